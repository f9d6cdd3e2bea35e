//! What a simulation may be told, and the times at which it is sampled.

use crate::description::{DefaultExperiment, Interval, Value};
use crate::error::FmiError;
use crate::fmu::Kind;
use crate::platform::memory;
use crate::simulation::inputs::Inputs;
use crate::simulation::sharing::Sharing;
use ode::{ChatteringPolicy, Method, Number};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Output intervals where nothing else is said.
pub const DEFAULT_INTERVALS: usize = 500;

/// Relative tolerance where neither the options nor the model say one.
pub const DEFAULT_TOLERANCE: f64 = 1e-6;

/// More rows than this are taken for a mistake.
const MAX_ROWS: usize = 100_000_000;

/// Unit round-off of double precision.
const U: f64 = f64::EPSILON / 2.0;

/// Options of a simulation; the default leaves everything to the model.
///
/// ```
/// use fmi::SimulateOptions;
/// let options = SimulateOptions::default().final_time(40.0).start_value("armFriction", 0.01).outputs(["armJoint.phi"]);
/// ```
#[derive(Debug, Clone, Default)]
pub struct SimulateOptions {
    /// Start time; default: that of the default experiment, else 0.
    pub start_time: Option<f64>,
    /// Final time; default: that of the default experiment, else the last of `times`, else an error.
    pub final_time: Option<f64>,
    /// The times of the rows, ascending. A time listed twice gives the limit from the left, then that from the right.
    /// Co-simulations without event mode have the former only: rows are read before the inputs of the next communication
    /// step are set, so that what follows an input directly, and the input itself, are those of the step before.
    /// At most one of `times`, `output_interval` and `ncp`; without any there are 500 intervals.
    pub times: Option<Vec<f64>>,
    /// Distance of the rows; the last row is at the final time.
    pub output_interval: Option<f64>,
    /// Number of intervals between the rows.
    pub ncp: Option<usize>,
    /// Values for parameters and variables with a start value, set before the initialization. Of several for one
    /// variable the last counts.
    pub start_values: Vec<(String, Value)>,
    /// Intervals between the ticks of clocks (FMI 3.0): for input clocks whose intervals are fixed or tunable.
    pub clock_intervals: Vec<(String, Interval)>,
    /// Real variables whose values are given anew at each run.
    pub parameters: Vec<String>,
    /// Variables to record: names; elements of arrays (`name[2,1]`, counted from 1); patterns, in which `*` stands for any
    /// characters and `?` for one; `all` for everything that is a number. Default: the variables of causality output and
    /// the states, or where there are neither, all variables that change. Time is always there.
    pub outputs: Option<Vec<String>>,
    /// Time-varying inputs.
    pub inputs: Option<Inputs>,
    /// Whether co-simulations that extrapolate inputs (`canInterpolateInputs`, FMI 1.0 and 2.0) are told their derivatives
    /// for the next step: that of the line to the inputs at its end. Default: yes. Inputs that are held over each step, as
    /// with `Some(false)` and in most other tools, are farther from the truth, by an error of the order of the step.
    pub input_derivatives: Option<bool>,
    /// Relative tolerance; default: that of the default experiment, else 1e-6.
    pub relative_tolerance: Option<f64>,
    /// How the model is run.
    pub kind: Kind,
    /// Integration method (model exchange).
    pub method: Method,
    /// Model exchange: step of the fixed-step methods; default: a 500th of the span. Co-simulation: the communication
    /// step; default: that of the default experiment, else the distance of the rows.
    pub step_size: Option<f64>,
    /// Largest step of the adaptive methods.
    pub max_step: Option<f64>,
    /// Limit of wall-clock time.
    pub timeout: Option<Duration>,
    /// Limit of work in equivalents of a right-hand side, see [`ode::Stats::work`] (model exchange).
    pub max_work: Option<f64>,
    /// What happens when state events follow each other so closely that time hardly advances (model exchange).
    pub chattering: ChatteringPolicy,
    /// Add rows for both sides of every event.
    pub record_events: bool,
    /// Set from outside to end the run.
    pub cancel: Option<Arc<AtomicBool>>,
    /// How simulations that run in parallel share the library of the FMU.
    pub sharing: Sharing,
}

