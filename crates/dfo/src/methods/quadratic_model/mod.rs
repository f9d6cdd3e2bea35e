//! Trust region on quadratic interpolation models of the cost, with bounds. The method belongs to the class
//! of BOBYQA (Powell, report DAMTP 2009/NA06) and COBYQA (Ragonneau, thesis, Hong Kong 2022).
//!
//! The first batch contains the 2n + 1 points of the first model. Of all quadratics through the points, the
//! model changes least from the previous model (`model.rs`). Its minimum within a radius and
//! the bounds gives the next trial point (`subproblem.rs`). The radius follows the accuracy of the
//! prediction. Nearby points stay in the model, up to 4n + 1 or the number of coefficients of a quadratic.
//! With these points, fits need half of the evaluations that they need with 2n + 1 points. After that, a new
//! point replaces the most dispensable point. If the remaining points determine a direction of the gradient
//! badly, a point is placed along this direction. If the model is exhausted at a radius, the minimum radius,
//! called the resolution, is reduced (Powell's rules, NA06, sections 2 and 6; Conn, Scheinberg and Vicente,
//! Introduction to Derivative-Free Optimization, 2009, chapters 5, 6 and 10).
//!
//! **Tests.** The x test measures the resolution. The f test measures the decrease predicted by the model.
//! The tests are applied when a resolution is exhausted. They count only if the model predicted the last two
//! costs to within the limit of the f test, and if points within a few resolutions determine its slope. If
//! the model then predicts a decrease farther away, the search continues with a larger resolution
//! (`final_check.rs`).
//!
//! **Restarts.** If steps fail at several resolutions although the model predicts a decrease, the cost has
//! noise or a kink. New points are then placed around the best one, as far away as the first points
//! (restarts: Cartis, Fiala, Marteau and Roberts, ACM TOMS 45, 2019).
//!
//! **Noise and kinks.** For a smooth cost, the curvature of the model converges as the resolution shrinks. If
//! the curvature grows, the cost has a kink or noise, and passed tests are meaningless. The search then
//! restarts from a larger distance, and has converged only if several consecutive starts end without such
//! evidence. Alternatively, it hands over to a simplex search or to CMA-ES (`hand_over.rs`), which continues
//! from the best point as it does from a start. CMA-ES continues if noise or steps hide the curvature of the
//! cost within a fifth of the first radius. Its ranks of many points average the noise, whereas a simplex
//! collapses.
//!
//! **Unknown sizes.** A parameter that starts at zero, without a nominal size and without a box, is first
//! varied alone (`shared/size_search.rs`).
//!
//! **Failures.** Failed points are never part of a model. The step is shortened. Later steps stay on one side
//! of a plane between failed points and the points of the model (`shared/failures.rs`). A failed first point
//! is retried nearer to the start and on the other side. If the search ends next to failed points, it
//! continues with CMA-ES, which searches for a lower cost between them (`failure_check.rs`).
//!
//! **Linear constraints.** Every requested point satisfies them. The steps are those of an active-set
//! iteration (`polyhedron.rs`). First points outside are moved to a sphere inside, and points that improve
//! the model to the nearest feasible ones (`rows.rs`; LINCOA: Powell, Math. Program. Comput. 7, 2015).
//!
//! **Nonlinear constraints** may be violated on the way. Each has a model through the same points, and the
//! points rank by a merit function (`nonlinear.rs`). The steps are those of sequential quadratic programming
//! on the models (`sqp.rs`; COBYQA: Ragonneau, thesis, Hong Kong 2022). If a constraint forbids the
//! evaluation of the cost, the point refines the models of the constraints only. The tests pass only at a
//! feasible point. The conditions of the interpolation are solved from scratch for any number of parameters.
//!
//! **Cutoffs**: none, because a model needs the value of every point.
//!
//! **Time**: O((4n)^3) operations per point up to 20 parameters: 11 microseconds for 2, 0.2 ms for 10, 0.6 ms
//! for 20. With more parameters, the inverse of the interpolation conditions is updated when points are
//! exchanged. The steps use truncated conjugate gradients, and the model keeps 2n + 1 points
//! (`many_parameters.rs`, `inverse.rs`, `truncated_cg.rs`). As in NEWUOA, this requires O(n^2) operations per
//! point (`benches/overhead.rs`).

mod constraint_models;
mod final_check;
mod hand_over;
mod initial;
mod inverse;
mod iteration;
mod many_parameters;
mod model;
mod nonlinear;
mod options;
mod polyhedron;
mod rows;
mod sqp;
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

/// A running search on quadratic models, created by [`QuadraticModel`].
pub type QuadraticModelState = WithSizes<QuadraticModel>;

/// Returns the setup without bounds that mean "unbounded", and with sizes that are either all widths or all
/// magnitudes.
fn prepared(setup: &Setup) -> Setup {
    Setup { space: setup.space.without_far_bounds().with_comparable_sizes(), ..setup.clone() }
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
        memory::check("a quadratic model for this many parameters", &[points, 7 * points + 2 * n_user])?;
        WithSizes::begin(self, prepared(setup))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<QuadraticModelState, Error> {
        WithSizes::restore(self, prepared(setup), state)
    }

    fn supports_linear(&self) -> bool {
        true
    }

    fn supports_nonlinear(&self) -> bool {
        true
    }

    fn describe(&self) -> Vec<(String, String)> {
        // If false, the option is omitted, so that runs from versions without this option can continue.
        let named = |(name, _): &(String, String)| self.hand_over || name != "hand_over";
        option_texts::fields(self).into_iter().filter(named).collect()
    }
}
