//! Reading of the recorded variables in model exchange: when an FMU computes them, and what makes them those
//! of the point.

use crate::error::FmiError;
use crate::simulation::running::{Mode, Running};
use crate::sys::RawInstance;
use ode::{CallError, CallResult, StepAction};

/// Samples at which a model has to answer the same with and without the derivatives computed before, while
/// something has changed since the sample before, to be trusted in the rest of the run.
const GOOD_SAMPLES: u32 = 8;

/// Ends of steps at which variables have to be the same before and after, while they change. One that did not
/// change then is looked at again from the row on at which it does.
const GOOD_STEPS: u32 = 3;

/// Time at which the model computes its variables: when they are read, as the standard demands, or only
/// together with the derivatives. In the latter case the derivatives are computed before (seen in FMUs of
/// OpenModelica 1.12). Determined anew in every run, from its own first samples, which are right in any case,
/// and where a variable moves later on; a run that finds it out then is made again, and those after it begin
/// so.
#[derive(Debug, Clone, Copy)]
enum Freshness {
    /// So many samples went well.
    Open(u32),
    WhenRead,
    WithDerivatives,
}

/// Points at which variables can be read: anywhere, as the standard demands, or only where a step was
/// completed (seen in FMUs of OpenModelica 1.12). In the latter case a step is completed at every row: the
/// rows of a step are in the order of time, and before its end. A run that finds it out has rows that may be
/// wrong, and ends.
#[derive(Debug, Clone, Copy)]
enum RowPoints {
    /// So many ends of steps went well.
    Open(u32),
    /// Anywhere for all variables but those that have not changed at so many ends of steps.
    Watched,
    Any,
    CompletedSteps,
}

impl Default for Freshness {
    fn default() -> Self {
        Freshness::Open(0)
    }
}

/// Reads the variables that are recorded, at the point last set.
#[derive(Debug)]
pub(crate) struct OutputReader {
    freshness: Freshness,
    row_points: RowPoints,
    /// The numbers that have to change at more ends of steps, and at how many they have.
    unseen: Vec<(usize, u32)>,
    /// Which of these have changed at the end of this step.
    moved: Vec<bool>,
    /// One of these has changed since it was last compared.
    has_moved: bool,
    /// Events so far.
    n_events: u64,
    /// The event indicators when a step was completed last, and before and after that of this one.
    indicators: [Vec<f64>; 3],
    /// Steps at whose end they were those of the step before until it was completed.
    n_late_indicators: u32,
    /// The answers to steps completed at rows, for the end of the step.
    row_actions: StepAction,
    /// The derivatives were computed at the point last set.
    pub(crate) is_evaluated: bool,
    /// Derivatives that nobody asked for.
    unused: Vec<f64>,
}

impl OutputReader {
    pub(crate) fn new(n_states: usize, n_indicators: usize) -> Self {
        Self {
            freshness: Freshness::default(),
            row_points: RowPoints::Open(0),
            unseen: Vec::new(),
            moved: Vec::new(),
            has_moved: false,
            n_events: 0,
            indicators: std::array::from_fn(|_| vec![f64::NAN; n_indicators]),
            n_late_indicators: 0,
            row_actions: StepAction::default(),
            is_evaluated: false,
            unused: vec![0.0; n_states],
        }
    }

    /// A run begins.
    pub(crate) fn begin(&mut self, running: &Running) {
        let before = running.plan.fmu().before_reading();
        self.freshness = match before.derivatives {
            true => Freshness::WithDerivatives,
            false => Freshness::default(),
        };
        self.n_events = 0;
        self.n_late_indicators = 0;
        self.indicators[0].fill(f64::NAN);
        self.row_actions = StepAction::default();
        self.row_points = match before.step_completed {
            true => RowPoints::CompletedSteps,
            false => RowPoints::Open(0),
        };
        self.unseen.clear();
        self.unseen.extend((0..running.buffers.n_numbers()).map(|number| (number, 0)));
        self.has_moved = false;
    }

