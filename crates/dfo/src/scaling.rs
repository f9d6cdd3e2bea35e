//! The search space: which parameters are free, on which scale they live, and what size a step of one has.
//!
//! Outside, points are always in the user's units and order. Methods see *working coordinates*: one per free
//! parameter, `x` itself on a linear scale (bit for bit, so that tolerances in x stay tolerances in x) and `ln x` on
//! a logarithmic one. The typical size of a coordinate is taken from the user, else from the width of a finite box,
//! else from |x0|, else it is 1.

use crate::bounds::{Bounds, clamp, fold};
use crate::error::Error;

/// The scale on which a parameter is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Transform {
    /// As it is.
    #[default]
    Linear,
    /// By its natural logarithm; only for positive parameters.
    Log,
}

/// How points outside of the box are brought back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum BoundsHandling {
    /// Mirrored at the bound, repeatedly if need be.
    #[default]
    Mirror,
    /// Set onto the bound.
    Clamp,
}

/// A checked start point with its box, scales and sizes.
#[derive(Debug, Clone, PartialEq)]
pub struct Space {
    x0: Vec<f64>,
    bounds: Bounds,
    free: Vec<usize>,
    transforms: Vec<Transform>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    sizes: Vec<f64>,
    size_given: Vec<bool>,
    /// Whether the user's bounds are finite on both sides (in working coordinates).
    boxed: Vec<bool>,
}

/// Logarithms of about the smallest and the largest normal number, with room for rounding.
const LN_RANGE: (f64, f64) = (-708.0, 709.0);

impl Space {
    /// Checks everything. `transforms` and `sizes` may be empty (all linear, all sizes by default); a size of a
    /// logarithmic parameter is in units of `ln x`.
    ///
    /// # Errors
    /// Lengths that differ, a start point that is empty, not finite or outside, a logarithmic parameter that is not
    /// positive, a size that is not positive and finite.
    pub fn new(x0: &[f64], bounds: Bounds, transforms: &[Transform], sizes: &[f64]) -> Result<Self, Error> {
        let n = x0.len();
        if n == 0 {
            return Err(Error::Empty);
        }
        for (what, got, optional) in [
            ("bounds", bounds.len(), false),
            ("transforms", transforms.len(), true),
            ("scales", sizes.len(), true),
        ] {
            if got != n && !(optional && got == 0) {
                return Err(Error::Length { what, expected: n, got });
            }
        }
        let mut space = Self {
            x0: x0.to_vec(),
            bounds,
            free: Vec::new(),
            transforms: Vec::new(),
            lower: Vec::new(),
            upper: Vec::new(),
            sizes: Vec::new(),
            size_given: Vec::new(),
            boxed: Vec::new(),
        };
        for index in 0..n {
            let transform = transforms.get(index).copied().unwrap_or_default();
            let size = sizes.get(index).copied();
            if let Some(value) = size.filter(|s| !(*s > 0.0 && s.is_finite())) {
                let range = "positive and finite";
                return Err(Error::ParameterOption { name: "scale", index, value, range });
            }
            space.add(index, transform, size)?;
        }
        Ok(space)
    }

    fn add(&mut self, index: usize, transform: Transform, size: Option<f64>) -> Result<(), Error> {
        let (value, lower, upper) = (self.x0[index], self.bounds.lower()[index], self.bounds.upper()[index]);
        if !value.is_finite() {
            return Err(Error::StartNotFinite { index, value });
        }
        if !(lower <= value && value <= upper) {
            return Err(Error::StartOutside { index, value, lower, upper });
        }
        if lower == upper {
            return Ok(());
        }
        let (lo, hi, default) = match transform {
            Transform::Linear => (lower, upper, if value != 0.0 { value.abs() } else { 1.0 }),
            Transform::Log => {
                let no_logarithm = |what, value| Err(Error::LogScale { index, what, value });
                if value <= 0.0 {
                    return no_logarithm("start value", value);
                }
                if lower < 0.0 && lower.is_finite() {
                    return no_logarithm("lower bound", lower);
                }
                (lower.max(0.0).ln(), upper.ln(), 1.0)
            }
        };
        let width = hi - lo;
        // An open side of a logarithmic parameter ends where exp(u) leaves the normal numbers.
        let (lo, hi) = match transform {
            Transform::Linear => (lo, hi),
            Transform::Log => (lo.max(LN_RANGE.0).min(value.ln()), hi.min(LN_RANGE.1).max(value.ln())),
        };
        self.free.push(index);
        self.transforms.push(transform);
        self.lower.push(lo);
        self.upper.push(hi);
        self.sizes.push(size.unwrap_or(if width.is_finite() { width } else { default }));
        self.size_given.push(size.is_some());
        self.boxed.push(width.is_finite());
        Ok(())
    }

    /// Number of parameters, the fixed ones included.
    pub fn n(&self) -> usize {
        self.x0.len()
    }

    /// Number of free parameters: the dimension in which a method searches.
    pub fn n_free(&self) -> usize {
        self.free.len()
    }

    /// Indices of the free parameters.
    pub fn free(&self) -> &[usize] {
        &self.free
    }

