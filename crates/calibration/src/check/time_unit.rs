//! Times in another unit than s, as the response of the model tells.

use super::series::{Evaluations, Outputs, Series, all_series, rounded, rounded_time, unexplained};
use super::subject::Subject;
use crate::cost::calibration::Calibration;
use crate::cost::failure::NoCost;
use crate::cost::residual::CostRule;
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Severity};
use dfo::RobustLoss;
use ode::Number;

/// A simulation that leaves more of the variance of the measurements than this has not followed them.
const UNEXPLAINED: f64 = 0.5;

/// A millisecond in s.
const MILLI: f64 = 1e-3;

/// Recordings that last so many times the experiment that the model suggests, or this part of it.
const FAR: (f64, f64) = (100.0, 1.0 / 20.0);

/// Units of time, by how many of them a second has.
const UNITS: [(f64, &str); 4] = [(1e6, "us"), (1e3, "ms"), (1.0 / 60.0, "min"), (1.0 / 3600.0, "h")];

/// The ratio of durations is about that of a unit within this factor.
const ABOUT: f64 = 1.5;

/// Recordings whose times look as if they were in another unit.
///
/// # Errors
/// [`CalibrationError::Cancelled`].
pub(super) fn findings(
    calibration: &Calibration,
    subjects: &[Subject<'_>],
    outputs: &Outputs<'_>,
    evaluations: &mut Evaluations<'_>,
) -> Result<Vec<Finding>, CalibrationError> {
    let is_open = outputs.fitted.as_ref().is_some_and(|fitted| unexplained(fitted) >= UNEXPLAINED);
    if (outputs.may_have_taken(MILLI) || is_open)
        && let Some(found) = in_milliseconds(calibration, &outputs.at_start, subjects, evaluations)?
    {
        return Ok(vec![found]);
    }
    if unexplained(&outputs.at_start) < UNEXPLAINED {
        return Ok(Vec::new());
    }
    let far = subjects.iter().filter_map(far_from_default_experiment);
    let far = far.filter(|(_, ratio)| is_open || outputs.may_have_taken(*ratio)).map(|(finding, _)| finding);
    Ok(far.collect())
}

/// A recording that lasts much longer or shorter than the experiment that the model suggests, and the ratio;
/// not the one that is [exactly](super::times::findings) so many units long.
fn far_from_default_experiment(subject: &Subject<'_>) -> Option<(Finding, f64)> {
    let (duration, asked) = subject.durations()?;
    let ratio = duration / asked;
    if super::times::unit_by_duration(subject).is_some() || (ratio <= FAR.0 && ratio >= FAR.1) || ratio == 0.0
    {
        return None;
    }
    let near = UNITS.into_iter().find(|(factor, _)| (ratio / factor).ln().abs() < ABOUT.ln());
    let likely = near.map_or("in another unit than s".to_owned(), |(_, unit)| format!("in {unit}"));
    let example = near.map_or("min", |(_, unit)| unit);
    let finding = Finding::new(
        Severity::Warning,
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

/// Recordings that the simulation answers a thousand times faster: each row at least half a unit from the
/// next, the costs of the whole a tenth, and the measurements better explained than by their means.
fn in_milliseconds(
    calibration: &Calibration,
    series: &[Series<'_>],
    subjects: &[Subject<'_>],
    evaluations: &mut Evaluations<'_>,
) -> Result<Option<Finding>, CalibrationError> {
    let is_coarse =
        |s: &Subject<'_>| s.experiment.data.sampling_interval().is_some_and(|interval| interval >= 0.5);
    if !subjects.iter().all(is_coarse) {
        return Ok(None);
    }
    let as_given = unexplained(series);
    if as_given < UNEXPLAINED {
        return Ok(None);
    }
    let Some(fast) = a_thousandth_as_long(calibration) else { return Ok(None) };
    evaluations.n += 1;
    let mut residuals = vec![0.0; fast.n_residuals()];
    let rule = CostRule::whole(RobustLoss::default(), &evaluations.context);
    match fast.evaluate_into(&fast.start(), rule, &mut residuals, &mut evaluations.stats) {
        Ok(_) => {}
        Err(NoCost::Cancelled) => return Err(CalibrationError::Cancelled),
        Err(_) => return Ok(None),
    }
    let in_ms = unexplained(&all_series(&fast, &residuals));
    let duration = subjects[0].experiment.data.time();
    let duration = duration[duration.len() - 1] - duration[0];
    Ok((in_ms < 0.1 * as_given && in_ms < UNEXPLAINED).then(|| {
        Finding::new(
            Severity::Warning,
            format!("{}{}", subjects[0].prefix, subjects[0].experiment.data.source()),
            format!(
                "it lasts {} s; with times a thousandth as long the simulation at the start values is {} times closer: the times look as if \
                 they were in ms",
                Number(rounded_time(duration)),
                Number(rounded((as_given / in_ms).sqrt()))
            ),
            "state the unit in the name of the column: 'time [ms]'",
        )
    }))
}

/// The same calibration with its times a thousandth as long.
fn a_thousandth_as_long(calibration: &Calibration) -> Option<Calibration> {
    let mut problem = calibration.problem().clone();
    for experiment in &mut problem.experiments {
        experiment.data.scale_times(MILLI);
        let windows = experiment.windows.iter_mut();
        windows.for_each(|(from, to)| (*from, *to) = (MILLI * *from, MILLI * *to));
        experiment.warm_up = experiment.warm_up.map(|seconds| MILLI * seconds);
        experiment.start_time = experiment.start_time.map(|start| MILLI * start);
        experiment.delays.iter_mut().for_each(|(_, delay)| *delay *= MILLI);
    }
    calibration.derived(problem).ok()
}
