//! Mutation, crossover and repair, as separate functions of given indices and random draws.

use super::options::{Crossover, Repair, Strategy};
use crate::method_interface::rng::Stream;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::problem::space::Space;
use crate::problem::space::fold;

/// Fills `out` with different numbers from `0..n`, none of them `target`.
pub(super) fn different(stream: &mut Stream, n: usize, target: usize, out: &mut [usize]) {
    for k in 0..out.len() {
        loop {
            let candidate = stream.below(n);
            if candidate != target && !out[..k].contains(&candidate) {
                out[k] = candidate;
                break;
            }
        }
    }
}

/// Computes the donor vector of a target.
pub(super) fn donor(
    strategy: Strategy,
    population: &RankedPoints,
    target: usize,
    best: usize,
    r: &[usize],
    weight: f64,
    out: &mut [f64],
) {
    for (k, v) in out.iter_mut().enumerate() {
        let x = |slot: usize| population.u(slot)[k];
        *v = match strategy {
            Strategy::Rand1 => x(r[0]) + weight * (x(r[1]) - x(r[2])),
            Strategy::Best1 => x(best) + weight * (x(r[0]) - x(r[1])),
            Strategy::CurrentToBest1 => {
                x(target) + weight * (x(best) - x(target)) + weight * (x(r[0]) - x(r[1]))
            }
            Strategy::Rand2 => x(r[0]) + weight * (x(r[1]) - x(r[2])) + weight * (x(r[3]) - x(r[4])),
        };
    }
}

/// Converts the donor to the trial. Coordinates not selected by crossover are copied from the target.
pub(super) fn cross(
    crossover: Crossover,
    stream: &mut Stream,
    probability: f64,
    target: &[f64],
    trial: &mut [f64],
) {
    let n = trial.len();
    let first = stream.below(n);
    match crossover {
        Crossover::Binomial => {
            for k in 0..n {
                // Draw for every coordinate, so that draws do not depend on other coordinates.
                let from_donor = stream.chance(probability);
                if !from_donor && k != first {
                    trial[k] = target[k];
                }
            }
        }
        Crossover::Exponential => {
            let mut length = 1;
            while length < n && stream.chance(probability) {
                length += 1;
            }
            for offset in length..n {
                let k = (first + offset) % n;
                trial[k] = target[k];
            }
        }
    }
}

