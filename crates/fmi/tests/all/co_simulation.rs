//! Co-simulation yields the samples of model exchange, regardless of the steps of the FMU.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use example_models::ExampleKind;
use fmi::ode::{ErrorKind, Ignore, Side, Termination};
use fmi::{
    FmiError, Fmu, Inputs, InstanceOptions, InterfaceChoice, InterfaceKind, SharedSimulator, SimulateOptions,
    SimulationPlan, Simulator, Status, Trajectory,
};
use std::sync::Arc;
use std::time::Duration;
use support::{Folder, MODELS, evil_with, model_as};

/// FMI 2.0 co-simulation with steps of any length.
fn slave(name: &str) -> Fmu {
    Fmu::open(example_models::example_fmu_as(name, ExampleKind::Fmi2CoSimulation).unwrap()).unwrap()
}

/// FMI 2.0 co-simulation with steps of fixed length.
fn fixed_step(name: &str, step: &str) -> Folder {
    model_as(name, ExampleKind::Fmi2CoSimulation, &[&format!("FIXED_STEP={step}")], |xml| {
        xml.replace("canHandleVariableCommunicationStepSize=\"true\"", "")
    })
}

fn evil(faults: &[&str]) -> Folder {
    evil_with(faults, |xml| {
        xml.replace(
            "<ModelExchange modelIdentifier=\"evil\"/>",
            "<CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"true\"/>",
        )
    })
}

fn close(a: f64, b: f64, tolerance: f64) {
    assert!((a - b).abs() <= tolerance, "{a} is not {b} within {tolerance:e}");
}

fn bits(t: &Trajectory) -> Vec<u64> {
    t.columns.iter().flatten().chain(&t.time).map(|v| v.to_bits()).collect()
}

#[test]
fn co_simulation_of_all_examples_agrees_with_model_exchange() {
    for (name, end) in MODELS {
        let options = SimulateOptions::new().final_time(end).ncp(97).relative_tolerance(1e-9);
        let truth =
            Fmu::open(example_models::example_fmu(name).unwrap()).unwrap().simulate(&options).unwrap();
        let found = slave(name).simulate(&options).unwrap();
        assert_eq!((&found.names, &found.time), (&truth.names, &truth.time), "{name}");
        assert!(found.events.is_empty() && found.sides == truth.sides);
        for (column, (a, b)) in truth.columns.iter().zip(&found.columns).enumerate() {
            for (row, (a, b)) in a.iter().zip(b).enumerate() {
                let message = || format!("{name}: {} in row {row}: {a} and {b}", truth.names[column]);
                assert!((a - b).abs() <= 1e-6 * (1.0 + a.abs()), "{}", message());
            }
        }
    }
}

#[test]
fn co_simulation_performs_the_same_steps_as_manual_loop() {
    let fmu = slave("furuta");
    let options = SimulateOptions::new().final_time(2.0).output_interval(0.05).outputs(["armJoint.phi"]);
    let plan = SimulationPlan::new(&fmu, &options).unwrap();
    assert_eq!(plan.kind(), InterfaceKind::CoSimulation);
    let result = fmu.simulate(&options).unwrap();
    assert_eq!(result.stats.accepted_steps, 40);
    let instance = fmu.instantiate_co_simulation(&InstanceOptions::default()).unwrap();
    let instance = instance.enter_initialization(0.0, Some(2.0), Some(1e-6)).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    for (k, value) in result.get("armJoint.phi").unwrap().iter().enumerate() {
        assert_eq!(instance.get("armJoint.phi").unwrap(), fmi::Value::Real(*value), "row {k}");
        if k < 40 {
            assert!(instance.do_step(k as f64 * 0.05, 0.05).unwrap().complete);
        }
    }
    instance.terminate().unwrap();
}

#[test]
fn rows_are_communication_points_when_steps_may_vary() {
    let fmu = slave("dahlquist");
    let times = [0.0, 0.013, 0.5, 0.5, 1.7, 2.0];
    let options = SimulateOptions::new().times(times).final_time(2.0).step_size(0.25);
    let result = fmu.simulate(&options).unwrap();
    for (t, x) in times.iter().zip(result.get("x").unwrap()) {
        close(*x, (-t).exp(), 1e-9);
    }
    assert_eq!(result.sides[2..4], [Side::Left, Side::Right]);
    assert_eq!(result.stats.accepted_steps, 10);
}

