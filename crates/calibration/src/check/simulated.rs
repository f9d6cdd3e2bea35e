//! What an evaluation at the start values shows: measurements in another unit, swapped, or far from the simulation from the start.

use super::subject::Subject;
use crate::calibration::Calibration;
use crate::column_units::declared;
use crate::data::{UnitConversion, parts, sampling_interval};
use crate::error::CalibrationError;
use crate::finding::{Finding, Severity};
use crate::layout::OutputResiduals;
use crate::no_cost::NoCost;
use crate::residual::CostRule;
use dfo::RobustLoss;
use ode::{Number, Stats};
use std::f64::consts::PI;
use std::fmt;

/// Measured and simulated values that differ in size by less than this are left to the parameters.
const LARGE: f64 = 30.0;

/// Ratios that units explain, and the units; `true`: of an angle.
const RATIOS: [(f64, &str, bool); 7] = [
    (180.0 / PI, "deg against rad", true),
    (100.0, "cm against m, or % against 1", false),
    (1e3, "mm against m, or kPa against Pa", false),
    (1e4, "cm2 against m2", false),
    (1e5, "bar against Pa", false),
    (1e6, "MPa against Pa, or mm2 against m2", false),
    (1e9, "GPa against Pa, or mm3 against m3", false),
];

/// Smaller ratios, which parameters explain as well: only where the simulation, times the ratio, is this part of the size of the
/// measurements away from them.
const SMALL_RATIOS: [(f64, &str); 4] = [
    (3.6, "km/h against m/s"),
    (60.0 / (2.0 * PI), "rpm against rad/s"),
    (2.0 * PI, "Hz against rad/s"),
    (60.0, "1/min against 1/s"),
];
const CLOSE: f64 = 0.1;

/// A simulation that leaves more of the variance of the measurements than this has not followed them.
const UNEXPLAINED: f64 = 0.5;

/// A millisecond in s.
const MILLI: f64 = 1e-3;

/// 0 degC in K.
const ZERO_CELSIUS: f64 = 273.15;

/// Values of the parameters, and the residuals there.
pub(super) struct Evaluated {
    pub(super) x: Vec<f64>,
    pub(super) residuals: Vec<f64>,
}

/// Evaluations that are made: how many, and what they take.
pub(super) struct Evaluations<'a> {
    pub(super) cancelled: &'a dyn Fn() -> bool,
    pub(super) n: usize,
    pub(super) stats: Stats,
}

/// Where the parameters are as they are looked at.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Place {
    Start,
    Fitted,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Start => "at the start values",
            Self::Fitted => "at the fitted values",
        })
    }
}

/// An output as it was measured and simulated.
struct Series<'a> {
    of: &'a OutputResiduals,
    simulated: Vec<f64>,
}

/// The findings of all experiments at the start, judged again where there is a result of a fit: what holds an output or its initial
/// value off may have been fitted. Another unit, or swapped columns, parameters make up for by values that mean nothing: such doubts
/// stay if the parameters have moved as far as that takes, or the result has them, too.
///
/// # Errors
/// [`CalibrationError::Cancelled`].
pub(super) fn findings(
    calibration: &Calibration,
    subjects: &[Subject<'_>],
    (at_start, fitted): (&Evaluated, Option<&Evaluated>),
    evaluations: &mut Evaluations<'_>,
) -> Result<Vec<Finding>, CalibrationError> {
    let series = all_series(calibration, &at_start.residuals);
    let fitted_series = fitted.map(|fitted| all_series(calibration, &fitted.residuals));
    let place = if fitted.is_some() { Place::Fitted } else { Place::Start };
    let may_be = |factor: f64| fitted.is_none_or(|fitted| has_moved((&at_start.x, &fitted.x), factor));
    let mut findings = Vec::new();
    for (k, one) in series.iter().enumerate() {
        let subject = &subjects[one.of.experiment];
        let last = fitted_series.as_ref().map_or(one, |fitted| &fitted[k]);
        let of_unit =
            unit(one, subject).filter(|(_, factor)| may_be(*factor) || unit(last, subject).is_some());
        // In another unit everything else is off, too.
        let found = of_unit.map(|(finding, _)| finding);
        findings.extend(found.or_else(|| held(last, subject, place)).or_else(|| initial(last, subject)));
    }
    findings.extend(swapped(&series, subjects));
    if may_be(MILLI.recip())
        || fitted_series.as_ref().is_some_and(|fitted| unexplained(fitted) >= UNEXPLAINED)
    {
        findings.extend(in_milliseconds(calibration, &series, subjects, evaluations)?);
    }
    Ok(findings)
}

/// Whether a fit has moved a parameter as far as a factor in the data or in time takes, by half of it on a logarithmic scale, or from
/// zero or through it.
fn has_moved((start, x): (&[f64], &[f64]), factor: f64) -> bool {
    let has = |(from, to): (&f64, &f64)| {
        from != to && (from * to <= 0.0 || (to / from).ln().abs() >= 0.5 * factor.ln().abs())
    };
    start.iter().zip(x).any(has)
}

fn all_series<'a>(calibration: &'a Calibration, residuals: &[f64]) -> Vec<Series<'a>> {
    let simulated = |of: &OutputResiduals| {
        let own = residuals[of.range.clone()].iter().zip(&of.weights).zip(&of.measured);
        own.map(|((r, w), measured)| measured + r / w).collect()
    };
    calibration.residual_layout().outputs.iter().map(|of| Series { of, simulated: simulated(of) }).collect()
}

