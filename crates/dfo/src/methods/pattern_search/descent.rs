//! Search for a descent direction that no poll has found, before a point counts as a minimum.

use super::discrete_gradients::{Blocked, DIFFERENCE, Descent, DiscreteGradients, Partial, implied};
use super::poll::Poll;
use super::state::{Phase, Polling};
use crate::method_interface::interface::{AnswersSoFar, Batch, Operation};
use crate::methods::shared::cost::Cost;

/// Shortest difference along an axis between linear constraints, in units of its usual length.
const SHORTEST: f64 = 0.01;

/// Distance from a linear constraint, in units of the step, up to which it blocks descent directions.
const NEARLY_ON: f64 = 0.01;

/// Factor by which the steps are shortened if none of the current length leads down.
const SHORTER: f64 = 0.1;

impl Polling {
    /// Starts the search for a descent direction from the best point. The first steps are as long as the
    /// first frame, later ones are shorter.
    pub(super) fn begin_descent(&mut self, least: f64) {
        let f_begin = self.best_cost();
        self.phase = Phase::Descending;
        self.descend_with(Descent {
            gradients: self.no_gradients(),
            scale: 1.0,
            least,
            f_begin,
            partial: None,
        });
    }

    fn no_gradients(&self) -> DiscreteGradients {
        let mut first = vec![0.0; self.step.len()];
        Poll::of_halton(first.len(), self.n_refined + 1).direction(0, &mut first);
        DiscreteGradients::new(first)
    }

    /// Requests the end point of the next step, or ends if the steps have become as short as the frame.
    fn descend_with(&mut self, mut descent: Descent) {
        descent.partial = None;
        loop {
            let length = self.first * descent.scale;
            let step: Vec<f64> = descent.gradients.direction().iter().map(|d| length * d).collect();
            if self.place_trial(&step) {
                self.descent = Some(descent);
                return;
            }
            if !self.shorten(&mut descent) {
                return;
            }
        }
    }

    /// Returns the displacement of the trial point from the best one, in units of the parameter sizes.
    fn displacement(&self) -> Vec<f64> {
        let (space, from) = (&self.setup.space, self.best.u(0));
        self.trial.0.iter().enumerate().map(|(k, u)| (u - from[k]) / space.size(k)).collect()
    }

    /// Shortens the steps. Returns false at the end of the search.
    fn shorten(&mut self, descent: &mut Descent) -> bool {
        descent.scale *= SHORTER;
        descent.gradients = self.no_gradients();
        if descent.scale >= self.scale {
            return true;
        }
        self.descent = None;
        self.descended(self.best_cost() < descent.f_begin);
        false
    }

    /// Processes the cost of the trial point.
    pub(super) fn descend(&mut self, cost: Cost) {
        let Some(mut descent) = self.descent.take() else { return };
        if descent.partial.is_some() {
            self.differentiate(descent, cost);
            return;
        }
        match cost.value() {
            Some(value) if value < self.best_cost() - descent.least => {
                self.accept(cost);
                self.n_doubled = 0;
                descent.gradients = self.no_gradients();
                self.descent = Some(descent);
                self.extend();
            }
            Some(value) => {
                descent.partial = Some(Partial {
                    derivatives: vec![0.0; self.step.len()],
                    axis: 0,
                    u: self.trial.0.clone(),
                    cost: value,
                    change: value - self.best_cost(),
                    step: self.displacement(),
                });
                self.next_difference(descent, 0);
            }
            // A failure contains no information on the cost.
            None => {
                if self.shorten(&mut descent) {
                    self.descend_with(descent);
                }
            }
        }
    }

