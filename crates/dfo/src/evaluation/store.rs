//! Store of evaluated points, by the bits of the point. It contains evaluations that the run has counted;
//! their number is limited, and the oldest are evicted first. It also contains early evaluations, made
//! speculatively or before the run was resumed, which count when the path reaches them.

use super::evaluator::CutoffUse;
use crate::outcome::answer::{Answer, EvaluationKind, Outcome};
use crate::outcome::trace::SpeculativeEntry;
use crate::problem::objective::Query;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap, VecDeque};

/// First id of points evaluated speculatively. Ids of the path count from 0.
pub(crate) const FIRST_ID: u64 = 1 << 63;

/// Maximum number of early evaluations, and maximum total number of their residuals. The path reaches a point
/// soon or never.
const MOST_EARLY: usize = 4096;
const MOST_EARLY_RESIDUALS: usize = 1 << 24;

type Key = Box<[u64]>;

/// An evaluation that the run has not counted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct EarlyOutcome {
    pub(crate) entry: SpeculativeEntry,
    /// True if the path had reached this point before the run was resumed.
    pub(crate) is_of_path: bool,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(from = "Stored", into = "Stored")]
pub(crate) struct Store {
    capacity: usize,
    cached: HashMap<Key, Answer>,
    /// Keys in insertion order.
    order: VecDeque<Key>,
    /// Keys that are never evicted.
    pinned: Vec<Key>,
    key: Vec<u64>,
    /// Early evaluations in insertion order, and their numbers by key.
    early: BTreeMap<u64, EarlyOutcome>,
    places: HashMap<Key, VecDeque<u64>>,
    next: u64,
    n_residuals: usize,
    /// Number of early evaluations from before the run was resumed.
    n_replays: usize,
}

/// File format of a store: entries in insertion order.
#[derive(Clone, Serialize, Deserialize)]
struct Stored {
    capacity: usize,
    pinned: Vec<(Vec<u64>, Answer)>,
    entries: Vec<(Vec<u64>, Answer)>,
    early: Vec<EarlyOutcome>,
}

impl From<Stored> for Store {
    fn from(stored: Stored) -> Self {
        let mut store = Self::new(stored.capacity);
        let point = |key: Vec<u64>| -> Vec<f64> { key.into_iter().map(f64::from_bits).collect() };
        for (key, answer) in stored.pinned {
            store.pin(&point(key), answer);
        }
        for (key, answer) in stored.entries {
            store.insert(&point(key), &answer, EvaluationKind::Residuals);
        }
        for early in stored.early {
            store.keep(early);
        }
        store
    }
}

impl From<Store> for Stored {
    fn from(store: Store) -> Self {
        let entry = |k: &[u64]| store.cached.get(k).map(|o| (k.to_vec(), o.clone()));
        Self {
            capacity: store.capacity,
            pinned: store.pinned.iter().filter_map(|k| entry(k)).collect(),
            entries: store.order.iter().filter_map(|k| entry(k)).collect(),
            early: store.early.into_values().collect(),
        }
    }
}

fn bits(x: &[f64]) -> Key {
    x.iter().map(|v| v.to_bits()).collect()
}

impl Store {
    pub(crate) fn new(capacity: usize) -> Self {
        Self { capacity, ..Self::default() }
    }

    pub(crate) fn is_off(&self) -> bool {
        self.capacity == 0
    }

    /// Stores an evaluation permanently, regardless of the capacity.
    pub(crate) fn pin(&mut self, x: &[f64], answer: Answer) {
        self.key(x);
        let key: Box<[u64]> = self.key.as_slice().into();
        if self.cached.insert(key.clone(), answer).is_none() {
            self.pinned.push(key);
        }
    }

    /// Returns the number of permanent evaluations.
    pub(crate) fn n_pinned(&self) -> usize {
        self.pinned.len()
    }

    fn key(&mut self, x: &[f64]) {
        self.key.clear();
        self.key.extend(x.iter().map(|v| v.to_bits()));
    }

    /// True if the store contains a counted evaluation of the point.
    pub(crate) fn remembers(&self, x: &[f64]) -> bool {
        !self.cached.is_empty() && self.cached.contains_key(&bits(x))
    }

    /// True if the store contains any evaluation of the point.
    pub(crate) fn contains(&self, x: &[f64]) -> bool {
        !(self.cached.is_empty() && self.places.is_empty()) && {
            let key = bits(x);
            self.cached.contains_key(&key) || self.places.contains_key(&key)
        }
    }

    /// Returns the stored answer for a point, if it answers the query. "Above c" answers only queries with a
    /// cutoff up to c. A cost without residuals answers only queries without residuals.
    pub(crate) fn get(&mut self, x: &[f64], query: Query<'_>) -> Option<&Answer> {
        if self.cached.is_empty() {
            return None;
        }
        self.key(x);
        let answers = |entry: &&Answer| {
            entry.answers(query.kind) && !matches!(entry.outcome, Outcome::Above(c) if c < query.cutoff)
        };
        self.cached.get(&self.key[..]).filter(answers)
    }

