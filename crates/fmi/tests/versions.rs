//! One model in every version of the standard: the same results.

#![allow(clippy::unwrap_used, clippy::panic)]

use fmi::ode::Termination;
use fmi::{
    ExampleKind, FmiError, Fmu, Inputs, Kind, Pool, Reuse, Session, SimulateOptions, SimulationPlan,
    Trajectory, Value,
};
use std::sync::Arc;

const MODELS: [(&str, f64); 6] = [
    ("dahlquist", 5.0),
    ("van_der_pol", 5.0),
    ("bouncing_ball", 2.9),
    ("stair", 8.5),
    ("furuta", 5.0),
    ("switched_input", 3.0),
];

fn open(name: &str, kind: ExampleKind) -> Fmu {
    Fmu::open(fmi::example_fmu_as(name, kind).unwrap()).unwrap()
}

fn truth(name: &str, options: &SimulateOptions) -> Trajectory {
    open(name, ExampleKind::Fmi2ModelExchange).simulate(options).unwrap()
}

/// Names, times and events are the same, values within a tolerance.
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
fn model_exchange_has_the_same_bits_in_all_versions() {
    for (name, end) in MODELS {
        let options =
            SimulateOptions::new().final_time(end).ncp(97).relative_tolerance(1e-8).record_events(true);
        let truth = truth(name, &options);
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
        let options = options.kind(Kind::CoSimulation);
        let two = open(name, ExampleKind::Fmi2CoSimulation).simulate(&options).unwrap();
        agree(name, &truth, &two, 1e-6);
        let one = open(name, ExampleKind::Fmi1CoSimulation).simulate(&options).unwrap();
        agree(name, &two, &one, 0.0);
        let three = open(name, ExampleKind::Fmi3).simulate(&options).unwrap();
        agree(name, &two, &three, 1e-9);
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
    for kind in ExampleKind::ALL {
        let fmu = open("switched_input", kind);
        agree(&format!("{kind:?}"), &truth, &fmu.simulate(&options).unwrap(), 1e-6);
    }
    // FMI 3.0 knows no input derivatives: held over steps of 1 ms they are good enough for this.
    let fmu = open("switched_input", ExampleKind::Fmi3);
    let options = options.kind(Kind::CoSimulation).step_size(1e-3);
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
    let options = SimulateOptions::new().final_time(2.0).ncp(4).kind(Kind::CoSimulation);
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
fn a_second_run_has_the_same_bits_in_all_versions() {
    let options = SimulateOptions::new()
        .final_time(1.0)
        .ncp(10)
        .parameters(["armFriction", "pendulumFriction"])
        .outputs(["armJoint.phi", "pendulumJoint.phi"]);
    for kind in ExampleKind::ALL {
        let pool = Pool::new(Arc::new(SimulationPlan::new(&open("furuta", kind), &options).unwrap()));
        let first = pool.lend().unwrap().trajectory(&[0.012, 0.002]).unwrap();
        let other = pool.lend().unwrap().trajectory(&[0.010, 0.001]).unwrap();
        assert_ne!(first.columns, other.columns);
        assert_eq!(pool.lend().unwrap().trajectory(&[0.012, 0.002]).unwrap(), first);
        assert!(pool.is_concurrent().unwrap());
        // FMI 1.0 has no reset for model exchange.
        let expected = match kind {
            ExampleKind::Fmi1ModelExchange => Reuse::Reinstantiate,
            _ => Reuse::Reset,
        };
        assert_eq!(pool.reuse().unwrap(), expected, "{kind:?}");
    }
}

#[test]
fn values_and_errors_of_all_versions() {
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
    assert!(matches!(error, Err(FmiError::MissingFunction { .. })));
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
