//! Creation and selection of children in the genetic algorithm: pairs of bit strings, and a surviving elite.

use super::coding::Coding;
use super::operators::{cross, fitness_sums, mutate, spin, tournament};
use super::options::{Genetic, Selection};
use crate::error::Error;
use crate::method_interface::interface::Setup;
use crate::method_interface::rng::{Purpose, Stream};
use crate::method_interface::tolerances::{TestedSet, ToleranceTests};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::generations::{GenerationRules, Generations, Populations};
use crate::methods::shared::ranked_points::RankedPoints;
use crate::outcome::termination::Termination;
use crate::values::choices::ParameterKind;
use serde::{Deserialize, Serialize};

/// Returns the number of best points that the tests compare. This is an eighth of the population, limited to
/// the range from n + 1 to 100.
fn n_seen(members: usize, n: usize) -> usize {
    members.div_ceil(8).max(n + 1).min(100)
}

/// Returns the mutation rate for strings of this length.
fn mutation_rate(options: &Genetic, length: usize) -> f64 {
    options.mutation_rate.unwrap_or((1.0 / length.max(1) as f64).min(0.1))
}

/// A running genetic algorithm, created by [`Genetic`].
pub type GeneticState = Generations<GeneticRules>;

/// State of the genetic algorithm except its population. The elite is not part of the candidates.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GeneticRules {
    options: Genetic,
    coding: Coding,
    mutation_rate: f64,
    /// Concatenated strings of all members.
    bits: Vec<bool>,
    child_bits: Vec<bool>,
    /// Unused second child of the last pair, if the number of children is odd.
    spare: Vec<bool>,
    sums: Vec<f64>,
    decoded: Vec<f64>,
    /// Best distinct points of all generations; [`n_seen`] returns their number.
    best_seen: RankedPoints,
    /// Number of generations since the best point changed, and its cost at that time.
    idle: usize,
    idle_since: f64,
    /// Violation of the best point at that time; 0 if it satisfies the constraints.
    #[serde(default, skip_serializing_if = "is_zero")]
    idle_violation: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl GeneticRules {
    /// True if these rules were created with `options`.
    pub(super) fn is_of(&self, options: &Genetic) -> bool {
        self.options == *options && self.mutation_rate == mutation_rate(options, self.coding.length())
    }

    pub(super) fn begin(
        options: &Genetic,
        setup: Setup,
        coding: Coding,
        members: usize,
        seed: u64,
    ) -> Result<GeneticState, Error> {
        let (n, length) = (setup.space.n_free(), coding.length());
        let n_children = if n == 0 { 0 } else { members - options.elite };
        let (mut pool, n_exact) =
            Populations::new(setup, seed, members, n_children, options.sampling, options.include_start)?;
        let (mut bits, mut decoded) = (vec![false; members * length], vec![0.0; n]);
        let Populations { setup, population, .. } = &mut pool;
        for slot in 0..members {
            let string = &mut bits[slot * length..(slot + 1) * length];
            coding.encode(&setup.space, population.u(slot), population.x(slot), string);
            // A sampled point moves to the point encoded by its string. A given point is evaluated unchanged.
            if slot >= n_exact {
                coding.decode(&setup.space, string, &mut decoded);
                setup.space.restore(&mut decoded);
                population.place(slot, &decoded, &setup.space);
            }
        }
        let best_seen = RankedPoints::new(&setup.space, n_seen(members, n));
        let rules = Self {
            best_seen,
            mutation_rate: mutation_rate(options, length),
            options: options.clone(),
            coding,
            bits,
            child_bits: vec![false; n_children * length],
            spare: vec![false; length],
            sums: Vec::with_capacity(members),
            decoded,
            idle: 0,
            idle_since: f64::INFINITY,
            idle_violation: 0.0,
        };
        Ok(Generations::new(rules, pool))
    }

    fn set_idle_since(&mut self, best: Cost) {
        (self.idle_since, self.idle_violation) = match best {
            Cost::Infeasible(violation) => (f64::INFINITY, violation),
            best => (best.value().unwrap_or(f64::INFINITY), 0.0),
        };
    }
}

