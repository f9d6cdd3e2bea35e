//! Points that the path may need after the current one, most probable first.
//!
//! The result of an iteration is known only after its costs. However, only a few simplices are likely to
//! follow, and their points can be computed. For example, an accepted reflection replaces the worst vertex,
//! and the current second worst vertex becomes the worst. If the costs of its points are known, they
//! determine the next simplex. Otherwise, its probability follows from counted frequencies. The guesses are
//! expanded best first, over as many iterations as the requested number of points requires.

use super::options::CoefficientValues;
use super::trial::{Frame, Seen, Trial, TrialPoint};
use crate::methods::shared::ranked_points::RankedPoints;
use crate::problem::space::Space;
use crate::values::choices::BoundsHandling;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Frequencies of accepted reflections, expansions, inside contractions and outside contractions after a
/// reflection, and of accepted expansions. Counted on the 53 problems of Moré and Wild (SIAM J. Optim. 20,
/// 2009).
const ACCEPTED: f64 = 0.50;
const EXPANDING: f64 = 0.23;
const INSIDE: f64 = 0.24;
const OUTSIDE: f64 = 0.04;
const EXPANDED: f64 = 0.11 / 0.23;
/// Frequency of contracted points that are not the worst vertex of the new simplex.
const BETTER_THAN_WORST: f64 = 0.8;

/// Minimum probability of a point that is worth evaluating, for any requested number. With 1000 workers, a
/// quarter of this value gains nothing (benches/scaling.md) and the search takes five times as long.
const LEAST_PROBABILITY: f64 = 1.0 / 256.0;

/// The simplex and the data required for its trial points.
pub(super) struct Problem<'a> {
    pub(super) space: &'a Space,
    pub(super) handling: BoundsHandling,
    pub(super) numbers: &'a CoefficientValues,
    pub(super) simplex: &'a RankedPoints,
    pub(super) available_cost: &'a dyn Fn(&[f64]) -> AvailableCost,
}

/// Knowledge about a point that the path has not reached.
pub(super) enum AvailableCost {
    Nothing,
    /// The point needs no further evaluation. The cost is infinite if it is only known to be high.
    Cost(f64),
    /// The point needs no further evaluation, but its cost is not available here.
    Hidden,
}

/// A possible future simplex: its parent with one vertex replaced.
#[derive(Debug, Clone, Copy)]
struct Node {
    parent: usize,
    /// Slot of the replaced vertex, and index of the point that replaces it; `None` for the current simplex.
    replaced: Option<(usize, usize)>,
    /// Index of the reflection, after it has been placed.
    reflection: usize,
}

/// A guess that the path needs a trial point of a simplex.
#[derive(Debug, Clone, Copy)]
struct Guess {
    node: usize,
    trial: Trial,
    probability: f64,
    /// Number of previous guesses.
    number: usize,
}

impl Ord for Guess {
    /// Orders by probability. Of equally probable guesses, the first is the greatest.
    fn cmp(&self, other: &Self) -> Ordering {
        self.probability.total_cmp(&other.probability).then(other.number.cmp(&self.number))
    }
}

impl PartialOrd for Guess {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Guess {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Guess {}

/// Reused buffers. Looking ahead does not allocate after they are large enough.
#[derive(Debug, Clone, Default)]
pub(super) struct Speculation {
    nodes: Vec<Node>,
    /// Slots of each node by rank, concatenated.
    orders: Vec<usize>,
    guesses: BinaryHeap<Guess>,
    n_guesses: usize,
    points: Vec<TrialPoint>,
    /// Costs of the points, if they are known. Infinite costs are only known to be high.
    costs: Vec<Option<f64>>,
    n_points: usize,
    centroid: Vec<f64>,
}

impl Speculation {
    /// Finds up to `wanted` points whose costs are not available, after `trial`, the point that the path
    /// needs now. Calls `found` for each point; the flag is true for the expansion of this iteration.
    pub(super) fn look(
        &mut self,
        problem: &Problem<'_>,
        trial: Trial,
        placed: &[TrialPoint; 4],
        wanted: usize,
        mut found: impl FnMut(&[f64], bool),
    ) {
        let space = problem.space;
        self.nodes.clear();
        self.guesses.clear();
        self.orders.clear();
        self.orders.extend_from_slice(problem.simplex.order());
        self.centroid.resize(space.n_free(), 0.0);
        (self.n_points, self.n_guesses) = (0, 0);
        let reflection = self.copy(problem, &placed[Trial::Reflection as usize]);
        let current = self.copy(problem, &placed[trial as usize]);
        self.nodes.push(Node { parent: 0, replaced: None, reflection });
        self.expand(problem, Guess { node: 0, trial, probability: 1.0, number: 0 }, current);
        let mut n_found = 0;
        // The limit includes guesses with known points, which also take time.
        for _ in 0..4 * wanted {
            if n_found == wanted {
                return;
            }
            let Some(guess) = self.guesses.pop() else { return };
            let number = self.place(problem, guess);
            let x = &self.points[number].x;
            let available_cost = (problem.available_cost)(x);
            self.costs[number] = match available_cost {
                AvailableCost::Cost(cost) => Some(cost),
                AvailableCost::Nothing | AvailableCost::Hidden => None,
            };
            if matches!(available_cost, AvailableCost::Nothing)
                && self.points[..number].iter().all(|p| p.x != *x)
            {
                found(x, guess.node == 0 && guess.trial == Trial::Expansion);
                n_found += 1;
            }
            self.expand(problem, guess, number);
        }
    }

