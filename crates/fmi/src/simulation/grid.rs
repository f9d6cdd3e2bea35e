//! Time span of a simulation and the times of its rows.

use super::options::{DEFAULT_INTERVALS, SimulateOptions};
use crate::description::DefaultExperiment;
use crate::error::{FmiError::BadSetting, Result};
use crate::platform::memory;
use base::Number;
use std::ops::Range;

/// Maximum number of rows. A larger number is assumed to be a mistake.
const MAX_ROWS: usize = 100_000_000;

impl SimulateOptions {
    /// Determines the time span and the rows.
    pub(crate) fn grid(&self, experiment: &DefaultExperiment) -> Result<Grid> {
        let given = [self.times.is_some(), self.output_interval.is_some(), self.ncp.is_some()];
        if given.iter().filter(|is| **is).count() > 1 {
            return Err(BadSetting("specify at most one of times, output_interval and ncp".to_owned()));
        }
        let start = self.start_time.or(experiment.start_time).unwrap_or(0.0);
        let last = self.times.as_ref().and_then(|times| times.last().copied());
        let Some(end) = self.final_time.or(experiment.stop_time).or(last) else {
            return Err(BadSetting(
                "final_time is missing, and the model declares no stop time. Specify final_time (other tools \
                 use 1 s) or times"
                    .to_owned(),
            ));
        };
        if !(start.is_finite() && end.is_finite() && start <= end) {
            return Err(BadSetting(format!(
                "cannot simulate from {} to {}: both times must be finite, and the end must not be before \
                 the start{}",
                Number(start),
                Number(end),
                self.suggested(experiment)
            )));
        }
        if !(end - start).is_finite() {
            return Err(BadSetting(format!(
                "the span from {} to {} is too long for a floating-point number",
                Number(start),
                Number(end)
            )));
        }
        let time_tolerance = base::time_tolerance(start, end);
        let mut interval = self.output_interval;
        let times: Vec<f64> = match (&self.times, self.output_interval, self.ncp) {
            (Some(times), ..) => snap(times, start..end, time_tolerance, &self.suggested(experiment))?,
            (_, Some(interval), _) => intervals(start, end, time_tolerance, interval)?,
            (_, _, Some(0)) => return Err(BadSetting("ncp = 0: expected at least 1 interval".to_owned())),
            (_, _, ncp) => {
                let n = ncp.unwrap_or(DEFAULT_INTERVALS);
                interval = Some((end - start) / n as f64);
                uniform(start, end, time_tolerance, n)?
            }
        };
        if self.times.is_some() {
            interval = common_interval(&times, start, time_tolerance);
        }
        Ok(Grid { start, end, time_tolerance, times, interval })
    }
}

impl SimulateOptions {
    /// Returns a note for messages about a start or end time that the model's default experiment supplies.
    fn suggested(&self, experiment: &DefaultExperiment) -> String {
        let of_model = [
            experiment.start_time.filter(|_| self.start_time.is_none()).map(|t| ("start", t, "start_time")),
            experiment.stop_time.filter(|_| self.final_time.is_none()).map(|t| ("end", t, "final_time")),
        ];
        let reported = |(what, time, option): (&str, f64, &str)| {
            format!("; {} is the {what} time of the model, which {option} overrides", Number(time))
        };
        of_model.into_iter().flatten().map(reported).collect()
    }
}

/// Time span and rows of a simulation.
#[derive(Debug, PartialEq)]
pub(crate) struct Grid {
    pub(crate) start: f64,
    pub(crate) end: f64,
    /// Difference below which two times count as equal.
    pub(crate) time_tolerance: f64,
    pub(crate) times: Vec<f64>,
    /// Row spacing, if it is constant.
    pub(crate) interval: Option<f64>,
}

impl Grid {
    /// Returns the row spacing, or its mean if it is not constant.
    pub(crate) fn mean_interval(&self) -> f64 {
        let n = self.times.len().saturating_sub(1).max(1);
        self.interval.unwrap_or((self.end - self.start) / n as f64)
    }
}

/// Returns the ends of `n` equal intervals: `start + k h`, never a sum, and exactly `end`. Rows closer than
/// the time tolerance are omitted.
fn uniform(start: f64, end: f64, time_tolerance: f64, n: usize) -> Result<Vec<f64>> {
    if start == end {
        return Ok(vec![start]);
    }
    if n > MAX_ROWS {
        return Err(BadSetting(format!("{n} intervals exceed the limit of {MAX_ROWS}")));
    }
    let h = (end - start) / n as f64;
    let mut times = vec![start];
    let mut last = start;
    for t in (1..n).map(|k| start + k as f64 * h) {
        if t - last > time_tolerance && end - t > time_tolerance {
            times.push(t);
            last = t;
        }
    }
    times.push(end);
    Ok(times)
}

/// Returns the spacing of an explicit list of rows if it is constant and the first row is at the start.
fn common_interval(times: &[f64], start: f64, time_tolerance: f64) -> Option<f64> {
    let (first, last) = (times.first()?, times.last()?);
    let n = times.len() - 1;
    let interval = (last - first) / n as f64;
    let is_regular =
        |(k, time): (usize, &f64)| (time - (start + k as f64 * interval)).abs() <= time_tolerance;
    (n > 1 && interval > time_tolerance && times.iter().enumerate().all(is_regular)).then_some(interval)
}

