//! State machine of Nelder-Mead: requested points and the processing of their outcomes.
//!
//! There is one decision procedure. It uses the known trial points. If it requires an unknown one, the next
//! batch requests this point.

use super::options::CoefficientValues;
use super::restart::Spreads;
use super::speculation::{AvailableCost, Problem, Speculation};
use super::trial::{Seen, Trial, TrialPoint};
use crate::error::Error;
use crate::method_interface::interface::{
    AnswersSoFar, Batch, Lookahead, Method, MethodDetails, Operation, Setup, Status, saved,
};
use crate::method_interface::tolerances::ToleranceTests;
use crate::methods::failure_check::{FailedPoints, FailureCheck};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::methods::shared::size_search::SizeSearch;
use crate::outcome::answer::{Answers, Outcome};
use crate::outcome::termination::Termination;
use crate::problem::objective::Query;
use crate::values::choices::BoundsHandling;
use serde::{Deserialize, Serialize};

/// Role of a point of the last batch.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) enum Role {
    Vertex(usize),
    Trial(Trial),
    /// A step along a parameter of unknown size.
    Step(usize),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Phase {
    /// Sizes of parameters are determined, from the start point.
    Sizing,
    /// Sizes are checked from the best vertex, after the tests have passed.
    Checking,
    /// The tests have passed near failed points. CMA-ES searches for a lower cost between them.
    BesideFailures,
    /// Starting vertices without a known outcome are requested.
    Starting,
    /// Vertices are requested after a shrink.
    Shrinking,
    /// Vertices are requested after a restart.
    Restarting,
    /// An iteration needs this trial point next.
    Evaluating(Trial),
    Done,
}

/// A running Nelder-Mead search, created by [`NelderMead`](super::NelderMead).
///
/// A manual loop follows the same path as [`minimize`](crate::minimize):
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
    pub(super) setup: Setup,
    pub(super) batch: Lookahead,
    pub(super) numbers: CoefficientValues,
    pub(super) handling: BoundsHandling,
    pub(super) simplex: RankedPoints,
    pub(super) centroid: Vec<f64>,
    pub(super) trials: [TrialPoint; 4],
    #[serde(skip)]
    pub(super) speculation: Speculation,
    pub(super) restarts: usize,
    pub(super) f_restart: Option<f64>,
    /// Spreads of the costs since the last start.
    pub(super) spreads: Spreads,
    /// True if there are parameters of unknown size, and the user has not specified a simplex.
    pub(super) sizing: bool,
    #[serde(default)]
    pub(super) failed: FailedPoints,
    #[serde(default)]
    pub(super) check: Option<FailureCheck>,
    /// The last search for sizes.
    pub(super) sizes: Option<SizeSearch>,
    pub(super) phase: Phase,
    pub(super) ended: Option<Termination>,
    pub(super) roles: Vec<Role>,
    pub(super) waiting: bool,
    /// Number of points in the last batch of the check.
    #[serde(default)]
    #[serde(rename = "n_asked")]
    n_requested: usize,
    pub(super) n_batches: u64,
    pub(super) n_points: u64,
    pub(super) n_iterations: usize,
    pub(super) operation: Option<Operation>,
    pub(super) tests: Option<ToleranceTests>,
    pub(super) f_0: f64,
}

impl NelderMeadState {
    pub(super) fn new(
        setup: Setup,
        batch: Lookahead,
        numbers: CoefficientValues,
        handling: BoundsHandling,
        simplex: RankedPoints,
        restarts: usize,
        sizing: bool,
    ) -> Self {
        let (n, n_user) = (setup.space.n_free(), setup.space.n());
        let trial = || TrialPoint::new(n, n_user);
        Self {
            setup,
            batch,
            numbers,
            handling,
            simplex,
            centroid: vec![0.0; n],
            trials: [trial(), trial(), trial(), trial()],
            speculation: Speculation::default(),
            restarts,
            f_restart: None,
            spreads: Spreads::default(),
            sizing,
            failed: FailedPoints::new(n_user),
            check: None,
            sizes: None,
            phase: if sizing { Phase::Sizing } else { Phase::Starting },
            ended: None,
            roles: Vec::with_capacity(n + 1),
            waiting: false,
            n_requested: 0,
            n_batches: 0,
            n_points: 0,
            n_iterations: 0,
            operation: None,
            tests: None,
            f_0: 0.0,
        }
    }

    /// Returns the number of answered batches.
    pub(crate) fn n_batches(&self) -> u64 {
        self.n_batches
    }

    pub(crate) fn n_points(&self) -> u64 {
        self.n_points
    }

    /// Sets the cost of the start point, which then needs no evaluation. `f_0` is the magnitude of the first
    /// costs of the preceding search.
    pub(crate) fn set_start_cost(&mut self, cost: f64, f_0: f64) {
        self.simplex.set_cost(0, Cost::Value(cost));
        self.f_0 = f_0;
    }

    /// Processes the outcomes of the check near failed points.
    fn check_answers(&mut self, answers: &Answers) -> Result<(), Error> {
        let Some(check) = &mut self.check else { return Ok(()) };
        let ended = check.tell(answers, &self.setup)?;
        self.waiting = false;
        self.n_batches += 1;
        self.n_points += self.n_requested as u64;
        if let Some(termination) = ended {
            self.end(termination);
        }
        Ok(())
    }

    /// Treats every point at which the tests pass as a kink.
    pub(crate) fn expect_kinks(&mut self) {
        self.spreads.has_kinks = true;
    }

