//! Map between the user's parameters and the coordinates that methods see.

use super::bounds::{Bounds, clamp, fold};
use super::linear_set::LinearSet;
use crate::error::Error;
use crate::problem::option_texts;
use crate::values::choices::{BoundsHandling, ParameterKind, ToleranceMeasure, Transform};
use serde::{Deserialize, Serialize};

/// A validated start point with its box, scales and sizes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Space {
    pub(super) x0: Vec<f64>,
    pub(super) bounds: Bounds,
    pub(super) free: Vec<usize>,
    pub(super) transforms: Vec<Transform>,
    pub(super) kinds: Vec<ParameterKind>,
    pub(super) lower: Vec<f64>,
    pub(super) upper: Vec<f64>,
    pub(super) sizes: Vec<f64>,
    pub(super) size_given: Vec<bool>,
    /// True if the size is unknown and was set to 1.
    pub(super) size_unknown: Vec<bool>,
    /// True if working coordinates are angles or hyperbolic coordinates, see [`BoundsHandling::Sine`].
    pub(super) sine: bool,
    /// Sizes of the parameters themselves, for use with `sine`. They are also the unit of the hyperbola at a
    /// single bound.
    pub(super) units: Vec<f64>,
    /// True if the user's bounds are finite on both sides (in working coordinates).
    pub(super) boxed: Vec<bool>,
    /// True if this is the space of a search that starts from a point, see
    /// [`without_far_bounds`](Self::without_far_bounds).
    #[serde(default)]
    pub(super) is_local: Local,
    /// For the lower and the upper bound: true if the bound is ignored, see
    /// [`without_far_bounds`](Self::without_far_bounds).
    pub(super) far: Vec<[bool; 2]>,
    /// Linear constraints.
    #[serde(default, skip_serializing_if = "LinearSet::is_empty")]
    pub(super) linear: LinearSet,
}

/// True for the space of a search that starts from a point. The method determines this flag, so two spaces
/// never differ by it alone. Files written before the flag existed can be read.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(super) struct Local(bool);

impl PartialEq for Local {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// Relative width of a box beyond which the box does not determine the size of the parameter.
const WIDE: f64 = 100.0;

/// Relative distance of a bound beyond which the bound is ignored. Beyond it, the rounding error of an angle
/// between the bounds (1e-16 of the width) exceeds the default `x_tol` of 1e-6 near the start.
const FAR: f64 = 1e10;

/// Magnitude of a start value below which it counts as zero. Parameters in SI units range from a capacitance
/// of 1e-12 F to a modulus of elasticity of 1e11 Pa.
const ZERO: f64 = 1e-12;

/// Magnitude of a start value below which it is only a first guess of the size, if nothing else determines
/// the size. The parameter may be this small, or the start may represent zero. The value is the square root
/// of the rounding unit.
const TINY: f64 = 1.5e-8;

/// Logarithms of approximately the smallest and the largest normal number, with a margin for rounding.
const LN_RANGE: (f64, f64) = (-708.0, 709.0);

/// Largest number up to which every integer is represented exactly.
const LARGEST_WHOLE: f64 = 9_007_199_254_740_992.0;

/// Returns the typical size of a parameter on its scale, if it can be determined. The given size takes
/// precedence. Next comes the width of the box, unless it is more than 100 times |start|. Otherwise, the size
/// is |start|, or 1 on a logarithmic scale.
///
/// A logarithmic box determines the size if it extends by at most a factor of 100 to each side of its middle.
/// If a parameter starts at zero (below 1e-12 in magnitude), a box of width up to 100 determines its size.
///
/// [`Space`] uses the same rule. The function is public for code that changes parameters by a fraction of
/// their size.
pub fn typical_size(
    transform: Transform,
    start: f64,
    (lower, upper): (f64, f64),
    given: Option<f64>,
) -> Option<f64> {
    let (width, magnitude) = match transform {
        Transform::Linear => (upper - lower, magnitude_of(start)),
        Transform::Log => (upper.ln() - lower.max(0.0).ln(), 1.0),
    };
    let of_box = Some(width).filter(|width| *width > 0.0 && *width <= widest(transform, magnitude_of(start)));
    given.or(of_box).or(Some(magnitude).filter(|size| *size > 0.0 && size.is_finite()))
}

/// Returns the magnitude of a value; 0 if it counts as zero.
fn magnitude_of(value: f64) -> f64 {
    if value.abs() < ZERO { 0.0 } else { value.abs() }
}

/// Returns the width of the widest box that determines the size of a parameter of this magnitude.
fn widest(transform: Transform, magnitude: f64) -> f64 {
    match transform {
        Transform::Linear => (WIDE * if magnitude > 0.0 { magnitude } else { 1.0 }).min(f64::MAX),
        Transform::Log => 2.0 * WIDE.ln(),
    }
}

/// The range of a working coordinate that rounds to one integer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct IntegerCell {
    pub(crate) low: f64,
    pub(crate) centre: f64,
    pub(crate) high: f64,
}

