//! Fit the parameters of a Functional Mock-up Unit to measurements: a model, data and parameters become an objective.
//!
//! [`Data`] holds a recording, an [`Experiment`] which of its columns measures which output of the model, a [`Parameter`] what
//! varies: in all experiments alike, or with a value in each. Together they are a [`Problem`], plain data that can be stored and
//! sent to other processes. A [`Calibration`] is a problem with its model loaded: [`Calibration::cost`],
//! [`Calibration::residuals`] and [`Calibration::fit`].
//!
//! Modules, from the lowest: `data`, `parameter`, `experiment`, `problem`; `column_units` (recordings in the units of the model);
//! `measurements` (which of them count), `residual` (measured against simulated), `assignment` (what an entry of `x` sets),
//! `simulation` (of an experiment), `evaluate` (residuals and cost at a point), `objective` (other costs); `race` and `solver` (which method integrates);
//! `calibration`; `check` (what does not fit, before a fit); `effect` (checks after a fit), `fit`, `stages`,
//! `prediction`, `profile` (how the cost rises beside the optimum), `validation`, `cross_validation`; `report` (what it found, for people);
//! `export` (files, tables, other programs).
#![forbid(unsafe_code)]

mod accuracy;
mod assignment;
mod calibration;
mod check;
mod column_units;
mod cross_validation;
mod data;
mod effect;
mod error;
mod evaluate;
mod experiment;
mod export;
mod finding;
mod fit;
mod identity;
mod input;
mod layout;
mod measurements;
mod names;
mod no_cost;
mod objective;
mod output_fit;
mod parallel;
mod parameter;
mod parameter_record;
mod phase;
mod prediction;
mod preflight;
mod prior;
mod problem;
mod profile;
mod race;
mod remote;
mod report;
mod residual;
mod simulation;
mod simulations;
mod solver;
mod stages;
mod validation;
mod visible;
mod warning;
mod worker;
mod worth;

pub use base::RunContext;
pub use calibration::{Calibration, CalibrationBuilder};
pub use check::{Check, CheckOptions};
pub use column_units::{InputColumn, recorded_inputs};
pub use cross_validation::{CrossValidation, CrossValidationOptions, Fold};
pub use data::{
    ClockChange, CsvRequest, Data, DateError, PairUnit, Series, TimeColumn, Unit, UnitConversion, UnitError,
    clock_change, date_seconds, find_column,
};
pub use dfo;
pub use dfo::Kind;
pub use effect::BoundSide;
pub use error::CalibrationError;
pub use experiment::{Experiment, InitialState, OutputScale, SimulationSettings, Weight};
pub use export::{FmuExport, SavedFit, Table};
pub use finding::{Finding, Severity};
pub use fit::{
    ChosenTolerance, Engine, EstimatedNoise, Fit, FitNoise, FitObserver, FitOptions, NoiseRule, OutputNoise,
};
pub use fmi;
pub use layout::{OutputResiduals, PriorResidual, ResidualLayout};
pub use objective::{Compared, CostKind, CustomCost, CustomFailure, NamedCost};
pub use output_fit::OutputFit;
pub use parameter::{Parameter, Scale, Target, Tie};
pub use phase::{CurrentPhase, FitPhase};
pub use prediction::{BandOptions, PredictionBand};
pub use preflight::{ParameterCheck, Preflight, PreflightOptions};
pub use prior::Prior;
pub use problem::{ModelFile, Problem};
pub use profile::{ParameterProfile, Profile, ProfileEnd, ProfileOptions, ProfilePoint};
pub use race::{Entry, Race, RaceOutcome, RaceTask, Verdict, race};
pub use remote::ModelProcess;
pub use report::{ExperimentCurves, OutputCurves, Signal};
pub use residual::quad_err;
pub use solver::Solver;
pub use stages::Stage;
pub use validation::{ValidatedOutput, Validation, ValidationSet};
pub use visible::visible;
pub use warning::{SETUP_LOG_TARGET, SetupWarning};
pub use worker::serve_if_asked;
pub use worth::{Estimator, PriorConflict, ResidualCheck, Unmodelled, UnmodelledKind, Worth, WorthOptions};
