//! Correct digits on smooth problems. Each problem lists its reference values, computed in quadruple
//! precision.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

/// Returns the smallest number of correct digits of all components at the end, and the number of right-hand
/// sides.
fn digits(
    f: impl FnMut(f64, &[f64], &mut [f64]),
    x0: &[f64],
    end: f64,
    reference: &[f64],
    rtol: f64,
) -> (f64, u64) {
    let mut seen = Recorder::default();
    let options = Options {
        relative_tolerance: rtol,
        absolute_tolerance: AbsoluteTolerance::Scalar(rtol * 1e-2),
        ..Options::default()
    };
    let mut system = Smooth { x0: x0.to_vec(), f };
    let report = Driver::new(options).unwrap().run(&mut system, 0.0, end, &[end], &mut seen).unwrap();
    let worst = reference.iter().zip(&seen.rows[0].3).map(|(r, x)| ((x - r) / r).abs()).fold(0.0, f64::max);
    (-worst.log10(), report.stats.right_hand_sides)
}

fn van_der_pol(_: f64, x: &[f64], dx: &mut [f64]) {
    dx[0] = x[1];
    dx[1] = (1.0 - x[0] * x[0]) * x[1] - x[0];
}

fn brusselator(_: f64, x: &[f64], dx: &mut [f64]) {
    dx[0] = 1.0 + x[0] * x[0] * x[1] - 4.0 * x[0];
    dx[1] = 3.0 * x[0] - x[0] * x[0] * x[1];
}

const VAN_DER_POL: [f64; 2] = [2.008_149_762_174_948_592, -0.042_508_875_273_202_146_99];
const BRUSSELATOR: [f64; 2] = [0.498_637_071_268_347_848_6, 4.596_780_349_452_011_183];

#[test]
fn tsit5_reaches_required_digits_on_smooth_problems() {
    let (d, _) = digits(van_der_pol, &[2.0, 0.0], 20.0, &VAN_DER_POL, 1e-6);
    assert!(d > 3.3, "Van der Pol at 1e-6: {d}");
    let (d, _) = digits(van_der_pol, &[2.0, 0.0], 20.0, &VAN_DER_POL, 1e-10);
    assert!(d > 7.5, "Van der Pol at 1e-10: {d}");
    let (d, _) = digits(brusselator, &[1.5, 3.0], 20.0, &BRUSSELATOR, 1e-6);
    assert!(d > 5.0, "Brusselator at 1e-6: {d}");
    let (d, _) = digits(brusselator, &[1.5, 3.0], 20.0, &BRUSSELATOR, 1e-10);
    assert!(d > 9.0, "Brusselator at 1e-10: {d}");
}

#[test]
fn error_decreases_with_tolerance() {
    let points: Vec<(f64, f64)> = (4..=10)
        .map(|k| {
            let rtol = 10f64.powi(-k);
            (f64::from(-k), -digits(van_der_pol, &[2.0, 0.0], 20.0, &VAN_DER_POL, rtol).0)
        })
        .collect();
    let n = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let slope = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>()
        / points.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>();
    assert!(slope > 0.5, "slope {slope}: {points:?}");
    for p in &points {
        assert!(p.1 - (my + slope * (p.0 - mx)) < 1.0, "{p:?} of {points:?}");
    }
}

/// x'' = -x from (1, 0). The errors at samples between steps must be similar to the errors at the ends of
/// steps.
#[test]
fn samples_between_steps_are_as_accurate_as_steps() {
    let times: Vec<f64> = (0..=2000).map(|k| f64::from(k) * 0.01).collect();
    let mut seen = Recorder::default();
    let mut system = Smooth {
        x0: vec![1.0, 0.0],
        f: |_: f64, x: &[f64], dx: &mut [f64]| {
            dx[0] = x[1];
            dx[1] = -x[0];
        },
    };
    let options = Options { relative_tolerance: 1e-8, ..Options::default() };
    Driver::new(options).unwrap().run(&mut system, 0.0, 20.0, &times, &mut seen).unwrap();
    let worst = seen.rows.iter().map(|r| (r.3[0] - r.0.cos()).abs()).fold(0.0, f64::max);
    assert!(worst < 5e-7, "{worst:e}");
}