/// Moves a trial into the box.
pub(super) fn repair(repair: Repair, stream: &mut Stream, space: &Space, target: &[f64], trial: &mut [f64]) {
    for (k, u) in trial.iter_mut().enumerate() {
        let (lower, upper) = space.working_bounds(k);
        if lower <= *u && *u <= upper {
            continue;
        }
        let bound = if *u < lower { lower } else { upper };
        *u = match repair {
            // A coordinate that is not finite keeps the value of the target.
            _ if !u.is_finite() => target[k],
            Repair::Midpoint => (0.5 * bound + 0.5 * target[k]).clamp(lower, upper),
            Repair::Mirror => fold(*u, lower, upper, target[k]),
            Repair::Clamp => bound,
            Repair::Resample => stream.between(lower, upper).clamp(lower, upper),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method_interface::rng::Purpose;
    use crate::problem::space::Bounds;

    fn space() -> Space {
        Space::new(&[0.5; 2], Bounds::new(&[0.0; 2], &[10.0; 2]).unwrap(), &[], &[]).unwrap()
    }

    /// Members (0, 0), (1, 2), (2, 4), ... , (5, 10).
    fn population() -> RankedPoints {
        let mut p = RankedPoints::new(&space(), 6);
        (0..6).for_each(|i| p.place(i, &[i as f64, 2.0 * i as f64], &space()));
        p
    }

    #[test]
    fn donor_matches_the_formula_of_each_strategy() {
        for (strategy, r, expected) in [
            // x_1 + 0.5 (x_5 - x_3)
            (Strategy::Rand1, &[1, 5, 3][..], [2.0, 4.0]),
            // x_4 + 0.5 (x_1 - x_5)
            (Strategy::Best1, &[1, 5], [2.0, 4.0]),
            // x_0 + 0.5 (x_4 - x_0) + 0.5 (x_1 - x_5)
            (Strategy::CurrentToBest1, &[1, 5], [0.0, 0.0]),
            // x_1 + 0.5 (x_5 - x_3) + 0.5 (x_4 - x_2)
            (Strategy::Rand2, &[1, 5, 3, 4, 2], [3.0, 6.0]),
        ] {
            let mut v = [0.0; 2];
            donor(strategy, &population(), 0, 4, r, 0.5, &mut v);
            assert_eq!((v, r.len()), (expected, strategy.n_drawn()), "{strategy:?}");
        }
    }

    #[test]
    fn drawn_members_differ_from_each_other_and_from_the_target() {
        let mut stream = Stream::new(1, Purpose::Individual, 0, 0);
        let mut counts = [0; 6];
        for _ in 0..6000 {
            let mut r = [0; 5];
            different(&mut stream, 6, 2, &mut r);
            counts[r[0]] += 1;
            r.sort_unstable();
            assert_eq!(r, [0, 1, 3, 4, 5]);
        }
        // Each of the five is first with probability 1/5: 1200 +- 3 * 31.
        assert!(counts[2] == 0 && [0, 1, 3, 4, 5].iter().all(|i| (1107..=1293).contains(&counts[*i])));
    }

    /// Returns the mean number of coordinates taken from the donor, out of 8.
    fn taken(crossover: Crossover, probability: f64) -> f64 {
        let mut total = 0.0;
        for i in 0..4000 {
            let mut trial = [1.0; 8];
            let mut stream = Stream::new(5, Purpose::Individual, 0, i);
            cross(crossover, &mut stream, probability, &[0.0; 8], &mut trial);
            let from_donor: f64 = trial.iter().sum();
            assert!(from_donor >= 1.0);
            if crossover == Crossover::Exponential {
                // One contiguous run: a target coordinate follows a donor coordinate at most once.
                let ends = (0..8).filter(|&k| trial[k] == 1.0 && trial[(k + 1) % 8] == 0.0).count();
                assert!(ends <= 1, "{trial:?}");
            }
            total += from_donor;
        }
        total / 4000.0
    }

    #[test]
    fn crossover_takes_expected_share_of_the_donor() {
        // Binomial: 1 + 7 P; exponential: (1 - P^8) / (1 - P). Three standard deviations of the mean.
        assert!((taken(Crossover::Binomial, 0.3) - 3.1).abs() < 3.0 * (7.0 * 0.21f64 / 4000.0).sqrt());
        assert!((taken(Crossover::Exponential, 0.5) - 1.992).abs() < 0.07);
        assert_eq!((taken(Crossover::Binomial, 0.0), taken(Crossover::Exponential, 0.0)), (1.0, 1.0));
        assert_eq!((taken(Crossover::Binomial, 1.0), taken(Crossover::Exponential, 1.0)), (8.0, 8.0));
    }

    #[test]
    fn repaired_points_are_in_the_box() {
        let target = [1.0, 9.0];
        for (how, expected) in
            [(Repair::Midpoint, [0.5, 9.5]), (Repair::Mirror, [3.0, 8.0]), (Repair::Clamp, [0.0, 10.0])]
        {
            let mut trial = [-3.0, 12.0];
            let mut stream = Stream::new(1, Purpose::Individual, 0, 0);
            repair(how, &mut stream, &space(), &target, &mut trial);
            assert_eq!(trial, expected, "{how:?}");
            for bad in [f64::NAN, f64::INFINITY, -1e308, 1e308] {
                let mut trial = [bad, bad];
                repair(how, &mut stream, &space(), &target, &mut trial);
                assert!(trial.iter().all(|u| (0.0..=10.0).contains(u)), "{how:?} {bad} {trial:?}");
            }
        }
    }
}
