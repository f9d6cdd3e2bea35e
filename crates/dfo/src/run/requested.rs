//! Options of a run by name, as users write them. One flat record contains the options of the method and the
//! options that every run has.

use crate::error::Error;
use crate::methods::AnyMethod;
use crate::problem::constraints::Constraints;
use crate::run::checkpoint::{Checkpoint, Resume};
use crate::run::options::{EvaluatedPoint, RunOptions};
use crate::values::choices::{ParameterKind, Search, StopRule, ToleranceMeasure, Transform};
use crate::values::fields::{field_names, read_part};
use crate::values::record::{Record, RecordError, Value};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;

/// Options that every run has. Missing options have their defaults; a limit of `None` means no limit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub(super) struct RunRecord {
    /// Method; default: chosen for the problem.
    method: Option<String>,
    /// Goal of the search, if no method is given.
    search: Option<Search>,
    /// Tolerance of the parameters.
    x_tol: Option<f64>,
    /// Tolerance of the cost.
    f_tol: Option<f64>,
    /// Tests that must pass: both, or either one.
    stop: Option<StopRule>,
    /// Measure of the tolerances.
    tolerances: Option<ToleranceMeasure>,
    /// Violation of a nonlinear constraint up to which a point counts as feasible.
    #[cfg_attr(feature = "schema", schemars(range(min = 0)))]
    constraint_tol: Option<f64>,
    /// Limit of evaluations.
    #[cfg_attr(feature = "schema", schemars(with = "Option<u64>", range(min = 1)))]
    max_evaluations: Value,
    /// Alias of `max_evaluations`.
    #[cfg_attr(feature = "schema", schemars(with = "Option<u64>", range(min = 1)))]
    max_fevals: Value,
    /// Limit of iterations.
    #[cfg_attr(feature = "schema", schemars(with = "Option<u64>"))]
    max_iterations: Value,
    /// Alias of `max_iterations`.
    #[cfg_attr(feature = "schema", schemars(with = "Option<u64>"))]
    max_iters: Value,
    /// Limit of wall-clock time, in seconds.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0)))]
    max_time: Value,
    /// Cost at or below which the run ends.
    target: Option<f64>,
    /// Fraction of failed evaluations above which the run ends.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 1)))]
    max_failed: Option<f64>,
    /// Disables the method's own limits if no limit is set.
    unlimited: Option<bool>,
    /// Number of evaluations that may run at once; -1 uses all cores. The result does not depend on it.
    #[cfg_attr(feature = "schema", schemars(schema_with = "workers_schema"))]
    workers: Value,
    /// Seed of the random numbers. By default, a seed is drawn and reported.
    seed: Option<u64>,
    /// Alias of `seed`.
    rng: Option<u64>,
    /// Number of evaluations to remember.
    #[cfg_attr(feature = "schema", schemars(with = "Option<u64>"))]
    cache: Value,
    /// Number of evaluations to keep in the trace; only the last ones are kept.
    #[cfg_attr(feature = "schema", schemars(with = "Option<u64>", range(min = 1)))]
    trace_limit: Value,
    /// Identity of the problem, see [`RunOptions::problem`].
    problem: Option<String>,
    /// Known points from earlier runs.
    warm_start: Option<Vec<EvaluatedPoint>>,
    /// File to which the state of the run is written.
    checkpoint: Option<PathBuf>,
    /// Minimum time between two writes of the checkpoint, in seconds.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", range(min = 0)))]
    checkpoint_interval: Value,
    /// Treatment of an existing checkpoint.
    resume: Option<Resume>,
    /// Name of the minimised function.
    function: Option<String>,
    /// Scale of all parameters, or of each parameter.
    #[cfg_attr(feature = "schema", schemars(with = "Option<PerParameter<Transform>>"))]
    scale: Value,
    /// Typical size of all parameters, or of each parameter.
    #[cfg_attr(feature = "schema", schemars(with = "Option<PerParameter<f64>>"))]
    nominal: Value,
    /// Kind of all parameters, or of each parameter.
    #[cfg_attr(feature = "schema", schemars(with = "Option<PerParameter<ParameterKind>>"))]
    kinds: Value,
}

#[cfg(feature = "schema")]
fn workers_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
    schemars::json_schema!({ "anyOf": [{ "enum": [-1, null] }, { "type": "integer", "minimum": 1 }] })
}

/// A value for all parameters, or one value per parameter.
#[cfg(feature = "schema")]
#[derive(schemars::JsonSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "its schema alone is used")]
enum PerParameter<T> {
    /// One value for all parameters.
    All(T),
    /// One value per parameter.
    Each(Vec<T>),
}

