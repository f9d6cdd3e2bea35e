//! Model descriptions: valid documents are read, common deviations are tolerated and reported, and malicious
//! documents are rejected with the line.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use crate::promises;

use fmi::description::{
    BaseUnit, Causality, DependencyKind, Dimension, Initial, ModelDescription, QuirkKind, Variability,
    VariableKind,
};
use fmi::{FmiError, Value};
use proptest::prelude::*;

/// A description that uses nearly all features of FMI 2.0, without quirks.
const FULL: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" fmiVersion="2.0" modelName="Full &amp; good"
  guid="{8c4e810f-3df3-4a00-8276-176fa3c9f013}" description="d" author="a" version="1.2" copyright="c" license="l"
  generationTool="by hand" generationDateAndTime="2012-09-01T12:00:00Z" variableNamingConvention="structured"
  numberOfEventIndicators="2">
  <ModelExchange modelIdentifier="full_me" needsExecutionTool="false" completedIntegratorStepNotNeeded="true"
    canBeInstantiatedOnlyOncePerProcess="1" canNotUseMemoryManagementFunctions="true" canGetAndSetFMUstate="true"
    canSerializeFMUstate="true" providesDirectionalDerivative="true">
    <SourceFiles><File name="all.c"/><File name="sub/more.c"/></SourceFiles>
  </ModelExchange>
  <CoSimulation modelIdentifier="full_cs" canHandleVariableCommunicationStepSize="true" canInterpolateInputs="true"
    maxOutputDerivativeOrder="3" canRunAsynchronuously="true"/>
  <UnitDefinitions>
    <Unit name="rad/s"><BaseUnit s="-1" rad="1"/><DisplayUnit name="rpm" factor="9.549296585513721"/></Unit>
    <Unit name="degC"><BaseUnit K="1" offset="273.15"/><DisplayUnit name="degF" factor="1.8" offset="32"/></Unit>
    <Unit name="N"><BaseUnit kg="1" m="1" s="-2" factor="1"/></Unit>
    <Unit name="odd"><BaseUnit A="1" mol="2" cd="3" factor="1e3"/></Unit>
  </UnitDefinitions>
  <TypeDefinitions>
    <SimpleType name="Speed" description="how fast">
      <Real quantity="AngularVelocity" unit="rad/s" displayUnit="rpm" relativeQuantity="true" min="-1e3" max="1000" nominal="10" unbounded="true"/>
    </SimpleType>
    <SimpleType name="Gear">
      <Enumeration quantity="q"><Item name="reverse" value="-1" description="back"/><Item name="first" value="1"/></Enumeration>
    </SimpleType>
    <SimpleType name="Flag"><Boolean/></SimpleType>
    <SimpleType name="Count"><Integer min="0" max="9"/></SimpleType>
    <SimpleType name="Text"><String/></SimpleType>
  </TypeDefinitions>
  <LogCategories><Category name="logEvents" description="e"/><Category name="logAll"/></LogCategories>
  <DefaultExperiment startTime="0.5" stopTime="1e1" tolerance="1E-6" stepSize=".25"/>
  <VendorAnnotations><Tool name="x"><anything><goes deep="1"/></anything></Tool></VendorAnnotations>
  <ModelVariables>
    <ScalarVariable name="time" valueReference="0" causality="independent" variability="continuous"><Real/></ScalarVariable>
    <ScalarVariable name="w" valueReference="1" description="speed" causality="output" variability="continuous" initial="exact"
      canHandleMultipleSetPerTimeInstant="false">
      <Annotations><Tool name="x"><Real start="9"/></Tool></Annotations>
      <Real declaredType="Speed" start="-3.5" reinit="true" unbounded="false"/>
    </ScalarVariable>
    <ScalarVariable name="der(w)" valueReference="2"><Real derivative="2"/></ScalarVariable>
    <ScalarVariable name="k" valueReference="3" causality="parameter" variability="tunable"><Real declaredType="Speed" max="5" start="1"/></ScalarVariable>
    <ScalarVariable name="k2" valueReference="4" causality="calculatedParameter" variability="fixed"><Real/></ScalarVariable>
    <ScalarVariable name="u" valueReference="5" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="n" valueReference="1" causality="input" variability="discrete"><Integer declaredType="Count" start="7"/></ScalarVariable>
    <ScalarVariable name="gear" valueReference="2" variability="discrete" initial="exact"><Enumeration declaredType="Gear" start="-1"/></ScalarVariable>
    <ScalarVariable name="on" valueReference="1" variability="discrete" initial="approx"><Boolean declaredType="Flag" start="true"/></ScalarVariable>
    <ScalarVariable name="name with &quot;quotes&quot; [1,2]" valueReference="0" causality="parameter" variability="fixed"><String declaredType="Text" start="&lt;t&#228;xt&gt;"/></ScalarVariable>
    <ScalarVariable name="c" valueReference="9" causality="local" variability="constant"><Real start="2"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="2" dependencies="" dependenciesKind=""/></Outputs>
    <Derivatives><Unknown index="3" dependencies="2 4 6" dependenciesKind="dependent fixed constant"/></Derivatives>
    <InitialUnknowns><Unknown index="3"/><Unknown index="5" dependencies="4"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"#;

