//! Requirements for every method: correct event times, samples as accurate as steps, and bit-for-bit
//! identical repetitions.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;
use crate::problems;

use common::*;
use ode::*;
use problems::hybrid::*;

const ADAPTIVE: &[Method] =
    &[Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Adams, Method::Bdf];

fn driver(method: Method, rtol: f64) -> Driver {
    Driver::new(Options { method, relative_tolerance: rtol, ..Options::default() }).unwrap()
}

#[test]
fn bounce_times_match_closed_form_for_every_method() {
    let expected = bounce_times(0.1, 100);
    for &method in ADAPTIVE {
        for rtol in [1e-4, 1e-6, 1e-9] {
            let bar = match method {
                Method::Radau5 | Method::Adams | Method::Bdf => 100.0 * rtol,
                _ => 1e-12,
            };
            let mut seen = Recorder::default();
            let mut ball = Ball { v_min: 0.1, resting: false };
            let report = driver(method, rtol).run(&mut ball, 0.0, 4.0, &[4.0], &mut seen).unwrap();
            assert_eq!(report.stats.state_events, 11, "{}", method.name());
            for (t, e) in seen.event_times().iter().zip(&expected) {
                assert!((t - e).abs() < bar, "{} at {rtol:e}: {t}: {:e}", method.name(), t - e);
            }
            assert_eq!(seen.rows.last().unwrap().3, [0.0, 0.0]);
        }
    }
}

#[test]
fn sliding_is_reported_as_chattering_by_every_method() {
    for &method in ADAPTIVE {
        let error = driver(method, 1e-6).run(&mut Relay(1.0), 0.0, 2.0, &[], &mut Ignore).unwrap_err();
        assert!(
            matches!(error.kind, ErrorKind::Chattering { indicator: 0, .. }),
            "{}: {error}",
            method.name()
        );
        assert!((error.time - 1.0).abs() < 1e-5, "{}: {error}", method.name());
    }
}

#[test]
fn dry_friction_turning_points_match_closed_form_for_every_method() {
    for &method in ADAPTIVE {
        let mut seen = Recorder::default();
        driver(method, 1e-8).run(&mut Coulomb(0.0), 0.0, 20.0, &[20.0], &mut seen).unwrap();
        assert_eq!(seen.events.len(), 5, "{}", method.name());
        for (k, t) in seen.event_times().iter().enumerate() {
            let off = t - (k + 1) as f64 * std::f64::consts::PI;
            assert!(off.abs() < 1e-6, "{}: event {k} at {t}: {off:e}", method.name());
        }
        assert!((seen.rows[0].3[0] - 0.05).abs() < 1e-6, "{}: {:?}", method.name(), seen.rows[0]);
    }
}

#[test]
fn samples_between_steps_are_as_accurate_as_steps_for_every_method() {
    let times: Vec<f64> = (0..=4000).map(|k| f64::from(k) * 0.005).collect();
    for &method in ADAPTIVE {
        for rtol in [1e-4, 1e-6, 1e-8, 1e-10] {
            let mut seen = Recorder::default();
            let mut system = Smooth {
                x0: vec![1.0, 0.0],
                f: |_: f64, x: &[f64], dx: &mut [f64]| {
                    dx[0] = x[1];
                    dx[1] = -x[0];
                },
            };
            driver(method, rtol).run(&mut system, 0.0, 20.0, &times, &mut seen).unwrap();
            let error =
                |r: &(f64, Option<usize>, Side, Vec<f64>)| (r.3[0] - r.0.cos()).hypot(r.3[1] + r.0.sin());
            let worst = seen.rows.iter().map(error).fold(0.0, f64::max);
            println!("{} {rtol:e} {worst:e} {:e}", method.name(), error(seen.rows.last().unwrap()));
            assert!(worst < 100.0 * rtol, "{} at {rtol:e}: {worst:e}", method.name());
        }
    }
}

