//! Description of what was fitted and how: parts of experiments, and options that differ from the defaults.

use crate::fit::one_stage::FitOptions;
use crate::problem::experiment::{Experiment, InitialState, Measured, Sigma, Weight};
use crate::problem::input::InputSource;
use crate::problem::settings::SimulationSettings;
use base::Number;
use dfo::{Record, Value};

/// A name and its description.
pub(super) type Described = (String, String);

/// Returns the options of a fit that differ from the defaults, by their user-visible names, except those in
/// `but`.
pub(super) fn options(requested: &Record, but: &[&str]) -> Vec<Described> {
    let usual = FitOptions::default().record().unwrap_or_default();
    others(requested, &usual, but)
}

/// Returns the settings of simulations that differ from the defaults, except those in `but`.
pub(super) fn settings(settings: &SimulationSettings, but: &[&str]) -> Vec<Described> {
    let fields = |settings| match Value::of(settings) {
        Ok(Value::Record(fields)) => fields,
        _ => Record::default(),
    };
    others(&fields(settings), &fields(&SimulationSettings::default()), but)
}

/// Returns the values of a record that differ from another record.
fn others(record: &Record, usual: &Record, but: &[&str]) -> Vec<Described> {
    let is_listed = |name: &str, value: &Value| !but.contains(&name) && usual.get(name) != Some(value);
    let reported = record.iter().filter(|(name, value)| is_listed(name, value));
    reported
        .map(|(name, value)| match (name.as_str(), value) {
            ("warm_start", Value::List(points)) => (name.clone(), format!("{} points", points.len())),
            _ => (name.clone(), words(value)),
        })
        .collect()
}

/// Formats a value for readers.
fn words(value: &Value) -> String {
    let all = |items: Vec<String>| if items.is_empty() { "none".to_owned() } else { items.join(", ") };
    match value {
        Value::Text(text) => text.clone(),
        Value::Flag(true) => "yes".to_owned(),
        Value::Flag(false) => "no".to_owned(),
        Value::List(items) => all(items.iter().map(words).collect()),
        Value::Record(fields) => {
            all(fields.iter().map(|(name, value)| format!("{name} {}", words(value))).collect())
        }
        other => other.to_string(),
    }
}

/// Returns the parts of an experiment.
pub(super) fn experiment(experiment: &Experiment) -> Vec<Described> {
    let data = experiment.data.summary();
    let unit = experiment.data.time_unit();
    let in_unit = |time: f64| format!("{} {unit}", Number(time));
    let span = |(from, to): (f64, f64)| format!("{} to {}", Number(from), in_unit(to));
    let list = |items: Vec<String>| (!items.is_empty()).then(|| items.join("; "));
    let times = data.from.zip(data.to).map(|times| format!(", {}", span(times))).unwrap_or_default();
    let first_date = experiment.data.first_date();
    let begins = first_date.map_or_else(String::new, |date| format!(", in {unit} from {date} on"));
    let facts = [
        ("outputs", list(experiment.outputs.iter().map(output).collect())),
        (
            "inputs",
            list(experiment.inputs.iter().map(|(variable, source)| input(variable, source)).collect()),
        ),
        ("hold inputs", experiment.hold_inputs.then(|| "yes, before and after the recording".to_owned())),
        ("rows", Some(format!("{}{times}{begins}", data.n_rows))),
        ("column of times", (data.time != "time").then(|| data.time.to_owned())),
        ("mask", data.mask.map(str::to_owned)),
        ("resample", data.resample.map(|interval| format!("means over {}", in_unit(interval)))),
        ("windows", list(experiment.windows.iter().map(|window| span(*window)).collect())),
        ("warm-up", experiment.warm_up.map(in_unit)),
        ("start time", experiment.start_time.map(in_unit)),
        (
            "start values",
            list(experiment.start_values.iter().map(|(name, value)| format!("{name} = {value}")).collect()),
        ),
        (
            "initial states",
            list(experiment.initial_states.iter().map(|(name, value)| initial(name, value)).collect()),
        ),
        (
            "steady state",
            experiment.steady.map(|steady| match steady.limit {
                Some(limit) => format!("before the start, within {}", in_unit(limit)),
                None => "before the start".to_owned(),
            }),
        ),
        (
            "delays",
            list(
                experiment.delays.iter().map(|(name, delay)| format!("{name} {}", in_unit(*delay))).collect(),
            ),
        ),
        ("SHA-256 of the file", data.file_sha256.map(str::to_owned)),
        ("fingerprint of the compared data", Some(data.fingerprint)),
    ];
    facts.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
}

fn output(Measured { variable, column, weight }: &Measured) -> String {
    let weight = match weight {
        Weight::Constant(1.0) => String::new(),
        Weight::Constant(weight) => format!(", weight {}", Number(*weight)),
        Weight::Column(column) => format!(", weights of column {column}"),
        Weight::Rows(_) => ", a weight for each row".to_owned(),
        Weight::Inverse(scale) => format!(", weight 1 / {} of what was measured", scale.name()),
        Weight::Sigma(Sigma::Constant(sigma)) => format!(", known sigma {}", Number(*sigma)),
        Weight::Sigma(Sigma::Column(column)) => format!(", known sigma in column {column}"),
        Weight::Log(_) => ", logarithms are compared".to_owned(),
        Weight::Sigma(Sigma::Model(model)) => format!(", sigma {model}"),
        Weight::Sigma(Sigma::Rows(_)) => ", a known sigma for each row".to_owned(),
    };
    format!("{variable} measured by column {column}{weight}")
}

fn input(variable: &str, source: &InputSource) -> String {
    match source {
        InputSource::Column(column) => format!("{variable} driven by column {column}"),
        InputSource::Held(column) => format!("{variable} driven by column {column}, held between rows"),
        InputSource::Constant(value) => format!("{variable} = {}", Number(*value)),
        InputSource::Function(_) => format!("{variable} driven by a function of time"),
    }
}

fn initial(state: &str, value: &InitialState) -> String {
    match value {
        InitialState::Value(value) => format!("{state} = {}", Number(*value)),
        InitialState::Measured => format!("{state} as measured"),
        InitialState::MeasuredBy(output) => format!("{state} as measured for {output}"),
        InitialState::Fitted(parameter) => {
            let [start, lower, upper] = [parameter.start(), parameter.lower(), parameter.upper()].map(Number);
            format!("{state} fitted from {start} within {lower} and {upper}")
        }
    }
}
