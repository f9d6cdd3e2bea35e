//! Boxes: lower and upper bounds, one-sided bounds and fixed parameters, with folding and clamping into the
//! box.

use crate::error::Error;
use serde::{Deserialize, Serialize};

/// Lower and upper bounds per parameter. An infinite bound means no bound. Equal bounds fix the parameter.
///
/// A box does not determine the size of a parameter if it is more than 100 times as wide as the given size,
/// or as |x0| if no size is given. Methods that start from a point ignore bounds that are far away: at least
/// 1e10 times the largest of 1, |x0| and the given size. Points still stay within such bounds. Methods that
/// sample a box search all of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    lower: Vec<f64>,
    upper: Vec<f64>,
}

impl Bounds {
    /// Creates bounds in the user's units.
    ///
    /// # Errors
    /// Returns an error if the lengths differ, or if a bound is NaN. Also returns an error if a lower bound
    /// is +inf or above the upper bound, or if an upper bound is -inf.
    pub fn new(lower: &[f64], upper: &[f64]) -> Result<Self, Error> {
        if lower.len() != upper.len() {
            return Err(Error::Length { what: "upper bounds", expected: lower.len(), got: upper.len() });
        }
        for (index, (&lo, &hi)) in lower.iter().zip(upper).enumerate() {
            if lo.is_nan() || lo == f64::INFINITY {
                return Err(Error::BadBound { side: "lower", index, value: lo });
            }
            if hi.is_nan() || hi == f64::NEG_INFINITY {
                return Err(Error::BadBound { side: "upper", index, value: hi });
            }
            if lo > hi {
                return Err(Error::BoundsCrossed { index, lower: lo, upper: hi });
            }
        }
        Ok(Self { lower: lower.to_vec(), upper: upper.to_vec() })
    }

    /// Creates infinite bounds for `n` parameters.
    pub fn unbounded(n: usize) -> Self {
        Self { lower: vec![f64::NEG_INFINITY; n], upper: vec![f64::INFINITY; n] }
    }

    /// Returns the number of parameters.
    pub fn len(&self) -> usize {
        self.lower.len()
    }

    /// True if there are no parameters.
    pub fn is_empty(&self) -> bool {
        self.lower.is_empty()
    }

    /// Returns the lower bounds.
    pub fn lower(&self) -> &[f64] {
        &self.lower
    }

    /// Returns the upper bounds.
    pub fn upper(&self) -> &[f64] {
        &self.upper
    }

    /// True if parameter `i` is fixed.
    pub fn is_fixed(&self, i: usize) -> bool {
        self.lower[i] == self.upper[i]
    }

    /// True if the point is in the box. False for a point of another length.
    pub fn contains(&self, x: &[f64]) -> bool {
        x.len() == self.len()
            && x.iter().zip(&self.lower).zip(&self.upper).all(|((&x, &lo), &hi)| lo <= x && x <= hi)
    }
}

/// Mirrors `u` at the bounds until it is inside. Returns `fallback`, a point inside, if the arithmetic
/// overflows.
pub(crate) fn fold(u: f64, lower: f64, upper: f64, fallback: f64) -> f64 {
    if !u.is_finite() {
        return fallback;
    }
    if lower <= u && u <= upper {
        return u;
    }
    let folded = if upper == f64::INFINITY {
        lower + (lower - u)
    } else if lower == f64::NEG_INFINITY {
        upper - (u - upper)
    } else {
        let width = upper - lower;
        let t = (u - lower).rem_euclid(2.0 * width);
        (lower + if t > width { 2.0 * width - t } else { t }).clamp(lower, upper)
    };
    if folded.is_finite() { folded } else { fallback }
}

/// Returns the nearest value within the bounds; `fallback` for values that are not finite.
pub(crate) fn clamp(u: f64, lower: f64, upper: f64, fallback: f64) -> f64 {
    if u.is_finite() { u.clamp(lower, upper) } else { fallback }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INF: f64 = f64::INFINITY;

    #[test]
    fn folding_mirrors_at_both_ends() {
        for (u, expected) in
            [(0.25, 0.25), (1.25, 0.75), (-0.25, 0.25), (2.25, 0.25), (3.25, 0.75), (-1.5, 0.5)]
        {
            assert_eq!(fold(u, 0.0, 1.0, 0.5), expected, "{u}");
        }
        assert_eq!(fold(-3.0, -1.0, INF, 0.0), 1.0);
        assert_eq!(fold(3.0, -INF, 1.0, 0.0), -1.0);
        assert_eq!(fold(1e300, -INF, INF, 0.0), 1e300);
    }

    #[test]
    fn folding_never_leaves_the_box() {
        let values = [0.0, 1.0, -1.0, 1e-300, 1e300, -1e300, f64::MAX, f64::MIN, 0.1 + 0.2, 1e17];
        let boxes = [
            (0.0, 1.0),
            (0.1, 0.1 + f64::EPSILON),
            (-1e300, 1e300),
            (f64::MIN, f64::MAX),
            (3.0, INF),
            (-INF, -2.0),
        ];
        for u in values.into_iter().chain([f64::NAN, INF, -INF]) {
            for (lo, hi) in boxes {
                let inside = 0.0f64.clamp(lo, hi);
                for v in [fold(u, lo, hi, inside), clamp(u, lo, hi, inside)] {
                    assert!(lo <= v && v <= hi && v.is_finite(), "{u} in [{lo}, {hi}] gives {v}");
                }
            }
        }
    }

    #[test]
    fn errors_name_bad_bounds() {
        let crossed = Bounds::new(&[0.0, 2.0], &[1.0, 1.0]);
        assert_eq!(crossed, Err(Error::BoundsCrossed { index: 1, lower: 2.0, upper: 1.0 }));
        assert!(matches!(
            Bounds::new(&[f64::NAN], &[1.0]),
            Err(Error::BadBound { side: "lower", index: 0, .. })
        ));
        assert!(matches!(
            Bounds::new(&[0.0], &[f64::NAN]),
            Err(Error::BadBound { side: "upper", index: 0, .. })
        ));
        assert!(matches!(Bounds::new(&[INF], &[INF]), Err(Error::BadBound { side: "lower", .. })));
        assert!(matches!(Bounds::new(&[-INF], &[-INF]), Err(Error::BadBound { side: "upper", .. })));
        assert!(matches!(Bounds::new(&[0.0], &[]), Err(Error::Length { expected: 1, got: 0, .. })));
    }
}
