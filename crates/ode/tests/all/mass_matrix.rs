//! Systems `M x' = f(t, x)` with a constant, singular `M` (index 1).

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

/// A mass matrix by columns, and a right-hand side from a function.
struct Dae<F> {
    x0: Vec<f64>,
    mass: Vec<f64>,
    f: F,
}

impl<F: FnMut(f64, &[f64], &mut [f64])> HybridSystem for Dae<F> {
    fn n_states(&self) -> usize {
        self.x0.len()
    }
    fn mass_matrix(&self) -> Option<&[f64]> {
        Some(&self.mass)
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&self.x0);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        (self.f)(t, x, dx);
        Ok(())
    }
}

fn solve<F: FnMut(f64, &[f64], &mut [f64])>(
    method: Method,
    rtol: f64,
    dae: &mut Dae<F>,
    end: f64,
) -> Vec<f64> {
    let mut seen = Recorder::default();
    let options = Options { method, relative_tolerance: rtol, ..Options::default() };
    Driver::new(options).unwrap().run(dae, 0.0, end, &[end], &mut seen).unwrap();
    seen.rows[0].3.clone()
}

/// Robertson's reaction with the last equation replaced by conservation. The solution does not change.
#[test]
fn robertson_with_conservation_matches_robertson() {
    let exact = [7.158270687194050905e-1, 9.185534764557763904e-6, 2.841637457458303518e-1];
    for (method, factor) in [(Method::Radau5, 1.0), (Method::Auto, 1.0), (Method::Bdf, 10.0)] {
        for (rtol, bar) in [(1e-4, 1e-4), (1e-6, 1e-6), (1e-9, 1e-8)] {
            let bar = factor * bar;
            let mut dae = Dae {
                x0: vec![1.0, 0.0, 0.0],
                mass: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
                f: |_: f64, y: &[f64], d: &mut [f64]| {
                    let (a, b, c) = (0.04 * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] * y[1]);
                    d.copy_from_slice(&[-a + b, a - b - c, y[0] + y[1] + y[2] - 1.0]);
                },
            };
            let x = solve(method, rtol, &mut dae, 40.0);
            for (x, e) in x.iter().zip(exact) {
                assert!(((x - e) / e).abs() < bar, "{} at {rtol:e}: {x} instead of {e}", method.name());
            }
        }
    }
}

/// The chemical Akzo Nobel problem of the IVP test set (F. Mazzia, C. Magherini, Test Set for Initial Value
/// Problem Solvers, 2008, II-1), in which an equilibrium determines the last concentration. The values at t =
/// 180 come from the test set.
#[test]
fn akzo_nobel_is_accurate_from_any_guess() {
    let exact = [
        1.150_794_920_661_702e-1,
        1.203_831_471_567_715e-3,
        1.611_562_887_407_974e-1,
        3.656_156_421_249_283e-4,
        1.708_010_885_264_404e-2,
        4.873_531_310_307_455e-3,
    ];
    let equilibrium = 115.83 * 0.444 * 0.007;
    for guess in [equilibrium, 0.0, 1e3, -5.0] {
        for (rtol, digits) in [(1e-4, 5.5), (1e-6, 6.5), (1e-8, 8.5), (1e-10, 10.5)] {
            let mut mass = vec![0.0; 36];
            (0..5).for_each(|i| mass[7 * i] = 1.0);
            let mut dae = Dae {
                x0: vec![0.444, 0.00123, 0.0, 0.007, 0.0, guess],
                mass,
                f: |_: f64, y: &[f64], d: &mut [f64]| {
                    let r = [
                        18.7 * y[0].powi(4) * y[1].sqrt(),
                        0.58 * y[2] * y[3],
                        0.58 / 34.4 * y[0] * y[4],
                        0.09 * y[0] * y[3] * y[3],
                        0.42 * y[5] * y[5] * y[1].sqrt(),
                    ];
                    let inflow = 3.3 * (0.9 / 737.0 - y[1]);
                    d.copy_from_slice(&[
                        -2.0 * r[0] + r[1] - r[2] - r[3],
                        -0.5 * r[0] - r[3] - 0.5 * r[4] + inflow,
                        r[0] - r[1] + r[2],
                        -r[1] + r[2] - 2.0 * r[3],
                        r[1] - r[2] + r[4],
                        115.83 * y[0] * y[3] - y[5],
                    ]);
                },
            };
            let mut seen = Recorder::default();
            let options = Options {
                method: Method::Radau5,
                relative_tolerance: rtol,
                absolute_tolerance: AbsoluteTolerance::Scalar(1e-4 * rtol),
                ..Options::default()
            };
            Driver::new(options).unwrap().run(&mut dae, 0.0, 180.0, &[0.0, 180.0], &mut seen).unwrap();
            assert!((seen.rows[0].3[5] - equilibrium).abs() < 1e-9, "{guess}: {:?}", seen.rows[0]);
            let found = exact.iter().zip(&seen.rows[1].3).map(|(e, x)| (x / e - 1.0).abs());
            let found = -found.fold(0.0, f64::max).log10();
            assert!(found > digits, "from {guess} at {rtol:e}: {found:.2} digits");
        }
    }
}

