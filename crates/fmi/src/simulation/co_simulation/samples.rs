//! Samples of a co-simulation: outputs of the model at communication points, interpolated values between two
//! points.

use super::run::{Exit, Run, Step, StepSide};
use super::state::{Call, CoSimulationState};
use crate::simulation::running::Running;
use crate::sys::Fault;
use ode::{Observer, Sample, Side, Termination};
use std::ops::ControlFlow;

impl Run<'_, '_> {
    /// Reads the outputs at the current time of the model.
    pub(super) fn read(&mut self, place: StepSide) -> Step<()> {
        self.timed(Call::Outputs, |run| run.read_into(place))
    }

    fn read_into(&mut self, place: StepSide) -> Step<()> {
        let time = self.t;
        let CoSimulationState { running: Running { current, buffers, .. }, before, after, .. } =
            &mut *self.stepping;
        let outputs = self.plan.outputs();
        current.core()?.call(|raw| buffers.read(outputs, raw))?;
        let row = match place {
            StepSide::Before => before,
            StepSide::After => after,
        };
        buffers.row(outputs, time, self.plan.time_tolerance, &[], row);
        Ok(())
    }

    /// True if the next requested time is listed twice.
    fn twice(&self) -> bool {
        let times = &self.plan.times;
        times.get(self.next_row + 1).is_some_and(|next| *next == times[self.next_row])
    }

    fn is_here(&self) -> bool {
        self.plan.times.get(self.next_row).is_some_and(|row| *row <= self.t + self.plan.time_tolerance)
    }

    /// Reads the derivatives of outputs at the end of a step, if the FMU supports them.
    pub(super) fn read_slopes(&mut self) -> Step<()> {
        let references = &self.plan.outputs().smooth.1;
        let CoSimulationState { running, ends, .. } = &mut *self.stepping;
        ends.clear();
        if !self.communication.output_derivatives || references.is_empty() {
            return Ok(());
        }
        let core = running.current.core()?;
        ends.resize(references.len(), 0.0);
        match core.raw.get_output_derivatives(references, ends) {
            Ok(()) => {}
            // The call is declared but not available, so no derivatives are used.
            Err(Fault::Missing(_) | Fault::Discard(_)) => ends.clear(),
            Err(fault) => return Err(core.error(fault).into()),
        }
        if ends.iter().any(|slope| !slope.is_finite()) {
            ends.clear();
        }
        Ok(())
    }

    /// Delivers samples between the current time and `end`. Discrete variables are held, continuous ones are
    /// interpolated linearly. If the derivative at the end is known, a parabola with this derivative is used.
    /// The derivative at the start is not used, because it may change if the inputs jump there.
    pub(super) fn sample_inside(&mut self, end: f64) -> Step<()> {
        while let Some(time) = self.row_before(end) {
            self.outside.check()?;
            let theta = (time - self.t) / (end - self.t);
            let CoSimulationState { before, after, between, .. } = &mut *self.stepping;
            for (i, value) in between.iter_mut().enumerate() {
                let outputs = self.plan.outputs();
                if outputs.is_tick(i) {
                    *value = 0.0;
                    continue;
                }
                *value = match (outputs.is_time(i), outputs.is_continuous(i)) {
                    (true, _) => time,
                    (_, true) => before[i] + theta * (after[i] - before[i]),
                    (_, false) => before[i],
                };
            }
            let CoSimulationState { before, after, between, ends, .. } = &mut *self.stepping;
            for (column, slope) in self.plan.outputs().smooth.0.iter().zip(ends.iter()) {
                let (rise, back) = (slope * (end - self.t), theta - 1.0);
                let bend = before[*column] - after[*column] + rise;
                between[*column] = after[*column] + back * (rise + back * bend);
            }
            let row = std::mem::take(&mut self.stepping.between);
            let flow = self.deliver(&row);
            self.stepping.between = row;
            flow?;
        }
        Ok(())
    }

    /// Delivers the limit from the left if it is requested.
    pub(super) fn sample_left(&mut self) -> Step<()> {
        if self.is_here() && self.twice() {
            self.read(StepSide::After)?;
            self.deliver_after()?;
        }
        Ok(())
    }

    /// Delivers all remaining samples at this point.
    pub(super) fn sample_here(&mut self) -> Step<()> {
        if !self.is_here() {
            return Ok(());
        }
        self.read(StepSide::After)?;
        while self.is_here() {
            self.deliver_after()?;
        }
        Ok(())
    }

    fn deliver_after(&mut self) -> Step<()> {
        let row = std::mem::take(&mut self.stepping.after);
        let flow = self.deliver(&row);
        self.stepping.after = row;
        flow
    }

    /// Passes the next row to the observer.
    fn deliver(&mut self, outputs: &[f64]) -> Step<()> {
        let index = self.next_row;
        let side = if self.twice() { Side::Left } else { Side::Right };
        self.next_row += 1;
        self.stats.samples += 1;
        let sample = Sample { time: self.plan.times[index], index: Some(index), side, states: &[], outputs };
        let mut observer = self.outside;
        match observer.sample(&sample) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Exit::Normal(Termination::StoppedByObserver)),
        }
    }
}