impl SimulateOptions {
    /// Options that leave everything to the model.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets [`start_time`](Self::start_time).
    #[must_use]
    pub fn start_time(mut self, time: f64) -> Self {
        self.start_time = Some(time);
        self
    }

    /// Sets [`final_time`](Self::final_time).
    #[must_use]
    pub fn final_time(mut self, time: f64) -> Self {
        self.final_time = Some(time);
        self
    }

    /// Sets [`times`](Self::times).
    #[must_use]
    pub fn times(mut self, times: impl Into<Vec<f64>>) -> Self {
        self.times = Some(times.into());
        self
    }

    /// Sets [`output_interval`](Self::output_interval).
    #[must_use]
    pub fn output_interval(mut self, interval: f64) -> Self {
        self.output_interval = Some(interval);
        self
    }

    /// Sets [`ncp`](Self::ncp).
    #[must_use]
    pub fn ncp(mut self, intervals: usize) -> Self {
        self.ncp = Some(intervals);
        self
    }

    /// Adds to [`clock_intervals`](Self::clock_intervals).
    #[must_use]
    pub fn clock_interval(mut self, name: impl Into<String>, interval: Interval) -> Self {
        self.clock_intervals.push((name.into(), interval));
        self
    }

    /// Adds to [`start_values`](Self::start_values).
    #[must_use]
    pub fn start_value(mut self, name: impl Into<String>, value: impl Into<Value>) -> Self {
        self.start_values.push((name.into(), value.into()));
        self
    }

    /// Sets [`parameters`](Self::parameters).
    #[must_use]
    pub fn parameters<N: Into<String>>(mut self, names: impl IntoIterator<Item = N>) -> Self {
        self.parameters = names.into_iter().map(Into::into).collect();
        self
    }

    /// Sets [`outputs`](Self::outputs).
    #[must_use]
    pub fn outputs<N: Into<String>>(mut self, names: impl IntoIterator<Item = N>) -> Self {
        self.outputs = Some(names.into_iter().map(Into::into).collect());
        self
    }

    /// Sets [`inputs`](Self::inputs).
    #[must_use]
    pub fn inputs(mut self, inputs: Inputs) -> Self {
        self.inputs = Some(inputs);
        self
    }

    /// Sets [`input_derivatives`](Self::input_derivatives).
    #[must_use]
    pub fn input_derivatives(mut self, told: bool) -> Self {
        self.input_derivatives = Some(told);
        self
    }

    /// Sets [`relative_tolerance`](Self::relative_tolerance).
    #[must_use]
    pub fn relative_tolerance(mut self, tolerance: f64) -> Self {
        self.relative_tolerance = Some(tolerance);
        self
    }

    /// Sets [`kind`](Self::kind).
    #[must_use]
    pub fn kind(mut self, kind: Kind) -> Self {
        self.kind = kind;
        self
    }

    /// Sets [`method`](Self::method).
    #[must_use]
    pub fn method(mut self, method: Method) -> Self {
        self.method = method;
        self
    }

    /// Sets [`step_size`](Self::step_size).
    #[must_use]
    pub fn step_size(mut self, step: f64) -> Self {
        self.step_size = Some(step);
        self
    }

    /// Sets [`max_step`](Self::max_step).
    #[must_use]
    pub fn max_step(mut self, step: f64) -> Self {
        self.max_step = Some(step);
        self
    }

    /// Sets [`timeout`](Self::timeout).
    #[must_use]
    pub fn timeout(mut self, limit: Duration) -> Self {
        self.timeout = Some(limit);
        self
    }

    /// Sets [`max_work`](Self::max_work).
    #[must_use]
    pub fn max_work(mut self, work: f64) -> Self {
        self.max_work = Some(work);
        self
    }

    /// Sets [`chattering`](Self::chattering).
    #[must_use]
    pub fn chattering(mut self, policy: ChatteringPolicy) -> Self {
        self.chattering = policy;
        self
    }

    /// Sets [`record_events`](Self::record_events).
    #[must_use]
    pub fn record_events(mut self, on: bool) -> Self {
        self.record_events = on;
        self
    }

    /// Sets [`cancel`](Self::cancel).
    #[must_use]
    pub fn cancel(mut self, flag: Arc<AtomicBool>) -> Self {
        self.cancel = Some(flag);
        self
    }

