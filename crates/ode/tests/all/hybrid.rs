//! State, time, step and input events against closed forms.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

fn driver(method: Method, options: Options) -> Driver {
    Driver::new(Options { method, ..options }).unwrap()
}

#[test]
fn bounce_times_match_closed_form() {
    let expected = bounce_times(0.1, 100);
    assert_eq!(expected.len(), 11);
    assert!((expected[10] - 2.499_113_314_224_620_7).abs() < 1e-14);
    let tsit5 = Options { relative_tolerance: 1e-6, ..Options::default() };
    let rk4 = Options { step_size: Some(0.01), ..Options::default() };
    for (method, options) in [(Method::Tsit5, tsit5), (Method::Rk4, rk4)] {
        let mut seen = Recorder::default();
        let mut ball = Ball { v_min: 0.1, resting: false };
        let report = driver(method, options).run(&mut ball, 0.0, 4.0, &[4.0], &mut seen).unwrap();
        assert_eq!(report.stats.state_events, 11);
        for (t, e) in seen.event_times().iter().zip(&expected) {
            assert!((t - e).abs() < 1e-12, "{}: {t} instead of {e}: {:e}", method.name(), t - e);
        }
        assert_eq!(seen.rows.last().unwrap().3, [0.0, 0.0]);
    }
}

#[test]
fn zeno_behaviour_is_an_error() {
    let mut ball = Ball { v_min: 0.0, resting: false };
    let error =
        driver(Method::Tsit5, Options::default()).run(&mut ball, 0.0, 3.0, &[], &mut Ignore).unwrap_err();
    assert!(matches!(error.kind, ErrorKind::Chattering { .. } | ErrorKind::StepTooSmall { .. }), "{error}");
    assert!((error.time - 2.558_633_965_585_808).abs() < 1e-5, "{error}");
}

/// x' = -sign(x): slides along x = 0 from t = 1 on.
struct Relay {
    sign: f64,
}
impl HybridSystem for Relay {
    fn n_states(&self) -> usize {
        1
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[0] = 1.0;
        self.sign = 1.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, _: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx[0] = -self.sign;
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = x[0];
        Ok(())
    }
    fn handle_event(&mut self, _: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        self.sign = if x[0] > 0.0 { 1.0 } else { -1.0 };
        Ok(EventOutcome::default())
    }
}

#[test]
fn sliding_is_reported_as_chattering() {
    let error = driver(Method::Tsit5, Options::default())
        .run(&mut Relay { sign: 1.0 }, 0.0, 2.0, &[], &mut Ignore)
        .unwrap_err();
    let ErrorKind::Chattering { events, indicator, .. } = error.kind else { panic!("{error}") };
    assert_eq!((events, indicator), (100, 0));
    assert!((error.time - 1.0).abs() < 1e-5);
    assert!(error.to_string().contains("chattering at t = "), "{error}");
}

/// x'' = -x - 0.1 sign(x') with sticking: turning points every pi, at .95, -.75, .55, -.35, .15, then rest at .05... .
struct Coulomb {
    mode: f64,
}
impl HybridSystem for Coulomb {
    fn n_states(&self) -> usize {
        2
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[0.95, 0.0]);
        self.mode = -1.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&if self.mode == 0.0 { [0.0, 0.0] } else { [x[1], -x[0] - 0.1 * self.mode] });
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = if self.mode == 0.0 { 1.0 } else { self.mode * x[1] + 1e-12 };
        Ok(())
    }
    fn handle_event(&mut self, _: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[1] = 0.0;
        self.mode = if x[0].abs() <= 0.1 { 0.0 } else { -x[0].signum() };
        Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
    }
}

#[test]
fn dry_friction_turning_points_match_closed_form() {
    let mut seen = Recorder::default();
    let options = Options { relative_tolerance: 1e-10, record_events: true, ..Options::default() };
    driver(Method::Tsit5, options).run(&mut Coulomb { mode: 0.0 }, 0.0, 20.0, &[20.0], &mut seen).unwrap();
    let pi = std::f64::consts::PI;
    assert_eq!(seen.events.len(), 5);
    for (k, t) in seen.event_times().iter().enumerate() {
        assert!((t - (k + 1) as f64 * pi).abs() < 1e-8, "event {k} at {t}");
    }
    let turns: Vec<f64> =
        seen.rows.iter().filter(|r| r.1.is_none() && r.2 == Side::Left).map(|r| r.3[0]).collect();
    for (x, e) in turns.iter().zip([-0.75, 0.55, -0.35, 0.15, 0.05]) {
        assert!((x - e).abs() < 1e-8, "{x} instead of {e}");
    }
    assert_eq!(seen.rows.last().unwrap().3[1], 0.0);
}

