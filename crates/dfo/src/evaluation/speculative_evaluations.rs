//! Speculative evaluations in progress. They use workers that the path does not need, and the run never waits
//! for them. They are cancelled when the path can no longer reach them.

use super::counted_batch::{CountedBatch, UnderWay};
use super::evaluator::{CutoffUse, Evaluator};
use super::store::FIRST_ID;
use crate::method_interface::interface::{Batch, Lookahead, Method};
use crate::outcome::answer::{Answer, Outcome};
use crate::outcome::trace::SpeculativeEntry;
use crate::problem::objective::Query;

/// Number of speculative evaluations that may remain unneeded, per evaluation of the path: with up to
/// [`FEW_WORKERS`] workers, and with a thousand. The third constant is the number allowed in addition from
/// the start.
const WASTE: f64 = 1.75;
const WASTE_OF_THOUSAND: f64 = 3.5;
const FIRST_WASTE: usize = 16;
/// Number of workers up to which `WASTE` applies.
const FEW_WORKERS: f64 = 64.0;

/// An evaluation started speculatively.
#[derive(Debug)]
struct SpeculativePoint {
    x: Vec<f64>,
    query: Query<'static>,
    batch: u64,
    /// Index of the work item of the round that waits for this evaluation; `None` until the path requests it.
    place: Option<usize>,
    hash: u64,
    is_cancelled: bool,
}

/// Speculative evaluations in progress.
#[derive(Debug, Default)]
pub(crate) struct SpeculativeEvaluations {
    under_way: Vec<SpeculativePoint>,
    requested: Batch,
    spare: Vec<Vec<f64>>,
    /// Hashes of the points of `requested`, and later of the points in progress.
    hashes: Vec<u64>,
    /// True if answers come one at a time, which means that a speculative evaluation was running when a round
    /// began.
    flows: bool,
}

/// Use of an answer to a speculative point.
pub(crate) enum Reached {
    /// It answers the query of the path at this index.
    Answer(usize, Answer),
    /// It does not answer the query, so the point at this index must be evaluated.
    Again(usize),
    /// The path has not reached the point.
    Kept,
}

/// Returns the number of speculative evaluations that may remain unneeded, per evaluation of the path.
fn share_of_waste(workers: usize) -> f64 {
    let many = (workers as f64 / FEW_WORKERS).max(1.0).ln() / (1000.0 / FEW_WORKERS).ln();
    WASTE + (WASTE_OF_THOUSAND - WASTE) * many.min(1.0)
}

/// Returns the number of speculative evaluations that may remain unneeded in a run with `n_evaluations`.
fn allowed_waste(n_evaluations: usize, workers: usize) -> usize {
    (share_of_waste(workers) * n_evaluations as f64) as usize + workers.min(FIRST_WASTE)
}

/// Hashes the bits of a point as rustc's `FxHasher` does, because thousands of points are hashed after each
/// answer. If two points have the same hash, at most one speculative evaluation is lost.
fn hash(x: &[f64]) -> u64 {
    x.iter().fold(0, |hash: u64, v| (hash.rotate_left(5) ^ v.to_bits()).wrapping_mul(0x517c_c1b7_2722_0a95))
}

impl SpeculativeEvaluations {
    /// True if a point of the path is already being evaluated. Index `k` of the round's work then waits for
    /// it.
    pub(crate) fn adopt(&mut self, x: &[f64], k: usize) -> bool {
        self.flows |= !self.under_way.is_empty();
        let same = |y: &[f64]| x.iter().zip(y).all(|(x, y)| x.to_bits() == y.to_bits());
        let free =
            |guess: &&mut SpeculativePoint| guess.place.is_none() && !guess.is_cancelled && same(&guess.x);
        let found = self.under_way.iter_mut().find(free);
        found.map(|guess| guess.place = Some(k)).is_some()
    }

