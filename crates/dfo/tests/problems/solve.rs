//! Least-squares solver to check the problems and to find reference minima of bounded ones: projected
//! Levenberg-Marquardt on the free variables, with finite-difference derivatives. Reliable but slow.
#![allow(dead_code, unreachable_pub)]

/// Minimises the sum of squares in a box from a start. Returns the point and the sum.
pub fn least_squares(
    residuals: &dyn Fn(&[f64]) -> Vec<f64>,
    start: &[f64],
    (lower, upper): (&[f64], &[f64]),
    rounds: usize,
) -> (Vec<f64>, f64) {
    let n = start.len();
    let inside = |x: f64, k: usize| x.max(lower[k]).min(upper[k]);
    let mut x: Vec<f64> = start.iter().enumerate().map(|(k, v)| inside(*v, k)).collect();
    let cost = |r: &[f64]| {
        let sum: f64 = r.iter().map(|v| v * v).sum();
        if sum.is_finite() { sum } else { f64::INFINITY }
    };
    let mut r = residuals(&x);
    let mut f = cost(&r);
    let mut damping = 1e-3;
    let mut largest = vec![0.0f64; n];
    for _ in 0..rounds {
        let mut jacobian = vec![vec![0.0; n]; r.len()];
        for k in 0..n {
            let h = 6e-6 * x[k].abs().max(1e-4);
            let (mut a, mut b) = (x.clone(), x.clone());
            (a[k], b[k]) = (inside(x[k] + h, k), inside(x[k] - h, k));
            let (ra, rb) = (residuals(&a), residuals(&b));
            for (row, (p, q)) in jacobian.iter_mut().zip(ra.iter().zip(&rb)) {
                row[k] = (p - q) / (a[k] - b[k]);
            }
            largest[k] = largest[k].max(jacobian.iter().map(|row| row[k] * row[k]).sum::<f64>().sqrt());
        }
        let gradient: Vec<f64> =
            (0..n).map(|k| jacobian.iter().zip(&r).map(|(row, r)| row[k] * r).sum()).collect();
        // At a bound, only variables whose descent direction points inward are free.
        let free: Vec<usize> = (0..n)
            .filter(|&k| !(x[k] <= lower[k] && gradient[k] > 0.0 || x[k] >= upper[k] && gradient[k] < 0.0))
            .collect();
        let mut moved = false;
        for _ in 0..40 {
            let scaled = |k: usize| if largest[k] > 0.0 { largest[k] } else { 1.0 };
            let matrix: Vec<Vec<f64>> = free
                .iter()
                .map(|&i| {
                    free.iter()
                        .map(|&j| {
                            let dot: f64 = jacobian.iter().map(|row| row[i] * row[j]).sum();
                            dot / (scaled(i) * scaled(j)) + if i == j { damping } else { 0.0 }
                        })
                        .collect()
                })
                .collect();
            let right: Vec<f64> = free.iter().map(|&i| -gradient[i] / scaled(i)).collect();
            let step = gauss(matrix, right);
            let mut trial = x.clone();
            free.iter().zip(&step).for_each(|(&k, s)| trial[k] = inside(x[k] + s / scaled(k), k));
            let rt = residuals(&trial);
            let ft = cost(&rt);
            if ft < f {
                (x, r, f, moved) = (trial, rt, ft, true);
                damping = (damping * 0.2).max(1e-14);
                break;
            }
            damping *= 4.0;
        }
        if !moved {
            break;
        }
    }
    (x, f)
}

/// Solves a symmetric positive definite system by elimination with pivoting.
fn gauss(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for step in 0..n {
        let pivot = (step..n).max_by(|&i, &j| a[i][step].abs().total_cmp(&a[j][step].abs())).unwrap_or(step);
        a.swap(step, pivot);
        b.swap(step, pivot);
        for row in step + 1..n {
            let factor = a[row][step] / a[step][step];
            let (done, rest) = a.split_at_mut(row);
            rest[0].iter_mut().zip(&done[step]).skip(step).for_each(|(x, top)| *x -= factor * top);
            b[row] -= factor * b[step];
        }
    }
    for step in (0..n).rev() {
        let sum: f64 = (step + 1..n).map(|k| a[step][k] * b[k]).sum();
        b[step] = (b[step] - sum) / a[step][step];
    }
    b
}
