//! Behavior of faulty FMUs: each test uses an FMU with one fault.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::ode::{ErrorKind, Ignore, Termination};
use fmi::{
    FmiError, Fmu, Inputs, InstanceOptions, InterfaceChoice, LogFilter, LogOptions, OpenOptions,
    SimulateOptions, SimulationPlan, Simulator, Status, Value,
};
use std::sync::Arc;
use support::{Folder, evil, evil_with};

fn plan(folder: &Folder) -> Arc<SimulationPlan> {
    Arc::new(SimulationPlan::new(&folder.open(), &SimulateOptions::new().parameters(["k"])).unwrap())
}

fn fails(faults: &[&str]) -> FmiError {
    let folder = evil(faults);
    let mut simulator = Simulator::new(plan(&folder)).unwrap();
    let first = simulator.run(&[1.0], &mut Ignore).unwrap_err();
    // The simulator remains usable, and the second run fails in the same way.
    let second = simulator.run(&[1.0], &mut Ignore).unwrap_err();
    assert_eq!(first.to_string(), second.to_string());
    first
}

#[test]
fn model_without_faults_runs() {
    let folder = evil(&[]);
    let result = folder.open().simulate(&SimulateOptions::new().relative_tolerance(1e-9)).unwrap();
    assert!((result.final_value("y").unwrap().unwrap() - (-1f64).exp()).abs() < 1e-8);
}

#[test]
fn permanent_discard_is_an_error_with_time() {
    let FmiError::Simulation(error) = fails(&["DISCARD_BELOW"]) else { panic!() };
    assert!(matches!(error.kind, ErrorKind::StepTooSmall { discarded: true }), "{error}");
    assert!((error.time - 2f64.ln()).abs() < 1e-5, "{error}");
    assert!(error.to_string().contains(": fmi2GetDerivatives returned discard at t = 0.69"), "{error}");
    // Also at the start.
    let error = fails(&["FAILING_ALWAYS=fmi2Discard"]).to_string();
    assert!(
        error.contains("its current state at t = 0: fmi2GetDerivatives returned discard at t = 0"),
        "{error}"
    );
}

#[test]
fn nan_derivative_rejects_step() {
    let FmiError::Simulation(error) = fails(&["NAN_LATE"]) else { panic!() };
    assert!(matches!(error.kind, ErrorKind::StepTooSmall { discarded: true }), "{error}");
    assert!(error.time <= 0.5 && error.time > 0.4, "{error}");
}

#[test]
fn error_contains_call_time_and_log() {
    let error = fails(&["ERROR_LATE"]);
    let failure = error.call_failure().unwrap();
    assert_eq!((failure.call, failure.status), ("fmi2GetDerivatives", Status::Error));
    assert!(failure.time.unwrap() > 0.5);
    assert_eq!(failure.log[0].text, "broken beyond t = 0.5");
    let text = error.to_string();
    assert!(text.contains("fmi2GetDerivatives returned error at t = ") && text.contains("broken"), "{text}");
}

#[test]
fn instance_is_abandoned_after_fatal() {
    // Freeing the instance would abort this process.
    let folder = evil(&["FATAL_LATE"]);
    let error = Simulator::new(plan(&folder)).unwrap().run(&[1.0], &mut Ignore).unwrap_err();
    assert_eq!(error.call_failure().unwrap().status, Status::Fatal);
}

#[test]
fn simulator_has_no_values_after_error() {
    let folder = evil(&["ERROR_LATE"]);
    let mut simulator = Simulator::new(plan(&folder)).unwrap();
    simulator.run(&[1.0], &mut Ignore).unwrap_err();
    let error = simulator.value("x").unwrap_err();
    assert!(
        error.call_failure().is_none() && error.to_string().contains("no instance is running"),
        "{error}"
    );
}

