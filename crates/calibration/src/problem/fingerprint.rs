//! Identity of the problem of a fit, by name and in words: a checkpoint belongs to one, and a refusal of it
//! can name the difference.

use crate::problem::definition::Problem;
use crate::problem::experiment::{Experiment, InitialState, Measured, Weight};
use crate::problem::input::{InputSource, Signal};
use crate::problem::parameter::{Parameter, Target};
use fmi::Kind;
use sha2::{Digest, Sha256};

/// All that the costs of a problem depend on, by name and in words: all but the bounds and starts of its
/// parameters.
pub(crate) fn identity(problem: &Problem, parameters: &[Parameter]) -> Vec<(String, String)> {
    let names: Vec<&str> = parameters.iter().map(Parameter::name).collect();
    let mut all = vec![
        ("model".to_owned(), problem.model.content_hash.clone()),
        ("parameter names".to_owned(), names.join(", ")),
    ];
    let crate::problem::experiment::SimulationSettings {
        kind,
        method,
        relative_tolerance,
        step_size,
        max_step,
        input_derivatives,
        chattering,
        timeout,
        isolation: _,
        memory_limit: _,
        sandbox: _,
    } = &problem.settings;
    let held = if *input_derivatives == Some(false) { "not told" } else { "told" };
    let number = |value: Option<f64>| value.map_or_else(|| "by default".to_owned(), |v| format!("{v:?}"));
    all.extend(
        [
            ("kind of simulation", kind_name(*kind).to_owned()),
            ("solver of the settings", method.name().to_owned()),
            ("relative tolerance", number(*relative_tolerance)),
            ("step size", number(*step_size)),
            ("largest step", number(*max_step)),
            ("derivatives of the inputs", held.to_owned()),
            ("chattering", chattering.name().to_owned()),
            ("time limit of a simulation", number(timeout.map(|t| t.as_secs_f64()))),
        ]
        .map(|(name, value)| (name.to_owned(), value)),
    );
    for parameter in &problem.parameters {
        if let Some(what) = what_it_sets(parameter) {
            all.push((format!("parameter {}", parameter.name()), what));
        }
    }
    for (k, experiment) in problem.experiments.iter().enumerate() {
        let of_experiment = |(name, value): (&str, String)| (format!("{name} of experiment {k}"), value);
        all.extend(of(experiment, &problem.parameters).into_iter().map(of_experiment));
    }
    all
}

/// Target of a parameter, its unit, its prior and its tie, in words; `None`: it sets the variable of its
/// name.
fn what_it_sets(parameter: &Parameter) -> Option<String> {
    let bare = Parameter::new(parameter.name(), 0.0);
    let mut words = Vec::new();
    if parameter.target() != bare.target() {
        words.push(match parameter.target() {
            Target::Variables(variables) => format!("sets {}", variables.join(", ")),
            Target::Delay(variable) => format!("delays {variable}"),
            Target::Offset(variable) => format!("is added to {variable}"),
        });
    }
    words.extend(parameter.given_unit().map(|unit| format!("in {unit}")));
    words.extend(parameter.known_prior().map(|prior| format!("{prior:?}")));
    words.extend(parameter.tie().map(|tie| format!("{:?} {} + {:?}", tie.factor, tie.to, tie.offset)));
    (!words.is_empty()).then(|| words.join("; "))
}

/// Data and settings that the costs of an experiment depend on, by name and in words.
fn of(experiment: &Experiment, parameters: &[Parameter]) -> Vec<(&'static str, String)> {
    let Experiment {
        name: _,
        data,
        outputs,
        inputs,
        start_values,
        initial_states,
        windows,
        warm_up,
        start_time,
        // Where it makes a difference without it there is no cost.
        hold_inputs: _,
        delays,
    } = experiment;
    let number = |value: Option<f64>| value.map_or_else(|| "by default".to_owned(), |v| format!("{v:?}"));
    let list = |all: Vec<String>| all.join("; ");
    let weight = |weight: &Weight| match weight {
        Weight::Constant(weight) => format!("{weight:?}"),
        Weight::Column(column) => format!("by {column}"),
        Weight::Rows(weights) => hash_of_numbers(weights),
        Weight::Inverse(scale) => format!("1 / {}", scale.name()),
    };
    let output =
        |m: &Measured| format!("{} measured by {}, weight {}", m.variable, m.column, weight(&m.weight));
    let input = |(variable, source): &(String, InputSource)| match source {
        InputSource::Column(column) => format!("{variable} from {column}"),
        InputSource::Constant(value) => format!("{variable} = {value:?}"),
        // A function is what it gives at the times of the recording.
        InputSource::Function(_) => {
            let samples = Signal::new(variable, source, data).map(|signal| signal.samples(data.time()));
            format!("{variable} from a function with {}", hash_of_numbers(&samples.unwrap_or_default()))
        }
    };
    let value = |(name, value): &(String, fmi::Value)| format!("{name} = {}", whole(value));
    let state = |(name, initial): &(String, InitialState)| match initial {
        InitialState::Value(value) => format!("{name} = {value:?}"),
        InitialState::Measured => format!("{name} as measured first"),
        InitialState::Fitted(parameter) => {
            let prior = parameter.known_prior().map(|prior| format!(", {prior:?}")).unwrap_or_default();
            format!("{name} fitted in {}{prior}", parameter.given_unit().unwrap_or("its unit"))
        }
    };
    let is_constant = |(name, _): &&(String, _)| !Experiment::is_start_of_local(name, parameters);
    let window = |(from, to): &(f64, f64)| format!("from {from:?} to {to:?}");
    let mut all = vec![
        ("data", data.hash()),
        ("outputs", list(outputs.iter().map(output).collect())),
        ("inputs", list(inputs.iter().map(input).collect())),
        ("start values", list(start_values.iter().filter(is_constant).map(value).collect())),
        (
            "window",
            if windows.is_empty() { "all".to_owned() } else { list(windows.iter().map(window).collect()) },
        ),
        ("start time", number(*start_time)),
    ];
    let is_given = |(_, value): &(&'static str, String)| !value.is_empty();
    let delay = |(variable, delay): &(String, f64)| format!("{variable} by {delay:?}");
    all.extend(
        [
            ("initial states", list(initial_states.iter().map(state).collect())),
            ("warm-up", warm_up.map(|seconds| format!("{seconds:?}")).unwrap_or_default()),
            ("delays", list(delays.iter().map(delay).collect())),
        ]
        .into_iter()
        .filter(is_given),
    );
    all
}

fn hash_of_numbers(numbers: &[f64]) -> String {
    hex(numbers
        .iter()
        .fold(Sha256::new(), |hasher, number| hasher.chain_update(number.to_bits().to_le_bytes())))
}

fn hex(hasher: Sha256) -> String {
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The same as a hash.
pub(crate) fn hash<'a>(identity: impl IntoIterator<Item = (&'a str, &'a str)>) -> String {
    let mut hasher = Sha256::new();
    for text in identity.into_iter().flat_map(|(name, value)| [name, value]) {
        hasher.update((text.len() as u64).to_le_bytes());
        hasher.update(text);
    }
    hex(hasher)
}

/// A value with all of its elements and bytes.
fn whole(value: &fmi::Value) -> String {
    match value {
        fmi::Value::Array(values) => format!("[{}]", values.iter().map(whole).collect::<Vec<_>>().join(", ")),
        fmi::Value::Binary(bytes) => bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
        other => other.to_string(),
    }
}

fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Kind::Auto => "auto",
        Kind::ModelExchange => "me",
        Kind::CoSimulation => "cs",
    }
}
