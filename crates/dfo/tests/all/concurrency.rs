//! Evaluations run concurrently, callbacks run on the calling thread, and interrupts take effect.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{plan, rosenbrock};
use dfo::{Error, Lookahead, Outcome, Query, Report, RunContext, Termination, minimize, with_query};
use std::cell::Cell;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Barrier};
use std::thread;
use std::time::{Duration, Instant};

/// Runs a function that would hang if evaluations did not overlap.
fn within_ten_seconds<T: Send + 'static>(f: impl FnOnce() -> T + Send + 'static) -> T {
    let (sender, receiver) = channel();
    thread::spawn(move || sender.send(f()));
    receiver.recv_timeout(Duration::from_secs(10)).expect("evaluations do not overlap")
}

#[test]
fn starting_vertices_are_evaluated_at_once() {
    for n in [1, 3, 6] {
        let report = within_ten_seconds(move || {
            let barrier = Barrier::new(n + 1);
            let cost = with_query(|x: &[f64], e: &Query<'_>| {
                if e.batch == 0 {
                    barrier.wait();
                }
                Outcome::Value(x.iter().map(|v| v * v).sum())
            });
            minimize(cost).start(&vec![1.0; n]).workers(n + 1).max_iterations(5).run().unwrap()
        });
        assert_eq!(report.n_iterations, 5);
    }
}

#[test]
fn four_points_are_evaluated_at_once_when_worthwhile() {
    let report = within_ten_seconds(|| {
        let (barrier, ahead) = (Barrier::new(4), AtomicUsize::new(0));
        let cost = with_query(|x: &[f64], e: &Query<'_>| {
            thread::sleep(Duration::from_millis(2));
            // The first four points after the starting ones: one that is needed and three that may be needed.
            if e.id >= 3 && ahead.fetch_add(1, Ordering::Relaxed) < 4 {
                barrier.wait();
            }
            Outcome::Value(rosenbrock(x))
        });
        minimize(cost)
            .start(&[-1.2, 1.0])
            .method(plan(Lookahead::Points(4)))
            .workers(4)
            .max_iterations(5)
            .run()
            .unwrap()
    });
    assert_eq!(report.n_iterations, 5);
}

#[test]
fn shrink_is_evaluated_at_once() {
    // Four parameters. Only the starting vertices and the shrunken ones are good, so iteration 1 shrinks.
    let report = within_ten_seconds(|| {
        let barrier = Barrier::new(4);
        let cost = with_query(|x: &[f64], e: &Query<'_>| {
            thread::sleep(Duration::from_millis(2));
            if e.batch == 3 {
                barrier.wait();
            }
            let sum: f64 = x.iter().map(|v| v * v).sum();
            Outcome::Value(if e.batch == 1 || e.batch == 2 { 1e6 } else { sum })
        });
        minimize(cost)
            .start(&[1.0; 4])
            .method(plan(Lookahead::None))
            .workers(4)
            .max_iterations(1)
            .run()
            .unwrap()
    });
    assert_eq!((report.n_iterations, report.n_batches), (1, 4));
}

#[test]
fn callbacks_run_regularly_on_the_calling_thread() {
    let caller = thread::current().id();
    let (last, longest, polls) = (Cell::new(Instant::now()), Cell::new(Duration::ZERO), Cell::new(0));
    let ask = || {
        assert_eq!(thread::current().id(), caller);
        longest.set(longest.get().max(last.get().elapsed()));
        last.set(Instant::now());
        polls.set(polls.get() + 1);
        false
    };
    let report = minimize(|x: &[f64]| {
        assert_ne!(thread::current().id(), caller);
        thread::sleep(Duration::from_millis(400));
        rosenbrock(x)
    })
    .start(&[-1.2, 1.0])
    .workers(3)
    .max_iterations(1)
    .observer(|_| {
        assert_eq!(thread::current().id(), caller);
        ControlFlow::Continue(())
    })
    .context(RunContext::new().polling(&ask))
    .run()
    .unwrap();
    assert_eq!(report.n_failed, 0);
    // The documented limit is 50 ms. The margin is for a machine that runs other tests.
    assert!(
        polls.get() >= 10 && longest.get() < Duration::from_millis(390),
        "{polls:?} calls, longest pause {longest:?}"
    );
}

