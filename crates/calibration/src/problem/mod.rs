//! The problem: parameters, experiments, priors, the objective, and the names that link them to the model.

pub(crate) mod assignment;
pub(crate) mod column_units;
pub(crate) mod constraint;
pub(crate) mod definition;
pub(crate) mod derived;
pub(crate) mod document;
pub(crate) mod error_model;
pub(crate) mod experiment;
pub(crate) mod experiment_record;
pub(crate) mod fingerprint;
pub(crate) mod goal;
pub(crate) mod input;
pub(crate) mod measurements;
pub(crate) mod objective;
pub(crate) mod parameter;
mod parameter_check;
pub(crate) mod prior;
pub(crate) mod residual_layout;
pub(crate) mod resolution;
pub(crate) mod resolved_goals;
pub(crate) mod row_means;
#[cfg(feature = "schema")]
pub(crate) mod schema;
pub(crate) mod settings;
pub(crate) mod warning;
