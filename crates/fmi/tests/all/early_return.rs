//! Co-simulations that end their steps early (FMI 3.0).

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::description::QuirkKind;
use fmi::ode::Termination;
use fmi::{BetweenSteps, Inputs, SimulateOptions, SimulationPlan, Simulator};
use std::sync::Arc;
use support::{fixture, fixture_with};

/// u = t, in steps of 0.5.
fn ramp() -> SimulateOptions {
    let inputs = Inputs::new().series("u", vec![0.0, 3.0], vec![0.0, 3.0]);
    SimulateOptions::new().inputs(inputs).times([0.0, 1.0, 2.0, 3.0]).step_size(0.5)
}

/// Returns x if u is held from each of these points to the next.
fn held(points: &[f64]) -> f64 {
    points.windows(2).map(|pair| pair[0] * (pair[1] - pair[0])).sum()
}

const GRID: [f64; 7] = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0];

#[test]
fn early_return_handles_events_within_steps() {
    let folder = fixture("early_return", |xml| xml);
    let fmu = folder.open();
    assert!(fmu.description().quirks.is_empty(), "{:?}", fmu.description().quirks);
    let plan = Arc::new(SimulationPlan::new(&fmu, &ramp()).unwrap());
    let mut simulator = Simulator::new(plan).unwrap();
    let result = simulator.trajectory(&[]).unwrap();
    // x is 1 at 1.667 and 3 at 2.676. The events are at the ends of the substeps of 0.05.
    let events: Vec<f64> = result.events.iter().map(|event| event.time).collect();
    assert!(
        events.len() == 2 && (events[0] - 1.7).abs() < 1e-14 && (events[1] - 2.7).abs() < 1e-14,
        "{events:?}"
    );
    assert!(result.events.iter().all(|event| event.cause.step));
    assert_eq!(result.get("level").unwrap(), [1.0, 1.0, 3.0, 5.0]);
    assert_eq!(result.stats.accepted_steps, 8);
    let expected = held(&[0.0, 0.5, 1.0, 1.5, 1.7, 2.0, 2.5, 2.7, 3.0]);
    assert!((result.final_value("x").unwrap().unwrap() - expected).abs() < 1e-13);
    assert_eq!(simulator.trajectory(&[]).unwrap(), result);
}

#[test]
fn early_return_is_unused_when_not_declared() {
    // Without early return, events wait for the end of a step of 0.5, or are not detected.
    let folder = fixture("early_return", |xml| xml.replace("mightReturnEarlyFromDoStep=\"true\"", ""));
    let result = folder.open().simulate(&ramp()).unwrap();
    assert_eq!((result.events.len(), result.stats.accepted_steps), (0, 6));
    assert!((result.final_value("x").unwrap().unwrap() - held(&GRID)).abs() < 1e-13);
}

#[test]
fn event_mode_is_omitted_when_model_rejects_it() {
    let folder = fixture_with("early_return", &["NO_EVENT_MODE"], |xml| {
        xml.replace("mightReturnEarlyFromDoStep=\"true\"", "")
    });
    let fmu = folder.open();
    assert!(fmu.quirks_seen().is_empty());
    let plan = Arc::new(SimulationPlan::new(&fmu, &ramp()).unwrap());
    let mut simulator = Simulator::new(plan).unwrap();
    let first = simulator.trajectory(&[]).unwrap();
    assert_eq!((first.events.len(), first.stats.accepted_steps), (0, 6));
    assert!((first.final_value("x").unwrap().unwrap() - held(&GRID)).abs() < 1e-13);
    assert_eq!(simulator.trajectory(&[]).unwrap(), first);
    let seen = fmu.quirks_seen();
    assert!(seen.len() == 1 && seen[0].kind == QuirkKind::Promise, "{seen:?}");

    // If a model cannot be instantiated at all, the first attempt reports the error, and the knowledge does
    // not change.
    let folder =
        fixture_with("early_return", &["NO_EVENT_MODE"], |xml| xml.replace("{early_return}", "{other}"));
    let fmu = folder.open();
    let error = fmu.simulate(&ramp()).unwrap_err().to_string();
    assert!(
        error.contains("fmi3InstantiateCoSimulation") && error.contains("there is no event mode"),
        "{error}"
    );
    assert!(fmu.quirks_seen().is_empty());
}

#[test]
fn manual_step_returns_early() {
    let folder = fixture("early_return", |xml| xml);
    let fmu = folder.open();
    let instance = fmu.instantiate_co_simulation(&fmi::InstanceOptions::default()).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    instance.set("u", 2.0).unwrap();
    let outcome = instance.do_step(0.0, 1.0).unwrap();
    // x = 2 t reaches 1 in the fifth substep.
    assert!(!outcome.complete && outcome.event && !outcome.terminate, "{outcome:?}");
    assert_eq!(outcome.reached, Some(0.5));
    let events = instance.handle_events(0.5).unwrap();
    assert!(!events.terminate);
    assert!(instance.do_step(0.5, 0.25).unwrap().complete);
    assert_eq!(instance.get("x").unwrap(), 1.5.into());
}