fn parse(text: &str) -> ModelDescription {
    ModelDescription::parse(text.as_bytes()).unwrap()
}

fn refusal(text: &str) -> String {
    ModelDescription::parse(text.as_bytes()).expect_err("must be refused").to_string()
}

/// Returns a description of FMI 2.0 with these variables and this structure.
fn document(variables: &str, structure: &str) -> String {
    format!(
        "<fmiModelDescription fmiVersion=\"2.0\" modelName=\"m\" guid=\"g\"><ModelExchange modelIdentifier=\"m\"/>\n\
         <ModelVariables>\n{variables}\n</ModelVariables>\n<ModelStructure>\n{structure}\n</ModelStructure></fmiModelDescription>"
    )
}

/// Returns the quirks of a description with one variable, given its attributes and its type element.
fn quirks_of(attributes: &str, kind: &str) -> Vec<(QuirkKind, String)> {
    let text = document(
        &format!("<ScalarVariable name=\"v\" valueReference=\"1\" {attributes}>{kind}</ScalarVariable>"),
        "",
    );
    parse(&text).quirks.iter().map(|quirk| (quirk.kind, quirk.to_string())).collect()
}

#[test]
fn long_texts_are_not_copied_to_variables() {
    let long = "q".repeat(2000);
    let text = document("<ScalarVariable name=\"v\" valueReference=\"1\"><Real declaredType=\"T\"/></ScalarVariable>", "")
        .replace(
            "<ModelVariables>",
            &format!("<TypeDefinitions><SimpleType name=\"T\"><Real quantity=\"{long}\"/></SimpleType></TypeDefinitions><ModelVariables>"),
        );
    let model = parse(&text);
    assert_eq!(model.variables[0].quantity, None);
    assert!(
        model.quirks.iter().any(|quirk| quirk.to_string().contains("has 2000 bytes")),
        "{:?}",
        model.quirks
    );
}

fn kinds_of(attributes: &str, kind: &str) -> Vec<QuirkKind> {
    quirks_of(attributes, kind).into_iter().map(|(kind, _)| kind).collect()
}

#[test]
fn description_contains_header_and_interfaces() {
    let model = parse(FULL);
    assert_eq!(
        (model.fmi_version.major, model.fmi_version.minor, model.fmi_version.text.as_str()),
        (2, 0, "2.0")
    );
    assert_eq!(model.model_name, "Full & good");
    assert_eq!(model.guid, "{8c4e810f-3df3-4a00-8276-176fa3c9f013}");
    let texts = [&model.description, &model.author, &model.version, &model.copyright, &model.license];
    assert_eq!(texts.map(|text| text.as_deref().unwrap()), ["d", "a", "1.2", "c", "l"]);
    assert_eq!(model.generation_tool.as_deref(), Some("by hand"));
    assert_eq!(model.generation_date_and_time.as_deref(), Some("2012-09-01T12:00:00Z"));
    assert_eq!(model.variable_naming_convention.as_deref(), Some("structured"));
    assert_eq!((model.n_event_indicators, model.n_states()), (2, 1));
    let me = model.model_exchange.as_ref().unwrap();
    assert_eq!(me.model_identifier, "full_me");
    assert_eq!(me.source_files, ["all.c", "sub/more.c"]);
    let can = me.capabilities;
    assert!(!can.needs_execution_tool && can.completed_integrator_step_not_needed);
    assert!(can.can_be_instantiated_only_once_per_process && can.can_not_use_memory_management_functions);
    assert!(can.can_get_and_set_state && can.can_serialize_state && can.provides_directional_derivative);
    let cs = model.co_simulation.as_ref().unwrap();
    assert_eq!((cs.model_identifier.as_str(), cs.capabilities.max_output_derivative_order), ("full_cs", 3));
    assert!(
        cs.capabilities.can_handle_variable_communication_step_size && cs.capabilities.can_interpolate_inputs
    );
    assert!(cs.capabilities.can_run_asynchronuously && !cs.capabilities.can_get_and_set_state);
    let experiment = model.default_experiment;
    assert_eq!((experiment.start_time, experiment.stop_time), (Some(0.5), Some(10.0)));
    assert_eq!((experiment.tolerance, experiment.step_size), (Some(1e-6), Some(0.25)));
    let categories: Vec<_> =
        model.log_categories.iter().map(|c| (c.name.as_str(), c.description.as_deref())).collect();
    assert_eq!(categories, [("logEvents", Some("e")), ("logAll", None)]);
    assert_eq!(model.quirks, []);
    model.require_conforming().unwrap();
}

