//! Smooth and piecewise linear functions in rotated axes, with a minimum of 0 at a chosen point.

/// Random numbers (Steele, Lea and Flood, OOPSLA 2014: SplitMix64).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns a uniform number in (0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64 + f64::MIN_POSITIVE
    }

    pub fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }

    pub fn normals(&mut self, n: usize) -> Vec<f64> {
        (0..n).map(|_| self.normal()).collect()
    }

    /// Returns orthonormal rows.
    pub fn rotation(&mut self, n: usize) -> Vec<Vec<f64>> {
        let mut rows: Vec<Vec<f64>> = Vec::new();
        while rows.len() < n {
            let mut row = self.normals(n);
            for other in &rows {
                let along = dot(&row, other);
                row.iter_mut().zip(other).for_each(|(a, b)| *a -= along * b);
            }
            let length = dot(&row, &row).sqrt();
            if length > 1e-2 {
                rows.push(row.iter().map(|a| a / length).collect());
            }
        }
        rows
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// A function and the position of its minimum.
pub struct Rotated {
    pub name: &'static str,
    pub minimum: Vec<f64>,
    rows: Vec<Vec<f64>>,
    f: fn(&[f64]) -> f64,
}

impl Rotated {
    pub fn cost(&self, x: &[f64]) -> f64 {
        let d: Vec<f64> = x.iter().zip(&self.minimum).map(|(x, c)| x - c).collect();
        (self.f)(&self.rows.iter().map(|row| dot(row, &d)).collect::<Vec<_>>())
    }
}

fn weighted(z: &[f64], f: impl Fn(f64) -> f64) -> f64 {
    z.iter().enumerate().map(|(k, z)| (1.0 + k as f64) * f(*z)).sum()
}

/// Returns exp(z) - 1 - z without cancellation.
fn exponential(z: f64) -> f64 {
    if z.abs() < 1e-2 {
        z * z * (0.5 + z * (1.0 / 6.0 + z * (1.0 / 24.0 + z / 120.0)))
    } else {
        z.exp_m1() - z
    }
}

fn rosenbrock(z: &[f64]) -> f64 {
    z.windows(2).map(|w| 100.0 * (w[1] - 2.0 * w[0] - w[0] * w[0]).powi(2) + w[0] * w[0]).sum()
}

type Function = (&'static str, fn(&[f64]) -> f64);

/// Returns smooth functions of `n` parameters.
pub fn smooth(n: usize, seed: u64) -> Vec<Rotated> {
    let functions: [Function; 8] = [
        ("ellipsoid", |z| weighted(z, |z| z * z)),
        ("rosenbrock", rosenbrock),
        ("exponential", |z| z.iter().enumerate().map(|(k, z)| exponential(z * (1.0 + 0.3 * k as f64))).sum()),
        ("ln cosh", |z| weighted(z, |z| (2.0 * (0.5 * z).sinh().powi(2)).ln_1p())),
        ("quartic", |z| {
            let square = dot(z, z);
            square + square * square + 0.1 * z.iter().map(|z| z.powi(3)).sum::<f64>()
        }),
        ("cosine", |z| weighted(z, |z| 2.0 * (0.5 * z).sin().powi(2))),
        ("logarithm", |z| weighted(z, |z| z * z).ln_1p()),
        ("hyperbola", |z| weighted(z, |z| z * z / (1.0 + z.hypot(1.0)))),
    ];
    let mut random = Random::new(seed * 1000 + n as u64);
    let rows = random.rotation(n);
    let minimum: Vec<f64> = random.normals(n).iter().map(|r| 1.0 + 0.8 * r).collect();
    let of = |(name, f)| Rotated { name, f, rows: rows.clone(), minimum: minimum.clone() };
    functions.into_iter().map(of).collect()
}

fn largest(z: &[f64]) -> f64 {
    z.iter().fold(f64::NEG_INFINITY, |most, z| most.max(*z))
}

/// Returns piecewise linear functions of `n` parameters: the sum and the maximum of absolute values along
/// rotated axes with different slopes, and the maximum of linear functions. The first two also occur with
/// more terms than parameters.
pub fn piecewise_linear(n: usize, seed: u64) -> Vec<Rotated> {
    let sum = |z: &[f64]| z.iter().map(|z| z.abs()).sum();
    let most = |z: &[f64]| z.iter().fold(0.0f64, |most, z| most.max(z.abs()));
    let mut random = Random::new(seed * 1000 + 500 + n as u64);
    let axes = random.rotation(n);
    let slopes: Vec<f64> = (0..n).map(|_| 10f64.powf(random.uniform())).collect();
    let scaled = |(row, slope): (&Vec<f64>, &f64)| row.iter().map(|v| v * slope).collect();
    let axes: Vec<Vec<f64>> = axes.iter().zip(&slopes).map(scaled).collect();
    let many: Vec<Vec<f64>> = (0..2 * n).map(|_| random.normals(n)).collect();
    // The last linear function decreases in directions in which the others increase together.
    let mut planes: Vec<Vec<f64>> = (0..n).map(|_| random.normals(n)).collect();
    planes.push((0..n).map(|k| -planes.iter().map(|row| row[k]).sum::<f64>()).collect());
    let minimum: Vec<f64> = random.normals(n).iter().map(|r| 2.0 + r).collect();
    let of = |name, rows: &[Vec<f64>], f: fn(&[f64]) -> f64| Rotated {
        name,
        f,
        rows: rows.to_vec(),
        minimum: minimum.clone(),
    };
    vec![
        of("sum", &axes, sum),
        of("largest", &axes, most),
        of("sum of many", &many, sum),
        of("largest of many", &many, most),
        of("largest plane", &planes, largest),
    ]
}