/// Counts time events. Has no states.
struct Stair {
    counter: f64,
    last: f64,
}
impl HybridSystem for Stair {
    fn n_states(&self) -> usize {
        0
    }
    fn n_outputs(&self) -> usize {
        1
    }
    fn start(&mut self, t0: f64, _: &mut [f64]) -> CallResult<EventOutcome> {
        self.counter = 1.0;
        Ok(EventOutcome { next_time: Some(t0 + 1.0), ..EventOutcome::default() })
    }
    fn derivatives(&mut self, _: f64, _: &[f64], _: &mut [f64]) -> CallResult<()> {
        panic!("a system without states has no right-hand side");
    }
    fn outputs(&mut self, _: f64, _: &[f64], y: &mut [f64]) -> CallResult<()> {
        y[0] = self.counter;
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        assert!(visit.cause.time && !visit.cause.state);
        self.counter += 1.0;
        let terminate = self.counter >= self.last;
        Ok(EventOutcome { next_time: Some(visit.time + 1.0), terminate, ..EventOutcome::default() })
    }
}

#[test]
fn time_events_without_states_yield_both_limits() {
    let mut seen = Recorder::default();
    let times = [0.0, 0.5, 1.0, 1.0, 2.0, 2.5, 5.0];
    let mut d = driver(Method::Auto, Options::default());
    let report = d.run(&mut Stair { counter: 0.0, last: 100.0 }, 0.0, 5.0, &times, &mut seen).unwrap();
    let values: Vec<f64> = seen.rows.iter().map(|r| r.3[0]).collect();
    assert_eq!(values, [1.0, 1.0, 1.0, 2.0, 3.0, 3.0, 6.0]);
    assert_eq!(seen.rows[2].2, Side::Left);
    assert_eq!(seen.rows[3].2, Side::Right);
    assert_eq!(seen.event_times(), [1.0, 2.0, 3.0, 4.0, 5.0]);
    assert_eq!((report.stats.time_events, report.termination), (5, Termination::Finished));

    let report = d.run(&mut Stair { counter: 0.0, last: 4.0 }, 0.0, 5.0, &times, &mut Ignore).unwrap();
    assert_eq!((report.time, report.termination), (3.0, Termination::StoppedByModel));
}

#[test]
fn recorded_events_have_two_rows_and_requested_times_have_index() {
    let mut seen = Recorder::default();
    let options = Options { record_events: true, ..Options::default() };
    driver(Method::Auto, options)
        .run(&mut Stair { counter: 0.0, last: 100.0 }, 0.0, 2.5, &[0.0, 1.0, 2.5], &mut seen)
        .unwrap();
    let rows: Vec<_> = seen.rows.iter().map(|r| (r.0, r.1, r.2, r.3[0])).collect();
    assert_eq!(
        rows,
        [
            (0.0, Some(0), Side::Right, 1.0),
            (1.0, None, Side::Left, 1.0),
            (1.0, Some(1), Side::Right, 2.0),
            (2.0, None, Side::Left, 2.0),
            (2.0, None, Side::Right, 3.0),
            (2.5, Some(2), Side::Right, 3.0),
        ]
    );
}

/// x' = u. The input u is 1 up to t = 1 and -2 afterwards (a jump). At t = 2 (a kink), it starts to grow with
/// slope 3.
struct Driven {
    after_jump: bool,
    inputs_seen: Vec<(f64, f64)>,
}
impl Driven {
    fn u(&self, t: f64) -> f64 {
        if !self.after_jump { 1.0 } else { -2.0 + 3.0 * (t - 2.0).max(0.0) }
    }
}
impl HybridSystem for Driven {
    fn n_states(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[0] = 0.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, _: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx[0] = self.u(t);
        self.inputs_seen.push((t, dx[0]));
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        assert!(visit.cause.input && visit.time == 1.0);
        self.after_jump = true;
        Ok(EventOutcome::default())
    }
    fn next_input_stop(&mut self, t: f64) -> Option<InputStop> {
        [(1.0, true), (2.0, false)]
            .into_iter()
            .map(|(time, jump)| InputStop { time, jump })
            .find(|stop| stop.time > t)
    }
}

