//! The state machine: a population, its trials, and what a complete generation does to both.

use super::adaptation::Adaptation;
use super::operators::{cross, different, donor, repair};
use super::options::{DifferentialEvolution, Scheme, Weight};
use crate::cost::Cost;
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
    /// Trials of this generation are to be made.
    Breeding,
    /// They are being evaluated.
    Trying,
    NoStart,
    Ended(Termination),
}

/// A running differential evolution; made by [`DifferentialEvolution`].
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct DifferentialEvolutionState {
    options: DifferentialEvolution,
    setup: Setup,
    seed: u64,
    population: Population,
    trials: Population,
    /// `F` and `CR` of each trial.
    factors: Vec<(f64, f64)>,
    adaptation: Option<Adaptation>,
    trial: Vec<f64>,
    phase: Phase,
    rounds: Rounds,
    n_iterations: usize,
    /// Members evaluated in complete generations.
    n_evaluated: usize,
    tests: Option<Tests>,
    f_0: f64,
}

impl DifferentialEvolutionState {
    pub(super) fn new(
        options: &DifferentialEvolution,
        setup: Setup,
        members: usize,
        seed: u64,
    ) -> Result<Self, Error> {
        let space = &setup.space;
        let n = space.n_free();
        let mut population = Population::new(space, members);
        let mut points = Vec::new();
        options.sampling.fill(space, seed, members, &mut points)?;
        for slot in 0..members {
            population.place(slot, &points[slot * n..(slot + 1) * n], space);
        }
        population.seed_with(&setup, options.include_start || n == 0);
        let adaptation = match options.scheme {
            Scheme::Classic { .. } => None,
            Scheme::Adaptive(adaptive) => {
                // A limit that says "none" is nothing to plan with.
                let limit = setup.max_evaluations.filter(|m| *m < usize::MAX);
                let limit = limit.unwrap_or(2000usize.saturating_mul(n + 1));
                Some(Adaptation::new(adaptive, members, options.budget.unwrap_or(limit), n))
            }
        };
        Ok(Self {
            trials: Population::new(space, members),
            factors: vec![(0.0, 0.0); members],
            trial: vec![0.0; n],
            options: options.clone(),
            population,
            seed,
            adaptation,
            phase: Phase::Starting,
            rounds: Rounds::with_capacity(members),
            n_iterations: 0,
            n_evaluated: 0,
            tests: None,
            f_0: 0.0,
            setup,
        })
    }

    /// Whether this state fits to a problem and to itself.
    pub(super) fn is_sound(&self, setup: &Setup) -> bool {
        let (space, members) = (&setup.space, self.population.len());
        let adaptive = matches!(self.options.scheme, Scheme::Adaptive(_));
        self.setup.space == *space
            && members >= if space.n_free() == 0 { 1 } else { 4 }
            && self.population.is_sound(space)
            && self.trials.is_sound(space)
            && (self.trials.len(), self.factors.len()) == (members, members)
            && self.trial.len() == space.n_free()
            && self.rounds.is_sound(space.n())
            && adaptive == self.adaptation.is_some()
            && self.adaptation.as_ref().is_none_or(|a| a.is_sound(space.n_free()))
    }

