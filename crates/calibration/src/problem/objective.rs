//! Cost that a fit minimises: the sum of squared residuals, or another function of the residuals.

use crate::error::CalibrationError;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use dfo::Outcome;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

/// Cost that a fit minimises. Residuals are weight times (simulated minus measured). With weights of 1/sigma,
/// the inverse standard deviation of the noise, the sum of squares is twice the negative log-likelihood, up
/// to a constant.
///
/// Sums of squares, including [custom](Self::Custom) ones, and the likelihood provide residuals for least
/// squares. Early stopping of a simulation and robust losses require the sum of squares of the residuals
/// themselves. All other costs require methods that use only the cost.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub enum CostKind {
    /// `sum r^2`: no 1/N, no 1/2.
    #[default]
    SumOfSquares,
    /// One of the named costs.
    Named(NamedCost),
    /// A user-defined function.
    Custom(CustomCost),
    /// The goals of a design. A method that minimises several goals receives them as residuals; others
    /// minimise the first one.
    Goals,
}

/// Costs that are not sums of squares. N is the number of residuals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum NamedCost {
    /// Mean absolute error, `sum |r| / N`.
    Mae,
    /// Root of the mean squared error, `sqrt(sum r^2 / N)`.
    Rmse,
    /// Mean of the normalised root mean squared errors of all outputs of all experiments. The error of an
    /// output is `sqrt(sum r^2 / N)` divided by the range of its measurements.
    Nrmse,
    /// Negative log-likelihood, up to a constant, with an unknown standard deviation of the noise for each
    /// output over its recordings: `sum_o N_o / 2 ln(r_o' r_o / N_o)`. It is the likelihood at the best
    /// standard deviations (Bard, Nonlinear Parameter Estimation, 1974, chapter IV: unknown diagonal
    /// covariance). N_o excludes residuals without noise: residuals of weight zero, and the residual of the
    /// measurement that a simulation starts from. Priors add half of their squares.
    ///
    /// The standard deviation of an output is at least the error of its simulation, `10 T |y|` for the
    /// relative tolerance T and the root mean square `|y|` of the measurements. Otherwise an output with less
    /// noise than that would be fitted to the errors of the simulation. Below this limit, an output adds
    /// `N_o / 2 ln v_o + r_o' r_o / (2 v_o) - N_o / 2` with the variance v_o of the limit, the maximum of its
    /// likelihood over the allowed variances. If all outputs are below their limits, all limits are reduced
    /// by the same factor until one output reaches it.
    ///
    /// Least squares minimises it as the sum of squares `N exp(2 L / N)`, where L is the cost and N the
    /// number of residuals with noise. Each evaluation multiplies the residuals of an output with `sqrt(G /
    /// v_o)`. Here `v_o = r_o' r_o / N_o` is the variance of the output at this point, and G is the geometric
    /// mean of the variances with weights N_o / N. The sum of squares is then N G. The search is one search
    /// for the concentrated likelihood (Seber and Wild, Nonlinear Regression, 1989, section 2.2.3), with the
    /// weights of iteratively reweighted least squares. For one output, it is the search for the plain sum of
    /// squares. `f_tol` applies to N G. `x_tol` is reduced to a hundredth, but not below 1e-6, because these
    /// residuals bend within the standard errors of the most precise output.
    ///
    /// Priors at the start whose squares exceed N require a method that uses only the cost, because their
    /// exponential has no useful linear model.
    Likelihood,
}

impl NamedCost {
    /// Returns "mae", "rmse", "nrmse" or "likelihood".
    pub fn name(self) -> &'static str {
        match self {
            Self::Mae => "mae",
            Self::Rmse => "rmse",
            Self::Nrmse => "nrmse",
            Self::Likelihood => "likelihood",
        }
    }
}

/// An output of an experiment, as passed to a user-defined function.
#[derive(Debug, Clone, Copy)]
pub struct Compared<'a> {
    /// Index of the experiment, from 0.
    pub experiment: usize,
    /// Variable of the model.
    pub variable: &'a str,
    /// Times of the measurements, in s.
    pub times: &'a [f64],
    /// Measured values.
    pub measured: &'a [f64],
    /// Simulated values, up to rounding.
    pub simulated: &'a [f64],
}

