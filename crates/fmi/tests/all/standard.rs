//! Requirements of the standard for steps, events and values, tested with models that depend on them.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use example_models::ExampleKind;
use fmi::ode::{Ignore, Method};
use fmi::{
    FmiError, Fmu, Inputs, InstanceOptions, SimulateOptions, SimulationPlan, Simulator, Trajectory, Value,
};
use std::sync::Arc;
use support::{evil, evil_with, faulty, fixture_with};

fn bits(t: &Trajectory) -> Vec<u64> {
    t.columns.iter().flatten().chain(&t.time).map(|v| v.to_bits()).collect()
}

fn slave(faults: &[&str], more: &str) -> support::Folder {
    evil_with(faults, |xml| {
        let interface = format!(
            "<CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"true\"{more}/>"
        );
        let input = r#"<ScalarVariable name="u" valueReference="7" causality="input" variability="continuous">
            <Real start="0"/></ScalarVariable></ModelVariables>"#;
        xml.replace("<ModelExchange modelIdentifier=\"evil\"/>", &interface)
            .replace("</ModelVariables>", input)
    })
}

#[test]
fn step_events_occur_in_all_versions() {
    use ExampleKind::{Fmi1CoSimulation, Fmi1ModelExchange, Fmi2CoSimulation, Fmi2ModelExchange, Fmi3};
    let kinds = [Fmi1ModelExchange, Fmi2ModelExchange, Fmi3, Fmi1CoSimulation, Fmi2CoSimulation, Fmi3];
    for (which, kind) in kinds.into_iter().enumerate() {
        // x' = 1, and x decreases by 1 after every completed step beyond 1.5.
        let folder = faulty(kind, &[]);
        let run = if which < 3 { fmi::InterfaceChoice::Auto } else { fmi::InterfaceChoice::CoSimulation };
        let options = SimulateOptions::new()
            .kind(run)
            .final_time(6.0)
            .ncp(60)
            .start_value("x", 0.0)
            .start_value("k", 22.0)
            .outputs(["x"])
            .max_step(0.125)
            .step_size(0.125);
        let options = if which < 3 { options.method(Method::Tsit5) } else { options };
        let result = folder.open().simulate(&options).unwrap();
        let x = result.get("x").unwrap();
        for (time, x) in result.time.iter().zip(x) {
            let turns = time - x;
            assert!((turns - turns.round()).abs() < 1e-9, "{kind:?} {run:?}: {x} at {time}");
            // A co-simulation without event mode makes internal steps of 1 ms.
            assert!(*x < 1.5 + 0.126, "{kind:?} {run:?}: {x} at {time}");
        }
        assert!((x[60] - 1.0).abs() < 1e-9 || (x[60] - 1.5).abs() < 0.51, "{kind:?}: {}", x[60]);
        let expected = if which < 3 || which == 5 { 5 } else { 0 };
        assert_eq!(result.stats.step_events, expected, "{kind:?} {run:?}: {:?}", result.stats);
    }
}

#[test]
fn outputs_are_current_when_computed_with_the_derivatives() {
    let (stale, plain) = (evil(&["STALE_OUTPUTS"]), evil(&[]));
    let options = SimulateOptions::new().ncp(97).outputs(["y"]).parameters(["k"]).relative_tolerance(1e-9);
    let plan = Arc::new(SimulationPlan::new(&stale.open(), &options).unwrap());
    let mut simulator = Simulator::new(Arc::clone(&plan)).unwrap();
    let first = simulator.trajectory(&[1.0]).unwrap();
    for (t, y) in first.time.iter().zip(first.get("y").unwrap()) {
        assert!((y - (-t).exp()).abs() < 1e-8, "{y} at {t}");
    }
    // The values after a run are also current, whatever ran before.
    assert!((simulator.get("y").unwrap() - (-1f64).exp()).abs() < 1e-8);
    simulator.run(&[0.0], &mut Ignore).unwrap();
    simulator.run(&[3.0], &mut Ignore).unwrap();
    assert_eq!(bits(&simulator.trajectory(&[1.0]).unwrap()), bits(&first));
    assert_eq!(bits(&Simulator::new(plan).unwrap().trajectory(&[1.0]).unwrap()), bits(&first));
    // A model that computes its outputs when they are read gives bit-for-bit the same values.
    let plan = Arc::new(SimulationPlan::new(&plain.open(), &options).unwrap());
    assert_eq!(bits(&Simulator::new(plan).unwrap().trajectory(&[1.0]).unwrap()), bits(&first));
}

