//! Limits of double precision: times far from zero, steps too small to resolve, and numbers that are not
//! finite.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

const ADAPTIVE: [Method; 5] = [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf];
const ALL: [Method; 7] =
    [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf, Method::Rk4, Method::Euler];

fn oscillator() -> Smooth<impl FnMut(f64, &[f64], &mut [f64])> {
    Smooth { x0: vec![1.0, 0.0], f: |_: f64, x: &[f64], dx: &mut [f64]| dx.copy_from_slice(&[x[1], -x[0]]) }
}

/// An autonomous system has the same solution for any start time. The time that rounding removes from one
/// step must be added to the next.
#[test]
fn accuracy_is_kept_at_times_far_from_zero() {
    for method in ADAPTIVE {
        let error = |start: f64| {
            let options = Options { method, relative_tolerance: 1e-9, ..Options::default() };
            let mut seen = Recorder::default();
            let mut driver = Driver::new(options).unwrap();
            driver.run(&mut oscillator(), start, start + 10.0, &[start + 10.0], &mut seen).unwrap();
            (seen.rows[0].3[0] - 10f64.cos()).abs()
        };
        let near = error(0.0);
        for start in [1e6, 1e9, -1e9] {
            let far = error(start);
            assert!(far < 2.0 * near + 1e-8, "{} from {start:e}: {far:e}, from 0: {near:e}", method.name());
        }
    }
}

#[test]
fn steps_below_rounding_are_rejected_or_enlarged() {
    for method in ADAPTIVE {
        let limits = Limits { max_steps: Some(1000), ..Limits::default() };
        for max_step in [1e-300, 1e-17, 2e-14] {
            let options = Options { method, max_step: Some(max_step), limits, ..Options::default() };
            let error =
                Driver::new(options).unwrap().run(&mut oscillator(), 1.0, 2.0, &[], &mut Ignore).unwrap_err();
            let ErrorKind::StepBelowRounding { step, least } = error.kind else { panic!("{error}") };
            assert!(step == max_step && least > 4e-14 && least < 1e-12, "{error}");
        }
        for first_step in [1e-300, 1e-17] {
            let options = Options { method, first_step: Some(first_step), limits, ..Options::default() };
            let report =
                Driver::new(options).unwrap().run(&mut oscillator(), 1.0, 2.0, &[], &mut Ignore).unwrap();
            assert!(report.stats.accepted_steps < 100, "{}: {report:?}", method.name());
        }
    }
    let options = Options { method: Method::Rk4, step_size: Some(1e-3), ..Options::default() };
    let error =
        Driver::new(options).unwrap().run(&mut oscillator(), 1e12, 1e12 + 1.0, &[], &mut Ignore).unwrap_err();
    assert!(error.to_string().starts_with("step size 0.001 is too small"), "{error}");
}

/// A solution that grows without bound ends with an error about steps, not with many steps that do not
/// advance.
#[test]
fn diverging_solution_is_an_error() {
    for method in ADAPTIVE {
        let limits = Limits { max_steps: Some(20_000), ..Limits::default() };
        let mut explosion =
            Smooth { x0: vec![1.0], f: |_: f64, x: &[f64], dx: &mut [f64]| dx[0] = x[0] * x[0] };
        let error = Driver::new(Options { method, limits, ..Options::default() })
            .unwrap()
            .run(&mut explosion, 0.0, 2.0, &[], &mut Ignore)
            .unwrap_err();
        assert!(
            matches!(error.kind, ErrorKind::StepTooSmall { .. } | ErrorKind::NoConvergence),
            "{}: {error}",
            method.name()
        );
        assert!((error.time - 1.0).abs() < 1e-4 && error.step > 1e-16, "{}: {error}", method.name());
    }
}

/// A right-hand side that is not finite at the start of a run is not reported as a problem of the step size.
#[test]
fn error_reports_start_that_cannot_be_evaluated() {
    for method in ALL {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut calls = 0;
            let mut system = Smooth {
                x0: vec![1.0, 1.0],
                f: |_: f64, _: &[f64], dx: &mut [f64]| {
                    calls += 1;
                    dx.copy_from_slice(&[1.0, bad]);
                },
            };
            let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
            let error = driver.run(&mut system, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
            assert!(matches!(error.kind, ErrorKind::DiscardedAtRestart), "{}: {error}", method.name());
            assert_eq!((error.time, calls), (0.0, 1), "{}", method.name());
        }
    }
}

