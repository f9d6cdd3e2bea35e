//! What a fit is worth: how uncertain its parameters are, which of them the data can tell apart, and what the residuals look like.

mod covariance;
mod differences;
mod residual_check;
mod verdict;

use crate::calibration::Calibration;
use crate::effect::{AT, inner};
use crate::error::CalibrationError;
use crate::parameter::{Parameter, Scale};
use crate::residual::sum_of_squares;
use crate::simulations::{Point, Simulations};
use covariance::{Factors, Noise};
use dfo::{Kind, RobustLoss};
use differences::{Center, Differences};
use nalgebra::DMatrix;
use ode::Number;
pub use residual_check::ResidualCheck;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::fmt;
use std::thread::available_parallelism;

/// How the covariance of the parameters is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// `(J'J)^-1 J'SJ (J'J)^-1` with one residual variance per output of the model, over all of its recordings:
    /// `r'r / N_o N / (N - p)`.
    #[default]
    Sandwich,
    /// `s^2 (J'J)^-1` with one variance for all residuals: `r'r / (N - p)`.
    Pooled,
}

impl Estimator {
    /// "sandwich" or "pooled".
    pub fn name(self) -> &'static str {
        match self {
            Self::Sandwich => "sandwich",
            Self::Pooled => "pooled",
        }
    }
}

impl fmt::Display for Estimator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Sandwich => "sandwich (one residual variance per output)",
            Self::Pooled => "pooled (one variance for all residuals)",
        })
    }
}

/// How [`Calibration::worth`] is found out.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct WorthOptions {
    /// How the covariance is estimated.
    pub estimator: Estimator,
    /// Simulations that run at once; default: all cores, in a fit: as many as its evaluations. The result does not depend on it.
    pub workers: Option<usize>,
    /// Parameters that are taken as known, by number, besides those that are fixed or lie at a bound: the standard errors of the others
    /// are conditional then. In a fit: those that it [holds](crate::FitOptions::held), too.
    pub held: Vec<usize>,
    /// What a residual counts; in a fit: as there. With a robust loss residuals and Jacobian are those of the residuals as they
    /// count.
    pub loss: RobustLoss,
}

/// What a fit is worth.
///
/// From central differences over steps of about one standard error (see the source of `differences`); never from second
/// derivatives. Residuals of priors count, with the variance 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Worth {
    /// How the covariance was estimated.
    pub estimator: Estimator,
    /// Names of the parameters.
    pub names: Vec<String>,
    /// The point, in the user's units.
    pub x: Vec<f64>,
    /// Whether a parameter is searched by its logarithm: its [confidence interval](Self::confidence_intervals) is symmetric there.
    pub is_log: Vec<bool>,
    /// Covariance of the parameters, n x n, row by row, in the user's units. Zero for parameters that are [held](Self::held); infinite on
    /// the diagonal, NaN beside it, for those that the data do not [determine](Self::undetermined).
    pub covariance: Vec<f64>,
    /// Standard errors: the roots of its diagonal.
    pub standard_errors: Vec<f64>,
    /// Correlation of the parameters, n x n, row by row; NaN where a standard error is zero or infinite.
    pub correlation: Vec<f64>,
    /// Standard errors with the residuals of each output taken for a first-order autoregression (covariance `s^2 rho^|i - j|`); `None`
    /// where no output has autocorrelated residuals.
    pub corrected_errors: Option<Vec<f64>>,
    /// The residuals of each output of each experiment, in the order of the residual vector.
    pub residual_checks: Vec<ResidualCheck>,
    /// Number of residuals less that of the parameters that are not held.
    pub degrees_of_freedom: usize,
    /// Parameters that are fixed, held, lie at a bound, or are no continuous numbers, by number: taken as known.
    pub held: Vec<usize>,
    /// Parameters that the data do not determine, by number.
    pub undetermined: Vec<usize>,
    /// Those of them that change no residual by more than the noise of the simulations.
    pub without_effect: Vec<usize>,
    /// Pairs of parameters that move the outputs the same way, with their correlation: 0.9 or more.
    pub confounded: Vec<(usize, usize, f64)>,
    /// The parameters of the combination that the data determine worst, where there are three or more in it.
    pub weakest: Vec<usize>,
    /// Parameters that this data can tell, by number: the longest beginning of the order in which the columns of the scaled Jacobian are
    /// most independent (QR with column pivoting; Burth, Verghese and Velez-Reyes, IEEE Trans. Power Systems 14, 1999) that has relative
    /// standard errors below 50 % and no correlation of 0.9 or more, the others held.
    pub identifiable: Vec<usize>,
    /// What is to be said of all this, in sentences; empty if nothing is.
    pub verdict: Vec<String>,
    /// The cost, as the fit has it.
    pub cost: f64,
    /// The cost with simulations a hundred times more accurate; `None` where they failed.
    pub accurate_cost: Option<f64>,
    /// Derivatives of the residuals by the parameters, m x n, row by row, in the user's units; zero for those that are held.
    pub jacobian: Vec<f64>,
    /// The residuals, m.
    pub residuals: Vec<f64>,
    /// Points that were simulated to find out.
    pub n_simulations: usize,
}

