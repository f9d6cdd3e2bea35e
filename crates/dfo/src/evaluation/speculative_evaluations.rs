//! Speculative evaluations that are under way: they use the workers that the path leaves free, are never
//! waited for, and are cancelled when the path can no longer come to them.

use super::counted_batch::{CountedBatch, UnderWay};
use super::evaluator::{CutoffUse, Evaluator};
use super::store::FIRST_ID;
use crate::method_interface::interface::{Batch, Lookahead, Method};
use crate::outcome::answer::{Answer, Outcome};
use crate::outcome::trace::SpeculativeEntry;
use crate::problem::objective::Query;
use std::collections::hash_map::DefaultHasher;
use std::hash::Hasher;

/// So many evaluations ahead of need may be for nothing, per evaluation of the path; and so many in all
/// before that.
const WASTE: f64 = 1.75;
const WASTE_OF_THOUSAND: f64 = 3.5;
const FIRST_WASTE: usize = 16;
/// Up to so many workers the first share holds.
const FEW_WORKERS: f64 = 64.0;

/// An evaluation that was begun ahead of need.
#[derive(Debug)]
struct SpeculativePoint {
    x: Vec<f64>,
    query: Query<'static>,
    batch: u64,
    /// The place in the round's work that waits for it, once the path has come to it.
    place: Option<usize>,
    hash: u64,
    is_cancelled: bool,
}

/// Those under way.
#[derive(Debug, Default)]
pub(crate) struct SpeculativeEvaluations {
    under_way: Vec<SpeculativePoint>,
    asked: Batch,
    spare: Vec<Vec<f64>>,
    /// Of the points of `asked`, and those of them that are under way.
    hashes: Vec<u64>,
    /// True if answers come one at a time: a guess was under way when a round began.
    flows: bool,
}

/// Use of an answer to a guess.
pub(crate) enum Reached {
    /// It answers what the path asks at this place.
    Answer(usize, Answer),
    /// It does not: the place has to be evaluated.
    Again(usize),
    /// The path is not there, or not yet.
    Kept,
}

/// Evaluations ahead of need that may be for nothing, per evaluation of the path.
fn share_of_waste(workers: usize) -> f64 {
    let many = (workers as f64 / FEW_WORKERS).max(1.0).ln() / (1000.0 / FEW_WORKERS).ln();
    WASTE + (WASTE_OF_THOUSAND - WASTE) * many.min(1.0)
}

/// Number of evaluations ahead of need that may be for nothing in a run of so many.
fn allowed_waste(n_evaluations: usize, workers: usize) -> usize {
    (share_of_waste(workers) * n_evaluations as f64) as usize + workers.min(FIRST_WASTE)
}

/// Of the bits of a point. Where two points share one, no more than a guess is lost.
fn hash(x: &[f64]) -> u64 {
    let mut hasher = DefaultHasher::new();
    x.iter().for_each(|v| hasher.write_u64(v.to_bits()));
    hasher.finish()
}

impl SpeculativeEvaluations {
    /// True if a point of the path is under way already; place `k` of the round's work waits for it then.
    pub(crate) fn adopt(&mut self, x: &[f64], k: usize) -> bool {
        self.flows |= !self.under_way.is_empty();
        let same = |y: &[f64]| x.iter().zip(y).all(|(x, y)| x.to_bits() == y.to_bits());
        let free =
            |guess: &&mut SpeculativePoint| guess.place.is_none() && !guess.is_cancelled && same(&guess.x);
        let found = self.under_way.iter_mut().find(free);
        found.map(|guess| guess.place = Some(k)).is_some()
    }