fn interrupted(workers: usize, ready_after: u64) -> (Result<Report, Error>, Duration, usize) {
    let started = AtomicUsize::new(0);
    let hanging = AtomicBool::new(false);
    let cost = with_query(|x: &[f64], e: &Query<'_>| {
        started.fetch_add(1, Ordering::Relaxed);
        if e.id < ready_after {
            // Long enough to leave the calling thread.
            thread::sleep(Duration::from_millis(25));
            return Outcome::Value(rosenbrock(x));
        }
        hanging.store(true, Ordering::Release);
        while !e.cancelled() {
            thread::sleep(Duration::from_millis(1));
        }
        Outcome::cancelled()
    });
    let begin = Instant::now();
    let result = minimize(cost)
        .start(&[-1.2, 1.0])
        .workers(workers)
        .context(RunContext::new().polling(&|| hanging.load(Ordering::Acquire)))
        .run();
    (result, begin.elapsed(), started.load(Ordering::Relaxed))
}

#[test]
fn interrupt_ends_running_evaluations_and_keeps_best() {
    for workers in [2, 4] {
        for ready_after in [2, 3, 20] {
            let (result, time, started) = interrupted(workers, ready_after);
            let report = result.unwrap();
            assert_eq!(report.termination, Termination::Interrupted);
            assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
            assert_eq!(report.n_evaluations + report.n_speculative, started);
            assert_eq!(report.n_evaluations, report.trace.len());
            // Cancelled evaluations are not failures.
            assert_eq!((report.n_failed, report.failures), (0, Vec::new()));
            assert!(started <= ready_after as usize + workers && time < Duration::from_secs(5), "{time:?}");
        }
        let (result, ..) = interrupted(workers, 0);
        let Err(Error::EndedWithoutPoint { termination, found }) = result else { panic!("{result:?}") };
        assert_eq!(termination, Termination::Interrupted);
        assert!(found.trace.len() <= workers && found.failures.is_empty());
    }
}

#[test]
fn cancel_flag_interrupts_and_is_left_unchanged() {
    let flag = Arc::new(AtomicBool::new(false));
    let report = minimize(|x: &[f64]| rosenbrock(x))
        .start(&[-1.2, 1.0])
        .context(RunContext::new().flagged(&flag))
        .observer(|p| {
            flag.store(p.n_iterations >= 4, Ordering::Relaxed);
            ControlFlow::Continue(())
        })
        .run()
        .unwrap();
    assert_eq!((report.termination, report.n_iterations), (Termination::Interrupted, 4));
    assert!(flag.load(Ordering::Relaxed));

    // The flag is not set either when the run itself ends evaluations.
    let shared = Arc::new(AtomicBool::new(false));
    let (hanging, seen_raised) = (AtomicBool::new(false), AtomicBool::new(false));
    let error = minimize(with_query(|_: &[f64], e: &Query<'_>| {
        hanging.store(true, Ordering::Release);
        while !e.cancelled() {
            thread::sleep(Duration::from_millis(1));
        }
        seen_raised.fetch_or(shared.load(Ordering::Relaxed), Ordering::Relaxed);
        Outcome::cancelled()
    }))
    .start(&[-1.2, 1.0])
    .workers(2)
    .context(RunContext::new().flagged(&shared).polling(&|| hanging.load(Ordering::Acquire)))
    .run()
    .unwrap_err();
    assert!(
        matches!(error, Error::EndedWithoutPoint { termination: Termination::Interrupted, .. }),
        "{error}"
    );
    assert!(!shared.load(Ordering::Relaxed) && !seen_raised.load(Ordering::Relaxed));
}

#[test]
fn cancel_flag_set_during_shutdown_is_not_lost() {
    let (flag, hanging) = (Arc::new(AtomicBool::new(false)), AtomicBool::new(false));
    let run = || {
        let cost = with_query(|x: &[f64], e: &Query<'_>| {
            if e.id == 0 {
                return Outcome::Value(rosenbrock(x));
            }
            hanging.store(true, Ordering::Release);
            while !e.cancelled() {
                thread::sleep(Duration::from_millis(1));
            }
            // Ctrl-C, after the run has ended this evaluation.
            flag.store(true, Ordering::Relaxed);
            Outcome::cancelled()
        });
        minimize(cost)
            .start(&[-1.2, 1.0])
            .workers(2)
            .context(RunContext::new().flagged(&flag).polling(&|| hanging.load(Ordering::Acquire)))
            .run()
    };
    let report = run().unwrap();
    assert_eq!((report.termination, report.fun), (Termination::Interrupted, rosenbrock(&[-1.2, 1.0])));
    assert!(flag.load(Ordering::Relaxed));
    // Other users of the flag also end: without hanging evaluations, the flag alone ends the run.
    hanging.store(false, Ordering::Relaxed);
    let Err(Error::EndedWithoutPoint { termination, found }) = run() else {
        panic!("it ran with the flag up")
    };
    assert_eq!((termination, found.trace.len()), (Termination::Interrupted, 0));
}