/// Reason why a user-defined function returned no cost.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CustomFailure {
    /// The cost does not exist at this point; the fit continues.
    Failed(String),
    /// The fit must end.
    Abort(String),
}

/// A function of measured and simulated values that returns residuals, or a cost as the only number.
type CustomFunction = dyn Fn(&[Compared<'_>]) -> Result<Vec<f64>, CustomFailure> + Send + Sync;

/// A user-defined function as the cost of a fit.
#[derive(Clone)]
pub struct CustomCost {
    name: String,
    gives_residuals: bool,
    function: Arc<CustomFunction>,
}

impl fmt::Debug for CustomCost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CustomCost").field("name", &self.name).finish_non_exhaustive()
    }
}

impl CustomCost {
    /// Creates a custom cost. The name identifies the function in checkpoints and reports.
    pub fn cost(
        name: impl Into<String>,
        function: impl Fn(&[Compared<'_>]) -> Result<f64, CustomFailure> + Send + Sync + 'static,
    ) -> Self {
        let function = move |compared: &[Compared<'_>]| function(compared).map(|cost| vec![cost]);
        Self { name: name.into(), gives_residuals: false, function: Arc::new(function) }
    }

    /// Creates a custom cost from residuals whose sum of squares is minimised. Their number and order must
    /// not change.
    pub fn residuals(
        name: impl Into<String>,
        function: impl Fn(&[Compared<'_>]) -> Result<Vec<f64>, CustomFailure> + Send + Sync + 'static,
    ) -> Self {
        Self { name: name.into(), gives_residuals: true, function: Arc::new(function) }
    }
}

impl CostKind {
    /// Returns the cost with this [`name`](Self::name). Returns `None` for a user-defined function.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::named().find(|kind| kind.name() == name)
    }

    /// Returns the costs that have names.
    pub fn named() -> impl Iterator<Item = Self> {
        let named = [NamedCost::Mae, NamedCost::Rmse, NamedCost::Nrmse, NamedCost::Likelihood];
        std::iter::once(Self::SumOfSquares).chain(named.map(Self::Named))
    }

    /// Returns "sum-of-squares", a name from [`NamedCost::name`], or the name of a user-defined function.
    pub fn name(&self) -> &str {
        match self {
            Self::SumOfSquares => "sum-of-squares",
            Self::Named(named) => named.name(),
            Self::Custom(custom) => &custom.name,
            Self::Goals => "goals",
        }
    }

    /// True if the cost is the sum of squares of the residuals themselves.
    pub fn is_sum_of_squares(&self) -> bool {
        matches!(self, Self::SumOfSquares)
    }

    /// True if the [uncertainty](crate::Fit::uncertainty) of a fit with this cost can be estimated. It is
    /// true for the sum of squares, with or without a loss, and for the likelihood.
    pub fn has_uncertainty(&self) -> bool {
        self.is_sum_of_squares() || self.is_likelihood()
    }

    pub(crate) fn is_likelihood(&self) -> bool {
        matches!(self, Self::Named(NamedCost::Likelihood))
    }

    /// Returns the scale to which differences of the cost are compared. For the likelihood it is N / 2, the
    /// change per relative change of the sums of squares. Otherwise it is the absolute value of the cost.
    pub(crate) fn size(&self, cost: f64, n_measurements: usize) -> f64 {
        if self.is_likelihood() { 0.5 * n_measurements as f64 } else { cost.abs() }
    }

    /// True if least squares can minimise the cost: for sums of squares and the
    /// [likelihood](NamedCost::Likelihood).
    pub fn has_residuals(&self) -> bool {
        match self {
            Self::SumOfSquares => true,
            Self::Named(named) => *named == NamedCost::Likelihood,
            Self::Custom(custom) => custom.gives_residuals,
            Self::Goals => false,
        }
    }

    /// Checks that the cost suits these measurements.
    pub(crate) fn check(&self, layout: &ResidualLayout, is_robust: bool) -> Result<(), CalibrationError> {
        let setup = |message: String| Err(CalibrationError::Setup(message));
        if self.is_sum_of_squares() {
            return Ok(());
        }
        let name = self.name();
        if is_robust {
            return setup(format!(
                "a robust loss requires the sum of squares. Remove it with the objective '{name}'"
            ));
        }
        if !layout.priors.is_empty() && !matches!(self, Self::Named(NamedCost::Likelihood)) {
            return setup(format!(
                "priors require the sum of squares or the likelihood. Use bounds with the objective '{name}'"
            ));
        }
        let is_constant = |o: &&OutputResiduals| o.measured.iter().all(|m| *m == o.measured[0]);
        match (self, layout.outputs.iter().find(is_constant)) {
            (Self::Named(NamedCost::Nrmse), Some(output)) => setup(format!(
                "all measurements of '{}' are {}, so the objective 'nrmse' has no range to divide by",
                output.variable,
                base::Number(output.measured[0])
            )),
            _ => Ok(()),
        }
    }

    /// Computes the outcome from residuals and their sum of squares `sum`. Residuals of a user-defined
    /// function are written to `custom_residuals`.
    pub(crate) fn outcome(
        &self,
        layout: &ResidualLayout,
        sum: f64,
        residuals: &[f64],
        custom_residuals: &mut Vec<f64>,
    ) -> Outcome {
        match self {
            Self::SumOfSquares => Outcome::Value(sum),
            Self::Named(named) => Outcome::Value(named.cost(layout, residuals)),
            Self::Custom(custom) => custom.outcome(layout, residuals, custom_residuals),
            // Goals follow from criteria, not from residuals.
            Self::Goals => Outcome::failed("a design has no residuals".to_owned()),
        }
    }
}

impl NamedCost {
    pub(crate) fn cost(self, layout: &ResidualLayout, residuals: &[f64]) -> f64 {
        let of_measurements = &residuals[..layout.n_measurements()];
        let n = of_measurements.len() as f64;
        let squares = |of: &[f64]| of.iter().map(|r| r * r).sum::<f64>();
        match self {
            Self::Mae => of_measurements.iter().map(|r| r.abs()).sum::<f64>() / n,
            Self::Rmse => (squares(of_measurements) / n).sqrt(),
            Self::Nrmse => {
                let of_output = |o: &OutputResiduals| {
                    let (low, high) = (o.measured.iter())
                        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), m| {
                            (low.min(*m), high.max(*m))
                        });
                    (squares(&residuals[o.range.clone()]) / o.measured.len() as f64).sqrt() / (high - low)
                };
                layout.outputs.iter().map(of_output).sum::<f64>() / layout.outputs.len() as f64
            }
            Self::Likelihood => {
                let of_priors = 0.5 * squares(&residuals[layout.n_measurements()..]);
                VariableNoise::all(layout, residuals).iter().fold(of_priors, |sum, own| sum + own.cost())
            }
        }
    }
}

/// Noise of a variable over its recordings.
struct VariableNoise<'a> {
    outputs: Vec<&'a OutputResiduals>,
    /// Number of residuals with noise; a tiny number if there is none.
    n: f64,
    squares: f64,
    /// Best variance that is not below the variance of the error of the simulation.
    variance: f64,
    /// True if the variance is the limit, because the squares of the residuals are smaller.
    is_limited: bool,
}

/// Error of a simulation relative to its relative tolerance. The root mean square errors of the outputs of
/// the tank, the oscillator and the pendulum are 0.005 to 7 times the tolerance, for tolerances from 1e-9 to
/// 1e-4.
const ERROR_PER_TOLERANCE: f64 = 10.0;

impl<'a> VariableNoise<'a> {
    fn all(layout: &'a ResidualLayout, residuals: &'a [f64]) -> Vec<Self> {
        let outputs = &layout.outputs;
        let is_first = |k: &usize| outputs[..*k].iter().all(|o| o.variable != outputs[*k].variable);
        let of = |k: usize| {
            let own = outputs[k..].iter().filter(|o| o.variable == outputs[k].variable).collect();
            Self::new(own, residuals)
        };
        let mut all: Vec<(Self, f64)> = (0..outputs.len()).filter(is_first).map(of).collect();
        let error = ERROR_PER_TOLERANCE * layout.relative_tolerance;
        // If all outputs are below their limits, they still differ in their errors.
        let ratio = |(noise, size): &(Self, f64)| noise.variance / (error * error * size);
        let largest = all.iter().map(ratio).filter(|ratio| ratio.is_finite()).fold(0.0, f64::max);
        let limit = error * error * largest.min(1.0);
        for (noise, size) in &mut all {
            let rounding = *size * f64::EPSILON * f64::EPSILON;
            let least = (limit * *size).max(rounding).max(f64::MIN_POSITIVE);
            // The output that reduces all limits is at its own one, up to rounding.
            noise.is_limited = noise.variance < least * (1.0 - 1e-9);
            noise.variance = noise.variance.max(least);
        }
        all.into_iter().map(|(noise, _)| noise).collect()
    }

