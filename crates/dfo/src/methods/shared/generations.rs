//! Common part of the methods with generations: the first population, creation and evaluation of candidates,
//! selection, and termination.

use crate::error::Error;
use crate::method_interface::interface::{
    AnswersSoFar, Batch, Lookahead, Method, MethodDetails, Operation, Setup, Status, restored, saved,
};
use crate::method_interface::sampling::Sampling;
use crate::method_interface::tolerances::{TestedSet, ToleranceTests};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::pending_generation::PendingGeneration;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::outcome::answer::{Answers, Outcome};
use crate::outcome::termination::Termination;
use crate::problem::constraints::Constraints;
use crate::problem::memory;
use crate::problem::space::Space;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Rules specific to a method with generations.
pub trait GenerationRules: Serialize + DeserializeOwned {
    /// Returns the name of the method.
    fn name(&self) -> &'static str;

    /// Creates the candidates of a generation, counted from 1.
    fn make_candidates(&mut self, generation: u64, pool: &mut Populations);

    /// Returns the cost above which a candidate makes no difference, or infinity.
    fn cutoff(&self, pool: &Populations, candidate: usize) -> f64;

    /// Selects the next population from the evaluated candidates.
    fn select(&mut self, pool: &mut Populations);

    /// Called when the first population is known.
    fn started(&mut self, pool: &mut Populations);

    /// Returns how many points are evaluated speculatively.
    fn lookahead(&self) -> Lookahead {
        Lookahead::None
    }

    /// Calls `found` for each candidate of later generations that is already certain, in order and with its
    /// cutoff. Ends if `found` returns false. `cost` returns the available cost of a member of the first
    /// population if `is_first`, otherwise of a candidate.
    fn look_ahead(
        &mut self,
        pool: &Populations,
        is_first: bool,
        cost: &dyn Fn(usize) -> Option<Cost>,
        found: &mut dyn FnMut(&[f64], f64) -> bool,
    ) {
        let _ = (pool, is_first, cost, found);
    }

    /// Returns the reason for termination after a generation whose tests did not pass, if the run has ended.
    /// `best` is the best cost so far.
    fn ended(&mut self, pool: &Populations, best: Cost) -> Option<Termination>;

    /// Returns the cost by which the member or candidate in a slot ranks. `values` are the values of the
    /// nonlinear constraints.
    fn cost_of(&mut self, slot: usize, outcome: &Outcome, constraints: &Constraints, values: &[f64]) -> Cost {
        let _ = slot;
        Cost::of(outcome, constraints, values)
    }

    /// Returns the part of the population that the tolerance tests measure.
    fn extent(&self) -> TestedSet {
        TestedSet::Population
    }

    /// Applies the tolerance tests to other points, if the population is a poor measure of convergence.
    fn judge_others(&self, pool: &Populations, f_0: f64) -> Option<ToleranceTests> {
        let _ = (pool, f_0);
        None
    }

    /// True if the search continues although the tests have passed, in order to try other integers. A search
    /// that always continues ends when it stalls.
    fn tries_neighbours(&self, space: &Space) -> bool {
        let _ = space;
        false
    }

    /// Restarts after the end of a search, possibly with another population. Returns true if the search
    /// continues.
    fn restart(&mut self, pool: &Populations, f_0: f64) -> bool {
        let _ = (pool, f_0);
        false
    }

    /// True if the rules are consistent with the problem and the pool. State loaded from a file may be
    /// inconsistent.
    fn is_sound(&self, pool: &Populations) -> bool;
}

/// The problem, the population, and the candidates for the next one.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Populations {
    pub(crate) setup: Setup,
    pub(crate) seed: u64,
    pub(crate) population: RankedPoints,
    pub(crate) candidates: RankedPoints,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Phase {
    /// The first population is being evaluated.
    Starting,
    /// Candidates of this generation must be created.
    Proposing,
    /// The candidates are being evaluated.
    Evaluating,
    NoStart,
    Ended(Termination),
}

