//! Times in another unit than s, as the response of the model tells.

use super::experiment_subject::ExperimentSubject;
use super::simulated_outputs::{Evaluations, Outputs, all_series, rounded, rounded_time, unexplained};
use crate::cost::failure::CostFailure;
use crate::cost::residual::CostRule;
use crate::error::CalibrationError;
use crate::findings::finding::Finding;
use crate::loaded::calibration::Calibration;
use base::Number;
use dfo::RobustLoss;
use std::time::{Duration, Instant};

/// A simulation that leaves more of the variance of the measurements than this has not followed them.
const UNEXPLAINED: f64 = 0.5;

/// A fit that leaves more of it than this is worse than one at which times are not looked at again.
const POOR: f64 = 0.05;

/// Another reading of the times by a factor of at least this,
const FAR_OFF: f64 = 1e3;
/// leaves so small a part of what the simulation at the start values leaves with the times as they are;
const BETTER_FAR_OFF: f64 = 0.1;
/// one by a smaller factor, which start values may be off by, this part;
const BETTER: f64 = 0.04;
/// and this part of what a poor fit leaves.
const BETTER_THAN_FIT: f64 = 0.2;

/// A fit that has taken up another unit has moved a parameter by its factor, but for this one.
const TAKEN: f64 = 3.0;

/// A simulation of longer times may take so many times as long as one of those given,
const PATIENCE: f64 = 20.0;
/// and this time in any case.
const LEAST_PATIENCE: Duration = Duration::from_millis(500);

/// Times from 0 or 1 on by ones, of at least so many rows,
const FEWEST_ROWS: usize = 5;
/// are numbers of rows where they are so many times as long as the experiment that the model suggests, or as
/// small a part of it.
const ROWS: f64 = 15.0;

/// Recordings that last so many times the experiment that the model suggests, or this part of it.
const FAR: (f64, f64) = (100.0, 1.0 / 20.0);

/// Units of time, by how many of them a second has.
const UNITS: [(f64, &str); 4] = [(1e6, "us"), (1e3, "ms"), (1.0 / 60.0, "min"), (1.0 / 3600.0, "h")];

/// The ratio of durations is about that of a unit within this factor.
const ABOUT: f64 = 1.5;

/// Another reading of the times of all recordings.
#[derive(Clone, Copy)]
struct Reading {
    /// What they are multiplied with.
    factor: f64,
    of: ReadAs,
}

