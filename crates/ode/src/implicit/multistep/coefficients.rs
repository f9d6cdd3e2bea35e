//! The coefficients of one step.

/// Highest order of any formula, an Adams formula. Formulae above 12 have an interval of stability
/// below a hundredth.
pub(super) const MAX_ORDER: usize = 12;
/// BDF of order 6 is unstable in most of a sector around the imaginary axis, and higher orders everywhere.
const MAX_BDF_ORDER: usize = 5;

/// The formula of the steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Formula {
    /// Adams-Moulton, of order 1 to 12. The corrector iterates without a matrix.
    Adams,
    /// Backward differentiation, of order 1 to 5. The corrector is Newton's method.
    Bdf,
}

impl Formula {
    pub(super) fn max_order(self) -> usize {
        match self {
            Self::Adams => MAX_ORDER,
            Self::Bdf => MAX_BDF_ORDER,
        }
    }

    /// The order and the step size are changed only if the step can grow by this factor. BDF: VODE. The
    /// coefficients of Adams formulae are exact for any steps.
    pub(super) fn worth_it(self) -> f64 {
        match self {
            Self::Adams => 1.2,
            Self::Bdf => 1.5,
        }
    }
}

/// Coefficients of a polynomial, in ascending powers.
type Polynomial = [f64; MAX_ORDER + 1];

/// The polynomial with the value 1 at zero and a zero at each of the negative `distances`.
fn through(distances: impl Iterator<Item = f64>) -> Polynomial {
    let mut m = [0.0; MAX_ORDER + 1];
    m[0] = 1.0;
    for (degree, distance) in (1..).zip(distances) {
        for i in (1..=degree).rev() {
            m[i] += m[i - 1] / distance;
        }
    }
    m
}

/// Modulus of the integral of `s^power m(s)` from -1 to 0.
fn integral(m: &Polynomial, power: usize) -> f64 {
    let term = |(i, m): (usize, &f64)| (-1f64).powi(i as i32) * m / (i + power + 1) as f64;
    m.iter().enumerate().map(term).sum::<f64>().abs()
}

/// The polynomial `s(s + xi_1) ... (s + xi_k)` of the distances to the last `k` points, in steps, integrated
/// from 0. It is the change of the array if the slope at one more point is used, apart from a factor.
pub(super) fn integral_through(k: usize, h: f64, past: &[f64]) -> [f64; MAX_ORDER + 2] {
    let mut product = [0.0; MAX_ORDER + 2];
    product[1] = 1.0;
    let mut sum = 0.0;
    for (degree, past) in (2..).zip(&past[..k]) {
        sum += past;
        for i in (1..=degree).rev() {
            product[i] = product[i] * (sum / h) + product[i - 1];
        }
    }
    let mut whole = [0.0; MAX_ORDER + 2];
    for (i, v) in whole.iter_mut().enumerate().skip(1) {
        *v = product[i - 1] / i as f64;
    }
    whole
}

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
    pub(super) fn new(formula: Formula, q: usize, h: f64, past: &[f64; MAX_ORDER + 1]) -> Self {
        match formula {
            Formula::Adams => Self::adams(q, h, past),
            Formula::Bdf => Self::bdf(q, h, past),
        }
    }

    /// The slope of the corrector's polynomial agrees with the right-hand side at the last `q` points. The
    /// slope of the predictor's polynomial agrees with it at the `q` points before the end. Their difference,
    /// and the errors of both, are multiples of the divided difference of the slopes over all these points
    /// (E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, section III.5).
    fn adams(q: usize, h: f64, past: &[f64; MAX_ORDER + 1]) -> Self {
        let mut xi = [1.0; MAX_ORDER + 2];
        for j in 2..=q + 1 {
            xi[j] = xi[j - 1] + past[j - 2] / h;
        }
        let m = through(xi[1..q].iter().copied());
        let m0 = integral(&m, 0);
        let mut l = [1.0; MAX_ORDER + 1];
        for i in 1..=q {
            l[i] = m[i - 1] / (i as f64 * m0);
        }
        let here = integral(&m, 1) / (m0 * xi[q]);
        let product = |n: usize| xi[1..=n].iter().product::<f64>();
        let below = if q > 1 {
            q as f64 * product(q - 2) * integral(&through(xi[1..q - 1].iter().copied()), 1)
        } else {
            1.0
        };
        let scale = product(q) * m0;
        let above = if q < MAX_ORDER {
            integral(&through(xi[1..=q].iter().copied()), 1) / (m0 * xi[q + 1])
        } else {
            0.0
        };
        Self { l, below, here, above, scale }
    }

    fn bdf(q: usize, h: f64, past: &[f64; MAX_ORDER + 1]) -> Self {
        let order = q as f64;
        let mut l = [0.0; MAX_ORDER + 1];
        (l[0], l[1]) = (1.0, 1.0);
        // The polynomial l(s) has the roots -1/xi_j of the past points, except one. This one is moved so that
        // the leading coefficient is the same as for equal steps.
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
        for q in 1..=MAX_BDF_ORDER {
            let c = Coefficients::new(Formula::Bdf, q, 0.1, &[0.1; MAX_ORDER + 1]);
            let harmonic: f64 = (1..=q).map(|j| 1.0 / j as f64).sum();
            assert!((c.l[1] - harmonic).abs() < 1e-14, "order {q}: {:?}", c.l);
            assert!((c.here * (q as f64 + 1.0) * harmonic - 1.0).abs() < 1e-14, "order {q}: {}", c.here);
            // l(s) vanishes at the past points except the present one: sum l_j (-1)^j = 0.
            let at_last: f64 = (0..=q).map(|j| c.l[j] * (-1f64).powi(j as i32)).sum();
            assert!(at_last.abs() < 1e-14, "order {q}: {at_last}");
        }
    }

    /// Equal steps give the classical Adams-Moulton formulae: the slopes of order 4.
    #[test]
    fn equal_steps_give_the_classical_adams_formulae() {
        let c = Coefficients::new(Formula::Adams, 4, 0.1, &[0.1; MAX_ORDER + 1]);
        assert!((c.l[1] - 24.0 / 9.0).abs() < 1e-13, "{:?}", c.l);
        // The correction vanishes at the last point, and its slope at the three before the end.
        for s in [-1.0, -2.0, -3.0] {
            let slope: f64 = (1..=4).map(|j| j as f64 * c.l[j] * f64::powi(s, j as i32 - 1)).sum();
            assert!(slope.abs() < 1e-12, "{slope}");
        }
        let at_last: f64 = (0..=4).map(|j| c.l[j] * (-1f64).powi(j as i32)).sum();
        assert!(at_last.abs() < 1e-13, "{at_last}");
    }
}
