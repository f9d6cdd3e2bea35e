//! Outputs whose residuals show something that lasts only because the weights of other outputs keep the
//! parameters off.

use crate::error::CalibrationError;
use crate::uncertainty::diagnostics::residual_check::ResidualCheck;
use crate::uncertainty::p_values::OfIndependent;
use crate::uncertainty::row_blocks::{ThinSvd, scaled, thin_svd};
use base::RunContext;
use nalgebra::{DMatrix, DVector};

/// An output takes part that has at least so many residuals for each parameter: of fewer the parameters
/// explain too much.
const RESIDUALS_PER_PARAMETER: usize = 4;

/// Largest rise of the squares of other outputs, over their variance, in standard deviations of a chi-squared
/// number: as many parameters as they were fitted with have moved.
const BY_CHANCE: f64 = 4.0;

/// Marks the outputs with systematic residuals that one step of least squares, with the residuals of each
/// output in units of their noise instead of the weights, brings to reproduce their measurements, while the
/// others are reproduced as well as before. Outputs that contradict each other are none. `jacobian`: of the
/// residuals (m) by the free parameters (p), m x p.
///
/// `n`: how many of the residuals are those of measurements. An output that is as good without the priors, by
/// the same weights, is kept away by these.
pub(crate) fn mark(
    checks: &mut [ResidualCheck],
    residuals: &[f64],
    n: usize,
    jacobian: &DMatrix<f64>,
    independent: &[OfIndependent],
    context: &RunContext<'_>,
) -> Result<(), CalibrationError> {
    let p = jacobian.ncols();
    let mut variables: Vec<(String, Vec<usize>)> = Vec::new();
    let mut from = 0;
    for check in checks.iter() {
        let rows = from..from + check.n;
        from = rows.end;
        match variables.iter_mut().find(|(name, _)| *name == check.variable) {
            Some((_, known)) => known.extend(rows),
            None => variables.push((check.variable.clone(), rows.collect())),
        }
    }
    if variables.len() < 2 || p == 0 {
        return Ok(());
    }
    let residuals = DVector::from_column_slice(residuals);
    let without_priors = match n < residuals.len() {
        true => least_squares(jacobian.rows(0, n).into_owned(), &residuals.rows(0, n).into_owned(), context)?,
        false => None,
    };
    let without_priors = without_priors.map(|step| jacobian * step + &residuals);
    for (own, (name, rows)) in variables.iter().enumerate() {
        let is_systematic = checks.iter().any(|check| check.variable == *name && check.is_systematic());
        if !is_systematic || rows.len() < RESIDUALS_PER_PARAMETER * p {
            continue;
        }
        // What the parameters leave of this output alone is its noise.
        let (part, r) = (jacobian.select_rows(rows), residuals.select_rows(rows));
        let Some(step) = least_squares(part.clone(), &r, context)? else { continue };
        let left = (&part * step + &r).norm_squared() / (rows.len() - p) as f64;
        let square = |rows: &[usize]| residuals.select_rows(rows).norm_squared() / rows.len() as f64;
        let variance = |k: usize| if k == own { left } else { square(&variables[k].1) };
        // Those of priors have the variance 1 already.
        let mut scale = DVector::from_element(residuals.len(), 1.0);
        for (k, (_, rows)) in variables.iter().enumerate() {
            rows.iter().for_each(|row| scale[*row] = variance(k).sqrt().recip());
        }
        if scale.iter().any(|scale| !scale.is_finite()) {
            continue;
        }
        let part = scaled(jacobian, scale.as_slice(), context)?;
        let Some(step) = least_squares(part, &residuals.component_mul(&scale), context)? else { continue };
        let moved = jacobian * step + &residuals;
        let rise = |(k, (_, rows)): (usize, &(String, Vec<usize>))| {
            let after = moved.select_rows(rows).norm_squared();
            (after - residuals.select_rows(rows).norm_squared()) / variance(k)
        };
        let most = p as f64 + BY_CHANCE * (2.0 * p as f64).sqrt();
        let others = variables.iter().enumerate().filter(|(k, _)| *k != own);
        if others.map(rise).any(|rise| rise > most) {
            continue;
        }
        let mut from = 0;
        for (k, check) in checks.iter_mut().enumerate() {
            let rows = from..from + check.n;
            from = rows.end;
            if check.variable == *name && check.is_systematic() {
                let is_removed = |r: &DVector<f64>| {
                    let r = &r.as_slice()[rows.clone()];
                    !check.clone().with_numbers_of(r, independent.get(k)).is_systematic()
                };
                check.is_by_weights = is_removed(&moved) && !without_priors.as_ref().is_some_and(is_removed);
            }
        }
    }
    Ok(())
}

