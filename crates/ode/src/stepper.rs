//! What a one-step method offers the driver: try a step, look inside it, go on from its end, or start anew.

use crate::control::Weights;
use crate::stats::Stats;
use crate::system::{CallResult, HybridSystem};

/// A trial step from `(t, x)` to `end`; `h = end - t` as the method computes with it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Trial<'a> {
    pub(crate) t: f64,
    pub(crate) end: f64,
    pub(crate) h: f64,
    pub(crate) x: &'a [f64],
}

/// An integration method. The driver alone decides whether a step is accepted, where it ends and how long the next
/// one is; the stepper keeps what the method remembers between steps.
pub(crate) trait Stepper {
    /// Order of the method, as the step-size controller needs it.
    fn order(&self) -> u32;

    /// Whether steps carry an error estimate.
    fn has_error_estimate(&self) -> bool;

    /// Makes room for `n` states.
    fn resize(&mut self, n: usize);

    /// Starts at `(t, x)`: evaluates the right-hand side there and forgets everything older.
    fn restart<S: HybridSystem + ?Sized>(
        &mut self,
        system: &mut S,
        t: f64,
        x: &[f64],
        stats: &mut Stats,
    ) -> CallResult<()>;

    /// The right-hand side at the start of the current step.
    fn derivative(&self) -> &[f64];

    /// Tries a step; `x_new` receives its end. Returns the weighted norm of the error estimate (0 without one; NaN if
    /// the step produced one).
    fn try_step<S: HybridSystem + ?Sized>(
        &mut self,
        system: &mut S,
        trial: Trial<'_>,
        weights: &Weights,
        x_new: &mut [f64],
        stats: &mut Stats,
    ) -> CallResult<f64>;

    /// The error estimate of the last trial, per state.
    fn error(&self) -> &[f64];

    /// The state at `trial.t + theta * trial.h` inside the last trial step.
    fn interpolate(&self, trial: Trial<'_>, theta: f64, x: &mut [f64]);

    /// The slope of [`interpolate`](Self::interpolate).
    fn interpolate_slope(&self, theta: f64, dx: &mut [f64]);

    /// The last trial is accepted as a whole; the next step starts at its end.
    fn accept(&mut self);
}
