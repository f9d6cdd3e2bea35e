//! Ranks of points with several criteria: non-dominated fronts, and crowding distances within a front.

use crate::methods::shared::cost::Cost;

/// Points by rank.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ranking {
    /// Indices of the points, best first. Pending points are left out.
    pub(super) order: Vec<usize>,
    /// Number of feasible points that no point dominates. They come first.
    pub(super) n_first: usize,
    /// Crowding distance of each point within its front; 0 for points that are not feasible.
    pub(super) crowding: Vec<f64>,
}

/// Returns the ranking of points with these costs and criteria. Feasible points rank by their front, and
/// within a front by their crowding distance. Infeasible points follow by their violation, then failed ones.
/// Points of equal rank keep their order.
pub(super) fn rank<'a>(costs: &[Cost], criteria: impl Fn(usize) -> &'a [f64]) -> Ranking {
    let feasible: Vec<usize> = (0..costs.len()).filter(|k| costs[*k].value().is_some()).collect();
    let rows: Vec<&[f64]> = feasible.iter().map(|k| criteria(*k)).collect();
    let mut order = Vec::with_capacity(costs.len());
    let (mut n_first, mut crowding) = (0, vec![0.0; costs.len()]);
    for mut front in fronts(&rows) {
        for (k, distance) in front.iter().zip(distances(&rows, &front)) {
            crowding[feasible[*k]] = distance;
        }
        front.iter_mut().for_each(|k| *k = feasible[*k]);
        front.sort_by(|a, b| crowding[*b].total_cmp(&crowding[*a]));
        n_first = if order.is_empty() { front.len() } else { n_first };
        order.append(&mut front);
    }
    let violation =
        |k: &usize| if let Cost::Infeasible(violation) = costs[*k] { Some(violation) } else { None };
    let mut infeasible: Vec<(f64, usize)> =
        (0..costs.len()).filter_map(|k| Some((violation(&k)?, k))).collect();
    infeasible.sort_by(|a, b| a.0.total_cmp(&b.0));
    order.extend(infeasible.into_iter().map(|(_, k)| k));
    order.extend((0..costs.len()).filter(|k| costs[*k] == Cost::Failed));
    Ranking { order, n_first, crowding }
}

/// True if no entry of `a` is larger than in `b`, and at least one is smaller.
pub(super) fn dominates(a: &[f64], b: &[f64]) -> bool {
    a.iter().zip(b).all(|(a, b)| a <= b) && a.iter().zip(b).any(|(a, b)| a < b)
}

/// Returns the fronts of the rows, the non-dominated one first (fast non-dominated sort, section III.A).
fn fronts(rows: &[&[f64]]) -> Vec<Vec<usize>> {
    let mut dominated: Vec<Vec<usize>> = vec![Vec::new(); rows.len()];
    let mut n_above = vec![0usize; rows.len()];
    for i in 0..rows.len() {
        for j in i + 1..rows.len() {
            let (above, below) = match (dominates(rows[i], rows[j]), dominates(rows[j], rows[i])) {
                (true, _) => (i, j),
                (_, true) => (j, i),
                _ => continue,
            };
            dominated[above].push(below);
            n_above[below] += 1;
        }
    }
    let mut fronts = Vec::new();
    let mut front: Vec<usize> = (0..rows.len()).filter(|k| n_above[*k] == 0).collect();
    while !front.is_empty() {
        let mut next = Vec::new();
        for &below in front.iter().flat_map(|k| &dominated[*k]) {
            n_above[below] -= 1;
            if n_above[below] == 0 {
                next.push(below);
            }
        }
        next.sort_unstable();
        fronts.push(std::mem::replace(&mut front, next));
    }
    fronts
}

/// Returns the crowding distance of each member of a front (section III.B): the sum over the criteria of the
/// distance between its neighbours, as a fraction of the range of the front. Infinite at the ends.
fn distances(rows: &[&[f64]], front: &[usize]) -> Vec<f64> {
    let mut distance = vec![0.0; front.len()];
    let n_criteria = front.first().map_or(0, |k| rows[*k].len());
    let mut sorted: Vec<usize> = (0..front.len()).collect();
    for values in (0..n_criteria).map(|m| front.iter().map(|k| rows[*k][m]).collect::<Vec<f64>>()) {
        let value = |k: usize| values[k];
        sorted.sort_by(|a, b| value(*a).total_cmp(&value(*b)).then(a.cmp(b)));
        let [first, .., last] = sorted[..] else {
            distance.fill(f64::INFINITY);
            break;
        };
        let range = value(last) - value(first);
        (distance[first], distance[last]) = (f64::INFINITY, f64::INFINITY);
        if range > 0.0 {
            for near in sorted.windows(3) {
                distance[near[1]] += (value(near[2]) - value(near[0])) / range;
            }
        }
    }
    distance
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rank_orders_fronts_crowding_violations_and_failures() {
        use Cost::{Failed, Infeasible, Pending, Value};
        let rows: [&[f64]; 9] = [
            &[2.0, 2.0], // second front
            &[0.0, 3.0], // end of the first front
            &[],
            &[0.5, 2.0], // (1 - 0) / 3 + (3 - 1.5) / 3
            &[1.0, 1.5], // (3 - 0.5) / 3 + (2 - 0) / 3
            &[],
            &[3.0, 0.0], // end of the first front
            &[],
            &[],
        ];
        let costs = [
            Value(0.0),
            Value(0.0),
            Failed,
            Value(0.0),
            Value(0.0),
            Infeasible(2.0),
            Value(0.0),
            Infeasible(1.0),
            Pending,
        ];
        let ranking = rank(&costs, |k| rows[k]);
        assert_eq!((ranking.order, ranking.n_first), (vec![1, 6, 4, 3, 0, 7, 5, 2], 4));
        let infinite = f64::INFINITY;
        let expected =
            [infinite, infinite, 0.0, 1.0 / 3.0 + 0.5, 2.5 / 3.0 + 2.0 / 3.0, 0.0, infinite, 0.0, 0.0];
        assert!(ranking.crowding.iter().zip(expected).all(|(a, b)| *a == b || (a - b).abs() < 1e-15));
    }

    #[test]
    fn rank_accepts_equal_points_and_no_points() {
        let rows: [&[f64]; 3] = [&[1.0, 1.0]; 3];
        let ranking = rank(&[Cost::Value(0.0); 3], |k| rows[k]);
        assert_eq!((ranking.order, ranking.n_first), (vec![0, 2, 1], 3));
        assert_eq!(rank(&[Cost::Failed], |_| &[]).order, [0]);
    }
}
