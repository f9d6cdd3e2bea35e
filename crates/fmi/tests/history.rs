//! Models that keep a state which no variable shows: what ran before must not matter.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::ode::Ignore;
use fmi::{Fmu, InterfaceKind, Pool, Reuse, Session, SimulateOptions, SimulationPlan, Simulator};
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
