//! Cancellation and the time limit also end long steps. No evaluation follows, in any part of a step.

#![allow(clippy::unwrap_used, clippy::panic)]

use ode::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

const METHODS: &[Method] =
    &[Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf, Method::Rk4, Method::Euler];

/// A chain of tanks with an indicator for a level. Counts evaluations, and calls `then` at one of them.
struct Chain<F> {
    calls: u64,
    at: u64,
    after: u64,
    then: F,
}

impl<F: FnMut()> Chain<F> {
    fn count(&mut self) {
        if self.calls >= self.at {
            self.after += 1;
        }
        self.calls += 1;
        if self.calls == self.at {
            (self.then)();
        }
    }
}

const TANKS: usize = 40;

impl<F: FnMut()> HybridSystem for Chain<F> {
    fn n_states(&self) -> usize {
        TANKS
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.fill(1.0);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        self.count();
        let mut inflow = 1.0 + (3.0 * t).sin();
        for (dx, x) in dx.iter_mut().zip(x) {
            let outflow = x * x.abs().sqrt();
            *dx = inflow - outflow;
            inflow = outflow;
        }
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        self.count();
        z[0] = x[0] - 1.1;
        Ok(())
    }
}

fn run(
    method: Method,
    at: u64,
    (cancel, timeout): (Option<Arc<AtomicBool>>, Option<Duration>),
    then: impl FnMut(),
) -> (Box<SimulationError>, u64) {
    let limits = Limits { timeout, ..Limits::default() };
    let step_size = Some(0.01);
    let mut driver =
        Driver::new(Options { method, limits, cancel, step_size, ..Options::default() }).unwrap();
    let mut chain = Chain { calls: 0, at, after: 0, then };
    let error = driver.run(&mut chain, 0.0, 1e6, &[], &mut Ignore).unwrap_err();
    (error, chain.after)
}

#[test]
fn cancelled_run_makes_no_further_evaluations() {
    for &method in METHODS {
        // Evaluations 3 to about 42 are the first differences of a Jacobian. Later ones belong to Newton's
        // method, stages and indicators.
        for at in (1..60).chain([97, 150, 151, 152, 153, 154, 155, 1003]) {
            let flag = Arc::new(AtomicBool::new(false));
            let set = Arc::clone(&flag);
            let (error, after) =
                run(method, at, (Some(flag), None), move || set.store(true, Ordering::Relaxed));
            assert!(matches!(error.kind, ErrorKind::Cancelled), "{}: {error}", method.name());
            assert_eq!(after, 0, "{} at evaluation {at}", method.name());
        }
    }
}

#[test]
fn timed_out_run_makes_no_further_evaluations() {
    let limit = Duration::from_millis(60);
    for method in [Method::Tsit5, Method::Radau5, Method::Bdf] {
        for at in [2, 20, 60] {
            let (error, after) = run(method, at, (None, Some(limit)), || std::thread::sleep(2 * limit));
            assert!(matches!(error.kind, ErrorKind::TimedOut(l) if l == limit), "{}: {error}", method.name());
            assert_eq!(after, 0, "{} at evaluation {at}", method.name());
        }
    }
}

/// Ends a run at the tenth sample, by the flag or at its next poll.
struct Rows {
    flag: Option<Arc<AtomicBool>>,
    samples: usize,
}

impl Observer for Rows {
    fn sample(&mut self, _: &Sample<'_>) -> std::ops::ControlFlow<()> {
        self.samples += 1;
        if let Some(flag) = self.flag.as_ref().filter(|_| self.samples == 10) {
            flag.store(true, Ordering::Relaxed);
        }
        std::ops::ControlFlow::Continue(())
    }
    fn poll(&mut self) -> std::ops::ControlFlow<()> {
        if self.flag.is_none() && self.samples == 10 {
            std::ops::ControlFlow::Break(())
        } else {
            std::ops::ControlFlow::Continue(())
        }
    }
}

#[test]
fn stopped_run_delivers_no_further_samples_inside_a_step() {
    let times: Vec<f64> = (0..1000).map(|k| 1e-3 * f64::from(k)).collect();
    for flag in [None, Some(Arc::<AtomicBool>::default())] {
        let options =
            Options { method: Method::Rk4, step_size: Some(0.5), cancel: flag.clone(), ..Options::default() };
        let mut rows = Rows { flag: flag.clone(), samples: 0 };
        let mut chain = Chain { calls: 0, at: u64::MAX, after: 0, then: || {} };
        let ended = Driver::new(options).unwrap().run(&mut chain, 0.0, 1.0, &times, &mut rows);
        match flag {
            None => assert_eq!(ended.unwrap().termination, Termination::StoppedByObserver),
            Some(_) => assert!(matches!(ended.unwrap_err().kind, ErrorKind::Cancelled)),
        }
        assert_eq!(rows.samples, 10);
    }
}
