//! State machine of multistart: sampling, exploration, and several parallel local searches.

use super::clusters;
use super::options::Multistart;
use super::speculative_searches::SpeculativeSearches;
use crate::error::Error;
use crate::method_interface::interface::{
    AnswersSoFar, Batch, Lookahead, Method, MethodDetails, MethodOptions, Operation, Optimum, Setup, Status,
    restored, saved,
};
use crate::method_interface::linear_model::LinearModel;
use crate::method_interface::rng::{draw_seed, seed_at};
use crate::method_interface::sampling::Sampling;
use crate::method_interface::tolerances::ToleranceTests;
use crate::methods::shared::cost::Cost;
use crate::methods::shared::pending_generation::PendingGeneration;
use crate::methods::shared::population::MAX_MEMBERS;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::outcome::answer::{Answers, Best, EvaluationKind};
use crate::outcome::termination::Termination;
use base::RunContext;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Number of parallel local searches. With four, two workers are busy even if one search waits for the next
/// sample. With eight or sixteen, the searches lose more of the budget to each other than they gain. On six
/// functions with 20 seeds and 10 000 evaluations (n = 10, no exploration), four solve 54 of 120, eight and
/// sixteen solve 40.
pub(super) const SIDE_BY_SIDE: usize = 4;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Phase {
    /// Points of the sample are being evaluated.
    Sampling,
    /// Differential evolution is running.
    Exploring,
    /// Local searches are running, possibly with points of the next sample.
    Searching,
    NoStart,
    Ended(Termination),
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// State except the inner methods.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Core {
    pub(super) setup: Setup,
    seed: u64,
    phase: Phase,
    sample: RankedPoints,
    /// True for points of the sample from which a search has started.
    used: Vec<bool>,
    rounds: PendingGeneration,
    /// Start points of pending searches.
    pub(super) queue: Vec<Vec<f64>>,
    /// Planned and completed evaluations of the exploration.
    n_planned: usize,
    n_explored: usize,
    n_starts: usize,
    /// Number of starts that test whether a cluster has one minimum, and whether one of them has ended in
    /// another minimum.
    #[serde(default)]
    n_tests_of_clusters: usize,
    #[serde(default)]
    clusters_are_split: bool,
    /// Number of points outside the first local search.
    #[serde(default)]
    n_elsewhere: usize,
    minima: Vec<Optimum>,
    best: Best,
    /// Violation of the best point; 0 if it satisfies the constraints.
    #[serde(default, skip_serializing_if = "is_zero")]
    best_violation: f64,
    /// Termination, tests and derivatives of the search that ended at the best minimum.
    #[serde(default)]
    end: Option<Termination>,
    tests: Option<ToleranceTests>,
    model: Option<LinearModel>,
    n_batches: u64,
    pub(super) n_points: u64,
    n_iterations: usize,
    operation: Option<Operation>,
}

impl Core {
    /// Records the answers to points of the sample. Returns true if all points are known.
    fn tell_sample(&mut self, answers: &Answers) -> Result<bool, Error> {
        let constraints = &self.setup.constraints;
        self.rounds.tell_ranked(answers, constraints, &mut self.sample, |_, k| {
            Cost::of(&answers.outcomes()[k], constraints, answers.constraints(k))
        })
    }

    /// True if probably all minima have been found.
    fn has_all_minima(&self) -> bool {
        let n_looked_at = clusters::n_looked_at(self.sample.len());
        let n_trials = if self.clusters_are_split { self.n_starts } else { n_looked_at };
        clusters::are_probably_all(self.minima.len(), n_trials)
    }

    /// True if the search that ended at the best minimum has converged. If the cost is zero, the x test does
    /// not need to pass.
    fn has_converged(&self) -> bool {
        self.end == Some(Termination::Converged) || self.tests.is_some_and(|tests| tests.passed)
    }
}

/// A running local search.
pub(super) struct Search {
    pub(super) start: Vec<f64>,
    pub(super) method: Box<dyn Method + Send>,
    /// Points of the search in the last batch.
    pub(super) requested: Batch,
}

/// Stored form, with the inner methods as separate states.
#[derive(Serialize, Deserialize)]
struct Stored<C> {
    core: C,
    exploration: Option<Vec<u8>>,
    searches: Vec<(Vec<f64>, Vec<u8>)>,
}

/// A running search from several starts, created by [`Multistart`].
pub struct MultistartState {
    pub(super) options: Multistart,
    pub(super) core: Core,
    exploration: Option<Box<dyn Method + Send>>,
    pub(super) searches: Vec<Search>,
    pub(super) ahead: Vec<SpeculativeSearches>,
    /// The last requested batch of all searches; empty if no points are pending.
    pub(super) requested: Batch,
    received: Answers,
}

