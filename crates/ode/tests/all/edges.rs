//! Edge cases of the driver: large times, an end at the start, events that change nothing, refused samples,
//! and instants close to each other.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

/// x' = f(t, x) with time events at given instants and input stops, a reset at events, and an output.
struct Scripted {
    x0: Vec<f64>,
    f: fn(f64, &[f64], &mut [f64]),
    output: fn(&[f64]) -> f64,
    time_events: Vec<f64>,
    input_stops: Vec<InputStop>,
    claims_change: bool,
    terminate_at_start: bool,
    started_only: bool,
}

impl Default for Scripted {
    fn default() -> Self {
        Self {
            x0: vec![1.0, 0.0],
            f: |_, x, dx| dx.copy_from_slice(&[x[1], -x[0]]),
            output: |x| x[0],
            time_events: vec![],
            input_stops: vec![],
            claims_change: false,
            terminate_at_start: false,
            started_only: false,
        }
    }
}

impl Scripted {
    fn next_time(&self, after: f64) -> Option<f64> {
        self.time_events.iter().copied().find(|t| *t > after)
    }
}

impl HybridSystem for Scripted {
    fn n_states(&self) -> usize {
        self.x0.len()
    }
    fn n_outputs(&self) -> usize {
        1
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&self.x0);
        let next_time = self.time_events.first().copied().filter(|t| *t >= t0);
        Ok(EventOutcome { next_time, terminate: self.terminate_at_start, ..EventOutcome::default() })
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        assert!(!self.started_only, "nothing but outputs may be asked for after the model has ended");
        (self.f)(t, x, dx);
        Ok(())
    }
    fn outputs(&mut self, _: f64, x: &[f64], y: &mut [f64]) -> CallResult<()> {
        y[0] = (self.output)(x);
        if y[0].is_nan() { Err(CallError::Discard) } else { Ok(()) }
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        let next_time = self.next_time(visit.time);
        Ok(EventOutcome { states_changed: self.claims_change, next_time, ..EventOutcome::default() })
    }
    fn next_input_stop(&mut self, t: f64) -> Option<InputStop> {
        self.input_stops.iter().copied().find(|stop| stop.time > t)
    }
}

fn run(system: &mut Scripted, span: (f64, f64), times: &[f64], options: Options) -> (Report, Recorder) {
    let mut seen = Recorder::default();
    let report = Driver::new(options).unwrap().run(system, span.0, span.1, times, &mut seen).unwrap();
    (report, seen)
}

#[test]
fn fixed_steps_advance_at_large_times() {
    for (start, step) in [(86_400.0, 1e-3), (1e6, 0.01), (1.7e9, 0.01), (1.7e9, 0.1), (-1.7e9, 0.1)] {
        for method in [Method::Rk4, Method::Euler] {
            let limits = Limits { max_steps: Some(2000), ..Limits::default() };
            let options = Options { method, step_size: Some(step), limits, ..Options::default() };
            let (report, _) = run(&mut Scripted::default(), (start, start + 100.0 * step), &[], options);
            assert!((99..=101).contains(&report.stats.accepted_steps), "{start}, {step}: {report:?}");
        }
    }
    let options = Options { method: Method::Rk4, step_size: Some(1e-6), ..Options::default() };
    let error = Driver::new(options)
        .unwrap()
        .run(&mut Scripted::default(), 1.7e9, 1.7e9 + 1.0, &[], &mut Ignore)
        .unwrap_err();
    assert!(matches!(error.kind, ErrorKind::StepBelowRounding { .. }), "{error}");
}

#[test]
fn model_can_terminate_at_its_start() {
    let mut system = Scripted { terminate_at_start: true, started_only: true, ..Scripted::default() };
    let (report, seen) = run(&mut system, (0.0, 1.0), &[0.0, 1.0], Options::default());
    assert_eq!((report.termination, report.time), (Termination::StoppedByModel, 0.0));
    assert_eq!(seen.rows.len(), 1);
}

#[test]
fn events_without_changes_avoid_restart_even_if_reported_as_changes() {
    let time_events: Vec<f64> = (0..1000).map(|k| 0.02 * f64::from(k)).collect();
    let with = |claims_change| {
        let mut system = Scripted { time_events: time_events.clone(), claims_change, ..Scripted::default() };
        run(&mut system, (0.0, 20.0), &[], Options::default()).0.stats
    };
    let (silent, claiming) = (with(false), with(true));
    assert_eq!((silent.time_events, silent.restarts), (1000, 0));
    assert_eq!(silent, claiming);
}

#[test]
fn input_jumps_cost_no_more_than_time_events() {
    let instants: Vec<f64> = (1..100).map(|k| 0.2 * f64::from(k)).collect();
    let stops = instants.iter().map(|t| InputStop { time: *t, jump: true }).collect();
    let by = |mut system: Scripted| {
        // a right-hand side that jumps at every instant, so that every event restarts
        system.f = |t, x, dx| {
            dx.copy_from_slice(&[x[1], if (t * 5.0).floor() % 2.0 == 0.0 { 1.0 } else { -1.0 } - x[0]])
        };
        run(&mut system, (0.0, 20.0), &[], Options::default()).0.stats.right_hand_sides
    };
    let jumps = by(Scripted { input_stops: stops, ..Scripted::default() });
    let timed = by(Scripted { time_events: instants, ..Scripted::default() });
    assert!(
        jumps <= timed + timed / 10,
        "{jumps} right-hand sides with input jumps, {timed} with time events"
    );
}

