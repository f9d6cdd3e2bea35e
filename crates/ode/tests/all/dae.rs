//! Systems `F(t, x, x') = 0`: known solutions, consistent initial values, index, and unsolvable systems.

#![allow(clippy::unwrap_used, clippy::panic)]

#[path = "../problems/dae.rs"]
mod problems;

use ode::*;
use problems::{AKZO, ALL, AMPLIFIER, Dae, ROBERTSON};

fn requested<'a>(problem: &Dae, rtol: f64) -> Solve<'a> {
    solve_dae(problem.residual, 0.0..problem.end, problem.x0, &vec![0.0; problem.x0.len()])
        .relative_tolerance(rtol)
        .absolute_tolerance(problem.atol * rtol)
        .times(&[problem.end])
}

fn solved(problem: &Dae, rtol: f64) -> (f64, Stats) {
    let solution = requested(problem, rtol).run().unwrap();
    (problem.digits(solution.last()), solution.report.stats)
}

#[test]
#[ignore = "a prints_a_table_of_decomposition_times to read"]
fn prints_a_table_of_decomposition_times() {
    for problem in &ALL {
        for k in 8..=20 {
            let (digits, s) = solved(problem, 10f64.powf(-0.5 * f64::from(k)));
            println!(
                "{:10} {:4} digits {digits:5.2} res {:5} steps {:5} rejected {:3} J {:4} LU {:4} N {:5}",
                problem.name,
                -0.5 * f64::from(k),
                s.right_hand_sides,
                s.accepted_steps,
                s.rejected_steps,
                s.jacobians,
                s.decompositions,
                s.newton_iterations
            );
        }
    }
}

/// Required digits and maximum number of residuals. At 1e-6 and 1e-8, the maximum is the number that IDA of
/// SUNDIALS 7 needs (`benches/dae.md`).
#[test]
#[cfg_attr(
    windows,
    ignore = "with the last bits of the C library of Windows, the amplifier has 2.64 digits at 1e-4"
)]
fn residual_solutions_match_test_set_digits() {
    for (problem, rtol, bar, most) in [
        (ROBERTSON, 1e-4, 3.0, 240),
        (ROBERTSON, 1e-6, 4.9, 340),
        (ROBERTSON, 1e-8, 6.8, 640),
        (AKZO, 1e-4, 3.4, 320),
        (AKZO, 1e-6, 5.3, 540),
        (AKZO, 1e-8, 7.0, 1000),
        (AMPLIFIER, 1e-4, 2.7, 12_000),
        (AMPLIFIER, 1e-6, 4.0, 19_000),
        (AMPLIFIER, 1e-8, 6.5, 40_000),
    ] {
        let (digits, stats) = solved(&problem, rtol);
        let what = format!("{} at {rtol:e}: {digits:.2} digits, {stats:?}", problem.name);
        assert!(digits > bar && stats.right_hand_sides < most, "{what}");
    }
}

/// After repeated failures of the error test, the restart finds consistent values, so the run succeeds at
/// every tolerance.
#[test]
fn amplifier_is_solved_at_every_tolerance() {
    for k in 12..36 {
        let rtol = 10f64.powf(-0.25 * f64::from(k));
        let (digits, stats) = solved(&AMPLIFIER, rtol);
        let bar = 0.25 * f64::from(k) - 2.5;
        assert!(digits > bar && stats.right_hand_sides < 40_000, "{rtol:e}: {digits:.2} {stats:?}");
    }
}

/// `x' + x - sin t = 0` and `y - x^2 = 0`, with the solution for x(0) = 1. A second version mixes equations
/// and states, so that no column of `dF/dx'` is zero.
fn linear(t: f64, x: &[f64], d: &[f64], r: &mut [f64]) {
    r[0] = d[0] + x[0] - t.sin();
    r[1] = x[1] - x[0] * x[0];
}

fn mixed(t: f64, u: &[f64], d: &[f64], r: &mut [f64]) {
    let mut e = [0.0; 2];
    linear(t, &[u[0] + u[1], u[0] - 2.0 * u[1]], &[d[0] + d[1], d[0] - 2.0 * d[1]], &mut e);
    (r[0], r[1]) = (e[0] + 3.0 * e[1], 2.0 * e[0] - e[1]);
}

fn exact(t: f64) -> f64 {
    1.5 * (-t).exp() + 0.5 * (t.sin() - t.cos())
}

