//! Long fits run in constant memory.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

mod common;

use calibration::RunContext;
use common::*;
use fmufit::calibration::{Calibration, Experiment, Parameter};

/// Returns the resident memory of this process in bytes.
fn resident() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|l| l.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<usize>().unwrap() * 1024
}

/// Evaluates `calls` costs with varying parameters. Returns the growth of the resident memory after the first
/// tenth.
fn growth(calls: usize, workers: usize) -> usize {
    let calibration = Calibration::builder(example("furuta"))
        .experiment(
            Experiment::new(furuta_measurements())
                .output("armJoint.phi", "phi")
                .output("pendulumJoint.phi", "theta")
                .window(0.0, 10.0),
        )
        .parameter(Parameter::new("armFriction", 0.012).bounds(0.0, 0.022))
        .parameter(Parameter::new("pendulumFriction", 0.002).bounds(0.0, 0.012))
        .build()
        .unwrap();
    let run = |from: usize, to: usize| {
        std::thread::scope(|scope| {
            for worker in 0..workers {
                let calibration = &calibration;
                scope.spawn(move || {
                    for k in (from + worker..to).step_by(workers) {
                        let x = [0.008 + 1e-7 * (k % 1000) as f64, 0.001 + 1e-8 * (k % 997) as f64];
                        assert!(calibration.cost(&x, &RunContext::new()).unwrap().is_finite());
                    }
                });
            }
        });
        resident()
    };
    let after_a_tenth = run(0, calls / 10);
    run(calls / 10, calls).saturating_sub(after_a_tenth)
}

// One test covers both numbers of workers, because it measures the whole process.
fn check(calls: usize) {
    for workers in [1, 2] {
        let grown = growth(calls, workers);
        assert!(grown < 1 << 20, "{grown} bytes more after {calls} calls from {workers} threads");
    }
}

#[test]
fn memory_is_constant_over_ten_thousand_evaluations() {
    check(10_000);
}

#[test]
#[ignore = "long: run by `make test-long`"]
fn memory_is_constant_over_a_hundred_thousand_evaluations() {
    check(100_000);
}
