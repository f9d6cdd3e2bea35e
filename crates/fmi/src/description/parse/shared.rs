//! Parsers of elements that are common to several versions of the standard: header, units, log categories,
//! experiment, attributes of variables.

use super::attributes::Attributes;
use super::xml::{Element, Xml};
use crate::description::draft::{Draft, Flags, NOWHERE};
use crate::description::model::{Capabilities, LogCategory, QuirkKind};
use crate::description::unit::{BaseUnit, DisplayUnit, Unit};
use crate::description::variable::{
    Causality, EnumerationItem, Initial, TypeDefinition, Variability, Variable,
};
use crate::error::Result;
use crate::value::VariableKind;

/// Reads the attributes of the root element that all versions have.
pub(super) fn header(root: &Attributes<'_>, token: &str, draft: &mut Draft) -> Result<()> {
    let model = &mut draft.model;
    model.model_name = root.expected("modelName");
    model.guid = root.expected(token);
    model.description = root.text("description");
    model.author = root.text("author");
    model.version = root.text("version");
    model.copyright = root.text("copyright");
    model.license = root.text("license");
    model.generation_tool = root.text("generationTool");
    model.generation_date_and_time = root.text("generationDateAndTime");
    model.variable_naming_convention = root.text("variableNamingConvention");
    draft.model.n_event_indicators = root.length("numberOfEventIndicators")?.unwrap_or(0);
    Ok(())
}

/// Returns the model identifier of an interface. It is used in paths, so it must be a valid file name.
pub(super) fn model_identifier(attributes: &Attributes<'_>) -> Result<String> {
    let name = attributes.required("modelIdentifier")?;
    let refuse = |why: &str| {
        let shown = super::attributes::shortened(name);
        Err(attributes.error(format!("modelIdentifier=\"{}\" {why}", shown.escape_debug())))
    };
    if name.contains(['/', '\\', ':']) {
        return refuse("contains a path separator");
    }
    if name.is_empty() || name == "." || name == ".." || name.chars().any(char::is_control) {
        return refuse("is not a valid file name");
    }
    if name.len() > 200 {
        return refuse("is longer than 200 bytes");
    }
    Ok(name.to_owned())
}

/// Returns the capabilities of both interfaces and of all versions. The attribute names of FMI 2.0 and 3.0
/// differ slightly.
pub(super) fn capabilities(attributes: &Attributes<'_>) -> Capabilities {
    let flag = |names: &[&str]| names.iter().any(|name| attributes.flag(name));
    Capabilities {
        needs_execution_tool: flag(&["needsExecutionTool"]),
        completed_integrator_step_not_needed: flag(&["completedIntegratorStepNotNeeded"]),
        can_be_instantiated_only_once_per_process: flag(&["canBeInstantiatedOnlyOncePerProcess"]),
        can_not_use_memory_management_functions: flag(&["canNotUseMemoryManagementFunctions"]),
        can_get_and_set_state: flag(&["canGetAndSetFMUstate", "canGetAndSetFMUState"]),
        can_serialize_state: flag(&["canSerializeFMUstate", "canSerializeFMUState"]),
        provides_directional_derivative: flag(&[
            "providesDirectionalDerivative",
            "providesDirectionalDerivatives",
        ]),
        provides_adjoint_derivative: flag(&["providesAdjointDerivatives"]),
        can_handle_variable_communication_step_size: flag(&["canHandleVariableCommunicationStepSize"]),
        can_interpolate_inputs: flag(&["canInterpolateInputs"]),
        can_run_asynchronuously: flag(&["canRunAsynchronuously"]),
        has_event_mode: flag(&["hasEventMode"]),
        might_return_early_from_do_step: flag(&["mightReturnEarlyFromDoStep"]),
        provides_intermediate_update: flag(&["providesIntermediateUpdate"]),
        can_return_early_after_intermediate_update: flag(&["canReturnEarlyAfterIntermediateUpdate"]),
        fixed_internal_step_size: attributes
            .real("fixedInternalStepSize")
            .filter(|step| step.is_finite() && *step > 0.0),
        max_output_derivative_order: attributes.count("maxOutputDerivativeOrder").unwrap_or(0),
    }
}

