//! Runs backward in time, integrated with the time `s = -t`: conversion of observer reports and results.

use crate::error::{ErrorKind, Report, SimulationError};
use crate::observer::{EventRecord, Observer, Sample, StepOutputs, StepView};
use crate::system::CallResult;
use std::ops::ControlFlow;

/// Reverses a time. Never returns a negative zero.
pub(super) fn turned(time: f64) -> f64 {
    0.0 - time
}

pub(super) fn negate(values: &mut [f64]) {
    values.iter_mut().for_each(|v| *v = -*v);
}

/// Observer wrapper that converts to the time of the system.
pub(super) struct BackwardObserver<'a>(pub(super) &'a mut dyn Observer);

impl Observer for BackwardObserver<'_> {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        self.0.sample(&Sample { time: turned(sample.time), ..*sample })
    }
    fn needs_steps(&self) -> bool {
        self.0.needs_steps()
    }
    fn step(&mut self, step: &StepView<'_>) {
        let inside = |t: f64, x: &mut [f64]| step.states_at(turned(t), x);
        self.0.step(&StepView::new(turned(step.start), turned(step.end), &inside));
    }
    fn needs_outputs(&self) -> bool {
        self.0.needs_outputs()
    }
    fn outputs(&mut self, step: &mut StepOutputs<'_>) -> CallResult<()> {
        let (span, is_ordered) = ((turned(step.start), turned(step.end)), step.is_ordered);
        let mut inside = |t: f64, outputs: &mut [f64]| step.outputs_at(turned(t), outputs);
        self.0.outputs(&mut StepOutputs::new(span, is_ordered, &mut inside))
    }
    fn event(&mut self, event: &EventRecord) {
        self.0.event(&EventRecord { time: turned(event.time), ..*event });
    }
    fn poll(&mut self) -> ControlFlow<()> {
        self.0.poll()
    }
}

/// Converts a report or an error to the time of the system.
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
