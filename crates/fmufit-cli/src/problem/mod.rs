//! Problems of fits as users write them: in a file, or in short on the command line.

mod asked;
mod document;
mod place;
mod problem_file;
pub(crate) mod short_form;

pub(crate) use asked::asked;
pub(crate) use problem_file::{ProblemFile, ProblemRecord};
