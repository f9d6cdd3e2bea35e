//! The samples of a co-simulation: at communication points as the model gives them, between two of them
//! interpolated.

use super::run::{Exit, Run, Step, StepSide};
use super::state::{Call, CoSimulationState};
use crate::simulation::running::Running;
use crate::sys::Fault;
use ode::{Observer, Sample, Side, Termination};
use std::ops::ControlFlow;

impl Run<'_, '_> {
    /// Reads the outputs where the model stands.
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

    /// True if the next requested time is listed once more.
    fn twice(&self) -> bool {
        let times = &self.plan.times;
        times.get(self.next_row + 1).is_some_and(|next| *next == times[self.next_row])
    }

    fn is_here(&self) -> bool {
        self.plan.times.get(self.next_row).is_some_and(|row| *row <= self.t + self.plan.time_tolerance)
    }

    /// Reads the derivatives of outputs at the end of a step, if the FMU offers them.
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
            // Offered, but not there: then without them.
            Err(Fault::Missing(_) | Fault::Discard(_)) => ends.clear(),
            Err(fault) => return Err(core.error(fault).into()),
        }
        if ends.iter().any(|slope| !slope.is_finite()) {
            ends.clear();
        }
        Ok(())
    }

    /// Samples between here and `end`: held where the variable is not continuous, else linear, or where the
    /// derivative at the end is known the parabola that has it (that at the start may be another one, if the
    /// inputs jump there).
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

    /// The limit from the left, where it is wanted.
    pub(super) fn sample_left(&mut self) -> Step<()> {
        if self.is_here() && self.twice() {
            self.read(StepSide::After)?;
            self.deliver_after()?;
        }
        Ok(())
    }

    /// All samples still due at this point.
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

    /// Hands the next row to the observer.
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