#[test]
fn input_jumps_are_events_and_kinks_end_steps() {
    for method in [Method::Tsit5, Method::Rk4] {
        let mut seen = Recorder::default();
        let mut system = Driven { after_jump: false, inputs_seen: vec![] };
        let times: Vec<f64> = (0..=30).map(|k| f64::from(k) * 0.1).collect();
        let options = Options { step_size: Some(0.07), ..Options::default() };
        let report = driver(method, options).run(&mut system, 0.0, 3.0, &times, &mut seen).unwrap();
        assert_eq!((report.stats.input_events, report.stats.events), (1, 1));
        for (t, _, _, x) in &seen.rows {
            let exact = if *t <= 1.0 { *t } else { 1.0 - 2.0 * (t - 1.0) + 1.5 * (t - 2.0).max(0.0).powi(2) };
            assert!((x[0] - exact).abs() < 1e-13, "{}: x({t}) = {} instead of {exact}", method.name(), x[0]);
        }
        assert!(system.inputs_seen.contains(&(1.0, 1.0)), "left limit at the jump");
        assert!(system.inputs_seen.contains(&(1.0, -2.0)), "right limit at the jump");
    }
}

/// Requests a step event after every step, refuses x < 0 (a square root), or fails.
struct Odd {
    step_events: bool,
    discard_below: f64,
    fail_after: f64,
}
impl HybridSystem for Odd {
    fn n_states(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[0] = 1.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        if t > self.fail_after {
            return Err(CallError::failed("the motor is on fire"));
        }
        if x[0] < self.discard_below {
            return Err(CallError::Discard);
        }
        dx[0] = -x[0].sqrt();
        Ok(())
    }
    fn step_completed(&mut self, _: f64, _: &[f64]) -> CallResult<StepAction> {
        Ok(StepAction { event: self.step_events, terminate: false })
    }
}

#[test]
fn step_events_avoid_restart_when_nothing_changes() {
    let mut odd = Odd { step_events: true, discard_below: -1.0, fail_after: 9.0 };
    let report = driver(Method::Tsit5, Options::default()).run(&mut odd, 0.0, 1.0, &[], &mut Ignore).unwrap();
    assert_eq!(report.stats.step_events, report.stats.accepted_steps);
    assert_eq!(report.stats.restarts, 0);
}

/// (sin t, cos t) and a state that follows the first one at this rate. An event without effect happens at
/// each crossing.
struct Silent {
    rate: f64,
    events: usize,
}
impl HybridSystem for Silent {
    fn n_states(&self) -> usize {
        3
    }
    fn n_event_indicators(&self) -> usize {
        self.events
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[0.0, 1.0, 0.0]);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[x[1], -x[0], self.rate * (t.sin() - x[2])]);
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z.copy_from_slice(&[x[0] + 0.3 * x[1], x[0] - 0.2][..self.events]);
        Ok(())
    }
}

/// A difference between the slope of an interpolant and the right-hand side does not cause a restart.
#[test]
fn state_events_avoid_restart_when_nothing_changes() {
    for rate in [1.0, 50.0, 1e5] {
        for method in [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf] {
            if rate > 1e3 && matches!(method, Method::Tsit5 | Method::Dop853) {
                continue;
            }
            for relative_tolerance in [1e-4, 1e-6, 1e-8] {
                let run = |events: usize| {
                    let mut d = driver(method, Options { relative_tolerance, ..Options::default() });
                    let mut seen = Recorder::default();
                    let stats =
                        d.run(&mut Silent { rate, events }, 0.0, 30.0, &[30.0], &mut seen).unwrap().stats;
                    (stats, seen.rows[0].3[0])
                };
                let ((with, x), (without, y)) = (run(2), run(0));
                let name = format!("{} rate {rate} at {relative_tolerance:e}", method.name());
                assert_eq!((with.state_events, with.restarts), (19, 0), "{name}");
                // Steps end at the events, but there are no restarts. DOP853, which Auto also uses, ends one
                // step before an event that its interpolant places slightly too early.
                let (steps, plain) = (with.accepted_steps, without.accepted_steps);
                let per_event = if matches!(method, Method::Auto | Method::Dop853) { 2 } else { 1 };
                assert!(steps < 3 * plain / 2 + per_event * with.state_events, "{name}: {steps} for {plain}");
                let (off, usual) = ((x - 30f64.sin()).abs(), (y - 30f64.sin()).abs());
                assert!(off < 5.0 * usual + 10.0 * relative_tolerance, "{name}: {off:e} for {usual:e}");
            }
        }
    }
}

