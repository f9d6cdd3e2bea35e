//! Profile likelihood: rise of the cost when one parameter is fixed away from its best value and the others
//! are fitted again.

mod refit;
mod result;
mod saved;
mod walk;

use crate::cost::parallel;
use crate::error::CalibrationError;
use crate::fit::one_stage::{Fit, FitNoise};
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::Simulations;
use crate::problem::fingerprint::hash_of_bytes;
use crate::problem::objective::{CostKind, NamedCost};
use crate::problem::parameter::{Parameter, inner};
use crate::uncertainty::estimate::EvaluatedPoint;
use crate::uncertainty::inactive_parameters::{AT, BoundSide};
use crate::uncertainty::result::{Uncertainty, check_level};
use crate::uncertainty::scores::Criterion;
use base::RunContext;
use dfo::{ParameterKind, RobustLoss};
use refit::Refits;
pub use result::{ParameterProfile, Profile, ProfileEnd, ProfilePoint};
use saved::{SavedSides, Side};
use std::path::PathBuf;
use std::sync::Mutex;
use walk::{Origin, walk};

/// Options of [`Calibration::profile`].
#[derive(Debug, Clone, PartialEq)]
pub struct ProfileOptions {
    /// Indices of the parameters; default: all fitted parameters.
    pub parameters: Option<Vec<usize>>,
    /// Confidence level of the intervals; default 0.95.
    pub level: f64,
    /// True to correct for autocorrelated residuals, as [`Uncertainty::covariance`] does; default: true.
    pub is_corrected: bool,
    /// Maximum number of points on each side of the optimum; default 20. A side that has not crossed the
    /// threshold by then is open. Refits that locate the crossing are not counted.
    pub max_points: usize,
    /// Number of sides that run in parallel; default: all cores. The result does not depend on it.
    pub workers: Option<usize>,
    /// File that stores the completed sides and allows a profile to resume.
    pub checkpoint: Option<PathBuf>,
}

impl Default for ProfileOptions {
    fn default() -> Self {
        Self {
            parameters: None,
            level: 0.95,
            is_corrected: true,
            max_points: 20,
            workers: None,
            checkpoint: None,
        }
    }
}

impl Calibration {
    /// Computes profile likelihoods of the parameters of a fit and their confidence intervals. The intervals
    /// of [`Uncertainty::confidence_intervals`](crate::Uncertainty::confidence_intervals) are symmetric, but
    /// these intervals need not be. They are open if the data do not bound a parameter.
    ///
    /// Each parameter is fixed at values farther and farther from the optimum, and the others are fitted
    /// again by least squares. The statistic is the rise of the cost that the fit minimised, with its weights
    /// and loss. It is scaled so that, for a quadratic cost, it is the square of the distance in standard
    /// errors:
    ///
    /// - With one variance `s^2` for all residuals, it is the rise divided by `s^2`.
    /// - With separate variances of the outputs, a robust loss, or autocorrelated residuals, it is the rise
    ///   times a factor. The numerator is the parameter's entry of the inverse of half the second
    ///   derivatives. The denominator is its variance in [`Uncertainty::covariance`] (Rotnitzky and Jewell,
    ///   Biometrika 77, 1990; Pace, Salvan and Sartori, Statistica Sinica 21, 2011).
    /// - With the [likelihood](crate::NamedCost::Likelihood) L of N residuals, the cost is the sum of squares
    ///   `N exp(2 L / N)` that the fit minimises, so the statistic is `(N - p) (exp(2 (L - L_min) / N) - 1)`,
    ///   with the same factor. Its limit for many measurements is `2 (L - L_min)`. For one output, it is the
    ///   statistic of the sum of squares.
    ///
    /// An interval ends where the statistic reaches the quantile of F with 1 and N - p degrees of freedom,
    /// the square of the quantile of Student's t. The degrees of freedom are those of the [variance of each
    /// parameter](Uncertainty::effective_degrees_of_freedom) (Bates and Watts, Nonlinear Regression Analysis
    /// and Its Applications, 1988, section 6.1). Raue et al. (Bioinformatics 25, 2009) use the quantile of
    /// chi-square, its limit for many measurements.
    ///
    /// The intervals refer to the optimum of the cost, which is located more accurately first. For a linear
    /// model, the interval equals the interval from the covariance.
    ///
    /// The sides of the parameters run in parallel. The context is checked on the calling thread. After the
    /// optimum is found, an interrupt returns the points computed so far ([`Profile::is_interrupted`]).
    ///
    /// # Errors
    /// Returns an error in these cases:
    ///
    /// - A parameter does not exist or was not fitted.
    /// - The level is not between 0 and 1.
    /// - The fit minimised neither a sum of squares nor the likelihood.
    /// - All residuals are zero, or the number of residuals does not exceed the number of parameters.
    /// - No optimum is found.
    /// - The file belongs to another problem, or cannot be read or written.
    /// - The run is cancelled before the optimum is found ([`CalibrationError::Cancelled`]).
    pub fn profile(
        &self,
        fit: &Fit,
        options: &ProfileOptions,
        context: &RunContext<'_>,
    ) -> Result<Profile, CalibrationError> {
        self.as_fitted(fit, |fitted| fitted.profile_fitted(fit, options, context))
    }