#[test]
fn units_convert_in_both_directions() {
    let model = parse(FULL);
    let [speed, temperature, force, odd] = &model.units[..] else { panic!("{:?}", model.units) };
    assert_eq!(speed.base, Some(BaseUnit { s: -1, rad: 1, ..BaseUnit::default() }));
    assert_eq!(force.base, Some(BaseUnit { kg: 1, m: 1, s: -2, ..BaseUnit::default() }));
    assert_eq!(odd.base, Some(BaseUnit { a: 1, mol: 2, cd: 3, factor: 1e3, ..BaseUnit::default() }));
    let base = temperature.base.unwrap();
    assert_eq!((base.k, base.to_base(20.0), base.from_base(293.15)), (1, 293.15, 20.0));
    let fahrenheit = &temperature.display_units[0];
    assert_eq!((fahrenheit.show(100.0), fahrenheit.read(212.0)), (212.0, 100.0));
}

#[test]
fn variables_contain_all_attributes() {
    let model = parse(FULL);
    let w = model.variable("w").unwrap();
    assert_eq!((w.value_reference, w.kind, w.causality), (1, VariableKind::Real, Causality::Output));
    assert_eq!((w.variability, w.initial), (Variability::Continuous, Some(Initial::Exact)));
    assert_eq!((w.description.as_deref(), w.start.clone()), (Some("speed"), Some(Value::Real(-3.5))));
    assert!(w.reinit && !w.can_handle_multiple_set_per_time_instant);
    assert_eq!(
        w.line,
        FULL[..FULL.find("<ScalarVariable name=\"w\"").unwrap()].matches('\n').count() as u32 + 1
    );
    let derivative = model.variable("der(w)").unwrap();
    assert_eq!(
        (derivative.derivative, derivative.causality, derivative.initial),
        (Some(1), Causality::Local, Some(Initial::Calculated))
    );
    assert_eq!(model.variable("k2").unwrap().initial, Some(Initial::Calculated));
    assert_eq!(model.variable("u").unwrap().initial, None);
    assert_eq!(model.variable("c").unwrap().initial, Some(Initial::Exact));
    assert_eq!(model.variable("time").unwrap().causality, Causality::Independent);
    assert_eq!(model.variable("gear").unwrap().start, Some(Value::Integer(-1)));
    assert_eq!(model.variable("on").unwrap().start, Some(Value::Boolean(true)));
    let text = model.variable("name with \"quotes\" [1,2]").unwrap();
    assert_eq!(text.start, Some(Value::String("<t\u{e4}xt>".to_owned())));
    assert_eq!(text.kind, VariableKind::String);
}

#[test]
fn types_supply_missing_attributes_of_variables() {
    let model = parse(FULL);
    let (w, k) = (model.variable("w").unwrap(), model.variable("k").unwrap());
    for variable in [w, k] {
        assert_eq!(variable.quantity.as_deref(), Some("AngularVelocity"));
        assert_eq!(
            (variable.unit.as_deref(), variable.display_unit.as_deref()),
            (Some("rad/s"), Some("rpm"))
        );
        assert_eq!(
            (variable.min, variable.nominal, variable.relative_quantity),
            (Some(-1e3), Some(10.0), true)
        );
    }
    assert_eq!((w.max, k.max), (Some(1000.0), Some(5.0)));
    assert_eq!((w.unbounded, k.unbounded), (false, true)); // w says so itself
    let n = model.variable("n").unwrap();
    assert_eq!((n.min, n.max), (Some(0.0), Some(9.0)));
    let gear = &model.type_definitions[1];
    assert_eq!((gear.name.as_str(), gear.kind), ("Gear", VariableKind::Enumeration));
    let items: Vec<_> = gear.items.iter().map(|item| (item.name.as_str(), item.value)).collect();
    assert_eq!(items, [("reverse", -1), ("first", 1)]);
}

