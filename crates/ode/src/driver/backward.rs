//! Runs that lead backward in time: the system and the observer as seen with the time `s = -t`.

use crate::error::{ErrorKind, Report, SimulationError};
use crate::observer::{EventRecord, Observer, Sample, StepView};
use crate::sparsity::JacobianPattern;
use crate::system::{Argument, CallResult, Direction, EventOutcome, EventVisit, HybridSystem, StepAction};
use std::ops::ControlFlow;

/// The other time; never a negative zero.
pub(super) fn turned(time: f64) -> f64 {
    0.0 - time
}

fn negate(values: &mut [f64]) {
    values.iter_mut().for_each(|v| *v = -*v);
}

/// A system with its time turned: `dx/ds = -f(-s, x)`. What it knows of inputs to come is of no use.
pub(super) struct Backward<'a, S: ?Sized> {
    pub(super) system: &'a mut S,
    /// Slopes with respect to the time of the system.
    pub(super) slopes: &'a mut Vec<f64>,
}

impl<S: HybridSystem + ?Sized> Backward<'_, S> {
    fn turn_slopes(&mut self, dx: &[f64]) {
        self.slopes.clear();
        self.slopes.extend(dx.iter().map(|v| -v));
    }
}

fn outcome(outcome: EventOutcome) -> EventOutcome {
    EventOutcome { next_time: outcome.next_time.map(turned), ..outcome }
}

impl<S: HybridSystem + ?Sized> HybridSystem for Backward<'_, S> {
    fn n_states(&self) -> usize {
        self.system.n_states()
    }
    fn n_event_indicators(&self) -> usize {
        self.system.n_event_indicators()
    }
    fn event_direction(&self, indicator: usize) -> Direction {
        self.system.event_direction(indicator)
    }
    fn n_outputs(&self) -> usize {
        self.system.n_outputs()
    }
    fn nominals(&mut self, nominals: &mut [f64]) -> CallResult<()> {
        self.system.nominals(nominals)
    }
    fn is_unbounded(&self, state: usize) -> bool {
        self.system.is_unbounded(state)
    }
    fn start(&mut self, s0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        self.system.start(turned(s0), x).map(outcome)
    }
    fn derivatives(&mut self, s: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        self.system.derivatives(turned(s), x, dx)?;
        negate(dx);
        Ok(())
    }
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        self.system.jacobian_pattern()
    }
    fn has_jacobian(&self) -> bool {
        self.system.has_jacobian()
    }
    fn jacobian_entries(&mut self, s: f64, x: &[f64], entries: &mut [f64]) -> CallResult<bool> {
        let known = self.system.jacobian_entries(turned(s), x, entries)?;
        negate(entries);
        Ok(known)
    }
    fn jacobian(&mut self, s: f64, x: &[f64], j: &mut [f64]) -> CallResult<bool> {
        let known = self.system.jacobian(turned(s), x, j)?;
        negate(j);
        Ok(known)
    }
    fn directional_derivative(
        &mut self,
        s: f64,
        x: &[f64],
        seed: &[f64],
        derivative: &mut [f64],
    ) -> CallResult<bool> {
        let known = self.system.directional_derivative(turned(s), x, seed, derivative)?;
        negate(derivative);
        Ok(known)
    }
    fn mass_matrix(&self) -> Option<&[f64]> {
        self.system.mass_matrix()
    }
    fn has_residual(&self) -> bool {
        self.system.has_residual()
    }
    fn slopes_at_start(&mut self, dx: &mut [f64]) {
        self.system.slopes_at_start(dx);
        negate(dx);
    }
    fn residual(&mut self, s: f64, x: &[f64], dx: &[f64], r: &mut [f64]) -> CallResult<()> {
        self.turn_slopes(dx);
        self.system.residual(turned(s), x, self.slopes, r)
    }
    fn residual_jacobian(
        &mut self,
        s: f64,
        x: &[f64],
        dx: &[f64],
        argument: Argument,
        j: &mut [f64],
    ) -> CallResult<bool> {
        self.turn_slopes(dx);
        let known = self.system.residual_jacobian(turned(s), x, self.slopes, argument, j)?;
        if argument == Argument::Slopes {
            negate(j);
        }
        Ok(known)
    }
    fn states_corrected(&mut self, s: f64, x: &[f64]) -> CallResult<()> {
        self.system.states_corrected(turned(s), x)
    }
    fn event_indicators(&mut self, s: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        self.system.event_indicators(turned(s), x, z)
    }
    fn outputs(&mut self, s: f64, x: &[f64], y: &mut [f64]) -> CallResult<()> {
        self.system.outputs(turned(s), x, y)
    }
    fn step_completed(&mut self, s: f64, x: &[f64]) -> CallResult<StepAction> {
        self.system.step_completed(turned(s), x)
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let visit = EventVisit { time: turned(visit.time), ..*visit };
        self.system.handle_event(&visit, x).map(outcome)
    }
}

/// An observer that is shown the time of the system.
pub(super) struct BackwardObserver<'a, O: ?Sized>(pub(super) &'a mut O);

impl<O: Observer + ?Sized> Observer for BackwardObserver<'_, O> {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        self.0.sample(&Sample { time: turned(sample.time), ..*sample })
    }
    fn wants_steps(&self) -> bool {
        self.0.wants_steps()
    }
    fn step(&mut self, step: &StepView<'_>) {
        let inside = |t: f64, x: &mut [f64]| step.states_at(turned(t), x);
        self.0.step(&StepView::new(turned(step.start), turned(step.end), &inside));
    }
    fn event(&mut self, event: &EventRecord) {
        self.0.event(&EventRecord { time: turned(event.time), ..*event });
    }
    fn poll(&mut self) -> ControlFlow<()> {
        self.0.poll()
    }
}

/// A report, or an error, with the time of the system.
pub(super) fn turned_end(
    mut ended: Result<Report, Box<SimulationError>>,
) -> Result<Report, Box<SimulationError>> {
    let turn = |time: &mut f64| *time = turned(*time);
    match &mut ended {
        Ok(report) => turn(&mut report.time),
        Err(error) => {
            turn(&mut error.time);
            error.last_event.iter_mut().for_each(turn);
            error.not_finite.iter_mut().for_each(|value| turn(&mut value.time));
            match &mut error.kind {
                ErrorKind::Span { start, end } => [start, end].into_iter().for_each(turn),
                ErrorKind::SampleTimes { time, .. } | ErrorKind::EventInThePast(time) => turn(time),
                _ => {}
            }
        }
    }
    ended
}
