//! Problems with minima on bounds, and some with interior minima. They are quadratics on boxes, Rosenbrock's
//! function in boxes, and the bound-constrained problems of Hock and Schittkowski (Test Examples for
//! Nonlinear Programming Codes, Springer, 1981). Even seeds are for tuning (`benches/simplex.rs`), odd seeds
//! for assessment (`tests/all/simplex_quality.rs`).

use super::solve::least_squares;
use super::{residuals, start};

type Cost = Box<dyn Fn(&[f64]) -> f64 + Send + Sync>;

/// A cost in a box, with its start and its smallest value.
pub struct Boxed {
    pub name: String,
    pub cost: Cost,
    pub start: Vec<f64>,
    pub lower: Vec<f64>,
    pub upper: Vec<f64>,
    pub best: f64,
}

impl Boxed {
    /// Returns three starts: the usual start and two corners of the box, as far as its bounds are finite.
    pub fn starts(&self) -> [Vec<f64>; 3] {
        let corner = |bounds: &[f64]| {
            bounds.iter().zip(&self.start).map(|(b, x)| if b.is_finite() { *b } else { *x }).collect()
        };
        [self.start.clone(), corner(&self.lower), corner(&self.upper)]
    }
}

/// Uniform numbers from a Lehmer generator, sufficient for matrices.
struct Dice(u64);

impl Dice {
    fn next(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0 * 48_271 % 0x7fff_ffff;
        low + (high - low) * self.0 as f64 / 2_147_483_647.0
    }
}

/// Returns orthonormal rows.
fn rotation(n: usize, dice: &mut Dice) -> Vec<Vec<f64>> {
    let mut rows: Vec<Vec<f64>> = Vec::new();
    while rows.len() < n {
        let mut row: Vec<f64> = (0..n).map(|_| (0..12).map(|_| dice.next(-0.5, 0.5)).sum()).collect();
        for _ in 0..2 {
            for q in &rows {
                let along: f64 = row.iter().zip(q).map(|(a, b)| a * b).sum();
                row.iter_mut().zip(q).for_each(|(a, b)| *a -= along * b);
            }
        }
        let norm = row.iter().map(|v| v * v).sum::<f64>().sqrt();
        row.iter_mut().for_each(|v| *v /= norm);
        rows.push(row);
    }
    rows
}

/// Position of the minimum of a quadratic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    Interior,
    /// Half of the coordinates are on a bound.
    Face,
    /// All coordinates are on a bound.
    Corner,
    /// All coordinates are on a bound, and the slope is zero in half of them.
    Degenerate,
}

/// `0.5 d'Hd + g'd` with `d = (x - x*) / width`. `H` has the given condition number, and `g` points out of
/// the box.
pub fn quadratic(n: usize, place: Place, condition: f64, seed: u64) -> Boxed {
    let mut dice = Dice(1_000_003 * (seed + 1) + 17 * n as u64 + place as u64);
    (0..10).for_each(|_| {
        dice.next(0.0, 1.0);
    });
    let q = rotation(n, &mut dice);
    let eigen: Vec<f64> = (0..n).map(|k| condition.powf(k as f64 / (n as f64 - 1.0))).collect();
    let lower: Vec<f64> = (0..n).map(|_| dice.next(-3.0, 1.0)).collect();
    let width: Vec<f64> = (0..n).map(|_| 10f64.powf(dice.next(-1.5, 1.5))).collect();
    let upper: Vec<f64> = lower.iter().zip(&width).map(|(l, w)| l + w).collect();
    let (mut minimum, mut slope) = (Vec::new(), Vec::new());
    for k in 0..n {
        let low = dice.next(0.0, 1.0) < 0.5;
        let steep = dice.next(0.5, 50.0);
        let active = match place {
            Place::Interior => false,
            Place::Face => k % 2 == 0,
            Place::Corner | Place::Degenerate => true,
        };
        let flat = !active || (place == Place::Degenerate && k % 2 == 1);
        minimum.push(match (active, low) {
            (false, _) => lower[k] + dice.next(0.2, 0.8) * width[k],
            (true, true) => lower[k],
            (true, false) => upper[k],
        });
        slope.push(if flat {
            0.0
        } else if low {
            steep
        } else {
            -steep
        });
    }
    let start: Vec<f64> = (0..n).map(|k| lower[k] + dice.next(0.2, 0.8) * width[k]).collect();
    let cost = move |x: &[f64]| {
        let d: Vec<f64> = (0..n).map(|k| (x[k] - minimum[k]) / width[k]).collect();
        let linear: f64 = d.iter().zip(&slope).map(|(d, g)| d * g).sum();
        let squares = q
            .iter()
            .zip(&eigen)
            .map(|(row, e)| e * row.iter().zip(&d).map(|(a, b)| a * b).sum::<f64>().powi(2));
        linear + 0.5 * squares.sum::<f64>()
    };
    let name = format!("quadratic {n} {place:?} {condition:e} {seed}");
    Boxed { name, cost: Box::new(cost), start, lower, upper, best: 0.0 }
}

