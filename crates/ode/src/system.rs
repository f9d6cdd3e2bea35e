//! Interface between the stepper and a model: a hybrid ODE as a trait.

use crate::sparsity::JacobianPattern;
use serde::{Deserialize, Serialize};

/// Reason why a call into the model returned no result.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// The model cannot be evaluated at this point (FMI's *discard*, a NaN or an infinite value). The driver
    /// retries with a smaller step, without losing the run and without allocating.
    #[error("the model cannot be evaluated at this point")]
    Discard,
    /// The model failed. The run ends with this error.
    #[error(transparent)]
    Failed(Box<dyn std::error::Error + Send + Sync>),
}

impl CallError {
    /// Wraps an error of the model.
    pub fn failed(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Failed(error.into())
    }
}

/// Result of a call into the model.
pub type CallResult<T> = Result<T, CallError>;

/// Domain changes of an event indicator that count as events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Direction {
    /// All changes: the rule of FMI.
    #[default]
    Both,
    /// All changes except the return after a bounce. If an event changed the states and turned the indicator
    /// back near zero, its return to the domain it came from is not an event.
    Either,
    /// Changes into the domain `z > 0`.
    Up,
    /// Changes into the domain `z <= 0`.
    Down,
}

/// Causes of an event. Several causes at one instant lead to a single visit of event mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct EventCause {
    /// An event indicator changed its domain.
    pub state: bool,
    /// The time event announced by the model is due.
    pub time: bool,
    /// The model requested an event after a completed step.
    pub step: bool,
    /// An input jumps.
    pub input: bool,
}

/// One visit of the model's event mode.
#[derive(Debug, Clone, Copy)]
pub struct EventVisit<'a> {
    /// Time of the event. If the model announced a time event within [rounding](crate::time_tolerance) of
    /// this instant, this is the announced time. It may then be later than the end of the run by that
    /// rounding.
    pub time: f64,
    /// Causes of the event.
    pub cause: EventCause,
    /// Crossing of each event indicator: +1 if it became positive, -1 if it left the positive domain. 0 means
    /// that it kept its domain, or crossed in a [direction](HybridSystem::event_direction) that is not an
    /// event.
    pub crossings: &'a [i8],
}

/// Changes made by the start or by a visit of event mode.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EventOutcome {
    /// True if the event changed the continuous states. The driver then uses the new ones.
    pub states_changed: bool,
    /// True if the event changed the nominal values. The driver then reads them again.
    pub nominals_changed: bool,
    /// Next time event known to the model, if any.
    pub next_time: Option<f64>,
    /// True if the model requests the end of the simulation here. This is a normal end.
    pub terminate: bool,
}

/// Requests of the model after a completed step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StepAction {
    /// True if the model requests event mode now (a step event).
    pub event: bool,
    /// True if the model requests the end of the simulation here. This is a normal end.
    pub terminate: bool,
}

/// Argument with respect to which a residual is differentiated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Argument {
    /// The states `x`.
    States,
    /// Their derivatives `x'`.
    Slopes,
}

/// Instant at which an input is not smooth. A step ends there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputStop {
    /// The instant.
    pub time: f64,
    /// `true` if the input jumps: an event with [`EventCause::input`] follows. `false` if only its slope
    /// changes: there is no event and no restart.
    pub jump: bool,
}

/// A hybrid ordinary differential equation: `x' = f(t, x)` between events. A state event happens if an event
/// indicator `z(t, x)` changes its domain (`z > 0` or `z <= 0`, the rule of FMI). Time events and step events
/// are also supported.
///
/// The driver calls the functions in the order that FMI requires: [`start`](Self::start) once, then steps.
/// Each step ends with one call of [`step_completed`](Self::step_completed) at its final point.
/// [`handle_event`](Self::handle_event) follows at that time and state. The driver never returns to a time
/// before a completed step. The other functions can be called at any time and state of the step being tried.
///
/// Slices have the lengths `n_states`, `n_event_indicators` and `n_outputs`. The driver guarantees this.
pub trait HybridSystem {
    /// Number of continuous states; may be zero.
    fn n_states(&self) -> usize;

    /// Number of event indicators.
    fn n_event_indicators(&self) -> usize {
        0
    }

    /// Returns the direction in which an indicator must cross for an event. Crossings in the other direction
    /// do not end a step, are not counted and are not reported. Read once per run.
    fn event_direction(&self, indicator: usize) -> Direction {
        let _ = indicator;
        Direction::Both
    }

    /// Number of outputs in each sample.
    fn n_outputs(&self) -> usize {
        0
    }

    /// Fills in the nominal values of the states. A value that is zero or not finite is replaced by 1, and a
    /// negative value by its absolute value.
    fn nominals(&mut self, nominals: &mut [f64]) -> CallResult<()> {
        nominals.fill(1.0);
        Ok(())
    }

    /// True if a state can grow far beyond its nominal value without its error growing too, such as the angle
    /// of a rotating shaft (FMI's `unbounded`). Only its absolute tolerance then applies. Read once per run
    /// and after each change of the nominal values.
    fn is_unbounded(&self, state: usize) -> bool {
        let _ = state;
        false
    }

    /// Starts the run: sets the model to `t0`, handles its initial events, and fills in the states.
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome>;

    /// Fills in the right-hand side `dx = f(t, x)`.
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()>;

