//! Steps on interpolation models: the choice of the next points, and the updates of radius, resolution and
//! set.

use super::interpolation::{Interpolation, NewPoint, Place, combine};
use super::points::{Evaluated, Selection, difference, distance, dot, norm, sum};
use super::state::{Candidate, LeastSquaresState, Phase, PointStatus, Role, Stagnation};
use super::subproblem::{Cancelled, Linear, Room, Subproblem, longest, smallest_singular_value};
use crate::method_interface::interface::Operation;
use crate::method_interface::tolerances::ToleranceTests;
use crate::methods::shared::failures::{Plane, plane};
use crate::outcome::termination::Termination;
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use std::borrow::Cow;

/// Minimum radius that can be resolved.
const SMALLEST: f64 = 1e-15;
/// Resolution down to which a search with an x tolerance of 0 continues although the cost only rounds.
const UNSTATED: f64 = 1e3 * SMALLEST;
/// Relative sum of squares below which it counts as zero (the default `model.rel_tol` of DFO-LS: Cartis,
/// Fiala, Marteau and Roberts 2019, section 4).
const ZERO: f64 = 1e-20;
/// Maximum number of turns without a requested point. The resolution normally reaches its limit long before.
const MOST_TURNS: usize = 200;
/// Maximum number of requests for missing directions around one point.
const MOST_TRIES: u32 = 8;
/// Maximum number of rounds of trial points without progress, in units of n + 1. A round makes no progress if
/// the changes are below the tolerances. The limit applies after the search has reached the limit of the x
/// test. Residuals that change on a finer scale prevent the f test from passing.
const MOST_HALTED: usize = 10;
/// Minimum radius after failures. Below this radius, a simplex search continues.
const STUCK: f64 = 1e-4;
/// Distance within which failed points affect steps, in units of the trust-region radius.
const NEAR: f64 = 4.0;
/// Curvature across the plane to failed points, in units of the largest curvature of the model.
const AVOIDANCE: f64 = 100.0;
/// Two failed steps indicate noise in the following case. The later step, including the points of the set, is
/// shorter by at least the factor `NEARER`. The misfit of the model has not decreased below the factor
/// `SMALLER`. For smooth residuals, the misfit decreases with the square of the length.
const NEARER: f64 = 0.25;
const SMALLER: f64 = 0.5;
/// Number of consecutive indications that trigger a probe.
const MOST_NOISY: usize = 2;
/// Cost above which a point does not enter the set, in units of the largest cost in the set. Of 720 fits of
/// an exponential decay from far away, with errors in the last digit of the residuals, six end without
/// success otherwise, and none with this limit (`tests/all/last_digits.rs`).
const WILD: f64 = 1e8;
/// Change of the residuals next to a point, relative to the misfit of the model, that counts as noise.
const JUMP: f64 = 0.03;
/// Maximum step of a search that converges to a root, as a fraction of the distance from the start. At a root
/// of multiplicity p, this fraction is 10^(-10/p) / p after the sum of squares has fallen to 1e-20 of its
/// first value. For any p, it is at most 1 / (10 e ln 10). A longer step leads to a minimum at infinity.
const ONWARD: f64 = 0.016;
/// Minimum distance from the start at which a minimum at infinity is considered, in units of the first
/// radius. Applies if the sum of squares does not fall to zero.
const FAR: f64 = 100.0;
/// Ratio to the start value, or to one, above which a value counts as diverged. Bounds at this distance count
/// as absent (`problem/space`).
const RUN_AWAY: f64 = 1e10;

/// Distance from a row below which it counts as active, in units of the resolution.
const AT_ROW: f64 = 1e-6;

/// Results of the tests at a point.
struct Judged {
    tests: ToleranceTests,
    /// Failed points prevent a decrease.
    is_kept_off: bool,
    /// The minimum is at infinity.
    recedes: bool,
}