    /// Makes the trials of a generation, each from draws of its own.
    fn breed(&mut self) {
        let generation = self.n_iterations as u64 + 1;
        let mut common = Stream::new(self.seed, Purpose::Generation, generation, 0);
        if let Some(adaptation) = &mut self.adaptation {
            let members = adaptation.population_after(self.n_evaluated).min(self.population.len());
            self.population.keep_best(members);
            self.trials.resize(members);
            self.factors.resize(members, (0.0, 0.0));
            adaptation.trim_archive(members, &mut common);
        }
        let weight = match self.options.scheme {
            Scheme::Classic { weight: Weight::Dither(low, high), .. } => common.between(low, high),
            Scheme::Classic { weight: Weight::Fixed(weight), .. } => weight,
            Scheme::Adaptive(_) => 0.0,
        };
        let space = &self.setup.space;
        for i in 0..self.population.len() {
            let mut stream = Stream::new(self.seed, Purpose::Individual, generation, i);
            let target = self.population.u(i);
            match (self.options.scheme, &self.adaptation) {
                (Scheme::Classic { strategy, crossover, probability, .. }, _) => {
                    let mut r = [0; 5];
                    let r = &mut r[..strategy.n_drawn()];
                    different(&mut stream, self.population.len(), i, r);
                    donor(
                        strategy,
                        &self.population,
                        (i, self.population.best()),
                        r,
                        weight,
                        &mut self.trial,
                    );
                    cross(crossover, &mut stream, probability, target, &mut self.trial);
                }
                (Scheme::Adaptive(_), Some(adaptation)) => {
                    let (f, cr) = adaptation.factors(&mut stream);
                    self.factors[i] = (f, cr);
                    adaptation.donor(&mut stream, &self.population, i, f, &mut self.trial);
                    let binomial = super::options::Crossover::Binomial;
                    cross(binomial, &mut stream, cr, target, &mut self.trial);
                }
                (Scheme::Adaptive(_), None) => self.trial.copy_from_slice(target),
            }
            repair(self.options.repair, &mut stream, space, target, &mut self.trial);
            self.trials.place(i, &self.trial, space);
        }
    }

    fn select(&mut self) {
        for i in 0..self.population.len() {
            let (old, new) = (self.population.cost(i), self.trials.cost(i));
            let Cost::Value(f) = new else { continue };
            if old.better_than(new) {
                continue;
            }
            if let (Some(adaptation), Cost::Value(before)) = (&mut self.adaptation, old)
                && f < before
            {
                adaptation.succeeded(self.factors[i], before - f, self.population.u(i));
            }
            self.population.copy_from(i, &self.trials, i);
        }
        if let Some(adaptation) = &mut self.adaptation {
            adaptation.learn();
        }
        self.n_evaluated += self.population.len();
    }

    fn end_generation(&mut self) {
        self.select();
        self.population.rank();
        self.n_iterations += 1;
        let tests = self.population.judge(&self.setup.space, &self.setup.tolerances, self.f_0);
        self.tests = Some(tests);
        self.phase = if tests.passed {
            Phase::Ended(Termination::Converged)
        } else if self.population.is_collapsed(&self.setup.space) {
            Phase::Ended(Termination::Collapsed)
        } else {
            Phase::Breeding
        };
    }

    fn start_known(&mut self) {
        self.population.rank();
        self.n_evaluated = self.population.len();
        self.f_0 = self.population.typical_cost();
        self.phase = if self.population.n_finite() == 0 {
            Phase::NoStart
        } else if self.setup.space.n_free() == 0 {
            Phase::Ended(Termination::AllFixed)
        } else {
            Phase::Breeding
        };
    }
}

impl Method for DifferentialEvolutionState {
    fn name(&self) -> &'static str {
        self.options.name()
    }

    fn ask(&mut self, batch: &mut Batch) {
        if self.phase == Phase::Breeding {
            self.breed();
            self.phase = Phase::Trying;
        }
        let n = self.setup.space.n();
        match self.phase {
            Phase::Starting => self.rounds.ask(batch, n, &self.population, |_| f64::INFINITY),
            Phase::Trying => {
                let targets = &self.population;
                self.rounds.ask(batch, n, &self.trials, |i| targets.cost(i).value().unwrap_or(f64::INFINITY));
            }
            Phase::Breeding | Phase::NoStart | Phase::Ended(_) => self.rounds.ask_nothing(batch, n),
        }
    }

    fn tell(&mut self, outcomes: &[Outcome]) -> Result<(), Error> {
        if self.phase == Phase::Starting {
            if self.rounds.tell(outcomes, &mut self.population)? {
                self.start_known();
            }
        } else if self.rounds.tell(outcomes, &mut self.trials)? {
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