/// What is known before it is asked what a point is worth.
#[derive(Default)]
pub(crate) struct KnownPoint<'a> {
    /// Plain residuals.
    pub(crate) residuals: Option<&'a [f64]>,
    /// Their derivatives in the user's units, m x n: where the differences begin. The derivatives of a search come from points as it
    /// happened to try them, so they never replace differences.
    pub(crate) jacobian: Option<&'a [f64]>,
    /// Parameters that lie at a bound, or are held.
    pub(crate) held: Vec<usize>,
    /// Parameters that were seen to have no effect: not held, even at a bound, where they say nothing.
    pub(crate) inert: &'a [usize],
    /// What differences of the cost count as none, relative to it.
    pub(crate) f_tol: f64,
}

/// A number with four digits.
pub(crate) fn digits(value: f64) -> Number {
    Number(format!("{value:.3e}").parse().unwrap_or(value))
}

impl Worth {
    /// Confidence intervals of the parameters, lower and upper end, by Student's t with the [degrees of
    /// freedom](Self::degrees_of_freedom): `x -+ t s`, of a parameter that is searched by its logarithm `x exp(-+ t s / x)`. Those of
    /// held parameters are points, those of undetermined ones have no ends. `level`: 0.95, for example.
    ///
    /// # Errors
    /// A level that does not lie between 0 and 1.
    pub fn confidence_intervals(&self, level: f64) -> Result<Vec<(f64, f64)>, CalibrationError> {
        self.intervals(level, &self.standard_errors)
    }

    /// The same with other standard errors: [`corrected_errors`](Self::corrected_errors), for example.
    ///
    /// # Errors
    /// As [`confidence_intervals`](Self::confidence_intervals).
    pub fn intervals(&self, level: f64, errors: &[f64]) -> Result<Vec<(f64, f64)>, CalibrationError> {
        let quantile = check_level(level, self.degrees_of_freedom)?;
        let interval = |((x, error), is_log): ((&f64, &f64), &bool)| match (*error, is_log) {
            (0.0, _) => (*x, *x),
            (error, true) if error.is_infinite() => (0.0, f64::INFINITY),
            (error, true) => (x * (-quantile * error / x).exp(), x * (quantile * error / x).exp()),
            (error, false) => (x - quantile * error, x + quantile * error),
        };
        Ok(self.x.iter().zip(errors).zip(&self.is_log).map(interval).collect())
    }

    /// What is to be said of the covariance: who is not determined, who is taken as known; empty if nothing is.
    pub fn message(&self) -> String {
        let mut said = self.undetermined_sentences();
        if !self.held.is_empty() {
            let names: Vec<&str> = self.held.iter().map(|i| self.names[*i].as_str()).collect();
            said.push(format!("at a bound or fixed, taken as known: {}", names.join(", ")));
        }
        said.join("; ")
    }

    /// What the message of a fit must not leave out: parameters that the data do not determine or cannot tell apart, a cost that
    /// depends on the accuracy of the simulations.
    pub(crate) fn remarks(&self, f_tol: f64) -> String {
        let pairs = self.confounded_sentences().into_iter();
        let said =
            self.undetermined_sentences().into_iter().chain(pairs).chain(self.accuracy_sentence(f_tol));
        said.map(|sentence| format!("; {sentence}")).collect()
    }
}

/// A line per parameter with its standard error, then the verdict.
impl fmt::Display for Worth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "standard errors: {}, {} degrees of freedom", self.estimator, self.degrees_of_freedom)?;
        let width = self.names.iter().map(String::len).max().unwrap_or(0);
        for (i, name) in self.names.iter().enumerate() {
            let (x, error) = (self.x[i], self.standard_errors[i]);
            write!(f, "{name:>width$}: {}", Number(x))?;
            if self.held.contains(&i) {
                f.write_str(", taken as known (fixed, held or at a bound)")?;
            } else if error.is_infinite() {
                f.write_str(", not determined")?;
            } else {
                write!(f, " +- {}", digits(error))?;
                if x != 0.0 {
                    write!(f, " ({} %)", digits(100.0 * error / x.abs()))?;
                }
                if let Some(corrected) = &self.corrected_errors {
                    write!(f, ", +- {} with autocorrelated residuals", digits(corrected[i]))?;
                }
            }
            f.write_str("\n")?;
        }
        self.verdict.iter().try_for_each(|said| writeln!(f, "- {said}"))
    }
}

