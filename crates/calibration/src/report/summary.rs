//! Summary of a fit as tables and sentences: the content of `Display`, the notebook element and the report.

use super::number::{rounded, with_error};
use crate::findings::display_text::digits;
use crate::findings::finding::{Finding, counts, merged};
use crate::fit::one_stage::Fit;
use crate::fit::phase::PhaseCost;
use crate::problem::objective::CostKind;
use crate::uncertainty::derived_value::DerivedValue;
use crate::uncertainty::inactive_parameters::BoundSide;
use crate::uncertainty::result::{KNOWN_NOISE, Uncertainty};
use base::Number;
use dfo::Termination;
use serde::Serialize;
use std::borrow::Cow;

/// Number of digits of a number without an error.
const DIGITS: usize = 8;

/// Number of digits of an RMS, a share or an error.
const FEW_DIGITS: usize = 4;

/// Maximum number of standard errors in the sentence; for more, only the smallest and the largest are
/// printed.
const LISTED: usize = 4;

/// Degrees of freedom below which they are printed next to the standard errors.
const FEW_DEGREES: f64 = 6.0;

/// Level of the intervals: 95 %.
const LEVEL: f64 = 0.95;

/// A fit as tables and sentences.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    /// Title: the name of the model.
    pub(super) title: String,
    /// True if the run ended successfully.
    pub(super) is_success: bool,
    /// Sentence on the termination and the quality of the fit.
    pub(super) sentence: String,
    /// Findings about the fit, sorted so that causes come first.
    pub(super) findings: Vec<Finding>,
    pub(super) parameters: Vec<ParameterRow>,
    pub(super) outputs: Vec<OutputRow>,
    /// True if the fit has standard errors; the next field is true if they are corrected for autocorrelated
    /// residuals.
    pub(super) has_errors: bool,
    pub(super) has_uncorrected_errors: bool,
    /// True if outputs belong to several experiments.
    pub(super) has_several_experiments: bool,
    /// Facts about the run: names and values.
    pub(super) facts: Vec<Fact>,
}

/// A name and its value.
#[derive(Debug, Serialize)]
pub(super) struct Fact {
    pub(super) name: Cow<'static, str>,
    pub(super) value: String,
}