#[test]
fn vanishing_absolute_tolerances_count_as_zero() {
    for method in ADAPTIVE {
        for tolerance in [f64::MIN_POSITIVE, 1e-320] {
            let mut decay = Smooth {
                x0: vec![1.0, 0.0],
                f: |_: f64, x: &[f64], dx: &mut [f64]| dx.copy_from_slice(&[-x[0], 0.0]),
            };
            let mut seen = Recorder::default();
            let absolute_tolerance = AbsoluteTolerance::Scalar(tolerance);
            Driver::new(Options { method, absolute_tolerance, ..Options::default() })
                .unwrap()
                .run(&mut decay, 0.0, 1.0, &[1.0], &mut seen)
                .unwrap_or_else(|error| panic!("{}: {error}", method.name()));
            assert!((seen.rows[0].3[0] - (-1f64).exp()).abs() < 1e-4, "{}", method.name());
            assert_eq!(seen.rows[0].3[1], 0.0);
        }
    }
}

/// Messages use exponents for very small and very large times.
#[test]
fn messages_format_numbers_with_exponents() {
    let mut driver = Driver::new(Options::default()).unwrap();
    let mut message = |start: f64, end: f64, times: &[f64]| {
        driver.run(&mut oscillator(), start, end, times, &mut Ignore).unwrap_err().to_string()
    };
    assert!(message(0.0, 1e-12, &[2e-12]).starts_with("requested time 2e-12 at position 0"));
    assert!(message(1e300, -1e-300, &[]).starts_with("cannot simulate from 1e300 to -1e-300"));
    let limits = Limits { max_steps: Some(1), ..Limits::default() };
    let options = Options { limits, first_step: Some(2.5e-13), ..Options::default() };
    let error =
        Driver::new(options).unwrap().run(&mut oscillator(), 0.0, 1e-12, &[], &mut Ignore).unwrap_err();
    assert_eq!(error.to_string(), "the limit of 1 steps was reached at t = 2.5e-13");
    let error = Driver::new(Options { relative_tolerance: 1e-30, ..Options::default() }).err().unwrap();
    assert_eq!(
        error.to_string(),
        "relative_tolerance = 1e-30 must be at least 1e-14 and below 1, or 0 if absolute tolerances are given"
    );
}

/// Either tolerance may be zero, as in SciPy and CVODE.
#[test]
fn either_tolerance_can_be_zero() {
    let (sine, cosine) = 10f64.sin_cos();
    let exact = [1e4 + cosine + 1e4 * sine, 1e4 * cosine - sine];
    let is_near = |method, rtol, atol: [f64; 2]| {
        let rotation = |_: f64, x: &[f64], dx: &mut [f64]| (dx[0], dx[1]) = (x[1], 1e4 - x[0]);
        let solve = ode::solve(rotation, 0.0..10.0, &[1e4 + 1.0, 1e4]).method(method);
        let solution = solve.relative_tolerance(rtol).absolute_tolerances(&atol).run().unwrap();
        exact.iter().zip(solution.last()).all(|(exact, x)| (exact - x).abs() < 1.0)
    };
    for method in ADAPTIVE {
        for (rtol, atol) in [(0.0, [1e-3, 1e-3]), (0.0, [1e-3, 1e-2]), (1e-7, [0.0, 1e-3])] {
            assert!(is_near(method, rtol, atol), "{method:?} with rtol = {rtol}, atol = {atol:?}");
        }
    }
    for (relative_tolerance, absolute_tolerance) in [
        (0.0, AbsoluteTolerance::FromNominals),
        (0.0, AbsoluteTolerance::Scalar(0.0)),
        (0.0, AbsoluteTolerance::PerState(vec![1.0, 0.0])),
        (1e-6, AbsoluteTolerance::Scalar(-1.0)),
        (1e-6, AbsoluteTolerance::Scalar(f64::NAN)),
    ] {
        let options = Options { relative_tolerance, absolute_tolerance, ..Options::default() };
        assert!(options.check().is_err(), "{options:?}");
    }
}

#[test]
fn error_reports_zero_state_without_absolute_tolerance() {
    let options = Options { absolute_tolerance: AbsoluteTolerance::Scalar(0.0), ..Options::default() };
    let mut system = Smooth { x0: vec![1.0, 0.0], f: |_: f64, _: &[f64], dx: &mut [f64]| dx.fill(1.0) };
    let error = Driver::new(options).unwrap().run(&mut system, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
    assert!(matches!(error.kind, ErrorKind::NoTolerance { state: 1 }), "{error}");
    assert!(error.to_string().contains("state 1 and its absolute tolerance are both 0 at t = 0"), "{error}");
}
