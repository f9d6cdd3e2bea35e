//! Parsers of the elements that the versions of the standard have in common: header, units, log categories,
//! experiment, words.

use super::attributes::Attributes;
use super::xml::{Element, Xml};
use crate::description::draft::{Draft, NOWHERE};
use crate::description::model::{Capabilities, DependencyKind, LogCategory, QuirkKind};
use crate::description::unit::{BaseUnit, DisplayUnit, Unit};
use crate::description::variable::{
    Causality, EnumerationItem, Initial, TypeDefinition, Variability, Variable,
};
use crate::error::FmiError;
use crate::value::VariableKind;

pub(super) const DEPENDENCY_KINDS: &[(&str, DependencyKind)] = &[
    ("dependent", DependencyKind::Dependent),
    ("constant", DependencyKind::Constant),
    ("fixed", DependencyKind::Fixed),
    ("tunable", DependencyKind::Tunable),
    ("discrete", DependencyKind::Discrete),
];

/// Attributes of the root element except those only one version has.
pub(super) fn header(root: &Attributes<'_>, token: &str, draft: &mut Draft) -> Result<(), FmiError> {
    let (model, quirks) = (&mut draft.model, &mut draft.quirks);
    model.model_name = root.expected("modelName", quirks);
    model.guid = root.expected(token, quirks);
    model.description = root.text("description");
    model.author = root.text("author");
    model.version = root.text("version");
    model.copyright = root.text("copyright");
    model.license = root.text("license");
    model.generation_tool = root.text("generationTool");
    model.generation_date_and_time = root.text("generationDateAndTime");
    model.variable_naming_convention = root.text("variableNamingConvention");
    draft.model.n_event_indicators = array_length(root, "numberOfEventIndicators", draft)?.unwrap_or(0);
    Ok(())
}

/// An attribute that is the length of an array.
pub(super) fn array_length(
    attributes: &Attributes<'_>,
    name: &str,
    draft: &mut Draft,
) -> Result<Option<usize>, FmiError> {
    let limit = draft.budget.limits.elements;
    match attributes.count(name, &mut draft.quirks).map(|count| count as usize) {
        Some(count) if count > limit => Err(attributes.error(format!(
            "{name}=\"{count}\", more than the limit of {limit} elements (DescriptionLimits::elements)"
        ))),
        count => Ok(count),
    }
}

/// The model identifier of an interface. It becomes part of paths, so it must be the name of a file.
pub(super) fn model_identifier(attributes: &Attributes<'_>) -> Result<String, FmiError> {
    let name = attributes.required("modelIdentifier")?;
    let refuse = |why: &str| {
        let shown = super::attributes::shortened(name);
        Err(attributes.error(format!("modelIdentifier=\"{}\" {why}", shown.escape_debug())))
    };
    if name.contains(['/', '\\', ':']) {
        return refuse("has a path separator in it");
    }
    if name.is_empty() || name == "." || name == ".." || name.chars().any(char::is_control) {
        return refuse("is not the name of a file");
    }
    if name.len() > 200 {
        return refuse("is longer than 200 bytes");
    }
    Ok(name.to_owned())
}

/// Capabilities common to both interfaces and to FMI 2.0 and 3.0, whose names differ in a suffix.
pub(super) fn capabilities(attributes: &Attributes<'_>, draft: &mut Draft) -> Capabilities {
    let quirks = &mut draft.quirks;
    let mut flag = |names: &[&str]| names.iter().any(|name| attributes.flag(name, quirks));
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
            .real("fixedInternalStepSize", quirks)
            .filter(|step| step.is_finite() && *step > 0.0),
        max_output_derivative_order: attributes.count("maxOutputDerivativeOrder", quirks).unwrap_or(0),
    }
}

