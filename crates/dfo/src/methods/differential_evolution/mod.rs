//! Differential evolution: the method of Storn and Price (J. Global Optim. 11, 1997) with its usual variants,
//! and L-SHADE (Tanabe and Fukunaga, CEC 2014). L-SHADE adapts its factors and shrinks its population.
//!
//! **Lag.** A generation is one batch, and selection processes its answers in order. With a lag `L`, the next
//! trial is created after each answer. Trial `k` uses the population after selection from all trials before
//! `k - L`. Therefore it can be evaluated while earlier trials are still running, and a long evaluation does
//! not block the others. The rule counts answers, so the number of workers does not change the result.
//! L-SHADE uses the adaptation from a generation only after the end of that generation. Trials of the first
//! generation are created after half of the first population is known. With lag 0, a generation is created
//! when the previous one is completely known, as in the papers. This needs fewer evaluations and is best for
//! one worker.
//!
//! **Selection.** A trial replaces its target if its cost is not above the target's cost. Failed and stopped
//! trials never replace a target. If another trial has replaced the target in the meantime, a trial may beat
//! only the original target. Such a trial replaces the worst member if it is better than that member. An
//! evaluation may stop above the target's cost (the cutoff). A failed target sets no cutoff.
//!
//! **Constraints.** A trial that violates linear constraints moves to the nearest feasible point. With
//! nonlinear constraints, members rank by the rules of Deb (2000): feasible before infeasible, feasible ones
//! by cost, infeasible ones by violation. L-SHADE then also learns from decreases of the violation.
//!
//! **L-SHADE.** Trials are `x_i + F (x_pbest - x_i) + F (x_r1 - x_r2)` with `x_pbest` among the best `p N`,
//! and `x_r2` from the population and the archive. `F` and `CR` are drawn around memories of successful
//! values, weighted by the decrease of the cost. A success over a failed target has no known decrease, so it
//! is not stored in the memories. Failed targets are not stored in the archive. The population shrinks
//! linearly with the number of evaluations, so the result depends on the budget. The budget is the limit of
//! the run, or [`DifferentialEvolution::budget`]. When the population shrinks, members beyond the last
//! remaining slot move to the slots of removed members. A pending trial then competes with the current member
//! of its slot.

mod adaptation;
mod initial;
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
use options::planned;
use state::DifferentialRules;

impl MethodOptions for DifferentialEvolution {
    type Method = DifferentialEvolutionState;

    fn begin(&self, setup: &Setup) -> Result<DifferentialEvolutionState, Error> {
        setup.tolerances.check()?;
        self.check()?;
        let (space, name) = (&setup.space, self.name());
        space.require_box(name)?;
        space.forbid_categorical(name)?;
        let n = space.n_free();
        let least = match self.scheme {
            Scheme::Adaptive(a) => a.final_population,
            Scheme::Classic { strategy, .. } => strategy.n_drawn() + 1,
        };
        let budget = self.budget.or(setup.max_evaluations).unwrap_or_else(|| planned(n));
        let members = self.population_of(n, budget);
        if !(least..=MAX_MEMBERS).contains(&members) {
            let range = "large enough for the strategy (rand/1: 4, rand/2: 6, L-SHADE: its final \
                         population), and at most a million";
            return Err(Error::Option { name: "population", value: members as f64, range });
        }
        initial::check(space, self)?;
        let members = if n == 0 { 1 } else { members };
        DifferentialRules::begin(self, setup.clone(), members, budget, setup.seed.unwrap_or_else(draw_seed))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<DifferentialEvolutionState, Error> {
        let restored: DifferentialEvolutionState = Generations::restore(setup, state)?;
        match restored.rules().is_of(self) {
            true => Ok(restored),
            false => Err(Error::State { message: "it was created with other options".to_owned() }),
        }
    }

    fn needs_start(&self) -> bool {
        false
    }

    fn supports_linear(&self) -> bool {
        true
    }

    fn supports_nonlinear(&self) -> bool {
        true
    }

    /// Returns false: ranking by violation first practically never satisfies an equality.
    fn supports_equalities(&self) -> bool {
        false
    }

    fn describe(&self) -> Vec<(String, String)> {
        initial::describe(self)
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
