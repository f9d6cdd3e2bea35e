//! One iteration: the next required trial point, the decision from the known ones, and the end of the
//! iteration.

use super::initial;
use super::restart;
use super::state::{NelderMeadState, Phase, Role};
use super::trial::{Frame, Seen, Trial};
use crate::method_interface::interface::{Batch, Operation};
use crate::method_interface::tolerances::ToleranceTests;
use crate::methods::failure_check::FailureCheck;
use crate::methods::shared::cost::Cost;
use crate::methods::shared::size_search::SizeSearch;
use crate::outcome::termination::Termination;

/// Size below which a simplex can only become much smaller by collapsing to a point.
const RESOLVED: f64 = 1e-12;

impl NelderMeadState {
    /// Returns the cost at which an evaluation may stop without changing a decision.
    fn cutoff(&self, trial: Trial) -> f64 {
        let worst = self.worst_cost();
        match (trial, self.trials[Trial::Reflection as usize].seen) {
            (Trial::Expansion | Trial::Outside, Seen::Cost(reflected)) if worst.is_finite() => reflected,
            _ => worst,
        }
    }

    /// Returns the cost above which no point is accepted in this or a later iteration. Infinite while the
    /// worst vertex has failed.
    pub(super) fn worst_cost(&self) -> f64 {
        self.simplex.cost(self.simplex.worst()).value().unwrap_or(f64::INFINITY)
    }

    pub(super) fn place(&mut self, trial: Trial) {
        let frame = Frame {
            space: &self.setup.space,
            handling: self.handling,
            factor: trial.factor(&self.numbers),
            centroid: &self.centroid,
            worst: self.simplex.u(self.simplex.worst()),
            fallback: self.simplex.u(self.simplex.best()),
        };
        frame.place(&mut self.trials[trial as usize], |u| self.simplex.has_vertex(u));
    }

    pub(super) fn request_trial(&mut self, trial: Trial, batch: &mut Batch) {
        let cutoff = self.cutoff(trial);
        batch.push(&self.trials[trial as usize].x, cutoff);
        self.roles.push(Role::Trial(trial));
    }

    /// Returns the cost of a trial point, `Ok(None)` if it was rejected, or `Err` if it is not known yet.
    fn trial_cost(&self, trial: Trial) -> Result<Option<f64>, Trial> {
        match self.trials[trial as usize].seen {
            Seen::Unknown => Err(trial),
            Seen::Cost(v) => Ok(Some(v)),
            Seen::Rejected => Ok(None),
        }
    }

    /// Returns the trial point to accept, or `None` for a shrink (Lagarias et al. 1998, section 2, steps 2 to
    /// 5). `Err` contains the next required trial point.
    fn accepted_trial(&self) -> Result<Option<(Trial, f64)>, Trial> {
        let [best, second_worst, worst] =
            [self.simplex.best(), self.simplex.second_worst(), self.simplex.worst()]
                .map(|s| self.simplex.cost(s));
        let reflected = self.trial_cost(Trial::Reflection)?;
        let reflection_beats = |cost| reflected.is_some_and(|r| Cost::Value(r).better_than(cost));
        if let Some(r) = reflected.filter(|_| reflection_beats(best)) {
            return Ok(Some(match self.trial_cost(Trial::Expansion)? {
                Some(e) if e < r => (Trial::Expansion, e),
                _ => (Trial::Reflection, r),
            }));
        }
        if let Some(r) = reflected.filter(|_| reflection_beats(second_worst)) {
            return Ok(Some((Trial::Reflection, r)));
        }
        if let Some(r) = reflected.filter(|_| reflection_beats(worst)) {
            let outside = self.trial_cost(Trial::Outside)?.filter(|c| *c <= r);
            return Ok(outside.map(|c| (Trial::Outside, c)));
        }
        let inside = self.trial_cost(Trial::Inside)?.filter(|c| Cost::Value(*c).better_than(worst));
        Ok(inside.map(|c| (Trial::Inside, c)))
    }

    /// Applies the decision that follows from the trial points.
    pub(super) fn decide(&mut self) -> Result<Operation, Trial> {
        match self.accepted_trial()? {
            Some((trial, value)) => {
                let point = &self.trials[trial as usize];
                self.simplex.replace_worst(&point.u, &point.x, value);
                Ok(trial.operation())
            }
            None => {
                self.simplex.shrink(self.numbers.shrink, &self.setup.space);
                Ok(Operation::Shrink)
            }
        }
    }

    fn begin_iteration(&mut self) {
        for point in &mut self.trials {
            point.seen = Seen::Unknown;
        }
        self.simplex.centroid(&mut self.centroid);
        self.phase = Phase::Evaluating(Trial::Reflection);
    }