    fn guess(&mut self, node: usize, trial: Trial, probability: f64) {
        if probability >= LEAST_PROBABILITY {
            self.guesses.push(Guess { node, trial, probability, number: self.n_guesses });
            self.n_guesses += 1;
        }
    }

    fn new_point(&mut self, space: &Space) -> usize {
        let number = self.n_points;
        if number == self.points.len() {
            self.points.push(TrialPoint::new(space.n_free(), space.n()));
            self.costs.push(None);
        }
        self.n_points += 1;
        number
    }

    fn copy(&mut self, problem: &Problem<'_>, point: &TrialPoint) -> usize {
        let number = self.new_point(problem.space);
        self.points[number].clone_from(point);
        self.costs[number] = match point.seen {
            Seen::Unknown => None,
            Seen::Cost(cost) => Some(cost),
            Seen::Rejected => Some(f64::INFINITY),
        };
        number
    }

    fn order(&self, node: usize, n: usize) -> &[usize] {
        &self.orders[node * (n + 1)..(node + 1) * (n + 1)]
    }

    /// Returns the index of the point in a slot of a node, if it differs from the current vertex.
    fn replacement(&self, mut node: usize, slot: usize) -> Option<usize> {
        while let Some((replaced, point)) = self.nodes[node].replaced {
            if replaced == slot {
                return Some(point);
            }
            node = self.nodes[node].parent;
        }
        None
    }

    fn vertex<'a>(&'a self, simplex: &'a RankedPoints, node: usize, slot: usize) -> &'a [f64] {
        self.replacement(node, slot).map_or_else(|| simplex.u(slot), |point| &self.points[point].u[..])
    }

    fn cost(&self, simplex: &RankedPoints, node: usize, slot: usize) -> Option<f64> {
        match self.replacement(node, slot) {
            Some(point) => self.costs[point],
            None => Some(simplex.cost(slot).value().unwrap_or(f64::INFINITY)),
        }
    }

    /// Places the point of a guess bit-for-bit as the iteration itself would. Returns its index.
    fn place(&mut self, problem: &Problem<'_>, guess: Guess) -> usize {
        let Problem { space, handling, numbers, simplex, .. } = *problem;
        let (n, node) = (space.n_free(), guess.node);
        let number = self.new_point(space);
        let mut centroid = std::mem::take(&mut self.centroid);
        let mut point = std::mem::replace(&mut self.points[number], TrialPoint::new(0, 0));
        let order = self.order(node, n);
        let (best, worst) = (order[0], order[n]);
        RankedPoints::centroid_of(
            (0..=n).filter(|slot| *slot != worst).filter_map(|slot| match self.replacement(node, slot) {
                Some(point) => Some(&self.points[point].u[..]),
                None => simplex.cost(slot).value().is_some().then(|| simplex.u(slot)),
            }),
            &mut centroid,
        );
        let frame = Frame {
            space,
            handling,
            factor: guess.trial.factor(numbers),
            centroid: &centroid,
            worst: self.vertex(simplex, node, worst),
            fallback: self.vertex(simplex, node, best),
        };
        let stays = &order[..n];
        frame.place(&mut point, |u| stays.iter().any(|&slot| self.vertex(simplex, node, slot) == u));
        self.points[number] = point;
        self.centroid = centroid;
        if guess.trial == Trial::Reflection {
            self.nodes[node].reflection = number;
        }
        number
    }

