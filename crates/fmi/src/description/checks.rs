//! Checks that need the complete description: references between its parts, and the quirk report.
//!
//! Tolerable deviations are reported as quirks, because exported FMUs often deviate from the standard in
//! small ways. A deviation is an error only if it would make a run wrong or unsafe.

use super::draft::Draft;
use super::limits::Reading;
use super::model::{ModelDescription, Quirk, QuirkKind, Unknown};
use super::names::NameIndex;
use super::quirks::Quirks;
use super::structure::Structure;
use super::unit::Unit;
use super::variable::{Causality, Dimension, Initial, TypeDefinition, Variability, Variable};
use crate::archive::MODEL_DESCRIPTION;
use crate::error::{FmiError, Result};
use crate::value::{Value, VariableKind};
use std::collections::{HashMap, HashSet};

/// Resolves the references of a draft and converts it to a description.
pub(super) fn finish(mut draft: Draft) -> Result<ModelDescription> {
    inherit_types(&mut draft)?;
    resolve_derivatives(&mut draft);
    resolve_dimensions(&mut draft)?;
    resolve_structure(&mut draft)?;
    draft.model.most_elements = draft.reading.limits.elements;
    let too_large = |(line, message)| FmiError::Description { file: MODEL_DESCRIPTION, line, message };
    Structure::default().check(&draft.model).map_err(too_large)?;
    let Draft { mut model, reading, .. } = draft;
    let mut quirks = reading.quirks.take();
    model.n_event_indicators = Structure::default().indicators(&model);
    reading.check(0)?;
    check_header(&model, &mut quirks);
    check_units(&model, &mut quirks);
    check_structure(&model, &mut quirks);
    for variable in &mut model.variables {
        reading.check(0)?;
        variable.is_narrow = model.fmi_version.major < 3 && variable.kind == VariableKind::Enumeration;
        check_range(variable, &mut quirks);
        if model.fmi_version.has_table_of_combinations() {
            check_roles(variable, &mut quirks);
            check_start(variable, &mut quirks);
        }
    }
    check_time(&model.variables, &mut quirks);
    model.has_arrays = model.variables.iter().any(|variable| !variable.dimensions.is_empty());
    model.names = index_names(&model.variables, &mut quirks);
    model.aliases = super::names::aliases(&model.variables, &model.names, |position, alias, first| {
        let (variable, first) = (&model.variables[position], &model.variables[first]);
        quirks.add(QuirkKind::Duplicate, variable.line, || {
            format!(
                "the alias \"{alias}\" of \"{}\" is also a name of the variable in line {}",
                variable.name, first.line
            )
        });
    });
    model.quirks = quirks.into_list();
    Ok(model)
}

/// Reports a second independent variable.
fn check_time(variables: &[Variable], quirks: &mut Quirks) {
    let mut independent = variables.iter().filter(|variable| variable.causality == Causality::Independent);
    let Some(first) = independent.next() else { return };
    for other in independent {
        quirks.add(QuirkKind::Duplicate, other.line, || {
            format!("\"{}\" is a second independent variable in addition to \"{}\"", other.name, first.name)
        });
    }
}

/// Returns an error if there are quirks other than features that the importer does not support.
pub(super) fn require_conforming(quirks: &[Quirk]) -> Result<()> {
    let mut departures = quirks.iter().filter(|quirk| quirk.kind != QuirkKind::Unsupported);
    match departures.next() {
        None => Ok(()),
        Some(first) => Err(FmiError::NotConforming {
            count: 1 + departures.count(),
            line: first.line,
            first: first.message.clone(),
        }),
    }
}

/// Maximum length of a string that variables inherit. Each variable has a copy, so a long string in a small
/// file could exhaust the memory.
const LONGEST_INHERITED: usize = 1024;

