//! External reasons to end a run: the observer, the flag that cancels, the limit of wall-clock time.

use ode::{EndConditions, EventRecord, Observer, Options, Sample, StepView, Stopped};
use std::cell::RefCell;
use std::fmt;
use std::ops::ControlFlow;

/// The observer of a run, shared by whatever makes its steps and the model's event iterations, with the flag
/// and the limit of time.
pub(crate) struct SharedObserver<'a> {
    observer: RefCell<&'a mut dyn Observer>,
    watch: EndConditions<'a>,
}

impl<'a> SharedObserver<'a> {
    /// For a run with these options that begins now.
    pub(crate) fn new(options: &'a Options, observer: &'a mut dyn Observer) -> Self {
        Self { observer: RefCell::new(observer), watch: EndConditions::new(options) }
    }

    /// Looked at between two calls of the model, of which none takes long: before each step, each round of an
    /// event iteration, each row inside of a step, and while a step is pending.
    ///
    /// # Errors
    /// The run is to end, and why.
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
    fn wants_steps(&self) -> bool {
        self.observer.borrow().wants_steps()
    }
    fn step(&mut self, step: &StepView<'_>) {
        self.observer.borrow_mut().step(step);
    }
    fn event(&mut self, event: &EventRecord) {
        self.observer.borrow_mut().event(event);
    }
    fn poll(&mut self) -> ControlFlow<()> {
        self.observer.borrow_mut().poll()
    }
}