#[test]
fn unknown_references_are_not_passed_to_fmu() {
    let folder = evil(&["TRUSTS_REFERENCES"]);
    let mut instance = folder.open().instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    let (far, mut value) = (0xf000_0000, [0.0]);
    for error in [
        instance.get_reals(&[far], &mut value).unwrap_err(),
        instance.directional_derivative(&[far], &[0], &[1.0], &mut value).unwrap_err(),
        instance.directional_derivative(&[1], &[far], &[1.0], &mut value).unwrap_err(),
    ] {
        assert!(matches!(error, FmiError::UnknownReference { reference, .. } if reference == far), "{error}");
    }
    instance.get_reals(&[2], &mut value).unwrap();
    assert_eq!(value, [1.0]);
}

#[test]
fn unknown_status_is_an_error() {
    assert_eq!(fails(&["ODD_STATUS"]).call_failure().unwrap().status, Status::Unknown(77));
}

#[test]
fn failed_initialization_expands_references_in_log() {
    let error = fails(&["NO_START"]);
    let failure = error.call_failure().unwrap();
    assert_eq!(failure.call, "fmi2ExitInitializationMode");
    assert_eq!(failure.log[0].text, "no solution for k (# #r99#)");
}

#[test]
fn rejected_value_is_reported_with_variable() {
    let folder = evil(&[]);
    let error = Simulator::new(plan(&folder)).unwrap().run(&[-1.0], &mut Ignore).unwrap_err();
    let failure = error.call_failure().unwrap();
    assert_eq!((failure.call, &failure.variables[..]), ("fmi2SetReal", &["k".to_owned()][..]));
    assert_eq!(failure.log[0].text, "k must not be negative, n");
}

#[test]
fn endless_event_iteration_is_stopped() {
    let error = fails(&["ENDLESS_EVENTS"]);
    assert!(error.to_string().contains("did not end within 100 iterations"), "{error}");
}

#[test]
fn event_in_the_past_is_an_error() {
    let FmiError::Simulation(error) = fails(&["PAST_EVENT"]) else { panic!() };
    assert!(matches!(error.kind, ErrorKind::EventInThePast(next) if next == -1.0), "{error}");
}

#[test]
fn log_is_bounded_for_many_messages() {
    let folder = evil(&["LOG_FLOOD"]);
    let result = folder.open().simulate(&SimulateOptions::new().ncp(1)).unwrap();
    assert_eq!(result.termination, Termination::Finished);
    let mut instance = folder
        .open()
        .instantiate()
        .unwrap()
        .enter_initialization(0.0, None, None)
        .unwrap()
        .exit_initialization()
        .unwrap()
        .enter_continuous_time()
        .unwrap();
    instance.get_derivatives(&mut [0.0]).unwrap();
    let (lines, dropped) = instance.log();
    assert_eq!((lines.len(), dropped), (32, 768));
    let texts: Vec<&str> = lines[28..].iter().map(|line| line.text.as_str()).collect();
    assert_eq!(texts[..3], ["", "100 % sure, %", "bad \u{fffd}\u{fffd} bytes"]);
    assert!(texts[3].starts_with("x = 1 of "), "{texts:?}");
    // The rate limit is exceeded here, and all lines are counted.
    instance.get_derivatives(&mut [0.0]).unwrap();
    let (lines, dropped) = instance.log();
    assert_eq!((lines.len(), dropped), (32, 1568));
}

#[test]
fn error_log_contains_reason_despite_many_messages() {
    let error = fails(&["LOG_FLOOD", "ERROR_LATE"]);
    let failure = error.call_failure().unwrap();
    assert_eq!(failure.log.last().unwrap().text, "broken beyond t = 0.5");
    // At least the initial right-hand side and one step were evaluated before.
    assert!(failure.dropped_log_lines > 2 * 800 - 8, "{}", failure.dropped_log_lines);
}

