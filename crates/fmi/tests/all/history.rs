//! What ran before must not matter; where it does on new instances too, the model is found out.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::description::QuirkKind;
use fmi::ode::Ignore;
use fmi::{Fmu, InterfaceChoice, InterfaceKind, Reuse, Session, SimulateOptions, SimulationPlan, Simulator};
use std::sync::Arc;
use support::{evil, evil_with, settle};

const ME: InterfaceKind = InterfaceKind::ModelExchange;

fn options() -> SimulateOptions {
    SimulateOptions::new().ncp(10)
}

fn simulator(fmu: &Fmu) -> Simulator {
    Simulator::new(Arc::new(SimulationPlan::new(fmu, &options().parameters(["k"])).unwrap())).unwrap()
}

/// The state appears with k above the limit, which the other values of the check are.
#[test]
fn a_state_outside_of_the_instances_wants_a_process_for_every_run() {
    let folder = evil(&["REMEMBERS=1.01"]);
    let fmu = folder.open();
    let mut simulator = simulator(&fmu);
    assert_eq!(settle(&mut simulator, &[1.0]), Reuse::NewProcess);
    let quirks = fmu.quirks_seen();
    assert_eq!(
        quirks.iter().map(|quirk| quirk.kind).collect::<Vec<_>>(),
        [QuirkKind::HiddenState],
        "{quirks:?}"
    );
    assert!(quirks[0].message.contains("isolation = \"process\""), "{quirks:?}");
    // Runs go on, and nothing is checked any more.
    assert_eq!(simulator.run(&[1.0], &mut Ignore).unwrap().stats.checks.runs, 0);
    assert_eq!(fmu.reuse_of(ME), Some(Reuse::NewProcess));
}

/// Neither reset nor a saved state renews it, a new instance does.
#[test]
fn a_state_of_an_instance_wants_new_instances() {
    let folder = evil(&["REMEMBERS_IN_INSTANCE=1.01"]);
    let truth = simulator(&folder.open()).trajectory(&[1.0]).unwrap().columns;
    let fmu = folder.open();
    let mut simulator = simulator(&fmu);
    assert_eq!(settle(&mut simulator, &[1.0]), Reuse::Reinstantiate);
    for k in [2.0, 1.0, 3.0, 1.0] {
        let found = simulator.trajectory(&[k]).unwrap().columns;
        assert!(k > 1.0 || found == truth);
    }
}

#[test]
fn an_honest_model_is_left_alone() {
    let folder = evil(&[]);
    let fmu = folder.open();
    let mut simulator = simulator(&fmu);
    assert_eq!(settle(&mut simulator, &[1.0]), Reuse::Reset);
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

/// The check is counted, and takes no more than a tenth of the runs before it.
#[test]
fn a_check_is_a_part_of_the_runs_before_it_and_is_counted() {
    let folder = evil(&[]);
    let plan = SimulationPlan::new(&folder.open(), &options().max_step(1e-4).parameters(["k"])).unwrap();
    let mut simulator = Simulator::new(Arc::new(plan)).unwrap();
    let first = simulator.run(&[1.0], &mut Ignore).unwrap().stats;
    let n_steps = first.accepted_steps + first.rejected_steps;
    assert_eq!(first.checks.runs, 0);
    let mut runs = 1;
    let checks = loop {
        let stats = simulator.run(&[1.0], &mut Ignore).unwrap().stats;
        assert_eq!(stats, first);
        if stats.checks.runs > 0 {
            assert!(stats.seconds.get() > stats.checks.seconds.get());
            break stats.checks;
        }
        runs += 1;
        assert!(runs < 1000);
    };
    assert_eq!(checks.runs, 4);
    assert!(checks.steps > 0 && checks.steps * 10 <= n_steps, "{checks:?} of {n_steps}");
    assert_eq!(simulator.run(&[1.0], &mut Ignore).unwrap().stats.checks.runs, 0);
}

/// A slow co-simulation makes hardly more steps than it is asked for, in whichever run the check is due.
#[test]
fn a_second_co_simulation_makes_at_most_a_tenth_more_steps() {
    let counted = tempfile::NamedTempFile::new().unwrap();
    let co_simulation =
        r#"<CoSimulation modelIdentifier="evil" canHandleVariableCommunicationStepSize="true"/>"#;
    let fault = format!("STEPS_FILE=\"{}\"", counted.path().display());
    let folder =
        evil_with(&[&fault], |xml| xml.replace(r#"<ModelExchange modelIdentifier="evil"/>"#, co_simulation));
    let mut session = Session::new(folder.open());
    let options = SimulateOptions::new().kind(InterfaceChoice::CoSimulation).final_time(1.0).step_size(2e-3);
    let mut n_before = 0;
    let steps = [(); 4].map(|()| {
        session.simulate(&options).unwrap();
        let n = counted.as_file().metadata().unwrap().len();
        n - std::mem::replace(&mut n_before, n)
    });
    assert_eq!(steps[0], 500);
    assert!(steps.iter().all(|n| (500..=550).contains(n)) && steps.iter().any(|n| *n > 500), "{steps:?}");
}

/// Ending or resetting the instance of a run that is over changes nothing of that run, nor of the next.
#[test]
fn instances_that_cannot_be_ended_or_reset_cost_nothing() {
    for status in ["fmi2Error", "fmi2Discard", "fmi2Fatal"] {
        for call in ["TERMINATE", "RESET"] {
            let folder = evil(&[&format!("{call}={status}")]);
            let fmu = folder.open();
            let honest = evil(&[]);
            let (mut found, mut truth) = (simulator(&fmu), simulator(&honest.open()));
            for round in 0..60 {
                let k = 1.0 + f64::from(round % 3);
                let columns = found.trajectory(&[k]).unwrap().columns;
                assert_eq!(columns, truth.trajectory(&[k]).unwrap().columns, "{call} {status}");
            }
        }
    }
}

#[test]
fn honest_failures_are_left_alone() {
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

/// An input function that is not finite says nothing about the model, whichever run it is.
#[test]
fn runs_that_an_input_function_ends_say_nothing() {
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
                // As a function does that has raised an exception: it has no value from then on.
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

/// The check of reset says nothing where runs fail on new instances, too.
#[test]
fn a_run_that_fails_does_not_accuse_the_reset_function() {
    for fault in ["ERROR_ABOVE=1.5", "FAILING_LATE=K(m)>1.5?fmi2Error:fmi2OK"] {
        let folder = evil(&[fault, "ODD_RUN=K(m)>1.5"]);
        let fmu = folder.open();
        let mut simulator = simulator(&fmu);
        simulator.run(&[2.0], &mut Ignore).unwrap_err();
        for _ in 0..50 {
            simulator.run(&[2.0], &mut Ignore).unwrap_err();
        }
        assert_eq!(fmu.quirks_seen(), vec![], "{fault}");
        assert_eq!(settle(&mut self::simulator(&folder.open()), &[1.0]), Reuse::Reset, "{fault}");
    }
}

/// As Simulink exports it: a parameter is in a static variable, which is changed by nothing but being set.
#[test]
fn what_others_have_set_is_not_there() {
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
    // Also while others have theirs.
    let mut setting = simulator(&fmu);
    setting.run(&[4.0], &mut Ignore).unwrap();
    assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
    assert_eq!(setting.get("twice_k").unwrap(), 8.0);
}
