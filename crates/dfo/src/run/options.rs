//! Options of a run: one record for Rust, Python, fits and files.

use crate::error::Error;
use crate::evaluation::MOST_WORKERS;
use crate::method::interface::{MethodOptions, ProblemClass};
use crate::method::tolerances::{Limits, Tolerances};
use crate::methods::{AnyMethod, NelderMead};
use crate::run::checkpoint::{Checkpoint, Code, Resume};
use crate::values::choices::{Kind, Search, Transform};
use crate::values::record::{Record, RecordError, Value};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;

/// A point with its cost, and the problem that they belong to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Known {
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
    pub known: Vec<Known>,
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

/// The options of every run that are known by name beside those that all methods have.
const OF_RUN: [&str; 14] = [
    "checkpoint",
    "code",
    "max_evaluations",
    "max_fevals",
    "max_iterations",
    "max_iters",
    "max_time",
    "method",
    "resume",
    "search",
    "seed",
    "target",
    "unlimited",
    "workers",
];

/// A run and what is said of its parameters, as users ask for them by name.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AskedRun {
    /// The run.
    pub options: RunOptions<AnyMethod>,
    /// The scale of each parameter; empty: all are linear.
    pub scale: Vec<Transform>,
    /// The typical size of each parameter, where it is known.
    pub nominal: Vec<Option<f64>>,
    /// The kind of each parameter; empty: all are continuous.
    pub kinds: Vec<Kind>,
}

impl AskedRun {
    /// The names of all options that a record of a run may have, with those of any method.
    ///
    /// # Errors
    /// The options of a method cannot be serialised.
    pub fn option_names() -> Result<BTreeSet<String>, Error> {
        let mut names = AnyMethod::all_option_names()?;
        names.extend(OF_RUN.map(str::to_owned));
        Ok(names)
    }

    /// The run of a record, over `n` parameters; `options` holds where the record says nothing, or none. What
    /// every run has stands in the record beside the options of the method.
    ///
    /// # Errors
    /// An option that there is not, or a value that it cannot have.
    pub fn new(options: RunOptions<AnyMethod>, record: &Record, n: usize) -> Result<Self, Error> {
        let mut asked = Self { options, ..Self::default() };
        let mut of_method = Record::new();
        for (name, value) in record {
            let is_of_run = *value == Value::Nothing && is_of_run(name);
            if !is_of_run && !asked.set(name, value, record, n)? {
                of_method.insert(name.clone(), value.clone());
            }
        }
        if asked.options.checkpoint.is_none() {
            if record.get("resume").is_some_and(|v| v.read("resume") == Ok(Resume::Require)) {
                let message =
                    "resume='require' has no effect without a checkpoint: give its file, checkpoint=...";
                return Err(RecordError::message(message).into());
            }
            if let Some(interval) = record.get("checkpoint_interval").filter(|v| **v != Value::Nothing) {
                return Err(RecordError::without_checkpoint().of("checkpoint_interval", interval).into());
            }
        }
        let method = match record.get("method") {
            Some(method) => method.read::<String>("method")?.parse()?,
            None => asked.options.method.clone(),
        };
        let search = record.get("search").map_or(Ok(Search::Local), |search| search.read("search"))?;
        let method = match method {
            AnyMethod::Auto(_) => AnyMethod::auto(search),
            method if search == Search::Local => method,
            method => {
                let name = method.name();
                let message = format!(
                    "search='global' leaves the choice of the method to the run; with method='{name}' leave it out"
                );
                return Err(RecordError::message(message).into());
            }
        };
        asked.options.method = method.with_options(&of_method)?;
        Ok(asked)
    }

    /// Sets what is not the method's; false: it is. `record` has what belongs to it.
    fn set(&mut self, name: &str, value: &Value, record: &Record, n: usize) -> Result<bool, Error> {
        let run = &mut self.options;
        match name {
            "method" | "search" | "code" => {}
            "resume" => _ = value.read::<Resume>(name)?,
            "checkpoint_interval" => _ = value.read::<f64>(name)?,
            "x_tol" => run.tolerances.x_tol = value.read(name)?,
            "f_tol" => run.tolerances.f_tol = value.read(name)?,
            "stop" => run.tolerances.stop = value.read(name)?,
            "tolerances" => run.tolerances.measure = value.read(name)?,
            "max_evaluations" | "max_fevals" => run.limits.max_evaluations = value.read_limit(name, 1)?,
            "max_iterations" | "max_iters" => run.limits.max_iterations = value.read_limit(name, 0)?,
            "max_time" => run.limits.max_time = value.read_time(name)?,
            "target" => run.limits.target = value.read(name)?,
            "max_failed" => run.limits.max_failed = value.read(name)?,
            "unlimited" => run.unlimited = value.read(name)?,
            "workers" => run.workers = value.read(name)?,
            "seed" => run.seed = value.read(name)?,
            "cache" => run.cache = value.read_limit(name, 0)?,
            "trace_limit" => run.trace_limit = value.read_limit(name, 1)?,
            "problem" => run.problem = value.read(name)?,
            "warm_start" => run.known = value.read(name)?,
            "checkpoint" => run.checkpoint = Some(checkpoint(value.read(name)?, record)?),
            "scale" => self.scale = per_parameter(name, value, n)?,
            "nominal" => self.nominal = per_parameter(name, value, n)?,
            "kinds" => self.kinds = per_parameter(name, value, n)?,
            _ => return Ok(false),
        }
        Ok(true)
    }
}

/// True if every run has an option of this name.
fn is_of_run(name: &str) -> bool {
    let nothing = Record::new();
    // A value of another type is refused by those that are no options of a method.
    !matches!(AskedRun::default().set(name, &Value::Nothing, &nothing, 0), Ok(false))
}

/// The file of a run, and when it is read and written.
fn checkpoint(path: PathBuf, record: &Record) -> Result<Checkpoint, Error> {
    let mut checkpoint = Checkpoint::new(path);
    let given = |name: &'static str| {
        record.get(name).filter(|value| **value != Value::Nothing).map(|value| (name, value))
    };
    if let Some((name, value)) = given("resume") {
        checkpoint.resume = value.read(name)?;
    }
    if let Some((name, value)) = given("checkpoint_interval") {
        let seconds = value.read::<f64>(name)?;
        checkpoint.interval = Duration::try_from_secs_f64(seconds)
            .map_err(|_| RecordError::range("a number of seconds, at least 0").of(name, value))?;
    }
    if let Some((name, value)) = given("code") {
        checkpoint.code = Some(value.read::<Code>(name)?);
    }
    Ok(checkpoint)
}

/// A value for each of `n` parameters; one that is no list holds for all.
fn per_parameter<T: DeserializeOwned + Clone>(name: &str, value: &Value, n: usize) -> Result<Vec<T>, Error> {
    let Value::List(values) = value else { return Ok(vec![value.read(name)?; n]) };
    if values.len() != n {
        let message = format!("{name} has {} values for {n} parameters", values.len());
        return Err(RecordError::message(message).into());
    }
    Ok(values.iter().map(|value| value.read(name)).collect::<Result<_, _>>()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_option_of_a_run_is_one_by_its_name() {
        assert!(OF_RUN.iter().all(|name| is_of_run(name)));
        let names = AskedRun::option_names().unwrap();
        assert!(names.contains("max_time") && names.contains("x_tol") && names.contains("initial_simplex"));
    }
}
