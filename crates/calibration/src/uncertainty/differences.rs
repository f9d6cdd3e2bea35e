//! Changes of the residuals over steps of about one standard error along the principal axes of the
//! covariance. They determine the Jacobian and its noise.
//!
//! Differences over steps much shorter than the standard error contain simulation noise (rounding, step
//! control, event location) that looks like information. Over one standard error along a principal axis, the
//! residuals change by the standard deviation of a residual. This holds for every axis, so the
//! signal-to-noise ratio is the same for all axes.

use crate::error::CalibrationError;
use crate::loaded::simulations_around::{Point, PointResiduals, Simulations};
use crate::problem::parameter::{Parameter, inner, outer};
use crate::uncertainty::row_blocks::{go_on, product, triangle};
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Maximum step relative to a parameter, or to its size if it is zero, or to its factor on a log scale.
const USUAL: f64 = 0.01;

/// Maximum relative step if the residuals change by less than the noise.
const LONGEST: f64 = 0.1;

/// Minimum step relative to the usual step, even if the standard errors are very small.
const SHORTEST: f64 = 1e-4;

/// Relative step of the first differences, when the Jacobian is unknown.
const FIRST: f64 = 1e-3;

/// Required ratio of the change over a step to the noise.
const ABOVE_NOISE: f64 = 10.0;

/// A step over which the residuals bend is too long above this change. The unit is the standard deviation of
/// a residual, or the required change above the noise if that is larger.
const FAR: f64 = 4.0;

/// If a bound leaves less than this part of a step on one side, that side is not used.
const TOO_NARROW: f64 = 0.25;

/// The residuals are checked for roughness if they bend by more than `BENT` of their change over about one
/// standard error. Their change must be at least `TELLING` of their deviation. The check uses the part `PART`
/// of the step.
const BENT: f64 = 0.1;
const PART: f64 = 1.0 / 16.0;
const TELLING: f64 = 0.3;

/// Over the short step, a smooth model bends by a sixteenth as much. If the step crosses kinks of the rows,
/// the bend is a quarter as large, because the number of kinks grows with the step. The model is not smooth
/// if the bend exceeds `STILL_BENT` of its previous value and `LEAST_BENT` of the change. A kink of a few
/// rows at the best point itself stays below this limit.
const STILL_BENT: f64 = 0.5;
const LEAST_BENT: f64 = 0.4;

/// A bend below this multiple of the simulation error counts as simulation error.
const BEND_ABOVE_NOISE: f64 = 10.0;

/// With the changes `a1 + a3 + a5` over a step, Richardson's extrapolation leaves `a1 - a5 / 4`. This
/// remainder counts as zero if it is below this part of the removed terms, `a3 + 5 a5 / 4`. For `a5 = a3 /
/// 8`, this is the remainder of `a1 = 0`.
const LEFT_OVER: f64 = 1.0 / 32.0;

/// Rounding error of a simulated value, relative to the measurements.
const ROUNDING: f64 = 1e-13;

/// The point around which the free parameters are moved.
pub(crate) struct Center<'a> {
    pub(crate) parameters: &'a [Parameter],
    pub(crate) x: &'a [f64],
    /// Indices of the parameters to move.
    pub(crate) free: &'a [usize],
    /// Typical sizes of these parameters, in the coordinates of the search.
    pub(crate) sizes: &'a [f64],
    /// Residuals at the point, as they count in the cost.
    pub(crate) residuals: &'a [f64],
    /// Norm of the weighted measurements.
    pub(crate) measured: f64,
    /// Norm of the difference from accurate simulations; 0 if there is none.
    pub(crate) simulation_error: f64,
    /// Directions that the active constraints leave, p x q, in the coordinates of the search; `None` if no
    /// constraint is active.
    pub(crate) basis: Option<DMatrix<f64>>,
    /// Inactive constraints: their derivatives with respect to the coordinates, and the distances from the
    /// lower and the upper limit.
    pub(crate) inactive: Vec<(DVector<f64>, (f64, f64))>,
}

