//! Changes of the residuals over steps of about one standard error along the principal axes of the
//! covariance: the Jacobian, and what of it is noise.
//!
//! Differences over steps that are short against the standard error hold the noise of the simulations
//! (rounding, step control, event location) as if it were information. Over one standard error along a
//! principal axis the residuals change by the standard deviation of a residual, whichever the axis, so the
//! ratio of signal to noise is the same for all.

use crate::error::CalibrationError;
use crate::loaded::simulations_around::{Point, PointResiduals, Simulations};
use crate::problem::parameter::{Parameter, inner, outer};
use crate::uncertainty::row_blocks::{go_on, product, triangle};
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Steps are no longer than this part of a parameter (of its size, where it is zero; on a log scale: of its
/// factor)...
const USUAL: f64 = 0.01;

/// ... except where the residuals change by less than noise: then up to this part.
const LONGEST: f64 = 0.1;

/// No shorter than this part of the usual step, however small the standard errors are.
const SHORTEST: f64 = 1e-4;

/// Steps of the first differences, where nothing is known of the Jacobian.
const FIRST: f64 = 1e-3;

/// The change over a step shall be so many times the noise.
const ABOVE_NOISE: f64 = 10.0;

/// A step over which the residuals bend is too long where they change by more than this many times the
/// standard deviation of a residual, or the noise that they must stand out from.
const FAR: f64 = 4.0;

/// A side of a parameter that leaves less than this part of a step is left out.
const TOO_NARROW: f64 = 0.25;

/// Where residuals bend by more than this part of their change over a step of about one standard error, over
/// which they change by at least this part of their deviation, they are looked at over this part of it.
const BENT: f64 = 0.1;
const PART: f64 = 1.0 / 16.0;
const TELLING: f64 = 0.3;

/// A smooth model bends over that by a sixteenth as much, and one whose rows have kinks that the step passes
/// by a quarter as much (their number grows with the step). Where it is more than the first of these parts of
/// what it was, and more than the second of the change, the model is not smooth: the kink of a few rows at
/// the best point itself stays below that.
const STILL_BENT: f64 = 0.5;
const LEAST_BENT: f64 = 0.4;

/// A bend below so many times the error of the simulations is theirs.
const BEND_ABOVE_NOISE: f64 = 10.0;

/// With the changes `a1 + a3 + a5` over a step, Richardson's extrapolation leaves `a1 - a5 / 4`. What is left
/// is no change where it is less than this part of what was taken away, `a3 + 5 a5 / 4`: for `a5 = a3 / 8`
/// that much is left of `a1 = 0`.
const LEFT_OVER: f64 = 1.0 / 32.0;

/// Rounding of a simulated value relative to what was measured.
const ROUNDING: f64 = 1e-13;

/// The point around which the parameters that are not held are moved.
pub(crate) struct Center<'a> {
    pub(crate) parameters: &'a [Parameter],
    pub(crate) x: &'a [f64],
    /// Numbers of the parameters that are moved.
    pub(crate) free: &'a [usize],
    /// Their typical sizes in the coordinates of the search.
    pub(crate) sizes: &'a [f64],
    /// The residuals there, as they count.
    pub(crate) residuals: &'a [f64],
    /// Norm of the measurements, times their weights.
    pub(crate) measured: f64,
    /// Norm of the difference from accurate simulations; 0 where there is none.
    pub(crate) simulation_error: f64,
}

/// Differences around a point: over the step `B z` in the coordinates of the search the residuals change by
/// `E z`.
pub(crate) struct Differences {
    /// E, m x p.
    pub(crate) changes: DMatrix<f64>,
    /// B, p x p: a step per column.
    pub(crate) steps: DMatrix<f64>,
    /// A combination of the changes whose norm is below this is noise.
    pub(crate) noise: f64,
    /// By how much the residuals bend over each step that goes to both sides, `r(+) + r(-) - 2 r(0)`,
    /// relative to their change `r(+) - r(-)`; 0 for others.
    bends: Vec<f64>,
    /// The residuals bend as no smooth model lets them.
    pub(crate) roughness: Option<ResidualBend>,
}