    /// Computes the profile with the weights and the tolerance of the fit.
    fn profile_fitted(
        &self,
        fit: &Fit,
        options: &ProfileOptions,
        context: &RunContext<'_>,
    ) -> Result<Profile, CalibrationError> {
        let held = self.held_in(fit);
        let n = fit.x.len();
        let requested = profiled(fit, &held, options)?;
        let n_free = n - held.len();
        let n_residuals = self.n_residuals();
        let without_noise = || {
            CalibrationError::Setup(format!(
                "a profile requires more residuals ({n_residuals}) than fitted parameters ({n_free}). Fit fewer parameters, or add \
                 measurements"
            ))
        };
        if n_residuals <= n_free {
            return Err(without_noise());
        }
        let normal = check_level(options.level, f64::INFINITY)?.powi(2);
        let estimator = fit.uncertainty.as_ref().map(|uncertainty| uncertainty.estimator).unwrap_or_default();
        let workers = options.workers.unwrap_or_else(base::available_cores);
        let size = |i: usize| self.size_of(&self.parameters()[i], fit.x[i]);
        let step = |i: usize| step_of(fit.uncertainty.as_ref(), i).unwrap_or_else(|| 0.01 * size(i));
        let is_likelihood = fit.objective == CostKind::Named(NamedCost::Likelihood).name();
        let loss = fit.report.loss.sparing(self.residual_layout().priors.len());
        let criterion = if is_likelihood { Criterion::Likelihood } else { Criterion::Loss(loss) };
        let mut refits = Refits {
            calibration: self,
            criterion,
            held: &held,
            sizes: (0..n).map(step).collect(),
            f_tol: refit::F_TOL * normal / (n_residuals as f64).max(normal),
            stats: Mutex::default(),
        };
        let noise = if fit.noise.as_ref().is_some_and(FitNoise::is_known) { " known noise" } else { "" };
        let objective = if is_likelihood { " likelihood" } else { "" };
        let statistic =
            format!("{held:?} {estimator:?} {} {}{noise}{objective}", fit.report.loss, options.is_corrected);
        let saved =
            SavedSides::open(options.checkpoint.as_deref(), self.profile_hash(fit, &statistic, options), n)?;
        let mut n_simulations = 0;
        let optimum = refits.optimum(&fit.x, &mut n_simulations, context)?;
        let mut simulations = Simulations::new(self, RobustLoss::default(), workers, context)?;
        let evaluated_point = EvaluatedPoint {
            held: held.clone(),
            f_tol: 1e-4,
            criterion,
            is_noise_known: fit.noise.as_ref().is_some_and(FitNoise::is_known),
            ..EvaluatedPoint::default()
        };
        let (uncertainty, curvature) =
            self.uncertainty_and_curvature(&optimum.x, estimator, &evaluated_point, &mut simulations)?;
        let uncertainty = if options.is_corrected { uncertainty } else { uncertainty.uncorrected() };
        n_simulations += simulations.n;
        let degrees_of_freedom = uncertainty.degrees_of_freedom;
        if degrees_of_freedom == 0.0 {
            return Err(without_noise());
        }
        let threshold = check_level(options.level, degrees_of_freedom)?.powi(2);
        refits.sizes = (0..n).map(|i| step_of(Some(&uncertainty), i).unwrap_or(refits.sizes[i])).collect();
        // The curvature of a likelihood is that of a sum of squares with variances of 1.
        let unit = if is_likelihood { self.n_weighted() as f64 / optimum.cost } else { 1.0 };
        let of_one_variance =
            if uncertainty.is_noise_known() { 1.0 } else { degrees_of_freedom / optimum.cost };
        let per_rise = |i: usize| -> Result<f64, CalibrationError> {
            let quantile = check_level(options.level, uncertainty.effective_degrees_of_freedom[i])?;
            let found =
                unit * curvature[i] / uncertainty.covariance[i * n + i] * threshold / (quantile * quantile);
            // For an undetermined parameter, or one at its bound, no other scale is available.
            let is_positive = found > 0.0 && found.is_finite();
            Ok(if is_positive { found } else { of_one_variance })
        };
        let origins = (requested.iter())
            .map(|&i| {
                Ok(Origin {
                    index: i,
                    x: &optimum.x,
                    cost: optimum.cost,
                    threshold,
                    per_rise: per_rise(i)?,
                    max_points: options.max_points,
                    standard_error: refits.sizes[i],
                    direction: direction(&uncertainty, i),
                })
            })
            .collect::<Result<Vec<Origin<'_>>, CalibrationError>>()?;
        let factors: Vec<f64> = origins.iter().map(|origin| origin.per_rise / of_one_variance).collect();
        let mut factors = factors.into_iter();
        let sides = sides_of(&refits, &origins, saved, workers, context);
        n_simulations += sides.iter().map(|side| side.n_simulations).sum::<usize>();
        let is_interrupted = sides.iter().any(|side| side.end == ProfileEnd::Interrupted);
        let mut sides = sides.into_iter();
        let mut parameters = Vec::with_capacity(requested.len());
        while let (Some(lower), Some(upper)) = (sides.next(), sides.next()) {
            let i = lower.parameter;
            let mut points: Vec<ProfilePoint> = lower.points.into_iter().rev().collect();
            points.push(ProfilePoint { value: optimum.x[i], statistic: 0.0, x: optimum.x.clone() });
            points.extend(upper.points);
            parameters.push(ParameterProfile {
                parameter: i,
                name: fit.names[i].clone(),
                optimum: optimum.x[i],
                factor: factors.next().unwrap_or(1.0),
                points,
                lower: lower.end,
                upper: upper.end,
            });
        }
        let mut stats = simulations.stats;
        drop(origins);
        stats += refits.stats.into_inner().unwrap_or_else(|e| e.into_inner());
        Ok(Profile {
            level: options.level,
            threshold,
            degrees_of_freedom,
            is_interrupted,
            is_autocorrelated: uncertainty.uncorrected_covariance.is_some(),
            parameters,
            n_simulations,
            stats,
            cost: if is_likelihood { uncertainty.cost } else { optimum.cost },
            x: optimum.x,
        })
    }