impl Series<'_> {
    fn name(&self, subject: &Subject<'_>) -> String {
        format!("{}output '{}' (column '{}')", subject.prefix, self.of.variable, self.of.column)
    }
}

fn range(values: &[f64]) -> f64 {
    let (low, high) =
        values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    high - low
}

/// Root of the mean square.
fn size(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    (values.map(|v| v * v).sum::<f64>() / n).sqrt()
}

fn size_of_difference(measured: &[f64], simulated: impl Iterator<Item = f64>) -> f64 {
    let differences: Vec<f64> = measured.iter().zip(simulated).map(|(m, s)| m - s).collect();
    size(differences.into_iter())
}

/// Measurements whose range and size are both some other multiple of those of the simulation, with the factor; or that are 273.15
/// away, which a parameter may make up for at any size.
fn unit(series: &Series<'_>, subject: &Subject<'_>) -> Option<(Finding, f64)> {
    let (measured, simulated) = (&series.of.measured, &series.simulated);
    let unit = declared(subject.description, &series.of.variable).and_then(|v| v.unit.as_deref());
    let (m, s) = (size(measured.iter().copied()), size(simulated.iter().copied()));
    let (range_m, range_s) = (range(measured), range(simulated));
    if measured.len() < 3 || !(m > 0.0 && s > 0.0 && range_m > 0.0) {
        return None;
    }
    let stated = unit.map_or_else(
        || "the unit of the model".to_owned(),
        |unit| format!("'{unit}', the unit of the model"),
    );
    let remedy = match subject.example_unit(&series.of.variable) {
        Some(example) => format!(
            "state the unit in the name of the column, as in '{} [{example}]', or convert it to {stated}",
            parts(&series.of.column).0
        ),
        None => format!("convert it to {stated}"),
    };
    let finding = |sentence: String, factor: f64| {
        Some((Finding::new(Severity::Warning, series.name(subject), sentence, remedy.clone()), factor))
    };
    let off = size_of_difference(measured, simulated.iter().copied());
    let times = |factor: f64| size_of_difference(measured, simulated.iter().map(|s| factor * s));
    let is_temperature = unit.is_some_and(|unit| UnitConversion::between("degC", unit).is_ok());
    for zero in [ZERO_CELSIUS, -ZERO_CELSIUS] {
        let left = size_of_difference(measured, simulated.iter().map(|s| s - zero));
        // Values whose unit the model does not state may as well be some multiple.
        let is_multiple =
            || SMALL_RATIOS.iter().any(|(factor, _)| times(*factor).min(times(1.0 / factor)) < left);
        let may_be = is_temperature || unit.is_none() && !is_multiple();
        if may_be && left < 0.3 * off && off > 0.5 * ZERO_CELSIUS {
            let sentence = format!(
                "the measurements are {} off the simulation at the start values, about as degC from K: another unit?",
                Number(rounded(off))
            );
            return finding(sentence, 1.0);
        }
    }
    // Neither ratio is that of the parameters alone, if both are so large: a gain that is wrong by so much is worth the same words.
    let ratio = (m / s, range_m / range_s);
    let is_large = |r: f64| !(1.0 / LARGE..=LARGE).contains(&r);
    if range_s > 0.0
        && is_large(ratio.0)
        && is_large(ratio.1)
        && (ratio.0 / ratio.1).ln().abs() < LARGE.ln() / 2.0
    {
        let middle = (ratio.0 * ratio.1).sqrt();
        let is_angle = unit.is_some_and(|unit| unit.starts_with("rad") || unit.starts_with("deg"));
        let near = |(factor, _, only_angles): &&(f64, &str, bool)| {
            (middle.ln().abs() - factor.ln()).abs() < 2f64.ln()
                && (!*only_angles || is_angle)
                && !is_temperature
        };
        let hint = RATIOS.iter().find(near).map_or_else(String::new, |(_, units, _)| format!(" ({units})"));
        let numbers = [range_m, range_s].map(|range| Number(rounded(range)));
        let sentence = format!(
            "the measurements range over {}, the simulation at the start values over {}: the ratio is about {}, as of another unit{hint}, \
             or of parameters that start far off",
            numbers[0],
            numbers[1],
            Number(rounded(middle))
        );
        return finding(sentence, middle);
    }
    for (factor, units) in SMALL_RATIOS.into_iter().filter(|_| !is_temperature) {
        for factor in [factor, 1.0 / factor] {
            let left = times(factor);
            if left < CLOSE * m && left < CLOSE * off {
                let sentence = format!(
                    "the measurements are {} times the simulation at the start values, up to {} of their size: another unit ({units})?",
                    Number(rounded(factor)),
                    Number(rounded(left / m))
                );
                return finding(sentence, factor);
            }
        }
    }
    None
}