#[test]
fn structure_is_zero_based_and_keeps_dependencies() {
    let structure = parse(FULL).structure;
    assert_eq!(
        (structure.outputs[0].index, structure.outputs[0].dependencies.as_deref()),
        (1, Some(&[][..]))
    );
    let derivative = &structure.derivatives[0];
    assert_eq!((derivative.index, derivative.dependencies.as_deref()), (2, Some(&[1, 3, 5][..])));
    assert_eq!(
        derivative.kinds,
        [DependencyKind::Dependent, DependencyKind::Fixed, DependencyKind::Constant]
    );
    assert_eq!(structure.initial_unknowns[0].dependencies, None);
    assert_eq!(structure.initial_unknowns[1].dependencies.as_deref(), Some(&[3][..]));
}

#[test]
fn unknown_names_get_suggestions() {
    let model = parse(FULL);
    assert_eq!(model.variable_index("gear"), Some(7));
    assert_eq!(model.variable("Gear"), None);
    assert_eq!(model.nearest_names("geer", 3), ["gear"]);
    assert_eq!(model.nearest_names("der(v)", 1), ["der(w)"]);
}

#[test]
fn fmi_version_is_parsed_from_its_numbers() {
    for (text, major, minor) in [("2.0", 2, 0), ("2.0.4", 2, 0), ("2", 2, 0), ("2.1-beta", 2, 1)] {
        let version =
            parse(&FULL.replace("fmiVersion=\"2.0\"", &format!("fmiVersion=\"{text}\""))).fmi_version;
        assert_eq!((version.major, version.minor, version.text.as_str()), (major, minor, text));
    }
    let four = ModelDescription::parse(b"<fmiModelDescription fmiVersion='4.0'/>").unwrap_err();
    assert!(matches!(&four, FmiError::UnknownVersion(version) if version == "4.0"), "{four}");
    assert!(
        refusal("<fmiModelDescription fmiVersion='new'/>").contains("fmiVersion=\"new\" is not a version")
    );
    assert!(refusal("<fmiModelDescription/>").contains("missing attribute fmiVersion"));
}

#[test]
fn descriptions_of_fmi_1_are_read() {
    let model = parse(
        r#"<fmiModelDescription fmiVersion="1.0" modelName="bouncing ball" modelIdentifier="ball" guid="{1}"
             numberOfContinuousStates="2" numberOfEventIndicators="1" generationTool="t">
           <UnitDefinitions><BaseUnit unit="rad"><DisplayUnitDefinition displayUnit="deg" gain="57.3"/></BaseUnit></UnitDefinitions>
           <TypeDefinitions><Type name="Angle"><RealType unit="rad" quantity="Angle"/></Type></TypeDefinitions>
           <DefaultExperiment stopTime="3"/>
           <ModelVariables>
             <ScalarVariable name="h" valueReference="0"><Real start="1" fixed="true" declaredType="Angle"/></ScalarVariable>
             <ScalarVariable name="g" valueReference="1" variability="parameter"><Real start="9.81"/></ScalarVariable>
             <ScalarVariable name="n" valueReference="0" causality="output" variability="discrete"><Integer/></ScalarVariable>
             <ScalarVariable name="-h" valueReference="0" alias="negatedAlias"><Real/></ScalarVariable>
           </ModelVariables></fmiModelDescription>"#,
    );
    assert_eq!((model.fmi_version.major, model.n_states(), model.n_event_indicators), (1, 2, 1));
    assert_eq!(model.model_exchange.as_ref().unwrap().model_identifier, "ball");
    assert!(model.co_simulation.is_none());
    let (h, g) = (model.variable("h").unwrap(), model.variable("g").unwrap());
    assert_eq!(
        (h.initial, h.unit.as_deref(), h.causality),
        (Some(Initial::Exact), Some("rad"), Causality::Local)
    );
    assert_eq!((g.causality, g.variability), (Causality::Parameter, Variability::Fixed));
    assert_eq!(model.variable("n").unwrap().variability, Variability::Discrete);
    assert!(model.variable("-h").unwrap().negated && !h.negated);
    assert!(model.quirks.is_empty(), "{:?}", model.quirks);
    let tool = parse(
        r#"<fmiModelDescription fmiVersion="1.0" modelName="m" modelIdentifier="m" guid="g" numberOfContinuousStates="0" numberOfEventIndicators="0">
           <Implementation><CoSimulation_Tool><Capabilities canHandleVariableCommunicationStepSize="true"/></CoSimulation_Tool></Implementation>
           </fmiModelDescription>"#,
    );
    let capabilities = tool.co_simulation.unwrap().capabilities;
    assert!(capabilities.needs_execution_tool && capabilities.can_handle_variable_communication_step_size);
}

