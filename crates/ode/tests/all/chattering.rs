//! State events that follow each other while time hardly advances: the three policies, and clocks that do not
//! advance.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

const ADAPTIVE: &[Method] = &[Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf];

fn driver(method: Method, chattering: ChatteringPolicy) -> Driver {
    Driver::new(Options { method, chattering, ..Options::default() }).unwrap()
}

/// `x' = push(t) - s`, `y' = 2 - s` with `s = sign(x)`, which changes when x passes the hysteresis. Starts at
/// x(0) = 1, y(0) = 0.
struct Switched {
    push: fn(f64) -> f64,
    hysteresis: f64,
    s: f64,
}

impl Switched {
    fn new(push: fn(f64) -> f64, hysteresis: f64) -> Self {
        Self { push, hysteresis, s: 1.0 }
    }
}

impl HybridSystem for Switched {
    fn n_states(&self) -> usize {
        2
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[1.0, 0.0]);
        self.s = 1.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, _: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[(self.push)(t) - self.s, 2.0 - self.s]);
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = x[0] + self.s * self.hysteresis;
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        self.s = f64::from(visit.crossings[0]);
        Ok(EventOutcome::default())
    }
}

#[test]
fn sliding_matches_filippov_solution() {
    // Above zero, x' = -0.5 and y' = 1; below, x' = 1.5 and y' = 3. The solution reaches x = 0 at t = 2 with
    // y = 2. To stay there, it combines three quarters of the upper field and one quarter of the lower field:
    // y' = 1.5.
    for &method in ADAPTIVE {
        let mut seen = Recorder::default();
        let mut system = Switched::new(|_| 0.5, 0.0);
        let times = [1.0, 3.0, 4.0];
        let report =
            driver(method, ChatteringPolicy::Slide).run(&mut system, 0.0, 4.0, &times, &mut seen).unwrap();
        assert_eq!((report.termination, report.stats.chattering), (Termination::Finished, 1));
        for (row, expected) in seen.rows.iter().zip([[0.5, 1.0], [0.0, 3.5], [0.0, 5.0]]) {
            for (x, e) in row.3.iter().zip(expected) {
                // Three steps of 1e-5 of the span.
                assert!((x - e).abs() < 1.2e-4, "{} at {}: {x} for {e}", method.name(), row.0);
            }
        }
    }
}

#[test]
fn sliding_ends_when_fields_point_away() {
    // With x' = t - 1.5 - s, x falls to 0, slides until t = 2.5, and then rises as (t - 2.5)^2 / 2.
    for &method in ADAPTIVE {
        let mut seen = Recorder::default();
        let mut system = Switched::new(|t| t - 1.5, 0.0);
        let mut driver = driver(method, ChatteringPolicy::Slide);
        let report = driver.run(&mut system, 0.0, 50.0, &[1.0, 2.4, 50.0], &mut seen).unwrap();
        let x: Vec<f64> = seen.rows.iter().map(|row| row.3[0]).collect();
        assert!(x[0].abs() < 1e-3 && x[1].abs() < 1e-3, "{}: {x:?}", method.name());
        assert!((x[2] / (0.5 * 47.5 * 47.5) - 1.0).abs() < 1e-4, "{}: {x:?}", method.name());
        // Two units of time in steps of 1e-5 times 50, and a few more steps. BDF's first step after an event
        // is of order 1, and its error test requires shorter steps.
        let most = if method == Method::Bdf { 30_000 } else { 6000 };
        assert!(report.stats.accepted_steps < most, "{}: {}", method.name(), report.stats.accepted_steps);
    }
}

/// `x' = v`, `v' = -force r`. The event sets the state `r` to 1 when `weight x + v` becomes positive, and
/// to -1 when it becomes negative. `x(0) = v(0) = r(0) = 1`.
struct Relay {
    weight: f64,
    force: f64,
    /// True for one indicator per direction, false for one indicator for both directions.
    two_indicators: bool,
    /// Time and states after the last event.
    last: (f64, Vec<f64>),
}

impl HybridSystem for Relay {
    fn n_states(&self) -> usize {
        3
    }
    fn n_event_indicators(&self) -> usize {
        if self.two_indicators { 2 } else { 1 }
    }
    fn event_direction(&self, indicator: usize) -> Direction {
        match (self.two_indicators, indicator) {
            (true, 0) => Direction::Up,
            (true, _) => Direction::Down,
            _ => Direction::Both,
        }
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.fill(1.0);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        assert!(t != self.last.0 || x[..2] == self.last.1[..2], "{:?} at {t} became {x:?}", self.last.1);
        dx.copy_from_slice(&[x[1], -self.force * x[2], 0.0]);
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z.fill(self.weight * x[0] + x[1]);
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[2] = if visit.crossings.contains(&1) { 1.0 } else { -1.0 };
        self.last = (visit.time, x.to_vec());
        Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
    }
}