impl LeastSquaresState {
    /// Returns the model around a point of the set. The model is constant along directions not covered by the
    /// points.
    fn interpolation(
        &self,
        base: usize,
        context: &RunContext<'_>,
    ) -> Result<Option<Interpolation>, Cancelled> {
        let (z, residuals) = (&self.points[base].z, &self.points[base].residuals[..]);
        let place = self.set.iter().position(|k| *k == base).unwrap_or(0);
        let counted: Vec<Cow<'_, [f64]>> = self.set.iter().map(|k| self.residuals_near(base, *k)).collect();
        let points: Vec<Place<'_>> =
            self.set.iter().zip(&counted).map(|(k, r)| (&self.points[*k].z[..], &r[..])).collect();
        if points.len() > self.n() {
            return Interpolation::new(&points, place, context);
        }
        let others = self.set.iter().filter(|k| **k != base).map(|k| difference(&self.points[*k].z, z));
        let others: Vec<Vec<f64>> = others.collect();
        let missing = Selection::of(others.iter().map(|v| &v[..])).missing(self.n());
        let missing = missing.iter().map(|v| v.iter().zip(z).map(|(v, z)| z + v * self.delta).collect());
        let missing: Vec<Vec<f64>> = missing.collect();
        let all: Vec<Place<'_>> =
            points.into_iter().chain(missing.iter().map(|z| (&z[..], residuals))).collect();
        Interpolation::new(&all, place, context)
    }

