//! What was ever set in a loaded copy of a library, and what new instances answer for it.

use crate::value::{Value, VariableKind};
use std::collections::HashMap;

/// A variable by its type and reference; aliases have the same.
pub(crate) type SetKey = (VariableKind, u32);

/// The variables that were ever set in a copy.
#[derive(Debug, Default)]
pub(crate) struct Record {
    /// Sorted.
    keys: Vec<SetKey>,
}

impl Record {
    /// Notes variables that are about to be set.
    pub(crate) fn note(&mut self, keys: impl IntoIterator<Item = SetKey>) {
        for key in keys {
            if let Err(place) = self.keys.binary_search(&key) {
                self.keys.insert(place, key);
            }
        }
    }

    /// The variables, sorted; their number tells whether there are new ones.
    pub(crate) fn keys(&self) -> &[SetKey] {
        &self.keys
    }

    /// Whether one of these was set.
    pub(crate) fn has_any(&self, keys: &[SetKey]) -> bool {
        keys.iter().any(|key| self.keys.binary_search(key).is_ok())
    }
}

/// What new instances of a library answer for variables that were not set; `None`: nothing is known of it.
pub(crate) type Defaults = HashMap<SetKey, Option<Value>>;
