//! The running search: the next required point, and the processing of its cost.

use super::discrete_gradients::Descent;
use super::options::PatternSearch;
use super::poll::Poll;
use crate::error::Error;
use crate::method_interface::interface::{
    AnswersSoFar, Batch, Lookahead, Method, MethodDetails, Operation, Setup, Status, saved,
};
use crate::method_interface::tolerances::{TestedSet, ToleranceTests};
use crate::methods::failure_check::{FailedPoints, FailureCheck};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::outcome::answer::Answers;
use crate::outcome::termination::Termination;
use crate::problem::constraints::quadratic_program::HalfSpace;
use crate::values::choices::{BoundsHandling, ToleranceMeasure, Transform};
use serde::{Deserialize, Serialize};

/// Number of frames whose gain the f test measures.
const FRAMES: usize = 4;

/// Number of doublings of a step that double the frame.
const DOUBLINGS: u32 = 3;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) enum Phase {
    /// The start point is evaluated.
    Starting,
    /// The points of the poll are evaluated.
    Polling,
    /// A step that lowered the cost is doubled.
    Extending,
    /// The search for a descent direction that no poll has found.
    Descending,
    /// The tests have passed near failed points. CMA-ES searches for a lower cost between them.
    BesideFailures,
    NoStart,
    Ended(Termination),
}

/// Maximum size of a frame that may still grow, to avoid overflow.
const LARGEST: f64 = 1e100;

/// A pattern search with known sizes.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Polling {
    pub(super) setup: Setup,
    batch: Lookahead,
    pub(super) phase: Phase,
    /// The best point, or the start.
    pub(super) best: RankedPoints,
    pub(super) trial: (Vec<f64>, Vec<f64>),
    /// Size of the first frame, and the current size as a multiple of the first.
    pub(super) first: f64,
    pub(super) scale: f64,
    poll: Poll,
    /// Index of the trial point in the poll.
    place: usize,
    /// Number of times that the frame has shrunk.
    pub(super) n_refined: u64,
    /// The best point when the frame last shrank, in working coordinates.
    reference: Vec<f64>,
    /// The last step, in units of the parameter sizes, and the number of its doublings.
    pub(super) step: Vec<f64>,
    pub(super) n_doubled: u32,
    /// The best cost when each of the last frames shrank.
    gains: Vec<f64>,
    /// Number of consecutive restarts that must gain nothing, number of such restarts so far, and best cost
    /// at the last start.
    restarts: usize,
    n_idle: usize,
    f_begin: f64,
    /// The tests that had passed when no descent direction was found. They remain valid until a better point
    /// is found.
    passed: Option<ToleranceTests>,
    /// The search for a descent direction.
    #[serde(default)]
    pub(super) descent: Option<Descent>,
    /// Points that failed in the search for a descent direction.
    #[serde(default)]
    failed: FailedPoints,
    #[serde(default)]
    check: Option<FailureCheck>,
    /// Number of points in the last batch.
    #[serde(default)]
    #[serde(rename = "n_asked")]
    n_requested: usize,
    waiting: bool,
    n_points: u64,
    n_iterations: usize,
    operation: Option<Operation>,
    tests: Option<ToleranceTests>,
    f_0: f64,
}

impl Polling {
    pub(super) fn new(options: &PatternSearch, setup: Setup) -> Self {
        let (space, n) = (&setup.space, setup.space.n_free());
        let mut best = RankedPoints::new(space, 1);
        best.place_exactly(0, space.x0(), space);
        Self {
            reference: best.u(0).to_vec(),
            trial: (best.u(0).to_vec(), best.x(0).to_vec()),
            best,
            batch: options.batch,
            phase: Phase::Starting,
            first: options.frame,
            scale: 1.0,
            poll: Poll::along_axes(n),
            place: 0,
            n_refined: 0,
            step: vec![0.0; n],
            n_doubled: 0,
            gains: Vec::with_capacity(FRAMES + 1),
            restarts: options.restarts,
            n_idle: 0,
            f_begin: f64::INFINITY,
            passed: None,
            descent: None,
            failed: FailedPoints::new(setup.space.n()),
            check: None,
            n_requested: 0,
            waiting: false,
            n_points: 0,
            n_iterations: 0,
            operation: None,
            tests: None,
            f_0: 0.0,
            setup,
        }
    }