/// Model with these faults whose description names OpenModelica as its tool.
fn openmodelica(faults: &[&str]) -> support::Folder {
    evil_with(faults, |xml| {
        xml.replace(
            "modelName=\"Evil\"",
            "modelName=\"Evil\" generationTool=\"OpenModelica Compiler OMCompiler v1.12.0\"",
        )
    })
}

/// Checks a model that computes y when a step is completed. `right` is y as a function of time. A second run
/// is bit-for-bit identical.
fn is_right_with_completed_steps(faults: &[&str], outputs: &[&str], right: fn(f64) -> f64) {
    let late = openmodelica(&[faults, &["OUTPUTS_OF_STEPS"]].concat());
    let options = SimulateOptions::new().ncp(97).outputs(outputs.iter().copied()).relative_tolerance(1e-9);
    for method in [ode::Method::Tsit5, ode::Method::Dop853, ode::Method::Radau5, ode::Method::Bdf] {
        let fmu = late.open();
        let found = fmu.simulate(&options.clone().method(method)).unwrap();
        for (t, y) in found.time.iter().zip(found.get("y").unwrap()) {
            assert!((y - right(*t)).abs() < 1e-7, "{method:?}: {y} at {t}");
        }
        assert_eq!(bits(&fmu.simulate(&options.clone().method(method)).unwrap()), bits(&found));
    }
}

#[test]
fn openmodelica_outputs_are_current_when_computed_in_completed_steps() {
    is_right_with_completed_steps(&[], &["y"], |t| (-t).exp());
    // The derivative changes from the first step on, y only from 0.5 on.
    let rests = |t: f64| if t < 0.5 { 1.0 } else { (-t).exp() };
    is_right_with_completed_steps(&["RESTS_AT_FIRST"], &["der(x)", "y"], rests);
    // The model computes y too late only after an event.
    is_right_with_completed_steps(&["LATE_FROM=0.4"], &["y"], |t| (-t).exp());
    // A model that computes its outputs when they are read gives bit-for-bit the same values.
    let options = SimulateOptions::new().ncp(97).outputs(["y"]);
    let run = |folder: &support::Folder| bits(&folder.open().simulate(&options).unwrap());
    assert_eq!(run(&openmodelica(&["OUTPUTS_OF_STEPS"])), run(&evil(&[])));
}

#[test]
fn rows_are_read_before_the_inputs_of_the_next_step_are_set() {
    // x' = u with u held over each step. Nothing is integrated if a value is read between setting u and the
    // step.
    let folder = slave(&["LATCHES"], "");
    let u = |t: f64| if t < 0.5 - 1e-9 { 1.0 + t } else { 4.0 };
    let inputs = Inputs::new().table(vec![0.0, 0.5, 0.5, 1.0], [("u", vec![1.0, 1.5, 4.0, 4.0])]);
    let options = SimulateOptions::new()
        .start_value("x", 0.0)
        .step_size(0.1)
        .output_interval(0.1)
        .outputs(["y"])
        .inputs(inputs);
    for options in
        [options.clone(), SimulateOptions { output_interval: None, ..options }.times([0.0, 0.5, 0.5, 1.0])]
    {
        let result = folder.open().simulate(&options).unwrap();
        for (t, y) in result.time.iter().zip(result.get("y").unwrap()) {
            let steps = (t * 10.0).round() as usize;
            let expected: f64 = (0..steps).map(|k| 0.1 * u(0.1 * k as f64)).sum();
            assert!((y - expected).abs() < 1e-12, "{y} at {t}, not {expected}");
        }
    }
}

