//! Progress of a run: one report per iteration, on the calling thread. The callback may stop the run.

use crate::method_interface::interface::{Operation, SimplexView};
use crate::method_interface::tolerances::ToleranceTests;
use crate::outcome::pareto_front::ParetoFront;
use crate::outcome::trace::{Trace, TraceEntry};

/// State of a run after an iteration. Iteration 0 evaluates the starting points.
#[derive(Debug, Clone, Copy)]
pub struct Progress<'a> {
    /// Complete iterations.
    pub n_iterations: usize,
    /// Evaluations of the path so far.
    pub n_evaluations: usize,
    /// Additional calls of the objective so far, made speculatively.
    pub n_speculative: usize,
    /// Failed evaluations so far.
    pub n_failed: usize,
    /// Best point so far, in the user's units. With several criteria, the compromise of the front.
    pub x: &'a [f64],
    /// Its cost. With several criteria, see [`ParetoFront::compromise`].
    pub fun: f64,
    /// Operation of this iteration.
    pub operation: Operation,
    /// The simplex, for methods that have one.
    pub simplex: Option<SimplexView<'a>>,
    /// The population, for methods that have one.
    pub population: Option<SimplexView<'a>>,
    /// The Pareto front, for methods with several criteria.
    pub front: Option<&'a ParetoFront>,
    /// The tolerance tests; `None` before the first iteration.
    pub tests: Option<ToleranceTests>,
    /// Seconds since the start.
    pub seconds: f64,
    pub(crate) trace: &'a Trace,
    pub(crate) first_recent: usize,
}

impl<'a> Progress<'a> {
    /// Returns the evaluations since the last report.
    pub fn recent(&self) -> impl DoubleEndedIterator<Item = TraceEntry<'a>> + ExactSizeIterator {
        self.trace.iter_from(self.first_recent)
    }

    /// Returns all evaluations so far.
    pub fn trace(&self) -> &'a Trace {
        self.trace
    }
}