/// Rosenbrock's chain in a box that excludes some coordinates of its minimum.
pub fn rosenbrock(n: usize, low: f64, high: f64, start: f64) -> Boxed {
    let r = |x: &[f64]| -> Vec<f64> {
        x.windows(2).flat_map(|w| [10.0 * (w[1] - w[0] * w[0]), 1.0 - w[0]]).collect()
    };
    let cost = move |x: &[f64]| r(x).iter().map(|r| r * r).sum();
    let (lower, upper) = (vec![low; n], vec![high; n]);
    let best = [low, 0.5 * (low + high), high, start]
        .map(|s| least_squares(&r, &vec![s; n], (&lower, &upper), 2000).1)
        .into_iter()
        .fold(f64::INFINITY, f64::min);
    Boxed {
        name: format!("Rosenbrock {n} [{low}, {high}]"),
        cost: Box::new(cost),
        start: vec![start; n],
        lower,
        upper,
        best,
    }
}

fn named(
    number: u32,
    (start, lower, upper): (&[f64], &[f64], &[f64]),
    best: f64,
    cost: impl Fn(&[f64]) -> f64 + Send + Sync + 'static,
) -> Boxed {
    let start = start.iter().zip(lower.iter().zip(upper)).map(|(x, (l, u))| x.clamp(*l, *u)).collect();
    let name = format!("Hock and Schittkowski {number}");
    Boxed { name, cost: Box::new(cost), start, lower: lower.to_vec(), upper: upper.to_vec(), best }
}

/// Problems 1 to 5, 25, 38, 45 and 110. Starts outside the box are moved to the bound.
pub fn hock_schittkowski() -> Vec<Boxed> {
    const INF: f64 = f64::INFINITY;
    let rosen = |x: &[f64]| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (1.0 - x[0]).powi(2);
    vec![
        named(1, (&[-2.0, 1.0], &[-INF, -1.5], &[INF; 2]), 0.0, rosen),
        named(2, (&[-2.0, 1.0], &[-INF, 1.5], &[INF; 2]), 0.050_426_187_9, rosen),
        named(3, (&[10.0, 1.0], &[-INF, 0.0], &[INF; 2]), 0.0, |x| x[1] + 1e-5 * (x[1] - x[0]).powi(2)),
        named(4, (&[1.125, 0.125], &[1.0, 0.0], &[INF; 2]), 8.0 / 3.0, |x| (x[0] + 1.0).powi(3) / 3.0 + x[1]),
        named(5, (&[0.0; 2], &[-1.5, -3.0], &[4.0, 3.0]), -1.913_222_954_9, |x| {
            (x[0] + x[1]).sin() + (x[0] - x[1]).powi(2) - 1.5 * x[0] + 2.5 * x[1] + 1.0
        }),
        named(25, (&[100.0, 12.5, 3.0], &[0.1, 0.0, 0.0], &[100.0, 25.6, 5.0]), 0.0, |x| {
            (1..100)
                .map(|i| {
                    let u = 25.0 + (-50.0 * (0.01 * f64::from(i)).ln()).powf(2.0 / 3.0);
                    (-0.01 * f64::from(i) + (-(u - x[1]).powf(x[2]) / x[0]).exp()).powi(2)
                })
                .sum()
        }),
        named(38, (&[-3.0, -1.0, -3.0, -1.0], &[-10.0; 4], &[10.0; 4]), 0.0, |x| {
            100.0 * (x[1] - x[0] * x[0]).powi(2)
                + (1.0 - x[0]).powi(2)
                + 90.0 * (x[3] - x[2] * x[2]).powi(2)
                + (1.0 - x[2]).powi(2)
                + 10.1 * ((x[1] - 1.0).powi(2) + (x[3] - 1.0).powi(2))
                + 19.8 * (x[1] - 1.0) * (x[3] - 1.0)
        }),
        named(45, (&[2.0; 5], &[0.0; 5], &[1.0, 2.0, 3.0, 4.0, 5.0]), 1.0, |x| {
            2.0 - x.iter().product::<f64>() / 120.0
        }),
        named(110, (&[9.0; 10], &[2.001; 10], &[9.999; 10]), -45.778_469_71, |x| {
            let logs: f64 = x.iter().map(|x| (x - 2.0).ln().powi(2) + (10.0 - x).ln().powi(2)).sum();
            logs - x.iter().product::<f64>().powf(0.2)
        }),
    ]
}

