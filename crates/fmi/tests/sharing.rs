//! What instances of one library do to each other, and what they leave behind.

#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::ode::Ignore;
use fmi::{
    FmiError, Fmu, InterfaceKind, Kind, Pool, Reuse, Session, Sharing, SimulateOptions, SimulationPlan,
    Simulator, Status,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use support::{Folder, evil, evil_with, evil_with_sibling, model_as};

fn pool(fmu: &Fmu, options: &SimulateOptions) -> Pool {
    Pool::new(Arc::new(SimulationPlan::new(fmu, options).unwrap()))
}

fn with_k() -> SimulateOptions {
    SimulateOptions::new().parameters(["k"])
}

fn run(pool: &Pool, k: f64) -> f64 {
    pool.lend().unwrap().trajectory(&[k]).unwrap().final_value("y").unwrap().unwrap()
}

fn only_once() -> Folder {
    evil_with(&[], |xml| xml.replace("\"evil\"/>", "\"evil\" canBeInstantiatedOnlyOncePerProcess=\"true\"/>"))
}

/// Both pools at once, from two threads, against their results one after the other.
fn run_both(pools: &[(f64, Pool)]) {
    let truths: Vec<f64> = pools.iter().map(|(k, pool)| run(pool, *k)).collect();
    std::thread::scope(|scope| {
        for ((k, pool), truth) in pools.iter().zip(truths) {
            scope.spawn(move || {
                for _ in 0..50 {
                    assert_eq!(run(pool, *k), truth);
                }
            });
        }
    });
}

#[test]
fn a_reset_that_keeps_parameters_leaves_nothing_to_the_next_session() {
    let folder = evil(&["RESET_KEEPS_PARAMETERS"]);
    let options = SimulateOptions::new();
    let truth = folder.open().simulate(&options).unwrap();
    let mut session = Session::new(folder.open());
    session.set("k", 2.0).unwrap();
    let first = session.simulate(&options).unwrap();
    assert_eq!(session.simulate(&options).unwrap(), first);
    session.reset();
    assert_eq!(session.simulate(&options).unwrap(), truth);
    // Nor to other plans of the same FMU.
    let pool = pool(session.fmu(), &with_k());
    pool.lend().unwrap().trajectory(&[3.0]).unwrap();
    drop(pool);
    assert_eq!(session.fmu().simulate(&options).unwrap(), truth);
}

#[test]
fn one_instance_per_copy_however_often_the_library_is_opened() {
    let folder = only_once();
    let (a, b) = (folder.open(), folder.open());
    let first = a.instantiate().unwrap();
    let second = b.instantiate().unwrap();
    drop((first, second));
    let options = SimulateOptions::new();
    let truth = a.simulate(&options).unwrap();
    assert_eq!(b.simulate(&options).unwrap(), truth);
    assert_eq!(a.simulate(&options).unwrap(), truth);
    run_both(&[(1.0, pool(&a, &with_k())), (3.0, pool(&b, &with_k()))]);
}

#[test]
fn what_is_found_out_about_a_library_holds_for_all_who_open_it() {
    let folder = evil(&["LYING_RESET"]);
    let (a, b) = (folder.open(), folder.open());
    assert_eq!(pool(&a, &SimulateOptions::new()).reuse().unwrap(), Reuse::Reinstantiate);
    b.instantiate().unwrap();
    assert_eq!(b.reuse(), Some(Reuse::Reinstantiate));
}

#[test]
fn two_pools_of_a_library_with_globals_do_not_run_at_once() {
    // Copies do not help where the globals are those of a second library.
    let folder = evil_with_sibling(&[], "sibling");
    let fmu = folder.open();
    let pools = [(1.0, pool(&fmu, &with_k())), (3.0, pool(&folder.open(), &with_k()))];
    assert!(pools.iter().all(|(_, pool)| pool.sharing().unwrap() == Sharing::Serial));
    run_both(&pools);
    // Values of a run are gone when another one was made.
    let plan =
        |k: f64| Arc::new(SimulationPlan::new(&fmu, &SimulateOptions::new().start_value("k", k)).unwrap());
    let mut first = Simulator::new(plan(1.0)).unwrap();
    first.run(&[], &mut Ignore).unwrap();
    let value = first.get("x").unwrap();
    let mut second = Simulator::new(plan(2.0)).unwrap();
    second.run(&[], &mut Ignore).unwrap();
    assert!(matches!(first.get("x"), Err(FmiError::Disturbed { .. })));
    first.run(&[], &mut Ignore).unwrap();
    assert_eq!(first.get("x").unwrap(), value);
}

#[test]
fn where_only_the_last_instance_is_right_there_is_only_one() {
    let folder = evil(&["LAST_ONLY"]);
    let truth = folder.open().simulate(&SimulateOptions::new().start_value("k", 2.0)).unwrap();
    let fmu = folder.open();
    let pool = pool(&fmu, &with_k());
    assert_eq!(pool.sharing().unwrap(), Sharing::Copies);
    for _ in 0..3 {
        assert_eq!(Some(run(&pool, 2.0)), truth.final_value("y").unwrap());
    }
}

#[test]
fn static_variables_inside_a_call_are_those_of_a_copy() {
    let folder = evil(&["STATIC_SCRATCH"]);
    let fmu = folder.open();
    let pool = pool(&fmu, &with_k());
    assert_eq!(pool.sharing().unwrap(), Sharing::Copies);
    assert_eq!(pool.reuse().unwrap(), Reuse::Reset);
    assert_eq!(fmu.sharing_of(InterfaceKind::ModelExchange), Some(Sharing::Copies));
    run_both(&[(1.0, pool), (3.0, self::pool(&fmu, &with_k()))]);
}

#[test]
fn an_honest_model_passes() {
    let folder = evil(&[]);
    let pool = pool(&folder.open(), &with_k());
    assert_eq!(pool.sharing().unwrap(), Sharing::Copies);
    assert_eq!(pool.reuse().unwrap(), Reuse::Reset);
}

#[test]
fn after_fatal_nothing_of_the_copy_is_called_and_others_have_another() {
    let folder = evil(&["FATAL_LATE"]);
    let fmu = folder.open();
    let mut other = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    for fmu in [fmu.clone(), folder.open()] {
        let error = fmu.simulate(&SimulateOptions::new()).unwrap_err();
        assert_eq!(error.call_failure().unwrap().status, Status::Fatal);
        let short = SimulateOptions::new().final_time(0.25);
        fmu.simulate(&short).unwrap();
    }
    assert_eq!(other.get("x").unwrap(), 1.0.into());
    let mut stepping = fmu
        .instantiate()
        .unwrap()
        .enter_initialization(0.0, None, None)
        .unwrap()
        .exit_initialization()
        .unwrap()
        .enter_continuous_time()
        .unwrap();
    stepping.set_time(0.75).unwrap();
    for _ in 0..2 {
        let error = stepping.get_derivatives(&mut [0.0]).unwrap_err();
        assert_eq!(error.call_failure().unwrap().status, Status::Fatal);
    }
}

#[test]
fn a_thread_may_outlive_the_library_it_has_called() {
    let folder = evil(&["THREAD_DATA"]);
    let (sender, receiver) = std::sync::mpsc::channel::<()>();
    let (done, ready) = std::sync::mpsc::channel::<()>();
    let fmu = folder.open();
    let thread = std::thread::spawn(move || {
        fmu.simulate(&SimulateOptions::new()).unwrap();
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
fn a_library_written_over_while_it_is_loaded_is_refused() {
    let folder = evil(&[]);
    folder.open().simulate(&SimulateOptions::new()).unwrap();
    let library =
        fmi::platform::find_binary(folder.path(), "evil", fmi::platform::FolderNames::SystemAndBits)
            .unwrap()
            .path;
    let file = std::fs::File::options().append(true).open(&library).unwrap();
    std::io::Write::write_all(&mut &file, b"more").unwrap();
    let error = folder.open().simulate(&SimulateOptions::new()).unwrap_err();
    assert!(error.to_string().contains("written over"), "{error}");
    // A new file in its place is fine, and it is that one which runs.
    for (fault, ends_itself) in [("ENDS_ITSELF", true), ("STATIC_SCRATCH", false), ("ENDS_ITSELF", true)] {
        let other = evil(&[fault]);
        let place = library.strip_prefix(folder.path()).unwrap();
        let aside = library.with_extension("new");
        std::fs::copy(other.path().join(place), &aside).unwrap();
        std::fs::rename(aside, &library).unwrap();
        let ended = folder.open().simulate(&SimulateOptions::new()).unwrap().termination;
        assert_eq!(ended == fmi::ode::Termination::StoppedByModel, ends_itself, "{fault}");
    }
}

#[test]
fn a_cancelled_test_is_no_verdict() {
    let folder = evil(&["STATIC_SCRATCH"]);
    let options = with_k().max_step(1e-3);
    let begin = std::time::Instant::now();
    folder.open().simulate(&options).unwrap();
    let one = begin.elapsed();
    let fmu = folder.open();
    for halves in [0, 1, 3, 5, 9] {
        let flag = Arc::new(AtomicBool::new(halves == 0));
        let pool = pool(&fmu, &options.clone().cancel(Arc::clone(&flag)));
        let reuse = std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(one * halves / 2);
                flag.store(true, Ordering::Relaxed);
            });
            pool.reuse()
        });
        if reuse.is_err() {
            flag.store(false, Ordering::Relaxed);
            assert_eq!(pool.reuse().unwrap(), Reuse::Reset);
        }
        assert_ne!(fmu.reuse(), Some(Reuse::Reinstantiate));
    }
}

