//! The solution is as accurate inside steps as at their ends.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::{Recorder, Smooth};
use ode::*;

fn driver(method: Method, tolerance: f64) -> Driver {
    Driver::new(Options {
        method,
        relative_tolerance: tolerance,
        absolute_tolerance: AbsoluteTolerance::Scalar(tolerance),
        ..Options::default()
    })
    .unwrap()
}

/// The first state at the ends of steps, and at points inside them.
#[derive(Default)]
struct Points {
    ends: Vec<(f64, f64)>,
    inside: Vec<(f64, f64)>,
}

impl Observer for Points {
    fn sample(&mut self, _: &Sample<'_>) -> std::ops::ControlFlow<()> {
        std::ops::ControlFlow::Continue(())
    }
    fn needs_steps(&self) -> bool {
        true
    }
    fn step(&mut self, step: &StepView<'_>) {
        let at = |t: f64| {
            let mut x = [0.0; 2];
            step.states_at(t, &mut x);
            (t, x[0])
        };
        self.ends.push(at(step.end));
        self.inside.extend([0.06, 0.3, 0.4, 0.6, 0.87].map(|s| at(step.start + s * (step.end - step.start))));
    }
}

fn largest(points: &[(f64, f64)], exact: impl Fn(f64) -> f64) -> f64 {
    points.iter().map(|(t, x)| (x - exact(*t)).abs()).fold(0.0, f64::max)
}

/// x' = -1e4 (x - sin t) + cos t (A. Prothero, A. Robinson, Mathematics of Computation 28 (1974) 145-162): the fast
/// component follows a slow path, and the steps are long.
#[test]
fn interpolation_is_accurate_for_stiff_component_on_slow_path() {
    for method in [Method::Radau5, Method::Bdf, Method::Auto] {
        for tolerance in [1e-4, 1e-6, 1e-8, 1e-10] {
            let f = |t: f64, x: &[f64], dx: &mut [f64]| {
                dx[0] = -1e4 * (x[0] - t.sin()) + t.cos();
                dx[1] = -x[1];
            };
            let mut points = Points::default();
            let report = driver(method, tolerance)
                .run(&mut Smooth { x0: vec![0.0, 1.0], f }, 0.0, 10.0, &[], &mut points)
                .unwrap();
            let (ends, inside) = (largest(&points.ends, f64::sin), largest(&points.inside, f64::sin));
            let steps = report.stats.accepted_steps;
            assert!(
                ends <= 5.0 * tolerance && inside <= 5.0 * tolerance,
                "{} at {tolerance:e}: {ends:e} at the ends of {steps} steps, {inside:e} inside",
                method.name()
            );
        }
    }
}

/// As above, with a clock that ticks every 0.4 and changes nothing.
struct Clocked;

impl HybridSystem for Clocked {
    fn n_states(&self) -> usize {
        2
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[0.0, 1.0]);
        Ok(EventOutcome { next_time: Some(t0 + 0.4), ..EventOutcome::default() })
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[-1e4 * (x[0] - t.sin()) + t.cos(), -x[1]]);
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        Ok(EventOutcome { next_time: Some(visit.time + 0.4), ..EventOutcome::default() })
    }
}

#[test]
fn interpolation_is_accurate_with_clock_events() {
    for method in [Method::Radau5, Method::Bdf, Method::Auto] {
        for tolerance in [1e-4, 1e-6, 1e-8] {
            let mut points = Points::default();
            let stats =
                driver(method, tolerance).run(&mut Clocked, 0.0, 10.0, &[], &mut points).unwrap().stats;
            let inside = largest(&points.inside, f64::sin);
            assert!(inside <= 5.0 * tolerance, "{} at {tolerance:e}: {inside:e} inside", method.name());
            assert_eq!(stats.time_events, 25, "{}", method.name());
            assert_eq!(stats.restarts, 0, "{}", method.name());
        }
    }
}

/// 0 = z - sin t and x' = 0: only the algebraic state limits the step size.
struct Algebraic;