/// Returns the problems of one half. The problems of Hock and Schittkowski are only for assessment.
pub fn boxes(judging: bool) -> Vec<Boxed> {
    let mut all = Vec::new();
    for seed in 0..6 {
        for n in [2, 5, 10] {
            for (place, conditions) in [
                (Place::Corner, [10.0, 1e3]),
                (Place::Face, [10.0, 1e3]),
                (Place::Degenerate, [10.0, 1e2]),
                (Place::Interior, [10.0, 1e3]),
            ] {
                let condition = conditions[(seed / 2) as usize % 2];
                if (seed % 2 == 1) == judging {
                    all.push(quadratic(n, place, condition, seed));
                }
            }
        }
    }
    for n in [2, 5, 10] {
        if judging {
            all.push(rosenbrock(n, -2.0, 0.8, -1.2));
            all.push(rosenbrock(n, -1.5, 0.5, 0.0));
        } else {
            all.push(rosenbrock(n, -3.0, 0.7, 0.5));
            all.push(rosenbrock(n, 1.2, 3.0, 2.0));
        }
    }
    if judging {
        all.extend(hock_schittkowski());
    }
    all
}

/// Problems of Moré and Wild that are solved in boxes: number, parameters and residuals.
pub const BOUNDED: [(usize, usize, usize); 16] = [
    (4, 2, 2),
    (5, 3, 3),
    (6, 4, 4),
    (7, 2, 2),
    (8, 3, 15),
    (9, 4, 11),
    (12, 3, 10),
    (13, 2, 10),
    (14, 4, 20),
    (15, 6, 6),
    (16, 10, 10),
    (17, 5, 33),
    (19, 8, 8),
    (20, 5, 5),
    (22, 8, 8),
    (11, 6, 31),
];

/// Returns the box around start and minimum. If `active`, the box excludes the minimum of every other
/// coordinate.
pub fn bounded_box(number: usize, n: usize, m: usize, active: bool) -> (Vec<f64>, Vec<f64>) {
    let x0 = start(number, n);
    let free = (vec![f64::NEG_INFINITY; n], vec![f64::INFINITY; n]);
    let f = |x: &[f64]| residuals(number, m, x);
    let (minimum, _) = least_squares(&f, &x0, (&free.0, &free.1), 2000);
    let (mut lower, mut upper) = (Vec::new(), Vec::new());
    for k in 0..n {
        let half = (1.5 * (minimum[k] - x0[k]).abs()).max(0.5 * x0[k].abs().max(0.1));
        lower.push(x0[k].min(minimum[k]) - half);
        upper.push(x0[k].max(minimum[k]) + half);
        if active && k % 2 == 0 && minimum[k] != x0[k] {
            let cut = x0[k] + 0.6 * (minimum[k] - x0[k]);
            if minimum[k] > x0[k] { upper[k] = cut } else { lower[k] = cut }
        }
    }
    (lower, upper)
}