    /// Sets [`sharing`](Self::sharing).
    #[must_use]
    pub fn sharing(mut self, sharing: Sharing) -> Self {
        self.sharing = sharing;
        self
    }

    /// Whether a plan for the one serves the other: all is the same, the flag that cancels too.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        // One pattern for all fields, so that none can be forgotten.
        let Self {
            start_time,
            final_time,
            times,
            output_interval,
            ncp,
            start_values,
            clock_intervals,
            parameters,
            outputs,
            inputs,
            input_derivatives,
            relative_tolerance,
            kind,
            method,
            step_size,
            max_step,
            timeout,
            max_work,
            chattering,
            record_events,
            cancel,
            sharing,
        } = self;
        let same_inputs = match (inputs, &other.inputs) {
            (Some(inputs), Some(others)) => inputs.is_same(others),
            (inputs, others) => inputs.is_none() && others.is_none(),
        };
        let same_flag = match (cancel, &other.cancel) {
            (Some(flag), Some(others)) => Arc::ptr_eq(flag, others),
            (flag, others) => flag.is_none() && others.is_none(),
        };
        same_inputs
            && same_flag
            && *start_time == other.start_time
            && *final_time == other.final_time
            && *times == other.times
            && *output_interval == other.output_interval
            && *ncp == other.ncp
            && *start_values == other.start_values
            && *clock_intervals == other.clock_intervals
            && *parameters == other.parameters
            && *outputs == other.outputs
            && *input_derivatives == other.input_derivatives
            && *relative_tolerance == other.relative_tolerance
            && *kind == other.kind
            && *method == other.method
            && *step_size == other.step_size
            && *max_step == other.max_step
            && *timeout == other.timeout
            && *max_work == other.max_work
            && *chattering == other.chattering
            && *record_events == other.record_events
            && *sharing == other.sharing
    }

    /// The options of the integration method.
    pub(crate) fn method_options(&self, experiment: &DefaultExperiment) -> ode::Options {
        let suggested = experiment.tolerance.filter(|tolerance| (1e-14..1.0).contains(tolerance));
        ode::Options {
            method: self.method,
            relative_tolerance: self.relative_tolerance.or(suggested).unwrap_or(DEFAULT_TOLERANCE),
            step_size: self.step_size,
            max_step: self.max_step,
            record_events: self.record_events,
            limits: ode::Limits { timeout: self.timeout, max_work: self.max_work, ..ode::Limits::default() },
            chattering: self.chattering,
            cancel: self.cancel.clone(),
            ..ode::Options::default()
        }
    }

    /// Resolves span and rows.
    pub(crate) fn grid(&self, experiment: &DefaultExperiment) -> Result<Grid, FmiError> {
        let given = [self.times.is_some(), self.output_interval.is_some(), self.ncp.is_some()];
        if given.iter().filter(|is| **is).count() > 1 {
            return Err(setting("at most one of times, output_interval and ncp can be given".to_owned()));
        }
        let start = self.start_time.or(experiment.start_time).unwrap_or(0.0);
        let last = self.times.as_ref().and_then(|times| times.last().copied());
        let Some(end) = self.final_time.or(experiment.stop_time).or(last) else {
            return Err(setting(
                "no final time: neither final_time nor times is given, and the model suggests none"
                    .to_owned(),
            ));
        };
        if !(start.is_finite() && end.is_finite() && start <= end) {
            let problem = format!(
                "cannot simulate from {} to {}: both must be finite, the end not before the start",
                Number(start),
                Number(end)
            );
            return Err(setting(problem));
        }
        if !(end - start).is_finite() {
            return Err(setting(format!(
                "the span from {} to {} is too long for a number",
                Number(start),
                Number(end)
            )));
        }
        let same = 100.0 * U * start.abs().max(end.abs()).max(end - start);
        let mut interval = self.output_interval;
        let times: Vec<f64> = match (&self.times, self.output_interval, self.ncp) {
            (Some(times), ..) => snap(times, start, end, same)?,
            (_, Some(interval), _) => intervals(start, end, same, interval)?,
            (_, _, Some(0)) => return Err(setting("ncp = 0: at least one interval is needed".to_owned())),
            (_, _, ncp) => {
                let n = ncp.unwrap_or(DEFAULT_INTERVALS);
                interval = Some((end - start) / n as f64);
                uniform(start, end, same, n)?
            }
        };
        if self.times.is_some() {
            interval = common_interval(&times, start, same);
        }
        Ok(Grid { start, end, same, times, interval })
    }
}

