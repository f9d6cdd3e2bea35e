//! Numbers that recordings, problems and their copies share.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::ops::Deref;
use std::sync::Arc;

/// A series of numbers. Copies share the memory until one of them is changed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Series(Arc<[f64]>);

impl Series {
    /// The numbers, to be changed: those of this copy alone.
    pub(crate) fn to_mut(&mut self) -> &mut [f64] {
        Arc::make_mut(&mut self.0)
    }

    /// The numbers as they are shared.
    pub(crate) fn shared(&self) -> Arc<[f64]> {
        Arc::clone(&self.0)
    }
}

impl Deref for Series {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        &self.0
    }
}

impl From<Vec<f64>> for Series {
    fn from(values: Vec<f64>) -> Self {
        Self(values.into())
    }
}

impl FromIterator<f64> for Series {
    fn from_iter<T: IntoIterator<Item = f64>>(values: T) -> Self {
        Vec::from_iter(values).into()
    }
}

/// The distance of ascending times from each other: the median, without times that stand twice.
pub(crate) fn sampling_interval(times: &[f64]) -> Option<f64> {
    let mut distances: Vec<f64> =
        times.windows(2).map(|pair| pair[1] - pair[0]).filter(|d| *d > 0.0).collect();
    let middle = distances.len().checked_sub(1)? / 2;
    Some(*distances.select_nth_unstable_by(middle, f64::total_cmp).1)
}

impl<'a> IntoIterator for &'a Series {
    type Item = &'a f64;
    type IntoIter = std::slice::Iter<'a, f64>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl Serialize for Series {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Series {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Vec::deserialize(deserializer).map(Self::from)
    }
}
