//! Model descriptions of FMI 3.0 (specification 3.0.1, chapters 2.4, 3.3 and 4.3): all types of variables,
//! arrays, aliases, clocks as variables. Scheduled execution is reported as unsupported and otherwise
//! ignored.

use super::attributes::Attributes;
use super::clocks::{ClockAttributes, Clocks};
use super::shared;
use super::xml::{Element, Xml};
use crate::description::clock::ClockTiming;
use crate::description::draft::{Draft, NOWHERE, StructureList};
use crate::description::model::{DependencyKind, Interface, QuirkKind, Unknown};
use crate::description::variable::{Alias, Dimension, Variable};
use crate::error::Result;
use crate::value::{Value, VariableKind};
use std::collections::HashMap;

/// Indices of variables by value reference, which FMI 3.0 uses instead of the positions in FMI 2.0. `None`
/// for ignored variables.
type Positions = HashMap<u32, Option<usize>>;

/// References to variables that may be declared later in the file.
#[derive(Default)]
struct Later {
    /// Variable index and value reference of the state.
    derivatives: Vec<(usize, u32)>,
    /// Variable index, index of the dimension, value reference.
    dimensions: Vec<(usize, usize, u32)>,
    clocks: Vec<(usize, Vec<u32>)>,
}

pub(super) fn parse(xml: &mut Xml<'_>, root: &Element<'_>, draft: &mut Draft) -> Result<()> {
    shared::header(&Attributes::of(root)?, "instantiationToken", draft)?;
    let mut positions = Positions::new();
    let mut clocks = Clocks::default();
    while let Some(element) = xml.child(root.level)? {
        match element.name() {
            "ModelExchange" => draft.model.model_exchange = Some(interface(&element)?),
            "CoSimulation" => draft.model.co_simulation = Some(interface(&element)?),
            "ScheduledExecution" => {
                draft.model.offers_scheduled_execution = true;
                unsupported(draft, &element, "scheduled execution");
            }
            "UnitDefinitions" => shared::units(xml, &element, draft)?,
            "TypeDefinitions" => type_definitions(xml, &element, &mut clocks, draft)?,
            "LogCategories" => shared::log_categories(xml, &element, draft)?,
            "DefaultExperiment" => shared::default_experiment(&element, draft)?,
            "ModelVariables" => positions = variables(xml, &element, &mut clocks, draft)?,
            "ModelStructure" => structure(xml, &element, &positions, draft)?,
            _ => {}
        }
    }
    clocks.finish(draft);
    Ok(())
}

fn unsupported(draft: &mut Draft, element: &Element<'_>, what: &str) {
    draft.reading.quirk(QuirkKind::Unsupported, element.line, || format!("{what} is not supported; ignored"));
}

fn interface(element: &Element<'_>) -> Result<Interface> {
    let attributes = Attributes::of(element)?;
    let mut capabilities = shared::capabilities(&attributes);
    capabilities.completed_integrator_step_not_needed = !attributes.flag("needsCompletedIntegratorStep");
    Ok(Interface {
        model_identifier: shared::model_identifier(&attributes)?,
        capabilities,
        source_files: Vec::new(),
    })
}

/// Returns the kind of variable for an element such as `<Float64>` or `<Float64Type>`.
fn kind(element: &str) -> Option<VariableKind> {
    Some(match element.strip_suffix("Type").unwrap_or(element) {
        "Float64" => VariableKind::Real,
        "Float32" => VariableKind::Float32,
        "Int8" => VariableKind::Int8,
        "UInt8" => VariableKind::UInt8,
        "Int16" => VariableKind::Int16,
        "UInt16" => VariableKind::UInt16,
        "Int32" => VariableKind::Integer,
        "UInt32" => VariableKind::UInt32,
        "Int64" => VariableKind::Int64,
        "UInt64" => VariableKind::UInt64,
        "Boolean" => VariableKind::Boolean,
        "String" => VariableKind::String,
        "Binary" => VariableKind::Binary,
        "Enumeration" => VariableKind::Enumeration,
        "Clock" => VariableKind::Clock,
        _ => return None,
    })
}

