//! Loaded library of an open FMU: access by threads, ownership and unloading.

#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::ode::{ErrorKind, Ignore};
use fmi::{
    FmiError, Fmu, Inputs, InterfaceChoice, Session, SharedSimulator, SimulateOptions, SimulationPlan,
    Simulator, Status, Trajectory,
};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use support::{Folder, evil, evil_with, evil_with_sibling, model_as};

const LONG: Duration = Duration::from_secs(60);

fn options() -> SimulateOptions {
    SimulateOptions::new().ncp(10)
}

fn simulator(fmu: &Fmu) -> Simulator {
    Simulator::new(Arc::new(SimulationPlan::new(fmu, &options().parameters(["k"])).unwrap())).unwrap()
}

/// True if the result is y(1) of y' = -k y.
fn is_of(k: f64, result: &Trajectory) -> bool {
    (result.final_value("y").unwrap().unwrap() - (-k).exp()).abs() < 1e-5
}

fn only_once(faults: &[&str]) -> Folder {
    evil_with(faults, |xml| {
        xml.replace("\"evil\"/>", "\"evil\" canBeInstantiatedOnlyOncePerProcess=\"true\"/>")
    })
}

/// The library ends the process if two threads are inside it.
#[test]
fn library_is_used_by_one_thread_at_a_time() {
    for folder in [evil(&["DIES_WITH_TWO"]), evil_with_sibling(&["DIES_WITH_TWO"], "alone")] {
        let fmu = folder.open();
        let plan = SimulationPlan::new(&fmu, &options().parameters(["k"])).unwrap();
        let pool = SharedSimulator::new(Arc::new(plan));
        std::thread::scope(|scope| {
            for thread in 0..4 {
                let (folder, fmu, pool) = (&folder, &fmu, &pool);
                scope.spawn(move || {
                    let mut session = Session::new(fmu.clone());
                    for round in 0..15 {
                        let k = f64::from(1 + thread + round % 3);
                        let of_pool = pool
                            .with_simulator(&base::RunContext::new(), |simulator| simulator.trajectory(&[k]));
                        assert!(is_of(k, &of_pool.unwrap()));
                        session.set("k", k).unwrap();
                        assert!(is_of(k, &session.simulate(&options()).unwrap()));
                        let mut by_hand =
                            fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
                        by_hand.get("k").unwrap();
                        // An FMU that no other thread uses.
                        let opened = folder.open();
                        assert!(is_of(k, &opened.simulate(&options().start_value("k", k)).unwrap()));
                    }
                });
            }
        });
    }
}

/// Each handle has a separate library. If the loader shares one library between them, their runs take turns.
#[test]
#[cfg_attr(windows, ignore = "builds an ELF library")]
fn opening_a_file_twice_gives_independent_models() {
    for folder in [
        evil(&["SHARED_GLOBALS"]),
        evil(&["STATIC_PARAMETERS"]),
        evil(&["LAST_ONLY"]),
        evil(&["UNIQUE_PARAMETERS"]),
        evil_with_sibling(&[], "common"),
    ] {
        std::thread::scope(|scope| {
            for k in [1.0, 2.0, 3.0] {
                let mut session = Session::new(folder.open());
                session.set("k", k).unwrap();
                scope.spawn(move || {
                    for _ in 0..20 {
                        assert!(is_of(k, &session.simulate(&options()).unwrap()));
                    }
                });
            }
        });
    }
    let folder = evil(&["SHARED_GLOBALS"]);
    let mut simulators = [2.0, 3.0].map(|k| (k, simulator(&folder.open())));
    for (k, simulator) in &mut simulators {
        simulator.run(&[*k], &mut Ignore).unwrap();
    }
    simulators.iter_mut().for_each(|(k, simulator)| assert_eq!(simulator.get("twice_k").unwrap(), 2.0 * *k));
}