#[test]
fn guesses_of_states_without_derivative_are_corrected() {
    for (y, slope) in [(1.0, -1.0), (0.0, 0.0), (-50.0, 1e3), (1e6, -1e6)] {
        let solution = solve_dae(linear, 0.0..2.0, &[1.0, y], &[slope, 0.0])
            .relative_tolerance(1e-8)
            .times(&[0.0, 1.0, 2.0])
            .run()
            .unwrap();
        assert_eq!(solution.states[0][0], 1.0);
        assert!((solution.states[0][1] - 1.0).abs() < 1e-9, "{:?}", solution.states);
        for (t, x) in solution.times.iter().zip(&solution.states) {
            assert!((x[0] - exact(*t)).abs() < 2e-7 && (x[1] - exact(*t).powi(2)).abs() < 2e-7, "{t}: {x:?}");
        }
        // x = 1, y = 1 corresponds to u = 1, v = 0.
        let other = solve_dae(mixed, 0.0..2.0, &[(2.0 + y) / 3.0, (1.0 - y) / 3.0], &[slope, 0.0])
            .relative_tolerance(1e-8)
            .times(&[0.0, 2.0])
            .run()
            .unwrap();
        let start = &other.states[0];
        assert!((start[0] - 1.0).abs() < 1e-8 && start[1].abs() < 1e-8, "{start:?} from {y}");
        assert!((other.last()[0] + other.last()[1] - exact(2.0)).abs() < 2e-7, "{:?}", other.last());
    }
}

/// A nonlinear equation determines the slopes: `x'^3 + x' = x`.
#[test]
fn residual_nonlinear_in_slopes_is_solved() {
    let residual = |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| r[0] = d[0].powi(3) + d[0] - x[0];
    // With p = x': x = p^3 + p, dx = (3 p^2 + 1) dp = p dt: t = 1.5 p^2 + ln p + c; p goes from 1 to 2.
    let end = 1.5 * 3.0 + 2f64.ln();
    for guess in [1.0, 0.0, -20.0] {
        let solution =
            solve_dae(residual, 0.0..end, &[2.0], &[guess]).relative_tolerance(1e-8).run().unwrap();
        assert!((solution.last()[0] - 10.0).abs() < 1e-5, "{:?}", solution.last());
    }
}

/// The matrix in front of the slopes depends on the states: `(1 + x^2) x' = -x`, so that `ln x + x^2 / 2 = 1 / 2 - t`.
#[test]
fn variable_matrix_of_slopes_is_supported() {
    let residual = |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| r[0] = (1.0 + x[0] * x[0]) * d[0] + x[0];
    let solution = solve_dae(residual, 0.0..5.0, &[1.0], &[0.0]).relative_tolerance(1e-8).run().unwrap();
    let x = solution.last()[0];
    assert!((x.ln() + 0.5 * x * x + 4.5).abs() < 1e-5, "{x}");
}

const G: f64 = 9.81;

/// Returns the residual of a pendulum of length 1, with the equation of the rod differentiated `2 - depth`
/// times: index 1, 2, 3.
fn pendulum(depth: u32) -> impl Fn(f64, &[f64], &[f64], &mut [f64]) {
    move |_, x, d, r| {
        let [px, py, vx, vy, force] = x else { panic!("five states") };
        r[0] = d[0] - vx;
        r[1] = d[1] - vy;
        r[2] = d[2] + px * force;
        r[3] = d[3] + py * force + G;
        r[4] = match depth {
            1 => vx * vx + vy * vy - force * (px * px + py * py) - G * py,
            2 => px * vx + py * vy,
            _ => px * px + py * py - 1.0,
        };
    }
}

