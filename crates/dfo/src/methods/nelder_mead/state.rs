//! The state machine: which points are asked for, and what follows from their outcomes.
//!
//! There is one decision procedure. It runs over the trial points as far as they are known; where it meets an unknown
//! one, that point is what the next batch asks for.

use super::foresight::{Foresight, Problem};
use super::initial;
use super::lee_wiswall::{LeeWiswall, Verdict};
use super::options::{BatchPlan, Numbers};
use super::restart;
use super::simplex::SimplexData;
use super::sizes::SizeSearch;
use super::trial::{Frame, Seen, Trial, TrialPoint};
use crate::answer::{Answers, Outcome};
use crate::choices::BoundsHandling;
use crate::error::Error;
use crate::method::{Batch, Details, Method, Operation, Setup, Status, saved};
use crate::methods::shared::cost::Cost;
use crate::termination::Termination;
use crate::tolerances::Tests;
use serde::{Deserialize, Serialize};

/// A simplex of this size cannot become much smaller but on one point.
const RESOLVED: f64 = 1e-12;

/// What a point of the last batch stands for.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
enum Role {
    Vertex(usize),
    Trial(Trial),
    /// A point of a vertex that moves together with others.
    Move(usize),
    /// A step along a parameter of unknown size.
    Step(usize),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
enum Phase {
    /// Sizes of parameters are looked for, from the start point.
    Sizing,
    /// The same once the tests have passed, from the best vertex.
    Checking,
    /// Vertices without a known outcome are asked for: the starting ones.
    Starting,
    /// The same after a shrink.
    Shrinking,
    /// The same after a restart.
    Restarting,
    /// Several vertices move at once.
    Moving,
    /// An iteration needs this trial point next.
    Trying(Trial),
    Done,
}

/// A running Nelder-Mead search; made by [`NelderMead`](super::NelderMead).
///
/// Driven by hand it takes the path that [`minimize`](crate::minimize) takes:
///
/// ```
/// use dfo::{Answers, Batch, Bounds, Method, MethodOptions, NelderMead, Outcome, Setup, Space};
///
/// let cost = |x: &[f64]| (x[0] - 1.0).powi(2) + 10.0 * (x[1] + 2.0).powi(2);
/// let space = Space::new(&[0.0, 0.0], Bounds::unbounded(2), &[], &[])?;
/// let mut search = NelderMead::default().begin(&Setup::new(space))?;
/// let mut batch = Batch::new();
/// loop {
///     search.ask(&mut batch);
///     if batch.is_empty() {
///         break;
///     }
///     let answers: Answers = batch.points().map(|x| Outcome::Value(cost(x))).collect();
///     search.tell(&answers)?;
/// }
/// let (x, f) = search.best().unwrap();
/// assert!((x[0] - 1.0).abs() < 1e-4 && (x[1] + 2.0).abs() < 1e-4 && f < 1e-8);
///
/// let report = dfo::minimize(cost).start(&[0.0, 0.0]).run()?;
/// assert_eq!((x, f), (&report.x[..], report.fun));
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct NelderMeadState {
    setup: Setup,
    plan: BatchPlan,
    numbers: Numbers,
    handling: BoundsHandling,
    simplex: SimplexData,
    centroid: Vec<f64>,
    trials: [TrialPoint; 4],
    #[serde(skip)]
    foresight: Foresight,
    parallel: Option<LeeWiswall>,
    restarts: usize,
    f_restart: Option<f64>,
    /// Whether there are parameters of unknown size, and the user gave no simplex.
    sizing: bool,
    /// The last search for sizes.
    sizes: Option<SizeSearch>,
    phase: Phase,
    ended: Option<Termination>,
    roles: Vec<Role>,
    waiting: bool,
    n_batches: u64,
    n_points: u64,
    n_iterations: usize,
    operation: Option<Operation>,
    tests: Option<Tests>,
    f_0: f64,
}

impl NelderMeadState {
    pub(super) fn new(
        setup: Setup,
        plan: BatchPlan,
        numbers: Numbers,
        handling: BoundsHandling,
        simplex: SimplexData,
        (restarts, sizing): (usize, bool),
    ) -> Self {
        let (n, n_user) = (setup.space.n_free(), setup.space.n());
        let trial = || TrialPoint::new(n, n_user);
        Self {
            setup,
            plan,
            numbers,
            handling,
            simplex,
            centroid: vec![0.0; n],
            trials: [trial(), trial(), trial(), trial()],
            foresight: Foresight::default(),
            parallel: (plan == BatchPlan::LeeWiswall).then(|| LeeWiswall::new(n, n_user)),
            restarts,
            f_restart: None,
            sizing,
            sizes: None,
            phase: if sizing { Phase::Sizing } else { Phase::Starting },
            ended: None,
            roles: Vec::with_capacity(n + 1),
            waiting: false,
            n_batches: 0,
            n_points: 0,
            n_iterations: 0,
            operation: None,
            tests: None,
            f_0: 0.0,
        }
    }

