//! Options of a run: one record for Rust, Python, fits and files.

use crate::error::Error;
use crate::evaluation::MOST_WORKERS;
use crate::method_interface::interface::{MethodOptions, ProblemClass};
use crate::method_interface::tolerances::{Limits, Tolerances};
use crate::methods::NelderMead;
use crate::run::checkpoint::Checkpoint;
use serde::{Deserialize, Serialize};

/// A point with its cost, and the problem that they belong to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct KnownPoint {
    /// The point, in the user's units.
    pub x: Vec<f64>,
    /// Its cost.
    pub cost: f64,
    /// Its residuals; empty where they are not known.
    pub residuals: Vec<f64>,
    /// Problem that the cost belongs to; if it is not that of the run, or `None`, the point is only a start.
    pub problem: Option<String>,
}

/// All that may be chosen about a run but its objective and the parameters that it searches. No limit is
/// `None`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunOptions<M = NelderMead> {
    /// The method with its options; default Nelder-Mead.
    pub method: M,
    /// Why it was chosen, where the user left it open.
    pub method_reason: Option<String>,
    /// When the tests pass that end a run.
    pub tolerances: Tolerances,
    /// Further limits that end the run. Without a limit of evaluations, iterations or time the method's own
    /// hold.
    pub limits: Limits,
    /// Where no limit is set, none holds: not even the method's own.
    pub unlimited: bool,
    /// Evaluations that may run at once. The result does not depend on it.
    pub workers: Option<usize>,
    /// Seed of the random numbers, for methods that draw them; default: drawn, and reported.
    pub seed: Option<u64>,
    /// Number of evaluations to remember, so that exact repeats cost nothing; default: the method's.
    pub cache: Option<usize>,
    /// Keeps only the last so many evaluations in the trace; default all.
    pub trace_limit: Option<usize>,
    /// Keeps residuals in the trace, where the method wanted them.
    pub trace_residuals: bool,
    /// Where the state of the run is written, and continued from.
    pub checkpoint: Option<Checkpoint>,
    /// Identity of the problem, a word or a hash that the caller vouches for: it stands for everything that a
    /// cost depends on but the point (model, data, settings), neither bounds nor start. Costs that are known
    /// from elsewhere are only used where they belong to the same problem; a checkpoint of another one is
    /// refused.
    pub problem: Option<String>,
    /// Points that are known from earlier runs.
    pub known: Vec<KnownPoint>,
}

impl<M> RunOptions<M> {
    /// The same for another method.
    pub fn with_method<N>(self, method: N) -> RunOptions<N> {
        let Self { tolerances, limits, unlimited, workers, seed, cache, .. } = self;
        let Self { trace_limit, trace_residuals, checkpoint, problem, known, .. } = self;
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
            known,
        }
    }

    /// Chooses the method for a problem of this class, where the choice is open.
    ///
    /// # Errors
    /// There is none for the search that is asked for, or it does not have the options that were given.
    pub fn choose(&mut self, class: &ProblemClass<'_>) -> Result<(), Error>
    where
        M: MethodOptions,
    {
        if let Some((method, reason)) = self.method.chosen(class)? {
            (self.method, self.method_reason) = (method, Some(reason));
        }
        Ok(())
    }

    /// Checks what does not depend on the problem.
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
