//! Fit the parameters of a Functional Mock-up Unit to measurements: a model, data and parameters become an objective.
//!
//! [`Data`] holds what was recorded, an [`Experiment`] says which column measures which output of the model, a
//! [`Parameter`] what may vary. A [`Calibration`] puts them together: [`Calibration::cost`],
//! [`Calibration::residuals`] and [`Calibration::fit`].
#![forbid(unsafe_code)]

mod calibration;
mod data;
mod effect;
mod error;
mod experiment;
mod fit;
mod identity;
mod parameter;
mod race;
mod residual;
mod solver;
mod spot_checks;
mod time_column;
mod warning;

pub use calibration::{Calibration, CalibrationBuilder};
pub use data::Data;
pub use dfo;
pub use dfo::Kind;
pub use effect::BoundSide;
pub use error::CalibrationError;
pub use experiment::{Experiment, SimulationSettings};
pub use fit::{Fit, FitObserver, FitOptions};
pub use fmi;
pub use parameter::{Parameter, Scale};
pub use race::{Entry, Heat, Lap, Race, Verdict, race};
pub use residual::quad_err;
pub use solver::Solver;
pub use time_column::TimeColumn;
pub use warning::{SETUP_LOG_TARGET, SetupWarning};
