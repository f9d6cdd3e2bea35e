//! The platforms for which an FMU has binaries, and how they run on this one.

use super::binary_folders::{FolderNames, LIBRARY_EXTENSION, binary_folders};
use crate::macros::words;
use std::collections::BTreeSet;

/// Folders of libraries for 64-bit and for 32-bit Windows.
const WINDOWS_64: [&str; 2] = ["win64", "x86_64-windows"];
const WINDOWS_32: [&str; 2] = ["win32", "x86-windows"];

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
        /// The library runs in a 32-bit Windows process, on Linux under Wine.
        Process32 = "runs here in a 32-bit process",
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
            let extension = file.rsplit_once('.').map_or("", |(_, extension)| extension);
            if extension == LIBRARY_EXTENSION {
                native.insert(folder);
            }
            if extension.eq_ignore_ascii_case("dll") {
                windows.insert(folder);
            }
        }
        has_sources |= file.starts_with("sources/") && file.ends_with(".c");
    }
    let own = binary_folders(names);
    let is_windows = |folder: &str, names: &[&str]| windows.contains(folder) && names.contains(&folder);
    let runs_by = |folder: &str| match folder {
        folder if native.contains(folder) && own.iter().any(|own| own == folder) => RunsBy::Loading,
        folder if cfg!(target_os = "linux") && is_windows(folder, &WINDOWS_64) => RunsBy::Wine,
        folder if cfg!(any(windows, target_os = "linux")) && is_windows(folder, &WINDOWS_32) => {
            RunsBy::Process32
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
    fn libraries_for_windows_run_on_linux_and_windows_only() {
        let files =
            ["modelDescription.xml", "binaries/win64/m.dll", "binaries/win32/m.dll", "binaries/plan9/m"];
        let found = platforms(files.into_iter(), FolderNames::SystemAndBits);
        let shown: Vec<_> = found.iter().map(|platform| (&platform.name[..], platform.runs_by)).collect();
        let (bits_32, bits_64) = match std::env::consts::OS {
            "windows" => (RunsBy::Process32, RunsBy::Loading),
            "linux" => (RunsBy::Process32, RunsBy::Wine),
            _ => (RunsBy::Nothing, RunsBy::Nothing),
        };
        assert_eq!(shown, [("plan9", RunsBy::Nothing), ("win32", bits_32), ("win64", bits_64)]);
    }

    #[test]
    fn sources_are_a_platform() {
        let found = platforms(["sources/all.c"].into_iter(), FolderNames::ProcessorAndSystem);
        assert_eq!(found, [Platform { name: "sources".to_owned(), runs_by: RunsBy::Compiling }]);
        assert_eq!(platforms(["sources/readme.txt"].into_iter(), FolderNames::ProcessorAndSystem), []);
    }
}