impl fmt::Debug for MultistartState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MultistartState").field("core", &self.core).finish_non_exhaustive()
    }
}

impl MultistartState {
    pub(super) fn begin(options: &Multistart, setup: &Setup) -> Result<Self, Error> {
        let (space, n) = (&setup.space, setup.space.n_free());
        let seed = setup.seed.unwrap_or_else(draw_seed);
        let share = options.exploration_of(n, setup.constraints.has_equalities());
        let planned = setup.max_evaluations.map_or(0, |budget| (share * budget as f64) as usize);
        let explores = planned > 0 && n > 0;
        let core = Core {
            setup: Setup { seed: Some(seed), ..setup.clone() },
            seed,
            phase: if explores { Phase::Exploring } else { Phase::Sampling },
            sample: RankedPoints::new(space, 0),
            used: Vec::new(),
            rounds: PendingGeneration::default(),
            queue: Vec::new(),
            n_planned: if explores { planned } else { 0 },
            n_explored: 0,
            n_starts: 0,
            n_tests_of_clusters: 0,
            clusters_are_split: false,
            n_elsewhere: 0,
            minima: Vec::new(),
            best: Best::default(),
            best_violation: 0.0,
            end: None,
            tests: None,
            model: None,
            n_batches: 0,
            n_points: 0,
            n_iterations: 0,
            operation: None,
        };
        let mut state = Self::of(options, core, None);
        if explores {
            state.exploration = Some(options.explore(&state.core.setup, planned, None)?);
        } else {
            state.enlarge()?;
            let seeded = state.core.sample.seed_with(setup, true);
            if n == 0 && seeded == 0 {
                state.core.sample.place_exactly(0, space.x0(), space);
            }
        }
        Ok(state)
    }

    fn of(options: &Multistart, core: Core, exploration: Option<Box<dyn Method + Send>>) -> Self {
        let (requested, received) = (Batch::new(), Answers::default());
        Self {
            options: options.clone(),
            core,
            exploration,
            searches: Vec::new(),
            ahead: Vec::new(),
            requested,
            received,
        }
    }

    pub(super) fn restore(options: &Multistart, setup: &Setup, state: &[u8]) -> Result<Self, Error> {
        let space = &setup.space;
        let stored: Stored<Core> = restored(state, |s: &Stored<Core>| {
            let core = &s.core;
            core.setup.space == *space
                && core.setup.constraints == setup.constraints
                && core.best_violation >= 0.0
                && core.sample.is_sound(space)
                && core.used.len() == core.sample.len()
                && core.rounds.is_sound(space.n())
                && core.best.is_sound(space.n())
                && core.best.get().is_none_or(|(x, _)| space.bounds().contains(x))
                && core.minima.iter().all(|m| m.x.len() == space.n())
                && core
                    .queue
                    .iter()
                    .chain(s.searches.iter().map(|(start, _)| start))
                    .all(|x| x.len() == space.n() && space.bounds().contains(x))
                && (core.phase != Phase::Exploring || s.exploration.is_some())
                && (core.phase != Phase::Searching || !s.searches.is_empty())
        })?;
        let Stored { core, exploration, searches } = stored;
        let exploration = match exploration {
            Some(state) => Some(options.explore(&core.setup, core.n_planned, Some(&state))?),
            None => None,
        };
        let mut whole = Self::of(options, core, exploration);
        for (start, state) in searches {
            whole.add(start, Some(&state))?;
        }
        Ok(whole)
    }

    /// Adds the points of the next sample. Existing points stay.
    fn enlarge(&mut self) -> Result<(), Error> {
        let Core { setup, seed, sample, used, .. } = &mut self.core;
        let (space, n) = (&setup.space, setup.space.n_free());
        let (before, more) = (sample.len(), self.options.sample_of(n));
        let sampling = self.options.sampling_of(n);
        // A Sobol sequence continues where it ended. Other samples are drawn with a new seed.
        let (skipped, seed) = match sampling {
            Sampling::Sobol => (before, *seed),
            _ => (0, seed.wrapping_add(before as u64)),
        };
        let mut points = Vec::new();
        sampling.fill(space, seed, skipped + more, &mut points)?;
        sample.resize(before + more);
        used.resize(before + more, false);
        for slot in before..before + more {
            let from = (slot - before + skipped) * n;
            sample.place(slot, &points[from..from + n], space);
        }
        Ok(())
    }

