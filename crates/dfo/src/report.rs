//! The result of a run: the best point, what it cost, and why the run ended.

use crate::barrier::BarrierStage;
use crate::method::Simplex;
use crate::termination::{Termination, Tests};
use crate::trace::Trace;
use std::fmt;

/// The result of a run. `Display` prints a summary for people.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Report {
    /// The best point (user's units, user's order).
    pub x: Vec<f64>,
    /// Its cost: the smallest of all used points.
    pub fun: f64,
    /// Calls of the objective, every one.
    pub n_evaluations: usize,
    /// Complete iterations.
    pub n_iterations: usize,
    /// Rounds: batches evaluated.
    pub n_batches: usize,
    /// Failed evaluations.
    pub n_failed: usize,
    /// Evaluations made ahead that turned out not to be needed.
    pub n_speculative: usize,
    /// Why the run ended.
    pub termination: Termination,
    /// The same in a sentence, with the test that fired and its values.
    pub message: String,
    /// The last values of the tolerance tests.
    pub tests: Option<Tests>,
    /// Every evaluation in request order.
    pub trace: Trace,
    /// The simplex at the end, for methods that have one.
    pub final_simplex: Option<Simplex>,
    /// Reasons of the failures with their counts, most frequent first.
    pub failures: Vec<(String, usize)>,
    /// Name of the method.
    pub method: &'static str,
    /// Batch plan of the method.
    pub batch: &'static str,
    /// Evaluations that could run at once.
    pub workers: usize,
    /// The stages of a sequential barrier search: barrier parameter, barrier, point and cost of each.
    pub schedule: Vec<BarrierStage>,
    /// The population at the end, for methods that have one.
    pub final_population: Option<Simplex>,
    /// The seed of the random numbers, for methods that draw them: the one given, or the one drawn.
    pub seed: Option<u64>,
    /// Wall-clock seconds.
    pub seconds: f64,
}

impl Report {
    /// Whether the method came to its own end (or to the target), rather than being stopped.
    pub fn is_success(&self) -> bool {
        self.termination.is_success()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {}", self.method, self.message)?;
        writeln!(f, "  cost         {:e}", self.fun)?;
        writeln!(f, "  x            {:?}", self.x)?;
        writeln!(f, "  iterations   {}", self.n_iterations)?;
        write!(f, "  evaluations  {} in {} batches", self.n_evaluations, self.n_batches)?;
        writeln!(f, " ({} failed, {} speculative)", self.n_failed, self.n_speculative)?;
        for (reason, count) in &self.failures {
            writeln!(f, "    {count} x {reason}")?;
        }
        write!(f, "  time         {:.3} s, workers {}, batch plan {}", self.seconds, self.workers, self.batch)
    }
}
