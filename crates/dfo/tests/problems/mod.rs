//! The 22 functions of Moré and Wild (SIAM J. Optim. 20, 2009) as residual vectors, from the published
//! formulas. Sources: Moré, Garbow and Hillstrom (ACM Trans. Math. Softw. 7, 1981) for 1 to 18; CUTEr for
//! Bdqrtic, Cube, Mancino and Heart8.
#![allow(dead_code, unreachable_pub, clippy::unwrap_used)]

pub mod boxes;
pub mod calibration;
pub mod hock_schittkowski;
pub mod nist;
pub mod rotated;
pub mod solve;

/// An instance: number of the function, parameters, residuals, exponent of the scale of the start, and best
/// known sum of squares.
#[derive(Debug, Clone, Copy)]
pub struct Instance {
    pub number: usize,
    pub n: usize,
    pub m: usize,
    pub scale: i32,
    pub best: f64,
}

impl Instance {
    pub fn start(&self) -> Vec<f64> {
        start(self.number, self.n).iter().map(|x| x * 10f64.powi(self.scale)).collect()
    }

    pub fn cost(&self, x: &[f64]) -> f64 {
        residuals(self.number, self.m, x).iter().map(|r| r * r).sum()
    }
}

/// The 53 instances: number of the problem, parameters, residuals, and the powers of ten that multiply the
/// standard start (J. J. Moré and S. M. Wild, SIAM J. Optim. 20 (2009) 172, section 4.1: their benchmark set,
/// problem by problem).
const INSTANCES: [(usize, usize, usize, &[i32]); 37] = [
    (1, 9, 45, &[0, 1]),
    (2, 7, 35, &[0, 1]),
    (3, 7, 35, &[0, 1]),
    (4, 2, 2, &[0, 1]),
    (5, 3, 3, &[0, 1]),
    (6, 4, 4, &[0, 1]),
    (7, 2, 2, &[0, 1]),
    (8, 3, 15, &[0, 1]),
    (9, 4, 11, &[0]),
    (10, 3, 16, &[0]),
    (11, 6, 31, &[0, 1]),
    (11, 9, 31, &[0, 1]),
    (11, 12, 31, &[0, 1]),
    (12, 3, 10, &[0]),
    (13, 2, 10, &[0]),
    (14, 4, 20, &[0, 1]),
    (15, 6, 6, &[0]),
    (15, 7, 7, &[0]),
    (15, 8, 8, &[0]),
    (15, 9, 9, &[0]),
    (15, 10, 10, &[0]),
    (15, 11, 11, &[0]),
    (16, 10, 10, &[0]),
    (17, 5, 33, &[0]),
    (18, 11, 65, &[0, 1]),
    (19, 8, 8, &[0]),
    (19, 10, 12, &[0]),
    (19, 11, 14, &[0]),
    (19, 12, 16, &[0]),
    (20, 5, 5, &[0]),
    (20, 6, 6, &[0]),
    (20, 8, 8, &[0]),
    (21, 5, 5, &[0, 1]),
    (21, 8, 8, &[0]),
    (21, 10, 10, &[0]),
    (21, 12, 12, &[0, 1]),
    (22, 8, 8, &[0, 1]),
];

/// Returns the smallest sum of squares. It is zero if a root is known (J. J. Moré, B. S. Garbow and K. E.
/// Hillstrom, ACM Trans. Math. Softw. 7 (1981) 17), otherwise the smallest result of `least_squares` from 60
/// starts.
fn smallest(number: usize, n: usize) -> f64 {
    match (number, n) {
        (1, _) => 36.0,
        (2, _) => 8.380_281_690_140_84,
        (3, _) => 9.880_597_014_925_37,
        (8, _) => 8.214_877_306_578_945e-3,
        (9, _) => 3.075_056_038_492_363e-4,
        (10, _) => 87.945_855_170_3,
        (11, 6) => 2.287_670_053_552_32e-3,
        (11, 9) => 1.399_760_138_085e-6,
        (11, _) => 4.722_381_1e-10,
        (13, _) => 124.362_182_355_615,
        (14, _) => 85_822.201_626_356_27,
        (15, 8) => 3.516_873_725_677_92e-3,
        (15, 10) => 4.772_713_696_375_34e-3,
        (15, 11) => 2.799_761_551_865_76e-3,
        (17, _) => 5.464_894_697_482_43e-5,
        (18, _) => 4.013_773_629_354_77e-2,
        (19, 8) => 10.238_973_421_317_43,
        (19, 10) => 18.281_161_753_593_53,
        (19, 11) => 22.260_591_734_883_75,
        (19, _) => 26.272_766_396_793_95,
        _ => 0.0,
    }
}

