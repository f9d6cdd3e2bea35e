//! Lookup of variables by name: a hash index, and suggestions for unknown names.

use super::variable::{Alias, Variable};
use std::collections::HashMap;
use std::hash::{BuildHasher, RandomState};

/// Open-addressing table of indices into the list of variables. The names stay in the variables. Hash keys
/// are random, so that a file cannot cause collisions deliberately.
#[derive(Clone, Default)]
pub(super) struct NameIndex {
    /// Index + 1, or 0 for an empty slot. The length is a power of two, and at most half of the slots are
    /// used.
    slots: Vec<u32>,
    hasher: RandomState,
}

impl NameIndex {
    /// Indexes the variables. If several variables have the same name, the first is used. For each of the
    /// others, `duplicate` is called with its index and the index of the first.
    pub(super) fn build(variables: &[Variable], mut duplicate: impl FnMut(usize, usize)) -> Self {
        let n_slots = (2 * variables.len() + 1).next_power_of_two();
        let mut index = NameIndex { slots: vec![0; n_slots], hasher: RandomState::new() };
        for (position, variable) in variables.iter().enumerate() {
            match index.probe(&variable.name, variables) {
                (_, Some(first)) => duplicate(position, first),
                (slot, None) => index.slots[slot] = position as u32 + 1,
            }
        }
        index
    }

    /// Returns the index of the variable with this name.
    pub(super) fn find(&self, name: &str, variables: &[Variable]) -> Option<usize> {
        if self.slots.is_empty() { None } else { self.probe(name, variables).1 }
    }

    /// Returns the slot where the search for `name` ends, and the variable index in the slot if the name
    /// matches.
    fn probe(&self, name: &str, variables: &[Variable]) -> (usize, Option<usize>) {
        let mask = self.slots.len() - 1;
        let mut slot = self.hasher.hash_one(name) as usize & mask;
        loop {
            let entry = self.slots[slot];
            if entry == 0 {
                return (slot, None);
            }
            let position = entry as usize - 1;
            if variables.get(position).is_some_and(|variable| variable.name == name) {
                return (slot, Some(position));
            }
            slot = (slot + 1) & mask;
        }
    }
}

/// Returns the indices of variables by alias. A variable name takes precedence over an alias, and an earlier
/// alias over a later one. For each ignored alias, `duplicate` is called with its index, the alias and the
/// index of the first variable.
pub(super) fn aliases(
    variables: &[Variable],
    names: &NameIndex,
    mut duplicate: impl FnMut(usize, &str, usize),
) -> HashMap<String, usize> {
    let mut found: HashMap<String, usize> = HashMap::new();
    for (position, variable) in variables.iter().enumerate() {
        for Alias { name, .. } in &variable.aliases {
            match names.find(name, variables).or_else(|| found.get(name).copied()) {
                Some(first) => duplicate(position, name, first),
                None => {
                    found.insert(name.clone(), position);
                }
            }
        }
    }
    found
}

/// The index is derived from the variables, so comparisons ignore it.
impl PartialEq for NameIndex {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl std::fmt::Debug for NameIndex {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "NameIndex({} slots)", self.slots.len())
    }
}

/// Maximum length of a name for which similar names are searched.
const LONGEST_WANTED: usize = 100;

/// Minimum number of characters that count as a common word of two names.
const SHORTEST_WORD: usize = 4;

/// Returns at most `n` names similar to `wanted`, the most similar first. Equally similar names are in file
/// order.
pub(super) fn nearest<'a>(wanted: &str, names: impl Iterator<Item = &'a str>, n: usize) -> Vec<&'a str> {
    let mut search = Search::new(wanted);
    let mut best: Vec<(usize, &str)> = Vec::with_capacity(n + 1);
    for name in names {
        let Some(distance) = search.distance(name) else { continue };
        let place = best.partition_point(|(other, _)| *other <= distance);
        if place < n {
            best.insert(place, (distance, name));
            best.truncate(n);
        }
    }
    best.into_iter().map(|(_, name)| name).collect()
}

/// Bounded search for names similar to one name, ignoring case. Memory is reused for each name.
struct Search {
    wanted: Vec<char>,
    /// Maximum distance of similar names: a third of the length plus one.
    limit: usize,
    name: Vec<char>,
    rows: [Vec<usize>; 3],
}

