//! Fits the parameters of a Functional Mock-up Unit (FMU) to measurements. A model, data and parameters
//! define an objective.
//!
//! [`Data`] contains a recording. An [`Experiment`] maps the outputs of the model to the columns that
//! measured them. A [`Parameter`] is a value to fit, shared by all experiments or separate in each. Together
//! they form a [`Problem`], plain data that can be stored and sent to other processes. A [`Calibration`] is a
//! problem with its model loaded. It provides [`Calibration::cost`], [`Calibration::residuals`] and
//! [`Calibration::fit`].
//!
//! Folders, from the lowest layer:
//!
//! - `expression`: formulas over parameters;
//! - `data`: recordings, units, dates;
//! - `problem`: parameters, experiments, priors, settings, the fingerprint;
//! - `cost`: residuals and cost of simulations, worker processes, the choice of the solver;
//! - `loaded`: [`Calibration`], simulations around a point;
//! - `check`: mistakes in a setup;
//! - `uncertainty`: covariance, residual tests, active bounds, the preflight before a fit;
//! - `fit`: one stage, several stages;
//! - `intervals`: profiles, bands, samples of the posterior distribution;
//! - `sensitivity`: effects of the parameters over the whole box;
//! - `validation`: validation on held-out data, cross-validation;
//! - `report`: pages and figures;
//! - `export`: files, tables, other programs;
//! - `design`: design optimisation, which minimises or maximises criteria of trajectories;
//! - `jobs`: fits by processes that share a folder;
//! - `live_page`: the page of a running fit.
//!
//! Features: `sandbox` (default) and `sparse` enable the features of the same names in `fmi` and `ode`.
//! `report` adds the HTML report, figures and the page of a running fit. `schema` adds JSON schemas.
#![forbid(unsafe_code)]
// Only pages read the state of a running fit and the summary of a result.
#![cfg_attr(not(feature = "report"), allow(dead_code))]

mod check;
mod cost;
mod data;
mod design;
mod error;
mod export;
mod expression;
mod findings;
mod fit;
mod intervals;
mod jobs;
#[cfg(feature = "report")]
mod live_page;
mod loaded;
mod problem;
mod report;
mod sensitivity;
mod uncertainty;
mod validation;

pub use base::RunContext;
pub use check::{Check, CheckOptions};
pub use cost::isolated_instance::IsolatedInstance;
pub use cost::model_process::ModelProcess;
pub use cost::residual::quad_err;
pub use data::{
    ClockChange, CsvRequest, Data, DateError, PairUnit, ParameterSet, Series, TimeColumn, Unit,
    UnitConversion, UnitError, clock_change, date_seconds, find_column,
};
pub use design::{Design, DesignBuilder, DesignFront, DesignResult};
pub use dfo;
pub use dfo::ParameterKind;
pub use error::CalibrationError;
pub use export::{FitDocument, FmuExport, SavedFit, Table};
pub use expression::{Expression, ExpressionError, Inequality, LinearForm, Relation};
pub use findings::display_text::{visible, visible_error, visible_line};
pub use findings::finding::{Finding, Origin, Severity};
pub use findings::identifier::FindingId;
pub use fit::goodness::{Comparison, Goodness};
pub use fit::live::LiveFit;
pub use fit::one_stage::{
    ChosenTolerance, EstimatedNoise, Fit, FitNoise, FitObserver, FitOptions, FitRecord, ModelledNoise,
    NoiseRule, OutputNoise, SigmaSeries, SimulationExecutor,
};
pub use fit::output_fit::OutputFit;
pub use fit::phase::{CurrentPhase, FitPhase, PhaseCost};
#[cfg(feature = "schema")]
pub use fit::schema::{fit_schema, stages_schema};
pub use fit::several_stages::{Stage, StageRecord};
pub use fmi;
pub use intervals::bands::{BandOptions, PredictionBand};
pub use intervals::posterior::{Posterior, PosteriorOptions, PosteriorParameter, WalkerStart};
pub use intervals::profile::{ParameterProfile, Profile, ProfileEnd, ProfileOptions, ProfilePoint};
pub use jobs::{JobDriver, JobDriverState, JobFolder, JobPoint, JobStatus};
#[cfg(feature = "report")]
pub use live_page::LivePage;
pub use loaded::calibration::{Calibration, CalibrationBuilder};
pub use loaded::design_point::{CriterionValue, DesignPoint, LimitedValue};
pub use loaded::effort::Effort;
pub use loaded::worker::serve_if_worker;
pub use problem::column_units::{InputColumn, recorded_inputs};
pub use problem::constraint::{Constraints, LinearRows};
pub use problem::definition::{ModelFile, Problem};
pub use problem::error_model::{Coefficient, ErrorModel};
pub use problem::experiment::{Experiment, InitialState, OutputScale, Sigma, Weight};
pub use problem::experiment_record::ExperimentRecord;
pub use problem::goal::{Combination, Goal};
pub use problem::objective::{Compared, CostKind, CustomCost, CustomFailure, NamedCost};
pub use problem::parameter::{Parameter, Scale, Target, Tie};
pub use problem::prior::Prior;
pub use problem::residual_layout::{OutputResiduals, PriorResidual, ResidualLayout};
pub use problem::settings::SimulationSettings;
pub use problem::warning::{SETUP_LOG_TARGET, SetupWarning};
#[cfg(feature = "report")]
pub use report::plot;
pub use report::{ExperimentCurves, OutputCurves, Signal};
pub use sensitivity::{SensitivityOptions, SensitivityProgress};
pub use uncertainty::derived_value::DerivedValue;
pub use uncertainty::diagnostics::lack_of_fit::LackOfFit;
pub use uncertainty::diagnostics::prior_check::PriorConflict;
pub use uncertainty::diagnostics::residual_check::ResidualCheck;
pub use uncertainty::differences::ResidualBend;
pub use uncertainty::inactive_parameters::BoundSide;
pub use uncertainty::preflight::{ParameterCheck, Preflight, PreflightOptions};
pub use uncertainty::result::{Estimator, Uncertainty, UncertaintyOptions};
pub use validation::bootstrap::{Bootstrap, BootstrapKind, BootstrapOptions};
pub use validation::cross_validation::{CrossValidation, CrossValidationOptions, Fold};
pub use validation::held_out::{ValidatedOutput, Validation, ValidationSet};