/// On the surface, `v = -weight x`, so `x` decays from the point at which the parabola reaches the surface.
#[test]
fn sliding_never_moves_states_unchanged_by_event() {
    for &method in ADAPTIVE {
        for (weight, force, end) in [(1.0, 3.0, 1.0), (1.0, 3.0, 5.0), (2.0, 6.0, 2.0), (0.5, 2.0, 3.0)] {
            for two_indicators in [true, false] {
                let mut seen = Recorder::default();
                let mut system = Relay { weight, force, two_indicators, last: (f64::NAN, vec![]) };
                let mut driver = driver(method, ChatteringPolicy::Slide);
                driver.run(&mut system, 0.0, end, &[end], &mut seen).unwrap();
                // weight (1 + t - force t^2 / 2) + 1 - force t = 0
                let (a, b, c) = (0.5 * weight * force, force - weight, -(weight + 1.0));
                let t = (-b + (b * b - 4.0 * a * c).sqrt()) / (2.0 * a);
                let x = (1.0 + t - 0.5 * force * t * t) * (-weight * (end - t)).exp();
                let found = &seen.rows[0].3;
                let is_right = (found[0] - x).abs() < 5e-4 && (found[1] + weight * x).abs() < 5e-4;
                assert!(
                    is_right,
                    "{} {weight} {force} {end} {two_indicators}: {found:?}, not {x}",
                    method.name()
                );
            }
        }
    }
}

#[test]
fn ball_with_accumulating_bounces_slides_on_floor() {
    let limit = 2.558_633_965_585_808_4;
    // BDF is excluded: its first steps after a bounce are as inaccurate as the tolerance allows. This ball
    // has no minimum speed, so it sinks into the floor if it is not above the floor after a bounce.
    for &method in &ADAPTIVE[..4] {
        let (mut seen, mut ball) = (Recorder::default(), Ball { v_min: 0.0, resting: false });
        let report =
            driver(method, ChatteringPolicy::Slide).run(&mut ball, 0.0, 4.0, &[2.6, 4.0], &mut seen).unwrap();
        assert_eq!(report.stats.chattering, 1);
        for row in &seen.rows {
            assert!(row.3[0].abs() < 1e-7 && row.3[1].abs() < 1e-3, "{}: {row:?}", method.name());
        }
        for policy in [ChatteringPolicy::Error, ChatteringPolicy::Warn] {
            let mut ball = Ball { v_min: 0.0, resting: false };
            let error = driver(method, policy).run(&mut ball, 0.0, 4.0, &[], &mut Ignore).unwrap_err();
            assert!(matches!(error.kind, ErrorKind::Chattering { events: 100, .. }), "{error}");
            assert!((error.time - limit).abs() < 1e-5, "{} {policy:?}: {error}", method.name());
        }
    }
}

#[test]
fn warn_policy_continues_and_counts_chattering() {
    // The system switches every 2e-7 units of time in a span of 10. A hundred switches take 2e-5, which is
    // above 1e-6 of the span. A fifth of this is below the limit.
    for (hysteresis, fired) in [(1e-7, 0), (4e-9, 20)] {
        let mut options =
            Options { chattering: ChatteringPolicy::Warn, method: Method::Tsit5, ..Options::default() };
        options.limits.max_events = Some(2100);
        let mut system = Switched::new(|_| 0.0, hysteresis);
        let error = Driver::new(options).unwrap().run(&mut system, 0.0, 10.0, &[], &mut Ignore).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::TooManyEvents(2100)), "{error}");
        assert_eq!(error.stats.chattering, fired);
    }
}

/// A system that consists of a clock that ticks every `period`.
struct Clock {
    period: f64,
    ticks: u64,
}

impl HybridSystem for Clock {
    fn n_states(&self) -> usize {
        0
    }
    fn start(&mut self, t0: f64, _: &mut [f64]) -> CallResult<EventOutcome> {
        Ok(EventOutcome { next_time: Some(t0 + self.period), ..EventOutcome::default() })
    }
    fn derivatives(&mut self, _: f64, _: &[f64], _: &mut [f64]) -> CallResult<()> {
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        self.ticks += 1;
        Ok(EventOutcome { next_time: Some(visit.time + self.period), ..EventOutcome::default() })
    }
}

