//! A warm driver allocates no memory: not per step, not per event, not per run.

#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use ode::{Driver, *};
use std::ops::ControlFlow;

struct Sum(f64);

impl Observer for Sum {
    fn sample(&mut self, s: &Sample<'_>) -> ControlFlow<()> {
        self.0 += s.states[0];
        ControlFlow::Continue(())
    }
}

#[test]
fn warm_driver_does_not_allocate() {
    let times: Vec<f64> = (0..=400).map(|k| f64::from(k) * 0.01).collect();
    for method in
        [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf, Method::Rk4, Method::Euler]
    {
        let options = Options { method, record_events: true, ..Options::default() };
        let mut driver = Driver::new(options).unwrap();
        let mut ball = Ball { v_min: 0.1, resting: false };
        driver.run(&mut ball, 0.0, 4.0, &times, &mut Sum(0.0)).unwrap();
        let counted = allocation_counter::measure(|| {
            let report = driver.run(&mut ball, 0.0, 4.0, &times, &mut Sum(0.0)).unwrap();
            assert!(report.stats.accepted_steps > 10 && report.stats.events > 5);
        });
        assert_eq!(counted.count_total, 0, "{}: {counted:?}", method.name());
    }
}

/// `x' = -y`, `0 = y - k x` from a guess of y. Every second, k changes, and y changes with it.
struct Valve {
    /// Mass matrix; `None` if a residual defines the system.
    mass: Option<[f64; 4]>,
    k: f64,
    corrections: u32,
}

impl HybridSystem for Valve {
    fn n_states(&self) -> usize {
        2
    }
    fn mass_matrix(&self) -> Option<&[f64]> {
        self.mass.as_ref().map(|mass| &mass[..])
    }
    fn has_residual(&self) -> bool {
        self.mass.is_none()
    }
    fn residual(&mut self, _: f64, x: &[f64], dx: &[f64], r: &mut [f64]) -> CallResult<()> {
        r.copy_from_slice(&[dx[0] + x[1], x[1] - self.k * x[0]]);
        Ok(())
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        self.k = 1.0;
        x.copy_from_slice(&[1.0, 7.0]);
        Ok(EventOutcome { next_time: Some(t0 + 1.0), ..EventOutcome::default() })
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[-x[1], x[1] - self.k * x[0]]);
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        self.k = 3.0 - self.k;
        Ok(EventOutcome { next_time: Some(visit.time + 1.0), ..EventOutcome::default() })
    }
    fn states_corrected(&mut self, _: f64, x: &[f64]) -> CallResult<()> {
        self.corrections += 1;
        assert!((x[1] - self.k * x[0]).abs() < 1e-9, "{x:?}");
        Ok(())
    }
}

#[test]
fn algebraic_correction_does_not_allocate() {
    for (method, has_residual) in [(Method::Radau5, false), (Method::Bdf, false), (Method::Bdf, true)] {
        let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
        let mass = (!has_residual).then_some([1.0, 0.0, 0.0, 0.0]);
        let mut valve = Valve { mass, k: 1.0, corrections: 0 };
        driver.run(&mut valve, 0.0, 5.5, &[], &mut Sum(0.0)).unwrap();
        assert_eq!(valve.corrections, 6);
        let counted = allocation_counter::measure(|| {
            driver.run(&mut valve, 0.0, 5.5, &[], &mut Sum(0.0)).unwrap();
        });
        assert_eq!((counted.count_total, valve.corrections), (0, 12), "{} {counted:?}", method.name());
    }
}

/// Heat in a rod of 150 cells with a known pattern, so decompositions are sparse.
struct Rod(JacobianPattern);

impl HybridSystem for Rod {
    fn n_states(&self) -> usize {
        self.0.n_states()
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        let cells = x.len() as f64;
        x.iter_mut().enumerate().for_each(|(i, x)| *x = (i as f64 / cells).powi(2));
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        for (i, dx) in dx.iter_mut().enumerate() {
            let at = |i: usize| x.get(i).copied().unwrap_or(0.0);
            *dx = 2e4 * (at(i.wrapping_sub(1)) + at(i + 1) - 2.0 * x[i]);
        }
        Ok(())
    }
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        Some(&self.0)
    }
}

/// The library for sparse matrices allocates 37 times per decomposition and once per solution, and frees
/// everything. Steps and right-hand sides allocate nothing.
#[test]
#[cfg_attr(not(feature = "sparse"), ignore = "requires the feature sparse")]
fn sparse_run_allocates_only_in_decompositions_and_solutions() {
    let n = 150;
    let places = (0..n).flat_map(|i| (i.max(1) - 1..(i + 2).min(n)).map(move |k| (i, k)));
    let mut rod = Rod(JacobianPattern::new(n, places).unwrap());
    for method in [Method::Radau5, Method::Bdf] {
        let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
        let mut run = |end| {
            let mut stats = Stats::default();
            let counted = allocation_counter::measure(|| {
                stats = driver.run(&mut rod, 0.0, end, &[end], &mut Sum(0.0)).unwrap().stats;
            });
            (counted, stats)
        };
        run(0.1);
        for end in [0.1, 1.0, 10.0] {
            let (counted, stats) = run(end);
            assert_eq!(counted.count_current, 0, "{}: {counted:?}", method.name());
            let steps = stats.accepted_steps + stats.rejected_steps;
            let solutions = match method {
                // Two per iteration, and one or two for the error of a step.
                Method::Radau5 => 2 * stats.newton_iterations + 2 * steps,
                _ => stats.newton_iterations,
            };
            assert!(stats.decompositions > 20 && stats.right_hand_sides > stats.newton_iterations);
            let most = 40 * stats.decompositions + solutions;
            assert!((1..=most).contains(&counted.count_total), "{}: {counted:?} {stats:?}", method.name());
        }
    }
}
