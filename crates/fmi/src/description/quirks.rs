//! Collection of deviations from the standard, with a maximum number per class that keeps a report readable.

use super::model::{Quirk, QuirkKind};

/// Number of quirks per class that are kept with their lines. The others are only counted.
const KEPT: usize = 50;
/// Maximum number of characters in a message.
const LONGEST: usize = 500;

#[derive(Debug, Default)]
pub(super) struct Quirks {
    list: Vec<Quirk>,
    counts: Vec<(QuirkKind, usize)>,
}

impl Quirks {
    /// Records a quirk. The message is created only if it is kept.
    pub(super) fn add(&mut self, kind: QuirkKind, line: u32, message: impl FnOnce() -> String) {
        let count = match self.counts.iter_mut().find(|(counted, _)| *counted == kind) {
            Some((_, count)) => count,
            None => {
                self.counts.push((kind, 0));
                let last = self.counts.len() - 1;
                &mut self.counts[last].1
            }
        };
        *count += 1;
        if *count <= KEPT {
            let mut message = message();
            // Names in the message may be as long as the file.
            if let Some((end, _)) = message.char_indices().nth(LONGEST) {
                message.truncate(end);
                message.push_str("...");
                message.shrink_to_fit();
            }
            self.list.push(Quirk { kind, message, line });
        }
    }

    /// Returns the quirks sorted by line, with quirks of the whole file first. The counts of omitted quirks
    /// are at the end.
    pub(super) fn into_list(mut self) -> Vec<Quirk> {
        self.list.sort_by_key(|quirk| quirk.line);
        for (kind, count) in self.counts {
            if count > KEPT {
                let message = format!("{} more violations of the kind \"{kind}\"", count - KEPT);
                self.list.push(Quirk { kind, message, line: 0 });
            }
        }
        self.list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quirks_limit_the_number_kept_per_class() {
        let mut quirks = Quirks::default();
        for line in (1..=1000).rev() {
            quirks.add(QuirkKind::Undefined, line, || format!("unit {line}"));
        }
        quirks.add(QuirkKind::Missing, 2000, || "guid".to_owned());
        let list = quirks.into_list();
        assert_eq!(list.len(), KEPT + 2);
        assert!(list.is_sorted_by_key(|quirk| if quirk.line == 0 { u32::MAX } else { quirk.line }));
        assert_eq!(list[KEPT].message, "guid");
        assert!(list[KEPT + 1].message.starts_with("950 more"), "{}", list[KEPT + 1]);
    }
}
