//! Runs do not depend on earlier runs.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::ode::Ignore;
use fmi::{Fmu, Session, SimulateOptions, SimulationPlan, Simulator};
use std::sync::Arc;
use support::evil;

fn options() -> SimulateOptions {
    SimulateOptions::new().ncp(10)
}

fn simulator(fmu: &Fmu) -> Simulator {
    Simulator::new(Arc::new(SimulationPlan::new(fmu, &options().parameters(["k"])).unwrap())).unwrap()
}

#[test]
fn runs_after_reset_match_runs_on_new_instances() {
    let folder = evil(&[]);
    let fmu = folder.open();
    let mut simulator = simulator(&fmu).resetting();
    let truths: Vec<_> = (0..7)
        .map(|i| {
            let k = 1.0 + f64::from(i);
            (k, self::simulator(&folder.open()).trajectory(&[k]).unwrap())
        })
        .collect();
    for (k, truth) in truths.iter().chain(&truths) {
        assert_eq!(simulator.trajectory(&[*k]).unwrap(), *truth);
    }
    assert!(fmu.quirks_seen().is_empty());
}

/// Errors of terminating or resetting an instance affect neither the finished run nor the next one.
#[test]
fn failed_terminate_or_reset_does_not_change_results() {
    for status in ["fmi2Error", "fmi2Discard", "fmi2Fatal"] {
        for call in ["TERMINATE", "RESET"] {
            let folder = evil(&[&format!("{call}={status}")]);
            let fmu = folder.open();
            let honest = evil(&[]);
            let (mut found, mut truth) = (simulator(&fmu).resetting(), simulator(&honest.open()));
            for round in 0..60 {
                let k = 1.0 + f64::from(round % 3);
                let columns = found.trajectory(&[k]).unwrap().columns;
                assert_eq!(columns, truth.trajectory(&[k]).unwrap().columns, "{call} {status}");
            }
        }
    }
}

#[test]
fn failed_runs_add_no_quirks() {
    for fault in ["ERROR_ABOVE=1.5", "FATAL_ABOVE=1.5", "NO_START"] {
        let folder = evil(&[fault]);
        let fmu = folder.open();
        let mut simulator = simulator(&fmu);
        for run in 0..60 {
            let k = if run % 3 == 0 { 1.0 } else { 2.0 };
            assert_eq!(
                simulator.run(&[k], &mut Ignore).is_ok(),
                k < 1.5 && fault != "NO_START",
                "{fault}: run {run}"
            );
        }
        assert!(fmu.quirks_seen().is_empty(), "{fault}: {:?}", fmu.quirks_seen());
    }
}

/// A non-finite input function is not a fault of the model, in any run.
#[test]
fn non_finite_input_function_adds_no_quirks() {
    use example_models::ExampleKind;
    use fmi::{Inputs, InterfaceChoice};
    for (kind, example) in [
        (InterfaceChoice::CoSimulation, ExampleKind::Fmi2CoSimulation),
        (InterfaceChoice::ModelExchange, ExampleKind::Fmi2ModelExchange),
    ] {
        let fmu = Fmu::open(example_models::example_fmu_as("quad_tank", example).unwrap()).unwrap();
        for before in 0..4 {
            let mut session = Session::of_kind(fmu.clone(), kind);
            let options = |ends: bool| {
                let is_over = std::sync::atomic::AtomicBool::new(false);
                // A function that has raised an exception returns no more values.
                let function = move |t: f64| {
                    is_over.fetch_or(ends && t > 4.0, std::sync::atomic::Ordering::Relaxed);
                    if is_over.load(std::sync::atomic::Ordering::Relaxed) { f64::NAN } else { 3.0 + 0.1 * t }
                };
                SimulateOptions::new().final_time(10.0).ncp(20).inputs(Inputs::new().function("u1", function))
            };
            let truth = session.simulate(&options(false)).unwrap();
            (0..before).for_each(|_| drop(session.simulate(&options(false)).unwrap()));
            session.simulate(&options(true)).unwrap_err();
            assert_eq!(session.simulate(&options(false)).unwrap().columns, truth.columns);
        }
        assert_eq!(fmu.quirks_seen(), vec![], "{kind:?}");
    }
}

/// As in a Simulink export: a parameter is in a static variable, which changes only when it is set.
#[test]
fn static_parameters_do_not_leak_between_users() {
    let folder = evil(&["STATIC_PARAMETERS"]);
    let fmu = folder.open();
    let truth = fmu.simulate(&options()).unwrap();
    for k in [3.0, 2.0] {
        let set = fmu.simulate(&options().start_value("k", k)).unwrap();
        assert!((set.final_value("y").unwrap().unwrap() - (-k).exp()).abs() < 1e-5);
        assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
        let mut instance = fmu.instantiate().unwrap();
        instance.set("k", k).unwrap();
        drop(instance.enter_initialization(0.0, None, None).unwrap());
        assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
    }
    // The result is also unchanged while another simulator exists.
    let mut setting = simulator(&fmu);
    setting.run(&[4.0], &mut Ignore).unwrap();
    assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
    assert_eq!(setting.get("twice_k").unwrap(), 8.0);
}