impl GenerationRules for GeneticRules {
    fn name(&self) -> &'static str {
        "ga"
    }

    /// Creates the children. Each pair uses a separate random stream.
    fn make_candidates(&mut self, generation: u64, pool: &mut Populations) {
        let Populations { setup, seed, population, candidates } = pool;
        let length = self.coding.length();
        fitness_sums(population, &mut self.sums);
        for (pair, strings) in self.child_bits.chunks_mut((2 * length).max(1)).enumerate() {
            let mut stream = Stream::new(*seed, Purpose::Individual, generation, pair);
            let mut parent = || match self.options.selection {
                Selection::FitnessProportional => spin(&mut stream, &self.sums),
                Selection::Tournament(size) => tournament(&mut stream, population, size),
            };
            let parents = [parent(), parent()];
            let string_of = |slot: usize| &self.bits[slot * length..(slot + 1) * length];
            let (first, second) = strings.split_at_mut(length);
            let second = if second.is_empty() { &mut self.spare[..] } else { second };
            first.copy_from_slice(string_of(parents[0]));
            second.copy_from_slice(string_of(parents[1]));
            if stream.chance(self.options.crossover_rate) {
                cross(&mut stream, first, second);
            }
            mutate(&mut stream, self.mutation_rate, first);
            mutate(&mut stream, self.mutation_rate, second);
        }
        for slot in 0..candidates.len() {
            let string = &self.child_bits[slot * length..(slot + 1) * length];
            self.coding.decode(&setup.space, string, &mut self.decoded);
            // The nearest feasible point, so that a string always means the same point.
            setup.space.restore(&mut self.decoded);
            candidates.place(slot, &self.decoded, &setup.space);
        }
    }

    /// Returns infinity, because selection by fitness needs every cost.
    fn cutoff(&self, _: &Populations, _: usize) -> f64 {
        f64::INFINITY
    }

    /// Replaces all members except the elite by the children.
    fn select(&mut self, pool: &mut Populations) {
        let Populations { population, candidates, .. } = pool;
        for child in 0..candidates.len() {
            self.best_seen.take_better(candidates, child);
        }
        let length = self.coding.length();
        let replaced = population.len() - candidates.len();
        let slots: &[usize] = &population.order()[replaced..];
        self.sums.clear();
        // The ranks change below, so store the slots first (in a buffer that is currently unused).
        self.sums.extend(slots.iter().map(|s| *s as f64));
        for (child, slot) in self.sums.iter().map(|s| *s as usize).enumerate() {
            population.copy_from(slot, candidates, child);
            let string = &self.child_bits[child * length..(child + 1) * length];
            self.bits[slot * length..(slot + 1) * length].copy_from_slice(string);
        }
    }

    fn started(&mut self, pool: &mut Populations) {
        let population = &pool.population;
        for member in 0..population.len() {
            self.best_seen.take_better(population, member);
        }
        self.set_idle_since(population.cost(population.best()));
    }

    fn ended(&mut self, pool: &Populations, best: Cost) -> Option<Termination> {
        let before = match self.idle_violation {
            violation if violation > 0.0 => Cost::Infeasible(violation),
            _ => Cost::Value(self.idle_since),
        };
        self.idle = if best.better_than(before) { 0 } else { self.idle + 1 };
        self.set_idle_since(best);
        if self.options.stall.is_some_and(|limit| self.idle >= limit) {
            return Some(Termination::Stalled);
        }
        // Without an elite, all costs may be lost. The best point seen is stored separately.
        (pool.population.n_finite() == 0).then_some(Termination::AllFailed)
    }

    /// Returns the best eighth, because mutation always keeps some members away from the best.
    fn extent(&self) -> TestedSet {
        TestedSet::BestEighth
    }

    /// Tests the best points seen. The population itself is a poor measure of convergence. Copies of one
    /// point fill it long before the minimum is found. Later, most children differ from their parents in a
    /// significant bit. Discrete parameters may have too few distinct points to compare.
    fn judge_others(&self, Populations { setup, .. }: &Populations, f_0: f64) -> Option<ToleranceTests> {
        let space = &setup.space;
        let continuous = (0..space.n_free()).all(|k| space.kind(k) == ParameterKind::Continuous);
        continuous.then(|| self.best_seen.judge(TestedSet::BestSeen, space, &setup.tolerances, f_0))
    }

    fn is_sound(&self, pool: &Populations) -> bool {
        let (space, length) = (&pool.setup.space, self.coding.length());
        let (members, children) = (pool.population.len(), pool.candidates.len());
        Coding::new(space, &self.options.resolution, self.options.gray).as_ref() == Ok(&self.coding)
            && members >= 1
            && self.best_seen.is_sound(space)
            && self.best_seen.len() == n_seen(members, space.n_free())
            && (members.checked_sub(children) == Some(self.options.elite) || space.n_free() == 0)
            && (self.bits.len(), self.child_bits.len()) == (members * length, children * length)
            && self.spare.len() == length
            && self.decoded.len() == space.n_free()
    }
}
