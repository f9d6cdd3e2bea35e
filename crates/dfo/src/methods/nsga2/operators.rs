//! Crossover and mutation, as separate functions of working coordinates.

use crate::method_interface::rng::Stream;
use crate::problem::space::Space;
use crate::values::choices::ParameterKind;

/// Probability that simulated binary crossover changes a coordinate, and that the two children exchange it
/// (Deb and Agrawal 1995).
const SHARE: f64 = 0.5;

/// Crosses the coordinates of a pair (simulated binary crossover). The unit of the distribution is the
/// distance between the parents. The distribution of each child ends at the bound on its side; far from the
/// bounds, the mean of the pair is kept.
pub(super) fn cross(stream: &mut Stream, space: &Space, index: f64, first: &mut [f64], second: &mut [f64]) {
    for k in 0..first.len() {
        if !stream.chance(SHARE) {
            continue;
        }
        let (low, high) = (first[k].min(second[k]), first[k].max(second[k]));
        let distance = high - low;
        if space.kind(k) != ParameterKind::Categorical && distance > 0.0 {
            let (lower, upper) = space.working_bounds(k);
            let draw = stream.uniform();
            let middle = 0.5 * low + 0.5 * high;
            let half = |room: f64| 0.5 * distance * spread(draw, index, 1.0 + 2.0 * room / distance);
            first[k] = (middle - half(low - lower)).clamp(lower, upper);
            second[k] = (middle + half(upper - high)).clamp(lower, upper);
        }
        if stream.chance(SHARE) {
            std::mem::swap(&mut first[k], &mut second[k]);
        }
    }
}

/// Returns the spread factor of crossover for a uniform number `draw`: the ratio of the distances of children
/// and of parents, at most `most`.
fn spread(draw: f64, index: f64, most: f64) -> f64 {
    let total = 2.0 - most.powf(-(index + 1.0));
    let share = draw * total;
    let power = if share <= 1.0 { share } else { 1.0 / (2.0 - share) };
    power.powf(1.0 / (index + 1.0)).min(most)
}

/// Mutates each coordinate with a given probability (polynomial mutation). The distribution ends at the
/// bounds.
pub(super) fn mutate(stream: &mut Stream, space: &Space, rate: f64, index: f64, u: &mut [f64]) {
    for (k, u) in u.iter_mut().enumerate() {
        if !stream.chance(rate) {
            continue;
        }
        let (lower, upper) = space.working_bounds(k);
        *u = match space.kind(k) {
            ParameterKind::Categorical => stream.between(lower, upper),
            _ => *u + (upper - lower) * change(stream.uniform(), index, (*u - lower) / (upper - lower)),
        }
        .clamp(lower, upper);
    }
}

/// Returns the change of mutation for a uniform number `draw`, as a fraction of the range. `at` is the
/// position in the range.
fn change(draw: f64, index: f64, at: f64) -> f64 {
    let power = index + 1.0;
    let towards = |share: f64, room: f64| {
        let beyond = (1.0 - room).clamp(0.0, 1.0).powf(power);
        1.0 - (share + (1.0 - share) * beyond).powf(1.0 / power)
    };
    if draw < 0.5 { -towards(2.0 * draw, at) } else { towards(2.0 * (1.0 - draw), 1.0 - at) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method_interface::rng::Purpose;
    use crate::problem::space::Bounds;

    fn space(upper: f64) -> Space {
        Space::new(&[0.5], Bounds::new(&[0.0], &[upper]).unwrap(), &[], &[]).unwrap()
    }

    #[test]
    fn crossover_keeps_the_mean_and_has_the_spread_of_its_distribution() {
        // Far bounds: P(spread <= 1) = 1/2, P(spread <= 1/2) = 1/2 * (1/2)^(index + 1).
        let (n, mut contracting, mut near) = (20_000, 0.0, 0.0);
        for i in 0..n {
            let mut stream = Stream::new(5, Purpose::Individual, 0, i);
            let (mut a, mut b) = ([49.0], [51.0]);
            cross(&mut stream, &space(100.0), 2.0, &mut a, &mut b);
            assert!((a[0] + b[0] - 100.0).abs() < 1e-9);
            let spread = (a[0] - b[0]).abs() / 2.0;
            contracting += f64::from(spread < 1.0);
            near += f64::from(spread < 0.5);
        }
        let shares = [contracting, near].map(|count| count / n as f64);
        // Half of the pairs are not crossed. Three standard deviations of a share are at most 0.01.
        assert!((shares[0] - 0.25).abs() < 0.01 && (shares[1] - 0.5 * 0.0625).abs() < 0.004, "{shares:?}");
    }

    #[test]
    fn crossover_and_mutation_reach_the_bounds_and_stay_inside() {
        for draw in [0.0, 0.3, 0.9999999] {
            let at_most = spread(draw, 0.0, 1.4);
            assert!((0.0..=1.4).contains(&at_most), "{at_most}");
            let change = change(draw, 0.0, 0.2);
            assert!((-0.2..=0.8).contains(&change), "{change}");
        }
        assert!((spread(1.0, 20.0, 1.4) - 1.4).abs() < 1e-12);
        assert!((change(0.0, 20.0, 0.2) + 0.2).abs() < 1e-12 && (change(1.0, 20.0, 0.2) - 0.8).abs() < 1e-12);
        assert!(change(0.5, 20.0, 0.2).abs() < 1e-12);
    }

    #[test]
    fn mutation_changes_coordinates_at_the_given_rate() {
        let mut changed = 0;
        let space = space(1.0);
        for i in 0..10_000 {
            let mut u = [0.25];
            mutate(&mut Stream::new(2, Purpose::Individual, 0, i), &space, 0.2, 20.0, &mut u);
            changed += usize::from(u != [0.25]);
            assert!(space.bounds().contains(&u));
        }
        // Three standard deviations: 3 sqrt(10 000 * 0.2 * 0.8) = 120.
        assert!(changed.abs_diff(2000) < 120, "{changed}");
    }
}
