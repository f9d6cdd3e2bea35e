//! Selection of the sample points that start a search, and clustering of the results of the searches into
//! minima.

use crate::method_interface::interface::Optimum;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::problem::space::Space;

/// Fraction of the sample that is considered (gamma), and sigma of the critical distance, from Rinnooy Kan
/// and Timmer.
const LOOKED_AT: f64 = 0.2;
const SIGMA: f64 = 4.0;

/// Results that differ by less than this fraction of the box in every parameter are one minimum.
const SAME: f64 = 5e-3;

/// Returns the number of points of a sample that are considered.
pub(super) fn n_looked_at(sample: usize) -> usize {
    ((LOOKED_AT * sample as f64).ceil() as usize).clamp(1, sample.max(1))
}

/// Returns the critical distance for a sample size in `n` dimensions, in units of the box.
pub(super) fn critical_distance(n: usize, sample: usize) -> f64 {
    let (n, count) = (n.max(1) as f64, sample.max(2) as f64);
    // Use logarithms, because the gamma function overflows.
    let volume = ln_gamma(1.0 + 0.5 * n) + (SIGMA * count.ln() / count).ln();
    (volume / n).exp() / std::f64::consts::PI.sqrt()
}

/// Returns ln Gamma of a positive multiple of one half.
fn ln_gamma(x: f64) -> f64 {
    let mut at = if x.fract() == 0.0 { 1.0 } else { 0.5 };
    let mut value = if at == 0.5 { 0.5 * std::f64::consts::PI.ln() } else { 0.0 };
    while at < x - 0.25 {
        value += at.ln();
        at += 1.0;
    }
    value
}

/// Returns the distance between two points in units of the box.
fn distance(space: &Space, u: &[f64], v: &[f64]) -> f64 {
    let share = |(k, (u, v)): (usize, (&f64, &f64))| ((u - v) / space.width(k).unwrap_or(1.0)).powi(2);
    u.iter().zip(v).enumerate().map(share).sum::<f64>().sqrt()
}

/// Returns the points that start a search. These are the unused points among the best fifth without a better
/// point within the critical distance. Requires up-to-date ranks.
pub(super) fn starts(space: &Space, sample: &RankedPoints, used: &[bool]) -> Vec<usize> {
    let critical = critical_distance(space.n_free(), sample.len());
    let looked_at = &sample.order()[..n_looked_at(sample.len())];
    let is_start = |rank: usize| {
        let slot = looked_at[rank];
        let near = |other: &usize| distance(space, sample.u(slot), sample.u(*other)) <= critical;
        !used[slot] && sample.cost(slot).is_ranked() && !looked_at[..rank].iter().any(near)
    };
    (0..looked_at.len()).filter(|&rank| is_start(rank)).map(|rank| looked_at[rank]).collect()
}

/// Number of starts that test whether each cluster has one minimum.
const TESTS: usize = 3;

/// Returns points that represent a minimum without a separate search, from the best to the worst considered
/// point. Requires up-to-date ranks.
pub(super) fn tests(sample: &RankedPoints, used: &[bool]) -> Vec<usize> {
    let looked_at = sample.order()[..n_looked_at(sample.len())].iter().copied();
    let left: Vec<usize> = looked_at.filter(|slot| !used[*slot] && sample.cost(*slot).is_ranked()).collect();
    let n = left.len().min(TESTS);
    (0..n).map(|k| left[k * (left.len() - 1) / (n - 1).max(1)]).collect()
}

/// Adds the result of a search to the list of minima, best first.
pub(super) fn enter(space: &Space, minima: &mut Vec<Optimum>, found: Optimum) {
    let (mut u, mut v) = (vec![0.0; space.n_free()], vec![0.0; space.n_free()]);
    space.to_working(&found.x, &mut u);
    let same = minima.iter().position(|minimum| {
        space.to_working(&minimum.x, &mut v);
        (0..u.len()).all(|k| (u[k] - v[k]).abs() <= SAME * space.width(k).unwrap_or(1.0))
    });
    match same {
        Some(k) if found.cost < minima[k].cost => {
            minima[k] = Optimum { n_starts: minima[k].n_starts + found.n_starts, ..found };
        }
        Some(k) => minima[k].n_starts += found.n_starts,
        None => minima.push(found),
    }
    minima.sort_by(|a, b| a.cost.total_cmp(&b.cost));
}

/// True if less than half a minimum is missing after the given number of trials, see the [module](super).
pub(super) fn are_probably_all(minima: usize, trials: usize) -> bool {
    let (w, t) = (minima as f64, trials as f64);
    t > w + 2.0 && w * (t - 1.0) / (t - w - 2.0) < w + 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn critical_distance_matches_the_formula() {
        // n = 2: (sigma ln N / (pi N))^(1/2); n = 3: Gamma(5/2) = 3 sqrt(pi) / 4.
        let expected = (4.0 * 100f64.ln() / (std::f64::consts::PI * 100.0)).sqrt();
        assert!((critical_distance(2, 100) / expected - 1.0).abs() < 1e-12);
        let gamma = 0.75 * std::f64::consts::PI.sqrt();
        let expected = (gamma * 4.0 * 50f64.ln() / 50.0).cbrt() / std::f64::consts::PI.sqrt();
        assert!((critical_distance(3, 50) / expected - 1.0).abs() < 1e-12);
        assert!(critical_distance(1000, 20_000).is_finite());
    }

    #[test]
    fn minima_are_complete_when_expected_number_is_reached() {
        // One minimum in 8 trials: 7 / 5 < 1.5; in 7: 6 / 4 = 1.5.
        assert!(are_probably_all(1, 8) && !are_probably_all(1, 7) && !are_probably_all(5, 7));
    }
}
