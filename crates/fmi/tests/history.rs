//! Models that keep a state which no variable shows: what ran before must not matter.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::ode::Ignore;
use fmi::{FmiError, Fmu, InterfaceKind, Pool, Reuse, Session, SimulateOptions, SimulationPlan, Simulator};
use std::sync::Arc;
use support::{Folder, evil, evil_with};

const ME: InterfaceKind = InterfaceKind::ModelExchange;

fn options() -> SimulateOptions {
    SimulateOptions::new().ncp(10)
}

fn simulator(fmu: &Fmu) -> Simulator {
    Simulator::new(Arc::new(SimulationPlan::new(fmu, &options().parameters(["k"])).unwrap())).unwrap()
}

fn saves_states(faults: &[&str]) -> Folder {
    evil_with(&[faults, &["STATES"]].concat(), |xml| {
        xml.replace("\"evil\"/>", "\"evil\" canGetAndSetFMUstate=\"true\"/>")
    })
}

/// The state appears at the fifth run; the next one that is made again in a new copy is the ninth.
#[test]
fn a_hidden_state_is_found_and_what_follows_is_right() {
    for (folder, wanted) in [
        (evil(&["REMEMBERS=1.5"]), Reuse::Reload),
        (saves_states(&["REMEMBERS=1.5"]), Reuse::Reload),
        (evil(&["REMEMBERS_IN_INSTANCE=1.5"]), Reuse::Reinstantiate),
        (saves_states(&["REMEMBERS_IN_INSTANCE=1.5"]), Reuse::Reinstantiate),
    ] {
        let truth = simulator(&folder.open()).trajectory(&[1.0]).unwrap().columns;
        let other = Fmu::open(folder.path()).unwrap();
        let fmu = folder.open();
        let mut simulator = simulator(&fmu);
        for run in 1..=40 {
            let k = if run == 5 { 2.0 } else { 1.0 };
            let found = simulator.trajectory(&[k]).unwrap().columns;
            assert!(k > 1.0 || !(1..6).contains(&run) || found == truth, "{wanted:?}: run {run}");
            assert!(k > 1.0 || run < 9 || found == truth, "{wanted:?}: run {run}");
        }
        assert_eq!(fmu.reuse_of(ME), Some(wanted));
        assert_eq!(fmu.n_history_findings(ME), 1);
        let quirks = fmu.quirks_seen();
        assert!(quirks.iter().any(|quirk| quirk.message.contains("no variable shows")), "{quirks:?}");
        // Nor for others who have it open.
        let mut session = Session::new(other);
        for k in [2.0, 1.0, 2.0, 1.0] {
            session.set("k", k).unwrap();
            let found = session.simulate(&options()).unwrap().columns;
            assert!(k > 1.0 || found.iter().zip(&truth).all(|(a, b)| a == b), "{wanted:?}");
        }
    }
}

#[test]
fn a_change_of_the_plan_is_looked_at() {
    let folder = evil(&["REMEMBERS=1.5"]);
    let fmu = folder.open();
    let truth = fmu.simulate(&options()).unwrap();
    // Runs 4 and 6 are none of those that are made again for their number.
    for _ in 0..2 {
        assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
    }
    fmu.simulate(&options().final_time(0.5).start_value("k", 2.0)).unwrap();
    assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
}

/// The fourth run is none of those that are made again.
#[test]
fn all_copies_of_a_pool_can_be_looked_at() {
    let plan = |fmu: &Fmu| Arc::new(SimulationPlan::new(fmu, &options().parameters(["k"])).unwrap());
    for (fault, expected) in [("REMEMBERS=1.5", true), ("REMEMBERS_IN_INSTANCE=1.5", true), ("NONE", false)] {
        let folder = evil(&[fault]);
        let pool = Pool::new(plan(&folder.open()));
        for k in [1.0, 1.0, 1.0, 2.0] {
            pool.lend().unwrap().run(&[k], &mut Ignore).unwrap();
        }
        assert!(!pool.depends_on_history(&[1.0], &|| true).unwrap());
        assert_eq!(pool.depends_on_history(&[1.0], &|| false).unwrap(), expected, "{fault}");
        assert!(!pool.depends_on_history(&[1.0], &|| false).unwrap());
    }
}

#[test]
fn an_honest_model_is_left_alone() {
    let folder = evil(&[]);
    let fmu = folder.open();
    let mut simulator = simulator(&fmu);
    for run in 0..40 {
        simulator.run(&[1.0 + f64::from(run % 7)], &mut Ignore).unwrap();
    }
    assert_eq!((fmu.reuse_of(ME), fmu.n_history_findings(ME)), (Some(Reuse::Reset), 0));
    assert!(fmu.quirks_seen().is_empty());
}

/// Ending or resetting the instance of a run that is over changes nothing of that run, nor of the next.
#[test]
fn instances_that_cannot_be_ended_or_reset_cost_nothing() {
    for status in ["fmi2Error", "fmi2Discard", "fmi2Fatal"] {
        for call in ["TERMINATE", "RESET"] {
            let folder = evil(&[&format!("{call}={status}"), "SHARED_GLOBALS"]);
            let fmu = folder.open();
            let pool = Pool::new(Arc::new(SimulationPlan::new(&fmu, &options().parameters(["k"])).unwrap()));
            let honest = evil(&[]);
            let mut truth = simulator(&honest.open());
            for round in 0..6 {
                let k = 1.0 + f64::from(round % 3);
                let found = pool.lend().unwrap().trajectory(&[k]).unwrap();
                assert_eq!(found.columns, truth.trajectory(&[k]).unwrap().columns, "{call} {status}");
                let mut alone = simulator(&fmu);
                alone.run(&[2.0], &mut Ignore).unwrap();
                assert_eq!(alone.trajectory(&[k]).unwrap().columns, found.columns, "{call} {status}");
            }
        }
    }
}