/// Each instance has a separate library.
#[test]
fn single_instance_models_support_several_simulators() {
    use example_models::ExampleKind::{Fmi1CoSimulation, Fmi2CoSimulation, Fmi2ModelExchange, Fmi3};
    let folder = only_once(&["DIES_WITH_TWO_INSTANCES", "SHARED_GLOBALS"]);
    let fmu = folder.open();
    let mut simulators = [2.0, 3.0].map(|k| (k, simulator(&fmu)));
    for (k, simulator) in &mut simulators {
        simulator.run(&[*k], &mut Ignore).unwrap();
    }
    let mut instances: Vec<_> = (0..3).map(|_| fmu.instantiate().unwrap()).collect();
    for (i, instance) in instances.iter_mut().enumerate() {
        instance.set("k", 4.0 + i as f64).unwrap();
    }
    for (i, instance) in instances.into_iter().enumerate() {
        let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
        assert_eq!(instance.get("k").unwrap(), (4.0 + i as f64).into());
    }
    simulators.iter_mut().for_each(|(k, simulator)| assert_eq!(simulator.get("twice_k").unwrap(), 2.0 * *k));
    for (version, kind) in [
        (Fmi1CoSimulation, InterfaceChoice::Auto),
        (Fmi2CoSimulation, InterfaceChoice::Auto),
        (Fmi2ModelExchange, InterfaceChoice::Auto),
        (Fmi3, InterfaceChoice::ModelExchange),
        (Fmi3, InterfaceChoice::CoSimulation),
    ] {
        // FMI 1.0 has the flag only for co-simulation, in another element.
        let place =
            if version == Fmi1CoSimulation { "<Capabilities" } else { "modelIdentifier=\"dahlquist\"" };
        let flag = format!("{place} canBeInstantiatedOnlyOncePerProcess=\"true\"");
        let folder = model_as("dahlquist", version, &[], |xml| {
            assert!(!xml.contains("OnlyOncePerProcess"));
            xml.replace(place, &flag)
        });
        let options = SimulateOptions::new().parameters(["k"]).final_time(1.0).step_size(1e-3).kind(kind);
        let plan = Arc::new(SimulationPlan::new(&folder.open(), &options).unwrap());
        let mut simulators = [2.0f64, 3.0].map(|k| (k, Simulator::new(Arc::clone(&plan)).unwrap()));
        for (k, simulator) in &mut simulators {
            simulator.run(&[*k], &mut Ignore).unwrap();
        }
        for (k, simulator) in &mut simulators {
            let x = simulator.get("x").unwrap();
            assert!((x - (-*k).exp()).abs() < 1e-4, "{version:?}: {x}");
        }
    }
}

/// Runs `work` while a simulation waits in an input function, and then lets the simulation continue.
fn with_a_simulation_inside(fmu: &Fmu, work: impl FnOnce()) {
    let (entered, is_inside) = channel();
    let (go_on, may_go_on) = channel::<()>();
    let may_go_on = Mutex::new(may_go_on);
    let wait = move |_: f64| {
        let _ = entered.send(());
        let _ = may_go_on.lock().unwrap().recv();
        0.0
    };
    let options = options().inputs(Inputs::new().function("u", wait));
    std::thread::scope(|scope| {
        let running = scope.spawn(|| fmu.simulate(&options).map(|_| ()));
        is_inside.recv_timeout(LONG).unwrap();
        work();
        drop(go_on);
        running.join().unwrap().unwrap();
    });
}

fn driven(xml: String) -> String {
    let input = r#"<ScalarVariable name="u" valueReference="7" causality="input" variability="continuous">
        <Real start="0"/></ScalarVariable></ModelVariables>"#;
    xml.replace("</ModelVariables>", input)
}

/// A model is dropped while another thread is in the middle of a simulation.
#[test]
fn drop_does_not_wait_for_a_running_simulation() {
    let folder = evil_with(&["ONE_SET", "DIES_WITH_TWO"], driven);
    let fmu = folder.open();
    let mut sessions = [Session::new(fmu.clone()), Session::new(fmu.clone())];
    sessions.iter_mut().for_each(|session| drop(session.simulate(&options()).unwrap()));
    let instance = fmu.instantiate().unwrap();
    with_a_simulation_inside(&fmu, || {
        let (done, is_done) = channel();
        std::thread::spawn(move || {
            drop((sessions, instance));
            done.send(()).unwrap();
        });
        is_done.recv_timeout(LONG).unwrap();
    });
}

#[test]
fn waiting_simulation_ends_when_cancelled_or_timed_out() {
    let folder = evil_with(&["ONE_SET"], driven);
    let fmu = folder.open();
    fmu.prepare(InterfaceChoice::Auto, &fmi::CancelRequest::default()).unwrap();
    with_a_simulation_inside(&fmu, || {
        // Simulations that set the same variables share a library.
        let inputs = Inputs::new().table(vec![0.0, 1.0], [("u", vec![0.0, 0.0])]);
        let options = || options().inputs(inputs.clone());
        let kind = |options: SimulateOptions| match fmu.simulate(&options).unwrap_err() {
            FmiError::Simulation(error) => error.kind,
            error => panic!("{error}"),
        };
        let flag = Arc::new(AtomicBool::new(false));
        let raise = {
            let flag = Arc::clone(&flag);
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(50));
                flag.store(true, Ordering::Relaxed);
            })
        };
        assert!(matches!(kind(options().cancel(flag)), ErrorKind::Cancelled));
        raise.join().unwrap();
        let limit = Duration::from_millis(50);
        assert!(matches!(kind(options().timeout(limit)), ErrorKind::TimedOut(found) if found == limit));
        let plan = Arc::new(SimulationPlan::new(&fmu, &options()).unwrap());
        let mut poll = || std::ops::ControlFlow::Break(());
        assert!(Simulator::new(plan).unwrap().trajectory_with(&[], &mut poll).is_err());
    });
}

