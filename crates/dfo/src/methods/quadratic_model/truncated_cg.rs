//! Step of a quadratic model of many parameters within a ball and a box, by conjugate gradients with O(n^2)
//! operations each.

use super::subproblem::Region;
use crate::methods::shared::dot::dot;

/// Relative limit for the end of the search. The search ends if a step gains less than this fraction of the
/// decrease so far. It also ends if the gradient is this small relative to the first one (Powell, report
/// DAMTP 2004/NA08, section 5).
const LITTLE: f64 = 0.01;

/// Returns a step in the region at which the model is small (Steihaug, SIAM J. Numer. Anal. 20, 1983). If the
/// step reaches a bound, the coordinate is fixed there and the search restarts with the others. `product`
/// returns the product of the Hessian with a vector.
pub(super) fn minimize(
    product: impl Fn(&[f64]) -> Vec<f64>,
    gradient: &[f64],
    Region { radius, lower, upper }: Region<'_>,
) -> Vec<f64> {
    let n = gradient.len();
    let (mut s, mut slope) = (vec![0.0; n], gradient.to_vec());
    let blocked = |k: usize, g: f64| (lower[k] >= 0.0 && g >= 0.0) || (upper[k] <= 0.0 && g <= 0.0);
    let mut free: Vec<bool> = (0..n).map(|k| !blocked(k, gradient[k])).collect();
    let (mut gained, mut first) = (0.0, None);
    for _ in 0..n {
        let mut direction = vec![0.0; n];
        let mut before = f64::INFINITY;
        // Continue until a bound is reached.
        loop {
            let rest: Vec<f64> =
                slope.iter().zip(&free).map(|(g, free)| if *free { -g } else { 0.0 }).collect();
            let squared = dot(&rest, &rest);
            let least = LITTLE * LITTLE * *first.get_or_insert(squared);
            if !(squared > least && squared.is_finite()) {
                return s;
            }
            let share = squared / before;
            direction.iter_mut().zip(&rest).for_each(|(d, r)| *d = share * *d + r);
            before = squared;
            let bent = product(&direction);
            let (curvature, along) = (dot(&direction, &bent), -dot(&slope, &direction));
            let (a, b, c) = (dot(&direction, &direction), dot(&s, &direction), radius * radius - dot(&s, &s));
            // Distance to the boundary of the ball, computed without cancellation.
            let root = (b * b + a * c.max(0.0)).sqrt();
            let ball = if b > 0.0 { c.max(0.0) / (b + root) } else { (root - b) / a };
            let bound = |k: usize| match direction[k] {
                d if d > 0.0 => (upper[k] - s[k]) / d,
                d if d < 0.0 => (lower[k] - s[k]) / d,
                _ => f64::INFINITY,
            };
            let (met, box_end) = (0..n).filter(|&k| free[k]).map(|k| (k, bound(k).max(0.0))).fold(
                (None, f64::INFINITY),
                |least, (k, end)| if end < least.1 { (Some(k), end) } else { least },
            );
            let minimum = if curvature > 0.0 { along / curvature } else { f64::INFINITY };
            let length = minimum.min(ball).min(box_end);
            if !(length.is_finite() && along > 0.0) {
                return s;
            }
            for k in 0..n {
                s[k] = (s[k] + length * direction[k]).clamp(lower[k], upper[k]);
                slope[k] += length * bent[k];
            }
            let gain = length * (along - 0.5 * length * curvature);
            gained += gain;
            match met.filter(|_| length == box_end && box_end < ball) {
                Some(k) => {
                    s[k] = if direction[k] > 0.0 { upper[k] } else { lower[k] };
                    free[k] = false;
                    break;
                }
                None if length == ball || gain <= LITTLE * gained => return s,
                None => {}
            }
        }
    }
    s
}
