//! Interface between a method and the driver: try a step, evaluate inside it, continue from its end, or
//! restart.

use crate::error::Undetermined;
use crate::error_norm::ErrorWeights;
use crate::stats::Stats;
use crate::system::{CallResult, HybridSystem};
use std::fmt::Debug;

/// The equations, the weights of their errors, and the statistics of the run.
pub(crate) struct Equations<'a> {
    pub(crate) system: &'a mut dyn HybridSystem,
    pub(crate) weights: &'a ErrorWeights,
    pub(crate) stats: &'a mut Stats,
}

impl Equations<'_> {
    /// Evaluates the right-hand side and counts the evaluation.
    #[inline]
    pub(crate) fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        self.stats.right_hand_sides += 1;
        self.system.derivatives(t, x, dx)
    }
}

/// A point of a system: time, state, and the slopes there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Point<'a> {
    pub(crate) t: f64,
    pub(crate) x: &'a [f64],
    pub(crate) slopes: &'a [f64],
}

/// A point whose state and slopes must be corrected, starting from the current values.
#[derive(Debug)]
pub(crate) struct PointMut<'a> {
    pub(crate) t: f64,
    pub(crate) x: &'a mut [f64],
    pub(crate) slopes: &'a mut [f64],
}

/// A trial step from `(t, x)` to `end`. The method computes with `h = end - t`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Trial<'a> {
    pub(crate) t: f64,
    pub(crate) end: f64,
    pub(crate) h: f64,
    pub(crate) x: &'a [f64],
}

/// Result of a trial step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Attempt {
    /// The step meets the tolerance.
    Good,
    /// The error is too large. A step of size `h` is more likely to succeed.
    TooInexact { h: f64 },
    /// The equations could not be solved. A step of size `h` is more likely to succeed.
    NotSolved { h: f64 },
}

/// Result of the check that the equations without derivatives hold at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Consistency {
    /// The equations hold within the tolerances of the states.
    Holds,
    /// The equations hold after a change of states.
    Corrected,
    /// No states were found for which the equations hold. `equation` has this `residual`.
    Impossible { equation: usize, residual: f64 },
    /// The equations do not determine the states.
    HigherIndex,
    /// No slopes were found for which the residual is zero. `equation` has this `residual` at the given
    /// values. `is_singular`: the matrix of the slopes has a smaller rank there than near these values.
    NoSlopes { equation: usize, residual: f64, is_singular: bool },
}

/// Treatment of a step that contains a located event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum StepWithEvent {
    /// The state at the event is interpolated.
    Interpolated,
    /// The step is repeated up to the event, because the method is more accurate at the ends of its steps
    /// than inside them.
    RepeatedToIt,
    /// The step is repeated up to just before the event. The interpolant has additional right-hand sides that
    /// the error test does not cover, and one of them may have been evaluated after the event.
    RepeatedToBefore,
}

/// Properties of a method that the driver needs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Properties {
    /// Order for the estimate of the first step: the order of the solution whose error is estimated.
    pub(crate) order: u32,
    /// True if steps include an error estimate.
    pub(crate) has_error_estimate: bool,
    /// True if the method supports mass matrices (and systems given by their residual).
    pub(crate) takes_mass_matrix: bool,
    pub(crate) takes_residual: bool,
    /// True if this run has no right-hand side to evaluate. [`Stepper::derivative`] is then the only source
    /// of slopes.
    pub(crate) slopes_from_stepper_only: bool,
    /// Treatment of a step that contains a located event.
    pub(crate) step_with_event: StepWithEvent,
    /// Default number of points inside each step at which event indicators are evaluated. There are more
    /// points if steps are longer relative to the curvature of the solution.
    pub(crate) interior_samples: u32,
    /// True if the method [begins](Stepper::begin_with) with the second derivative while indicators slide.
    pub(crate) needs_second_derivative: bool,
    /// True if [`Stepper::derivative`] is the right-hand side also at the end of a whole step, not only at a
    /// point that was [evaluated](Stepper::evaluate).
    pub(crate) evaluates_ends: bool,
    /// True if the method uses Jacobians.
    pub(crate) takes_jacobians: bool,
}