    /// The start point.
    pub fn x0(&self) -> &[f64] {
        &self.x0
    }

    /// The box in the user's units.
    pub fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// Scale of free parameter `k`.
    pub fn transform(&self, k: usize) -> Transform {
        self.transforms[k]
    }

    /// Bounds of working coordinate `k`.
    pub fn working_bounds(&self, k: usize) -> (f64, f64) {
        (self.lower[k], self.upper[k])
    }

    /// Typical size of working coordinate `k`: the unit of a relative `x_tol`.
    pub fn size(&self, k: usize) -> f64 {
        self.sizes[k]
    }

    /// Whether the user gave the size of working coordinate `k`.
    pub fn size_given(&self, k: usize) -> bool {
        self.size_given[k]
    }

    /// Width of the box along working coordinate `k`, if the user's bounds make it finite.
    pub fn width(&self, k: usize) -> Option<f64> {
        self.boxed[k].then(|| self.upper[k] - self.lower[k])
    }

    /// Working coordinates of a point (`x` of length [`n`](Self::n), `u` of length [`n_free`](Self::n_free)).
    pub fn to_working(&self, x: &[f64], u: &mut [f64]) {
        for (k, &i) in self.free.iter().enumerate() {
            u[k] = match self.transforms[k] {
                Transform::Linear => x[i],
                Transform::Log => x[i].ln().clamp(self.lower[k], self.upper[k]),
            };
        }
    }

    /// The point of given working coordinates; always inside of the box if they are.
    pub fn to_user(&self, u: &[f64], x: &mut [f64]) {
        x.copy_from_slice(&self.x0);
        for (k, &i) in self.free.iter().enumerate() {
            x[i] = match self.transforms[k] {
                Transform::Linear => u[k],
                Transform::Log => u[k].exp().clamp(self.bounds.lower()[i], self.bounds.upper()[i]),
            };
        }
    }

    /// Brings working coordinate `k` into its bounds; `fallback`, a value inside, stands in for what is not finite.
    pub fn bring_inside(&self, k: usize, u: f64, fallback: f64, handling: BoundsHandling) -> f64 {
        match handling {
            BoundsHandling::Mirror => fold(u, self.lower[k], self.upper[k], fallback),
            BoundsHandling::Clamp => clamp(u, self.lower[k], self.upper[k], fallback),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INF: f64 = f64::INFINITY;

    #[test]
    fn sizes_come_from_user_then_box_then_start_then_one() -> Result<(), Error> {
        let bounds = Bounds::new(&[0.0, 0.0, -INF, -INF], &[4.0, INF, INF, 2.0])?;
        let space = Space::new(&[1.0, 3.0, 0.0, -5.0], bounds.clone(), &[], &[])?;
        assert_eq!([0, 1, 2, 3].map(|k| space.size(k)), [4.0, 3.0, 1.0, 5.0]);
        let space = Space::new(&[1.0, 3.0, 0.0, -5.0], bounds, &[], &[0.1, 0.2, 0.3, 0.4])?;
        assert_eq!([0, 1, 2, 3].map(|k| space.size(k)), [0.1, 0.2, 0.3, 0.4]);
        Ok(())
    }

    #[test]
    fn fixed_parameters_keep_their_value() -> Result<(), Error> {
        let space = Space::new(&[1.0, 7.0, 2.0], Bounds::new(&[0.0, 7.0, 0.0], &[4.0, 7.0, 4.0])?, &[], &[])?;
        let mut x = [0.0; 3];
        space.to_user(&[3.0, 3.5], &mut x);
        assert_eq!((space.n_free(), x), (2, [3.0, 7.0, 3.5]));
        Ok(())
    }

    #[test]
    fn log_parameters_stay_in_their_box() -> Result<(), Error> {
        let space = Space::new(&[0.3], Bounds::new(&[0.1], &[10.0])?, &[Transform::Log], &[])?;
        assert!((space.size(0) - 100.0f64.ln()).abs() < 1e-14);
        let (lo, hi) = space.working_bounds(0);
        for (u, expected) in [(lo, 0.1), (hi, 10.0)] {
            let mut x = [0.0];
            space.to_user(&[u], &mut x);
            assert!((x[0] - expected).abs() < 1e-14 * expected && space.bounds().contains(&x));
        }
        let half_open = Space::new(&[0.3], Bounds::new(&[0.0], &[10.0])?, &[Transform::Log], &[])?;
        assert_eq!((half_open.width(0), half_open.size(0)), (None, 1.0));
        Ok(())
    }

    #[test]
    fn what_has_no_logarithm_is_an_error() -> Result<(), Error> {
        let log = [Transform::Log];
        let zero = Space::new(&[0.0], Bounds::unbounded(1), &log, &[]);
        assert!(matches!(zero, Err(Error::LogScale { index: 0, what: "start value", .. })));
        let negative = Space::new(&[1.0], Bounds::new(&[-1.0], &[2.0])?, &log, &[]);
        assert!(matches!(negative, Err(Error::LogScale { what: "lower bound", .. })));
        Ok(())
    }
}
