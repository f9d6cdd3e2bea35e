//! Problems of fits as users write them: in a file, or in short form on the command line.

mod document;
mod error_location;
mod of_arguments;
mod problem_file;
pub(crate) mod short_form;

pub(crate) use of_arguments::of_arguments;
pub(crate) use problem_file::{ProblemFile, ProblemRecord};
