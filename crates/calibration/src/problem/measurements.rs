//! Measurements of an experiment that count, their weights, and the start of the simulation.

use crate::data::Series;
use crate::error::CalibrationError;
use crate::problem::error_model::ErrorModel;
use crate::problem::experiment::{Experiment, InitialState, Measured, Sigma, Weight};
use base::Number;

/// Maximum number of sampling intervals between the start of the model and the start of a recording, if no
/// start time is given.
const MOST_BEFORE: f64 = 10.0;

/// The measurements of an output that count, in order of time.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Counted {
    pub(crate) times: Series,
    pub(crate) values: Series,
    pub(crate) weights: Series,
    /// True if the values are logarithms of the measurements.
    pub(crate) is_log: bool,
}

impl Counted {
    /// Returns the measurements of some rows, which are counted from 0.
    fn rows(&self, keep: impl Fn(usize) -> bool) -> Self {
        let n = self.times.len();
        // A complete series is shared, not copied.
        if (0..n).all(&keep) {
            return self.clone();
        }
        let of = |series: &Series| (0..n).filter(|row| keep(*row)).map(|row| series[row]).collect();
        Self {
            times: of(&self.times),
            values: of(&self.values),
            weights: of(&self.weights),
            is_log: self.is_log,
        }
    }
}

/// Measurements that the simulation of an experiment is compared with, and its start time.
#[derive(Debug)]
pub(crate) struct Measurements {
    /// Start time of the simulation.
    pub(crate) start_time: f64,
    /// Measurements of each output; none is empty.
    pub(crate) outputs: Vec<Counted>,
    /// End of the simulation of a scenario without measurements.
    pub(crate) end: Option<f64>,
}

impl Measurements {
    /// Returns the span of a scenario of a design, which has no measurements. The simulation spans the rows
    /// of the data, or `default` of the model, unless the scenario sets its start or its end.
    pub(crate) fn of_scenario(
        experiment: &Experiment,
        default: (f64, Option<f64>),
    ) -> Result<Self, CalibrationError> {
        let time = experiment.data.time();
        let start_time = experiment.start_time.or(time.first().copied()).unwrap_or(default.0);
        let Some(end) = experiment.final_time.or(time.last().copied()).or(default.1) else {
            return setup("the model states no stop time. Set the final_time of the scenario".to_owned());
        };
        if !(start_time.is_finite() && end.is_finite() && start_time < end) {
            let [start, end] = [start_time, end].map(Number);
            return setup(format!(
                "final_time = {end} must be later than the start of the simulation, {start}"
            ));
        }
        if let Some(weight) = experiment.weight.filter(|weight| !(weight.is_finite() && *weight >= 0.0)) {
            return setup(format!("weight = {} must be a finite number of at least 0", Number(weight)));
        }
        Ok(Self { start_time, outputs: Vec::new(), end: Some(end) })
    }

