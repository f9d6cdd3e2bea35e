//! Remembered evaluations, by the bits of the point; bounded, the oldest go first.

use crate::answer::{Answer, Outcome, Want};
use crate::objective::Query;
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, VecDeque};

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(from = "Stored", into = "Stored")]
pub(crate) struct Cache {
    capacity: usize,
    known: HashMap<Box<[u64]>, Answer>,
    /// Keys in the order in which they came.
    order: VecDeque<Box<[u64]>>,
    /// Keys that stay.
    pinned: Vec<Box<[u64]>>,
    key: Vec<u64>,
}

/// A cache as a file holds it: in the order in which the points came.
#[derive(Clone, Serialize, Deserialize)]
struct Stored {
    capacity: usize,
    pinned: Vec<(Vec<u64>, Answer)>,
    entries: Vec<(Vec<u64>, Answer)>,
}

impl From<Stored> for Cache {
    fn from(stored: Stored) -> Self {
        let mut cache = Self::new(stored.capacity);
        let point = |key: Vec<u64>| -> Vec<f64> { key.into_iter().map(f64::from_bits).collect() };
        for (key, answer) in stored.pinned {
            cache.pin(&point(key), answer);
        }
        for (key, answer) in stored.entries {
            cache.insert(&point(key), &answer, Want::Residuals);
        }
        cache
    }
}

impl From<Cache> for Stored {
    fn from(cache: Cache) -> Self {
        let entry = |k: &[u64]| cache.known.get(k).map(|o| (k.to_vec(), o.clone()));
        Self {
            capacity: cache.capacity,
            pinned: cache.pinned.iter().filter_map(|k| entry(k)).collect(),
            entries: cache.order.iter().filter_map(|k| entry(k)).collect(),
        }
    }
}

impl Cache {
    pub(crate) fn new(capacity: usize) -> Self {
        Self { capacity, ..Self::default() }
    }

    pub(crate) fn is_off(&self) -> bool {
        self.capacity == 0
    }

    /// Remembers an evaluation for good, whatever the capacity.
    pub(crate) fn pin(&mut self, x: &[f64], answer: Answer) {
        self.key(x);
        let key: Box<[u64]> = self.key.as_slice().into();
        if self.known.insert(key.clone(), answer).is_none() {
            self.pinned.push(key);
        }
    }

    /// Evaluations that stay.
    pub(crate) fn n_pinned(&self) -> usize {
        self.pinned.len()
    }

    fn key(&mut self, x: &[f64]) {
        self.key.clear();
        self.key.extend(x.iter().map(|v| v.to_bits()));
    }

    /// Whether something is known of a point.
    pub(crate) fn contains(&self, x: &[f64]) -> bool {
        let key = || x.iter().map(|v| v.to_bits()).collect::<Vec<u64>>();
        !self.known.is_empty() && self.known.contains_key(&key()[..])
    }

    /// What is known of a point, if that answers the question: "above c" does only up to the cutoff c, a cost only where
    /// no residuals are wanted.
    pub(crate) fn get(&mut self, x: &[f64], query: Query<'_>) -> Option<&Answer> {
        if self.known.is_empty() {
            return None;
        }
        self.key(x);
        let answers = |known: &&Answer| {
            known.answers(query.want) && !matches!(known.outcome, Outcome::Above(c) if c < query.cutoff)
        };
        self.known.get(&self.key[..]).filter(answers)
    }

    /// Whether no more is known of a point than that it lies above some cutoff.
    pub(crate) fn is_above(&mut self, x: &[f64]) -> bool {
        self.key(x);
        matches!(self.known.get(&self.key[..]), Some(Answer { outcome: Outcome::Above(_), .. }))
    }

    /// Remembers an evaluation, unless it says nothing lasting about the point.
    pub(crate) fn insert(&mut self, x: &[f64], answer: &Answer, want: Want) {
        if self.capacity == 0 || !answer.outcome.is_lasting() {
            return;
        }
        self.key(x);
        if let Some(known) = self.known.get_mut(&self.key[..]) {
            *known = answer.only(want);
            return;
        }
        while self.order.len() >= self.capacity {
            if let Some(oldest) = self.order.pop_front() {
                self.known.remove(&oldest);
            }
        }
        let key: Box<[u64]> = self.key.as_slice().into();
        self.order.push_back(key.clone());
        self.known.insert(key, answer.only(want));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encoding::{decode, encode};

    fn get(cache: &mut Cache, x: f64, cutoff: f64) -> Option<Outcome> {
        cache.get(&[x], Query::new(0, 0, cutoff)).map(|known| known.outcome.clone())
    }

    fn insert(cache: &mut Cache, x: f64, outcome: Outcome) {
        cache.insert(&[x], &outcome.into(), Want::Cost);
    }

    #[test]
    fn the_oldest_go_first() {
        let mut cache = Cache::new(2);
        (0..3).map(f64::from).for_each(|k| insert(&mut cache, k, Outcome::Value(k)));
        let known = |c: &mut Cache, x: f64| get(c, x, f64::INFINITY);
        assert_eq!((known(&mut cache, 0.0), known(&mut cache, 2.0)), (None, Some(Outcome::Value(2.0))));
        let mut back: Cache = decode(&encode(&cache).unwrap()).unwrap();
        insert(&mut back, 9.0, Outcome::Value(9.0));
        assert_eq!((known(&mut back, 1.0), known(&mut back, 2.0)), (None, Some(Outcome::Value(2.0))));
    }

    #[test]
    fn above_a_cutoff_answers_up_to_it() {
        let mut cache = Cache::new(4);
        insert(&mut cache, 1.0, Outcome::Above(3.0));
        assert_eq!(get(&mut cache, 1.0, 2.0), Some(Outcome::Above(3.0)));
        assert_eq!(get(&mut cache, 1.0, 3.5), None);
        insert(&mut cache, 1.0, Outcome::Value(7.0));
        assert_eq!(get(&mut cache, 1.0, f64::INFINITY), Some(Outcome::Value(7.0)));
        insert(&mut cache, 2.0, Outcome::cancelled());
        assert_eq!(get(&mut cache, 2.0, 1.0), None);
        let mut pinned = Cache::new(0);
        pinned.pin(&[5.0], Outcome::Value(1.0).into());
        insert(&mut pinned, 6.0, Outcome::Value(2.0));
        let mut back: Cache = decode(&encode(&pinned).unwrap()).unwrap();
        let known = (get(&mut back, 5.0, 1.0), get(&mut back, 6.0, 1.0));
        assert!(known == (Some(Outcome::Value(1.0)), None) && back.is_off());
        let mut off = Cache::new(0);
        insert(&mut off, 1.0, Outcome::Value(1.0));
        assert!(off.is_off() && get(&mut off, 1.0, 1.0).is_none());
    }

    #[test]
    fn a_cost_does_not_answer_for_residuals() {
        let mut cache = Cache::new(4);
        let query = Query::new(0, 0, f64::INFINITY).want(Want::Residuals);
        let answer = Answer { residuals: vec![1.0], ..Outcome::Value(1.0).into() };
        cache.insert(&[1.0], &answer, Want::Cost);
        assert_eq!(cache.get(&[1.0], query), None);
        cache.insert(&[1.0], &answer, Want::Residuals);
        assert_eq!(cache.get(&[1.0], query), Some(&answer));
        insert(&mut cache, 2.0, Outcome::failed("no"));
        assert!(cache.get(&[2.0], query).is_some());
    }
}