/// The step `d` of least `|j d + r|`.
fn least_squares(
    mut j: DMatrix<f64>,
    r: &DVector<f64>,
    context: &RunContext<'_>,
) -> Result<Option<DVector<f64>>, CalibrationError> {
    let lengths: Vec<f64> = j.column_iter().map(|column| column.norm()).collect();
    for (mut column, length) in j.column_iter_mut().zip(&lengths) {
        if *length > 0.0 {
            column /= *length;
        }
    }
    let Some(ThinSvd { u, values, v_t }) = thin_svd(&j, context)? else { return Ok(None) };
    let smallest = 1e-10 * values.iter().copied().fold(0.0, f64::max);
    let mut along = u.tr_mul(r);
    for (along, value) in along.iter_mut().zip(&values) {
        *along *= if *value > smallest { -value.recip() } else { 0.0 };
    }
    let mut step = v_t.tr_mul(&along);
    step.iter_mut().zip(&lengths).filter(|(_, length)| **length > 0.0).for_each(|(d, length)| *d /= length);
    Ok(Some(step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};

    /// A pseudo-random number from -1 to 1.
    fn noise(k: usize) -> f64 {
        2.0 * ((12.9898 * (k as f64 + 1.0)).sin() * 43_758.547).fract().abs() - 1.0
    }

    /// The least squares fit of `large = 100 k t` and `small = 0.01 k t + shift t`, k = 1, with noise of a
    /// tenth of `large`, and of `relative` of `small`; all weights 1.
    fn checks(shift: f64, relative: f64) -> Vec<ResidualCheck> {
        let n = 100;
        let t = |k: usize| (k % n) as f64 / n as f64;
        let slope = |k: usize| if k < n { 100.0 } else { 0.01 };
        let error = |k: usize| match k < n {
            true => 10.0 * noise(k),
            false => 0.01 * relative * noise(k) + shift * t(k),
        };
        let j = DMatrix::from_fn(2 * n, 1, |k, _| slope(k) * t(k));
        let r = DVector::from_fn(2 * n, |k, _| error(k));
        let r = &j * least_squares(j.clone(), &r, &RunContext::new()).unwrap().unwrap() + r;
        let output = |k: usize| OutputResiduals {
            experiment: 0,
            output: k,
            variable: ["large", "small"][k].to_owned(),
            column: String::new(),
            range: k * n..(k + 1) * n,
            times: (0..n).map(t).collect(),
            measured: (0..n).map(|i| slope(k * n) * t(i)).collect(),
            weights: vec![1.0; n].into(),
            starts_simulation: false,
        };
        let layout = ResidualLayout { outputs: vec![output(0), output(1)], priors: Vec::new() };
        let mut checks =
            ResidualCheck::all(&layout, &["run1".to_owned()], r.as_slice(), None, &RunContext::new())
                .unwrap();
        mark(&mut checks, r.as_slice(), 2 * n, &j, &[], &RunContext::new()).unwrap();
        checks
    }

    #[test]
    fn an_accurate_output_that_hardly_counts_is_one_of_weights() {
        // `large` tells k to about 1 %, `small` would to 0.01 %.
        let checks = checks(0.0, 1e-3);
        assert!(checks[1].is_systematic() && checks[1].is_by_weights, "{checks:?}");
        assert!(!checks[0].is_systematic() && !checks[0].is_by_weights, "{checks:?}");
    }

    #[test]
    fn an_output_that_contradicts_the_others_is_not_one_of_weights() {
        // 30 % away from what `large` says of k to about 2 %.
        let contradicted = checks(-3e-3, 0.1);
        assert!(contradicted[1].is_systematic() && !contradicted[1].is_by_weights, "{contradicted:?}");
        assert!(contradicted.iter().all(|check| !check.is_by_weights));
    }
}