/// Differences around a point. Over the step `B z` in the coordinates of the search, the residuals change by
/// `E z`.
pub(crate) struct Differences {
    /// E, m x p.
    pub(crate) changes: DMatrix<f64>,
    /// B, p x q: one step per column. There are fewer columns than parameters if constraints are active.
    pub(crate) steps: DMatrix<f64>,
    /// Norm below which a combination of the changes is noise.
    pub(crate) noise: f64,
    /// Bend of the residuals over each two-sided step, `r(+) + r(-) - 2 r(0)`, relative to their change
    /// `r(+) - r(-)`; 0 for one-sided steps.
    bends: Vec<f64>,
    /// Bends that are too large for a smooth model.
    pub(crate) roughness: Option<ResidualBend>,
}

/// Bends of the residuals over a step of about one standard error that do not vanish with the step, relative
/// to their change. The bends of a smooth model are proportional to the step. Their limit is the relative
/// curvature of Bates and Watts (J. R. Stat. Soc. B 42, 1980, section 2).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ResidualBend {
    /// Bend over about one standard error.
    pub bend: f64,
    /// Bend over a sixteenth of that step.
    #[serde(alias = "bend_of_quarter")]
    pub bend_of_part: f64,
}

/// A step along an axis, in the coordinates of the search.
struct Step {
    direction: DVector<f64>,
    length: f64,
}

impl Center<'_> {
    fn bounds(&self, k: usize) -> (f64, f64) {
        let p = &self.parameters[self.free[k]];
        (inner(p, p.search_lower()), inner(p, p.search_upper()))
    }

    /// Returns the number of independent directions.
    pub(crate) fn n_directions(&self) -> usize {
        self.basis.as_ref().map_or(self.free.len(), DMatrix::ncols)
    }

    fn coordinate(&self, k: usize) -> f64 {
        inner(&self.parameters[self.free[k]], self.x[self.free[k]])
    }

    fn is_log(&self, k: usize) -> bool {
        self.parameters[self.free[k]].scale_kind() == crate::problem::parameter::Scale::Log
    }

    /// Returns the sizes that steps are relative to: the parameter itself, or a factor e on a log scale. The
    /// size is at least a step over which the residuals change by `deviation`, limited to the typical size.
    fn references(&self, jacobian: &DMatrix<f64>, deviation: f64) -> DVector<f64> {
        DVector::from_fn(self.free.len(), |k, _| {
            if self.is_log(k) {
                return 1.0;
            }
            let telling = deviation / jacobian.column(k).norm() / USUAL;
            let size = self.sizes[k];
            self.coordinate(k).abs().max(if telling.is_nan() { size } else { telling.min(size) })
        })
    }

    fn moved(&self, step: &Step, by: f64) -> Vec<f64> {
        let mut x = self.x.to_vec();
        for (k, &i) in self.free.iter().enumerate() {
            let part = step.direction[k] * by;
            if part != 0.0 {
                let p = &self.parameters[i];
                x[i] = outer(p, self.coordinate(k) + part).clamp(p.search_lower(), p.search_upper());
            }
        }
        x
    }

    /// Returns the longest steps that the bounds allow in a direction, backward and forward.
    fn capacity(&self, step: &Step) -> (f64, f64) {
        let (mut backward, mut forward) = (f64::INFINITY, f64::INFINITY);
        for (k, d) in step.direction.iter().enumerate().filter(|(_, d)| **d != 0.0) {
            let ((lower, upper), u) = (self.bounds(k), self.coordinate(k));
            let (down, up) = ((u - lower) / d.abs(), (upper - u) / d.abs());
            let (against, along) = if *d > 0.0 { (down, up) } else { (up, down) };
            (backward, forward) = (backward.min(against), forward.min(along));
        }
        for (gradient, (below, above)) in &self.inactive {
            let slope = gradient.dot(&step.direction);
            if slope != 0.0 {
                let (down, up) = (below / slope.abs(), above / slope.abs());
                let (against, along) = if slope > 0.0 { (down, up) } else { (up, down) };
                (backward, forward) = (backward.min(against), forward.min(along));
            }
        }
        (backward, forward)
    }

    /// Returns the start and end of a step, as multiples of its direction. A step is symmetric, or one-sided
    /// if there is no room on the other side. Returns `None` if there is no room on either side.
    fn span(&self, step: &Step) -> Option<(f64, f64)> {
        let ((backward, forward), t) = (self.capacity(step), step.length);
        let least = TOO_NARROW * t;
        if backward.min(forward) >= least {
            let t = t.min(backward).min(forward);
            Some((-t, t))
        } else if forward.max(backward) < least {
            None
        } else if forward >= backward {
            Some((0.0, t.min(forward)))
        } else {
            Some((-t.min(backward), 0.0))
        }
    }

    /// Returns the steps. If the bounds leave no room for one of them, returns steps of the same extent along
    /// the axes of the parameters instead. Along an axis, one side always has room for at least half the
    /// width of the bounds.
    fn within_bounds(&self, steps: Vec<Step>) -> Vec<Step> {
        if steps.iter().all(|step| self.span(step).is_some()) {
            return steps;
        }
        let part = |step: &Step, k: usize| (step.direction[k] * step.length).abs();
        self.axes(|k| steps.iter().map(|step| part(step, k)).fold(f64::MIN_POSITIVE, f64::max))
    }

    /// Returns steps along the axes of the parameters, or along the directions that the active constraints
    /// leave.
    fn axes(&self, lengths_of: impl Fn(usize) -> f64) -> Vec<Step> {
        if let Some(basis) = &self.basis {
            let of_column = |direction: DVector<f64>| {
                let lengths = direction.iter().enumerate().filter(|(_, d)| **d != 0.0);
                let length = lengths.map(|(k, d)| lengths_of(k) / d.abs()).fold(f64::INFINITY, f64::min);
                Step { direction, length }
            };
            return basis.column_iter().map(|column| of_column(column.into_owned())).collect();
        }
        let p = self.free.len();
        let axis = |k: usize| {
            let direction = DVector::from_fn(p, |i, _| f64::from(u8::from(i == k)));
            Step { direction, length: lengths_of(k) }
        };
        (0..p).map(axis).collect()
    }
}

