//! A problem with a loaded model, as its users see it: [`Calibration`](handle::Calibration), simulations
//! around a point, and the worker process that serves them.

pub(crate) mod handle;
pub(crate) mod simulations;
pub(crate) mod variables;
pub(crate) mod worker;