#[test]
fn pendulum_of_index_1_is_solved_and_higher_index_is_reported() {
    let x0 = [1.0, 0.0, 0.0, 0.0, 7.0];
    // A quarter of the period: K(sin 45 deg) / sqrt(g), Gauss's arithmetic-geometric mean.
    let (mut a, mut b) = (1.0f64, 0.5f64.sqrt());
    for _ in 0..6 {
        (a, b) = (0.5 * (a + b), (a * b).sqrt());
    }
    let quarter = std::f64::consts::FRAC_PI_2 / a / G.sqrt();
    let solution =
        solve_dae(pendulum(1), 0.0..quarter, &x0, &[0.0; 5]).relative_tolerance(1e-9).run().unwrap();
    let end = solution.last();
    assert!(end[0].abs() < 1e-6 && (end[1] + 1.0).abs() < 1e-6, "{end:?}");
    assert!((end[4] - 3.0 * G).abs() < 1e-4 && solution.states[0][4].abs() < 1e-9, "{end:?}");
    for (depth, x0) in [(2, [1.0, 0.0, 0.0, 0.5, 0.0]), (2, x0), (3, [0.6, -0.8, 0.0, 0.0, 0.0]), (3, x0)] {
        let error = solve_dae(pendulum(depth), 0.0..1.0, &x0, &[0.0; 5]).run().unwrap_err();
        let SolveError::Simulation(error) = error else { panic!("{error}") };
        assert!(matches!(error.kind, ErrorKind::HigherIndex), "{error}");
        let undetermined = error.undetermined.as_ref().unwrap();
        assert_eq!((undetermined.equation, &undetermined.states[..]), (4, &[4][..]));
        assert!(undetermined.pivot < 1e-6, "{undetermined:?}");
        assert!(error.to_string().contains("index 2 or higher") && error.to_string().contains("states [4]"));
    }
}

#[test]
fn unsolvable_residuals_are_errors() {
    let length = solve_dae(linear, 0.0..1.0, &[1.0, 1.0], &[0.0]).run().unwrap_err();
    assert_eq!(length.to_string(), "dx0: expected 2 values, got 1");
    let tolerances = solve_dae(linear, 0.0..1.0, &[1.0, 1.0], &[0.0; 2]).absolute_tolerances(&[1e-6]).run();
    let Err(SolveError::Simulation(error)) = tolerances else { panic!("{tolerances:?}") };
    assert!(matches!(error.kind, ErrorKind::ToleranceCount { given: 1, states: 2 }), "{error}");
    let method = solve_dae(linear, 0.0..1.0, &[1.0, 1.0], &[0.0; 2]).method(Method::Radau5).run();
    let Err(SolveError::Simulation(error)) = method else { panic!("{method:?}") };
    assert!(matches!(error.kind, ErrorKind::ResidualNeedsBdf), "{error}");
    // y^2 + 1 = 0 has no solution.
    let none = |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| {
        r.copy_from_slice(&[d[0] + x[0], x[1] * x[1] + 1.0]);
    };
    let Err(SolveError::Simulation(error)) = solve_dae(none, 0.0..1.0, &[1.0, 2.0], &[0.0; 2]).run() else {
        panic!("solved")
    };
    let ErrorKind::Inconsistent { equation: 1, residual } = error.kind else { panic!("{error}") };
    assert_eq!(residual, 5.0);
    // Two identical equations.
    let twice = |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| r.fill(d[0] + x[1] - x[0]);
    let Err(SolveError::Simulation(error)) = solve_dae(twice, 0.0..1.0, &[1.0, 2.0], &[0.0; 2]).run() else {
        panic!("solved")
    };
    assert!(matches!(error.kind, ErrorKind::HigherIndex), "{error}");
}

/// `dF/dx'` is singular only at the guess. States that have a derivative at consistent values keep their
/// values.
#[test]
fn state_is_unchanged_when_its_derivative_vanishes_at_guess() {
    let product = |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| {
        r.copy_from_slice(&[x[1] * d[0] + x[0], x[1] - 2.0]);
    };
    let slopes = |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| {
        r.copy_from_slice(&[d[1] * d[0] + x[0], d[1] - 1.0]);
    };
    let halved = solve_dae(product, 0.0..1.0, &[1.0, 0.0], &[0.0; 2]).relative_tolerance(1e-8).run().unwrap();
    assert_eq!(halved.states[0], [1.0, 2.0]);
    assert!((halved.last()[0] - (-0.5f64).exp()).abs() < 1e-6, "{:?}", halved.last());
    let whole = solve_dae(slopes, 0.0..1.0, &[1.0, 0.0], &[0.0; 2]).relative_tolerance(1e-8).run().unwrap();
    assert_eq!(whole.states[0], [1.0, 0.0]);
    assert!((whole.last()[0] - (-1f64).exp()).abs() < 1e-6, "{:?}", whole.last());
    // A hundred such pairs with sparse Jacobians.
    let n = 100;
    let many = move |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| {
        for i in 0..n {
            (r[i], r[n + i]) = (x[n + i] * d[i] + x[i], x[n + i] - 2.0);
        }
    };
    let places = (0..n).flat_map(|i| [(i, i), (i, n + i), (n + i, n + i)]);
    let x0: Vec<f64> = (0..2 * n).map(|i| if i < n { 1.0 } else { 0.0 }).collect();
    let sparse = solve_dae(many, 0.0..1.0, &x0, &vec![0.0; 2 * n])
        .pattern(JacobianPattern::new(2 * n, places).unwrap())
        .relative_tolerance(1e-8)
        .run()
        .unwrap();
    assert_eq!((sparse.states[0][0], sparse.states[0][n]), (1.0, 2.0));
    assert!((sparse.last()[0] - (-0.5f64).exp()).abs() < 1e-6, "{:?}", sparse.last()[0]);
}

