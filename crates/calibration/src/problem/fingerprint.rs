//! Identity of the problem of a fit, as a list of named fields. A checkpoint belongs to one identity, and a
//! rejected checkpoint can report the difference.

use crate::error::CalibrationError;
use crate::expression::Relation;
use crate::problem::definition::Problem;
use crate::problem::experiment::{Experiment, InitialState};
use crate::problem::goal::Goal;
use crate::problem::input::{InputSource, Signal};
use crate::problem::parameter::Parameter;
use ciborium::Value;
use serde::Serialize;
use sha2::{Digest, Sha256};

/// Fields that do not affect any cost. `hold_inputs` is one of them, because a problem that needs this
/// setting has no cost without it. The data are included as a hash instead.
const WITHOUT_EFFECT: [&str; 7] =
    ["isolation", "memory_limit", "sandbox", "max_description_bytes", "name", "hold_inputs", "data"];

/// Longest series of numbers shown in full; longer ones are shown as a hash.
const LONGEST: usize = 8;

/// Returns the names and values of everything that the costs of a problem depend on, except the bounds and
/// starts of its parameters. Also contains the constraints, because a stored search depends on them.
pub(crate) fn identity(
    problem: &Problem,
    parameters: &[Parameter],
) -> Result<Vec<(String, String)>, CalibrationError> {
    let names: Vec<&str> = parameters.iter().map(Parameter::name).collect();
    let mut all = vec![
        ("model".to_owned(), problem.model.content_hash.clone()),
        ("parameter names".to_owned(), names.join(", ")),
    ];
    let mut settings = problem.settings.clone();
    settings.run.input_derivatives.get_or_insert(true);
    // Checkpoints of older versions do not contain a time unit.
    let is_known = |(name, value): &(String, String)| value != "none" || !name.starts_with("time_unit ");
    all.extend(fields("the simulations", &settings)?.into_iter().filter(is_known));
    for parameter in &problem.parameters {
        let own = fields(&format!("parameter {}", parameter.name()), &parameter.without_search())?;
        // Checkpoints of older versions have no periodic and no derived parameters.
        let is_older = |(name, value): &(String, String)| {
            !(value == "false" && name.starts_with("periodic ")
                || value == "none" && name.starts_with("expr "))
        };
        all.extend(own.into_iter().filter(is_older));
    }
    if !problem.goals.is_empty() {
        // A checkpoint rejects a repeated field, so all goals share one.
        let texts: Vec<&str> = problem.goals.iter().map(Goal::text).collect();
        all.push(("objective".to_owned(), texts.join("; ")));
    }
    if !problem.combination.is_sum() {
        all.push(("combine".to_owned(), problem.combination.name().to_owned()));
    }
    if !problem.constraints.is_empty() {
        let texts: Vec<&str> = problem.constraints.iter().map(Relation::text).collect();
        all.push(("constraints".to_owned(), texts.join("; ")));
    }
    for (k, experiment) in problem.experiments.iter().enumerate() {
        all.push((format!("data of experiment {k}"), experiment.data.hash()));
        let described = without_objects(experiment, &problem.parameters);
        all.extend(fields(&format!("experiment {k}"), &described)?);
    }
    Ok(all)
}

/// Returns the parts of the experiment that its costs depend on. Starts and bounds are removed. A function is
/// replaced by a hash of its values at the times of the recording.
fn without_objects(experiment: &Experiment, parameters: &[Parameter]) -> Experiment {
    let mut copy = Experiment { data: Default::default(), ..experiment.clone() };
    copy.start_values.retain(|(name, _)| !Experiment::is_start_of_local(name, parameters));
    for (variable, source) in &mut copy.inputs {
        if let InputSource::Function(_) = source {
            let signal = Signal::new(variable, source, &experiment.data);
            let samples = signal.map(|signal| signal.samples(experiment.data.time())).unwrap_or_default();
            *source = InputSource::Column(format!("a function with {}", hash_of_numbers(&samples)));
        }
    }
    for (state, initial) in &mut copy.initial_states {
        if let InitialState::Fitted(parameter) = initial {
            **parameter = parameter.for_state(state).without_search();
        }
    }
    copy
}

/// Returns the fields of a record that costs depend on, as text.
fn fields<T: Serialize>(of: &str, record: &T) -> Result<Vec<(String, String)>, CalibrationError> {
    let value = Value::serialized(record)
        .map_err(|e| CalibrationError::Setup(format!("{of} cannot be identified: {e}")))?;
    let named = |(name, value): &(Value, Value)| {
        let name = name.as_text().filter(|name| !WITHOUT_EFFECT.contains(name))?;
        Some((format!("{name} of {of}"), text(value)))
    };
    Ok(value.as_map().into_iter().flatten().filter_map(named).collect())
}

/// Formats a value with all its bits. Null and empty lists become "none".
fn text(value: &Value) -> String {
    let list = |items: Vec<String>| if items.is_empty() { "none".to_owned() } else { items.join(", ") };
    match value {
        Value::Null => "none".to_owned(),
        Value::Bool(flag) => flag.to_string(),
        Value::Integer(number) => i128::from(*number).to_string(),
        Value::Float(number) => format!("{number:?}"),
        Value::Text(text) => text.clone(),
        Value::Bytes(bytes) if bytes.len() > 8 * LONGEST => hash_of_bytes(bytes),
        Value::Bytes(bytes) => hex(bytes),
        Value::Array(items) => match items.iter().map(Value::as_float).collect::<Option<Vec<f64>>>() {
            Some(numbers) if numbers.len() > LONGEST => hash_of_numbers(&numbers),
            _ => match items.iter().any(|item| item.is_array() || item.is_map()) {
                true => items.iter().map(text).collect::<Vec<_>>().join("; "),
                false => list(items.iter().map(text).collect()),
            },
        },
        Value::Map(entries) => {
            list(entries.iter().map(|(name, value)| format!("{} {}", text(name), text(value))).collect())
        }
        other => format!("{other:?}"),
    }
}

fn hash_of_numbers(numbers: &[f64]) -> String {
    hash_of_bytes(&numbers.iter().flat_map(|number| number.to_bits().to_le_bytes()).collect::<Vec<u8>>())
}

/// Returns the SHA-256 hash in hexadecimal.
pub(crate) fn hash_of_bytes(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns the hash of an identity.
pub(crate) fn hash<'a>(identity: impl IntoIterator<Item = (&'a str, &'a str)>) -> String {
    let mut bytes = Vec::new();
    for text in identity.into_iter().flat_map(|(name, value)| [name, value]) {
        bytes.extend((text.len() as u64).to_le_bytes());
        bytes.extend(text.as_bytes());
    }
    hash_of_bytes(&bytes)
}