    /// True if the state is consistent with itself and with the problem.
    pub(crate) fn is_sound(&self, setup: &Setup) -> bool {
        let space = &setup.space;
        space.is_same_space(&self.setup.space)
            && self.sizes.as_ref().is_none_or(|s| s.is_sound(space))
            && self.simplex.is_sound(space)
            && self.failed.is_sound(space.n())
            && (self.phase != Phase::BesideFailures || self.check.is_some())
            && self.check.as_ref().is_none_or(|check| check.is_sound(&self.setup))
            && self.centroid.len() == space.n_free()
            && self.trials.iter().all(|t| t.is_sound(space))
    }
}

/// Returns the cost of an outcome, or `Err` if the outcome is unknown.
fn cost_of(outcome: &Outcome) -> Result<Option<f64>, ()> {
    if outcome.is_conclusive() { Ok(outcome.value()) } else { Err(()) }
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
            Phase::BesideFailures => {
                if let Some(check) = &mut self.check {
                    check.ask(batch);
                    self.n_requested = batch.len();
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
            Phase::Evaluating(trial) => {
                self.place(trial);
                self.request_trial(trial, batch);
            }
        }
        self.waiting = self.phase != Phase::Done;
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        let outcomes = answers.outcomes();
        let requested = self.roles.len();
        if !self.waiting {
            return Err(Error::TellWithoutAsk);
        }
        if self.phase == Phase::BesideFailures {
            return self.check_answers(answers);
        }
        if outcomes.len() > requested {
            return Err(Error::TooManyOutcomes { requested, received: outcomes.len() });
        }
        self.waiting = false;
        if requested > 0 {
            self.n_batches += 1;
            self.n_points += requested as u64;
        }
        for (k, outcome) in outcomes.iter().enumerate() {
            let Ok(cost) = cost_of(outcome) else { continue };
            let seen = cost.map_or(Seen::Rejected, Seen::Cost);
            let is_above = matches!(outcome, Outcome::Above(_));
            // Costs that are not finite count as failures, even if the caller does not mark them.
            if !is_above && outcome.value().is_none() {
                self.spreads.forget();
                let x = match self.roles[k] {
                    Role::Vertex(slot) => Some(self.simplex.x(slot)),
                    Role::Trial(trial) => Some(&self.trials[trial as usize].x[..]),
                    Role::Step(_) => None,
                };
                x.into_iter().for_each(|x| self.failed.remember(x));
            }
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
            }
        }
        match self.phase {
            Phase::Done | Phase::BesideFailures => {}
            Phase::Starting | Phase::Shrinking | Phase::Restarting => {
                if !self.simplex.is_pending() {
                    self.vertices_evaluated();
                }
            }
            Phase::Sizing | Phase::Checking => self.size_step_answered(),
            Phase::Evaluating(_) => match self.decide() {
                Err(needed) => self.phase = Phase::Evaluating(needed),
                Ok(Operation::Shrink) => self.phase = Phase::Shrinking,
                Ok(operation) => self.end_iteration(operation),
            },
        }
        Ok(())
    }

    fn speculate(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        let Phase::Evaluating(trial) = self.phase else { return };
        let (cutoff, best) = (self.worst_cost(), self.simplex.cost(self.simplex.best()).value());
        // A reflection that leads to an expansion is better than the best vertex.
        let best = best.filter(|_| cutoff.is_finite()).unwrap_or(f64::INFINITY);
        let Self { speculation, simplex, setup, trials, numbers, handling, .. } = self;
        let available_cost = |x: &[f64]| match answers_so_far.ahead(x, &Query::new(0, 0, cutoff)) {
            Some(answer) => AvailableCost::Cost(answer.outcome.value().unwrap_or(f64::INFINITY)),
            None if answers_so_far.contains(x) => AvailableCost::Hidden,
            None => AvailableCost::Nothing,
        };
        let space = &setup.space;
        let problem =
            Problem { space, handling: *handling, numbers, simplex, available_cost: &available_cost };
        speculation.look(&problem, trial, trials, wanted, |x, expansion| {
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

    fn details(&self) -> MethodDetails<'_> {
        let space = &self.setup.space;
        let unmoved = |search: &SizeSearch| search.without_effect(space).collect();
        let details = MethodDetails {
            without_effect: self.sizes.as_ref().map_or_else(Vec::new, unmoved),
            n_iterations: self.n_iterations,
            operation: self.operation,
            tests: self.tests,
            plan: self.batch.name(),
            lookahead: self.batch,
            simplex: Some(self.simplex.view()),
            ..MethodDetails::default()
        };
        match &self.check {
            Some(check) => check.details(details),
            None => details,
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        // While starting vertices are missing, they are not ranked yet.
        let mut best: Option<(&[f64], f64)> = None;
        for &slot in self.simplex.order() {
            if let Cost::Value(v) = self.simplex.cost(slot)
                && best.is_none_or(|(_, b)| v < b)
            {
                best = Some((self.simplex.x(slot), v));
            }
        }
        // Points that are not vertices also count: steps of the size search, and a reflection that waits for
        // its expansion.
        let seen =
            [self.sizes.as_ref().and_then(SizeSearch::best), self.check.as_ref().map(FailureCheck::best)];
        for seen in seen.into_iter().flatten() {
            if best.is_none_or(|(_, b)| seen.1 < b) {
                best = Some(seen);
            }
        }
        let reflection = &self.trials[Trial::Reflection as usize];
        match (self.phase, reflection.seen) {
            (Phase::Evaluating(_), Seen::Cost(r)) if best.is_none_or(|(_, b)| r < b) => {
                Some((&reflection.x, r))
            }
            _ => best,
        }
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }
}