#[test]
fn extrapolated_inputs_are_set_before_the_initialization() {
    let capability = " canInterpolateInputs=\"true\"";
    for faults in [&["LATCHES", "EXTRAPOLATES"][..], &["LATCHES", "REFUSES_EARLY_INPUTS"]] {
        let folder = slave(faults, capability);
        let inputs = Inputs::new().series("u", vec![0.0], vec![3.0]);
        let options = SimulateOptions::new()
            .start_value("x", 0.5)
            .step_size(0.1)
            .output_interval(0.1)
            .outputs(["y"])
            .inputs(inputs);
        let fmu = folder.open();
        for _ in 0..3 {
            let result = fmu.simulate(&options).unwrap();
            for (t, y) in result.time.iter().zip(result.get("y").unwrap()) {
                assert!((y - (0.5 + 3.0 * t)).abs() < 1e-12, "{y} at {t} with {faults:?}");
            }
        }
    }
}

#[test]
fn input_derivatives_are_passed_unless_disabled() {
    let fmu =
        Fmu::open(example_models::example_fmu_as("switched_input", ExampleKind::Fmi2CoSimulation).unwrap())
            .unwrap();
    let inputs = Inputs::new().function("u", |t| 0.3 * t);
    let options = SimulateOptions::new().final_time(2.0).ncp(8).outputs(["y"]).inputs(inputs);
    let last = |options: SimulateOptions| fmu.simulate(&options).unwrap().final_value("y").unwrap().unwrap();
    // y' = (2 u - y) / 0.5; u is a ramp, or held over steps of 0.25.
    let ramp = 2.0 * 0.3 * (2.0 - 0.5 * (1.0 - (-2f64 / 0.5).exp()));
    let held = (0..8).fold(0.0, |y, k| {
        let target = 2.0 * 0.3 * 0.25 * f64::from(k);
        target + (y - target) * (-0.25f64 / 0.5).exp()
    });
    for (options, expected) in [
        (options.clone(), ramp),
        (options.clone().input_derivatives(true), ramp),
        (options.input_derivatives(false), held),
    ] {
        let found = last(options);
        assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
    }
}

#[test]
fn equal_steps_have_bit_for_bit_equal_length() {
    // The model rejects a step whose length differs from the first one only by rounding.
    let folder = slave(&["ONE_LENGTH=9.94"], "");
    let times: Vec<f64> = (0..=200).map(|k| f64::from(k) * 0.05).collect();
    assert!(times.windows(2).any(|pair| pair[1] - pair[0] != 0.05));
    let mut gaps = times.clone();
    gaps.retain(|t| !(*t * 20.0).round().rem_euclid(7.0).eq(&3.0));
    for times in [times, gaps] {
        let options = SimulateOptions::new().final_time(10.0).times(times);
        folder.open().simulate(&options).unwrap();
    }
    // Far from 0, all differences of times differ from the constant.
    let times: Vec<f64> = (0..=200).map(|k| 1000.0 + f64::from(k) * 0.05).collect();
    let options = SimulateOptions::new().start_time(1000.0).final_time(1010.0).times(times);
    let folder = slave(&["ONE_LENGTH=1009.94"], "");
    folder.open().simulate(&options).unwrap();
}

