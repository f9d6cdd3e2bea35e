//! A method that evaluates a list of points. A run with it has the workers, limits, interrupts and
//! checkpoints of every other run.

use crate::error::Error;
use crate::method_interface::interface::{
    Batch, Method, MethodDetails, MethodOptions, Setup, Status, restored, saved,
};
use crate::outcome::answer::{Answers, EvaluationKind, Outcome};
use crate::outcome::termination::Termination;
use std::sync::Arc;

/// Number of points requested at once. A run that ends cancels the points of its batch one by one, and the
/// evaluator searches all of them each time. With a time limit of 0.3 s, a run of 32 768 points of 0.2 ms on
/// two workers ended after 5.0 s with a single batch, and after 0.3 s with this size.
const BATCH: usize = 1024;

/// Evaluates a list of points, whose values are the residuals, without a search. The values are in the trace
/// of the run.
#[derive(Debug, Clone, PartialEq)]
pub struct ListedPoints {
    points: Arc<[f64]>,
    n: usize,
    /// Number of points evaluated.
    n_evaluated: usize,
    n_batches: usize,
}

impl ListedPoints {
    /// Creates the list from the coordinates of points of length `n`, one after the other, in the user's
    /// units.
    pub fn new(points: Vec<f64>, n: usize) -> Self {
        Self { points: points.into(), n, n_evaluated: 0, n_batches: 0 }
    }

    fn points(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.points.chunks_exact(self.n)
    }
}

impl MethodOptions for ListedPoints {
    type Method = Self;

    fn begin(&self, setup: &Setup) -> Result<Self, Error> {
        match self.points().find(|x| !setup.space.bounds().contains(x)) {
            Some(x) => {
                let range = "the number of bounds, and every point within the bounds";
                Err(Error::Option { name: "length of a point", value: x.len() as f64, range })
            }
            None => Ok(self.clone()),
        }
    }

    fn restore(&self, _: &Setup, state: &[u8]) -> Result<Self, Error> {
        let is_sound = |state: &(usize, usize)| state.0 <= self.points().len() && state.1 <= state.0;
        let (n_evaluated, n_batches) = restored(state, is_sound)?;
        Ok(Self { n_evaluated, n_batches, ..self.clone() })
    }

    fn needs_start(&self) -> bool {
        false
    }

    fn needs_residuals(&self) -> bool {
        true
    }

    fn describe(&self) -> Vec<(String, String)> {
        let bytes: Vec<u8> = self.points.iter().flat_map(|value| value.to_bits().to_le_bytes()).collect();
        let text = format!("{} points with checksum {:08x}", self.points().len(), crc32fast::hash(&bytes));
        vec![("points".to_owned(), text)]
    }

    fn default_limits(&self, _: usize) -> (Option<usize>, Option<usize>) {
        (None, None)
    }
}

impl Method for ListedPoints {
    fn name(&self) -> &'static str {
        "listed points"
    }

    fn ask(&mut self, batch: &mut Batch) {
        batch.start(self.n, self.n_batches as u64, self.n_evaluated as u64);
        batch.set_kind(EvaluationKind::Residuals);
        self.points().skip(self.n_evaluated).take(BATCH).for_each(|x| batch.push(x, f64::INFINITY));
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        let requested = (self.points().len() - self.n_evaluated).min(BATCH);
        let outcomes = answers.outcomes();
        // Skipped points are requested again.
        if outcomes.len() == requested && outcomes.iter().all(|outcome| *outcome != Outcome::Skipped) {
            self.n_evaluated += requested;
            self.n_batches += 1;
        }
        Ok(())
    }

    fn status(&self) -> Status {
        let is_done = self.n_evaluated == self.points().len();
        if is_done { Status::Ended(Termination::Converged) } else { Status::Running }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        None
    }

    fn details(&self) -> MethodDetails<'_> {
        MethodDetails { n_iterations: self.n_batches, plan: "listed", ..MethodDetails::default() }
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(&(self.n_evaluated, self.n_batches))
    }
}
