//! Problems used to tune the rules and constants of `auto`. The table of the judging problems was visible
//! during the tuning, so the two sets are not independent samples. The references are computed on request, by
//! a run at a tight tolerance.

use super::Problem;
use ode::{JacobianPattern, Method};

/// Returns the problem with the end of a run at rtol 1e-12 as its reference.
fn with_reference(mut problem: Problem, method: Method) -> Problem {
    problem.reference = problem.end_state(problem.options(method, 1e-12)).unwrap().0;
    problem
}

/// `x'' = mu (1 - x^2) x' - x` for about one and a half periods.
fn relaxation(name: &'static str, end: f64, f: fn(f64, &[f64], &mut [f64])) -> Problem {
    let plain =
        Problem { name, x0: vec![2.0, 0.0], end, f, atol: 1e-2, by_largest: true, ..Problem::default() };
    with_reference(plain, Method::Radau5)
}

macro_rules! van_der_pol {
    ($name:literal, $mu:literal, $end:literal) => {
        relaxation($name, $end, |_, y, d| {
            d[0] = y[1];
            d[1] = $mu * (1.0 - y[0] * y[0]) * y[1] - y[0];
        })
    };
}

/// A planet on an ellipse for five orbits.
fn kepler(name: &'static str, e: f64) -> Problem {
    let x0 = vec![1.0 - e, 0.0, 0.0, ((1.0 + e) / (1.0 - e)).sqrt()];
    Problem {
        name,
        x0: x0.clone(),
        end: 10.0 * std::f64::consts::PI,
        f: |_, y, d| {
            let r3 = (y[0] * y[0] + y[1] * y[1]).powf(1.5);
            d.copy_from_slice(&[y[2], y[3], -y[0] / r3, -y[1] / r3]);
        },
        reference: x0,
        atol: 1e-2,
        by_largest: true,
        ..Problem::default()
    }
}

/// A. Prothero, A. Robinson, On the stability and accuracy of one-step methods for solving stiff systems of ordinary differential
/// equations, Mathematics of Computation 28 (1974) 145-162.
macro_rules! prothero_robinson {
    ($name:literal, $rate:literal) => {
        Problem {
            name: $name,
            x0: vec![0.0],
            end: 10.0,
            f: |t, y, d| d[0] = -$rate * (y[0] - t.sin()) + t.cos(),
            reference: vec![10f64.sin()],
            atol: 1e-2,
            ..Problem::default()
        }
    };
}

/// Six damped oscillators in a chain of very different frequencies, driven slowly: eigenvalues near the imaginary axis.
macro_rules! oscillators {
    ($name:literal, $damping:literal) => {
        with_reference(
            Problem {
                name: $name,
                x0: vec![0.0; 12],
                end: 10.0,
                f: |t, y, d| {
                    for i in 0..6 {
                        let w = 4f64.powi(i as i32);
                        let left = if i > 0 { y[2 * i - 2] } else { t.sin() };
                        d[2 * i] = y[2 * i + 1];
                        d[2 * i + 1] = w * w * (left - y[2 * i]) - 2.0 * $damping * w * y[2 * i + 1];
                    }
                },
                atol: 1e-2,
                by_largest: true,
                ..Problem::default()
            },
            Method::Dop853,
        )
    };
}

/// Advection and diffusion of a bump on a line of 150 cells, upwind.
macro_rules! advection {
    ($name:literal, $diffusion:literal) => {{
        const N: usize = 150;
        let near = |i: usize| (i.saturating_sub(1)..(i + 2).min(N)).map(move |k| (i, k));
        let bump = |i: usize| (-((i as f64 / N as f64 - 0.3) / 0.1).powi(2)).exp();
        with_reference(
            Problem {
                name: $name,
                x0: (0..N).map(bump).collect(),
                end: 0.5,
                f: |_, y, d| {
                    let n = N as f64;
                    for i in 0..N {
                        let left = if i > 0 { y[i - 1] } else { 0.0 };
                        let right = if i + 1 < N { y[i + 1] } else { y[i] };
                        d[i] = n * (left - y[i]) + $diffusion * n * n * (left - 2.0 * y[i] + right);
                    }
                },
                pattern: JacobianPattern::new(N, (0..N).flat_map(near)),
                atol: 1e-2,
                by_largest: true,
                ..Problem::default()
            },
            Method::Radau5,
        )
    }};
}

