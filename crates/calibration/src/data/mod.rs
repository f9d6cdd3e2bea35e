//! Recordings: tables from CSV files and from memory, their column of times and its unit.

mod csv;
mod dates;
mod symbols;
mod table;
mod time_column;
mod units;

pub use dates::date_seconds;
pub use table::Data;
pub(crate) use table::sampling_interval;
pub use time_column::{PairUnit, TimeColumn, find_column};
pub(crate) use time_column::{listed, parts};
pub use units::{Unit, UnitConversion, UnitError};
