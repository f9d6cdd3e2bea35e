//! When two times are one.

/// Times of a span that are not farther apart than this are one: `100 u max(|start|, |end|, |end - start|)`,
/// `u` being the unit round-off. Everything that compares times of a run does it by this rule: events,
/// inputs, ticks of clocks, requested rows, the end.
///
/// ```
/// let tolerance = ode::time_tolerance(0.0, 10.0);
/// assert!((0.1 + 0.2 - 0.3_f64).abs() < tolerance && tolerance < 1e-12);
/// ```
pub fn time_tolerance(start: f64, end: f64) -> f64 {
    const U: f64 = f64::EPSILON / 2.0;
    100.0 * U * start.abs().max(end.abs()).max((end - start).abs())
}
