//! Prediction bands: uncertainty of model predictions due to the uncertainty of the parameters.

use crate::cost::parallel;
use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use crate::problem::parameter::{Parameter, inner, outer};
use crate::problem::residual_layout::OutputResiduals;
use crate::uncertainty::covariance::measured_start::MeasuredStart;
use crate::uncertainty::joint_errors::{JointErrors, VarianceEstimate};
use crate::uncertainty::result::{Uncertainty, check_level};
use crate::uncertainty::row_blocks::go_on;
use base::{Number, RunContext};
use fmi::Trajectory;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use serde::{Deserialize, Serialize};

/// Minimum relative change of at least one parameter for a step along a principal axis. Steps are otherwise
/// one standard error. With smaller steps, the noise of the simulations would dominate.
const SHORTEST: f64 = 1e-4;

/// A side is skipped if the bounds leave less than this part of a step.
const TOO_NARROW: f64 = 0.25;

/// Principal axes with less than this part of the largest variance are due to rounding.
const ROUNDING: f64 = 1e-12;

/// Options of a prediction band.
#[derive(Debug, Clone, PartialEq)]
pub struct BandOptions {
    /// Times of the predictions in s, ascending; default: the times of the measurements.
    pub times: Option<Vec<f64>>,
    /// Coverage probability of an interval; default 0.95.
    pub level: f64,
    /// True to correct for autocorrelated residuals, as [`Uncertainty::covariance`] does; default: true.
    pub is_corrected: bool,
    /// Names of the outputs; default: all compared outputs.
    pub outputs: Option<Vec<String>>,
    /// Number of parallel simulations; default: all cores. The result does not depend on it.
    pub workers: Option<usize>,
}

impl Default for BandOptions {
    fn default() -> Self {
        Self { times: None, level: 0.95, is_corrected: true, outputs: None, workers: None }
    }
}

/// Prediction of one output of one experiment, with its uncertainty at each time. The level is pointwise, not
/// simultaneous for the whole curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PredictionBand {
    /// Name of the experiment.
    pub experiment: String,
    /// Variable of the model.
    pub variable: String,
    /// Unit of the variable, if the model declares one.
    pub unit: Option<String>,
    /// Times in s.
    #[serde(rename = "time")]
    pub times: Vec<f64>,
    /// Predicted values.
    #[serde(rename = "value")]
    pub values: Vec<f64>,
    /// Standard errors of the prediction due to the uncertainty of the parameters.
    #[serde(rename = "standard_error")]
    pub standard_errors: Vec<f64>,
    /// Standard deviation of the noise of a measurement at each time: the standard deviation of the residuals
    /// divided by the weight of the measurement. It is interpolated linearly between measurements. NaN if all
    /// weights are zero.
    pub noise: Vec<f64>,
    /// Lower ends of the intervals of the model output.
    pub lower: Vec<f64>,
    /// Upper ends of the intervals of the model output.
    pub upper: Vec<f64>,
    /// Lower ends of the intervals of a new measurement, which contains noise.
    pub measured_lower: Vec<f64>,
    /// Upper ends of the intervals of a new measurement.
    pub measured_upper: Vec<f64>,
}

/// Step along a principal axis. `forward` and `backward` are fractions of one standard error.
struct Step {
    direction: DVector<f64>,
    /// Axis divided by the root of its variance.
    axis: DVector<f64>,
    forward: f64,
    backward: f64,
}

/// Errors of a fit along the principal axes of its parameters, followed by the measured initial states.
struct AxisErrors<'a> {
    joint: &'a JointErrors,
    covariance: DMatrix<f64>,
    slopes: Vec<DMatrix<f64>>,
    level: f64,
}

impl<'a> AxisErrors<'a> {
    /// Creates the errors from the standard errors `errors` and the `steps` along the axes of the
    /// correlation.
    fn new(joint: &'a JointErrors, errors: &[f64], steps: &[Step], level: f64) -> Self {
        let (n, k) = (errors.len(), joint.starts.len());
        // Inverse of the axes, scaled by the standard errors.
        let mut inverse = DMatrix::zeros(steps.len() + k, n + k);
        for (a, step) in steps.iter().enumerate() {
            (0..n).filter(|i| step.axis[*i] != 0.0).for_each(|i| inverse[(a, i)] = step.axis[i] / errors[i]);
        }
        inverse.view_mut((steps.len(), n), (k, k)).fill_with_identity();
        let along = |of: &[f64]| &inverse * joint.matrix(of) * inverse.transpose();
        let slopes = joint.slopes.iter().map(|slope| along(slope)).collect();
        Self { covariance: along(&joint.covariance), slopes, joint, level }
    }