fn type_definitions(
    xml: &mut Xml<'_>,
    parent: &Element<'_>,
    clocks: &mut Clocks,
    draft: &mut Draft,
) -> Result<()> {
    while let Some(element) = xml.child(parent.level)? {
        let Some(kind) = kind(element.name()) else {
            unsupported(draft, &element, "an unknown variable type");
            continue;
        };
        let attributes = Attributes::of(&element)?;
        let name = attributes.required_text("name")?;
        let description = attributes.text("description");
        let mut definition = shared::type_definition(name, description, kind, &attributes);
        if kind == VariableKind::Clock {
            let clock = ClockAttributes::of(&attributes);
            clocks.types.insert(definition.name.clone(), clock);
        }
        if kind == VariableKind::Enumeration {
            definition.items = shared::items(xml, &element, draft)?;
        }
        draft.reading.push(&mut draft.model.type_definitions, definition);
    }
    Ok(())
}

fn variables(
    xml: &mut Xml<'_>,
    parent: &Element<'_>,
    clocks: &mut Clocks,
    draft: &mut Draft,
) -> Result<Positions> {
    let mut positions = Positions::new();
    let mut later = Later::default();
    while let Some(element) = xml.child(parent.level)? {
        let attributes = Attributes::of(&element)?;
        let Some(kind) = kind(element.name()) else {
            let name = attributes.get("name").unwrap_or_default();
            draft.reading.take(2 * size_of::<(u32, Option<usize>, u8)>());
            positions.entry(attributes.value_reference()?).or_insert(None);
            unsupported(draft, &element, &format!("variable \"{name}\" of type {}", element.name()));
            continue;
        };
        let mut variable = shared::plain_variable(&attributes, kind)?;
        let position = draft.model.variables.len();
        shared::roles(&attributes, &mut variable);
        let flags = shared::value_attributes(&attributes, &mut variable);
        variable.intermediate_update = attributes.flag("intermediateUpdate");
        if kind == VariableKind::Clock {
            // Memory for the timing of the clock.
            draft.reading.take(size_of::<ClockTiming>() + 16);
            let clock = ClockAttributes::of(&attributes);
            draft.reading.push(&mut clocks.variables, (position, clock));
        }
        if kind == VariableKind::Binary {
            variable.max_size = attributes.count("maxSize").map(|size| size as usize);
        }
        let texts = variable_children(xml, &element, &mut variable, draft, &mut later)?;
        let is_array = !variable.dimensions.is_empty();
        variable.start = match kind {
            VariableKind::String | VariableKind::Binary => {
                start_of_texts(texts, is_array).or_else(|| start_attribute(&attributes, &variable))
            }
            _ => attributes.start(kind, is_array),
        };
        if let Some(state) = attributes.count("derivative") {
            draft.reading.push(&mut later.derivatives, (position, state));
        }
        if let Some(clocks) = attributes.counts("clocks") {
            draft.reading.push(&mut later.clocks, (position, clocks));
        }
        // Memory for two entries of a table that doubles its capacity.
        draft.reading.take(2 * size_of::<(u32, Option<usize>, u8)>());
        positions.entry(variable.value_reference).or_insert(Some(position));
        draft.add_variable(variable, flags);
    }
    let position = |reference: u32| positions.get(&reference).copied().flatten().unwrap_or(NOWHERE);
    let variables = &mut draft.model.variables;
    for (variable, state) in later.derivatives {
        variables[variable].derivative = Some(position(state));
    }
    for (variable, dimension, reference) in later.dimensions {
        variables[variable].dimensions[dimension] = Dimension::Parameter(position(reference));
    }
    for (variable, clocks) in later.clocks {
        let indices = clocks.into_iter().map(position).filter(|clock| *clock != NOWHERE);
        variables[variable].clocks = indices.collect();
    }
    Ok(positions)
}