#[test]
fn rows_between_fixed_steps_are_interpolated() {
    let folder = fixed_step("dahlquist", "0.1");
    let times = [0.0, 0.05, 0.1, 0.12, 0.12, 0.95, 0.97];
    let options = SimulateOptions::new().times(times).final_time(0.97).step_size(0.1);
    let result = folder.open().simulate(&options).unwrap();
    let x = result.get("x").unwrap();
    let exact = |k: f64| (-0.1 * k).exp();
    for (row, expected) in [
        (0, 1.0),
        (1, 0.5 * (1.0 + exact(1.0))),
        (2, exact(1.0)),
        (3, 0.8 * exact(1.0) + 0.2 * exact(2.0)),
        (5, 0.5 * (exact(9.0) + exact(10.0))),
        (6, 0.3 * exact(9.0) + 0.7 * exact(10.0)),
    ] {
        close(x[row], expected, 1e-9);
    }
    assert_eq!(x[3], x[4]);
    assert_eq!(result.sides[3..5], [Side::Left, Side::Right]);
    assert_eq!(
        (result.stats.accepted_steps, result.termination, result.end_time),
        (10, Termination::Finished, 0.97)
    );
    assert_eq!(result.time, times);
    // Times are 0.1 * k, not a sum of steps, because the model rejects steps that are not exactly 0.1.
    let long = SimulateOptions::new().final_time(100.0).step_size(0.1).ncp(7);
    assert_eq!(folder.open().simulate(&long).unwrap().stats.accepted_steps, 1000);
    // The model decides about other step sizes, and rejects this one.
    let error = folder.open().simulate(&options.step_size(0.2)).unwrap_err();
    assert_eq!(error.call_failure().unwrap().call, "fmi2DoStep");
}

#[test]
fn discrete_outputs_are_held_between_fixed_steps() {
    let folder = fixed_step("stair", "0.4");
    let options = SimulateOptions::new().final_time(4.0).step_size(0.4).output_interval(0.1);
    let result = folder.open().simulate(&options).unwrap();
    for (t, counter) in result.time.iter().zip(result.get("counter").unwrap()) {
        let point = 0.4 * ((t + 1e-9) / 0.4).floor();
        assert_eq!(*counter, 1.0 + (point + 1e-9).floor(), "t = {t}");
    }
}

#[test]
fn model_may_end_the_simulation() {
    let options = SimulateOptions::new().final_time(20.0).output_interval(0.5);
    let result = slave("stair").simulate(&options).unwrap();
    assert_eq!((result.termination, result.end_time), (Termination::StoppedByModel, 9.0));
    assert_eq!(result.time.last(), Some(&9.0));
    // Within a step.
    let folder = evil(&["ENDS_ITSELF"]);
    let mut simulator = Simulator::new(Arc::new(
        SimulationPlan::new(&folder.open(), &SimulateOptions::new().ncp(10)).unwrap(),
    ))
    .unwrap();
    let first = simulator.trajectory(&[]).unwrap();
    assert_eq!((first.termination, first.end_time), (Termination::StoppedByModel, 0.25));
    assert_eq!(first.time, [0.0, 0.1, 0.2]);
    assert_eq!(simulator.trajectory(&[]).unwrap(), first);
}

