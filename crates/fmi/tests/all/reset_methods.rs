//! The ways of bringing an instance back to its beginning, and how liars among them are found out.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use example_models::{ExampleKind, example_fmu_as};
use fmi::ode::Ignore;
use fmi::{Fmu, InterfaceChoice, InterfaceKind, Reuse, Session, SimulateOptions, SimulationPlan, Simulator};
use std::sync::Arc;
use support::{Folder, evil, evil_with, model, settle};

/// An evil model that says it can save and restore states, of both kinds.
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

const KINDS: [InterfaceChoice; 2] = [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation];

fn interface(kind: InterfaceChoice) -> InterfaceKind {
    if kind == InterfaceChoice::CoSimulation {
        InterfaceKind::CoSimulation
    } else {
        InterfaceKind::ModelExchange
    }
}

/// What new instances give.
fn truths(folder: &Folder, kind: InterfaceChoice) -> Vec<(f64, Vec<f64>)> {
    let run = |k: f64| {
        let options = SimulateOptions::new().start_value("k", k).kind(kind);
        (k, folder.open().simulate(&options).unwrap().get("y").unwrap().to_vec())
    };
    [1.0, 2.0, 1.0, 0.5, 3.0, 1.0].map(run).to_vec()
}

/// Runs with many values have the bits of new instances, before the check and after it; how it is done.
fn check(faults: &[&str], kind: InterfaceChoice) -> Reuse {
    let folder = with_states(faults);
    let truths = truths(&folder, kind);
    let fmu = folder.open();
    let mut simulator = Simulator::new(plan(&fmu, kind)).unwrap();
    let mut known = None;
    for round in 0.. {
        for (k, truth) in &truths {
            assert_eq!(simulator.trajectory(&[*k]).unwrap().get("y").unwrap(), truth, "{faults:?} {k}");
        }
        // Again with what was found out.
        let before = std::mem::replace(&mut known, fmu.reuse_of(interface(kind)));
        if before.is_some() && before == known {
            break;
        }
        assert!(round < 1000);
    }
    known.unwrap()
}

#[test]
fn a_saved_state_comes_first_where_it_is_right() {
    let kind = InterfaceChoice::ModelExchange;
    assert_eq!(check(&[], kind), Reuse::Restore);
    // It does not matter what the reset function does.
    assert_eq!(check(&["LYING_RESET"], kind), Reuse::Restore);
    assert_eq!(check(&["FAILING_RESET"], kind), Reuse::Restore);
}

/// The solver of a co-simulation need not be part of its saved states: some models abort when they start again from one.
#[test]
fn a_co_simulation_is_not_brought_back_by_a_saved_state() {
    let kind = InterfaceChoice::CoSimulation;
    assert_eq!(check(&[], kind), Reuse::Reset);
    assert_eq!(check(&["FAILING_RESET"], kind), Reuse::Reinstantiate);
}

#[test]
fn the_next_way_is_taken_where_states_do_not_come_back() {
    for kind in KINDS {
        for fault in ["SAVE_FAILS", "RESTORE_FAILS", "RESTORE_FORGETS", "RESTORE_STICKS"] {
            assert_eq!(check(&[fault], kind), Reuse::Reset, "{fault}");
        }
        assert_eq!(check(&["RESTORE_FORGETS", "RESET_TO_ZERO"], kind), Reuse::Reinstantiate);
        assert_eq!(check(&["SAVE_FAILS", "FAILING_RESET"], kind), Reuse::Reinstantiate);
    }
}

#[test]
fn states_without_the_functions_are_not_used() {
    let folder = evil_with(&[], |xml| {
        xml.replace("modelIdentifier=\"evil\"", "modelIdentifier=\"evil\" canGetAndSetFMUstate=\"true\"")
    });
    assert_eq!(
        settle(&mut Simulator::new(plan(&folder.open(), InterfaceChoice::Auto)).unwrap(), &[1.0]),
        Reuse::Reset
    );
}

