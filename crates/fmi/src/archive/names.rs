//! Names of archive entries: checks for names that are safe to unpack on every system, and for collisions.

use crate::error::EntryProblem;
use crate::macros::getters;
use std::borrow::Cow;
use std::collections::HashMap;
use std::collections::hash_map::Entry;

/// Name of the description, which every FMU has at its root.
pub(crate) const MODEL_DESCRIPTION: &str = "modelDescription.xml";

/// Maximum length in bytes of a whole name, and of one component (limit of file systems).
const LONGEST_NAME: usize = 1024;
const LONGEST_COMPONENT: usize = 255;
/// Maximum number of components. Limits the work per entry.
const DEEPEST: usize = 64;

/// Normalizes a name as Info-ZIP does. Backslashes, which some Windows tools write, become slashes. Empty
/// components and `.` are removed. Components that lead out of the archive are kept.
pub(super) fn normalized(name: &str) -> String {
    let slashes = name.replace('\\', "/");
    let kept = |component: &&str| !matches!(*component, "" | ".");
    let mut path = slashes.split('/').filter(kept).collect::<Vec<_>>().join("/");
    if slashes.starts_with('/') {
        path.insert(0, '/');
    }
    let last = slashes.rsplit('/').next().unwrap_or_default();
    if !kept(&last) && !path.is_empty() && !path.ends_with('/') {
        path.push('/');
    }
    path
}

/// Rejects names that lead outside the target folder, on this or another system. A single slash at the end
/// marks a folder and is not part of the name.
pub(super) fn check(name: &str) -> Result<(), EntryProblem> {
    if name.len() > LONGEST_NAME {
        return Err(EntryProblem::NameTooLong { found: name.len(), limit: LONGEST_NAME });
    }
    let is_harmless = |byte: u8| (b' '..=b'~').contains(&byte) && byte != b'\\';
    if !name.bytes().all(is_harmless)
        && let Some(c) = name.chars().find(|&c| c == '\\' || c.is_control())
    {
        return Err(EntryProblem::ForbiddenCharacter(c));
    }
    if name.starts_with('/') || has_drive(name) {
        return Err(EntryProblem::Absolute);
    }
    let path = name.strip_suffix('/').unwrap_or(name);
    if path.split('/').count() > DEEPEST {
        return Err(EntryProblem::TooDeep { limit: DEEPEST });
    }
    path.split('/').try_for_each(check_component)
}

fn check_component(component: &str) -> Result<(), EntryProblem> {
    match component {
        "" => Err(EntryProblem::EmptyName),
        "." | ".." => Err(EntryProblem::Traversal),
        long if long.len() > LONGEST_COMPONENT => {
            Err(EntryProblem::NameTooLong { found: long.len(), limit: LONGEST_COMPONENT })
        }
        other if !crate::platform::is_file_name(other) => Err(EntryProblem::ReservedName),
        _ => Ok(()),
    }
}

fn has_drive(name: &str) -> bool {
    matches!(name.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic())
}

/// Names added so far, compared as on a case-insensitive file system.
#[derive(Default)]
pub(super) struct Names<'a> {
    seen: HashMap<Cow<'a, str>, Seen<'a>>,
    /// Number of names added.
    added: usize,
    folders: u64,
    /// Folder of the last name, because names in one folder usually follow each other.
    last_folder: &'a str,
}

struct Seen<'a> {
    name: &'a str,
    /// Index of the name that first contained it.
    position: usize,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    File,
    /// A folder with a separate entry, or one that occurs only as part of other names.
    Folder,
}

impl<'a> Names<'a> {
    getters! {
        /// Returns the number of files and folders, including folders without a separate entry.
        pub(super) count(self) -> u64 = self.seen.len() as u64;
        /// Returns the number of folders.
        pub(super) n_folders(self) -> u64 = self.folders;
    }

    /// Creates a set with capacity for `n` names.
    pub(super) fn with_capacity(n: usize) -> Self {
        Self { seen: HashMap::with_capacity(n), ..Self::default() }
    }

    /// Adds a checked name. Returns an error if it collides with another one. Folders may be listed more than
    /// once.
    pub(super) fn add(&mut self, name: &'a str, is_folder: bool) -> Result<(), EntryProblem> {
        let path = name.strip_suffix('/').unwrap_or(name);
        self.added += 1;
        let folder = path.rfind('/').map_or("", |end| &path[..end]);
        if folder != self.last_folder {
            self.add_folders(path)?;
            self.last_folder = folder;
        }
        self.add_one(path, if is_folder { Kind::Folder } else { Kind::File })
    }

    /// Adds the parent folders of a path, below the deepest known one. The parents of a known folder are also
    /// known.
    fn add_folders(&mut self, path: &'a str) -> Result<(), EntryProblem> {
        let mut above = path.rmatch_indices('/').map(|(end, _)| end);
        let end_of_known = above.find(|&end| self.is_folder(&path[..end])).map_or(0, |end| end + 1);
        for (end, _) in path[end_of_known..].match_indices('/') {
            self.add_one(&path[..end_of_known + end], Kind::Folder)?;
        }
        Ok(())
    }

    /// True if a folder with exactly this name was added.
    fn is_folder(&self, name: &str) -> bool {
        self.seen.get(&*fold(name)).is_some_and(|seen| seen.name == name && seen.kind == Kind::Folder)
    }