/// With zero slopes as a guess, `dF/dx'` is zero. No state is changed, and the message contains the residual
/// of the given values.
#[test]
fn singular_jacobian_of_slopes_is_an_error() {
    type Scalar = fn(f64, f64) -> f64;
    let cases: [(Scalar, f64, f64); 4] = [
        (|x, d| d.powi(3) + x - 1.0, 0.0, 1.0),
        (|x, d| d.powi(3) - x, 1.0, 1.0),
        (|x, d| d * d - x, 1.0, 1.0),
        (|x, d| d * d.abs() - x, 1.0, 1.0),
    ];
    for (f, x0, slope) in cases {
        let residual = |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| r[0] = f(x[0], d[0]);
        let failed = solve_dae(residual, 0.0..1.0, &[x0], &[0.0]).run();
        let Err(SolveError::Simulation(error)) = failed else { panic!("{failed:?}") };
        let ErrorKind::InconsistentSlopes { equation: 0, residual: left, is_singular: true } = error.kind
        else {
            panic!("{error}")
        };
        assert_eq!(left, f(x0, 0.0));
        let solution = solve_dae(residual, 0.0..1.0, &[x0], &[slope]).run().unwrap();
        assert_eq!(solution.states[0], [x0]);
    }
    // With the correct slope as a guess: y' = y^(1/3), y = (1 + 2 t / 3)^(3/2).
    let cube = |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| r[0] = d[0].powi(3) - x[0];
    let solution = solve_dae(cube, 0.0..1.0, &[1.0], &[1.0]).relative_tolerance(1e-8).run().unwrap();
    assert!((solution.last()[0] - (5f64 / 3.0).powf(1.5)).abs() < 1e-5);
    // d^2 + 1 = 0 has no solution.
    let none = |_: f64, _: &[f64], d: &[f64], r: &mut [f64]| r[0] = d[0] * d[0] + 1.0;
    let failed = solve_dae(none, 0.0..1.0, &[1.0], &[1.0]).run();
    let Err(SolveError::Simulation(error)) = failed else { panic!("{failed:?}") };
    let ErrorKind::InconsistentSlopes { residual: 2.0, is_singular: false, .. } = error.kind else {
        panic!("{error}")
    };
}

/// Many copies of `x' = u`, `u' = l - x` with an equation without `l` that determines `u` (index 2) or `x`
/// (index 3).
fn bound(n: usize, index: usize, start: f64, exclude: bool) -> Result<Solution, SolveError> {
    let residual = move |t: f64, x: &[f64], d: &[f64], r: &mut [f64]| {
        for i in 0..n {
            r[i] = d[i] - x[n + i];
            r[n + i] = d[n + i] - x[2 * n + i] + x[i];
            r[2 * n + i] = if index == 2 { x[n + i] - t.cos() } else { x[i] - t.sin() };
        }
    };
    let decided = if index == 2 { n } else { 0 };
    let places = (0..n).flat_map(|i| {
        let of_states = [(i, i), (i, n + i), (n + i, i), (n + i, n + i), (n + i, 2 * n + i)];
        of_states.into_iter().chain([(2 * n + i, decided + i)])
    });
    let x0: Vec<f64> = (0..3 * n).map(|i| if i / n == 1 { start } else { 0.0 }).collect();
    solve_dae(residual, 0.0..1.0, &x0, &vec![0.0; 3 * n])
        .pattern(JacobianPattern::new(3 * n, places).unwrap())
        .options(|o| o.exclude_algebraic = exclude)
        .run()
}