    /// Cancels speculative points that the path can no longer reach, and starts others if workers are free.
    /// `answers` are the answers to the current points of the path, and `open` is the number of missing ones.
    /// `left` is the number of evaluations left in the budget after these points.
    pub(crate) fn renew(
        &mut self,
        method: &mut dyn Method,
        round: &mut CountedBatch,
        answers: &[Answer],
        open: usize,
        left: usize,
        evaluator: &mut dyn Evaluator,
    ) {
        let capacity = match method.details().lookahead {
            Lookahead::None => 0,
            Lookahead::Points(points) => evaluator.capacity(points),
            Lookahead::Workers => evaluator.width(),
            Lookahead::Measured if evaluator.pays_ahead() => evaluator.width(),
            Lookahead::Measured => 0,
        };
        let awaited = self.under_way.iter().filter(|guess| guess.place.is_some()).count();
        let wanted = capacity.saturating_sub(open).min(left);
        if wanted == 0 && self.under_way.len() == awaited {
            return;
        }
        let Self { under_way, requested, spare, hashes, flows } = self;
        requested.start(round.work.n(), round.work.index(), 0);
        requested.set_kind(round.work.kind());
        if wanted > 0 {
            // Requests more points than fit, so that running points are not cancelled when other points
            // precede them.
            method.speculate(2 * wanted, &UnderWay { round, answers }, requested);
            if !round.ledger.constraints.nonlinear.is_empty() {
                requested.remove_cutoffs();
            }
        }
        hashes.clear();
        hashes.extend(requested.points().map(hash));
        hashes.sort_unstable();
        for guess in under_way.iter_mut().filter(|guess| guess.place.is_none() && !guess.is_cancelled) {
            if hashes.binary_search(&guess.hash).is_err() {
                guess.is_cancelled = true;
                evaluator.cancel(guess.query.id);
            }
        }
        // A cancelled point may still be evaluated to its end.
        let under_way_in_all = open + under_way.len() - awaited;
        let most = allowed_waste(round.ledger.n_evaluations + open, evaluator.width());
        hashes.clear();
        hashes.extend(under_way.iter().filter(|guess| !guess.is_cancelled).map(|guess| guess.hash));
        hashes.sort_unstable();
        let is_begun = |x: &[f64]| hashes.binary_search(&hash(x)).is_ok();
        // The path will reach these points.
        let is_useful =
            |k: &usize| is_begun(requested.point(*k)) || round.store.contains(requested.point(*k));
        let useful = awaited + (0..requested.n_certain()).filter(is_useful).count();
        let mut allowed = most.saturating_sub(round.ledger.n_in_vain().saturating_sub(useful));
        let mut free = capacity.saturating_sub(under_way_in_all);
        // While little of the budget is left, the least probable points would use it up (benches/ahead.rs).
        allowed = if *flows {
            let n_ahead =
                under_way.iter().filter(|guess| !guess.is_cancelled && guess.place.is_none()).count();
            let at_once = share_of_waste(evaluator.width()).ceil() as usize + 1;
            allowed.min(at_once.saturating_sub(n_ahead).max(allowed / 20))
        } else {
            allowed.div_ceil(2)
        };
        for k in 0..requested.len() {
            let (x, is_certain) = (requested.point(k), k < requested.n_certain());
            if free == 0 || !is_certain && allowed == 0 {
                break;
            }
            if is_begun(x) || is_certain && (k >= left || round.store.contains(x)) {
                continue;
            }
            free -= 1;
            allowed = allowed.saturating_sub(usize::from(!is_certain));
            let (hash, mut query) = (hash(x), requested.query(k));
            query.id = FIRST_ID + round.ledger.n_guessed;
            round.ledger.n_guessed += 1;
            let mut point = spare.pop().unwrap_or_default();
            point.clear();
            point.extend_from_slice(x);
            evaluator.submit(x, query);
            let batch = requested.index();
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

    /// Processes an answer.
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

    /// Cancels all speculative evaluations, including those that the path waits for.
    pub(crate) fn cancel(&mut self, evaluator: &mut dyn Evaluator) {
        for guess in self.under_way.iter_mut().filter(|guess| !guess.is_cancelled) {
            guess.is_cancelled = true;
            evaluator.cancel(guess.query.id);
        }
    }

    /// Cancels the evaluations that only later indices of the round's work wait for, and those that no index
    /// waits for.
    pub(crate) fn cancel_after(&mut self, place: usize, evaluator: &mut dyn Evaluator) {
        for guess in self.under_way.iter_mut().filter(|guess| guess.place.is_none_or(|k| k > place)) {
            guess.is_cancelled = true;
            evaluator.cancel(guess.query.id);
        }
    }
}