    /// Batches and points told so far.
    pub(crate) fn n_batches(&self) -> u64 {
        self.n_batches
    }

    pub(crate) fn n_points(&self) -> u64 {
        self.n_points
    }

    /// Whether this state fits to a problem and to itself.
    pub(crate) fn is_sound(&self, setup: &Setup) -> bool {
        let space = &setup.space;
        space.is_same_space(&self.setup.space)
            && self.sizes.as_ref().is_none_or(|s| s.is_sound(space))
            && self.simplex.is_sound(space)
            && self.centroid.len() == space.n_free()
            && self.trials.iter().all(|t| t.is_sound(space))
            && self.parallel.is_some() == (self.plan == BatchPlan::LeeWiswall)
            && self.parallel.as_ref().is_none_or(|p| p.is_sound(space))
    }

    /// Where an evaluation may stop without changing a decision.
    fn cutoff(&self, trial: Trial) -> f64 {
        let worst = self.worst_cost();
        match (trial, self.trials[Trial::Reflection as usize].seen) {
            (Trial::Expansion | Trial::Outside, Seen::Cost(reflected)) if worst.is_finite() => reflected,
            _ => worst,
        }
    }

    /// The cost above which no point is accepted, now or in the iterations to come; infinite while the worst vertex has
    /// failed.
    fn worst_cost(&self) -> f64 {
        self.simplex.cost(self.simplex.worst()).value().unwrap_or(f64::INFINITY)
    }

