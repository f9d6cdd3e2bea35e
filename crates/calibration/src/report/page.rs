//! The report: one self-contained page with tables, figures, settings and hashes.

use super::curves::{ExperimentCurves, OutputCurves, Signal};
use super::figure::{self, Panel, Point, Series};
use super::number::rounded;
use super::setup;
use super::summary::{Fact, Summary, fact};
use super::template;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use crate::loaded::design_point::{CriterionValue, DesignPoint, LimitedValue};
use crate::problem::experiment::Experiment;
use base::Number;
use serde::Serialize;

/// Heights of the panels of a figure, in pixels.
const TALL: u32 = 230;
const LOW: u32 = 120;

/// Maximum number of inputs of an experiment in figures.
const MOST_INPUTS: usize = 8;

#[derive(Serialize)]
struct Page {
    outputs: Vec<Figure>,
    search: Vec<Figure>,
    correlation: Option<Correlation>,
    residual_checks: Vec<[String; 7]>,
    settings: Vec<Fact>,
    experiments: Vec<Setup>,
    origin: Vec<Fact>,
    /// Goals, criteria and constraints of a design: text, scenario, value at the start, value.
    criteria: Vec<[String; 4]>,
    is_design: bool,
    date: String,
}

#[derive(Serialize)]
pub(super) struct Figure {
    title: String,
    caption: String,
    svg: Option<String>,
}

#[derive(Serialize)]
struct Correlation {
    names: Vec<String>,
    rows: Vec<Vec<Cell>>,
}

/// A coefficient, and the strength and sign of its colour.
#[derive(Serialize)]
struct Cell {
    text: String,
    is_negative: bool,
    strength: f64,
}

/// Parts of an experiment.
#[derive(Serialize)]
struct Setup {
    name: String,
    recording: String,
    facts: Vec<(String, String)>,
}

/// Returns the page of a fit.
/// `design` contains the start, if it could be simulated, and the result of a design.
pub(super) fn page(
    calibration: &Calibration,
    fit: &Fit,
    curves: &[ExperimentCurves],
    design: Option<(Option<DesignPoint>, DesignPoint)>,
) -> String {
    let page = Page {
        outputs: figures(curves),
        search: [convergence(fit), waterfall(fit)].into_iter().flatten().collect(),
        correlation: correlation(fit),
        residual_checks: residual_checks(fit),
        settings: settings(calibration, fit),
        experiments: experiments(calibration),
        origin: origin(calibration),
        criteria: design.iter().flat_map(|(start, result)| criteria(start.as_ref(), result)).collect(),
        is_design: !calibration.problem().goals.is_empty(),
        date: jiff::Timestamp::now().strftime("%Y-%m-%d %H:%M UTC").to_string(),
    };
    template::page(&Summary::new(fit), &page)
}

/// Returns the criteria and constraints of a design.
fn criteria(start: Option<&DesignPoint>, result: &DesignPoint) -> Vec<[String; 4]> {
    let number = |value: Option<f64>| value.map_or_else(|| "failed".to_owned(), |value| rounded(value, 6));
    let criterion = |(k, criterion): (usize, &CriterionValue)| {
        let before = start.and_then(|start| start.criteria.get(k)).map(|c| c.value);
        [criterion.text.clone(), criterion.scenario.clone(), number(before), number(Some(criterion.value))]
    };
    let constraint = |(k, limited): (usize, &LimitedValue)| {
        let holds = |limited: &LimitedValue| match limited.violation() {
            0.0 => "holds".to_owned(),
            violation => format!("violated by {}", rounded(violation, 3)),
        };
        let before =
            start.and_then(|start| start.constraints.get(k)).map_or_else(|| "failed".to_owned(), holds);
        [limited.text.clone(), String::new(), before, holds(limited)]
    };
    let criteria = result.criteria.iter().enumerate().map(criterion);
    criteria.chain(result.constraints.iter().enumerate().map(constraint)).collect()
}

/// Returns the figures of the outputs of each experiment, and of its inputs.
fn figures(experiments: &[ExperimentCurves]) -> Vec<Figure> {
    let mut all = output_figures(experiments, "The simulation at the start failed. ");
    all.extend(experiments.iter().filter_map(|experiment| input_figure(experiment, experiments.len() > 1)));
    all
}