/// x' = z with 0 = x^2 + z^2 - 1 on the branch z > 0 from x = 0: sin and cos. A second version mixes the
/// equations, so that the matrix is singular but has no zero row.
#[test]
fn algebraic_states_are_solved_with_mixed_equations() {
    let plain =
        |_: f64, x: &[f64], d: &mut [f64]| d.copy_from_slice(&[x[1], x[0] * x[0] + x[1] * x[1] - 1.0]);
    let mut dae = Dae { x0: vec![0.0, 1.0], mass: vec![1.0, 0.0, 0.0, 0.0], f: plain };
    let mixed = |t: f64, x: &[f64], d: &mut [f64]| {
        let mut e = [0.0; 2];
        plain(t, x, &mut e);
        d.copy_from_slice(&[2.0 * e[0] + e[1], e[0] - e[1]]);
    };
    let mut other = Dae { x0: vec![0.0, 1.0], mass: vec![2.0, 1.0, 0.0, 0.0], f: mixed };
    for (method, rtol) in
        [(Method::Radau5, 1e-5), (Method::Radau5, 1e-8), (Method::Bdf, 1e-5), (Method::Bdf, 1e-8)]
    {
        for x in [solve(method, rtol, &mut dae, 1.2), solve(method, rtol, &mut other, 1.2)] {
            let bar = if method == Method::Bdf { 50.0 * rtol } else { 10.0 * rtol };
            assert!(
                (x[0] - 1.2f64.sin()).abs() < bar && (x[1] - 1.2f64.cos()).abs() < bar,
                "{} {x:?}",
                method.name()
            );
        }
    }
}

#[test]
fn regular_mass_matrix_scales_right_hand_side() {
    let mut dae = Dae {
        x0: vec![1.0, 1.0],
        mass: vec![2.0, 0.0, 0.0, 0.5],
        f: |_: f64, x: &[f64], d: &mut [f64]| d.copy_from_slice(&[-2.0 * x[0], -x[1]]),
    };
    for method in [Method::Radau5, Method::Bdf] {
        let x = solve(method, 1e-8, &mut dae, 1.0);
        assert!((x[0] - (-1f64).exp()).abs() < 1e-7 && (x[1] - (-2f64).exp()).abs() < 1e-7, "{x:?}");
    }
}

#[test]
fn rejects_unsupported_mass_matrices() {
    let mut dae = Dae { x0: vec![1.0], mass: vec![2.0], f: |_: f64, x: &[f64], d: &mut [f64]| d[0] = -x[0] };
    for method in [Method::Tsit5, Method::Dop853, Method::Rk4, Method::Euler] {
        let options = Options { method, ..Options::default() };
        let error = Driver::new(options).unwrap().run(&mut dae, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::MassMatrixNeedsImplicit), "{error}");
    }
    for mass in [vec![1.0, 0.0], vec![], vec![f64::NAN]] {
        dae.mass = mass;
        let error =
            Driver::new(Options::default()).unwrap().run(&mut dae, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::MassMatrix { states: 1, .. }), "{error}");
    }
}

