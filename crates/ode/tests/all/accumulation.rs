//! Balls beyond their Zeno limit never fall through the floor undetected, with every method and for any state
//! that the event leaves.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

const METHODS: [Method; 7] =
    [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf, Method::Rk4, Method::Euler];

#[derive(Debug, Clone, Copy)]
struct BallSpec {
    height: f64,
    factor: f64,
    /// True if the event puts the ball exactly on the floor; false if it leaves the ball where it was found.
    put_on_floor: bool,
}

/// Balls that fall on a floor at height `floor`. All lengths are in units of `unit`. An event reverses the
/// speed of the falling balls or, if it is `blind`, of all crossing balls.
#[derive(Debug, Clone)]
struct Balls {
    balls: Vec<BallSpec>,
    direction: Direction,
    blind: bool,
    gravity: f64,
    /// Rate of an additional stiff state; 0 if there is none.
    rate: f64,
    floor: f64,
    unit: f64,
    nominals: bool,
    least: f64,
}

impl Balls {
    /// Returns the time at which the bounces of the first ball accumulate.
    fn limit(&self) -> f64 {
        let limit =
            |b: &BallSpec| (2.0 * b.height / self.gravity).sqrt() * (1.0 + b.factor) / (1.0 - b.factor);
        self.balls.iter().map(limit).fold(f64::INFINITY, f64::min)
    }
}

impl HybridSystem for Balls {
    fn n_states(&self) -> usize {
        2 * self.balls.len() + usize::from(self.rate > 0.0)
    }
    fn n_event_indicators(&self) -> usize {
        self.balls.len()
    }
    fn event_direction(&self, _: usize) -> Direction {
        self.direction
    }
    fn n_outputs(&self) -> usize {
        0
    }
    fn nominals(&mut self, nominals: &mut [f64]) -> CallResult<()> {
        nominals.fill(if self.nominals { self.unit } else { 1.0 });
        Ok(())
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        for (x, b) in x.chunks_exact_mut(2).zip(&self.balls) {
            x.copy_from_slice(&[self.unit * (self.floor + b.height), 0.0]);
        }
        x[2 * self.balls.len()..].fill(1.0);
        self.least = 0.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        for (dx, x) in dx.chunks_exact_mut(2).zip(x.chunks_exact(2)) {
            dx.copy_from_slice(&[x[1], -self.gravity * self.unit]);
        }
        let n = 2 * self.balls.len();
        dx[n..].iter_mut().zip(&x[n..]).for_each(|(dx, x)| *dx = -self.rate * (x - t.cos()));
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        for (z, x) in z.iter_mut().zip(x.chunks_exact(2)) {
            *z = x[0] - self.unit * self.floor;
        }
        Ok(())
    }
    fn step_completed(&mut self, _: f64, x: &[f64]) -> CallResult<StepAction> {
        for x in x.chunks_exact(2).take(self.balls.len()) {
            self.least = self.least.min(x[0] / self.unit - self.floor);
        }
        Ok(StepAction::default())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        for ((x, b), crossing) in x.chunks_exact_mut(2).zip(&self.balls).zip(visit.crossings) {
            if *crossing != 0 && (self.blind || x[1] < 0.0) {
                x[1] *= -b.factor;
                if b.put_on_floor {
                    x[0] = self.unit * self.floor;
                }
            }
        }
        Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
    }
}

/// A run with all its settings.
#[derive(Debug)]
struct Case {
    system: Balls,
    rtol: f64,
    method: Method,
    chattering: ChatteringPolicy,
    t0: f64,
}

impl Case {
    fn draw(random: &mut Random, number: usize) -> Self {
        let (n, size) = (random.of(&[1, 1, 2, 3]), random.of(&[1.0, 1.0, 0.01, 50.0]));
        let ball = |r: &mut Random| BallSpec {
            height: size * (0.2 + 1.5 * r.next()),
            factor: r.of(&[0.0, 0.01, 0.05, 0.2, 0.3, 0.4, 0.5, 0.7, 0.8, 0.9, 0.95]),
            put_on_floor: r.next() < 0.5,
        };
        let mut system = Balls {
            balls: (0..n).map(|_| ball(random)).collect(),
            direction: random.of(&[Direction::Down, Direction::Down, Direction::Both, Direction::Either]),
            blind: random.next() < 0.5,
            gravity: random.of(&[9.81, 9.81, 1.62, 274.0]),
            rate: 0.0,
            floor: random.of(&[0.0, 0.0, 0.1, 3.0, -0.7, 1000.0]),
            unit: random.of(&[1.0, 1.0, 1e-6, 1e6]),
            nominals: random.next() < 0.7,
            least: 0.0,
        };
        if number.is_multiple_of(10) && n > 1 {
            // Both balls land at the same time.
            system.balls[1].height = system.balls[0].height;
        }
        let rtol = random.of(&[1e-3, 1e-5, 1e-6, 1e-6, 1e-8, 1e-10]);
        let method = random.of(&METHODS);
        let chattering = match number % 8 {
            0 => ChatteringPolicy::Slide,
            4 => ChatteringPolicy::Warn,
            _ => ChatteringPolicy::Error,
        };
        // With FMI's rule, leaving the floor is also an event.
        system.blind &= system.direction != Direction::Both;
        // While one ball slides, steps end at events of the other balls, wherever the sliding ball is. The
        // handler must therefore check its speed.
        system.blind &= n == 1 || chattering != ChatteringPolicy::Slide;
        system.nominals |= system.unit != 1.0;
        if matches!(method, Method::Auto | Method::Radau5 | Method::Bdf) {
            system.rate = random.of(&[0.0, 0.0, 1e4]);
        }
        Self { system, rtol, method, chattering, t0: random.of(&[0.0, 0.0, -3.0, 1e4]) }
    }