    /// Returns the residuals of a point, with the loss linearised at the base. Within the set, only the model
    /// is then curved. Otherwise the curvature of the loss would hide the slope of the cost. This happens
    /// between points whose residuals differ by the scale of the loss.
    pub(super) fn residuals_near(&self, base: usize, point: usize) -> Cow<'_, [f64]> {
        let (loss, residuals) = (&self.setup.loss, &self.points[point].residuals);
        let n = residuals.len();
        if loss.is_linear() || point == base {
            return Cow::Borrowed(residuals);
        }
        let counted = |(k, (at_base, residuals)): (usize, (&f64, &f64))| {
            let loss = loss.of_residual(k, n);
            let plain = loss.inverse(*at_base);
            at_base + loss.slope(plain) * (loss.inverse(*residuals) - plain)
        };
        self.points[base].residuals.iter().zip(residuals).enumerate().map(counted).collect()
    }

    /// Chooses a point and its nearest independent points as the set.
    pub(super) fn choose_set(&mut self, base: usize) {
        let selection = Selection::nearest(&self.points, &self.points[base].z, self.n());
        self.set = std::iter::once(base).chain(selection.chosen).collect();
        self.model = None;
    }

    /// Chooses the set around the best point of the set and of a round.
    fn choose_set_from(&mut self, round: &[Candidate]) {
        let new = round.iter().filter_map(|candidate| match candidate.status {
            PointStatus::Point(k) => Some(k),
            _ => None,
        });
        if let Some(best) = self.best_of(self.set.iter().copied().chain(new)) {
            self.choose_set(best);
        }
    }

    /// Returns the point of the set that is farthest from the base, and its distance.
    fn farthest(&self, base: usize) -> (usize, f64) {
        let far = |k: usize| (k, distance(&self.points[k].z, &self.points[base].z));
        self.set
            .iter()
            .map(|k| far(*k))
            .fold((base, 0.0), |far, other| if other.1 > far.1 { other } else { far })
    }

    /// Fills the round, or ends. If cancelled, does neither and can be called again.
    pub(super) fn descend(&mut self, context: &RunContext<'_>) -> Result<(), Cancelled> {
        // Each turn without a point shrinks the resolution or removes a point from the set.
        for turn in 0.. {
            if !self.round.is_empty() || !matches!(self.phase, Phase::Descending) {
                break;
            }
            if turn >= MOST_TURNS {
                self.phase = Phase::Ended(Termination::Collapsed);
                break;
            }
            let base = self.base();
            let f = self.points[base].cost;
            if self.is_zero(f) {
                self.end_at_zero(base, context)?;
                break;
            }
            if self.set.len() <= self.n() && (self.completed.0 != base || self.completed.1 < MOST_TRIES) {
                self.complete(base);
                continue;
            }
            let model = self.model_at(base, context)?;
            let improving = self.improving.take();
            let Some(model) = model else {
                // The points are in a plane up to rounding, so replace one direction.
                let (farthest, _) = self.farthest(base);
                if farthest == base || self.delta < SMALLEST {
                    self.phase = Phase::Ended(Termination::Collapsed);
                    break;
                }
                self.set.retain(|k| *k == base || *k != farthest);
                self.completed.1 = 0;
                continue;
            };
            if let Some(point) = improving {
                let distance = distance(&self.points[point].z, &self.points[base].z);
                self.improve(base, &model, point, distance);
                self.model = Some(model);
                continue;
            }
            let z = self.points[base].z.clone();
            let room = self.room_around(&z);
            let (step, predicted) = self.best_step(&z, &model.linear, self.delta, &room);
            let length = norm(&step);
            let Judged { tests, is_kept_off, recedes } =
                self.judge_step(base, &model.linear, (&step, predicted), &room);
            self.tests = Some(tests);
            // Decreases due to rounding of the sum of squares, or negligible compared with the tolerance.
            // Otherwise a direction without effect would be followed forever.
            let rounding = 4.0 * self.points[base].residuals.len() as f64 * f64::EPSILON * f;
            let nothing = rounding.max(1e-7 * tests.f_limit);
            // Equal residuals at all points are not a minimum if other residuals are known. A simplex search
            // continues beyond them.
            let is_plateau = tests.passed && self.is_plateau(base, predicted);
            if tests.passed && recedes {
                self.phase = Phase::Ended(Termination::Unbounded);
            } else if tests.passed && !is_plateau {
                self.phase = Phase::Ended(Termination::Converged);
            } else if is_kept_off || is_plateau || (self.n_failed > 0 && self.delta < STUCK) {
                self.begin_simplex();
            } else if tests.x_passed && self.is_halted(MOST_HALTED) {
                self.phase = Phase::Ended(self.end_in_noise(base));
            } else if self.rho < SMALLEST {
                self.phase = Phase::Ended(Termination::Collapsed);
            } else if length < 0.5 * self.rho || predicted <= nothing {
                let (x_size, gain) = self.uncertainty(base, &model.linear, &step, predicted, &room);
                let x_limit = if self.setup.tolerances.x_tol > 0.0 { 0.0 } else { UNSTATED };
                let may_pass = !tests.x_passed && self.rho > x_limit;
                if !may_pass && (gain <= rounding || self.is_flat(&z, &model.linear, rounding, &room)) {
                    self.phase = Phase::Ended(Termination::Collapsed);
                    continue;
                }
                self.shrink_or_improve(base, &model, x_size);
                self.model = Some(model);
            } else {
                self.ask_for(sum(&z, &step), Role::Trial { predicted, radius: self.delta });
                self.model = Some(model);
            }
        }
        Ok(())
    }

    /// True if a sum of squares counts as zero.
    pub(super) fn is_zero(&self, f: f64) -> bool {
        f <= ZERO * self.f_0
    }

    /// Ends the run after the cost has become zero. The points do not need to determine a model.
    fn end_at_zero(&mut self, base: usize, context: &RunContext<'_>) -> Result<(), Cancelled> {
        let f = self.points[base].cost;
        self.tests = Some(self.judge(self.rho, f, f));
        let model = self.interpolation(base, context)?;
        let recedes = f > 0.0 && model.is_some_and(|model| self.recedes(base, &model.linear, 0.0));
        self.phase = Phase::Ended(if recedes { Termination::Unbounded } else { Termination::Converged });
        Ok(())
    }

    /// Returns the stored model, relative to this point, or a new one. With a loss, always returns a new
    /// model.
    fn model_at(
        &mut self,
        base: usize,
        context: &RunContext<'_>,
    ) -> Result<Option<Interpolation>, Cancelled> {
        let is_kept = self.setup.loss.is_linear() && self.set.len() == self.n() + 1;
        let Some(mut model) = self.model.take().filter(|_| is_kept) else {
            return self.interpolation(base, context);
        };
        let step = difference(&self.points[base].z, &self.points[self.set[model.base]].z);
        model.rebase(self.set.iter().position(|k| *k == base).unwrap_or(0), &step);
        Ok(Some(model))
    }

    /// Applies the tests at a point. `step` is its best step and the predicted decrease.
    fn judge_step(&self, base: usize, linear: &Linear, step: (&[f64], f64), room: &Room) -> Judged {
        let (step, predicted) = step;
        let length = norm(step);
        let (z, f) = (&self.points[base].z, self.points[base].cost);
        let mut tests = self.judge(self.rho.max(length), predicted, f);
        if !tests.x_passed && self.judge(length, predicted, f).x_passed {
            let (x_size, gain) = self.uncertainty(base, linear, step, predicted, room);
            tests = self.judge(x_size, gain, f);
        }
        let (mut is_kept_off, mut recedes) = (false, false);
        if tests.passed && (length >= 0.9 * self.delta || !self.failed.is_empty()) {
            // Include decreases prevented by the radius and by failed points.
            let radius = self.options.radius.max(self.delta);
            tests = self.judge(self.rho, self.best_step(z, linear, radius, room).1, f);
            recedes = tests.passed && self.recedes(base, linear, FAR);
            if tests.passed {
                let free = Subproblem { linear, radius, room }.solve().1;
                tests = self.judge(self.rho, free, f);
                is_kept_off = !tests.passed;
            }
        }
        Judged { tests, is_kept_off, recedes }
    }

    /// Shrinks the radius or the resolution if no decrease is possible, or requests a point that improves the
    /// model. `x_size` is the maximum distance of the minimum.
    fn shrink_or_improve(&mut self, base: usize, model: &Interpolation, x_size: f64) {
        if x_size < 0.1 * self.rho {
            // The model is more accurate than this resolution requires.
            self.refine(x_size);
            return;
        }
        self.n_geometry += 1;
        // If the model is correct, no decrease is possible at this resolution.
        self.delta = self.rho.max(0.1 * self.delta);
        if self.delta <= 1.5 * self.rho {
            self.delta = self.rho;
        }
        let (point, distance) = self.farthest(base);
        let may_improve = self.n_geometry <= 2 * (self.n() + 1);
        if distance > (2.0 * self.delta).max(10.0 * self.rho) && may_improve {
            self.improve(base, model, point, distance);
        } else if self.delta <= self.rho {
            self.refine(x_size);
        }
    }

    /// True if residuals that are constant at several points, but not at all points, prevent a decrease. In
    /// the first case, at least half of the residuals that change anywhere are constant within the set.
    /// Rounded residuals jump instead, so the model represents only the jumps of the others. In the second
    /// case, no decrease is predicted, and a point too far away for the x test has identical residuals.
    fn is_plateau(&self, base: usize, predicted: f64) -> bool {
        let Evaluated { z, residuals, .. } = &self.points[base];
        let is_same = |k: usize, i: usize| self.points[k].residuals[i] == residuals[i];
        let rests = |i: &usize| self.set.iter().all(|k| is_same(*k, *i));
        let changes = |i: &usize| (0..self.points.len()).any(|k| !is_same(k, *i));
        let n_moving = (0..residuals.len()).filter(|i| !rests(i)).count();
        let n_resting = (0..residuals.len()).filter(|i| rests(i) && changes(i)).count();
        let is_far = |point: &Evaluated| distance(&point.z, z) > self.x_limit();
        n_resting > 0 && n_resting >= n_moving
            || predicted == 0.0
                && self.points.iter().any(|point| point.residuals != *residuals)
                && self.points.iter().any(|point| point.residuals == *residuals && is_far(point))
    }

    /// True if the search moves towards a minimum at infinity. It must have moved at least `far` first radii
    /// from the start. The minimum of the model must be farther away in the same direction than for any root
    /// (see [`ONWARD`]).
    fn recedes(&self, base: usize, linear: &Linear, far: f64) -> bool {
        let z = &self.points[base].z;
        let way = norm(z);
        let (step, _) = self.best_step(z, linear, ONWARD * way, &self.room_around(z));
        let along = dot(&step, z) / way;
        way >= far * self.options.radius && along >= 0.99 * ONWARD * way
    }

    /// Returns bounds on the distance of the minimum from the base, and on the decrease of the cost up to it.
    fn uncertainty(
        &self,
        base: usize,
        linear: &Linear,
        step: &[f64],
        predicted: f64,
        room: &Room,
    ) -> (f64, f64) {
        let length = norm(step);
        let coarse = (self.rho, predicted);
        let Some(curvature) = self.curvature.filter(|_| self.set.len() == self.n() + 1) else {
            return coarse;
        };
        let (_, far) = self.farthest(base);
        let sigma = match room.rows.is_empty() {
            true => smallest_singular_value(&linear.factor),
            false => {
                let error = curvature * far * self.points[base].cost.sqrt();
                self.smallest_in_rows(linear, step, room, error)
            }
        };
        // The error of the Jacobian is the curvature times the size of the set. The error of the gradient is
        // this error times the residuals.
        let gradient = curvature * far * self.points[base].cost.sqrt() / sigma;
        let x_size = length + gradient / sigma;
        if x_size < self.rho { (x_size, predicted + gradient * gradient) } else { coarse }
    }

    /// Returns the smallest singular value of the Jacobian in the null space of the rows and bounds that hold
    /// the minimum of the model. `error` is the possible error of the gradient.
    fn smallest_in_rows(&self, linear: &Linear, step: &[f64], room: &Room, error: f64) -> f64 {
        let Linear { factor, reached } = linear;
        let gradient = factor.tr_mul(&(reached + factor * DVector::from_column_slice(step)));
        let holding = room.holding(step, gradient.as_slice(), AT_ROW * self.rho, error);
        let basis = Selection::of(holding.iter().map(|row| &row.normal[..])).missing(self.n());
        if basis.is_empty() {
            return f64::INFINITY;
        }
        let basis: Vec<DVector<f64>> = basis.into_iter().map(DVector::from_vec).collect();
        let inside = factor * DMatrix::from_columns(&basis);
        smallest_singular_value(&Linear::turned(reached.clone(), inside).factor)
    }

    /// Returns a step along a direction with the given length, on the side with more space.
    pub(super) fn fitted(&self, z: &[f64], direction: &[f64], length: f64) -> Vec<f64> {
        self.room_around(z).along(direction, length)
    }

    /// Requests points along the directions not covered by the set.
    fn complete(&mut self, base: usize) {
        let z = self.points[base].z.clone();
        let others = self.set.iter().filter(|k| **k != base).map(|k| difference(&self.points[*k].z, &z));
        let others: Vec<Vec<f64>> = others.collect();
        let tries = if self.completed.0 == base { self.completed.1 } else { 0 };
        for direction in Selection::of(others.iter().map(|v| &v[..])).missing(self.n()) {
            // Alternate between both sides, with decreasing distance.
            let sign = if tries % 2 == 0 { 1.0 } else { -1.0 };
            let v = self.fitted(&z, &direction, sign * self.delta * 0.5f64.powi((tries / 2) as i32));
            self.ask_for(sum(&z, &v), Role::Near);
        }
        self.completed = (base, tries + 1);
    }

    /// True if the cost differs only by rounding over the whole resolution, and the model predicts no larger
    /// decrease farther away.
    fn is_flat(&self, z: &[f64], linear: &Linear, rounding: f64, room: &Room) -> bool {
        linear.factor.norm_squared() * self.rho * self.rho <= rounding
            && self.best_step(z, linear, self.options.radius.max(self.delta), room).1 <= rounding
    }

    /// Reduces the resolution to a tenth, or to the maximum distance of the minimum if smaller. Near the
    /// limit of the x test, the reductions avoid a short last stage (Powell's rule in BOBYQA: report DAMTP
    /// 2009/NA06, section 6).
    fn refine(&mut self, x_size: f64) {
        self.n_geometry = 0;
        self.delta = 0.5 * self.rho;
        let end = self.x_limit();
        let next = match self.rho / end {
            ratio if ratio > 16.0 && ratio <= 250.0 => ratio.sqrt() * end,
            ratio if ratio > 1.0 && ratio <= 16.0 => end,
            _ => 0.1 * self.rho,
        };
        self.rho = next.min(x_size).max(0.1 * SMALLEST);
        self.delta = self.delta.max(self.rho);
    }

    /// Requests a more informative point to replace a point that is too far away.
    fn improve(&mut self, base: usize, model: &Interpolation, point: usize, distance: f64) {
        let radius = (0.1 * distance).min(0.5 * self.delta).max(self.rho);
        let z = self.points[base].z.clone();
        let room = self.room_around(&z);
        let place = self.set.iter().position(|k| *k == point).unwrap_or(0);
        let step = longest(model.gradient(place), radius, &room, self.n_geometry_failed % 2 == 1);
        self.ask_for(sum(&z, &step), Role::Geometry { instead: point });
    }

    /// Updates the state after a round.
    pub(super) fn descended(&mut self, round: &[Candidate]) {
        match (&round[0].role, round[0].status) {
            (Role::Geometry { .. }, PointStatus::Point(new)) if self.is_wild(new) => {
                self.n_geometry_failed += 1;
                self.delta *= 0.5;
                self.rho = self.rho.min(self.delta);
            }
            (Role::Geometry { instead }, PointStatus::Point(new)) => {
                if let Some(place) = self.set.iter().position(|k| *k == *instead) {
                    let model = self.model.take().filter(|_| self.set.len() == self.n() + 1);
                    self.model = model.and_then(|mut model| {
                        let base = self.set[model.base];
                        let step = difference(&self.points[new].z, &self.points[base].z);
                        let lagrange = model.lagrange(&step);
                        let misfit = self.misfit(base, new, &lagrange);
                        self.follow(&mut model, place, new, &step, &lagrange, &misfit).then_some(model)
                    });
                    self.set[place] = new;
                }
                self.n_geometry_failed = 0;
            }
            (Role::Geometry { .. }, _) => {
                self.n_geometry_failed += 1;
                self.n_failed += 1;
                if self.n_geometry_failed.is_multiple_of(2) {
                    self.delta *= 0.5;
                    self.rho = self.rho.min(self.delta);
                }
            }
            (Role::Trial { .. }, _) => self.tried(round),
            (Role::Probe { misfit }, PointStatus::Point(new)) => {
                let base = self.base();
                let jump = distance(&self.points[new].residuals, &self.points[base].residuals);
                (self.n_noisy, self.failure) = (0, None);
                if jump > JUMP * misfit {
                    self.begin_averaging();
                }
            }
            (Role::Probe { .. }, _) => (self.n_noisy, self.failure) = (0, None),
            (Role::Near | Role::Start(_) | Role::Difference | Role::Check, _) => self.choose_set_from(round),
        }
    }

    /// Updates the state after trial points.
    fn tried(&mut self, round: &[Candidate]) {
        self.n_iterations += 1;
        self.operation = Some(Operation::TrustRegionStep);
        let base = self.base();
        let (f, z) = (self.points[base].cost, self.points[base].z.clone());
        let mut trials = round.iter().filter_map(|candidate| match (&candidate.role, candidate.status) {
            (Role::Trial { predicted, radius }, PointStatus::Point(k)) => Some((k, *predicted, *radius)),
            _ => None,
        });
        let first = trials.next();
        let best = trials.fold(first, |best, new| match best {
            Some(best) if self.points[new.0].cost >= self.points[best.0].cost => Some(best),
            _ => Some(new),
        });
        let (ratio, length) = match best {
            Some((k, predicted, radius)) => {
                self.delta = if self.points[k].cost < f { radius } else { self.delta };
                ((f - self.points[k].cost) / predicted, distance(&self.points[k].z, &z))
            }
            None => (-1.0, distance(&round[0].z, &z)),
        };
        self.delta = if ratio < 0.1 {
            (0.5 * self.delta).min(length)
        } else if ratio < 0.7 {
            (0.5 * self.delta).max(length)
        } else {
            (2.0 * self.delta).min((0.5 * self.delta).max(4.0 * length)).max(self.delta)
        };
        if self.delta <= 1.5 * self.rho {
            self.delta = self.rho;
        }
        self.curvature = None;
        if ratio > 0.0 {
            (self.n_failed, self.n_geometry) = (0, 0);
        }
        let model = self.model.take().or_else(|| self.interpolation(base, &RunContext::new()).ok().flatten());
        if let Some(((k, ..), mut model)) = best.zip(model) {
            let step = difference(&self.points[k].z, &z);
            let lagrange = model.lagrange(&step);
            let off = self.misfit(base, k, &lagrange);
            let misfit = norm(&off);
            let size = length.max(self.farthest(base).1);
            if ratio >= 0.3 {
                self.curvature = Some(misfit / (length * size));
            }
            match self.failure {
                _ if ratio >= 0.7 => (self.failure, self.n_noisy) = (None, 0),
                Some((of, at)) if size <= NEARER * at => {
                    self.n_noisy = if misfit > SMALLER * of { self.n_noisy + 1 } else { 0 };
                    self.failure = Some((misfit, size));
                }
                None if ratio < 0.1 => self.failure = Some((misfit, size)),
                _ => {}
            }
            if self.set.len() == self.n() + 1
                && !self.is_wild(k)
                && let Some(place) = self.replaced(base, k, &lagrange)
            {
                let is_accurate = self.follow(&mut model, place, k, &step, &lagrange, &off);
                self.model = is_accurate.then_some(model);
                self.set[place] = k;
            }
        }
        if self.set.len() <= self.n() {
            self.choose_set_from(round);
        }
        self.look_for_progress(self.base());
        if let Some((misfit, size)) = self.failure.filter(|_| self.n_noisy >= MOST_NOISY) {
            self.probe(misfit, size);
        } else if ratio < 0.1 {
            let base = self.base();
            let (point, distance) = self.farthest(base);
            let is_far = distance > (2.0 * self.delta).max(10.0 * self.rho);
            if best.is_none() {
                self.n_failed += 1;
                self.delta = 0.5 * length;
                self.rho = self.rho.min(self.delta);
            } else if is_far && self.set.len() == self.n() + 1 {
                self.improving = Some(point);
            } else if self.delta <= self.rho {
                // The model has a new point. If new points do not help for long, the resolution is the cause.
                self.n_geometry += 1;
                if (length <= self.rho && ratio < 1e-3) || self.n_geometry > 2 * (self.n() + 1) {
                    self.refine(self.rho);
                }
            }
        }
    }

    /// True if a point is too far outside the range of a linear model. In the model, the coefficients of this
    /// point would leave too few digits for the other points.
    fn is_wild(&self, new: usize) -> bool {
        let largest = self.set.iter().map(|k| self.points[*k].cost).fold(0.0, f64::max);
        self.points[new].cost > WILD * largest
    }

    /// Records whether the search makes more progress than the tolerances. `best` is its best point.
    pub(super) fn look_for_progress(&mut self, best: usize) {
        let Evaluated { z, cost, .. } = &self.points[best];
        let (limit, cost) = (self.judge(0.0, 0.0, *cost).f_limit, *cost);
        self.halt = match self.halt.take() {
            Some(halt) if distance(&halt.z, z) <= self.x_limit() && halt.cost - cost <= limit => {
                Some(Stagnation { n_rounds: halt.n_rounds + 1, ..halt })
            }
            _ => Some(Stagnation { z: z.clone(), cost, n_rounds: 0 }),
        };
    }

    /// Returns the termination in noise. If parameters have diverged so far that their rounding may look like
    /// noise, returns the unbounded termination.
    pub(super) fn end_in_noise(&self, point: usize) -> Termination {
        let space = &self.setup.space;
        let is_far = |i: &usize| self.points[point].x[*i].abs() > RUN_AWAY * space.x0()[*i].abs().max(1.0);
        if space.free().iter().any(is_far) { Termination::Unbounded } else { Termination::Noise }
    }

    /// True if the search has made no progress in `most` rounds for each parameter and one more.
    pub(super) fn is_halted(&self, most: usize) -> bool {
        self.halt.as_ref().is_some_and(|halt| halt.n_rounds > most * (self.n() + 1))
    }

    /// Requests a point so near to the base that smooth residuals hardly change.
    fn probe(&mut self, misfit: f64, size: f64) {
        let base = self.base();
        let z = self.points[base].z.clone();
        let direction: Vec<f64> = (0..self.n()).map(|_| 1.0 / (self.n() as f64).sqrt()).collect();
        let step = self.fitted(&z, &direction, 1e-5 * size);
        self.ask_for(sum(&z, &step), Role::Probe { misfit });
    }

    /// Returns the differences between the residuals at a new point and the model.
    fn misfit(&self, base: usize, new: usize, lagrange: &[f64]) -> Vec<f64> {
        let base = &self.points[base].residuals;
        let mut rest = difference(&self.points[new].residuals, base);
        combine(&mut rest, &self.residuals_of_set(), base, lagrange);
        rest
    }

    fn residuals_of_set(&self) -> Vec<&[f64]> {
        self.set.iter().map(|k| &self.points[*k].residuals[..]).collect()
    }

    /// Updates the model with a new point. Returns false if the model is no longer accurate. `step` leads
    /// from the base point to the new point. `lagrange` and `misfit` are the values at the new point.
    fn follow(
        &self,
        model: &mut Interpolation,
        place: usize,
        new: usize,
        step: &[f64],
        lagrange: &[f64],
        misfit: &[f64],
    ) -> bool {
        let is_better = self.points[new].cost < self.points[self.set[model.base]].cost;
        let new = NewPoint { step, lagrange, residuals: &self.points[new].residuals, misfit };
        model.exchange(place, &new, &self.residuals_of_set(), is_better)
    }

    /// Returns the index in the set of the point that a new one replaces. This is a distant point, or a point
    /// whose position the new one largely covers.
    fn replaced(&self, base: usize, new: usize, lagrange: &[f64]) -> Option<usize> {
        let better = self.points[new].cost < self.points[base].cost;
        let from = if better { new } else { base };
        let weight = |(&k, value): (&usize, &f64)| {
            let distance = distance(&self.points[k].z, &self.points[from].z);
            if k == base && !better { 0.0 } else { value.abs() * (distance / self.delta).powi(2).max(1.0) }
        };
        let weights = self.set.iter().zip(lagrange).map(weight).enumerate();
        let most = weights.fold((0, 0.0), |most, new| if new.1 > most.1 { new } else { most });
        (most.1 > 0.0).then_some(most.0)
    }

    /// Returns the best step of the model from `z`, and the predicted decrease. If nearby points have failed,
    /// the step stays on the side of the points with residuals.
    fn best_step(&self, z: &[f64], linear: &Linear, radius: f64, room: &Room) -> (Vec<f64>, f64) {
        let best = Subproblem { linear, radius, room }.solve();
        if self.failed.is_empty() {
            return best;
        }
        let reach = NEAR * self.delta.max(self.rho);
        let near = |other: &Vec<f64>| Some(difference(other, z)).filter(|d| norm(d) <= reach);
        let mut failed: Vec<Vec<f64>> = self.failed.iter().filter_map(near).collect();
        failed.sort_by(|a, b| norm(a).total_cmp(&norm(b)));
        let good: Vec<Vec<f64>> = self.points.iter().filter_map(|p| near(&p.z)).collect();
        let Some(Plane { normal, limit }) =
            plane(&good, &failed).filter(|p| dot(&p.normal, &best.0) > p.limit)
        else {
            return best;
        };
        // Steps beyond the plane become costly, so that the remaining steps follow the plane.
        let steep = linear.factor.tr_mul(&linear.reached).norm() / radius;
        let weight = (AVOIDANCE * linear.factor.norm_squared().max(steep)).sqrt();
        let row: Vec<f64> = normal.iter().map(|v| weight * v).collect();
        let (step, _) = Subproblem {
            linear: &linear.with_row(&row, -weight * limit),
            ..Subproblem { linear, radius, room }
        }
        .solve();
        let predicted = linear.decrease(&step);
        (step, predicted)
    }
}