#[test]
fn refused_sample_shrinks_step() {
    // x' = -50 x: interpolants of large steps dip below zero, where the output is undefined.
    let mut system = Scripted {
        x0: vec![1.0],
        f: |_, x, dx| dx[0] = -50.0 * x[0],
        output: |x| x[0].sqrt(),
        ..Scripted::default()
    };
    let times: Vec<f64> = (0..=2000).map(|k| 1e-3 * f64::from(k)).collect();
    let (_, seen) = run(&mut system, (0.0, 2.0), &times, Options::default());
    let indices: Vec<usize> = seen.rows.iter().filter_map(|r| r.1).collect();
    assert_eq!(indices, (0..=2000).collect::<Vec<_>>());
}

#[test]
fn instants_within_rounding_are_merged() {
    let at = 0.1 + 0.2; // 0.30000000000000004
    let stop = |time: f64| InputStop { time, jump: true };
    let mut system = Scripted {
        time_events: vec![0.0, 0.3, at, 1.0],
        input_stops: vec![stop(1e-17), stop(0.3), stop(at)],
        ..Scripted::default()
    };
    let (report, seen) = run(&mut system, (0.0, 1.0), &[0.0, 0.3, 1.0], Options::default());
    let times: Vec<f64> = seen.event_times();
    assert!(
        times.windows(2).all(|w| w[0] <= w[1])
            && times.iter().all(|t| [0.0, 0.3, 1.0].iter().any(|e| (t - e).abs() < 1e-15)),
        "{times:?}"
    );
    assert_eq!(report.stats.input_events, 3);
    assert_eq!(seen.rows.len(), 3);
}

#[test]
fn repeated_time_event_is_an_error() {
    struct Stuck;
    impl HybridSystem for Stuck {
        fn n_states(&self) -> usize {
            0
        }
        fn start(&mut self, _: f64, _: &mut [f64]) -> CallResult<EventOutcome> {
            Ok(EventOutcome { next_time: Some(0.5), ..EventOutcome::default() })
        }
        fn derivatives(&mut self, _: f64, _: &[f64], _: &mut [f64]) -> CallResult<()> {
            Ok(())
        }
        fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
            Ok(EventOutcome { next_time: Some(visit.time), ..EventOutcome::default() })
        }
    }
    let error =
        Driver::new(Options::default()).unwrap().run(&mut Stuck, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
    assert!(matches!(error.kind, ErrorKind::TimeEventLoop(100)), "{error}");
    assert_eq!(error.time, 0.5);
}

/// An input violates its contract and announces the same instant repeatedly.
#[test]
fn repeated_input_stop_is_an_error() {
    struct Stuck {
        jump: bool,
    }
    impl HybridSystem for Stuck {
        fn n_states(&self) -> usize {
            0
        }
        fn start(&mut self, _: f64, _: &mut [f64]) -> CallResult<EventOutcome> {
            Ok(EventOutcome::default())
        }
        fn derivatives(&mut self, _: f64, _: &[f64], _: &mut [f64]) -> CallResult<()> {
            Ok(())
        }
        fn next_input_stop(&mut self, _: f64) -> Option<InputStop> {
            Some(InputStop { time: 0.5, jump: self.jump })
        }
    }
    for jump in [false, true] {
        let mut driver = Driver::new(Options::default()).unwrap();
        let error = driver.run(&mut Stuck { jump }, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::TimeEventLoop(100)), "{error}");
        assert_eq!(error.time, 0.5);
    }
}

/// Without states, only a refused point shortens a step. The next step has its usual length.
#[test]
fn refused_point_without_states_shrinks_one_step() {
    struct Clock {
        looks: u64,
    }
    impl HybridSystem for Clock {
        fn n_states(&self) -> usize {
            0
        }
        fn n_event_indicators(&self) -> usize {
            1
        }
        fn start(&mut self, _: f64, _: &mut [f64]) -> CallResult<EventOutcome> {
            Ok(EventOutcome::default())
        }
        fn derivatives(&mut self, _: f64, _: &[f64], _: &mut [f64]) -> CallResult<()> {
            Ok(())
        }
        fn event_indicators(&mut self, t: f64, _: &[f64], z: &mut [f64]) -> CallResult<()> {
            self.looks += 1;
            z[0] = 1.0 + t;
            if self.looks.is_multiple_of(20) { Err(CallError::Discard) } else { Ok(()) }
        }
    }
    let limits = Limits { max_steps: Some(2000), ..Limits::default() };
    let mut driver = Driver::new(Options { limits, ..Options::default() }).unwrap();
    let report = driver.run(&mut Clock { looks: 0 }, 0.0, 1.0, &[], &mut Ignore).unwrap();
    assert!(report.stats.accepted_steps < 550, "{report:?}");
    assert!(report.stats.rejected_steps > 20, "{report:?}");
}