/// Span and rows of a simulation.
#[derive(Debug, PartialEq)]
pub(crate) struct Grid {
    pub(crate) start: f64,
    pub(crate) end: f64,
    /// Times closer than this are one.
    pub(crate) same: f64,
    pub(crate) times: Vec<f64>,
    /// Distance of the rows, where they have one.
    pub(crate) interval: Option<f64>,
}

fn setting(problem: String) -> FmiError {
    FmiError::BadSetting { problem }
}

/// `n` equal intervals: `start + k h`, never a sum, and the end itself; fewer where the rows could not be told apart.
fn uniform(start: f64, end: f64, same: f64, n: usize) -> Result<Vec<f64>, FmiError> {
    if start == end {
        return Ok(vec![start]);
    }
    if n > MAX_ROWS {
        return Err(setting(format!("{n} intervals are more than the limit of {MAX_ROWS}")));
    }
    let h = (end - start) / n as f64;
    let mut times = vec![start];
    let mut last = start;
    for t in (1..n).map(|k| start + k as f64 * h) {
        if t - last > same && end - t > same {
            times.push(t);
            last = t;
        }
    }
    times.push(end);
    Ok(times)
}

/// The distance of rows that are given one by one, if it is the same for all and the first is at the start.
fn common_interval(times: &[f64], start: f64, same: f64) -> Option<f64> {
    let (first, last) = (times.first()?, times.last()?);
    let n = times.len() - 1;
    let interval = (last - first) / n as f64;
    let is_regular = |(k, time): (usize, &f64)| (time - (start + k as f64 * interval)).abs() <= same;
    (n > 1 && interval > same && times.iter().enumerate().all(is_regular)).then_some(interval)
}

/// Rows `interval` apart, and one at the end.
fn intervals(start: f64, end: f64, same: f64, interval: f64) -> Result<Vec<f64>, FmiError> {
    if !(interval > 0.0 && interval.is_finite()) {
        return Err(setting(format!("output_interval = {} must be positive and finite", Number(interval))));
    }
    let count = ((end - start) / interval).ceil();
    if count > MAX_ROWS as f64 || interval <= same {
        return Err(setting(format!(
            "output_interval = {} from {} to {} makes more rows than the limit of {MAX_ROWS}",
            Number(interval),
            Number(start),
            Number(end)
        )));
    }
    Ok((0..=count as usize)
        .map(|k| start + k as f64 * interval)
        .take_while(|t| *t < end - same)
        .chain([end])
        .collect())
}