/// The model restores the old parameter at the end of the initialization, which the check sees in its runs with other values.
#[test]
fn parameters_that_a_restored_state_brings_back_are_seen() {
    let kind = InterfaceChoice::ModelExchange;
    let folder = with_states(&["RESTORE_STICKS"]);
    let fmu = folder.open();
    let mut simulator = Simulator::new(plan(&fmu, kind)).unwrap();
    let truth = |k: f64| {
        let options = SimulateOptions::new().start_value("k", k).kind(kind);
        folder.open().simulate(&options).unwrap().get("y").unwrap().to_vec()
    };
    assert_eq!(settle(&mut simulator, &[1.0]), Reuse::Reset);
    for k in [2.0, 3.0, 1.0, 2.0] {
        assert_eq!(simulator.trajectory(&[k]).unwrap().get("y").unwrap(), truth(k));
    }
    assert_eq!(fmu.reuse(), Some(Reuse::Reset));
}

/// New instances do not have the value given either: nothing is wrong with the restored ones, but a fit of it would be in vain.
#[test]
fn a_parameter_that_the_model_overrides_is_an_error() {
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let folder = with_states(&["OVERRIDES_K"]);
        let fmu = folder.open();
        let mut simulator = Simulator::new(plan(&fmu, kind)).unwrap();
        for k in [1.0, 2.0, 3.0, 1.0] {
            let message = simulator.trajectory(&[k]).unwrap_err().to_string();
            let expected = format!(
                "k was given the value {k}, and after the initialization it is 1.5: the model sets it"
            );
            assert!(message.contains(&expected), "{message}");
        }
        // That one is right.
        simulator.trajectory(&[1.5]).unwrap();
    }
}

/// As models of 20-sim do.
#[test]
fn values_are_set_after_the_model_made_its_data() {
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
fn a_tolerance_is_told_where_somebody_states_one() {
    let folder = with_states(&["TELLS_TOLERANCE"]);
    let told = |options: SimulateOptions| {
        let options = options.final_time(1.0).outputs(["k"]);
        folder.open().simulate(&options).unwrap().get("k").unwrap()[0]
    };
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = || SimulateOptions::new().kind(kind);
        assert_eq!((told(options()), told(options().relative_tolerance(1e-4))), (-1.0, 1e-4));
    }
    let stated = evil_with(&["TELLS_TOLERANCE"], |xml| {
        xml.replace("stopTime=\"1\"", "stopTime=\"1\" tolerance=\"1e-3\"")
    });
    let options = SimulateOptions::new().final_time(1.0).outputs(["k"]);
    assert_eq!(stated.open().simulate(&options).unwrap().get("k").unwrap()[0], 1e-3);
}

#[test]
fn the_bundled_models_come_back_by_their_states() {
    let folder = model("furuta");
    let options = SimulateOptions::new().final_time(2.0).parameters(["armFriction"]);
    let plan = Arc::new(SimulationPlan::new(&folder.open(), &options).unwrap());
    assert_eq!(settle(&mut Simulator::new(plan).unwrap(), &[0.01]), Reuse::Restore);
}

#[test]
fn a_reset_function_that_the_standard_does_not_have_is_no_quirk() {
    let fmu = Fmu::open(example_fmu_as("dahlquist", ExampleKind::Fmi1ModelExchange).unwrap()).unwrap();
    let mut simulator = Simulator::new(plan(&fmu, InterfaceChoice::ModelExchange)).unwrap();
    assert_eq!(settle(&mut simulator, &[1.0]), Reuse::Reinstantiate);
    assert_eq!(fmu.quirks_seen(), []);
}

#[test]
fn a_way_that_passed_while_more_was_set_says_nothing_of_other_plans() {
    // Reset leaves the state at 0, which runs that set it do not see.
    let folder = evil(&["RESET_TO_ZERO"]);
    let fmu = folder.open();
    let plain = SimulateOptions::new().kind(InterfaceChoice::ModelExchange);
    let truth = folder.open().simulate(&plain).unwrap();
    let setting = plain.clone().start_value("x", 1.0);
    for (options, reuse) in [(&setting, Reuse::Reset), (&plain, Reuse::Reinstantiate)] {
        let mut simulator = Simulator::new(Arc::new(SimulationPlan::new(&fmu, options).unwrap())).unwrap();
        // The verdict on the model is that of the first until the second has been checked.
        while simulator.run(&[], &mut Ignore).unwrap().stats.checks.runs == 0 {}
        assert_eq!(fmu.reuse(), Some(reuse));
        assert_eq!(simulator.trajectory(&[]).unwrap().columns, truth.columns);
    }
}

#[test]
fn initial_values_prove_nothing_about_reset() {
    // Reset leaves a parameter a little off, which shows after the first step only.
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