impl Differences {
    /// Computes the differences. In a fit, it runs two simulations for each parameter, along the principal
    /// axes of a first guess. The guess `jacobian` is m x p, with respect to the coordinates of the search.
    /// Without a guess, it uses the axes of the parameters. It runs two more simulations for each combination
    /// whose change is not above the noise, or whose residuals bend over the step.
    ///
    /// # Errors
    /// Returns an error if the work is cancelled or no simulation is possible any more. Returns `Ok(Err(..))`
    /// if simulations fail on both sides of the point.
    pub(crate) fn around(
        center: &Center<'_>,
        jacobian: Option<DMatrix<f64>>,
        simulations: &mut Simulations<'_>,
    ) -> Result<Result<Self, String>, CalibrationError> {
        let (m, p) = (center.residuals.len(), center.n_directions());
        let deviation = center.residuals.iter().map(|r| r * r).sum::<f64>().sqrt()
            / (m.saturating_sub(p).max(1) as f64).sqrt();
        let noise = center.simulation_error.max(ROUNDING * center.measured);
        if p == 0 {
            return Ok(Ok(Self::of(DMatrix::zeros(m, 0), DMatrix::zeros(center.free.len(), 0), noise)));
        }
        let first = || {
            center.axes(|k| match center.is_log(k) {
                true => FIRST,
                false => (FIRST * center.coordinate(k).abs()).max(FIRST * USUAL * center.sizes[k]),
            })
        };
        let guess = match jacobian.filter(|jacobian| jacobian.iter().all(|j| j.is_finite())) {
            // An explicit request includes a first round that determines the step lengths of the
            // second one.
            None if simulations.budget.is_unlimited() => {
                match Self::measured(center, center.within_bounds(first()), simulations)? {
                    Ok(found) => Some(found.jacobian(&simulations.context)?),
                    Err(reason) => return Ok(Err(reason)),
                }
            }
            guess => guess,
        };
        let steps = match guess {
            Some(guess) => principal_steps(center, &guess, deviation, noise, &simulations.context)?,
            None => first(),
        };
        let found = match Self::measured(center, center.within_bounds(steps), simulations)? {
            Ok(found) => found.with_better_steps(center, deviation, noise, simulations)?,
            Err(reason) => return Ok(Err(reason)),
        };
        let roughness = found.roughness(center, deviation, noise, simulations)?;
        let found = found.without_cubic_terms(center, deviation, simulations)?;
        Ok(Ok(Self { noise: 3.0 * noise, roughness, ..found }))
    }