    /// Sparsity pattern of the Jacobian, if the model provides it. `None` if each derivative may depend on
    /// each state. Read once per run.
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        None
    }

    /// Fills in the Jacobian entries at the positions of the [pattern](Self::jacobian_pattern): column by
    /// column, with ascending rows. All entries are zero on entry. Returns `Ok(false)` if the model provides
    /// no entries (decided once per run). Called only if there is a pattern.
    fn jacobian_entries(&mut self, t: f64, x: &[f64], entries: &mut [f64]) -> CallResult<bool> {
        let _ = (t, x, entries);
        Ok(false)
    }

    /// True if the driver should call [`jacobian`](Self::jacobian), which requires a dense matrix. Read once
    /// per run.
    fn has_jacobian(&self) -> bool {
        false
    }

    /// Fills in the whole Jacobian by columns: `j[i + n * k]` is the derivative of `dx[i]` with respect to
    /// `x[k]`. All entries are zero on entry. Returns `Ok(false)` if the model provides no Jacobian (decided
    /// once per run). Called only if there are no [entries](Self::jacobian_entries). For a sparse system,
    /// only the entries at the positions of the pattern are used.
    fn jacobian(&mut self, t: f64, x: &[f64], j: &mut [f64]) -> CallResult<bool> {
        let _ = (t, x, j);
        Ok(false)
    }

    /// Fills in the product of the Jacobian and `seed`. Returns `Ok(false)` if the model has no directional
    /// derivatives (decided once per run). Called only if there is no [`jacobian`](Self::jacobian). Without
    /// either, the driver uses finite differences.
    fn directional_derivative(
        &mut self,
        t: f64,
        x: &[f64],
        seed: &[f64],
        derivative: &mut [f64],
    ) -> CallResult<bool> {
        let _ = (t, x, seed, derivative);
        Ok(false)
    }

    /// Constant matrix `M` of `M x' = f(t, x)`, by columns (`n * n` numbers); `None` for the identity. The
    /// matrix may be singular (a differential-algebraic system of index 1). Some equations, or sums of
    /// equations, then contain no derivative. They must hold within the tolerances of the states at the start
    /// and after each event. If they do not, Newton's method changes the states until they hold. The
    /// correction does not change `M x`, so the other equations continue from the values given.
    /// [`states_corrected`](Self::states_corrected) reports the correction. If there are no such states
    /// nearby, the run ends with [`ErrorKind::Inconsistent`](crate::ErrorKind). Only
    /// [`Method::Radau5`](crate::Method), [`Method::Bdf`](crate::Method) and [`Method::Auto`](crate::Method)
    /// support a mass matrix.
    fn mass_matrix(&self) -> Option<&[f64]> {
        None
    }

    /// True if the equations are `F(t, x, x') = 0` instead of `x' = f(t, x)`. [`residual`](Self::residual)
    /// computes `F` (index 0 or 1). Only [`Method::Bdf`](crate::Method) supports residuals. Read once per
    /// run.
    fn has_residual(&self) -> bool {
        false
    }

    /// Fills in the residual `r = F(t, x, dx)`, one equation per state.
    fn residual(&mut self, t: f64, x: &[f64], dx: &[f64], r: &mut [f64]) -> CallResult<()> {
        let _ = (t, x, dx, r);
        Err(CallError::Discard)
    }

    /// Fills in the Jacobian of the residual with respect to one of its arguments, by columns. All entries
    /// are zero on entry. Called only if [`has_jacobian`](Self::has_jacobian) is true. Returns `Ok(false)` if
    /// there is no Jacobian. The [pattern](Self::jacobian_pattern) must cover both Jacobians.
    fn residual_jacobian(
        &mut self,
        t: f64,
        x: &[f64],
        dx: &[f64],
        argument: Argument,
        j: &mut [f64],
    ) -> CallResult<bool> {
        let _ = (t, x, dx, argument, j);
        Ok(false)
    }

    /// True if the system supports runs backward in time, whose end is before their start. Read once per run.
    fn can_run_backward(&self) -> bool {
        false
    }

    /// Fills in a guess of `x'` at the start of a system given by its residual. The values are zero on entry.
    fn slopes_at_start(&mut self, dx: &mut [f64]) {
        let _ = dx;
    }

    /// Called at the start and after an event if states were changed so that the equations without
    /// derivatives hold. `x` contains all states after the correction. No other function is called there
    /// before this one.
    fn states_corrected(&mut self, t: f64, x: &[f64]) -> CallResult<()> {
        let _ = (t, x);
        Ok(())
    }

    /// Fills in the event indicators.
    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        let _ = (t, x, z);
        Ok(())
    }

    /// True if outputs inside a step can only be evaluated in the order of time.
    fn outputs_in_order(&self) -> bool {
        false
    }

    /// Fills in the outputs. Unlike derivatives and indicators, outputs may be NaN or infinite. The observer
    /// receives them unchanged and decides what to do.
    fn outputs(&mut self, t: f64, x: &[f64], y: &mut [f64]) -> CallResult<()> {
        let _ = (t, x, y);
        Ok(())
    }

    /// Called after every accepted step with its final point.
    fn step_completed(&mut self, t: f64, x: &[f64]) -> CallResult<StepAction> {
        let _ = (t, x);
        Ok(StepAction::default())
    }

    /// Handles the events at `visit.time`. `x` contains the states before the event and receives the states
    /// after it.
    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let _ = (visit, x);
        Ok(EventOutcome::default())
    }

    /// Returns the first instant strictly after `t` at which an input jumps or changes its slope.
    fn next_input_stop(&mut self, t: f64) -> Option<InputStop> {
        let _ = t;
        None
    }
}
