//! Outputs that are measured on unlike scales and have the same weight: the largest decides the fit.

use super::simulated_outputs::{Place, rounded};
use crate::findings::finding::{Finding, Severity};
use crate::loaded::calibration::Calibration;
use crate::problem::column_units::declared;
use crate::problem::experiment::Weight;
use crate::problem::residual_layout::OutputResiduals;
use base::Number;

/// Outputs that differ by this factor have 99 % and 1 % of the squares.
const UNLIKE: f64 = 10.0;

/// Sums over the measurements and residuals of an output of the model, in all experiments.
struct Output<'a> {
    variable: &'a str,
    n: f64,
    /// Sum of the squared weighted distances of the measurements from their mean.
    spread: f64,
    /// Sum of the squared residuals.
    squares: f64,
}

impl Output<'_> {
    /// Standard deviation of its measurements, times their weight.
    fn deviation(&self) -> f64 {
        (self.spread / self.n).sqrt()
    }
}

/// The outputs of the smallest and the largest spread, where they count unlike and nobody has chosen weights;
/// with residuals, and where they are from, what each has of the cost. After a fit it is the residuals that
/// must be unlike: with noise of one size the same weight is right.
pub(super) fn finding(calibration: &Calibration, residuals: Option<(&[f64], Place)>) -> Option<Finding> {
    let problem = calibration.problem();
    let mut weights = problem.experiments.iter().flat_map(|e| &e.outputs).map(|o| &o.weight);
    let first = weights.next().filter(|weight| matches!(weight, Weight::Constant(_)))?;
    if weights.any(|weight| weight != first) {
        return None;
    }
    let mut outputs: Vec<Output<'_>> = Vec::new();
    for own in &calibration.residual_layout().outputs {
        let n = own.measured.len() as f64;
        let mean = own.measured.iter().sum::<f64>() / n;
        let weighted = own.measured.iter().zip(&own.weights).map(|(y, w)| (w * (y - mean)).powi(2));
        let spread: f64 = weighted.sum();
        let squares = residuals.map_or(spread, |(r, _)| r[own.range.clone()].iter().map(|r| r * r).sum());
        match outputs.iter_mut().find(|output| output.variable == own.variable) {
            Some(output) => {
                output.n += n;
                output.spread += spread;
                output.squares += squares;
            }
            None => outputs.push(Output { variable: &own.variable, n, spread, squares }),
        }
    }
    outputs.retain(|output| output.spread > 0.0);
    let by_deviation = |a: &&Output<'_>, b: &&Output<'_>| a.deviation().total_cmp(&b.deviation());
    let (small, large) = (outputs.iter().min_by(by_deviation)?, outputs.iter().max_by(by_deviation)?);
    let is_fitted = residuals.is_some_and(|(_, place)| place == Place::Fitted);
    let of_residuals = (large.squares / large.n).sqrt() / (small.squares / small.n).sqrt();
    if large.deviation() < UNLIKE * small.deviation()
        || (is_fitted && (of_residuals.is_nan() || of_residuals < UNLIKE))
    {
        return None;
    }
    let description = calibration.fmu().description();
    let unit = |output: &Output<'_>| declared(description, output.variable).and_then(|v| v.unit.clone());
    // Of one unit it may be meant so: sensors of one kind have one noise.
    let severity = match unit(small) {
        Some(of_small) if Some(&of_small) == unit(large).as_ref() => Severity::Note,
        _ => Severity::Warning,
    };
    let percent = |part: f64, all: f64| Number(rounded(100.0 * part / all));
    let cost: f64 = outputs.iter().map(|output| output.squares).sum();
    let relative = |output: &Output<'_>| output.squares * output.n / output.spread;
    let cost_with_sd: f64 = outputs.iter().map(relative).sum();
    let of = residuals.map_or_else(
        || "of the squares of the measurements".to_owned(),
        |(_, place)| format!("of the cost {}", place),
    );
    let [small_name, large_name] = [small, large].map(|output| output.variable);
    Some(Finding::new(
        severity,
        format!("outputs '{small_name}' and '{large_name}'"),
        format!(
            "their measurements vary by {} and {} (standard deviations), and their weights are the same: '{small_name}' has {} % {of}",
            Number(rounded(small.deviation())),
            Number(rounded(large.deviation())),
            percent(small.squares, cost),
        ),
        format!(
            "weights=\"sd\" makes outputs of unlike scale count alike ('{small_name}' would have {} % of it); weights of 1 over the noise of \
             each give the smallest standard errors",
            percent(relative(small), cost_with_sd),
        ),
    ))
}

/// Weights that are as unlike as the residuals, instead of as their inverses, within this factor on a
/// logarithmic scale.
const AS_RESIDUALS: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// Outputs of unlike residuals whose weights are in proportion to these: sigma, where 1/sigma is meant.
pub(super) fn inverse_weights(calibration: &Calibration, residuals: &[f64]) -> Option<Finding> {
    let outputs = &calibration.residual_layout().outputs;
    let measured = |o: &OutputResiduals| &calibration.problem().experiments[o.experiment].outputs[o.output];
    let is_given = |o: &OutputResiduals| {
        matches!(measured(o).weight, Weight::Constant(_) | Weight::Rows(_) | Weight::Column(_))
    };
    if !outputs.iter().all(is_given) {
        return None;
    }
    let rms = |o: &OutputResiduals, weights: &dyn Fn(usize) -> f64| {
        let squares = residuals[o.range.clone()].iter().enumerate().map(|(k, r)| (r / weights(k)).powi(2));
        (squares.sum::<f64>() / o.range.len() as f64).sqrt()
    };
    let of = |o| (o, rms(o, &|k| o.weights[k]), rms(o, &|_| 1.0) / rms(o, &|k| o.weights[k]));
    let by_size = |a: &(&OutputResiduals, f64, f64), b: &(&OutputResiduals, f64, f64)| a.1.total_cmp(&b.1);
    let all = || outputs.iter().map(of).filter(|(_, rms, weight)| *rms > 0.0 && *weight > 0.0);
    let (small, large) = (all().min_by(by_size)?, all().max_by(by_size)?);
    let (unlike, of_weights) = (large.1 / small.1, large.2 / small.2);
    let is_inverse = unlike >= UNLIKE && AS_RESIDUALS.contains(&(of_weights.ln() / unlike.ln()));
    is_inverse.then(|| {
        Finding::warning(
            format!("outputs '{}' and '{}'", small.0.variable, large.0.variable),
            format!(
                "their residuals are {} and {} (RMS), and their weights {} and {}: the noisier one counts more",
                Number(rounded(small.1)),
                Number(rounded(large.1)),
                Number(rounded(small.2)),
                Number(rounded(large.2))
            ),
            "are the weights sigma? 1/sigma gives the smallest standard errors",
        )
    })
}