/// States that are determined by the equations without derivatives may be given as guesses.
#[test]
fn algebraic_guess_is_corrected_at_start() {
    struct WithCorrections<F> {
        dae: Dae<F>,
        corrections: Vec<(f64, Vec<f64>)>,
    }
    impl<F: FnMut(f64, &[f64], &mut [f64])> HybridSystem for WithCorrections<F> {
        fn n_states(&self) -> usize {
            self.dae.n_states()
        }
        fn mass_matrix(&self) -> Option<&[f64]> {
            self.dae.mass_matrix()
        }
        fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
            self.dae.start(t0, x)
        }
        fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
            self.dae.derivatives(t, x, dx)
        }
        fn states_corrected(&mut self, t: f64, x: &[f64]) -> CallResult<()> {
            self.corrections.push((t, x.to_vec()));
            Ok(())
        }
    }
    // x' = -x + y, with y + y^3 = 10 + 20 x and z = x y - 3. At x = 1, y = 3 and z = 0.
    let plain = |_: f64, x: &[f64], d: &mut [f64]| {
        d.copy_from_slice(&[x[1] - x[0], x[1] + x[1].powi(3) - 10.0 - 20.0 * x[0], x[2] - x[0] * x[1] + 3.0]);
    };
    // This system is multiplied by a matrix from the left and written in states u with x = B u, so that it
    // contains no zeros.
    let (a, b) = (
        [[2.0, 1.0, -1.0], [1.0, 1.0, 0.5], [-1.0, 2.0, 1.0]],
        [[1.0, 2.0, 0.5], [-1.0, 1.0, 1.0], [0.5, 0.0, 2.0]],
    );
    let of =
        |u: &[f64]| -> Vec<f64> { b.iter().map(|row| row.iter().zip(u).map(|(b, u)| b * u).sum()).collect() };
    let mixed = |t: f64, u: &[f64], d: &mut [f64]| {
        let mut e = [0.0; 3];
        plain(t, &of(u), &mut e);
        for (d, row) in d.iter_mut().zip(a) {
            *d = row.iter().zip(e).map(|(a, e)| a * e).sum();
        }
    };
    let mixed_mass: Vec<f64> = (0..9).map(|p| a[p % 3][0] * b[0][p / 3]).collect();
    for method in [Method::Radau5, Method::Auto, Method::Bdf] {
        for (y, z) in [(3.0, 0.0), (2.0, 5.0), (-40.0, 1e3), (0.0, 0.0), (300.0, -1e5)] {
            let options = Options { method, relative_tolerance: 1e-8, ..Options::default() };
            let (mut seen, mut driver) = (Recorder::default(), Driver::new(options).unwrap());
            let mut reported = WithCorrections {
                dae: Dae { x0: vec![1.0, y, z], mass: [&[1.0][..], &[0.0; 8]].concat(), f: plain },
                corrections: Vec::new(),
            };
            driver.run(&mut reported, 0.0, 1.0, &[0.0, 1.0], &mut seen).unwrap();
            let start = &seen.rows[0].3;
            assert!(start[0] == 1.0 && (start[1] - 3.0).abs() < 1e-9 && start[2].abs() < 1e-8, "{start:?}");
            if y == 3.0 {
                assert!(reported.corrections.is_empty() && start[1..] == [y, z]);
            } else {
                assert_eq!(reported.corrections, [(0.0, start.clone())]);
            }

            // B^-1 times (1, y, z), by Cramer's rule.
            let det = |m: [[f64; 3]; 3]| {
                m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
                    - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                    + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
            };
            let u: Vec<f64> = (0..3)
                .map(|k| {
                    let mut m = b;
                    m.iter_mut().zip([1.0, y, z]).for_each(|(row, v)| row[k] = v);
                    det(m) / det(b)
                })
                .collect();
            let mut other = Recorder::default();
            driver
                .run(
                    &mut Dae { x0: u, mass: mixed_mass.clone(), f: mixed },
                    0.0,
                    1.0,
                    &[0.0, 1.0],
                    &mut other,
                )
                .unwrap();
            for (row, same) in seen.rows.iter().zip(&other.rows) {
                for (x, s) in row.3.iter().zip(of(&same.3)) {
                    assert!((x - s).abs() < 1e-6, "{:?} {:?}", row.3, of(&same.3));
                }
            }
        }
    }
}