/// A running method with generations.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Generations<B> {
    rules: B,
    pool: Populations,
    phase: Phase,
    rounds: PendingGeneration,
    n_iterations: usize,
    tests: Option<ToleranceTests>,
    f_0: f64,
    /// The tests that passed before the last restart. They remain valid until a better point is found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    passed: Option<ToleranceTests>,
}

impl<B: GenerationRules> Generations<B> {
    pub(crate) fn new(rules: B, pool: Populations) -> Self {
        let rounds = PendingGeneration::with_capacity(pool.population.len());
        Self {
            rules,
            pool,
            phase: Phase::Starting,
            rounds,
            n_iterations: 0,
            tests: None,
            f_0: 0.0,
            passed: None,
        }
    }

    /// Restores a state saved for this problem.
    pub(crate) fn restore(setup: &Setup, state: &[u8]) -> Result<Self, Error> {
        restored(state, |s: &Self| s.is_sound(setup))
    }

    /// True if the state is consistent with itself and with the problem. State loaded from a file may be
    /// inconsistent.
    pub(crate) fn is_sound(&self, setup: &Setup) -> bool {
        let (Populations { setup: stored, population, candidates, .. }, space) = (&self.pool, &setup.space);
        stored.space == *space
            && stored.constraints == setup.constraints
            && population.is_sound(space)
            && candidates.is_sound(space)
            && self.rounds.is_sound(space.n())
            && self.rules.is_sound(&self.pool)
    }

    /// Returns the numbers of answered batches and points.
    pub(crate) fn counts(&self) -> (u64, u64) {
        self.rounds.counts()
    }

    /// Returns the state of the method except its population.
    pub(crate) fn rules(&self) -> &B {
        &self.rules
    }

    fn start_evaluated(&mut self) {
        let Populations { population, setup, .. } = &mut self.pool;
        population.rank();
        self.f_0 = population.typical_cost();
        self.phase = if population.n_finite() == 0 {
            Phase::NoStart
        } else if setup.space.n_free() == 0 {
            Phase::Ended(Termination::AllFixed)
        } else {
            Phase::Proposing
        };
        self.rules.started(&mut self.pool);
    }

    fn end_generation(&mut self) {
        self.rules.select(&mut self.pool);
        self.pool.population.rank();
        self.n_iterations += 1;
        let tests = self.rules.judge_others(&self.pool, self.f_0).unwrap_or_else(|| {
            let Populations { population, setup, .. } = &self.pool;
            population.judge(self.rules.extent(), &setup.space, &setup.tolerances, self.f_0)
        });
        self.tests = Some(tests);
        let best = self.rounds.best_cost();
        let (is_feasible, f_best) =
            (!matches!(best, Cost::Infeasible(_)), best.value().unwrap_or(f64::INFINITY));
        let ended = match self.rules.ended(&self.pool, best) {
            _ if tests.passed && is_feasible && !self.rules.tries_neighbours(&self.pool.setup.space) => {
                Some(Termination::Converged)
            }
            // No untried neighbour is left.
            Some(Termination::Collapsed) if tests.passed && is_feasible => Some(Termination::Converged),
            other => other,
        };
        if let Some(earlier) = self.passed.filter(|earlier| f_best >= earlier.f_best) {
            self.tests = Some(earlier);
        }
        self.phase = match ended {
            None => Phase::Proposing,
            Some(_) if self.rules.restart(&self.pool, self.f_0) => {
                self.passed = self.tests.filter(|tests| tests.passed);
                Phase::Proposing
            }
            Some(_) if self.passed.is_some() && self.tests == self.passed => {
                Phase::Ended(Termination::Converged)
            }
            Some(termination) => Phase::Ended(termination),
        };
    }
}

