//! Checks of the names in parameters, delays and initial states against the variables of the model and the
//! outputs and inputs of the experiments.

use crate::data::find_column;
use crate::error::CalibrationError;
use crate::problem::experiment::{Experiment, InitialState, Measured};
use crate::problem::parameter::{Parameter, Target};
use base::Number;
use fmi::ModelDescription;

/// True if two names refer to the same variable.
pub(crate) fn is_same(description: &ModelDescription, one: &str, other: &str) -> bool {
    let reference = |name: &str| description.variable(name).map(|v| (v.kind, v.value_reference));
    one == other || reference(one).is_some_and(|of| reference(other) == Some(of))
}

impl Experiment {
    /// True if a variable is a compared output or a driven input.
    fn shifts(&self, variable: &str) -> bool {
        let mut outputs = self.outputs.iter().map(|output| &output.variable);
        outputs.any(|name| name == variable) || self.inputs.iter().any(|(name, _)| name == variable)
    }

    /// Returns the compared outputs and the driven inputs.
    fn shifted_names(&self) -> impl Iterator<Item = &str> {
        let outputs = self.outputs.iter().map(|output| output.variable.as_str());
        outputs.chain(self.inputs.iter().map(|(name, _)| name.as_str()))
    }
}

/// Checks the parameters against each other and against the experiments.
pub(crate) fn check_targets(
    parameters: &[Parameter],
    experiments: &[Experiment],
    names: &[String],
    description: &ModelDescription,
) -> Result<(), CalibrationError> {
    let bad = |parameter: &Parameter, message: String| {
        Err(CalibrationError::Parameter { name: parameter.name().to_owned(), message })
    };
    for (i, parameter) in parameters.iter().enumerate() {
        let shares =
            |other: &&Parameter| names.iter().any(|name| other.acts_in(name) && parameter.acts_in(name));
        let earlier = || parameters[..i].iter().filter(shares);
        match parameter.target() {
            Target::Variables(variables) => {
                for (j, variable) in variables.iter().enumerate() {
                    if let Some(twice) = variables[..j].iter().find(|v| is_same(description, v, variable)) {
                        let alias =
                            if twice == variable { String::new() } else { format!(", as '{twice}' too") };
                        return bad(
                            parameter,
                            format!("lists the variable '{variable}' twice{alias}. Remove one of them"),
                        );
                    }
                    let sets =
                        |p: &&Parameter| p.variable_names().iter().any(|v| is_same(description, v, variable));
                    if let Some(other) = earlier().find(sets) {
                        let message = format!(
                            "sets the variable '{variable}', which parameter '{}' also sets. Remove one of them",
                            other.name()
                        );
                        return bad(parameter, message);
                    }
                }
            }
            Target::Delay(variable) | Target::Offset(variable) | Target::Factor(variable) => {
                let what = match parameter.target() {
                    Target::Delay(_) => "delay",
                    Target::Factor(_) => "factor",
                    _ => "offset",
                };
                if let Some(other) = earlier().find(|p| p.target() == parameter.target()) {
                    return bad(
                        parameter,
                        format!(
                            "is the {what} of '{variable}', as is parameter '{}'. Remove one of them",
                            other.name()
                        ),
                    );
                }
                let mut acting = experiments.iter().zip(names);
                let missing = acting.position(|(e, name)| parameter.acts_in(name) && !e.shifts(variable));
                let is_anywhere = experiments.iter().any(|e| e.shifts(variable));
                if let Some(k) = missing.filter(|_| parameter.is_local() || !is_anywhere) {
                    let of = if experiments.len() > 1 { format!(" of {}", names[k]) } else { String::new() };
                    let available = experiments[k].shifted_names().collect::<Vec<_>>().join(", ");
                    return bad(
                        parameter,
                        format!(
                            "is the {what} of '{variable}', which is not an output or input{of} with a column; available: {available}"
                        ),
                    );
                }
                let is_given =
                    |e: &Experiment| what == "delay" && e.delays.iter().any(|(name, _)| name == variable);
                if experiments.iter().any(is_given) {
                    return bad(
                        parameter,
                        format!("is the delay of '{variable}', but delays also sets it. Remove one of them"),
                    );
                }
            }
        }
    }
    Ok(())
}

