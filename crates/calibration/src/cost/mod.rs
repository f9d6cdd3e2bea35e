//! Residuals and cost of a problem, from simulations in this process or in worker processes.

pub(crate) mod accuracy;
pub(crate) mod comparison;
pub(crate) mod criteria;
pub(crate) mod failure;
pub(crate) mod isolated_instance;
pub(crate) mod loaded_problem;
pub(crate) mod model_process;
pub(crate) mod parallel;
pub(crate) mod process;
pub(crate) mod request;
pub(crate) mod residual;
pub(crate) mod simulation;
pub(crate) mod split;