/// Bends of the residuals over a step of about one standard error that do not vanish with the step, relative
/// to their change. Those of a smooth model are proportional to the step; the relative curvature of Bates and
/// Watts (J. R. Stat. Soc. B 42, 1980, section 2) is their limit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ResidualBend {
    /// Over about one standard error.
    pub bend: f64,
    /// Over a sixteenth of that.
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
        (inner(p, p.lower()), inner(p, p.upper()))
    }

    fn coordinate(&self, k: usize) -> f64 {
        inner(&self.parameters[self.free[k]], self.x[self.free[k]])
    }

    fn is_log(&self, k: usize) -> bool {
        self.parameters[self.free[k]].scale_kind() == crate::problem::parameter::Scale::Log
    }

    /// Sizes that steps are relative to: the parameter itself, on a log scale a factor e; not less than a
    /// step by which the residuals change by `deviation`, as far as the typical size goes.
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
                x[i] = outer(p, self.coordinate(k) + part).clamp(p.lower(), p.upper());
            }
        }
        x
    }

    /// Longest steps that the bounds allow in a direction, backward and forward.
    fn room(&self, step: &Step) -> (f64, f64) {
        let (mut backward, mut forward) = (f64::INFINITY, f64::INFINITY);
        for (k, d) in step.direction.iter().enumerate().filter(|(_, d)| **d != 0.0) {
            let ((lower, upper), u) = (self.bounds(k), self.coordinate(k));
            let (down, up) = ((u - lower) / d.abs(), (upper - u) / d.abs());
            let (against, along) = if *d > 0.0 { (down, up) } else { (up, down) };
            (backward, forward) = (backward.min(against), forward.min(along));
        }
        (backward, forward)
    }

    /// From where to where a step goes, as multiples of its direction: to both sides as far, to one side
    /// where the other has no room. `None`: there is none on either side.
    fn span(&self, step: &Step) -> Option<(f64, f64)> {
        let ((backward, forward), t) = (self.room(step), step.length);
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

    /// The steps, or where the bounds leave no room for one of them, steps along the axes of the parameters
    /// that go as far along each: on one side there is room for at least half the width of the bounds.
    fn with_room(&self, steps: Vec<Step>) -> Vec<Step> {
        if steps.iter().all(|step| self.span(step).is_some()) {
            return steps;
        }
        let part = |step: &Step, k: usize| (step.direction[k] * step.length).abs();
        self.axes(|k| steps.iter().map(|step| part(step, k)).fold(f64::MIN_POSITIVE, f64::max))
    }

    fn axes(&self, lengths: impl Fn(usize) -> f64) -> Vec<Step> {
        let p = self.free.len();
        let axis = |k: usize| {
            let direction = DVector::from_fn(p, |i, _| f64::from(u8::from(i == k)));
            Step { direction, length: lengths(k) }
        };
        (0..p).map(axis).collect()
    }
}

