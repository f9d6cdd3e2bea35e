//! The parallel simplex of Lee and Wiswall (Comput. Econ. 30, 2007): the `p` worst vertices move at once,
//! each reflected through the centroid of the others and then expanded or contracted on its own account.
//!
//! This is another path than the serial one. Left alone it is quick at first and slow at last, so `p` is
//! halved whenever the best vertex has not improved for five iterations; with one vertex it is the serial
//! method. On the problems of Moré and Wild with four parameters or more it needs 14, 53 and 150 rounds
//! (median) to tau = 1e-1, 1e-3 and 1e-5, the serial plan 44, 158 and 363, and it solves as many (98 %);
//! without the fall-back it solves 83 %.

use super::options::CoefficientValues;
use super::trial::{Frame, Seen, Trial, TrialPoint};
use crate::method::interface::Batch;
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::problem::space::Space;
use crate::values::choices::BoundsHandling;
use serde::{Deserialize, Serialize};

/// Iterations without a better best vertex after which fewer vertices move.
const IDLE: usize = 5;

/// A vertex on the move.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Move {
    slot: usize,
    /// Cost of the vertex one rank better when the iteration began.
    ahead: Cost,
    reflected: TrialPoint,
    /// Trial after the reflection, if there is one.
    follow: Option<Trial>,
    second: TrialPoint,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct LeeWiswall {
    moves: Vec<Move>,
    /// Number of moves in use: vertices that move at once.
    degree: usize,
    centroid: Vec<f64>,
    placed: bool,
    /// True if the reflections are known and the second points are placed.
    second_round: bool,
    best: f64,
    idle: usize,
}

/// Result of an iteration.
pub(super) enum Verdict {
    /// Some points are not known yet.
    Unfinished,
    Moved,
    /// No vertex improved: shrink.
    Stuck,
}

impl LeeWiswall {
    /// Half as many vertices as there are parameters.
    pub(super) fn new(n: usize, n_user: usize) -> Self {
        let degree = (n / 2).max(1);
        let point = || TrialPoint::new(n, n_user);
        let vertex =
            || Move { slot: 0, ahead: Cost::Failed, reflected: point(), follow: None, second: point() };
        Self {
            moves: (0..degree).map(|_| vertex()).collect(),
            degree,
            centroid: vec![0.0; n],
            placed: false,
            second_round: false,
            best: f64::INFINITY,
            idle: 0,
        }
    }

    /// True if several vertices move at once; false once it has come down to the serial method.
    pub(super) fn is_parallel(&self) -> bool {
        self.degree > 1
    }

    pub(super) fn begin(&mut self) {
        self.placed = false;
        self.second_round = false;
    }

    /// Asks for the points of the present round that are not known.
    pub(super) fn ask(
        &mut self,
        batch: &mut Batch,
        mut role: impl FnMut(usize),
        simplex: &RankedPoints,
        (space, handling, numbers): (&Space, BoundsHandling, &CoefficientValues),
    ) {
        let best = simplex.best();
        if !self.placed {
            self.placed = true;
            simplex.centroid_of_best(self.degree, &mut self.centroid);
            let first = simplex.order().len() - self.degree;
            for (k, vertex) in self.moves[..self.degree].iter_mut().enumerate() {
                vertex.slot = simplex.order()[first + k];
                vertex.ahead = simplex.cost(simplex.order()[first + k - 1]);
                (vertex.follow, vertex.reflected.seen) = (None, Seen::Unknown);
                let frame = Frame {
                    space,
                    handling,
                    factor: Trial::Reflection.factor(numbers),
                    centroid: &self.centroid,
                    worst: simplex.u(vertex.slot),
                    fallback: simplex.u(best),
                };
                frame.place(&mut vertex.reflected, |u| simplex.order().iter().any(|&s| simplex.u(s) == u));
            }
        }
        for (k, vertex) in self.moves[..self.degree].iter_mut().enumerate() {
            let own = simplex.cost(vertex.slot).value().unwrap_or(f64::INFINITY);
            if !self.second_round && vertex.reflected.seen == Seen::Unknown {
                batch.push(&vertex.reflected.x, own);
                role(k);
            }
            let Some(follow) = vertex.follow.filter(|_| self.second_round) else { continue };
            if vertex.second.seen == Seen::Unknown {
                let frame = Frame {
                    space,
                    handling,
                    factor: follow.factor(numbers),
                    centroid: &self.centroid,
                    worst: simplex.u(vertex.slot),
                    fallback: simplex.u(best),
                };
                frame.place(&mut vertex.second, |u| simplex.order().iter().any(|&s| simplex.u(s) == u));
                let cutoff = match (follow, vertex.reflected.seen) {
                    (Trial::Expansion | Trial::Outside, Seen::Cost(r)) => r,
                    _ => own,
                };
                batch.push(&vertex.second.x, cutoff);
                role(k);
            }
        }
    }

