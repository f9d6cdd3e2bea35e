//! NSGA-II: several criteria at once (Deb, Pratap, Agarwal and Meyarivan, IEEE Trans. Evol. Comput. 6, 2002).
//!
//! The criteria are the residuals of an evaluation. A point dominates another point if none of its criteria
//! is larger and at least one is smaller. A generation selects pairs of parents by tournaments of two
//! members, creates two children of each pair, and evaluates them as one batch. The best members of both
//! generations survive: fronts of points that do not dominate each other rank in their order, and points of
//! one front by their crowding distance. The extreme points of the first front therefore always survive.
//!
//! **Children** result from simulated binary crossover (Deb and Agrawal, Complex Syst. 9, 1995) and
//! polynomial mutation (Deb and Goyal, Comput. Sci. Inform. 26, 1996), both with distributions that end at
//! the bounds. A pair with a child that repeats a member or an earlier child is created again. Values of
//! categorical parameters are exchanged and drawn again, because they have no order.
//!
//! **Constraints.** A child that violates linear constraints moves to the nearest feasible point. With
//! nonlinear constraints, feasible points rank before infeasible ones, and these by their violation
//! (constrained domination of the paper, after Deb 2000). Failed points rank behind all others.
//!
//! **End.** There is no test of convergence, so a limit ends the run. The front is the first front of the
//! final population. Its size is at most the size of the population. If a limit ends the run within a
//! generation, the evaluated children compete, too.
//!
//! **Cutoffs**: none, because every criterion counts.

mod operators;
mod options;
mod ranking;
mod state;

pub use options::Nsga2;
pub use state::Nsga2State;

use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, Setup, restored};
use crate::method_interface::rng::draw_seed;
use crate::problem::option_texts;

/// Default limit of evaluations: the limit of the experiments of the paper, which have 1 to 30 parameters.
const DEFAULT_EVALUATIONS: usize = 25_000;

impl MethodOptions for Nsga2 {
    type Method = Nsga2State;

    fn begin(&self, setup: &Setup) -> Result<Nsga2State, Error> {
        self.check()?;
        setup.space.require_box(Self::NAME)?;
        Nsga2State::new(self, setup.clone(), setup.seed.unwrap_or_else(draw_seed))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<Nsga2State, Error> {
        let restored: Nsga2State = restored(state, |state: &Nsga2State| state.is_sound(setup))?;
        match restored.is_of(self) {
            true => Ok(restored),
            false => Err(Error::State { message: "it was created with other options".to_owned() }),
        }
    }

    fn needs_start(&self) -> bool {
        false
    }

    fn needs_residuals(&self) -> bool {
        true
    }

    fn supports_linear(&self) -> bool {
        true
    }

    fn supports_nonlinear(&self) -> bool {
        true
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    fn default_limits(&self, _: usize) -> (Option<usize>, Option<usize>) {
        (Some(DEFAULT_EVALUATIONS), None)
    }
}
