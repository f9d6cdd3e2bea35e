//! Each model gives the same results in every version of the standard.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use example_models::ExampleKind;
use fmi::ode::{Method, Termination};
use fmi::{
    FmiError, Fmu, Inputs, InterfaceChoice, Session, SimulateOptions, SimulationPlan, Simulator, Trajectory,
    Value,
};
use std::sync::Arc;
use support::MODELS;

fn open(name: &str, kind: ExampleKind) -> Fmu {
    Fmu::open(example_models::example_fmu_as(name, kind).unwrap()).unwrap()
}

fn truth(name: &str, options: &SimulateOptions) -> Trajectory {
    open(name, ExampleKind::Fmi2ModelExchange).simulate(options).unwrap()
}

/// Checks that names, times and events are equal, and that values agree within a tolerance.
fn agree(name: &str, truth: &Trajectory, found: &Trajectory, tolerance: f64) {
    assert_eq!((&found.names, &found.time), (&truth.names, &truth.time), "{name}");
    assert_eq!((found.termination, found.end_time), (truth.termination, truth.end_time), "{name}");
    for (column, (a, b)) in truth.columns.iter().zip(&found.columns).enumerate() {
        for (row, (a, b)) in a.iter().zip(b).enumerate() {
            assert!(
                (a - b).abs() <= tolerance * (1.0 + a.abs()),
                "{name}: {} in row {row}: {a} and {b}",
                truth.names[column]
            );
        }
    }
}

#[test]
fn model_exchange_is_bit_for_bit_identical_in_all_versions() {
    for (name, end) in MODELS {
        // An implicit method uses directional derivatives for its Jacobian, which FMI 1.0 does not have.
        let options = SimulateOptions::new()
            .final_time(end)
            .ncp(97)
            .method(Method::Dop853)
            .relative_tolerance(1e-8)
            .record_events(true);
        let truth = truth(name, &options);
        // In FMI 1.0 the state variables are unknown.
        let options = options.outputs(truth.names.clone());
        for kind in [ExampleKind::Fmi1ModelExchange, ExampleKind::Fmi3] {
            let found = open(name, kind).simulate(&options).unwrap();
            agree(name, &truth, &found, 0.0);
            assert_eq!(found.events, truth.events, "{name} {kind:?}");
        }
    }
}

#[test]
fn co_simulation_agrees_in_all_versions() {
    for (name, end) in MODELS {
        let options = SimulateOptions::new().final_time(end).ncp(97).relative_tolerance(1e-8);
        let truth = truth(name, &options);
        let options = options.outputs(truth.names.clone()).kind(InterfaceChoice::CoSimulation);
        let two = open(name, ExampleKind::Fmi2CoSimulation).simulate(&options).unwrap();
        agree(name, &truth, &two, 1e-6);
        let one = open(name, ExampleKind::Fmi1CoSimulation).simulate(&options).unwrap();
        agree(name, &two, &one, 0.0);
        let three = open(name, ExampleKind::Fmi3).simulate(&options).unwrap();
        agree(name, &two, &three, 1e-9);
    }
}

#[test]
fn model_ends_the_simulation_in_all_versions() {
    // The stair ends at 9 s: between two communication points, and at one.
    for (interval, last) in [(0.4, 8.8), (0.5, 9.0)] {
        let options = SimulateOptions::new().final_time(20.0).output_interval(interval);
        for kind in ExampleKind::ALL {
            let fmu = open("stair", kind);
            for way in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
                let Ok(_) = fmu.choose(way) else { continue };
                let result = fmu.simulate(&options.clone().kind(way)).unwrap();
                assert_eq!(
                    (result.termination, result.end_time),
                    (Termination::StoppedByModel, 9.0),
                    "{kind:?}"
                );
                let end = *result.time.last().unwrap();
                assert!((end - last).abs() < 1e-12, "{kind:?} {way:?}: {end}");
                assert_eq!(result.get("counter").unwrap().last(), Some(&(1.0 + end.floor())), "{kind:?}");
            }
        }
    }
}

