//! Interface of a method to the driver: try a step, look inside it, go on from its end, or start anew.

use crate::error::Undetermined;
use crate::error_norm::ErrorWeights;
use crate::stats::Stats;
use crate::system::{CallResult, HybridSystem};
use std::fmt::Debug;

/// The equations, how exactly they are to be solved, and a count of what that takes.
pub(crate) struct Equations<'a> {
    pub(crate) system: &'a mut dyn HybridSystem,
    pub(crate) weights: &'a ErrorWeights,
    pub(crate) stats: &'a mut Stats,
}

impl Equations<'_> {
    /// The right-hand side, counted.
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

/// A point whose state and slopes are looked for, from those that it has.
#[derive(Debug)]
pub(crate) struct PointMut<'a> {
    pub(crate) t: f64,
    pub(crate) x: &'a mut [f64],
    pub(crate) slopes: &'a mut [f64],
}

/// A trial step from `(t, x)` to `end`; `h = end - t` as the method computes with it.
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
    /// It meets the tolerance.
    Good,
    /// Its error is too large; a step of this size has a better chance.
    TooInexact { h: f64 },
    /// Its equations could not be solved; a step of this size has a better chance.
    NotSolved { h: f64 },
}

/// Result of the check that the equations without derivatives hold at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Consistency {
    /// They do, within the tolerances of the states.
    Holds,
    /// They do now: states were changed.
    Corrected,
    /// No states were found for which they hold: this equation has this residual.
    Impossible { equation: usize, residual: f64 },
    /// They do not decide the states.
    HigherIndex,
    /// No slopes were found for which a residual is zero: this equation has this residual at the values
    /// given. `is_singular`: the matrix in front of the slopes has a smaller rank there than near them.
    NoSlopes { equation: usize, residual: f64, is_singular: bool },
}

/// Treatment of a step inside of which an event was located.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum StepWithEvent {
    /// The state at the event is that of the interpolant.
    Interpolated,
    /// It is made again up to the event: the method is more exact at the ends of its steps than inside them.
    RepeatedToIt,
    /// It is made again up to a little before the event: the interpolant has right-hand sides of its own, for
    /// which the error test does not vouch, and one of them may have seen what is behind the event.
    RepeatedToBefore,
}

/// Properties of a method that the driver needs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Properties {
    /// The order that decides how a first step is guessed: that of the solution whose error is estimated.
    pub(crate) order: u32,
    /// Steps carry an error estimate.
    pub(crate) has_error_estimate: bool,
    /// It integrates systems with a mass matrix, and those that are given by their residual.
    pub(crate) takes_mass_matrix: bool,
    pub(crate) takes_residual: bool,
    /// There is no right-hand side to be evaluated in this run: [`Stepper::derivative`] is what there is of
    /// slopes.
    pub(crate) only_own_slopes: bool,
    /// Treatment of a step inside of which an event was located.
    pub(crate) step_with_event: StepWithEvent,
    /// At how many points inside its steps event indicators are looked at by default: more where steps are
    /// longer, as seen against the curvature of the solution.
    pub(crate) interior_samples: u32,
    /// It [begins](Stepper::begin_with) with the second derivative where indicators slide.
    pub(crate) wants_second_derivative: bool,
    /// [`Stepper::derivative`] is the right-hand side itself also where a whole step has led, and not only
    /// where it was [evaluated](Stepper::evaluate).
    pub(crate) evaluates_ends: bool,
    /// It makes use of Jacobians.
    pub(crate) takes_jacobians: bool,
}

impl Default for Properties {
    fn default() -> Self {
        Self {
            order: 1,
            has_error_estimate: true,
            takes_mass_matrix: false,
            takes_residual: false,
            only_own_slopes: false,
            step_with_event: StepWithEvent::Interpolated,
            interior_samples: 1,
            wants_second_derivative: false,
            evaluates_ends: true,
            takes_jacobians: false,
        }
    }
}