    /// Returns the noise without a limit, and the mean square of the weighted measurements.
    fn new(outputs: Vec<&'a OutputResiduals>, residuals: &[f64]) -> (Self, f64) {
        let (mut n, mut squares, mut measured) = (0, 0.0, 0.0);
        for output in &outputs {
            n += output.noisy_rows().count();
            squares += residuals[output.range.clone()].iter().map(|r| r * r).sum::<f64>();
            let rows = output.measured.iter().zip(&output.weights);
            measured += rows.map(|(m, w)| (m * w) * (m * w)).sum::<f64>();
        }
        let size = measured / f64::max(n as f64, 1.0);
        let n = f64::max(n as f64, f64::MIN_POSITIVE);
        (Self { outputs, n, squares, variance: squares / n, is_limited: false }, size)
    }

    /// Returns the sum of the squares divided by the variance.
    fn scaled_squares(&self) -> f64 {
        if self.is_limited { self.squares / self.variance } else { self.n }
    }

    /// Returns the negative log-likelihood.
    fn cost(&self) -> f64 {
        0.5 * (self.n * self.variance.ln() + (self.scaled_squares() - self.n))
    }
}

/// Returns the variance of each output in the [likelihood](NamedCost::Likelihood), and whether it is the
/// limit of the accuracy of the simulation.
pub(crate) fn likelihood_variances(layout: &ResidualLayout, residuals: &[f64]) -> Vec<(f64, bool)> {
    let all = VariableNoise::all(layout, residuals);
    let of = |output: &OutputResiduals| {
        let own = all.iter().find(|noise| noise.outputs.iter().any(|o| o.variable == output.variable));
        own.map_or((1.0, false), |noise| (noise.variance, noise.is_limited))
    };
    layout.outputs.iter().map(of).collect()
}

/// Returns residuals whose sum of squares is `N exp(2 L / N)` for the [likelihood](NamedCost::Likelihood) L
/// and N residuals with noise.
///
/// Let T be the sum of `r_o' r_o / v_o` over all outputs, plus the squares of the priors: N without priors
/// and limited variances. With `H = N / T exp(2 L / N)`, the residuals of an output are multiplied with
/// `sqrt(H / v_o)`, and those of the priors with `sqrt(H)`. The sum of squares is then H T.
pub(crate) fn reweighted_by_likelihood(layout: &ResidualLayout, residuals: &[f64]) -> Vec<f64> {
    let mut scaled = vec![0.0; residuals.len()];
    let of_priors = layout.n_measurements()..residuals.len();
    let squares_of_priors: f64 = residuals[of_priors.clone()].iter().map(|r| r * r).sum();
    let noises = VariableNoise::all(layout, residuals);
    let n: f64 = noises.iter().map(|noise| noise.n).sum();
    let cost = noises.iter().fold(0.5 * squares_of_priors, |sum, noise| sum + noise.cost());
    let total = noises.iter().fold(squares_of_priors, |sum, noise| sum + noise.scaled_squares());
    // Roots, because the squares may overflow.
    let whole = (cost / n).exp();
    let root = whole * (n / total).sqrt();
    for noise in &noises {
        let factor = root * noise.variance.sqrt().recip();
        for row in noise.outputs.iter().flat_map(|output| output.noisy_rows()) {
            // All residuals are zero if the total is.
            scaled[row] = if total > 0.0 { residuals[row] * factor } else { whole };
        }
    }
    of_priors.for_each(|k| scaled[k] = residuals[k] * if total > 0.0 { root } else { 0.0 });
    scaled
}

impl CustomCost {
    fn outcome(
        &self,
        layout: &ResidualLayout,
        residuals: &[f64],
        custom_residuals: &mut Vec<f64>,
    ) -> Outcome {
        let values = |o: &OutputResiduals| (o.simulated_values(residuals), o.measured_values());
        let values: Vec<(Vec<f64>, Vec<f64>)> = layout.outputs.iter().map(values).collect();
        let compared: Vec<Compared<'_>> = (layout.outputs.iter().zip(&values))
            .map(|(o, (simulated, measured))| Compared {
                experiment: o.experiment,
                variable: &o.variable,
                times: &o.times,
                measured,
                simulated,
            })
            .collect();
        match (self.function)(&compared) {
            Ok(returned) if self.gives_residuals => {
                *custom_residuals = returned;
                dfo::RobustLoss::default().cost(custom_residuals, f64::INFINITY)
            }
            Ok(returned) => Outcome::Value(returned.first().copied().unwrap_or(f64::NAN)),
            Err(CustomFailure::Failed(message)) => Outcome::failed(message),
            Err(CustomFailure::Abort(message)) => Outcome::Abort(message),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::residual_layout::PriorResidual;

    fn layout() -> ResidualLayout {
        let output =
            |experiment, variable: &str, range: std::ops::Range<usize>, weight: f64| OutputResiduals {
                experiment,
                output: 0,
                variable: variable.to_owned(),
                column: variable.to_owned(),
                times: vec![0.0; range.len()].into(),
                measured: (0..range.len()).map(|i| i as f64).collect(),
                weights: vec![weight; range.len()].into(),
                range,
                starts_simulation: false,
                is_noise_known: false,
                is_log: false,
            };
        let outputs = vec![output(0, "x", 0..2, 1.0), output(0, "y", 2..5, 2.0), output(1, "x", 5..7, 1.0)];
        ResidualLayout { outputs, ..ResidualLayout::default() }
    }

    #[test]
    fn named_costs_match_their_formulas() {
        let (layout, r) = (layout(), [1.0, -2.0, 3.0, 0.0, -1.0, 2.0, 4.0]);
        let cost = |named: NamedCost| named.cost(&layout, &r);
        assert_eq!(cost(NamedCost::Mae), 13.0 / 7.0);
        assert_eq!(cost(NamedCost::Rmse), (35.0_f64 / 7.0).sqrt());
        let nrmse = ((5.0_f64 / 2.0).sqrt() + (10.0_f64 / 3.0).sqrt() / 2.0 + 10.0_f64.sqrt()) / 3.0;
        assert!((cost(NamedCost::Nrmse) - nrmse).abs() < 1e-15);
        // The two recordings of x share one standard deviation.
        let likelihood = 2.0 * (25.0_f64 / 4.0).ln() + 1.5 * (10.0_f64 / 3.0).ln();
        assert!((cost(NamedCost::Likelihood) - likelihood).abs() < 1e-14);
        assert!(NamedCost::Likelihood.cost(&layout, &[0.0; 7]).is_finite());
    }

    #[test]
    fn likelihood_ignores_rows_without_noise() {
        let (r, expected) =
            ([0.0, -2.0, 3.0, 0.0, -1.0, 2.0, 4.0], 1.5 * 8.0_f64.ln() + 1.5 * (10.0_f64 / 3.0).ln());
        let (mut of_start, mut of_zero) = (layout(), layout());
        of_start.outputs[0].starts_simulation = true;
        of_zero.outputs[0].weights = vec![0.0, 1.0].into();
        for layout in [of_start, of_zero] {
            assert!((NamedCost::Likelihood.cost(&layout, &r) - expected).abs() < 1e-14);
        }
    }

    #[test]
    fn reweighted_residuals_have_the_likelihood_as_their_sum_of_squares() {
        let prior = |parameter, index| PriorResidual {
            parameter,
            prior: crate::problem::prior::Prior::Normal { mean: 0.0, sd: 1.0 },
            index,
        };
        let priors = vec![prior(0, 7), prior(1, 8)];
        let (plain, with_priors) = (layout(), ResidualLayout { priors, ..layout() });
        let r = [1.0, -2.0, 3.0, 0.0, -1.0, 2.0, 4.0, 0.5, -1.5];
        for (layout, r) in [(&plain, &r[..7]), (&with_priors, &r[..])] {
            let squares = |r: &[f64]| reweighted_by_likelihood(layout, r).iter().map(|r| r * r).sum::<f64>();
            let expected = |r: &[f64]| 7.0 * (2.0 * NamedCost::Likelihood.cost(layout, r) / 7.0).exp();
            assert!((squares(r) / expected(r) - 1.0).abs() < 1e-14);
            // An exact output has the variance of rounding, and other directions of the residuals count.
            for factor in [0.0, 1e-20, 1e-3, 1e150] {
                let mut exact = r.to_vec();
                exact[2..5].iter_mut().for_each(|r| *r *= factor);
                let ratio = squares(&exact) / expected(&exact);
                assert!((ratio - 1.0).abs() < 1e-12, "{factor}: {ratio}");
            }
        }
        // The variance of an output is at least that of the error of the simulation.
        let limited = ResidualLayout { relative_tolerance: 1e-4, ..with_priors.clone() };
        for factor in [0.0, 1e-9, 1e-4, 1e-3, 1.0] {
            let exact: Vec<f64> =
                (0..9).map(|k| if (2..5).contains(&k) { r[k] * factor } else { r[k] }).collect();
            let squares = reweighted_by_likelihood(&limited, &exact).iter().map(|r| r * r).sum::<f64>();
            let expected = 7.0 * (2.0 * NamedCost::Likelihood.cost(&limited, &exact) / 7.0).exp();
            assert!((squares / expected - 1.0).abs() < 1e-12, "{factor}");
            let (variance, is_limited) = likelihood_variances(&limited, &exact)[1];
            let least = 1e-6 * (4.0 * 5.0 / 3.0);
            assert_eq!(is_limited, factor <= 1e-3);
            assert!((variance / f64::max(least, factor * factor * 10.0 / 3.0) - 1.0).abs() < 1e-12);
        }
        // One output keeps its residuals.
        let one = ResidualLayout { outputs: plain.outputs[..1].to_vec(), ..ResidualLayout::default() };
        let same = reweighted_by_likelihood(&one, &r[..2]);
        assert!(same.iter().zip(&r).all(|(s, r)| (s - r).abs() < 1e-15), "{same:?}");
        // The residual of a measurement that a simulation starts from does not count.
        let mut of_start = plain.clone();
        of_start.outputs[0].starts_simulation = true;
        let n: f64 = reweighted_by_likelihood(&of_start, &[0.0, -2.0, 3.0, 0.0, -1.0, 2.0, 4.0])
            .iter()
            .map(|r| r * r)
            .sum();
        let cost = NamedCost::Likelihood.cost(&of_start, &[0.0, -2.0, 3.0, 0.0, -1.0, 2.0, 4.0]);
        assert!((n / (6.0 * (cost / 3.0).exp()) - 1.0).abs() < 1e-14);
    }

    #[test]
    fn custom_cost_receives_measured_and_simulated_values() {
        let custom = CustomCost::residuals("ratios", |compared| {
            assert_eq!(compared[1].simulated, [1.5, 1.0, 1.5]);
            Ok(compared.iter().flat_map(|c| c.simulated.iter().zip(c.measured).map(|(s, m)| s + m)).collect())
        });
        let mut custom_residuals = Vec::new();
        let kind = CostKind::Custom(custom);
        let r = [1.0, -2.0, 3.0, 0.0, -1.0, 2.0, 4.0];
        let outcome = kind.outcome(&layout(), 35.0, &r, &mut custom_residuals);
        assert_eq!(custom_residuals, [1.0, 0.0, 1.5, 2.0, 3.5, 2.0, 6.0]);
        assert_eq!(outcome, Outcome::Value(1.0 + 2.25 + 4.0 + 12.25 + 4.0 + 36.0));
        assert!(kind.has_residuals() && !kind.is_sum_of_squares());
    }
}
