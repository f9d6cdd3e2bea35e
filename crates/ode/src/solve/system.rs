//! A hybrid system defined by closures.

use crate::sparsity::JacobianPattern;
use crate::system::{Argument, CallResult, Direction, EventOutcome, EventVisit, HybridSystem, StepAction};
use std::fmt;

type Rhs<'a> = Box<dyn FnMut(f64, &[f64], &mut [f64]) + 'a>;
type Residual<'a> = Box<dyn FnMut(f64, &[f64], &[f64], &mut [f64]) + 'a>;
type Jacobian<'a> = Box<dyn FnMut(f64, &[f64], &[f64], Argument, &mut [f64]) + 'a>;
type Function<'a> = Box<dyn FnMut(f64, &[f64]) -> f64 + 'a>;
type Change<'a> = Box<dyn FnMut(f64, &mut [f64], &[usize]) + 'a>;

/// Form of the equations.
pub(super) enum Form<'a> {
    Explicit(Rhs<'a>),
    /// Residual and the slopes at the start.
    Residual(Residual<'a>, Vec<f64>),
}

/// An event function and the crossings that count as its events.
pub struct Event<'a> {
    pub(super) function: Function<'a>,
    pub(super) direction: Direction,
    /// Occurrence at which the run ends; 0 means never.
    pub(super) terminal: usize,
    /// Times and the preceding states.
    pub(super) occurrences: Vec<(f64, Vec<f64>)>,
}

impl fmt::Debug for Event<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { direction, terminal, .. } = self;
        f.debug_struct("Event")
            .field("direction", direction)
            .field("terminal", terminal)
            .finish_non_exhaustive()
    }
}

/// Times and states.
#[derive(Default)]
pub(super) struct Rows {
    pub(super) times: Vec<f64>,
    pub(super) states: Vec<Vec<f64>>,
    /// True if the start or an event added the last row.
    is_made: bool,
}

impl Rows {
    pub(super) fn push(&mut self, t: f64, x: &[f64]) {
        self.times.push(t);
        self.states.push(x.to_vec());
        self.is_made = false;
    }
}

/// The system and the results stored during a run.
pub(super) struct ClosureSystem<'a> {
    pub(super) form: Form<'a>,
    pub(super) x0: Vec<f64>,
    pub(super) events: Vec<Event<'a>>,
    pub(super) on_event: Option<Change<'a>>,
    pub(super) jacobian: Option<Jacobian<'a>>,
    pub(super) pattern: Option<JacobianPattern>,
    pub(super) mass: Option<Vec<f64>>,
    /// True if the ends of the steps are stored.
    pub(super) keeps_rows: bool,
    pub(super) rows: Rows,
}

impl<'a> ClosureSystem<'a> {
    pub(super) fn new(form: Form<'a>, x0: Vec<f64>) -> Self {
        Self {
            form,
            x0,
            events: Vec::new(),
            on_event: None,
            jacobian: None,
            pattern: None,
            mass: None,
            keeps_rows: false,
            rows: Rows::default(),
        }
    }

    fn keep(&mut self, t: f64, x: &[f64], is_made: bool) {
        if self.keeps_rows {
            self.rows.push(t, x);
            self.rows.is_made = is_made;
        }
    }

    fn fill_jacobian(&mut self, t: f64, x: &[f64], dx: &[f64], argument: Argument, j: &mut [f64]) -> bool {
        let Some(jacobian) = &mut self.jacobian else { return false };
        jacobian(t, x, dx, argument, j);
        true
    }
}

impl HybridSystem for ClosureSystem<'_> {
    fn n_states(&self) -> usize {
        self.x0.len()
    }
    fn n_event_indicators(&self) -> usize {
        self.events.len()
    }
    fn event_direction(&self, indicator: usize) -> Direction {
        self.events[indicator].direction
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&self.x0);
        self.keep(t0, x, true);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        match &mut self.form {
            Form::Explicit(rhs) => rhs(t, x, dx),
            Form::Residual(residual, slopes) => residual(t, x, slopes, dx),
        }
        Ok(())
    }
    fn can_run_backward(&self) -> bool {
        true
    }
    fn has_residual(&self) -> bool {
        matches!(self.form, Form::Residual(..))
    }
    fn slopes_at_start(&mut self, dx: &mut [f64]) {
        if let Form::Residual(_, slopes) = &self.form {
            dx.copy_from_slice(slopes);
        }
    }
    fn residual(&mut self, t: f64, x: &[f64], dx: &[f64], r: &mut [f64]) -> CallResult<()> {
        if let Form::Residual(residual, _) = &mut self.form {
            residual(t, x, dx, r);
        }
        Ok(())
    }
    fn residual_jacobian(
        &mut self,
        t: f64,
        x: &[f64],
        dx: &[f64],
        argument: Argument,
        j: &mut [f64],
    ) -> CallResult<bool> {
        Ok(self.fill_jacobian(t, x, dx, argument, j))
    }
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        self.pattern.as_ref()
    }
    fn has_jacobian(&self) -> bool {
        self.jacobian.is_some()
    }
    fn jacobian(&mut self, t: f64, x: &[f64], j: &mut [f64]) -> CallResult<bool> {
        Ok(self.fill_jacobian(t, x, &[], Argument::States, j))
    }
    fn mass_matrix(&self) -> Option<&[f64]> {
        self.mass.as_deref()
    }
    fn states_corrected(&mut self, t: f64, x: &[f64]) -> CallResult<()> {
        if self.rows.is_made {
            self.rows.times.pop();
            self.rows.states.pop();
        }
        self.keep(t, x, false);
        Ok(())
    }
    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z.iter_mut().zip(&mut self.events).for_each(|(z, event)| *z = (event.function)(t, x));
        Ok(())
    }
    fn step_completed(&mut self, t: f64, x: &[f64]) -> CallResult<StepAction> {
        self.keep(t, x, false);
        Ok(StepAction::default())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let mut which = Vec::new();
        let mut outcome = EventOutcome::default();
        for (i, (event, crossing)) in self.events.iter_mut().zip(visit.crossings).enumerate() {
            if *crossing != 0 {
                which.push(i);
                event.occurrences.push((visit.time, x.to_vec()));
                outcome.terminate |= event.terminal != 0 && event.occurrences.len() >= event.terminal;
            }
        }
        if let Some(on_event) = self.on_event.as_mut().filter(|_| !which.is_empty()) {
            let before = x.to_vec();
            on_event(visit.time, x, &which);
            outcome.states_changed = before != x;
        }
        if outcome.states_changed {
            self.keep(visit.time, x, true);
        }
        Ok(outcome)
    }
}