    /// Returns the setup of a search from a point, with a separate seed.
    pub(super) fn setup_at(&self, start: &[f64]) -> Setup {
        let Core { setup, seed, .. } = &self.core;
        let space = setup.space.starting_at(start);
        let seed = Some(seed_at(*seed, start));
        Setup { space, seed, start_given: true, prior: Vec::new(), ..setup.clone() }
    }

    /// Adds a search from a point, or restores it from a state.
    fn add(&mut self, start: Vec<f64>, state: Option<&[u8]>) -> Result<(), Error> {
        let method = self.options.search(&self.setup_at(&start), state)?;
        self.searches.push(Search { start, method, requested: Batch::new() });
        Ok(())
    }

    /// Processes a sample after all its points are known.
    fn sampled(&mut self) -> Result<(), Error> {
        let Core { setup, sample, used, queue, phase, operation, n_starts, .. } = &mut self.core;
        sample.rank();
        let first = operation.is_none();
        if first && sample.n_finite() == 0 {
            *phase = Phase::NoStart;
            return Ok(());
        }
        if setup.space.n_free() == 0 {
            (*phase, *operation) = (Phase::Ended(Termination::AllFixed), Some(Operation::Initial));
            return Ok(());
        }
        if first {
            *operation = Some(Operation::Initial);
            let has_cost = sample.cost(0).is_ranked();
            if setup.start_given && has_cost && sample.x(0) == setup.space.x0() {
                queue.push(sample.x(0).to_vec());
                used[0] = true;
            }
        }
        let left =
            self.options.max_starts.map_or(usize::MAX, |most| most.saturating_sub(*n_starts + queue.len()));
        for slot in clusters::starts(&setup.space, sample, used).into_iter().take(left) {
            queue.push(sample.x(slot).to_vec());
            used[slot] = true;
        }
        self.next()
    }

    /// Starts searches, continues with the next sample, or ends.
    fn next(&mut self) -> Result<(), Error> {
        while self.searches.len() < self.at_once() && !self.core.queue.is_empty() {
            let start = self.core.queue.remove(0);
            self.core.n_starts += 1;
            self.add(start, None)?;
        }
        let Core { sample, n_starts, .. } = &self.core;
        let most_starts = self.options.max_starts.unwrap_or(usize::MAX);
        // Finding more minima only makes it less probable that these are all.
        let is_last = self.core.has_all_minima() || *n_starts >= most_starts || sample.len() >= MAX_MEMBERS;
        if !self.searches.is_empty() {
            // Request the next sample early, so that enough searches are available before the last current
            // one has ended.
            let has_capacity = self.first_has_ended() && self.searches.len() < self.at_once();
            if has_capacity && !is_last && !sample.is_pending() {
                self.enlarge()?;
            }
            self.core.phase = Phase::Searching;
        } else if sample.is_pending() {
            self.core.phase = Phase::Sampling;
        } else if is_last && self.test_clusters(most_starts) {
            return self.next();
        } else if is_last {
            let end = match &self.core.end {
                Some(Termination::Noise) => Termination::Noise,
                _ if self.core.has_converged() => Termination::Converged,
                _ => Termination::Stalled,
            };
            self.core.phase = Phase::Ended(end);
        } else {
            self.core.phase = Phase::Sampling;
            self.enlarge()?;
        }
        Ok(())
    }

    /// Queues starts that test the clusters, once per run. These are points that represent a minimum because
    /// a better point is near. Returns true if there are any.
    fn test_clusters(&mut self, most_starts: usize) -> bool {
        let Core { sample, used, queue, n_starts, n_tests_of_clusters, .. } = &mut self.core;
        if *n_tests_of_clusters > 0 {
            return false;
        }
        for slot in clusters::tests(sample, used).into_iter().take(most_starts.saturating_sub(*n_starts)) {
            queue.push(sample.x(slot).to_vec());
            used[slot] = true;
        }
        *n_tests_of_clusters = queue.len();
        !queue.is_empty()
    }

    fn first_has_ended(&self) -> bool {
        self.core.n_starts > self.searches.len()
    }

    /// Returns the number of searches that run in parallel. After an exploration, the first search runs alone
    /// on the remaining budget.
    fn at_once(&self) -> usize {
        self.options.side_by_side.unwrap_or(if self.needs_the_rest() { 1 } else { SIDE_BY_SIDE })
    }

    /// True if the first search after an exploration is running.
    pub(super) fn needs_the_rest(&self) -> bool {
        self.core.n_planned > 0 && !self.first_has_ended()
    }

