//! Information that an FMU provides at run time: names of states, version and types, dependencies,
//! derivatives and log categories. Also the terminals listed in its files.

#![allow(clippy::unwrap_used)]

use crate::support;

use example_models::ExampleKind::{Fmi1ModelExchange, Fmi2ModelExchange, Fmi3};
use example_models::example_fmu_as;
use fmi::description::DependencyKind;
use fmi::ode::Method;
use fmi::{
    ElementDependency, EventMode, FmiError, Fmu, Instance, InstanceOptions, LogOptions, OpenOptions,
    SimulateOptions,
};
use support::{arrays, evil, fixture, model, model_as};

fn in_event_mode(fmu: &Fmu) -> Instance<EventMode> {
    let instance = fmu.instantiate().unwrap();
    instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap()
}

#[test]
fn state_names_are_available_in_all_versions() {
    for kind in [Fmi1ModelExchange, Fmi2ModelExchange, Fmi3] {
        let fmu = Fmu::open(example_fmu_as("quad_tank", kind).unwrap()).unwrap();
        let names: Vec<String> = in_event_mode(&fmu).state_names().unwrap().into_iter().flatten().collect();
        assert_eq!(names, ["qt.x1", "qt.x2", "qt.x3", "qt.x4"], "{kind:?}");
        assert_eq!(fmu.quirks_seen(), [], "{kind:?}");
    }
}

#[test]
fn library_version_mismatch_is_a_quirk_and_type_mismatch_an_error() {
    let fmu = evil(&["VERSION=\"3.0\""]);
    let fmu = fmu.open();
    fmu.simulate(&SimulateOptions::new().ncp(1)).unwrap();
    let message = &fmu.quirks_seen()[0].message;
    assert_eq!(message, "the model description declares FMI 2.0, but the library reports \"3.0\"");
    // A later release of the same version is accepted.
    let fmu = evil(&["VERSION=\"2.0.4\""]);
    let fmu = fmu.open();
    fmu.simulate(&SimulateOptions::new().ncp(1)).unwrap();
    assert_eq!(fmu.quirks_seen(), []);
    let error = evil(&["TYPES_PLATFORM=\"vax64\""]).open().instantiate().unwrap_err();
    assert!(matches!(error, FmiError::LoadFailed { .. }), "{error}");
    assert!(error.to_string().contains("\"vax64\""), "{error}");
}

#[test]
fn array_derivatives_support_directional_and_adjoint_calls() {
    let folder = arrays();
    let mut instance = folder.open().instantiate().unwrap();
    instance.set("k", vec![1.0, 2.0, 4.0]).unwrap();
    let instance = instance.enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    let mut out = [0.0; 3];
    instance.directional_derivative(&[3], &[2], &[1.0, 10.0, 100.0], &mut out).unwrap();
    assert_eq!(out, [-1.0, -20.0, -400.0]);
    instance.adjoint_derivative(&[3], &[2], &[100.0, 10.0, 1.0], &mut out).unwrap();
    assert_eq!(out, [-100.0, -20.0, -4.0]);
    assert!(matches!(
        instance.adjoint_derivative(&[3], &[2], &[1.0], &mut out),
        Err(FmiError::Length { expected: 3, found: 1, .. })
    ));
    // Adjoint derivatives are a function of FMI 3.0.
    let old = model("dahlquist");
    let mut old = in_event_mode(&old.open());
    let error = old.adjoint_derivative(&[], &[], &[], &mut []).unwrap_err();
    assert_eq!(error.to_string(), "the FMU does not implement the function (adjoint derivatives)");
}

#[test]
fn simulation_uses_directional_derivatives_of_array_states() {
    let promise =
        |xml: String| xml.replace("<ModelExchange", "<ModelExchange providesDirectionalDerivatives=\"true\"");
    let folder = fixture("arrays", promise);
    let options = SimulateOptions::new().method(Method::Radau5).relative_tolerance(1e-8).outputs(["sum"]);
    let found = folder.open().simulate(&options).unwrap();
    assert!(found.stats.directional_derivatives > 0, "{:?}", found.stats);
    let without = arrays().open().simulate(&options).unwrap();
    assert_eq!(without.stats.directional_derivatives, 0);
    // x' = -x from 1, 2, 3.
    for result in [&found, &without] {
        let sum = result.final_value("sum").unwrap().unwrap();
        assert!((sum - 6.0 * (-1f64).exp()).abs() < 1e-6, "{sum}");
    }
}

#[test]
fn variable_dependencies_are_listed_per_element() {
    let folder = arrays();
    let mut instance = folder.open().instantiate().unwrap();
    instance.set("n", 2).unwrap();
    let instance = instance.enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    // Dependencies without effect are omitted.
    let of = |i| ElementDependency {
        element: Some(i),
        known: 2,
        known_element: Some(i),
        kind: DependencyKind::Fixed,
    };
    assert_eq!(instance.variable_dependencies("der(x)").unwrap(), [of(0), of(1)]);
    assert_eq!(instance.variable_dependencies("sum").unwrap(), []);
    assert!(matches!(instance.variable_dependencies("y"), Err(FmiError::UnknownVariable { .. })));
    let old = model("dahlquist");
    let error = in_event_mode(&old.open()).variable_dependencies("x").unwrap_err();
    assert!(matches!(error, FmiError::MissingFunction(_)), "{error}");
}