/// A run and the properties of its parameters, as requested by name.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RequestedRun {
    /// The run.
    pub options: RunOptions<AnyMethod>,
    /// Scale of each parameter; all are linear if empty.
    pub scale: Vec<Transform>,
    /// Typical size of each parameter; `None` if unknown.
    pub nominal: Vec<Option<f64>>,
    /// Kind of each parameter; all are continuous if empty.
    pub kinds: Vec<ParameterKind>,
}

impl RequestedRun {
    /// Returns the names of all options that a record of a run may contain, including the options of every
    /// method.
    ///
    /// # Errors
    /// Returns an error if the options of a method cannot be serialised.
    pub fn option_names() -> Result<BTreeSet<String>, Error> {
        let mut names = AnyMethod::all_option_names()?;
        names.extend(field_names::<RunRecord>()?);
        Ok(names)
    }

    /// Reads the run of a record over `n` parameters. `options` supplies the values that the record does not
    /// set. The record contains both the options that every run has and the options of the method.
    ///
    /// # Errors
    /// Returns an error if an option does not exist or its value is not allowed.
    pub fn new(options: RunOptions<AnyMethod>, record: &Record, n: usize) -> Result<Self, Error> {
        let (of_run, mut of_method) = read_part::<RunRecord>(record.clone(), "run option")?;
        let mut requested = Self { options, ..Self::default() };
        requested.options.workers = workers(&of_run.workers)?.or(requested.options.workers);
        if let Some(Value::Text(plan)) = of_method.get("batch")
            && plan.eq_ignore_ascii_case("workers")
        {
            let n = requested.options.workers.unwrap_or_else(base::available_cores);
            of_method.insert("batch".to_owned(), Value::Count(n as u64));
        }
        let method = requested.method(&of_run, &of_method);
        requested.set(of_run, n)?;
        requested.options.method = method?;
        Ok(requested)
    }

    /// Returns the record that requests a run with these options. Unset options are left out. The record
    /// contains neither parameters nor the identities of problem and code.
    ///
    /// # Errors
    /// Returns an error if the options of the method cannot be serialised.
    pub fn record(options: &RunOptions<AnyMethod>) -> Result<Record, Error> {
        let RunOptions { method, tolerances, limits, checkpoint, evaluated, constraints, .. } = options;
        let count = |limit: Option<usize>| limit.map_or(Value::Nothing, |n| Value::Count(n as u64));
        let seconds =
            |time: Option<Duration>| time.map_or(Value::Nothing, |time| Value::Number(time.as_secs_f64()));
        let checkpoint = checkpoint.as_ref();
        let run = RunRecord {
            method: Some(method.name().to_owned()),
            search: if let AnyMethod::Auto(auto) = method { Some(auto.search) } else { None },
            x_tol: Some(tolerances.x_tol),
            f_tol: Some(tolerances.f_tol),
            stop: Some(tolerances.stop),
            tolerances: Some(tolerances.measure),
            constraint_tol: (constraints.tolerance != Constraints::default().tolerance)
                .then_some(constraints.tolerance),
            max_evaluations: count(limits.max_evaluations),
            max_iterations: count(limits.max_iterations),
            max_time: seconds(limits.max_time),
            target: limits.target,
            max_failed: limits.max_failed,
            unlimited: options.unlimited.then_some(true),
            workers: count(options.workers),
            seed: options.seed,
            cache: count(options.cache),
            trace_limit: count(options.trace_limit),
            warm_start: (!evaluated.is_empty()).then(|| evaluated.clone()),
            checkpoint: checkpoint.map(|checkpoint| checkpoint.path.clone()),
            checkpoint_interval: seconds(checkpoint.map(|checkpoint| checkpoint.interval)),
            resume: checkpoint.map(|checkpoint| checkpoint.resume),
            ..RunRecord::default()
        };
        let Value::Record(mut record) = Value::of(&run)? else { return Ok(Record::new()) };
        record.retain(|_, value| *value != Value::Nothing);
        record.extend(method.option_record()?);
        Ok(record)
    }

    /// Reads the method with its options.
    fn method(&self, of_run: &RunRecord, of_method: &Record) -> Result<AnyMethod, Error> {
        let method = match &of_run.method {
            Some(method) => method.parse()?,
            None => self.options.method.clone(),
        };
        let search = of_run.search.unwrap_or_default();
        let method = match method {
            AnyMethod::Auto(_) => AnyMethod::auto(search),
            method if search == Search::Local => method,
            method => {
                let name = method.name();
                let message = format!(
                    "search='global' selects the method automatically, so it cannot be combined with \
                     method='{name}'"
                );
                return Err(RecordError::message(message).into());
            }
        };
        method.with_options(of_method)
    }

