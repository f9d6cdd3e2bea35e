//! Model descriptions of FMI 2.0 (specification 2.0.4, chapter 2.2 and the ME and CS parts of 3.3 and 4.3).

use super::attributes::Attributes;
use super::shared;
use super::xml::{Element, Xml};
use crate::description::draft::{Draft, Flags, StructureList};
use crate::description::model::{DependencyKind, Interface, QuirkKind, Unknown};
use crate::description::variable::Variable;
use crate::error::Result;

pub(super) fn parse(xml: &mut Xml<'_>, root: &Element<'_>, draft: &mut Draft) -> Result<()> {
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

fn interface(xml: &mut Xml<'_>, element: &Element<'_>, draft: &mut Draft) -> Result<Interface> {
    let attributes = Attributes::of(element)?;
    let model_identifier = shared::model_identifier(&attributes)?;
    let capabilities = shared::capabilities(&attributes);
    let mut source_files = Vec::new();
    while let Some(child) = xml.named(element.level, &["SourceFiles"])? {
        while let Some(file) = xml.named(child.level, &["File"])? {
            let name = Attributes::of(&file)?.required("name")?.to_owned();
            draft.reading.take_text(&name);
            draft.reading.push(&mut source_files, name);
        }
    }
    Ok(Interface { model_identifier, capabilities, source_files })
}

fn variables(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<()> {
    while let Some(element) = xml.child(parent.level)? {
        if element.name() == "ScalarVariable" {
            let (variable, flags) = variable(xml, &element, draft)?;
            draft.add_variable(variable, flags);
        } else {
            // The model structure refers to indices in this list. Unknown elements do not count.
            let line = element.line;
            draft.reading.quirk(QuirkKind::Element, line, || {
                format!("unexpected element <{}> among the variables; ignored", element.name())
            });
        }
    }
    Ok(())
}

fn variable(xml: &mut Xml<'_>, element: &Element<'_>, draft: &mut Draft) -> Result<(Variable, Flags)> {
    let attributes = Attributes::of(element)?;
    let mut typed = None;
    while let Some(child) = xml.child(element.level)? {
        let Some(kind) = shared::scalar_kind(child.name()) else { continue };
        if typed.is_some() {
            draft.reading.quirk(QuirkKind::Element, child.line, || {
                format!("the variable has a second type <{}>; ignored", child.name())
            });
            continue;
        }
        let mut variable = shared::plain_variable(&attributes, kind)?;
        let values = Attributes::of(&child)?;
        let flags = shared::value_attributes(&values, &mut variable);
        variable.start = values.start(kind, false);
        variable.derivative = values.count("derivative").map(shared::position);
        typed = Some((variable, flags));
    }
    let Some((mut variable, flags)) = typed else {
        let name = attributes.get("name").unwrap_or_default();
        return Err(
            attributes.error(format!("variable \"{}\" has no type", super::attributes::shortened(name)))
        );
    };
    shared::roles(&attributes, &mut variable);
    Ok((variable, flags))
}

fn structure(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<()> {
    while let Some(element) = xml.child(parent.level)? {
        let list = match element.name() {
            "Outputs" => StructureList::Outputs,
            "Derivatives" => StructureList::Derivatives,
            "InitialUnknowns" => StructureList::InitialUnknowns,
            _ => continue,
        };
        while let Some(child) = xml.named(element.level, &["Unknown"])? {
            let unknown = unknown(&Attributes::of(&child)?)?;
            draft.add_unknown(list, unknown, child.line);
        }
    }
    Ok(())
}

fn unknown(attributes: &Attributes<'_>) -> Result<Unknown> {
    let index = attributes.required("index")?;
    let index = index.trim().parse().map(shared::position).map_err(|_| {
        attributes.error(format!("index=\"{}\" is not a valid index", super::attributes::shortened(index)))
    })?;
    let dependencies = attributes.counts("dependencies");
    Ok(Unknown {
        index,
        dependencies: dependencies.map(|list| list.into_iter().map(shared::position).collect()),
        kinds: attributes.choices("dependenciesKind", DependencyKind::WORDS).unwrap_or_default(),
    })
}