    /// Requests the next point of a gradient, along the coordinates from `from` on, or the next step.
    fn next_difference(&mut self, mut descent: Descent, from: usize) {
        let Some(partial) = &mut descent.partial else { return };
        let implied = implied(&partial.step);
        let mut trial = std::mem::take(&mut self.trial);
        let found = (from..self.step.len())
            .find(|&axis| axis != implied && self.place_beside(&partial.u, axis, descent.scale, &mut trial));
        self.trial = trial;
        if let Some(axis) = found {
            partial.axis = axis;
            self.descent = Some(descent);
            return;
        }
        let mut gradient = std::mem::take(&mut partial.derivatives);
        let explained: f64 = gradient.iter().zip(&partial.step).map(|(g, s)| g * s).sum();
        gradient[implied] = (partial.change - explained) / partial.step[implied];
        let space = &self.setup.space;
        let at = |is_at: &dyn Fn(f64, (f64, f64)) -> bool| -> Vec<bool> {
            self.best.u(0).iter().enumerate().map(|(k, u)| is_at(*u, space.working_bounds(k))).collect()
        };
        let bounds = (at(&|u, (lower, _)| u <= lower), at(&|u, (_, upper)| u >= upper));
        let blocked = Blocked {
            at_lower: &bounds.0,
            at_upper: &bounds.1,
            rows: if space.rows().is_empty() {
                Vec::new()
            } else {
                self.near_rows(self.best.u(0), NEARLY_ON * self.first * descent.scale).collect()
            },
        };
        let slope = descent.gradients.add(gradient, &blocked);
        let gain = slope.map_or(0.0, |slope| self.first * descent.scale * slope);
        if gain > descent.least || self.shorten(&mut descent) {
            self.descend_with(descent);
        }
    }

    /// Places a point next to `u` along a coordinate. Returns false if there is none.
    fn place_beside(
        &self,
        u: &[f64],
        axis: usize,
        scale: f64,
        (trial, x): &mut (Vec<f64>, Vec<f64>),
    ) -> bool {
        let space = &self.setup.space;
        let (lower, upper) = space.working_bounds(axis);
        let distance = DIFFERENCE * scale * self.first * space.size(axis);
        trial.copy_from_slice(u);
        let forward = (u[axis] + distance).min(upper);
        trial[axis] =
            if forward - u[axis] >= 0.5 * distance { forward } else { (u[axis] - distance).max(lower) };
        if !space.satisfies_rows(trial) {
            let ends = [forward, (u[axis] - distance).max(lower)].map(|end| {
                trial[axis] = end;
                space.shorten(u, trial);
                trial[axis]
            });
            let [up, down] = ends.map(|end| (end - u[axis]).abs());
            trial.copy_from_slice(u);
            trial[axis] = if up >= down { ends[0] } else { ends[1] };
            // Without enough room, the derivative counts as zero.
            if up.max(down) < SHORTEST * distance || !space.satisfies_rows(trial) {
                trial.copy_from_slice(u);
            }
        }
        space.to_user(trial, x);
        trial[axis] != u[axis]
    }

    fn differentiate(&mut self, mut descent: Descent, cost: Cost) {
        let Some(partial) = &mut descent.partial else { return };
        let axis = partial.axis;
        if let Some(cost) = cost.value() {
            let distance = (self.trial.0[axis] - partial.u[axis]) / self.setup.space.size(axis);
            partial.derivatives[axis] = (cost - partial.cost) / distance;
            (partial.u[axis], partial.cost) = (self.trial.0[axis], cost);
        }
        self.next_difference(descent, axis + 1);
    }

    /// Continues the search after a step that led down has been doubled as long as the cost decreased.
    pub(super) fn descend_on(&mut self) {
        self.conclude(Operation::Poll);
        self.phase = Phase::Descending;
        if let Some(descent) = self.descent.take() {
            self.descend_with(descent);
        }
    }

    /// Adds the points that follow if the step does not lead down.
    pub(super) fn speculate_on_descent(
        &self,
        wanted: usize,
        answers_so_far: &dyn AnswersSoFar,
        batch: &mut Batch,
    ) {
        let Some(descent) = &self.descent else { return };
        let mut ahead = self.trial.clone();
        let (from, implied) = match &descent.partial {
            Some(partial) => (partial.axis + 1, implied(&partial.step)),
            None => (0, implied(&self.displacement())),
        };
        for axis in (from..self.step.len()).filter(|axis| *axis != implied) {
            if batch.len() == wanted {
                return;
            }
            let u = ahead.0.clone();
            if self.place_beside(&u, axis, descent.scale, &mut ahead) && !answers_so_far.contains(&ahead.1) {
                batch.push(&ahead.1, f64::INFINITY);
            }
        }
    }
}
