//! Systems `M x' = f(t, x)` with a constant, singular `M` (index 1).

#![allow(clippy::unwrap_used)]

mod common;

use common::{Driver, *};
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

/// Robertson's reaction with the last equation replaced by conservation: the same solution.
#[test]
fn robertson_with_conservation_is_robertson() {
    let exact = [7.158270687194050905e-1, 9.185534764557763904e-6, 2.841637457458303518e-1];
    for method in [Method::Radau5, Method::Auto] {
        for (rtol, bar) in [(1e-4, 1e-4), (1e-6, 1e-6), (1e-9, 1e-8)] {
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

/// x' = z with 0 = x^2 + z^2 - 1 on the branch z > 0 from x = 0: sin and cos. Then the same with equations mixed, so that
/// the matrix is singular but has no zero row.
#[test]
fn algebraic_states_and_mixed_equations() {
    let plain =
        |_: f64, x: &[f64], d: &mut [f64]| d.copy_from_slice(&[x[1], x[0] * x[0] + x[1] * x[1] - 1.0]);
    let mut dae = Dae { x0: vec![0.0, 1.0], mass: vec![1.0, 0.0, 0.0, 0.0], f: plain };
    let mixed = |t: f64, x: &[f64], d: &mut [f64]| {
        let mut e = [0.0; 2];
        plain(t, x, &mut e);
        d.copy_from_slice(&[2.0 * e[0] + e[1], e[0] - e[1]]);
    };
    let mut other = Dae { x0: vec![0.0, 1.0], mass: vec![2.0, 1.0, 0.0, 0.0], f: mixed };
    for rtol in [1e-5, 1e-8] {
        for x in [solve(Method::Radau5, rtol, &mut dae, 1.2), solve(Method::Radau5, rtol, &mut other, 1.2)] {
            assert!(
                (x[0] - 1.2f64.sin()).abs() < 10.0 * rtol && (x[1] - 1.2f64.cos()).abs() < 10.0 * rtol,
                "{x:?}"
            );
        }
    }
}

#[test]
fn a_mass_matrix_of_an_ordinary_system_scales_it() {
    let mut dae = Dae {
        x0: vec![1.0, 1.0],
        mass: vec![2.0, 0.0, 0.0, 0.5],
        f: |_: f64, x: &[f64], d: &mut [f64]| d.copy_from_slice(&[-2.0 * x[0], -x[1]]),
    };
    let x = solve(Method::Radau5, 1e-8, &mut dae, 1.0);
    assert!((x[0] - (-1f64).exp()).abs() < 1e-7 && (x[1] - (-2f64).exp()).abs() < 1e-7, "{x:?}");
}

#[test]
fn what_cannot_be_done_is_refused() {
    let mut dae = Dae { x0: vec![1.0], mass: vec![2.0], f: |_: f64, x: &[f64], d: &mut [f64]| d[0] = -x[0] };
    for method in [Method::Tsit5, Method::Dop853, Method::Bdf, Method::Rk4, Method::Euler] {
        let options = Options { method, ..Options::default() };
        let error = Driver::new(options).unwrap().run(&mut dae, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::MassMatrixNeedsRadau5), "{error}");
    }
    for mass in [vec![1.0, 0.0], vec![], vec![f64::NAN]] {
        dae.mass = mass;
        let error =
            Driver::new(Options::default()).unwrap().run(&mut dae, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::MassMatrix { states: 1, .. }), "{error}");
    }
}