/// Fills in the attributes that variables inherit from their types.
fn inherit_types(draft: &mut Draft) -> Result<()> {
    let model = &mut draft.model;
    for definition in &mut model.type_definitions {
        for text in [&mut definition.quantity, &mut definition.unit, &mut definition.display_unit] {
            if let Some(long) = text.take_if(|text| text.len() > LONGEST_INHERITED) {
                draft.reading.quirk(QuirkKind::Attribute, 0, || {
                    format!(
                        "a quantity or unit of the type \"{}\" has {} bytes and is ignored",
                        definition.name,
                        long.len()
                    )
                });
            }
        }
    }
    let types: HashMap<&str, &TypeDefinition> =
        model.type_definitions.iter().map(|definition| (definition.name.as_str(), definition)).collect();
    let mut unknown: HashSet<String> = HashSet::new();
    for (variable, flags) in model.variables.iter_mut().zip(&draft.flags) {
        let Some(name) = &variable.declared_type else { continue };
        let (line, kind) = (variable.line, variable.kind);
        match types.get(name.as_str()) {
            Some(definition) if definition.kind == kind => {
                inherit(variable, definition, &draft.reading);
                draft.reading.check(line)?;
                variable.relative_quantity |= definition.relative_quantity && !flags.relative_quantity;
                variable.unbounded |= definition.unbounded && !flags.unbounded;
            }
            Some(definition) => draft.reading.quirk(QuirkKind::Undefined, line, || {
                format!(
                    "{kind} \"{}\" has the declared type \"{name}\", which is of type {}",
                    variable.name, definition.kind
                )
            }),
            None if !unknown.contains(name) => {
                unknown.insert(name.clone());
                draft.reading.quirk(QuirkKind::Undefined, line, || format!("type \"{name}\" is not defined"));
            }
            None => {}
        }
    }
    Ok(())
}

fn inherit(variable: &mut Variable, definition: &TypeDefinition, reading: &Reading) {
    let fill = |field: &mut Option<String>, inherited: &Option<String>| {
        if field.is_none() && inherited.as_ref().is_some_and(|text| reading.take_text(text)) {
            field.clone_from(inherited);
        }
    };
    fill(&mut variable.quantity, &definition.quantity);
    fill(&mut variable.unit, &definition.unit);
    fill(&mut variable.display_unit, &definition.display_unit);
    variable.min = variable.min.or(definition.min);
    variable.max = variable.max.or(definition.max);
    variable.nominal = variable.nominal.or(definition.nominal);
}

/// Removes `derivative` attributes that do not refer to a variable.
fn resolve_derivatives(draft: &mut Draft) {
    let n_variables = draft.model.variables.len();
    for variable in &mut draft.model.variables {
        if variable.derivative.is_some_and(|state| state >= n_variables) {
            variable.derivative = None;
            draft.reading.quirk(QuirkKind::Structure, variable.line, || {
                format!("\"{}\" is the derivative of a variable that does not exist", variable.name)
            });
        }
    }
}

/// Returns an error for a dimension that is not a structural parameter. Reports start values that do not
/// match the number of elements.
fn resolve_dimensions(draft: &mut Draft) -> Result<()> {
    let model = &draft.model;
    for variable in model.variables.iter().filter(|variable| !variable.dimensions.is_empty()) {
        let refuse = |message: String| {
            Err(FmiError::Description { file: MODEL_DESCRIPTION, line: variable.line, message })
        };
        for dimension in &variable.dimensions {
            let Dimension::Parameter(index) = *dimension else { continue };
            let is_declared = model
                .variables
                .get(index)
                .is_some_and(|v| v.causality == Causality::StructuralParameter && v.kind.is_integer());
            if !is_declared {
                return refuse(format!(
                    "\"{}\" has a dimension that is not a structural parameter",
                    variable.name
                ));
            }
        }
        let elements = Structure::default().elements(model, variable);
        let given = match &variable.start {
            Some(Value::Array(values)) => values.len(),
            Some(_) => 1,
            None => continue,
        };
        // A single value applies to all elements.
        if given != elements && given != 1 {
            draft.reading.quirk(QuirkKind::Start, variable.line, || {
                format!("\"{}\" has {given} start values for {elements} elements", variable.name)
            });
        }
    }
    Ok(())
}

/// Removes invalid indices from the model structure. An invalid derivative or event indicator is an error,
/// because removing it would change their number.
fn resolve_structure(draft: &mut Draft) -> Result<()> {
    let n_variables = draft.model.variables.len();
    let quirks = &mut draft.reading.quirks.borrow_mut();
    let structure = &mut draft.model.structure;
    let [output_lines, derivative_lines, initial_lines, indicator_lines] = &draft.structure_lines;
    let derivatives = structure.derivatives.iter().zip(derivative_lines).map(|pair| ("a derivative", pair));
    let indicators =
        structure.event_indicators.iter().zip(indicator_lines).map(|pair| ("an event indicator", pair));
    for (what, (unknown, &line)) in derivatives.chain(indicators) {
        if unknown.index >= n_variables {
            let message = format!(
                "{what} refers to a variable that does not exist (the model has {n_variables} variables)"
            );
            return Err(FmiError::Description { file: MODEL_DESCRIPTION, line, message });
        }
    }
    keep_in_range("output", &mut structure.outputs, output_lines, n_variables, quirks);
    keep_in_range("initial unknown", &mut structure.initial_unknowns, initial_lines, n_variables, quirks);
    let lists = [
        &mut structure.outputs,
        &mut structure.derivatives,
        &mut structure.initial_unknowns,
        &mut structure.event_indicators,
    ];
    for unknown in lists.into_iter().flatten() {
        resolve_dependencies(unknown, n_variables, quirks);
    }
    Ok(())
}

