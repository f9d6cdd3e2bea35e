//! Weighted norms, the first step, and the step-size controller.

use crate::options::{AbsoluteTolerance, Options};

/// The least absolute tolerance, because the inverse of a weight must be a number.
const LEAST_ATOL: f64 = 1e-300;

/// The relative tolerance of unbounded states: what rounding leaves of a difference of large numbers.
const ROUNDING: f64 = 1e-14;

/// Weights `w_i = atol_i + rtol_i * max(|x_i|, |x_new_i|)` of the root-mean-square norm; `rtol_i` is the
/// relative tolerance, or next to nothing for unbounded states.
#[derive(Debug, Default)]
pub(crate) struct Weights {
    rtol: f64,
    relative: Vec<f64>,
    atol: Vec<f64>,
    scale: Vec<f64>,
    /// The states whose absolute tolerance is zero.
    purely_relative: Vec<usize>,
}

impl Weights {
    /// Sets tolerances for `nominals.len()` states; corrects nominals that are zero, negative or not finite.
    /// The caller has checked that a list of tolerances has this length.
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

    /// A state that has no tolerance at `x`: it is zero, and so is its absolute tolerance.
    pub(crate) fn without_tolerance(&self, x: &[f64]) -> Option<usize> {
        self.purely_relative.iter().copied().find(|&i| self.relative[i] * x[i].abs() < LEAST_ATOL)
    }

    /// The relative tolerance, or [what stands for it](Options::rtol_or_like) where it is zero.
    pub(crate) fn rtol(&self) -> f64 {
        self.rtol
    }

    /// The size below which a state counts as small: its nominal value, or less if the absolute tolerance
    /// says so (by the rule that makes absolute tolerances of nominal values).
    pub(crate) fn scale(&self, i: usize) -> f64 {
        self.scale[i]
    }

    /// Fills in the inverse weights at the state `x`, times `factor`.
    pub(crate) fn inverse_at(&self, x: &[f64], factor: f64, inverse: &mut [f64]) {
        for (i, v) in inverse.iter_mut().enumerate() {
            *v = factor / self.weight(i, x[i], x[i]);
        }
    }

    fn weight(&self, i: usize, a: f64, b: f64) -> f64 {
        self.atol[i] + self.relative[i] * a.abs().max(b.abs())
    }

