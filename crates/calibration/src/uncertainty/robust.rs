//! Robust statistics: the median, and distances from it.

/// Median absolute deviation of a normal distribution, in standard deviations.
pub(crate) const MEDIAN_DEVIATION: f64 = 0.674_489_750_196_081_7;

/// Returns the median; sorts the values.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

/// Returns a quantile by linear interpolation between the ordered values; sorts the values.
pub(crate) fn quantile(values: &mut [f64], p: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let position = p * (values.len() - 1) as f64;
    let (below, part) = (position.floor() as usize, position.fract());
    let above = (below + 1).min(values.len() - 1);
    values[below] + part * (values[above] - values[below])
}

/// Returns the distances from the median, in robust standard deviations; NaN or infinite if the deviation is
/// zero.
pub(crate) fn distances(r: &[f64]) -> Vec<f64> {
    let center = median(&mut r.to_vec());
    let distances: Vec<f64> = r.iter().map(|r| (r - center).abs()).collect();
    let deviation = median(&mut distances.clone()) / MEDIAN_DEVIATION;
    distances.into_iter().map(|distance| distance / deviation).collect()
}

/// Returns normally distributed numbers, using the Box-Muller method.
#[cfg(test)]
pub(crate) fn normal_numbers(n: usize, state: &mut u64) -> Vec<f64> {
    let mut uniform = || {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((*state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    };
    (0..n).map(|_| (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos()).collect()
}