#[test]
fn a_copy_that_can_be_instantiated_so_often_is_followed_by_another() {
    let folder = evil(&["INSTANCES=5", "FAILING_RESET"]);
    let fmu = folder.open();
    let mut simulator = simulator(&fmu);
    let truth = simulator.trajectory(&[1.0]).unwrap();
    for _ in 0..30 {
        assert_eq!(simulator.trajectory(&[1.0]).unwrap().columns, truth.columns);
    }
    let messages: Vec<String> = fmu.quirks_seen().into_iter().map(|quirk| quirk.message).collect();
    assert!(messages.iter().any(|message| message.contains("only so often")), "{messages:?}");
    assert!(messages.iter().any(|message| message.contains("reset function")), "{messages:?}");
}

/// The runs from the seventh on fail in every loaded copy, which none of the runs that are made again for their number shows before
/// the ninth.
#[test]
fn a_failure_that_depends_on_earlier_runs_is_none() {
    for fault in ["FAILING_START", "FAILING_LATE"] {
        for status in ["fmi2Error", "fmi2Fatal", "fmi2Discard"] {
            let folder = evil(&[&format!("{fault}={status}"), "ODD_RUN=runs>=9"]);
            let fmu = folder.open();
            let mut simulator = simulator(&fmu);
            let truth = simulator.trajectory(&[1.0]).unwrap().columns;
            for run in 1..20 {
                let found = simulator.trajectory(&[1.0]).unwrap().columns;
                assert_eq!(found, truth, "{fault} {status}: run {run}");
            }
            assert_eq!((fmu.reuse_of(ME), fmu.n_history_findings(ME)), (Some(Reuse::Reload), 1));
        }
    }
}

/// Whoever watches a run that fails so is told to make it again.
#[test]
fn an_observer_sees_no_run_twice() {
    let folder = evil(&["FAILING_LATE=fmi2Error", "ODD_RUN=runs>=9"]);
    let mut simulator = simulator(&folder.open());
    let mut failures =
        (1..20).filter_map(|run| simulator.run(&[1.0], &mut Ignore).err().map(|error| (run, error)));
    let (run, error) = failures.next().unwrap();
    assert!(matches!(error, FmiError::FailedByHistory { .. }) && run <= 7, "{run}: {error}");
    assert!(failures.next().is_none());
}

/// Initial values, which are no run.
#[test]
fn initial_values_do_not_fail_because_of_earlier_runs() {
    let folder = evil(&["FAILING_START=fmi2Error", "ODD_RUN=runs>=4"]);
    let fmu = folder.open();
    for _ in 0..6 {
        assert_eq!(Session::new(fmu.clone()).get("twice_k").unwrap().as_number(), Some(2.0));
    }
}

#[test]
fn honest_failures_are_left_alone() {
    for fault in ["ERROR_ABOVE=1.5", "FATAL_ABOVE=1.5", "NO_START"] {
        let folder = evil(&[fault]);
        let fmu = folder.open();
        let mut simulator = simulator(&fmu);
        for run in 0..40 {
            let k = if run % 3 == 0 { 1.0 } else { 2.0 };
            assert_eq!(
                simulator.run(&[k], &mut Ignore).is_ok(),
                k < 1.5 && fault != "NO_START",
                "{fault}: run {run}"
            );
        }
        assert_eq!(fmu.n_history_findings(ME), 0, "{fault}");
        assert!(fmu.quirks_seen().is_empty(), "{fault}: {:?}", fmu.quirks_seen());
    }
}

/// An input function that is not finite says nothing about the model, whichever run it is.
#[test]
fn runs_that_an_input_function_ends_are_not_compared() {
    use example_models::ExampleKind;
    use fmi::{Inputs, Kind};
    for (kind, example) in [
        (Kind::CoSimulation, ExampleKind::Fmi2CoSimulation),
        (Kind::ModelExchange, ExampleKind::Fmi2ModelExchange),
    ] {
        let fmu = Fmu::open(example_models::example_fmu_as("quad_tank", example).unwrap()).unwrap();
        for before in 0..6 {
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
        let kind = fmu.choose(kind).unwrap();
        assert_eq!((fmu.n_history_findings(kind), fmu.quirks_seen()), (0, vec![]), "{kind}");
    }
}

/// The check of reset says nothing where runs fail on new instances, too.
#[test]
fn a_run_that_fails_does_not_accuse_the_reset_function() {
    for fault in ["ERROR_ABOVE=1.5", "FAILING_LATE=K(m)>1.5?fmi2Error:fmi2OK"] {
        let folder = evil(&[fault, "ODD_RUN=K(m)>1.5"]);
        let fmu = folder.open();
        let mut simulator = simulator(&fmu);
        simulator.run(&[1.0], &mut Ignore).unwrap();
        simulator.run(&[2.0], &mut Ignore).unwrap_err();
        for _ in 0..3 {
            simulator.run(&[1.0], &mut Ignore).unwrap();
        }
        assert_eq!((fmu.reuse_of(ME), fmu.quirks_seen()), (Some(Reuse::Reset), vec![]), "{fault}");
        // And that of a pool, whose reference fails.
        let fmu = evil(&[fault, "ODD_RUN=K(m)>1.5"]);
        let options = options().parameters(["k"]).start_value("k", 2.0);
        let plan = Arc::new(SimulationPlan::new(&fmu.open(), &options).unwrap());
        let pool = Pool::new(Arc::clone(&plan));
        drop(pool.lend().unwrap());
        assert_eq!(plan.fmu().quirks_seen(), vec![], "{fault}");
    }
}
