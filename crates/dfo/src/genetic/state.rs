//! The state machine: members with their strings, their children, and what a complete generation does to both.

use super::coding::Coding;
use super::operators::{cross, fitness_sums, mutate, spin, tournament};
use super::options::{Genetic, Selection};
use crate::error::Error;
use crate::method::{Batch, Method, Operation, Setup, SimplexView, Status, saved};
use crate::objective::Outcome;
use crate::population::Population;
use crate::rng::{Purpose, Stream};
use crate::rounds::Rounds;
use crate::termination::{Termination, Tests};
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Phase {
    /// The first population is being evaluated.
    Starting,
    /// Children of this generation are to be made.
    Breeding,
    /// They are being evaluated.
    Trying,
    NoStart,
    Ended(Termination),
}

/// A running genetic algorithm; made by [`Genetic`].
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GeneticState {
    options: Genetic,
    setup: Setup,
    coding: Coding,
    seed: u64,
    mutation_rate: f64,
    population: Population,
    /// The strings of all members, one after the other.
    bits: Vec<bool>,
    /// The elite is not among them.
    children: Population,
    child_bits: Vec<bool>,
    /// The second child of a last pair that needs only one.
    spare: Vec<bool>,
    sums: Vec<f64>,
    decoded: Vec<f64>,
    phase: Phase,
    rounds: Rounds,
    n_iterations: usize,
    /// Generations since the best point changed, and its cost then.
    idle: usize,
    idle_since: f64,
    tests: Option<Tests>,
    f_0: f64,
}

impl GeneticState {
    pub(super) fn new(
        options: &Genetic,
        setup: Setup,
        coding: Coding,
        members: usize,
        seed: u64,
    ) -> Result<Self, Error> {
        let space = &setup.space;
        let (n, length) = (space.n_free(), coding.length());
        let mut population = Population::new(space, members);
        let mut points = Vec::new();
        options.sampling.fill(space, seed, members, &mut points)?;
        for slot in 0..members {
            population.place(slot, &points[slot * n..(slot + 1) * n], space);
        }
        let n_exact = population.seed_with(&setup, options.include_start || n == 0);
        let (mut bits, mut decoded) = (vec![false; members * length], vec![0.0; n]);
        for slot in 0..members {
            let own = &mut bits[slot * length..(slot + 1) * length];
            coding.encode(space, population.u(slot), population.x(slot), own);
            // A sampled point moves to what its string stands for; one that was given is evaluated as it was given.
            if slot >= n_exact {
                coding.decode(space, own, &mut decoded);
                population.place(slot, &decoded, space);
            }
        }
        let n_children = if n == 0 { 0 } else { members - options.elite };
        Ok(Self {
            mutation_rate: options.mutation_rate.unwrap_or((1.0 / length.max(1) as f64).min(0.1)),
            children: Population::new(space, n_children),
            child_bits: vec![false; n_children * length],
            spare: vec![false; length],
            sums: Vec::with_capacity(members),
            rounds: Rounds::with_capacity(members),
            options: options.clone(),
            phase: Phase::Starting,
            n_iterations: 0,
            idle: 0,
            idle_since: f64::INFINITY,
            tests: None,
            f_0: 0.0,
            setup,
            coding,
            seed,
            population,
            bits,
            decoded,
        })
    }

    /// Whether this state fits to a problem and to itself.
    pub(super) fn is_sound(&self, setup: &Setup) -> bool {
        let (space, length) = (&setup.space, self.coding.length());
        let (members, children) = (self.population.len(), self.children.len());
        self.setup.space == *space
            && Coding::new(space, &self.options.resolution, self.options.gray).as_ref() == Ok(&self.coding)
            && members >= 1
            && (children + self.options.elite == members || space.n_free() == 0)
            && self.population.is_sound(space)
            && self.children.is_sound(space)
            && (self.bits.len(), self.child_bits.len()) == (members * length, children * length)
            && self.spare.len() == length
            && self.decoded.len() == space.n_free()
            && self.rounds.is_sound(space.n())
    }

