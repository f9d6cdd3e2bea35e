//! Prediction bands: how uncertain the parameters of a fit leave what the model predicts.

use crate::cost::parallel;
use crate::error::CalibrationError;
use crate::fit::one_stage::{Fit, FitNoise};
use crate::loaded::calibration::Calibration;
use crate::problem::parameter::{Parameter, inner, outer};
use crate::problem::residual_layout::OutputResiduals;
use crate::uncertainty::result::{Uncertainty, check_level};
use crate::uncertainty::row_blocks::go_on;
use base::{Number, RunContext};
use fmi::Trajectory;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use serde::{Deserialize, Serialize};
use std::thread::available_parallelism;

/// Steps along a principal axis of the covariance are one standard error, but at least this part of a
/// parameter somewhere: below, the noise of the simulations would count.
const SHORTEST: f64 = 1e-4;

/// A side on which the bounds leave less than this part of a step is left out.
const TOO_NARROW: f64 = 0.25;

/// A principal axis with less than this part of the largest variance is rounding.
const ROUNDING: f64 = 1e-12;

/// Options of a prediction band.
#[derive(Debug, Clone, PartialEq)]
pub struct BandOptions {
    /// Times of the predictions in s, ascending; default: those of the measurements.
    pub times: Option<Vec<f64>>,
    /// The probability that an interval shall hold; default 0.95.
    pub level: f64,
    /// True to correct for autocorrelated residuals, as [`Uncertainty::covariance`] does; default: true.
    pub is_corrected: bool,
    /// Only these outputs; default: all that are compared.
    pub outputs: Option<Vec<String>>,
    /// Simulations that run at once; default: all cores. The result does not depend on it.
    pub workers: Option<usize>,
}

impl Default for BandOptions {
    fn default() -> Self {
        Self { times: None, level: 0.95, is_corrected: true, outputs: None, workers: None }
    }
}

/// The prediction of one output of one experiment, with its uncertainty at each time. `Level` is pointwise,
/// not of the whole curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PredictionBand {
    /// The experiment.
    pub experiment: String,
    /// The variable of the model.
    pub variable: String,
    /// Its unit, where the model states it.
    pub unit: Option<String>,
    /// Times, in s.
    #[serde(rename = "time")]
    pub times: Vec<f64>,
    /// The prediction.
    #[serde(rename = "value")]
    pub values: Vec<f64>,
    /// Standard error of the prediction: what the uncertainty of the parameters makes of it.
    #[serde(rename = "standard_error")]
    pub standard_errors: Vec<f64>,
    /// Standard deviation of the noise of a measurement, from the residuals of this output over all
    /// experiments.
    pub noise: f64,
    /// The interval of the model's output: lower end.
    pub lower: Vec<f64>,
    /// Upper end.
    pub upper: Vec<f64>,
    /// The interval of a new measurement, which has noise: lower end.
    pub measured_lower: Vec<f64>,
    /// Upper end.
    pub measured_upper: Vec<f64>,
}

/// A step along a principal axis, forward and backward as parts of one standard error.
struct Step {
    direction: DVector<f64>,
    forward: f64,
    backward: f64,
}

/// Quantiles of Student's t: for the uncertainty of the parameters, and for the noise of a measurement.
struct Quantiles {
    of_parameters: f64,
    of_noise: f64,
}

impl Quantiles {
    /// Half the width of an interval, from the variance that the parameters leave and the noise.
    fn width(&self, variance: f64, noise: f64) -> f64 {
        (self.of_parameters * self.of_parameters * variance + (self.of_noise * noise).powi(2)).sqrt()
    }
}

/// The uncertainty of a fit from which bands can be computed.
fn usable_uncertainty(fit: &Fit, is_corrected: bool) -> Result<Uncertainty, CalibrationError> {
    let setup = |message: String| Err(CalibrationError::Setup(message));
    let Some(uncertainty) = &fit.uncertainty else {
        return setup(
            "a prediction band needs the covariance of the parameters: this fit has none, for it was ended early, made without \
             its uncertainty, or minimised neither a sum of squares nor the likelihood"
                .to_owned(),
        );
    };
    if !uncertainty.undetermined.is_empty() {
        let names: Vec<&str> = uncertainty.undetermined.iter().map(|i| fit.names[*i].as_str()).collect();
        return setup(format!(
            "there is no prediction band: the data do not determine {}; fix it, or give it a prior",
            names.join(", ")
        ));
    }
    if uncertainty.degrees_of_freedom == 0 {
        return setup(format!(
            "there is no prediction band: {} residuals are no more than the parameters that were fitted, and say nothing of the \
             noise; fit fewer parameters, or give more measurements",
            uncertainty.residuals.len()
        ));
    }
    Ok(if is_corrected { uncertainty.clone() } else { uncertainty.uncorrected() })
}

