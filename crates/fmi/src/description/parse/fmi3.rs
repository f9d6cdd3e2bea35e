//! Model descriptions of FMI 3.0, as far as the house types go: header, interfaces, scalar variables of the types
//! that FMI 2.0 has too, model structure. What has no house type yet is left out and listed as a quirk.

use super::attributes::Attributes;
use super::xml::{Element, Xml};
use super::{Draft, Flags, NOWHERE, StructureList, shared};
use crate::description::model::{Interface, QuirkKind, Unknown};
use crate::description::variable::{Value, Variable, VariableKind};
use crate::error::FmiError;
use std::collections::HashMap;

/// Positions of variables by value reference, which FMI 3.0 uses where FMI 2.0 has positions; `None` for variables
/// left out.
type Positions = HashMap<u32, Option<usize>>;

pub(super) fn parse(xml: &mut Xml<'_>, root: &Element<'_>, draft: &mut Draft) -> Result<(), FmiError> {
    shared::header(&Attributes::of(root)?, "instantiationToken", draft)?;
    let mut positions = Positions::new();
    while let Some(element) = xml.child(root.level)? {
        match element.name() {
            "ModelExchange" => draft.model.model_exchange = Some(interface(&element, draft)?),
            "CoSimulation" => draft.model.co_simulation = Some(interface(&element, draft)?),
            "ScheduledExecution" => {
                draft.model.offers_scheduled_execution = true;
                unsupported(draft, &element, "scheduled execution");
            }
            "UnitDefinitions" => shared::units(xml, &element, draft)?,
            "TypeDefinitions" => type_definitions(xml, &element, draft)?,
            "LogCategories" => shared::log_categories(xml, &element, draft)?,
            "DefaultExperiment" => shared::default_experiment(&element, draft)?,
            "ModelVariables" => positions = variables(xml, &element, draft)?,
            "ModelStructure" => structure(xml, &element, &positions, draft)?,
            _ => {}
        }
    }
    Ok(())
}

fn unsupported(draft: &mut Draft, element: &Element<'_>, what: &str) {
    draft.quirks.add(QuirkKind::Unsupported, element.line, || format!("{what} is left out"));
}

fn interface(element: &Element<'_>, draft: &mut Draft) -> Result<Interface, FmiError> {
    let attributes = Attributes::of(element)?;
    Ok(Interface {
        model_identifier: shared::model_identifier(&attributes)?,
        capabilities: shared::capabilities(&attributes, draft),
        source_files: Vec::new(),
    })
}

/// The house type for an element like `<Float64>` or `<Float64Type>`, whatever its width.
fn kind(element: &str) -> Option<VariableKind> {
    match element.strip_suffix("Type").unwrap_or(element) {
        "Float32" | "Float64" => Some(VariableKind::Real),
        "Int8" | "UInt8" | "Int16" | "UInt16" | "Int32" | "UInt32" | "Int64" | "UInt64" => {
            Some(VariableKind::Integer)
        }
        "Boolean" => Some(VariableKind::Boolean),
        "String" => Some(VariableKind::String),
        "Enumeration" => Some(VariableKind::Enumeration),
        _ => None,
    }
}