/// Returns the label of the time axis of an experiment.
fn time_axis(experiment: &ExperimentCurves) -> String {
    let from = experiment.first_date.as_ref().map_or_else(String::new, |date| format!(" from {date}"));
    format!("time in {}{from}", experiment.time_unit)
}

/// Draws the recorded inputs, one panel each. A line ends where the recording has no value.
fn input_figure(experiment: &ExperimentCurves, are_several: bool) -> Option<Figure> {
    let panel = |signal: &Signal| {
        let rows: Vec<Point> = signal.times.iter().copied().zip(signal.values.iter().copied()).collect();
        let parts = rows.chunk_by(|a, b| a.1.is_nan() == b.1.is_nan());
        let parts = parts.filter(|part| !part[0].1.is_nan()).map(|part| match part {
            [one] => Series::Measured(vec![*one]),
            several => Series::Input(several.to_vec()),
        });
        let unit = signal.unit.as_ref().map_or_else(String::new, |unit| format!(" in {unit}"));
        let (y_label, series) = (format!("{}{unit}", signal.variable), parts.collect());
        Panel { height: LOW, y_label, series, is_logarithm: false, has_zero: false }
    };
    let shown = &experiment.inputs[..experiment.inputs.len().min(MOST_INPUTS)];
    let panels: Vec<Panel> = shown.iter().map(panel).collect();
    let title = if are_several { format!("{}: inputs", experiment.name) } else { "Inputs".to_owned() };
    let caption = match experiment.inputs.len() - shown.len() {
        0 => "As recorded.".to_owned(),
        n => format!("As recorded; {n} more are not drawn."),
    };
    let svg = figure::draw(&panels, &time_axis(experiment));
    (!shown.is_empty()).then_some(Figure { title, caption, svg })
}

/// Draws the measurements, the start and the fitted values of each output, with the residuals below. The
/// caption contains `without_start` if there is no simulation at the start.
pub(super) fn output_figures(experiments: &[ExperimentCurves], without_start: &str) -> Vec<Figure> {
    let figure = |experiment: &ExperimentCurves, output: &OutputCurves| {
        let OutputCurves { measured, residuals, sigma, start, fitted } = output;
        let unit = measured.unit.as_ref().map_or_else(String::new, |unit| format!(" in {unit}"));
        let points = |times: &[f64], values: &[f64]| -> Vec<Point> {
            times.iter().copied().zip(values.iter().copied()).collect()
        };
        let curve = |signal: &Signal| points(&signal.times, &signal.values);
        let bars = |values: &[f64]| -> Option<Series> {
            let rows = measured.times.iter().zip(values).zip(sigma.as_ref()?);
            Some(Series::Bars(rows.flat_map(|((t, y), sigma)| [(*t, y - sigma), (*t, y + sigma)]).collect()))
        };
        let mut upper: Vec<Series> = bars(&measured.values).into_iter().collect();
        let is_measured = !measured.times.is_empty();
        upper.extend(is_measured.then(|| Series::Measured(curve(measured))));
        upper.extend(start.as_ref().map(|signal| Series::Start(curve(signal))));
        upper.extend(fitted.as_ref().map(|signal| Series::Fitted(curve(signal))));
        let mut lower: Vec<Series> = bars(residuals).into_iter().collect();
        lower.push(Series::Marks(points(&measured.times, residuals)));
        let panel = |height, y_label, series, has_zero| Panel {
            height,
            y_label,
            series,
            is_logarithm: false,
            has_zero,
        };
        let mut panels = vec![panel(TALL, format!("{}{unit}", measured.variable), upper, false)];
        if is_measured {
            panels.push(panel(LOW, format!("residual{unit}"), lower, true));
        }
        let title = match experiments.len() {
            1 => measured.variable.clone(),
            _ => format!("{}: {}", experiment.name, measured.variable),
        };
        let remark = if start.is_none() { without_start } else { "" };
        let of_bars = if sigma.is_some() { "Bars: one known standard deviation (sigma). " } else { "" };
        let note = if is_measured { figure::note(measured.times.len()) } else { String::new() };
        let caption = format!("{remark}{of_bars}{note}");
        Figure { title, caption, svg: figure::draw(&panels, &time_axis(experiment)) }
    };
    experiments.iter().flat_map(|e| e.outputs.iter().map(move |output| figure(e, output))).collect()
}