#[test]
fn the_check_of_a_pool_ends_when_it_is_told() {
    let folder = evil(&["STATIC_SCRATCH"]);
    for most in [0, 1, 20, 200, 2000] {
        let (fmu, n_asked) = (folder.open(), std::cell::Cell::new(0));
        let pool = pool(&fmu, &with_k().max_step(1e-3));
        let cancelled = || {
            n_asked.set(n_asked.get() + 1);
            n_asked.get() > most
        };
        match pool.prepare(&cancelled) {
            // Once it was told it made no further step.
            Err(FmiError::Cancelled) => assert_eq!(n_asked.get(), most + 1),
            other => assert!(other.is_ok() && n_asked.get() <= most, "{most}: {other:?}"),
        }
        assert_eq!(pool.reuse().unwrap(), Reuse::Reset, "{most}");
    }
}

#[test]
fn a_test_that_times_out_binds_only_its_pool() {
    let folder = evil(&["STATIC_SCRATCH"]);
    let fmu = folder.open();
    let short = with_k().max_step(1e-5).timeout(Duration::from_millis(1));
    assert_eq!(pool(&fmu, &short).reuse().unwrap(), Reuse::Reinstantiate);
    assert_eq!(fmu.reuse(), None);
}

/// The evil model as co-simulation.
fn slave(faults: &[&str]) -> Folder {
    evil_with(faults, |xml| {
        xml.replace(
            "<ModelExchange modelIdentifier=\"evil\"/>",
            "<CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"true\"/>",
        )
    })
}

