//! Recordings: tables from CSV files and from memory, their column of times and its unit.

mod csv;
mod table;
mod time_column;

pub use table::Data;
pub(crate) use table::sampling_interval;
pub use time_column::TimeColumn;
pub(crate) use time_column::parts;
