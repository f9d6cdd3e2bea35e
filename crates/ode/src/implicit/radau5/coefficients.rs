//! Coefficients of Radau IIA of order 5 and of the transformation that separates its stages.

const SQRT_6: f64 = 2.449_489_742_783_178_098_2;

/// Abscissae of the first two stages; the third is 1.
pub(super) const C1: f64 = (4.0 - SQRT_6) / 10.0;
pub(super) const C2: f64 = (4.0 + SQRT_6) / 10.0;

/// The inverse of the matrix of the method has the real eigenvalue `GAMMA` and the complex pair `ALPHA +- i
/// BETA`.
pub(super) const GAMMA: f64 = 3.637_834_252_744_495_732_2;
pub(super) const ALPHA: f64 = 2.681_082_873_627_752_133_9;
pub(super) const BETA: f64 = 3.050_430_199_247_410_569_4;

/// Columns of `T`: the real eigenvector, and the real and imaginary parts of the complex one (Hairer and
/// Wanner, (IV.8.14)).
pub(super) const T: [[f64; 3]; 3] = [
    [9.123_239_487_089_294_279_2e-2, -0.141_255_295_020_954_208_43, -3.002_919_410_514_742_449_2e-2],
    [0.241_717_932_707_107_018_96, 0.204_129_352_293_799_931_99, 0.382_942_112_757_261_937_79],
    [0.966_048_182_615_092_936_19, 1.0, 0.0],
];
pub(super) const T_INVERSE: [[f64; 3]; 3] = [
    [4.325_579_890_063_155_351_0, 0.339_199_251_815_809_869_54, 0.541_770_539_935_874_871_19],
    [-4.178_718_591_551_904_727_3, -0.327_682_820_761_062_387_08, 0.476_623_554_500_550_451_96],
    [-0.502_872_634_945_786_875_95, 2.571_926_949_855_605_429_2, -0.596_039_204_828_224_924_97],
];

/// Error estimate: `h^-1 (GAMMA^-1 ...)` of the embedded formula of order 3 (Hairer and Wanner, (IV.8.18)):
/// weights of the stages.
pub(super) const E: [f64; 3] = [-(13.0 + 7.0 * SQRT_6) / 3.0, (-13.0 + 7.0 * SQRT_6) / 3.0, -1.0 / 3.0];

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    fn matrix(rows: [[f64; 3]; 3]) -> Matrix3<f64> {
        Matrix3::from_fn(|i, j| rows[i][j])
    }

    /// Computes the matrix of the method from its abscissae: `a_ij` is the integral of the Lagrange
    /// polynomial of `c_j` up to `c_i`.
    fn method() -> Matrix3<f64> {
        let c = [C1, C2, 1.0];
        let powers = Matrix3::from_fn(|i, k| c[i].powi(k as i32));
        let integrals = Matrix3::from_fn(|i, k| c[i].powi(k as i32 + 1) / (k as f64 + 1.0));
        integrals * powers.try_inverse().unwrap()
    }

    #[test]
    fn transformation_splits_inverse_into_two_blocks() {
        let (t, t_inverse) = (matrix(T), matrix(T_INVERSE));
        assert!((t * t_inverse - Matrix3::identity()).amax() < 1e-14);
        let blocks = t_inverse * method().try_inverse().unwrap() * t;
        let expected = Matrix3::new(GAMMA, 0.0, 0.0, 0.0, ALPHA, -BETA, 0.0, BETA, ALPHA);
        assert!((blocks - expected).amax() < 1e-13, "{blocks}");
    }

    #[test]
    fn radau5_coefficients_have_order_five() {
        let (a, c) = (method(), [C1, C2, 1.0]);
        // Simplifying assumptions B(5) and C(3) give order 5 (Hairer, Wanner II, theorem IV.5.1).
        for q in 1..=5 {
            let sum: f64 = (0..3).map(|j| a[(2, j)] * c[j].powi(q - 1)).sum();
            assert!((sum - 1.0 / f64::from(q)).abs() < 1e-15, "B({q}): {sum}");
        }
        // z = A (h f), so the error weights follow from A^-1 and the embedded formula of order 3.
        let e = Matrix3::from_fn(|i, j| if i == 0 { E[j] } else { 0.0 });
        let on_slopes = e * a;
        for q in 0..=2 {
            let sum: f64 = (0..3).map(|j| on_slopes[(0, j)] * c[j].powi(q)).sum();
            assert!((sum + f64::from(q == 0)).abs() < 1e-13, "error of degree {q}: {sum}");
        }
    }
}
