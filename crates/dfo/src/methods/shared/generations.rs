//! What the methods with generations have in common: a first population, candidates that are bred and tried, selection,
//! and how it all ends.

use crate::answer::Answers;
use crate::error::Error;
use crate::memory;
use crate::method::{Batch, Details, Method, Operation, Setup, Status, restored, saved};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::population::Population;
use crate::methods::shared::rounds::Rounds;
use crate::sampling::Sampling;
use crate::space::Space;
use crate::termination::Termination;
use crate::tolerances::{Extent, Tests};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// What one such method does its own way.
pub trait Breeder: Serialize + DeserializeOwned {
    /// Name of the method.
    fn name(&self) -> &'static str;

    /// Makes the candidates of a generation (counted from 1).
    fn breed(&mut self, generation: u64, pool: &mut Pool);

    /// The cost above which a candidate makes no difference; infinite if there is none.
    fn cutoff(&self, pool: &Pool, candidate: usize) -> f64;

    /// Takes candidates, all of them tried, into the population.
    fn select(&mut self, pool: &mut Pool);

    /// The first population is known.
    fn started(&mut self, pool: &Pool);

    /// Why the run is over after a generation whose tests did not pass, if it is. `best`: the smallest cost so far.
    fn ended(&mut self, pool: &Pool, best: f64) -> Option<Termination>;

    /// How much of the population the tolerance tests measure.
    fn extent(&self) -> Extent {
        Extent::Population
    }

    /// The tolerance tests over the best points of all generations, where the population says nothing about convergence.
    fn judge_best_seen(&self, setup: &Setup, f_0: f64) -> Option<Tests> {
        let _ = (setup, f_0);
        None
    }

    /// Whether the search goes on where all members are one point of whole numbers: until nothing new comes for long.
    fn tries_neighbours(&self, space: &Space) -> bool {
        let _ = space;
        false
    }

    /// Whether this fits to a problem and to its pool: what comes from a file may not.
    fn is_sound(&self, pool: &Pool) -> bool;
}

/// The problem, and those who live.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Pool {
    pub(crate) setup: Setup,
    pub(crate) seed: u64,
    pub(crate) population: Population,
    pub(crate) candidates: Population,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Phase {
    /// The first population is being evaluated.
    Starting,
    /// Candidates of this generation are to be made.
    Breeding,
    /// They are being evaluated.
    Trying,
    NoStart,
    Ended(Termination),
}

/// A running method with generations.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Generations<B> {
    breeder: B,
    pool: Pool,
    phase: Phase,
    rounds: Rounds,
    n_iterations: usize,
    tests: Option<Tests>,
    f_0: f64,
}

impl<B: Breeder> Generations<B> {
    pub(crate) fn new(breeder: B, pool: Pool) -> Self {
        let rounds = Rounds::with_capacity(pool.population.len());
        Self { breeder, pool, phase: Phase::Starting, rounds, n_iterations: 0, tests: None, f_0: 0.0 }
    }

    /// Continues from a state that was saved for this problem.
    pub(crate) fn restore(setup: &Setup, state: &[u8]) -> Result<Self, Error> {
        let space = &setup.space;
        restored(state, |s: &Self| {
            s.pool.setup.space == *space
                && s.pool.population.is_sound(space)
                && s.pool.candidates.is_sound(space)
                && s.rounds.is_sound(space.n())
                && s.breeder.is_sound(&s.pool)
        })
    }

    fn start_known(&mut self) {
        let Pool { population, setup, .. } = &mut self.pool;
        population.rank();
        self.f_0 = population.typical_cost();
        self.phase = if population.n_finite() == 0 {
            Phase::NoStart
        } else if setup.space.n_free() == 0 {
            Phase::Ended(Termination::AllFixed)
        } else {
            Phase::Breeding
        };
        self.breeder.started(&self.pool);
    }