impl Differences {
    /// In a fit, two simulations for each parameter, along the principal axes of a first guess `jacobian` (m
    /// x p, by the coordinates of the search), or else along the axes of the parameters; and two more for
    /// each combination whose change does not stand out from the noise, or over whose step the residuals
    /// bend.
    ///
    /// # Errors
    /// Cancelled, or no simulation can be made any more; `Ok(Err(..))`: simulations fail on both sides of the
    /// point.
    pub(crate) fn around(
        center: &Center<'_>,
        jacobian: Option<DMatrix<f64>>,
        simulations: &mut Simulations<'_>,
    ) -> Result<Result<Self, String>, CalibrationError> {
        let (m, p) = (center.residuals.len(), center.free.len());
        let deviation = center.residuals.iter().map(|r| r * r).sum::<f64>().sqrt()
            / (m.saturating_sub(p).max(1) as f64).sqrt();
        let noise = center.simulation_error.max(ROUNDING * center.measured);
        if p == 0 {
            return Ok(Ok(Self::of(DMatrix::zeros(m, 0), DMatrix::zeros(0, 0), noise)));
        }
        let first = || {
            center.axes(|k| match center.is_log(k) {
                true => FIRST,
                false => (FIRST * center.coordinate(k).abs()).max(FIRST * USUAL * center.sizes[k]),
            })
        };
        let guess = match jacobian.filter(|jacobian| jacobian.iter().all(|j| j.is_finite())) {
            // Whoever asks for it has the first round for the lengths of the second one.
            None if simulations.budget.is_unlimited() => {
                match Self::measured(center, center.with_room(first()), simulations)? {
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
        let found = match Self::measured(center, center.with_room(steps), simulations)? {
            Ok(found) => found.with_better_steps(center, deviation, noise, simulations)?,
            Err(reason) => return Ok(Err(reason)),
        };
        let roughness = found.roughness(center, deviation, noise, simulations)?;
        let found = found.without_cubic_terms(center, deviation, simulations)?;
        Ok(Ok(Self { noise: 3.0 * noise, roughness, ..found }))
    }

    /// Steps that were too short or too long are replaced: combinations of them whose changes do not stand
    /// out from the noise by longer ones, and steps over which the residuals bend, far beyond a standard
    /// error, by shorter ones.
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
        // A combination of the steps, as long as it has to be.
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
        let mut own = match turned {
            Some(v) => Self {
                changes: product(&self.changes, &v, &simulations.context)?,
                steps: &self.steps * v,
                bends: vec![0.0; p],
                ..self
            },
            None => self,
        };
        for (place, k) in places.into_iter().enumerate() {
            own.changes.set_column(k, &better.changes.column(place));
            own.steps.set_column(k, &better.steps.column(place));
            own.bends[k] = better.bends[place];
        }
        Ok(own)
    }

    /// The changes over these steps.
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
        // Where simulations fail on both sides, shorter steps are tried.
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

    /// Changes over steps that nothing else is known of.
    pub(crate) fn of(changes: DMatrix<f64>, steps: DMatrix<f64>, noise: f64) -> Self {
        Self { changes, steps, noise, bends: Vec::new(), roughness: None }
    }

    /// Looks at a sixteenth of the step over which the residuals bend most: a simulation of a smooth model is
    /// a sixteenth of the change away there, up to as small a part of its bend. Switching times that jump
    /// with the parameters make them bend as much over any step.
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
            // What is known by now is more than that.
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

    /// Steps that were made long, so that changes stand out from the noise, are made half as long as well:
    /// what grows with the third power of the step is taken away (Richardson's extrapolation).
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

    /// The same with the residuals multiplied by these factors.
    pub(crate) fn weighted(mut self, factors: &[f64]) -> Self {
        for mut column in self.changes.column_iter_mut() {
            column.iter_mut().zip(factors).for_each(|(change, factor)| *change *= factor);
        }
        self.noise *= factors.iter().copied().fold(0.0, f64::max);
        self
    }

    /// By the coordinates of the search, m x p.
    pub(crate) fn jacobian(&self, context: &RunContext<'_>) -> Result<DMatrix<f64>, CalibrationError> {
        if self.steps.is_empty() {
            return Ok(self.changes.clone());
        }
        match self.steps.clone().try_inverse() {
            Some(inverse) => product(&self.changes, &inverse, context),
            None => Ok(DMatrix::zeros(self.changes.nrows(), self.steps.ncols())),
        }
    }
}

/// The norm of `a + b - 2 c` over that of `b - a`; 0 where nothing changes.
fn bend(a: &[f64], c: &[f64], b: &[f64]) -> f64 {
    let norm = |of: &dyn Fn(usize) -> f64| (0..c.len()).map(|i| of(i).powi(2)).sum::<f64>().sqrt();
    let (change, bend) = (norm(&|i| b[i] - a[i]), norm(&|i| a[i] + b[i] - 2.0 * c[i]));
    if change > 0.0 { bend / change } else { 0.0 }
}

fn first_reason(found: &[PointResiduals]) -> Option<String> {
    found.iter().find_map(|found| found.as_ref().err().cloned())
}

/// Steps along the principal axes of the covariance that this Jacobian stands for, each of about one standard
/// error, or as long as it must be to stand out from the noise.
fn principal_steps(
    center: &Center<'_>,
    jacobian: &DMatrix<f64>,
    deviation: f64,
    noise: f64,
    context: &RunContext<'_>,
) -> Result<Vec<Step>, CalibrationError> {
    let p = center.free.len();
    let references = center.references(jacobian, deviation);
    let mut triangle = triangle(jacobian, std::slice::from_ref(&(0..jacobian.nrows())), context)?;
    triangle.column_iter_mut().zip(&references).for_each(|(mut column, size)| column *= *size);
    let rows = triangle.nrows().max(p);
    let svd = triangle.resize_vertically(rows, 0.0).try_svd(false, true, f64::EPSILON, 10_000);
    let axes = svd.and_then(|svd| Some((svd.v_t?, svd.singular_values)));
    let (v_t, values) = axes.unwrap_or_else(|| (DMatrix::identity(p, p), DVector::zeros(p)));
    Ok((0..p)
        .map(|i| {
            let axis = v_t.row(i).transpose();
            let largest = axis.amax().max(f64::MIN_POSITIVE);
            let error = (deviation / values[i]).min(USUAL / largest).max(SHORTEST * USUAL / largest);
            let length = error.max(ABOVE_NOISE * noise / values[i]).min(LONGEST / largest);
            Step { direction: axis.component_mul(&references), length }
        })
        .collect())
}