    /// Returns the index, counted from 0, of the first added name that equals this one (or contains it as a
    /// leading part).
    pub(super) fn position(&self, name: &str) -> Option<usize> {
        self.seen.get(&*fold(name)).map(|seen| seen.position)
    }

    /// Adds a name or a leading part of one.
    fn add_one(&mut self, part: &'a str, kind: Kind) -> Result<(), EntryProblem> {
        let position = self.added - 1;
        let seen = match self.seen.entry(fold(part)) {
            Entry::Vacant(vacant) => {
                vacant.insert(Seen { name: part, position, kind });
                self.folders += u64::from(kind == Kind::Folder);
                return Ok(());
            }
            Entry::Occupied(occupied) => occupied.into_mut(),
        };
        if seen.name != part {
            return Err(EntryProblem::CaseDuplicate(seen.name.to_owned()));
        }
        match (seen.kind, kind) {
            (Kind::Folder, Kind::Folder) => Ok(()),
            (Kind::File, Kind::File) => Err(EntryProblem::Duplicate),
            _ => Err(EntryProblem::FileAndFolder(part.to_owned())),
        }
    }
}

/// Returns approximately the form in which case-insensitive file systems compare names. Converts to upper
/// case, then to lower case, so that letters with two lower-case forms become equal.
fn fold(name: &str) -> Cow<'_, str> {
    if !name.is_ascii() {
        Cow::Owned(name.to_uppercase().to_lowercase())
    } else if name.bytes().any(|byte| byte.is_ascii_uppercase()) {
        Cow::Owned(name.to_ascii_lowercase())
    } else {
        Cow::Borrowed(name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entry_names_are_normalized_as_by_info_zip() {
        for (name, expected) in [
            ("./modelDescription.xml", "modelDescription.xml"),
            ("binaries\\linux64\\m.so", "binaries/linux64/m.so"),
            (".\\resources\\", "resources/"),
            ("./", ""),
            (".", ""),
            ("a//./b/", "a/b/"),
            ("a/.", "a/"),
            ("\\a", "/a"),
            ("\\\\host\\a", "/host/a"),
            ("/", "/"),
            ("..\\a", "../a"),
            ("a\\..\\..\\b", "a/../../b"),
            ("C:\\a", "C:/a"),
            ("", ""),
        ] {
            assert_eq!(normalized(name), expected, "{name:?}");
        }
    }

    #[test]
    fn entry_names_accept_ordinary_names() {
        for name in ["modelDescription.xml", "binaries/", "a/b c/\u{e4}.txt", "a..b", "sources/a.c"] {
            assert_eq!(check(name), Ok(()), "{name}");
        }
        // Windows reserves such names.
        for name in ["...", "10:30.txt"] {
            assert_eq!(check(name).is_ok(), !cfg!(windows), "{name}");
        }
    }

    #[test]
    fn entry_names_reject_paths_outside_folder() {
        for (name, problem) in [
            ("", EntryProblem::EmptyName),
            ("a//b", EntryProblem::EmptyName),
            ("a//", EntryProblem::EmptyName),
            ("../a", EntryProblem::Traversal),
            ("a/../b", EntryProblem::Traversal),
            ("a/..", EntryProblem::Traversal),
            ("./a", EntryProblem::Traversal),
            ("/a", EntryProblem::Absolute),
            ("/", EntryProblem::Absolute),
            ("C:/a", EntryProblem::Absolute),
            ("c:a", EntryProblem::Absolute),
            ("a\\b", EntryProblem::ForbiddenCharacter('\\')),
            ("a\0b", EntryProblem::ForbiddenCharacter('\0')),
            ("a\nb", EntryProblem::ForbiddenCharacter('\n')),
        ] {
            assert_eq!(check(name), Err(problem), "{name:?}");
        }
    }

    #[test]
    fn entry_names_reject_long_and_deep_paths() {
        let long = "x".repeat(256);
        assert_eq!(check(&long), Err(EntryProblem::NameTooLong { found: 256, limit: 255 }));
        assert_eq!(check(&"x/".repeat(513)), Err(EntryProblem::NameTooLong { found: 1026, limit: 1024 }));
        assert_eq!(check(&"x/".repeat(65)), Err(EntryProblem::TooDeep { limit: 64 }));
    }

    fn add_all(names: &[&str]) -> Result<(), EntryProblem> {
        let mut all = Names::default();
        names.iter().try_for_each(|name| all.add(name, name.ends_with('/')))
    }

    #[test]
    fn entry_names_report_collisions_in_any_order() {
        for (names, problem) in [
            (&["a", "a"][..], EntryProblem::Duplicate),
            (&["a", "A"], EntryProblem::CaseDuplicate("a".into())),
            (&["x/a", "X/b"], EntryProblem::CaseDuplicate("x".into())),
            (&["\u{e4}", "\u{c4}"], EntryProblem::CaseDuplicate("\u{e4}".into())),
            (&["\u{3c3}", "\u{3c2}"], EntryProblem::CaseDuplicate("\u{3c3}".into())),
            (&["a", "a/b"], EntryProblem::FileAndFolder("a".into())),
            (&["a/b", "a"], EntryProblem::FileAndFolder("a".into())),
            (&["a/", "a"], EntryProblem::FileAndFolder("a".into())),
        ] {
            assert_eq!(add_all(names), Err(problem), "{names:?}");
        }
    }

    #[test]
    fn entry_names_accept_repeated_folders() {
        assert_eq!(add_all(&["a/", "a/b", "a/", "a/c/d", "a/c/"]), Ok(()));
    }
}
