//! Copies of a library that needs much static thread-local storage. This storage is allocated once per
//! process, so the test has a separate process.

#![cfg(all(target_os = "linux", target_env = "gnu"))]
#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::ode::Ignore;
use fmi::{FmiError, SimulateOptions, SimulationPlan, Simulator};
use std::sync::Arc;
use support::evil;

#[test]
fn loader_message_is_returned_when_static_tls_is_exhausted() {
    let folder = evil(&["LARGE_TLS=400", "FATAL_ABOVE=50"]);
    let options = SimulateOptions::new().parameters(["k"]).ncp(2);
    let plan = SimulationPlan::new(&folder.open(), &options).unwrap();
    let mut simulator = Simulator::new(Arc::new(plan)).unwrap();
    // Each run uses up one copy.
    let mut lost = 0;
    let message = loop {
        match simulator.run(&[100.0], &mut Ignore).unwrap_err() {
            FmiError::LoadFailed { message, .. } => break message,
            error => assert!(error.call_failure().is_some(), "{error}"),
        }
        lost += 1;
        assert!(lost < 64, "the room for static thread-local storage has no end");
    };
    assert!(lost > 1 && message.contains("static TLS"), "{lost}: {message}");
}