impl<B: GenerationRules> Method for Generations<B> {
    fn name(&self) -> &'static str {
        self.rules.name()
    }

    fn ask(&mut self, batch: &mut Batch) {
        if self.phase == Phase::Proposing {
            self.rules.make_candidates(self.n_iterations as u64 + 1, &mut self.pool);
            self.phase = Phase::Evaluating;
        }
        let Self { rules, pool, phase, rounds, .. } = self;
        let n = pool.setup.space.n();
        match phase {
            Phase::Starting => rounds.ask(batch, n, &pool.population, |_| f64::INFINITY),
            Phase::Evaluating => rounds.ask(batch, n, &pool.candidates, |k| rules.cutoff(pool, k)),
            Phase::Proposing | Phase::NoStart | Phase::Ended(_) => rounds.ask_nothing(batch, n),
        }
    }

    fn speculate(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        let Self { rules, pool, phase, rounds, .. } = self;
        let (is_first, tried) = match phase {
            Phase::Starting => (true, &pool.population),
            Phase::Evaluating => (false, &pool.candidates),
            Phase::Proposing | Phase::NoStart | Phase::Ended(_) => return,
        };
        if rules.lookahead() == Lookahead::None {
            return;
        }
        let cost = |slot: usize| match tried.cost(slot) {
            Cost::Pending => rounds
                .place_of(slot)
                .and_then(|k| answers_so_far.answer(k))
                .map(|a| Cost::of(&a.outcome, &pool.setup.constraints, &a.constraints)),
            cost => Some(cost),
        };
        let mut left = wanted;
        rules.look_ahead(pool, is_first, &cost, &mut |x, cutoff| {
            batch.push(x, cutoff);
            left -= usize::from(!answers_so_far.contains(x));
            left > 0
        });
        batch.all_certain();
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        let Self { rules, pool: Populations { setup, population, candidates, .. }, rounds, phase, .. } = self;
        let constraints = &setup.constraints;
        let cost_of = |slot: usize, k: usize| {
            rules.cost_of(slot, &answers.outcomes()[k], constraints, answers.constraints(k))
        };
        if *phase == Phase::Starting {
            if rounds.tell_ranked(answers, constraints, population, cost_of)? {
                self.start_evaluated();
            }
        } else if rounds.tell_ranked(answers, constraints, candidates, cost_of)? {
            self.end_generation();
        }
        Ok(())
    }

    fn status(&self) -> Status {
        match &self.phase {
            Phase::NoStart => Status::NoStart,
            Phase::Ended(termination) => Status::Ended(termination.clone()),
            Phase::Starting | Phase::Proposing | Phase::Evaluating => Status::Running,
        }
    }

    fn details(&self) -> MethodDetails<'_> {
        let operation = match (&self.phase, self.n_iterations) {
            (Phase::Starting | Phase::NoStart, _) => None,
            (_, 0) => Some(Operation::Initial),
            _ => Some(Operation::Generation),
        };
        MethodDetails {
            n_iterations: self.n_iterations,
            operation,
            tests: self.tests,
            settled: self.tests.is_some_and(|tests| tests.passed),
            plan: "generation",
            lookahead: self.rules.lookahead(),
            seed: Some(self.pool.seed),
            population: Some(self.pool.population.view()),
            ..MethodDetails::default()
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        self.rounds.best()
    }

    fn best_violation(&self) -> f64 {
        self.rounds.best_violation()
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }
}

impl Populations {
    /// Samples the first population. Known points and the start point occupy the first slots. Also returns
    /// the number of these points.
    pub(crate) fn new(
        setup: Setup,
        seed: u64,
        members: usize,
        candidates: usize,
        sampling: Sampling,
        include_start: bool,
    ) -> Result<(Self, usize), Error> {
        let space = &setup.space;
        let n = space.n_free();
        // Both on two scales, the sampled points, and the points of a batch.
        let rows = 3 * members + 2 * candidates;
        memory::check("a population with this many members and parameters", &[rows, space.n() + n])?;
        let mut population = RankedPoints::new(space, members);
        let mut points = Vec::new();
        sampling.fill(space, seed, members, &mut points)?;
        for slot in 0..members {
            population.place(slot, &points[slot * n..(slot + 1) * n], space);
        }
        let n_exact = population.seed_with(&setup, include_start || n == 0);
        let candidates = RankedPoints::new(space, candidates);
        Ok((Self { setup, seed, population, candidates }, n_exact))
    }
}
