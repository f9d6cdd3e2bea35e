//! Suggestions for misspelt names.

/// Returns the most similar name, if at most two fifths of its letters differ.
pub(crate) fn nearest<'n>(written: &str, names: impl IntoIterator<Item = &'n str>) -> Option<&'n str> {
    let requested = folded(written);
    let all = names.into_iter().map(|name| (edits(&requested, &folded(name)), name));
    let (edits, name) = all.min()?;
    (5 * edits <= 2 * name.len().max(written.len())).then_some(name)
}

/// Returns a name in lower case without separators, to compare spellings.
pub(crate) fn folded(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Returns the number of letters to change, add or remove to convert one word to the other (Levenshtein, Sov.
/// Phys. Dokl. 10, 1966).
pub(crate) fn edits(from: &str, to: &str) -> usize {
    let to: Vec<char> = to.chars().collect();
    let mut row: Vec<usize> = (0..=to.len()).collect();
    for (i, c) in from.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, d) in to.iter().enumerate() {
            let least = (diagonal + usize::from(c != *d)).min(row[j] + 1).min(row[j + 1] + 1);
            diagonal = std::mem::replace(&mut row[j + 1], least);
        }
    }
    row[to.len()]
}
