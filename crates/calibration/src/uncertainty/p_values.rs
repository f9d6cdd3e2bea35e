//! Chances of what the residuals of an output show, if they are independent and normally distributed: of
//! their autocorrelation, and of their distances from the median.

use nalgebra::{DMatrix, DMatrixView, DVector};
use statrs::distribution::{Beta, Binomial, Continuous, ContinuousCDF, DiscreteCDF, Normal};

/// The median absolute deviation of normally distributed numbers is this part of their standard deviation.
pub(crate) const MEDIAN_DEVIATION: f64 = 0.674_489_750_196_081_7;

/// What is less likely than this is no chance: once in a thousand outputs it is one.
pub(crate) const BY_CHANCE: f64 = 1e-3;

/// Beyond so many residuals an autocorrelation that matters is no chance: 0.3 is three standard deviations,
/// and what a fit takes of it is little.
const FEW: usize = 100;

/// With fewer degrees of freedom residuals show nothing but the fit.
const FEWEST_DEGREES: f64 = 3.0;

/// The covariance of the residuals of an output that independent errors leave, over their variance.
pub(crate) struct OfIndependent {
    /// Its root; `None` for many residuals.
    root: Option<DMatrix<f64>>,
}

impl OfIndependent {
    /// True for so many residuals that it is not needed.
    pub(crate) fn is_of_many(n: usize) -> bool {
        n > FEW
    }

    /// That of n residuals without a fit.
    pub(crate) fn without_fit(n: usize) -> Self {
        Self { root: (n <= FEW).then(|| DMatrix::identity(n, n)) }
    }

    /// Of residuals `r = (I - U U') e`: the block `s^2 I - 2 s^2 U_k U_k' + U_k (U'S U) U_k'` of an output.
    /// `rows`: U_k, n x q; `middle`: U'S U over s^2.
    pub(crate) fn of_fit(rows: DMatrixView<'_, f64>, middle: &DMatrix<f64>) -> Self {
        let n = rows.nrows();
        let root = || {
            let inner = middle - DMatrix::identity(rows.ncols(), rows.ncols()) * 2.0;
            let mut axes = (DMatrix::identity(n, n) + rows * inner * rows.transpose()).symmetric_eigen();
            axes.eigenvalues.iter_mut().for_each(|value| *value = value.max(0.0).sqrt());
            axes.recompose()
        };
        Self { root: (n <= FEW && middle.iter().all(|m| m.is_finite())).then(root) }
    }

    /// The chance that the ratio of the mean squared step between neighbours to the variance (von Neumann,
    /// Ann. Math. Statist. 12, 1941) is as small as that of these residuals or smaller, and the
    /// autocorrelation that the ratio shows: one less the ratio over that of independent residuals, from
    /// which the fit has taken some. `None` for many residuals, and where the fit leaves too few.
    ///
    /// As the ratio of Durbin and Watson (Biometrika 37, 1950) it is below c where a quadratic form of normal
    /// errors is negative; its distribution by the saddlepoint (Kuonen, Biometrika 86, 1999).
    pub(crate) fn autocorrelation(&self, r: &[f64]) -> Option<(f64, f64)> {
        let (root, n) = (self.root.as_ref()?, r.len());
        let about_mean = root - DMatrix::from_fn(n, n, |_, j| root.column(j).sum() / n as f64);
        let steps = DMatrix::from_fn(n.saturating_sub(1), n, |i, j| root[(i + 1, j)] - root[(i, j)]);
        let degrees = about_mean.norm_squared();
        if degrees < FEWEST_DEGREES {
            return None;
        }
        let mean = r.iter().sum::<f64>() / n as f64;
        let squares: f64 = r.iter().map(|r| (r - mean) * (r - mean)).sum();
        let ratio = r.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>() / squares;
        if !ratio.is_finite() {
            return None;
        }
        let form = steps.tr_mul(&steps) - about_mean.tr_mul(&about_mean) * ratio;
        let shown = 1.0 - ratio * degrees / steps.norm_squared();
        Some((chance_below_zero(&form.symmetric_eigenvalues()), shown))
    }
}

/// The chance that the sum of squares of independent normal numbers times these factors is below zero, by the
/// saddlepoint in the form of Barndorff-Nielsen (Kuonen, Biometrika 86, 1999, equation 2).
fn chance_below_zero(factors: &DVector<f64>) -> f64 {
    let (least, most) = (factors.min(), factors.max());
    if least >= 0.0 || most <= 0.0 {
        return if most <= 0.0 { 1.0 } else { 0.0 };
    }
    let part = |t: f64, factor: f64| factor / (1.0 - 2.0 * t * factor);
    let slope = |t: f64| factors.iter().map(|factor| part(t, *factor)).sum::<f64>();
    let (mut low, mut high) = (0.5 / least, 0.5 / most);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if slope(middle) > 0.0 { high = middle } else { low = middle }
    }
    let t = 0.5 * (low + high);
    let cumulants = -0.5 * factors.iter().map(|factor| (1.0 - 2.0 * t * factor).ln()).sum::<f64>();
    let curvature = 2.0 * factors.iter().map(|factor| part(t, *factor).powi(2)).sum::<f64>();
    let w = t.signum() * (-2.0 * cumulants).max(0.0).sqrt();
    let v = t * curvature.sqrt();
    // At the mean of the sum the form is 0 / 0.
    if w.abs() < 1e-4 { 0.5 } else { Normal::standard().cdf(w + (v / w).ln() / w) }
}

