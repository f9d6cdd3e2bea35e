//! A problem with its loaded model: [`Calibration`](calibration::Calibration), simulations around a point and
//! their budget, files of computations under way, and the worker process that serves them.

pub(crate) mod budget;
pub(crate) mod calibration;
pub(crate) mod design_point;
pub(crate) mod effort;
pub(crate) mod saved_file;
pub(crate) mod simulations_around;
pub(crate) mod variables;
pub(crate) mod worker;
