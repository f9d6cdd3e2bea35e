//! Differential evolution: the form of Storn and Price (J. Global Optim. 11, 1997) with its usual variants,
//! and L-SHADE (Tanabe and Fukunaga, CEC 2014), which sets its own factors and shrinks its population.
//!
//! **Lag.** A generation is one batch, whose answers are selected from in order. With a lag `L` the next
//! trial is made after each: trial `k` from the population after selection from all trials before `k - L`. So
//! it is certain, and can be evaluated, while trials before it are still under way, and a long evaluation
//! does not hold up the others. The rule counts answers, not workers: their number changes nothing. What
//! L-SHADE learns from a generation is used from its end on. Trials of the first generation are made from the
//! first population after half of it is known. With lag 0 a generation is made when the one before it is
//! known whole, as in the papers: that takes fewer evaluations, and is best for one worker.
//!
//! **Selection.** A trial takes the place of its target when its cost is not above the target's; a failed or
//! given-up trial never does. Where another trial has replaced the target since, one that beats the target
//! alone takes the place of the worst member if it is better. An evaluation may stop above the target's cost
//! (the cutoff); a failed target sets none.
//!
//! **L-SHADE.** Trials are `x_i + F (x_pbest - x_i) + F (x_r1 - x_r2)` with `x_pbest` among the best `p N`,
//! and `x_r2` from population and archive. `F` and `CR` are drawn around memories of what succeeded, weighted
//! by how much the cost fell; a success over a failed target says nothing about how much, so it enters no
//! memory, and a failed target enters no archive. The population shrinks linearly with the evaluations made,
//! so the budget matters: that of the run, or [`DifferentialEvolution::budget`]. Members beyond the last slot
//! that is left move to the slots of those that go; a trial competes with whoever stands in its slot then.

mod adaptation;
mod operators;
mod options;
mod state;

pub use options::{Adaptive, Crossover, DifferentialEvolution, DifferentialWeight, Repair, Scheme, Strategy};
pub use state::DifferentialEvolutionState;

use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, Setup};
use crate::method_interface::rng::draw_seed;
use crate::methods::shared::generations::Generations;
use crate::methods::shared::population::MAX_MEMBERS;
use crate::problem::option_texts;
use crate::values::choices::ParameterKind;
use options::planned;
use state::DifferentialRules;

impl MethodOptions for DifferentialEvolution {
    type Method = DifferentialEvolutionState;

    fn begin(&self, setup: &Setup) -> Result<DifferentialEvolutionState, Error> {
        setup.tolerances.check()?;
        self.check()?;
        let (space, name) = (&setup.space, self.name());
        space.require_box(name)?;
        if let Some(k) = (0..space.n_free()).find(|&k| space.kind(k) == ParameterKind::Categorical) {
            return Err(Error::NotContinuous {
                method: name,
                index: space.free()[k],
                kind: ParameterKind::Categorical,
            });
        }
        let n = space.n_free();
        let least = match self.scheme {
            Scheme::Adaptive(a) => a.final_population,
            Scheme::Classic { strategy, .. } => strategy.n_drawn() + 1,
        };
        let budget = self.budget.or(setup.max_evaluations).unwrap_or_else(|| planned(n));
        let members = self.population_of(n, budget);
        if !(least..=MAX_MEMBERS).contains(&members) {
            let range = "large enough for the strategy (rand/1: 4, rand/2: 6, L-SHADE: its final population), at most \
                         a million";
            return Err(Error::Option { name: "population", value: members as f64, range });
        }
        let members = if n == 0 { 1 } else { members };
        DifferentialRules::begin(self, setup.clone(), members, budget, setup.seed.unwrap_or_else(draw_seed))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<DifferentialEvolutionState, Error> {
        let restored: DifferentialEvolutionState = Generations::restore(setup, state)?;
        match restored.rules().is_of(self) {
            true => Ok(restored),
            false => Err(Error::State { message: "it was made with other options".to_owned() }),
        }
    }

    fn needs_start(&self) -> bool {
        false
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    fn plans_with_budget(&self) -> bool {
        matches!(self.scheme, Scheme::Adaptive(_)) && self.budget.is_none()
    }

    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        let evaluations = match self.scheme {
            Scheme::Adaptive(_) => planned(n),
            Scheme::Classic { .. } => 5000usize.saturating_mul(n + 1),
        };
        (Some(evaluations), None)
    }
}