/// Parses `<UnitDefinitions>` of FMI 2.0 and 3.0.
pub(super) fn units(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<()> {
    while let Some(element) = xml.named(parent.level, &["Unit"])? {
        let name = Attributes::of(&element)?.required("name")?.to_owned();
        let mut unit = Unit { name, base: None, display_units: Vec::new() };
        while let Some(child) = xml.child(element.level)? {
            let attributes = Attributes::of(&child)?;
            match child.name() {
                "BaseUnit" => unit.base = Some(base_unit(&attributes)),
                "DisplayUnit" => {
                    let shown = display_unit(&attributes)?;
                    draft.reading.take_text(&shown.name);
                    draft.reading.push(&mut unit.display_units, shown);
                }
                _ => {}
            }
        }
        draft.reading.take_text(&unit.name);
        draft.reading.push(&mut draft.model.units, unit);
    }
    Ok(())
}

fn base_unit(attributes: &Attributes<'_>) -> BaseUnit {
    let exponent = |name: &str| attributes.integer(name).unwrap_or(0);
    BaseUnit {
        kg: exponent("kg"),
        m: exponent("m"),
        s: exponent("s"),
        a: exponent("A"),
        k: exponent("K"),
        mol: exponent("mol"),
        cd: exponent("cd"),
        rad: exponent("rad"),
        factor: attributes.real("factor").unwrap_or(1.0),
        offset: attributes.real("offset").unwrap_or(0.0),
    }
}

fn display_unit(attributes: &Attributes<'_>) -> Result<DisplayUnit> {
    Ok(DisplayUnit {
        name: attributes.required("name")?.to_owned(),
        factor: attributes.real("factor").unwrap_or(1.0),
        offset: attributes.real("offset").unwrap_or(0.0),
        inverse: attributes.flag("inverse"),
    })
}

/// Parses `<LogCategories>` of FMI 2.0 and 3.0.
pub(super) fn log_categories(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<()> {
    while let Some(element) = xml.named(parent.level, &["Category"])? {
        let attributes = Attributes::of(&element)?;
        let name = attributes.expected("name");
        let category = LogCategory { name, description: attributes.text("description") };
        draft.reading.push(&mut draft.model.log_categories, category);
    }
    Ok(())
}

/// Parses `<DefaultExperiment>` of all versions.
pub(super) fn default_experiment(element: &Element<'_>, draft: &mut Draft) -> Result<()> {
    let attributes = Attributes::of(element)?;
    let experiment = &mut draft.model.default_experiment;
    experiment.start_time = attributes.real("startTime");
    experiment.stop_time = attributes.real("stopTime");
    experiment.tolerance = attributes.real("tolerance");
    experiment.step_size = attributes.real("stepSize");
    Ok(())
}

/// Returns the items of an enumeration: name, value and description of each `<Item>`.
pub(super) fn items(
    xml: &mut Xml<'_>,
    parent: &Element<'_>,
    draft: &mut Draft,
) -> Result<Vec<EnumerationItem>> {
    let mut items = Vec::new();
    while let Some(element) = xml.named(parent.level, &["Item"])? {
        let attributes = Attributes::of(&element)?;
        let next = items.len() as i64 + 1;
        let item = EnumerationItem {
            name: attributes.expected("name"),
            value: attributes.wide_integer("value").unwrap_or(next),
            description: attributes.text("description"),
        };
        draft.reading.push(&mut items, item);
    }
    Ok(items)
}

/// Returns a type definition with the attributes that describe its values, without enumeration items.
pub(super) fn type_definition(
    name: String,
    description: Option<String>,
    kind: VariableKind,
    attributes: &Attributes<'_>,
) -> TypeDefinition {
    TypeDefinition {
        name,
        description,
        kind,
        quantity: attributes.text("quantity"),
        unit: attributes.text("unit"),
        display_unit: attributes.text("displayUnit"),
        relative_quantity: attributes.flag("relativeQuantity"),
        unbounded: attributes.flag("unbounded"),
        min: attributes.real("min"),
        max: attributes.real("max"),
        nominal: attributes.real("nominal"),
        items: Vec::new(),
    }
}

/// Returns the kind of variable for an element of FMI 1.0 or 2.0, for example `<Real>`. Type definitions of
/// FMI 1.0 use names such as `<RealType>`.
pub(super) fn scalar_kind(element: &str) -> Option<VariableKind> {
    match element.strip_suffix("Type").unwrap_or(element) {
        "Real" => Some(VariableKind::Real),
        "Integer" => Some(VariableKind::Integer),
        "Boolean" => Some(VariableKind::Boolean),
        "String" => Some(VariableKind::String),
        "Enumeration" => Some(VariableKind::Enumeration),
        _ => None,
    }
}

/// Parses `<TypeDefinitions>` of FMI 1.0 (elements `<Type>`) and 2.0 (`<SimpleType>`).
pub(super) fn scalar_types(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<()> {
    while let Some(element) = xml.named(parent.level, &["Type", "SimpleType"])? {
        let outer = Attributes::of(&element)?;
        let name = outer.required_text("name")?;
        let mut definition = None;
        while let Some(child) = xml.child(element.level)? {
            let Some(kind) = scalar_kind(child.name()) else { continue };
            let (name, attributes) = (name.clone(), Attributes::of(&child)?);
            let mut found = type_definition(name, outer.text("description"), kind, &attributes);
            if kind == VariableKind::Enumeration {
                found.items = items(xml, &child, draft)?;
            }
            definition = Some(found);
        }
        match definition {
            Some(definition) => draft.reading.push(&mut draft.model.type_definitions, definition),
            None => draft.reading.quirk(QuirkKind::Missing, element.line, || {
                format!("type \"{name}\" has no base type; ignored")
            }),
        }
    }
    Ok(())
}

/// Returns a variable with its name and reference. All other fields have their defaults.
pub(super) fn plain_variable(attributes: &Attributes<'_>, kind: VariableKind) -> Result<Variable> {
    Ok(Variable {
        name: attributes.required_text("name")?,
        value_reference: attributes.value_reference()?,
        description: attributes.text("description"),
        kind,
        can_handle_multiple_set_per_time_instant: true,
        line: attributes.line,
        ..Variable::default()
    })
}

/// Reads the attributes of a value that all versions have.
pub(super) fn value_attributes(attributes: &Attributes<'_>, variable: &mut Variable) -> Flags {
    variable.declared_type = attributes.text("declaredType");
    variable.quantity = attributes.text("quantity");
    variable.unit = attributes.text("unit");
    variable.display_unit = attributes.text("displayUnit");
    variable.min = attributes.real("min");
    variable.max = attributes.real("max");
    variable.nominal = attributes.real("nominal");
    variable.reinit = attributes.flag("reinit");
    let relative_quantity = attributes.boolean("relativeQuantity");
    let unbounded = attributes.boolean("unbounded");
    variable.relative_quantity = relative_quantity.unwrap_or(false);
    variable.unbounded = unbounded.unwrap_or(false);
    Flags { relative_quantity: relative_quantity.is_some(), unbounded: unbounded.is_some() }
}

/// Reads causality, variability and initial, or uses the standard's defaults. Also reads whether the variable
/// may be set several times at one instant.
pub(super) fn roles(attributes: &Attributes<'_>, variable: &mut Variable) {
    variable.causality = attributes.choice("causality", Causality::WORDS).unwrap_or(Causality::Local);
    variable.variability = match attributes.choice("variability", Variability::WORDS) {
        // The schema's default is valid for floating-point variables. All other variables cannot be
        // continuous.
        Some(Variability::Continuous) if !variable.kind.is_float() => {
            attributes.quirk(QuirkKind::Combination, || {
                format!("{} \"{}\" is continuous; treated as discrete", variable.kind, variable.name)
            });
            Variability::Discrete
        }
        Some(given) => given,
        None => Variability::default_for(variable.causality, variable.kind),
    };
    variable.initial = attributes
        .choice("initial", Initial::WORDS)
        .or_else(|| Initial::default_for(variable.causality, variable.variability));
    variable.can_handle_multiple_set_per_time_instant =
        attributes.boolean("canHandleMultipleSetPerTimeInstant").unwrap_or(true);
}

/// Converts a position counted from 1 to an index counted from 0.
pub(super) fn position(one_based: u32) -> usize {
    (one_based as usize).checked_sub(1).unwrap_or(NOWHERE)
}
