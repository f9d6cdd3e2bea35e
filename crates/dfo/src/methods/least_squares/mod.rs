//! Gauss-Newton in a trust region on linear interpolation models of the residuals (Zhang, Conn and Scheinberg
//! 2010; Cartis, Fiala, Marteau and Roberts, ACM TOMS 45, 2019): n + 1 points, each evaluated once, make a
//! model of every residual; its sum of squares is smallest at the next trial point, within a radius that
//! grows and shrinks with the success of the predictions (`trust_region.rs`). The new point changes the model
//! by a matrix of rank one, which costs O(mn + n^2) (`interpolation.rs`, `triangle.rs`). With rounds of
//! several points the others are trial points at other radii, and neighbours of the first one, so that its
//! Jacobian is known in the same round. Where a point next to the best one shows noise, the models are
//! regressions on all points around, one new point at a time (`averaging.rs`). Steps keep to the side of a
//! plane between points that failed and the others; where that leads nowhere, Nelder-Mead takes over from a
//! good point that lies away from them.

mod averaging;
mod interpolation;
mod jacobian;
mod model;
mod options;
mod points;
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
        memory::check("a model of so many parameters", &[n + 1, 4 * n + 2 * n_user])?;
        Ok(LeastSquaresState::new(&near(setup), self))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<LeastSquaresState, Error> {
        let setup = near(setup);
        restored(state, |s: &LeastSquaresState| s.is_sound(&setup))
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    fn needs_residuals(&self) -> bool {
        true
    }

    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        (Some(1000usize.saturating_mul(n + 1)), None)
    }
}

/// The same problem without bounds that stand for none.
fn near(setup: &Setup) -> Setup {
    Setup { space: setup.space.without_far_bounds(), ..setup.clone() }
}
