//! The points that the path may need after the one it needs now, the most probable first.
//!
//! What an iteration does is not known before its costs are, but most simplices that can follow are few and
//! their points can be computed: an accepted reflection replaces the worst vertex, and the next worst is the
//! second worst of today. The guesses are followed best first, over as many iterations as points are wanted.

use super::options::CoefficientValues;
use super::trial::{Frame, Trial, TrialPoint};
use crate::methods::shared::ranked_points::RankedPoints;
use crate::problem::space::Space;
use crate::values::choices::BoundsHandling;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Frequency of reflections that are accepted as they are, that are followed by an expansion, by an inside
/// and by an outside contraction, and of expansions that are accepted: counted over the 53 problems of Moré
/// and Wild (SIAM J. Optim. 20, 2009).
const ACCEPTED: f64 = 0.50;
const EXPANDING: f64 = 0.23;
const INSIDE: f64 = 0.24;
const OUTSIDE: f64 = 0.04;
const EXPANDED: f64 = 0.11 / 0.23;
/// Frequency of contracted points that are not the worst vertex of the new simplex.
const BETTER_THAN_WORST: f64 = 0.8;

/// A point that the path needs with less probability is not worth its evaluation, however many are wanted:
/// with 1000 workers a quarter of this gains nothing (docs/scaling.md has the clock) and takes five times as
/// long to find.
const LEAST_PROBABILITY: f64 = 1.0 / 256.0;

/// The simplex and what its trial points are made with.
pub(super) struct Problem<'a> {
    pub(super) space: &'a Space,
    pub(super) handling: BoundsHandling,
    pub(super) numbers: &'a CoefficientValues,
    pub(super) simplex: &'a RankedPoints,
}

/// Predicate of points that need no evaluation any more.
type Known<'a> = &'a dyn Fn(&[f64]) -> bool;

/// A simplex that may come to be: that of its parent with one vertex replaced.
#[derive(Debug, Clone, Copy)]
struct Node {
    parent: usize,
    /// The slot of the vertex that is replaced, and the number of the point that takes it; none for the
    /// present simplex.
    replaced: Option<(usize, usize)>,
    /// Number of the reflection, once it is placed.
    reflection: usize,
}

/// That the path needs a trial point of a simplex.
#[derive(Debug, Clone, Copy)]
struct Guess {
    node: usize,
    trial: Trial,
    probability: f64,
    /// Guesses before it.
    number: usize,
}

impl Ord for Guess {
    /// The most probable is the greatest, of equal ones the first.
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

/// Buffers that are used over and over: looking ahead allocates nothing once they are large enough.
#[derive(Debug, Clone, Default)]
pub(super) struct Speculation {
    nodes: Vec<Node>,
    /// The slots of each node by rank, one node after the other.
    orders: Vec<usize>,
    guesses: BinaryHeap<Guess>,
    n_guesses: usize,
    points: Vec<TrialPoint>,
    n_points: usize,
    centroid: Vec<f64>,
}

impl Speculation {
    /// Finds up to `wanted` points that are not `known`, after `trial`, which the path needs now; `found` is
    /// given each, and whether it is the expansion of this iteration.
    pub(super) fn look(
        &mut self,
        problem: &Problem<'_>,
        trial: Trial,
        placed: &[TrialPoint; 4],
        wanted: usize,
        known: Known<'_>,
        mut found: impl FnMut(&[f64], bool),
    ) {
        let space = problem.space;
        self.nodes.clear();
        self.guesses.clear();
        self.orders.clear();
        self.orders.extend_from_slice(problem.simplex.order());
        self.centroid.resize(space.n_free(), 0.0);
        (self.n_points, self.n_guesses) = (0, 0);
        let reflection = self.copy(space, &placed[Trial::Reflection as usize]);
        let current = self.copy(space, &placed[trial as usize]);
        self.nodes.push(Node { parent: 0, replaced: None, reflection });
        self.expand(problem, Guess { node: 0, trial, probability: 1.0, number: 0 }, current);
        let mut n_found = 0;
        // Guesses whose points are known already cost time, too.
        for _ in 0..4 * wanted {
            if n_found == wanted {
                return;
            }
            let Some(guess) = self.guesses.pop() else { return };
            let number = self.place(problem, guess);
            let x = &self.points[number].x;
            let is_new = self.points[..number].iter().all(|p| p.x != *x) && !known(x);
            if is_new {
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
        }
        self.n_points += 1;
        number
    }

    fn copy(&mut self, space: &Space, point: &TrialPoint) -> usize {
        let number = self.new_point(space);
        self.points[number].clone_from(point);
        number
    }

    fn order(&self, node: usize, n: usize) -> &[usize] {
        &self.orders[node * (n + 1)..(node + 1) * (n + 1)]
    }

    /// The point that stands in a slot of a node, if it is not the present vertex.
    fn replacement(&self, mut node: usize, slot: usize) -> Option<&TrialPoint> {
        while let Some((replaced, point)) = self.nodes[node].replaced {
            if replaced == slot {
                return Some(&self.points[point]);
            }
            node = self.nodes[node].parent;
        }
        None
    }

    fn vertex<'a>(&'a self, simplex: &'a RankedPoints, node: usize, slot: usize) -> &'a [f64] {
        self.replacement(node, slot).map_or_else(|| simplex.u(slot), |point| &point.u[..])
    }

    /// Places the point of a guess as the iteration itself would, bit for bit; its number.
    fn place(&mut self, problem: &Problem<'_>, guess: Guess) -> usize {
        let Problem { space, handling, numbers, simplex } = *problem;
        let (n, node) = (space.n_free(), guess.node);
        let number = self.new_point(space);
        let mut centroid = std::mem::take(&mut self.centroid);
        let mut point = std::mem::replace(&mut self.points[number], TrialPoint::new(0, 0));
        let order = self.order(node, n);
        let (best, worst) = (order[0], order[n]);
        RankedPoints::centroid_of(
            (0..=n).filter(|slot| *slot != worst).filter_map(|slot| match self.replacement(node, slot) {
                Some(point) => Some(&point.u[..]),
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
        match trial {
            Trial::Reflection => {
                for (trial, share) in
                    [(Trial::Inside, INSIDE), (Trial::Expansion, EXPANDING), (Trial::Outside, OUTSIDE)]
                {
                    self.guess(node, trial, share * probability);
                }
                self.follow(n, node, point, n / 2, ACCEPTED * probability);
            }
            Trial::Expansion => {
                self.follow(n, node, point, 0, EXPANDED * probability);
                self.follow(n, node, reflection, 0, (1.0 - EXPANDED) * probability);
            }
            Trial::Outside | Trial::Inside => {
                self.follow(n, node, point, n / 2, BETTER_THAN_WORST * probability);
                self.follow(n, node, point, n, (1.0 - BETTER_THAN_WORST) * probability);
            }
        }
    }

    /// The simplex in which a point has replaced the worst vertex and has this rank, and its reflection.
    fn follow(&mut self, n: usize, node: usize, point: usize, rank: usize, probability: f64) {
        let start = self.orders.len();
        self.orders.extend_from_within(node * (n + 1)..(node + 1) * (n + 1));
        let slot = self.orders[start + n];
        self.orders[start + rank..].rotate_right(1);
        self.nodes.push(Node { parent: node, replaced: Some((slot, point)), reflection: point });
        self.guess(self.nodes.len() - 1, Trial::Reflection, probability);
    }
}
