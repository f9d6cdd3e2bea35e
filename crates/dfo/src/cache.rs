//! Remembered evaluations, by the bits of the point; bounded, the oldest go first.

use crate::objective::{FailureKind, Outcome};
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, VecDeque};

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(from = "Stored", into = "Stored")]
pub(crate) struct Cache {
    capacity: usize,
    known: HashMap<Box<[u64]>, Outcome>,
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
    pinned: Vec<(Vec<u64>, Outcome)>,
    entries: Vec<(Vec<u64>, Outcome)>,
}

impl From<Stored> for Cache {
    fn from(stored: Stored) -> Self {
        let mut cache = Self::new(stored.capacity);
        let point = |key: Vec<u64>| -> Vec<f64> { key.into_iter().map(f64::from_bits).collect() };
        for (key, outcome) in stored.pinned {
            cache.pin(&point(key), &outcome);
        }
        for (key, outcome) in stored.entries {
            cache.insert(&point(key), &outcome);
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
    pub(crate) fn pin(&mut self, x: &[f64], outcome: &Outcome) {
        self.key(x);
        let key: Box<[u64]> = self.key.as_slice().into();
        if self.known.insert(key.clone(), outcome.clone()).is_none() {
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

    /// What is known of a point, if that answers the question: "above c" does only up to the cutoff c.
    pub(crate) fn get(&mut self, x: &[f64], cutoff: f64) -> Option<&Outcome> {
        if self.known.is_empty() {
            return None;
        }
        self.key(x);
        self.known.get(&self.key[..]).filter(|o| !matches!(o, Outcome::Above(c) if *c < cutoff))
    }

    /// Remembers an evaluation, unless it says nothing lasting about the point.
    pub(crate) fn insert(&mut self, x: &[f64], outcome: &Outcome) {
        let passing = |kind| matches!(kind, FailureKind::Cancelled | FailureKind::TimedOut);
        if self.capacity == 0
            || !outcome.is_known()
            || matches!(outcome, Outcome::Failed(f) if passing(f.kind))
        {
            return;
        }
        self.key(x);
        if let Some(known) = self.known.get_mut(&self.key[..]) {
            known.clone_from(outcome);
            return;
        }
        while self.order.len() >= self.capacity {
            if let Some(oldest) = self.order.pop_front() {
                self.known.remove(&oldest);
            }
        }
        let key: Box<[u64]> = self.key.as_slice().into();
        self.order.push_back(key.clone());
        self.known.insert(key, outcome.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_go_first() {
        let mut cache = Cache::new(2);
        for k in 0..3 {
            cache.insert(&[f64::from(k)], &Outcome::Value(f64::from(k)));
        }
        let known = |c: &mut Cache, k: f64| c.get(&[k], f64::INFINITY).cloned();
        assert_eq!(known(&mut cache, 0.0), None);
        assert_eq!(known(&mut cache, 2.0), Some(Outcome::Value(2.0)));
        let bytes = postcard::to_allocvec(&cache).unwrap();
        let mut back: Cache = postcard::from_bytes(&bytes).unwrap();
        back.insert(&[9.0], &Outcome::Value(9.0));
        assert_eq!((known(&mut back, 1.0), known(&mut back, 2.0)), (None, Some(Outcome::Value(2.0))));
    }

    #[test]
    fn above_a_cutoff_answers_up_to_it() {
        let mut cache = Cache::new(4);
        cache.insert(&[1.0], &Outcome::Above(3.0));
        assert_eq!(cache.get(&[1.0], 2.0), Some(&Outcome::Above(3.0)));
        assert_eq!(cache.get(&[1.0], 3.5), None);
        cache.insert(&[1.0], &Outcome::Value(7.0));
        assert_eq!(cache.get(&[1.0], f64::INFINITY), Some(&Outcome::Value(7.0)));
        cache.insert(&[2.0], &Outcome::cancelled());
        assert_eq!(cache.get(&[2.0], 1.0), None);
        let mut pinned = Cache::new(0);
        pinned.pin(&[5.0], &Outcome::Value(1.0));
        pinned.insert(&[6.0], &Outcome::Value(2.0));
        let mut back: Cache = postcard::from_bytes(&postcard::to_allocvec(&pinned).unwrap()).unwrap();
        assert!(back.get(&[5.0], 1.0).is_some() && back.get(&[6.0], 1.0).is_none() && back.is_off());
        let mut off = Cache::new(0);
        off.insert(&[1.0], &Outcome::Value(1.0));
        assert!(off.is_off() && off.get(&[1.0], 1.0).is_none());
    }
}
