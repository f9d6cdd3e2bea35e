//! Loaded copies of libraries: who has them, what was set in them, what copies would share, and what happens when there are no
//! more.

#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::ode::Ignore;
use fmi::{
    FmiError, Fmu, Inputs, InterfaceKind, Pool, Session, Sharing, SimulateOptions, SimulationPlan, Simulator,
    Trajectory, Value,
};
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;
use support::{Folder, evil, evil_with, evil_with_sibling};

const LONG: Duration = Duration::from_secs(60);

fn options() -> SimulateOptions {
    SimulateOptions::new().ncp(10)
}

fn pool(fmu: &Fmu, options: SimulateOptions) -> Pool {
    Pool::new(Arc::new(SimulationPlan::new(fmu, &options.parameters(["k"])).unwrap()))
}

/// The description says another start value than the library has.
fn rounded(faults: &[&str]) -> Folder {
    evil_with(faults, |xml| {
        let start = "variability=\"fixed\"><Real start=\"1\"/>";
        assert!(xml.contains(start));
        xml.replace(start, "variability=\"fixed\"><Real start=\"1.00000001\"/>")
    })
}

/// y(1) of y' = -k y.
fn is_of(k: f64, result: &Trajectory) -> bool {
    (result.final_value("y").unwrap().unwrap() - (-k).exp()).abs() < 1e-5
}

#[test]
fn parameters_that_the_library_keeps_are_set_again() {
    let folder = rounded(&["STATIC_PARAMETERS"]);
    let fmu = folder.open();
    let truth = fmu.simulate(&options()).unwrap();
    assert!(is_of(1.0, &truth));
    let with = |k: f64| fmu.simulate(&options().start_value("k", k)).unwrap();
    for k in [3.0, 2.0] {
        assert!(is_of(k, &with(k)));
        // To what a new instance answers, bit for bit, not to what the description says.
        assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
        assert_eq!(folder.open().simulate(&options()).unwrap().columns, truth.columns);
    }
    let pool = pool(&fmu, options());
    let first = pool.lend().unwrap().trajectory(&[3.0]).unwrap();
    let mut session = Session::new(fmu.clone());
    for k in [2.0, 5.0] {
        session.set("k", k).unwrap();
        assert!(is_of(k, &session.simulate(&options()).unwrap()));
        assert_eq!(pool.lend().unwrap().trajectory(&[3.0]).unwrap().columns, first.columns);
    }
    session.reset();
    assert_eq!(session.simulate(&options()).unwrap().columns, truth.columns);
    assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
}

/// There the only copy is asked before anything is set in it.
#[test]
fn parameters_that_a_sibling_keeps_are_set_again() {
    let folder = evil_with_sibling(&["KEPT_IN_SIBLING"], "keeper");
    let fmu = folder.open();
    let truth = fmu.simulate(&options()).unwrap();
    for k in [3.0, 2.0] {
        assert!(is_of(k, &fmu.simulate(&options().start_value("k", k)).unwrap()));
        assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
    }
    assert_eq!(fmu.sharing_of(InterfaceKind::ModelExchange), Some(Sharing::Serial));
}

#[test]
fn what_is_set_by_hand_does_not_stay_either() {
    let folder = rounded(&["STATIC_PARAMETERS"]);
    let fmu = folder.open();
    let truth = fmu.simulate(&options()).unwrap();
    for k in [2.0, 3.0, 4.0] {
        let mut instance = fmu.instantiate().unwrap();
        instance.set("k", k).unwrap();
        let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
        assert_eq!(instance.get("k").unwrap(), Value::Real(k));
        drop(instance);
        let mut next = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
        assert_eq!(next.get("k").unwrap(), Value::Real(1.0));
        drop(next);
        assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
    }
}