    /// Selects the measurements of an experiment. The simulation starts at `default_start` if nothing else is
    /// specified.
    pub(crate) fn new(experiment: &Experiment, default_start: f64) -> Result<Self, CalibrationError> {
        let (source, unit) = (experiment.data.source(), experiment.data.time_unit());
        if experiment.outputs.is_empty() {
            return setup(format!("{source}: no output is compared with a column"));
        }
        let mut outputs = in_windows(experiment)?;
        let first = |outputs: &[Counted]| outputs.iter().map(|o| o.times[0]).fold(f64::INFINITY, f64::min);
        let last = outputs.iter().filter_map(|o| o.times.last()).copied().fold(f64::NEG_INFINITY, f64::max);
        let warm_up = experiment.warm_up.unwrap_or(0.0);
        if !(warm_up.is_finite() && warm_up >= 0.0) {
            return setup(format!("warm_up = {} must be a finite number of at least 0", Number(warm_up)));
        }
        let before_windows = experiment.warm_up.filter(|_| !experiment.windows.is_empty());
        let before_windows = before_windows.map(|warm_up| first(&outputs) - warm_up);
        let start_time = experiment.start_time.or(before_windows).unwrap_or(default_start);
        let tolerance = base::time_tolerance(start_time, last);
        if experiment.warm_up.is_some() {
            for (measured, Measured { variable, column, .. }) in outputs.iter_mut().zip(&experiment.outputs) {
                *measured = measured.rows(|row| measured.times[row] >= start_time + warm_up - tolerance);
                if measured.times.is_empty() {
                    let [start, warm_up, last] = [start_time, warm_up, last].map(Number);
                    return setup(format!(
                        "{source}: no measurement of '{variable}' (column '{column}') remains after the warm-up of {warm_up} {unit} \
                         from {start} {unit}; the last one is at {last} {unit}. Set a shorter warm_up"
                    ));
                }
            }
        }
        let first = first(&outputs);
        if first < start_time - tolerance {
            let [first, start] = [first, start_time].map(Number);
            return setup(format!(
                "{source}: the first measurement is at {first} {unit}, before the simulation starts at {start} {unit}. Set start_time = \
                 {first}, or a window that begins later"
            ));
        }
        let measurements = Self { start_time, outputs, end: None };
        if experiment.start_time.is_none() && before_windows.is_none() {
            measurements.check_begin(experiment)?;
        }
        Ok(measurements)
    }

    /// Rejects a simulation that starts long before the recording, if its start time is only the default of
    /// the model.
    fn check_begin(&self, experiment: &Experiment) -> Result<(), CalibrationError> {
        let (begin, start_time, unit) =
            (experiment.data.time()[0], self.start_time, experiment.data.time_unit());
        let tolerance = (MOST_BEFORE + 1.0) * base::time_tolerance(start_time, self.last_time());
        match experiment.data.sampling_interval() {
            Some(interval) if begin - start_time > MOST_BEFORE * interval + tolerance => {
                let [begin, start, before] = [begin, start_time, begin - start_time].map(Number);
                setup(format!(
                    "{}: the recording begins at {begin} {unit}, but the simulation begins at {start} {unit}. Set start_time = {begin} to \
                     start with the recording, or start_time = {start} to also simulate the {before} {unit} before it",
                    experiment.data.source()
                ))
            }
            _ => Ok(()),
        }
    }

    /// Returns the time of the last measurement.
    pub(crate) fn last_time(&self) -> f64 {
        let ends = self.outputs.iter().filter_map(|o| o.times.last()).copied().chain(self.end);
        ends.fold(self.start_time, f64::max)
    }
}

/// Returns the measurements in the windows that have a nonzero weight.
fn in_windows(experiment: &Experiment) -> Result<Vec<Counted>, CalibrationError> {
    let (data, time) = (&experiment.data, experiment.data.time());
    for (from, to) in &experiment.windows {
        if from.is_nan() || to.is_nan() || from > to {
            let [from, to] = [*from, *to].map(Number);
            return setup(format!("window from {from} to {to} ends before its start"));
        }
    }
    let tolerance = base::time_tolerance(time[0], time[time.len() - 1]);
    let counts = |t: &f64| {
        let is_in = |(from, to): &(f64, f64)| (from - tolerance..=to + tolerance).contains(t);
        experiment.windows.is_empty() || experiment.windows.iter().any(is_in)
    };
    let Some(first) = time.iter().position(counts) else {
        let list = |(from, to): &(f64, f64)| format!("{} to {}", Number(*from), Number(*to));
        let windows = experiment.windows.iter().map(list).collect::<Vec<_>>().join(", ");
        let several = if experiment.windows.len() > 1 { "windows" } else { "window" };
        return setup(format!(
            "no time of {} is in the {several} from {windows}. The times range from {} to {}",
            data.source(),
            time[0],
            time[time.len() - 1]
        ));
    };
    let rows = first..time.iter().rposition(counts).unwrap_or(first) + 1;
    let of_output = |Measured { variable, column, weight }: &Measured| {
        let weights = weights_of_rows(experiment, variable, column, weight)?;
        let measured = data.measured(column, rows.clone())?;
        let is_log = matches!(weight, Weight::Log(_));
        let all = Counted { times: data.time_series().clone(), values: measured.clone(), weights, is_log };
        let counted = all.rows(|row| {
            rows.contains(&row) && !measured[row].is_nan() && all.weights[row] != 0.0 && counts(&time[row])
        });
        if counted.times.is_empty() {
            return setup(format!(
                "{}: no measurement of '{variable}' (column '{column}') counts, because all in the windows are missing or have the \
                 weight 0",
                data.source()
            ));
        }
        if is_log { logarithms(experiment, variable, column, counted) } else { Ok(counted) }
    };
    experiment.outputs.iter().map(of_output).collect()
}