pub(super) fn fact((name, value): (&'static str, String)) -> Fact {
    Fact { name: name.into(), value }
}

/// A parameter.
#[derive(Debug, Serialize)]
pub(super) struct ParameterRow {
    pub(super) name: String,
    pub(super) start: String,
    pub(super) value: String,
    /// Standard error, or the reason for its absence; empty if no errors were estimated.
    pub(super) error: String,
    /// Standard error under the assumption of independent residuals, if they are not.
    pub(super) uncorrected_error: String,
    /// Bounds of the 95 % interval.
    pub(super) interval: Option<[String; 2]>,
    pub(super) unit: String,
    pub(super) bounds: [String; 2],
    pub(super) remark: String,
}

/// An output of an experiment.
#[derive(Debug, Serialize)]
pub(super) struct OutputRow {
    pub(super) experiment: String,
    pub(super) variable: String,
    pub(super) column: String,
    pub(super) n: usize,
    pub(super) rms: String,
    pub(super) start_rms: String,
    pub(super) fit_percent: String,
    pub(super) unit: String,
}

impl Summary {
    pub(super) fn new(fit: &Fit) -> Self {
        let uncertainty = fit.uncertainty.as_ref();
        let first = fit.outputs.first().map(|output| &output.experiment);
        Self {
            title: format!("{} of {}", if is_design(fit) { "Design" } else { "Fit" }, fit.model),
            is_success: fit.is_success(),
            sentence: sentence(fit),
            findings: merged(&fit.findings_with(fit.shown_names())),
            parameters: (0..fit.x.len())
                .map(|i| parameter(fit, i))
                .chain(fit.derived.iter().map(|value| derived(fit, value)))
                .collect(),
            outputs: outputs(fit),
            has_errors: uncertainty.is_some(),
            has_uncorrected_errors: uncertainty
                .is_some_and(|uncertainty| uncertainty.uncorrected_covariance.is_some()),
            has_several_experiments: fit.outputs.iter().any(|output| Some(&output.experiment) != first),
            facts: facts(fit),
        }
    }
}

/// True if the search optimised the goals of a design.
fn is_design(fit: &Fit) -> bool {
    fit.objective == CostKind::Goals.name()
}

/// Returns the sentence on the termination and the quality of the fit.
fn sentence(fit: &Fit) -> String {
    let are_several = fit.report.optima.len() > 1;
    let is_below_minima = fit.report.optima.first().is_some_and(|lowest| fit.report.fun < lowest.cost);
    let ended = match fit.report.termination.ended() {
        Termination::MaxEvaluations | Termination::MaxTime if is_below_minima => {
            "The fit returned the best point within its limits, below all minima that it found"
        }
        Termination::MaxEvaluations | Termination::MaxTime if are_several => {
            "The fit returned the lowest minimum that it found within its limits"
        }
        Termination::BeforeMinimum if fit.is_conditional() => {
            "Each stage converged, but all parameters together did not"
        }
        Termination::BeforeMinimum => "The fit ended before the minimum",
        Termination::Converged => "The fit converged",
        Termination::Noise if fit.report.is_success() => "The fit converged to the noise of the simulations",
        Termination::Noise => "The fit ended in the noise of the simulations before it converged",
        Termination::Target => "The fit reached its target",
        Termination::AllFixed => "All parameters are fixed",
        Termination::MaxEvaluations => "The fit did not converge within its limit of evaluations",
        Termination::MaxIterations => "The fit did not converge within its limit of iterations",
        Termination::MaxTime => "The fit did not converge within its time limit",
        Termination::Interrupted => "The fit was interrupted before it converged",
        Termination::StoppedByObserver => "The callback ended the fit before it converged",
        Termination::TooManyFailed => "The fit was ended because too many simulations failed",
        _ => "The fit did not converge",
    };
    let before = match fit.start_rms {
        Some(rms) => format!("at the start {}", rounded(rms, FEW_DIGITS)),
        None => "none at the start".to_owned(),
    };
    let is_noise_known = fit.uncertainty.as_ref().is_some_and(Uncertainty::is_noise_known);
    let rms = rounded(fit.rms, FEW_DIGITS) + if is_noise_known { " sigma" } else { "" };
    let counts = match counts(&fit.findings()) {
        counts if counts.is_empty() => String::new(),
        counts => format!(" {counts}."),
    };
    let errors = with_few_degrees(fit, relative_errors(fit));
    let resumed = match &fit.report.resumed {
        Some(resumed) => format!(" It was {resumed}."),
        None => String::new(),
    };
    let doubt = match (fit.is_usable(), fit.is_success()) {
        (true, _) => "",
        (false, true) => ", but its result should not be used",
        (false, false) => ", and its result should not be used",
    };
    if is_design(fit) {
        let before = fit
            .start_cost
            .map_or_else(String::new, |cost| format!(" (at the start {})", rounded(cost, DIGITS)));
        let ended = ended.replacen("fit", "search", 1);
        return format!(
            "{ended}{doubt}: minimised objective {}{before}.{resumed}{counts}",
            rounded(fit.cost, DIGITS)
        );
    }
    format!(
        "{ended}{doubt}: RMS {rms} ({before}) over {} measurements.{errors}{resumed}{counts}",
        fit.n_measurements
    )
}

/// Adds the degrees of freedom to the sentence about standard errors if there are few. A value is then within
/// one standard error less often than 68 % (50 % with one degree of freedom).
fn with_few_degrees(fit: &Fit, errors: String) -> String {
    let degrees = fit.uncertainty.as_ref().map_or(0.0, |uncertainty| uncertainty.degrees_of_freedom);
    if degrees == 0.0 || degrees >= FEW_DEGREES {
        return errors;
    }
    let unit = if degrees == 1.0 { "degree" } else { "degrees" };
    errors.replacen("errors:", &format!("errors, with {} {unit} of freedom:", digits(degrees)), 1)
}

/// Returns the standard errors relative to the values: of each free parameter or, for many, only the smallest
/// and the largest. They are corrected for autocorrelated residuals, if any.
fn relative_errors(fit: &Fit) -> String {
    let Some(uncertainty) = &fit.uncertainty else { return String::new() };
    if uncertainty.roughness.is_some() {
        return " Standard errors: unreliable.".to_owned();
    }
    let errors = &uncertainty.standard_errors;
    let free = (0..fit.x.len()).filter(|i| !uncertainty.held.contains(i));
    let (determined, open): (Vec<usize>, Vec<usize>) = free.partition(|i| errors[*i].is_finite());
    let name = |i: usize| &fit.shown_names()[i];
    let relative = |i: usize| errors[i] / fit.x[i].abs();
    let one = |i: usize| match relative(i) < 1.0 {
        true => format!("{} {} %", name(i), rounded(100.0 * relative(i), 2)),
        false => format!("{} +- {}", name(i), rounded(errors[i], 2)),
    };
    let by_size = |a: &&usize, b: &&usize| relative(**a).total_cmp(&relative(**b));
    let of_determined = match (determined.iter().min_by(by_size), determined.iter().max_by(by_size)) {
        (Some(least), Some(most)) if determined.len() > LISTED => {
            Some(format!("from {} to {}", one(*least), one(*most)))
        }
        (Some(_), _) => Some(determined.iter().map(|i| one(*i)).collect::<Vec<_>>().join(", ")),
        _ => None,
    };
    let of_determined = of_determined.map(|errors| format!(" Standard errors: {errors}."));
    let (unknown, open): (Vec<usize>, Vec<usize>) =
        open.into_iter().partition(|i| uncertainty.has_unknown_error(*i));
    let listed = |what: &str, parameters: &[usize]| match parameters {
        [] => String::new(),
        _ => {
            let names: Vec<&str> = parameters.iter().map(|i| name(*i).as_str()).collect();
            format!(" {what}: {}.", names.join(", "))
        }
    };
    of_determined.unwrap_or_default()
        + &listed("Not determined", &open)
        + &listed("Of unknown error", &unknown)
}

fn bound(fit: &Fit, i: usize, side: BoundSide) -> f64 {
    let (lower, upper) = fit.bounds[i];
    match side {
        BoundSide::Lower => lower,
        BoundSide::Upper => upper,
    }
}

fn parameter(fit: &Fit, i: usize) -> ParameterRow {
    let value = fit.x[i];
    let (lower, upper) = fit.bounds[i];
    let is_fixed = lower == upper;
    let side = fit.at_bound.iter().find(|(k, _)| *k == i).map(|(_, side)| *side);
    let uncertainty = fit.uncertainty.as_ref();
    // Unreliable standard errors are not printed.
    let has_errors = uncertainty.is_some_and(|uncertainty| uncertainty.roughness.is_none());
    let of = |errors: &[f64]| errors.get(i).copied().filter(|_| has_errors).unwrap_or(f64::NAN);
    let error = uncertainty.map_or(f64::NAN, |uncertainty| of(&uncertainty.standard_errors));
    let uncorrected = uncertainty.and_then(Uncertainty::uncorrected_errors).map(|errors| of(&errors));
    let is_usable = |error: f64| error.is_finite() && error > 0.0;
    let shown = |error: f64| match error {
        error if is_usable(error) => rounded(error, 2),
        f64::INFINITY if uncertainty.is_some_and(|uncertainty| uncertainty.has_unknown_error(i)) => {
            "error unknown".to_owned()
        }
        f64::INFINITY => "not determined".to_owned(),
        _ => "none".to_owned(),
    };
    let mut remarks = Vec::new();
    if is_fixed {
        remarks.push("fixed".to_owned());
    } else if let Some(side) = side {
        remarks.push(format!("at its {} bound {}", side.name(), Number(bound(fit, i, side))));
    }
    if let Some((_, prior)) = fit.priors.iter().find(|(k, _)| *k == i) {
        // The data and the prior add to the inverse of the variance, unless the parameter is at a bound.
        let share = (prior.slope(value) * error).powi(2);
        let share = (is_usable(error) && share <= 1.0)
            .then(|| format!(", {} % of the information", rounded(100.0 * share, 2)));
        remarks.push(format!("{prior}{}", share.unwrap_or_default()));
    }
    if fit.without_effect.contains(&i) {
        remarks.push("without effect".to_owned());
    }
    let interval = uncertainty.filter(|_| is_usable(error)).and_then(|uncertainty| {
        let (lower, upper) = *uncertainty.confidence_intervals(LEVEL).ok()?.get(i)?;
        Some([lower, upper].map(|end| with_error(end, error)))
    });
    ParameterRow {
        name: fit.shown_names()[i].clone(),
        start: rounded(fit.start[i], DIGITS),
        value: with_error(value, error),
        error: uncertainty.map_or_else(String::new, |_| shown(error)),
        uncorrected_error: uncorrected
            .filter(|error| is_usable(*error) || error.is_infinite())
            .map_or_else(String::new, shown),
        interval,
        unit: fit.units[i].clone().unwrap_or_default(),
        bounds: [lower, upper].map(|bound| Number(bound).to_string()),
        remark: remarks.join(", "),
    }
}

/// Returns the row of a derived parameter.
fn derived(fit: &Fit, derived: &DerivedValue) -> ParameterRow {
    let uncertainty = fit.uncertainty.as_ref();
    // Unreliable standard errors are not printed.
    let reliable = uncertainty.filter(|uncertainty| uncertainty.roughness.is_none());
    let error = reliable.map_or(f64::NAN, |uncertainty| derived.standard_error(uncertainty));
    let is_usable = |error: f64| error.is_finite() && error > 0.0;
    let shown = |error: f64| match error {
        error if is_usable(error) => rounded(error, 2),
        f64::INFINITY => "not determined".to_owned(),
        _ => "none".to_owned(),
    };
    let interval = reliable.filter(|_| is_usable(error));
    let interval = interval.and_then(|uncertainty| derived.confidence_interval(uncertainty, LEVEL));
    let (lower, upper) = derived.bounds;
    ParameterRow {
        name: derived.shown_name.clone(),
        start: rounded(derived.start, DIGITS),
        value: with_error(derived.value, error),
        error: uncertainty.map_or_else(String::new, |_| shown(error)),
        uncorrected_error: reliable
            .and_then(|uncertainty| derived.uncorrected_error(uncertainty))
            .filter(|error| is_usable(*error) || error.is_infinite())
            .map_or_else(String::new, shown),
        interval: interval.map(|(lower, upper)| [lower, upper].map(|end| with_error(end, error))),
        unit: derived.unit.clone().unwrap_or_default(),
        bounds: [lower, upper].map(|bound| Number(bound).to_string()),
        remark: match &derived.tied_to {
            Some(_) => format!("tied: {}", derived.expression),
            None => format!("derived: {}", derived.expression),
        },
    }
}

fn outputs(fit: &Fit) -> Vec<OutputRow> {
    let row = |output: &crate::fit::output_fit::OutputFit| OutputRow {
        experiment: output.experiment.clone(),
        variable: output.variable.clone(),
        column: output.column.clone(),
        n: output.n,
        rms: rounded(output.rms, FEW_DIGITS),
        start_rms: output.start_rms.map_or_else(|| "failed".to_owned(), |rms| rounded(rms, FEW_DIGITS)),
        fit_percent: match output.fit_percent.is_nan() {
            true => "none: constant data".to_owned(),
            false => format!("{} %", rounded(output.fit_percent, 3)),
        },
        unit: output.unit.clone().unwrap_or_default(),
    };
    fit.outputs.iter().map(row).collect()
}

fn facts(fit: &Fit) -> Vec<Fact> {
    let report = &fit.report;
    let before = match fit.start_cost {
        Some(cost) => format!(" ({} at the start)", rounded(cost, DIGITS)),
        None => String::new(),
    };
    let mut facts = vec![("ended", format!("{}: {}", report.method, report.message))];
    facts.extend(report.method_reason.iter().map(|reason| ("chosen", reason.clone())));
    facts.extend(fit.stages.iter().map(|stage| ("stage", stage.report.message.clone())));
    let rms = if is_design(fit) { String::new() } else { format!(", RMS {}", rounded(fit.rms, DIGITS)) };
    facts.push(("cost", format!("{}{before}{rms}", rounded(fit.cost, DIGITS))));
    if !is_design(fit) && fit.objective != CostKind::SumOfSquares.name() {
        facts.push(("objective", fit.objective.clone()));
    }
    if !report.loss.is_linear() {
        facts.push(("loss", report.loss.to_string()));
    }
    facts.extend(fit.noise.iter().map(|noise| ("noise", noise.to_string())));
    let goodness = fit.goodness();
    facts.extend(goodness.p_value.map(|p| {
        let [chisqr, redchi, p] = [goodness.chisqr, goodness.redchi, p].map(digits);
        ("goodness of fit", format!("chi-square {chisqr}, reduced {redchi}, p = {p}"))
    }));
    let lack_of_fit = fit.uncertainty.as_ref().and_then(|uncertainty| uncertainty.lack_of_fit);
    facts.extend(lack_of_fit.map(|test| ("replicates", test.to_string())));
    if !is_design(fit) {
        facts.push(("standard errors", errors(fit)));
    }
    let counts =
        [(report.n_failed, "failed"), (report.n_lost, "lost"), (report.n_speculative, "speculative")];
    let counts: String =
        counts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!(", {n} {what}")).collect();
    facts.push((
        "search",
        format!(
            "{} evaluations in {} iterations and {} batches{counts}; {} s, workers {}, batch plan {}",
            report.n_evaluations,
            report.n_iterations,
            report.n_batches,
            rounded(report.seconds, 3),
            report.workers,
            report.batch
        ),
    ));
    facts.extend(report.failures.iter().map(|(reason, count)| ("failures", format!("{count} x {reason}"))));
    facts.push((
        "simulated",
        format!(
            "{}; {} s in simulations, {} s of them inside the model",
            match (fit.stats.right_hand_sides, fit.stats.accepted_steps) {
                (0, steps) => format!("{steps} communication steps of models that integrate themselves"),
                (n, _) => format!("{n} right-hand sides, solver {}", fit.solver.name()),
            },
            rounded(fit.stats.seconds.get(), 3),
            rounded(fit.stats.seconds_in_model.get(), 3)
        ),
    ));
    let phase = |PhaseCost { phase, taken }: &PhaseCost| {
        let (n, seconds) = (taken.simulations, rounded(taken.seconds.get(), 3));
        let what = if n == 1 { "simulation" } else { "simulations" };
        format!("{} {n} {what}, {seconds} s", phase.key().replace('_', " "))
    };
    let with_simulations = fit.phases.iter().filter(|cost| cost.taken.simulations > 0);
    facts.push(("phases", with_simulations.map(phase).collect::<Vec<_>>().join("; ")));
    facts.into_iter().map(fact).collect()
}

/// Returns the description of the estimate of the standard errors.
fn errors(fit: &Fit) -> String {
    let Some(uncertainty) = &fit.uncertainty else { return "none were estimated".to_owned() };
    if uncertainty.is_noise_known() {
        return format!("{KNOWN_NOISE}; {} simulations", uncertainty.n_simulations);
    }
    let corrected = uncertainty
        .uncorrected_covariance
        .as_ref()
        .map_or("", |_| ", corrected for autocorrelated residuals");
    let active = match &uncertainty.active_constraints[..] {
        [] => String::new(),
        active => format!(", conditional on the active constraints '{}'", active.join("', '")),
    };
    format!("{}{corrected}{active}; {} simulations", uncertainty.estimator, uncertainty.n_simulations)
}