    /// Sets the given options that do not belong to the method.
    fn set(&mut self, requested: RunRecord, n: usize) -> Result<(), Error> {
        let checkpoint = checkpoint(&requested)?;
        let run = &mut self.options;
        let (tolerances, limits) = (&mut run.tolerances, &mut run.limits);
        set(&mut tolerances.x_tol, requested.x_tol);
        set(&mut tolerances.f_tol, requested.f_tol);
        set(&mut tolerances.stop, requested.stop);
        set(&mut tolerances.measure, requested.tolerances);
        set(&mut run.constraints.tolerance, requested.constraint_tol);
        set(&mut run.unlimited, requested.unlimited);
        set(&mut run.evaluated, requested.warm_start);
        limit(&mut limits.max_evaluations, "max_evaluations", &requested.max_evaluations, 1)?;
        limit(&mut limits.max_evaluations, "max_fevals", &requested.max_fevals, 1)?;
        limit(&mut limits.max_iterations, "max_iterations", &requested.max_iterations, 0)?;
        limit(&mut limits.max_iterations, "max_iters", &requested.max_iters, 0)?;
        limit(&mut run.cache, "cache", &requested.cache, 0)?;
        limit(&mut run.trace_limit, "trace_limit", &requested.trace_limit, 1)?;
        if requested.max_time != Value::Nothing {
            limits.max_time = requested.max_time.read_time("max_time")?;
        }
        limits.target = requested.target.or(limits.target);
        limits.max_failed = requested.max_failed.or(limits.max_failed);
        if requested.seed.is_some() && requested.rng.is_some() {
            return Err(
                RecordError::message("rng and seed are the same option; specify only one of them").into()
            );
        }
        run.seed = requested.seed.or(requested.rng).or(run.seed);
        run.problem = requested.problem.or(run.problem.take());
        run.checkpoint = checkpoint.or(run.checkpoint.take());
        self.scale = per_parameter("scale", &requested.scale, n)?;
        self.nominal = per_parameter("nominal", &requested.nominal, n)?;
        self.kinds = per_parameter("kinds", &requested.kinds, n)?;
        Ok(())
    }
}

/// Sets an option if a value is given.
fn set<T>(option: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *option = given;
    }
}

/// Sets a limit if a value is given.
fn limit(limit: &mut Option<usize>, name: &str, given: &Value, least: u64) -> Result<(), RecordError> {
    if *given != Value::Nothing {
        *limit = given.read_limit(name, least)?;
    }
    Ok(())
}

/// Reads the number of evaluations that may run at once, if it is given.
fn workers(given: &Value) -> Result<Option<usize>, RecordError> {
    match given {
        Value::Negative(-1) => Ok(Some(base::available_cores())),
        Value::Negative(_) | Value::Count(0) => {
            Err(RecordError::range("at least 1, or -1 for all cores").of("workers", given))
        }
        given => given.read("workers"),
    }
}

/// Reads the options of the checkpoint: its file and when it is read and written.
fn checkpoint(requested: &RunRecord) -> Result<Option<Checkpoint>, Error> {
    let interval = &requested.checkpoint_interval;
    let seconds = interval.read::<Option<f64>>("checkpoint_interval")?;
    let Some(path) = &requested.checkpoint else {
        if requested.resume == Some(Resume::Require) {
            let message = "resume='require' requires a checkpoint; specify its file with checkpoint=...";
            return Err(RecordError::message(message).into());
        }
        return match seconds {
            Some(_) => Err(RecordError::without_checkpoint().of("checkpoint_interval", interval).into()),
            None => Ok(None),
        };
    };
    let mut checkpoint = Checkpoint::new(path);
    set(&mut checkpoint.resume, requested.resume);
    if let Some(seconds) = seconds {
        checkpoint.interval = Duration::try_from_secs_f64(seconds).map_err(|_| {
            RecordError::range("a number of seconds, at least 0").of("checkpoint_interval", interval)
        })?;
    }
    checkpoint.function.clone_from(&requested.function);
    Ok(Some(checkpoint))
}

/// Reads one value for each of `n` parameters. A value that is not a list applies to all of them. Returns an
/// empty list if nothing is given.
fn per_parameter<T: DeserializeOwned + Clone>(name: &str, value: &Value, n: usize) -> Result<Vec<T>, Error> {
    let values = match value {
        Value::Nothing => return Ok(Vec::new()),
        Value::List(values) => values,
        value => return Ok(vec![value.read(name)?; n]),
    };
    if values.len() != n {
        let message = format!("{name}: expected {n} values, one per parameter; got {}", values.len());
        return Err(RecordError::message(message).into());
    }
    Ok(values.iter().map(|value| value.read(name)).collect::<Result<_, _>>()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn option_names_include_runs_and_methods() {
        let names = RequestedRun::option_names().unwrap();
        assert!(["max_time", "x_tol", "initial_simplex"].iter().all(|name| names.contains(*name)));
        let of_run = field_names::<RunRecord>().unwrap();
        assert!(crate::methods::option_names::COMMON.iter().all(|name| of_run.contains(*name)));
    }
}