/// Checks the outputs, delays and initial states of an experiment.
pub(crate) fn check_names(
    experiment: &Experiment,
    parameters: &[Parameter],
    description: &ModelDescription,
) -> Result<(), CalibrationError> {
    let setup = |message: String| Err(CalibrationError::Setup(message));
    for (i, output) in experiment.outputs.iter().enumerate() {
        let full = |column: &str| experiment.data.full_name(column).map(str::to_owned);
        let column = full(&output.column);
        let has = |name: &str| find_column(experiment.data.all_names(), name).is_ok();
        let (variable, named) = (&output.variable, &output.column);
        if !has(named)
            && has(variable)
            && description.variable(named).is_some()
            && description.variable(variable).is_none()
        {
            return setup(format!(
                "output '{variable}' with the column '{named}' is reversed: '{named}' is a variable of the model, and '{variable}' \
                 is a column. Map variables to columns, {{\"{named}\": \"{variable}\"}}"
            ));
        }
        // Another check reports variables that do not exist.
        let is_declared = |name: &str| description.variable(name).is_some();
        let same = |other: &&Measured| {
            column.is_some()
                && full(&other.column) == column
                && other.variable != output.variable
                && [&other.variable, variable].iter().all(|name| is_declared(name))
        };
        if let Some(other) = experiment.outputs[..i].iter().find(same) {
            return setup(format!(
                "column '{}' is compared with two outputs, '{}' and '{}'. Specify a separate column for each",
                output.column, other.variable, output.variable
            ));
        }
    }
    for (i, (variable, delay)) in experiment.delays.iter().enumerate() {
        if !experiment.shifts(variable) {
            let available = experiment.shifted_names().collect::<Vec<_>>().join(", ");
            return setup(format!(
                "delays: '{variable}' is not an output or input with a column; available: {available}"
            ));
        }
        if !delay.is_finite() {
            return setup(format!("the delay {} of '{variable}' must be a finite number", Number(*delay)));
        }
        if experiment.delays[..i].iter().any(|(name, _)| name == variable) {
            return setup(format!("the delay of '{variable}' is set twice"));
        }
    }
    for (i, (state, initial)) in experiment.initial_states.iter().enumerate() {
        match initial {
            InitialState::MeasuredBy(output) => check_same_unit(state, output, description)?,
            _ => check_state(state, description)?,
        }
        let same = |name: &String| is_same(description, name, state);
        if experiment.initial_states[..i].iter().any(|(name, _)| same(name)) {
            return setup(format!("initial state '{state}' is set twice"));
        }
        if experiment.start_values.iter().any(|(name, _)| same(name)) {
            return setup(format!("'{state}' is in initial_states and in start_values. Remove one of them"));
        }
        if let Some(parameter) = parameters.iter().find(|p| p.variable_names().iter().any(same)) {
            return setup(format!(
                "initial state '{state}' is set, but parameter '{}' also sets it. Remove one of them",
                parameter.name()
            ));
        }
        if let InitialState::Fitted(parameter) = initial
            && (parameter.is_derived() || parameter.variable_names().is_empty())
        {
            return setup(format!(
                "initial state '{state}' is fitted by a parameter that is derived, a delay or an offset. Use one with a start and bounds"
            ));
        }
    }
    Ok(())
}

/// Returns the names of the continuous states, as far as the model description identifies them.
pub(crate) fn states(description: &ModelDescription) -> Vec<&String> {
    let state = |index: usize| {
        description.variables[index].derivative.map(|state| &description.variables[state].name)
    };
    description.structure.derivatives.iter().filter_map(|derivative| state(derivative.index)).collect()
}

/// Returns an error if an output that provides the start value of a variable has a different unit.
fn check_same_unit(
    variable: &str,
    output: &str,
    description: &ModelDescription,
) -> Result<(), CalibrationError> {
    let unit = |name: &str| description.variable(name)?.unit.as_deref();
    match (unit(variable), unit(output)) {
        (Some(unit), Some(other)) if unit != other => Err(CalibrationError::Setup(format!(
            "initial state '{variable}' (in {unit}) is 'measured:{output}', but '{output}' is in {other}. Use a number or a parameter"
        ))),
        _ => Ok(()),
    }
}

/// Rejects names that are not states of the model, as far as the model description identifies states.
fn check_state(name: &str, description: &ModelDescription) -> Result<(), CalibrationError> {
    let states = states(description);
    let is_state = states.iter().any(|state| is_same(description, state, name))
        || states
            .iter()
            .any(|state| name.strip_prefix(state.as_str()).is_some_and(|rest| rest.starts_with('[')));
    if states.is_empty() || is_state || description.variable(name).is_none() {
        // Planning the simulation rejects an unknown name and suggests the nearest ones.
        return Ok(());
    }
    let shown = states.iter().take(10).map(|state| state.as_str()).collect::<Vec<_>>().join(", ");
    let more = if states.len() > 10 { ", ..." } else { "" };
    Err(CalibrationError::Setup(format!(
        "initial state '{name}' is not a state of the model; available: {shown}{more}. Set other variables with start_values"
    )))
}