    /// Returns the indices of the fixed parameters of the fit, without the parameters that the fit found at a
    /// bound.
    fn held_in(&self, fit: &Fit) -> Vec<usize> {
        let is_at_bound = |i: usize, p: &Parameter| {
            let at = inner(p, fit.x[i]);
            let distance = (at - inner(p, p.lower())).min(inner(p, p.upper()) - at);
            !p.is_periodic() && distance <= AT * self.size_of(p, fit.x[i])
        };
        let was_held =
            |i: usize| fit.uncertainty.as_ref().is_some_and(|uncertainty| uncertainty.held.contains(&i));
        let is_held = |(i, p): &(usize, &Parameter)| {
            let is_found = fit.at_bound.iter().any(|(index, _)| index == i) || is_at_bound(*i, p);
            let is_fixed =
                p.is_fixed() || p.lower() == p.upper() || p.value_kind() != ParameterKind::Continuous;
            is_fixed || (was_held(*i) && !is_found)
        };
        self.parameters().iter().enumerate().filter(is_held).map(|(i, _)| i).collect()
    }

    /// Returns the number of measurements whose weight is not zero.
    fn n_weighted(&self) -> usize {
        let outputs = &self.residual_layout().outputs;
        outputs.iter().flat_map(|output| &output.weights).filter(|weight| **weight != 0.0).count()
    }