#[test]
fn inputs_of_all_types_reach_the_model_in_all_versions() {
    let inputs = Inputs::new()
        .series("u", vec![0.0, 0.7, 2.0, 2.0, 5.0], vec![0.0, 0.21, 0.6, 1.0, 1.0])
        .series("gear", vec![0.0, 1.0], vec![1.0, 2.0])
        .series("enabled", vec![0.0, 2.5], vec![1.0, 0.0]);
    let options = SimulateOptions::new()
        .times([0.0, 0.5, 1.0, 1.0, 2.0, 2.0, 2.5, 2.5, 3.0])
        .final_time(3.0)
        .relative_tolerance(1e-9)
        .step_size(0.25)
        .inputs(inputs)
        .outputs(["x", "target", "gear", "limit", "enabled", "u"]);
    let truth = truth("switched_input", &options);
    // Without event mode there are only limits from the left.
    let mut left = truth.clone();
    for row in (1..left.time.len()).filter(|row| truth.time[*row] == truth.time[row - 1]) {
        left.columns.iter_mut().for_each(|column| column[row] = column[row - 1]);
    }
    for kind in ExampleKind::ALL {
        let fmu = open("switched_input", kind);
        let has_events = !matches!(kind, ExampleKind::Fmi1CoSimulation | ExampleKind::Fmi2CoSimulation);
        let truth = if has_events { &truth } else { &left };
        agree(&format!("{kind:?}"), truth, &fmu.simulate(&options).unwrap(), 1e-6);
    }
    // FMI 3.0 has no input derivatives. Inputs held over steps of 1 ms are accurate enough here.
    let fmu = open("switched_input", ExampleKind::Fmi3);
    let options = options.kind(InterfaceChoice::CoSimulation).step_size(1e-3);
    let result = fmu.simulate(&options).unwrap();
    agree("3.0 CS", &truth, &result, 2e-3);
    let at = |kind: fn(&fmi::ode::EventCause) -> bool| -> Vec<f64> {
        result.events.iter().filter(|e| kind(&e.cause)).map(|e| e.time).collect()
    };
    assert_eq!(at(|c| c.input), [1.0, 2.0, 2.5]);
    assert!(!at(|c| c.step).is_empty());
}

#[test]
fn events_end_steps_of_co_simulation_early() {
    let options = SimulateOptions::new().final_time(2.0).ncp(4).kind(InterfaceChoice::CoSimulation);
    let result = open("bouncing_ball", ExampleKind::Fmi3).simulate(&options).unwrap();
    let times: Vec<f64> = result.events.iter().map(|event| event.time).collect();
    for (found, expected) in
        times.iter().zip([0.45152364098573090445, 1.0836567383657541707, 1.526149906531770457])
    {
        assert!((found - expected).abs() < 1e-9, "{times:?}");
    }
    let result = open("stair", ExampleKind::Fmi3).simulate(&options.final_time(20.0).ncp(40)).unwrap();
    assert_eq!((result.termination, result.end_time), (Termination::StoppedByModel, 9.0));
    assert_eq!(result.events.len(), 9);
}

#[test]
fn simulator_repeats_a_run_bit_for_bit_in_all_versions() {
    let options = SimulateOptions::new()
        .final_time(1.0)
        .ncp(10)
        .parameters(["armFriction", "pendulumFriction"])
        .outputs(["armJoint.phi", "pendulumJoint.phi"]);
    for kind in ExampleKind::ALL {
        let plan = Arc::new(SimulationPlan::new(&open("furuta", kind), &options).unwrap());
        let mut simulator = Simulator::new(plan).unwrap().resetting();
        let first = simulator.trajectory(&[0.012, 0.002]).unwrap();
        let other = simulator.trajectory(&[0.010, 0.001]).unwrap();
        assert_ne!(first.columns, other.columns);
        assert_eq!(simulator.trajectory(&[0.012, 0.002]).unwrap(), first);
    }
}

#[test]
fn values_and_errors_are_consistent_in_all_versions() {
    for (kind, get) in [
        (ExampleKind::Fmi1ModelExchange, "fmiInitialize"),
        (ExampleKind::Fmi1CoSimulation, "fmiInitializeSlave"),
        (ExampleKind::Fmi2CoSimulation, "fmi2ExitInitializationMode"),
        (ExampleKind::Fmi3, "fmi3ExitInitializationMode"),
    ] {
        let fmu = open("switched_input", kind);
        let mut session = Session::new(fmu.clone());
        session.set("T", 0.25).unwrap();
        session.set("gear", 3).unwrap();
        session.simulate(&SimulateOptions::new().final_time(1.0)).unwrap();
        assert_eq!(session.get("gear").unwrap(), Value::Integer(3), "{kind:?}");
        assert_eq!(session.get("enabled").unwrap(), Value::Boolean(true));
        assert_eq!(session.get("T").unwrap(), Value::Real(0.25));
        let options = SimulateOptions::new().final_time(1.0).start_value("T", -1.0);
        let error = fmu.simulate(&options).unwrap_err();
        let failure = error.call_failure().unwrap();
        assert_eq!(failure.call, get, "{error}");
        assert!(failure.log[0].text.contains("T = -1 must be positive"), "{error}");
    }
    let error = open("switched_input", ExampleKind::Fmi1ModelExchange).instantiate().unwrap().reset();
    assert!(matches!(error, Err(FmiError::MissingFunction(_))));
}

