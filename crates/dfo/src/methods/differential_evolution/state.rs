//! Breeding and selection of differential evolution: trial vectors against their targets.

use super::adaptation::Adaptation;
use super::operators::{cross, different, donor, repair};
use super::options::{Crossover, DifferentialEvolution, Scheme, Weight, planned};
use crate::choices::Kind;
use crate::error::Error;
use crate::method::Setup;
use crate::methods::shared::cost::Cost;
use crate::methods::shared::generations::{GenerationRules, Generations, Populations};
use crate::rng::{Purpose, Stream};
use crate::space::Space;
use crate::termination::Termination;
use serde::{Deserialize, Serialize};

/// A running differential evolution; made by [`DifferentialEvolution`].
pub type DifferentialEvolutionState = Generations<DifferentialRules>;

/// State of differential evolution besides its population.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct DifferentialRules {
    options: DifferentialEvolution,
    /// `F` and `CR` of each trial.
    factors: Vec<(f64, f64)>,
    adaptation: Option<Adaptation>,
    trial: Vec<f64>,
    /// Members evaluated in complete generations.
    n_evaluated: usize,
}

impl DifferentialRules {
    pub(super) fn begin(
        options: &DifferentialEvolution,
        setup: Setup,
        members: usize,
        seed: u64,
    ) -> Result<DifferentialEvolutionState, Error> {
        let n = setup.space.n_free();
        let adaptation = match options.scheme {
            Scheme::Classic { .. } => None,
            Scheme::Adaptive(adaptive) => {
                let budget = options.budget.or(setup.max_evaluations).unwrap_or_else(|| planned(n));
                Some(Adaptation::new(adaptive, members, budget, n))
            }
        };
        let rules = Self {
            options: options.clone(),
            factors: vec![(0.0, 0.0); members],
            adaptation,
            trial: vec![0.0; n],
            n_evaluated: 0,
        };
        let (pool, _) =
            Populations::new(setup, seed, (members, members), options.sampling, options.include_start)?;
        Ok(Generations::new(rules, pool))
    }
}

impl DifferentialRules {
    /// True if it was made with these options.
    pub(super) fn is_of(&self, options: &DifferentialEvolution) -> bool {
        let adaptive = match options.scheme {
            Scheme::Adaptive(adaptive) => Some(adaptive),
            Scheme::Classic { .. } => None,
        };
        self.options == *options && self.adaptation.as_ref().map(|adaptation| adaptation.options) == adaptive
    }
}

impl GenerationRules for DifferentialRules {
    fn name(&self) -> &'static str {
        self.options.name()
    }

    /// Each trial is made from draws of its own.
    fn make_candidates(&mut self, generation: u64, pool: &mut Populations) {
        let Populations { setup, seed, population, candidates } = pool;
        let mut common = Stream::new(*seed, Purpose::Generation, generation, 0);
        if let Some(adaptation) = &mut self.adaptation {
            let members = adaptation.population_after(self.n_evaluated).min(population.len());
            population.keep_best(members);
            candidates.resize(members);
            self.factors.resize(members, (0.0, 0.0));
            adaptation.trim_archive(members, &mut common);
        }
        let weight = match self.options.scheme {
            Scheme::Classic { weight: Weight::Dither(low, high), .. } => common.between(low, high),
            Scheme::Classic { weight: Weight::Fixed(weight), .. } => weight,
            Scheme::Adaptive(_) => 0.0,
        };
        for i in 0..population.len() {
            let mut stream = Stream::new(*seed, Purpose::Individual, generation, i);
            let (target, trial) = (population.u(i), &mut self.trial[..]);
            match (self.options.scheme, &self.adaptation) {
                (Scheme::Classic { strategy, crossover, probability, .. }, _) => {
                    let mut r = [0; 5];
                    let r = &mut r[..strategy.n_drawn()];
                    different(&mut stream, population.len(), i, r);
                    donor(strategy, population, (i, population.best()), r, weight, trial);
                    cross(crossover, &mut stream, probability, target, trial);
                }
                (Scheme::Adaptive(_), Some(adaptation)) => {
                    let (f, cr) = adaptation.factors(&mut stream);
                    self.factors[i] = (f, cr);
                    adaptation.donor(&mut stream, population, i, f, trial);
                    cross(Crossover::Binomial, &mut stream, cr, target, trial);
                }
                (Scheme::Adaptive(_), None) => trial.copy_from_slice(target),
            }
            repair(self.options.repair, &mut stream, &setup.space, target, trial);
            candidates.place(i, trial, &setup.space);
        }
    }

    /// The cost of the target: what is above it is not selected.
    fn cutoff(&self, pool: &Populations, candidate: usize) -> f64 {
        pool.cost_as_cutoff(candidate)
    }

    fn select(&mut self, pool: &mut Populations) {
        let Populations { population, candidates, .. } = pool;
        for i in 0..population.len() {
            let (old, new) = (population.cost(i), candidates.cost(i));
            let Cost::Value(f) = new else { continue };
            if old.better_than(new) {
                continue;
            }
            if let (Some(adaptation), Cost::Value(before)) = (&mut self.adaptation, old)
                && f < before
            {
                adaptation.succeeded(self.factors[i], before - f, population.u(i));
            }
            population.copy_from(i, candidates, i);
        }
        if let Some(adaptation) = &mut self.adaptation {
            adaptation.learn();
        }
        self.n_evaluated += population.len();
    }

    fn started(&mut self, pool: &Populations) {
        self.n_evaluated = pool.population.len();
    }

    fn ended(&mut self, pool: &Populations, _: f64) -> Option<Termination> {
        pool.population.is_collapsed(&pool.setup.space).then_some(Termination::Collapsed)
    }

    /// Members that stand for one whole number differ in what they are made from, and so do their trials.
    fn tries_neighbours(&self, space: &Space) -> bool {
        space.n_free() > 0 && (0..space.n_free()).all(|k| space.kind(k) != Kind::Continuous)
    }

    fn is_sound(&self, pool: &Populations) -> bool {
        let (n, members) = (pool.setup.space.n_free(), pool.population.len());
        let adaptive = matches!(self.options.scheme, Scheme::Adaptive(_));
        let least = match self.options.scheme {
            Scheme::Classic { strategy, .. } => strategy.n_drawn() + 1,
            Scheme::Adaptive(_) => 4,
        };
        members >= if n == 0 { 1 } else { least }
            && (pool.candidates.len(), self.factors.len()) == (members, members)
            && self.trial.len() == n
            && adaptive == self.adaptation.is_some()
            && self.adaptation.as_ref().is_none_or(|a| a.is_sound(n, members))
    }
}