    /// Replaces steps of unsuitable length. Combinations whose changes are not above the noise get
    /// longer steps. Steps far beyond a standard error over which the residuals bend get shorter ones.
    fn with_better_steps(
        self,
        center: &Center<'_>,
        deviation: f64,
        noise: f64,
        simulations: &mut Simulations<'_>,
    ) -> Result<Self, CalibrationError> {
        let p = self.steps.ncols();
        let jacobian = self.jacobian(&simulations.context)?;
        let references = center.references(&jacobian, deviation);
        let least = ABOVE_NOISE * noise;
        let triangle =
            triangle(&self.changes, std::slice::from_ref(&(0..self.changes.nrows())), &simulations.context)?;
        let rows = triangle.nrows().max(p);
        let svd = triangle.resize_vertically(rows, 0.0).try_svd(false, true, f64::EPSILON, 10_000);
        let Some((v_t, values)) = svd.and_then(|svd| Some((svd.v_t?, svd.singular_values))) else {
            return Ok(self);
        };
        let far = FAR * deviation.max(least);
        let is_bent = |k: usize| self.bends[k] > BENT && self.changes.column(k).norm() > far;
        // The combination of the steps is lengthened as required.
        let lengthened = |i: usize| {
            let direction = &self.steps * v_t.row(i).transpose();
            let largest = direction.component_div(&references).amax().max(f64::MIN_POSITIVE);
            let length = (least / values[i].max(noise)).min(LONGEST / largest);
            Step { direction, length }
        };
        let (mut turned, mut steps) = (None, Vec::new());
        if (0..p).any(is_bent) {
            let bent = (0..p).filter(|k| is_bent(*k));
            steps.extend(bent.map(|k| {
                let length = deviation.max(least) / self.changes.column(k).norm();
                (k, Step { direction: self.steps.column(k).into_owned(), length })
            }));
        } else {
            let weak = (0..p).filter(|i| values[*i] < least).map(|i| (i, lengthened(i)));
            steps.extend(weak.filter(|(_, step)| step.length > 1.0 + TOO_NARROW));
            turned = (!steps.is_empty()).then(|| v_t.transpose());
        }
        if steps.is_empty() || steps.iter().any(|(_, step)| center.span(step).is_none()) {
            return Ok(self);
        }
        let (places, steps): (Vec<usize>, Vec<Step>) = steps.into_iter().unzip();
        let Ok(better) = Self::measured(center, steps, simulations)? else { return Ok(self) };
        let mut combined = match turned {
            Some(v) => Self {
                changes: product(&self.changes, &v, &simulations.context)?,
                steps: &self.steps * v,
                bends: vec![0.0; p],
                ..self
            },
            None => self,
        };
        for (place, k) in places.into_iter().enumerate() {
            combined.changes.set_column(k, &better.changes.column(place));
            combined.steps.set_column(k, &better.steps.column(place));
            combined.bends[k] = better.bends[place];
        }
        Ok(combined)
    }

    /// Simulates these steps and returns the changes.
    fn measured(
        center: &Center<'_>,
        mut steps: Vec<Step>,
        simulations: &mut Simulations<'_>,
    ) -> Result<Result<Self, String>, CalibrationError> {
        let (m, p) = (center.residuals.len(), steps.len());
        let mut changes = DMatrix::from_vec(m, p, vec![0.0; m * p]);
        let mut bends = vec![0.0; p];
        let mut open: Vec<usize> = (0..p).collect();
        let mut reason = String::new();
        // If simulations fail on both sides, shorter steps are tried.
        for _ in 0..3 {
            let spans: Vec<(f64, f64)> =
                open.iter().map(|&k| center.span(&steps[k]).unwrap_or((0.0, 0.0))).collect();
            let ends: Vec<(usize, f64)> = (open.iter().zip(&spans))
                .flat_map(|(&k, &(from, to))| [(k, from), (k, to)])
                .filter(|(_, by)| *by != 0.0)
                .collect();
            let points: Vec<Point> =
                ends.iter().map(|&(k, by)| Point::new(center.moved(&steps[k], by))).collect();
            let found = simulations.residuals(&points)?;
            let mut left = Vec::new();
            for (&k, &span) in open.iter().zip(&spans) {
                let at = |by: f64| match ends.iter().position(|end| *end == (k, by)) {
                    Some(place) => found[place].as_ref().ok().map(Vec::as_slice),
                    None => Some(center.residuals),
                };
                let (from, to) = match (at(span.0), at(span.1)) {
                    (Some(from), Some(to)) => ((span.0, from), (span.1, to)),
                    (Some(from), None) if span.0 != 0.0 => ((span.0, from), (0.0, center.residuals)),
                    (None, Some(to)) if span.1 != 0.0 => ((0.0, center.residuals), (span.1, to)),
                    _ => {
                        reason = first_reason(&found).unwrap_or_default();
                        steps[k].length /= 8.0;
                        left.push(k);
                        continue;
                    }
                };
                let length = steps[k].length;
                let per_length = if to.0 > from.0 { length / (to.0 - from.0) } else { 0.0 };
                go_on(&simulations.context)?;
                if from.0 < 0.0 && to.0 > 0.0 {
                    bends[k] = bend(from.1, center.residuals, to.1);
                }
                let differences = to.1.iter().zip(from.1).map(|(b, a)| (b - a) * per_length);
                changes.column_mut(k).iter_mut().zip(differences).for_each(|(to, change)| *to = change);
            }
            open = left;
            if open.is_empty() {
                let columns: Vec<DVector<f64>> = steps.iter().map(|s| &s.direction * s.length).collect();
                return Ok(Ok(Self { bends, ..Self::of(changes, DMatrix::from_columns(&columns), 0.0) }));
            }
        }
        Ok(Err(reason))
    }

