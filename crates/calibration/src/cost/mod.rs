//! A problem with a loaded model: simulations, residuals and cost, in this process or in worker processes,
//! and the choice of the solver.

pub(crate) mod accuracy;
pub(crate) mod batch;
pub(crate) mod calibration;
pub(crate) mod evaluator;
pub(crate) mod failure;
pub(crate) mod parallel;
pub(crate) mod process;
pub(crate) mod race;
pub(crate) mod residual;
pub(crate) mod simulation;
pub(crate) mod solver;
pub(crate) mod variables;
pub(crate) mod worker;