#[test]
fn names_of_fmi_3_include_aliases() {
    let model = parse(
        r#"<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="t"><CoSimulation modelIdentifier="m"/>
           <ModelVariables>
             <Float64 name="x" valueReference="1"><Alias name="y"/><Alias name="z"/></Float64>
             <Float64 name="w" valueReference="2"><Alias name="x"/><Alias name="z"/></Float64>
             <String name="s" valueReference="3" causality="parameter" variability="fixed" start="text"/>
             <Binary name="b" valueReference="4" causality="parameter" variability="fixed" start="00fF"/>
           </ModelVariables><ModelStructure/></fmiModelDescription>"#,
    );
    let names: Vec<(&str, usize)> = model.names().collect();
    assert_eq!(names, [("x", 0), ("y", 0), ("z", 0), ("w", 1), ("x", 1), ("z", 1), ("s", 2), ("b", 3)]);
    let found = ["x", "y", "z", "w"].map(|name| model.variable_index(name).unwrap());
    assert_eq!(found, [0, 0, 0, 1]);
    assert_eq!(model.nearest_names("Y", 1), ["y"]);
    // Elements of other types, and in an invalid place.
    assert_eq!(model.variable("s").unwrap().start, Some("text".into()));
    assert_eq!(model.variable("b").unwrap().start, Some(Value::Binary(vec![0, 255])));
    let quirks: Vec<_> = model.quirks.iter().map(|quirk| (quirk.kind, quirk.line)).collect();
    let expected = [QuirkKind::Duplicate, QuirkKind::Duplicate, QuirkKind::Start, QuirkKind::Start];
    assert_eq!(quirks, expected.into_iter().zip([4, 4, 5, 6]).collect::<Vec<_>>(), "{:?}", model.quirks);
}

#[test]
fn descriptions_of_fmi_3_are_read() {
    let model = parse(
        r#"<fmiModelDescription fmiVersion="3.0.1" modelName="m" instantiationToken="{t}">
           <ModelExchange modelIdentifier="m" canGetAndSetFMUState="true"/>
           <CoSimulation modelIdentifier="m" hasEventMode="true"/>
           <TypeDefinitions><Float64Type name="T" unit="m"/><EnumerationType name="E"><Item name="a" value="1"/></EnumerationType></TypeDefinitions>
           <UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit></UnitDefinitions>
           <ModelVariables>
             <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
             <Float64 name="x" valueReference="7" declaredType="T" start="1" initial="exact"/>
             <Float64 name="der(x)" valueReference="8" derivative="7"/>
             <UInt16 name="n" valueReference="9" causality="output" start="3"/>
             <String name="s" valueReference="10" causality="parameter"><Start value="text"/></String>
             <Float32 name="a" valueReference="11" start="1 2 3"><Dimension start="3"/></Float32>
             <Binary name="b" valueReference="12" causality="output" initial="exact"><Start value="00fF"/></Binary>
             <UInt64 name="rows" valueReference="13" causality="structuralParameter" start="2"/>
             <Int64 name="m" valueReference="14" start="1 2 3 4 5 6"><Dimension valueReference="13"/><Dimension start="3"/>
               <Alias name="matrix" description="the same"/></Int64>
             <UInt64 name="big" valueReference="15" start="18446744073709551615" initial="exact"/>
             <Clock name="c" valueReference="16" causality="input" intervalVariability="triggered"/>
             <Boolean name="tick" valueReference="17" clocks="16"/>
           </ModelVariables>
           <ModelStructure>
             <ContinuousStateDerivative valueReference="8" dependencies="7" dependenciesKind="constant"/>
             <Output valueReference="12"/><Output valueReference="9" dependencies="12 7" dependenciesKind="fixed fixed"/>
             <InitialUnknown valueReference="8"/><EventIndicator valueReference="8"/>
           </ModelStructure></fmiModelDescription>"#,
    );
    assert_eq!(
        (model.fmi_version.major, model.fmi_version.text.as_str(), model.guid.as_str()),
        (3, "3.0.1", "{t}")
    );
    assert_eq!((model.n_states(), model.n_event_indicators, model.variables.len()), (1, 1, 12));
    let variable = |name: &str| model.variable(name).unwrap();
    assert_eq!(variable("der(x)").derivative, Some(1));
    assert_eq!(variable("x").unit.as_deref(), Some("m"));
    assert_eq!(
        (variable("n").variability, variable("n").kind),
        (Variability::Discrete, VariableKind::UInt16)
    );
    assert_eq!(variable("s").variability, Variability::Fixed);
    assert_eq!(model.structure.outputs[1].dependencies.as_deref(), Some(&[6, 1][..]));
    assert_eq!(variable("s").start, Some("text".into()));
    assert_eq!(variable("a").start, Some(vec![1.0, 2.0, 3.0].into()));
    assert_eq!(variable("b").start, Some(Value::Binary(vec![0, 255])));
    assert_eq!(variable("rows").causality, Causality::StructuralParameter);
    assert_eq!(variable("m").dimensions, [Dimension::Parameter(7), Dimension::Fixed(3)]);
    assert_eq!(model.extents(variable("m")), [2, 3]);
    assert_eq!(model.variable_index("matrix"), model.variable_index("m"));
    assert_eq!(variable("big").start, Some(u64::MAX.into()));
    assert_eq!(variable("tick").clocks, [10]);
    assert_eq!(model.structure.derivatives[0].dependencies.as_deref(), Some(&[1][..]));
    let exchange = model.model_exchange.as_ref().unwrap();
    assert!(exchange.capabilities.can_get_and_set_state);
    assert!(exchange.capabilities.completed_integrator_step_not_needed);
    assert!(model.quirks.is_empty(), "{:?}", model.quirks);
}