#[test]
fn coincident_events_share_one_visit() {
    for &method in ADAPTIVE {
        let also = |t: f64| vec![t - 0.5, 0.5 - t, if t > 0.5 { 1.0 } else { -1.0 }];
        let mut turning = Turning { also, seen: vec![], announced: Some(0.5) };
        let report = driver(method, 1e-6).run(&mut turning, 0.0, 0.7, &[0.5], &mut Ignore).unwrap();
        assert!(turning.seen[0].0 == 0.5, "{}: {:?}", method.name(), turning.seen);
        assert!(
            report.stats.time_events == 1 && report.stats.events <= 2,
            "{}: {:?}",
            method.name(),
            turning.seen
        );
    }
}

/// sin(2 pi t) is below -0.99 for only 0.045 units of time.
#[test]
fn crossing_and_return_within_a_step_are_located() {
    for &method in ADAPTIVE {
        let mut turning = Turning { also: |_| vec![], seen: vec![], announced: None };
        let relative_tolerance = if method == Method::Bdf { 1e-13 } else { 1e-12 };
        let options = Options { method, relative_tolerance, max_step: Some(0.1), ..Options::default() };
        Driver::new(options).unwrap().run(&mut turning, 0.0, 1.0, &[], &mut Ignore).unwrap();
        let expected = [(0.72747329317779394807, -1), (0.77252670682220605193, 1)];
        assert_eq!(turning.seen.len(), 2, "{}: {:?}", method.name(), turning.seen);
        for ((t, crossings), (e, direction)) in turning.seen.iter().zip(expected) {
            assert!((t - e).abs() < 1e-10, "{}: {t}: {:e}", method.name(), t - e);
            assert_eq!(crossings[0], direction);
        }
        for interior_samples in [None, Some(0), Some(10)] {
            let mut turning = Turning { also: |_| vec![], seen: vec![], announced: None };
            let options = Options { method, interior_samples, ..Options::default() };
            Driver::new(options).unwrap().run(&mut turning, 0.0, 1.0, &[], &mut Ignore).unwrap();
            assert!(turning.seen.len().is_multiple_of(2), "{}: {:?}", method.name(), turning.seen);
            if interior_samples == Some(10) {
                assert_eq!(turning.seen.len(), 2, "{}", method.name());
            }
        }
    }
}

#[test]
fn jump_indicators_are_located_loosely_when_allowed() {
    for &method in ADAPTIVE {
        let run = |loose_jump_indicators: bool| {
            let also = |t: f64| vec![if t < 0.3 { 1.0 } else { -1.0 }];
            let mut turning = Turning { also, seen: vec![], announced: None };
            let options = Options { method, loose_jump_indicators, ..Options::default() };
            let report = Driver::new(options).unwrap().run(&mut turning, 0.0, 0.5, &[], &mut Ignore).unwrap();
            (turning.seen[0].0, report.stats.event_indicators)
        };
        let ((tight, many), (loose, few)) = (run(false), run(true));
        // Radau5 repeats its step and locates the event to a thousandth of its tolerance.
        let bar = if method == Method::Radau5 { 1e-9 } else { 1e-14 };
        assert!((0.0..bar).contains(&(tight - 0.3)), "{}: {tight}", method.name());
        assert!((0.0..1e-9).contains(&(loose - 0.3)), "{}: {loose}", method.name());
        assert!(few < many, "{}: {few} {many}", method.name());
    }
}

#[test]
fn second_run_is_bitwise_identical_for_every_method() {
    let times: Vec<f64> = (0..=400).map(|k| f64::from(k) * 0.01).collect();
    for &method in ADAPTIVE {
        let run = |d: &mut Driver| {
            let mut seen = Recorder::default();
            let mut ball = Ball { v_min: 0.1, resting: false };
            let stats = d.run(&mut ball, 0.0, 4.0, &times, &mut seen).unwrap().stats;
            (seen.rows, stats)
        };
        let mut d = driver(method, 1e-6);
        let first = run(&mut d);
        d.run(&mut Coulomb(0.0), 0.0, 20.0, &[], &mut Ignore).unwrap();
        d.run(&mut problems::stiff::hires(), 0.0, 300.0, &[], &mut Ignore).unwrap();
        assert!(first == run(&mut d), "{}", method.name());
        assert!(first == run(&mut driver(method, 1e-6)), "{}", method.name());
    }
}

