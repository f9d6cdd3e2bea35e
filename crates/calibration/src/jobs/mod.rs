//! Fits whose simulations are done by independent processes that share only a folder.
//!
//! The search is deterministic, and the folder contains every answer. A process that drives the fit therefore
//! repeats the search from its beginning, which requires no simulations, and continues where another process
//! ended.

mod driver;
mod folder;
mod points;

pub use driver::{JobDriver, JobDriverState};
pub use folder::{JobFolder, JobStatus};
pub use points::JobPoint;