#[test]
fn log_filter_drops_lines_below_level() {
    let folder = evil(&["LOG_FLOOD", "ERROR_LATE"]);
    // In simulations, the filter of the opened FMU applies.
    for (filter, kept) in [(LogFilter::All, 8), (LogFilter::Errors, 1), (LogFilter::Nothing, 0)] {
        let options =
            OpenOptions { logging: LogOptions { filter, ..LogOptions::default() }, ..OpenOptions::default() };
        let fmu = Fmu::open_with(folder.path(), &options).unwrap();
        let error = fmu.simulate(&SimulateOptions::new()).unwrap_err();
        let failure = error.call_failure().unwrap();
        assert_eq!(failure.log.len(), kept, "{filter:?}: {error}");
    }
    let options = InstanceOptions { log_filter: LogFilter::Errors, ..InstanceOptions::default() };
    let instance = folder.open().instantiate_with(&options).unwrap();
    let instance = instance.enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap().enter_continuous_time().unwrap();
    instance.get_derivatives(&mut [0.0]).unwrap();
    assert_eq!(instance.log(), (Vec::new(), 0));
}

#[test]
fn model_may_end_the_simulation() {
    let folder = evil(&["ENDS_ITSELF"]);
    let mut simulator = Simulator::new(plan(&folder)).unwrap();
    let first = simulator.trajectory(&[1.0]).unwrap();
    assert_eq!(first.termination, Termination::StoppedByModel);
    assert!(first.end_time >= 0.25 && first.end_time < 1.0);
    assert_eq!(simulator.trajectory(&[1.0]).unwrap(), first);
}

#[test]
fn flush_to_zero_is_disabled_during_and_after_run() {
    let tiny = std::hint::black_box(1e-310);
    let folder = evil(&["FLUSHES"]);
    let result = folder.open().simulate(&SimulateOptions::new().ncp(1)).unwrap();
    assert!(result.final_value("y").unwrap().unwrap().abs() < 1e-9, "the model saw flushed denormals");
    assert!(tiny * std::hint::black_box(1.0) > 0.0, "the mode of this thread was changed");
}

#[test]
fn inputs_are_set_once_per_time_point() {
    let folder = evil_with(&["ONE_SET"], |xml| {
        let input = r#"<ScalarVariable name="u" valueReference="7" causality="input" variability="continuous"
            canHandleMultipleSetPerTimeInstant="false"><Real start="0"/></ScalarVariable></ModelVariables>"#;
        xml.replace("</ModelVariables>", input)
    });
    // A ramp from 0 to 1, a jump to 3, and 3 until the end: its integral at 2 is 0.5 + 3.
    let inputs = Inputs::new().table(vec![0.0, 1.0, 1.0, 2.0], [("u", vec![0.0, 1.0, 3.0, 3.0])]);
    let options = SimulateOptions::new()
        .final_time(2.0)
        .times([0.0, 0.5, 1.0, 1.0, 2.0])
        .start_value("x", 0.0)
        .inputs(inputs)
        .record_events(true);
    let result = folder.open().simulate(&options).unwrap();
    assert_eq!(result.events.len(), 1);
    for (time, y) in result.time.iter().zip(result.get("y").unwrap()) {
        let expected = if *time <= 1.0 { 0.5 * time * time } else { 0.5 + 3.0 * (time - 1.0) };
        assert!((y - expected).abs() < 1e-6, "{y} at {time}");
    }
}

#[test]
fn constant_inputs_are_set_in_initialization_mode() {
    let folder = evil_with(&["ONE_SET", "LATE_INPUTS"], |xml| {
        let input = r#"<ScalarVariable name="u" valueReference="7" causality="input" variability="continuous">
            <Real start="0"/></ScalarVariable></ModelVariables>"#;
        xml.replace("</ModelVariables>", input)
    });
    let fmu = folder.open();
    let by_hand = fmu.instantiate().unwrap().set("u", 2.0).unwrap_err();
    assert!(by_hand.to_string().contains("inputs are set in initialization mode"), "{by_hand}");
    // x' = u, as a start value and as a parameter of the runs, on a new instance and on a reset one.
    let options = SimulateOptions::new().start_value("x", 0.0).ncp(1);
    let result = fmu.simulate(&options.clone().start_value("u", 2.0)).unwrap();
    assert!((result.get("y").unwrap()[1] - 2.0).abs() < 1e-12);
    let plan = SimulationPlan::new(&fmu, &options.parameters(["x", "u"])).unwrap();
    let mut simulator = Simulator::new(Arc::new(plan)).unwrap().resetting();
    let run = |simulator: &mut Simulator| {
        for (x, u) in [(0.0, 3.0), (1.0, -2.0), (0.5, 0.0)] {
            let result = simulator.trajectory(&[x, u]).unwrap();
            assert!((result.get("y").unwrap()[1] - (x + u)).abs() < 1e-12, "{x} and {u}");
        }
    };
    run(&mut simulator);
    run(&mut simulator);
}

