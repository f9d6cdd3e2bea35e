//! Model descriptions of FMI 1.0: header, units, variables and experiment. The model structure stays empty,
//! because FMI 1.0 files do not specify the state variables.

use super::attributes::Attributes;
use super::shared;
use super::xml::{Element, Xml};
use crate::description::draft::Draft;
use crate::description::model::{Capabilities, Interface};
use crate::description::unit::{DisplayUnit, Unit};
use crate::description::variable::{Causality, Initial, Variability, Variable};
use crate::error::Result;
use crate::value::VariableKind;

pub(super) fn parse(xml: &mut Xml<'_>, root: &Element<'_>, draft: &mut Draft) -> Result<()> {
    let attributes = Attributes::of(root)?;
    shared::header(&attributes, "guid", draft)?;
    draft.model.declared_states = attributes.length("numberOfContinuousStates")?;
    let mut interface =
        Interface { model_identifier: shared::model_identifier(&attributes)?, ..Interface::default() };
    let mut is_co_simulation = false;
    while let Some(element) = xml.child(root.level)? {
        match element.name() {
            "UnitDefinitions" => units(xml, &element, draft)?,
            "TypeDefinitions" => shared::scalar_types(xml, &element, draft)?,
            "DefaultExperiment" => shared::default_experiment(&element, draft)?,
            "ModelVariables" => variables(xml, &element, draft)?,
            "Implementation" => {
                is_co_simulation = true;
                interface.capabilities = implementation(xml, &element)?;
            }
            _ => {}
        }
    }
    let model = &mut draft.model;
    *(if is_co_simulation { &mut model.co_simulation } else { &mut model.model_exchange }) = Some(interface);
    Ok(())
}

/// Parses `<CoSimulation_StandAlone>` or `<CoSimulation_Tool>` with the nested `<Capabilities>`.
fn implementation(xml: &mut Xml<'_>, parent: &Element<'_>) -> Result<Capabilities> {
    let mut capabilities = Capabilities::default();
    while let Some(element) = xml.child(parent.level)? {
        let needs_tool = element.name() == "CoSimulation_Tool";
        while let Some(child) = xml.named(element.level, &["Capabilities"])? {
            capabilities = shared::capabilities(&Attributes::of(&child)?);
        }
        capabilities.needs_execution_tool = needs_tool;
    }
    Ok(capabilities)
}

/// Parses `<BaseUnit unit="rad/s"><DisplayUnitDefinition displayUnit="rpm" gain="9.55"/></BaseUnit>`.
fn units(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<()> {
    while let Some(element) = xml.named(parent.level, &["BaseUnit"])? {
        let name = Attributes::of(&element)?.required("unit")?.to_owned();
        let mut display_units = Vec::new();
        while let Some(child) = xml.named(element.level, &["DisplayUnitDefinition"])? {
            let attributes = Attributes::of(&child)?;
            draft.reading.take_text(attributes.get("displayUnit").unwrap_or_default());
            let display_unit = DisplayUnit {
                name: attributes.required("displayUnit")?.to_owned(),
                factor: attributes.real("gain").unwrap_or(1.0),
                offset: attributes.real("offset").unwrap_or(0.0),
                inverse: false,
            };
            draft.reading.push(&mut display_units, display_unit);
        }
        draft.reading.push(&mut draft.model.units, Unit { name, base: None, display_units });
    }
    Ok(())
}

fn variables(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<()> {
    while let Some(element) = xml.named(parent.level, &["ScalarVariable"])? {
        let attributes = Attributes::of(&element)?;
        let mut typed = None;
        while let Some(child) = xml.child(element.level)? {
            if let Some(kind) = shared::scalar_kind(child.name()) {
                let mut variable = shared::plain_variable(&attributes, kind)?;
                let values = Attributes::of(&child)?;
                let flags = shared::value_attributes(&values, &mut variable);
                variable.start = values.start(variable.kind, false);
                let fixed = values.boolean("fixed").unwrap_or(true);
                typed = Some((variable, flags, fixed));
            }
        }
        let Some((mut variable, flags, fixed)) = typed else {
            return Err(attributes.error("the variable has no type".to_owned()));
        };
        roles(&attributes, &mut variable, fixed);
        draft.add_variable(variable, flags);
    }
    Ok(())
}

/// Sets causality, variability and initial. In FMI 1.0 "parameter" is a variability, and there is no
/// `initial` (specification 1.0, chapter 3.1).
fn roles(attributes: &Attributes<'_>, variable: &mut Variable, fixed: bool) {
    let causalities = [
        ("input", Causality::Input),
        ("output", Causality::Output),
        ("internal", Causality::Local),
        ("none", Causality::Local),
    ];
    let variabilities = [
        ("constant", Variability::Constant),
        ("parameter", Variability::Fixed),
        ("discrete", Variability::Discrete),
        ("continuous", Variability::Continuous),
    ];
    variable.causality = attributes.choice("causality", &causalities).unwrap_or(Causality::Local);
    variable.variability = attributes
        .choice("variability", &variabilities)
        .filter(|&given| given != Variability::Continuous || variable.kind == VariableKind::Real)
        .unwrap_or_else(|| Variability::default_for(variable.causality, variable.kind));
    if variable.variability == Variability::Fixed && variable.causality == Causality::Local {
        let computed = variable.start.is_none();
        variable.causality = if computed { Causality::CalculatedParameter } else { Causality::Parameter };
    }
    variable.initial = match (variable.causality, &variable.start) {
        (Causality::Input, _) => None,
        (_, Some(_)) if fixed => Some(Initial::Exact),
        (_, Some(_)) => Some(Initial::Approx),
        (_, None) => Some(Initial::Calculated),
    };
    // The start value in the file belongs to the alias. The model's value has the opposite sign.
    variable.negated =
        attributes.get("alias") == Some("negatedAlias") && variable.kind != VariableKind::String;
}
