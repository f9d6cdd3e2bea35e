//! Resets of instances, with values set before and after the reset.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::{Fmu, InterfaceChoice, Session, SimulateOptions, SimulationPlan, Simulator};
use std::sync::Arc;
use support::{Folder, evil_with};

/// Evil model that declares saved states for both interfaces.
fn with_states(faults: &[&str]) -> Folder {
    let faults: Vec<&str> = faults.iter().copied().chain(["STATES"]).collect();
    evil_with(&faults, |xml| {
        let able = "modelIdentifier=\"evil\" canGetAndSetFMUstate=\"true\"";
        xml.replace(
            "<ModelExchange modelIdentifier=\"evil\"/>",
            &format!("<ModelExchange {able}/><CoSimulation {able} canHandleVariableCommunicationStepSize=\"true\"/>"),
        )
    })
}

fn options(kind: InterfaceChoice) -> SimulateOptions {
    SimulateOptions::new().parameters(["k"]).kind(kind)
}

fn plan(fmu: &Fmu, kind: InterfaceChoice) -> Arc<SimulationPlan> {
    Arc::new(SimulationPlan::new(fmu, &options(kind)).unwrap())
}

#[test]
fn simulator_creates_a_new_instance_when_reset_fails() {
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let folder = with_states(&["FAILING_RESET"]);
        let mut simulator = Simulator::new(plan(&folder.open(), kind)).unwrap().resetting();
        for k in [1.0, 2.0, 1.0, 0.5, 1.0] {
            let options = SimulateOptions::new().start_value("k", k).kind(kind);
            let truth = folder.open().simulate(&options).unwrap();
            assert_eq!(simulator.trajectory(&[k]).unwrap().columns, truth.columns, "{k}");
        }
    }
}

/// New instances do not have the specified value either. The instances are not at fault, but fitting this
/// parameter would be useless.
#[test]
fn parameter_overridden_by_the_model_is_an_error() {
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let folder = with_states(&["OVERRIDES_K"]);
        let fmu = folder.open();
        let mut simulator = Simulator::new(plan(&fmu, kind)).unwrap();
        for k in [1.0, 2.0, 3.0, 1.0] {
            let message = simulator.trajectory(&[k]).unwrap_err().to_string();
            let expected = format!(
                "k was set to {k}, but is 1.5 after the initialization. The model computes the value itself"
            );
            assert!(message.contains(&expected), "{message}");
        }
        // The value that the model sets is accepted.
        simulator.trajectory(&[1.5]).unwrap();
    }
}

/// Models of 20-sim create their data in `setupExperiment`.
#[test]
fn values_are_set_after_setup_experiment() {
    let truth = |k: f64, x: f64| x * (-k).exp();
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let folder = with_states(&["BEGINS_IN_SETUP"]);
        let fmu = folder.open();
        let options =
            options(kind).start_value("x", 3.0).final_time(1.0).relative_tolerance(1e-9).outputs(["x"]);
        let mut simulator = Simulator::new(Arc::new(SimulationPlan::new(&fmu, &options).unwrap())).unwrap();
        for k in [2.0, 0.5, 2.0] {
            let x = simulator.trajectory(&[k]).unwrap().get("x").unwrap().to_vec();
            let (last, expected) = (x[x.len() - 1], truth(k, 3.0));
            assert!(
                x[0] == 3.0 && (kind == InterfaceChoice::CoSimulation || (last - expected).abs() < 1e-7),
                "{kind:?} {k}: {last}"
            );
            assert!((last - expected).abs() < 0.05, "{kind:?} {k}: {last} {expected}");
        }
    }
    let folder = with_states(&["BEGINS_IN_SETUP"]);
    let mut instance = folder.open().instantiate().unwrap();
    instance.set("k", 2.0).unwrap();
    instance.set("x", 3.0).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    let values = ["k", "x"].map(|name| instance.get(name).unwrap());
    assert_eq!(values, [fmi::Value::Real(2.0), fmi::Value::Real(3.0)]);
}

#[test]
fn tolerance_is_passed_to_the_model_when_specified() {
    let folder = with_states(&["TELLS_TOLERANCE"]);
    let reported = |options: SimulateOptions| {
        let options = options.final_time(1.0).outputs(["k"]);
        folder.open().simulate(&options).unwrap().get("k").unwrap()[0]
    };
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = || SimulateOptions::new().kind(kind);
        assert_eq!((reported(options()), reported(options().relative_tolerance(1e-4))), (-1.0, 1e-4));
    }
    let stated = evil_with(&["TELLS_TOLERANCE"], |xml| {
        xml.replace("stopTime=\"1\"", "stopTime=\"1\" tolerance=\"1e-3\"")
    });
    let options = SimulateOptions::new().final_time(1.0).outputs(["k"]);
    assert_eq!(stated.open().simulate(&options).unwrap().get("k").unwrap()[0], 1e-3);
}

#[test]
fn simulation_is_repeatable_when_reset_is_incomplete() {
    // Reset leaves a parameter slightly wrong, which becomes visible only after the first step.
    let step = "<CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"true\"/>";
    let folder =
        evil_with(&["LYING_RESET"], |xml| xml.replace("<ModelExchange modelIdentifier=\"evil\"/>", step));
    let truth = folder.open().simulate(&SimulateOptions::new()).unwrap();
    let fmu = folder.open();
    for _ in 0..3 {
        assert_eq!(Session::new(fmu.clone()).get("y").unwrap(), 1.0.into());
    }
    for _ in 0..3 {
        assert_eq!(fmu.simulate(&SimulateOptions::new()).unwrap().columns, truth.columns);
    }
}
