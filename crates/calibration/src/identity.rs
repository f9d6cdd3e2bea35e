//! What a fit is made from, by name and in words: what a checkpoint belongs to, and what a refusal of one can name.

use crate::experiment::{Experiment, Measured};
use crate::parameter::Parameter;
use crate::problem::Problem;
use fmi::Kind;
use sha2::{Digest, Sha256};

/// All that the costs of a problem depend on, by name and in words: all but the bounds and starts of its parameters.
pub(crate) fn identity(problem: &Problem, parameters: &[Parameter]) -> Vec<(String, String)> {
    let names: Vec<&str> = parameters.iter().map(Parameter::name).collect();
    let mut all = vec![
        ("model".to_owned(), problem.model.content_hash.clone()),
        ("parameter names".to_owned(), names.join(", ")),
    ];
    // Costs do not depend on how simulations share the library.
    let crate::experiment::SimulationSettings {
        kind,
        method,
        relative_tolerance,
        step_size,
        max_step,
        input_derivatives,
        chattering,
        timeout,
        sharing: _,
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
    for (k, Experiment { name: _, data, outputs, inputs, start_values, window, start_time }) in
        problem.experiments.iter().enumerate()
    {
        let output = |m: &Measured| format!("{} measured by {}, weight {:?}", m.variable, m.column, m.weight);
        let input = |(variable, column): &(String, String)| format!("{variable} from {column}");
        let value = |(name, value): &(String, fmi::Value)| format!("{name} = {}", whole(value));
        let is_constant =
            |(name, _): &&(String, _)| !Experiment::is_start_of_local(name, &problem.parameters);
        let window = window.map_or_else(|| "all".to_owned(), |(from, to)| format!("from {from:?} to {to:?}"));
        all.extend(
            [
                ("data", data.hash()),
                ("outputs", outputs.iter().map(output).collect::<Vec<_>>().join("; ")),
                ("inputs", inputs.iter().map(input).collect::<Vec<_>>().join("; ")),
                (
                    "start values",
                    start_values.iter().filter(is_constant).map(value).collect::<Vec<_>>().join("; "),
                ),
                ("window", window),
                ("start time", number(*start_time)),
            ]
            .map(|(name, value)| (format!("{name} of experiment {k}"), value)),
        );
    }
    all
}

/// The same as a hash.
pub(crate) fn hash<'a>(identity: impl IntoIterator<Item = (&'a str, &'a str)>) -> String {
    let mut hasher = Sha256::new();
    for text in identity.into_iter().flat_map(|(name, value)| [name, value]) {
        hasher.update((text.len() as u64).to_le_bytes());
        hasher.update(text);
    }
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
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