#[test]
fn refused_points_shrink_steps_and_error_reports_numbers() {
    // x = (1 - t/2)^2 reaches 0 at t = 2. A run to 1.9 succeeds; beyond 2, nothing can be evaluated.
    let mut odd = Odd { step_events: false, discard_below: 0.0, fail_after: 9.0 };
    let mut d = driver(Method::Tsit5, Options { relative_tolerance: 1e-8, ..Options::default() });
    let mut seen = Recorder::default();
    d.run(&mut odd, 0.0, 1.9, &[1.9], &mut seen).unwrap();
    assert!((seen.rows[0].3[0] - 0.0025).abs() < 1e-8);
    odd.discard_below = 0.25; // reached at t = 1
    let error = d.run(&mut odd, 0.0, 1.9, &[], &mut Ignore).unwrap_err();
    assert!(matches!(error.kind, ErrorKind::StepTooSmall { discarded: true }), "{error}");
    assert!((error.time - 1.0).abs() < 1e-5, "{error}");
    let error = driver(Method::Rk4, Options { step_size: Some(0.1), ..Options::default() })
        .run(&mut odd, 0.0, 1.9, &[], &mut Ignore)
        .unwrap_err();
    assert!(matches!(error.kind, ErrorKind::StepTooSmall { discarded: true }), "{error}");
    odd.discard_below = 2.0;
    let error = d.run(&mut odd, 0.0, 1.9, &[], &mut Ignore).unwrap_err();
    assert!(matches!(error.kind, ErrorKind::DiscardedAtRestart), "{error}");
}

#[test]
fn model_errors_keep_their_message() {
    let mut odd = Odd { step_events: false, discard_below: -1.0, fail_after: 0.5 };
    let error =
        driver(Method::Tsit5, Options::default()).run(&mut odd, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
    assert!(error.to_string().contains("the motor is on fire"), "{error}");
    assert!(std::error::Error::source(&*error).is_some());
}

#[test]
fn limits_and_cancel_return_typed_errors() {
    let limited = |limits: Limits| {
        let mut ball = Ball { v_min: 0.1, resting: false };
        let options = Options { limits, max_step: Some(0.001), ..Options::default() };
        driver(Method::Tsit5, options).run(&mut ball, 0.0, 4.0, &[], &mut Ignore).unwrap_err().kind
    };
    assert!(matches!(
        limited(Limits { max_steps: Some(7), ..Limits::default() }),
        ErrorKind::TooManySteps(7)
    ));
    assert!(matches!(
        limited(Limits { max_events: Some(3), ..Limits::default() }),
        ErrorKind::TooManyEvents(3)
    ));
    assert!(matches!(
        limited(Limits { max_right_hand_sides: Some(50), ..Limits::default() }),
        ErrorKind::TooManyRightHandSides(50)
    ));
    let no_time = Limits { timeout: Some(std::time::Duration::ZERO), ..Limits::default() };
    assert!(matches!(limited(no_time), ErrorKind::TimedOut(_)));
    let cancel = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(true));
    let options = Options { cancel: Some(cancel), ..Options::default() };
    let mut ball = Ball { v_min: 0.1, resting: false };
    let error = driver(Method::Tsit5, options).run(&mut ball, 0.0, 4.0, &[], &mut Ignore).unwrap_err();
    assert!(matches!(error.kind, ErrorKind::Cancelled));
}