#[test]
fn invalid_dimensions_are_rejected() {
    let array = |dimension: &str| {
        refusal(&format!(
            r#"<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="t"><ModelExchange modelIdentifier="m"/>
               <ModelVariables><Float64 name="p" valueReference="1" causality="parameter" start="2"/>
               <Float64 name="a" valueReference="2">{dimension}</Float64></ModelVariables></fmiModelDescription>"#
        ))
    };
    assert!(array("<Dimension/>").contains("without an extent"));
    assert!(array("<Dimension valueReference='1'/>").contains("not a structural parameter"));
    assert!(array("<Dimension valueReference='9'/>").contains("not a structural parameter"));
    let huge = "<Dimension start='4000000000'/>".repeat(3);
    assert!(array(&huge).contains("more than 2000000 elements"));
}

#[test]
fn unknown_elements_and_attributes_are_ignored() {
    let text = document(
        "<ScalarVariable name='a' valueReference='1' future='x'><Real quantum='1'/><Future/></ScalarVariable>",
        "<Future><Unknown index='99'/></Future>",
    )
    .replace("<ModelVariables>", "<Surprise deep='1'><ModelVariables><Nonsense/></ModelVariables></Surprise><ModelVariables>");
    let model = parse(&text);
    assert_eq!((model.variables.len(), model.quirks.len()), (1, 0));
}

#[test]
fn invalid_values_become_quirks_with_lines() {
    let quirks = quirks_of("causality='sideways'", "<Real min='1,5' start='2.0' initial='x'/>");
    assert_eq!(
        quirks,
        [
            (QuirkKind::Attribute, "line 3: <Real>: min=\"1,5\" is not a number; ignored".to_owned()),
            (
                QuirkKind::Attribute,
                "line 3: <ScalarVariable>: causality=\"sideways\" is not a value that the standard defines; \
                 ignored"
                    .to_owned()
            ),
            (QuirkKind::Start, "line 3: \"v\" has an unused start value".to_owned()),
        ]
    );
    let error =
        parse(&document("<ScalarVariable name='v' valueReference='1'><Real unit='?'/></ScalarVariable>", ""))
            .require_conforming()
            .unwrap_err()
            .to_string();
    assert!(error.contains("1 places; the first is in line 3: unit \"?\" is not defined"), "{error}");
}

#[test]
fn invalid_combinations_are_tolerated_and_reported() {
    use QuirkKind::{Combination, Range, Start, Undefined};
    for (attributes, kind, expected) in [
        ("causality='parameter' variability='constant'", "<Real start='1'/>", Combination),
        ("causality='parameter' variability='fixed' initial='calculated'", "<Real/>", Combination),
        ("causality='input' initial='exact'", "<Real start='0'/>", Combination),
        ("variability='continuous'", "<Integer/>", Combination),
        ("causality='parameter' variability='fixed'", "<Real/>", Start),
        ("causality='input'", "<Real/>", Start),
        ("", "<Real nominal='0'/>", Range),
        ("", "<Real nominal='-1'/>", Range),
        ("", "<Real nominal='NaN'/>", Range),
        ("", "<Real min='2' max='1'/>", Range),
        ("causality='input'", "<Real start='3' max='2'/>", Range),
        ("causality='input'", "<Real start='NaN'/>", Range),
        ("", "<Real declaredType='None'/>", Undefined),
        ("", "<Real unit='furlong'/>", Undefined),
    ] {
        assert_eq!(kinds_of(attributes, kind), [expected], "{attributes} {kind}");
    }
    let variable =
        |name, kind| format!("<ScalarVariable name='{name}' valueReference='1'>{kind}</ScalarVariable>");
    let model = parse(&document(&(variable("a", "<Real/>") + &variable("a", "<Boolean/>")), ""));
    assert_eq!(model.quirks[0].kind, QuirkKind::Duplicate);
    assert_eq!(model.variable("a").unwrap().kind, VariableKind::Real);
}