fn keep_in_range(
    what: &str,
    list: &mut Vec<Unknown>,
    lines: &[u32],
    n_variables: usize,
    quirks: &mut Quirks,
) {
    let mut lines = lines.iter();
    list.retain(|unknown| {
        let line = lines.next().copied().unwrap_or(0);
        let is_in_range = unknown.index < n_variables;
        if !is_in_range {
            quirks.add(QuirkKind::Structure, line, || {
                format!(
                    "an {what} refers to a variable that does not exist (the model has {n_variables} \
                         variables); ignored"
                )
            });
        }
        is_in_range
    });
}

/// Replaces invalid dependencies by "depends on all", which is always valid.
fn resolve_dependencies(unknown: &mut Unknown, n_variables: usize, quirks: &mut Quirks) {
    let Unknown { index, dependencies, kinds } = unknown;
    let in_range = dependencies.iter().flatten().all(|&index| index < n_variables);
    if !in_range {
        *dependencies = None;
        quirks.add(QuirkKind::Structure, 0, || {
            format!(
                "variable number {} depends on variables that do not exist; assumed to depend on all \
                 variables",
                *index + 1
            )
        });
    }
    if !kinds.is_empty() && dependencies.as_ref().map(Vec::len) != Some(kinds.len()) {
        if in_range {
            quirks.add(QuirkKind::Structure, 0, || {
                format!(
                    "variable number {} has {} dependency kinds; expected one per dependency",
                    *index + 1,
                    kinds.len()
                )
            });
        }
        kinds.clear();
    }
}

fn check_header(model: &ModelDescription, quirks: &mut Quirks) {
    let has_interface = model.model_exchange.is_some() || model.co_simulation.is_some();
    // Scheduled execution has a separate quirk.
    if !has_interface && !model.offers_scheduled_execution {
        quirks.add(QuirkKind::Missing, 0, || {
            "neither model exchange nor co-simulation is supported".to_owned()
        });
    }
    let experiment = &model.default_experiment;
    if let (Some(start), Some(stop)) = (experiment.start_time, experiment.stop_time)
        && stop < start
    {
        quirks.add(QuirkKind::Range, 0, || {
            format!("the default experiment ends at {stop}, before it starts at {start}")
        });
    }
}

/// Reports undefined units of variables. Each name is reported once.
fn check_units(model: &ModelDescription, quirks: &mut Quirks) {
    let units: HashMap<&str, &Unit> = model.units.iter().map(|unit| (unit.name.as_str(), unit)).collect();
    if units.len() < model.units.len() {
        quirks.add(QuirkKind::Duplicate, 0, || {
            format!("{} units have only {} different names", model.units.len(), units.len())
        });
    }
    let mut reported = HashSet::new();
    for variable in &model.variables {
        let Some(name) = variable.unit.as_deref() else { continue };
        let Some(unit) = units.get(name) else {
            if reported.insert((name, "")) {
                quirks.add(QuirkKind::Undefined, variable.line, || format!("unit \"{name}\" is not defined"));
            }
            continue;
        };
        let Some(shown) = variable.display_unit.as_deref().filter(|shown| *shown != name) else { continue };
        if !unit.display_units.iter().any(|display| display.name == shown) && reported.insert((name, shown)) {
            quirks.add(QuirkKind::Undefined, variable.line, || {
                format!("display unit \"{shown}\" of \"{name}\" is not defined")
            });
        }
    }
}

