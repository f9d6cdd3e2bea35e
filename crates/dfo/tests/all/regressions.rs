//! Regression tests: logarithms without bounds, clamping, nested pools, and panics of the function of a
//! context.

#![allow(clippy::unwrap_used, clippy::panic)]

use dfo::{BoundsHandling, NelderMead, RunContext, Transform, minimize};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

#[test]
fn logarithmic_parameter_without_bounds_stays_finite() {
    for f in [|x: &[f64]| 1.0 / x[0], |x: &[f64]| x[0]] {
        let report =
            minimize(f).start(&[1.0]).transforms(&[Transform::Log]).max_iterations(3000).run().unwrap();
        assert!(report.trace.iter().all(|e| e.x[0].is_normal()), "{report}");
    }
}

#[test]
fn clamped_points_are_on_the_bound() {
    let method = NelderMead::default().bounds_handling(BoundsHandling::Clamp);
    let report = minimize(|x: &[f64]| x[0])
        .start(&[0.3])
        .bounds(&[0.0], &[1.0])
        .unwrap()
        .method(method)
        .run()
        .unwrap();
    assert_eq!(report.x, [0.0]);
    let late = report.trace.iter().skip(10);
    assert!(late.filter(|e| e.x[0] == 0.5).count() == 0);
}

#[test]
fn nested_minimisation_with_workers_ends() {
    let outer = move |x: &[f64]| {
        let a = x[0];
        let run = minimize(move |y: &[f64]| (y[0] - a).powi(2))
            .start(&[0.0])
            .workers(3)
            .context(RunContext::new().polling(&|| false));
        run.run().unwrap().x[0].powi(2)
    };
    let report = minimize(outer)
        .start(&[1.0])
        .workers(2)
        .context(RunContext::new().polling(&|| false))
        .max_evaluations(30)
        .run()
        .unwrap();
    assert!(report.fun < 1.0);
}

#[test]
fn panic_of_context_function_ends_the_batch() {
    let calls = AtomicUsize::new(0);
    let objective = |x: &[f64]| {
        calls.fetch_add(1, Ordering::SeqCst);
        std::thread::sleep(Duration::from_millis(100));
        x.iter().sum()
    };
    let polls = std::cell::Cell::new(0);
    let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        let ask = || {
            polls.set(polls.get() + 1);
            if polls.get() == 2 {
                // A panic without a message, because writing a message may take long while the workers
                // continue.
                std::panic::resume_unwind(Box::new("out of patience"));
            }
            false
        };
        minimize(objective).start(&[1.0; 12]).workers(2).context(RunContext::new().polling(&ask)).run()
    }));
    assert!(result.is_err());
    assert!(calls.load(Ordering::SeqCst) < 13);
}
