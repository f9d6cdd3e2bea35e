//! Outputs that are no 64-bit floating-point numbers: texts, bytes and 64-bit integers travel through rows of
//! numbers.
//!
//! A row of samples holds numbers only, and it alone knows at which instants samples are taken. So a text or
//! a binary value is one number in it, its place in a table of all values seen in the run, and a 64-bit
//! integer is two numbers, its halves. The columns stand behind those with names, and are put together again
//! when a trajectory is made.

use crate::description::{Value, VariableKind};
use crate::instance::integer_codec;
use std::collections::HashMap;
use std::hash::{BuildHasher, Hash};
use std::sync::Arc;

/// All texts and binary values of a run, each once.
#[derive(Debug, Default)]
pub(crate) struct ValueTable {
    /// Places of the values by their hashes.
    places: HashMap<u64, Vec<usize>>,
    values: Vec<Value>,
}

impl ValueTable {
    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        self.places.clear();
        self.values.clear();
    }

    /// The number that stands for a text, which most often is that of the row before, `last`; nothing is
    /// allocated for one that was there before.
    pub(crate) fn text(&mut self, text: &str, last: f64) -> f64 {
        let is = |value: &Value| matches!(value, Value::String(known) if known == text);
        self.place(text, last, is, || Value::String(text.to_owned()))
    }

    /// The number that stands for bytes; as for texts.
    pub(crate) fn bytes(&mut self, bytes: &[u8], last: f64) -> f64 {
        let is = |value: &Value| matches!(value, Value::Binary(known) if known == bytes);
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
        // Fewer values than 2^53 fit into any memory.
        place as f64
    }

    /// The values, for [`places`].
    pub(crate) fn into_values(self) -> Arc<[Value]> {
        self.values.into()
    }
}

/// The places in the table that the numbers of a column stand for.
pub(crate) fn places(numbers: &[f64]) -> Vec<usize> {
    numbers.iter().map(|number| *number as usize).collect()
}

/// The 64-bit integers of this kind whose halves stand in two columns.
pub(crate) fn integers(kind: VariableKind, high: &[f64], low: &[f64]) -> Arc<[Value]> {
    high.iter().zip(low).map(|(high, low)| integer_codec::value(kind, join(*high, *low))).collect()
}

/// Numbers that a value of this kind takes in a row beside (or in place of) the one with a name.
pub(crate) fn width(kind: VariableKind) -> usize {
    match kind {
        VariableKind::String | VariableKind::Binary => 1,
        VariableKind::Int64 | VariableKind::UInt64 => 2,
        _ => 0,
    }
}

/// The upper or lower half of a word, exactly.
pub(crate) fn half(word: i64, upper: bool) -> f64 {
    if upper { (word >> 32) as f64 } else { f64::from(word as u32) }
}

/// The word of two halves.
fn join(high: f64, low: f64) -> i64 {
    ((high as i64) << 32) | (low as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_exact() {
        for word in [0, 1, -1, i64::MIN, i64::MAX, (1 << 53) + 1, -(1 << 53) - 1, 0xffff_ffff, 1 << 32] {
            assert_eq!(join(half(word, true), half(word, false)), word);
        }
    }

    #[test]
    fn a_value_has_one_place() {
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