#[test]
fn panic_of_context_function_ends_evaluations_and_keeps_the_flag() {
    let (flag, hanging) = (Arc::new(AtomicBool::new(false)), AtomicBool::new(false));
    let cost = with_query(|_: &[f64], e: &Query<'_>| {
        hanging.store(true, Ordering::Release);
        while !e.cancelled() {
            thread::sleep(Duration::from_millis(1));
        }
        Outcome::cancelled()
    });
    let unwound = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        minimize(cost)
            .start(&[-1.2, 1.0])
            .workers(2)
            .context(RunContext::new().flagged(&flag).polling(&|| {
                if hanging.load(Ordering::Acquire) {
                    std::panic::resume_unwind(Box::new("asked"))
                } else {
                    false
                }
            }))
            .run()
    }));
    assert_eq!(unwound.unwrap_err().downcast_ref::<&str>(), Some(&"asked"));
    assert!(!flag.load(Ordering::Relaxed));
}

#[test]
fn abort_ends_the_run_and_keeps_earlier_evaluations() {
    let started = AtomicUsize::new(0);
    let cost = with_query(|x: &[f64], e: &Query<'_>| {
        started.fetch_add(1, Ordering::Relaxed);
        if e.id == 2 {
            return Outcome::Abort("third".to_owned());
        }
        let start = Instant::now();
        while e.id > 2 && !e.cancelled() && start.elapsed() < Duration::from_secs(60) {
            thread::yield_now();
        }
        Outcome::Value(x.iter().sum())
    });
    let report = minimize(cost).start(&[1.0; 7]).workers(2).run().unwrap();
    assert_eq!(report.termination, Termination::Aborted("third".to_owned()));
    assert_eq!(report.n_evaluations + report.n_speculative, started.load(Ordering::Relaxed));
    // Each worker may start one more point before the calling thread reads the abort.
    assert!(report.n_evaluations == 3 && report.n_speculative <= 2);
    assert_eq!(report.trace.iter().map(|e| e.id).collect::<Vec<_>>(), [0, 1, 2]);
    assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
}

/// The pools of a run belong to rayon, so an objective that uses rayon runs its tasks there or in a separate
/// pool.
#[test]
fn objective_may_use_rayon() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let cost = |x: &[f64]| {
        thread::sleep(Duration::from_millis(1));
        let half = |from: usize| move || x.iter().skip(from).step_by(2).map(|v| v * v).sum::<f64>();
        let (even, odd) = rayon::join(half(0), half(1));
        let again = pool.install(|| rayon::join(half(0), half(1)));
        assert_eq!((even, odd), again);
        even + odd
    };
    let run =
        |workers: usize| minimize(cost).start(&[1.0; 3]).workers(workers).max_evaluations(60).run().unwrap();
    let alone = run(1);
    for workers in [3, 70] {
        let report = run(workers);
        assert_eq!(
            (report.x, report.fun, report.n_evaluations),
            (alone.x.clone(), alone.fun, alone.n_evaluations)
        );
    }
}

#[test]
fn workers_have_large_stacks() {
    fn deep(level: u32) -> f64 {
        let capacity = std::hint::black_box([f64::from(level); 1024]);
        if level == 0 { 0.0 } else { capacity[7] * 0.0 + deep(level - 1) }
    }
    // 1000 levels of 8 KiB need more than the usual 2 MiB of a thread.
    let cost = |x: &[f64]| {
        // Long enough to leave the calling thread.
        thread::sleep(Duration::from_millis(25));
        x[0] * x[0] + deep(1000)
    };
    let report = minimize(cost)
        .start(&[1.0])
        .workers(2)
        .context(RunContext::new().polling(&|| false))
        .max_evaluations(8)
        .run()
        .unwrap();
    assert!(report.n_failed == 0 && report.fun < 1.0);
}
