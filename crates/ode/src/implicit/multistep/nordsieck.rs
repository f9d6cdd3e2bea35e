//! The Nordsieck array: rows `z_j = h^j x^(j) / j!` of a polynomial, expanded at a point, in units of a step
//! `h`.
//!
//! The functions take the rows in use, one more than the order. Each row has one number per state.

use super::coefficients::{MAX_ORDER, integral_through};

/// Changes the unit to a step `ratio` times as long.
pub(super) fn rescale(z: &mut [Vec<f64>], ratio: f64) {
    let mut factor = 1.0;
    for z in &mut z[1..] {
        factor *= ratio;
        z.iter_mut().for_each(|z| *z *= factor);
    }
}

/// Moves the point of expansion forward by one step: multiplies by Pascal's triangle.
pub(super) fn advance(z: &mut [Vec<f64>]) {
    for k in 1..z.len() {
        for j in (k..z.len()).rev() {
            let (low, high) = z.split_at_mut(j);
            add_multiple(&mut low[j - 1], 1.0, &high[0]);
        }
    }
}

/// Moves the point of expansion back within the last step, to the fraction `theta` from its start. The unit
/// is then the shorter step.
pub(super) fn retreat(z: &mut [Vec<f64>], theta: f64) {
    let s = theta - 1.0;
    rescale(z, s);
    advance(z);
    rescale(z, theta / s);
}

/// Reduces the order of an Adams formula by one: removes the slope at the oldest point.
pub(super) fn lower_adams(z: &mut [Vec<f64>], h: f64, past: &[f64]) {
    let q = z.len() - 1;
    let whole = integral_through(q - 2, h, past);
    let (low, high) = z.split_at_mut(q);
    for (z, whole) in low.iter_mut().zip(whole).skip(2) {
        add_multiple(z, -(q as f64) * whole, &high[0]);
    }
}

/// Increases the order of an Adams formula by one. The last row must be allocated. `factor` times the last
/// correction is the divided difference of the slopes over one more past point.
pub(super) fn raise_adams(z: &mut [Vec<f64>], h: f64, past: &[f64], factor: f64, last_correction: &[f64]) {
    let q = z.len() - 2;
    let whole = integral_through(q - 1, h, past);
    z[q + 1].fill(0.0);
    for (z, whole) in z.iter_mut().zip(whole).skip(2) {
        add_multiple(z, factor * whole, last_correction);
    }
}

/// Reduces the order of BDF by one: removes the term of the oldest point, which is `sum(past)` away.
pub(super) fn lower_bdf(z: &mut [Vec<f64>], h: f64, past: &[f64]) {
    let q = z.len() - 1;
    // The product of s and the distances to the remaining points, as a polynomial in s.
    let mut l = [0.0; MAX_ORDER + 1];
    l[2] = 1.0;
    let mut sum = 0.0;
    for j in 1..q - 1 {
        sum += past[j - 1];
        let xi = sum / h;
        for i in (2..=j + 2).rev() {
            l[i] = l[i] * xi + l[i - 1];
        }
    }
    let (low, high) = z.split_at_mut(q);
    for (z, l) in low.iter_mut().zip(l).skip(2) {
        add_multiple(z, -l, &high[0]);
    }
}

/// Increases the order of BDF by one. The last row must be allocated. The last correction of the corrector
/// gives the term of one more past point.
pub(super) fn raise_bdf(z: &mut [Vec<f64>], h: f64, past: &[f64], last_correction: &[f64]) {
    let q = z.len() - 2;
    let mut l = [0.0; MAX_ORDER + 1];
    l[2] = 1.0;
    let (mut alpha_0, mut alpha_1, mut product, mut xi_old) = (-1.0, 1.0, 1.0, 1.0);
    let mut sum = h;
    for (j, past) in (1..q).zip(&past[1..]) {
        sum += past;
        let xi = sum / h;
        product *= xi;
        alpha_0 -= 1.0 / (j as f64 + 1.0);
        alpha_1 += 1.0 / xi;
        for i in (2..=j + 2).rev() {
            l[i] = l[i] * xi_old + l[i - 1];
        }
        xi_old = xi;
    }
    let factor = (-alpha_0 - alpha_1) / product;
    let (low, high) = z.split_at_mut(q + 1);
    for (z, e) in high[0].iter_mut().zip(last_correction) {
        *z = factor * e;
    }
    for (z, l) in low.iter_mut().zip(l).skip(2) {
        add_multiple(z, l, &high[0]);
    }
}

