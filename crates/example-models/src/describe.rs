//! Model descriptions of the bundled models for every version of the standard. They are generated from the
//! description next to the model's source (FMI 2.0 model exchange).

use crate::kind::ExampleKind;
use fmi::FmiError;
use fmi::description::{
    BaseUnit, Causality, DefaultExperiment, Initial, ModelDescription, Unknown, Value, Variability, Variable,
    VariableKind,
};
use std::fmt::Write;

/// Returns `modelDescription.xml` of a model in another form. `original` is the description for FMI 2.0 model
/// exchange.
pub(crate) fn description(original: &str, kind: ExampleKind) -> Result<String, FmiError> {
    Ok(match kind {
        ExampleKind::Fmi2ModelExchange => original.to_owned(),
        ExampleKind::Fmi2CoSimulation => as_co_simulation(original),
        ExampleKind::Fmi1ModelExchange => fmi1(&ModelDescription::parse(original.as_bytes())?, false),
        ExampleKind::Fmi1CoSimulation => fmi1(&ModelDescription::parse(original.as_bytes())?, true),
        ExampleKind::Fmi3 => fmi3(&ModelDescription::parse(original.as_bytes())?),
    })
}

/// Returns the description with the co-simulation interface.
fn as_co_simulation(original: &str) -> String {
    original
        .replace("<ModelExchange", "<CoSimulation\n    canHandleVariableCommunicationStepSize=\"true\"\n    canInterpolateInputs=\"true\"")
        .replace("</ModelExchange>", "</CoSimulation>")
        .replace("    completedIntegratorStepNotNeeded=\"true\"\n", "")
        .replace("fmi2_me.c", "fmi2_cs.c")
}

/// Attributes. Those without a value are omitted.
#[derive(Default)]
struct Attributes(String);

impl Attributes {
    fn text(mut self, name: &str, value: Option<&str>) -> Self {
        if let Some(value) = value {
            // Writing to a string does not fail.
            let _ = write!(self.0, " {name}=\"{}\"", escaped(value));
        }
        self
    }

    fn shown(self, name: &str, value: Option<impl ToString>) -> Self {
        let value = value.map(|value| value.to_string());
        self.text(name, value.as_deref())
    }