    /// Runs the case. Returns a description of the error, if there is one.
    fn run(&mut self) -> Result<(), String> {
        let Self { system, rtol, method, chattering, t0 } = self;
        let (rtol, method, chattering, t0) = (*rtol, *method, *chattering, *t0);
        let slides = chattering == ChatteringPolicy::Slide;
        let (limit, n) = (system.limit(), system.balls.len());
        let span = 1.5 * limit;
        let times: Vec<f64> = (0..=400).map(|i| t0 + span * f64::from(i) / 400.0).collect();
        let mut options = Options { method, relative_tolerance: rtol, chattering, ..Options::default() };
        options.limits.max_steps = Some(600_000);
        let mut seen = Recorder::default();
        let outcome = Driver::new(options).unwrap().run(system, t0, t0 + span, &times, &mut seen);
        let samples = seen.rows.iter().flat_map(|row| row.3[..2 * n].chunks_exact(2));
        let least = samples.map(|x| x[0] / system.unit - system.floor).fold(system.least, f64::min);
        // A ball that still slides returns within a hundred steps. This is how deep it sinks in the last
        // hundred steps.
        let step = ChatteringPolicy::SLIDING_STEP * span;
        let sunk = if slides { 0.5 * 100.0 * system.gravity * step * step } else { 0.0 };
        let highest = system.balls.iter().map(|b| b.height).fold(0.0, f64::max);
        // An event is located within a few times 100 u max(|t|, span).
        let speed = (2.0 * highest * system.gravity).sqrt();
        let located = 16.0 * 100.0 * 0.5 * f64::EPSILON * (t0.abs() + span) * speed;
        let tolerance = 100.0 * rtol * (highest + system.floor.abs()) + sunk + located;
        if least.is_nan() || least < -tolerance {
            return Err(format!("{least:e} below the floor, {outcome:?}"));
        }
        let Err(error) = outcome else { return Ok(()) };
        if slides && method == Method::Bdf && matches!(error.kind, ErrorKind::TooManySteps(_)) {
            // The first step after each event is of order 1. If the tolerance is tight, it is far shorter
            // than a step of sliding.
            return Ok(());
        }
        let (ErrorKind::Chattering { indicator, .. } | ErrorKind::EventsAccumulate { indicator }) =
            error.kind
        else {
            return Err(error.to_string());
        };
        // BDF restarts at order 1, so the run ends when the bounces are below the tolerance. The height may
        // be a small fraction of the tolerance.
        let early = if matches!(method, Method::Bdf | Method::Euler) { 0.0 } else { 0.97 };
        if indicator >= n || error.time - t0 < early * limit {
            return Err(format!("{error}, limit {limit}"));
        }
        if slides && !method.is_fixed_step() {
            return Err(format!("does not slide: {error}"));
        }
        Ok(())
    }
}