/// The chance that so many of n residuals or more lie beyond a number of robust standard deviations from
/// their median. Of distances from the middle of a normal distribution the part `u` below their median has
/// the beta distribution of an order statistic, and those above it are independent, given the median.
/// `effective`: as many independent residuals tell the median as well.
pub(crate) fn chance_of_outliers(n: usize, limit: f64, count: usize) -> f64 {
    let shape = 0.5 * (n as f64 + 1.0);
    let above = (n as u64 - 1) / 2;
    let (Ok(beta), normal) = (Beta::new(shape, shape), Normal::standard()) else { return 1.0 };
    let Some(before) = (count as u64).checked_sub(1) else { return 1.0 };
    // Midpoints on the logarithmic scale `ln(u / (1 - u))`, over twelve standard deviations to both sides.
    let (half, scale) = (200_i32, 2.0 / (n.max(1) as f64).sqrt());
    let step = 12.0 * scale / f64::from(half);
    let at = |k: i32| {
        let u = 1.0 / (1.0 + (-step * f64::from(k)).exp());
        let middle = normal.inverse_cdf(0.5 + 0.5 * u);
        let beyond = 2.0 * normal.sf(limit * middle / MEDIAN_DEVIATION) / (1.0 - u);
        let tail = Binomial::new(beyond.clamp(0.0, 1.0), above).map_or(1.0, |b| b.sf(before));
        let weight = beta.pdf(u) * u * (1.0 - u) * step;
        if weight > 0.0 { weight * tail } else { 0.0 }
    };
    (-half..=half).map(at).sum::<f64>().min(1.0)
}

/// The values are sorted.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

/// Distances from the median, in robust standard deviations; NaN or infinite where these are zero.
pub(crate) fn distances(r: &[f64]) -> Vec<f64> {
    let center = median(&mut r.to_vec());
    let distances: Vec<f64> = r.iter().map(|r| (r - center).abs()).collect();
    let deviation = median(&mut distances.clone()) / MEDIAN_DEVIATION;
    distances.into_iter().map(|distance| distance / deviation).collect()
}

/// Normally distributed numbers, by the method of Box and Muller.
#[cfg(test)]
pub(crate) fn normal_numbers(n: usize, state: &mut u64) -> Vec<f64> {
    let mut uniform = || {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((*state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    };
    (0..n).map(|_| (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_autocorrelation_has_the_chance_that_it_has_after_a_fit() {
        // Two outputs of twelve, the second three times as noisy, and a fit of four parameters to both.
        let (n, q, mut state) = (12, 4, 1);
        let base = DMatrix::from_fn(2 * n, q, |i, j| ((i % n) as f64 + 1.0).powi(j as i32) + (i / n) as f64);
        let base = base.qr().q();
        let variance = |i: usize| if i < n { 1.0 } else { 9.0 };
        let weighted = DMatrix::from_fn(2 * n, q, |i, j| variance(i) * base[(i, j)]);
        let independent = OfIndependent::of_fit(base.rows(0, n), &base.tr_mul(&weighted));
        let chance = |lasts: f64, state: &mut u64| {
            let mut errors = normal_numbers(2 * n, state);
            (1..2 * n).for_each(|i| errors[i] += lasts * errors[i - 1]);
            let errors = DVector::from_fn(2 * n, |i, _| variance(i).sqrt() * errors[i]);
            let left = &errors - &base * base.tr_mul(&errors);
            independent.autocorrelation(&left.as_slice()[..n]).unwrap().0
        };
        let chances: Vec<f64> = (0..4000).map(|_| chance(0.0, &mut state)).collect();
        for (level, slack) in [(0.5, 0.03), (0.05, 0.012), (0.01, 0.006), (BY_CHANCE, 0.002)] {
            let share = chances.iter().filter(|chance| **chance < level).count() as f64 / 4000.0;
            assert!((share - level).abs() < slack, "{level}: {share}");
        }
        // That of the residuals themselves, without regard to the fit, is hardly ever small.
        let lasting = (0..400).filter(|_| chance(0.95, &mut state) < 0.05).count();
        assert!(lasting > 60, "{lasting}");
    }

    #[test]
    fn the_chance_of_outliers_is_that_of_normal_numbers() {
        let mut state = 2;
        for n in [20, 25, 60, 100] {
            let (limit, mut beyond) = (5.0, [0.0; 2]);
            for _ in 0..4000 {
                let r = normal_numbers(n, &mut state);
                let distance = distances(&r);
                let count = distance.iter().filter(|d| **d > limit).count();
                beyond.iter_mut().enumerate().for_each(|(k, sum)| *sum += f64::from(u8::from(count > k)));
            }
            for (k, found) in beyond.iter().enumerate() {
                let (share, expected) = (found / 4000.0, chance_of_outliers(n, limit, k + 1));
                let slack = 4.0 * (expected / 4000.0).sqrt() + 0.2 * expected + 1e-3;
                assert!((share - expected).abs() < slack, "{n}: {share}, {expected}");
            }
        }
    }
}
