//! The platforms for which an FMU has binaries, and how they run on this one.

use super::binary_folders::{FolderNames, LIBRARY_EXTENSION, binary_folders};
use crate::macros::words;
use std::collections::BTreeSet;

/// Folders of binaries that run under Wine on Linux.
const WINDOWS: [&str; 2] = ["win64", "x86_64-windows"];

words! {
    /// How a part of an FMU runs on this platform.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum RunsBy {
        /// The library is loaded.
        Loading = "runs here",
        /// The sources are compiled.
        Compiling = "compiled here",
        /// The library runs in a Windows process under Wine.
        Wine = "runs here under Wine",
        /// It does not run here.
        Nothing = "does not run here",
    }
}

/// A folder of `binaries/`, or `sources`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Platform {
    /// Name of the folder, for example `linux64` or `x86_64-windows`; `sources` for source code.
    pub name: String,
    /// How it runs on this platform.
    pub runs_by: RunsBy,
}

/// Returns the platforms of an FMU with these files.
pub(crate) fn platforms<'a>(files: impl Iterator<Item = &'a str>, names: FolderNames) -> Vec<Platform> {
    let (mut folders, mut native, mut windows) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
    let mut has_sources = false;
    for file in files {
        if let Some((folder, file)) = file.strip_prefix("binaries/").and_then(|below| below.split_once('/')) {
            folders.insert(folder);
            match file.rsplit_once('.') {
                Some((_, extension)) if extension == LIBRARY_EXTENSION => _ = native.insert(folder),
                Some((_, extension)) if extension.eq_ignore_ascii_case("dll") => _ = windows.insert(folder),
                _ => {}
            }
        }
        has_sources |= file.starts_with("sources/") && file.ends_with(".c");
    }
    let own = binary_folders(names);
    let runs_by = |folder: &str| match folder {
        folder if native.contains(folder) && own.iter().any(|own| own == folder) => RunsBy::Loading,
        folder if cfg!(target_os = "linux") && windows.contains(folder) && WINDOWS.contains(&folder) => {
            RunsBy::Wine
        }
        _ => RunsBy::Nothing,
    };
    let listed =
        folders.iter().map(|folder| Platform { name: (*folder).to_owned(), runs_by: runs_by(folder) });
    let sources = Platform { name: "sources".to_owned(), runs_by: RunsBy::Compiling };
    listed.chain(has_sources.then_some(sources)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn libraries_for_windows_run_under_wine_on_linux_only() {
        let files =
            ["modelDescription.xml", "binaries/win64/m.dll", "binaries/win32/m.dll", "binaries/plan9/m"];
        let found = platforms(files.into_iter(), FolderNames::SystemAndBits);
        let shown: Vec<_> = found.iter().map(|platform| (&platform.name[..], platform.runs_by)).collect();
        let windows = match std::env::consts::OS {
            "windows" => RunsBy::Loading,
            "linux" => RunsBy::Wine,
            _ => RunsBy::Nothing,
        };
        assert_eq!(shown, [("plan9", RunsBy::Nothing), ("win32", RunsBy::Nothing), ("win64", windows)]);
    }

    #[test]
    fn sources_are_a_platform() {
        let found = platforms(["sources/all.c"].into_iter(), FolderNames::ProcessorAndSystem);
        assert_eq!(found, [Platform { name: "sources".to_owned(), runs_by: RunsBy::Compiling }]);
        assert_eq!(platforms(["sources/readme.txt"].into_iter(), FolderNames::ProcessorAndSystem), []);
    }
}