#[test]
fn co_simulation_continues_after_discarded_and_early_steps() {
    let options = SimulateOptions::new().ncp(10).step_size(0.1);
    let straight = |folder: &support::Folder| {
        let result = folder.open().simulate(&options).unwrap();
        for (t, x) in result.time.iter().zip(result.get("x").unwrap()) {
            assert!((x - t).abs() < 1e-12, "{x} at {t}");
        }
        assert_eq!(result.end_time, 1.0);
        result.stats
    };
    let fixed = |xml: String| xml.replace("canHandleVariableCommunicationStepSize=\"true\"", "");
    assert!(straight(&fixture_with("early", &["DISCARDS"], |xml| xml)).rejected_steps >= 10);
    assert_eq!(straight(&fixture_with("early", &["RETURNS_EARLY"], |xml| xml)).rejected_steps, 0);
    // A model that supports only steps of one length continues with that length from its current time.
    assert_eq!(straight(&fixture_with("early", &["RETURNS_EARLY"], fixed)).rejected_steps, 0);
    let message = |faults: &[&str], edit: fn(String) -> String| {
        fixture_with("early", faults, edit).open().simulate(&options).unwrap_err().to_string()
    };
    let error = message(&["DISCARDS"], fixed);
    assert!(error.contains("fmi3DoStep returned discard"), "{error}");
    for edit in [fixed, |xml| xml] {
        let error = message(&["STANDS_STILL"], edit);
        assert!(error.contains("fmi3DoStep returned early at t = 0.6"), "{error}");
    }
    // An instance that the test controls.
    let folder = fixture_with("early", &["RETURNS_EARLY"], |xml| xml);
    let instance = folder.open().instantiate_co_simulation(&InstanceOptions::default()).unwrap();
    let instance = instance.enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    let outcome = instance.do_step(0.0, 0.1).unwrap();
    assert_eq!((outcome.complete, outcome.early, outcome.reached), (false, true, Some(0.04)));
}

#[test]
fn model_is_notified_if_its_state_may_be_restored() {
    let folder = evil(&["REPORTS_PRIOR", "STATES"]);
    let instance = folder.open().instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap().enter_continuous_time().unwrap();
    instance.completed_integrator_step().unwrap();
    assert_eq!(instance.get("n").unwrap(), Value::Integer(1));
    let state = instance.save_state().unwrap();
    instance.completed_integrator_step().unwrap();
    assert_eq!(instance.get("n").unwrap(), Value::Integer(0));
    drop(state);
    instance.completed_integrator_step().unwrap();
    assert_eq!(instance.get("n").unwrap(), Value::Integer(1));

    let folder = slave(&["REPORTS_PRIOR", "STATES"], " canGetAndSetFMUstate=\"true\"");
    let instance = folder.open().instantiate_co_simulation(&InstanceOptions::default()).unwrap();
    let instance = instance.enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    let state = instance.save_state().unwrap();
    instance.do_step(0.0, 0.1).unwrap();
    assert_eq!(instance.get("n").unwrap(), Value::Integer(0));
    instance.restore_state(&state).unwrap();
    drop(state);
    instance.do_step(0.0, 0.1).unwrap();
    assert_eq!(instance.get("n").unwrap(), Value::Integer(1));
}

#[test]
fn enumerations_before_fmi3_are_limited_to_32_bits() {
    let folder = evil_with(&[], |xml| {
        xml.replace("<Integer start=\"3\"/>", "<Enumeration declaredType=\"E\" start=\"3\"/>").replace(
            "<ModelVariables>",
            "<TypeDefinitions><SimpleType name=\"E\"><Enumeration/></SimpleType></TypeDefinitions><ModelVariables>",
        )
    });
    let fmu = folder.open();
    let with = |n: i64| {
        SimulationPlan::new(&fmu, &SimulateOptions::new().start_value("n", Value::Integer(n.into())))
    };
    assert!(with(7).is_ok());
    let error = with(4_294_967_298).unwrap_err();
    assert!(matches!(error, FmiError::OutOfRange { .. }));
    let error = error.to_string();
    assert!(error.contains("32 bits") && error.contains("4294967298 is out of range"), "{error}");
}

#[test]
fn missing_listed_source_is_reported() {
    let folder = evil_with(&[], |xml| {
        let files = "<ModelExchange modelIdentifier=\"evil\"><SourceFiles><File name=\"gone.c\"/></SourceFiles></ModelExchange>";
        xml.replace("<ModelExchange modelIdentifier=\"evil\"/>", files)
    });
    std::fs::remove_dir_all(folder.path().join("binaries")).unwrap();
    std::fs::create_dir(folder.path().join("sources")).unwrap();
    let error = folder.open().instantiate().unwrap_err().to_string();
    assert!(
        error.contains("no binary") && error.contains("\"gone.c\" is listed, but does not exist"),
        "{error}"
    );
}
