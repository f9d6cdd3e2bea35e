//! Export of a fit to a file that can be loaded again, to tables, and to other programs.

mod files;
mod fmu;
mod json;
mod lengths;
mod saved_fit;
mod ssv;
mod tables;

pub use fmu::FmuExport;
pub use json::FitDocument;
pub use saved_fit::SavedFit;
pub use tables::Table;
