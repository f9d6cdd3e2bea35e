//! Names of shared libraries, and of the folders of an FMU that contain them, on this platform.

use super::binary::Machine;
use std::env;

/// Extension of shared libraries on this platform, without the dot: `so`, `dll`, `dylib`.
pub const LIBRARY_EXTENSION: &str = env::consts::DLL_EXTENSION;

/// Naming scheme of the folders of `binaries/`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FolderNames {
    /// `linux64` (FMI 1.0 and 2.0).
    SystemAndBits,
    /// `x86_64-linux` (FMI 3.0).
    ProcessorAndSystem,
}

/// Returns the folders of `binaries/` that may contain a library for this platform, the best first.
///
/// FMI 1.0 and 2.0 use the names `linux64`, `win64` and `darwin64`, which support only x86 processors. FMUs
/// for ARM use the names of FMI 3.0, or contain an ARM library in the x86 folder. Both are therefore
/// searched, and [`BinaryHeader::runs_here`](super::BinaryHeader::runs_here) decides.
pub fn binary_folders(names: FolderNames) -> Vec<String> {
    let modern = format!("{}-{}", modern_processor(), modern_system());
    let classic = format!("{}{}", classic_system(), usize::BITS);
    let is_x86 = matches!(Machine::host(), Machine::X86 | Machine::X86_64);
    let classic_first = names == FolderNames::SystemAndBits && is_x86;
    if classic_first { vec![classic, modern] } else { vec![modern, classic] }
}

fn modern_processor() -> &'static str {
    env::consts::ARCH
}

fn modern_system() -> &'static str {
    match env::consts::OS {
        "macos" => "darwin",
        other => other,
    }
}

fn classic_system() -> &'static str {
    match env::consts::OS {
        "windows" => "win",
        "macos" => "darwin",
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classic_folder_precedes_modern_one_only_on_x86() {
        let two = binary_folders(FolderNames::SystemAndBits);
        let three = binary_folders(FolderNames::ProcessorAndSystem);
        assert_eq!(two.len(), 2);
        if Machine::host() == Machine::X86_64 && cfg!(target_os = "linux") {
            assert_eq!(two, ["linux64", "x86_64-linux"]);
            assert_eq!(three, ["x86_64-linux", "linux64"]);
        }
    }
}
