//! Robust losses, which reduce the weight of large residuals.

use crate::error::Error;
use crate::outcome::answer::Outcome;
use crate::values::record::{Record, RecordError, Value};
use serde::{Deserialize, Serialize};
use std::f64::consts::SQRT_2;
use std::fmt;

/// Contribution of a residual to the cost: `rho((r / scale)^2) scale^2`, with the functions rho of SciPy's
/// `least_squares`.
///
/// For small residuals, every loss equals the square of the residual.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Loss {
    /// `rho(z) = z`: the square.
    #[default]
    Linear,
    /// `rho(z) = 2 (sqrt(1 + z) - 1)`: grows like the absolute value.
    #[serde(alias = "soft_l1")]
    SoftL1,
    /// `rho(z) = z` up to 1, `2 sqrt(z) - 1` beyond (Huber, Ann. Math. Statist. 35, 1964).
    Huber,
    /// `rho(z) = ln(1 + z)`: outliers count almost nothing. The cost may have several minima.
    Cauchy,
}

/// A loss and its scale. Residuals that are small relative to the scale count with their squares.
///
/// Every residual r is replaced with `s(r) = sign(r) scale sqrt(rho((r / scale)^2))`. The sum of squares is
/// then the robust cost, for every method (Triggs, McLauchlan, Hartley and Fitzgibbon, Bundle adjustment: a
/// modern synthesis, 2000, section 3.4).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RobustLoss {
    kind: Loss,
    scale: f64,
    /// Number of residuals at the end of the vector that count with their squares.
    #[serde(default, skip_serializing_if = "is_zero")]
    spared: usize,
}

fn is_zero(n: &usize) -> bool {
    *n == 0
}

impl Default for RobustLoss {
    /// Returns the linear loss.
    fn default() -> Self {
        Self { kind: Loss::Linear, scale: 1.0, spared: 0 }
    }
}

impl fmt::Display for RobustLoss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self.kind {
            Loss::Linear => return f.write_str("linear"),
            Loss::SoftL1 => "soft-l1",
            Loss::Huber => "huber",
            Loss::Cauchy => "cauchy",
        };
        write!(f, "{name}, scale {:?}", self.scale)
    }
}

impl RobustLoss {
    /// Creates a loss. `scale` is in the units of the residuals.
    ///
    /// # Errors
    /// Returns an error if the scale is not between 1e-300 and 1e300.
    pub fn new(kind: Loss, scale: f64) -> Result<Self, Error> {
        if (1e-300..=1e300).contains(&scale) {
            return Ok(Self { kind, scale, spared: 0 });
        }
        Err(Error::Option {
            name: "the scale of the loss",
            value: scale,
            range: "positive (1e-300 to 1e300)",
        })
    }

    /// Reads the loss of a record and removes the options `loss` and `f_scale` from the record. `None` if the
    /// record has no `loss`.
    ///
    /// # Errors
    /// Returns an error if the value of an option is not allowed.
    pub fn from_record(record: &mut Record) -> Result<Option<Self>, Error> {
        let scale = record.remove("f_scale").map(|scale| scale.read("f_scale")).transpose()?;
        match record.remove("loss") {
            Some(loss) => Self::named(Some(loss.read("loss")?), scale),
            None => Ok(None),
        }
    }

    /// Creates the loss with this kind and scale; default scale 1. `None` if there is no kind.
    ///
    /// # Errors
    /// Returns an error if the scale is not allowed.
    pub fn named(kind: Option<Loss>, scale: Option<f64>) -> Result<Option<Self>, Error> {
        let Some(kind) = kind else { return Ok(None) };
        Self::new(kind, scale.unwrap_or(1.0)).map(Some).map_err(|_| {
            let scale = Value::Number(scale.unwrap_or(1.0));
            RecordError::range("positive and finite (1e-300 to 1e300)").of("f_scale", &scale).into()
        })
    }

    /// Exempts the last `n_last` residuals of a vector from this loss. They count with their squares, as the
    /// residuals of priors do.
    pub fn sparing(self, n_last: usize) -> Self {
        Self { spared: if self.is_linear() { 0 } else { n_last }, ..self }
    }

    /// Returns the loss of residual `k` of `n`.
    pub fn of_residual(&self, k: usize, n: usize) -> Self {
        if k + self.spared < n { Self { spared: 0, ..*self } } else { Self::default() }
    }

