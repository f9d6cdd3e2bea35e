//! One iteration: the choice of the next trial point, and the processing of its cost.

use super::model::{Interpolation, Quadratic};
use super::state::{ModelSearch, Phase};
use super::subproblem::{Region, minimize};
use super::truncated_cg;
use crate::method_interface::tolerances::{TestedSet, ToleranceTests};
use crate::methods::cma_es::CmaEs;
use crate::methods::failure_check::FailureCheck;
use crate::methods::shared::failures::{Plane, plane};
use crate::outcome::termination::Termination;
use crate::values::choices::ToleranceMeasure;
use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Minimum resolution, limited by rounding.
const SMALLEST: f64 = 1e-14;
/// Factor of the resolution when it is exhausted. This and the following constants were tuned with the even
/// halves of the fits, boxes and smooth instances of `benches/quadratic.rs`. That bench uses the odd halves
/// for evaluation.
const REDUCTION: f64 = 0.2;
/// Number of consecutive resolutions with failed steps that indicates noise or a kink.
pub(super) const MOST_REFUSED: usize = 4;
/// Distances, in radii and in resolutions, beyond which points leave the model.
pub(super) const FAR: f64 = 10.0;
const FAR_RESOLUTIONS: f64 = 200.0;
/// Minimum spread of the points along any direction, in units of the radius, with which they determine the
/// gradient.
pub(super) const POISED: f64 = 0.3;
/// Relative decrease of the cost below which a restart counts as unsuccessful.
const NO_PROGRESS: f64 = 1e-9;
/// Factor by which failed steps are shortened. A smaller factor would lead straight to where the objective
/// fails. A larger factor costs evaluations.
const SHORTENED: f64 = 0.8;
/// Distance, in radii, beyond which failed points are ignored.
const NEAR: f64 = 4.0;
/// Curvature across the plane to failed points, in units of the largest curvature of the model.
const AVOIDANCE: f64 = 100.0;