    /// Creates differences from changes and steps only.
    pub(crate) fn of(changes: DMatrix<f64>, steps: DMatrix<f64>, noise: f64) -> Self {
        Self { changes, steps, noise, bends: Vec::new(), roughness: None }
    }

    /// Repeats the step with the largest bend at a sixteenth of its length. For a smooth model, the relative
    /// bend is then about a sixteenth as large. If switching times jump with the parameters, the relative
    /// bend is the same over every step.
    fn roughness(
        &self,
        center: &Center<'_>,
        deviation: f64,
        noise: f64,
        simulations: &mut Simulations<'_>,
    ) -> Result<Option<ResidualBend>, CalibrationError> {
        let change = |k: usize| self.changes.column(k).norm();
        let is_bent = |k: &usize| {
            self.bends[*k] > BENT
                && change(*k) >= TELLING * deviation
                && 2.0 * change(*k) * self.bends[*k] > BEND_ABOVE_NOISE * noise
        };
        let bent = (0..self.bends.len()).filter(is_bent);
        let Some(k) = bent.max_by(|a, b| self.bends[*a].total_cmp(&self.bends[*b])) else { return Ok(None) };
        let part = Step { direction: self.steps.column(k).into_owned(), length: PART };
        let Some((from, to)) = center.span(&part) else { return Ok(None) };
        let by = if to > 0.0 { to } else { from };
        let found = match simulations.beside(&[Point::new(center.moved(&part, by))]) {
            // The differences computed so far are more important than this check.
            Err(CalibrationError::Cancelled) => return Ok(None),
            found => found?.swap_remove(0),
        };
        let Ok(residuals) = found else { return Ok(None) };
        let column = self.changes.column(k);
        let off =
            residuals.iter().zip(center.residuals).zip(&column).map(|((r, c), change)| r - c - by * change);
        let size = off.map(|off| off * off).sum::<f64>().sqrt();
        let found = ResidualBend { bend: self.bends[k], bend_of_part: size / (by.abs() * column.norm()) };
        let is_rough = found.bend_of_part > (STILL_BENT * found.bend).max(LEAST_BENT);
        Ok((is_rough && 2.0 * size > BEND_ABOVE_NOISE * noise).then_some(found))
    }

    /// Repeats long steps with half the length and removes the cubic terms (Richardson's extrapolation). Long
    /// steps were used so that changes exceed the noise.
    fn without_cubic_terms(
        mut self,
        center: &Center<'_>,
        deviation: f64,
        simulations: &mut Simulations<'_>,
    ) -> Result<Self, CalibrationError> {
        let references = center.references(&self.jacobian(&simulations.context)?, deviation);
        let is_long = |k: &usize| self.steps.column(*k).component_div(&references).amax() > 1.01 * USUAL;
        let long: Vec<usize> = (0..self.steps.ncols()).filter(is_long).collect();
        if long.is_empty() {
            return Ok(self);
        }
        let steps = long.iter().map(|&k| Step { direction: self.steps.column(k).into_owned(), length: 0.5 });
        let Ok(half) = Self::measured(center, steps.collect(), simulations)? else { return Ok(self) };
        for (place, &k) in long.iter().enumerate() {
            let mut linear = half.changes.column(place) * (8.0 / 3.0) - self.changes.column(k) / 3.0;
            let cubic = self.changes.column(k) - &linear;
            if linear.norm() <= LEFT_OVER * cubic.norm() {
                linear.fill(0.0);
            }
            self.changes.set_column(k, &linear);
        }
        Ok(self)
    }