/// Converts costs for drawing: to logarithms, unless some are negative, as a likelihood may be. The logarithm
/// of zero is not finite and is not drawn.
fn drawn(is_logarithm: bool, points: Vec<Point>) -> Vec<Point> {
    let value = |cost: f64| if is_logarithm { cost.log10() } else { cost };
    points.into_iter().map(|(k, cost)| (k, value(cost))).collect()
}

fn cost_panel(is_logarithm: bool, series: Vec<Series>) -> Panel {
    Panel { height: TALL, y_label: "cost".to_owned(), series, is_logarithm, has_zero: false }
}

fn convergence(fit: &Fit) -> Option<Figure> {
    let trace = &fit.report.trace;
    let first = trace.n_dropped() + 1;
    let costs = trace.iter().enumerate().filter_map(|(k, e)| Some(((first + k) as f64, e.outcome.value()?)));
    (!trace.is_empty()).then(|| cost_figure(costs.collect(), first + trace.len() - 1, fit.report.n_failed))
}

/// Draws the costs of evaluations by their numbers, up to the last one, and the best cost so far.
pub(super) fn cost_figure(costs: Vec<Point>, last: usize, n_failed: usize) -> Figure {
    let mut best = f64::INFINITY;
    let mut steps: Vec<Point> = Vec::new();
    for (k, cost) in &costs {
        if *cost < best {
            steps.extend(steps.last().map(|(_, before)| (*k, *before)));
            best = *cost;
            steps.push((*k, *cost));
        }
    }
    steps.extend(steps.last().map(|(_, cost)| (last as f64, *cost)));
    let is_logarithm = costs.iter().all(|(_, cost)| *cost >= 0.0);
    let evaluated = drawn(is_logarithm, costs);
    let series = vec![Series::Measured(evaluated), Series::Fitted(drawn(is_logarithm, steps))];
    let svg = figure::draw(&[cost_panel(is_logarithm, series)], "evaluation");
    let failed = match n_failed {
        0 => String::new(),
        n => format!(" {n} evaluations failed."),
    };
    let caption = format!("Cost of each evaluation (dots) and of the best point so far (line).{failed}");
    Figure { title: "Convergence".to_owned(), caption, svg }
}

/// Draws the sorted final costs of the searches from several starts.
fn waterfall(fit: &Fit) -> Option<Figure> {
    let optima = &fit.report.optima;
    let ends = optima.iter().flat_map(|optimum| std::iter::repeat_n(optimum.cost, optimum.n_starts.max(1)));
    let ends: Vec<Point> = ends.enumerate().map(|(k, cost)| ((k + 1) as f64, cost)).collect();
    let caption =
        format!("Costs of {} local searches, sorted: {} distinct minima.", ends.len(), optima.len());
    let is_logarithm = ends.iter().all(|(_, cost)| *cost >= 0.0);
    let panel = cost_panel(is_logarithm, vec![Series::Marks(drawn(is_logarithm, ends))]);
    let svg = figure::draw(&[panel], "local search, from the best to the worst");
    (!optima.is_empty()).then(|| Figure { title: "Minima found".to_owned(), caption, svg })
}

fn correlation(fit: &Fit) -> Option<Correlation> {
    let uncertainty = fit.uncertainty.as_ref()?;
    let n = fit.x.len();
    let cell = |value: &f64| Cell {
        text: if value.is_nan() {
            "\u{2013}".to_owned()
        } else {
            format!("{value:.2}").replace('-', "\u{2212}")
        },
        is_negative: *value < 0.0,
        strength: if value.is_nan() { 0.0 } else { (0.6 * value.abs().min(1.0) * 100.0).round() / 100.0 },
    };
    (n > 1 && uncertainty.correlation.len() == n * n).then(|| Correlation {
        names: fit.shown_names().to_vec(),
        rows: uncertainty.correlation.chunks(n).map(|row| row.iter().map(cell).collect()).collect(),
    })
}