    /// Returns the variance of a prediction from its changes along the axes and with the initial states.
    fn variance(&self, changes: &DVector<f64>) -> VarianceEstimate {
        let of = |matrix: &DMatrix<f64>| changes.dot(&(matrix * changes));
        VarianceEstimate {
            value: of(&self.covariance).max(0.0),
            slopes: self.slopes.iter().map(of).collect(),
        }
    }

    /// Returns half the width of an interval.
    fn width(&self, variance: &VarianceEstimate) -> Result<f64, CalibrationError> {
        if variance.value == 0.0 {
            return Ok(0.0);
        }
        let degrees = self.joint.degrees_of_freedom(variance);
        Ok(check_level(self.level, degrees)? * variance.value.sqrt())
    }
}

/// Returns the uncertainty of a fit if bands can be computed from it.
fn usable_uncertainty(fit: &Fit, is_corrected: bool) -> Result<Uncertainty, CalibrationError> {
    let setup = |message: String| Err(CalibrationError::Setup(message));
    let Some(uncertainty) = &fit.uncertainty else {
        return setup(
            "a prediction band requires the covariance of the parameters. This fit has none because it ended early, was made without \
             it, or minimised neither a sum of squares nor the likelihood"
                .to_owned(),
        );
    };
    if !uncertainty.undetermined.is_empty() {
        let names: Vec<&str> = uncertainty.undetermined.iter().map(|i| fit.names[*i].as_str()).collect();
        return setup(format!(
            "the prediction band is unbounded because the data do not determine {}. Fix it, or add a prior",
            names.join(", ")
        ));
    }
    if uncertainty.joint.is_empty() {
        return setup(
            "the file of this fit is from an older version without the data of a prediction band. Fit again"
                .to_owned(),
        );
    }
    if uncertainty.degrees_of_freedom == 0.0 {
        return setup(format!(
            "the prediction band requires an estimate of the noise, but the {} residuals are not more than the fitted parameters. \
             Fit fewer parameters, or add measurements",
            uncertainty.residuals.len()
        ));
    }
    Ok(if is_corrected { uncertainty.clone() } else { uncertainty.uncorrected() })
}

impl Calibration {
    /// Predicts the outputs at the parameters of a fit. Their uncertainty follows from the covariance of the
    /// parameters and of measured initial states (delta method; Seber and Wild, Nonlinear Regression, 1989,
    /// section 5.1). The variance of an output y is `J C J'`, with J the derivatives of y with respect to
    /// both.
    ///
    /// The derivatives are differences over one standard error along each principal axis of the
    /// [covariance](Uncertainty::covariance), and along each initial state, from two simulations each. The
    /// variance of a new measurement also includes the noise, according to its
    /// [weight](PredictionBand::noise). Intervals use Student's t with the degrees of freedom of the variance
    /// at each time (Satterthwaite, Biometrics Bulletin 2, 1946). The covariance accounts for autocorrelated
    /// residuals.
    ///
    /// # Errors
    /// Returns an error if the fit has no [uncertainty](Fit::uncertainty), no degrees of freedom, or
    /// parameters that the data do not determine. Also returns an error if the level is not between 0 and 1,
    /// an output is not compared, the times are invalid, or a simulation fails. Returns
    /// [`CalibrationError::Cancelled`] if the context ends the computation.
    pub fn prediction_bands(
        &self,
        fit: &Fit,
        options: &BandOptions,
        context: &RunContext<'_>,
    ) -> Result<Vec<PredictionBand>, CalibrationError> {
        let _held = self.hold();
        self.check_length(&fit.x)?;
        let uncertainty = &usable_uncertainty(fit, options.is_corrected)?;
        check_level(options.level, 1.0)?;
        let layout = self.residual_layout();
        let available: Vec<&str> = layout.outputs.iter().map(|output| output.variable.as_str()).collect();
        let chosen = options.outputs.as_deref();
        if let Some(name) = chosen.unwrap_or_default().iter().find(|name| !available.contains(&name.as_str()))
        {
            let available = available.join(", ");
            return Err(CalibrationError::Setup(format!(
                "output '{name}' not found; available: {available}"
            )));
        }
        self.prepare()?;
        // Short simulations may end before the next check for cancellation.
        if context.is_over() {
            return Err(CalibrationError::Cancelled);
        }
        let of_fit = self.of_fit(fit)?;
        let weighed = of_fit.as_ref().unwrap_or(self).residual_layout();
        let steps = self.principal_steps(fit, uncertainty);
        let errors = AxisErrors::new(&uncertainty.joint, &uncertainty.standard_errors, &steps, options.level);
        let simulated = self.simulated_beside(fit, &steps, options, context)?;
        let by_starts = self.changes_by_starts(fit, &uncertainty.joint, options, context)?;
        let is_chosen = |name: &str| chosen.is_none_or(|chosen| chosen.iter().any(|c| c == name));
        let outputs = layout.outputs.iter().enumerate().filter(|(_, output)| is_chosen(&output.variable));
        let band = |(k, output): (usize, &OutputResiduals)| {
            go_on(context)?;
            let n = self.problem().experiments.len();
            let column = |i: usize| simulated[i * n + output.experiment].columns[output.output].as_slice();
            let (values, times) = (column(0).to_vec(), simulated[output.experiment].time.clone());
            let (variance_of, residual_variance) = uncertainty.joint.outputs[k];
            let mut noise = noise_at(&times, &weighed.outputs[k], residual_variance);
            if output.is_log {
                // A standard deviation of the logarithm is relative.
                noise.iter_mut().zip(&values).for_each(|(noise, value)| *noise *= value.abs());
            }
            let mut band = PredictionBand {
                experiment: self.evaluator().simulations[output.experiment].name.clone(),
                variable: output.variable.clone(),
                unit: None,
                standard_errors: Vec::with_capacity(times.len()),
                lower: values.clone(),
                upper: values.clone(),
                measured_lower: values.clone(),
                measured_upper: values.clone(),
                noise,
                values,
                times,
            };
            let declared = self.fmu().description().variable(&output.variable);
            band.unit = declared.and_then(|variable| variable.unit.clone());
            for row in 0..band.values.len() {
                let along = steps.iter().enumerate().map(|(a, step)| {
                    (column(1 + 2 * a)[row] - column(2 + 2 * a)[row]) / (step.forward + step.backward)
                });
                let starts = uncertainty.joint.starts.iter().zip(&by_starts);
                let by_start =
                    starts.map(|((experiment, _), changes)| match *experiment == output.experiment {
                        true => changes[output.output][row],
                        false => 0.0,
                    });
                let changes = DVector::from_vec(along.chain(by_start).collect());
                let mut variance = errors.variance(&changes);
                band.standard_errors.push(variance.value.sqrt());
                let width = errors.width(&variance)?;
                band.lower[row] -= width;
                band.upper[row] += width;
                let of_noise = band.noise[row] * band.noise[row];
                variance.value += of_noise;
                variance.slopes[variance_of] += of_noise;
                let width = errors.width(&variance)?;
                band.measured_lower[row] -= width;
                band.measured_upper[row] += width;
            }
            Ok(band)
        };
        outputs.map(band).collect()
    }