/// Three digits.
pub(super) fn rounded(value: f64) -> f64 {
    if value == 0.0 {
        return value;
    }
    let ten = 10f64.powi(2 - value.abs().log10().floor() as i32);
    if ten.is_finite() && ten > 0.0 { (value * ten).round() / ten } else { value }
}

/// Outputs that stay where they start in the simulation, but not in the recording.
fn held(series: &Series<'_>, subject: &Subject<'_>, place: Place) -> Option<Finding> {
    let (measured, simulated) = (&series.of.measured, &series.simulated);
    let is_held = simulated.len() > 2 && range(simulated) <= 1e-12 * size(simulated.iter().copied());
    (is_held && range(measured) > 0.0).then(|| {
        Finding::new(
            Severity::Warning,
            series.name(subject),
            format!(
                "the simulation {place} holds it at {}, the measurements range over {}",
                Number(rounded(simulated[0])),
                Number(rounded(range(measured)))
            ),
            "is an input missing, or an initial value? Is it the right variable?",
        )
    })
}

/// Outputs that start far from their first measurement: by a quarter of the range, and by ten times the noise.
fn initial(series: &Series<'_>, subject: &Subject<'_>) -> Option<Finding> {
    let (measured, simulated) = (&series.of.measured, &series.simulated);
    let (times, start) = (&series.of.times, subject.start_time);
    let interval = sampling_interval(times)?;
    if measured.len() < 10 || times[0] - start > 1.5 * interval {
        return None;
    }
    let mut steps: Vec<f64> = measured.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    let middle = steps.len() / 2;
    let noise = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
    let off = (simulated[0] - measured[0]).abs();
    (off > 0.25 * range(measured) && off > 10.0 * noise).then(|| {
        let [first, at_start] = [measured[0], simulated[0]].map(|v| Number(rounded(v)));
        Finding::new(
            Severity::Warning,
            series.name(subject),
            format!("the first measurement is {first}, the simulation starts at {at_start}"),
            "give the initial state (start_values or initial_states), or fit it",
        )
    })
}

/// Two outputs of one experiment that are much closer to each other's simulation than to their own.
fn swapped(series: &[Series<'_>], subjects: &[Subject<'_>]) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (i, a) in series.iter().enumerate() {
        for b in &series[i + 1..] {
            if a.of.experiment != b.of.experiment || a.of.times != b.of.times || a.of.times.len() < 5 {
                continue;
            }
            let off = |one: &Series<'_>, other: &Series<'_>| {
                size_of_difference(&one.of.measured, other.simulated.iter().copied()).powi(2)
            };
            // Relative to what each varies, so that two outputs of different size count the same.
            let scale = |s: &Series<'_>| range(&s.of.measured).powi(2);
            let (of_a, of_b) = (scale(a), scale(b));
            let own = off(a, a) / of_a + off(b, b) / of_b;
            let crossed = off(a, b) / of_a + off(b, a) / of_b;
            if of_a > 0.0
                && of_b > 0.0
                && crossed < 0.1 * own
                && off(a, b) < 0.5 * off(a, a)
                && off(b, a) < 0.5 * off(b, b)
            {
                let subject = &subjects[a.of.experiment];
                findings.push(Finding::new(
                    Severity::Warning,
                    format!("{}outputs '{}' and '{}'", subject.prefix, a.of.variable, b.of.variable),
                    format!(
                        "column '{}' is closer to the simulated '{}', and column '{}' to the simulated '{}'",
                        a.of.column, b.of.variable, b.of.column, a.of.variable
                    ),
                    "are the two columns swapped?",
                ));
            }
        }
    }
    findings
}

/// How much of the variance of the measurements is left, on average over the outputs.
fn unexplained(series: &[Series<'_>]) -> f64 {
    let of_one = |s: &Series<'_>| {
        let n = s.of.measured.len() as f64;
        let mean = s.of.measured.iter().sum::<f64>() / n;
        let spread = size_of_difference(&s.of.measured, std::iter::repeat(mean)).powi(2);
        let left = size_of_difference(&s.of.measured, s.simulated.iter().copied()).powi(2);
        if spread > 0.0 { left / spread } else { 0.0 }
    };
    series.iter().map(of_one).sum::<f64>() / series.len() as f64
}

/// Recordings that the simulation answers a thousand times faster: each row at least half a unit from the next, the costs of the whole a
/// tenth, and the measurements better explained than by their means.
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
    let rule = CostRule::whole(RobustLoss::default(), evaluations.cancelled);
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
                Number(duration),
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