#[test]
fn two_owners_in_one_thread_do_not_disturb_each_other() {
    for folder in [evil(&["SHARED_GLOBALS"]), evil(&["LAST_ONLY"]), evil(&["STATIC_PARAMETERS"])] {
        let fmu = folder.open();
        let mut sessions: Vec<Session> = (0..3).map(|_| Session::new(fmu.clone())).collect();
        for round in 0..3 {
            for (i, session) in sessions.iter_mut().enumerate() {
                let k = 1.0 + i as f64 + f64::from(round);
                session.set("k", k).unwrap();
                assert!(is_of(k, &session.simulate(&options()).unwrap()));
            }
            for (i, session) in sessions.iter_mut().enumerate() {
                let k = 1.0 + i as f64 + f64::from(round);
                assert_eq!(session.get("twice_k").unwrap(), Value::Real(2.0 * k));
            }
        }
    }
}

/// The library ends the process when two threads are in it.
#[test]
fn no_two_threads_are_in_one_copy() {
    for (folder, sharing) in [
        (evil(&["DIES_WITH_TWO"]), Sharing::Copies),
        (evil(&["DIES_WITH_TWO"]), Sharing::Serial),
        (evil_with_sibling(&["DIES_WITH_TWO"], "alone"), Sharing::Copies),
    ] {
        let fmu = folder.open();
        let pools =
            [pool(&fmu, options().sharing(sharing)), pool(&folder.open(), options().sharing(sharing))];
        std::thread::scope(|scope| {
            for thread in 0..4 {
                let (pools, fmu) = (&pools, &fmu);
                scope.spawn(move || {
                    let mut session = Session::new(fmu.clone());
                    for round in 0..20 {
                        let k = f64::from(1 + thread + round % 3);
                        let result = pools[round as usize % 2].lend().unwrap().trajectory(&[k]).unwrap();
                        assert!(is_of(k, &result));
                        if sharing == Sharing::Copies {
                            session.set("k", k).unwrap();
                            assert!(is_of(k, &session.simulate(&options()).unwrap()));
                        }
                    }
                });
            }
        });
    }
}

#[test]
fn together_is_one_copy_for_all() {
    let folder = evil(&["SHARED_GLOBALS"]);
    let pool = pool(&folder.open(), options().sharing(Sharing::Together));
    let (mut first, mut second) = (pool.lend().unwrap(), pool.lend().unwrap());
    first.run(&[2.0], &mut Ignore).unwrap();
    second.run(&[3.0], &mut Ignore).unwrap();
    assert_eq!(first.get("twice_k").unwrap(), 6.0, "the instances share their static variables");
    assert_eq!(pool.sharing().unwrap(), Sharing::Together);
}

#[test]
fn names_of_the_ways_of_sharing() {
    for (name, sharing) in Sharing::NAMES {
        assert_eq!((name.parse::<Sharing>().unwrap(), sharing.name()), (sharing, name));
    }
    let error = "copy".parse::<Sharing>().unwrap_err().to_string();
    assert!(["copy", "copies", "serial", "together"].iter().all(|name| error.contains(name)), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn variables_that_are_unique_in_the_process_are_read_from_the_file() {
    let folder = evil(&["UNIQUE_PARAMETERS"]);
    let fmu = folder.open();
    let pool = pool(&fmu, options());
    assert_eq!(pool.sharing().unwrap(), Sharing::Serial);
    std::thread::scope(|scope| {
        for k in [1.0, 2.0, 3.0] {
            let pool = &pool;
            scope.spawn(move || {
                for _ in 0..20 {
                    assert!(is_of(k, &pool.lend().unwrap().trajectory(&[k]).unwrap()));
                }
            });
        }
    });
}

/// Where there is one copy only, it goes to whoever runs next.
#[test]
fn where_there_is_one_copy_it_changes_hands() {
    let folder = evil_with_sibling(&[], "handed");
    let once =
        |xml: String| xml.replace("\"evil\"/>", "\"evil\" canBeInstantiatedOnlyOncePerProcess=\"true\"/>");
    let description = folder.path().join("modelDescription.xml");
    std::fs::write(&description, once(std::fs::read_to_string(&description).unwrap())).unwrap();
    let fmu = folder.open();
    let mut session = Session::new(fmu.clone());
    let first = session.simulate(&options()).unwrap();
    assert!(session.get("y").is_ok());
    let pool = pool(&fmu, options());
    assert!(is_of(2.0, &pool.lend().unwrap().trajectory(&[2.0]).unwrap()));
    let error = session.get("y").unwrap_err();
    assert!(
        matches!(error, FmiError::Disturbed { .. }) && error.to_string().contains("simulate again"),
        "{error}"
    );
    assert_eq!(session.simulate(&options()).unwrap(), first);
    assert!(session.get("y").is_ok());
    // An instance made by hand stays; the message says what to do.
    let instance = fmu.instantiate().unwrap();
    let error = session.simulate(&options()).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, FmiError::NoCopy { .. }) && text.contains("by hand"), "{text}");
    assert!(text.contains("libhanded"), "{text}");
    drop(instance);
    assert_eq!(session.simulate(&options()).unwrap(), first);
    // A thread does not wait for itself.
    let (mut lease, mut other) = (pool.lend().unwrap(), pool.lend().unwrap());
    lease.run(&[1.0], &mut Ignore).unwrap();
    assert!(matches!(other.run(&[1.0], &mut Ignore), Err(FmiError::NoCopy { .. })));
    drop(lease);
    other.run(&[1.0], &mut Ignore).unwrap();
}