/// `<UnitDefinitions>` of FMI 2.0 and 3.0.
pub(super) fn units(xml: &mut Xml<'_>, parent: &Element<'_>, draft: &mut Draft) -> Result<(), FmiError> {
    while let Some(element) = xml.child(parent.level)? {
        if element.name() != "Unit" {
            continue;
        }
        let name = Attributes::of(&element)?.required("name")?.to_owned();
        let mut unit = Unit { name, base: None, display_units: Vec::new() };
        while let Some(child) = xml.child(element.level)? {
            let attributes = Attributes::of(&child)?;
            match child.name() {
                "BaseUnit" => unit.base = Some(base_unit(&attributes, draft)),
                "DisplayUnit" => {
                    let shown = display_unit(&attributes, draft)?;
                    draft.budget.take_text(&shown.name);
                    draft.budget.push(&mut unit.display_units, shown);
                }
                _ => {}
            }
        }
        draft.budget.take_text(&unit.name);
        draft.budget.push(&mut draft.model.units, unit);
    }
    Ok(())
}

fn base_unit(attributes: &Attributes<'_>, draft: &mut Draft) -> BaseUnit {
    let quirks = &mut draft.quirks;
    let mut exponent = |name: &str| attributes.integer(name, quirks).unwrap_or(0);
    BaseUnit {
        kg: exponent("kg"),
        m: exponent("m"),
        s: exponent("s"),
        a: exponent("A"),
        k: exponent("K"),
        mol: exponent("mol"),
        cd: exponent("cd"),
        rad: exponent("rad"),
        factor: attributes.real("factor", quirks).unwrap_or(1.0),
        offset: attributes.real("offset", quirks).unwrap_or(0.0),
    }
}

fn display_unit(attributes: &Attributes<'_>, draft: &mut Draft) -> Result<DisplayUnit, FmiError> {
    let quirks = &mut draft.quirks;
    Ok(DisplayUnit {
        name: attributes.required("name")?.to_owned(),
        factor: attributes.real("factor", quirks).unwrap_or(1.0),
        offset: attributes.real("offset", quirks).unwrap_or(0.0),
        inverse: attributes.flag("inverse", quirks),
    })
}

/// `<LogCategories>` of FMI 2.0 and 3.0.
pub(super) fn log_categories(
    xml: &mut Xml<'_>,
    parent: &Element<'_>,
    draft: &mut Draft,
) -> Result<(), FmiError> {
    while let Some(element) = xml.child(parent.level)? {
        if element.name() == "Category" {
            let attributes = Attributes::of(&element)?;
            let name = attributes.expected("name", &mut draft.quirks);
            let category = LogCategory { name, description: attributes.text("description") };
            draft.budget.push(&mut draft.model.log_categories, category);
        }
    }
    Ok(())
}

/// `<DefaultExperiment>` of all versions.
pub(super) fn default_experiment(element: &Element<'_>, draft: &mut Draft) -> Result<(), FmiError> {
    let attributes = Attributes::of(element)?;
    let (experiment, quirks) = (&mut draft.model.default_experiment, &mut draft.quirks);
    experiment.start_time = attributes.real("startTime", quirks);
    experiment.stop_time = attributes.real("stopTime", quirks);
    experiment.tolerance = attributes.real("tolerance", quirks);
    experiment.step_size = attributes.real("stepSize", quirks);
    Ok(())
}

/// The items of an enumeration: name, value and description of each `<Item>`.
pub(super) fn items(
    xml: &mut Xml<'_>,
    parent: &Element<'_>,
    draft: &mut Draft,
) -> Result<Vec<EnumerationItem>, FmiError> {
    let mut items = Vec::new();
    while let Some(element) = xml.child(parent.level)? {
        if element.name() != "Item" {
            continue;
        }
        let attributes = Attributes::of(&element)?;
        let next = items.len() as i64 + 1;
        let item = EnumerationItem {
            name: attributes.expected("name", &mut draft.quirks),
            value: attributes.wide_integer("value", &mut draft.quirks).unwrap_or(next),
            description: attributes.text("description"),
        };
        draft.budget.push(&mut items, item);
    }
    Ok(items)
}