    /// True if the state is consistent with itself and with the problem.
    pub(super) fn is_sound(&self, setup: &Setup) -> bool {
        let n = setup.space.n_free();
        // The frame size is at most the first size or the maximum size of a growing frame.
        let space = &setup.space;
        let is_inside = |u: &[f64]| {
            u.len() == n
                && u.iter().enumerate().all(|(k, u)| {
                    let (lower, upper) = space.working_bounds(k);
                    lower <= *u && *u <= upper && u.is_finite()
                })
        };
        let is_length = |length: f64| length > 0.0 && length <= self.first.max(2.0 * LARGEST);
        self.setup.space == *space
            && self.setup.tolerances.check().is_ok()
            && self.first > 0.0
            && self.first.is_finite()
            && is_length(self.first * self.scale)
            && self.scale > 0.0
            && self.scale.is_finite()
            && self.best.len() == 1
            && self.best.is_sound(space)
            && is_inside(&self.trial.0)
            && space.bounds().contains(&self.trial.1)
            && self.poll.is_sound(n)
            && (self.place < self.poll.len() || self.phase != Phase::Polling)
            && (self.phase != Phase::Descending || self.descent.is_some())
            && self.descent.as_ref().is_none_or(|descent| descent.is_sound(n))
            && self.failed.is_sound(space.n())
            && (self.phase != Phase::BesideFailures || self.check.is_some())
            && self.check.as_ref().is_none_or(|check| check.is_sound(&self.setup))
            && (self.reference.len(), self.step.len()) == (n, n)
    }

    pub(super) fn best_cost(&self) -> f64 {
        self.best.cost(0).value().unwrap_or(f64::INFINITY)
    }

    /// Computes the step to point `k` of a poll, in units of the parameter sizes. The step is on the mesh of
    /// a frame of this scale.
    fn poll_step(&self, poll: &Poll, k: usize, scale: f64, out: &mut [f64]) {
        poll.direction(k, out);
        if poll.is_conforming(k) {
            out.iter_mut().for_each(|d| *d *= self.first * scale);
            return;
        }
        let mesh = scale.min(scale * scale);
        out.iter_mut().for_each(|d| *d = self.first * mesh * (scale * *d / mesh).round());
    }

    /// Places the point at a step from the best one, in working coordinates and in the user's units. Returns
    /// false if the result is the best point itself.
    fn place(&self, step: &[f64], (u, x): &mut (Vec<f64>, Vec<f64>)) -> bool {
        let space = &self.setup.space;
        for (k, (u, step)) in u.iter_mut().zip(step).enumerate() {
            let here = self.best.u(0)[k];
            *u = space.bring_inside(k, here + space.size(k) * step, here, BoundsHandling::Clamp);
        }
        // The nearest feasible point. Its step follows the constraints.
        space.restore(u);
        space.to_user(u, x);
        x != self.best.x(0)
    }

    /// Makes the point at this step the trial point.
    pub(super) fn place_trial(&mut self, step: &[f64]) -> bool {
        let mut trial = std::mem::take(&mut self.trial);
        let is_new = self.place(step, &mut trial);
        self.trial = trial;
        is_new
    }

    /// Returns the next poll from the best point. `n_refined` is the number of times that the frame has
    /// shrunk. `has_moved` is true if the point may have moved since.
    fn next_poll(&self, n_refined: u64, has_moved: bool, scale: f64) -> Poll {
        let (space, n) = (&self.setup.space, self.step.len());
        let way = |k: usize| (self.best.u(0)[k] - self.reference[k]) / space.size(k);
        let way: Vec<f64> = (0..n).map(way).collect();
        let mut poll = if has_moved && way.iter().any(|w| *w != 0.0) {
            Poll::along(&way)
        } else if n_refined == 0 {
            Poll::along_axes(n)
        } else {
            Poll::of_halton(n, n_refined)
        };
        if !space.rows().is_empty() {
            let near = self.near_rows(self.best.u(0), self.first * scale);
            poll.conform(&near.map(|row| row.normal).collect::<Vec<_>>());
        }
        poll
    }