/// An integration method. The driver decides where steps end, and whether a step that meets the tolerance
/// stands; the stepper judges its own error, proposes step sizes, and keeps what the method remembers between
/// steps.
///
/// The order of calls: [`begin`](Self::begin) once a run; [`evaluate`](Self::evaluate) and
/// [`forget`](Self::forget) at its first point, with [`make_consistent`](Self::make_consistent) between them;
/// trials, of which the last good one may be looked into and is then accepted; after an event
/// [`evaluate`](Self::evaluate), [`make_consistent`](Self::make_consistent), and [`forget`](Self::forget) if
/// it changed something.
pub(crate) trait Stepper: Debug + Send + Sync {
    /// Properties of the method that the driver needs.
    fn properties(&self) -> Properties;

    /// Starts a run: makes room, forgets everything. It fails where there is no room for its matrices.
    fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()>;

    /// Takes `(t, x)` as the current point and evaluates the right-hand side there; the step sizes and the
    /// slow parts of the past (Jacobians, differences) are kept.
    fn evaluate(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> CallResult<()>;

    /// Sees to it that the algebraic equations of a singular mass matrix hold at `(t, x)`, where the
    /// right-hand side has just been [evaluated](Self::evaluate), by changing what they decide.
    fn make_consistent(
        &mut self,
        equations: &mut Equations<'_>,
        t: f64,
        x: &mut [f64],
    ) -> CallResult<Consistency> {
        let _ = (equations, t, x);
        Ok(Consistency::Holds)
    }

    /// The current point has nothing to do with the steps before it.
    fn forget(&mut self);

    /// After [`forget`](Self::forget), while indicators slide: the right-hand side `dx` that the current one
    /// leads to after the time `s`. Their difference gives the second derivative, with which a multistep
    /// method can begin at order 2: its steps of order 1 are far shorter than those of sliding where the
    /// tolerance is tight.
    fn begin_with(&mut self, s: f64, dx: &[f64]) {
        let _ = (s, dx);
    }

    /// An input changes its slope at the current point, where a step always ends. Returns the step size to go
    /// on with.
    fn kink(&mut self, h: f64) -> f64 {
        h
    }

    /// The next trial is the last one, which was good, with an earlier end.
    fn repeat(&mut self) {}

    /// After a failure at `(t, x)`: states that the equations without derivatives do not determine, neither
    /// there nor nearby, as in systems of index 2 or higher. `None`: there are none.
    fn undetermined(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> Option<Undetermined> {
        let _ = (equations, t, x);
        None
    }

    /// The right-hand side at the current point, or an estimate of it.
    fn derivative(&self) -> &[f64];

    /// Tries a step; `x_new` receives its end. A refused point, or a number that is not finite, is
    /// [`Discard`](crate::CallError::Discard).
    fn try_step(
        &mut self,
        equations: &mut Equations<'_>,
        trial: Trial<'_>,
        x_new: &mut [f64],
    ) -> CallResult<Attempt>;

    /// The error estimate of the last trial, per state.
    fn error(&self) -> &[f64];

    /// A point of the last trial was refused, or it turned out of no use: returns the step size to go on
    /// with.
    fn refused(&mut self, h: f64) -> f64;

    /// Makes ready to look inside the last trial, which was good and ended at `x_new`.
    fn prepare_interpolation(
        &mut self,
        equations: &mut Equations<'_>,
        trial: Trial<'_>,
        x_new: &[f64],
    ) -> CallResult<()> {
        let _ = (equations, trial, x_new);
        Ok(())
    }

    /// The state at `trial.t + theta * trial.h` inside the last trial step.
    fn interpolate(&self, trial: Trial<'_>, theta: f64, x: &mut [f64]);

    /// The last trial, of size `h`, is accepted up to `theta` (1: as a whole); the next step starts there.
    /// Returns the step size to go on with.
    fn accept(&mut self, h: f64, theta: f64) -> f64;
}
