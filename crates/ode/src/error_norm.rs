//! Weights of errors, and the weighted norms of the error tests.

use crate::options::{AbsoluteTolerance, Options};

/// Smallest absolute tolerance, so that the inverse of a weight is finite.
const LEAST_ATOL: f64 = 1e-300;

/// Relative tolerance of unbounded states: the rounding error of a difference of large numbers.
const ROUNDING: f64 = 1e-14;

/// Weights `w_i = atol_i + rtol_i * max(|x_i|, |x_new_i|)` of the root-mean-square norm. `rtol_i` is the
/// relative tolerance, or a negligible value for unbounded states.
#[derive(Debug, Default)]
pub(crate) struct ErrorWeights {
    rtol: f64,
    relative: Vec<f64>,
    atol: Vec<f64>,
    scale: Vec<f64>,
    /// Indices of the states whose absolute tolerance is zero.
    purely_relative: Vec<usize>,
}

impl ErrorWeights {
    /// Sets the tolerances of `nominals.len()` states. Corrects nominal values that are zero, negative or not
    /// finite. The caller must check that a list of tolerances has this length.
    pub(crate) fn set(&mut self, options: &Options, nominals: &[f64], is_unbounded: impl Fn(usize) -> bool) {
        let rtol = options.relative_tolerance;
        self.rtol = options.rtol_or_like();
        self.relative.clear();
        self.relative.extend((0..nominals.len()).map(|i| if is_unbounded(i) { ROUNDING } else { rtol }));
        self.atol.clear();
        match &options.absolute_tolerance {
            AbsoluteTolerance::FromNominals => self.atol.extend(nominals.iter().map(|nominal| {
                let n = nominal.abs();
                0.01 * rtol * if n > 0.0 && n.is_finite() { n } else { 1.0 }
            })),
            AbsoluteTolerance::Scalar(v) => self.atol.resize(nominals.len(), *v),
            AbsoluteTolerance::PerState(list) => self.atol.extend_from_slice(list),
        }
        self.purely_relative.clear();
        self.purely_relative.extend((0..self.atol.len()).filter(|&i| self.atol[i] == 0.0));
        self.atol.iter_mut().for_each(|atol| *atol = atol.max(LEAST_ATOL));
        self.scale.clear();
        self.scale.extend(nominals.iter().zip(&self.atol).map(|(nominal, atol)| {
            let n = nominal.abs();
            (if n > 0.0 && n.is_finite() { n } else { 1.0 }).min(atol / (0.01 * self.rtol))
        }));
    }

    /// Returns a state without a tolerance at `x`: the state and its absolute tolerance are zero.
    pub(crate) fn without_tolerance(&self, x: &[f64]) -> Option<usize> {
        self.purely_relative.iter().copied().find(|&i| self.relative[i] * x[i].abs() < LEAST_ATOL)
    }

    /// Relative tolerance, or [its replacement](Options::rtol_or_like) if it is zero.
    pub(crate) fn rtol(&self) -> f64 {
        self.rtol
    }

    /// Size below which a state counts as small: its nominal value, or a smaller one derived from the
    /// absolute tolerance. The derivation inverts the rule that computes absolute tolerances from nominal
    /// values.
    pub(crate) fn scale(&self, i: usize) -> f64 {
        self.scale[i]
    }

    /// Fills in the inverse weights at the state `x`, multiplied by `factor`.
    pub(crate) fn inverse_at(&self, x: &[f64], factor: f64, inverse: &mut [f64]) {
        for (i, v) in inverse.iter_mut().enumerate() {
            *v = factor / self.weight(i, x[i], x[i]);
        }
    }

    fn weight(&self, i: usize, a: f64, b: f64) -> f64 {
        self.atol[i] + self.relative[i] * a.abs().max(b.abs())
    }