    /// Gives up those that the path has left, and begins others where there is room. `answers`: to the points
    /// of the path that were under way; `open`: how many still are; `left`: evaluations that the budget
    /// leaves after these.
    pub(crate) fn renew<M: Method + ?Sized>(
        &mut self,
        method: &mut M,
        round: &mut CountedBatch,
        answers: &[Answer],
        open: usize,
        left: usize,
        evaluator: &mut dyn Evaluator,
    ) {
        let room = match method.details().lookahead {
            Lookahead::None => 0,
            Lookahead::Points(points) => evaluator.room(points),
            Lookahead::Workers => evaluator.width(),
            Lookahead::Measured if evaluator.pays_ahead() => evaluator.width(),
            Lookahead::Measured => 0,
        };
        let awaited = self.under_way.iter().filter(|guess| guess.place.is_some()).count();
        let wanted = room.saturating_sub(open).min(left);
        if wanted == 0 && self.under_way.len() == awaited {
            return;
        }
        let Self { under_way, asked, spare, hashes, flows } = self;
        asked.start(round.work.n(), round.work.index(), 0);
        asked.set_want(round.work.want());
        if wanted > 0 {
            // Farther than there is room for: what is under way already is not given up because others have come before it.
            method.speculate(2 * wanted, &UnderWay { round, answers }, asked);
        }
        hashes.clear();
        hashes.extend(asked.points().map(hash));
        hashes.sort_unstable();
        for guess in under_way.iter_mut().filter(|guess| guess.place.is_none() && !guess.is_cancelled) {
            if hashes.binary_search(&guess.hash).is_err() {
                guess.is_cancelled = true;
                evaluator.cancel(guess.query.id);
            }
        }
        // A point that was given up may still be evaluated to its end.
        let under_way_in_all = open + under_way.len() - awaited;
        let most = allowed_waste(round.ledger.n_evaluations + open, evaluator.width());
        hashes.clear();
        hashes.extend(under_way.iter().filter(|guess| !guess.is_cancelled).map(|guess| guess.hash));
        hashes.sort_unstable();
        let is_begun = |x: &[f64]| hashes.binary_search(&hash(x)).is_ok();
        // The path will come to these.
        let is_useful = |k: &usize| is_begun(asked.point(*k)) || round.store.contains(asked.point(*k));
        let useful = awaited + (0..asked.n_certain()).filter(is_useful).count();
        let mut allowed = most.saturating_sub(round.ledger.n_in_vain().saturating_sub(useful));
        let mut free = room.saturating_sub(under_way_in_all);
        // While little is left, the least probable ones would soon take it (benches/ahead.rs).
        allowed = if *flows {
            let n_ahead =
                under_way.iter().filter(|guess| !guess.is_cancelled && guess.place.is_none()).count();
            let at_once = share_of_waste(evaluator.width()).ceil() as usize + 1;
            allowed.min(at_once.saturating_sub(n_ahead).max(allowed / 20))
        } else {
            allowed.div_ceil(2)
        };
        for k in 0..asked.len() {
            let (x, is_certain) = (asked.point(k), k < asked.n_certain());
            if free == 0 || !is_certain && allowed == 0 {
                break;
            }
            if is_begun(x) || is_certain && (k >= left || round.store.contains(x)) {
                continue;
            }
            free -= 1;
            allowed = allowed.saturating_sub(usize::from(!is_certain));
            let (hash, mut query) = (hash(x), asked.query(k));
            query.id = FIRST_ID + round.ledger.n_guessed;
            round.ledger.n_guessed += 1;
            let mut point = spare.pop().unwrap_or_default();
            point.clear();
            point.extend_from_slice(x);
            evaluator.submit(x, query);
            let batch = asked.index();
            under_way.push(SpeculativePoint {
                x: point,
                query,
                batch,
                place: None,
                hash,
                is_cancelled: false,
            });
        }
    }

    /// Takes an answer in.
    pub(crate) fn answered(
        &mut self,
        id: u64,
        answer: Answer,
        round: &mut CountedBatch,
        cutoff_use: CutoffUse,
    ) -> Option<Reached> {
        let place = self.under_way.iter().position(|guess| guess.query.id == id)?;
        let guess = self.under_way.swap_remove(place);
        let SpeculativePoint { x, query, batch, place, .. } = guess;
        let mut answer = answer;
        if answer.outcome == Outcome::Skipped {
            self.spare.push(x);
            return Some(place.map_or(Reached::Kept, Reached::Again));
        }
        answer.outcome = answer.outcome.checked(query.cutoff);
        let entry = SpeculativeEntry::new(id, batch, x, query, answer);
        let Some(k) = place else {
            round.keep_early(entry);
            return Some(Reached::Kept);
        };
        Some(match entry.answer_to(&round.work.query(k), cutoff_use) {
            Some(answer) => {
                round.ledger.n_adopted += 1;
                Reached::Answer(k, answer)
            }
            None => {
                round.ledger.useless(entry);
                Reached::Again(k)
            }
        })
    }

    /// Gives all up. Those that the path waits for included.
    pub(crate) fn cancel(&mut self, evaluator: &mut dyn Evaluator) {
        for guess in self.under_way.iter_mut().filter(|guess| !guess.is_cancelled) {
            guess.is_cancelled = true;
            evaluator.cancel(guess.query.id);
        }
    }

    /// The same for those that only places of the round's work after this one wait for, and those that none
    /// waits for.
    pub(crate) fn cancel_after(&mut self, place: usize, evaluator: &mut dyn Evaluator) {
        for guess in self.under_way.iter_mut().filter(|guess| guess.place.is_none_or(|k| k > place)) {
            guess.is_cancelled = true;
            evaluator.cancel(guess.query.id);
        }
    }
}
