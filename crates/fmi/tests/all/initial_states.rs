//! Initial states whose start values the initialization overrides, and states that must keep their values.

#![allow(clippy::unwrap_used)]

use crate::support::{Folder, evil_with, faulty};
use example_models::ExampleKind;
use fmi::description::QuirkKind;
use fmi::{FmiError, SimulateOptions, SimulationPlan, Simulator};
use std::sync::Arc;

/// Model of x' = -x. The initialization sets x to 3, whatever its start value is.
fn computing(initial: &str, is_co_simulation: bool) -> Folder {
    evil_with(&["COMPUTES_X=3"], |xml| {
        let start = if initial == "calculated" { "" } else { " start=\"1\"" };
        let xml = xml.replace(
            "initial=\"exact\"><Real start=\"1\"/>",
            &format!("initial=\"{initial}\"><Real{start}/>"),
        );
        let interface =
            "<CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"true\"/>";
        match is_co_simulation {
            true => xml.replace("<ModelExchange modelIdentifier=\"evil\"/>", interface),
            false => xml,
        }
    })
}

fn options() -> SimulateOptions {
    SimulateOptions::new().ncp(4).relative_tolerance(1e-10)
}

fn is_decay_from(trajectory: &fmi::Trajectory, x0: f64) {
    for (t, x) in trajectory.time.iter().zip(trajectory.get("x").unwrap()) {
        assert!((x - x0 * (-t).exp()).abs() < 1e-8, "x({t}) = {x}");
    }
}

#[test]
fn initial_state_is_set_after_the_initialization_in_model_exchange() {
    for initial in ["exact", "approx", "calculated"] {
        let folder = computing(initial, false);
        let fmu = folder.open();
        is_decay_from(&fmu.simulate(&options()).unwrap(), 3.0);
        is_decay_from(&fmu.simulate(&options().initial_state("x", 2.0)).unwrap(), 2.0);
        // A parameter of the run, on instances that are used again.
        let mut fitted = options().parameters(["x", "k"]);
        fitted.initial_states = vec!["x".to_owned()];
        let mut simulator = Simulator::new(Arc::new(SimulationPlan::new(&fmu, &fitted).unwrap())).unwrap();
        for x0 in [2.0, -0.5, 3.0, 2.0] {
            is_decay_from(&simulator.trajectory(&[x0, 1.0]).unwrap(), x0);
        }
    }
}

#[test]
fn initial_state_is_set_in_every_version() {
    use ExampleKind::{Fmi1ModelExchange, Fmi2ModelExchange, Fmi3};
    for kind in [Fmi1ModelExchange, Fmi2ModelExchange, Fmi3] {
        let folder = faulty(kind, &["COMPUTES_X=3"]);
        let options = options().final_time(1.0);
        is_decay_from(&folder.open().simulate(&options).unwrap(), 3.0);
        is_decay_from(&folder.open().simulate(&options.initial_state("x", 2.0)).unwrap(), 2.0);
    }
}

#[test]
fn start_value_without_effect_is_a_quirk_and_not_settable_if_calculated() {
    for is_co_simulation in [false, true] {
        let folder = computing("approx", is_co_simulation);
        let fmu = folder.open();
        is_decay_from(&fmu.simulate(&options().start_value("x", 2.0)).unwrap(), 3.0);
        let quirks = fmu.quirks_seen();
        assert!(
            quirks.len() == 1
                && quirks[0].kind == QuirkKind::Start
                && quirks[0].message.starts_with("x was set to the start value 2, but is 3 after the init"),
            "{quirks:?}"
        );
        assert!(fmu.ineffective_start_value("x", 2.0).is_some());
        assert!(fmu.ineffective_start_value("x", 2.5).is_none());
        let folder = computing("calculated", is_co_simulation);
        let error = folder.open().simulate(&options().start_value("x", 2.0)).unwrap_err();
        assert!(matches!(error, FmiError::NotSettable { .. }), "{error}");
    }
    // A start value that takes effect is not a quirk.
    let folder = computing("approx", false);
    let fmu = folder.open();
    fmu.simulate(&options().start_value("x", 3.0)).unwrap();
    assert!(fmu.quirks_seen().is_empty());
}

#[test]
fn initial_state_without_effect_is_rejected_in_co_simulation() {
    for initial in ["exact", "approx"] {
        let folder = computing(initial, true);
        let fmu = folder.open();
        for _ in 0..2 {
            let error = fmu.simulate(&options().initial_state("x", 2.0)).unwrap_err();
            assert!(
                matches!(&error, FmiError::StateNotTaken { name, given: 2.0, found: 3.0 } if name == "x"),
                "{error}"
            );
        }
        is_decay_from(&fmu.simulate(&options().initial_state("x", 3.0)).unwrap(), 3.0);
    }
}