impl HybridSystem for Algebraic {
    fn n_states(&self) -> usize {
        2
    }
    fn mass_matrix(&self) -> Option<&[f64]> {
        Some(&[0.0, 0.0, 0.0, 1.0])
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[0.0, 1.0]);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[x[0] - t.sin(), 0.0]);
        Ok(())
    }
}

#[test]
fn interpolation_is_accurate_for_algebraic_state() {
    for tolerance in [1e-4, 1e-6, 1e-8, 1e-10] {
        let mut points = Points::default();
        driver(Method::Radau5, tolerance).run(&mut Algebraic, 0.0, 10.0, &[], &mut points).unwrap();
        let (ends, inside) = (largest(&points.ends, f64::sin), largest(&points.inside, f64::sin));
        assert!(
            ends <= tolerance && inside <= 5.0 * tolerance,
            "at {tolerance:e}: {ends:e} and {inside:e} inside"
        );
    }
}

#[test]
fn interpolation_is_accurate_for_smooth_oscillation() {
    for method in [Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf, Method::Auto] {
        for tolerance in [1e-4, 1e-6, 1e-8, 1e-10] {
            let f = |_: f64, x: &[f64], dx: &mut [f64]| dx.copy_from_slice(&[x[1], -x[0]]);
            let mut points = Points::default();
            driver(method, tolerance)
                .run(&mut Smooth { x0: vec![0.0, 1.0], f }, 0.0, 20.0, &[], &mut points)
                .unwrap();
            let (ends, inside) = (largest(&points.ends, f64::sin), largest(&points.inside, f64::sin));
            assert!(
                inside <= 1.5 * ends + tolerance,
                "{} at {tolerance:e}: {ends:e} at the ends of steps, {inside:e} inside",
                method.name()
            );
        }
    }
}

/// x' = -rate (x - u), where u is a triangle wave with kinks at integers.
struct Follower {
    rate: f64,
}

fn triangle(t: f64) -> f64 {
    1.0 - ((t / 2.0).fract() * 2.0 - 1.0).abs()
}

impl Follower {
    /// Returns the exact solution. On each slope, the state exponentially approaches the path that is `slope
    /// / rate` behind the input.
    fn exact(&self, t: f64) -> f64 {
        let (mut x, mut slope) = (0.0, 1.0);
        for kink in 0..=t as usize {
            let from = kink as f64;
            let behind = slope / self.rate;
            let off = x - triangle(from) + behind;
            let span = (t - from).min(1.0);
            x = triangle(from) + slope * span - behind + off * (-self.rate * span).exp();
            slope = -slope;
        }
        x
    }
}

impl HybridSystem for Follower {
    fn n_states(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[0] = 0.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx[0] = -self.rate * (x[0] - triangle(t));
        Ok(())
    }
    fn next_input_stop(&mut self, t: f64) -> Option<InputStop> {
        Some(InputStop { time: t.floor() + 1.0, jump: false })
    }
}

#[test]
fn interpolation_is_accurate_after_input_kink() {
    let times: Vec<f64> = (0..=4000).map(|k| f64::from(k) * 0.005).collect();
    for method in [Method::Tsit5, Method::Radau5, Method::Bdf, Method::Auto] {
        for rate in [10.0, 100.0, 1000.0] {
            for tolerance in [1e-4, 1e-6, 1e-8] {
                let mut follower = Follower { rate };
                let mut seen = Recorder::default();
                let stats =
                    driver(method, tolerance).run(&mut follower, 0.0, 20.0, &times, &mut seen).unwrap().stats;
                let points: Vec<(f64, f64)> = seen.rows.iter().map(|row| (row.0, row.3[0])).collect();
                let off = largest(&points, |t| follower.exact(t)) / tolerance;
                assert!(off <= 12.0, "{} at rate {rate}, {tolerance:e}: {off} tolerances", method.name());
                // The step after the last kink determines the size of this step.
                assert!(method != Method::Radau5 || stats.rejected_steps <= 20, "{tolerance:e}: {stats:?}");
            }
        }
    }
}