    /// Returns the differences with the residuals multiplied by these factors.
    pub(crate) fn weighted(mut self, factors: &[f64]) -> Self {
        for mut column in self.changes.column_iter_mut() {
            column.iter_mut().zip(factors).for_each(|(change, factor)| *change *= factor);
        }
        self.noise *= factors.iter().copied().fold(0.0, f64::max);
        self
    }

    /// Returns the Jacobian with respect to the coordinates of the search, m x p.
    pub(crate) fn jacobian(&self, context: &RunContext<'_>) -> Result<DMatrix<f64>, CalibrationError> {
        if self.steps.is_empty() {
            return Ok(DMatrix::zeros(self.changes.nrows(), self.steps.nrows()));
        }
        let inverse = match self.steps.is_square() {
            true => self.steps.clone().try_inverse(),
            // Changes across the active constraints are unknown; they count as zero.
            false => self.steps.clone().pseudo_inverse(f64::EPSILON * self.steps.norm()).ok(),
        };
        match inverse {
            Some(inverse) => product(&self.changes, &inverse, context),
            None => Ok(DMatrix::zeros(self.changes.nrows(), self.steps.nrows())),
        }
    }
}

/// Returns the norm of `a + b - 2 c` divided by the norm of `b - a`; 0 if nothing changes.
fn bend(a: &[f64], c: &[f64], b: &[f64]) -> f64 {
    let norm = |of: &dyn Fn(usize) -> f64| (0..c.len()).map(|i| of(i).powi(2)).sum::<f64>().sqrt();
    let (change, bend) = (norm(&|i| b[i] - a[i]), norm(&|i| a[i] + b[i] - 2.0 * c[i]));
    if change > 0.0 { bend / change } else { 0.0 }
}

fn first_reason(found: &[PointResiduals]) -> Option<String> {
    found.iter().find_map(|found| found.as_ref().err().cloned())
}

/// Returns steps along the principal axes of the covariance that this Jacobian implies. Each step is about
/// one standard error long, or as long as required to exceed the noise.
fn principal_steps(
    center: &Center<'_>,
    jacobian: &DMatrix<f64>,
    deviation: f64,
    noise: f64,
    context: &RunContext<'_>,
) -> Result<Vec<Step>, CalibrationError> {
    let p = center.n_directions();
    let references = center.references(jacobian, deviation);
    let mut triangle = triangle(jacobian, std::slice::from_ref(&(0..jacobian.nrows())), context)?;
    triangle.column_iter_mut().zip(&references).for_each(|(mut column, size)| column *= *size);
    let within = center.basis.as_ref().map(|basis| {
        let mut scaled = basis.clone();
        scaled.row_iter_mut().zip(&references).for_each(|(mut row, size)| row /= *size);
        scaled.qr().q()
    });
    if let Some(within) = &within {
        triangle *= within;
    }
    let rows = triangle.nrows().max(p);
    let svd = triangle.resize_vertically(rows, 0.0).try_svd(false, true, f64::EPSILON, 10_000);
    let axes = svd.and_then(|svd| Some((svd.v_t?, svd.singular_values)));
    let (v_t, values) = axes.unwrap_or_else(|| (DMatrix::identity(p, p), DVector::zeros(p)));
    Ok((0..p)
        .map(|i| {
            let axis = v_t.row(i).transpose();
            let axis = within.as_ref().map_or_else(|| axis.clone(), |within| within * &axis);
            let largest = axis.amax().max(f64::MIN_POSITIVE);
            let error = (deviation / values[i]).min(USUAL / largest).max(SHORTEST * USUAL / largest);
            let length = error.max(ABOVE_NOISE * noise / values[i]).min(LONGEST / largest);
            Step { direction: axis.component_mul(&references), length }
        })
        .collect())
}