fn type_definitions(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<(), FmiError> {
    while let Some(element) = xml.child(parent.level)? {
        let Some(kind) = kind(element.name()) else {
            unsupported(draft, &element, "a type of variables this importer does not know");
            continue;
        };
        let attributes = Attributes::of(&element)?;
        let name = attributes.required("name")?.to_owned();
        let mut definition = shared::plain_type(name, attributes.text("description"), kind);
        shared::type_attributes(&attributes, &mut definition, draft);
        if kind == VariableKind::Enumeration {
            definition.items = shared::items(xml, &element, draft)?;
        }
        draft.model.type_definitions.push(definition);
    }
    Ok(())
}

fn variables(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<Positions, FmiError> {
    let mut positions = Positions::new();
    let mut derivatives = Vec::new();
    while let Some(element) = xml.child(parent.level)? {
        let attributes = Attributes::of(&element)?;
        let Some(kind) = kind(element.name()) else {
            let name = attributes.get("name").unwrap_or_default();
            positions.entry(attributes.value_reference()?).or_insert(None);
            unsupported(draft, &element, &format!("variable \"{name}\" of type {}", element.name()));
            continue;
        };
        let mut variable = shared::plain_variable(&attributes, kind)?;
        let flags = scalar_attributes(&attributes, &mut variable, draft);
        variable_children(xml, &element, &mut variable, draft)?;
        let position = draft.model.variables.len();
        if let Some(state) = attributes.count("derivative", &mut draft.quirks) {
            derivatives.push((position, state));
        }
        positions.entry(variable.value_reference).or_insert(Some(position));
        draft.model.variables.push(variable);
        draft.flags.push(flags);
    }
    for (position, state) in derivatives {
        let state = positions.get(&state).copied().flatten().unwrap_or(NOWHERE);
        draft.model.variables[position].derivative = Some(state);
    }
    Ok(positions)
}

fn scalar_attributes(attributes: &Attributes<'_>, variable: &mut Variable, draft: &mut Draft) -> Flags {
    shared::roles(attributes, variable, draft);
    let quirks = &mut draft.quirks;
    variable.declared_type = attributes.text("declaredType");
    variable.quantity = attributes.text("quantity");
    variable.unit = attributes.text("unit");
    variable.display_unit = attributes.text("displayUnit");
    variable.min = attributes.real("min", quirks);
    variable.max = attributes.real("max", quirks);
    variable.nominal = attributes.real("nominal", quirks);
    variable.reinit = attributes.flag("reinit", quirks);
    variable.can_handle_multiple_set_per_time_instant =
        attributes.boolean("canHandleMultipleSetPerTimeInstant", quirks).unwrap_or(true);
    // Several words are the start values of an array, which is reported with its dimensions.
    let is_scalar = attributes.get("start").is_some_and(|start| start.split_ascii_whitespace().count() == 1);
    variable.start = match variable.kind {
        _ if !is_scalar => None,
        VariableKind::Real => attributes.real("start", quirks).map(Value::Real),
        VariableKind::Integer | VariableKind::Enumeration => {
            attributes.integer("start", quirks).map(Value::Integer)
        }
        VariableKind::Boolean => attributes.boolean("start", quirks).map(Value::Boolean),
        VariableKind::String => None,
    };
    let relative_quantity = attributes.boolean("relativeQuantity", quirks);
    let unbounded = attributes.boolean("unbounded", quirks);
    variable.relative_quantity = relative_quantity.unwrap_or(false);
    variable.unbounded = unbounded.unwrap_or(false);
    Flags { relative_quantity: relative_quantity.is_some(), unbounded: unbounded.is_some() }
}

/// `<Dimension>`, and `<Start value="..."/>` of texts.
fn variable_children(
    xml: &mut Xml<'_>,
    element: &Element<'_>,
    variable: &mut Variable,
    draft: &mut Draft,
) -> Result<(), FmiError> {
    while let Some(child) = xml.child(element.level)? {
        match child.name() {
            "Dimension" => {
                unsupported(
                    draft,
                    &child,
                    &format!("\"{}\" is an array; all but its first element", variable.name),
                );
            }
            "Start" if variable.start.is_none() && variable.kind == VariableKind::String => {
                variable.start = Attributes::of(&child)?.text("value").map(Value::String);
            }
            _ => {}
        }
    }
    Ok(())
}

fn structure(
    xml: &mut Xml<'_>,
    parent: &Element<'_>,
    positions: &Positions,
    draft: &mut Draft,
) -> Result<(), FmiError> {
    while let Some(element) = xml.child(parent.level)? {
        let list = match element.name() {
            "Output" => StructureList::Outputs,
            "ContinuousStateDerivative" => StructureList::Derivatives,
            "InitialUnknown" => StructureList::InitialUnknowns,
            "EventIndicator" => {
                draft.model.n_event_indicators += 1;
                continue;
            }
            _ => continue,
        };
        let attributes = Attributes::of(&element)?;
        let position = |reference: &u32| positions.get(reference).copied().unwrap_or(Some(NOWHERE));
        let Some(index) = position(&attributes.value_reference()?) else { continue };
        let references = attributes.counts("dependencies", &mut draft.quirks);
        // One that is left out makes the list incomplete, and what depends on an unknown set depends on all.
        let dependencies: Option<Vec<usize>> =
            references.and_then(|list| list.iter().map(position).collect());
        let kinds = attributes.choices("dependenciesKind", shared::DEPENDENCY_KINDS, &mut draft.quirks);
        let kinds = kinds.filter(|_| dependencies.is_some()).unwrap_or_default();
        draft.add_unknown(list, Unknown { index, dependencies, kinds }, element.line);
    }
    Ok(())
}