#[test]
fn fixed_step_methods_converge_with_their_order() {
    let error = |method: Method, step: f64| {
        let mut seen = Recorder::default();
        let options = Options { method, step_size: Some(step), ..Options::default() };
        let mut system = Smooth { x0: vec![1.0], f: |_: f64, x: &[f64], dx: &mut [f64]| dx[0] = -x[0] };
        let report = Driver::new(options).unwrap().run(&mut system, 0.0, 1.0, &[1.0], &mut seen).unwrap();
        assert_eq!(report.stats.accepted_steps as f64, (1.0 / step).round());
        (seen.rows[0].3[0] - (-1f64).exp()).abs()
    };
    for (method, order) in [(Method::Euler, 1.0), (Method::Rk4, 4.0)] {
        let ratio = error(method, 0.02) / error(method, 0.01);
        assert!((ratio.log2() - order).abs() < 0.1, "{}: {ratio}", method.name());
    }
}

/// Steps shortened by an input are also halved. Euler's method multiplies by 1 + h in each step.
#[test]
fn halve_steps_splits_every_step() {
    let stops: Vec<f64> = (1..20).map(|k| 0.05 * f64::from(k)).collect();
    let run = |step: f64, halve_steps: bool, stops: &[f64]| {
        let mut seen = Recorder::default();
        let step_size = Some(step);
        let options = Options { method: Method::Euler, step_size, halve_steps, ..Options::default() };
        let mut system = Stopped { stops: stops.to_vec() };
        let report = Driver::new(options).unwrap().run(&mut system, 0.0, 1.0, &[1.0], &mut seen).unwrap();
        (report.stats.accepted_steps, seen.rows.last().unwrap().3[0])
    };
    for (step, given, n) in [(0.4, &stops[..], 20), (0.05, &stops[..], 20), (0.25, &[][..], 4), (0.4, &[], 3)]
    {
        let ((whole, _), (halves, x)) = (run(step, false, given), run(step, true, given));
        assert_eq!((whole, halves), (n, 2 * n), "step {step}");
        let expected = match (n, given.is_empty()) {
            (3, _) => 1.2f64.powi(4) * 1.1f64.powi(2),
            _ => (1.0 + 0.5 / n as f64).powi(2 * n as i32),
        };
        assert!((x - expected).abs() < 1e-12, "step {step}: {x} instead of {expected}");
    }
}

/// x' = x with an input that has kinks.
struct Stopped {
    stops: Vec<f64>,
}

impl HybridSystem for Stopped {
    fn n_states(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[0] = 1.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx[0] = x[0];
        Ok(())
    }
    fn next_input_stop(&mut self, t: f64) -> Option<InputStop> {
        let time = *self.stops.iter().find(|stop| **stop > t + 1e-12)?;
        Some(InputStop { time, jump: false })
    }
}

/// An angle that grows without bound. A tolerance relative to its size would allow its error to grow, and the
/// error does grow.
#[test]
fn error_of_unbounded_states_is_independent_of_their_size() {
    struct Rotor {
        unbounded: bool,
    }
    impl HybridSystem for Rotor {
        fn n_states(&self) -> usize {
            2
        }
        fn is_unbounded(&self, state: usize) -> bool {
            self.unbounded && state == 0
        }
        fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
            x.copy_from_slice(&[0.0, 1.0]);
            Ok(EventOutcome::default())
        }
        /// angle = 1000 t + sin(7 t) / 7
        fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
            dx.copy_from_slice(&[1000.0 + (7.0 * t).cos(), -x[1]]);
            Ok(())
        }
    }
    for method in [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf] {
        let error = |unbounded| {
            let mut seen = Recorder::default();
            let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
            driver.run(&mut Rotor { unbounded }, 0.0, 20.0, &[20.0], &mut seen).unwrap();
            (seen.rows[0].3[0] - 20_000.0 - (140f64).sin() / 7.0).abs()
        };
        let (free, bound) = (error(true), error(false));
        assert!(free < 2e-5, "{}: {free:e} with absolute tolerance alone", method.name());
        assert!(bound > 1e-4, "{}: {bound:e} measured against the size", method.name());
    }
}
