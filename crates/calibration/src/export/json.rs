//! Export of the numbers of a fit as valid JSON for other programs. Numbers that are not finite are null.

use super::files::check_belongs;
use super::tables::unit_of;
use crate::error::CalibrationError;
use crate::findings::finding::Finding;
use crate::fit::goodness::Goodness;
use crate::fit::one_stage::{ChosenTolerance, Fit, FitNoise};
use crate::fit::output_fit::OutputFit;
use crate::loaded::calibration::Calibration;
use crate::uncertainty::result::Uncertainty;
use serde::Serialize;
use serde_json::Value as Json;
use std::collections::BTreeMap;

impl Fit {
    /// Returns the results of the fit as JSON:
    ///
    /// - parameters with errors, start, bounds and units (derived parameters last),
    /// - cost and RMS,
    /// - quality of fit of each output,
    /// - uncertainty,
    /// - method and settings.
    ///
    /// The trace and the recordings are not included; [`Fit::save`] stores everything. Numbers that are not
    /// finite are null.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Setup`] if the fit does not belong to this calibration.
    pub fn to_json(&self, calibration: &Calibration) -> Result<String, CalibrationError> {
        check_belongs(self, calibration)?;
        let failed = |e: serde_json::Error| {
            CalibrationError::Setup(format!("the result cannot be written as JSON: {e}"))
        };
        serde_json::to_string_pretty(&self.json(calibration).map_err(failed)?).map_err(failed)
    }

    fn json(&self, calibration: &Calibration) -> Result<FitDocument<'_>, serde_json::Error> {
        let mut uncertainty = serde_json::to_value(&self.uncertainty)?;
        if let Some(fields) = uncertainty.as_object_mut() {
            // These arrays are as long as the recordings.
            fields.remove("jacobian");
            fields.remove("residuals");
            // These fields are only needed for predictions.
            fields.remove("joint");
            fields.remove("uncorrected_joint");
            // The findings of the fit include these findings.
            fields.remove("findings");
            fields.insert("verdict".to_owned(), self.uncertainty.as_ref().map(Uncertainty::verdict).into());
        }
        let parameters = calibration.parameters().iter().enumerate().map(|(k, p)| {
            let side = self.at_bound.iter().find(|(index, _)| *index == k).map(|(_, side)| side.name());
            FitParameter {
                name: p.name().to_owned(),
                value: self.x[k],
                standard_error: self.uncertainty.as_ref().map(|uncertainty| uncertainty.standard_errors[k]),
                start: self.start[k],
                unit: unit_of(p, calibration),
                free: Some(FreeParameter {
                    lower: p.lower(),
                    upper: p.upper(),
                    fixed: p.is_fixed(),
                    at_bound: side,
                    without_effect: self.without_effect.contains(&k),
                }),
                tied_to: None,
                expr: None,
            }
        });
        let derived = self.derived.iter().map(|derived| FitParameter {
            name: derived.name.clone(),
            value: derived.value,
            standard_error: self.uncertainty.as_ref().map(|uncertainty| derived.standard_error(uncertainty)),
            start: derived.start,
            unit: derived.unit.clone(),
            free: None,
            tied_to: derived.tied_to.clone(),
            expr: Some(derived.expression.clone()),
        });
        let report = &self.report;
        let model = &calibration.problem().model;
        let plan = calibration.evaluator().simulations.first().map(|simulation| simulation.pool.plan());
        let chosen = self.tolerance.map(|chosen| chosen.used);
        Ok(FitDocument {
            written_by: concat!("fmufit ", env!("CARGO_PKG_VERSION")),
            model: FitModel {
                name: calibration.fmu().description().model_name.clone(),
                path: model.path.display().to_string(),
                sha256: model.content_hash.clone(),
            },
            parameters: parameters.chain(derived).collect(),
            cost: self.cost,
            rms: self.rms,
            start_cost: self.start_cost,
            start_rms: self.start_rms,
            outputs: &self.outputs,
            goodness: self.goodness(),
            noise: self.noise.as_ref(),
            tolerance: self.tolerance,
            uncertainty,
            success: self.is_success(),
            usable: self.is_usable(),
            termination: report.termination.name(),
            message: &report.message,
            findings: self.findings(),
            method: &report.method,
            problem: calibration.problem().document()?,
            fit_options: serde_json::to_value(&self.options)?,
            stages: self
                .stages
                .iter()
                .map(|stage| serde_json::to_value(&stage.options))
                .collect::<Result<_, _>>()?,
            relative_tolerance: chosen.or_else(|| plan.map(|plan| plan.relative_tolerance())),
            options: report.options.iter().map(|(name, value)| (&name[..], &value[..])).collect(),
            solver: self.solver.name(),
            n_evaluations: report.n_evaluations,
            n_iterations: report.n_iterations,
            n_failed: report.n_failed,
            n_lost: report.n_lost,
            seconds: report.seconds,
            seed: report.seed,
            stats: serde_json::to_value(self.stats)?,
        })
    }
}