    /// Norm of the error of a step from `x` to `x_new`; NaN if any value is NaN.
    pub(crate) fn error_norm(&self, x: &[f64], x_new: &[f64], error: &[f64]) -> f64 {
        let n = x.len();
        let (x_new, error) = (&x_new[..n], &error[..n]);
        let (atol, relative) = (&self.atol[..n], &self.relative[..n]);
        let mut sum = 0.0;
        for i in 0..n {
            // A NaN in the states also appears in the error.
            let (a, b) = (x[i].abs(), x_new[i].abs());
            let part = error[i] / (atol[i] + relative[i] * if a > b { a } else { b });
            sum += part * part;
        }
        (sum / x.len().max(1) as f64).sqrt()
    }

    /// Norm of `v` at the state `x`.
    pub(crate) fn norm(&self, x: &[f64], v: &[f64]) -> f64 {
        self.error_norm(x, x, v)
    }

    /// Norm of `a - b` at the state `x`.
    pub(crate) fn distance(&self, x: &[f64], a: &[f64], b: &[f64]) -> f64 {
        let sum: f64 = (0..x.len()).map(|i| ((a[i] - b[i]) / self.weight(i, x[i], x[i])).powi(2)).sum();
        (sum / x.len().max(1) as f64).sqrt()
    }

    /// True if `a` and `b` differ by less than this multiple of the weight in each state at `x`. False if any
    /// value is NaN.
    pub(crate) fn are_close(&self, x: &[f64], a: &[f64], b: &[f64], multiple: f64) -> bool {
        (0..x.len()).all(|i| (a[i] - b[i]).abs() < multiple * self.weight(i, x[i], x[i]))
    }

    /// Norm of `a - b` divided by the norm of `c - d`, at the state `x`. Zero if the latter norm is zero.
    pub(crate) fn ratio(&self, x: &[f64], [a, b]: [&[f64]; 2], [c, d]: [&[f64]; 2]) -> f64 {
        let (mut above, mut below) = (0.0, 0.0);
        for i in 0..x.len() {
            let inverse = 1.0 / self.weight(i, x[i], x[i]);
            above += ((a[i] - b[i]) * inverse).powi(2);
            below += ((c[i] - d[i]) * inverse).powi(2);
        }
        if below > 0.0 { (above / below).sqrt() } else { 0.0 }
    }

    /// Index of the state that contributes most to the error norm.
    pub(crate) fn worst(&self, x: &[f64], x_new: &[f64], error: &[f64]) -> Option<usize> {
        let share = |i: usize| (error[i] / self.weight(i, x[i], x_new[i])).abs();
        (0..x.len()).max_by(|&i, &j| share(i).total_cmp(&share(j)))
    }
}

/// Root mean square of the products of `v` and the inverse weights.
pub(crate) fn scaled_norm(v: &[f64], inverse_weights: &[f64]) -> f64 {
    let sum: f64 = v.iter().zip(inverse_weights).map(|(v, w)| (v * w) * (v * w)).sum();
    (sum / v.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_nominals_are_corrected() {
        let mut w = ErrorWeights::default();
        w.set(&Options::default(), &[2.0, 0.0, -3.0, f64::NAN, f64::INFINITY], |_| false);
        let expected = [2e-8, 1e-8, 3e-8, 1e-8, 1e-8];
        for (a, e) in w.atol.iter().zip(expected) {
            assert!((a - e).abs() < 1e-20);
        }
    }

    #[test]
    fn norm_is_root_mean_square_of_weighted_error() {
        let mut w = ErrorWeights::default();
        let absolute_tolerance = AbsoluteTolerance::Scalar(1.0);
        w.set(
            &Options { relative_tolerance: 0.1, absolute_tolerance, ..Options::default() },
            &[1.0, 1.0],
            |_| false,
        );
        // weights 1 + 0.1 * 10 = 2 and 1 + 0.1 * 20 = 3
        let n = w.error_norm(&[10.0, 0.0], &[-5.0, 20.0], &[2.0, 6.0]);
        assert!((n - (5.0_f64 / 2.0).sqrt()).abs() < 1e-15);
        assert_eq!(w.worst(&[10.0, 0.0], &[-5.0, 20.0], &[2.0, 6.0]), Some(1));
    }
}
