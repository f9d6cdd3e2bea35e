//! A running method as a single type, for callers that choose the method at run time.

use crate::error::Error;
use crate::method_interface::interface::{AnswersSoFar, Batch, Method, MethodDetails, Status};
use crate::method_interface::linear_model::LinearModel;
use crate::outcome::answer::Answers;
use crate::outcome::pareto_front::ParetoFront;
use base::RunContext;
use std::fmt;

/// A running method whose type is known only at run time.
pub struct BoxedMethod(Box<dyn Method + Send>);

impl BoxedMethod {
    /// Boxes a method.
    pub fn new(method: impl Method + Send + 'static) -> Self {
        Self(Box::new(method))
    }
}

impl fmt::Debug for BoxedMethod {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("BoxedMethod").field(&self.0.name()).finish()
    }
}

impl Method for BoxedMethod {
    fn name(&self) -> &'static str {
        self.0.name()
    }
    fn ask(&mut self, batch: &mut Batch) {
        self.0.ask(batch);
    }
    fn ask_unless(&mut self, context: &RunContext<'_>, batch: &mut Batch) {
        self.0.ask_unless(context, batch);
    }
    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        self.0.tell(answers)
    }
    fn tell_last(&mut self, answers: &mut Answers) -> Result<(), Error> {
        self.0.tell_last(answers)
    }
    fn speculate(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        self.0.speculate(wanted, answers_so_far, batch);
    }
    fn status(&self) -> Status {
        self.0.status()
    }
    fn details(&self) -> MethodDetails<'_> {
        self.0.details()
    }
    fn best(&self) -> Option<(&[f64], f64)> {
        self.0.best()
    }
    fn best_violation(&self) -> f64 {
        self.0.best_violation()
    }
    fn front(&self) -> Option<ParetoFront> {
        self.0.front()
    }
    fn linear_model(&self, context: &RunContext<'_>) -> Option<LinearModel> {
        self.0.linear_model(context)
    }
    fn save(&self) -> Option<Vec<u8>> {
        self.0.save()
    }
}