/// Results of a fit, see [`Fit::to_json`].
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(title = "Fit of fmufit"))]
pub struct FitDocument<'f> {
    /// Program and version that wrote the document.
    written_by: &'static str,
    model: FitModel,
    /// Parameters of the search, followed by derived parameters.
    parameters: Vec<FitParameter>,
    cost: f64,
    /// Root of the mean squared residual.
    rms: f64,
    start_cost: Option<f64>,
    start_rms: Option<f64>,
    /// Quality of fit of each output.
    outputs: &'f [OutputFit],
    /// Chi-square and information criteria.
    goodness: Goodness,
    noise: Option<&'f FitNoise>,
    /// Choice of the relative tolerance, if the user did not specify one.
    tolerance: Option<ChosenTolerance>,
    /// Relative tolerance of the simulations.
    relative_tolerance: Option<f64>,
    /// Fitted problem: model, parameters, experiments with descriptions of their recordings, and settings of
    /// the simulations.
    #[cfg_attr(feature = "schema", schemars(with = "BTreeMap<String, Json>"))]
    problem: Json,
    /// Options of the fit, as in the table `[fit]` of a problem file.
    #[cfg_attr(feature = "schema", schemars(schema_with = "crate::fit::schema::fit_schema"))]
    fit_options: Json,
    /// Options of the stages, as in the tables `[[stages]]`.
    #[cfg_attr(feature = "schema", schemars(schema_with = "crate::fit::schema::stages_schema"))]
    stages: Vec<Json>,
    /// Uncertainty of the parameters, if it was estimated, with a verdict in a sentence.
    #[cfg_attr(feature = "schema", schemars(with = "Option<BTreeMap<String, Json>>"))]
    uncertainty: Json,
    /// True if the search succeeded.
    success: bool,
    /// True if no finding is an error. The values are usable within the limits that the warnings describe.
    usable: bool,
    /// Reason for the termination, as a key.
    termination: &'f str,
    /// Reason for the termination, as a sentence.
    message: &'f str,
    findings: Vec<Finding>,
    method: &'f str,
    /// Options of the method as strings.
    options: BTreeMap<&'f str, &'f str>,
    solver: &'f str,
    n_evaluations: usize,
    n_iterations: usize,
    n_failed: usize,
    /// Number of answers that the executor lost. Their points were evaluated again.
    n_lost: usize,
    seconds: f64,
    seed: Option<u64>,
    /// Work counters of the simulations.
    #[cfg_attr(feature = "schema", schemars(with = "BTreeMap<String, Json>"))]
    stats: Json,
}

/// Model of a fit.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct FitModel {
    name: String,
    path: String,
    sha256: String,
}

/// Parameter of a fit.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct FitParameter {
    name: String,
    value: f64,
    standard_error: Option<f64>,
    start: f64,
    unit: Option<String>,
    /// Fields of parameters that are not derived.
    #[serde(flatten)]
    free: Option<FreeParameter>,
    /// Name of the parameter that this parameter is tied to.
    #[serde(skip_serializing_if = "Option::is_none")]
    tied_to: Option<String>,
    /// Formula of a derived parameter.
    #[serde(skip_serializing_if = "Option::is_none")]
    expr: Option<String>,
}

#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct FreeParameter {
    lower: f64,
    upper: f64,
    fixed: bool,
    /// Bound at which the parameter ended: `lower` or `upper`.
    at_bound: Option<&'static str>,
    without_effect: bool,
}