#[test]
fn fast_clock_is_accepted_and_stalled_clock_is_rejected() {
    for policy in [ChatteringPolicy::Error, ChatteringPolicy::Warn, ChatteringPolicy::Slide] {
        let mut fast = Clock { period: 1e-5, ticks: 0 };
        driver(Method::Tsit5, policy).run(&mut fast, 0.0, 1.0, &[], &mut Ignore).unwrap();
        assert!((99_998..=100_000).contains(&fast.ticks), "{}", fast.ticks);
        for period in [2e-14, 1e-13, 1e-12] {
            let mut still = Clock { period, ticks: 0 };
            let error =
                driver(Method::Tsit5, policy).run(&mut still, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
            assert!(matches!(error.kind, ErrorKind::TimeEventLoop(100)), "{period:e}: {error}");
            assert!(still.ticks <= 201, "{}", still.ticks);
        }
    }
}

#[test]
fn policies_parse_from_names() {
    for name in ChatteringPolicy::NAMES {
        let policy: ChatteringPolicy = name.parse().unwrap();
        assert_eq!(format!("{policy:?}").to_lowercase(), name);
    }
    assert!("stop".parse::<ChatteringPolicy>().unwrap_err().to_string().contains("error, warn, slide"));
}

/// A relay that switches 2000 times per second and a clock of 1 kHz are not chattering, however long the run
/// is. A solution that cannot leave the border of a domain and a clock that does not advance are.
#[test]
fn allowed_event_rate_is_independent_of_span() {
    for span in [10.0, 1e4, 1e7, 1e9] {
        for &method in ADAPTIVE {
            let limits = Limits { max_events: Some(1000), ..Limits::default() };
            let mut driver = Driver::new(Options { method, limits, ..Options::default() }).unwrap();
            let mut relay = Switched::new(|_| 0.0, 2.5e-4);
            let error = driver.run(&mut relay, 0.0, span, &[], &mut Ignore).unwrap_err();
            assert!(
                matches!(error.kind, ErrorKind::TooManyEvents(1000)),
                "{} {span:e}: {error}",
                method.name()
            );
            // Times closer than 1.1e-14 of the span are equal.
            assert!((error.time - 1.5).abs() < 1e-3 + 2e-11 * span, "{} {span:e}: {error}", method.name());

            let mut sliding = Switched::new(|_| 0.0, 0.0);
            let error = driver.run(&mut sliding, 0.0, span, &[], &mut Ignore).unwrap_err();
            assert!(
                matches!(error.kind, ErrorKind::Chattering { events: 100, .. }),
                "{} {span:e}: {error}",
                method.name()
            );
        }
        let limits = Limits { max_events: Some(1000), ..Limits::default() };
        let mut driver = Driver::new(Options { limits, ..Options::default() }).unwrap();
        let mut clock = Clock { period: 1e-3, ticks: 0 };
        let error = driver.run(&mut clock, 0.0, span, &[], &mut Ignore).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::TooManyEvents(1000)), "{span:e}: {error}");
        let mut still = Clock { period: 2e-14 * span, ticks: 0 };
        let error = driver.run(&mut still, 0.0, span, &[], &mut Ignore).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::TimeEventLoop(100)), "{span:e}: {error}");
    }
}

/// A ball that its event puts exactly on the floor never falls through, although its arcs become shorter than
/// any step. (With BDF it does, because the first step of BDF is a straight line.)
#[test]
fn ball_on_floor_does_not_fall_through() {
    struct Bare {
        direction: Direction,
    }
    impl HybridSystem for Bare {
        fn n_states(&self) -> usize {
            2
        }
        fn n_event_indicators(&self) -> usize {
            1
        }
        fn event_direction(&self, _: usize) -> Direction {
            self.direction
        }
        fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
            x.copy_from_slice(&[1.0, 0.0]);
            Ok(EventOutcome::default())
        }
        fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
            dx.copy_from_slice(&[x[1], -9.81]);
            Ok(())
        }
        fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
            z[0] = x[0];
            Ok(())
        }
        fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
            if visit.crossings[0] < 0 {
                x.copy_from_slice(&[0.0, -0.7 * x[1]]);
            }
            Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
        }
    }
    for &method in &ADAPTIVE[..4] {
        for direction in [Direction::Down, Direction::Both] {
            let mut driver = driver(method, ChatteringPolicy::Error);
            let what = format!("{} {direction:?}", method.name());
            let error = driver.run(&mut Bare { direction }, 0.0, 4.0, &[], &mut Ignore).expect_err(&what);
            // The resolution of times determines which of the two errors occurs first.
            let kind = &error.kind;
            let named = matches!(
                kind,
                ErrorKind::Chattering { events: 100, .. } | ErrorKind::EventsAccumulate { indicator: 0 }
            );
            assert!(named, "{what}: {error}");
            assert!((error.time - 2.558_633_965_585_808_4).abs() < 1e-6, "{what}: {error}");
        }
    }
}