fn residual_checks(fit: &Fit) -> Vec<[String; 7]> {
    let checks = fit.uncertainty.iter().flat_map(|uncertainty| &uncertainty.residual_checks);
    let number = |value: f64| if value.is_nan() { "\u{2013}".to_owned() } else { rounded(value, 3) };
    let row = |check: &crate::uncertainty::diagnostics::residual_check::ResidualCheck| {
        let numbers = [check.mean, check.deviation, check.autocorrelation];
        let [mean, deviation, lag] = numbers.map(number);
        let [n, outliers] = [check.n, check.n_outliers].map(|n| n.to_string());
        [check.experiment.clone(), check.variable.clone(), n, mean, deviation, lag, outliers]
    };
    checks.map(row).collect()
}

/// Returns the settings of the simulations and of the search.
fn settings(calibration: &Calibration, fit: &Fit) -> Vec<Fact> {
    let report = &fit.report;
    let settings = &calibration.problem().settings;
    let plan = calibration.evaluator().simulations.first().map(|simulation| simulation.pool.plan());
    let mut facts = vec![("method", report.method.clone().into_owned())];
    facts.extend(report.method_reason.iter().map(|reason| ("reason for the method", reason.clone())));
    let options: Vec<String> = report.options.iter().map(|(name, value)| format!("{name} {value}")).collect();
    facts.push(("options of the method", options.join("; ")));
    facts.push(("end", report.message.clone()));
    facts.push(("loss", report.loss.to_string()));
    facts.extend(report.seed.map(|seed| ("seed", seed.to_string())));
    facts.push(("workers, batch plan", format!("{}, {}", report.workers, report.batch)));
    facts.push(("solver", fit.solver.name().to_owned()));
    let chosen = fit.tolerance.map(|chosen| chosen.used);
    let used = chosen.or_else(|| plan.map(|plan| plan.relative_tolerance()));
    let tolerance = used.map(|used| Number(used).to_string());
    facts.extend(tolerance.map(|tolerance| ("relative tolerance", tolerance)));
    let limit = settings.run.timeout.map(|limit| Number(limit.as_secs_f64()).to_string());
    facts.extend(limit.map(|limit| ("time limit of a simulation in s", limit)));
    let mut reported = setup::options(&fit.options, &REPORTED_ELSEWHERE);
    for (k, stage) in fit.stages.iter().enumerate() {
        let options = setup::options(&stage.options, &REPORTED_ELSEWHERE).into_iter();
        let options = options.map(|(name, value)| format!("{name} {value}")).collect::<Vec<_>>().join("; ");
        reported.push((format!("options of stage {}", k + 1), options));
    }
    reported.extend(setup::settings(settings, &["solver", "relative_tolerance", "timeout"]));
    let reported = reported.into_iter().map(|(name, value)| Fact { name: name.into(), value });
    facts.into_iter().map(fact).chain(reported).collect()
}

/// Options of a fit that appear in other lines.
const REPORTED_ELSEWHERE: [&str; 6] = ["method", "objective", "loss", "f_scale", "seed", "workers"];

/// Returns the parts of each experiment.
fn experiments(calibration: &Calibration) -> Vec<Setup> {
    let problem = calibration.problem();
    let setup = |(name, experiment): (String, &Experiment)| Setup {
        name,
        recording: experiment.data.source().to_owned(),
        facts: setup::experiment(experiment),
    };
    problem.experiment_names().into_iter().zip(&problem.experiments).map(setup).collect()
}

/// Returns the origin of the fit: the model, and the version of this program.
fn origin(calibration: &Calibration) -> Vec<Fact> {
    let (problem, description) = (calibration.problem(), calibration.fmu().description());
    let facts = [
        ("model", Some(description.model_name.clone())),
        ("version of the model", description.version.clone()),
        ("file", Some(problem.model.path.display().to_string())),
        ("SHA-256 of the FMU", Some(problem.model.content_hash.clone())),
        ("FMI version", Some(description.fmi_version.to_string())),
        ("generated by", description.generation_tool.clone()),
        ("generated at", description.generation_date_and_time.clone()),
        ("GUID", Some(description.guid.clone())),
        ("fmufit", Some(env!("CARGO_PKG_VERSION").to_owned())),
    ];
    let stated = facts.into_iter().filter_map(|(name, value)| Some((name, value?)));
    stated.filter(|(_, value)| !value.is_empty()).map(fact).collect()
}
