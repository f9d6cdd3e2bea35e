//! Sobol' indices: the parts of the variance of a value that parameters cause.
//!
//! The design consists of two samples `A` and `B` of the box, `A_B^j` (`A` with column `j` of `B`) and, for
//! the second order, `B_A^j` (Saltelli, Comput. Phys. Commun. 145, 2002). With the values f at these points,
//! less their mean, and the variance V of f over `A` and `B`:
//!
//! - first order: `S_j = mean(f(B) (f(A_B^j) - f(A))) / V` (Saltelli et al., Comput. Phys. Commun. 181, 2010,
//!   table 2 b);
//! - total order: `ST_j = mean((f(A) - f(A_B^j))^2) / (2 V)` (Jansen, Comput. Phys. Commun. 117, 1999);
//! - second order: `S_jk = mean(f(B_A^j) f(A_B^k) - f(A) f(B)) / V - S_j - S_k` (Saltelli 2002).
//!
//! Both samples are the halves of the coordinates of Sobol points in twice as many dimensions.

use super::bootstrap::Bootstrap;
use crate::error::Error;
use crate::method_interface::sampling::{SOBOL_DIMENSIONS, sobol};
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};

/// Sobol' indices of one value, in the order of the free parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SobolIndices {
    /// First-order indices: the part of the variance that a parameter causes alone.
    pub s1: Vec<f64>,
    /// Half widths of the confidence intervals of `s1`.
    pub s1_conf: Vec<f64>,
    /// Total-order indices: the part of the variance that a parameter causes alone and in interactions.
    pub st: Vec<f64>,
    /// Half widths of the confidence intervals of `st`.
    pub st_conf: Vec<f64>,
    /// Second-order indices, row by row: the part of the variance that the interaction of two parameters
    /// causes. The matrix is symmetric, with NaN on its diagonal. Empty if they were not requested.
    pub s2: Vec<f64>,
    /// Half widths of the confidence intervals of `s2`.
    pub s2_conf: Vec<f64>,
}

/// Returns the number of points of one row of the design: `A`, all `A_B^j`, all `B_A^j`, `B`.
pub(super) fn row_length(d: usize, second_order: bool) -> usize {
    if second_order { 2 * d + 2 } else { d + 2 }
}

/// Returns the points of the design, row by row.
pub(super) fn rows(space: &Space, n: usize, second_order: bool, seed: u64) -> Result<Vec<f64>, Error> {
    let d = space.n_free();
    if 2 * d > SOBOL_DIMENSIONS {
        let range = "at most 20 for Sobol' indices. Fix parameters, or use morris";
        return Err(Error::Option { name: "number of free parameters", value: d as f64, range });
    }
    let mut unit = vec![0.0; n * 2 * d];
    sobol(seed, 2 * d, n, &mut unit)?;
    let mut points = Vec::with_capacity(n * row_length(d, second_order) * space.n());
    let (mut u, mut x) = (vec![0.0; d], vec![0.0; space.n()]);
    for row in unit.chunks_exact(2 * d) {
        let (a, b) = row.split_at(d);
        let mut push = |base: &[f64], other: &[f64], changed: Option<usize>| {
            for (k, u) in u.iter_mut().enumerate() {
                let (lower, upper) = space.working_bounds(k);
                let part = if changed == Some(k) { other[k] } else { base[k] };
                *u = (lower + part * (upper - lower)).clamp(lower, upper);
            }
            space.to_user(&u, &mut x);
            points.extend_from_slice(&x);
        };
        push(a, b, None);
        (0..d).for_each(|k| push(a, b, Some(k)));
        if second_order {
            (0..d).for_each(|k| push(b, a, Some(k)));
        }
        push(b, a, None);
    }
    Ok(points)
}

/// Values at the complete rows of the design, less their mean and divided by the largest of them.
#[derive(Debug)]
struct Rows {
    d: usize,
    length: usize,
    values: Vec<f64>,
}

impl Rows {
    fn n(&self) -> usize {
        self.values.len() / self.length
    }

    fn n_pairs(&self) -> usize {
        if self.length == 2 * self.d + 2 { self.d * (self.d - 1) / 2 } else { 0 }
    }

    /// Computes first order, total order and second order from these rows: `d`, `d` and all pairs `j < k`.
    fn estimate(&self, rows: impl Iterator<Item = usize>, found: &mut [f64]) {
        let d = self.d;
        found.fill(0.0);
        let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for row in rows {
            let row = &self.values[row * self.length..(row + 1) * self.length];
            let (a, b) = (row[0], row[self.length - 1]);
            n += 1.0;
            sum += a + b;
            squares += a * a + b * b;
            for j in 0..d {
                let mixed = row[1 + j];
                found[j] += b * (mixed - a);
                found[d + j] += 0.5 * (a - mixed) * (a - mixed);
            }
            if self.n_pairs() > 0 {
                let mut pairs = found[2 * d..].iter_mut();
                for j in 0..d {
                    for (k, pair) in (j + 1..d).zip(&mut pairs) {
                        *pair += row[1 + d + j] * row[1 + k] - a * b;
                    }
                }
            }
        }
        let mean = sum / (2.0 * n);
        let variance = squares / (2.0 * n) - mean * mean;
        // A resample may consist of equal rows.
        let scale = if variance > 0.0 { 1.0 / (n * variance) } else { f64::NAN };
        found.iter_mut().for_each(|sum| *sum *= scale);
        let (first, rest) = found.split_at_mut(2 * d);
        let mut pairs = rest.iter_mut();
        for j in 0..d {
            for (k, pair) in (j + 1..d).zip(&mut pairs) {
                *pair -= first[j] + first[k];
            }
        }
    }
}

