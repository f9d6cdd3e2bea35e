//! Interface between the stepper and a model: a hybrid ODE as a trait.

use crate::sparsity::JacobianPattern;
use serde::{Deserialize, Serialize};

/// Why a call into the model did not deliver.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// The model cannot be evaluated at this point (FMI's *discard*, a NaN or an infinite value).
    /// The driver answers with a smaller step; nothing is lost and nothing is allocated.
    #[error("the model cannot be evaluated at this point")]
    Discard,
    /// The model is broken; the run ends with this error.
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

/// Changes of the domain of an event indicator that are events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Direction {
    /// All: the rule of FMI.
    #[default]
    Both,
    /// All, but an indicator next to zero that a change of states at its event has turned back to where it
    /// came from (a bounce) has no event when it gets there.
    Either,
    /// Those into the domain `z > 0`.
    Up,
    /// Those into the domain `z <= 0`.
    Down,
}

/// Causes of an event; several at one instant are one visit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct EventCause {
    /// An event indicator changed its domain.
    pub state: bool,
    /// The instant the model announced as its next time event.
    pub time: bool,
    /// The model asked for it when a step was completed.
    pub step: bool,
    /// An input jumps.
    pub input: bool,
}

/// One visit of the model's event mode.
#[derive(Debug, Clone, Copy)]
pub struct EventVisit<'a> {
    /// Time of the event: that of the model's own time event where there is one within
    /// [rounding](crate::time_tolerance), though it may lie so much behind the end of the run.
    pub time: f64,
    /// Causes of the event.
    pub cause: EventCause,
    /// Per event indicator: +1 it became positive, -1 it left the positive domain, 0 it stayed, or it crossed
    /// in a [direction](HybridSystem::event_direction) that is no event.
    pub crossings: &'a [i8],
}

/// Changes made by a visit of event mode (or by the start).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EventOutcome {
    /// The continuous states were changed; the driver takes the new ones.
    pub states_changed: bool,
    /// The nominal values were changed; the driver reads them again.
    pub nominals_changed: bool,
    /// The next time event the model knows of, if any.
    pub next_time: Option<f64>,
    /// The model wishes to end the simulation here: a normal end.
    pub terminate: bool,
}

/// The model's answer to a completed step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StepAction {
    /// A step event: the model wants to enter event mode now.
    pub event: bool,
    /// The model wishes to end the simulation here: a normal end.
    pub terminate: bool,
}

/// With respect to what a residual is differentiated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Argument {
    /// The states `x`.
    States,
    /// Their derivatives `x'`.
    Slopes,
}

/// An instant at which an input is not smooth; a step ends there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputStop {
    /// The instant.
    pub time: f64,
    /// `true`: the input jumps, an event with [`EventCause::input`] is made; `false`: only its slope changes
    /// (no event, no restart).
    pub jump: bool,
}

/// A hybrid ordinary differential equation: `x' = f(t, x)` between events, event indicators `z(t, x)` whose
/// change of domain (`z > 0` against `z <= 0`, the rule of FMI) makes a state event, time events, step
/// events.
///
/// The driver promises the order that FMI wants: [`start`](Self::start) once; then steps, each ended by one
/// [`step_completed`](Self::step_completed) at its final point, never going back behind one that was
/// completed; [`handle_event`](Self::handle_event) after it, at the same time and state. The other calls may
/// come at any time and state of the step that is being tried.
///
/// Slices have the lengths `n_states`, `n_event_indicators` and `n_outputs`; the driver guarantees it.
pub trait HybridSystem {
    /// Number of continuous states; may be zero.
    fn n_states(&self) -> usize;

    /// Number of event indicators.
    fn n_event_indicators(&self) -> usize {
        0
    }

    /// In which direction an indicator must cross for an event. Crossings in the other one end no step, are
    /// not counted, and are not told of. Read once a run.
    fn event_direction(&self, indicator: usize) -> Direction {
        let _ = indicator;
        Direction::Both
    }

    /// Number of outputs that a sample holds.
    fn n_outputs(&self) -> usize {
        0
    }

    /// Fills in the nominal values of the states. Values that are zero, negative or not finite are taken as
    /// 1, |v|, 1.
    fn nominals(&mut self, nominals: &mut [f64]) -> CallResult<()> {
        nominals.fill(1.0);
        Ok(())
    }

    /// True if a state may grow far beyond its nominal value without its error growing with it, such as an
    /// angle that turns on and on (FMI's `unbounded`): then its absolute tolerance alone counts. Read once a
    /// run and after changes of nominals.
    fn is_unbounded(&self, state: usize) -> bool {
        let _ = state;
        false
    }

    /// Starts the run: brings the model to `t0`, lets its initial events happen, and fills in the states.
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome>;

    /// The right-hand side: fills in `dx = f(t, x)`.
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()>;

