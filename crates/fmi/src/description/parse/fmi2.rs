//! Model descriptions of FMI 2.0 (specification 2.0.4, chapter 2.2 and the ME and CS parts of 3.3 and 4.3).

use super::attributes::Attributes;
use super::shared;
use super::xml::{Element, Xml};
use crate::description::draft::{Draft, Flags, StructureList};
use crate::description::model::{Interface, QuirkKind, Unknown};
use crate::description::variable::Variable;
use crate::error::FmiError;
use crate::value::VariableKind;

pub(super) fn parse(xml: &mut Xml<'_>, root: &Element<'_>, draft: &mut Draft) -> Result<(), FmiError> {
    shared::header(&Attributes::of(root)?, "guid", draft)?;
    while let Some(element) = xml.child(root.level)? {
        match element.name() {
            "ModelExchange" => draft.model.model_exchange = Some(interface(xml, &element, draft)?),
            "CoSimulation" => draft.model.co_simulation = Some(interface(xml, &element, draft)?),
            "UnitDefinitions" => shared::units(xml, &element, draft)?,
            "TypeDefinitions" => shared::scalar_types(xml, &element, draft)?,
            "LogCategories" => shared::log_categories(xml, &element, draft)?,
            "DefaultExperiment" => shared::default_experiment(&element, draft)?,
            "ModelVariables" => variables(xml, &element, draft)?,
            "ModelStructure" => structure(xml, &element, draft)?,
            _ => {}
        }
    }
    Ok(())
}

fn interface(xml: &mut Xml<'_>, element: &Element<'_>, draft: &mut Draft) -> Result<Interface, FmiError> {
    let attributes = Attributes::of(element)?;
    let model_identifier = shared::model_identifier(&attributes)?;
    let capabilities = shared::capabilities(&attributes, draft);
    let mut source_files = Vec::new();
    while let Some(child) = xml.child(element.level)? {
        if child.name() != "SourceFiles" {
            continue;
        }
        while let Some(file) = xml.child(child.level)? {
            if file.name() == "File" {
                let name = Attributes::of(&file)?.required("name")?.to_owned();
                draft.budget.take_text(&name);
                draft.budget.push(&mut source_files, name);
            }
        }
    }
    Ok(Interface { model_identifier, capabilities, source_files })
}

fn variables(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<(), FmiError> {
    while let Some(element) = xml.child(parent.level)? {
        if element.name() == "ScalarVariable" {
            let (variable, flags) = variable(xml, &element, draft)?;
            draft.add_variable(variable, flags);
        } else {
            // Positions in the list are what the model structure refers to: this one has none.
            let line = element.line;
            draft.quirks.add(QuirkKind::Element, line, || {
                format!("<{}> among the variables; ignored", element.name())
            });
        }
    }
    Ok(())
}

fn variable(
    xml: &mut Xml<'_>,
    element: &Element<'_>,
    draft: &mut Draft,
) -> Result<(Variable, Flags), FmiError> {
    let attributes = Attributes::of(element)?;
    let mut typed = None;
    while let Some(child) = xml.child(element.level)? {
        let Some(kind) = shared::scalar_kind(child.name()) else { continue };
        if typed.is_some() {
            draft.quirks.add(QuirkKind::Element, child.line, || {
                format!("a second type, <{}>, for one variable; ignored", child.name())
            });
            continue;
        }
        let mut variable = shared::plain_variable(&attributes, kind)?;
        let flags = value_attributes(&Attributes::of(&child)?, &mut variable, draft);
        typed = Some((variable, flags));
    }
    let Some((mut variable, flags)) = typed else {
        let name = attributes.get("name").unwrap_or_default();
        return Err(
            attributes.error(format!("variable \"{}\" has no type", super::attributes::shortened(name)))
        );
    };
    shared::roles(&attributes, &mut variable, draft);
    variable.can_handle_multiple_set_per_time_instant =
        attributes.boolean("canHandleMultipleSetPerTimeInstant", &mut draft.quirks).unwrap_or(true);
    Ok((variable, flags))
}

/// Parses the attributes of the element that names the type.
fn value_attributes(attributes: &Attributes<'_>, variable: &mut Variable, draft: &mut Draft) -> Flags {
    let quirks = &mut draft.quirks;
    variable.declared_type = attributes.text("declaredType");
    variable.start = attributes.start(variable.kind, false, quirks);
    if matches!(variable.kind, VariableKind::Boolean | VariableKind::String) {
        return Flags::default();
    }
    variable.quantity = attributes.text("quantity");
    variable.min = attributes.real("min", quirks);
    variable.max = attributes.real("max", quirks);
    if variable.kind != VariableKind::Real {
        return Flags::default();
    }
    variable.unit = attributes.text("unit");
    variable.display_unit = attributes.text("displayUnit");
    variable.nominal = attributes.real("nominal", quirks);
    variable.derivative = attributes.count("derivative", quirks).map(shared::position);
    variable.reinit = attributes.flag("reinit", quirks);
    let relative_quantity = attributes.boolean("relativeQuantity", quirks);
    let unbounded = attributes.boolean("unbounded", quirks);
    variable.relative_quantity = relative_quantity.unwrap_or(false);
    variable.unbounded = unbounded.unwrap_or(false);
    Flags { relative_quantity: relative_quantity.is_some(), unbounded: unbounded.is_some() }
}

fn structure(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<(), FmiError> {
    while let Some(element) = xml.child(parent.level)? {
        let list = match element.name() {
            "Outputs" => StructureList::Outputs,
            "Derivatives" => StructureList::Derivatives,
            "InitialUnknowns" => StructureList::InitialUnknowns,
            _ => continue,
        };
        while let Some(child) = xml.child(element.level)? {
            if child.name() == "Unknown" {
                let unknown = unknown(&Attributes::of(&child)?, draft)?;
                draft.add_unknown(list, unknown, child.line);
            }
        }
    }
    Ok(())
}

fn unknown(attributes: &Attributes<'_>, draft: &mut Draft) -> Result<Unknown, FmiError> {
    let quirks = &mut draft.quirks;
    let index = attributes.required("index")?;
    let index = index.trim().parse().map(shared::position).map_err(|_| {
        attributes.error(format!("index=\"{}\" is not a position", super::attributes::shortened(index)))
    })?;
    let dependencies = attributes.counts("dependencies", quirks);
    Ok(Unknown {
        index,
        dependencies: dependencies.map(|list| list.into_iter().map(shared::position).collect()),
        kinds: attributes.choices("dependenciesKind", shared::DEPENDENCY_KINDS, quirks).unwrap_or_default(),
    })
}