/// The quantile of Student's t for a two-sided interval.
///
/// # Errors
/// A level that does not lie between 0 and 1.
pub(crate) fn check_level(level: f64, degrees_of_freedom: usize) -> Result<f64, CalibrationError> {
    if !(level > 0.0 && level < 1.0) {
        let level = Number(level);
        return Err(CalibrationError::Setup(format!(
            "the level of a confidence interval lies between 0 and 1, for example 0.95, not {level}"
        )));
    }
    let t = StudentsT::new(0.0, 1.0, degrees_of_freedom as f64);
    Ok(t.map_or(f64::INFINITY, |t| t.inverse_cdf(0.5 + 0.5 * level)))
}

impl Calibration {
    /// How much a point is worth as the result of a fit: covariance and correlation of the parameters, what the data cannot tell, what
    /// the residuals look like, and the cost with a hundredth of the relative tolerance. Takes one simulation for that, and two for
    /// each parameter that is not held, at least twice (steps of about one standard error are found by a first round). Simulations run
    /// in parallel. `cancelled` is asked on the calling thread.
    ///
    /// # Errors
    /// The wrong number of values; the simulation fails there, or on all sides around it; [`CalibrationError::Cancelled`].
    pub fn worth(
        &self,
        x: &[f64],
        options: &WorthOptions,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Worth, CalibrationError> {
        self.check_length(x)?;
        let workers = options.workers.unwrap_or_else(|| available_parallelism().map_or(1, usize::from));
        let mut simulations = Simulations::new(self, (options.loss, workers), cancelled)?;
        if let Some(index) = options.held.iter().find(|i| **i >= x.len()) {
            let n = x.len();
            return Err(CalibrationError::Setup(format!(
                "parameter {index} is held, but there are only {n}"
            )));
        }
        let known = KnownPoint { f_tol: 1e-4, held: options.held.clone(), ..KnownPoint::default() };
        self.worth_of(x, options.estimator, &known, &mut simulations)
    }

    pub(crate) fn worth_of(
        &self,
        x: &[f64],
        estimator: Estimator,
        known: &KnownPoint<'_>,
        simulations: &mut Simulations<'_>,
    ) -> Result<Worth, CalibrationError> {
        let parameters = self.parameters();
        let (n, before) = (x.len(), simulations.n);
        let is_held = |i: usize| {
            let p = &parameters[i];
            let is_at_bound = self.is_at_bound(p, x[i]) && !known.inert.contains(&i);
            let is_fixed = p.is_fixed() || p.lower() == p.upper() || p.value_kind() != Kind::Continuous;
            known.held.contains(&i) || is_fixed || is_at_bound
        };
        let (held, free): (Vec<usize>, Vec<usize>) = (0..n).partition(|i| is_held(*i));
        let loss = simulations.loss;
        let mut points = vec![Point { x: x.to_vec(), is_accurate: true }];
        if known.residuals.is_none() {
            points.push(Point::new(x.to_vec()));
        }
        let mut found = simulations.residuals(&points)?;
        let residuals: Vec<f64> = match (known.residuals, found.len()) {
            (Some(plain), _) => plain.iter().map(|r| loss.transform(*r)).collect(),
            (None, _) => found.swap_remove(1).map_err(|message| self.failed_at(x, message, None))?,
        };
        let accurate = found.swap_remove(0).ok();
        let simulation_error = accurate.as_ref().map_or(0.0, |accurate| {
            accurate.iter().zip(&residuals).map(|(a, r)| (a - r) * (a - r)).sum::<f64>().sqrt()
        });
        let layout = self.residual_layout();
        let measured = layout.outputs.iter().flat_map(|o| o.measured.iter().zip(&o.weights));
        let sizes: Vec<f64> = free.iter().map(|&i| self.size_of(&parameters[i], x[i])).collect();
        let center = Center {
            parameters,
            x,
            free: &free,
            sizes: &sizes,
            residuals: &residuals,
            measured: measured.map(|(y, w)| (y * w) * (y * w)).sum::<f64>().sqrt(),
            simulation_error,
        };
        // By the coordinates of the search.
        let per_unit: Vec<f64> = free.iter().map(|&i| slope(&parameters[i], x[i])).collect();
        let guess = match (known.jacobian, known.residuals) {
            (Some(jacobian), Some(plain)) => Some(DMatrix::from_fn(residuals.len(), free.len(), |r, k| {
                jacobian[r * n + free[k]] * loss.slope(plain[r]) * per_unit[k]
            })),
            _ => None,
        };
        let differences = Differences::around(&center, guess, simulations)?
            .map_err(|message| self.failed_at(x, format!("around this point: {message}"), None))?;
        let noise = Noise::estimate(layout, &residuals, free.len(), estimator == Estimator::Sandwich);
        let factors = Factors::new(&differences);
        let spread = |of_free: DMatrix<f64>| {
            let mut matrix = vec![0.0; n * n];
            for (a, &i) in free.iter().enumerate() {
                for (b, &j) in free.iter().enumerate() {
                    let is_open = |k: usize| factors.is_undetermined[k] || noise.degrees_of_freedom == 0;
                    matrix[i * n + j] = match (is_open(a) || is_open(b), a == b) {
                        (false, _) => of_free[(a, b)] * per_unit[a] * per_unit[b],
                        (true, true) => f64::INFINITY,
                        (true, false) => f64::NAN,
                    };
                }
            }
            matrix
        };
        let covariance = spread(factors.covariance(&noise));
        let standard_errors = roots(&covariance, n);
        let correlation = (0..n * n).map(|k| {
            let scale = standard_errors[k / n] * standard_errors[k % n];
            match scale > 0.0 && scale.is_finite() {
                true if k / n == k % n => 1.0,
                true => (covariance[k] / scale).clamp(-1.0, 1.0),
                false => f64::NAN,
            }
        });
        let residual_checks = ResidualCheck::all(layout, &self.problem().experiment_names(), &residuals);
        let corrected = residual_checks.iter().any(ResidualCheck::is_autocorrelated);
        let jacobian = differences.jacobian();
        let mut by_parameters = vec![0.0; residuals.len() * n];
        for (k, &i) in free.iter().enumerate() {
            (0..residuals.len()).for_each(|r| by_parameters[r * n + i] = jacobian[(r, k)] / per_unit[k]);
        }
        let select = |flags: &dyn Fn(usize) -> bool| {
            (0..free.len()).filter(|k| flags(*k)).map(|k| free[k]).collect::<Vec<usize>>()
        };
        let longest: Vec<f64> = differences.steps.row_iter().map(|row| row.amax()).collect();
        let is_inert = |k: usize| {
            factors.is_undetermined[k] && jacobian.column(k).norm() * longest[k] <= differences.noise
        };
        let mut worth = Worth {
            estimator,
            names: parameters.iter().map(|p| p.name().to_owned()).collect(),
            x: x.to_vec(),
            is_log: parameters.iter().map(|p| p.scale_kind() == Scale::Log).collect(),
            correlation: correlation.collect(),
            corrected_errors: corrected.then(|| roots(&spread(factors.corrected(&noise)), n)),
            covariance,
            standard_errors,
            degrees_of_freedom: noise.degrees_of_freedom,
            held,
            undetermined: select(&|k| factors.is_undetermined[k]),
            without_effect: select(&is_inert),
            confounded: Vec::new(),
            weakest: Vec::new(),
            identifiable: Vec::new(),
            verdict: Vec::new(),
            cost: sum_of_squares(&residuals),
            // Without differences among accurate simulations nothing is known of a cost that is all error of the simulations.
            accurate_cost: accurate.as_deref().map(sum_of_squares),
            jacobian: by_parameters,
            residuals,
            n_simulations: simulations.n - before,
            residual_checks,
        };
        worth.find_confounded();
        worth.find_weakest(&jacobian, &free);
        worth.find_identifiable((&differences, &noise), &free, &sizes);
        worth.verdict = worth.sentences(self.problem().experiments.len() > 1, known.f_tol);
        Ok(worth)
    }

    /// Whether a parameter lies at one of its bounds.
    fn is_at_bound(&self, p: &Parameter, x: f64) -> bool {
        let (lower, upper, at) = (inner(p, p.lower()), inner(p, p.upper()), inner(p, x));
        (at - lower).min(upper - at) <= AT * self.size_of(p, x)
    }
}

/// Derivative of a parameter by its coordinate in the search.
fn slope(p: &Parameter, x: f64) -> f64 {
    match p.scale_kind() {
        Scale::Linear => 1.0,
        Scale::Log => x,
    }
}

fn roots(matrix: &[f64], n: usize) -> Vec<f64> {
    (0..n).map(|i| matrix[i * n + i].max(0.0).sqrt()).collect()
}