#[test]
fn samples_between_communication_points_use_output_derivatives() {
    let fixed = |order: &str| {
        let order = order.to_owned();
        fixture("early_return", move |xml| {
            xml.replace("canHandleVariableCommunicationStepSize=\"true\"", &order)
        })
    };
    let options = SimulateOptions { times: Some(vec![0.2, 0.7, 1.0, 1.3]), ..ramp() };
    let folder = fixed("maxOutputDerivativeOrder=\"1\"");
    let result = folder.open().simulate(&options).unwrap();
    // u is held in each step. w is the parabola through both ends with the slope at the end of the step.
    for (found, expected) in result.get("w").unwrap().iter().zip([0.0, 0.01, 0.0625, 0.1825]) {
        assert!((found - expected).abs() < 1e-14, "{found}, not {expected}");
    }
    // Without derivatives, samples are on the chord.
    let folder = fixed("");
    let result = folder.open().simulate(&options).unwrap();
    assert!((result.get("w").unwrap()[1] - 0.4 * 0.0625).abs() < 1e-14);
}

/// x' = 1 with internal steps of 0.1, regardless of the requested steps.
fn internal_steps(declared: bool) -> support::Folder {
    fixture_with("early", &["INTERNAL_STEPS"], |xml| match declared {
        true => xml.replace("mightReturnEarlyFromDoStep=\"true\"", "fixedInternalStepSize=\"0.1\""),
        false => xml.replace("mightReturnEarlyFromDoStep=\"true\"", ""),
    })
}

#[test]
fn rows_between_internal_steps_are_interpolated_or_rejected() {
    let folder = internal_steps(true);
    let fmu = folder.open();
    for times in [vec![0.0, 0.2, 0.25, 1.0], vec![0.03, 0.04, 0.11, 0.97]] {
        for step in [None, Some(0.1), Some(0.3)] {
            let mut options = SimulateOptions::new().times(times.clone());
            options.run.step_size = step;
            options.final_time = times.last().copied();
            let result = fmu.simulate(&options).unwrap();
            for (t, x) in times.iter().zip(result.get("x").unwrap()) {
                assert!((x - t).abs() < 1e-14, "{x} at {t} with {step:?}");
            }
        }
    }
    let refused = |times: &[f64]| {
        let options = SimulateOptions::new().times(times).between_steps(BetweenSteps::Refuse);
        fmu.simulate(&options).map_err(|error| error.to_string())
    };
    let error = refused(&[0.0, 0.2, 0.25, 1.0]).unwrap_err();
    assert!(error.contains("t = 0.25") && error.contains("0.2 and 0.3"), "{error}");
    assert_eq!(refused(&[0.0, 0.2, 0.3, 1.0]).unwrap().get("x").unwrap().len(), 4);
    assert!(fmu.quirks_seen().is_empty(), "{:?}", fmu.quirks_seen());
}

#[test]
fn inputs_change_at_internal_steps() {
    // A stop between two internal steps does not create a point between them.
    let folder = fixture_with("early", &["INTERNAL_STEPS"], |xml| {
        let input = "<Float64 name=\"u\" valueReference=\"2\" causality=\"input\" variability=\"continuous\" start=\"0\"/>";
        xml.replace("mightReturnEarlyFromDoStep=\"true\"", "fixedInternalStepSize=\"0.1\"")
            .replace("</ModelVariables>", &format!("{input}</ModelVariables>"))
    });
    let inputs = Inputs::new().series("u", vec![0.0, 0.25, 0.26, 1.0], vec![0.0, 0.0, 1.0, 1.0]);
    let options = SimulateOptions::new().times([0.0, 1.0]).step_size(0.5).inputs(inputs);
    let result = folder.open().simulate(&options).unwrap();
    // 0.2, 0.3, 0.5 and 1.
    assert_eq!(result.stats.accepted_steps, 4);
}

#[test]
fn time_after_step_is_always_read() {
    let folder = internal_steps(false);
    let fmu = folder.open();
    let instance = fmu.instantiate_co_simulation(&fmi::InstanceOptions::default()).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    let outcome = instance.do_step(0.0, 0.25).unwrap();
    assert!(outcome.complete && !outcome.early, "{outcome:?}");
    assert_eq!(outcome.reached, Some(0.2));
    fmu.simulate(&SimulateOptions::new().times([0.0, 0.25, 1.0])).unwrap();
    let seen = fmu.quirks_seen();
    assert!(seen.len() == 1 && seen[0].kind == QuirkKind::Promise, "{seen:?}");
    assert!(seen[0].message.contains("to 0.25, the model is at 0.2"), "{seen:?}");
}

#[test]
fn event_mode_is_not_entered_after_termination() {
    let folder = fixture_with("early", &["ENDS_IN_EVENT"], |xml| {
        xml.replace("mightReturnEarlyFromDoStep=\"true\"", "hasEventMode=\"true\"")
    });
    let result = folder.open().simulate(&SimulateOptions::new().ncp(4)).unwrap();
    assert_eq!((result.termination, result.end_time), (Termination::StoppedByModel, 0.5));
    assert_eq!(result.time, [0.0, 0.25, 0.5]);
    assert!(result.events.is_empty());
}
