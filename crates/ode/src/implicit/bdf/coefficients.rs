//! The coefficients of one step of BDF.

pub(super) const MAX_ORDER: usize = 5;

/// Coefficients of one step, computed from its size, its order and the sizes of the previous steps.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Coefficients {
    /// Factors of the correction for each row of the array.
    pub(super) l: [f64; MAX_ORDER + 1],
    /// Error constants: of the next lower order (times `z_q`), of this order (times `e`), of the next higher
    /// order.
    pub(super) below: f64,
    pub(super) here: f64,
    pub(super) above: f64,
    /// Constant that makes differences of `e` comparable between steps of different sizes.
    pub(super) scale: f64,
}

impl Coefficients {
    /// Computes the coefficients for order `q` and step `h` after steps `past[0]` (the last one), `past[1]`,
    /// ...
    pub(super) fn new(q: usize, h: f64, past: &[f64; MAX_ORDER + 1]) -> Self {
        let order = q as f64;
        let mut l = [0.0; MAX_ORDER + 1];
        (l[0], l[1]) = (1.0, 1.0);
        // The polynomial l(s) has the roots -1/xi_j of the past points, except one. This one is moved so that
        // the leading coefficient is that of equal steps.
        let (mut alpha, mut alpha_hat) = (-1.0, -1.0);
        let (mut xi, mut xi_fixed) = (1.0, 1.0);
        let mut sum = h;
        if q > 1 {
            for j in 2..q {
                sum += past[j - 2];
                xi = h / sum;
                alpha -= 1.0 / j as f64;
                for i in (1..=j).rev() {
                    l[i] += l[i - 1] * xi;
                }
            }
            alpha -= 1.0 / order;
            xi_fixed = -l[1] - alpha;
            sum += past[q - 2];
            xi = h / sum;
            alpha_hat = -l[1] - xi;
            for i in (1..=q).rev() {
                l[i] += l[i - 1] * xi_fixed;
            }
        }
        let a1 = 1.0 - alpha_hat + alpha;
        let a2 = 1.0 + order * a1;
        let here = (a1 / (alpha * a2)).abs();
        let scale = (a2 * xi_fixed / (l[q] * xi)).abs();
        let below = if q > 1 {
            let c = xi_fixed / l[q];
            let (a3, a4) = (alpha + 1.0 / order, alpha_hat + xi);
            (c * (1.0 - a4 + a3) / a3).abs()
        } else {
            1.0
        };
        sum += past[q - 1];
        let xi = h / sum;
        let (a5, a6) = (alpha - 1.0 / (order + 1.0), alpha_hat - xi);
        let above = ((1.0 - a6 + a5) / a2 / (xi * (order + 2.0) * a5)).abs();
        Self { l, below, here, above, scale }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Equal steps give the classical formulae: `l_1` is the harmonic number, and the error is `e / ((q + 1)
    /// l_1)`.
    #[test]
    fn equal_steps_give_the_classical_formulae() {
        for q in 1..=MAX_ORDER {
            let c = Coefficients::new(q, 0.1, &[0.1; MAX_ORDER + 1]);
            let harmonic: f64 = (1..=q).map(|j| 1.0 / j as f64).sum();
            assert!((c.l[1] - harmonic).abs() < 1e-14, "order {q}: {:?}", c.l);
            assert!((c.here * (q as f64 + 1.0) * harmonic - 1.0).abs() < 1e-14, "order {q}: {}", c.here);
            // l(s) vanishes at the past points except the present one: sum l_j (-1)^j = 0.
            let at_last: f64 = (0..=q).map(|j| c.l[j] * (-1f64).powi(j as i32)).sum();
            assert!(at_last.abs() < 1e-14, "order {q}: {at_last}");
        }
    }
}