/// Returns the instances with their smallest sums of squares.
pub fn instances() -> Vec<Instance> {
    let each = |&(number, n, m, scales): &(usize, usize, usize, &'static [i32])| {
        scales.iter().map(move |&scale| Instance { number, n, m, scale, best: smallest(number, n) })
    };
    INSTANCES.iter().flat_map(each).collect()
}

/// Returns the standard start.
pub fn start(number: usize, n: usize) -> Vec<f64> {
    match number {
        1..=3 | 8 | 19 => vec![1.0; n],
        4 => vec![-1.2, 1.0],
        5 => vec![-1.0, 0.0, 0.0],
        6 => vec![3.0, -1.0, 0.0, 1.0],
        7 => vec![0.5, -2.0],
        9 => vec![0.25, 0.39, 0.415, 0.39],
        10 => vec![0.02, 4000.0, 250.0],
        11 | 16 | 20 => vec![0.5; n],
        12 => vec![0.0, 10.0, 20.0],
        13 => vec![0.3, 0.4],
        14 => vec![25.0, 5.0, -5.0, -1.0],
        15 => (1..=n).map(|k| k as f64 / (n + 1) as f64).collect(),
        17 => vec![0.5, 1.5, -1.0, 0.01, 0.02],
        18 => vec![1.3, 0.65, 0.65, 0.7, 0.6, 3.0, 5.0, 7.0, 2.0, 4.5, 5.5],
        21 => {
            let sum = |i: usize| -> f64 { (1..=n).map(|j| wave((i as f64 / j as f64).sqrt())).sum() };
            (1..=n).map(|i| -8.710996e-4 * ((i as f64 - 50.0).powi(3) + sum(i))).collect()
        }
        22 => vec![-0.3, -0.39, 0.3, -0.344, -1.2, 2.69, 1.59, -1.5],
        _ => panic!("there is no function {number}"),
    }
}

/// Mancino's `v (sin^5 ln v + cos^5 ln v)`.
fn wave(v: f64) -> f64 {
    v * (v.ln().sin().powi(5) + v.ln().cos().powi(5))
}

const BARD: [f64; 15] =
    [0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39];
const KOWALIK_V: [f64; 11] = [4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625];
const KOWALIK_Y: [f64; 11] =
    [0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246];
const MEYER: [f64; 16] = [
    34780.0, 28610.0, 23650.0, 19630.0, 16370.0, 13720.0, 11540.0, 9744.0, 8261.0, 7030.0, 6005.0, 5147.0,
    4427.0, 3820.0, 3307.0, 2872.0,
];
const OSBORNE_1: [f64; 33] = [
    0.844, 0.908, 0.932, 0.936, 0.925, 0.908, 0.881, 0.850, 0.818, 0.784, 0.751, 0.718, 0.685, 0.658, 0.628,
    0.603, 0.580, 0.558, 0.538, 0.522, 0.506, 0.490, 0.478, 0.467, 0.457, 0.448, 0.438, 0.431, 0.424, 0.420,
    0.414, 0.411, 0.406,
];
const OSBORNE_2: [f64; 65] = [
    1.366, 1.191, 1.112, 1.013, 0.991, 0.885, 0.831, 0.847, 0.786, 0.725, 0.746, 0.679, 0.608, 0.655, 0.616,
    0.606, 0.602, 0.626, 0.651, 0.724, 0.649, 0.649, 0.694, 0.644, 0.624, 0.661, 0.612, 0.558, 0.533, 0.495,
    0.500, 0.423, 0.395, 0.375, 0.372, 0.391, 0.396, 0.405, 0.428, 0.429, 0.523, 0.562, 0.607, 0.653, 0.672,
    0.708, 0.633, 0.668, 0.645, 0.632, 0.591, 0.559, 0.597, 0.625, 0.739, 0.710, 0.729, 0.720, 0.636, 0.581,
    0.428, 0.292, 0.162, 0.098, 0.054,
];