    fn end_generation(&mut self) {
        self.breeder.select(&mut self.pool);
        let Pool { population, setup, .. } = &mut self.pool;
        population.rank();
        self.n_iterations += 1;
        let tests = self.breeder.judge_best_seen(setup, self.f_0).unwrap_or_else(|| {
            population.judge(self.breeder.extent(), &setup.space, &setup.tolerances, self.f_0)
        });
        self.tests = Some(tests);
        let best = self.rounds.best().map_or(f64::INFINITY, |(_, f)| f);
        let ended = self.breeder.ended(&self.pool, best);
        self.phase = match ended {
            _ if tests.passed && !self.breeder.tries_neighbours(&self.pool.setup.space) => {
                Phase::Ended(Termination::Converged)
            }
            // No neighbour can be tried any more.
            Some(Termination::Collapsed) if tests.passed => Phase::Ended(Termination::Converged),
            Some(termination) => Phase::Ended(termination),
            None => Phase::Breeding,
        };
    }
}

impl<B: Breeder> Method for Generations<B> {
    fn name(&self) -> &'static str {
        self.breeder.name()
    }

    fn ask(&mut self, batch: &mut Batch) {
        if self.phase == Phase::Breeding {
            self.breeder.breed(self.n_iterations as u64 + 1, &mut self.pool);
            self.phase = Phase::Trying;
        }
        let Self { breeder, pool, phase, rounds, .. } = self;
        let n = pool.setup.space.n();
        match phase {
            Phase::Starting => rounds.ask(batch, n, &pool.population, |_| f64::INFINITY),
            Phase::Trying => rounds.ask(batch, n, &pool.candidates, |k| breeder.cutoff(pool, k)),
            Phase::Breeding | Phase::NoStart | Phase::Ended(_) => rounds.ask_nothing(batch, n),
        }
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        if self.phase == Phase::Starting {
            if self.rounds.tell(answers, &mut self.pool.population)? {
                self.start_known();
            }
        } else if self.rounds.tell(answers, &mut self.pool.candidates)? {
            self.end_generation();
        }
        Ok(())
    }

    fn status(&self) -> Status {
        match &self.phase {
            Phase::NoStart => Status::NoStart,
            Phase::Ended(termination) => Status::Ended(termination.clone()),
            Phase::Starting | Phase::Breeding | Phase::Trying => Status::Running,
        }
    }

    fn details(&self) -> Details<'_> {
        let operation = match (&self.phase, self.n_iterations) {
            (Phase::Starting | Phase::NoStart, _) => None,
            (_, 0) => Some(Operation::Initial),
            _ => Some(Operation::Generation),
        };
        Details {
            n_iterations: self.n_iterations,
            operation,
            tests: self.tests,
            settled: self.tests.is_some_and(|tests| tests.passed),
            plan: "generation",
            seed: Some(self.pool.seed),
            population: Some(self.pool.population.view()),
            ..Details::default()
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        self.rounds.best()
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }
}

impl Pool {
    /// The first population, sampled; what is known and the start point stand first. Returns how many those are.
    pub(crate) fn new(
        setup: Setup,
        seed: u64,
        (members, candidates): (usize, usize),
        sampling: Sampling,
        include_start: bool,
    ) -> Result<(Self, usize), Error> {
        let space = &setup.space;
        let n = space.n_free();
        // Both on two scales, the sampled points, and the points of a batch.
        let rows = 3 * members + 2 * candidates;
        memory::check("a population of so many members and parameters", &[rows, space.n() + n])?;
        let mut population = Population::new(space, members);
        let mut points = Vec::new();
        sampling.fill(space, seed, members, &mut points)?;
        for slot in 0..members {
            population.place(slot, &points[slot * n..(slot + 1) * n], space);
        }
        let n_exact = population.seed_with(&setup, include_start || n == 0);
        let candidates = Population::new(space, candidates);
        Ok((Self { setup, seed, population, candidates }, n_exact))
    }

    /// The cost of a member as a cutoff for what would take its place.
    pub(crate) fn cost_as_cutoff(&self, member: usize) -> f64 {
        match self.population.cost(member) {
            Cost::Value(cost) => cost,
            _ => f64::INFINITY,
        }
    }
}