/// x' = -1000 (x - u), where u is a triangle wave with kinks at integers up to t = 5, where it jumps to 3.
struct Follower(Vec<f64>);

impl HybridSystem for Follower {
    fn n_states(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[0] = 0.0;
        self.0.clear();
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        let u = if self.0.is_empty() { 1.0 - ((t / 2.0).fract() * 2.0 - 1.0).abs() } else { 3.0 };
        dx[0] = -1000.0 * (x[0] - u);
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        assert!(visit.cause.input);
        self.0.push(visit.time);
        Ok(EventOutcome::default())
    }
    fn next_input_stop(&mut self, t: f64) -> Option<InputStop> {
        let next = t.floor() + 1.0;
        (next <= 5.0).then_some(InputStop { time: next, jump: next == 5.0 })
    }
}

#[test]
fn input_jumps_are_hit_with_and_without_kinks() {
    for &method in ADAPTIVE {
        let mut follower = Follower(vec![]);
        let mut seen = Recorder::default();
        driver(method, 1e-6).run(&mut follower, 0.0, 6.0, &[4.5, 5.0, 5.0, 6.0], &mut seen).unwrap();
        assert_eq!(follower.0, [5.0], "{}", method.name());
        // On a slope s, the state is s / 1000 behind the input.
        let expected = [0.499, 0.999, 0.999, 3.0];
        for (row, e) in seen.rows.iter().zip(expected) {
            // An explicit method operates at its stability limit here.
            assert!((row.3[0] - e).abs() < 3e-5, "{}: {row:?} instead of {e}", method.name());
        }
    }
}

/// x' = -sqrt(x), refused below zero, or x' = log(1 - t), which is NaN after t = 1.
#[test]
fn refused_points_shrink_steps_and_then_fail() {
    for &method in ADAPTIVE {
        let mut root = Smooth { x0: vec![1.0], f: |_: f64, x: &[f64], dx: &mut [f64]| dx[0] = -x[0].sqrt() };
        let mut seen = Recorder::default();
        driver(method, 1e-6).run(&mut root, 0.0, 1.9, &[1.9], &mut seen).unwrap();
        assert!((seen.rows[0].3[0] - 0.0025).abs() < 1e-5, "{}", method.name());
        let mut log = Smooth { x0: vec![0.0], f: |t: f64, _: &[f64], dx: &mut [f64]| dx[0] = (1.0 - t).ln() };
        driver(method, 1e-6).run(&mut log, 0.0, 0.999, &[], &mut Ignore).unwrap();
        let error = driver(method, 1e-6).run(&mut log, 0.0, 2.0, &[], &mut Ignore).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::StepTooSmall { .. }), "{}: {error}", method.name());
        assert!(error.time > 0.99 && error.time <= 1.0, "{}: {error}", method.name());
    }
}

#[test]
fn systems_without_states_or_span_finish() {
    for &method in ADAPTIVE {
        let mut nothing = Smooth { x0: vec![], f: |_: f64, _: &[f64], _: &mut [f64]| panic!("no states") };
        let report = driver(method, 1e-6).run(&mut nothing, 0.0, 3.0, &[1.0, 3.0], &mut Ignore).unwrap();
        assert_eq!((report.stats.samples, report.termination), (2, Termination::Finished));
        let mut ball = Ball { v_min: 0.1, resting: false };
        let report = driver(method, 1e-6).run(&mut ball, 2.0, 2.0, &[2.0], &mut Ignore).unwrap();
        assert_eq!((report.stats.samples, report.stats.accepted_steps), (1, 0));
    }
}

/// Stores the state in the middle of every step, and the ends of the steps.
#[derive(Default)]
struct Steps {
    spans: Vec<(f64, f64)>,
    middle: Vec<Vec<f64>>,
    ends: Vec<[Vec<f64>; 2]>,
}

impl Observer for Steps {
    fn sample(&mut self, _: &Sample<'_>) -> std::ops::ControlFlow<()> {
        std::ops::ControlFlow::Continue(())
    }
    fn needs_steps(&self) -> bool {
        true
    }
    fn step(&mut self, step: &StepView<'_>) {
        let at = |t: f64| {
            let mut x = vec![f64::NAN; 2];
            step.states_at(t, &mut x);
            x
        };
        self.spans.push((step.start, step.end));
        self.middle.push(at(0.5 * (step.start + step.end)));
        self.ends.push([at(step.start), at(step.end)]);
    }
}