    /// Applies [`transform`](Self::transform) to each residual.
    pub fn transform_all(&self, residuals: &mut [f64]) {
        let n = residuals.len().saturating_sub(self.spared);
        residuals[..n].iter_mut().for_each(|r| *r = self.transform(*r));
    }

    /// Applies [`inverse`](Self::inverse) to each residual.
    pub fn inverse_all(&self, residuals: &mut [f64]) {
        let n = residuals.len().saturating_sub(self.spared);
        residuals[..n].iter_mut().for_each(|s| *s = self.inverse(*s));
    }

    /// Returns the kind of the loss.
    pub fn kind(&self) -> Loss {
        self.kind
    }

    /// Returns the scale, in the units of the residuals.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// True if residuals are unchanged.
    pub fn is_linear(&self) -> bool {
        self.kind == Loss::Linear
    }

    /// Returns the number whose square is the contribution of the residual. It is exact for small residuals
    /// and does not overflow for large ones. NaN and infinities are returned unchanged.
    #[inline]
    pub fn transform(&self, r: f64) -> f64 {
        if self.is_linear() { r } else { self.bent(r) }
    }

    fn bent(&self, r: f64) -> f64 {
        let (scale, size) = (self.scale, r.abs());
        if !r.is_finite() {
            return r;
        }
        match self.kind {
            Loss::Linear => r,
            // 2 (sqrt(1 + z) - 1) = 2 z / (sqrt(1 + z) + 1), which avoids cancellation.
            Loss::SoftL1 => r * (scale.sqrt() / (0.5 * scale + 0.5 * scale.hypot(r)).sqrt()),
            Loss::Huber if size <= scale => r,
            Loss::Huber => (scale.sqrt() * SQRT_2 * (size - 0.5 * scale).sqrt()).copysign(r),
            Loss::Cauchy => {
                let t = size / scale;
                if t < 1e-8 {
                    r
                } else if t < 1e150 {
                    (scale * (t * t).ln_1p().sqrt()).copysign(r)
                } else {
                    (scale * (2.0 * (size.ln() - scale.ln())).sqrt()).copysign(r)
                }
            }
        }
    }

    /// Transforms the residuals in place ([`transform`](Self::transform)) and returns their cost, summed from
    /// the first to the last. Stops when the sum strictly exceeds the cutoff. A residual that is not finite
    /// is a failure whose message contains its index.
    pub fn cost(&self, residuals: &mut [f64], cutoff: f64) -> Outcome {
        let mut sum = 0.0;
        let n = residuals.len().saturating_sub(self.spared);
        for (k, r) in residuals.iter_mut().enumerate() {
            *r = if k < n { self.transform(*r) } else { *r };
            sum += *r * *r;
            if !r.is_finite() {
                return Outcome::not_finite(format!("residual {k} is {r}"));
            }
            if sum > cutoff {
                return Outcome::Above(cutoff);
            }
        }
        match sum.is_finite() {
            true if residuals.is_empty() => Outcome::failed("the objective returned no residuals"),
            true => Outcome::Value(sum),
            false => Outcome::not_finite("the sum of the squared residuals is infinite".to_owned()),
        }
    }

    /// Inverts [`transform`](Self::transform), up to rounding.
    pub fn inverse(&self, s: f64) -> f64 {
        let (scale, size) = (self.scale, s.abs());
        let t = size / scale;
        if !s.is_finite() {
            return s;
        }
        match self.kind {
            Loss::Linear => s,
            // With w = t^2 / 2: 1 + z = (1 + w)^2.
            Loss::SoftL1 if t < 1e100 => s * (1.0 + 0.25 * t * t).sqrt(),
            Loss::SoftL1 => 0.5 * s * t,
            Loss::Huber if size <= scale => s,
            Loss::Huber => (0.5 * size * t + 0.5 * scale).copysign(s),
            Loss::Cauchy if t < 1e-8 => s,
            Loss::Cauchy if t < 20.0 => (scale * (t * t).exp_m1().sqrt()).copysign(s),
            Loss::Cauchy => (scale.ln() + 0.5 * t * t).exp().copysign(s),
        }
    }