#[test]
fn observer_can_stop_run() {
    let mut seen = Recorder { stop_after: Some(3), ..Recorder::default() };
    let times: Vec<f64> = (0..=40).map(|k| f64::from(k) * 0.1).collect();
    let mut ball = Ball { v_min: 0.1, resting: false };
    let report =
        driver(Method::Tsit5, Options::default()).run(&mut ball, 0.0, 4.0, &times, &mut seen).unwrap();
    assert_eq!((report.termination, seen.rows.len()), (Termination::StoppedByObserver, 3));
    assert_eq!(report.stats.samples, 3);
}

#[test]
fn rejects_invalid_spans_times_and_tolerances() {
    let mut d = driver(Method::Tsit5, Options::default());
    let mut ball = Ball { v_min: 0.1, resting: false };
    let mut fails = |start: f64, end: f64, times: &[f64]| {
        d.run(&mut ball, start, end, times, &mut Ignore).unwrap_err().kind
    };
    assert!(matches!(fails(1.0, 0.0, &[]), ErrorKind::Span { .. }));
    assert!(matches!(fails(0.0, f64::INFINITY, &[]), ErrorKind::Span { .. }));
    assert!(matches!(fails(0.0, 1.0, &[0.5, 0.4]), ErrorKind::SampleTimes { index: 1, .. }));
    assert!(matches!(fails(0.0, 1.0, &[0.5, 0.5, 0.5]), ErrorKind::SampleTimes { index: 2, .. }));
    assert!(matches!(fails(0.0, 1.0, &[f64::NAN]), ErrorKind::SampleTimes { index: 0, .. }));
    assert!(matches!(fails(0.0, 1.0, &[1.5]), ErrorKind::SampleTimes { index: 0, .. }));
    let options =
        Options { absolute_tolerance: AbsoluteTolerance::PerState(vec![1e-6]), ..Options::default() };
    let error = driver(Method::Tsit5, options).run(&mut ball, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
    assert!(matches!(error.kind, ErrorKind::ToleranceCount { given: 1, states: 2 }));
    assert!(Driver::new(Options { relative_tolerance: 0.0, ..Options::default() }).is_err());
    assert!(Driver::new(Options { step_size: Some(f64::NAN), ..Options::default() }).is_err());
}

#[test]
fn zero_span_and_times_near_1e9_are_supported() {
    let mut seen = Recorder::default();
    let mut d = driver(Method::Tsit5, Options::default());
    let mut ball = Ball { v_min: 0.1, resting: false };
    d.run(&mut ball, 2.0, 2.0, &[2.0], &mut seen).unwrap();
    assert_eq!(seen.rows.len(), 1);
    let mut seen = Recorder::default();
    let t0 = 1e9;
    let report = d.run(&mut ball, t0, t0 + 4.0, &[t0 + 4.0], &mut seen).unwrap();
    assert_eq!(report.stats.state_events, 11);
    for (t, e) in seen.event_times().iter().zip(bounce_times(0.1, 100)) {
        // Near 1e9, times within 100 u t = 1.1e-5 are equal, and each bounce passes on its error.
        assert!((t - t0 - e).abs() < 1e-3, "{t}");
    }
}

#[test]
fn second_run_is_bitwise_identical() {
    let times: Vec<f64> = (0..=400).map(|k| f64::from(k) * 0.01).collect();
    let run = |d: &mut Driver| {
        let mut seen = Recorder::default();
        d.run(&mut Ball { v_min: 0.1, resting: false }, 0.0, 4.0, &times, &mut seen).unwrap();
        seen.rows
    };
    let mut d = driver(Method::Tsit5, Options::default());
    let first = run(&mut d);
    d.run(&mut Coulomb { mode: 0.0 }, 0.0, 20.0, &[], &mut Ignore).unwrap();
    assert_eq!(first, run(&mut d));
    assert_eq!(first, run(&mut driver(Method::Tsit5, Options::default())));
}

#[test]
fn samples_do_not_change_steps() {
    let steps = |times: &[f64]| {
        let mut d = driver(Method::Tsit5, Options::default());
        d.run(&mut Ball { v_min: 0.1, resting: false }, 0.0, 4.0, times, &mut Ignore)
            .unwrap()
            .stats
            .right_hand_sides
    };
    let dense: Vec<f64> = (0..=4000).map(|k| f64::from(k) * 1e-3).collect();
    assert_eq!(steps(&[]), steps(&dense));
}
