//! Text of a problem file, with comments.

use super::matching::{Columns, Pair};
use super::proposal::{Candidate, Proposed};
use base::Number;
use calibration::{CostKind, FitOptions, SimulationSettings};
use dfo::AnyMethod;
use fmi::Fmu;

/// Maximum number of omitted parameters to list for each reason.
const LISTED: usize = 12;

/// Returns the text. `model` and `data` are the paths as written in the file.
pub(super) fn text(
    fmu: &Fmu,
    model: &str,
    data: &str,
    columns: &Columns,
    time: Option<&str>,
    (max_description_bytes, sandbox): (Option<u64>, bool),
    proposed: &Proposed,
) -> String {
    let description = fmu.description();
    let mut lines = vec![
        // For editors.
        "#:schema problem.schema.json".to_owned(),
        "# Parameters of a model to fit, and recordings to fit them to.".to_owned(),
        "#   fmufit check FILE    checks this file for mistakes".to_owned(),
        "#   fmufit fit FILE      fits the parameters".to_owned(),
        "#   fmufit schema > problem.schema.json    lets editors check this file".to_owned(),
        format!(
            "# Paths are relative to the folder of this file. Times are in {}.",
            one_line(description.time_unit())
        ),
        String::new(),
        format!(
            "model = {}  # {}, FMI {}",
            quoted(model),
            one_line(&description.model_name),
            description.fmi_version
        ),
        String::new(),
        "# A recording. Add one more table of this name for each further recording.".to_owned(),
        "[[experiments]]".to_owned(),
        format!("data = {}", quoted(data)),
    ];
    lines.extend(time.map(|time| format!("time = {}", quoted(time))));
    lines.push("# Measured column of each output: variable of the model = column.".to_owned());
    lines.push(pairs("outputs", &columns.outputs));
    for (column, candidates) in &columns.unmatched {
        lines.push(format!(
            "# Column '{}' {}",
            one_line(column),
            match &candidates[..] {
                [] => "does not match any output or input.".to_owned(),
                several => format!("may match {}.", one_line(&several.join(", "))),
            }
        ));
    }
    if !columns.inputs.is_empty() || !columns.undriven.is_empty() {
        lines.push("# Column of each input, or its constant value; { column = \"name\", hold = true } holds it between rows.".to_owned());
        lines.push(pairs("inputs", &columns.inputs));
    }
    if !columns.undriven.is_empty() {
        lines.push(format!(
            "# Undriven inputs, which keep their start values: {}.",
            one_line(&columns.undriven.join(", "))
        ));
    }
    lines.extend(
        [
            "# weights = \"range\"            # weight of each output: inverse of its range; or { output = \
             number or column }",
            "# start_values = { name = 1.0 }  # other parameters, start values of variables",
            "# initial_states = { x = \"measured\", y = { start = 1.0, lower = 0.0, upper = 2.0 } }",
            "# windows = [[0.0, 10.0]]        # only measurements in these windows are compared",
            "# start_time = 0.0             # time of the recording at which the model has its start values; needed for Unix times",
            "# warm_up = 5.0                  # initial part of the simulation that is not compared",
            "",
        ]
        .map(str::to_owned),
    );
    lines.push(
        "# Parameters with start values and bounds. Fit unknown parameters and leave out known ones."
            .to_owned(),
    );
    lines.push(
        "# Further fields: scale = \"log\", nominal, fixed, local, variables, unit, tied_to, expr, prior."
            .to_owned(),
    );
    lines.extend(proposed.confounded.iter().map(|remark| format!("# {}", one_line(remark))));
    proposed.active().for_each(|candidate| lines.extend(parameter(candidate)));
    lines.extend(left_out(&proposed.candidates));
    lines.extend(settings(&columns.without_unit, max_description_bytes, sandbox));
    lines.join("\n") + "\n"
}

