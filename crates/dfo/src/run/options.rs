//! Options of a run, shared by Rust, Python, fits and files.

use crate::error::Error;
use crate::evaluation::MOST_WORKERS;
use crate::method_interface::interface::{MethodOptions, ProblemClass};
use crate::method_interface::tolerances::{Limits, Tolerances};
use crate::methods::NelderMead;
use crate::problem::constraints::Constraints;
use crate::run::checkpoint::Checkpoint;
use serde::{Deserialize, Serialize};

/// A point with its cost and the identity of its problem.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EvaluatedPoint {
    /// The point, in the user's units.
    pub x: Vec<f64>,
    /// Its cost.
    pub cost: f64,
    /// Its residuals; empty if unknown.
    pub residuals: Vec<f64>,
    /// Values of the nonlinear constraints. A run with another number of nonlinear constraints does not use
    /// the point.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub constraints: Vec<f64>,
    /// Identity of the problem that the cost belongs to. If it differs from the identity of the run, or is
    /// `None`, the point is only used as a start.
    pub problem: Option<String>,
}

/// All options of a run except its objective and its parameters. A limit of `None` means no limit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunOptions<M = NelderMead> {
    /// The method with its options; default Nelder-Mead.
    pub method: M,
    /// Reason why the method was chosen, if the user did not choose it.
    pub method_reason: Option<String>,
    /// Conditions of the tolerance tests that end a run.
    pub tolerances: Tolerances,
    /// Further limits that end the run. If none of evaluations, iterations and time is limited, the method's
    /// own limits apply.
    pub limits: Limits,
    /// True to disable the method's own limits if no limit is set.
    pub unlimited: bool,
    /// Number of evaluations that may run at once. The result does not depend on it.
    pub workers: Option<usize>,
    /// Seed of the random numbers, for methods that draw random numbers. By default, a seed is drawn and
    /// reported.
    pub seed: Option<u64>,
    /// Number of evaluations to remember, so that exact repeats cost nothing; default: chosen by the method.
    pub cache: Option<usize>,
    /// Number of evaluations to keep in the trace; only the last ones are kept. Default all.
    pub trace_limit: Option<usize>,
    /// True to keep residuals in the trace, for the points at which the method requested them.
    pub trace_residuals: bool,
    /// File to which the state of the run is written, and from which the run continues.
    pub checkpoint: Option<Checkpoint>,
    /// Identity of the problem: a word or a hash that the caller vouches for. It must represent everything
    /// that a cost depends on except the point: model, data and settings, but neither bounds nor start. Costs
    /// from other runs are used only if they belong to the same problem. A checkpoint of another problem is
    /// rejected.
    pub problem: Option<String>,
    /// Evaluated points from earlier runs.
    #[serde(rename = "known")]
    pub evaluated: Vec<EvaluatedPoint>,
    /// Linear constraints, and limits of the nonlinear ones.
    #[serde(skip_serializing_if = "Constraints::is_empty")]
    pub constraints: Constraints,
}

impl<M> RunOptions<M> {
    /// Returns these options with another method.
    pub fn with_method<N>(self, method: N) -> RunOptions<N> {
        let Self { tolerances, limits, unlimited, workers, seed, cache, .. } = self;
        let Self { trace_limit, trace_residuals, checkpoint, problem, evaluated, constraints, .. } = self;
        RunOptions {
            method,
            method_reason: None,
            tolerances,
            limits,
            unlimited,
            workers,
            seed,
            cache,
            trace_limit,
            trace_residuals,
            checkpoint,
            problem,
            evaluated,
            constraints,
        }
    }

    /// Chooses the method for a problem of this class, if the user left the choice open.
    ///
    /// # Errors
    /// Returns an error if no method supports the requested search, or if the chosen method does not have the
    /// given options.
    pub fn choose(&mut self, class: &ProblemClass<'_>) -> Result<(), Error>
    where
        M: MethodOptions,
    {
        if let Some((method, reason)) = self.method.chosen(class)? {
            (self.method, self.method_reason) = (method, Some(reason));
        }
        Ok(())
    }

    /// Checks the options that do not depend on the problem.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.limits.check()?;
        match self.workers {
            Some(workers) if !(1..=MOST_WORKERS).contains(&workers) => {
                let range = "at least 1, and at most 32768";
                Err(Error::Option { name: "workers", value: workers as f64, range })
            }
            _ => Ok(()),
        }
    }
}