    /// Computes the derivatives, for what the model computes along with them. A point without derivatives is
    /// none to compare at.
    pub(crate) fn evaluate(&mut self, running: &mut Running) -> CallResult<()> {
        let unused = &mut self.unused;
        match running.current.call(|raw| raw.get_derivatives(unused)) {
            Ok(()) | Err(CallError::Discard) => {
                self.is_evaluated = true;
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    /// Reads the outputs.
    pub(crate) fn read(&mut self, running: &mut Running) -> CallResult<()> {
        if running.current.mode != Mode::Continuous || self.unused.is_empty() {
            return running.read_outputs();
        }
        if matches!(self.row_points, RowPoints::CompletedSteps) {
            let action = completed(running)?;
            self.row_actions.event |= action.event;
            self.row_actions.terminate |= action.terminate;
        }
        let is_watched = matches!(self.row_points, RowPoints::Open(_) | RowPoints::Watched)
            && running.plan.outputs().needs_fmu();
        if is_watched {
            running.buffers.keep();
        }
        match self.freshness {
            _ if self.is_evaluated => running.read_outputs()?,
            Freshness::WhenRead => running.read_outputs()?,
            Freshness::WithDerivatives => {
                self.evaluate(running)?;
                running.read_outputs()?;
            }
            Freshness::Open(good) => return self.compare(running, good),
        }
        if is_watched && self.watch(running) && !self.is_evaluated {
            self.note_moved(running);
            self.evaluate(running)?;
            // Rows before this one may have been read too early.
            if reads_other(running)? {
                running.plan.fmu().note_outputs_of_derivatives();
                return Err(CallError::failed(FmiError::ReadBetweenSteps));
            }
            // Without completed steps there is nothing else to be late for.
            if running.plan.completed_step_not_needed {
                self.trust_moved();
                if self.unseen.is_empty() {
                    self.row_points = RowPoints::Any;
                }
            }
        }
        Ok(())
    }

    /// Notes if a variable has changed that is not known to be the same before and after the end of a step.
    fn watch(&mut self, running: &Running) -> bool {
        let moves = self.unseen.iter().any(|(number, _)| !running.buffers.is_as_kept(*number));
        self.has_moved |= moves;
        moves
    }

    /// Notes which variables have changed that are not known to be right.
    fn note_moved(&mut self, running: &Running) {
        self.moved.clear();
        self.moved.extend(self.unseen.iter().map(|(number, _)| !running.buffers.is_as_kept(*number)));
    }

    /// These were right, and are known to be after a few times.
    fn trust_moved(&mut self) {
        self.unseen.iter_mut().zip(&self.moved).for_each(|((_, times), moved)| *times += u32::from(*moved));
        self.unseen.retain(|(_, times)| *times < GOOD_STEPS);
    }

    /// True if a variable has changed in rows and was not compared since: rows of a run that ends here may be
    /// wrong.
    pub(crate) fn has_unchecked_rows(&self, running: &Running) -> bool {
        self.has_moved
            && !running.plan.completed_step_not_needed
            && matches!(self.row_points, RowPoints::Open(_) | RowPoints::Watched)
    }

    /// An event has happened: a model may compute its variables in another way from now on. They are looked
    /// at again where they move next, after the first, second, fourth, eighth ... event.
    pub(crate) fn after_event(&mut self, running: &Running) {
        self.n_events += 1;
        self.indicators[0].fill(f64::NAN);
        if self.n_events.is_power_of_two() && matches!(self.row_points, RowPoints::Any | RowPoints::Watched) {
            self.row_points = RowPoints::Watched;
            self.unseen.clear();
            self.unseen.extend((0..running.buffers.n_numbers()).map(|number| (number, GOOD_STEPS - 1)));
        }
    }

    /// Reads the outputs, computes the derivatives and reads them again.
    fn compare(&mut self, running: &mut Running, good: u32) -> CallResult<()> {
        let has_changed = reads_other(running)?;
        self.watch(running);
        self.evaluate(running)?;
        if reads_other(running)? {
            self.freshness = Freshness::WithDerivatives;
            running.plan.fmu().note_stale_outputs();
        } else if has_changed {
            self.freshness =
                if good + 1 < GOOD_SAMPLES { Freshness::Open(good + 1) } else { Freshness::WhenRead };
        }
        Ok(())
    }

    /// Completes a step. While it is open where variables can be read, they are read before and after.
    pub(crate) fn complete_step(&mut self, running: &mut Running) -> CallResult<StepAction> {
        let at_rows = std::mem::take(&mut self.row_actions);
        let action = match self.row_points {
            RowPoints::Open(good) if running.plan.outputs().needs_fmu() && !self.unused.is_empty() => {
                self.has_moved = false;
                self.complete_and_compare(running, good)?
            }
            RowPoints::Watched if std::mem::take(&mut self.has_moved) => {
                self.complete_and_compare(running, GOOD_STEPS)?
            }
            _ => completed(running)?,
        };
        Ok(StepAction {
            event: action.event | at_rows.event,
            terminate: action.terminate | at_rows.terminate,
        })
    }

    fn complete_and_compare(&mut self, running: &mut Running, good: u32) -> CallResult<StepAction> {
        if !self.is_evaluated {
            self.evaluate(running)?;
        }
        let has_changed = compared(reads_other(running))?;
        self.note_moved(running);
        let before = self.read_indicators(running, 1);
        let action = completed(running)?;
        if before && !action.event && self.read_indicators(running, 2) {
            self.compare_indicators(running);
        }
        if action.event || action.terminate || has_changed.is_none() {
            self.has_moved = true;
            return Ok(action);
        }
        let Some(is_other) = compared(reads_other(running))? else { return Ok(action) };
        if is_other {
            running.plan.fmu().note_outputs_of_steps();
            return Err(CallError::failed(FmiError::ReadBetweenSteps));
        }
        if has_changed == Some(true) {
            self.trust_moved();
            self.row_points = match (good + 1 < GOOD_STEPS, self.unseen.is_empty()) {
                (true, _) => RowPoints::Open(good + 1),
                (false, true) => RowPoints::Any,
                (false, false) => RowPoints::Watched,
            };
        }
        Ok(action)
    }
}

impl OutputReader {
    /// Reads the event indicators; false if there are none to be had.
    fn read_indicators(&mut self, running: &mut Running, which: usize) -> bool {
        let indicators = &mut self.indicators[which];
        !indicators.is_empty() && running.current.call(|raw| raw.get_event_indicators(indicators)).is_ok()
    }

    /// Notes a model whose indicators at the end of a step are those of the step before until it is
    /// completed.
    fn compare_indicators(&mut self, running: &Running) {
        let [last, before, after] = &self.indicators;
        let is_late = |((last, before), after): ((&f64, &f64), &f64)| before == last && after != before;
        if last.iter().zip(before).zip(after).any(is_late) {
            self.n_late_indicators += 1;
            if self.n_late_indicators == GOOD_STEPS - 1 {
                running.plan.fmu().note_late_indicators();
            }
        }
        self.indicators.swap(0, 2);
    }
}

/// Reads the outputs; true if they are not what was read before.
fn reads_other(running: &mut Running) -> CallResult<bool> {
    running.buffers.keep();
    running.read_outputs()?;
    Ok(!running.buffers.are_as_kept())
}

/// What was read for comparison alone; nothing where the model has no values.
fn compared(read: CallResult<bool>) -> CallResult<Option<bool>> {
    match read {
        Ok(other) => Ok(Some(other)),
        Err(CallError::Discard) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Tells the model that a step is completed.
fn completed(running: &mut Running) -> CallResult<StepAction> {
    let (event, terminate) = running.current.call(RawInstance::completed_integrator_step)?;
    Ok(StepAction { event, terminate })
}