#[test]
fn observer_can_interpolate_inside_steps() {
    for &method in ADAPTIVE {
        let mut steps = Steps::default();
        let f = |_: f64, x: &[f64], dx: &mut [f64]| dx.copy_from_slice(&[x[1], -x[0]]);
        let mut circle = Smooth { x0: vec![0.0, 1.0], f };
        let report = driver(method, 1e-8).run(&mut circle, 0.0, 10.0, &[], &mut steps).unwrap();
        assert_eq!(steps.spans.len() as u64, report.stats.accepted_steps);
        assert_eq!((steps.spans[0].0, steps.spans[steps.spans.len() - 1].1), (0.0, 10.0));
        assert!(steps.spans.windows(2).all(|pair| pair[0].1 == pair[1].0));
        for (x, (a, b)) in steps.middle.iter().zip(&steps.spans) {
            let t = 0.5 * (a + b);
            let off = (x[0] - t.sin()).hypot(x[1] - t.cos());
            assert!(off < 3e-6, "{} at {t}: {off:e}", method.name());
        }
        // Neighbouring steps meet.
        for pair in steps.ends.windows(2) {
            assert!((pair[0][1][0] - pair[1][0][0]).abs() < 1e-14, "{}", method.name());
        }
    }
    // A step that an event shortens ends at the event, with the state before it.
    for &method in ADAPTIVE {
        let mut steps = Steps::default();
        let mut ball = Ball { v_min: 0.1, resting: false };
        driver(method, 1e-8).run(&mut ball, 0.0, 0.6, &[], &mut steps).unwrap();
        let bounce = bounce_times(0.1, 1)[0];
        let cut = steps.spans.iter().enumerate().any(|(at, (_, end))| {
            (end - bounce).abs() < 1e-6 && steps.ends[at][1][1] < -4.0 && steps.ends[at + 1][0][1] > 3.0
        });
        assert!(cut, "{}", method.name());
    }
}

#[test]
fn results_are_bitwise_identical_across_threads_and_instances() {
    let methods = [ADAPTIVE, &[Method::Rk4, Method::Euler]].concat();
    for method in methods {
        let run = move || {
            let mut seen = Recorder::default();
            let mut driver = driver(method, 1e-7);
            let mut ball = Ball { v_min: 0.1, resting: false };
            let times: Vec<f64> = (0..=30).map(|k| 0.1 * f64::from(k)).collect();
            let report = driver.run(&mut ball, 0.0, 3.0, &times, &mut seen).unwrap();
            let stiff = problems::stiff::all().remove(0);
            let end = match method {
                Method::Rk4 | Method::Euler => None,
                _ => Some(stiff.run(method, 1e-6)),
            };
            let rows: Vec<Vec<u64>> =
                seen.rows.iter().map(|row| row.3.iter().map(|x| x.to_bits()).collect()).collect();
            (rows, seen.event_times(), report.stats, end.map(|(digits, stats)| (digits.to_bits(), stats)))
        };
        let here = run();
        let others: Vec<_> = (0..3).map(|_| std::thread::spawn(run)).collect();
        for other in others {
            assert_eq!(other.join().unwrap(), here, "{}", method.name());
        }
    }
}

/// A right-hand side that jumps every half second without an event.
#[test]
fn bdf_restarts_at_order_1_after_three_failures() {
    let problem = problems::Problem {
        x0: vec![1.0, 1.0],
        end: 10.0,
        f: |t, y, d| {
            let on = f64::from(u8::from(t % 1.0 < 0.5));
            d.copy_from_slice(&[-0.5 * (y[0] - on - (3.0 * t).sin()), y[0] - y[1]]);
        },
        atol: 1e-2,
        ..problems::Problem::default()
    };
    let stats = problem.end_state(problem.options(Method::Bdf, 1e-8)).unwrap().1;
    // It needs 2903 if the order is lowered by one at a time.
    assert!(stats.right_hand_sides < 2750, "{stats:?}");
}