#[test]
fn copies_help_co_simulation_too() {
    let folder = slave(&["SHARED_GLOBALS"]);
    let options = with_k().kind(Kind::CoSimulation);
    let fmu = folder.open();
    let pools = [(1.0, pool(&fmu, &options)), (3.0, pool(&folder.open(), &options))];
    assert!(pools.iter().all(|(_, pool)| pool.sharing().unwrap() == Sharing::Copies));
    run_both(&pools);
    assert!((run(&pools[1].1, 3.0) - (-3f64).exp()).abs() < 1e-12);
}

/// Two workers hold simulators at once, a third and a fourth too, and simulations outside of any pool have copies as well.
#[test]
fn with_copies_nobody_waits() {
    let folder = evil(&["SHARED_GLOBALS"]);
    let fmu = folder.open();
    let pool = pool(&fmu, &with_k());
    let mut leases: Vec<_> = (0..4).map(|_| pool.lend().unwrap()).collect();
    let mut session = Session::new(fmu.clone());
    for (i, lease) in leases.iter_mut().enumerate() {
        lease.run(&[1.0 + i as f64], &mut Ignore).unwrap();
    }
    session.set("k", 9.0).unwrap();
    session.simulate(&SimulateOptions::new()).unwrap();
    // Each has its values still.
    for (i, lease) in leases.iter_mut().enumerate() {
        let k = 1.0 + i as f64;
        assert_eq!(lease.get("twice_k").unwrap(), 2.0 * k);
        assert!((lease.get("y").unwrap() - (-k).exp()).abs() < 1e-5);
    }
    assert_eq!(session.get("twice_k").unwrap(), fmi::Value::Real(18.0));
}