    /// Returns a hash of everything that the sides of profiles depend on, except their parameter.
    fn profile_hash(&self, fit: &Fit, statistic: &str, options: &ProfileOptions) -> String {
        let bounds: Vec<_> =
            self.parameters().iter().map(|p| (p.lower(), p.upper(), p.scale_kind())).collect();
        let costs = self.problem_hash();
        let (level, points) = (options.level, options.max_points);
        let words = format!("{costs} {:?} {bounds:?} {statistic} {level:?} {points}", fit.x);
        hash_of_bytes(words.as_bytes())
    }
}

/// Returns the indices of the parameters whose profiles are requested.
fn profiled(fit: &Fit, held: &[usize], options: &ProfileOptions) -> Result<Vec<usize>, CalibrationError> {
    let setup = |message: String| Err(CalibrationError::Setup(message));
    if !CostKind::of_name(&fit.objective).is_some_and(|objective| objective.has_uncertainty()) {
        let what = &fit.objective;
        return setup(format!(
            "a profile likelihood requires a sum of squares or the likelihood, but the fit minimised another cost ({what})"
        ));
    }
    let (n, is_free) = (fit.x.len(), |i: &usize| !held.contains(i));
    let requested = match &options.parameters {
        None => (0..n).filter(is_free).collect(),
        Some(requested) => requested.clone(),
    };
    if let Some(index) = requested.iter().find(|i| **i >= n) {
        return setup(format!("parameter index {index} is not below the number of parameters, {n}"));
    }
    if let Some(index) = requested.iter().find(|i| !is_free(i)) {
        return setup(format!(
            "parameter '{}' has no profile because it was not fitted (fixed or not continuous)",
            fit.names[*index]
        ));
    }
    if let Some(k) = (1..requested.len()).find(|k| requested[..*k].contains(&requested[*k])) {
        return setup(format!("parameter '{}' is listed twice", fit.names[requested[k]]));
    }
    if requested.is_empty() {
        return setup("a profile requires a free parameter, but none is free".to_owned());
    }
    if options.max_points == 0 {
        return setup("a profile requires at least one point on each side of the optimum, not 0".to_owned());
    }
    Ok(requested)
}

/// Returns the sides of all parameters, alternating lower and upper. Reads the saved sides and computes the
/// others in parallel.
fn sides_of(
    refits: &Refits<'_>,
    origins: &[Origin<'_>],
    saved: SavedSides,
    workers: usize,
    context: &RunContext<'_>,
) -> Vec<Side> {
    let saved = Mutex::new(saved);
    let side_of = |s: usize| if s.is_multiple_of(2) { BoundSide::Lower } else { BoundSide::Upper };
    let task = |s: usize, context: &RunContext<'_>| {
        let (origin, side) = (&origins[s / 2], side_of(s));
        // Ignore a poisoned lock, because the list is consistent at all times.
        let lock = || saved.lock().unwrap_or_else(|e| e.into_inner());
        if let Some(side) = lock().of(origin.index, side) {
            return side.clone();
        }
        let walked = walk(refits, side, origin, context);
        if walked.end != ProfileEnd::Interrupted {
            lock().add(walked.clone());
        }
        walked
    };
    let walked = parallel::map(2 * origins.len(), workers, context, &task).into_iter().enumerate();
    let not_begun = |s: usize| Side::new(origins[s / 2].index, side_of(s));
    walked.map(|(s, side)| side.unwrap_or_else(|| not_begun(s))).collect()
}

/// Returns the standard error of a parameter in the coordinates of the search, if it is known.
fn step_of(uncertainty: Option<&Uncertainty>, i: usize) -> Option<f64> {
    let uncertainty = uncertainty?;
    let error = uncertainty.standard_errors[i] / if uncertainty.is_log[i] { uncertainty.x[i] } else { 1.0 };
    (error > 0.0 && error.is_finite()).then_some(error)
}

/// Returns the direction in which the best values of all parameters change with one of them, in the
/// coordinates of the search. It is the covariances divided by the variance of that parameter.
fn direction(uncertainty: &Uncertainty, i: usize) -> Vec<f64> {
    let n = uncertainty.x.len();
    let scale = |k: usize| if uncertainty.is_log[k] { uncertainty.x[k] } else { 1.0 };
    let of = |k: usize| {
        uncertainty.covariance[i * n + k] / uncertainty.covariance[i * n + i] * scale(i) / scale(k)
    };
    (0..n).map(|k| if of(k).is_finite() { of(k) } else { 0.0 }).collect()
}