/// A chain of reactions with rates from 1e-3 to 1e6, with a feedback.
fn chain_of_reactions() -> Problem {
    let plain = Problem {
        name: "Reactions",
        x0: vec![1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        end: 1e3,
        f: |_, y, d| {
            let r = [0.1 * y[0], 1e3 * y[1] * y[1], 1e6 * y[1] * y[2], 50.0 * y[3], 1e-3 * y[4], 10.0 * y[5]];
            d[0] = -r[0] + r[4];
            d[1] = r[0] - r[1] - r[2] + 0.1 * r[3];
            d[2] = r[1] - r[2] + r[5];
            d[3] = r[2] - r[3];
            d[4] = r[3] - r[4];
            d[5] = 0.9 * r[3] - r[5];
        },
        atol: 1e-4,
        by_largest: true,
        ..Problem::default()
    };
    with_reference(plain, Method::Radau5)
}

/// The nerve equations of A. L. Hodgkin and A. F. Huxley (Journal of Physiology 117 (1952) 500-544), with a current that makes it fire.
fn nerve() -> Problem {
    let plain = Problem {
        name: "Nerve",
        x0: vec![-65.0, 0.053, 0.596, 0.3177],
        end: 50.0,
        f: |_, y, d| {
            let v = y[0] + 65.0;
            let ratio = |x: f64, s: f64| if (x / s).abs() < 1e-6 { s } else { x / ((x / s).exp() - 1.0) };
            let (am, bm) = (0.1 * ratio(25.0 - v, 10.0), 4.0 * (-v / 18.0).exp());
            let (ah, bh) = (0.07 * (-v / 20.0).exp(), 1.0 / ((3.0 - 0.1 * v).exp() + 1.0));
            let (an, bn) = (0.01 * ratio(10.0 - v, 10.0), 0.125 * (-v / 80.0).exp());
            let sodium = 120.0 * y[1].powi(3) * y[2] * (v - 115.0);
            let potassium = 36.0 * y[3].powi(4) * (v + 12.0);
            d[0] = 10.0 - sodium - potassium - 0.3 * (v - 10.6);
            d[1] = am * (1.0 - y[1]) - bm * y[1];
            d[2] = ah * (1.0 - y[2]) - bh * y[2];
            d[3] = an * (1.0 - y[3]) - bn * y[3];
        },
        atol: 1e-2,
        by_largest: true,
        ..Problem::default()
    };
    with_reference(plain, Method::Dop853)
}

/// Diffusion through 60 dense coupled cells: a full matrix without a useful pattern. Its spectrum is known:
/// real, from 1 to 1e4.
fn dense_diffusion() -> Problem {
    let plain = Problem {
        name: "Dense diffusion",
        x0: (0..60).map(|i| (0.1 * f64::from(i)).sin()).collect(),
        end: 3.0,
        f: |t, y, d| {
            // A Householder reflection of a diagonal matrix.
            let n = y.len() as f64;
            let mean = 2.0 * y.iter().sum::<f64>() / n;
            for (i, d) in d.iter_mut().enumerate() {
                let rate = 10f64.powf(4.0 * i as f64 / (n - 1.0));
                *d = -rate * (y[i] - mean);
            }
            let mean = 2.0 * d.iter().sum::<f64>() / n;
            d.iter_mut().for_each(|d| *d += t.sin() - mean);
        },
        atol: 1e-2,
        by_largest: true,
        ..Problem::default()
    };
    with_reference(plain, Method::Radau5)
}

pub fn all() -> Vec<Problem> {
    vec![
        van_der_pol!("VDP mu=5", 5.0, 20.0),
        van_der_pol!("VDP mu=30", 30.0, 80.0),
        van_der_pol!("VDP mu=200", 200.0, 500.0),
        van_der_pol!("VDP mu=1e4", 1e4, 2.2e4),
        kepler("Kepler 0.1", 0.1),
        kepler("Kepler 0.5", 0.5),
        kepler("Kepler 0.9", 0.9),
        prothero_robinson!("P-R 30", 30.0),
        prothero_robinson!("P-R 300", 300.0),
        prothero_robinson!("P-R 1e5", 1e5),
        oscillators!("Oscillators 0.01", 0.01),
        oscillators!("Oscillators 0.3", 0.3),
        advection!("Advection 1e-4", 1e-4),
        advection!("Advection 1e-2", 1e-2),
        advection!("Advection 1", 1.0),
        chain_of_reactions(),
        nerve(),
        dense_diffusion(),
    ]
}