    /// True if the point is only known to be above some cutoff.
    pub(crate) fn is_above(&mut self, x: &[f64]) -> bool {
        self.key(x);
        matches!(self.cached.get(&self.key[..]), Some(Answer { outcome: Outcome::Above(_), .. }))
    }

    /// Stores an evaluation, unless another evaluation of the point could have a different outcome.
    pub(crate) fn insert(&mut self, x: &[f64], answer: &Answer, kind: EvaluationKind) {
        if self.capacity == 0 || !answer.outcome.is_lasting() {
            return;
        }
        self.key(x);
        if let Some(entry) = self.cached.get_mut(&self.key[..]) {
            *entry = answer.only(kind);
            return;
        }
        while self.order.len() >= self.capacity {
            if let Some(oldest) = self.order.pop_front() {
                self.cached.remove(&oldest);
            }
        }
        let key: Box<[u64]> = self.key.as_slice().into();
        self.order.push_back(key.clone());
        self.cached.insert(key, answer.only(kind));
    }

    /// Keeps an early evaluation. Returns an evaluation that is not kept: the oldest if the store is full, or
    /// this one if its outcome is not lasting.
    pub(crate) fn keep(&mut self, early: EarlyOutcome) -> Option<EarlyOutcome> {
        let outcome = &early.entry.answer.outcome;
        if matches!(outcome, Outcome::Failed(_)) && !outcome.is_lasting() && !early.is_of_path {
            return Some(early);
        }
        self.n_residuals += early.entry.answer.residuals.len();
        self.n_replays += usize::from(early.is_of_path);
        self.places.entry(bits(&early.entry.x)).or_default().push_back(self.next);
        self.early.insert(self.next, early);
        self.next += 1;
        let is_full = self.early.len() > MOST_EARLY || self.n_residuals > MOST_EARLY_RESIDUALS;
        let oldest = self.early.iter().find(|(_, early)| !early.is_of_path).map(|(number, _)| *number);
        oldest.filter(|_| is_full).and_then(|number| self.remove(number))
    }

    fn remove(&mut self, number: u64) -> Option<EarlyOutcome> {
        let early = self.early.remove(&number)?;
        self.n_residuals -= early.entry.answer.residuals.len();
        self.n_replays -= usize::from(early.is_of_path);
        let key = bits(&early.entry.x);
        if let Some(numbers) = self.places.get_mut(&key) {
            numbers.retain(|n| *n != number);
            if numbers.is_empty() {
                self.places.remove(&key);
            }
        }
        Some(early)
    }

    /// Removes the early evaluation of a point that the path has reached. Returns its answer, or the
    /// evaluation itself if it does not answer this query.
    pub(crate) fn take(
        &mut self,
        x: &[f64],
        query: &Query<'_>,
        cutoff_use: CutoffUse,
    ) -> Option<Result<(Answer, bool), EarlyOutcome>> {
        if self.places.is_empty() {
            return None;
        }
        self.key(x);
        let number = *self.places.get(&self.key[..])?.front()?;
        let early = self.remove(number)?;
        Some(match early.entry.answer_to(query, cutoff_use) {
            Some(answer) => Ok((answer, early.is_of_path)),
            None => Err(early),
        })
    }

    /// Returns the known answer for a point if it answers this query, including early evaluations.
    pub(crate) fn look_up(&self, x: &[f64], query: &Query<'_>, cutoff_use: CutoffUse) -> Option<Answer> {
        let key = bits(x);
        if let Some(entry) = self.cached.get(&key) {
            let is_below = matches!(entry.outcome, Outcome::Above(c) if c < query.cutoff);
            return (entry.answers(query.kind) && !is_below).then(|| entry.only(query.kind));
        }
        let early = self.early.get(self.places.get(&key)?.front()?)?;
        early.entry.answer_to(query, cutoff_use)
    }

    /// Removes and returns all early evaluations.
    pub(crate) fn drain(&mut self) -> impl Iterator<Item = EarlyOutcome> {
        self.places.clear();
        (self.n_residuals, self.n_replays) = (0, 0);
        std::mem::take(&mut self.early).into_values()
    }

    /// True if there are evaluations of the path from before the run was resumed.
    pub(crate) fn has_replays(&self) -> bool {
        self.n_replays > 0
    }

    /// Removes evaluations of the path before the run was resumed, if the first batch did not need them.
    pub(crate) fn forget_replays(&mut self) {
        let replays: Vec<u64> =
            self.early.iter().filter(|(_, early)| early.is_of_path).map(|(number, _)| *number).collect();
        replays.into_iter().for_each(|number| drop(self.remove(number)));
    }

    /// Removes aborts after a run was resumed, because their exceptions belong to the previous process.
    pub(crate) fn forget_aborts(&mut self) {
        let is_abort = |early: &EarlyOutcome| matches!(early.entry.answer.outcome, Outcome::Abort(_));
        let aborts: Vec<u64> =
            self.early.iter().filter(|(_, early)| is_abort(early)).map(|(number, _)| *number).collect();
        aborts.into_iter().for_each(|number| drop(self.remove(number)));
    }

