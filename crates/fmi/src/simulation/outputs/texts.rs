//! Outputs that are no 64-bit floating-point numbers: texts, bytes and 64-bit integers travel through rows of numbers.
//!
//! A row of samples holds numbers only, and it alone knows at which instants samples are taken. So a text or a binary
//! value is one number in it, its place in a table of all values seen in the run, and a 64-bit integer is two numbers,
//! its halves. The columns stand behind those with names, and are put together again when a trajectory is made.

use crate::description::{Value, VariableKind};
use crate::instance::integer_codec;
use std::collections::HashMap;

/// All texts and binary values of a run, each once.
#[derive(Debug, Default)]
pub(crate) struct ValueTable {
    texts: HashMap<String, usize>,
    binaries: HashMap<Vec<u8>, usize>,
    values: Vec<Value>,
}

impl ValueTable {
    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        self.texts.clear();
        self.binaries.clear();
        self.values.clear();
    }

    /// The number that stands for a text; nothing is allocated for one that was there before.
    pub(crate) fn text(&mut self, text: &str) -> f64 {
        // Fewer values than 2^53 fit into any memory.
        if let Some(place) = self.texts.get(text) {
            return *place as f64;
        }
        let place = self.values.len();
        self.values.push(Value::String(text.to_owned()));
        self.texts.insert(text.to_owned(), place);
        place as f64
    }

    /// The number that stands for bytes; as for texts.
    pub(crate) fn bytes(&mut self, bytes: &[u8]) -> f64 {
        if let Some(place) = self.binaries.get(bytes) {
            return *place as f64;
        }
        let place = self.values.len();
        self.values.push(Value::Binary(bytes.to_vec()));
        self.binaries.insert(bytes.to_vec(), place);
        place as f64
    }

    /// The value that a number stands for; empty text if it stands for none.
    fn value(&self, number: f64) -> Value {
        self.values.get(number as usize).cloned().unwrap_or_else(|| Value::String(String::new()))
    }

    /// The values behind the numbers of the columns (one or two) that [`width`] says.
    pub(crate) fn decode(&self, kind: VariableKind, columns: &[Vec<f64>]) -> Vec<Value> {
        match columns {
            [places] => places.iter().map(|number| self.value(*number)).collect(),
            [high, low] => {
                let words = high.iter().zip(low).map(|(high, low)| join(*high, *low));
                words.map(|word| integer_codec::value(kind, word)).collect()
            }
            _ => Vec::new(),
        }
    }
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
        let numbers = [table.text("a"), table.bytes(b"a"), table.text(""), table.text("a")];
        assert_eq!(numbers, [0.0, 1.0, 2.0, 0.0]);
        let values = table.decode(VariableKind::String, &[numbers.to_vec()]);
        assert_eq!(values, ["a".into(), Value::Binary(b"a".to_vec()), "".into(), "a".into()]);
        table.clear();
        assert_eq!(table.text("b"), 0.0);
    }
}
