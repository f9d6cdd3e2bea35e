//! Positions of the first points: the start, two along each axis, and, if requested, more in the planes
//! between axes.

use crate::problem::space::Space;

/// Returns the available distances from `u` along coordinate `k`, below and above.
fn margins(space: &Space, u: &[f64], k: usize) -> (f64, f64) {
    let (lower, upper) = space.working_bounds(k);
    ((u[k] - lower).max(0.0), (upper - u[k]).max(0.0))
}

/// Returns two displacements of coordinate `k` from `u` with approximately this length. The displacements are
/// on both sides if there is enough space, limited by the bounds. Otherwise both are on the side with more
/// space.
fn pair(space: &Space, u: &[f64], k: usize, length: f64) -> [f64; 2] {
    let (below, above) = margins(space, u, k);
    let (side, near, far) = if above >= below { (1.0, below, above) } else { (-1.0, above, below) };
    if near >= 0.5 * length {
        let (near, far) = (near.min(length), far.min(length));
        return if side > 0.0 { [far, -near] } else { [near, -far] };
    }
    let far = far.min(2.0 * length);
    [side * 0.5 * far, side * far]
}

/// Sets `u` to the point with this index. Index 0 is `centre`. The next n indices are one step along each
/// axis, and the next n the second steps. Pairs of steps follow. `shortened` is the number of failures of the
/// point. After each failure, the point changes sides if the box has space on both sides. After every second
/// failure, starting with the first, the step is halved.
pub(super) fn place(
    space: &Space,
    centre: &[f64],
    number: usize,
    radius: f64,
    shortened: u32,
    u: &mut [f64],
) {
    u.copy_from_slice(centre);
    let n = centre.len();
    let steps: &[(usize, usize)] = &match number {
        0 => return,
        number if number <= 2 * n => [((number - 1) % n, (number - 1) / n), (usize::MAX, 0)],
        number => {
            // Pairs of axes, adjacent axes first.
            let (turn, p) = ((number - 2 * n - 1) / n + 1, (number - 2 * n - 1) % n);
            [(p, 0), ((p + turn) % n, 0)]
        }
    };
    for &(k, which) in steps.iter().filter(|(k, _)| *k < n) {
        let steps = pair(space, centre, k, radius * space.size(k));
        let flipped = shortened % 2 == 1 && steps[0] * steps[1] < 0.0;
        let step = steps[if flipped { 1 - which } else { which }] * 0.5f64.powi(shortened.div_ceil(2) as i32);
        let (lower, upper) = space.working_bounds(k);
        let moved = (centre[k] + step).clamp(lower, upper);
        u[k] = if moved.is_finite() { moved } else { centre[k] };
    }
}
