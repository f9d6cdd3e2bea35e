//! `fmufit info`: shows the contents of a model.

use crate::arguments::Info;
use crate::console::{Console, Table};
use crate::error::{Error, Exit};
use base::Number;
use calibration::visible_line;
use fmi::description::{Causality, Interface};
use fmi::platform::{Platform, RunsBy};
use fmi::{Fmu, ModelDescription, Value, Variable};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Value as Json, json};

pub(crate) fn run(arguments: &Info, console: &Console) -> Result<Exit, Error> {
    let fmu = arguments.limits.open(&arguments.model)?;
    let description = fmu.description();
    let is_requested = |variable: &&Variable| match &arguments.causality {
        Some(word) => variable.causality.name().eq_ignore_ascii_case(word),
        None => true,
    };
    let requested: Vec<&Variable> = description.variables.iter().filter(is_requested).collect();
    if let Some(word) = arguments.causality.as_ref().filter(|_| requested.is_empty()) {
        let mut available: Vec<&str> = description.variables.iter().map(|v| v.causality.name()).collect();
        available.sort_unstable();
        available.dedup();
        let available = available.join(", ");
        return Err(Error::input(format!(
            "--causality {word}: no variable has this causality; expected one of: {available}"
        )));
    }
    if arguments.json {
        console.json(&document(&fmu, &requested))?;
        return Ok(Exit::Success);
    }
    let is_shown =
        |variable: &&&Variable| arguments.all || arguments.causality.is_some() || !is_internal(variable);
    let shown: Vec<&&Variable> = requested.iter().filter(is_shown).collect();
    let mut table = Table::new(["name", "causality", "variability", "type", "unit", "start", "description"]);
    for variable in &shown {
        table.row([
            variable.name.clone(),
            variable.causality.to_string(),
            variable.variability.to_string(),
            format!("{}{}", variable.kind, "[]".repeat(variable.dimensions.len())),
            variable.unit.clone().unwrap_or_default(),
            variable.start.as_ref().map(value_text).unwrap_or_default(),
            variable.description.clone().unwrap_or_default(),
        ]);
    }
    console.result(&header(&fmu));
    console.result("");
    console.result(&table.text(console.width()));
    match requested.len() - shown.len() {
        0 => {}
        n => console.result(&format!("\nand {n} internal variables; use --all to show them")),
    }
    if !description.quirks.is_empty() {
        let n = description.quirks.len();
        console.result(&format!("\n{n} violations of the FMI standard; use fmufit validate to list them"));
    }
    Ok(Exit::Success)
}

fn is_internal(variable: &Variable) -> bool {
    matches!(variable.causality, Causality::Local | Causality::Independent)
}