#[test]
fn wrong_structure_is_tolerated_when_safe() {
    let variables = "<ScalarVariable name='x' valueReference='1' initial='exact'><Real start='1'/></ScalarVariable>\n\
        <ScalarVariable name='der(x)' valueReference='2'><Real derivative='1'/></ScalarVariable>\n\
        <ScalarVariable name='d2' valueReference='3'><Real derivative='77'/></ScalarVariable>";
    let model = parse(&document(
        variables,
        "<Outputs><Unknown index='0'/><Unknown index='4'/></Outputs>\n\
         <Derivatives><Unknown index='2' dependencies='1 9'/><Unknown index='1'/></Derivatives>\n\
         <InitialUnknowns><Unknown index='4294967295' dependenciesKind='fixed'/></InitialUnknowns>",
    ));
    assert_eq!((model.structure.outputs.len(), model.structure.initial_unknowns.len()), (0, 0));
    assert_eq!(model.n_states(), 2); // as listed, although the second is a state and no derivative
    assert_eq!(model.structure.derivatives[0].dependencies, None);
    assert_eq!(model.variable("d2").unwrap().derivative, None);
    assert!(model.quirks.iter().all(|quirk| quirk.kind == QuirkKind::Structure), "{:?}", model.quirks);
    assert_eq!(model.quirks.len(), 6, "{:?}", model.quirks);

    let message = refusal(&document(variables, "<Derivatives>\n<Unknown index='4'/></Derivatives>"));
    assert_eq!(
        message,
        "modelDescription.xml, line 9: a derivative refers to a variable that does not exist \
                         (the model has 3 variables)"
    );
}

#[test]
fn unusable_description_is_rejected_with_line() {
    for (variable, part) in [
        ("<ScalarVariable valueReference='1'><Real/></ScalarVariable>", "missing attribute name"),
        ("<ScalarVariable name='a'><Real/></ScalarVariable>", "missing attribute valueReference"),
        ("<ScalarVariable name='a' valueReference='-1'><Real/></ScalarVariable>", "valueReference=\"-1\""),
        ("<ScalarVariable name='a' valueReference='4294967296'><Real/></ScalarVariable>", "valueReference="),
        ("<ScalarVariable name='a' valueReference='1'/>", "\"a\" has no type"),
    ] {
        let message = refusal(&document(variable, ""));
        assert!(message.starts_with("modelDescription.xml, line 3: ") && message.contains(part), "{message}");
    }
    assert!(refusal("<html/>").contains("the root element is <html>"));
    let huge = FULL.replace("numberOfEventIndicators=\"2\"", "numberOfEventIndicators=\"4000000000\"");
    assert!(refusal(&huge).contains("exceeds the limit of 2000000"));
}

#[test]
fn model_identifiers_with_path_separators_are_rejected() {
    for name in ["../evil", "a/b", "a\\b", "C:evil", "..", ".", "", "a&#10;b"] {
        let message = refusal(&FULL.replace("full_me", name));
        assert!(message.contains("line 6: <ModelExchange>: modelIdentifier="), "{name}: {message}");
    }
    for (version, place) in [("1.0", "modelIdentifier='../e'"), ("3.0", "")] {
        let text = format!(
            "<fmiModelDescription fmiVersion='{version}' {place}><CoSimulation modelIdentifier='../e'/></fmiModelDescription>"
        );
        assert!(refusal(&text).contains("path separator"), "{version}");
    }
}

#[test]
fn entity_bombs_are_rejected() {
    let mut bomb = "<?xml version=\"1.0\"?>\n<!DOCTYPE bomb [<!ENTITY a0 \"ha\">".to_owned();
    for i in 1..30 {
        bomb += &format!("<!ENTITY a{i} \"&a{0};&a{0};\">", i - 1);
    }
    bomb += "]>\n<fmiModelDescription fmiVersion=\"2.0\" modelName=\"&a29;\" guid=\"\"/>";
    assert!(refusal(&bomb).contains("line 2: document type definitions are not supported"));
    let external = "<!DOCTYPE a SYSTEM \"file:///etc/passwd\"><fmiModelDescription fmiVersion=\"2.0\"/>";
    assert!(refusal(external).contains("document type definition"));
    assert!(refusal(&FULL.replace("by hand", "&undefined;")).contains("generationTool"));
}