    /// Returns the linear constraints and bounds within a distance of a point, in units of the parameter
    /// sizes. The limits of these half-spaces are 0, so they contain the feasible directions.
    pub(super) fn near_rows(&self, u: &[f64], distance: f64) -> impl Iterator<Item = HalfSpace> {
        let (space, n) = (&self.setup.space, u.len());
        let mut near = Vec::new();
        for row in space.rows() {
            let normal: Vec<f64> = row.normal.iter().enumerate().map(|(k, a)| a * space.size(k)).collect();
            let length = normal.iter().map(|a| a * a).sum::<f64>().sqrt();
            if row.limit - row.value(u) <= distance * length {
                near.push(HalfSpace { normal, limit: 0.0 });
            }
        }
        for k in 0..n {
            let (lower, upper) = space.working_bounds(k);
            for (sign, gap) in [(1.0, upper - u[k]), (-1.0, u[k] - lower)] {
                if gap <= distance * space.size(k) {
                    let mut normal = vec![0.0; n];
                    normal[k] = sign;
                    near.push(HalfSpace { normal, limit: 0.0 });
                }
            }
        }
        near.into_iter()
    }

    /// Starts a poll from the best point.
    fn begin_poll(&mut self) {
        self.poll = self.next_poll(self.n_refined, true, self.scale);
        self.phase = Phase::Polling;
        self.go_to(0);
    }

    /// Selects the first direction of the poll, from `from` on, whose point differs from the best one. If
    /// there is none, the poll has failed.
    fn go_to(&mut self, from: usize) {
        let mut step = std::mem::take(&mut self.step);
        let found = (from..self.poll.len()).find(|&place| {
            self.poll_step(&self.poll, place, self.scale, &mut step);
            self.place_trial(&step)
        });
        self.step = step;
        match found {
            Some(place) => self.place = place,
            None => self.poll_failed(from > 0),
        }
    }

    /// Processes a poll without a better point. `counts` is true if any of its points was evaluated.
    fn poll_failed(&mut self, counts: bool) {
        if self.operation.is_none() {
            self.phase = Phase::NoStart;
            return;
        }
        self.gains.push(self.best_cost());
        if self.gains.len() > FRAMES {
            self.gains.remove(0);
        }
        if counts {
            self.conclude(Operation::Refinement);
        }
        match self.tests.filter(|tests| tests.passed && counts) {
            Some(tests) if self.passed.is_none_or(|passed| tests.f_best < passed.f_best) => {
                self.passed = None;
                self.begin_descent(tests.f_limit);
            }
            Some(_) => self.descended(false),
            None if self.first * self.scale < f64::EPSILON => {
                self.phase = Phase::Ended(Termination::Collapsed);
            }
            None => {
                self.scale *= 0.5;
                self.begin_frame();
            }
        }
    }

    /// Continues after the search for a descent direction. If it gained nothing, the best point is a minimum
    /// according to polls and discrete gradients. The run then ends or restarts with the first frame.
    pub(super) fn descended(&mut self, has_gained: bool) {
        let (f, least) = (self.best_cost(), self.tests.map_or(0.0, |tests| tests.f_limit));
        let gains = has_gained || self.f_begin - f > least;
        self.n_idle = if gains { 0 } else { self.n_idle + 1 };
        if !has_gained {
            self.passed = self.tests;
            if self.n_idle >= self.restarts {
                self.converged(least);
                return;
            }
        }
        self.f_begin = f;
        self.gains.clear();
        self.scale = 1.0;
        self.begin_frame();
    }

    /// Ends the search without a lower cost. If points near the best one failed, first starts the check for a
    /// lower cost between them.
    fn converged(&mut self, least: f64) {
        let point = (self.best.x(0), self.best_cost());
        let check = self
            .failed
            .are_near(point.0, &self.setup.space)
            .then(|| FailureCheck::new(&self.setup, point, least, (self.n_points, self.n_points)));
        self.phase = match check {
            None => Phase::Ended(Termination::Converged),
            Some(Err(_)) => Phase::Ended(Termination::BesideFailures),
            Some(Ok(check)) => {
                self.check = Some(check);
                Phase::BesideFailures
            }
        };
    }