#[test]
fn log_categories_are_selected_by_name() {
    for kind in [Fmi1ModelExchange, Fmi2ModelExchange, Fmi3] {
        let fmu = Fmu::open(example_fmu_as("bouncing_ball", kind).unwrap()).unwrap();
        let mut instance = in_event_mode(&fmu);
        instance.log_categories(&["logEvents"]).unwrap();
        instance.update_discrete_states(1).unwrap();
        let n_events = instance.log().0.iter().filter(|line| line.category == "logEvents").count();
        // In FMI 1.0 the first update is part of the initialization.
        assert_eq!(n_events, usize::from(kind != Fmi1ModelExchange), "{kind:?}");
        instance.log_categories(&["logStatusError"]).unwrap();
        instance.update_discrete_states(1).unwrap();
        assert_eq!(instance.log().0.len(), n_events, "{kind:?}");
        if kind != Fmi1ModelExchange {
            let error = instance.log_categories(&["logAll"]).unwrap_err().to_string();
            assert!(error.contains("\"logAll\"") && error.contains("logEvents, logStatusDiscard"), "{error}");
        }
    }
    // Categories can also be set when an instance is created, and in simulations.
    let path = example_fmu_as("bouncing_ball", Fmi2ModelExchange).unwrap();
    let log_categories = vec!["logStatusError".to_owned()];
    let fmu = Fmu::open(&path).unwrap();
    let options = InstanceOptions { logging: true, log_categories, ..InstanceOptions::default() };
    let instance = fmu.instantiate_with(&options).unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    instance.update_discrete_states(1).unwrap();
    assert_eq!(instance.log().0, []);
    let logging =
        LogOptions { requested: true, categories: vec!["logAll".to_owned()], ..LogOptions::default() };
    let fmu = Fmu::open_with(&path, &OpenOptions { logging, ..OpenOptions::default() }).unwrap();
    let error = fmu.simulate(&SimulateOptions::new()).unwrap_err();
    assert!(matches!(error, FmiError::BadSetting(_)), "{error}");
}

#[test]
fn extra_files_of_an_fmu_are_ignored() {
    // Layered standards and files of tools (FMI 3.0, sections 2.5.1 and 2.5.2), some of them broken.
    let [plain, full] = [(); 2].map(|()| model_as("dahlquist", Fmi3, &[], |xml| xml));
    for (name, text) in [
        ("extra/org.fmi-standard.fmi-ls-xcp/fmi-ls-manifest.xml", "<fmiLayeredStandardManifest"),
        ("extra/com.vendor/deep/er/data.bin", "\0\u{1}"),
        ("terminalsAndIcons/icon.png", "none"),
        ("documentation/index.html", "<html>"),
        ("vendor/readme", "x"),
    ] {
        let path = full.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    let packed = full.path().with_extension("fmu");
    fmi::pack(full.path(), &packed).unwrap();
    let expected = plain.open().simulate(&SimulateOptions::new().ncp(5)).unwrap();
    for fmu in [full.open(), Fmu::open(&packed).unwrap()] {
        assert_eq!(fmu.simulate(&SimulateOptions::new().ncp(5)).unwrap(), expected);
        assert!(
            fmu.description().quirks.is_empty() && fmu.quirks_seen().is_empty(),
            "{:?}",
            fmu.quirks_seen()
        );
        assert_eq!(fmu.terminals().unwrap(), []);
    }
    std::fs::remove_file(packed).unwrap();
}

#[test]
fn terminals_are_read_from_archives_and_folders() {
    let folder = model_as("dahlquist", Fmi3, &[], |xml| xml);
    assert_eq!(folder.open().terminals().unwrap(), []);
    let place = folder.path().join("terminalsAndIcons");
    std::fs::create_dir(&place).unwrap();
    let text = "<fmiTerminalsAndIcons fmiVersion=\"3.0\"><Terminals><Terminal name=\"out\" matchingRule=\"plug\">\
                <TerminalMemberVariable variableName=\"x\" variableKind=\"signal\"/></Terminal></Terminals>\
                </fmiTerminalsAndIcons>";
    std::fs::write(place.join("terminalsAndIcons.xml"), text).unwrap();
    let packed = folder.path().with_extension("fmu");
    fmi::pack(folder.path(), &packed).unwrap();
    for fmu in [folder.open(), Fmu::open(&packed).unwrap()] {
        let terminals = fmu.terminals().unwrap();
        assert_eq!((terminals.len(), terminals[0].members[0].variable.as_str()), (1, "x"));
    }
    std::fs::remove_file(packed).unwrap();
}
