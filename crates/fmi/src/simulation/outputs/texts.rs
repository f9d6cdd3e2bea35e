//! Outputs that are not 64-bit floating-point numbers: strings, bytes and 64-bit integers, stored in rows of
//! numbers.
//!
//! A row of samples contains only numbers, and only rows have sample times. Therefore a string or binary
//! value is stored as its index in a table of all values of the run. A 64-bit integer is stored as two
//! numbers, its halves. These columns follow the named columns. They are converted back when a trajectory is
//! created.

use crate::description::{Value, VariableKind};
use crate::instance::integer_codec;
use std::collections::HashMap;
use std::hash::{BuildHasher, Hash};
use std::sync::Arc;

/// All strings and binary values of a run, each once.
#[derive(Debug, Default)]
pub(crate) struct ValueTable {
    /// Indices of the values, by hash.
    places: HashMap<u64, Vec<usize>>,
    values: Vec<Value>,
}

impl ValueTable {
    /// Clears the table.
    pub(crate) fn clear(&mut self) {
        self.places.clear();
        self.values.clear();
    }

    /// Returns the number for a string. `last` is the number in the previous row, which is usually the same.
    /// A known string causes no allocation.
    pub(crate) fn text(&mut self, text: &str, last: f64) -> f64 {
        let is = |value: &Value| matches!(value, Value::String(stored) if stored == text);
        self.place(text, last, is, || Value::String(text.to_owned()))
    }

    /// Returns the number for bytes, as [`text`](Self::text) does for strings.
    pub(crate) fn bytes(&mut self, bytes: &[u8], last: f64) -> f64 {
        let is = |value: &Value| matches!(value, Value::Binary(stored) if stored == bytes);
        self.place(bytes, last, is, || Value::Binary(bytes.to_vec()))
    }

    fn place(
        &mut self,
        hashed: impl Hash,
        last: f64,
        is: impl Fn(&Value) -> bool,
        make: impl FnOnce() -> Value,
    ) -> f64 {
        let Self { places, values } = self;
        if values.get(last as usize).is_some_and(&is) {
            return last;
        }
        let alike = places.entry(places.hasher().hash_one(hashed)).or_default();
        let place = alike.iter().copied().find(|place| is(&values[*place])).unwrap_or_else(|| {
            alike.push(values.len());
            values.push(make());
            values.len() - 1
        });
        // The conversion is exact, because no memory can hold 2^53 values.
        place as f64
    }

    /// Returns the values to which the indices of [`places`] refer.
    pub(crate) fn into_values(self) -> Arc<[Value]> {
        self.values.into()
    }
}

/// Converts the numbers of a column to indices into the table.
pub(crate) fn places(numbers: &[f64]) -> Vec<usize> {
    numbers.iter().map(|number| *number as usize).collect()
}

/// Returns the 64-bit integers of this kind from two columns with their halves.
pub(crate) fn integers(kind: VariableKind, high: &[f64], low: &[f64]) -> Arc<[Value]> {
    high.iter().zip(low).map(|(high, low)| integer_codec::value(kind, join(*high, *low))).collect()
}

/// Returns the number of unnamed columns for a value of this kind. Strings and binary values have no named
/// column.
pub(crate) fn width(kind: VariableKind) -> usize {
    match kind {
        VariableKind::String | VariableKind::Binary => 1,
        VariableKind::Int64 | VariableKind::UInt64 => 2,
        _ => 0,
    }
}

/// Returns the upper or lower half of a word, exactly.
pub(crate) fn half(word: i64, upper: bool) -> f64 {
    if upper { (word >> 32) as f64 } else { f64::from(word as u32) }
}

/// Combines two halves to a word.
fn join(high: f64, low: f64) -> i64 {
    ((high as i64) << 32) | (low as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_join_to_the_same_word() {
        for word in [0, 1, -1, i64::MIN, i64::MAX, (1 << 53) + 1, -(1 << 53) - 1, 0xffff_ffff, 1 << 32] {
            assert_eq!(join(half(word, true), half(word, false)), word);
        }
    }

    #[test]
    fn table_stores_each_value_once() {
        let mut table = ValueTable::default();
        let mut last = 0.0;
        let mut text = |table: &mut ValueTable, text| {
            last = table.text(text, last);
            last
        };
        let numbers = [
            text(&mut table, "a"),
            table.bytes(b"a", 0.0),
            text(&mut table, ""),
            text(&mut table, ""),
            text(&mut table, "a"),
        ];
        assert_eq!(numbers, [0.0, 1.0, 2.0, 2.0, 0.0]);
        let values = table.into_values();
        assert_eq!(*values, ["a".into(), Value::Binary(b"a".to_vec()), "".into()]);
    }
}
