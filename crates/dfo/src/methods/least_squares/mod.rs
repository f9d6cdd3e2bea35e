//! Gauss-Newton in a trust region on linear interpolation models of the residuals (Zhang, Conn and Scheinberg
//! 2010; Cartis, Fiala, Marteau and Roberts, ACM TOMS 45, 2019).
//!
//! The models interpolate every residual at n + 1 points, each evaluated once. The next trial point minimises
//! the sum of squares of the models within a radius. The radius grows and shrinks with the success of the
//! predictions (`trust_region.rs`). A new point changes the model by a matrix of rank one, which costs O(mn +
//! n^2) (`interpolation.rs`, `triangle.rs`).
//!
//! With rounds of several points, the others are trial points at other radii and neighbours of the first one
//! (`rounds.rs`). The Jacobian at the first trial point is then known in the same round. If a point next to
//! the best one shows noise, the models become regressions on all nearby points (`averaging.rs`). Then each
//! round contains one point. Steps stay on one side of a plane that separates failed points from the others.
//! If this makes no progress, Nelder-Mead continues from a good point away from the failed points.
//!
//! All points satisfy the linear inequalities. Steps, distances of the minimum and the directions of geometry
//! points respect them like bounds (`Room` in `subproblem.rs`).

mod averaging;
mod interpolation;
mod jacobian;
mod model;
mod options;
mod points;
mod rounds;
mod simplex_search;
mod state;
mod subproblem;
mod triangle;
mod trust_region;

pub use options::{LeastSquares, StepPlan};
pub use state::LeastSquaresState;

use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, Setup, restored};
use crate::problem::memory;
use crate::problem::option_texts;

impl MethodOptions for LeastSquares {
    type Method = LeastSquaresState;

    fn begin(&self, setup: &Setup) -> Result<LeastSquaresState, Error> {
        setup.tolerances.check()?;
        self.check()?;
        setup.space.require_continuous("least-squares")?;
        let (n, n_user) = (setup.space.n_free(), setup.space.n());
        memory::check("a model for this many parameters", &[n + 1, 4 * n + 2 * n_user])?;
        let batch = self.batch.decided(n, setup.workers);
        Ok(LeastSquaresState::new(&near(setup), &Self { batch, ..self.clone() }))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<LeastSquaresState, Error> {
        let setup = near(setup);
        restored(state, |s: &LeastSquaresState| s.is_sound(&setup))
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    fn supports_linear(&self) -> bool {
        true
    }

    fn needs_residuals(&self) -> bool {
        true
    }

    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        (Some(1000usize.saturating_mul(n + 1)), None)
    }
}

/// Returns the setup without bounds that mean "unbounded".
fn near(setup: &Setup) -> Setup {
    Setup { space: setup.space.without_far_bounds(), ..setup.clone() }
}