/// Replaces the measurements of an output by their logarithms.
fn logarithms(
    experiment: &Experiment,
    variable: &str,
    column: &str,
    counted: Counted,
) -> Result<Counted, CalibrationError> {
    if let Some(k) = counted.values.iter().position(|value| *value <= 0.0) {
        return setup(format!(
            "{}: the measurement {} of '{variable}' (column '{column}') at time {} must be positive for sigma 'log'. Exclude it with a mask, \
             or use 'a + b*abs(y)'",
            experiment.data.source(),
            Number(counted.values[k]),
            Number(counted.times[k])
        ));
    }
    let is_start =
        |(state, initial): &(String, InitialState)| initial.measured_output(state) == Some(variable);
    if experiment.initial_states.iter().any(is_start) {
        return setup(format!(
            "the simulation starts at a measurement of '{variable}', which cannot have sigma 'log'. Fit the initial state, or use a number \
             as sigma"
        ));
    }
    let values = counted.values.iter().map(|value| value.ln()).collect();
    Ok(Counted { values, ..counted })
}

/// True if the weights only select rows. Such weights do not declare noise.
pub(crate) fn is_mask(weights: &[f64]) -> bool {
    weights.iter().all(|weight| *weight == 0.0 || *weight == 1.0)
}

/// Returns the inverse of the standard deviation of each row.
fn inverse_of_sigma(
    experiment: &Experiment,
    variable: &str,
    column: &str,
    sigma: &Sigma,
) -> Result<Series, CalibrationError> {
    let (data, n) = (&experiment.data, experiment.data.time().len());
    let sigmas = match sigma {
        Sigma::Constant(sigma) if !(sigma.is_finite() && *sigma > 0.0) => {
            let sigma = Number(*sigma);
            return setup(format!("sigma {sigma} of output '{variable}' must be positive and finite"));
        }
        Sigma::Constant(sigma) => return Ok(vec![1.0 / sigma; n].into()),
        Sigma::Model(_) if experiment.resample.is_some() || data.resampled.is_some() => {
            return setup(format!(
                "the sigma of output '{variable}' depends on simulated values, but resample changes the noise. Pass averaged data, \
                 with the sigma of the means"
            ));
        }
        Sigma::Model(model) => {
            let measured = data.measured(column, 0..n)?;
            let sigmas = model.of_measured(model.at_start(measured), measured);
            if sigmas.contains(&0.0) {
                return setup(format!(
                    "sigma '{model}' of output '{variable}' (column '{column}') is 0, because all measurements are 0. Add a constant to sigma"
                ));
            }
            return Ok(sigmas.iter().map(|sigma| 1.0 / sigma).collect());
        }
        Sigma::Column(column) if data.resampled.is_some() => {
            return setup(format!(
                "the sigma of output '{variable}' in column '{column}' was averaged by an earlier resampling. Resample the \
                 original recording with this column"
            ));
        }
        Sigma::Column(column) => data.series(column).map_err(|error| with_hint_of_sigma(error, column))?,
        Sigma::Rows(sigmas) if sigmas.len() != n => {
            let when = if experiment.resample.is_some() { " before resample takes means" } else { "" };
            return setup(format!(
                "output '{variable}' has {} values of sigma for {n} rows of {}{when}. Specify a number, or one value per row",
                sigmas.len(),
                data.source()
            ));
        }
        Sigma::Rows(sigmas) => sigmas,
    };
    let measured = data.column(column)?;
    // The sigma of a missing measurement may be missing.
    let is_bad = |row: &usize| !(sigmas[*row] > 0.0 || sigmas[*row].is_nan() && measured[*row].is_nan());
    match (0..n).find(is_bad) {
        Some(row) => setup(format!(
            "sigma {} of output '{variable}' at time {} must be positive. An infinite sigma excludes a measurement",
            Number(sigmas[row]),
            Number(data.time()[row])
        )),
        None => Ok(sigmas.iter().map(|sigma| if sigma.is_nan() { 1.0 } else { 1.0 / sigma }).collect()),
    }
}