    /// Returns the derivatives of the outputs of each experiment with respect to its measured initial states.
    fn changes_by_starts(
        &self,
        fit: &Fit,
        joint: &JointErrors,
        options: &BandOptions,
        context: &RunContext<'_>,
    ) -> Result<Vec<Vec<Vec<f64>>>, CalibrationError> {
        let measured_starts = self.measured_starts(&fit.x);
        let n = fit.x.len();
        let of = |(k, (experiment, state)): (usize, &(usize, String))| {
            let is_of_state =
                |start: &&MeasuredStart| (start.experiment, &start.state) == (*experiment, state);
            let Some(start) = measured_starts.iter().find(is_of_state) else {
                return Err(CalibrationError::Setup(format!(
                    "the prediction band requires a measurement of '{state}' at the start of the simulation, which no longer exists"
                )));
            };
            let step = joint.of(n + k).value.sqrt().max(SHORTEST * start.value.abs());
            let step = if step > 0.0 { step } else { SHORTEST };
            let side = |by: f64| -> Result<Trajectory, CalibrationError> {
                let moved = self.with_starts_moved(&[(start, by)])?;
                moved.simulate_experiment(*experiment, &fit.x, options.times.as_deref(), context)
            };
            let (above, below) = (side(step)?, side(-step)?);
            let column = |(a, b): (&Vec<f64>, &Vec<f64>)| {
                a.iter().zip(b).map(|(a, b)| (a - b) / (2.0 * step)).collect()
            };
            Ok(above.columns.iter().zip(&below.columns).map(column).collect())
        };
        joint.starts.iter().enumerate().map(of).collect()
    }

