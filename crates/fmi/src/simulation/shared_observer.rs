//! External reasons to end a run: the observer, the cancellation flag and the wall-clock time limit.

use ode::{
    CallResult, EndConditions, EventRecord, Observer, Options, Sample, StepOutputs, StepView, Stopped,
};
use std::cell::RefCell;
use std::fmt;
use std::ops::ControlFlow;

/// Observer of a run with the cancellation flag and the time limit. The engine that makes the steps and the
/// model's event iterations share it.
pub(crate) struct SharedObserver<'a> {
    observer: RefCell<&'a mut dyn Observer>,
    watch: EndConditions<'a>,
}

impl<'a> SharedObserver<'a> {
    /// Creates the observer of a run with these options that starts now.
    pub(crate) fn new(options: &'a Options, observer: &'a mut dyn Observer) -> Self {
        Self { observer: RefCell::new(observer), watch: EndConditions::new(options) }
    }

    /// Checks the end conditions. Callers check before each step, each round of an event iteration and each
    /// row inside a step. They also check while a step is pending. No call of the model between two checks
    /// takes long.
    ///
    /// # Errors
    /// Returns the reason if the run must end.
    pub(crate) fn check(&self) -> Result<(), Stopped> {
        if self.observer.borrow_mut().poll().is_break() {
            return Err(Stopped::ByObserver);
        }
        self.watch.check()
    }
}

impl fmt::Debug for SharedObserver<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SharedObserver").field("watch", &self.watch).finish_non_exhaustive()
    }
}

impl Observer for &SharedObserver<'_> {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        self.observer.borrow_mut().sample(sample)
    }
    fn needs_steps(&self) -> bool {
        self.observer.borrow().needs_steps()
    }
    fn step(&mut self, step: &StepView<'_>) {
        self.observer.borrow_mut().step(step);
    }
    fn needs_outputs(&self) -> bool {
        self.observer.borrow().needs_outputs()
    }
    fn outputs(&mut self, step: &mut StepOutputs<'_>) -> CallResult<()> {
        self.observer.borrow_mut().outputs(step)
    }
    fn event(&mut self, event: &EventRecord) {
        self.observer.borrow_mut().event(event);
    }
    fn poll(&mut self) -> ControlFlow<()> {
        self.observer.borrow_mut().poll()
    }
}