/// Checks given times, and makes those one that are within rounding of each other or of the ends of the span.
fn snap(times: &[f64], start: f64, end: f64, same: f64) -> Result<Vec<f64>, FmiError> {
    let mut snapped: Vec<f64> = memory::list_of("the list of times", times.len())?;
    for (i, &time) in times.iter().enumerate() {
        if !(time >= start - same && time <= end + same) {
            return Err(setting(format!(
                "times[{i}] = {} is not within the span of the simulation, {} to {}",
                Number(time),
                Number(start),
                Number(end)
            )));
        }
        let mut time = if time <= start + same {
            start
        } else if time >= end - same {
            end
        } else {
            time
        };
        if let Some(&before) = snapped.last() {
            if times[i] < times[i - 1] {
                return Err(setting(format!(
                    "times must ascend: times[{i}] = {} comes after {}",
                    Number(times[i]),
                    Number(times[i - 1])
                )));
            }
            if time - before <= same {
                time = before;
            }
            if i > 1 && time == snapped[i - 2] {
                return Err(setting(format!(
                    "times[{i}] = {} is listed a third time; twice is left and right limit",
                    Number(time)
                )));
            }
        }
        snapped.push(time);
    }
    Ok(snapped)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: DefaultExperiment =
        DefaultExperiment { start_time: None, stop_time: None, tolerance: None, step_size: None };

    fn grid(options: &SimulateOptions) -> Grid {
        options.grid(&NONE).unwrap()
    }

    fn problem(options: &SimulateOptions) -> String {
        options.grid(&NONE).unwrap_err().to_string()
    }

    #[test]
    fn five_hundred_intervals_by_default() {
        let g = grid(&SimulateOptions::new().final_time(40.0));
        assert_eq!((g.start, g.end, g.times.len()), (0.0, 40.0, 501));
        assert_eq!((g.times[1], g.times[500]), (0.08, 40.0));
        let one = grid(&SimulateOptions::new().start_time(0.1).final_time(1.1).ncp(1));
        assert_eq!(one.times, [0.1, 1.1]);
        assert_eq!(grid(&SimulateOptions::new().final_time(0.0)).times, [0.0]);
    }

    #[test]
    fn rows_that_cannot_be_told_apart_are_one() {
        let g = grid(&SimulateOptions::new().start_time(1e9).final_time(1e9 + 1e-5));
        assert_eq!((g.times[0], *g.times.last().unwrap()), (1e9, 1e9 + 1e-5));
        assert!(g.times.windows(2).all(|pair| pair[1] > pair[0]), "{:?}", g.times);
        let g = grid(&SimulateOptions::new().start_time(1e9).final_time(1e9 + 1.0));
        assert!(g.times.len() > 400 && g.times.windows(2).all(|pair| pair[1] - pair[0] > g.same));
        assert!(
            problem(&SimulateOptions::new().start_time(-1.5e308).final_time(1.5e308)).contains("too long")
        );
    }

    #[test]
    fn intervals_end_at_the_final_time() {
        let times = |interval| grid(&SimulateOptions::new().final_time(1.0).output_interval(interval)).times;
        assert_eq!(times(0.5), [0.0, 0.5, 1.0]);
        assert_eq!(times(0.1).len(), 11);
        assert_eq!(times(0.4), [0.0, 0.4, 0.8, 1.0]);
        assert_eq!(times(7.0), [0.0, 1.0]);
    }

    #[test]
    fn the_default_experiment_comes_before_the_last_of_the_times() {
        let experiment = DefaultExperiment { start_time: Some(1.0), stop_time: Some(3.0), ..NONE };
        let options = SimulateOptions::new().times([1.5, 2.0]);
        let g = options.grid(&experiment).unwrap();
        assert_eq!((g.start, g.end), (1.0, 3.0));
        assert_eq!(grid(&options).end, 2.0);
        assert!(
            SimulateOptions::new()
                .times([4.0])
                .grid(&experiment)
                .unwrap_err()
                .to_string()
                .contains("times[0] = 4")
        );
        assert!(problem(&SimulateOptions::new()).contains("final_time"));
    }

    #[test]
    fn times_within_rounding_are_one() {
        let three = 0.1 + 0.2;
        let g = grid(&SimulateOptions::new().times([-1e-17, 0.3, three, 1.0 + 1e-15]).final_time(1.0));
        assert_eq!(g.times, [0.0, 0.3, 0.3, 1.0]);
    }

    #[test]
    fn bad_settings_name_the_numbers() {
        let end = || SimulateOptions::new().final_time(1.0);
        assert!(problem(&end().ncp(2).output_interval(0.1)).contains("at most one"));
        assert!(problem(&end().ncp(0)).contains("ncp = 0"));
        assert!(problem(&end().times([0.5, 0.2])).contains("times[1] = 0.2 comes after 0.5"));
        assert!(problem(&end().times([0.5, 0.5, 0.5])).contains("third"));
        assert!(problem(&end().times([f64::NAN])).contains("NaN"));
        assert!(problem(&end().times([2.0])).contains("times[0] = 2"));
        assert!(problem(&end().output_interval(-0.1)).contains("-0.1"));
        assert!(problem(&end().output_interval(1e-300)).contains("limit"));
        assert!(problem(&SimulateOptions::new().final_time(f64::INFINITY)).contains("inf"));
        assert!(problem(&end().start_time(2.0)).contains("from 2 to 1"));
    }

    #[test]
    fn the_tolerance_of_the_model_is_taken_if_it_makes_sense() {
        let tolerance = |suggested| {
            let experiment = DefaultExperiment { tolerance: suggested, ..NONE };
            SimulateOptions::new().method_options(&experiment).relative_tolerance
        };
        assert_eq!(tolerance(Some(1e-4)), 1e-4);
        assert_eq!(tolerance(Some(0.0)), 1e-6);
        assert_eq!(tolerance(None), 1e-6);
    }
}