    pub(super) fn end_iteration(&mut self, operation: Operation) {
        self.n_iterations += 1;
        self.operation = Some(operation);
        let space = &self.setup.space;
        let tolerances = &self.setup.tolerances;
        let f_best = self.simplex.cost(self.simplex.best()).value().unwrap_or(f64::NAN);
        let x_size = self.simplex.x_size(space, tolerances.measure);
        let tests = tolerances.judge(x_size, self.simplex.f_spread(self.simplex.order()), f_best, self.f_0);
        let before = self.tests.replace(tests).map(|before| before.x_size);
        self.spreads.enter(&tests);
        let collapsed = self.simplex.is_collapsed(space);
        if tests.passed {
            // Vertices that all coincide are not evidence of convergence, unless the previous simplex was
            // about as small.
            let came_there = before.is_some_and(|size| size <= (10.0 * tolerances.x_tol).max(RESOLVED));
            if x_size == 0.0 && !came_there {
                self.end(Termination::Collapsed);
            } else if let Some(side) = self.side_of_restart(&tests) {
                self.restarts -= 1;
                self.f_restart = Some(tests.f_best);
                restart::orient(&mut self.simplex, &self.setup.space, side);
                self.phase = Phase::Restarting;
            } else if self.sizing {
                let (space, limit) = (&self.setup.space, tests.f_limit);
                let from = (self.simplex.x(self.simplex.best()), tests.f_best);
                self.sizes = Some(SizeSearch::beside(space, from, limit, self.sizes.as_ref()));
                self.phase = Phase::Checking;
                self.size_step_answered();
            } else {
                self.converged(tests.f_limit);
            }
        } else if collapsed {
            let alone = self.simplex.n_finite() == 1;
            self.end(if alone { Termination::OneFiniteVertex } else { Termination::Collapsed });
        } else {
            self.begin_iteration();
        }
    }

    /// Returns the edge of a new simplex, in units of the parameter sizes, if a restart is required although
    /// the tests passed. A restart is required if the old simplex is on a kink, or flat for a reason other
    /// than a bound. The last restart, if any, must have lowered the cost by more than the f test allows.
    fn side_of_restart(&mut self, tests: &ToleranceTests) -> Option<f64> {
        let useless = self.f_restart.is_some_and(|f| f - tests.f_best <= tests.f_limit);
        let space = &self.setup.space;
        let is_on_bound = || restart::free_coordinates(&self.simplex, space).count() < space.n_free();
        let (has_kinks, is_on_row) = (self.spreads.judge(), restart::is_on_row(&self.simplex, space));
        if self.restarts == 0 || useless {
            None
        } else if is_on_row || has_kinks && !is_on_bound() {
            Some(restart::SIDE_AT_KINKS)
        } else {
            restart::is_flat(&self.simplex, space).then(|| self.simplex.relative_size(space))
        }
    }

    /// Ends the search without a lower cost. If points near the best one failed, first starts the check for a
    /// lower cost between them.
    fn converged(&mut self, f_limit: f64) {
        let best = self.simplex.best();
        let point = (self.simplex.x(best), self.simplex.cost(best).value().unwrap_or(f64::NAN));
        let check = self
            .failed
            .are_near(point.0, &self.setup.space)
            .then(|| FailureCheck::new(&self.setup, point, f_limit, (self.n_batches, self.n_points)));
        match check {
            None => self.end(Termination::Converged),
            Some(Err(_)) => self.end(Termination::BesideFailures),
            Some(Ok(check)) => (self.phase, self.check) = (Phase::BesideFailures, Some(check)),
        }
    }

    pub(super) fn end(&mut self, termination: Termination) {
        self.phase = Phase::Done;
        self.ended = Some(termination);
    }

    /// Processes a step of a size search, or the start point of the search.
    pub(super) fn size_step_answered(&mut self) {
        let space = &mut self.setup.space;
        match (&self.sizes, self.simplex.cost(0)) {
            (None, Cost::Pending) => {}
            (None, Cost::Value(f_0)) => {
                self.sizes = Some(SizeSearch::from_start(space, self.simplex.x(0), f_0));
                self.size_step_answered();
            }
            // Without a cost at the start, no comparison is possible.
            (None, Cost::Infeasible(_) | Cost::Failed) => self.phase = Phase::Starting,
            (Some(search), _) if !search.is_over() => {}
            (Some(search), _) => {
                if self.phase == Phase::Checking {
                    if !search.is_lower() {
                        return self.converged(self.tests.map_or(0.0, |tests| tests.f_limit));
                    }
                    self.restarts = self.restarts.saturating_sub(1);
                }
                self.simplex = initial::around(space, search);
                self.phase = if self.phase == Phase::Checking { Phase::Restarting } else { Phase::Starting };
                if !self.simplex.is_pending() {
                    self.vertices_evaluated();
                }
            }
        }
    }

    /// Continues after all requested vertices are known.
    pub(super) fn vertices_evaluated(&mut self) {
        let phase = self.phase;
        self.simplex.sort();
        match phase {
            Phase::Shrinking => return self.end_iteration(Operation::Shrink),
            Phase::Restarting => return self.end_iteration(Operation::Restart),
            Phase::Starting
            | Phase::Sizing
            | Phase::Checking
            | Phase::BesideFailures
            | Phase::Evaluating(_)
            | Phase::Done => {}
        }
        if self.simplex.cost(self.simplex.best()).value().is_none() {
            self.phase = Phase::Done;
            return;
        }
        // Steps of the size search may already have come near the minimum.
        let start = self.sizes.as_ref().map(|search| search.base().1.abs()).filter(|f| *f > 0.0);
        self.f_0 = self.f_0.max(start.unwrap_or_else(|| self.simplex.smallest_cost()));
        self.operation = Some(Operation::Initial);
        if self.setup.space.n_free() == 0 {
            return self.end(Termination::AllFixed);
        }
        self.begin_iteration();
    }
}