/// Returns the settings. Defaults are written as comments, and settings of the command line as values.
/// `without_unit` contains variables without a unit in the model whose columns have one.
/// `max_description_bytes` is the limit with which the model was opened.
fn settings(without_unit: &[Pair], max_description_bytes: Option<u64>, sandbox: bool) -> Vec<String> {
    let (settings, fit) = (SimulationSettings::default(), FitOptions::default());
    let tolerances = fit.run.tolerances;
    let objectives = CostKind::named().map(|kind| kind.name().to_owned()).collect::<Vec<_>>();
    let methods = AnyMethod::names().collect::<Vec<_>>().join(", ");
    let mut lines = vec!["[settings]".to_owned()];
    lines.extend(max_description_bytes.map(|bytes| format!("max_description_bytes = {bytes}")));
    lines.extend(sandbox.then(|| {
        "sandbox = true               # the model writes only into a separate folder and opens no connections".to_owned()
    }));
    if !without_unit.is_empty() {
        lines.push(
            "# The model declares no unit for these variables. Specify the unit of each; columns are \
             converted to it."
                .to_owned(),
        );
        lines.push(format!("# {}", pairs("units", without_unit)));
    }
    lines.extend([
        format!(
            "# solver = \"{}\"             # explicit, switches to implicit if the model is stiff",
            settings.run.method.name()
        ),
        "# relative_tolerance = 1e-6".to_owned(),
        "# timeout = 10.0              # limit per simulation, in s; a longer simulation counts as failed"
            .to_owned(),
        format!(
            "# isolation = \"{}\"       # the model runs in separate processes",
            settings.isolation.name()
        ),
        String::new(),
        "[fit]".to_owned(),
        format!("# method = \"{}\"             # or {methods}", fit.run.method.name()),
        format!(
            "# objective = \"{}\"  # or {}",
            fit.objective.name(),
            objectives.into_iter().filter(|name| name != fit.objective.name()).collect::<Vec<_>>().join(", ")
        ),
        format!(
            "# x_tol = {}               # f_tol = {}",
            Number(tolerances.x_tol),
            Number(tolerances.f_tol)
        ),
        "# max_time = 600.0            # in s; max_evaluations, max_iterations, target".to_owned(),
        "# checkpoint = \"fit.ckpt\"     # fmufit resume continues from it".to_owned(),
    ]);
    lines
}

/// Returns comments about parameters that are not proposed, one line per reason.
fn left_out(candidates: &[Candidate]) -> Vec<String> {
    let mut reasons: Vec<&str> = Vec::new();
    for reason in candidates.iter().filter_map(|candidate| candidate.reason.as_deref()) {
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    let line = |reason: &&str| {
        let excluded = candidates.iter().filter(|candidate| candidate.reason.as_deref() == Some(*reason));
        let names: Vec<&str> = excluded.map(|candidate| candidate.name.as_str()).collect();
        let more = match names.len().saturating_sub(LISTED) {
            0 => String::new(),
            n => format!(" and {n} more (fmufit info --causality parameter)"),
        };
        let listed = names.iter().take(LISTED).copied().collect::<Vec<_>>().join(", ");
        format!("# Left out ({}): {}{more}", one_line(reason), one_line(&listed))
    };
    let mut lines: Vec<String> = reasons.iter().map(line).collect();
    if !lines.is_empty() {
        lines.push(String::new());
    }
    lines
}

/// Returns the table of a parameter.
fn parameter(candidate: &Candidate) -> Vec<String> {
    let Candidate { name, start, lower, upper, unit, description, reason: _ } = candidate;
    let unit = unit.as_ref().map(|unit| format!("in {}", one_line(unit)));
    let reported: Vec<String> = description.as_deref().map(one_line).into_iter().chain(unit).collect();
    let comment = if reported.is_empty() { String::new() } else { format!("  # {}", reported.join("; ")) };
    let [start, lower, upper] = [*start, *lower, *upper].map(Number);
    vec![
        format!("[[parameters]]{comment}"),
        format!("name = {}", quoted(name)),
        format!("start = {start}"),
        format!("lower = {lower}"),
        format!("upper = {upper}"),
        String::new(),
    ]
}

fn pairs(name: &str, pairs: &[Pair]) -> String {
    let pair = |(variable, column): &Pair| format!("{} = {}", quoted(variable), quoted(column));
    match pairs {
        [] => format!("{name} = {{}}"),
        pairs => format!("{name} = {{ {} }}", pairs.iter().map(pair).collect::<Vec<_>>().join(", ")),
    }
}

/// Quotes a string in TOML syntax.
fn quoted(text: &str) -> String {
    format!(
        "\"{}\"",
        text.chars()
            .map(|c| match c {
                '"' | '\\' => format!("\\{c}"),
                c if c.is_control() => format!("\\u{:04X}", u32::from(c)),
                c => c.to_string(),
            })
            .collect::<String>()
    )
}

/// Converts a text to a single line for a comment. Texts of models may contain line breaks.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").chars().filter(|c| !c.is_control()).collect()
}