/// Checks that derivatives refer to their states, and that the listed outputs are the output variables.
fn check_structure(model: &ModelDescription, quirks: &mut Quirks) {
    let mut listed = HashSet::new();
    let mut states = HashSet::new();
    for unknown in &model.structure.derivatives {
        let variable = &model.variables[unknown.index];
        let mut complain = |what: &str| {
            quirks.add(QuirkKind::Structure, variable.line, || {
                format!("derivative \"{}\" {what}", variable.name)
            });
        };
        if !listed.insert(unknown.index) {
            complain("is listed twice in the model structure");
        }
        if !variable.kind.is_float() {
            complain("is not a Real variable");
        }
        match variable.derivative {
            None => complain("does not declare which state it is the derivative of"),
            Some(state) if !states.insert(state) => complain("refers to the state of another derivative"),
            Some(_) => {}
        }
    }
    if !model.fmi_version.lists_outputs() {
        return;
    }
    let outputs: HashSet<usize> = model.structure.outputs.iter().map(|unknown| unknown.index).collect();
    for (position, variable) in model.variables.iter().enumerate() {
        let is_output = variable.causality == Causality::Output;
        if is_output != outputs.contains(&position) {
            quirks.add(QuirkKind::Structure, variable.line, || {
                let not = if is_output { "not " } else { "" };
                format!(
                    "{} \"{}\" is {not}listed as an output in the model structure",
                    variable.causality, variable.name
                )
            });
        }
    }
}

fn check_range(variable: &Variable, quirks: &mut Quirks) {
    let mut complain = |what: String| {
        quirks.add(QuirkKind::Range, variable.line, || format!("\"{}\" has {what}", variable.name));
    };
    if let Some(nominal) = variable.nominal
        && !(nominal > 0.0 && nominal.is_finite())
    {
        complain(format!("an invalid nominal value {nominal}"));
    }
    let (min, max) = (variable.min.unwrap_or(f64::NEG_INFINITY), variable.max.unwrap_or(f64::INFINITY));
    if min > max {
        complain(format!("a minimum {min} above its maximum {max}"));
        return;
    }
    let start = match variable.start {
        Some(Value::Real(start)) => start,
        Some(Value::Integer(start)) => start as f64,
        _ => return,
    };
    if start < min || start > max || start.is_nan() {
        complain(format!("a start value {start} outside its range {min} to {max}"));
    }
}

/// Checks combinations of causality, variability and initial against the tables of FMI 2.0 (2.2.7).
fn check_roles(variable: &Variable, quirks: &mut Quirks) {
    use {Causality as C, Initial as I, Variability as V};
    let pair_fits = match variable.causality {
        C::Parameter | C::StructuralParameter | C::CalculatedParameter => {
            matches!(variable.variability, V::Fixed | V::Tunable)
        }
        C::Input => matches!(variable.variability, V::Discrete | V::Continuous),
        C::Output => !matches!(variable.variability, V::Fixed | V::Tunable),
        C::Local => true,
        C::Independent => variable.variability == V::Continuous,
    };
    let initial_fits = match (variable.causality, variable.variability) {
        (C::Input | C::Independent, _) => variable.initial.is_none(),
        (C::Parameter | C::StructuralParameter, _) | (_, V::Constant) => variable.initial == Some(I::Exact),
        (C::CalculatedParameter, _) | (_, V::Fixed | V::Tunable) => variable.initial != Some(I::Exact),
        _ => true,
    };
    if !pair_fits || (!initial_fits && variable.initial.is_some()) {
        quirks.add(QuirkKind::Combination, variable.line, || {
            let initial = variable.initial.map(|initial| format!(", initial {initial}")).unwrap_or_default();
            format!(
                "\"{}\" has an invalid combination of attributes: causality {}, variability {}{initial}",
                variable.name, variable.causality, variable.variability
            )
        });
    }
}

/// Reports missing and superfluous start values.
fn check_start(variable: &Variable, quirks: &mut Quirks) {
    let needed = variable.causality == Causality::Input
        || matches!(variable.initial, Some(Initial::Exact | Initial::Approx));
    if needed != variable.start.is_some() {
        quirks.add(QuirkKind::Start, variable.line, || {
            let what = if needed { "has no start value" } else { "has an unused start value" };
            format!("\"{}\" {what}", variable.name)
        });
    }
}

fn index_names(variables: &[Variable], quirks: &mut Quirks) -> NameIndex {
    NameIndex::build(variables, |duplicate, first| {
        let (duplicate, first) = (&variables[duplicate], &variables[first]);
        quirks.add(QuirkKind::Duplicate, duplicate.line, || {
            format!("the name \"{}\" is also the name of the variable in line {}", duplicate.name, first.line)
        });
    })
}