    fn number(self, name: &str, value: Option<f64>) -> Self {
        // {:?} writes the shortest decimal that parses to the same number.
        self.shown(name, value.map(|value| format!("{value:?}")))
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

fn start(variable: &Variable) -> Option<String> {
    variable.start.as_ref().map(|value| match value {
        Value::Real(x) => format!("{x:?}"),
        Value::Integer(i) => i.to_string(),
        Value::Boolean(b) => b.to_string(),
        Value::String(text) => text.clone(),
        // No bundled model has other types.
        other => other.to_string(),
    })
}

fn experiment(experiment: &DefaultExperiment) -> String {
    let attributes = Attributes::default()
        .number("startTime", experiment.start_time)
        .number("stopTime", experiment.stop_time)
        .number("tolerance", experiment.tolerance);
    format!("  <DefaultExperiment{}/>\n", attributes.0)
}

fn header(model: &ModelDescription) -> Attributes {
    Attributes::default()
        .text("modelName", Some(&model.model_name))
        .text("description", model.description.as_deref())
        .text("author", model.author.as_deref())
        .text("version", model.version.as_deref())
        .text("variableNamingConvention", Some("structured"))
}

fn identifier(model: &ModelDescription) -> Option<&str> {
    model.model_exchange.as_ref().map(|interface| interface.model_identifier.as_str())
}

/// Writes FMI 1.0: parameters are a variability, time is not a variable, and states are only a number.
fn fmi1(model: &ModelDescription, co_simulation: bool) -> String {
    let header = header(model)
        .text("modelIdentifier", identifier(model))
        .text("guid", Some(&model.guid))
        .shown("numberOfContinuousStates", Some(model.n_states()))
        .shown("numberOfEventIndicators", Some(model.n_event_indicators));
    let mut out = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<fmiModelDescription fmiVersion=\"1.0\"{}>\n",
        header.0
    );
    if !model.units.is_empty() {
        out.push_str("  <UnitDefinitions>\n");
        for unit in &model.units {
            let _ = writeln!(out, "    <BaseUnit unit=\"{}\"/>", escaped(&unit.name));
        }
        out.push_str("  </UnitDefinitions>\n");
    }
    out.push_str(&experiment(&model.default_experiment));
    out.push_str("  <ModelVariables>\n");
    for variable in model.variables.iter().filter(|v| v.causality != Causality::Independent) {
        let variability = match (variable.causality, variable.variability) {
            (Causality::Parameter | Causality::CalculatedParameter, _) => "parameter",
            (_, Variability::Constant) => "constant",
            (_, Variability::Continuous) => "continuous",
            _ => "discrete",
        };
        let causality = match variable.causality {
            Causality::Input => "input",
            Causality::Output => "output",
            _ => "internal",
        };
        let outer = Attributes::default()
            .text("name", Some(&variable.name))
            .shown("valueReference", Some(variable.value_reference))
            .text("description", variable.description.as_deref())
            .text("variability", Some(variability))
            .text("causality", Some(causality));
        let start = start(variable);
        // The start value of an input is neither a guess nor fixed.
        let fixed = start.is_some() && variable.causality != Causality::Input;
        let inner = Attributes::default()
            .text("unit", variable.unit.as_deref())
            .shown("min", bound(variable, variable.min))
            .shown("max", bound(variable, variable.max))
            .text("start", start.as_deref())
            .shown("fixed", fixed.then_some(variable.initial != Some(Initial::Approx)));
        let kind = variable.kind.name();
        let _ = writeln!(
            out,
            "    <ScalarVariable{}>\n      <{kind}{}/>\n    </ScalarVariable>",
            outer.0, inner.0
        );
    }
    out.push_str("  </ModelVariables>\n");
    if co_simulation {
        out.push_str(
            "  <Implementation>\n    <CoSimulation_StandAlone>\n      <Capabilities \
             canHandleVariableCommunicationStepSize=\"true\" canHandleEvents=\"true\" \
             canInterpolateInputs=\"true\"/>\n    </CoSimulation_StandAlone>\n  </Implementation>\n",
        );
    }
    out.push_str("</fmiModelDescription>\n");
    out
}

/// Formats a bound in the format of the variable's type. Booleans and strings have no bounds.
fn bound(variable: &Variable, value: Option<f64>) -> Option<String> {
    value.map(|value| match variable.kind {
        VariableKind::Real => format!("{value:?}"),
        _ => format!("{value}"),
    })
}

/// Writes FMI 3.0 with both interfaces. Value references replace positions, and event indicators are
/// variables.
fn fmi3(model: &ModelDescription) -> String {
    let header =
        header(model).text("license", model.license.as_deref()).text("instantiationToken", Some(&model.guid));
    let mut out = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<fmiModelDescription fmiVersion=\"3.0\"{}>\n",
        header.0
    );
    interfaces3(model, &mut out);
    units3(model, &mut out);
    out.push_str("  <LogCategories>\n");
    for category in &model.log_categories {
        let attributes = Attributes::default()
            .text("name", Some(&category.name))
            .text("description", category.description.as_deref());
        let _ = writeln!(out, "    <Category{}/>", attributes.0);
    }
    out.push_str("  </LogCategories>\n");
    out.push_str(&experiment(&model.default_experiment));
    out.push_str("  <ModelVariables>\n");
    for variable in &model.variables {
        variable3(model, variable, &mut out);
    }
    let indicators = || (0..model.n_event_indicators).map(|i| (i + 1, model.variables.len() + i));
    for (number, reference) in indicators() {
        let _ = writeln!(
            out,
            "    <Float64 name=\"eventIndicator{number}\" valueReference=\"{reference}\" causality=\"local\" \
             variability=\"continuous\" initial=\"calculated\"/>"
        );
    }
    out.push_str("  </ModelVariables>\n  <ModelStructure>\n");
    let structure = &model.structure;
    for (element, list) in [
        ("Output", &structure.outputs),
        ("ContinuousStateDerivative", &structure.derivatives),
        ("InitialUnknown", &structure.initial_unknowns),
    ] {
        for unknown in list {
            unknown3(model, element, unknown, &mut out);
        }
    }
    for (_, reference) in indicators() {
        let _ = writeln!(out, "    <EventIndicator valueReference=\"{reference}\"/>");
    }
    out.push_str("  </ModelStructure>\n</fmiModelDescription>\n");
    out
}