impl Space {
    /// Checks and creates a space. `transforms` and `sizes` may be empty (all linear, all default sizes). The
    /// size of a logarithmic parameter is in units of `ln x`.
    ///
    /// # Errors
    /// Returns an error if lengths differ, or if the start point is empty, not finite or outside the box.
    /// Also returns an error if a logarithmic parameter is not positive, or if a size is not positive and
    /// finite.
    pub fn new(
        x0: &[f64],
        bounds: Bounds,
        transforms: &[Transform],
        sizes: &[Option<f64>],
    ) -> Result<Self, Error> {
        let n = x0.len();
        if n == 0 {
            return Err(Error::Empty);
        }
        for (what, got, optional) in [
            ("bounds", bounds.len(), false),
            ("transforms", transforms.len(), true),
            ("nominal sizes", sizes.len(), true),
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
            kinds: Vec::new(),
            lower: Vec::new(),
            upper: Vec::new(),
            sizes: Vec::new(),
            size_given: Vec::new(),
            size_unknown: Vec::new(),
            sine: false,
            units: Vec::new(),
            boxed: Vec::new(),
            is_local: Local(false),
            far: Vec::new(),
            linear: LinearSet::default(),
        };
        for index in 0..n {
            let transform = transforms.get(index).copied().unwrap_or_default();
            let size = sizes.get(index).copied().flatten();
            if let Some(value) = size.filter(|s| !(*s > 0.0 && s.is_finite())) {
                let range = "positive and finite";
                return Err(Error::ParameterOption { name: "nominal size", index, value, range });
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
        let (lo, hi) = match transform {
            Transform::Linear => (lower, upper),
            Transform::Log => {
                let no_logarithm = |what, value| Err(Error::LogScale { index, what, value });
                if value <= 0.0 {
                    return no_logarithm("start value", value);
                }
                if lower <= 0.0 && lower.is_finite() {
                    return no_logarithm("lower bound", lower);
                }
                (lower.max(0.0).ln(), upper.ln())
            }
        };
        let width = hi - lo;
        // An unbounded side of a logarithmic parameter ends at the limit of the normal numbers for exp(u).
        let (lo, hi) = match transform {
            Transform::Linear => (lo, hi),
            Transform::Log => (lo.max(LN_RANGE.0).min(value.ln()), hi.min(LN_RANGE.1).max(value.ln())),
        };
        self.free.push(index);
        self.transforms.push(transform);
        self.kinds.push(ParameterKind::Continuous);
        self.lower.push(lo);
        self.upper.push(hi);
        // For a start at zero, a wide box determines the size only for a search of the box itself.
        let typical = typical_size(transform, value, (lower, upper), size);
        self.sizes.push(typical.unwrap_or(if width.is_finite() && width > 0.0 { width } else { 1.0 }));
        self.size_given.push(size.is_some());
        let linear = transform == Transform::Linear;
        self.size_unknown.push(linear && value.abs() < TINY && size.is_none() && width.is_infinite());
        self.boxed.push(width.is_finite());
        self.far.push([false; 2]);
        Ok(())
    }

    /// Returns this problem for a search that starts from a point. A box that is too wide to determine a size
    /// has no [`width`](Self::width). For a linear parameter, bounds beyond 1e10 times the largest of 1, |x0|
    /// and the given size are ignored. The coordinates are then the same as for a parameter without bounds,
    /// and points are clamped to the bounds.
    pub(crate) fn without_far_bounds(&self) -> Self {
        let mut space = Self { is_local: Local(true), ..self.clone() };
        for (k, &i) in self.free.iter().enumerate().filter(|(k, _)| self.transforms[*k] == Transform::Linear)
        {
            let (value, size) =
                (magnitude_of(self.x0[i]), if self.size_given[k] { self.sizes[k] } else { 0.0 });
            let limit = FAR * value.max(size).max(1.0);
            let far = [self.lower[k], self.upper[k]].map(|bound| bound.is_finite() && bound.abs() >= limit);
            space.far[k] = far;
            space.boxed[k] &= far == [false; 2];
            if value < TINY && !self.size_given[k] && space.width(k).is_none() {
                (space.sizes[k], space.size_unknown[k]) = (if value > 0.0 { value } else { 1.0 }, true);
            }
        }
        space
    }

    /// Returns this space with |x0| as the size of each linear parameter if a box is too wide to determine
    /// the size of any of them. Otherwise, a box just below the limit and one just above it would give sizes
    /// that differ by a factor of 100. Given sizes, and the sizes of parameters that start at zero, are kept.
    pub(crate) fn with_comparable_sizes(mut self) -> Self {
        let is_default = |k: usize| self.transforms[k] == Transform::Linear && !self.size_given[k];
        let has_wide_box = |k: usize| (self.upper[k] - self.lower[k]).is_finite() && self.is_wide(k);
        if (0..self.n_free()).any(|k| is_default(k) && has_wide_box(k)) {
            for (k, &i) in self.free.iter().enumerate() {
                let magnitude = magnitude_of(self.x0[i]);
                if self.transforms[k] == Transform::Linear && !self.size_given[k] && magnitude >= TINY {
                    self.sizes[k] = magnitude;
                }
            }
        }
        self
    }

    /// True if the box is too wide to determine the size of coordinate `k`, see [`typical_size`].
    fn is_wide(&self, k: usize) -> bool {
        let size_given_by_user = self.size_given[k].then(|| self.sizes[k]);
        let magnitude = size_given_by_user.unwrap_or(magnitude_of(self.x0[self.free[k]]));
        self.upper[k] - self.lower[k] > widest(self.transforms[k], magnitude)
    }

    /// True if coordinate `k` has no effective bound.
    pub(crate) fn is_open(&self, k: usize) -> bool {
        let (lower, upper) = self.working_bounds(k);
        (lower == f64::NEG_INFINITY || self.far[k][0]) && (upper == f64::INFINITY || self.far[k][1])
    }

    /// Makes parameters discrete; `kinds` has one entry per parameter. Working coordinates of discrete
    /// parameters stay real, and [`to_user`](Self::to_user) rounds them. A linear range is extended by half a
    /// unit at each end, so each integer has an equal part of it.
    ///
    /// # Errors
    /// Returns an error if the number of kinds is not the number of parameters. For a discrete parameter,
    /// returns an error if its start value is not an integer, or if there is no integer between its bounds.
    /// Also returns an error if its bounds exceed 2^53, beyond which integers are not represented exactly.
    pub fn with_kinds(mut self, kinds: &[ParameterKind]) -> Result<Self, Error> {
        if kinds.len() != self.n() {
            return Err(Error::Length { what: "kinds", expected: self.n(), got: kinds.len() });
        }
        for (k, &index) in self.free.iter().enumerate() {
            self.kinds[k] = kinds[index];
            let value = self.x0[index];
            if kinds[index] == ParameterKind::Continuous {
                continue;
            }
            let ends = [self.bounds.lower()[index], self.bounds.upper()[index]];
            if ends[0].ceil() > ends[1].floor() {
                return Err(Error::NoWholeNumber { index, lower: ends[0], upper: ends[1] });
            }
            if let Some(value) = ends.into_iter().find(|b| b.is_finite() && b.abs() > LARGEST_WHOLE) {
                let range = "at most 2^53 in magnitude, because the parameter is discrete";
                return Err(Error::ParameterOption { name: "bound", index, value, range });
            }
            if value != value.round() {
                let range = "an integer, because the parameter is discrete";
                return Err(Error::ParameterOption { name: "start value", index, value, range });
            }
            if self.transforms[k] == Transform::Linear {
                self.lower[k] = self.lower[k].ceil() - 0.5;
                self.upper[k] = self.upper[k].floor() + 0.5;
            }
        }
        Ok(self)
    }

    /// True if two points of the working space are equal up to rounding.
    pub(crate) fn is_same(&self, u: &[f64], v: &[f64]) -> bool {
        u.iter().zip(v).enumerate().all(|(k, (u, v))| {
            // The rounding error of ln x is absolute, the rounding error of x relative. Values that are tiny
            // relative to the size count as zero.
            let magnitude = match self.transforms[k] {
                Transform::Linear => v.abs().max(f64::EPSILON * self.sizes[k]),
                Transform::Log => v.abs().max(1.0),
            };
            (u - v).abs() <= 2.0 * f64::EPSILON * magnitude
        })
    }

    /// Returns the kind of free parameter `k`.
    pub fn kind(&self, k: usize) -> ParameterKind {
        self.kinds[k]
    }

    /// Returns the integer nearest to working coordinate `u` of a discrete parameter `k`, and the ends of the
    /// range that rounds to it, all as working coordinates. The ends of the outermost ranges are infinite.
    pub(crate) fn integer_cell(&self, k: usize, u: f64) -> IntegerCell {
        let i = self.free[k];
        let (lower, upper) = (self.bounds.lower()[i].ceil(), self.bounds.upper()[i].floor());
        let (value, working): (f64, fn(f64) -> f64) = match self.transforms[k] {
            Transform::Linear => (u, |x| x),
            Transform::Log => (u.exp(), f64::ln),
        };
        let value = value.round().clamp(lower, upper);
        IntegerCell {
            low: if value > lower { working(value - 0.5) } else { f64::NEG_INFINITY },
            centre: working(value),
            high: if value < upper { working(value + 0.5) } else { f64::INFINITY },
        }
    }

    /// Checks that all free parameters are continuous, for methods that require it.
    ///
    /// # Errors
    /// Returns an error with the first parameter that is not continuous.
    pub fn require_continuous(&self, method: &'static str) -> Result<(), Error> {
        match self.kinds.iter().position(|k| *k != ParameterKind::Continuous) {
            Some(k) => Err(Error::NotContinuous { method, index: self.free[k], kind: self.kinds[k] }),
            None => Ok(()),
        }
    }

    /// Checks that no free parameter is categorical, for methods that require an order of the values.
    ///
    /// # Errors
    /// Returns an error with the first categorical parameter.
    pub(crate) fn forbid_categorical(&self, method: &'static str) -> Result<(), Error> {
        match self.kinds.iter().position(|k| *k == ParameterKind::Categorical) {
            Some(k) => Err(Error::NotContinuous { method, index: self.free[k], kind: self.kinds[k] }),
            None => Ok(()),
        }
    }

    /// Checks that all free parameters have a finite range, for methods that search a box.
    ///
    /// # Errors
    /// Returns an error with the first parameter without a finite range, or whose range has no finite width.
    pub fn require_box(&self, method: &'static str) -> Result<(), Error> {
        let endless = (0..self.n_free()).find(|&k| self.width(k).is_none_or(|w| !w.is_finite()));
        match endless.map(|k| self.free[k]) {
            Some(index) => {
                let (lower, upper) = (self.bounds.lower()[index], self.bounds.upper()[index]);
                Err(Error::NeedsBox { method, index, lower, upper })
            }
            None => Ok(()),
        }
    }

    /// Returns bounds, scales, kinds and sizes as text, for a fingerprint.
    pub(crate) fn describe(&self) -> Vec<(String, String)> {
        let Self { bounds, free, transforms, kinds, sizes, size_given, .. } = self;
        let given = free.iter().zip(size_given).filter(|(_, given)| **given).map(|(index, _)| index);
        [
            ("lower bounds", option_texts::numbers(bounds.lower())),
            ("upper bounds", option_texts::numbers(bounds.upper())),
            ("free parameters", option_texts::word(free)),
            ("scales", option_texts::word(transforms)),
            ("kinds", option_texts::word(kinds)),
            ("sizes", option_texts::numbers(sizes)),
            ("sizes given for parameters", option_texts::word(&given.collect::<Vec<_>>())),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into_iter()
        .chain(self.describe_linear())
        .collect()
    }

    /// True if the point is strictly between the bounds of all free parameters.
    pub(crate) fn is_inside(&self, x: &[f64]) -> bool {
        let (lower, upper) = (self.bounds.lower(), self.bounds.upper());
        self.free.iter().all(|&i| lower[i] < x[i] && x[i] < upper[i])
    }

    /// Returns this space with another start point inside the box.
    pub(crate) fn starting_at(&self, x0: &[f64]) -> Self {
        Self { x0: x0.to_vec(), ..self.clone() }
    }

    /// Returns the number of parameters, including fixed ones.
    pub fn n(&self) -> usize {
        self.x0.len()
    }

    /// Returns the number of free parameters, which is the dimension of the search.
    pub fn n_free(&self) -> usize {
        self.free.len()
    }

    /// Returns the indices of the free parameters.
    pub fn free(&self) -> &[usize] {
        &self.free
    }

    /// Returns the start point.
    pub fn x0(&self) -> &[f64] {
        &self.x0
    }

    /// Returns the box in the user's units.
    pub fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// Returns the scale of free parameter `k`.
    pub fn transform(&self, k: usize) -> Transform {
        self.transforms[k]
    }

    /// Returns the bounds of working coordinate `k`.
    pub fn working_bounds(&self, k: usize) -> (f64, f64) {
        if self.sine { (f64::NEG_INFINITY, f64::INFINITY) } else { (self.lower[k], self.upper[k]) }
    }

    /// Returns the typical size of working coordinate `k`, which is the unit of a relative `x_tol`.
    pub fn size(&self, k: usize) -> f64 {
        self.sizes[k]
    }

    /// True if the user gave the size of working coordinate `k`.
    pub fn size_given(&self, k: usize) -> bool {
        self.size_given[k]
    }

    /// True if the size of parameter `k` is unknown: it starts at or close to zero, without a nominal size
    /// and without a box.
    pub(crate) fn size_is_unknown(&self, k: usize) -> bool {
        self.size_unknown[k]
    }

    /// Returns the typical size of parameter `k` itself, even if its coordinate is an angle.
    pub(crate) fn unit(&self, k: usize) -> f64 {
        if self.sine { self.units[k] } else { self.sizes[k] }
    }

    /// Sets the size, found during the search, of a parameter without a box.
    pub(crate) fn set_unit(&mut self, k: usize, size: f64) {
        if self.sine {
            self.units[k] = size;
        }
        // With one bound, the angle keeps its size, and only the unit of the hyperbola changes.
        if !self.sine || self.limits_of(k) == (f64::NEG_INFINITY, f64::INFINITY) {
            self.sizes[k] = size;
        }
    }

    /// True if two spaces are equal except for sizes found during the search.
    pub(crate) fn is_same_space(&self, other: &Self) -> bool {
        let mut completed = self.clone();
        let unknown = (0..self.n_free()).filter(|&k| self.size_unknown[k]);
        self.n_free() == other.n_free() && {
            unknown.for_each(|k| completed.set_unit(k, other.unit(k)));
            completed == *other
        }
    }

    /// Returns the width of the box along working coordinate `k`, if the user's bounds make it finite. For a
    /// search that starts from a point, the box must also determine the size of the parameter.
    pub fn width(&self, k: usize) -> Option<f64> {
        (self.boxed[k] && !(self.is_local.0 && self.is_wide(k))).then(|| self.upper[k] - self.lower[k])
    }

    /// Computes the working coordinates of a point (`x` of length [`n`](Self::n), `u` of length
    /// [`n_free`](Self::n_free)).
    pub fn to_working(&self, x: &[f64], u: &mut [f64]) {
        for (k, &i) in self.free.iter().enumerate() {
            u[k] = match self.transforms[k] {
                Transform::Linear => x[i],
                Transform::Log => x[i].ln().clamp(self.lower[k], self.upper[k]),
            };
            if self.sine {
                u[k] = self.unfold(k, u[k]);
            }
        }
    }

    /// Computes the point of given working coordinates. It is in the box if they are within their bounds.
    pub fn to_user(&self, u: &[f64], x: &mut [f64]) {
        x.copy_from_slice(&self.x0);
        for (k, &i) in self.free.iter().enumerate() {
            let u = if self.sine { self.fold_sine(k, u[k]) } else { u[k] };
            x[i] = match self.transforms[k] {
                Transform::Linear => u,
                Transform::Log => u.exp().clamp(self.bounds.lower()[i], self.bounds.upper()[i]),
            };
            if self.kinds[k] != ParameterKind::Continuous {
                let whole = x[i].round().clamp(self.bounds.lower()[i].ceil(), self.bounds.upper()[i].floor());
                // Converts -0 to 0: -0 would be a different point in the cache.
                x[i] = whole + 0.0;
            }
        }
        self.set_dependents(u, x);
    }

    /// Returns the user's bounds on the linear or logarithmic scale of a coordinate; infinite without an
    /// effective bound.
    pub(crate) fn limits_of(&self, k: usize) -> (f64, f64) {
        let i = self.free[k];
        let (lower, upper) = (self.bounds.lower()[i], self.bounds.upper()[i]);
        let open = match self.transforms[k] {
            Transform::Linear => lower.is_infinite(),
            Transform::Log => lower <= 0.0,
        };
        let [far_below, far_above] = self.far[k];
        let lower = if open || far_below { f64::NEG_INFINITY } else { self.lower[k] };
        (lower, if upper.is_infinite() || far_above { f64::INFINITY } else { self.upper[k] })
    }

    /// Returns the largest distance from `centre` that coordinate `k` reaches on the way to any of the
    /// `others`. All of them are pairs of a working coordinate and the user's coordinate. With angles, the
    /// way may pass a bound and return, because many angles represent one position.
    pub(crate) fn extent<I>(&self, k: usize, centre: (f64, f64), others: I, measure: ToleranceMeasure) -> f64
    where
        I: Iterator<Item = (f64, f64)> + Clone,
    {
        let logarithmic = measure == ToleranceMeasure::Relative && self.transforms[k] == Transform::Log;
        let bent = self.sine && self.limits_of(k) != (f64::NEG_INFINITY, f64::INFINITY) && {
            let wider = |(low, high): (f64, f64), (u, _): (f64, f64)| (low.min(u), high.max(u));
            let range = others.clone().fold((centre.0, centre.0), wider);
            self.bounds_passed(k, range.0, range.1) != [None; 2]
        };
        let size = if bent || logarithmic {
            let place = |x: f64| if logarithmic { x.ln() } else { x };
            let here = place(centre.1);
            let far = |size: f64, x: f64| size.max((place(x) - here).abs());
            others.fold(0.0, |size, (u, x)| {
                let passed = if bent { self.bounds_passed(k, centre.0, u) } else { [None; 2] };
                passed.into_iter().flatten().fold(far(size, x), far)
            })
        } else {
            others.fold(0.0, |size: f64, (_, x)| size.max((x - centre.1).abs()))
        };
        match (measure, self.sine) {
            (ToleranceMeasure::Absolute, _) => size,
            (ToleranceMeasure::Relative, true) => size / self.units[k],
            (ToleranceMeasure::Relative, false) => size / self.sizes[k],
        }
    }

    /// Moves working coordinate `k` into its bounds. Returns `fallback`, a value inside, for values that are
    /// not finite.
    pub fn bring_inside(&self, k: usize, u: f64, fallback: f64, handling: BoundsHandling) -> f64 {
        match handling {
            BoundsHandling::Mirror => fold(u, self.lower[k], self.upper[k], fallback),
            BoundsHandling::Clamp => clamp(u, self.lower[k], self.upper[k], fallback),
            BoundsHandling::Sine => clamp(u, f64::NEG_INFINITY, f64::INFINITY, fallback),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INF: f64 = f64::INFINITY;

    #[test]
    fn size_precedence_is_user_box_start_one() -> Result<(), Error> {
        let bounds = Bounds::new(&[0.0, 0.0, -INF, -INF], &[4.0, INF, INF, 2.0])?;
        let space = Space::new(&[1.0, 3.0, 0.0, -5.0], bounds.clone(), &[], &[])?;
        assert_eq!([0, 1, 2, 3].map(|k| space.size(k)), [4.0, 3.0, 1.0, 5.0]);
        let space = Space::new(&[1.0, 3.0, 0.0, -5.0], bounds, &[], &[0.1, 0.2, 0.3, 0.4].map(Some))?;
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
        let half_open =
            Space::new(&[0.3], Bounds::new(&[f64::NEG_INFINITY], &[10.0])?, &[Transform::Log], &[])?;
        assert_eq!((half_open.width(0), half_open.size(0)), (None, 1.0));
        assert!(Space::new(&[0.3], Bounds::new(&[0.0], &[10.0])?, &[Transform::Log], &[]).is_err());
        Ok(())
    }

    #[test]
    fn discrete_parameters_are_integers_with_equal_shares() -> Result<(), Error> {
        let space = |x0: f64, kind| {
            let bounds = Bounds::new(&[-0.2], &[3.7])?;
            Space::new(&[x0], bounds, &[], &[])?.with_kinds(&[kind])
        };
        let integer = space(2.0, ParameterKind::Integer)?;
        assert_eq!(integer.working_bounds(0), (-0.5, 3.5));
        let mut counts = [0; 4];
        for k in 0..=4000 {
            let mut x = [0.0];
            integer.to_user(&[-0.5 + 4.0 * f64::from(k) / 4000.0], &mut x);
            counts[x[0] as usize] += 1;
        }
        assert!(counts.iter().all(|c| (1000..=1001).contains(c)), "{counts:?}");
        let mut x = [1.0];
        integer.to_user(&[-0.3], &mut x);
        assert_eq!(x[0].to_bits(), 0.0f64.to_bits());
        assert!(matches!(space(2.5, ParameterKind::Categorical), Err(Error::ParameterOption { .. })));
        for end in [1e20, f64::MAX] {
            let wide = Space::new(&[0.0], Bounds::new(&[0.0], &[end])?, &[], &[])?
                .with_kinds(&[ParameterKind::Integer]);
            assert!(matches!(wide, Err(Error::ParameterOption { name: "bound", .. })), "{end}");
        }
        assert!(space(2.5, ParameterKind::Continuous)?.require_continuous("m").is_ok());
        assert!(matches!(integer.require_continuous("m"), Err(Error::NotContinuous { index: 0, .. })));
        let endless = Space::new(&[1.0, 1.0], Bounds::new(&[0.0; 2], &[2.0, INF])?, &[], &[])?;
        assert!(matches!(endless.require_box("m"), Err(Error::NeedsBox { index: 1, .. })));
        Ok(())
    }

    #[test]
    fn value_without_logarithm_is_an_error() -> Result<(), Error> {
        let log = [Transform::Log];
        let zero = Space::new(&[0.0], Bounds::unbounded(1), &log, &[]);
        assert!(matches!(zero, Err(Error::LogScale { index: 0, what: "start value", .. })));
        for lower in [-1.0, 0.0] {
            let space = Space::new(&[1.0], Bounds::new(&[lower], &[2.0])?, &log, &[]);
            assert!(matches!(space, Err(Error::LogScale { what: "lower bound", .. })));
        }
        Ok(())
    }
}