    /// An outcome came for move `k`.
    pub(super) fn see(&mut self, k: usize, seen: Seen) {
        let vertex = &mut self.moves[k];
        if self.second_round {
            vertex.second.seen = seen;
        } else {
            vertex.reflected.seen = seen;
        }
    }

    /// The best of the points seen in an iteration that is not concluded.
    pub(super) fn best_seen(&self) -> Option<(&[f64], f64)> {
        let moves = self.moves[..self.degree].iter().filter(|_| self.placed);
        let second = |m: &'_ Move| m.follow.is_some() && self.second_round;
        let points = moves.flat_map(|m| [Some(&m.reflected), Some(&m.second).filter(|_| second(m))]);
        let mut best: Option<(&[f64], f64)> = None;
        for point in points.flatten() {
            if let Seen::Cost(v) = point.seen
                && best.is_none_or(|(_, b)| v < b)
            {
                best = Some((&point.x, v));
            }
        }
        best
    }

    /// Draws the conclusions from a round.
    pub(super) fn conclude(&mut self, simplex: &mut RankedPoints) -> Verdict {
        let best = simplex.cost(simplex.best());
        let moves = &mut self.moves[..self.degree];
        if !self.second_round {
            if moves.iter().any(|m| m.reflected.seen == Seen::Unknown) {
                return Verdict::Unfinished;
            }
            for vertex in moves.iter_mut() {
                let own = simplex.cost(vertex.slot);
                vertex.second.seen = Seen::Unknown;
                vertex.follow = match vertex.reflected.seen {
                    Seen::Cost(r) if Cost::Value(r).better_than(best) => Some(Trial::Expansion),
                    Seen::Cost(r) if Cost::Value(r).better_than(vertex.ahead) => None,
                    Seen::Cost(r) if Cost::Value(r).better_than(own) => Some(Trial::Outside),
                    _ => Some(Trial::Inside),
                };
            }
            self.second_round = true;
        }
        if moves.iter().any(|m| m.follow.is_some() && m.second.seen == Seen::Unknown) {
            return Verdict::Unfinished;
        }
        let mut improved = false;
        for vertex in moves.iter() {
            let own = simplex.cost(vertex.slot);
            let reflected = match vertex.reflected.seen {
                Seen::Cost(r) => Some((r, &vertex.reflected)),
                _ => None,
            };
            let second = match (vertex.follow, vertex.second.seen) {
                (Some(_), Seen::Cost(c)) => Some((c, &vertex.second)),
                _ => None,
            };
            let new = match vertex.follow {
                None | Some(Trial::Reflection) => reflected,
                Some(Trial::Expansion) => {
                    second.filter(|(e, _)| reflected.is_none_or(|(r, _)| *e < r)).or(reflected)
                }
                Some(Trial::Outside) => second.filter(|(c, _)| reflected.is_none_or(|(r, _)| *c <= r)),
                Some(Trial::Inside) => second.filter(|(c, _)| Cost::Value(*c).better_than(own)),
            };
            improved |= new.is_some();
            // A reflection that beat its vertex stays, even where the contraction after it did not help.
            let kept = reflected.filter(|_| vertex.follow == Some(Trial::Outside));
            if let Some((value, point)) = new.or(kept) {
                simplex.replace(vertex.slot, &point.u, &point.x, value);
            }
        }
        simplex.sort();
        self.fall_back(simplex);
        if improved { Verdict::Moved } else { Verdict::Stuck }
    }

    /// Fewer vertices, if the best has not improved for long.
    fn fall_back(&mut self, simplex: &RankedPoints) {
        let best = simplex.cost(simplex.best()).value().unwrap_or(f64::INFINITY);
        self.idle = if best < self.best { 0 } else { self.idle + 1 };
        self.best = best;
        if self.idle >= IDLE {
            self.degree = (self.degree / 2).max(1);
            self.idle = 0;
        }
    }

    pub(super) fn is_sound(&self, space: &Space) -> bool {
        let n = space.n_free();
        let point = |p: &TrialPoint| p.is_sound(space);
        self.degree >= 1
            && self.degree <= self.moves.len()
            && self.moves.len() <= n.max(1)
            && self.centroid.len() == n
            && self.moves.iter().all(|m| m.slot <= n && point(&m.reflected) && point(&m.second))
    }
}
