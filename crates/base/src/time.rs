//! Tolerance for comparing times.

/// Returns the largest difference between two numbers that represent the same time, in a span from `start` to
/// `end`: `100 u max(|start|, |end|, |end - start|)`, where `u` is the unit round-off. All comparisons of
/// times use this rule: events, inputs, clock ticks, rows and the end of a run. The resolution of a time
/// decreases with its magnitude: 2e-7 s for seconds since 1970.
///
/// ```
/// let (a, b) = (0.1 + 0.2, 0.3_f64);
/// assert!(a != b && (a - b).abs() <= base::time_tolerance(0.0, b));
/// ```
pub fn time_tolerance(start: f64, end: f64) -> f64 {
    const U: f64 = f64::EPSILON / 2.0;
    100.0 * U * start.abs().max(end.abs()).max((end - start).abs())
}