#[test]
fn inconsistent_start_is_an_error_with_equation_and_residual() {
    let run = |x0: Vec<f64>, mass: Vec<f64>, f: fn(&[f64], &mut [f64])| {
        let mut dae = Dae { x0, mass, f: |_: f64, x: &[f64], d: &mut [f64]| f(x, d) };
        Driver::new(Options::default()).unwrap().run(&mut dae, 0.5, 1.0, &[], &mut Ignore)
    };
    // y^2 + 1 = 0 has no solution. The residual at y = 2 is 5.
    let error = run(vec![1.0, 2.0], vec![1.0, 0.0, 0.0, 0.0], |x, d| {
        d.copy_from_slice(&[-x[0], x[1] * x[1] + 1.0]);
    })
    .unwrap_err();
    let ErrorKind::Inconsistent { equation: 1, residual } = error.kind else { panic!("{error}") };
    assert_eq!(residual, 5.0);
    assert!(error.to_string().contains("t = 0.5") && error.to_string().contains("equation 1"), "{error}");
    // A system of index 2: the equation determines x, and y keeps it there.
    let index_2 = |x: &[f64], d: &mut [f64]| d.copy_from_slice(&[x[1], x[0] - 1.0]);
    let error = run(vec![1.5, 0.0], vec![1.0, 0.0, 0.0, 0.0], index_2).unwrap_err();
    assert!(matches!(error.kind, ErrorKind::Inconsistent { equation: 1, residual: 0.5 }), "{error}");
    // Consistent values are accepted.
    run(vec![1.0, 0.0], vec![1.0, 0.0, 0.0, 0.0], index_2).unwrap();
}

/// At t = 1, a valve opens. The states do not change, but the flow that they cause jumps.
#[test]
fn algebraic_states_are_corrected_at_events() {
    struct Valve {
        mass: [f64; 4],
        opening: f64,
        corrected: Vec<(f64, Vec<f64>)>,
    }
    impl HybridSystem for Valve {
        fn n_states(&self) -> usize {
            2
        }
        fn mass_matrix(&self) -> Option<&[f64]> {
            Some(&self.mass)
        }
        fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
            self.opening = 1.0;
            x.copy_from_slice(&[1.0, 1.0]);
            Ok(EventOutcome { next_time: Some(1.0), ..EventOutcome::default() })
        }
        fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
            dx.copy_from_slice(&[-x[1], x[1] - self.opening * x[0]]);
            Ok(())
        }
        fn handle_event(&mut self, _: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
            self.opening = 3.0;
            Ok(EventOutcome::default())
        }
        fn states_corrected(&mut self, t: f64, x: &[f64]) -> CallResult<()> {
            self.corrected.push((t, x.to_vec()));
            Ok(())
        }
    }
    for method in [Method::Radau5, Method::Auto, Method::Bdf] {
        let mut seen = Recorder::default();
        let mut valve = Valve { mass: [1.0, 0.0, 0.0, 0.0], opening: 1.0, corrected: Vec::new() };
        let options = Options { method, relative_tolerance: 1e-9, ..Options::default() };
        Driver::new(options).unwrap().run(&mut valve, 0.0, 2.0, &[1.0, 1.0, 2.0], &mut seen).unwrap();
        let e = std::f64::consts::E;
        let expected = [[1.0 / e, 1.0 / e], [1.0 / e, 3.0 / e], [(-4f64).exp(), 3.0 * (-4f64).exp()]];
        for (row, expected) in seen.rows.iter().zip(expected) {
            for (x, exact) in row.3.iter().zip(expected) {
                let bar = if method == Method::Bdf { 5e-8 } else { 1e-8 };
                assert!((x - exact).abs() < bar, "{}: {row:?}", method.name());
            }
        }
        assert_eq!(valve.corrected, [(1.0, seen.rows[1].3.clone())]);
    }
}