/// Formats a value for display.
fn value_text(value: &Value) -> String {
    match value {
        Value::Real(x) => Number(*x).to_string(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

/// Returns the lines about the model as a whole.
fn header(fmu: &Fmu) -> String {
    let description = fmu.description();
    let mut lines = vec![format!("{}, FMI {}", description.model_name, description.fmi_version)];
    lines.extend(description.description.clone());
    lines.push(interfaces(description).iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "));
    let tool = description.generation_tool.iter().chain(&description.generation_date_and_time);
    lines.push(tool.cloned().collect::<Vec<_>>().join(", "));
    let experiment = &description.default_experiment;
    let unit = format!(" {}", description.time_unit());
    let facts = [
        ("start", experiment.start_time, &unit[..]),
        ("stop", experiment.stop_time, &unit),
        ("tolerance", experiment.tolerance, ""),
        ("step", experiment.step_size, &unit),
    ];
    let facts =
        facts.iter().filter_map(|(name, value, unit)| value.map(|v| format!("{name} {}{unit}", Number(v))));
    lines.push(facts.collect::<Vec<_>>().join(", "));
    lines.extend(platform_lines(fmu));
    lines.retain(|line| !line.is_empty());
    lines.iter().map(|line| visible_line(line)).collect::<Vec<_>>().join("\n")
}

/// Returns the platforms for which there are binaries, and what is missing if none of them runs here.
fn platform_lines(fmu: &Fmu) -> Vec<String> {
    let platforms = fmu.platforms().unwrap_or_default();
    let shown: Vec<String> =
        platforms.iter().map(|platform| format!("{} ({})", platform.name, platform.runs_by)).collect();
    let has_sources = platforms.iter().any(|platform| platform.runs_by == RunsBy::Compiling);
    let program = fmu.windows_program().filter(|_| !has_sources);
    let missing = program.and_then(|program| program.check().err());
    [shown.join(", ")].into_iter().chain(missing.map(|error| format!("warning: {error}"))).collect()
}

fn interfaces(description: &ModelDescription) -> Vec<(&'static str, &Interface)> {
    let model_exchange = description.model_exchange.iter().map(|interface| ("model exchange", interface));
    model_exchange
        .chain(description.co_simulation.iter().map(|interface| ("co-simulation", interface)))
        .collect()
}

/// Model as printed by `--json`.
#[derive(Serialize, JsonSchema)]
#[schemars(title = "Model, as shown by fmufit info")]
pub(super) struct Document<'m> {
    /// Path of the model.
    path: String,
    /// Name of the model.
    model_name: &'m str,
    /// FMI version, for example `2.0`.
    fmi_version: String,
    description: Option<&'m str>,
    generation_tool: Option<&'m str>,
    generation_date_and_time: Option<&'m str>,
    /// Interfaces: `model exchange`, `co-simulation`.
    interfaces: Vec<&'static str>,
    /// Folders with binaries, and `sources`.
    platforms: Vec<PlatformFields>,
    default_experiment: Experiment,
    variables: Vec<VariableFields<'m>>,
    /// Violations of the FMI standard.
    quirks: Vec<String>,
}

/// A platform for which the model has a library or sources.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Platform")]
struct PlatformFields {
    /// Name of the folder, for example `linux64` or `x86_64-windows`; `sources` for source code.
    name: String,
    /// How it runs on this machine: `runs here`, `compiled here`, `runs here under Wine`, `runs here in a
    /// 32-bit process`, `does not run here`.
    runs_by: &'static str,
}

/// Default experiment of a model; times in s.
#[derive(Serialize, JsonSchema)]
struct Experiment {
    start_time: Option<f64>,
    stop_time: Option<f64>,
    tolerance: Option<f64>,
    step_size: Option<f64>,
}

/// A variable of a model.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Variable")]
struct VariableFields<'m> {
    name: &'m str,
    causality: &'static str,
    variability: &'static str,
    initial: Option<&'static str>,
    r#type: &'static str,
    unit: Option<&'m str>,
    display_unit: Option<&'m str>,
    /// A number, a string, a boolean, or a list of these.
    start: Option<Json>,
    min: Option<f64>,
    max: Option<f64>,
    nominal: Option<f64>,
    is_array: bool,
    description: Option<&'m str>,
}

fn json_of(value: &Value) -> Json {
    match value {
        Value::Real(x) => json!(x),
        Value::Boolean(truth) => json!(truth),
        Value::Integer(i) => i64::try_from(*i).map_or_else(|_| json!(i.to_string()), |i| json!(i)),
        Value::String(text) => json!(text),
        Value::Array(values) => values.iter().map(json_of).collect(),
        other => json!(other.to_string()),
    }
}

fn document<'m>(fmu: &'m Fmu, variables: &[&'m Variable]) -> Document<'m> {
    let description = fmu.description();
    let variable = |variable: &&'m Variable| VariableFields {
        name: &variable.name,
        causality: variable.causality.name(),
        variability: variable.variability.name(),
        initial: variable.initial.map(|initial| initial.name()),
        r#type: variable.kind.name(),
        unit: variable.unit.as_deref(),
        display_unit: variable.display_unit.as_deref(),
        start: variable.start.as_ref().map(json_of),
        min: variable.min,
        max: variable.max,
        nominal: variable.nominal,
        is_array: !variable.dimensions.is_empty(),
        description: variable.description.as_deref(),
    };
    let platform =
        |platform: Platform| PlatformFields { name: platform.name, runs_by: platform.runs_by.name() };
    let experiment = &description.default_experiment;
    Document {
        path: fmu.path().display().to_string(),
        model_name: &description.model_name,
        fmi_version: description.fmi_version.to_string(),
        description: description.description.as_deref(),
        generation_tool: description.generation_tool.as_deref(),
        generation_date_and_time: description.generation_date_and_time.as_deref(),
        interfaces: interfaces(description).iter().map(|(name, _)| *name).collect(),
        platforms: fmu.platforms().unwrap_or_default().into_iter().map(platform).collect(),
        default_experiment: Experiment {
            start_time: experiment.start_time,
            stop_time: experiment.stop_time,
            tolerance: experiment.tolerance,
            step_size: experiment.step_size,
        },
        variables: variables.iter().map(variable).collect(),
        quirks: description.quirks.iter().map(ToString::to_string).collect(),
    }
}