    /// Processes the answers to the points of the exploration.
    fn explored(&mut self, answers: &Answers) -> Result<(), Error> {
        let Some(exploration) = &mut self.exploration else { return Ok(()) };
        exploration.tell(answers)?;
        let core = &mut self.core;
        core.n_explored += answers.outcomes().iter().filter(|o| o.is_conclusive()).count();
        let (details, status) = (exploration.details(), exploration.status());
        match (details.operation, details.population) {
            (Some(Operation::Initial), Some(population)) if core.operation.is_none() => {
                core.operation = Some(Operation::Initial);
                let space = &core.setup.space;
                core.sample = RankedPoints::new(space, population.len());
                core.used = vec![false; population.len()];
                for rank in 0..population.len() {
                    core.sample.place_exactly(rank, population.vertex(rank), space);
                    core.sample.set_cost(rank, population.rank_cost(rank));
                }
            }
            (Some(_), _) => core.operation = Some(Operation::Generation),
            (None, _) => {}
        }
        match status {
            Status::NoStart => core.phase = Phase::NoStart,
            // The sample requires the first population.
            Status::Running if core.n_explored < core.n_planned || core.operation.is_none() => {}
            _ => {
                core.queue.extend(core.best.get().map(|(x, _)| x.to_vec()));
                self.exploration = None;
                return self.sampled();
            }
        }
        Ok(())
    }

    /// Processes the answers to the points of the searches.
    fn searched(&mut self, answers: &Answers) -> Result<(), Error> {
        let mut first = 0;
        for search in &mut self.searches {
            let len = search.requested.len();
            self.received.clear();
            for k in first..(first + len).min(answers.len()) {
                self.received.push_from(answers, k);
            }
            first += len;
            if len > 0 {
                search.method.tell(&self.received)?;
                self.ahead.retain_mut(|ahead| ahead.start != search.start || ahead.follow(&self.received));
            }
        }
        self.core.operation = Some(Operation::LocalSearches);
        if self.core.sample.is_pending() {
            // The remaining points belong to the next sample.
            self.received.clear();
            for k in first..answers.len() {
                self.received.push_from(answers, k);
            }
            if self.core.tell_sample(&self.received)? {
                self.sampled()?;
            }
        }
        self.retire()
    }

    /// Records the ended searches, and continues with the next ones.
    fn retire(&mut self) -> Result<(), Error> {
        let (core, before) = (&mut self.core, self.searches.len());
        let n_minima = core.minima.len();
        self.searches.retain(|search| {
            let status = search.method.status();
            if let Some((x, cost)) = search.method.best().filter(|_| status != Status::Running)
                && search.method.best_violation() == 0.0
            {
                if core.minima.first().is_none_or(|best| cost < best.cost) {
                    core.end = match &status {
                        Status::Ended(end) => Some(end.clone()),
                        Status::Running | Status::NoStart => None,
                    };
                    (core.tests, core.model) =
                        (search.method.details().tests, search.method.linear_model(&RunContext::new()));
                }
                let found = Optimum { x: x.to_vec(), cost, n_starts: 1 };
                clusters::enter(&core.setup.space, &mut core.minima, found);
            }
            status == Status::Running
        });
        core.clusters_are_split |= core.n_tests_of_clusters > 0 && core.minima.len() > n_minima;
        let Self { searches, ahead, .. } = self;
        ahead.retain(|ahead| {
            searches.iter().map(|search| &search.start).chain(&core.queue).any(|start| *start == ahead.start)
        });
        if self.searches.len() < before { self.next() } else { Ok(()) }
    }

    /// Delays the other searches if their points exceed half of the budget before the first local search has
    /// ended.
    fn leave_half_to_the_first(&mut self) {
        let Core { n_elsewhere, setup, .. } = &self.core;
        let Some(budget) = setup.max_evaluations.filter(|_| !self.first_has_ended()) else { return };
        let wanted: usize = self.searches.iter().skip(1).map(|search| search.requested.len()).sum();
        if n_elsewhere + wanted > budget / 2 {
            for search in self.searches.iter_mut().skip(1) {
                search.requested = Batch::new();
            }
        }
    }

    /// Requests the points of the searches. A method may detect its end only when it is asked.
    fn ask_searches(&mut self) {
        loop {
            for search in &mut self.searches {
                search.method.ask(&mut search.requested);
            }
            if self.searches.iter().all(|search| search.method.status() == Status::Running) {
                self.leave_half_to_the_first();
                return;
            }
            if self.retire().is_err() {
                // A search that has started once can start again, so this error is not expected.
                self.core.phase = Phase::Ended(Termination::Stalled);
            }
            if self.core.phase != Phase::Searching {
                return;
            }
        }
    }
}