#[test]
fn excessive_nesting_is_rejected() {
    let deep = format!("{}{}", "<a>".repeat(1000), "</a>".repeat(1000));
    let inside = FULL.replace("<anything>", &format!("<anything>{deep}"));
    assert!(refusal(&inside).contains("nested more than 128 levels deep"));
    let bottomless = "<a>".repeat(1_000_000);
    assert!(
        refusal(&format!("<fmiModelDescription fmiVersion='2.0'>{bottomless}"))
            .contains("nested more than 128 levels")
    );
}

#[test]
fn truncated_documents_are_rejected() {
    for length in (0..FULL.len() - 20).step_by(37).filter(|&at| FULL.is_char_boundary(at)) {
        let message = refusal(&FULL[..length]);
        assert!(message.starts_with("modelDescription.xml, line "), "{message}");
    }
}

#[test]
fn invalid_utf8_is_replaced_and_reported() {
    let mut bytes = FULL.as_bytes().to_vec();
    let place = FULL.find("by hand").unwrap();
    bytes[place] = 0xff;
    let model = ModelDescription::parse(&bytes).unwrap();
    assert_eq!(model.generation_tool.as_deref(), Some("\u{fffd}y hand"));
    assert_eq!((model.quirks[0].kind, model.quirks[0].line), (QuirkKind::Encoding, 4));
    assert!(matches!(model.require_conforming(), Err(FmiError::NotConforming { count: 1, line: 4, .. })));
}

#[test]
fn declared_encoding_is_used() {
    let latin = FULL.replace("UTF-8", "ISO-8859-1").replace("by hand", "M\u{fc}ller");
    let bytes: Vec<u8> = latin.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect();
    assert_eq!(ModelDescription::parse(&bytes).unwrap().generation_tool.as_deref(), Some("M\u{fc}ller"));
    let utf16: Vec<u8> = format!("\u{feff}{}", FULL.replace("UTF-8", "UTF-16"))
        .encode_utf16()
        .flat_map(u16::to_le_bytes)
        .collect();
    let mut wide = ModelDescription::parse(&utf16).unwrap();
    wide.quirks.clear();
    assert_eq!(wide, parse(FULL));
}

/// Returns a description with this number of variables, four lines each.
fn large(n: usize) -> String {
    let variables: String = (1..=n)
        .map(|i| {
            format!(
                "<ScalarVariable name=\"plant.stage[{i}].massFlowRate\" valueReference=\"{i}\" description=\"mass flow \
                 rate of stage {i}\" causality=\"local\" variability=\"continuous\">\n<Real declaredType=\"T\" unit=\"kg/s\" \
                 min=\"0\" derivative=\"{}\"/>\n</ScalarVariable>\n",
                1 + i / 2
            )
        })
        .collect();
    let unknowns: String =
        (1..=n / 2).map(|i| format!("<Unknown index=\"{i}\" dependencies=\"{i} 1\"/>\n")).collect();
    document(&variables, &format!("<Derivatives>{unknowns}</Derivatives>"))
}

/// The benchmark `benches/open.rs` measures the duration.
#[test]
fn description_with_100_000_variables_is_searchable() {
    let model = parse(&large(100_000));
    assert_eq!(model.variables.len(), 100_000);
    for i in 1..=100_000 {
        assert_eq!(model.variable_index(&format!("plant.stage[{i}].massFlowRate")), Some(i - 1));
    }
    assert_eq!(model.nearest_names("plant.stage[500].masFlowRate", 1), ["plant.stage[500].massFlowRate"]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_bytes_are_read_or_rejected(bytes in prop::collection::vec(any::<u8>(), 0..500)) {
        promises::hold_for_document(&bytes);
    }

    #[test]
    fn arbitrary_text_in_root_element_is_read_or_rejected(text in "[<>/=\"' a-zA-Z&;#0-9!\\[\\]?-]{0,200}") {
        promises::hold_for_document(format!("<fmiModelDescription fmiVersion='2.0'>{text}").as_bytes());
    }

    /// For any changes of the document, all indices are in range if it is accepted.
    #[test]
    fn modified_documents_are_consistent_or_rejected(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        digits in prop::collection::vec((any::<prop::sample::Index>(), b'0'..=b'9'), 0..8),
        version in 1..4_u32,
    ) {
        let mut bytes = FULL.replace("fmiVersion=\"2.0\"", &format!("fmiVersion=\"{version}.0\"")).into_bytes();
        let places: Vec<usize> = (0..bytes.len()).filter(|&at| bytes[at].is_ascii_digit()).collect();
        for (place, digit) in digits {
            bytes[*place.get(&places)] = digit;
        }
        for (place, value) in changes {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        promises::hold_for_document(&bytes);
    }
}
