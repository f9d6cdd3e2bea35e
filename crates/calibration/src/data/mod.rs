//! Recordings: tables from CSV files and from memory, with their time column and units.

mod clock_change;
mod csv;
mod csv_records;
mod dates;
mod parameter_set;
mod recording;
mod resampling;
mod series;
mod time_column;
mod unit_symbols;
mod units;

pub use clock_change::{ClockChange, clock_change};
pub use csv::CsvRequest;
pub(crate) use csv::how_to_convert;
pub use dates::{DateError, date_seconds};
pub use parameter_set::ParameterSet;
pub use recording::Data;
pub(crate) use recording::NewValues;
pub(crate) use resampling::Means;
pub use series::Series;
pub(crate) use series::sampling_interval;
pub(crate) use time_column::{MOST_LISTED, TimeUnit, listed, parts};
pub use time_column::{PairUnit, TimeColumn, find_column};
pub use units::{Unit, UnitConversion, UnitError};