impl Method for MultistartState {
    fn name(&self) -> &'static str {
        "multistart"
    }

    fn ask(&mut self, batch: &mut Batch) {
        if self.core.phase == Phase::Searching {
            self.ask_searches();
        }
        let Self { core, exploration, searches, requested, options, .. } = self;
        let n = core.setup.space.n();
        batch.start(n, core.n_batches, core.n_points);
        let mut take = |from: &Batch| (0..from.len()).for_each(|k| batch.push(from.point(k), from.cutoff(k)));
        let mut needs_residuals = options.needs_residuals();
        match core.phase {
            Phase::Sampling => {
                core.rounds.ask(requested, n, &core.sample, |_| f64::INFINITY);
                take(requested);
            }
            Phase::Exploring => {
                needs_residuals = false;
                if let Some(exploration) = exploration {
                    exploration.ask(requested);
                    take(requested);
                }
            }
            Phase::Searching => {
                searches.iter().for_each(|search| take(&search.requested));
                if core.sample.is_pending() {
                    core.rounds.ask(requested, n, &core.sample, |_| f64::INFINITY);
                    take(requested);
                }
            }
            Phase::NoStart | Phase::Ended(_) => {}
        }
        if needs_residuals {
            batch.set_kind(EvaluationKind::Residuals);
        }
        requested.clone_from(batch);
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        let (requested, outcomes) = (std::mem::take(&mut self.requested), answers.outcomes());
        if requested.is_empty() {
            return Err(Error::TellWithoutAsk);
        }
        if outcomes.len() > requested.len() {
            let error = Error::TooManyOutcomes { requested: requested.len(), received: outcomes.len() };
            self.requested = requested;
            return Err(error);
        }
        let core = &mut self.core;
        core.n_batches += 1;
        core.n_points += requested.len() as u64;
        for (k, outcome) in outcomes.iter().enumerate() {
            let Some(cost) = outcome.value() else { continue };
            let violation = core.setup.constraints.rank(answers.constraints(k));
            if core.best.offer_ranked(requested.point(k), cost, violation, core.best_violation) {
                core.best_violation = violation;
            }
        }
        core.n_iterations += usize::from(core.operation.is_some());
        match core.phase {
            Phase::Sampling => {
                core.n_elsewhere += requested.len();
                if core.tell_sample(answers)? {
                    self.sampled()?;
                }
            }
            Phase::Exploring => {
                core.n_elsewhere += requested.len();
                self.explored(answers)?;
            }
            Phase::Searching => {
                core.n_elsewhere +=
                    requested.len() - self.searches.first().map_or(0, |first| first.requested.len());
                self.searched(answers)?;
            }
            Phase::NoStart | Phase::Ended(_) => {}
        }
        Ok(())
    }

    fn speculate(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        match self.core.phase {
            Phase::Exploring if self.core.n_explored + self.requested.len() < self.core.n_planned => {
                if let Some(exploration) = &mut self.exploration {
                    exploration.speculate(wanted, answers_so_far, batch);
                }
            }
            Phase::Searching => self.look_ahead(wanted, answers_so_far, batch),
            _ => {}
        }
    }

    fn status(&self) -> Status {
        match &self.core.phase {
            Phase::NoStart => Status::NoStart,
            Phase::Ended(termination) => Status::Ended(termination.clone()),
            Phase::Sampling | Phase::Exploring | Phase::Searching => Status::Running,
        }
    }

    fn details(&self) -> MethodDetails<'_> {
        let core = &self.core;
        let exploring = self.exploration.as_ref().and_then(|method| method.details().population);
        MethodDetails {
            n_iterations: core.n_iterations,
            operation: core.operation,
            tests: core.tests,
            // The optimality of the best minimum is only known at the end of the method.
            settled: false,
            plan: "sample, then searches side by side",
            seed: Some(core.seed),
            population: exploring.or_else(|| Some(core.sample.view())),
            lookahead: Lookahead::Measured,
            optima: &core.minima,
            ..MethodDetails::default()
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        self.core.best.get()
    }

    fn linear_model(&self, _: &RunContext<'_>) -> Option<LinearModel> {
        let is_best = self.core.minima.first().map(|m| m.cost) == self.core.best.cost();
        self.core.model.clone().filter(|_| is_best)
    }

    fn save(&self) -> Option<Vec<u8>> {
        let mut searches = Vec::new();
        for search in &self.searches {
            searches.push((search.start.clone(), search.method.save()?));
        }
        let exploration = match &self.exploration {
            Some(exploration) => Some(exploration.save()?),
            None => None,
        };
        saved(&Stored { core: &self.core, exploration, searches })
    }
}