#[derive(Clone, Copy)]
enum ReadAs {
    Unit(&'static str),
    /// Numbers of rows of a recording that takes as long as the model suggests, in s.
    Rows(f64),
}

impl Reading {
    /// The readings that the times allow: of ms and us a row is at least a half.
    fn all(subjects: &[ExperimentSubject<'_>]) -> Vec<Self> {
        let is_coarse =
            |s: &ExperimentSubject<'_>| s.experiment.data.sampling_interval().is_some_and(|dt| dt >= 0.5);
        let is_coarse = subjects.iter().all(is_coarse);
        let units = UNITS
            .into_iter()
            .map(|(per_second, unit)| Self { factor: 1.0 / per_second, of: ReadAs::Unit(unit) });
        let units = units.filter(|reading| reading.factor > 1.0 || is_coarse);
        units.chain(Self::rows(subjects)).collect()
    }

    fn rows(subjects: &[ExperimentSubject<'_>]) -> Option<Self> {
        let [subject] = subjects else { return None };
        let (duration, asked) = subject.durations()?;
        let time = subject.experiment.data.time();
        let is_numbered = time.len() >= FEWEST_ROWS
            && (time[0] == 0.0 || time[0] == 1.0)
            && time.windows(2).all(|pair| pair[1] - pair[0] == 1.0);
        let is_other = !(1.0 / ROWS..=ROWS).contains(&(duration / asked));
        (is_numbered && is_other).then(|| Self { factor: asked / duration, of: ReadAs::Rows(asked) })
    }

    /// What is said of recordings that the simulation at the start values follows so many times closer by
    /// this reading.
    fn finding(self, subject: &ExperimentSubject<'_>, closer: f64) -> Finding {
        let time = subject.experiment.data.time();
        let closer = Number(rounded(closer));
        let (sentence, remedy) = match self.of {
            ReadAs::Unit(unit) => (
                format!(
                    "it lasts {} s; with times in {unit} the simulation at the start values is {closer} times closer: the times look as \
                     if they were in {unit}",
                    Number(rounded_time(time[time.len() - 1] - time[0]))
                ),
                format!("state the unit in the name of the column: 'time [{unit}]'"),
            ),
            ReadAs::Rows(end) => (
                format!(
                    "its times are {}, {}, {} and so on to {}; with as many rows in {} s, which the experiment that the model suggests \
                     lasts, the simulation at the start values is {closer} times closer: the times look like numbers of rows",
                    Number(time[0]),
                    Number(time[1]),
                    Number(time[2]),
                    Number(time[time.len() - 1]),
                    Number(end)
                ),
                "give the times in s as the column of times".to_owned(),
            ),
        };
        Finding::warning(format!("{}{}", subject.prefix, subject.experiment.data.source()), sentence, remedy)
    }
}

/// Recordings whose times look as if they were in another unit.
///
/// # Errors
/// [`CalibrationError::Cancelled`].
pub(super) fn findings(
    calibration: &Calibration,
    subjects: &[ExperimentSubject<'_>],
    outputs: &Outputs<'_>,
    evaluations: &mut Evaluations<'_>,
) -> Result<Vec<Finding>, CalibrationError> {
    let as_given = unexplained(&outputs.at_start);
    if as_given < UNEXPLAINED || subjects.iter().any(|subject| subject.experiment.data.has_dates()) {
        return Ok(Vec::new());
    }
    let fitted = outputs.fitted.as_ref().map(|fitted| unexplained(fitted));
    let is_open = fitted.is_some_and(|left| left >= UNEXPLAINED);
    let mut limit = None;
    for reading in Reading::all(subjects) {
        let factor = reading.factor.max(1.0 / reading.factor);
        let better = if factor >= FAR_OFF { BETTER_FAR_OFF } else { BETTER };
        let most = match fitted {
            Some(left) if !is_open && !outputs.has_moved_by(factor / TAKEN) => {
                if left < POOR {
                    continue;
                }
                BETTER_THAN_FIT * left
            }
            _ => UNEXPLAINED,
        };
        let Some(other) = read_otherwise(calibration, reading.factor) else { continue };
        if reading.factor > 1.0 && limit.is_none() {
            limit = Some(patience(calibration, evaluations)?);
        }
        if let Some(left) = left_by(&other, limit.filter(|_| reading.factor > 1.0), evaluations)?
            && left < better * as_given
            && left < most
        {
            return Ok(vec![reading.finding(&subjects[0], (as_given / left).sqrt())]);
        }
    }
    let far = subjects.iter().filter_map(far_from_default_experiment);
    let far = far.filter(|(_, ratio)| is_open || outputs.may_have_taken(*ratio)).map(|(finding, _)| finding);
    Ok(far.collect())
}

/// A recording that lasts much longer or shorter than the experiment that the model suggests, and the ratio;
/// not the one that is [exactly](super::times::findings) so many units long.
fn far_from_default_experiment(subject: &ExperimentSubject<'_>) -> Option<(Finding, f64)> {
    let (duration, asked) = subject.durations()?;
    let ratio = duration / asked;
    if super::times::unit_by_duration(subject).is_some() || (ratio <= FAR.0 && ratio >= FAR.1) || ratio == 0.0
    {
        return None;
    }
    let near = UNITS.into_iter().find(|(factor, _)| (ratio / factor).ln().abs() < ABOUT.ln());
    let likely = near.map_or("in another unit than s".to_owned(), |(_, unit)| format!("in {unit}"));
    let example = near.map_or(if ratio > 1.0 { "ms" } else { "min" }, |(_, unit)| unit);
    let finding = Finding::warning(
        format!("{}{}", subject.prefix, subject.experiment.data.source()),
        format!(
            "it lasts {} s, {} times the {} s of the experiment that the model suggests, and the simulation at the start values does not \
             follow it: are its times {likely}?",
            Number(rounded(duration)),
            Number(rounded(ratio)),
            Number(asked)
        ),
        format!("state the unit in the name of the column: 'time [{example}]'"),
    );
    Some((finding, ratio))
}

/// The part of the variance of the measurements that the simulation at the start values leaves, within a time
/// if there is a limit; `None` where there is no such simulation.
///
/// # Errors
/// [`CalibrationError::Cancelled`].
fn left_by(
    calibration: &Calibration,
    limit: Option<Duration>,
    evaluations: &mut Evaluations<'_>,
) -> Result<Option<f64>, CalibrationError> {
    evaluations.n += 1;
    let mut residuals = vec![0.0; calibration.n_residuals()];
    let context = limit.map_or(evaluations.context, |limit| evaluations.context.within(Some(limit)));
    let rule = CostRule::whole(RobustLoss::default(), &context);
    match calibration.evaluate_into(&calibration.start(), rule, &mut residuals, &mut evaluations.stats) {
        Ok(_) => Ok(Some(unexplained(&all_series(calibration, &residuals)))),
        Err(CostFailure::Cancelled) if evaluations.context.is_over() => Err(CalibrationError::Cancelled),
        Err(_) => Ok(None),
    }
}

/// The time that a simulation of longer times may take: it might take any.
///
/// # Errors
/// [`CalibrationError::Cancelled`].
fn patience(
    calibration: &Calibration,
    evaluations: &mut Evaluations<'_>,
) -> Result<Duration, CalibrationError> {
    let began = Instant::now();
    left_by(calibration, None, evaluations)?;
    Ok(began.elapsed().mul_f64(PATIENCE).max(LEAST_PATIENCE))
}

/// The same calibration with its times multiplied with a factor; `None` where a function of time drives an
/// input.
fn read_otherwise(calibration: &Calibration, factor: f64) -> Option<Calibration> {
    let mut problem = calibration.problem().clone();
    for experiment in &mut problem.experiments {
        if experiment.driven_by_function().is_some() {
            return None;
        }
        experiment.data.scale_times(factor);
        let windows = experiment.windows.iter_mut();
        windows.for_each(|(from, to)| (*from, *to) = (factor * *from, factor * *to));
        experiment.warm_up = experiment.warm_up.map(|seconds| factor * seconds);
        experiment.start_time = experiment.start_time.map(|start| factor * start);
        experiment.delays.iter_mut().for_each(|(_, delay)| *delay *= factor);
    }
    calibration.derived(problem).ok()
}
