//! Page of a running fit: the figures of the report, drawn from the results of the search.

use super::curves::{ExperimentCurves, OutputCurves, Signal, known_sigma};
use super::number::rounded;
use super::page::{Figure, cost_figure, output_figures};
use super::template;
use crate::fit::live::{LiveFit, LiveResiduals};
use crate::loaded::calibration::Calibration;
use crate::problem::parameter::Parameter;
use serde::Serialize;
use std::collections::HashMap;
use std::time::Instant;

/// Number of significant digits.
const DIGITS: usize = 6;

/// Maximum number of outputs in figures; the page is redrawn repeatedly.
const MOST_OUTPUTS: usize = 12;

/// Maximum number of listed running evaluations, and of listed reasons of failures.
const MOST_ROWS: usize = 8;

/// Data that do not change while a fit runs.
#[derive(Debug)]
pub(crate) struct LiveSubject {
    model: String,
    parameters: Vec<Row>,
    bounds: Vec<(f64, f64)>,
    experiments: Vec<String>,
    /// Units of the outputs.
    units: HashMap<String, String>,
    /// Time unit of the model.
    time_unit: String,
    began: Instant,
}

/// A parameter.
#[derive(Debug, Clone, Serialize)]
struct Row {
    name: String,
    start: String,
    value: String,
    unit: String,
    bounds: [String; 2],
    remark: String,
}

/// A point and a remark.
#[derive(Serialize)]
struct PointRow {
    text: String,
    x: Vec<String>,
}

#[derive(Serialize)]
struct State {
    sentence: String,
    parameters: Vec<Row>,
    search: Vec<Figure>,
    outputs: Vec<Figure>,
    /// Number of outputs that are not drawn.
    more_outputs: usize,
    running: Vec<PointRow>,
    n_failed: usize,
    failures: Vec<(String, usize)>,
    failed: Vec<PointRow>,
}

/// Returns the page of a failed fit, with the reason.
pub(crate) fn error_page(message: &str) -> String {
    template::error(message)
}

fn numbers(x: &[f64]) -> Vec<String> {
    x.iter().map(|value| rounded(*value, DIGITS)).collect()
}

impl LiveSubject {
    pub(crate) fn new(calibration: &Calibration) -> Self {
        let description = calibration.fmu().description();
        let parameter = |p: &Parameter| Row {
            name: p.shown_name().to_owned(),
            start: rounded(p.start(), DIGITS),
            value: String::new(),
            unit: p.unit(description).unwrap_or_default().to_owned(),
            bounds: [p.lower(), p.upper()].map(|bound| rounded(bound, DIGITS)),
            remark: if p.is_fixed() { "fixed".to_owned() } else { String::new() },
        };
        let outputs = calibration.residual_layout().outputs.iter();
        let unit = |variable: &String| {
            let unit = description.variable(variable)?.unit.clone()?;
            Some((variable.clone(), unit))
        };
        Self {
            model: description.model_name.clone(),
            parameters: calibration.parameters().iter().map(parameter).collect(),
            bounds: calibration.parameters().iter().map(|p| p.search_bounds()).collect(),
            experiments: calibration.problem().experiment_names(),
            units: outputs.filter_map(|output| unit(&output.variable)).collect(),
            time_unit: description.time_unit().to_owned(),
            began: Instant::now(),
        }
    }

    /// Returns the page. The `nonce` belongs to its script, and `state` is the variable part.
    pub(crate) fn page(&self, nonce: &str, state: &str) -> String {
        template::live(&format!("Fit of {}, running", self.model), nonce, state)
    }

    /// Returns the responses that the search has simulated so far at its start and at the best point.
    pub(crate) fn curves(&self, live: &LiveFit) -> Vec<ExperimentCurves> {
        live.state().residuals().map(|found| self.curves_of(&found)).unwrap_or_default()
    }