pub(super) fn norm(v: &[f64]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

impl ModelSearch {
    pub(super) fn base(&self) -> usize {
        self.points.best()
    }

    pub(super) fn cost(&self, slot: usize) -> f64 {
        self.points.cost(slot).value().unwrap_or(f64::INFINITY)
    }

    /// Returns the displacement between two points in units of the parameter sizes.
    pub(super) fn displacement(&self, from: &[f64], to: &[f64]) -> Vec<f64> {
        let space = &self.setup.space;
        from.iter().zip(to).enumerate().map(|(k, (from, to))| (to - from) / space.size(k)).collect()
    }

    /// Rebuilds the interpolation, which is not part of a saved state.
    pub(super) fn complete(&mut self) {
        if self.has_many() {
            self.complete_inverse();
        } else if self.interpolation.is_none() {
            self.interpolation = self.interpolate();
        }
    }

    /// Returns the interpolation conditions of the current points.
    fn interpolate(&self) -> Option<Interpolation> {
        let (n, base) = (self.n(), self.base());
        let f = self.points.cost(base).value()?;
        let (mut slots, mut flat) = (Vec::new(), Vec::new());
        for slot in 0..self.points.len() {
            let y = self.displacement(self.points.u(base), self.points.u(slot));
            let length = norm(&y);
            if slot != base && (self.cost(slot) - f).is_finite() && length > 0.0 && length.is_finite() {
                slots.push(slot);
                flat.extend(y);
            }
        }
        Interpolation::new(n, slots, &flat)
    }

    /// Ranks the points, and makes the model interpolate them. `from` is the previous base point of the
    /// model.
    pub(super) fn refit(&mut self, from: &[f64]) {
        self.points.rank();
        if self.has_many() {
            self.rebuild(from);
            return;
        }
        let base = self.base();
        let moved = self.displacement(from, self.points.u(base));
        self.model.gradient = self.model.slope(&moved);
        self.interpolation = self.interpolate();
        let f = self.objective(base);
        let Some(points) = &self.interpolation else { return };
        let values: Vec<f64> = points.slots.iter().map(|&slot| self.objective(slot) - f).collect();
        if !points.update(&mut self.model, &values) {
            self.model = Quadratic::zero(self.setup.space.n_free());
            if !points.update(&mut self.model, &values) {
                self.interpolation = None;
            }
        }
        self.refit_constraints(&moved);
    }

    /// Replaces the model by the model of least norm if the slope of the latter is much smaller (Powell,
    /// NA06, section 6, waits for three consecutive cases).
    fn compare_with_least_norm(&mut self) {
        if self.nonlinear.is_some() {
            return;
        }
        if self.has_many() {
            self.compare_inverse_with_least_norm();
            return;
        }
        let f = self.cost(self.base());
        let Some(points) = &self.interpolation else { return };
        let values: Vec<f64> = points.slots.iter().map(|&slot| self.cost(slot) - f).collect();
        let mut fresh = Quadratic::zero(self.n());
        if !points.update(&mut fresh, &values) {
            return;
        }
        if self.is_much_steeper_than(&fresh.gradient) {
            self.model = fresh;
        }
    }

    /// True if the slope of the model is much larger than the slope of another. Components blocked by bounds
    /// are ignored.
    pub(super) fn is_much_steeper_than(&self, other: &[f64]) -> bool {
        if self.has_rows() {
            return self.free_slope(&self.model.gradient) >= 10.0 * self.free_slope(other);
        }
        let (lower, upper) = self.margins();
        let slope = |gradient: &[f64]| {
            let inward = |(k, g): (usize, &f64)| {
                let blocked = (lower[k] >= 0.0 && *g > 0.0) || (upper[k] <= 0.0 && *g < 0.0);
                if blocked { 0.0 } else { g * g }
            };
            gradient.iter().enumerate().map(inward).sum::<f64>()
        };
        slope(&self.model.gradient) >= 10.0 * slope(other)
    }

    fn first_points(&self) -> usize {
        self.retries.len()
    }

    /// Removes a point other than the best one.
    fn remove(&mut self, slot: usize) {
        let last = self.points.len() - 1;
        let (u, x, cost) =
            (self.points.u(last).to_vec(), self.points.x(last).to_vec(), self.points.cost(last));
        self.points.set(slot, &u, &x);
        self.points.set_cost(slot, cost);
        self.points.resize(last);
        self.points.rank();
    }

    /// Returns the lower and upper bounds on a step from the base point along each coordinate, in units of
    /// the parameter sizes.
    pub(super) fn margins(&self) -> (Vec<f64>, Vec<f64>) {
        let (space, u) = (&self.setup.space, self.points.u(self.base()));
        let ends = |k: usize| {
            let (lower, upper) = space.working_bounds(k);
            (((lower - u[k]) / space.size(k)).min(0.0), ((upper - u[k]) / space.size(k)).max(0.0))
        };
        (0..u.len()).map(ends).unzip()
    }

    /// Returns the best step of the model that avoids failed points.
    pub(super) fn best_step(&self) -> Vec<f64> {
        let (lower, upper) = self.margins();
        let region = Region { radius: self.delta, lower: &lower, upper: &upper };
        let mut step = self.step_within(&self.model, region);
        if self.failed.is_empty() {
            return step;
        }
        let u = self.points.u(self.base());
        let near = |v: &[f64]| {
            let d = self.displacement(u, v);
            (norm(&d) <= NEAR * self.delta.max(self.rho)).then_some(d)
        };
        let mut failed: Vec<Vec<f64>> = self.failed.iter().filter_map(|v| near(v)).collect();
        failed.sort_by(|a, b| norm(a).total_cmp(&norm(b)));
        let good: Vec<Vec<f64>> = (0..self.points.len())
            .filter(|&slot| self.points.cost(slot).value().is_some())
            .filter_map(|slot| near(self.points.u(slot)))
            .collect();
        let Some(Plane { normal, limit }) = plane(&good, &failed) else { return step };
        let beyond = normal.iter().zip(&step).map(|(a, b)| a * b).sum::<f64>() - limit;
        if beyond > 0.0 {
            // Steps beyond the plane become costly, so that the remaining steps follow the plane.
            let steep = norm(&self.model.gradient) / self.delta;
            let largest = self.model.hessian.iter().fold(steep, |m, v| m.max(v.abs()));
            let weight = AVOIDANCE * largest;
            let mut model = self.model.clone();
            for (a, n_a) in normal.iter().enumerate() {
                model.gradient[a] -= weight * limit * n_a;
                for (b, n_b) in normal.iter().enumerate() {
                    model.hessian[a * normal.len() + b] += weight * n_a * n_b;
                }
            }
            step = self.step_within(&model, region);
        }
        step
    }

    fn step_within(&self, model: &Quadratic, region: Region<'_>) -> Vec<f64> {
        if self.nonlinear.is_some() {
            self.constrained_step(model)
        } else if self.has_rows() {
            self.step_within_rows(model)
        } else if self.has_many() {
            truncated_cg::minimize(|v| self.product(&model.hessian, v), &model.gradient, region)
        } else {
            minimize(model, region)
        }
    }

    fn judge(&self, predicted: f64) -> ToleranceTests {
        let space = &self.setup.space;
        let tolerances = &self.setup.tolerances;
        let base = self.base();
        let size = match tolerances.measure {
            ToleranceMeasure::Relative => self.rho,
            ToleranceMeasure::Absolute => {
                let (u, x) = (self.points.u(base), self.points.x(base));
                let moved: Vec<f64> = (0..u.len()).map(|k| u[k] + self.rho * space.size(k)).collect();
                let mut there = x.to_vec();
                space.to_user(&moved, &mut there);
                space.free().iter().map(|&i| (there[i] - x[i]).abs()).fold(0.0, f64::max)
            }
        };
        let tests = tolerances.judge(size, Some(predicted.max(0.0)), self.cost(base), self.f_0);
        let passed = tests.passed && self.is_feasible();
        ToleranceTests { extent: TestedSet::Model, passed, ..tests }
    }

    /// Sets the trust-region radius, with the resolution as lower limit.
    fn set_delta(&mut self, delta: f64) {
        self.delta = if delta <= 1.5 * self.rho { self.rho } else { delta };
    }

    /// Chooses the next point. Each turn without a point shrinks the trust region.
    pub(super) fn choose(&mut self) {
        if !self.failed.is_empty() {
            self.fold();
        }
        while self.phase == Phase::Choosing {
            if self.interpolation.is_none() && self.inverse.is_none() {
                let alone = self.points.n_finite() == 1;
                self.end(if alone { Termination::AllFailed } else { Termination::Collapsed });
                return;
            }
            self.adapt_penalty();
            let s = self.best_step();
            let predicted = -self.change(&s);
            self.tests = Some(self.judge(predicted));
            let visible = f64::EPSILON * self.cost(self.base()).abs();
            if norm(&s) >= 0.5 * self.rho && predicted > visible && self.place_trial(&s) {
                self.phase = Phase::Trial { predicted };
                return;
            }
            // If the model is correct, no decrease is possible at this resolution.
            self.set_delta(0.1 * self.delta);
            if self.improve_geometry(POISED) {
                return;
            }
            if self.delta <= self.rho {
                self.refine();
            }
        }
    }

    /// Makes the end of a step the trial point. Returns false if the point is already known.
    pub(super) fn place_trial(&mut self, s: &[f64]) -> bool {
        let space = &self.setup.space;
        let mut u = self.points.u(self.base()).to_vec();
        for (k, u) in u.iter_mut().enumerate() {
            let (lower, upper) = space.working_bounds(k);
            *u = (*u + s[k] * space.size(k)).clamp(lower, upper);
        }
        space.shorten(self.points.u(self.base()), &mut u);
        let is_repeat =
            self.failed.contains(&u) || (0..self.points.len()).any(|slot| self.points.u(slot) == u);
        if is_repeat || u.iter().any(|u| !u.is_finite()) {
            return false;
        }
        self.trial.place(0, &u, &self.setup.space);
        true
    }

    /// Removes points that are too far away. Then requests a point along the direction in which the others
    /// determine the gradient worst. Requests the point only if the spread at this radius is below `poised`
    /// (Conn, Scheinberg and Vicente 2009, chapter 6: the model must be fully linear).
    fn improve_geometry(&mut self, poised: f64) -> bool {
        if self.has_many() {
            return self.replace_farthest(poised);
        }
        self.improve_within(poised, f64::INFINITY, self.delta)
    }

    /// Improves the geometry with a point at the distance `reach`. Only points within `near` count.
    pub(super) fn improve_within(&mut self, poised: f64, near: f64, reach: f64) -> bool {
        let limit = (FAR * self.delta).max(FAR_RESOLUTIONS * self.rho);
        let n = self.n();
        let (mut slot, before) = (0, self.points.len());
        let mut spread = DMatrix::zeros(n, n);
        while slot < self.points.len() {
            let y = self.displacement(self.points.u(self.base()), self.points.u(slot));
            let length = norm(&y);
            if length > limit && self.points.len() > 2 {
                self.remove(slot);
                continue;
            }
            slot += 1;
            if length.is_finite() && length <= near {
                // A point outside this distance counts like a point at this distance.
                let unit = length.max(reach);
                spread.ger(
                    1.0 / (unit * unit),
                    &DVector::from_column_slice(&y),
                    &DVector::from_vec(y.clone()),
                    1.0,
                );
            }
        }
        if self.points.len() < before {
            let from = self.points.u(self.base()).to_vec();
            self.refit(&from);
        }
        let Some(eigen) = SymmetricEigen::try_new(spread, f64::EPSILON, 1000 * n) else { return false };
        let (place, least) = eigen.eigenvalues.argmin();
        let have = least.max(0.0).sqrt();
        if have >= poised {
            return false;
        }
        let (lower, upper) = self.margins();
        let direction = eigen.eigenvectors.column(place);
        let towards = |length: f64| {
            let s: Vec<f64> =
                direction.iter().enumerate().map(|(k, v)| (length * v).clamp(lower[k], upper[k])).collect();
            let s = self.nearest_inside(s);
            let along = s.iter().zip(direction.iter()).map(|(s, v)| s * v).sum::<f64>().abs();
            (s, along)
        };
        let (mut first, mut second) = (towards(reach), towards(-reach));
        if second.1 > first.1 {
            std::mem::swap(&mut first, &mut second);
        }
        for (s, along) in [first, second, towards(0.25 * reach), towards(-0.25 * reach)] {
            if along > 2.0 * have.min(POISED) * reach && self.place_trial(&s) {
                self.phase = Phase::Geometry;
                return true;
            }
        }
        false
    }

    /// Updates the state after the cost of a point that improves the model.
    pub(super) fn geometry_evaluated(&mut self) {
        let base = self.base();
        let from = self.points.u(base).to_vec();
        let s = self.displacement(&from, self.trial.u(0));
        let Some(cost) = self.trial.cost(0).value().filter(|cost| (cost - self.cost(base)).is_finite())
        else {
            self.remember_failed(self.trial.u(0).to_vec());
            return;
        };
        self.note_error(self.cost(base) + self.change(&s) - cost);
        self.take_trial(&from, &s, cost < self.cost(base));
    }

    /// Adds the trial point to the model and refits the model. `s` is the displacement of the point from the
    /// base point at `from`.
    fn take_trial(&mut self, from: &[f64], s: &[f64], better: bool) {
        if self.has_many() {
            return self.exchange(s, better);
        }
        if let Some(slot) = self.slot_to_replace(s, better) {
            self.points.copy_from(slot, &self.trial, 0);
        }
        self.refit(from);
    }

    /// Updates the state after the cost of the best point of the model.
    pub(super) fn trial_evaluated(&mut self, predicted: f64) {
        let base = self.base();
        let from = self.points.u(base).to_vec();
        let s = self.displacement(&from, self.trial.u(0));
        let length = norm(&s);
        let decrease = self.trial.cost(0).value().map(|cost| self.cost(base) - cost);
        let Some(decrease) = decrease.filter(|decrease| decrease.is_finite()) else {
            self.remember_failed(self.trial.u(0).to_vec());
            self.delta = SHORTENED * length;
            self.rho = self.rho.min(self.delta);
            if self.rho < SMALLEST {
                self.restart();
            }
            return;
        };
        self.note_error(decrease - predicted);
        let ratio = decrease / predicted;
        self.set_delta(if ratio <= 0.1 {
            (0.5 * self.delta).min(length)
        } else if ratio <= 0.7 {
            (0.5 * self.delta).max(length)
        } else {
            (0.5 * self.delta).max(2.0 * length)
        });
        if ratio > 0.1 {
            self.forget_refusals();
        }
        self.take_trial(&from, &s, decrease > 0.0);
        if !self.has_many() || ratio <= 0.1 {
            self.compare_with_least_norm();
        }
        if ratio <= 0.1
            && !self.improve_geometry(POISED)
            && ratio <= 0.0
            && self.delta.max(length) <= self.rho
        {
            self.refused = Some((predicted - decrease) / length);
            self.refine();
        }
    }

    fn note_error(&mut self, error: f64) {
        self.last_errors = [error.abs(), self.last_errors[0]];
    }

    fn forget_refusals(&mut self) {
        (self.refused, self.largest_bend, self.n_refused) = (None, 0.0, 0);
    }

    /// Returns the slot for the trial point. This is an empty slot, or the slot whose removal leaves the best
    /// determined model. Far points are preferred (Powell, NA06, equation 6.1 and its weights).
    fn slot_to_replace(&mut self, s: &[f64], better: bool) -> Option<usize> {
        if let Some(slot) = self.unused_slot() {
            return Some(slot);
        }
        let points = self.interpolation.as_ref()?;
        let slots = points.slots.iter().copied().chain([self.base()]);
        self.most_dispensable(slots.zip(points.lagrange(s).map(|(_, factor)| factor)), better)
    }

    /// Returns a slot without a point of the model.
    pub(super) fn unused_slot(&mut self) -> Option<usize> {
        let empty = (0..self.points.len()).find(|&slot| self.points.cost(slot).value().is_none());
        if empty.is_none() && self.points.len() < self.most_points {
            let end = self.points.len();
            self.points.resize(end + 1);
            self.points.rank();
            return Some(end);
        }
        empty
    }

    /// Returns the slot to be replaced by the trial point. `factors` contains slots with the growth factors
    /// of the determinant of the conditions.
    pub(super) fn most_dispensable(
        &self,
        factors: impl Iterator<Item = (usize, f64)>,
        better: bool,
    ) -> Option<usize> {
        let base = self.base();
        let from = if better { self.trial.u(0) } else { self.points.u(base) };
        let mut chosen = (None, 0.0);
        for (slot, factor) in factors {
            if slot == base && !better {
                continue;
            }
            let distance =
                norm(&self.displacement(from, self.points.u(slot))) / (0.1 * self.delta).max(self.rho);
            let weight = factor.abs() * distance.powi(8).max(1.0);
            if weight > chosen.1 {
                chosen = (Some(slot), weight);
            }
        }
        chosen.0
    }

    /// True if the slope error of the model along the last failed step may hide a decrease. The hidden
    /// decrease within the extent of the model must exceed the limit of the f test.
    pub(super) fn may_be_steep(&self) -> bool {
        let hidden = self.refused.map_or(0.0, |error| error * self.extent());
        let predicted = -self.change(&self.best_step());
        hidden > 0.0 && !self.judge(predicted.max(0.0) + hidden).passed
    }

    /// True if a point failed within the radius of the last start, around the best point. Steps avoid this
    /// point, so costs beyond it are unknown.
    fn is_beside_failures(&self) -> bool {
        let u = self.points.u(self.base());
        self.failed.iter().any(|v| norm(&self.displacement(u, v)) <= self.radius)
    }

    /// Ends the search, or starts the search for a lower cost if points near the best one failed.
    fn end(&mut self, termination: Termination) {
        self.phase = Phase::Ended(termination);
        if !self.is_beside_failures() {
            return;
        }
        let best = self.base();
        let least = self.tests.map_or(0.0, |tests| tests.f_limit);
        if !self.is_supported_by(&CmaEs::default()) {
            self.phase = Phase::Ended(Termination::BesideFailures);
            return;
        }
        let point = (self.points.x(best), self.cost(best));
        self.phase = match FailureCheck::new(&self.setup, point, least, self.rounds.counts()) {
            Ok(check) => {
                self.check = Some(check);
                Phase::BesideFailures
            }
            Err(_) => Phase::Ended(Termination::BesideFailures),
        };
    }

    /// Ends the search, reduces the resolution, or restarts after the resolution is exhausted.
    fn refine(&mut self) {
        self.fold();
        if self.continues_after_check() {
            return;
        }
        let found = self.look_for_roughness();
        self.roughness = found.or(self.roughness);
        if self.hand_over && (found.is_some() || self.n_undecided > 0) && self.hand_over() {
            return;
        }
        let (passed, is_inaccurate) = (self.has_passed(), self.is_inaccurate());
        if passed {
            self.n_smooth = if found.is_some() { 0 } else { self.n_smooth + 1 };
        }
        if passed && found.is_none() && (self.roughness.is_none() || self.n_smooth >= self.restarts) {
            self.roughness = None;
            self.end(Termination::Converged);
            return;
        }
        if self.is_flat() {
            // Costs may differ at a larger distance.
            self.radius *= 2.0;
            self.restart();
            if self.phase == Phase::Starting {
                self.roughness = None;
            }
            return;
        }
        if passed {
            // Points at the same distance would give the same evidence. A larger distance covers more
            // resolutions.
            self.radius *= 2.0;
        }
        if passed || self.n_refused >= MOST_REFUSED || self.rho <= SMALLEST {
            self.restart();
            return;
        }
        let tolerance = match self.setup.tolerances.measure {
            ToleranceMeasure::Relative => self.setup.tolerances.x_tol,
            ToleranceMeasure::Absolute => 0.0,
        };
        self.delta = 0.5 * self.rho;
        // Powell's reductions: by a constant factor, and near the end to the last resolution in two steps or
        // one.
        self.rho = match self.rho / tolerance {
            ratio if ratio <= 1.0 || ratio > 250.0 => REDUCTION * self.rho,
            ratio if ratio > 16.0 => (self.rho * tolerance).sqrt(),
            _ => tolerance,
        };
        self.delta = self.delta.max(self.rho);
        self.refused = None;
        if is_inaccurate {
            self.improve_geometry(f64::INFINITY);
        }
    }

    /// Restarts with new points around the best one.
    fn restart(&mut self) {
        let best = self.base();
        let f = self.cost(best);
        let useless = f >= self.f_restart - NO_PROGRESS * self.f_restart.abs();
        self.n_useless = if useless { self.n_useless + 1 } else { 0 };
        if self.n_useless > self.restarts {
            self.end(Termination::Stalled);
            return;
        }
        self.f_restart = f;
        self.last_errors = [f64::INFINITY; 2];
        self.curvatures.clear();
        self.forget_refusals();
        (self.delta, self.rho) = (self.radius, self.radius);
        self.trial.copy_from(0, &self.points, best);
        self.points.copy_from(0, &self.trial, 0);
        self.points.resize(self.first_points());
        self.inverse = None;
        self.place_around();
        self.phase = Phase::Starting;
    }
}