    /// Simulates the experiments at the parameters of a fit and at both ends of each step.
    fn simulated_beside(
        &self,
        fit: &Fit,
        steps: &[Step],
        options: &BandOptions,
        context: &RunContext<'_>,
    ) -> Result<Vec<Trajectory>, CalibrationError> {
        let point = |step: &Step, by: f64| -> Vec<f64> {
            let moved = fit.x.iter().zip(step.direction.iter()).zip(self.parameters());
            let value = |((x, d), p): ((&f64, &f64), &Parameter)| match *d {
                0.0 => *x,
                d => outer(p, inner(p, *x) + by * d).clamp(p.search_lower(), p.search_upper()),
            };
            moved.map(value).collect()
        };
        let mut points = vec![fit.x.clone()];
        for step in steps {
            points.extend([point(step, step.forward), point(step, -step.backward)]);
        }
        let workers = options.workers.unwrap_or_else(base::available_cores);
        let n = self.problem().experiments.len();
        let task = |i: usize, context: &RunContext<'_>| {
            self.simulate_experiment(i % n, &points[i / n], options.times.as_deref(), context)
        };
        let mut found = Vec::with_capacity(points.len() * n);
        for simulated in parallel::map(points.len() * n, workers, context, &task) {
            found.push(simulated.unwrap_or(Err(CalibrationError::Cancelled))?);
        }
        if let Some(i) = (0..found.len()).find(|i| found[*i].time.len() != found[i % n].time.len()) {
            let end = Number(found[i].time.last().copied().unwrap_or(f64::NAN));
            return Err(CalibrationError::Setup(format!(
                "the prediction band cannot be computed: with parameters one standard error away, the model ended the simulation at \
                 t = {end}"
            )));
        }
        Ok(found)
    }

    /// Returns steps of one standard error along the principal axes of the correlation, in the coordinates of
    /// the search. The bounds limit the steps.
    fn principal_steps(&self, fit: &Fit, uncertainty: &Uncertainty) -> Vec<Step> {
        let n = fit.x.len();
        let errors: Vec<f64> = uncertainty.errors_of_search().collect();
        let free: Vec<usize> = (0..n).filter(|&i| errors[i] > 0.0 && errors[i].is_finite()).collect();
        let correlation =
            DMatrix::from_fn(free.len(), free.len(), |a, b| uncertainty.correlation[free[a] * n + free[b]]);
        if free.is_empty() || correlation.iter().any(|c| !c.is_finite()) {
            return Vec::new();
        }
        let axes = SymmetricEigen::new(correlation);
        let largest = axes.eigenvalues.max();
        let step = |k: usize| {
            let (mut direction, mut axis) = (DVector::zeros(n), DVector::zeros(n));
            for (a, &i) in free.iter().enumerate() {
                let (part, root) = (axes.eigenvectors[(a, k)], axes.eigenvalues[k].sqrt());
                (direction[i], axis[i]) = (part * root * errors[i], part / root);
            }
            let (mut part, mut forward, mut backward) = (0.0_f64, f64::INFINITY, f64::INFINITY);
            for (i, p) in self.parameters().iter().enumerate().filter(|(i, _)| direction[*i] != 0.0) {
                let (x, d) = (inner(p, fit.x[i]), direction[i]);
                let (lower, upper) = (inner(p, p.search_lower()), inner(p, p.search_upper()));
                let (up, down) = ((upper - x) / d.abs(), (x - lower) / d.abs());
                (forward, backward) = if d > 0.0 {
                    (forward.min(up), backward.min(down))
                } else {
                    (forward.min(down), backward.min(up))
                };
                let size = match (uncertainty.is_log[i], x.abs()) {
                    (true, _) => 1.0,
                    (false, 0.0) => self.size_of(p, x),
                    (false, size) => size,
                };
                part = part.max(d.abs() / size);
            }
            let length = (SHORTEST / part).max(1.0);
            let (forward, backward) = (forward.min(length), backward.min(length));
            let (forward, backward) = match (forward < TOO_NARROW * length, backward < TOO_NARROW * length) {
                (true, false) => (0.0, backward),
                (false, true) => (forward, 0.0),
                _ => (forward, backward),
            };
            Step { direction, axis, forward, backward }
        };
        let is_real = |k: &usize| axes.eigenvalues[*k] > ROUNDING * largest;
        let steps = (0..free.len()).filter(is_real).map(step);
        steps.filter(|step| step.forward + step.backward > 0.0).collect()
    }
}

/// Returns the standard deviations of the noise of measurements of an output at these times, from the
/// variance of its residuals.
fn noise_at(times: &[f64], output: &OutputResiduals, residual_variance: f64) -> Vec<f64> {
    let deviations: Vec<(f64, f64)> = output
        .times
        .iter()
        .zip(&output.weights)
        .filter(|(_, weight)| **weight != 0.0)
        .map(|(time, weight)| (*time, residual_variance.sqrt() / weight.abs()))
        .collect();
    let at = |time: &f64| {
        let next = deviations.partition_point(|(t, _)| t < time);
        match (next.checked_sub(1).map(|before| deviations[before]), deviations.get(next).copied()) {
            (Some((from, a)), Some((to, b))) => a + (b - a) * (time - from) / (to - from),
            (Some((_, sd)), None) | (None, Some((_, sd))) => sd,
            (None, None) => f64::NAN,
        }
    };
    times.iter().map(at).collect()
}
