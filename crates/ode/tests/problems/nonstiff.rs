//! Problems that are not stiff.

use super::Problem;

pub fn van_der_pol() -> Problem {
    Problem {
        name: "VDP mu=1",
        x0: vec![2.0, 0.0],
        end: 20.0,
        f: |_, y, d| {
            d[0] = y[1];
            d[1] = (1.0 - y[0] * y[0]) * y[1] - y[0];
        },
        reference: vec![2.008149762174948592, -4.250887527320214699e-2],
        atol: 1e-2,
        ..Problem::default()
    }
}

pub fn brusselator() -> Problem {
    Problem {
        name: "Brusselator",
        x0: vec![1.5, 3.0],
        end: 20.0,
        f: |_, y, d| {
            d[0] = 1.0 + y[0] * y[0] * y[1] - 4.0 * y[0];
            d[1] = 3.0 * y[0] - y[0] * y[0] * y[1];
        },
        reference: vec![4.986370712683478486e-1, 4.596780349452011183],
        atol: 1e-2,
        ..Problem::default()
    }
}

/// States: x1..x7, y1..y7, their velocities in the same order.
pub fn pleiades() -> Problem {
    let mut x0 = vec![3.0, 3.0, -1.0, -3.0, 2.0, -2.0, 2.0, 3.0, -3.0, 2.0, 0.0, 0.0, -4.0, 4.0];
    x0.extend([0.0, 0.0, 0.0, 0.0, 0.0, 1.75, -1.5, 0.0, 0.0, 0.0, -1.25, 1.0, 0.0, 0.0]);
    Problem {
        name: "Pleiades",
        x0,
        end: 3.0,
        f: |_, y, d| {
            d[..14].copy_from_slice(&y[14..]);
            for i in 0..7 {
                let (mut ax, mut ay) = (0.0, 0.0);
                for j in (0..7).filter(|&j| j != i) {
                    let (dx, dy) = (y[j] - y[i], y[7 + j] - y[7 + i]);
                    let weight = (j + 1) as f64 / (dx * dx + dy * dy).powf(1.5);
                    ax += weight * dx;
                    ay += weight * dy;
                }
                d[14 + i] = ax;
                d[21 + i] = ay;
            }
        },
        reference: vec![
            3.706139143970512901e-1,
            3.237284092057233093,
            -3.222559032418323347,
            6.597091455775308359e-1,
            3.425581707156579790e-1,
            1.562172101400631016,
            -7.003092922212495385e-1,
            -3.943437585517392055,
            -3.271380973972549928,
            5.225081843456544192,
            -2.590612434977469511,
            1.198213693392274638,
            -2.429682344935823409e-1,
            1.091449240428979748,
            3.417003806314314752,
            1.354584501625501221,
            -2.590065597810775420,
            2.025053734714241106,
            -1.155815100160449093,
            -8.072988170223021726e-1,
            5.952396354208718767e-1,
            -3.741244961234008471,
            3.773459685750629037e-1,
            9.386858869551078887e-1,
            3.667922227200569867e-1,
            -3.474046353808494366e-1,
            2.344915448180936923,
            -1.947020434263291901,
        ],
        atol: 1e-2,
        ..Problem::default()
    }
}

pub fn arenstorf() -> Problem {
    let x0 = vec![0.994, 0.0, 0.0, -2.00158510637908252240537862224];
    Problem {
        name: "Arenstorf",
        x0: x0.clone(),
        end: 17.0652165601579625588917206249,
        f: |_, y, d| {
            let mu = 0.012277471;
            let nu = 1.0 - mu;
            let d1 = ((y[0] + mu).powi(2) + y[1] * y[1]).powf(1.5);
            let d2 = ((y[0] - nu).powi(2) + y[1] * y[1]).powf(1.5);
            d[0] = y[2];
            d[1] = y[3];
            d[2] = y[0] + 2.0 * y[3] - nu * (y[0] + mu) / d1 - mu * (y[0] - nu) / d2;
            d[3] = y[1] - 2.0 * y[2] - nu * y[1] / d1 - mu * y[1] / d2;
        },
        reference: x0,
        atol: 1e-2,
        by_largest: true,
        ..Problem::default()
    }
}

/// A planet on an ellipse of eccentricity 0.6 for three orbits. It returns to its start.
pub fn two_body() -> Problem {
    let x0 = vec![0.4, 0.0, 0.0, 2.0];
    Problem {
        name: "Two-body",
        x0: x0.clone(),
        end: 6.0 * std::f64::consts::PI,
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

/// E. N. Lorenz, Deterministic nonperiodic flow, Journal of the Atmospheric Sciences 20 (1963) 130-141.
pub fn lorenz() -> Problem {
    Problem {
        name: "Lorenz",
        x0: vec![1.0, 1.0, 1.0],
        end: 10.0,
        f: |_, y, d| {
            d[0] = 10.0 * (y[1] - y[0]);
            d[1] = y[0] * (28.0 - y[2]) - y[1];
            d[2] = y[0] * y[1] - 8.0 / 3.0 * y[2];
        },
        reference: vec![-4.902687541158402, -3.7438729218116897, 24.69085810283557],
        atol: 1e-2,
        by_largest: true,
        ..Problem::default()
    }
}

pub fn all() -> Vec<Problem> {
    vec![van_der_pol(), brusselator(), pleiades(), arenstorf()]
}
