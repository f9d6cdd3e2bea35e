//! A trust region on quadratic interpolation models of the cost, with bounds: the class of BOBYQA (Powell,
//! report DAMTP 2009/NA06) and COBYQA (Ragonneau, thesis, Hong Kong 2022).
//!
//! 2n + 1 points, asked for as one batch, begin a model: of all quadratics through the points the one that
//! changes least from the model before (`model.rs`). Its smallest value within a radius and the bounds gives
//! the next trial point (`subproblem.rs`); the radius follows the success of the prediction. Points stay in
//! the model as long as they lie near, up to 4n + 1 or as many as a quadratic has coefficients: what was paid
//! for is used, and fits take half of the evaluations that they take with 2n + 1 points. Then a new point
//! replaces one which the others do without best. Where the points that are left determine a direction of the
//! gradient badly, one is placed along it. When the model is exhausted at a radius, the smallest radius, the
//! resolution, is reduced (Powell's rules, NA06, sections 2 and 6; Conn, Scheinberg and Vicente, Introduction
//! to Derivative-Free Optimization, 2009, chapters 5, 6 and 10).
//!
//! **Tests.** The x test measures the resolution, the f test the decrease that the model predicts. They are
//! applied when a resolution is exhausted, and count only if the model predicted the last two costs to within
//! the limit of the f test.
//!
//! **Restarts.** Where steps fail at several resolutions although the model promises a decrease, there is
//! noise or a kink: new points are placed around the best one, as far away as the first (restarts: Cartis,
//! Fiala, Marteau and Roberts, ACM TOMS 45, 2019).
//!
//! **Noise and kinks.** Where the cost is smooth the curvature of the model settles as the resolution
//! shrinks; where it grows all the same there is a kink or noise, and passed tests mean nothing: the search
//! starts anew, too, from farther off, and has converged only where several starts in a row end without such
//! evidence. Or it hands over to a simplex search (`hand_over.rs`, `nelder_mead/simplex_search.rs`), which
//! goes on from the best point as Nelder-Mead does from a start.
//!
//! **Unknown sizes.** A parameter that starts at zero, without a nominal size and without a box, is moved
//! alone first (`shared/size_search.rs`).
//!
//! **Failures.** A failed point enters no model. The step is shortened, and later steps keep to the side of a
//! plane between failed points and those of the model (`shared/failures.rs`). Of the first points a failed
//! one is tried nearer to the start and on its other side. A search that ends beside points that failed goes
//! on with CMA-ES, which looks for a lower cost between them (`failure_check.rs`).
//!
//! **Cutoffs**: none, since a model needs the value of every point. **Time**: O((4n)^3) operations per point
//! up to 20 parameters: 11 microseconds for 2, 0.2 ms for 10, 0.6 ms for 20. For more parameters the inverse
//! of the interpolation conditions is updated as points are exchanged, the steps are those of truncated
//! conjugate gradients, and the model keeps 2n + 1 points (`many_parameters.rs`, `inverse.rs`,
//! `truncated_cg.rs`), as in NEWUOA: O(n^2) operations per point (`benches/overhead.rs`).

mod hand_over;
mod initial;
mod inverse;
mod iteration;
mod many_parameters;
mod model;
mod options;
mod state;
mod subproblem;
mod truncated_cg;

pub use options::QuadraticModel;

use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, Setup};
use crate::methods::shared::with_sizes::{NeedsSizes, WithSizes};
use crate::problem::memory;
use crate::problem::option_texts;
use state::ModelSearch;

/// A running search on quadratic models; made by [`QuadraticModel`].
pub type QuadraticModelState = WithSizes<QuadraticModel>;

/// The problem as the search sees it: without bounds that stand for "none".
fn prepared(setup: &Setup) -> Setup {
    Setup { space: setup.space.without_far_bounds(), ..setup.clone() }
}

impl NeedsSizes for QuadraticModel {
    const NAME: &'static str = "quadratic-model";
    type Search = ModelSearch;

    fn search(&self, setup: Setup) -> Result<ModelSearch, Error> {
        let points = self.resolve(setup.space.n_free())?;
        Ok(ModelSearch::new(setup, self, points))
    }

    fn is_sound(search: &ModelSearch, setup: &Setup) -> bool {
        search.is_sound(setup)
    }
}

impl MethodOptions for QuadraticModel {
    type Method = QuadraticModelState;

    fn begin(&self, setup: &Setup) -> Result<QuadraticModelState, Error> {
        setup.tolerances.check()?;
        setup.space.require_continuous("quadratic-model")?;
        let (n, n_user) = (setup.space.n_free(), setup.space.n());
        let points = self.resolve(n)?;
        memory::check("a quadratic model of so many parameters", &[points, 7 * points + 2 * n_user])?;
        WithSizes::begin(self, prepared(setup))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<QuadraticModelState, Error> {
        WithSizes::restore(self, prepared(setup), state)
    }

    fn describe(&self) -> Vec<(String, String)> {
        // Runs of before this option are continued without it.
        let named = |(name, _): &(String, String)| self.hand_over || name != "hand_over";
        option_texts::fields(self).into_iter().filter(named).collect()
    }
}
