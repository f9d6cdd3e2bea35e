//! Runs whose end is before their start.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::Smooth;
use ode::*;

const ADAPTIVE: [Method; 5] = [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf];

/// Integrates `x'' = -x` from t = 2 back to -1, with samples (one listed twice) and dense output.
#[test]
fn backward_run_returns_to_start() {
    let times = [2.0, 1.0, 1.0, 0.0, -1.0];
    for method in ADAPTIVE {
        let solution =
            solve(|_, x, dx| dx.copy_from_slice(&[x[1], -x[0]]), 2.0..-1.0, &[2f64.cos(), -2f64.sin()])
                .method(method)
                .relative_tolerance(1e-9)
                .times(&times)
                .dense_output()
                .run()
                .unwrap();
        assert_eq!(solution.times, times);
        assert_eq!(solution.report.time, -1.0);
        let dense = solution.dense.as_ref().unwrap();
        let at = |t: f64| (t, dense.at(t).unwrap());
        let rows = times.iter().copied().zip(solution.states).chain([0.3, -0.7, 1.999].map(at));
        for (t, x) in rows {
            let error = (x[0] - t.cos()).abs().max((x[1] + t.sin()).abs());
            assert!(error < 3e-7, "{} at {t}: {error:e}", method.name());
        }
        assert!(dense.at(2.1).is_none() && dense.at(-1.1).is_none());
    }
}

/// The steps equal the steps of the time-reversed system.
#[test]
fn backward_run_equals_run_of_time_reversed_system() {
    let forward = solve(|t, x, dx| dx[0] = -(0.3 - t).sin() * x[0], 0.0..3.0, &[1.0]).run().unwrap();
    let back = solve(|t, x, dx| dx[0] = (0.3 + t).sin() * x[0], 0.0..-3.0, &[1.0]).run().unwrap();
    assert_eq!(forward.states, back.states);
    assert_eq!(forward.times, back.times.iter().map(|t| 0.0 - t).collect::<Vec<_>>());
}

/// `x = t`: backward from 2, x crosses 1 downward in the direction of the integration.
#[test]
fn event_directions_follow_the_integration() {
    for (direction, crossings) in [(Direction::Down, 1), (Direction::Up, 0), (Direction::Both, 1)] {
        let solution = solve(|_, _, dx| dx[0] = 1.0, 2.0..0.0, &[2.0])
            .event(Event::new(|_, x| x[0] - 1.0).direction(direction))
            .run()
            .unwrap();
        assert_eq!(solution.events[0].len(), crossings, "{direction:?}");
        assert!(solution.events[0].iter().all(|e| (e.0 - 1.0).abs() < 1e-9));
    }
    // A terminal event, and a change of the state before it.
    let solution = solve(|_, _, dx| dx[0] = 1.0, 2.0..0.0, &[2.0])
        .event(Event::new(|_, x| x[0] - 1.0).direction(Direction::Down).terminal(2))
        .on_event(|_, x, _| x[0] = 1.5)
        .run()
        .unwrap();
    assert_eq!(solution.report.termination, Termination::StoppedByModel);
    assert!((solution.report.time - 0.5).abs() < 1e-9, "{}", solution.report.time);
}

#[test]
fn differential_algebraic_systems_run_backward() {
    let residual = |t: f64, x: &[f64], d: &[f64], r: &mut [f64]| {
        r.copy_from_slice(&[d[0] + x[1] - t, x[1] - x[0]]);
    };
    // x = t - 1 + c e^-t
    let exact = |t: f64| t - 1.0 + (-t).exp();
    let jacobian = |_: f64, _: &[f64], _: &[f64], argument: Argument, j: &mut [f64]| match argument {
        Argument::States => j.copy_from_slice(&[0.0, -1.0, 1.0, 1.0]),
        Argument::Slopes => j[0] = 1.0,
    };
    let requested = || solve_dae(residual, 2.0..-1.0, &[exact(2.0), 0.0], &[0.0; 2]).relative_tolerance(1e-8);
    for solution in [requested().run().unwrap(), requested().residual_jacobian(jacobian).run().unwrap()] {
        let x = solution.last();
        assert!((x[0] - exact(-1.0)).abs() < 1e-5 && (x[1] - x[0]).abs() < 1e-7, "{x:?}");
    }
    let mass = solve(|t, x, dx| dx.copy_from_slice(&[t - x[1], x[1] - x[0]]), 2.0..-1.0, &[exact(2.0), 0.0])
        .mass_matrix(&[1.0, 0.0, 0.0, 0.0])
        .relative_tolerance(1e-8)
        .run()
        .unwrap();
    assert!((mass.last()[0] - exact(-1.0)).abs() < 1e-5, "{:?}", mass.last());
}

#[test]
fn backward_errors_report_system_times() {
    let run = |times: &[f64]| solve(|_, x, dx| dx[0] = -1.0 / x[0], 0.0..-1.0, &[1.0]).times(times).run();
    let error = run(&[-0.5, -0.25]).unwrap_err();
    assert!(error.to_string().contains("requested time -0.25 at position 1"), "{error}");
    // The solution of x' = sqrt(x), backward from 1, ends at t = -2.
    let error = solve(|_, x, dx| dx[0] = x[0].sqrt() + 0.1, 0.0..-9.0, &[1.0]).run().unwrap_err();
    let SolveError::Simulation(error) = error else { panic!("{error}") };
    assert!((-3.0..-1.0).contains(&error.time), "{error}");
    // A system that cannot run backward is rejected.
    let mut smooth = Smooth { x0: vec![1.0], f: |_: f64, _: &[f64], dx: &mut [f64]| dx[0] = 1.0 };
    let mut driver = Driver::new(Options::default()).unwrap();
    let error = driver.run(&mut smooth, 1.0, 0.0, &[], &mut Ignore).unwrap_err();
    assert!(matches!(error.kind, ErrorKind::Span { start: 1.0, end: 0.0 }), "{error}");
}
