//! Handing a fit on: to a file that is read back, to tables, to other programs.

mod document;
mod files;
mod saved_fit;

pub use saved_fit::SavedFit;