/// Instances made by hand have copies too, and nobody else is in these.
#[test]
fn a_second_instance_made_by_hand_has_a_copy_of_its_own() {
    for folder in [only_once(), evil(&["SHARED_GLOBALS"])] {
        let fmu = folder.open();
        let mut instances: Vec<_> = (0..3).map(|_| fmu.instantiate().unwrap()).collect();
        for (i, instance) in instances.iter_mut().enumerate() {
            instance.set("k", 2.0 + i as f64).unwrap();
        }
        for (i, instance) in instances.into_iter().enumerate() {
            let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
            assert_eq!(instance.get("k").unwrap(), (2.0 + i as f64).into());
        }
        let mut next = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
        assert_eq!(next.get("k").unwrap(), 1.0.into());
    }
}

#[test]
fn after_fatal_the_next_run_has_another_copy() {
    let folder = evil(&["FATAL_ABOVE=50", "SHARED_GLOBALS"]);
    let pool = pool(&folder.open(), &with_k());
    assert_eq!(pool.sharing().unwrap(), Sharing::Copies);
    let mut lease = pool.lend().unwrap();
    let truth = lease.trajectory(&[1.0]).unwrap();
    let error = lease.run(&[100.0], &mut Ignore).unwrap_err();
    assert_eq!(error.call_failure().unwrap().status, Status::Fatal);
    assert_eq!(lease.trajectory(&[1.0]).unwrap(), truth);
    lease.run(&[100.0], &mut Ignore).unwrap_err();
    drop(lease);
    assert_eq!(pool.lend().unwrap().trajectory(&[1.0]).unwrap(), truth);
}

#[test]
fn copies_help_all_versions() {
    use example_models::ExampleKind::{Fmi1CoSimulation, Fmi2CoSimulation, Fmi2ModelExchange, Fmi3};
    for (version, kind) in [
        (Fmi1CoSimulation, Kind::Auto),
        (Fmi2CoSimulation, Kind::Auto),
        (Fmi2ModelExchange, Kind::Auto),
        (Fmi3, Kind::ModelExchange),
        (Fmi3, Kind::CoSimulation),
    ] {
        // FMI 1.0 has the flag for co-simulation only, in another element.
        let place =
            if version == Fmi1CoSimulation { "<Capabilities" } else { "modelIdentifier=\"dahlquist\"" };
        let flag = format!("{place} canBeInstantiatedOnlyOncePerProcess=\"true\"");
        let folder = model_as("dahlquist", version, &[], |xml| {
            assert!(!xml.contains("OnlyOncePerProcess"));
            xml.replace(place, &flag)
        });
        let pool = pool(&folder.open(), &with_k().final_time(1.0).step_size(1e-3).kind(kind));
        assert_eq!(pool.sharing().unwrap(), Sharing::Copies, "{version:?}");
        let mut leases = [pool.lend().unwrap(), pool.lend().unwrap()];
        for (lease, k) in leases.iter_mut().zip([2.0, 3.0]) {
            lease.run(&[k], &mut Ignore).unwrap();
        }
        for (lease, k) in leases.iter_mut().zip([2.0f64, 3.0]) {
            let x = lease.get("x").unwrap();
            assert!((x - (-k).exp()).abs() < 1e-4, "{version:?}: {x}");
        }
    }
}

#[test]
fn a_model_that_writes_into_the_resources_has_others_for_every_run() {
    let folder = evil(&["WRITES_RESOURCES"]);
    std::fs::create_dir(folder.path().join("resources")).unwrap();
    let fmu = folder.open();
    let trace = fmu.root().unwrap().join("resources/trace.txt");
    let first = pool(&fmu, &with_k());
    assert_eq!(first.written_resource().unwrap(), Some(trace.clone()));
    assert_eq!((first.sharing().unwrap(), first.reuse().unwrap()), (Sharing::Copies, Reuse::Reload));
    assert!(fmu.quirks_seen().iter().any(|quirk| quirk.message.contains("trace.txt")));
    let written = std::fs::read(&trace).unwrap();
    run_both(&[(1.0, first), (3.0, pool(&folder.open(), &with_k()))]);
    assert_eq!(std::fs::read(&trace).unwrap(), written);

    let folder = evil(&[]);
    std::fs::create_dir(folder.path().join("resources")).unwrap();
    let pool = pool(&folder.open(), &with_k());
    assert_eq!((pool.written_resource().unwrap(), pool.sharing().unwrap()), (None, Sharing::Copies));
}