/// A model is dropped while another thread is in the middle of a simulation.
#[test]
fn dropping_waits_for_nobody() {
    let driven = |xml: String| {
        let input = r#"<ScalarVariable name="u" valueReference="7" causality="input" variability="continuous">
            <Real start="0"/></ScalarVariable></ModelVariables>"#;
        xml.replace("</ModelVariables>", input)
    };
    let sibling = evil_with_sibling(&["ONE_SET"], "slow");
    let description = sibling.path().join("modelDescription.xml");
    std::fs::write(&description, driven(std::fs::read_to_string(&description).unwrap())).unwrap();
    for folder in [evil_with(&["ONE_SET"], driven), sibling] {
        let fmu = folder.open();
        let mut session = Session::new(fmu.clone());
        session.simulate(&options()).unwrap();
        let mut other = Session::new(fmu.clone());
        other.simulate(&options()).unwrap();
        let (entered, is_inside) = channel();
        let (go_on, may_go_on) = channel::<()>();
        let may_go_on = std::sync::Mutex::new(may_go_on);
        let wait = move |_: f64| {
            let _ = entered.send(());
            let _ = may_go_on.lock().unwrap().recv();
            0.0
        };
        let inputs = Inputs::new().function("u", wait);
        let running = {
            let fmu = fmu.clone();
            std::thread::spawn(move || fmu.simulate(&options().inputs(inputs)).map(|_| ()))
        };
        is_inside.recv_timeout(LONG).unwrap();
        let (done, is_done) = channel();
        std::thread::spawn(move || {
            session.reset();
            drop((session, other));
            done.send(()).unwrap();
        });
        is_done.recv_timeout(LONG).unwrap();
        drop(go_on);
        running.join().unwrap().unwrap();
    }
}

/// A cancelled simulation does not wait either.
#[test]
fn waiting_for_a_copy_can_be_cancelled() {
    let folder = evil_with_sibling(&[], "waited");
    let fmu = folder.open();
    let pool = pool(&fmu, options());
    let mut lease = pool.lend().unwrap();
    lease.run(&[1.0], &mut Ignore).unwrap();
    let flag = Arc::new(std::sync::atomic::AtomicBool::new(false));
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| fmu.simulate(&options().cancel(Arc::clone(&flag))).map(|_| ()));
        std::thread::sleep(Duration::from_millis(50));
        flag.store(true, std::sync::atomic::Ordering::Relaxed);
        let error = waiting.join().unwrap().unwrap_err();
        assert!(matches!(error, FmiError::Simulation(_)), "{error}");
    });
}