#[test]
fn inputs_jump_at_communication_points_and_follow_slopes() {
    let fmu = slave("switched_input");
    let inputs = Inputs::new()
        .table(vec![0.0, 10.0], [("u", vec![1.0, 1.0])])
        .series("gear", vec![0.0, 1.0], vec![1.0, 2.0])
        .series("enabled", vec![0.0, 2.0], vec![1.0, 0.0]);
    let options = SimulateOptions::new()
        .times([0.0, 0.5, 1.0, 1.0, 2.0, 2.0, 3.0])
        .final_time(3.0)
        .step_size(0.3)
        .inputs(inputs)
        .outputs(["x", "target", "gear", "limit", "enabled", "time"]);
    let result = fmu.simulate(&options).unwrap();
    let x = result.get("x").unwrap();
    close(x[1], 2.0 * (1.0 - (-1f64).exp()), 1e-9);
    close(x[3], 1.7293294335267746, 1e-9);
    close(x[5], 3.6926981557493064, 1e-9);
    close(x[6], 3.6926981557493064 * (-2f64).exp(), 1e-9);
    // Rows are read before inputs are set. At jumps, both rows are the limit from the left.
    assert_eq!(result.get("target").unwrap(), [2.0, 2.0, 2.0, 2.0, 4.0, 4.0, 0.0]);
    assert_eq!(result.get("gear").unwrap(), [1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0]);
    assert_eq!(result.get("enabled").unwrap(), [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);

    // A ramp is followed exactly if the FMU accepts derivatives. Otherwise, it is held over a step.
    let ramp = |t: f64| 2.0 * 0.3 * (t - 0.5 * (1.0 - (-t / 0.5).exp()));
    let ramps = [
        Inputs::new().series("u", vec![0.0, 0.7, 2.0], vec![0.0, 0.21, 0.6]),
        Inputs::new().function("u", |t| 0.3 * t),
    ];
    let options = SimulateOptions::new().final_time(2.0).ncp(8).outputs(["y"]);
    for inputs in ramps {
        let result = fmu.simulate(&options.clone().inputs(inputs.clone())).unwrap();
        for (t, y) in result.time.iter().zip(result.get("y").unwrap()) {
            close(*y, ramp(*t), 1e-9);
        }
        let folder = model_as("switched_input", ExampleKind::Fmi2CoSimulation, &[], |xml| {
            xml.replace("canInterpolateInputs=\"true\"", "")
        });
        let held = folder.open().simulate(&options.clone().inputs(inputs)).unwrap();
        let error = ramp(2.0) - held.final_value("y").unwrap().unwrap();
        assert!(error > 0.01 && error < 0.1, "{error}");
    }
}

#[test]
fn repeated_run_is_bit_identical_on_every_thread() {
    let fmu = slave("furuta");
    let options = SimulateOptions::new()
        .final_time(2.0)
        .output_interval(0.1)
        .parameters(["armFriction", "pendulumFriction"])
        .outputs(["armJoint.phi", "pendulumJoint.phi"]);
    let pool = SharedSimulator::new(Arc::new(SimulationPlan::new(&fmu, &options).unwrap()));
    let run = |values: [f64; 2]| {
        pool.with_simulator(&base::RunContext::new(), |simulator| simulator.trajectory(&values))
    };
    let truth = bits(&run([0.011, 0.0015]).unwrap());
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                for other in [0.012, 0.013] {
                    run([other, 0.002]).unwrap();
                    assert_eq!(bits(&run([0.011, 0.0015]).unwrap()), truth);
                }
            });
        }
    });
}

#[test]
fn co_simulation_continues_after_partial_or_rejected_steps() {
    let options = SimulateOptions::new().ncp(10);
    for (fault, rejected) in [("PARTIAL_STEPS", false), ("REFUSES_LONG_STEPS", true), ("PENDING", false)] {
        let folder = evil(&[fault]);
        let result = folder.open().simulate(&options).unwrap();
        for (t, y) in result.time.iter().zip(result.get("y").unwrap()) {
            close(*y, (-t).exp(), 1e-12);
        }
        assert_eq!(result.stats.rejected_steps > 0, rejected, "{fault}: {:?}", result.stats);
    }
}

#[test]
fn failed_step_reports_time_and_log() {
    let run = |fault: &str| {
        let folder = evil(&[fault]);
        let plan = Arc::new(SimulationPlan::new(&folder.open(), &SimulateOptions::new().ncp(10)).unwrap());
        let mut simulator = Simulator::new(plan).unwrap();
        let first = simulator.run(&[], &mut Ignore).unwrap_err();
        assert_eq!(simulator.run(&[], &mut Ignore).unwrap_err().to_string(), first.to_string());
        first
    };
    let error = run("STEP_ERROR");
    let failure = error.call_failure().unwrap();
    assert_eq!((failure.call, failure.status), ("fmi2DoStep", Status::Error));
    assert!(failure.time.unwrap() > 0.5 && failure.log[0].text == "no step beyond t = 0.5", "{error}");
    let error = run("REFUSES_ALL_STEPS");
    assert_eq!(error.call_failure().unwrap().status, Status::Discard, "{error}");
}

#[test]
fn unfinished_step_is_cancelled_after_timeout() {
    let folder = evil(&["STUCK"]);
    let options = SimulateOptions::new().timeout(Duration::from_millis(50));
    let plan = Arc::new(SimulationPlan::new(&folder.open(), &options).unwrap());
    let mut simulator = Simulator::new(plan).unwrap();
    for _ in 0..2 {
        let FmiError::Simulation(error) = simulator.run(&[], &mut Ignore).unwrap_err() else { panic!() };
        assert!(matches!(error.kind, ErrorKind::TimedOut(_)), "{error}");
    }
}