/// Adds to the error of a missing column that a name alone is not an estimated standard deviation.
fn with_hint_of_sigma(error: CalibrationError, name: &str) -> CalibrationError {
    match error {
        CalibrationError::Data { source_name, message } if ErrorModel::is_coefficient(name) => {
            let message = format!(
                "{message}. sigma '{name}' is the name of a column; write '{name} + 0*abs(y)' for a standard deviation that the fit estimates"
            );
            CalibrationError::Data { source_name, message }
        }
        other => other,
    }
}

/// Returns the weights of an output, one per row.
pub(crate) fn weights_of_rows(
    experiment: &Experiment,
    variable: &str,
    column: &str,
    weight: &Weight,
) -> Result<Series, CalibrationError> {
    let (data, n, measured_column) = (&experiment.data, experiment.data.time().len(), column);
    let (weights, place) = match weight {
        Weight::Constant(weight) | Weight::Log(weight) if !(weight.is_finite() && *weight > 0.0) => {
            let hint = if *weight == 0.0 { ". Remove the output instead" } else { "" };
            let weight = Number(*weight);
            return setup(format!(
                "weight {weight} of output '{variable}' must be positive and finite{hint}"
            ));
        }
        Weight::Constant(weight) | Weight::Log(weight) => return Ok(vec![*weight; n].into()),
        Weight::Sigma(sigma) => return inverse_of_sigma(experiment, variable, column, sigma),
        Weight::Inverse(scale) => {
            let weight = 1.0 / scale.of(data.measured(column, 0..n)?);
            if weight.is_finite() && weight > 0.0 {
                return Ok(vec![weight; n].into());
            }
            let (scale, value) = (scale.name(), Number(1.0 / weight));
            return setup(format!(
                "the measurements of '{variable}' (column '{column}') have the {scale} {value}, which cannot be used as a weight. \
                 Specify a number"
            ));
        }
        // The problem was stored with means of its weights.
        Weight::Column(column) if data.resampled.is_some() => {
            return setup(format!(
                "the weights of output '{variable}' in column '{column}' were averaged by an earlier resampling. Resample the \
                 original recording with this column"
            ));
        }
        Weight::Column(column) => (data.series(column)?, format!(" in column '{column}'")),
        Weight::Rows(weights) if weights.len() != n => {
            let when = if experiment.resample.is_some() { " before resampling" } else { "" };
            return setup(format!(
                "output '{variable}' has {} weights for {n} rows of {}{when}. Specify a number, or one weight per row",
                weights.len(),
                data.source()
            ));
        }
        Weight::Rows(weights) => (weights, String::new()),
    };
    // A missing measurement needs no weight.
    let measured = data.measured(measured_column, 0..n)?;
    let weights: Series = match weights.iter().zip(measured).any(|(w, m)| w.is_nan() && m.is_nan()) {
        true => weights.iter().zip(measured).map(|(w, m)| if m.is_nan() { 0.0 } else { *w }).collect(),
        false => weights.clone(),
    };
    match weights.iter().position(|w| !(w.is_finite() && *w >= 0.0)) {
        Some(row) => setup(format!(
            "the weight {} of output '{variable}'{place} at time {} must be finite and at least 0. A weight of 0 excludes a measurement",
            Number(weights[row]),
            Number(data.time()[row])
        )),
        None => Ok(weights),
    }
}

fn setup<T>(message: String) -> Result<T, CalibrationError> {
    Err(CalibrationError::Setup(message))
}