/// A type with the attributes that say what values it has; without items.
pub(super) fn type_definition(
    name: String,
    description: Option<String>,
    kind: VariableKind,
    attributes: &Attributes<'_>,
    draft: &mut Draft,
) -> TypeDefinition {
    let quirks = &mut draft.quirks;
    TypeDefinition {
        name,
        description,
        kind,
        quantity: attributes.text("quantity"),
        unit: attributes.text("unit"),
        display_unit: attributes.text("displayUnit"),
        relative_quantity: attributes.flag("relativeQuantity", quirks),
        unbounded: attributes.flag("unbounded", quirks),
        min: attributes.real("min", quirks),
        max: attributes.real("max", quirks),
        nominal: attributes.real("nominal", quirks),
        items: Vec::new(),
    }
}

/// The type of variables behind an element of FMI 1.0 or 2.0: `<Real>`; `<RealType>` in the type definitions
/// of FMI 1.0.
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

/// `<TypeDefinitions>` of FMI 1.0 (elements `<Type>`) and 2.0 (`<SimpleType>`).
pub(super) fn scalar_types(
    xml: &mut Xml<'_>,
    parent: &Element<'_>,
    draft: &mut Draft,
) -> Result<(), FmiError> {
    while let Some(element) = xml.child(parent.level)? {
        if !matches!(element.name(), "Type" | "SimpleType") {
            continue;
        }
        let outer = Attributes::of(&element)?;
        let name = outer.required_text("name")?;
        let mut definition = None;
        while let Some(child) = xml.child(element.level)? {
            let Some(kind) = scalar_kind(child.name()) else { continue };
            let (name, attributes) = (name.clone(), Attributes::of(&child)?);
            let mut found = type_definition(name, outer.text("description"), kind, &attributes, draft);
            if kind == VariableKind::Enumeration {
                found.items = items(xml, &child, draft)?;
            }
            definition = Some(found);
        }
        match definition {
            Some(definition) => draft.budget.push(&mut draft.model.type_definitions, definition),
            None => draft.quirks.add(QuirkKind::Missing, element.line, || {
                format!("type \"{name}\" does not say what it is; left out")
            }),
        }
    }
    Ok(())
}

/// A variable with its name and reference, everything else at the defaults.
pub(super) fn plain_variable(attributes: &Attributes<'_>, kind: VariableKind) -> Result<Variable, FmiError> {
    Ok(Variable {
        name: attributes.required_text("name")?,
        value_reference: attributes.value_reference()?,
        description: attributes.text("description"),
        kind,
        causality: Causality::Local,
        variability: Variability::Continuous,
        initial: None,
        can_handle_multiple_set_per_time_instant: true,
        line: attributes.line,
        declared_type: None,
        quantity: None,
        unit: None,
        display_unit: None,
        relative_quantity: false,
        unbounded: false,
        min: None,
        max: None,
        nominal: None,
        start: None,
        derivative: None,
        reinit: false,
        is_narrow: false,
        negated: false,
        dimensions: Vec::new(),
        aliases: Vec::new(),
        clocks: Vec::new(),
        clock: None,
        intermediate_update: false,
        max_size: None,
    })
}

/// Causality, variability and initial as given, else as the standard fills them in.
pub(super) fn roles(attributes: &Attributes<'_>, variable: &mut Variable, draft: &mut Draft) {
    let quirks = &mut draft.quirks;
    variable.causality = attributes.choice("causality", Causality::WORDS, quirks).unwrap_or(Causality::Local);
    variable.variability = match attributes.choice("variability", Variability::WORDS, quirks) {
        // The schema's default fits Real variables; everything else cannot be continuous.
        Some(Variability::Continuous) if !variable.kind.is_float() => {
            quirks.add(QuirkKind::Combination, attributes.line, || {
                format!("{} \"{}\" is continuous; taken as discrete", variable.kind, variable.name)
            });
            Variability::Discrete
        }
        Some(given) => given,
        None => Variability::default_for(variable.causality, variable.kind),
    };
    variable.initial = attributes
        .choice("initial", Initial::WORDS, quirks)
        .or_else(|| Initial::default_for(variable.causality, variable.variability));
}

/// Turns a position counted from 1 into one counted from 0.
pub(super) fn position(one_based: u32) -> usize {
    (one_based as usize).checked_sub(1).unwrap_or(NOWHERE)
}