#[test]
fn interface_kind_is_chosen_or_requested() {
    let both = evil_with(&[], |xml| {
        xml.replace(
            "<ModelExchange modelIdentifier=\"evil\"/>",
            "<ModelExchange modelIdentifier=\"evil\"/><CoSimulation modelIdentifier=\"evil\"/>",
        )
    });
    let fmu = both.open();
    for (kind, expected) in [
        (InterfaceChoice::Auto, InterfaceKind::ModelExchange),
        (InterfaceChoice::ModelExchange, InterfaceKind::ModelExchange),
        (InterfaceChoice::CoSimulation, InterfaceKind::CoSimulation),
    ] {
        let options = SimulateOptions::new().kind(kind).relative_tolerance(1e-9);
        assert_eq!(SimulationPlan::new(&fmu, &options).unwrap().kind(), expected);
        close(fmu.simulate(&options).unwrap().final_value("y").unwrap().unwrap(), (-1f64).exp(), 1e-8);
    }
    let error = SimulationPlan::new(
        &slave("dahlquist"),
        &SimulateOptions::new().kind(InterfaceChoice::ModelExchange),
    );
    assert!(matches!(error.unwrap_err(), FmiError::NotOffered { .. }));
    assert_eq!(fmi::Session::new(slave("dahlquist")).get("der(x)").unwrap(), fmi::Value::Real(-1.0));
}

#[test]
fn observer_stops_run_at_any_sample() {
    struct Stop(usize);
    impl fmi::ode::Observer for Stop {
        fn sample(&mut self, sample: &fmi::ode::Sample<'_>) -> std::ops::ControlFlow<()> {
            match sample.index == Some(self.0) {
                true => std::ops::ControlFlow::Break(()),
                false => std::ops::ControlFlow::Continue(()),
            }
        }
    }
    let options = SimulateOptions::new().final_time(2.0).ncp(20);
    let mut simulator =
        Simulator::new(Arc::new(SimulationPlan::new(&slave("furuta"), &options).unwrap())).unwrap();
    let whole = bits(&simulator.trajectory(&[]).unwrap());
    for sample in [0, 1, 13] {
        let report = simulator.run(&[], &mut Stop(sample)).unwrap();
        assert_eq!(report.termination, Termination::StoppedByObserver);
    }
    assert_eq!(bits(&simulator.trajectory(&[]).unwrap()), whole);
}

#[test]
fn instance_allows_only_recovery_after_error() {
    let folder = support::evil_with(&["STEP_ERROR"], |xml| {
        let slave = "<CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"true\" \
                     canGetAndSetFMUstate=\"true\"/>";
        xml.replace("<ModelExchange modelIdentifier=\"evil\"/>", slave)
    });
    let fmu = folder.open();
    let instance = fmu.instantiate_co_simulation(&InstanceOptions::default()).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    let saved = instance.save_state();
    assert!(instance.do_step(0.0, 0.25).unwrap().complete);
    let y = instance.get("y").unwrap();
    assert!(matches!(instance.do_step(0.75, 0.25).unwrap_err(), FmiError::Call(_)));
    let refused = |error: FmiError| assert!(matches!(error, FmiError::AfterError("fmi2DoStep")), "{error}");
    refused(instance.do_step(0.25, 0.25).unwrap_err());
    refused(instance.get("y").unwrap_err());
    refused(instance.set("n", 2).unwrap_err());
    refused(instance.save_state().map(|_| ()).unwrap_err());
    if let Ok(saved) = saved {
        instance.restore_state(&saved).unwrap();
        assert!(instance.do_step(0.0, 0.25).unwrap().complete);
        assert_eq!(instance.get("y").unwrap(), y);
        instance.do_step(0.75, 0.25).unwrap_err();
    }
    let instance = instance.reset().unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    assert!(instance.do_step(0.0, 0.25).unwrap().complete);
    assert_eq!(instance.get("y").unwrap(), y);
}