/// Returns rows with spacing `interval`, and a row at the end.
fn intervals(start: f64, end: f64, time_tolerance: f64, interval: f64) -> Result<Vec<f64>> {
    if !(interval > 0.0 && interval.is_finite()) {
        return Err(BadSetting(format!(
            "output_interval = {} must be positive and finite",
            Number(interval)
        )));
    }
    let count = ((end - start) / interval).ceil();
    if count > MAX_ROWS as f64 || interval <= time_tolerance {
        return Err(BadSetting(format!(
            "output_interval = {} from {} to {} results in more rows than the limit of {MAX_ROWS}",
            Number(interval),
            Number(start),
            Number(end)
        )));
    }
    Ok((0..=count as usize)
        .map(|k| start + k as f64 * interval)
        .take_while(|t| *t < end - time_tolerance)
        .chain([end])
        .collect())
}

/// Checks the requested times. Merges times that are within rounding of each other, or of the ends of the
/// time span.
fn snap(times: &[f64], span: Range<f64>, time_tolerance: f64, suggested: &str) -> Result<Vec<f64>> {
    let Range { start, end } = span;
    let mut snapped: Vec<f64> = memory::list_of("the list of times", times.len())?;
    for (i, &time) in times.iter().enumerate() {
        if !(time >= start - time_tolerance && time <= end + time_tolerance) {
            return Err(BadSetting(format!(
                "times[{i}] = {} is outside the span of the simulation, {} to {}{suggested}",
                Number(time),
                Number(start),
                Number(end)
            )));
        }
        let mut time = if time <= start + time_tolerance {
            start
        } else if time >= end - time_tolerance {
            end
        } else {
            time
        };
        if let Some(&before) = snapped.last() {
            if times[i] < times[i - 1] {
                return Err(BadSetting(format!(
                    "times must not decrease: times[{i}] = {} follows {}",
                    Number(times[i]),
                    Number(times[i - 1])
                )));
            }
            if time - before <= time_tolerance {
                time = before;
            }
            if i > 1 && time == snapped[i - 2] {
                return Err(BadSetting(format!(
                    "times[{i}] = {} occurs a third time; expected at most two occurrences (left and right \
                     limit)",
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
    fn grid_has_500_intervals_by_default() {
        let g = grid(&SimulateOptions::new().final_time(40.0));
        assert_eq!((g.start, g.end, g.times.len()), (0.0, 40.0, 501));
        assert_eq!((g.times[1], g.times[500]), (0.08, 40.0));
        let one = grid(&SimulateOptions::new().start_time(0.1).final_time(1.1).ncp(1));
        assert_eq!(one.times, [0.1, 1.1]);
        assert_eq!(grid(&SimulateOptions::new().final_time(0.0)).times, [0.0]);
    }

    #[test]
    fn grid_omits_rows_closer_than_the_tolerance() {
        let g = grid(&SimulateOptions::new().start_time(1e9).final_time(1e9 + 1e-5));
        assert_eq!((g.times[0], *g.times.last().unwrap()), (1e9, 1e9 + 1e-5));
        assert!(g.times.windows(2).all(|pair| pair[1] > pair[0]), "{:?}", g.times);
        let g = grid(&SimulateOptions::new().start_time(1e9).final_time(1e9 + 1.0));
        assert!(g.times.len() > 400 && g.times.windows(2).all(|pair| pair[1] - pair[0] > g.time_tolerance));
        assert!(
            problem(&SimulateOptions::new().start_time(-1.5e308).final_time(1.5e308)).contains("too long")
        );
    }

    #[test]
    fn output_interval_adds_a_row_at_the_final_time() {
        let times = |interval| grid(&SimulateOptions::new().final_time(1.0).output_interval(interval)).times;
        assert_eq!(times(0.5), [0.0, 0.5, 1.0]);
        assert_eq!(times(0.1).len(), 11);
        assert_eq!(times(0.4), [0.0, 0.4, 0.8, 1.0]);
        assert_eq!(times(7.0), [0.0, 1.0]);
    }

    #[test]
    fn default_stop_time_takes_precedence_over_the_last_of_times() {
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
    fn grid_merges_times_within_rounding() {
        let three = 0.1 + 0.2;
        let g = grid(&SimulateOptions::new().times([-1e-17, 0.3, three, 1.0 + 1e-15]).final_time(1.0));
        assert_eq!(g.times, [0.0, 0.3, 0.3, 1.0]);
    }

    #[test]
    fn grid_errors_contain_the_invalid_numbers() {
        let end = || SimulateOptions::new().final_time(1.0);
        assert!(problem(&end().ncp(2).output_interval(0.1)).contains("at most one"));
        assert!(problem(&end().ncp(0)).contains("ncp = 0"));
        assert!(problem(&end().times([0.5, 0.2])).contains("times[1] = 0.2 follows 0.5"));
        assert!(problem(&end().times([0.5, 0.5, 0.5])).contains("third"));
        assert!(problem(&end().times([f64::NAN])).contains("NaN"));
        assert!(problem(&end().times([2.0])).contains("times[0] = 2"));
        assert!(problem(&end().output_interval(-0.1)).contains("-0.1"));
        assert!(problem(&end().output_interval(1e-300)).contains("limit"));
        assert!(problem(&SimulateOptions::new().final_time(f64::INFINITY)).contains("inf"));
        assert!(problem(&end().start_time(2.0)).contains("from 2 to 1"));
    }

    #[test]
    fn method_options_use_the_tolerance_of_the_model_if_valid() {
        let tolerance = |suggested| {
            let experiment = DefaultExperiment { tolerance: suggested, ..NONE };
            SimulateOptions::new().method_options(&experiment).relative_tolerance
        };
        assert_eq!(tolerance(Some(1e-4)), 1e-4);
        assert_eq!(tolerance(Some(0.0)), 1e-6);
        assert_eq!(tolerance(None), 1e-6);
    }
}