#[test]
fn higher_index_is_reported_for_sparse_matrices() {
    for (index, start, exclude) in [(2, 1.0, false), (2, 1.0, true), (2, 5.0, true), (3, 1.0, false)] {
        let Err(SolveError::Simulation(error)) = bound(40, index, start, exclude) else { panic!("solved") };
        let undetermined = error.undetermined.as_ref().unwrap_or_else(|| panic!("{error}"));
        assert!(undetermined.states.iter().all(|k| (80..120).contains(k)), "{error}");
        assert!(error.to_string().contains("index 2 or higher"), "{error}");
    }
    // The system is too large to be treated as dense. States that violate an equation are still an error.
    let Err(SolveError::Simulation(error)) = bound(200, 2, 5.0, true) else { panic!("solved") };
    assert!(matches!(error.kind, ErrorKind::Inconsistent { equation: 400, residual: 4.0 }), "{error}");
}

/// Consistent values are found for a sparse system with equations and states mixed in pairs, so that no
/// column of `dF/dx'` is zero.
#[test]
fn mixed_states_of_sparse_systems_are_corrected() {
    let n = 60;
    let residual = move |t: f64, x: &[f64], d: &[f64], r: &mut [f64]| {
        for ((x, d), r) in x.chunks(2).zip(d.chunks(2)).zip(r.chunks_mut(2)) {
            mixed(t, x, d, r);
        }
    };
    let places = (0..n).flat_map(|i| [0, 1, 2, 3].map(|k| (2 * i + k / 2, 2 * i + k % 2)));
    let x0: Vec<f64> = (0..2 * n).map(|i| if i % 2 == 0 { 7.0 / 3.0 } else { -4.0 / 3.0 }).collect();
    let solution = solve_dae(residual, 0.0..2.0, &x0, &vec![0.0; 2 * n])
        .pattern(JacobianPattern::new(2 * n, places).unwrap())
        .relative_tolerance(1e-8)
        .run()
        .unwrap();
    let (start, end) = (&solution.states[0], solution.last());
    assert!((start[0] - 1.0).abs() < 1e-8 && start[1].abs() < 1e-8, "{:?}", &start[..2]);
    assert!((end[2 * n - 2] + end[2 * n - 1] - exact(2.0)).abs() < 2e-7, "{:?}", &end[..2]);
}

/// If the residual is NaN, smaller steps are tried, up to the time at which it becomes NaN.
#[test]
fn nan_residual_ends_run_at_its_time() {
    let root = |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| r[0] = d[0] + 1.0 - 0.0 * x[0].sqrt();
    let Err(SolveError::Simulation(error)) = solve_dae(root, 0.0..3.0, &[2.0], &[-1.0]).run() else {
        panic!("solved")
    };
    assert!(matches!(error.kind, ErrorKind::StepTooSmall { discarded: true }), "{error}");
    assert!((error.time - 2.0).abs() < 1e-2, "{error}");
    let at_start = solve_dae(root, 0.0..3.0, &[-2.0], &[-1.0]).run();
    let Err(SolveError::Simulation(error)) = at_start else { panic!("solved") };
    assert!(matches!(error.kind, ErrorKind::DiscardedAtRestart), "{error}");
}

#[test]
#[should_panic(expected = "of the user")]
fn panic_in_residual_propagates() {
    let _ = solve_dae(|_, _, _, _| panic!("of the user"), 0.0..1.0, &[1.0], &[0.0]).run();
}

/// Jacobians of the user, a pattern, and differences give the same solution. The first two need fewer
/// residuals.
#[test]
fn user_jacobians_give_the_same_solution() {
    let plain = solved(&AKZO, 1e-6);
    let pattern = JacobianPattern::new(6, (0..6).flat_map(|i| (0..6).map(move |k| (i, k)))).unwrap();
    let whole = requested(&AKZO, 1e-6).pattern(pattern).run().unwrap();
    assert_eq!(AKZO.digits(whole.last()), plain.0);
    let jacobian = |_: f64, y: &[f64], _: &[f64], argument: Argument, j: &mut [f64]| match argument {
        Argument::Slopes => (j[0], j[4]) = (1.0, 1.0),
        Argument::States => {
            let (b, c) = (1e4, 6e7 * y[1]);
            j.copy_from_slice(&[0.04, -0.04, 1.0, -b * y[2], b * y[2] + c, 1.0, -b * y[1], b * y[1], 1.0]);
        }
    };
    let with_jacobian = requested(&ROBERTSON, 1e-6).residual_jacobian(jacobian).run().unwrap();
    let differences = solved(&ROBERTSON, 1e-6);
    assert!(ROBERTSON.digits(with_jacobian.last()) > 4.9);
    assert!(with_jacobian.report.stats.right_hand_sides + 10 < differences.1.right_hand_sides);
}