/// x' = u, with u held over each step: the evil model with an input.
fn integrator(more: &str) -> Folder {
    evil_with(&["LATCHES"], |xml| {
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
fn rows_of_held_input_are_communication_points() {
    let times: Vec<f64> = (0..=100).map(|k| 0.01 * f64::from(k)).collect();
    let options = |values: Vec<f64>| {
        let inputs = Inputs::new().series("u", times.clone(), values);
        SimulateOptions::new().final_time(1.0).times([0.0, 1.0]).step_size(0.5).inputs(inputs).outputs(["x"])
    };
    // The library has no function that sets derivatives, regardless of the description.
    for more in ["", " canInterpolateInputs=\"true\""] {
        let folder = integrator(more);
        let fmu = folder.open();
        let ramp = fmu.simulate(&options(times.clone())).unwrap();
        close(ramp.final_value("x").unwrap().unwrap(), 1.495, 1e-12);
        assert_eq!(ramp.stats.accepted_steps, 100, "{more}");
        // A constant input requires no communication points.
        let constant = fmu.simulate(&options(vec![2.0; 101])).unwrap();
        close(constant.final_value("x").unwrap().unwrap(), 3.0, 1e-12);
        assert_eq!(constant.stats.accepted_steps, 2);
    }
    // If derivatives are passed to the model, a straight line requires none either.
    let inputs = Inputs::new().series("u", times.clone(), times.clone());
    let options = |passed| {
        SimulateOptions::new()
            .final_time(1.0)
            .times([0.0, 1.0])
            .inputs(inputs.clone())
            .input_derivatives(passed)
    };
    let steps = |passed| slave("switched_input").simulate(&options(passed)).unwrap().stats.accepted_steps;
    assert_eq!((steps(true), steps(false)), (1, 100));
}

#[test]
fn communication_step_is_the_larger_of_declared_step_and_row_spacing() {
    let stated = |step: &str, variable: bool| {
        evil_with(&[], |xml| {
            let interface = format!(
                "<CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"{variable}\"/>"
            );
            xml.replace("<ModelExchange modelIdentifier=\"evil\"/>", &interface)
                .replace("stopTime=\"1\"", &format!("stopTime=\"1\" stepSize=\"{step}\""))
        })
    };
    let steps = |step: &str, variable: bool, options: &SimulateOptions| {
        let folder = stated(step, variable);
        let result = folder.open().simulate(options).unwrap();
        close(result.final_value("y").unwrap().unwrap(), (-1f64).exp(), 1e-9);
        result.stats.accepted_steps
    };
    let rows = SimulateOptions::new().ncp(20);
    assert_eq!(steps("1e-8", true, &rows), 20);
    assert_eq!(steps("1e-8", false, &rows), 20);
    assert_eq!(steps("1e-3", true, &rows), 20);
    assert_eq!(steps("1e-3", true, &rows.clone().step_size(1e-3)), 1000);
    // A model with steps of fixed length uses the step size that it declares.
    assert_eq!(steps("1e-3", false, &rows), 1000);
    let irregular = SimulateOptions::new().times([0.0, 0.25, 1.0]);
    assert_eq!(steps("1e-8", true, &irregular), 3);
}

/// The evil model with steps of fixed length, or of any length.
fn with_stop_time(faults: &[&str], variable: bool) -> Folder {
    evil_with(faults, |xml| {
        let interface = format!(
            "<CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"{variable}\"/>"
        );
        xml.replace("<ModelExchange modelIdentifier=\"evil\"/>", &interface)
    })
}

#[test]
fn co_simulation_always_receives_stop_time() {
    for variable in [true, false] {
        let folder = with_stop_time(&["NEEDS_STOP"], variable);
        for (end, step) in [(1.0, 0.1), (0.97, 0.1), (0.3, 0.1)] {
            let options = SimulateOptions::new().final_time(end).times([0.0, end]).step_size(step);
            let result = folder.open().simulate(&options).unwrap();
            assert_eq!((result.termination, result.time.len()), (Termination::Finished, 2));
        }
    }
}

#[test]
fn stop_time_is_withheld_when_last_step_is_rejected() {
    // 0.1 + 0.1 + 0.1 > 0.3.
    let options = SimulateOptions::new().final_time(0.3).step_size(0.1).output_interval(0.1);
    for status in ["fmi2Error", "fmi2Discard"] {
        let folder = with_stop_time(&[&format!("STRICT_STOP={status}")], false);
        let fmu = folder.open();
        for _ in 0..2 {
            let result = fmu.simulate(&options).unwrap();
            assert_eq!(result.time.len(), 4);
            for (t, y) in result.time.iter().zip(result.get("y").unwrap()) {
                close(*y, (-t).exp(), 1e-12);
            }
        }
        let quirks: Vec<String> = fmu.quirks_seen().into_iter().map(|quirk| quirk.message).collect();
        assert!(quirks.len() == 1 && quirks[0].contains("the stop time 0.3"), "{quirks:?}");
    }
    // A model whose last step also fails without a stop time still receives the stop time.
    let folder = with_stop_time(&["NEEDS_STOP", "FAILS_BEYOND=0.25"], false);
    let fmu = folder.open();
    for _ in 0..2 {
        let error = fmu.simulate(&options).unwrap_err();
        assert_eq!(error.call_failure().unwrap().call, "fmi2DoStep", "{error}");
    }
    assert!(fmu.quirks_seen().is_empty());
}
