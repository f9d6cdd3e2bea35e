//! Events that are requested in only one direction of a crossing.

#![allow(clippy::unwrap_used)]

use crate::common;

use common::*;
use ode::*;
use std::f64::consts::PI;

const ALL: [Method; 7] =
    [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf, Method::Rk4, Method::Euler];

/// (sin 2 pi t, cos 2 pi t) with the indicator `sin 2 pi t + above`.
struct Wave {
    above: f64,
    direction: Option<Direction>,
    seen: Vec<(f64, i8)>,
}

impl Wave {
    fn new(above: f64, direction: Option<Direction>) -> Self {
        Self { above, direction, seen: Vec::new() }
    }
}

impl HybridSystem for Wave {
    fn n_states(&self) -> usize {
        2
    }
    fn n_event_indicators(&self) -> usize {
        usize::from(self.direction.is_some())
    }
    fn event_direction(&self, _: usize) -> Direction {
        self.direction.unwrap_or_default()
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[(2.0 * PI * t0).sin(), (2.0 * PI * t0).cos()]);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[2.0 * PI * x[1], -2.0 * PI * x[0]]);
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = x[0] + self.above;
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        self.seen.push((visit.time, visit.crossings[0]));
        Ok(EventOutcome::default())
    }
}

fn options(method: Method, max_step: Option<f64>) -> Options {
    let step_size = Some(1e-3);
    Options { method, max_step, step_size, relative_tolerance: 1e-10, ..Options::default() }
}

#[test]
fn crossings_in_opposite_direction_are_ignored() {
    for method in ALL {
        // Euler's circle grows by 2 pi^2 h per turn. The duration of a turn is accurate to h^2.
        let bar = if method == Method::Euler { 1e-4 } else { 1e-7 };
        for (direction, sign, first) in [(Direction::Up, 1, 1.0), (Direction::Down, -1, 0.5)] {
            let mut wave = Wave::new(0.0, Some(direction));
            let report = Driver::new(options(method, None))
                .unwrap()
                .run(&mut wave, 0.0, 3.75, &[], &mut Ignore)
                .unwrap();
            // At the start, the indicator is at zero and rising. This is an event of this direction,
            // immediately after the start.
            let wanted = wave.seen.iter().filter(|(t, _)| *t > 0.1);
            let times: Vec<f64> = wanted.clone().map(|(t, _)| *t).collect();
            assert_eq!(times.len(), if sign == 1 { 3 } else { 4 }, "{}: {:?}", method.name(), wave.seen);
            for (k, t) in times.iter().enumerate() {
                assert!((t - first - k as f64).abs() < bar, "{}: {t}", method.name());
            }
            assert!(wave.seen.iter().all(|(_, crossing)| *crossing == sign));
            assert_eq!(report.stats.state_events, wave.seen.len() as u64);
        }
    }
}

#[test]
fn ignored_crossings_do_not_change_steps() {
    for method in ALL {
        let run = |direction: Option<Direction>| {
            let mut seen = Recorder::default();
            let mut wave = Wave::new(-0.5, direction);
            let mut driver = Driver::new(options(method, None)).unwrap();
            // The sine falls through 0.5 at 5/12 and does not rise through it again before the end.
            let report = driver.run(&mut wave, 0.25, 1.0, &[1.0], &mut seen).unwrap();
            (seen.rows, report.stats.accepted_steps, report.stats.right_hand_sides, report.stats.state_events)
        };
        let (rows, steps, calls, events) = run(Some(Direction::Up));
        // DOP853 needs additional evaluations for its interpolation when steps are examined. At this
        // tolerance, Auto uses DOP853.
        let extra = if matches!(method, Method::Dop853 | Method::Auto) { 3 * steps } else { 0 };
        let without = run(None);
        assert_eq!((rows, steps, events), (without.0, without.1, 0), "{}", method.name());
        assert!(calls <= without.2 + extra, "{}: {calls} for {}", method.name(), without.2);
    }
}

#[test]
fn return_inside_a_step_is_an_event() {
    // The indicator is negative only from 0.727 to 0.773, so steps of 0.1 pass over this interval.
    let (down, up) = (0.727_473_293_177_793_95, 0.772_526_706_822_206_05);
    for method in [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf] {
        for (direction, time) in [(Direction::Down, down), (Direction::Up, up)] {
            let mut wave = Wave::new(0.99, Some(direction));
            let options = Options { interior_samples: Some(9), ..options(method, Some(0.1)) };
            let mut driver = Driver::new(options).unwrap();
            driver.run(&mut wave, 0.0, 1.0, &[], &mut Ignore).unwrap();
            assert_eq!(wave.seen.len(), 1, "{}: {:?}", method.name(), wave.seen);
            // The slope of the indicator there is 0.9.
            let bar = if method == Method::Bdf { 1e-6 } else { 1e-8 };
            assert!((wave.seen[0].0 - time).abs() < bar, "{}: {:?}", method.name(), wave.seen);
        }
    }
}

/// `x' = 1` with an indicator that crosses three times within a step of RK4: upward, downward, upward.
struct Thrice(Direction);

impl HybridSystem for Thrice {
    fn n_states(&self) -> usize {
        1
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn event_direction(&self, _: usize) -> Direction {
        self.0
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[0] = t0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, _: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx[0] = 1.0;
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = (x[0] - 0.32) * (x[0] - 0.5) * (x[0] - 0.68);
        Ok(())
    }
}

#[test]
fn interior_samples_find_every_crossing_of_a_long_step() {
    for (direction, expected) in [
        (Direction::Both, vec![0.32, 0.5, 0.68]),
        (Direction::Down, vec![0.5]),
        (Direction::Up, vec![0.32, 0.68]),
    ] {
        let mut seen = Recorder::default();
        let options = Options {
            method: Method::Rk4,
            step_size: Some(1.0),
            interior_samples: Some(9),
            ..Options::default()
        };
        Driver::new(options).unwrap().run(&mut Thrice(direction), 0.0, 2.0, &[], &mut seen).unwrap();
        let times = seen.event_times();
        assert_eq!(times.len(), expected.len(), "{direction:?}: {times:?}");
        assert!(times.iter().zip(&expected).all(|(t, e)| (t - e).abs() < 1e-12), "{direction:?}: {times:?}");
    }
}