/// Evaluates the polynomial `s` steps from the point of expansion.
pub(super) fn value(z: &[Vec<f64>], s: f64, x: &mut [f64]) {
    x.fill(0.0);
    for z in z.iter().rev() {
        for (x, z) in x.iter_mut().zip(z) {
            *x = *x * s + z;
        }
    }
}

/// Computes `y += factor x`.
pub(super) fn add_multiple(y: &mut [f64], factor: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * x;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A polynomial of the degree of the order is continued exactly for any step sizes.
    #[test]
    fn nordsieck_array_represents_polynomial() {
        let at = |t: f64| 1.0 + t * (2.0 + t * (3.0 + 4.0 * t));
        let slope_at = |t: f64| 2.0 + t * (6.0 + 12.0 * t);
        let (h, t) = (0.5, 1.0);
        let mut z = [at(t), h * slope_at(t), h * h * (3.0 + 12.0 * t), h * h * h * 4.0].map(|z| vec![z]);
        rescale(&mut z, 0.4);
        let mut x = [f64::NAN];
        value(&z, 0.25, &mut x);
        assert!((x[0] - at(1.05)).abs() < 1e-12);
        advance(&mut z);
        assert!((z[0][0] - at(1.2)).abs() < 1e-12);
        value(&z, -0.75, &mut x);
        assert!((x[0] - at(1.05)).abs() < 1e-12);
        retreat(&mut z, 0.25);
        assert!((z[0][0] - at(1.05)).abs() < 1e-12);
        assert!((z[1][0] / 0.05 - slope_at(1.05)).abs() < 1e-12);
        assert!((z[3][0] / 0.05_f64.powi(3) - 4.0).abs() < 1e-9);
    }

    /// With the order reduced, the polynomial keeps its value and slope and passes through the remaining
    /// points. With the order increased, it passes through the additional point.
    #[test]
    fn order_changes_drop_or_add_one_point() {
        let at = |t: f64| 1.0 + t * (2.0 + t * (3.0 + 4.0 * t));
        let (h, past) = (0.5, [0.5, 0.3, 0.2]);
        let mut z = [1.0, h * 2.0, h * h * 3.0, h * h * h * 4.0].map(|z| vec![z]);
        lower_bdf(&mut z, h, &past);
        assert_eq!((z[0][0], z[1][0]), (1.0, 2.0 * h));
        let mut x = [f64::NAN];
        value(&z[..3], -past[0] / h, &mut x);
        assert!((x[0] - at(-past[0])).abs() < 1e-14);
    }

    /// With the order of an Adams formula reduced, the slopes at the remaining points are kept. Increased
    /// again by the divided difference of the slopes, the polynomial is the same.
    #[test]
    fn adams_order_changes_drop_or_add_one_slope() {
        let (h, past) = (0.5, [0.5, 0.3, 0.2]);
        let mut z = [1.0, h * 2.0, h * h * 3.0, h * h * h * 4.0].map(|z| vec![z]);
        let whole = z.clone();
        lower_adams(&mut z, h, &past);
        let slope = |z: &[Vec<f64>], s: f64| {
            (1..z.len()).map(|j| j as f64 * z[j][0] * s.powi(j as i32 - 1)).sum::<f64>()
        };
        assert_eq!((z[0][0], z[1][0]), (1.0, 2.0 * h));
        assert!((slope(&z[..3], -past[0] / h) - slope(&whole, -past[0] / h)).abs() < 1e-14);
        raise_adams(&mut z, h, &past, 3.0, &[whole[3][0]]);
        assert!(z.iter().zip(&whole).all(|(a, b)| (a[0] - b[0]).abs() < 1e-14), "{z:?}");
    }
}