/// Returns the start value of a string or binary variable from an attribute, as in FMI 2.0. The standard
/// requires `<Start>` elements.
fn start_attribute(attributes: &Attributes<'_>, variable: &Variable) -> Option<Value> {
    let start = match variable.kind {
        VariableKind::Binary => Value::Binary(attributes.hexadecimal("start")?),
        _ => Value::String(attributes.text("start")?),
    };
    attributes.quirk(QuirkKind::Start, || {
        format!("\"{}\" has its start value in an attribute instead of <Start> elements", variable.name)
    });
    Some(if variable.dimensions.is_empty() { start } else { Value::Array(vec![start]) })
}

/// Returns a scalar value, or the values of an array.
fn start_of_texts(mut values: Vec<Value>, is_array: bool) -> Option<Value> {
    match (values.is_empty(), is_array) {
        (true, _) => None,
        (false, true) => Some(Value::Array(values)),
        (false, false) => Some(values.swap_remove(0)),
    }
}

/// Parses `<Dimension>`, `<Alias>` and `<Start value="..."/>`. Returns the start values of string and binary
/// variables.
fn variable_children(
    xml: &mut Xml<'_>,
    element: &Element<'_>,
    variable: &mut Variable,
    draft: &mut Draft,
    later: &mut Later,
) -> Result<Vec<Value>> {
    let position = draft.model.variables.len();
    let mut starts = Vec::new();
    while let Some(child) = xml.child(element.level)? {
        let attributes = Attributes::of(&child)?;
        match child.name() {
            "Dimension" => {
                let extent = attributes.count("start");
                if let Some(reference) = attributes.count("valueReference") {
                    let number = variable.dimensions.len();
                    draft.reading.push(&mut later.dimensions, (position, number, reference));
                } else if extent.is_none() {
                    return Err(
                        attributes.error(format!("\"{}\" has a dimension without an extent", variable.name))
                    );
                }
                let extent = Dimension::Fixed(extent.unwrap_or(0) as usize);
                draft.reading.push(&mut variable.dimensions, extent);
            }
            "Alias" => {
                let name = attributes.required("name")?.to_owned();
                // Memory for this name, and for two entries in a table that doubles its capacity.
                draft.reading.take(2 * (name.len() + 24) + 2 * size_of::<(String, usize, u8)>());
                let alias = Alias {
                    name,
                    description: attributes.text("description"),
                    display_unit: attributes.text("displayUnit"),
                };
                draft.reading.push(&mut variable.aliases, alias);
            }
            "Start" if variable.kind == VariableKind::String => {
                draft.reading.push(&mut starts, Value::String(attributes.expected("value")));
            }
            "Start" if variable.kind == VariableKind::Binary => {
                let bytes = attributes.hexadecimal("value");
                draft.reading.push(&mut starts, Value::Binary(bytes.unwrap_or_default()));
            }
            _ => {}
        }
    }
    Ok(starts)
}

fn structure(
    xml: &mut Xml<'_>,
    parent: &Element<'_>,
    positions: &Positions,
    draft: &mut Draft,
) -> Result<()> {
    while let Some(element) = xml.child(parent.level)? {
        let list = match element.name() {
            "Output" => StructureList::Outputs,
            "ContinuousStateDerivative" => StructureList::Derivatives,
            "InitialUnknown" => StructureList::InitialUnknowns,
            "EventIndicator" => StructureList::EventIndicators,
            _ => continue,
        };
        let attributes = Attributes::of(&element)?;
        let position = |reference: &u32| positions.get(reference).copied().unwrap_or(Some(NOWHERE));
        let Some(index) = position(&attributes.value_reference()?) else { continue };
        let references = attributes.counts("dependencies");
        // An ignored variable makes the list incomplete. With an incomplete list, the unknown counts as
        // dependent on all variables.
        let dependencies: Option<Vec<usize>> =
            references.and_then(|list| list.iter().map(position).collect());
        let kinds = attributes.choices("dependenciesKind", DependencyKind::WORDS);
        let kinds = kinds.filter(|_| dependencies.is_some()).unwrap_or_default();
        draft.add_unknown(list, Unknown { index, dependencies, kinds }, element.line);
    }
    Ok(())
}
