//! Data of the figures of a fit: measurements, responses at the start and at the fitted values, residuals,
//! inputs, and sensitivities.

#[cfg(feature = "report")]
use super::figure::{self, Panel, Series};
use crate::cost::parallel;
use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use crate::problem::input::{InputSource, hold};
use crate::problem::residual_layout::OutputResiduals;
use base::RunContext;
use fmi::Trajectory;
use serde::Serialize;

/// Height of a panel of a plot, in pixels.
#[cfg(feature = "report")]
const PANEL: u32 = 160;

/// Approximate number of points of a response.
const CURVE_POINTS: usize = 2001;

/// Curves of one experiment of a fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ExperimentCurves {
    /// Name of the experiment.
    pub name: String,
    /// Unit of all times: the time unit of the model.
    pub time_unit: String,
    /// First time of the recording as written in the file, if times are dates.
    pub first_date: Option<String>,
    /// Windows in which measurements count; empty if all measurements count.
    pub windows: Vec<(f64, f64)>,
    /// Outputs, in the order of the residual vector.
    pub outputs: Vec<OutputCurves>,
    /// Recorded inputs.
    pub inputs: Vec<Signal>,
}

/// Curves of one output of an experiment.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct OutputCurves {
    /// Measurements that count.
    pub measured: Signal,
    /// Simulated values at the fitted parameters minus measurements, without weights, at the same times.
    pub residuals: Vec<f64>,
    /// Standard deviations of the noise of these measurements if it is known
    /// ([`Weight::Sigma`](crate::Weight::Sigma)), in the unit of the variable.
    pub sigma: Option<Vec<f64>>,
    /// Response at the start of the fit; `None` if the simulation fails there.
    pub start: Option<Signal>,
    /// Response at the fitted values.
    pub fitted: Option<Signal>,
}

/// A variable over time.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Signal {
    /// Variable of the model.
    pub variable: String,
    /// Unit, if the model declares it.
    pub unit: Option<String>,
    /// Times, in the time unit of the model.
    pub times: Vec<f64>,
    /// Values.
    pub values: Vec<f64>,
}

/// Returns the standard deviations of an output with known noise. Measurements of weight zero have an
/// infinite one.
pub(super) fn known_sigma(series: &OutputResiduals) -> Option<Vec<f64>> {
    let is_known = series.is_noise_known && !series.is_log;
    is_known.then(|| series.weights.iter().map(|weight| 1.0 / weight).collect())
}

/// Draws columns over their times, in s, as SVG with one panel per column, labelled by its name. Returns
/// `None` if there are no finite values to draw.
#[cfg(feature = "report")]
pub fn plot<'a>(times: &[f64], columns: impl IntoIterator<Item = (String, &'a [f64])>) -> Option<String> {
    let panel = |(y_label, values): (String, &[f64])| {
        let points = times.iter().copied().zip(values.iter().copied()).collect();
        Panel {
            height: PANEL,
            y_label,
            series: vec![Series::Fitted(points)],
            is_logarithm: false,
            has_zero: false,
        }
    };
    figure::draw(&columns.into_iter().map(panel).collect::<Vec<_>>(), "time in s")
}