#[test]
fn descriptions_of_all_versions_conform() {
    for (name, _) in MODELS {
        for kind in ExampleKind::ALL {
            let fmu = open(name, kind);
            let quirks = &fmu.description().quirks;
            assert!(quirks.is_empty(), "{name} {kind:?}: {quirks:?}");
            let two = open(name, ExampleKind::Fmi2ModelExchange);
            assert_eq!(fmu.description().n_states(), two.description().n_states());
            assert_eq!(fmu.description().n_event_indicators, two.description().n_event_indicators);
        }
    }
}

#[test]
fn negated_aliases_reverse_the_sign_of_all_values() {
    let folder = support::model_as("switched_input", ExampleKind::Fmi1ModelExchange, &[], |xml| {
        let alias = |name: &str, reference: u32, attributes: &str, kind: &str| {
            format!(
                "<ScalarVariable name=\"{name}\" valueReference=\"{reference}\" alias=\"negatedAlias\" {attributes}>{kind}\
                 </ScalarVariable>"
            )
        };
        let aliases = [
            alias("-x", 1, "causality=\"output\"", "<Real/>"),
            alias("-u", 6, "causality=\"input\"", "<Real start=\"0\"/>"),
            alias(
                "not enabled",
                7,
                "causality=\"input\" variability=\"discrete\"",
                "<Boolean start=\"false\"/>",
            ),
            alias("-gear", 8, "causality=\"input\" variability=\"discrete\"", "<Integer start=\"-1\"/>"),
            alias("-T", 10, "variability=\"parameter\"", "<Real start=\"-0.5\"/>"),
        ];
        xml.replace("</ModelVariables>", &format!("{}</ModelVariables>", aliases.concat()))
    });
    let fmu = folder.open();
    let options = SimulateOptions::new().final_time(2.0).ncp(20).relative_tolerance(1e-9);
    let inputs = |u: &str, gear: &str, enabled: &str, sign: f64, on: f64| {
        Inputs::new()
            .series(u, vec![0.0, 1.0, 2.0], vec![0.0, sign, 0.5 * sign])
            .series(gear, vec![0.0, 0.5], vec![sign, 2.0 * sign])
            .series(enabled, vec![0.0, 1.5], vec![on, 1.0 - on])
    };
    let plain = options
        .clone()
        .start_value("T", 0.25)
        .inputs(inputs("u", "gear", "enabled", 1.0, 1.0))
        .outputs(["x", "u", "gear", "enabled"]);
    let negated = options
        .start_value("-T", -0.25)
        .inputs(inputs("-u", "-gear", "not enabled", -1.0, 0.0))
        .outputs(["-x", "-u", "-gear", "not enabled"]);
    let (plain, negated) = (fmu.simulate(&plain).unwrap(), fmu.simulate(&negated).unwrap());
    assert!(plain.final_value("x").unwrap().unwrap() > 0.1);
    for column in 0..3 {
        for (a, b) in plain.columns[column].iter().zip(&negated.columns[column]) {
            assert_eq!(*a, -*b, "column {column}");
        }
    }
    for (a, b) in plain.columns[3].iter().zip(&negated.columns[3]) {
        assert_eq!(*a, 1.0 - *b);
    }
    // As a parameter of a run, and when it is read.
    let options = SimulateOptions::new().final_time(0.1).parameters(["-T"]);
    let plan = Arc::new(SimulationPlan::new(&fmu, &options).unwrap());
    let mut simulator = fmi::Simulator::new(plan).unwrap();
    simulator.run(&[-0.75], &mut fmi::ode::Ignore).unwrap();
    assert_eq!(simulator.value("T").unwrap(), Value::Real(0.75));
    assert_eq!(simulator.value("-T").unwrap(), Value::Real(-0.75));
    assert_eq!(simulator.value("-gear").unwrap(), Value::Integer(-1));
    assert_eq!(simulator.value("not enabled").unwrap(), Value::Boolean(false));
}

#[test]
fn scheduled_execution_is_described_but_not_run() {
    let folder = support::model_as("dahlquist", ExampleKind::Fmi3, &[], |xml| {
        let at = xml.find("<ModelExchange").unwrap();
        let end = xml.find("<UnitDefinitions").or(xml.find("<LogCategories")).unwrap();
        format!("{}<ScheduledExecution modelIdentifier=\"dahlquist\"/>\n  {}", &xml[..at], &xml[end..])
    });
    let fmu = folder.open();
    assert!(fmu.description().offers_scheduled_execution);
    let error = fmu.simulate(&SimulateOptions::new()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "Dahlquist does not support model exchange or co-simulation; it supports scheduled execution"
    );
}
