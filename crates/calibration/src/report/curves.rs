//! Data of the figures of a fit: measurements, responses at the start and at the fitted values, residuals,
//! inputs, sensitivities.

#[cfg(feature = "report")]
use super::figure::{self, Panel, Series};
use crate::cost::parallel;
use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use crate::problem::input::InputSource;
use crate::problem::residual_layout::OutputResiduals;
use base::RunContext;
use fmi::Trajectory;
use serde::Serialize;
use std::thread::available_parallelism;

/// Height of a panel of a plot, in pixels.
#[cfg(feature = "report")]
const PANEL: u32 = 160;

/// Points of a response, about.
const CURVE_POINTS: usize = 2001;

/// Curves of one experiment of a fit.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ExperimentCurves {
    /// The experiment.
    pub name: String,
    /// The first time of the recording as it stands in the file, where times are dates.
    pub first_date: Option<String>,
    /// Where measurements count, in s; none: everywhere.
    pub windows: Vec<(f64, f64)>,
    /// Its outputs, in the order of the residual vector.
    pub outputs: Vec<OutputCurves>,
    /// Its recorded inputs.
    pub inputs: Vec<Signal>,
}

/// Curves of one output of an experiment.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct OutputCurves {
    /// The measurements that count.
    pub measured: Signal,
    /// Simulated at the fitted values minus measured, without weights, at the same times.
    pub residuals: Vec<f64>,
    /// The response at the start of the fit; `None` if the simulation fails there.
    pub start: Option<Signal>,
    /// The response at the fitted values.
    pub fitted: Option<Signal>,
}

/// A variable over time.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Signal {
    /// The variable of the model.
    pub variable: String,
    /// Its unit, where the model states it.
    pub unit: Option<String>,
    /// Times, in s.
    pub times: Vec<f64>,
    /// Its values.
    pub values: Vec<f64>,
}

/// Columns over their times, in s, as an SVG drawing with a panel for each, labelled by its name; `None`
/// where there is nothing finite to draw.
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
    /// Curves of a fit, experiment by experiment: each is simulated at the start of the fit and at the fitted
    /// values, with the steps of the fit. The context is looked at before every step of the simulations.
    ///
    /// # Errors
    /// The fit has another number of parameters, or its simulation fails now;
    /// [`CalibrationError::Cancelled`].
    pub fn curves(
        &self,
        fit: &Fit,
        context: &RunContext<'_>,
    ) -> Result<Vec<ExperimentCurves>, CalibrationError> {
        self.check_length(&fit.x)?;
        let layout = fit.residual_layout(self);
        let residuals = match &fit.uncertainty {
            Some(uncertainty) if uncertainty.residuals.len() == layout.n_residuals() => {
                uncertainty.residuals.clone()
            }
            _ => layout.reweighed(&self.residuals(&fit.x, context)?, self.residual_layout()),
        };
        let names = self.problem().experiment_names();
        // Chosen before several threads ask for it.
        let workers = available_parallelism().map_or(1, usize::from);
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
                let own = residuals[series.range.clone()].iter().zip(&series.weights);
                OutputCurves {
                    measured: signal(&series.times, &series.measured),
                    residuals: own.map(|(r, w)| r / w).collect(),
                    start: curve(&at_start),
                    fitted: curve(&at_end),
                }
            };
            let experiment = &self.problem().experiments[k];
            let own = layout.outputs.iter().filter(|series| series.experiment == k);
            let input = |(variable, source): &(String, InputSource)| {
                let InputSource::Column(column) = source else { return None };
                let values = experiment.data.column(column).ok()?;
                Some(self.signal(variable, experiment.data.time(), values))
            };
            let inputs = experiment.inputs.iter().filter_map(input).collect();
            Ok(ExperimentCurves {
                name,
                first_date: experiment.data.first_date().map(str::to_owned),
                windows: experiment.windows.clone(),
                outputs: own.map(output).collect(),
                inputs,
            })
        };
        names.into_iter().enumerate().map(curves).collect()
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

    /// An experiment simulated from its start to its last measurement, with the steps of the fit; `None` if
    /// that fails.
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

    /// Sensitivity of each output to each parameter, without weights, in the order of the residual vector:
    /// the derivative times the size of the parameter's value (of one that is zero: its nominal size), so the
    /// effect of a relative change of one. Per output one column per parameter. Empty where the fit has no
    /// [`Uncertainty`](crate::Uncertainty).
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