#[test]
fn nan_outputs_are_recorded() {
    let folder = evil(&["NAN_OUTPUT"]);
    let result = folder.open().simulate(&SimulateOptions::new().ncp(2)).unwrap();
    assert!(result.get("y").unwrap().iter().all(|y| y.is_nan()));
}

/// A state is copied from the vector of the integration. The corresponding variable of the description may
/// have a different value.
#[test]
fn state_contradicting_its_variable_is_reported() {
    let reported =
        "x differs from the continuous state that it represents according to the model description";
    let options = SimulateOptions::new().ncp(10).outputs(["x", "y"]);
    let simulate = |value: &str| {
        let folder = evil(&[&format!("STATE_VALUE={value}")]);
        let fmu = folder.open();
        let quirks = |fmu: &Fmu| fmu.quirks_seen().into_iter().map(|quirk| quirk.message).collect::<Vec<_>>();
        (fmu.simulate(&options), quirks(&fmu))
    };
    // From the start: the variable is recorded, as requested.
    let (result, quirks) = simulate("2*m->x");
    let result = result.unwrap();
    assert!(result.get("x").unwrap().iter().zip(result.get("y").unwrap()).all(|(x, y)| *x == 2.0 * y));
    assert_eq!(quirks, [format!("{reported}; the variable is recorded")]);
    let (result, _) = simulate("NAN");
    assert!(result.unwrap().get("x").unwrap().iter().all(|x| x.is_nan()));
    // Later: the rows are already recorded.
    let (result, quirks) = simulate("m->time>0.5?2*m->x:m->x");
    let result = result.unwrap();
    assert_eq!(result.get("x").unwrap(), result.get("y").unwrap());
    assert_eq!(quirks, [format!("at the end of a simulation, {reported}; the state is recorded")]);
    for (value, shown) in [("m->time>0.5?NAN:m->x", "NaN"), ("m->time>0.5?INFINITY:m->x", "inf")] {
        let error = simulate(value).0.unwrap_err().to_string();
        let expected = format!("at t = 1: x is {shown}, although the continuous state that it represents");
        assert!(error.contains(&expected), "{error}");
    }
    // In single precision.
    assert!(simulate("(float)m->x").1.is_empty());
}

#[test]
fn zero_nominal_is_replaced_by_one() {
    let folder = evil(&["BAD_NOMINAL"]);
    let good = evil(&[]);
    let options = SimulateOptions::new();
    assert_eq!(folder.open().simulate(&options).unwrap(), good.open().simulate(&options).unwrap());
}

#[test]
fn library_without_mandatory_function_is_rejected() {
    let error = evil(&["MISSING_SYMBOL"]).open().instantiate().unwrap_err();
    assert!(matches!(&error, FmiError::MissingSymbol { symbol: "fmi2GetDerivatives", .. }), "{error}");
}

#[test]
fn missing_optional_function_is_an_error_when_called() {
    let folder = evil(&[]);
    let mut instance = folder.open().instantiate().unwrap();
    for (error, function) in [
        (instance.save_state().unwrap_err(), "fmi2GetFMUstate"),
        (instance.set("label", "x").unwrap_err(), "fmi2SetString"),
        (instance.set_logging(true).unwrap_err(), "fmi2SetDebugLogging"),
    ] {
        assert!(matches!(error, FmiError::MissingFunction(f) if f == function), "{error}");
    }
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
    let error = instance.directional_derivative(&[], &[], &[], &mut []).unwrap_err();
    assert!(matches!(error, FmiError::MissingFunction("fmi2GetDirectionalDerivative")), "{error}");
}