/// Nothing is loaded again when an FMU is opened again.
#[cfg(target_os = "linux")]
#[test]
fn copies_are_used_again_by_who_opens_the_fmu_next() {
    let path = example_models::example_fmu("stair").unwrap();
    let mapped = || {
        let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
        let files = maps
            .lines()
            .filter(|line| line.contains("stair.so"))
            .filter_map(|line| line.split_whitespace().nth(4));
        files.collect::<std::collections::HashSet<_>>().len()
    };
    let round = || {
        let fmu = Fmu::open(&path).unwrap();
        let mut first = Session::new(fmu.clone());
        let mut second = Session::new(fmu);
        let options = SimulateOptions::new().final_time(2.0).ncp(2);
        assert_eq!(first.simulate(&options).unwrap(), second.simulate(&options).unwrap());
    };
    round();
    let before = mapped();
    for _ in 0..50 {
        round();
    }
    assert_eq!((before, mapped()), (2, 2));
}

/// The library ends the process when two instances of it are alive in one copy.
#[test]
fn there_is_one_instance_in_a_copy() {
    let faults = &["DIES_WITH_TWO_INSTANCES", "RESET_TO_ZERO"];
    for folder in [evil(faults), evil_with_sibling(faults, "single")] {
        let fmu = folder.open();
        let truth = fmu.simulate(&options()).unwrap();
        for k in [2.0, 3.0] {
            // After one whose instance is idle: by a pool, by a session, by a plan with other settings, by hand.
            let pool = pool(&fmu, options());
            assert!(is_of(k, &pool.lend().unwrap().trajectory(&[k]).unwrap()));
            let mut session = Session::new(fmu.clone());
            session.set("k", k).unwrap();
            assert!(is_of(k, &session.simulate(&options()).unwrap()));
            assert!(is_of(k, &pool.lend().unwrap().trajectory(&[k]).unwrap()));
            assert_eq!(fmu.simulate(&options()).unwrap().columns, truth.columns);
            let first = options().start_value("x", 1.0);
            assert_eq!(fmu.simulate(&first).unwrap().columns, truth.columns);
            drop((pool, session));
            fmu.instantiate().unwrap();
        }
    }
}

/// Many pools need no more copies than simulators run at once.
#[cfg(target_os = "linux")]
#[test]
fn a_copy_that_lies_in_a_pool_is_lent_to_another_pool() {
    let fmu = Fmu::open(example_models::example_fmu("van_der_pol").unwrap()).unwrap();
    let pools: Vec<Pool> = (0..5)
        .map(|i| {
            let options = SimulateOptions::new().final_time(1.0 + f64::from(i)).ncp(2).parameters(["mu"]);
            Pool::new(Arc::new(SimulationPlan::new(&fmu, &options).unwrap()))
        })
        .collect();
    let run = |pool: &Pool, mu: f64| pool.lend().unwrap().trajectory(&[mu]).unwrap();
    let truths: Vec<Trajectory> = pools.iter().map(|pool| run(pool, 1.5)).collect();
    for mu in [2.0, 1.5, 0.5, 1.5] {
        for (pool, truth) in pools.iter().zip(&truths) {
            let found = run(pool, mu);
            assert!(mu != 1.5 || found == *truth);
        }
    }
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let files = maps.lines().filter(|line| line.contains("van_der_pol.so"));
    let files: std::collections::HashSet<_> =
        files.filter_map(|line| line.split_whitespace().nth(4)).collect();
    assert_eq!(files.len(), 1);
}

#[test]
fn a_simulator_can_be_dropped_on_another_thread() {
    let folder = evil(&["DIES_WITH_TWO"]);
    let fmu = folder.open();
    let plan = Arc::new(SimulationPlan::new(&fmu, &options()).unwrap());
    let mut simulators: Vec<Simulator> = (0..4).map(|_| Simulator::new(Arc::clone(&plan)).unwrap()).collect();
    for simulator in &mut simulators {
        simulator.run(&[], &mut Ignore).unwrap();
    }
    std::thread::scope(|scope| {
        for simulator in simulators {
            scope.spawn(move || drop(simulator));
        }
    });
}