impl Calibration {
    /// Predicts the outputs at the parameters of a fit, with the uncertainty that the covariance of the
    /// parameters leaves (delta method; Seber and Wild, Nonlinear Regression, 1989, section 5.1): the
    /// variance of an output y is `J C J'`, with `J = dy/dx` and C the [covariance](Uncertainty::covariance).
    /// With `C = L L'`, L the principal axes, it is the sum of the squares of the changes of y over one
    /// standard error along each axis, which are taken from two simulations each. A new measurement has the
    /// variance of the residuals of this output on top. Intervals are by Student's t, with the fewest
    /// [degrees of freedom](Uncertainty::effective_degrees_of_freedom) of the parameters; autocorrelated
    /// residuals are in the covariance.
    ///
    /// # Errors
    /// A fit without [uncertainty](Fit::uncertainty), without degrees of freedom, or with parameters that the
    /// data do not determine; a level that does not lie between 0 and 1, an output that is not compared,
    /// times that cannot be used; simulations that fail; [`CalibrationError::Cancelled`].
    pub fn prediction_bands(
        &self,
        fit: &Fit,
        options: &BandOptions,
        context: &RunContext<'_>,
    ) -> Result<Vec<PredictionBand>, CalibrationError> {
        let _held = self.hold();
        self.check_length(&fit.x)?;
        let uncertainty = &usable_uncertainty(fit, options.is_corrected)?;
        let fewest = uncertainty.effective_degrees_of_freedom.iter().copied().fold(f64::INFINITY, f64::min);
        let quantiles = Quantiles {
            of_parameters: check_level(options.level, fewest)?,
            of_noise: check_level(options.level, uncertainty.degrees_of_freedom as f64)?,
        };
        let layout = self.residual_layout();
        let known: Vec<&str> = layout.outputs.iter().map(|output| output.variable.as_str()).collect();
        let chosen = options.outputs.as_deref();
        if let Some(name) = chosen.unwrap_or_default().iter().find(|name| !known.contains(&name.as_str())) {
            let known = known.join(", ");
            return Err(CalibrationError::Setup(format!("there is no output '{name}'; there are: {known}")));
        }
        self.solver(context)?;
        self.prepare()?;
        // Short simulations may end before anybody asks again.
        if context.is_over() {
            return Err(CalibrationError::Cancelled);
        }
        let steps = self.principal_steps(fit, uncertainty);
        let simulated = self.simulated_beside(fit, &steps, options, context)?;
        let is_chosen = |name: &str| chosen.is_none_or(|chosen| chosen.iter().any(|c| c == name));
        let outputs = layout.outputs.iter().filter(|output| is_chosen(&output.variable));
        let band = |output: &OutputResiduals| {
            go_on(context)?;
            let n = self.problem().experiments.len();
            let column = |i: usize| simulated[i * n + output.experiment].columns[output.output].as_slice();
            let values = column(0).to_vec();
            let mut variances = vec![0.0; values.len()];
            for (k, step) in steps.iter().enumerate() {
                let length = step.forward + step.backward;
                let ends = column(1 + 2 * k).iter().zip(column(2 + 2 * k));
                for (variance, (f, b)) in variances.iter_mut().zip(ends) {
                    *variance += ((f - b) / length) * ((f - b) / length);
                }
            }
            let noise = self.noise_of(output, fit, uncertainty);
            let at = |sign: f64, noise: f64| -> Vec<f64> {
                let width = |v: &f64| sign * quantiles.width(*v, noise);
                values.iter().zip(&variances).map(|(y, v)| y + width(v)).collect()
            };
            let declared = self.fmu().description().variable(&output.variable);
            Ok(PredictionBand {
                experiment: self.evaluator().simulations[output.experiment].name.clone(),
                variable: output.variable.clone(),
                unit: declared.and_then(|variable| variable.unit.clone()),
                times: simulated[output.experiment].time.clone(),
                lower: at(-1.0, 0.0),
                upper: at(1.0, 0.0),
                measured_lower: at(-1.0, noise),
                measured_upper: at(1.0, noise),
                standard_errors: variances.iter().map(|v| v.sqrt()).collect(),
                values,
                noise,
            })
        };
        outputs.map(band).collect()
    }

    /// The experiments simulated at the parameters of a fit, and at both ends of each step.
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
                d => outer(p, inner(p, *x) + by * d).clamp(p.lower(), p.upper()),
            };
            moved.map(value).collect()
        };
        let mut points = vec![fit.x.clone()];
        for step in steps {
            points.extend([point(step, step.forward), point(step, -step.backward)]);
        }
        let workers = options.workers.unwrap_or_else(|| available_parallelism().map_or(1, usize::from));
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
                "there is no prediction band: with parameters one standard error away the model ended the simulation at t = {end}"
            )));
        }
        Ok(found)
    }

    /// Standard deviation of the noise of a measurement of an output.
    fn noise_of(&self, output: &OutputResiduals, fit: &Fit, uncertainty: &Uncertainty) -> f64 {
        let estimated = fit.noise.as_ref().and_then(FitNoise::estimated);
        let of_fit = estimated.and_then(|noise| noise.of_measurements(self.problem(), output));
        of_fit.unwrap_or_else(|| {
            let own = || fit.outputs.iter().filter(|own| own.variable == output.variable);
            let squares: f64 = own().map(|output| output.n as f64 * output.rms * output.rms).sum();
            let (n, dof) = (uncertainty.residuals.len() as f64, uncertainty.degrees_of_freedom as f64);
            (squares / own().map(|output| output.n).sum::<usize>() as f64 * n / dof).sqrt()
        })
    }

    /// Steps of one standard error along the principal axes of the correlation, in the coordinates of the
    /// search, as far as the bounds let them go.
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
            let mut direction = DVector::zeros(n);
            for (a, &i) in free.iter().enumerate() {
                direction[i] = axes.eigenvectors[(a, k)] * axes.eigenvalues[k].sqrt() * errors[i];
            }
            let (mut part, mut forward, mut backward) = (0.0_f64, f64::INFINITY, f64::INFINITY);
            for (i, p) in self.parameters().iter().enumerate().filter(|(i, _)| direction[*i] != 0.0) {
                let (x, d) = (inner(p, fit.x[i]), direction[i]);
                let (up, down) = ((inner(p, p.upper()) - x) / d.abs(), (x - inner(p, p.lower())) / d.abs());
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
            Step { direction, forward, backward }
        };
        let is_real = |k: &usize| axes.eigenvalues[*k] > ROUNDING * largest;
        let steps = (0..free.len()).filter(is_real).map(step);
        steps.filter(|step| step.forward + step.backward > 0.0).collect()
    }
}