    /// Norm of the error of a step from `x` to `x_new`; NaN if anything in it is.
    pub(crate) fn error_norm(&self, x: &[f64], x_new: &[f64], error: &[f64]) -> f64 {
        let n = x.len();
        let (x_new, error) = (&x_new[..n], &error[..n]);
        let (atol, relative) = (&self.atol[..n], &self.relative[..n]);
        let mut sum = 0.0;
        for i in 0..n {
            // A number that is not one is found in the error.
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

    /// True if `a` and `b` differ by less than this multiple of its weight in each state at `x`; not if
    /// either is NaN.
    pub(crate) fn are_close(&self, x: &[f64], a: &[f64], b: &[f64], multiple: f64) -> bool {
        (0..x.len()).all(|i| (a[i] - b[i]).abs() < multiple * self.weight(i, x[i], x[i]))
    }

    /// Norm of `a - b` over that of `c - d`, at the state `x`; zero if the latter is.
    pub(crate) fn ratio(&self, x: &[f64], [a, b]: [&[f64]; 2], [c, d]: [&[f64]; 2]) -> f64 {
        let (mut above, mut below) = (0.0, 0.0);
        for i in 0..x.len() {
            let inverse = 1.0 / self.weight(i, x[i], x[i]);
            above += ((a[i] - b[i]) * inverse).powi(2);
            below += ((c[i] - d[i]) * inverse).powi(2);
        }
        if below > 0.0 { (above / below).sqrt() } else { 0.0 }
    }

    /// The state that contributes most to the error norm.
    pub(crate) fn worst(&self, x: &[f64], x_new: &[f64], error: &[f64]) -> Option<usize> {
        let share = |i: usize| (error[i] / self.weight(i, x[i], x_new[i])).abs();
        (0..x.len()).max_by(|&i, &j| share(i).total_cmp(&share(j)))
    }
}

/// Root mean square of `v` times inverse weights.
pub(crate) fn scaled_norm(v: &[f64], inverse_weights: &[f64]) -> f64 {
    let sum: f64 = v.iter().zip(inverse_weights).map(|(v, w)| (v * w) * (v * w)).sum();
    (sum / v.len().max(1) as f64).sqrt()
}

/// The PI controllers of DOPRI5 and DOP853 (Hairer, Norsett, Wanner I, II.4 and II.5, and IV.2 of volume II).
#[derive(Debug)]
pub(crate) struct Controller {
    exponent: f64,
    beta: f64,
    growth: f64,
    reduction: f64,
    previous_error: f64,
    just_rejected: bool,
}

impl Controller {
    const SAFETY: f64 = 0.9;

    /// For methods of order 5: `beta = 0.04`, growth at most 10, reduction at most to a fifth; for those of
    /// order 8: no memory, growth at most 6, reduction at most to a third.
    pub(crate) fn new(order: u32) -> Self {
        let (beta, growth, reduction) = if order < 8 { (0.04, 10.0, 0.2) } else { (0.0, 6.0, 1.0 / 3.0) };
        Self {
            exponent: 1.0 / f64::from(order) - 0.75 * beta,
            beta,
            growth,
            reduction,
            previous_error: 1e-4,
            just_rejected: false,
        }
    }

    pub(crate) fn restart(&mut self) {
        self.previous_error = 1e-4;
        self.just_rejected = false;
    }

    /// Factor for the step size after a step accepted with this error norm.
    pub(crate) fn accepted(&mut self, error: f64) -> f64 {
        let factor = error.powf(self.exponent) / self.previous_error.powf(self.beta) / Self::SAFETY;
        let growth = if self.just_rejected { 1.0 } else { self.growth };
        self.previous_error = error.max(1e-4);
        self.just_rejected = false;
        (1.0 / factor).clamp(self.reduction, growth)
    }

    /// Factor for the step size after a step rejected with this error norm.
    pub(crate) fn rejected(&mut self, error: f64) -> f64 {
        self.just_rejected = true;
        (Self::SAFETY / error.powf(self.exponent)).clamp(self.reduction, 0.9)
    }

    /// Factor for the step size after a point that the model refused.
    pub(crate) fn discarded(&mut self) -> f64 {
        self.just_rejected = true;
        0.25
    }
}

/// First guess of a step size: HNW I, II.4, steps a) and b): an explicit Euler step of this length changes
/// the solution by a hundredth of its norm.
pub(crate) fn probe_step(weights: &Weights, x: &[f64], dx: &[f64], span: f64) -> f64 {
    let (d0, d1) = (weights.norm(x, x), weights.norm(x, dx));
    if d0 < 1e-5 || d1 < 1e-5 { 1e-6 * span } else { 0.01 * d0 / d1 }
}

/// The step size from two right-hand sides `probe` apart: HNW I, II.4, steps d) to f).
pub(crate) fn first_step(
    weights: &Weights,
    order: u32,
    x: &[f64],
    dx: &[f64],
    dx_probe: &[f64],
    probe: f64,
) -> f64 {
    let d1 = weights.norm(x, dx);
    let d2 = weights.distance(x, dx_probe, dx) / probe;
    let largest = d1.max(d2);
    if largest <= 1e-15 {
        return 100.0 * probe;
    }
    (0.01 / largest).powf(1.0 / f64::from(order + 1)).min(100.0 * probe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_nominals_are_corrected() {
        let mut w = Weights::default();
        w.set(&Options::default(), &[2.0, 0.0, -3.0, f64::NAN, f64::INFINITY], |_| false);
        let expected = [2e-8, 1e-8, 3e-8, 1e-8, 1e-8];
        for (a, e) in w.atol.iter().zip(expected) {
            assert!((a - e).abs() < 1e-20);
        }
    }

    #[test]
    fn the_norm_is_the_root_mean_square_of_the_weighted_error() {
        let mut w = Weights::default();
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

    #[test]
    fn no_growth_right_after_a_rejection() {
        let mut c = Controller::new(5);
        assert!(c.rejected(100.0) < 0.5);
        assert!(c.accepted(1e-8) <= 1.0);
        assert!(c.accepted(1e-8) > 5.0);
    }
}