impl Calibration {
    /// Returns the curves of a fit, experiment by experiment. Each experiment is simulated at the start of
    /// the fit and at the fitted values, with the steps of the fit. The context is checked before every step
    /// of the simulations.
    ///
    /// # Errors
    /// Returns an error if the fit has a different number of parameters, or if its simulation now fails.
    /// Returns [`CalibrationError::Cancelled`] if the context has ended.
    pub fn curves(
        &self,
        fit: &Fit,
        context: &RunContext<'_>,
    ) -> Result<Vec<ExperimentCurves>, CalibrationError> {
        self.check_length(&fit.x)?;
        if !self.problem().goals.is_empty() {
            return self.curves_of_design(fit, context);
        }
        let layout = fit.residual_layout(self);
        let residuals = match &fit.uncertainty {
            Some(uncertainty) if uncertainty.residuals.len() == layout.n_residuals() => {
                uncertainty.residuals.clone()
            }
            _ => layout.reweighed(&self.residuals(&fit.x, context)?, self.residual_layout()),
        };
        let names = self.problem().experiment_names();
        let workers = base::available_cores();
        let simulate = |k: usize, context: &RunContext<'_>| {
            self.response(k / 2, if k.is_multiple_of(2) { &fit.start } else { &fit.x }, context)
        };
        let mut responses = parallel::map(2 * names.len(), workers, context, &simulate).into_iter();
        let mut response = || responses.next().flatten().unwrap_or(Err(CalibrationError::Cancelled));
        let curves = |(k, name): (usize, String)| {
            let (at_start, at_end) = (response()?, response()?);
            let output = |series: &OutputResiduals| {
                let signal = |times: &[f64], values: &[f64]| self.signal(&series.variable, times, values);
                let curve = |trajectory: &Option<Trajectory>| {
                    let trajectory = trajectory.as_ref()?;
                    Some(signal(&trajectory.time, trajectory.columns.get(series.output)?))
                };
                OutputCurves {
                    measured: signal(&series.times, &series.measured_values()),
                    residuals: series.differences(&residuals),
                    sigma: known_sigma(series),
                    start: curve(&at_start),
                    fitted: curve(&at_end),
                }
            };
            let experiment = &self.problem().experiments[k];
            let of_experiment = layout.outputs.iter().filter(|series| series.experiment == k);
            let input = |(variable, source): &(String, InputSource)| {
                let (times, values) =
                    (experiment.data.time(), experiment.data.column(source.column()?).ok()?);
                if let InputSource::Held(_) = source {
                    let (times, values) = hold(times, values);
                    return Some(self.signal(variable, &times, &values));
                }
                Some(self.signal(variable, times, values))
            };
            let inputs = experiment.inputs.iter().filter_map(input).collect();
            Ok(ExperimentCurves {
                name,
                time_unit: experiment.data.time_unit().to_owned(),
                first_date: experiment.data.first_date().map(str::to_owned),
                windows: experiment.windows.clone(),
                outputs: of_experiment.map(output).collect(),
                inputs,
            })
        };
        names.into_iter().enumerate().map(curves).collect()
    }

    /// Returns the variables in the criteria of a design, at the start and at the result.
    fn curves_of_design(
        &self,
        fit: &Fit,
        context: &RunContext<'_>,
    ) -> Result<Vec<ExperimentCurves>, CalibrationError> {
        let curves = |(k, name): (usize, String)| {
            let (start, end) = self.span(k);
            let rows: Vec<f64> = (0..CURVE_POINTS)
                .map(|i| (end - start) * i as f64 / (CURVE_POINTS - 1) as f64 + start)
                .collect();
            let variables = self.evaluator().simulations[k].criteria.outputs();
            let simulate = |x: &[f64]| self.simulate_variables(k, x, Some(&rows), variables, context);
            let (at_start, at_end) = (simulate(&fit.start).ok(), simulate(&fit.x)?);
            let output = |(i, variable): (usize, &String)| {
                let of = |found: &Trajectory| Some(self.signal(variable, &found.time, found.columns.get(i)?));
                OutputCurves {
                    measured: self.signal(variable, &[], &[]),
                    residuals: Vec::new(),
                    sigma: None,
                    start: at_start.as_ref().and_then(of),
                    fitted: of(&at_end),
                }
            };
            Ok(ExperimentCurves {
                name,
                time_unit: self.fmu().description().time_unit().to_owned(),
                first_date: None,
                windows: Vec::new(),
                outputs: variables.iter().enumerate().map(output).collect(),
                inputs: Vec::new(),
            })
        };
        self.problem().experiment_names().into_iter().enumerate().map(curves).collect()
    }

    fn signal(&self, variable: &str, times: &[f64], values: &[f64]) -> Signal {
        let declared = self.fmu().description().variable(variable);
        Signal {
            variable: variable.to_owned(),
            unit: declared.and_then(|v| v.unit.clone()),
            times: times.to_vec(),
            values: values.to_vec(),
        }
    }

    /// Simulates an experiment from its start to its last measurement, with the steps of the fit. Returns
    /// `None` if the simulation fails.
    fn response(
        &self,
        k: usize,
        x: &[f64],
        context: &RunContext<'_>,
    ) -> Result<Option<Trajectory>, CalibrationError> {
        let times = self.evaluator().simulations[k].curve_times(CURVE_POINTS);
        match self.simulate_experiment(k, x, Some(&times), context) {
            Err(CalibrationError::Cancelled) => Err(CalibrationError::Cancelled),
            simulated => Ok(simulated.ok()),
        }
    }

    /// Returns the sensitivity of each output to each parameter, without weights, in the order of the
    /// residual vector. The sensitivity is the derivative times the absolute value of the parameter, or times
    /// its nominal size if the value is zero. It is the effect of a relative change of one. Each output has
    /// one column per parameter. The result is empty if the fit has no [`Uncertainty`](crate::Uncertainty).
    pub fn sensitivities(&self, fit: &Fit) -> Vec<Vec<Vec<f64>>> {
        let (layout, n) = (fit.residual_layout(self), fit.x.len());
        let jacobian = fit.uncertainty.as_ref().map(|uncertainty| uncertainty.jacobian.as_slice());
        let Some(jacobian) =
            jacobian.filter(|j| n > 0 && n == self.parameters().len() && j.len() == n * layout.n_residuals())
        else {
            return Vec::new();
        };
        let size = |i: usize| match fit.x[i].abs() {
            0.0 => self.size_of(&self.parameters()[i], 0.0),
            size => size,
        };
        let column = |series: &OutputResiduals, i: usize| {
            let rows = series.range.clone().zip(&series.weights);
            rows.map(|(row, weight)| jacobian[row * n + i] * size(i) / weight).collect()
        };
        let columns = |series: &OutputResiduals| (0..n).map(|i| column(series, i)).collect();
        layout.outputs.iter().map(columns).collect()
    }
}