#[test]
fn simulator_can_be_dropped_on_another_thread() {
    let folder = evil(&["DIES_WITH_TWO"]);
    let fmu = folder.open();
    let mut simulators: Vec<Simulator> = (0..4).map(|_| simulator(&fmu)).collect();
    for simulator in &mut simulators {
        simulator.run(&[1.0], &mut Ignore).unwrap();
    }
    std::thread::scope(|scope| {
        for simulator in simulators {
            scope.spawn(move || drop(simulator));
        }
    });
}

#[test]
fn fatal_abandons_the_library_and_the_next_run_loads_another() {
    let folder = evil(&["FATAL_LATE"]);
    let fmu = folder.open();
    let mut other = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    for _ in 0..2 {
        let error = fmu.simulate(&options()).unwrap_err();
        assert_eq!(error.call_failure().unwrap().status, Status::Fatal);
        fmu.simulate(&options().final_time(0.25)).unwrap();
    }
    // Instances that the test controls use another library.
    assert_eq!(other.get("x").unwrap(), 1.0.into());
    let instance = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut stepping = instance.exit_initialization().unwrap().enter_continuous_time().unwrap();
    stepping.set_time(0.75).unwrap();
    for _ in 0..2 {
        let error = stepping.get_derivatives(&mut [0.0]).unwrap_err();
        assert_eq!(error.call_failure().unwrap().status, Status::Fatal);
    }
    let folder = evil(&["FATAL_ABOVE=50", "SHARED_GLOBALS"]);
    let mut simulator = simulator(&folder.open());
    let truth = simulator.trajectory(&[1.0]).unwrap();
    for _ in 0..3 {
        let error = simulator.run(&[100.0], &mut Ignore).unwrap_err();
        assert_eq!(error.call_failure().unwrap().status, Status::Fatal);
        assert_eq!(simulator.trajectory(&[1.0]).unwrap(), truth);
    }
}

#[test]
fn library_with_instance_limit_is_replaced() {
    let folder = evil(&["INSTANCES=5", "FAILING_RESET"]);
    let fmu = folder.open();
    let mut simulator = simulator(&fmu);
    let truth = simulator.trajectory(&[1.0]).unwrap();
    for _ in 0..30 {
        assert_eq!(simulator.trajectory(&[1.0]).unwrap().columns, truth.columns);
    }
    let messages: Vec<String> = fmu.quirks_seen().into_iter().map(|quirk| quirk.message).collect();
    assert!(
        messages.iter().any(|message| message.contains("only a limited number of instances")),
        "{messages:?}"
    );
}

#[test]
fn library_can_log_while_unloading() {
    let folder = evil(&["LOGS_AT_END"]);
    for _ in 0..5 {
        let fmu = folder.open();
        fmu.simulate(&options()).unwrap();
        fmu.simulate(&options()).unwrap();
    }
}

#[test]
#[cfg_attr(windows, ignore = "uses the threads of POSIX")]
fn thread_can_outlive_the_library() {
    let folder = evil(&["THREAD_DATA"]);
    let (sender, receiver) = channel::<()>();
    let (done, ready) = channel::<()>();
    let fmu = folder.open();
    let thread = std::thread::spawn(move || {
        fmu.simulate(&options()).unwrap();
        drop(fmu);
        done.send(()).unwrap();
        receiver.recv().unwrap();
    });
    ready.recv().unwrap();
    drop(folder);
    sender.send(()).unwrap();
    thread.join().unwrap();
}

#[test]
fn replaced_library_is_loaded_again() {
    let folder = evil(&[]);
    let library =
        fmi::platform::find_binary(folder.path(), "evil", fmi::platform::FolderNames::SystemAndBits)
            .unwrap()
            .path;
    let place = library.strip_prefix(folder.path()).unwrap();
    for (fault, ends_itself) in [("ENDS_ITSELF", true), ("STATIC_SCRATCH", false), ("ENDS_ITSELF", true)] {
        let other = evil(&[fault]);
        let aside = library.with_extension("new");
        std::fs::copy(other.path().join(place), &aside).unwrap();
        std::fs::rename(aside, &library).unwrap();
        let ended = folder.open().simulate(&options()).unwrap().termination;
        assert_eq!(ended == fmi::ode::Termination::StoppedByModel, ends_itself, "{fault}");
    }
}