    /// Makes the children of a generation, each pair from draws of its own.
    fn breed(&mut self) {
        let generation = self.n_iterations as u64 + 1;
        let length = self.coding.length();
        fitness_sums(&self.population, &mut self.sums);
        for (pair, strings) in self.child_bits.chunks_mut((2 * length).max(1)).enumerate() {
            let mut stream = Stream::new(self.seed, Purpose::Individual, generation, pair);
            let mut parent = || match self.options.selection {
                Selection::FitnessProportional => spin(&mut stream, &self.sums),
                Selection::Tournament(size) => tournament(&mut stream, &self.population, size),
            };
            let parents = [parent(), parent()];
            let own = |slot: usize| &self.bits[slot * length..(slot + 1) * length];
            let (first, second) = strings.split_at_mut(length);
            let second = if second.is_empty() { &mut self.spare[..] } else { second };
            first.copy_from_slice(own(parents[0]));
            second.copy_from_slice(own(parents[1]));
            if stream.chance(self.options.crossover_rate) {
                cross(&mut stream, first, second);
            }
            mutate(&mut stream, self.mutation_rate, first);
            mutate(&mut stream, self.mutation_rate, second);
        }
        for slot in 0..self.children.len() {
            let own = &self.child_bits[slot * length..(slot + 1) * length];
            self.coding.decode(&self.setup.space, own, &mut self.decoded);
            self.children.place(slot, &self.decoded, &self.setup.space);
        }
    }

    /// Children take the places of all but the elite.
    fn end_generation(&mut self) {
        let length = self.coding.length();
        let replaced = self.population.len() - self.children.len();
        let slots: &[usize] = &self.population.order()[replaced..];
        self.sums.clear();
        // The ranks change below, so the slots are noted first (in a buffer that is free now).
        self.sums.extend(slots.iter().map(|s| *s as f64));
        for (child, slot) in self.sums.iter().map(|s| *s as usize).enumerate() {
            self.population.copy_from(slot, &self.children, child);
            let own = &self.child_bits[child * length..(child + 1) * length];
            self.bits[slot * length..(slot + 1) * length].copy_from_slice(own);
        }
        self.population.rank();
        self.n_iterations += 1;
        let best = self.rounds.best().map_or(f64::INFINITY, |(_, f)| f);
        self.idle = if best < self.idle_since { 0 } else { self.idle + 1 };
        self.idle_since = best;
        let tests = self.population.judge(&self.setup.space, &self.setup.tolerances, self.f_0);
        self.tests = Some(tests);
        self.phase = if tests.passed {
            Phase::Ended(Termination::Converged)
        } else if self.options.stall.is_some_and(|limit| self.idle >= limit) {
            Phase::Ended(Termination::Stalled)
        } else if self.population.n_finite() == 0 {
            // Without an elite everything may be lost; the best point seen is kept elsewhere.
            Phase::Ended(Termination::Collapsed)
        } else {
            Phase::Breeding
        };
    }

    fn start_known(&mut self) {
        self.population.rank();
        self.f_0 = self.population.typical_cost();
        self.idle_since = self.rounds.best().map_or(f64::INFINITY, |(_, f)| f);
        self.phase = if self.population.n_finite() == 0 {
            Phase::NoStart
        } else if self.setup.space.n_free() == 0 {
            Phase::Ended(Termination::AllFixed)
        } else {
            Phase::Breeding
        };
    }
}

impl Method for GeneticState {
    fn name(&self) -> &'static str {
        "ga"
    }

    fn ask(&mut self, batch: &mut Batch) {
        if self.phase == Phase::Breeding {
            self.breed();
            self.phase = Phase::Trying;
        }
        let n = self.setup.space.n();
        match self.phase {
            Phase::Starting => self.rounds.ask(batch, n, &self.population, |_| f64::INFINITY),
            Phase::Trying => self.rounds.ask(batch, n, &self.children, |_| f64::INFINITY),
            Phase::Breeding | Phase::NoStart | Phase::Ended(_) => self.rounds.ask_nothing(batch, n),
        }
    }

    fn tell(&mut self, outcomes: &[Outcome]) -> Result<(), Error> {
        if self.phase == Phase::Starting {
            if self.rounds.tell(outcomes, &mut self.population)? {
                self.start_known();
            }
        } else if self.rounds.tell(outcomes, &mut self.children)? {
            self.end_generation();
        }
        Ok(())
    }

    fn used(&self) -> &[bool] {
        self.rounds.used()
    }

    fn status(&self) -> Status {
        match &self.phase {
            Phase::NoStart => Status::NoStart,
            Phase::Ended(termination) => Status::Ended(termination.clone()),
            Phase::Starting | Phase::Breeding | Phase::Trying => Status::Running,
        }
    }

    fn n_iterations(&self) -> usize {
        self.n_iterations
    }

    fn operation(&self) -> Option<Operation> {
        match (&self.phase, self.n_iterations) {
            (Phase::Starting | Phase::NoStart, _) => None,
            (_, 0) => Some(Operation::Initial),
            _ => Some(Operation::Generation),
        }
    }

    fn plan(&self) -> &'static str {
        "generation"
    }

    fn tests(&self) -> Option<Tests> {
        self.tests
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        self.rounds.best()
    }

    fn population(&self) -> Option<SimplexView<'_>> {
        Some(self.population.view())
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }

    fn seed(&self) -> Option<u64> {
        Some(self.seed)
    }
}
