//! Checks of an evaluation at the start values: measurements that are in a different unit, swapped, or far
//! from the simulation at the start.

use super::experiment_subject::ExperimentSubject;
use super::simulated_outputs::{Outputs, Place, Series, range, rounded, size, size_of_difference};
use crate::data::{UnitConversion, parts, sampling_interval};
use crate::findings::finding::Finding;
use crate::findings::identifier::FindingId;
use crate::problem::column_units::declared;
use crate::problem::experiment::InitialState;
use crate::problem::parameter::Parameter;
use base::Number;

/// Differences in size below this ratio are attributed to the parameters.
const LARGE: f64 = 30.0;

/// 0 degC in K.
const ZERO_CELSIUS: f64 = 273.15;

/// Returns the findings of all experiments at the start, updated with the result of a fit if there is one.
/// The fit may have removed an offset of an output or of its initial value. Parameters can also compensate
/// for a different unit or swapped columns, with meaningless values. Such a doubt remains if the parameters
/// have moved far enough to compensate, or if it also exists at the result.
pub(super) fn findings(subjects: &[ExperimentSubject<'_>], outputs: &Outputs<'_>) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (one, last) in outputs.at_start.iter().zip(outputs.last()) {
        let subject = &subjects[one.of.experiment];
        let stays = |factor: f64| outputs.may_have_taken(factor) || unit(last, subject).is_some();
        // A wrong unit also causes the other findings.
        let found = unit(one, subject).filter(|(_, factor)| stays(*factor)).map(|(finding, _)| finding);
        let found = found
            .or_else(|| held(last, subject, outputs.place()))
            .or_else(|| initial(last, subject, outputs.place()));
        findings.extend(found);
    }
    findings.extend(swapped(&outputs.at_start, subjects));
    findings
}

/// Returns a finding and a factor if the range and the size of the measurements are the same multiple of the
/// simulated range and size. Also returns a finding if they differ by 273.15, which a parameter may
/// compensate for at any size.
fn unit(series: &Series<'_>, subject: &ExperimentSubject<'_>) -> Option<(Finding, f64)> {
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
            "State the unit in the name of the column, as in '{} [{example}]', or convert it to {stated}",
            parts(&series.of.column).0
        ),
        None => format!("Convert it to {stated}"),
    };
    let finding = |sentence: String, factor: f64| {
        let id = FindingId::UnitMismatch;
        Some((Finding::warning(id, series.name(subject), sentence, remedy.clone()), factor))
    };
    let off = size_of_difference(measured, simulated.iter().copied());
    let may_be_temperature = unit.is_none_or(|unit| UnitConversion::between("degC", unit).is_ok());
    for zero in [ZERO_CELSIUS, -ZERO_CELSIUS] {
        let left = size_of_difference(measured, simulated.iter().map(|s| s - zero));
        if may_be_temperature && left < 0.3 * off && off > 0.5 * ZERO_CELSIUS {
            let sentence = format!(
                "the measurements differ from the simulation at the start values by {}, roughly the offset between degC and K. They are probably \
                 in another unit, which the parameters cannot correct",
                Number(rounded(off))
            );
            return finding(sentence, 1.0);
        }
    }
    // If both ratios are so large, parameters alone are an unlikely cause. A gain that is this wrong deserves
    // the same finding.
    let ratio = (m / s, range_m / range_s);
    let is_large = |r: f64| !(1.0 / LARGE..=LARGE).contains(&r);
    if range_s > 0.0
        && is_large(ratio.0)
        && is_large(ratio.1)
        && (ratio.0 / ratio.1).ln().abs() < LARGE.ln() / 2.0
    {
        let middle = (ratio.0 * ratio.1).sqrt();
        let numbers = [range_m, range_s].map(|range| Number(rounded(range)));
        let sentence = format!(
            "the measurements range over {}, the simulation at the start values over {}. Range and size differ by a factor of about {}: the measurements are in another unit, \
             or the parameters start far from their values",
            numbers[0],
            numbers[1],
            Number(rounded(middle))
        );
        return finding(sentence, middle);
    }
    None
}

/// Returns a finding if an output is constant in the simulation but not in the recording.
fn held(series: &Series<'_>, subject: &ExperimentSubject<'_>, place: Place) -> Option<Finding> {
    let (measured, simulated) = (&series.of.measured, &series.simulated);
    let is_held = simulated.len() > 2 && range(simulated) <= 1e-12 * size(simulated.iter().copied());
    (is_held && range(measured) > 0.0).then(|| {
        Finding::warning(
            FindingId::ConstantSimulation,
            series.name(subject),
            format!(
                "the simulation {place} is constant at {}, but the measurements range over {}. The fit cannot follow them",
                Number(rounded(simulated[0])),
                Number(rounded(range(measured)))
            ),
            "Check the inputs, the initial state and the name of the variable",
        )
    })
}

/// Returns a finding if an output starts far from its first measurement: by a quarter of the range, and by
/// ten times the noise. The start value of a state with a fitted initial value is irrelevant.
fn initial(series: &Series<'_>, subject: &ExperimentSubject<'_>, place: Place) -> Option<Finding> {
    let is_fitted = |(state, initial): &(String, InitialState)| {
        *state == series.of.variable && matches!(initial, InitialState::Fitted(_))
    };
    let is_set = |p: &Parameter| p.variable_names().contains(&series.of.variable) && !p.is_fixed();
    let is_free =
        subject.experiment.initial_states.iter().any(is_fitted) || subject.parameters.iter().any(is_set);
    if place == Place::Start && is_free {
        return None;
    }
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
        Finding::warning(
            FindingId::InitialState,
            series.name(subject),
            format!(
                "the first measurement is {first}, but the simulation starts at {at_start}. The fit compensates for the difference with \
                 wrong parameters"
            ),
            "Set the initial state (initial_states), or fit it",
        )
    })
}

/// Returns findings about two outputs of one experiment that are much closer to each other's simulation than
/// to their own.
fn swapped(series: &[Series<'_>], subjects: &[ExperimentSubject<'_>]) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (i, a) in series.iter().enumerate() {
        for b in &series[i + 1..] {
            if a.of.experiment != b.of.experiment || a.of.times != b.of.times || a.of.times.len() < 5 {
                continue;
            }
            let off = |one: &Series<'_>, other: &Series<'_>| {
                size_of_difference(&one.of.measured, other.simulated.iter().copied()).powi(2)
            };
            // Scale by the range so that outputs of different size have equal weight.
            let scale = |s: &Series<'_>| range(&s.of.measured).powi(2);
            let (of_a, of_b) = (scale(a), scale(b));
            let paired = off(a, a) / of_a + off(b, b) / of_b;
            let crossed = off(a, b) / of_a + off(b, a) / of_b;
            if of_a > 0.0
                && of_b > 0.0
                && crossed < 0.1 * paired
                && off(a, b) < 0.5 * off(a, a)
                && off(b, a) < 0.5 * off(b, b)
            {
                let subject = &subjects[a.of.experiment];
                findings.push(Finding::warning(
                    FindingId::SwappedColumns,
                    format!("{}outputs '{}' and '{}'", subject.prefix, a.of.variable, b.of.variable),
                    format!(
                        "column '{}' is closer to the simulated '{}', and column '{}' to the simulated '{}'. The fit compares \
                         the wrong columns if they are swapped",
                        a.of.column, b.of.variable, b.of.column, a.of.variable
                    ),
                    "Check which column belongs to which output",
                ));
            }
        }
    }
    findings
}