    /// Returns the variable part of the page. The `phase` is the current phase of the fit.
    pub(crate) fn state(&self, live: &LiveFit, phase: &str) -> String {
        let state = live.state();
        let found = state.residuals();
        let n_outputs = found.as_ref().map_or(0, |found| found.layout.outputs.len());
        let running = live.under_way();
        let listed = running.iter().take(MOST_ROWS).map(|running| PointRow {
            text: format!("{:.1} s", running.since.elapsed().as_secs_f64()),
            x: numbers(&running.x),
        });
        let failed = state.failed.iter().map(|(x, reason)| PointRow { text: reason.clone(), x: numbers(x) });
        let cost = state
            .best
            .as_ref()
            .map_or_else(String::new, |(_, cost)| format!(", cost {}", rounded(*cost, DIGITS)));
        let mut failures = state.failures.clone();
        failures.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
        failures.truncate(MOST_ROWS);
        template::live_state(State {
            sentence: format!(
                "For {:.0} s, now {phase}: iteration {}, {} evaluations, {} failed, {} under way{cost}.",
                self.began.elapsed().as_secs_f64(),
                state.n_iterations,
                state.n_evaluations,
                state.n_failed,
                running.len(),
            ),
            parameters: self.rows(state.best.as_ref().map(|(x, _)| x.as_slice())),
            search: match state.costs.is_empty() {
                true => Vec::new(),
                false => vec![cost_figure(state.costs, state.n_evaluations, state.n_failed)],
            },
            outputs: output_figures(&found.map(|found| self.curves_of(&found)).unwrap_or_default(), ""),
            more_outputs: n_outputs.saturating_sub(MOST_OUTPUTS),
            running: listed.collect(),
            n_failed: state.n_failed,
            failures,
            failed: failed.collect(),
        })
    }

    /// Returns the parameters with their values at the best point.
    fn rows(&self, best: Option<&[f64]>) -> Vec<Row> {
        let mut rows = self.parameters.clone();
        for ((row, value), (lower, upper)) in rows.iter_mut().zip(best.unwrap_or_default()).zip(&self.bounds)
        {
            row.value = rounded(*value, DIGITS);
            if row.remark.is_empty() && (value <= lower || value >= upper) {
                row.remark = format!("at its {} bound", if value <= lower { "lower" } else { "upper" });
            }
        }
        rows
    }

    /// Returns the curves of the first outputs. Simulated values are the measurements plus the residuals.
    fn curves_of(&self, found: &LiveResiduals) -> Vec<ExperimentCurves> {
        let mut all: Vec<ExperimentCurves> = (self.experiments.iter())
            .map(|name| ExperimentCurves {
                time_unit: self.time_unit.clone(),
                first_date: None,
                name: name.clone(),
                windows: Vec::new(),
                outputs: Vec::new(),
                inputs: Vec::new(),
            })
            .collect();
        for output in found.layout.outputs.iter().take(MOST_OUTPUTS) {
            let signal = |values: Vec<f64>| Signal {
                variable: output.variable.clone(),
                unit: self.units.get(&output.variable).cloned(),
                times: output.times.to_vec(),
                values,
            };
            let simulated = |residuals: &[f64]| {
                let residuals_of_output = residuals.get(output.range.clone()).unwrap_or_default();
                signal(
                    residuals_of_output
                        .iter()
                        .zip(&output.measured)
                        .map(|(r, measured)| output.value(measured + r))
                        .collect(),
                )
            };
            let curves = OutputCurves {
                measured: signal(output.measured_values()),
                residuals: found.at_best.get(output.range.clone()).unwrap_or_default().to_vec(),
                sigma: known_sigma(output),
                start: found.at_start.as_deref().map(simulated),
                fitted: Some(simulated(&found.at_best)),
            };
            if let Some(experiment) = all.get_mut(output.experiment) {
                experiment.outputs.push(curves);
            }
        }
        all
    }
}
