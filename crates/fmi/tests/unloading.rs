//! Copies of a library that were made for one run are unloaded, where nothing of them can be called any more. Alone in its
//! process: it counts what is loaded there.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::ode::Ignore;
use fmi::{InterfaceKind, Reuse, SimulateOptions, SimulationPlan, Simulator};
use std::sync::Arc;
use support::evil;

/// Loaded copies of an FMU's library at present.
fn n_loaded() -> usize {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    maps.lines().filter(|line| line.contains("evil.so") && line.contains(" r-xp ")).count()
}

#[test]
fn copies_for_one_run_are_unloaded() {
    let folder = evil(&["REMEMBERS=1.5"]);
    let fmu = folder.open();
    let options = SimulateOptions::new().ncp(10).parameters(["k"]);
    let plan = Arc::new(SimulationPlan::new(&fmu, &options).unwrap());
    let mut simulator = Simulator::new(plan).unwrap();
    for k in [2.0, 1.0, 1.0] {
        simulator.run(&[k], &mut Ignore).unwrap();
    }
    assert_eq!(fmu.reuse_of(InterfaceKind::ModelExchange), Some(Reuse::Reload));
    let before = n_loaded();
    let truth = simulator.trajectory(&[1.0]).unwrap();
    for run in 0..200 {
        simulator.run(&[1.0 + f64::from(run % 3)], &mut Ignore).unwrap();
    }
    assert_eq!(simulator.trajectory(&[1.0]).unwrap().columns, truth.columns);
    assert!(n_loaded() <= before + 2, "{before} copies, then {}", n_loaded());
}