#[test]
fn failed_instantiation_contains_log() {
    let error = evil(&["NOT_INSTANTIABLE"]).open().instantiate().unwrap_err();
    assert!(
        error.to_string().contains("fmi2Instantiate") && error.to_string().contains("no licence for evil"),
        "{error}"
    );
}

#[test]
fn unusable_fmu_reports_reason() {
    let folder = evil(&[]);
    let options = SimulateOptions::new().kind(InterfaceChoice::CoSimulation);
    let cs = SimulationPlan::new(&folder.open(), &options).unwrap_err();
    assert!(matches!(cs, FmiError::NotOffered { .. }), "{cs}");
    assert_eq!(cs.to_string(), "Evil does not support co-simulation; it supports model exchange");

    let folder = evil(&[]);
    std::fs::remove_dir_all(folder.path().join("binaries")).unwrap();
    std::fs::create_dir_all(folder.path().join("binaries/plan9")).unwrap();
    let error = folder.open().instantiate().unwrap_err();
    assert!(matches!(error, FmiError::NoBinary { .. }) && error.to_string().contains("plan9"), "{error}");

    let folder = evil(&[]);
    let library =
        fmi::platform::find_binary(folder.path(), "evil", fmi::platform::FolderNames::SystemAndBits)
            .unwrap()
            .path;
    let mut bytes = std::fs::read(&library).unwrap();
    bytes.truncate(200);
    std::fs::write(&library, bytes).unwrap();
    let error = folder.open().instantiate().unwrap_err();
    assert!(matches!(error, FmiError::LoadFailed { .. }), "{error}");
}

#[test]
fn start_values_are_checked_by_name_type_and_settability() {
    let folder = evil(&[]);
    let fmu = folder.open();
    let set = |name: &str, value: Value| {
        SimulationPlan::new(&fmu, &SimulateOptions::new().start_value(name, value))
            .map(|_| ())
            .map_err(|e| e.to_string())
    };
    for (name, value) in [
        ("k", Value::Real(2.0)),
        ("k", Value::Integer(2)),
        ("x", Value::Real(0.5)),
        ("n", Value::Integer(7)),
        ("n", Value::Real(7.0)),
        ("b", Value::Boolean(false)),
        ("label", "text".into()),
    ] {
        set(name, value).unwrap();
    }
    for (name, value, text) in [
        ("k", "text".into(), "k: expected a value of type Real, got \"text\" (String)"),
        ("k", Value::Boolean(true), "Boolean"),
        ("n", Value::Real(1.5), "n: expected a value of type Integer, got 1.5 (Real)"),
        ("b", Value::Integer(1), "b: expected a value of type Boolean"),
        ("label", Value::Real(1.0), "String"),
        ("label", "a\0b".into(), "NUL"),
        ("k", Value::Real(f64::NAN), "k: expected a finite number, got NaN"),
        ("k", Value::Real(f64::INFINITY), "k: expected a finite number, got inf"),
        ("c", Value::Real(1.0), "c cannot be set: it is a constant"),
        ("y", Value::Real(1.0), "y cannot be set: the model calculates it"),
        ("twice_k", Value::Real(1.0), "twice_k cannot be set: it is a calculated parameter"),
        ("time", Value::Real(1.0), "time cannot be set: it is the independent variable"),
        ("kk", Value::Real(1.0), "no variable \"kk\"; did you mean k"),
    ] {
        let error = set(name, value).unwrap_err();
        assert!(error.contains(text), "{error}");
    }
    for (name, kind) in [("n", "floating-point"), ("y", "calculates"), ("k2", "no variable")] {
        let error =
            SimulationPlan::new(&fmu, &SimulateOptions::new().parameters([name])).unwrap_err().to_string();
        assert!(error.contains(kind), "{error}");
    }
    let plan = SimulationPlan::new(&fmu, &SimulateOptions::new().outputs(["label"])).unwrap();
    let error = plan.require_single_numbers().unwrap_err();
    assert!(matches!(error, FmiError::NotAnOutput { .. }), "{error}");
}