    /// Processes the outcomes of the check near failed points.
    fn check_answers(&mut self, answers: &Answers) -> Result<(), Error> {
        let Some(check) = &mut self.check else { return Ok(()) };
        let ended = check.tell(answers, &self.setup)?;
        self.waiting = false;
        self.n_points += self.n_requested as u64;
        if let Some(termination) = ended {
            self.phase = Phase::Ended(termination);
        }
        Ok(())
    }

    /// Starts the polls of a frame of another size.
    fn begin_frame(&mut self) {
        self.n_refined += 1;
        self.reference.copy_from_slice(self.best.u(0));
        self.begin_poll();
    }

    /// Ends an iteration.
    pub(super) fn conclude(&mut self, operation: Operation) {
        self.n_iterations += 1;
        self.operation = Some(operation);
        let oldest =
            (self.gains.len() == FRAMES && operation == Operation::Refinement).then(|| self.gains[0]);
        let oldest = oldest.filter(|f| f.is_finite());
        let (f, size) = (self.best_cost(), self.frame_size());
        let tests = self.setup.tolerances.judge(size, oldest.map(|earlier| earlier - f), f, self.f_0);
        self.tests = Some(ToleranceTests { extent: TestedSet::Frame, ..tests });
    }

    /// Returns the size of the frame as measured by the x test.
    fn frame_size(&self) -> f64 {
        let (space, frame) = (&self.setup.space, self.first * self.scale);
        let size = |(k, &i): (usize, &usize)| match space.transform(k) {
            Transform::Linear => frame * space.size(k),
            Transform::Log => self.best.x(0)[i] * (frame * space.size(k)).exp_m1(),
        };
        match self.setup.tolerances.measure {
            ToleranceMeasure::Relative => frame,
            ToleranceMeasure::Absolute => space.free().iter().enumerate().map(size).fold(0.0, f64::max),
        }
    }

    /// Accepts the trial point as the best point.
    pub(super) fn accept(&mut self, cost: Cost) {
        let Self { setup, best, trial: (u, x), step, .. } = self;
        for (k, step) in step.iter_mut().enumerate() {
            *step = (u[k] - best.u(0)[k]) / setup.space.size(k);
        }
        let was_infeasible = matches!(best.cost(0), Cost::Infeasible(_));
        best.set(0, u, x);
        best.set_cost(0, cost);
        if let (true, Some(f)) = (was_infeasible, cost.value()) {
            // The first feasible point. Tests measure gains from here on.
            self.f_0 = f.abs();
            self.gains.clear();
        }
    }

    /// Requests twice the last step, or ends the iteration if the doubled step does not move the point.
    pub(super) fn extend(&mut self) {
        let doubled: Vec<f64> = self.step.iter().map(|s| 2.0 * s).collect();
        self.phase = Phase::Extending;
        if !self.place_trial(&doubled) {
            self.extended();
        }
    }

    /// Continues after a step has been doubled as long as the cost decreased.
    fn extended(&mut self) {
        if self.descent.is_some() {
            self.descend_on();
            return;
        }
        if self.n_doubled >= DOUBLINGS && self.first * self.scale < LARGEST {
            self.scale *= 2.0;
        }
        self.conclude(Operation::Poll);
        self.begin_poll();
    }

    fn started(&mut self) {
        self.f_0 = self.best.cost(0).value().map_or(0.0, f64::abs);
        self.operation = Some(Operation::Initial);
        if self.step.is_empty() {
            self.phase = Phase::Ended(Termination::AllFixed);
        }
    }
}

