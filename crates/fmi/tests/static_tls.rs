//! Copies of a library that needs much static thread-local storage, which is set aside once per process: in a process of its
//! own.

#![cfg(all(target_os = "linux", target_env = "gnu"))]
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::ode::Ignore;
use fmi::{FmiError, Pool, SimulateOptions, SimulationPlan};
use std::sync::Arc;
use support::evil;

#[test]
fn where_no_further_copy_can_be_loaded_simulations_take_turns_and_the_loader_is_quoted_at_the_end() {
    let folder = evil(&["LARGE_TLS=400", "SHARED_GLOBALS", "FATAL_ABOVE=50"]);
    let options = SimulateOptions::new().parameters(["k"]).ncp(2);
    let pool = Pool::new(Arc::new(SimulationPlan::new(&folder.open(), &options).unwrap()));
    // More at once than there can be copies.
    std::thread::scope(|scope| {
        for thread in 0..16 {
            let pool = &pool;
            scope.spawn(move || {
                for round in 0..10 {
                    let k = f64::from(1 + (thread + round) % 5);
                    let y = pool.lend().unwrap().trajectory(&[k]).unwrap().final_value("y").unwrap();
                    assert!((y.unwrap() - (-k).exp()).abs() < 1e-5);
                }
            });
        }
    });
    // Each takes a copy with it.
    let mut lost = 0;
    let reason = loop {
        let error = pool.lend().unwrap().run(&[100.0], &mut Ignore).unwrap_err();
        match error {
            FmiError::NoCopy { reason, .. } => break reason,
            error => assert!(error.call_failure().is_some(), "{error}"),
        }
        lost += 1;
        assert!(lost < 64, "the room for static thread-local storage has no end");
    };
    assert!(lost > 1 && reason.contains("static TLS"), "{lost}: {reason}");
}