    /// Sparsity pattern of the Jacobian, if the model has it; `None`: any derivative may depend on any state.
    /// Read once per run.
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        None
    }

    /// Fills in the entries of the Jacobian at the places of the [pattern](Self::jacobian_pattern), column by
    /// column, the rows of each ascending; all are zero when it is called. `Ok(false)`: the model has none
    /// (decided once per run). Asked where there is a pattern.
    fn jacobian_entries(&mut self, t: f64, x: &[f64], entries: &mut [f64]) -> CallResult<bool> {
        let _ = (t, x, entries);
        Ok(false)
    }

    /// True if [`jacobian`](Self::jacobian) is to be called, for which a dense matrix is allocated. Read once
    /// per run.
    fn has_jacobian(&self) -> bool {
        false
    }

    /// Fills in the whole Jacobian by columns: `j[i + n * k]` is the derivative of `dx[i]` with respect to
    /// `x[k]`. All entries are zero when it is called. `Ok(false)`: the model has none (decided once per
    /// run). Asked where there are no [entries](Self::jacobian_entries); of a sparse system only those at the
    /// places of the pattern are taken.
    fn jacobian(&mut self, t: f64, x: &[f64], j: &mut [f64]) -> CallResult<bool> {
        let _ = (t, x, j);
        Ok(false)
    }

    /// Fills in the Jacobian times `seed`. `Ok(false)`: the model has no directional derivatives (decided
    /// once per run). Asked where there is no [`jacobian`](Self::jacobian); without either the driver takes
    /// differences.
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

    /// The constant matrix `M` of `M x' = f(t, x)`, by columns (`n * n` numbers); `None`: the identity. It
    /// may be singular (a differential-algebraic system of index 1). Then some equations, or sums of them,
    /// have no derivative in them. Where these do not hold within the tolerances of the states, at the start
    /// and after each event, Newton's method changes the states until they do, in such a way that `M x` stays
    /// as it is: that what the other equations say of derivatives goes on from the values given.
    /// [`states_corrected`](Self::states_corrected) tells of it;
    /// [`ErrorKind::Inconsistent`](crate::ErrorKind) is what comes of it where there is no such state near.
    /// Only [`Method::Radau5`](crate::Method), [`Method::Bdf`](crate::Method) and
    /// [`Method::Auto`](crate::Method) take a mass matrix.
    fn mass_matrix(&self) -> Option<&[f64]> {
        None
    }

    /// True if the equations are `F(t, x, x') = 0`, given by [`residual`](Self::residual) (index 0 or 1),
    /// instead of `x' = f(t, x)`. Only [`Method::Bdf`](crate::Method) takes them. Read once a run.
    fn has_residual(&self) -> bool {
        false
    }

    /// Fills in the residual `r = F(t, x, dx)`, one equation per state.
    fn residual(&mut self, t: f64, x: &[f64], dx: &[f64], r: &mut [f64]) -> CallResult<()> {
        let _ = (t, x, dx, r);
        Err(CallError::Discard)
    }

    /// Fills in the Jacobian of the residual with respect to one of its arguments, by columns; all entries
    /// are zero when it is called. Asked where [`has_jacobian`](Self::has_jacobian). `Ok(false)`: there is
    /// none. The [pattern](Self::jacobian_pattern) is that of both Jacobians together.
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

    /// True if a run may lead backward in time, from a start after its end. Read once a run.
    fn can_run_backward(&self) -> bool {
        false
    }

    /// Fills in what is known of `x'` at the start of a system given by its residual: a guess, zeros when it
    /// is called.
    fn slopes_at_start(&mut self, dx: &mut [f64]) {
        let _ = dx;
    }

    /// Told at the start and after an event, before anything else is asked of it there, if states were
    /// changed so that the equations without derivatives hold; `x` has all states as they are now.
    fn states_corrected(&mut self, t: f64, x: &[f64]) -> CallResult<()> {
        let _ = (t, x);
        Ok(())
    }

    /// Fills in the event indicators.
    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        let _ = (t, x, z);
        Ok(())
    }

    /// Fills in the outputs. Unlike derivatives and indicators they may be NaN or infinite: the observer is
    /// given them as they are, and judges.
    fn outputs(&mut self, t: f64, x: &[f64], y: &mut [f64]) -> CallResult<()> {
        let _ = (t, x, y);
        Ok(())
    }

    /// Told after every accepted step, with its final point.
    fn step_completed(&mut self, t: f64, x: &[f64]) -> CallResult<StepAction> {
        let _ = (t, x);
        Ok(StepAction::default())
    }

    /// Lets the events at `visit.time` happen; `x` holds the states before and receives those after.
    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let _ = (visit, x);
        Ok(EventOutcome::default())
    }

    /// The first instant strictly after `t` at which an input jumps or changes its slope.
    fn next_input_stop(&mut self, t: f64) -> Option<InputStop> {
        let _ = t;
        None
    }
}