    /// Adds the points that the path may need after a point.
    fn expand(&mut self, problem: &Problem<'_>, guess: Guess, point: usize) {
        let n = problem.space.n_free();
        let Guess { node, trial, probability, .. } = guess;
        let reflection = self.nodes[node].reflection;
        let rank = self.rank(problem.simplex, node, point);
        let [first, second, third, accepted] =
            self.shares(problem.simplex, guess, point).map(|s| s * probability);
        match trial {
            Trial::Reflection => {
                self.guess(node, Trial::Inside, first);
                self.guess(node, Trial::Expansion, second);
                self.guess(node, Trial::Outside, third);
                self.follow(n, node, point, rank.unwrap_or(n / 2).clamp(1.min(n - 1), n - 1), accepted);
            }
            Trial::Expansion => {
                self.follow(n, node, point, 0, first);
                self.follow(n, node, reflection, 0, second);
            }
            Trial::Outside | Trial::Inside => {
                self.follow(n, node, point, rank.unwrap_or(n / 2).min(n - 1), first);
                self.follow(n, node, point, n, second);
            }
        }
    }

    /// Returns the number of vertices of a node with known costs that are not higher than the cost of a
    /// point. Returns `None` if the cost is not known.
    fn rank(&self, simplex: &RankedPoints, node: usize, point: usize) -> Option<usize> {
        let cost = self.costs[point]?;
        let costs = self.order(node, simplex.n).iter().map(|slot| self.cost(simplex, node, *slot));
        Some(costs.filter(|other| other.is_some_and(|other| other <= cost)).count())
    }

    /// Returns the probabilities of the outcomes of a trial point. After a reflection: inside contraction,
    /// expansion, outside contraction, acceptance unchanged. After an expansion: acceptance, acceptance of
    /// the reflection. After a contraction: acceptance as a vertex that is not the worst, acceptance as the
    /// worst vertex.
    fn shares(&self, simplex: &RankedPoints, guess: Guess, point: usize) -> [f64; 4] {
        self.shares_from_costs(simplex, guess, point).unwrap_or(match guess.trial {
            Trial::Reflection => [INSIDE, EXPANDING, OUTSIDE, ACCEPTED],
            Trial::Expansion => [EXPANDED, 1.0 - EXPANDED, 0.0, 0.0],
            Trial::Outside | Trial::Inside => [BETTER_THAN_WORST, 1.0 - BETTER_THAN_WORST, 0.0, 0.0],
        })
    }

    /// Returns the outcomes of `shares` if the costs determine them.
    fn shares_from_costs(&self, simplex: &RankedPoints, guess: Guess, point: usize) -> Option<[f64; 4]> {
        let (n, node) = (simplex.n, guess.node);
        let order = self.order(node, n);
        let at = |rank: usize| self.cost(simplex, node, order[rank]);
        let cost = self.costs[point]?;
        let reflected = self.costs[self.nodes[node].reflection];
        let outcome = match guess.trial {
            Trial::Reflection if cost < at(0)? => 1,
            Trial::Reflection if cost < at(n - 1)? => 3,
            Trial::Reflection => usize::from(cost < at(n)?) * 2,
            Trial::Expansion => usize::from(cost >= reflected?),
            Trial::Outside | Trial::Inside => {
                let limit = if guess.trial == Trial::Outside { reflected? } else { at(n)? };
                match (cost < limit, cost < at(n - 1)?) {
                    // The simplex shrinks.
                    (false, _) => return Some([0.0; 4]),
                    (true, is_better) => usize::from(!is_better),
                }
            }
        };
        Some(std::array::from_fn(|k| f64::from(u8::from(k == outcome))))
    }

    /// Adds the simplex in which a point with this rank has replaced the worst vertex, and its reflection.
    fn follow(&mut self, n: usize, node: usize, point: usize, rank: usize, probability: f64) {
        let start = self.orders.len();
        self.orders.extend_from_within(node * (n + 1)..(node + 1) * (n + 1));
        let slot = self.orders[start + n];
        self.orders[start + rank..].rotate_right(1);
        self.nodes.push(Node { parent: node, replaced: Some((slot, point)), reflection: point });
        self.guess(self.nodes.len() - 1, Trial::Reflection, probability);
    }
}