/// Runs random cases with this seed.
fn run_cases(seed: u64, count: usize) {
    let mut random = Random(seed);
    let mut wrong = Vec::new();
    for number in 0..count {
        let mut case = Case::draw(&mut random, number);
        if let Err(why) = case.run() {
            wrong.push(format!("seed {seed}, case {number}: {why}\n    {case:?}"));
        }
    }
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn balls_stay_above_floor() {
    run_cases(1, 300);
}

#[test]
#[ignore = "long"]
fn many_balls_stay_above_floor() {
    for seed in 1..=20 {
        run_cases(seed, 1500);
    }
}

/// One ball, put exactly on the floor. All bounces are found until their times cannot be distinguished. The
/// error then reports the indicator.
#[test]
fn accumulation_error_reports_indicator_at_zeno_limit() {
    // Euler's method is excluded: its steps are straight lines, so the balls come to rest.
    for &method in &METHODS[..6] {
        for factor in [0.2, 0.5, 0.8] {
            for put_on_floor in [true, false] {
                let mut system = Balls {
                    balls: vec![BallSpec { height: 1.0, factor, put_on_floor }],
                    direction: Direction::Down,
                    blind: false,
                    gravity: 9.81,
                    rate: 0.0,
                    floor: 0.0,
                    unit: 1.0,
                    nominals: true,
                    least: 0.0,
                };
                let limit = system.limit();
                let options = Options { method, ..Options::default() };
                let mut driver = Driver::new(options).unwrap();
                let error = driver.run(&mut system, 0.0, 1.5 * limit, &[], &mut Ignore).unwrap_err();
                let name = format!("{} {factor} {put_on_floor}: {error}", method.name());
                assert!(error.to_string().contains("chattering at t ="), "{name}");
                assert!(error.to_string().contains("event indicator 0"), "{name}");
                if !matches!(method, Method::Bdf | Method::Euler) {
                    assert!((error.time - limit).abs() < 1e-3 * limit, "{name}");
                }
                let least = if method == Method::Bdf { 5 } else { 8 };
                assert!(error.stats.state_events > least, "{name}");
            }
        }
    }
}

/// A plain crossing costs no right-hand side and one evaluation of the indicators. A fall that begins far
/// below the floor does not count as a return.
#[test]
fn plain_crossings_need_few_extra_evaluations() {
    /// x'' = -g with the indicator z = x. The function changes the state at an event.
    struct Fall(Event);
    type Event = fn(&mut [f64]);
    impl HybridSystem for Fall {
        fn n_states(&self) -> usize {
            2
        }
        fn n_event_indicators(&self) -> usize {
            1
        }
        fn event_direction(&self, _: usize) -> Direction {
            Direction::Down
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
        fn handle_event(&mut self, _: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
            self.0(x);
            Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
        }
    }
    let t1 = (2.0_f64 / 9.81).sqrt();
    let rest: [(Event, f64); 3] = [
        (|_| {}, -9.81 * t1),
        (|x| x.copy_from_slice(&[-0.5, 0.1]), 0.1),
        (|x| x[1] *= 0.5, -0.5 * 9.81 * t1),
    ];
    for method in METHODS {
        for (i, (event, v)) in rest.iter().enumerate() {
            let mut seen = Recorder::default();
            let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
            let report = driver.run(&mut Fall(*event), 0.0, 2.0, &[2.0], &mut seen);
            let report = report.unwrap_or_else(|e| panic!("{} {i}: {e}", method.name()));
            assert_eq!(report.stats.state_events, 1, "{} {i}", method.name());
            let (s, x0) = (2.0 - t1, if i == 1 { -0.5 } else { 0.0 });
            let exact = x0 + v * s - 0.5 * 9.81 * s * s;
            let off = (seen.rows[0].3[0] - exact).abs();
            let most = if method == Method::Euler { 0.1 } else { 1e-4 };
            assert!(off < most, "{} {i}: {off:e}", method.name());
        }
    }
}

/// A ball that its event stops at the floor does not continue and fall undetected.
#[test]
fn ball_stopped_at_floor_does_not_fall_through() {
    for method in METHODS {
        for put_on_floor in [true, false] {
            for chattering in [ChatteringPolicy::Error, ChatteringPolicy::Slide] {
                let balls = vec![BallSpec { height: 1.0, factor: 0.0, put_on_floor }];
                let mut system = Balls {
                    balls,
                    direction: Direction::Down,
                    blind: true,
                    gravity: 9.81,
                    rate: 0.0,
                    floor: 0.0,
                    unit: 1.0,
                    nominals: true,
                    least: 0.0,
                };
                let mut driver = Driver::new(Options { method, chattering, ..Options::default() }).unwrap();
                let ended = driver.run(&mut system, 0.0, 2.0, &[], &mut Ignore);
                let name = format!("{} {put_on_floor} {chattering:?}: {ended:?}", method.name());
                assert!(system.least > -1e-5, "{}: {name}", system.least);
                let slides = chattering == ChatteringPolicy::Slide && !method.is_fixed_step();
                assert_eq!(ended.is_ok(), slides, "{name}");
            }
        }
    }
}

/// With [`Direction::Either`], a handler that always reverses the speed makes a ball bounce, because leaving
/// the floor is not an event.
#[test]
fn leaving_the_floor_is_ignored_with_direction_either() {
    for method in METHODS {
        for put_on_floor in [true, false] {
            let balls = vec![BallSpec { height: 1.0, factor: 0.8, put_on_floor }];
            let mut system = Balls {
                balls,
                direction: Direction::Either,
                blind: true,
                gravity: 9.81,
                rate: 0.0,
                floor: 0.0,
                unit: 1.0,
                nominals: true,
                least: 0.0,
            };
            let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
            let mut seen = Recorder::default();
            driver.run(&mut system, 0.0, 2.0, &[], &mut seen).unwrap();
            let t1 = (2.0_f64 / 9.81).sqrt();
            let expected = [t1, t1 * 2.6, t1 * 3.88];
            let name = format!("{} {put_on_floor}: {:?}", method.name(), seen.event_times());
            assert_eq!(seen.events.len(), expected.len(), "{name}");
            let most = if method == Method::Euler { 0.05 } else { 1e-4 };
            assert!(seen.event_times().iter().zip(expected).all(|(t, e)| (t - e).abs() < most), "{name}");
        }
    }
}