impl Method for Polling {
    fn name(&self) -> &'static str {
        "pattern-search"
    }

    fn ask(&mut self, batch: &mut Batch) {
        self.waiting = self.status() == Status::Running;
        if let (Phase::BesideFailures, Some(check)) = (&self.phase, &mut self.check) {
            check.ask(batch);
            self.n_requested = batch.len();
            return;
        }
        batch.start(self.setup.space.n(), self.n_points, self.n_points);
        if self.status() == Status::Running {
            // The start is the first trial point. Gradients need costs of any magnitude, so they use no
            // cutoff.
            let cutoff = if self.phase == Phase::Descending { f64::INFINITY } else { self.best_cost() };
            batch.push(&self.trial.1, cutoff);
        }
    }

    fn speculate(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        // The rest of this poll, then the poll that follows if all its points fail or the step cannot be
        // doubled.
        let half = 0.5 * self.scale;
        let next_poll = |n_refined, has_moved, scale| (self.next_poll(n_refined, has_moved, scale), scale);
        let (rest, next) = match self.phase {
            Phase::Starting => (0, next_poll(1, false, half)),
            Phase::Polling => (self.place + 1, next_poll(self.n_refined + 1, false, half)),
            Phase::Extending => (self.poll.len(), next_poll(self.n_refined, true, self.scale)),
            Phase::Descending => return self.speculate_on_descent(wanted, answers_so_far, batch),
            Phase::BesideFailures | Phase::NoStart | Phase::Ended(_) => return,
        };
        let mut ahead = self.trial.clone();
        let mut step = vec![0.0; self.step.len()];
        let places = (rest..self.poll.len()).map(|k| (&self.poll, k, self.scale));
        for (poll, k, scale) in places.chain((0..next.0.len()).map(|k| (&next.0, k, next.1))) {
            if batch.len() == wanted {
                return;
            }
            self.poll_step(poll, k, scale, &mut step);
            if self.place(&step, &mut ahead) && ahead.1 != self.trial.1 && !answers_so_far.contains(&ahead.1)
            {
                batch.push(&ahead.1, self.best_cost());
            }
        }
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        let outcomes = answers.outcomes();
        if !self.waiting {
            return Err(Error::TellWithoutAsk);
        }
        if self.phase == Phase::BesideFailures {
            return self.check_answers(answers);
        }
        if outcomes.len() > 1 {
            return Err(Error::TooManyOutcomes { requested: 1, received: outcomes.len() });
        }
        self.waiting = false;
        self.n_points += 1;
        let Some(outcome) = outcomes.first().filter(|outcome| outcome.is_conclusive()) else { return Ok(()) };
        let cost = Cost::of(outcome, &self.setup.constraints, answers.constraints(0));
        // With a cutoff, the evaluation of a failing point might have stopped before the failure.
        if cost == Cost::Failed && self.phase == Phase::Descending {
            self.failed.remember(&self.trial.1);
        }
        let gains = cost.better_than(self.best.cost(0));
        match self.phase {
            Phase::Starting => {
                self.best.set_cost(0, cost);
                if cost != Cost::Failed {
                    self.started();
                }
                if self.phase == Phase::Starting {
                    self.begin_poll();
                }
            }
            Phase::Polling if gains => {
                self.accept(cost);
                self.n_doubled = 0;
                if self.operation.is_none() {
                    // First cost of a search whose start has failed.
                    self.started();
                    self.begin_poll();
                } else {
                    self.extend();
                }
            }
            Phase::Polling => self.go_to(self.place + 1),
            Phase::Extending if gains => {
                self.accept(cost);
                self.n_doubled += 1;
                self.extend();
            }
            Phase::Extending => self.extended(),
            Phase::Descending => self.descend(cost),
            Phase::BesideFailures | Phase::NoStart | Phase::Ended(_) => {}
        }
        Ok(())
    }

    fn status(&self) -> Status {
        match &self.phase {
            Phase::NoStart => Status::NoStart,
            Phase::Ended(termination) => Status::Ended(termination.clone()),
            Phase::Starting
            | Phase::Polling
            | Phase::Extending
            | Phase::Descending
            | Phase::BesideFailures => Status::Running,
        }
    }

    fn best_violation(&self) -> f64 {
        match self.best.cost(0) {
            Cost::Infeasible(violation) => violation,
            _ => 0.0,
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        let seen = (self.best.x(0), self.best.cost(0).value()?);
        let found = self.check.as_ref().map(FailureCheck::best);
        Some(found.filter(|found| found.1 < seen.1).unwrap_or(seen))
    }

    fn details(&self) -> MethodDetails<'_> {
        let passed = self.passed.filter(|passed| self.best_cost() >= passed.f_best);
        let tests = passed.or(self.tests);
        let details = MethodDetails {
            n_iterations: self.n_iterations,
            operation: self.operation,
            tests,
            settled: passed.is_some_and(|tests| tests.passed),
            plan: self.batch.name(),
            lookahead: self.batch,
            population: Some(self.best.view()),
            ..MethodDetails::default()
        };
        match &self.check {
            Some(check) => check.details(details),
            None => details,
        }
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }
}