    /// Returns the derivative of [`transform`](Self::transform) at a residual. It decreases from 1 at zero to
    /// 0.
    pub fn slope(&self, r: f64) -> f64 {
        let (scale, size) = (self.scale, r.abs());
        let t = size / scale;
        match self.kind {
            Loss::Linear => 1.0,
            Loss::SoftL1 => scale.sqrt() * ((0.5 * scale + 0.5 * scale.hypot(r)).sqrt() / scale.hypot(r)),
            Loss::Huber if size <= scale => 1.0,
            Loss::Huber => scale / self.transform(size),
            Loss::Cauchy if t < 1e-8 => 1.0,
            Loss::Cauchy if t < 1e150 => (1.0 + t * t).recip() * (size / self.transform(size)),
            Loss::Cauchy => (scale / size) * (scale / self.transform(size)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(scale: f64) -> [RobustLoss; 4] {
        [Loss::Linear, Loss::SoftL1, Loss::Huber, Loss::Cauchy]
            .map(|kind| RobustLoss::new(kind, scale).unwrap())
    }

    #[test]
    fn spared_residuals_count_with_their_squares() {
        let loss = RobustLoss::new(Loss::Huber, 1.0).unwrap().sparing(1);
        let mut residuals = [3.0, 3.0];
        // 2 * 3 - 1 for the first residual, 9 for the second.
        assert_eq!(loss.cost(&mut residuals, f64::INFINITY), Outcome::Value(residuals[0].powi(2) + 9.0));
        assert!((residuals[0].powi(2) - 5.0).abs() < 1e-14);
        loss.inverse_all(&mut residuals);
        assert!((residuals[0] - 3.0).abs() < 1e-14 && residuals[1] == 3.0);
        loss.transform_all(&mut residuals);
        assert!((residuals[0].powi(2) - 5.0).abs() < 1e-14 && residuals[1] == 3.0);
        assert_eq!(loss.of_residual(0, 2).kind(), Loss::Huber);
        assert!(loss.of_residual(1, 2).is_linear() && !loss.is_linear());
        let stored = serde_json::to_string(&loss).unwrap();
        assert_eq!(serde_json::from_str::<RobustLoss>(&stored).unwrap(), loss);
    }

    #[test]
    fn reduced_squares_match_scipy() {
        // scipy.optimize._lsq.least_squares: rho at z = 0.25 and z = 9.
        let z = [0.25f64, 9.0];
        let expected = [
            z,
            z.map(|z| 2.0 * ((1.0 + z).sqrt() - 1.0)),
            [0.25, 2.0 * 3.0 - 1.0],
            z.map(|z| (1.0 + z).ln()),
        ];
        for (loss, rho) in all(2.0).iter().zip(expected) {
            for (r, rho) in [(1.0, rho[0]), (-6.0, rho[1])] {
                let s = loss.transform(r);
                assert!((s * s - 4.0 * rho).abs() < 1e-13 && s.signum() == f64::signum(r), "{loss} {r} {s}");
            }
        }
    }

    #[test]
    fn transform_keeps_small_residuals_and_does_not_overflow() {
        for loss in [1e-300, 1e-6, 1.0, 1e6, 1e300].into_iter().flat_map(all) {
            assert_eq!(loss.transform(0.0), 0.0);
            assert_eq!(loss.transform(1e-9 * loss.scale), 1e-9 * loss.scale);
            assert!(loss.transform(f64::NAN).is_nan() && loss.slope(f64::NAN).is_nan() != loss.is_linear());
            let mut last = 0.0;
            for exponent in -320..=308 {
                let r = 10f64.powi(exponent).min(f64::MAX);
                let s = loss.transform(r);
                assert!(s.is_finite() && s >= last && s <= r * (1.0 + 4.0 * f64::EPSILON), "{loss} {r} {s}");
                assert_eq!(loss.transform(-r), -s);
                let slope = loss.slope(r);
                assert!((0.0..=1.0 + 1e-12).contains(&slope), "{loss} {r} {slope}");
                last = s;
                // The inverse returns r within the rounding of the logarithm, unless the square underflows.
                let back = loss.inverse(s);
                assert!((back / r - 1.0).abs() < 1e-12 || s == 0.0 || r < 1e-300, "{loss} {r} {s} {back}");
            }
        }
    }

    #[test]
    fn slope_matches_derivative_of_transform() {
        for loss in all(0.5) {
            for r in [-3.0, -0.4, 1e-3, 0.3, 2.0, 1e3] {
                let h = 1e-6 * f64::max(1.0, f64::abs(r));
                let difference = (loss.transform(r + h) - loss.transform(r - h)) / (2.0 * h);
                assert!((loss.slope(r) - difference).abs() < 1e-7, "{loss} {r}");
            }
        }
    }

    #[test]
    fn invalid_scales_are_rejected() {
        for scale in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(RobustLoss::new(Loss::Huber, scale).is_err());
        }
    }
}
