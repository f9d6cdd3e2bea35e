//! Co-simulations that call back during their steps and end them early (FMI 3.0).

#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::description::QuirkKind;
use fmi::ode::ErrorKind;
use fmi::{FmiError, Inputs, SimulateOptions, SimulationPlan, Simulator};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use support::{fixture, fixture_with};

/// u = v = t.
fn ramp() -> SimulateOptions {
    let line = || (vec![0.0, 3.0], vec![0.0, 3.0]);
    let inputs = Inputs::new().series("u", line().0, line().1).series("v", line().0, line().1);
    SimulateOptions::new().inputs(inputs).times([0.0, 1.0, 2.0, 3.0])
}

#[test]
fn inputs_are_exact_within_steps_and_events_end_them_early() {
    let folder = fixture("intermediate", |xml| xml);
    let fmu = folder.open();
    assert!(fmu.description().quirks.is_empty(), "{:?}", fmu.description().quirks);
    let plan = Arc::new(SimulationPlan::new(&fmu, &ramp()).unwrap());
    let mut simulator = Simulator::new(plan).unwrap();
    let result = simulator.trajectory(&[]).unwrap();
    for (t, x) in result.time.iter().zip(result.get("x").unwrap()) {
        assert!((x - 0.5 * t * t).abs() < 1e-13, "x({t}) = {x}");
    }
    // x = t^2 / 2 is 1 at 1.414 and 3 at 2.449; substeps of 0.05 end behind.
    let events: Vec<f64> = result.events.iter().map(|event| event.time).collect();
    assert!(
        events.len() == 2 && (events[0] - 1.45).abs() < 1e-14 && (events[1] - 2.45).abs() < 1e-14,
        "{events:?}"
    );
    assert!(result.events.iter().all(|event| event.cause.step));
    assert_eq!(result.get("level").unwrap(), [1.0, 1.0, 3.0, 5.0]);
    assert_eq!(result.stats.accepted_steps, 8);
    // 6 steps of 0.5, two of them in two parts: nine substeps, then ten.
    assert_eq!(result.final_value("updates").unwrap(), Some(78.0));
    assert_eq!(result.final_value("misuse").unwrap(), Some(0.0));
    // v is held from each communication point: the sum of t h over the points.
    let points = [0.0, 0.5, 1.0, 1.45, 1.5, 2.0, 2.45, 2.5, 3.0];
    let held: f64 = points.windows(2).map(|pair| pair[0] * (pair[1] - pair[0])).sum();
    assert!((result.final_value("w").unwrap().unwrap() - held).abs() < 1e-13);
    assert_eq!(simulator.trajectory(&[]).unwrap(), result);
}

#[test]
fn what_the_model_does_not_offer_is_not_used() {
    // No inputs between communication points: u is held, too.
    let folder = fixture("intermediate", |xml| xml.replace(" intermediateUpdate=\"true\"", ""));
    let result = folder.open().simulate(&ramp()).unwrap();
    assert!((result.final_value("x").unwrap().unwrap() - 4.5).abs() > 0.1);
    // No early return: events wait for the end of a step of 0.5 or are not noticed.
    let folder = fixture("intermediate", |xml| {
        xml.replace("mightReturnEarlyFromDoStep=\"true\"", "")
            .replace("canReturnEarlyAfterIntermediateUpdate=\"true\"", "")
    });
    let result = folder.open().simulate(&ramp()).unwrap();
    assert_eq!((result.events.len(), result.stats.accepted_steps), (0, 6));
    assert_eq!(result.final_value("misuse").unwrap(), Some(0.0));
    assert!((result.final_value("x").unwrap().unwrap() - 4.5).abs() < 1e-13);
}