/// Returns the residual vector of a function; its length is `m`.
pub fn residuals(number: usize, m: usize, x: &[f64]) -> Vec<f64> {
    let n = x.len();
    let each = |f: &dyn Fn(usize, f64) -> f64| -> Vec<f64> { (1..=m).map(|i| f(i, i as f64)).collect() };
    match number {
        // Linear, full rank.
        1 => {
            let shift = 2.0 * x.iter().sum::<f64>() / m as f64 + 1.0;
            each(&|i, _| if i <= n { x[i - 1] - shift } else { -shift })
        }
        // Linear, rank 1; also with zero columns and rows.
        2 | 3 => {
            let weighted = |j: usize| (j + 1) as f64 * x[j];
            let sum: f64 =
                if number == 2 { (0..n).map(weighted).sum() } else { (1..n - 1).map(weighted).sum() };
            each(&|i, t| match number {
                2 => t * sum - 1.0,
                _ if i == m => -1.0,
                _ => (t - 1.0) * sum - 1.0,
            })
        }
        // Rosenbrock.
        4 => vec![10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]],
        // Helical valley.
        5 => {
            let turn = if x[0] == 0.0 {
                0.25f64.copysign(x[1])
            } else {
                (x[1] / x[0]).atan() / std::f64::consts::TAU + if x[0] < 0.0 { 0.5 } else { 0.0 }
            };
            vec![10.0 * (x[2] - 10.0 * turn), 10.0 * (x[0].hypot(x[1]) - 1.0), x[2]]
        }
        // Powell singular.
        6 => vec![
            x[0] + 10.0 * x[1],
            5f64.sqrt() * (x[2] - x[3]),
            (x[1] - 2.0 * x[2]).powi(2),
            10f64.sqrt() * (x[0] - x[3]).powi(2),
        ],
        // Freudenstein and Roth.
        7 => vec![
            -13.0 + x[0] + ((5.0 - x[1]) * x[1] - 2.0) * x[1],
            -29.0 + x[0] + ((1.0 + x[1]) * x[1] - 14.0) * x[1],
        ],
        // Bard.
        8 => each(&|i, u| BARD[i - 1] - (x[0] + u / ((16.0 - u) * x[1] + u.min(16.0 - u) * x[2]))),
        // Kowalik and Osborne.
        9 => each(&|i, _| {
            let v = KOWALIK_V[i - 1];
            KOWALIK_Y[i - 1] - x[0] * v * (v + x[1]) / (v * (v + x[2]) + x[3])
        }),
        // Meyer.
        10 => each(&|i, t| x[0] * (x[1] / (45.0 + 5.0 * t + x[2])).exp() - MEYER[i - 1]),
        // Watson.
        11 => each(&|i, k| match i {
            30 => x[0],
            31 => x[1] - x[0] * x[0] - 1.0,
            _ => {
                let t = k / 29.0;
                let slope: f64 = (1..n).map(|j| j as f64 * x[j] * t.powi(j as i32 - 1)).sum();
                let value: f64 = (0..n).map(|j| x[j] * t.powi(j as i32)).sum();
                slope - value * value - 1.0
            }
        }),
        // Box, three-dimensional.
        12 => each(&|_, i| {
            let t = i / 10.0;
            (-t * x[0]).exp() - (-t * x[1]).exp() + x[2] * ((-i).exp() - (-t).exp())
        }),
        // Jennrich and Sampson.
        13 => each(&|_, i| 2.0 + 2.0 * i - (i * x[0]).exp() - (i * x[1]).exp()),
        // Brown and Dennis.
        14 => each(&|_, i| {
            let t = i / 5.0;
            (x[0] + t * x[1] - t.exp()).powi(2) + (x[2] + x[3] * t.sin() - t.cos()).powi(2)
        }),
        // Chebyquad.
        15 => {
            let mut sums = vec![0.0; m];
            for x in x {
                let y = 2.0 * x - 1.0;
                let (mut before, mut now) = (1.0, y);
                for sum in &mut sums {
                    *sum += now;
                    (before, now) = (now, 2.0 * y * now - before);
                }
            }
            let integral = |i: usize| if i.is_multiple_of(2) { -1.0 / ((i * i) as f64 - 1.0) } else { 0.0 };
            each(&|i, _| sums[i - 1] / n as f64 - integral(i))
        }
        // Brown, almost linear.
        16 => {
            let sum: f64 = x.iter().sum();
            let product: f64 = x.iter().product();
            each(&|i, _| if i < n { x[i - 1] + sum - (n + 1) as f64 } else { product - 1.0 })
        }
        // Osborne 1.
        17 => each(&|i, k| {
            let t = 10.0 * (k - 1.0);
            OSBORNE_1[i - 1] - (x[0] + x[1] * (-t * x[3]).exp() + x[2] * (-t * x[4]).exp())
        }),
        // Osborne 2.
        18 => each(&|i, k| {
            let t = (k - 1.0) / 10.0;
            let bell = |height: usize| x[height] * (-x[height + 4] * (t - x[height + 7]).powi(2)).exp();
            OSBORNE_2[i - 1] - (x[0] * (-t * x[4]).exp() + bell(1) + bell(2) + bell(3))
        }),
        // Bdqrtic.
        19 => each(&|i, _| {
            if i <= n - 4 {
                3.0 - 4.0 * x[i - 1]
            } else {
                let k = i - (n - 4) - 1;
                let square = |j: usize| x[j] * x[j];
                square(k)
                    + 2.0 * square(k + 1)
                    + 3.0 * square(k + 2)
                    + 4.0 * square(k + 3)
                    + 5.0 * square(n - 1)
            }
        }),
        // Cube.
        20 => each(&|i, _| if i == 1 { x[0] - 1.0 } else { 10.0 * (x[i - 1] - x[i - 2].powi(3)) }),
        // Mancino.
        21 => each(&|i, t| {
            let x_i = x[i - 1];
            let sum: f64 = (1..=n).map(|j| wave((x_i * x_i + t / j as f64).sqrt())).sum();
            1400.0 * x_i + (t - 50.0).powi(3) + sum
        }),
        // Heart8.
        22 => {
            let [a, b, c, d, t, u, v, w] = *x.first_chunk().unwrap();
            vec![
                a + b + 0.69,
                c + d + 0.044,
                t * a + u * b - v * c - w * d + 1.57,
                v * a + w * b + t * c + u * d + 1.31,
                a * (t * t - v * v) - 2.0 * c * t * v + b * (u * u - w * w) - 2.0 * d * u * w + 2.65,
                c * (t * t - v * v) + 2.0 * a * t * v + d * (u * u - w * w) + 2.0 * b * u * w - 2.0,
                a * t * (t * t - 3.0 * v * v)
                    + c * v * (v * v - 3.0 * t * t)
                    + b * u * (u * u - 3.0 * w * w)
                    + d * w * (w * w - 3.0 * u * u)
                    + 12.6,
                c * t * (t * t - 3.0 * v * v) - a * v * (v * v - 3.0 * t * t) + d * u * (u * u - 3.0 * w * w)
                    - b * w * (w * w - 3.0 * u * u)
                    - 9.48,
            ]
        }
        _ => panic!("there is no function {number}"),
    }
}
