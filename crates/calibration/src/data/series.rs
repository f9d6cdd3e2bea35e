//! Numbers shared by recordings, problems and their copies.

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::ops::Deref;
use std::sync::Arc;

/// Series of numbers. Copies share the memory until one of them is modified.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Series(Arc<[f64]>);

impl Series {
    /// Returns the numbers for modification in this copy only.
    pub(crate) fn to_mut(&mut self) -> &mut [f64] {
        Arc::make_mut(&mut self.0)
    }

    /// Returns the shared numbers.
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

impl From<&[f64]> for Series {
    fn from(values: &[f64]) -> Self {
        Self(values.into())
    }
}

impl FromIterator<f64> for Series {
    fn from_iter<T: IntoIterator<Item = f64>>(values: T) -> Self {
        Vec::from_iter(values).into()
    }
}

/// Returns the median spacing of ascending times, without repeated times.
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

/// Serializes a list of numbers in text formats, and little-endian bytes, which are smaller, in binary
/// formats.
impl Serialize for Series {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            return self.0.serialize(serializer);
        }
        if cfg!(target_endian = "little") {
            return serializer.serialize_bytes(bytemuck::cast_slice(&self.0));
        }
        let mut bytes = Vec::with_capacity(8 * self.len());
        self.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        serializer.serialize_bytes(&bytes)
    }
}

impl<'de> Deserialize<'de> for Series {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match deserializer.is_human_readable() {
            true => deserializer.deserialize_seq(Numbers),
            // Files of earlier versions also contain lists here.
            false => deserializer.deserialize_byte_buf(Numbers),
        }
    }
}

struct Numbers;

impl<'de> Visitor<'de> for Numbers {
    type Value = Series;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("numbers, or 8 bytes for each")
    }

    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Series, E> {
        match bytes.as_chunks::<8>() {
            (words, []) => Ok(words.iter().map(|word| f64::from_le_bytes(*word)).collect()),
            _ => Err(E::invalid_length(bytes.len(), &self)),
        }
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut numbers: A) -> Result<Series, A::Error> {
        let mut values = Vec::new();
        while let Some(value) = numbers.next_element()? {
            values.push(value);
        }
        Ok(values.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_serializes_compactly_bit_for_bit_and_reads_old_lists() {
        let series = Series::from(vec![1.5, -0.0, f64::NAN, 1e-310, f64::INFINITY]);
        let bits = |series: &Series| series.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        let (mut bytes, mut list) = (Vec::new(), Vec::new());
        ciborium::into_writer(&series, &mut bytes).unwrap();
        ciborium::into_writer(&series.to_vec(), &mut list).unwrap();
        assert_eq!(bytes.len(), 2 + 8 * series.len());
        for stored in [&bytes[..], &list] {
            assert_eq!(bits(&ciborium::from_reader(stored).unwrap()), bits(&series));
        }
        let finite = Series::from(vec![1.5, -0.1]);
        assert_eq!(serde_json::to_string(&finite).unwrap(), "[1.5,-0.1]");
        assert_eq!(serde_json::from_str::<Series>("[1.5,-0.1]").unwrap(), finite);
        assert!(ciborium::from_reader::<Series, _>(&[0x43, 1, 2, 3][..]).is_err());
    }
}