#[test]
fn an_event_mode_that_is_promised_and_refused_is_done_without() {
    let folder = fixture_with("intermediate", &["NO_EVENT_MODE"], |xml| {
        xml.replace("mightReturnEarlyFromDoStep=\"true\"", "")
            .replace("canReturnEarlyAfterIntermediateUpdate=\"true\"", "")
    });
    let fmu = folder.open();
    assert!(fmu.quirks_seen().is_empty());
    let plan = Arc::new(SimulationPlan::new(&fmu, &ramp()).unwrap());
    let mut simulator = Simulator::new(plan).unwrap();
    let first = simulator.trajectory(&[]).unwrap();
    assert_eq!((first.events.len(), first.stats.accepted_steps), (0, 6));
    assert!((first.final_value("x").unwrap().unwrap() - 4.5).abs() < 1e-13);
    assert_eq!(simulator.trajectory(&[]).unwrap(), first);
    let seen = fmu.quirks_seen();
    assert!(seen.len() == 1 && seen[0].kind == QuirkKind::Promise, "{seen:?}");

    // A model that cannot be made at all says so for the first attempt, and nothing is learnt of it.
    let folder =
        fixture_with("intermediate", &["NO_EVENT_MODE"], |xml| xml.replace("{intermediate}", "{other}"));
    let fmu = folder.open();
    let error = fmu.simulate(&ramp()).unwrap_err().to_string();
    assert!(
        error.contains("fmi3InstantiateCoSimulation") && error.contains("there is no event mode"),
        "{error}"
    );
    assert!(fmu.quirks_seen().is_empty());
}

#[test]
fn a_cancelled_run_ends_within_the_step() {
    let folder = fixture("intermediate", |xml| xml);
    let cancel = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&cancel);
    let inputs = Inputs::new().function("u", move |t| {
        if t > 2.12 {
            flag.store(true, Ordering::Relaxed);
        }
        0.1 * t
    });
    let options = SimulateOptions::new().inputs(inputs).step_size(1.0).times([0.0, 3.0]).cancel(cancel);
    match folder.open().simulate(&options).unwrap_err() {
        FmiError::Simulation(error) => {
            assert!(matches!(error.kind, ErrorKind::Cancelled));
            // Noticed in the substep up to 2.2, which ends the step from 2 to 3.
            assert!((error.time - 2.2).abs() < 1e-12, "{}", error.time);
        }
        other => panic!("{other}"),
    }
}

#[test]
fn callbacks_at_a_wrong_time_are_answered_and_ignored() {
    let folder = fixture_with("intermediate", &["MISUSE"], |xml| xml);
    let result = folder.open().simulate(&ramp()).unwrap();
    assert_eq!(result.final_value("misuse").unwrap(), Some(0.0));
    assert!((result.final_value("x").unwrap().unwrap() - 4.5).abs() < 1e-13);
}

#[test]
fn a_refused_input_ends_the_run() {
    let folder = fixture_with("intermediate", &["REFUSES"], |xml| xml);
    let error = folder.open().simulate(&ramp()).unwrap_err();
    assert!(matches!(error, FmiError::Simulation(_)) && error.to_string().contains("fmi3DoStep"), "{error}");
}

#[test]
fn single_steps_by_hand_call_back_without_consequence() {
    let folder = fixture("intermediate", |xml| xml);
    let fmu = folder.open();
    let instance = fmu.instantiate_co_simulation(&fmi::InstanceOptions::default()).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    instance.set("u", 2.0).unwrap();
    let outcome = instance.do_step(0.0, 1.0).unwrap();
    // x = 2 t reaches 1 with the fifth substep.
    assert!(!outcome.complete && outcome.event && !outcome.terminate, "{outcome:?}");
    assert_eq!(outcome.reached, Some(0.5));
    let events = instance.handle_events(0.5).unwrap();
    assert!(!events.terminate);
    assert!(instance.do_step(0.5, 0.25).unwrap().complete);
    assert_eq!(instance.get("x").unwrap(), 1.5.into());
}

#[test]
fn samples_between_communication_points_take_the_derivatives_of_outputs_into_account() {
    let fixed = |order: &str| {
        let order = order.to_owned();
        fixture("intermediate", move |xml| {
            xml.replace("canHandleVariableCommunicationStepSize=\"true\"", &order)
        })
    };
    let options = SimulateOptions { times: Some(vec![0.2, 0.7, 1.0, 1.3]), ..ramp() };
    let folder = fixed("maxOutputDerivativeOrder=\"1\"");
    let result = folder.open().simulate(&options).unwrap();
    // x = t^2 / 2 is the parabola through both ends of a step with the slope at its end.
    for (t, x) in result.time.iter().zip(result.get("x").unwrap()) {
        assert!((x - 0.5 * t * t).abs() < 1e-14, "x({t}) = {x}");
    }
    // Nobody offers derivatives: the chord, h^2 / 8 off at most.
    let folder = fixed("");
    let result = folder.open().simulate(&options).unwrap();
    let chord = 0.125 * 0.4;
    assert!((result.get("x").unwrap()[0] - chord).abs() < 1e-14);
}