/// Returns the indices of `d` parameters from the values at the complete rows, or `None` if the values are
/// all equal.
pub(super) fn indices(
    values: Vec<f64>,
    d: usize,
    second_order: bool,
    bootstrap: &Bootstrap,
) -> Option<SobolIndices> {
    let first = *values.first()?;
    if values.iter().all(|value| *value == first) {
        return None;
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let largest = values.iter().fold(0.0f64, |largest, value| largest.max((value - mean).abs()));
    let values = values.into_iter().map(|value| (value - mean) / largest).collect();
    let rows = Rows { d, length: row_length(d, second_order), values };
    let n = 2 * d + rows.n_pairs();
    let mut found = vec![0.0; n];
    rows.estimate(0..rows.n(), &mut found);
    let widths = bootstrap.half_widths(rows.n(), n, |resampled, found| {
        rows.estimate(resampled.iter().copied(), found);
    });
    let matrix = |pairs: &[f64]| {
        let mut matrix = vec![f64::NAN; if second_order { d * d } else { 0 }];
        let mut pairs = pairs.iter();
        for j in 0..d {
            for (k, pair) in (j + 1..d).zip(&mut pairs) {
                (matrix[j * d + k], matrix[k * d + j]) = (*pair, *pair);
            }
        }
        matrix
    };
    Some(SobolIndices {
        s1: found[..d].to_vec(),
        s1_conf: widths[..d].to_vec(),
        st: found[d..2 * d].to_vec(),
        st_conf: widths[d..2 * d].to_vec(),
        s2: matrix(&found[2 * d..]),
        s2_conf: matrix(&widths[2 * d..]),
    })
}

impl SobolIndices {
    /// Returns NaN indices of a value without variance.
    pub(super) fn undefined(d: usize, second_order: bool) -> Self {
        let (nan, matrix) = (vec![f64::NAN; d], vec![f64::NAN; if second_order { d * d } else { 0 }]);
        Self {
            s1: nan.clone(),
            s1_conf: nan.clone(),
            st: nan.clone(),
            st_conf: nan,
            s2: matrix.clone(),
            s2_conf: matrix,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values at 16 rows for three parameters, from 0 to 1 in no order.
    fn values(length: usize) -> Vec<f64> {
        (1..=16 * length as u64).map(|i| (i * i * 7919 % 10_007) as f64 / 10_007.0).collect()
    }

    const BOOTSTRAP: Bootstrap = Bootstrap { level: 0.95, n_resamples: 200_000, seed: 1 };

    fn assert_close(found: &[f64], expected: &[f64], tolerance: f64) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() <= tolerance, "{found} instead of {expected}");
        }
    }

    /// The references come from `SALib.analyze.sobol.analyze` of SALib 1.6.0 with `num_resamples=200000`. The
    /// half widths of both have a standard error of 0.16 % (1 / sqrt(2 n) of a standard deviation from n
    /// draws).
    #[test]
    fn sobol_indices_equal_those_of_salib() {
        let found = indices(values(8), 3, true, &BOOTSTRAP).unwrap();
        assert_close(&found.s1, &[-0.311284793767198, -0.185738518761945, -0.1805134953820172], 1e-14);
        assert_close(&found.st, &[1.1816109510668964, 1.045990518491352, 2.056480623777177], 1e-14);
        let pairs = |matrix: &[f64]| [matrix[1], matrix[2], matrix[5]];
        let expected = [0.15388501387408457, 0.6425436871426237, 0.2535998969541971];
        assert_close(&pairs(&found.s2), &expected, 1e-14);
        assert!(found.s2[0].is_nan() && found.s2[3] == found.s2[1] && found.s2[7] == found.s2[5]);
        let widths = [
            (found.s1_conf, [0.8167532597980326, 0.5491248943944599, 0.8942268902546697]),
            (found.st_conf, [0.7528679045697254, 0.6149761009632803, 1.1136356630134268]),
            (pairs(&found.s2_conf).to_vec(), [0.6901761954381542, 1.0525064315287918, 1.1476261259250178]),
        ];
        for (found, expected) in widths {
            for (found, expected) in found.iter().zip(expected) {
                // Five standard errors of the difference.
                let tolerance = 5.0 * 0.0016 * 2f64.sqrt() * expected;
                assert!((found - expected).abs() < tolerance, "{found} instead of {expected}");
            }
        }
        let found = indices(values(5), 3, false, &Bootstrap { n_resamples: 2, ..BOOTSTRAP }).unwrap();
        assert_close(&found.s1, &[-0.35303467871457095, -0.184835727992308, 0.6291726337734547], 1e-14);
        assert_close(&found.st, &[1.463589199228715, 0.9419403220684809, 0.789382539481282], 1e-14);
        assert!(found.s2.is_empty() && found.s2_conf.is_empty());
    }

    #[test]
    fn sobol_indices_do_not_depend_on_offset_and_scale_of_the_values() {
        let bootstrap = Bootstrap { n_resamples: 100, ..BOOTSTRAP };
        let found = indices(values(5), 3, false, &bootstrap).unwrap();
        for scale in [1e-200, 1e200] {
            let scaled = values(5).iter().map(|value| scale * (value + 2.0)).collect();
            let scaled = indices(scaled, 3, false, &bootstrap).unwrap();
            assert_close(&scaled.s1, &found.s1, 1e-13);
            assert_close(&scaled.st_conf, &found.st_conf, 1e-13);
        }
    }
}
