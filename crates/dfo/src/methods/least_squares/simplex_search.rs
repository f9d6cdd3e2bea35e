//! The simplex search that takes over where points fail around the best one.

use super::points::Evaluated;
use super::state::{LeastSquaresState, Phase, simplex_method};
use crate::answer::Answers;
use crate::error::Error;
use crate::method::{Method, MethodOptions, Status};
use crate::termination::Termination;

impl LeastSquaresState {
    /// Points fail around the best one, and a model tells nothing of that: a simplex search from the start, which keeps off such
    /// places, takes over.
    pub(super) fn begin_simplex(&mut self) {
        self.phase = match simplex_method().begin(&self.setup) {
            Ok(simplex) => Phase::Simplex(Box::new(simplex)),
            Err(_) => Phase::Ended(Termination::Collapsed),
        };
    }

    /// Takes the answers to the points of the simplex search: they serve the model of the result, too.
    pub(super) fn tell_simplex(&mut self, answers: &Answers) -> Result<(), Error> {
        let Phase::Simplex(simplex) = &mut self.phase else { return Ok(()) };
        simplex.tell(answers)?;
        let status = simplex.status();
        self.n_batches += 1;
        self.n_points += self.simplex_points.len() as u64;
        for (k, x) in std::mem::take(&mut self.simplex_points).into_iter().enumerate().take(answers.len()) {
            if let Some((cost, residuals)) = answers.outcomes()[k].value().zip(answers.residuals(k)) {
                self.best_seen.offer(&x, cost);
                let mut z = vec![0.0; self.n()];
                self.setup.space.to_working(&x, &mut z);
                z.iter_mut().enumerate().for_each(|(k, z)| *z = self.scaled(k, *z));
                self.points.push(Evaluated { z, x, cost, residuals: residuals.to_vec() });
            }
        }
        if let Some(best) = self.best_of(0..self.points.len()) {
            self.set = vec![best];
        }
        self.forget();
        match status {
            Status::Running => {}
            Status::Ended(termination) => self.end(termination),
            Status::NoStart => self.end(Termination::Collapsed),
        }
        Ok(())
    }

    /// Ends, with the tests of the simplex where it was one.
    fn end(&mut self, termination: Termination) {
        if let Phase::Simplex(simplex) = &self.phase {
            let details = simplex.details();
            self.tests = details.tests;
            self.operation = details.operation;
            self.n_iterations += details.n_iterations;
        }
        self.phase = Phase::Ended(termination);
    }
}