    fn place(&mut self, trial: Trial) {
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

    fn request_trial(&mut self, trial: Trial, batch: &mut Batch) {
        let cutoff = self.cutoff(trial);
        batch.push(&self.trials[trial as usize].x, cutoff);
        self.roles.push(Role::Trial(trial));
    }

    /// The cost of a trial point: `Ok(None)` if it is no candidate, `Err` if it is not known yet.
    fn consult(&self, trial: Trial) -> Result<Option<f64>, Trial> {
        match self.trials[trial as usize].seen {
            Seen::Unknown => Err(trial),
            Seen::Cost(v) => Ok(Some(v)),
            Seen::Rejected => Ok(None),
        }
    }

    /// The decision of an iteration (Lagarias et al. 1998, section 2, steps 2 to 5): the point to accept, or none for
    /// a shrink. `Err`: this point is needed.
    fn verdict(&self) -> Result<Option<(Trial, f64)>, Trial> {
        let [best, second_worst, worst] =
            [self.simplex.best(), self.simplex.second_worst(), self.simplex.worst()]
                .map(|s| self.simplex.cost(s));
        let reflected = self.consult(Trial::Reflection)?;
        let reflection_beats = |cost| reflected.is_some_and(|r| Cost::Value(r).better_than(cost));
        if let Some(r) = reflected.filter(|_| reflection_beats(best)) {
            return Ok(Some(match self.consult(Trial::Expansion)? {
                Some(e) if e < r => (Trial::Expansion, e),
                _ => (Trial::Reflection, r),
            }));
        }
        if let Some(r) = reflected.filter(|_| reflection_beats(second_worst)) {
            return Ok(Some((Trial::Reflection, r)));
        }
        if let Some(r) = reflected.filter(|_| reflection_beats(worst)) {
            let outside = self.consult(Trial::Outside)?.filter(|c| *c <= r);
            return Ok(outside.map(|c| (Trial::Outside, c)));
        }
        let inside = self.consult(Trial::Inside)?.filter(|c| Cost::Value(*c).better_than(worst));
        Ok(inside.map(|c| (Trial::Inside, c)))
    }

    /// Carries out what the trial points decide.
    fn decide(&mut self) -> Result<Operation, Trial> {
        match self.verdict()? {
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
        self.phase = Phase::Trying(Trial::Reflection);
        if let Some(parallel) = self.parallel.as_mut().filter(|p| p.is_parallel()) {
            parallel.begin();
            self.phase = Phase::Moving;
        }
    }

    fn end_iteration(&mut self, operation: Operation) {
        self.n_iterations += 1;
        self.operation = Some(operation);
        let space = &self.setup.space;
        let tolerances = &self.setup.tolerances;
        let f_best = self.simplex.cost(self.simplex.best()).value().unwrap_or(f64::NAN);
        let x_size = self.simplex.x_size(space, tolerances.measure);
        let tests = tolerances.judge(x_size, self.simplex.f_spread(), f_best, self.f_0);
        let before = self.tests.replace(tests).map(|before| before.x_size);
        let collapsed = self.simplex.is_collapsed(space);
        if tests.passed {
            // All vertices on one point say nothing, unless they came there through simplices that were about as small.
            let came_there = before.is_some_and(|size| size <= (10.0 * tolerances.x_tol).max(RESOLVED));
            if x_size == 0.0 && !came_there {
                self.end(Termination::Collapsed);
            } else if self.may_restart(&tests) {
                let space = &self.setup.space;
                let x_size = self.simplex.relative_size(space);
                restart::orient(&mut self.simplex, space, x_size);
                self.phase = Phase::Restarting;
            } else if self.sizing {
                let best = self.simplex.best();
                let from = (self.simplex.x(best), tests.f_best);
                self.sizes =
                    Some(SizeSearch::beside(&self.setup.space, from, tests.f_limit, self.sizes.as_ref()));
                self.phase = Phase::Checking;
                self.sizes_told();
            } else {
                self.end(Termination::Converged);
            }
        } else if collapsed {
            let alone = self.simplex.n_finite() == 1;
            self.end(if alone { Termination::OneFiniteVertex } else { Termination::Collapsed });
        } else {
            self.begin_iteration();
        }
    }

    /// Whether the simplex deserves to be built anew although the tests passed: it is flat, not because of a bound, and
    /// the last restart, if there was one, brought something.
    fn may_restart(&mut self, tests: &Tests) -> bool {
        let useless = self.f_restart.is_some_and(|f| f - tests.f_best <= tests.f_limit);
        if self.restarts == 0 || useless || !restart::is_flat(&self.simplex, &self.setup.space) {
            return false;
        }
        self.restarts -= 1;
        self.f_restart = Some(tests.f_best);
        true
    }

    fn end(&mut self, termination: Termination) {
        self.phase = Phase::Done;
        self.ended = Some(termination);
    }

    /// A step in search of sizes, or the start point that they start from, is known.
    fn sizes_told(&mut self) {
        let space = &mut self.setup.space;
        match (&self.sizes, self.simplex.cost(0)) {
            (None, Cost::Pending) => {}
            (None, Cost::Value(f_0)) => {
                self.sizes = Some(SizeSearch::from_start(space, self.simplex.x(0), f_0));
                self.sizes_told();
            }
            // Nothing to compare with.
            (None, Cost::Failed) => self.phase = Phase::Starting,
            (Some(search), _) if !search.is_over() => {}
            (Some(search), _) => {
                if self.phase == Phase::Checking && !search.is_lower() {
                    return self.end(Termination::Converged);
                }
                self.simplex = initial::around(space, search);
                self.phase = if self.phase == Phase::Checking { Phase::Restarting } else { Phase::Starting };
                if !self.simplex.is_pending() {
                    self.vertices_known();
                }
            }
        }
    }

    /// All vertices asked for are known.
    fn vertices_known(&mut self) {
        let phase = self.phase;
        self.simplex.sort();
        match phase {
            Phase::Shrinking => return self.end_iteration(Operation::Shrink),
            Phase::Restarting => return self.end_iteration(Operation::Restart),
            Phase::Starting
            | Phase::Sizing
            | Phase::Checking
            | Phase::Moving
            | Phase::Trying(_)
            | Phase::Done => {}
        }
        if self.simplex.cost(self.simplex.best()).value().is_none() {
            self.phase = Phase::Done;
            return;
        }
        // Steps in search of sizes may have come near to the minimum already.
        let start = self.sizes.as_ref().map(|search| search.base().1.abs()).filter(|f| *f > 0.0);
        self.f_0 = start.unwrap_or_else(|| self.simplex.smallest_cost());
        self.operation = Some(Operation::Initial);
        if self.setup.space.n_free() == 0 {
            return self.end(Termination::AllFixed);
        }
        self.begin_iteration();
    }
}

/// The cost that an outcome stands for; `Err` if it says nothing.
fn cost_of(outcome: &Outcome) -> Result<Option<f64>, ()> {
    if outcome.is_known() { Ok(outcome.value()) } else { Err(()) }
}

impl Method for NelderMeadState {
    fn name(&self) -> &'static str {
        "nelder-mead"
    }

    fn ask(&mut self, batch: &mut Batch) {
        batch.start(self.setup.space.n(), self.n_batches, self.n_points);
        self.roles.clear();
        match self.phase {
            Phase::Done => {}
            Phase::Starting | Phase::Shrinking | Phase::Restarting => {
                for &slot in self.simplex.order() {
                    if self.simplex.cost(slot) == Cost::Pending {
                        batch.push(self.simplex.x(slot), f64::INFINITY);
                        self.roles.push(Role::Vertex(slot));
                    }
                }
            }
            Phase::Sizing | Phase::Checking => {
                let roles = &mut self.roles;
                match &mut self.sizes {
                    Some(search) => {
                        search.ask(&self.setup.space, batch, |number| roles.push(Role::Step(number)));
                    }
                    None => {
                        batch.push(self.simplex.x(0), f64::INFINITY);
                        roles.push(Role::Vertex(0));
                    }
                }
            }
            Phase::Moving => {
                if let Some(parallel) = &mut self.parallel {
                    let (space, roles) = (&self.setup.space, &mut self.roles);
                    let problem = (space, self.handling, &self.numbers);
                    parallel.ask(batch, |k| roles.push(Role::Move(k)), &self.simplex, problem);
                }
            }
            Phase::Trying(trial) => {
                self.place(trial);
                self.request_trial(trial, batch);
            }
        }
        self.waiting = self.phase != Phase::Done;
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        let outcomes = answers.outcomes();
        let asked = self.roles.len();
        if !self.waiting {
            return Err(Error::TellWithoutAsk);
        }
        if outcomes.len() > asked {
            return Err(Error::TooManyOutcomes { asked, told: outcomes.len() });
        }
        self.waiting = false;
        if asked > 0 {
            self.n_batches += 1;
            self.n_points += asked as u64;
        }
        for (k, outcome) in outcomes.iter().enumerate() {
            let Ok(cost) = cost_of(outcome) else { continue };
            let seen = cost.map_or(Seen::Rejected, Seen::Cost);
            match self.roles[k] {
                Role::Vertex(slot) => {
                    self.simplex.set_cost(slot, cost.map_or(Cost::Failed, Cost::Value));
                }
                Role::Step(number) => {
                    if let Some(search) = &mut self.sizes {
                        search.see(&self.setup.space, number, cost);
                    }
                }
                Role::Trial(trial) => self.trials[trial as usize].seen = seen,
                Role::Move(number) => {
                    if let Some(parallel) = &mut self.parallel {
                        parallel.see(number, seen);
                    }
                }
            }
        }
        match self.phase {
            Phase::Done => {}
            Phase::Starting | Phase::Shrinking | Phase::Restarting => {
                if !self.simplex.is_pending() {
                    self.vertices_known();
                }
            }
            Phase::Sizing | Phase::Checking => self.sizes_told(),
            Phase::Moving => {
                let Some(parallel) = &mut self.parallel else { return Ok(()) };
                match parallel.conclude(&mut self.simplex) {
                    Verdict::Unfinished => {}
                    Verdict::Moved => self.end_iteration(Operation::ParallelMoves),
                    Verdict::Stuck => {
                        self.simplex.shrink(self.numbers.shrink, &self.setup.space);
                        self.phase = Phase::Shrinking;
                    }
                }
            }
            Phase::Trying(_) => match self.decide() {
                Err(needed) => self.phase = Phase::Trying(needed),
                Ok(Operation::Shrink) => self.phase = Phase::Shrinking,
                Ok(operation) => self.end_iteration(operation),
            },
        }
        Ok(())
    }

    fn speculate(&mut self, wanted: usize, known: &dyn Fn(&[f64]) -> bool, batch: &mut Batch) {
        let Phase::Trying(trial) = self.phase else { return };
        let (cutoff, best) = (self.worst_cost(), self.simplex.cost(self.simplex.best()).value());
        // A reflection that asks for an expansion beats the best vertex.
        let best = best.filter(|_| cutoff.is_finite()).unwrap_or(f64::INFINITY);
        let Self { foresight, simplex, setup, trials, numbers, handling, .. } = self;
        let problem = Problem { space: &setup.space, handling: *handling, numbers, simplex };
        foresight.look(&problem, (trial, trials), (wanted, known), |x, expansion| {
            batch.push(x, if expansion { best.min(cutoff) } else { cutoff });
        });
    }

    fn status(&self) -> Status {
        match (&self.ended, self.phase) {
            (Some(termination), _) => Status::Ended(termination.clone()),
            (None, Phase::Done) => Status::NoStart,
            (None, _) => Status::Running,
        }
    }

    fn details(&self) -> Details<'_> {
        let plan = match &self.parallel {
            Some(parallel) if !parallel.is_parallel() => "lee-wiswall, then serial",
            _ => self.plan.name(),
        };
        let space = &self.setup.space;
        let unmoved = |search: &SizeSearch| search.without_effect(space).collect();
        Details {
            without_effect: self.sizes.as_ref().map_or_else(Vec::new, unmoved),
            n_iterations: self.n_iterations,
            operation: self.operation,
            tests: self.tests,
            plan,
            lookahead: self.plan.lookahead(),
            simplex: Some(self.simplex.view()),
            ..Details::default()
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        // While starting vertices are missing they are not ranked yet.
        let mut best: Option<(&[f64], f64)> = None;
        for &slot in self.simplex.order() {
            if let Cost::Value(v) = self.simplex.cost(slot)
                && best.is_none_or(|(_, b)| v < b)
            {
                best = Some((self.simplex.x(slot), v));
            }
        }
        // What was seen and is no vertex counts too: steps in search of sizes, a reflection that waits for its expansion,
        // vertices on the move.
        if let Some(seen) = self.sizes.as_ref().and_then(SizeSearch::best)
            && best.is_none_or(|(_, b)| seen.1 < b)
        {
            best = Some(seen);
        }
        if let (Phase::Moving, Some(seen)) =
            (self.phase, self.parallel.as_ref().and_then(LeeWiswall::best_seen))
            && best.is_none_or(|(_, b)| seen.1 < b)
        {
            return Some(seen);
        }
        let reflection = &self.trials[Trial::Reflection as usize];
        match (self.phase, reflection.seen) {
            (Phase::Trying(_), Seen::Cost(r)) if best.is_none_or(|(_, b)| r < b) => Some((&reflection.x, r)),
            _ => best,
        }
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }
}