impl Search {
    fn new(wanted: &str) -> Self {
        let wanted: Vec<char> = wanted.chars().take(LONGEST_WANTED).flat_map(char::to_lowercase).collect();
        let limit = 1 + wanted.len() / 3;
        Search { wanted, limit, name: Vec::new(), rows: Default::default() }
    }

    /// Returns the distance of a name if it is within the limit. The last component of a name also matches,
    /// for example `phi` for `joint.phi`.
    fn distance(&mut self, name: &str) -> Option<usize> {
        if name.len() > 16 * LONGEST_WANTED {
            return None;
        }
        self.name.clear();
        self.name.extend(name.chars().flat_map(char::to_lowercase));
        let longer = self.name.len().checked_sub(self.wanted.len() + 1);
        if !self.wanted.is_empty()
            && longer.is_some_and(|at| self.name[at] == '.' && self.name[at + 1..] == self.wanted[..])
        {
            return Some(1);
        }
        let is_near = self.name.len().abs_diff(self.wanted.len()) <= self.limit;
        let edits = if is_near { self.edits() } else { None };
        edits.or_else(|| self.shares_a_word().then_some(self.limit + 1))
    }

    /// True if the name contains the wanted name, or begins with at least half of it. For example,
    /// `fricScale` and `joint.friction` match `friction`.
    fn shares_a_word(&self) -> bool {
        let same = self.name.iter().zip(&self.wanted).take_while(|(a, b)| a == b).count();
        let n = self.wanted.len();
        n >= SHORTEST_WORD
            && ((same >= SHORTEST_WORD && 2 * same >= n)
                || self.name.windows(n).any(|part| part == self.wanted))
    }

    /// Returns the number of insertions, deletions, replacements and swaps of adjacent characters between the
    /// two names (optimal string alignment). Returns `None` if it exceeds `limit`.
    fn edits(&mut self) -> Option<usize> {
        let (a, b) = (&self.wanted, &self.name);
        let [before, last, row] = &mut self.rows;
        last.clear();
        last.extend(0..=b.len());
        before.clone_from(last);
        row.clone_from(last);
        for i in 1..=a.len() {
            row[0] = i;
            let mut smallest = i;
            for j in 1..=b.len() {
                let mut edits =
                    (last[j] + 1).min(row[j - 1] + 1).min(last[j - 1] + usize::from(a[i - 1] != b[j - 1]));
                if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                    edits = edits.min(before[j - 2] + 1);
                }
                row[j] = edits;
                smallest = smallest.min(edits);
            }
            if smallest > self.limit {
                return None;
            }
            std::mem::swap(before, last);
            std::mem::swap(last, row);
        }
        Some(last[b.len()]).filter(|&edits| edits <= self.limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near<'a>(wanted: &str, names: &[&'a str]) -> Vec<&'a str> {
        nearest(wanted, names.iter().copied(), 3)
    }

    #[test]
    fn nearest_names_tolerate_typing_errors() {
        let names = ["armJoint.phi", "armJoint.w", "pendulumJoint.phi", "armFriction", "time"];
        assert_eq!(near("armFrction", &names), ["armFriction"]);
        assert_eq!(near("armFritcion", &names), ["armFriction"]);
        assert_eq!(near("ARMFRICTION", &names), ["armFriction"]);
        assert_eq!(near("armJoint.phj", &names), ["armJoint.phi", "armJoint.w"]);
        assert_eq!(near("phi", &names), ["armJoint.phi", "pendulumJoint.phi"]);
        assert!(near("voltage", &names).is_empty());
    }

    #[test]
    fn nearest_returns_at_most_n_names_sorted_by_distance() {
        assert_eq!(near("abcd", &["abxx", "abcx", "abcd1", "zbcd", "abcd"]), ["abcd", "abcx", "abcd1"]);
        assert!(nearest("a", ["a"].into_iter(), 0).is_empty());
    }

    #[test]
    fn nearest_handles_empty_and_very_long_names() {
        let long = "x".repeat(100_000);
        assert!(near(&long, &["x", ""]).is_empty());
        assert!(near("", &["time", &long]).is_empty());
        assert_eq!(near("\u{e4}", &["\u{c4}"]), ["\u{c4}"]);
    }

    #[test]
    fn distance_counts_a_swap_as_one_edit() {
        let mut search = Search::new("abcdefghi");
        assert_eq!(search.distance("abdcefghi"), Some(1));
        assert_eq!(search.distance("abcdefghi"), Some(0));
        assert_eq!(search.distance("bcdefgh"), Some(2));
    }
}