fn interfaces3(model: &ModelDescription, out: &mut String) {
    let capabilities =
        model.model_exchange.as_ref().map(|interface| interface.capabilities).unwrap_or_default();
    let common = Attributes::default()
        .text("modelIdentifier", identifier(model))
        .text("canGetAndSetFMUState", Some("true"))
        .text("canSerializeFMUState", Some("true"));
    let derivatives = Attributes::default().text(
        "providesDirectionalDerivatives",
        capabilities.provides_directional_derivative.then_some("true"),
    );
    let needs_steps = Attributes::default().text(
        "needsCompletedIntegratorStep",
        (!capabilities.completed_integrator_step_not_needed).then_some("true"),
    );
    let _ = writeln!(out, "  <ModelExchange{}{}{}/>", common.0, derivatives.0, needs_steps.0);
    let _ = writeln!(
        out,
        "  <CoSimulation{} canHandleVariableCommunicationStepSize=\"true\" mightReturnEarlyFromDoStep=\"true\" \
         canReturnEarlyAfterIntermediateUpdate=\"false\" hasEventMode=\"true\"/>",
        common.0
    );
}

fn units3(model: &ModelDescription, out: &mut String) {
    if model.units.is_empty() {
        return;
    }
    out.push_str("  <UnitDefinitions>\n");
    for unit in &model.units {
        let _ = writeln!(out, "    <Unit name=\"{}\">", escaped(&unit.name));
        if let Some(BaseUnit { kg, m, s, a, k, mol, cd, rad, factor, offset }) = unit.base {
            let mut attributes = Attributes::default();
            for (name, exponent) in
                [("kg", kg), ("m", m), ("s", s), ("A", a), ("K", k), ("mol", mol), ("cd", cd), ("rad", rad)]
            {
                attributes = attributes.shown(name, (exponent != 0).then_some(exponent));
            }
            let attributes = attributes
                .number("factor", (factor != 1.0).then_some(factor))
                .number("offset", (offset != 0.0).then_some(offset));
            let _ = writeln!(out, "      <BaseUnit{}/>", attributes.0);
        }
        for shown in &unit.display_units {
            let attributes = Attributes::default()
                .text("name", Some(&shown.name))
                .number("factor", Some(shown.factor))
                .number("offset", Some(shown.offset));
            let _ = writeln!(out, "      <DisplayUnit{}/>", attributes.0);
        }
        out.push_str("    </Unit>\n");
    }
    out.push_str("  </UnitDefinitions>\n");
}

fn variable3(model: &ModelDescription, variable: &Variable, out: &mut String) {
    let kind = match variable.kind {
        VariableKind::Real => "Float64",
        VariableKind::Integer => "Int32",
        other => other.name(),
    };
    let state = variable.derivative.map(|state| model.variables[state].value_reference);
    let is_real = variable.kind == VariableKind::Real;
    // Booleans and strings have no bounds, and `initial` of inputs and time is omitted.
    let initial = variable.initial.filter(|_| variable.causality != Causality::Input);
    let attributes = Attributes::default()
        .text("name", Some(&variable.name))
        .shown("valueReference", Some(variable.value_reference))
        .text("description", variable.description.as_deref())
        .shown("causality", Some(variable.causality))
        .shown("variability", Some(variable.variability))
        .shown("initial", initial)
        .text("unit", variable.unit.as_deref().filter(|_| is_real))
        .shown("min", bound(variable, variable.min))
        .shown("max", bound(variable, variable.max))
        .number("nominal", variable.nominal)
        .text("start", start(variable).as_deref())
        .shown("derivative", state)
        .text("reinit", variable.reinit.then_some("true"));
    let _ = writeln!(out, "    <{kind}{}/>", attributes.0);
}

fn unknown3(model: &ModelDescription, element: &str, unknown: &Unknown, out: &mut String) {
    let reference = |index: usize| model.variables[index].value_reference.to_string();
    let dependencies = unknown
        .dependencies
        .as_ref()
        .map(|list| list.iter().map(|index| reference(*index)).collect::<Vec<_>>().join(" "));
    let attributes = Attributes::default()
        .text("valueReference", Some(&reference(unknown.index)))
        .text("dependencies", dependencies.as_deref());
    let _ = writeln!(out, "    <{element}{}/>", attributes.0);
}

/// Returns `sources/buildDescription.xml`, which replaces the list of files in FMI 3.0.
pub(crate) fn build_description(identifier: &str, files: &[&str]) -> String {
    let files: String = files.iter().map(|file| format!("      <SourceFile name=\"{file}\"/>\n")).collect();
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<fmiBuildDescription fmiVersion=\"3.0\">\n  <BuildConfiguration \
         modelIdentifier=\"{identifier}\">\n    <SourceFileSet language=\"C99\">\n{files}    </SourceFileSet>\n  \
         </BuildConfiguration>\n</fmiBuildDescription>\n"
    )
}