impl Default for Properties {
    fn default() -> Self {
        Self {
            order: 1,
            has_error_estimate: true,
            takes_mass_matrix: false,
            takes_residual: false,
            slopes_from_stepper_only: false,
            step_with_event: StepWithEvent::Interpolated,
            interior_samples: 1,
            needs_second_derivative: false,
            evaluates_ends: true,
            takes_jacobians: false,
        }
    }
}

/// An integration method. The driver decides where steps end and whether a step within the tolerance is
/// accepted. The stepper estimates its error, proposes step sizes, and stores the state of the method between
/// steps.
///
/// The order of calls is as follows. [`begin`](Self::begin) is called once per run. At the first point,
/// [`evaluate`](Self::evaluate), [`make_consistent`](Self::make_consistent) and [`forget`](Self::forget)
/// follow. Trial steps come next: the last good one may be interpolated and is then accepted. After an event,
/// [`evaluate`](Self::evaluate) and [`make_consistent`](Self::make_consistent) are called, and
/// [`forget`](Self::forget) if the event changed something.
pub(crate) trait Stepper: Debug + Send + Sync {
    /// Properties of the method that the driver needs.
    fn properties(&self) -> Properties;

    /// Starts a run: allocates the work space and discards the previous state. Fails if memory is
    /// insufficient for its matrices.
    fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()>;

    /// Makes `(t, x)` the current point and evaluates the right-hand side there. Keeps the step sizes and the
    /// slowly changing data (Jacobians, differences).
    fn evaluate(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> CallResult<()>;

    /// Ensures that the algebraic equations of a singular mass matrix hold at `(t, x)`, by changing the
    /// states that they determine. The right-hand side was [evaluated](Self::evaluate) at this point just
    /// before.
    fn make_consistent(
        &mut self,
        equations: &mut Equations<'_>,
        t: f64,
        x: &mut [f64],
    ) -> CallResult<Consistency> {
        let _ = (equations, t, x);
        Ok(Consistency::Holds)
    }

    /// Discards the history, because the current point does not continue the previous steps.
    fn forget(&mut self);

    /// Sets the second derivative after [`forget`](Self::forget), while indicators slide. `dx` is the
    /// right-hand side at the time `s` after the current point, reached along the current slopes. The
    /// difference of the two gives the second derivative, so a multistep method can begin at order 2. Its
    /// steps of order 1 would be far shorter than during sliding if the tolerance is tight.
    fn begin_with(&mut self, s: f64, dx: &[f64]) {
        let _ = (s, dx);
    }

    /// Handles a change of slope of an input at the current point, where a step always ends. Returns the next
    /// step size.
    fn kink(&mut self, h: f64) -> f64 {
        h
    }

    /// Announces that the next trial is the last good one with an earlier end.
    fn repeat(&mut self) {}

    /// Returns the states that the equations without derivatives do not determine, after a failure at `(t,
    /// x)`. They are determined neither there nor nearby, as in systems of index 2 or higher. `None` if there
    /// are no such states.
    fn undetermined(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> Option<Undetermined> {
        let _ = (equations, t, x);
        None
    }

    /// Right-hand side at the current point, or an estimate of it.
    fn derivative(&self) -> &[f64];

    /// Tries a step and writes its end to `x_new`. Returns [`Discard`](crate::CallError::Discard) if the
    /// model refuses a point or a value is not finite.
    fn try_step(
        &mut self,
        equations: &mut Equations<'_>,
        trial: Trial<'_>,
        x_new: &mut [f64],
    ) -> CallResult<Attempt>;

    /// Error estimate of the last trial, per state.
    fn error(&self) -> &[f64];

    /// Reports that a point of the last trial was refused, or that the trial is unusable. Returns the next
    /// step size.
    fn refused(&mut self, h: f64) -> f64;

    /// Prepares the interpolation inside the last trial, which was good and ended at `x_new`.
    fn prepare_interpolation(
        &mut self,
        equations: &mut Equations<'_>,
        trial: Trial<'_>,
        x_new: &[f64],
    ) -> CallResult<()> {
        let _ = (equations, trial, x_new);
        Ok(())
    }

    /// Computes the state at `trial.t + theta * trial.h` inside the last trial step.
    fn interpolate(&self, trial: Trial<'_>, theta: f64, x: &mut [f64]);

    /// Accepts the last trial, of size `h`, up to `theta` (1: the whole step). The next step starts there.
    /// Returns the next step size.
    fn accept(&mut self, h: f64, theta: f64) -> f64;
}