    /// True if all points have length `n`. A store read from a file may be inconsistent.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        self.early.values().all(|early| early.entry.x.len() == n)
            && self.cached.keys().all(|key| key.len() == n)
    }
}

impl SpeculativeEntry {
    /// Creates an entry for an answer that the path has not counted.
    pub(crate) fn new(id: u64, batch: u64, x: Vec<f64>, query: Query<'_>, answer: Answer) -> Self {
        let mut answer = answer.only(query.kind);
        if query.kind == EvaluationKind::Residuals {
            answer.check_residuals();
        }
        Self { id, batch, x, cutoff: query.cutoff, answer }
    }

    /// Returns the answer that the objective would have given to this query, if it can be derived.
    pub(crate) fn answer_to(&self, query: &Query<'_>, cutoff_use: CutoffUse) -> Option<Answer> {
        let cutoff = query.cutoff;
        let above =
            || Some(Answer { outcome: Outcome::Above(cutoff), ..self.answer.only(EvaluationKind::Cost) });
        match &self.answer.outcome {
            Outcome::Value(value) if *value > cutoff && cutoff_use == CutoffUse::Yes => above(),
            Outcome::Value(_) => self.answer.answers(query.kind).then(|| self.answer.only(query.kind)),
            Outcome::Above(c) => {
                if *c >= cutoff {
                    above()
                } else {
                    None
                }
            }
            // With a lower cutoff, the evaluation might have been abandoned earlier.
            Outcome::Failed(_) | Outcome::Abort(_) => {
                let same = self.cutoff == cutoff || cutoff_use == CutoffUse::No;
                same.then(|| self.answer.clone())
            }
            Outcome::Skipped => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::values::encoding::{decode, encode};

    fn get(store: &mut Store, x: f64, cutoff: f64) -> Option<Outcome> {
        store.get(&[x], Query::new(0, 0, cutoff)).map(|answer| answer.outcome.clone())
    }

    fn insert(store: &mut Store, x: f64, outcome: Outcome) {
        store.insert(&[x], &outcome.into(), EvaluationKind::Cost);
    }

    #[test]
    fn store_evicts_oldest_entries_first() {
        let mut store = Store::new(2);
        (0..3).map(f64::from).for_each(|k| insert(&mut store, k, Outcome::Value(k)));
        let outcome = |c: &mut Store, x: f64| get(c, x, f64::INFINITY);
        assert_eq!((outcome(&mut store, 0.0), outcome(&mut store, 2.0)), (None, Some(Outcome::Value(2.0))));
        let mut back: Store = decode(&encode(&store).unwrap()).unwrap();
        insert(&mut back, 9.0, Outcome::Value(9.0));
        assert_eq!((outcome(&mut back, 1.0), outcome(&mut back, 2.0)), (None, Some(Outcome::Value(2.0))));
    }

    #[test]
    fn above_outcome_answers_queries_up_to_its_cutoff() {
        let mut store = Store::new(4);
        insert(&mut store, 1.0, Outcome::Above(3.0));
        assert_eq!(get(&mut store, 1.0, 2.0), Some(Outcome::Above(3.0)));
        assert_eq!(get(&mut store, 1.0, 3.5), None);
        insert(&mut store, 1.0, Outcome::Value(7.0));
        assert_eq!(get(&mut store, 1.0, f64::INFINITY), Some(Outcome::Value(7.0)));
        insert(&mut store, 2.0, Outcome::cancelled());
        assert_eq!(get(&mut store, 2.0, 1.0), None);
        let mut pinned = Store::new(0);
        pinned.pin(&[5.0], Outcome::Value(1.0).into());
        insert(&mut pinned, 6.0, Outcome::Value(2.0));
        let mut back: Store = decode(&encode(&pinned).unwrap()).unwrap();
        let outcomes = (get(&mut back, 5.0, 1.0), get(&mut back, 6.0, 1.0));
        assert!(outcomes == (Some(Outcome::Value(1.0)), None) && back.is_off());
        let mut off = Store::new(0);
        insert(&mut off, 1.0, Outcome::Value(1.0));
        assert!(off.is_off() && get(&mut off, 1.0, 1.0).is_none());
    }

    #[test]
    fn cost_does_not_answer_query_for_residuals() {
        let mut store = Store::new(4);
        let query = Query::new(0, 0, f64::INFINITY).kind(EvaluationKind::Residuals);
        let answer = Answer { residuals: vec![1.0], ..Outcome::Value(1.0).into() };
        store.insert(&[1.0], &answer, EvaluationKind::Cost);
        assert_eq!(store.get(&[1.0], query), None);
        store.insert(&[1.0], &answer, EvaluationKind::Residuals);
        assert_eq!(store.get(&[1.0], query), Some(&answer));
        insert(&mut store, 2.0, Outcome::failed("no"));
        assert!(store.get(&[2.0], query).is_some());
    }
}
