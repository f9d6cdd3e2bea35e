//! Rows that are too far apart to show what the simulation does between them.

use super::simulated_outputs::{Evaluations, Place, Series, all_series, rounded, size};
use crate::cost::residual::PointResiduals;
use crate::data::sampling_interval;
use crate::error::CalibrationError;
use crate::findings::finding::Finding;
use crate::loaded::calibration::Calibration;
use base::Number;
use dfo::RobustLoss;
use ode::Stats;

/// Fewer pairs of steps show no oscillation.
const FEWEST: usize = 8;

/// Recordings with more rows are not looked at: whoever records so many knows how fast the machine is.
const MOST: usize = 500;

/// Steps of half an interval that are smaller than this part of the standard deviation of the rows are no
/// oscillation.
const SMALL: f64 = 0.1;

/// A solver takes more steps than this from row to row where the solution turns back between them.
const STEPS: u64 = 3;

/// False for simulations whose solver takes too few steps for an output to turn back between rows.
pub(super) fn may_turn_back(stats: &Stats) -> bool {
    stats.accepted_steps >= STEPS * stats.samples
}

/// An output that oscillates too fast for its rows: values midway between them are simulated, and steps of
/// half an interval turn back more than they go on. Those of a sine turn back from a frequency of half the
/// sampling rate on (Nyquist), and the rows are those of a slower one, too.
///
/// # Errors
/// [`CalibrationError::Cancelled`].
pub(super) fn finding(
    calibration: &Calibration,
    at: &PointResiduals,
    place: Place,
    evaluations: &mut Evaluations<'_>,
) -> Result<Option<Finding>, CalibrationError> {
    let outputs = &calibration.residual_layout().outputs;
    if outputs.iter().any(|output| output.times.len() > MOST) {
        return Ok(None);
    }
    let Some((between, intervals)) = midway(calibration) else { return Ok(None) };
    evaluations.n += 1;
    let (loss, context) = (RobustLoss::default(), evaluations.context);
    let residuals = between.residuals_with(None, &at.x, loss, &context, &mut evaluations.stats)?;
    let Some(residuals) = residuals else { return Ok(None) };
    let (rows, between) = (all_series(calibration, &at.residuals), all_series(&between, &residuals));
    let is_fast = |(rows, between): &(&Series<'_>, &Series<'_>)| {
        turns_back(rows, between, intervals[rows.of.experiment])
    };
    Ok(rows.iter().zip(&between).find(is_fast).map(|(rows, _)| {
        let interval = intervals[rows.of.experiment];
        let sentence = format!(
            "the simulation {place} turns back within the {} s from row to row: rows so far apart cannot tell a frequency above {} Hz \
             from a lower one",
            Number(rounded(interval)),
            Number(rounded(0.5 / interval))
        );
        Finding::warning(
            format!("output '{}' (column '{}')", rows.of.variable, rows.of.column),
            sentence,
            "record faster; until then fits from other start values may end elsewhere and be as good",
        )
    }))
}

/// The same calibration with each measurement half an interval earlier, and the intervals of the experiments;
/// `None` where it cannot be simulated so.
fn midway(calibration: &Calibration) -> Option<(Calibration, Vec<f64>)> {
    let mut problem = calibration.problem().clone();
    let mut intervals = Vec::new();
    for (experiment, simulation) in problem.experiments.iter_mut().zip(&calibration.evaluator().simulations) {
        let interval = sampling_interval(experiment.data.time())?;
        let first = simulation.options.start_time.unwrap_or_default() + 0.75 * interval;
        simulation.keep_start(experiment);
        experiment.start_time = simulation.options.start_time;
        let end = *experiment.data.time().last()?;
        match experiment.windows.as_mut_slice() {
            [] => experiment.windows.push((first, end)),
            windows => windows.iter_mut().for_each(|(from, _)| *from = from.max(first)),
        }
        let variables: Vec<String> = experiment.outputs().map(|(variable, _)| variable.to_owned()).collect();
        for variable in variables {
            match experiment.delays.iter_mut().find(|(name, _)| *name == variable) {
                Some((_, delay)) => *delay += 0.5 * interval,
                None => experiment.delays.push((variable, 0.5 * interval)),
            }
        }
        intervals.push(interval);
    }
    Some((calibration.derived(problem).ok()?, intervals))
}

/// True if the steps from rows to the values midway, and on to the next rows, go to opposite sides for the
/// most part.
fn turns_back(rows: &Series<'_>, between: &Series<'_>, interval: f64) -> bool {
    let times = &rows.of.times;
    let pairs = between.of.times.iter().zip(&between.simulated).filter_map(|(time, middle)| {
        let k = times.partition_point(|t| t < time);
        let before = k.checked_sub(1)?;
        let is_next =
            times.get(k) == Some(time) && (times[k] - times[before] - interval).abs() < 0.01 * interval;
        is_next.then(|| (middle - rows.simulated[before], rows.simulated[k] - middle))
    });
    let pairs: Vec<(f64, f64)> = pairs.collect();
    let product: f64 = pairs.iter().map(|(a, b)| a * b).sum();
    let n = rows.simulated.len() as f64;
    let mean = rows.simulated.iter().sum::<f64>() / n;
    let deviation = size(rows.simulated.iter().map(|s| s - mean));
    pairs.len() >= FEWEST && product < 0.0 && size(pairs.iter().map(|(a, _)| *a)) > SMALL * deviation
}