/// A chain of masses on springs with sparse Jacobians, and its forces as algebraic states.
#[test]
fn large_sparse_dae_is_solved() {
    let n = 100;
    let residual = move |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| {
        for i in 0..n {
            let left = if i > 0 { x[i - 1] } else { 0.0 };
            let right = if i + 1 < n { x[i + 1] } else { 0.0 };
            r[i] = d[i] - x[n + i];
            r[n + i] = x[n + i] - (left - 2.0 * x[i] + right);
        }
    };
    let places = (0..n).flat_map(|i| {
        let near = (i.saturating_sub(1)..(i + 2).min(n)).map(move |k| (n + i, k));
        near.chain([(i, i), (i, n + i), (n + i, n + i)])
    });
    let k = std::f64::consts::PI / 101.0;
    let mode = |i: usize| (k * (i + 1) as f64).sin();
    let decay = 2.0 * (k.cos() - 1.0);
    let pattern = JacobianPattern::new(2 * n, places).unwrap();
    // With consistent forces, and with guessed forces.
    for guess in [decay, 7.0] {
        let x0: Vec<f64> = (0..n).map(mode).chain((0..n).map(|i| guess * mode(i))).collect();
        let solution = solve_dae(residual, 0.0..100.0, &x0, &vec![0.0; 2 * n])
            .pattern(pattern.clone())
            .relative_tolerance(1e-6)
            .run()
            .unwrap();
        let share = (100.0 * decay).exp();
        assert!((solution.states[0][n + 50] - decay * mode(50)).abs() < 1e-9);
        assert!((solution.last()[50] - share * mode(50)).abs() < 1e-5, "{}", solution.last()[50]);
        assert!(solution.report.stats.right_hand_sides < 300, "{:?}", solution.report.stats);
    }
}

/// Excluding algebraic states from the error test reduces the number of steps, and the differential states
/// keep their digits.
#[test]
fn algebraic_states_can_be_excluded_from_error_test() {
    let plain = solved(&AKZO, 1e-6);
    let without = requested(&AKZO, 1e-6).options(|o| o.exclude_algebraic = true).run().unwrap();
    assert!(AKZO.digits(without.last()) > 5.0);
    assert!(without.report.stats.accepted_steps != plain.1.accepted_steps);
}

/// Events at y = 0.25 (x = 0.5) reset the state to 1 twice. The third event ends the run.
#[test]
fn events_restart_with_consistent_states() {
    let decay = |_: f64, x: &[f64], d: &[f64], r: &mut [f64]| {
        r[0] = d[0] + x[0];
        r[1] = x[1] - x[0] * x[0];
    };
    let solution = solve_dae(decay, 0.0..10.0, &[1.0, 1.0], &[-1.0, 0.0])
        .relative_tolerance(1e-9)
        .event(Event::new(|_, x| x[1] - 0.25).direction(Direction::Down).terminal(3))
        .on_event(|_, x, which| {
            assert_eq!(which, [0]);
            x[0] = 1.0;
        })
        .dense_output()
        .run()
        .unwrap();
    let times: Vec<f64> = solution.events[0].iter().map(|e| e.0).collect();
    for (k, t) in times.iter().enumerate() {
        assert!((t - 2f64.ln() * (k + 1) as f64).abs() < 1e-7, "{times:?}");
    }
    assert_eq!((times.len(), solution.report.termination), (3, Termination::StoppedByModel));
    let dense = solution.dense.unwrap();
    for t in [0.3, 1.0, 1.9] {
        let x = dense.at(t).unwrap();
        let expected = (-(t % 2f64.ln())).exp();
        assert!((x[0] - expected).abs() < 1e-7 && (x[1] - expected * expected).abs() < 1e-7, "{t}: {x:?}");
    }
    assert_eq!(dense.at(5.0), None);
    // The values after the event are consistent.
    let mut after = solution.states.iter().filter(|x| x[0] == 1.0).collect::<Vec<_>>();
    // At the last event, the run ends before the states are made consistent.
    assert_eq!(after.pop(), Some(&vec![1.0, solution.events[0][2].1[1]]));
    assert!(after.len() == 3 && after.iter().all(|x| (x[1] - 1.0).abs() < 1e-8), "{after:?}");
}
