//! Platforms for which sources are compiled: C compilers, their options, and the libraries they make.

use super::binary::{BinaryFormat, BinaryHeader, Machine};
use super::binary_folders::{FolderNames, LIBRARY_EXTENSION, binary_folders};
use crate::error::FmiError;
use crate::macros::words;
use std::str::FromStr;

words! {
    /// A platform for which sources are compiled.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum BuildTarget {
        /// This platform.
        #[default]
        Native = "native",
        /// Windows on a 64-bit x86 processor. Other systems need the cross compiler of MinGW-w64.
        Win64 = "win64",
        /// 32-bit Windows. 64-bit systems need the cross compiler of MinGW-w64.
        Win32 = "win32",
    }
}

impl FromStr for BuildTarget {
    type Err = FmiError;

    /// Parses a [name](Self::name).
    fn from_str(name: &str) -> Result<Self, FmiError> {
        let found = Self::WORDS.iter().find(|(word, _)| *word == name);
        found.map(|(_, target)| *target).ok_or_else(|| {
            let words: Vec<String> = Self::WORDS.iter().map(|(word, _)| format!("'{word}'")).collect();
            FmiError::BadSetting(format!(
                "platform = '{name}' is invalid; expected one of: {}",
                words.join(", ")
            ))
        })
    }
}

impl BuildTarget {
    /// Returns the names of all platforms.
    pub fn names() -> impl Iterator<Item = &'static str> {
        Self::WORDS.iter().map(|(word, _)| *word)
    }

    /// Returns the processor for which a cross compiler is needed.
    fn foreign(self) -> Option<Machine> {
        let machine = match self {
            Self::Native => return None,
            Self::Win64 => Machine::X86_64,
            Self::Win32 => Machine::X86,
        };
        (!cfg!(windows) || Machine::host() != machine).then_some(machine)
    }

    fn is_windows(self) -> bool {
        self != Self::Native || cfg!(windows)
    }

    /// Returns the names of C compilers to try.
    pub(crate) fn compilers(self) -> &'static [&'static str] {
        match self.foreign() {
            None => &["cc", "gcc", "clang"],
            Some(Machine::X86) => &["i686-w64-mingw32-gcc"],
            Some(_) => &["x86_64-w64-mingw32-gcc"],
        }
    }

    /// Returns the environment variable with the name of another compiler.
    pub(crate) fn variable(self) -> &'static str {
        match self.foreign() {
            None => "CC",
            Some(Machine::X86) => "CC_i686_pc_windows_gnu",
            Some(_) => "CC_x86_64_pc_windows_gnu",
        }
    }

    /// Returns options for compiling a shared library. Floating-point arithmetic follows the standard:
    /// contraction to fused operations would make results depend on the processor. Assertions are disabled,
    /// as in libraries that tools deliver. A failed assertion would end the process (seen in the reset
    /// function of Dymola's sources).
    pub(crate) fn options(self) -> Vec<&'static str> {
        let mut options = vec!["-O2", "-DNDEBUG", "-shared", "-ffp-contract=off"];
        if self.is_windows() {
            // The same sources give the same file: no names of temporary files, no time, and an address that
            // does not depend on the path of the library.
            options.extend(["-static-libgcc", "-s", "-Wl,--no-insert-timestamp,--disable-auto-image-base"]);
        } else {
            options.push("-fPIC");
        }
        if self == Self::Win32 {
            // Otherwise, registers have more digits than memory.
            options.extend(["-msse2", "-mfpmath=sse"]);
        }
        options
    }

    /// Returns the libraries that every model is linked with.
    pub(crate) fn system_libraries(self) -> &'static [&'static str] {
        if self.is_windows() { &[] } else { &["-lm"] }
    }

    /// Returns the extension of shared libraries, without the dot.
    pub(crate) fn extension(self) -> &'static str {
        if self.is_windows() { "dll" } else { LIBRARY_EXTENSION }
    }

    /// Returns the folder of `binaries/` for a library.
    pub(crate) fn folder(self, names: FolderNames) -> String {
        match (self, names) {
            (Self::Native, names) => binary_folders(names).swap_remove(0),
            (Self::Win64, FolderNames::SystemAndBits) => "win64".to_owned(),
            (Self::Win64, FolderNames::ProcessorAndSystem) => "x86_64-windows".to_owned(),
            (Self::Win32, FolderNames::SystemAndBits) => "win32".to_owned(),
            (Self::Win32, FolderNames::ProcessorAndSystem) => "x86-windows".to_owned(),
        }
    }

    /// True if this platform can load the library.
    pub(crate) fn can_load(self, library: &BinaryHeader) -> bool {
        let is_windows = |machine| library.format == BinaryFormat::Pe && library.machines.contains(&machine);
        match self {
            Self::Native => library.runs_here(),
            Self::Win64 => is_windows(Machine::X86_64),
            Self::Win32 => is_windows(Machine::X86),
        }
    }

    /// Returns a name that distinguishes the platform from others.
    pub(crate) fn identity(self) -> String {
        match self {
            Self::Native => format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            Self::Win64 => "windows x86_64".to_owned(),
            Self::Win32 => "windows x86".to_owned(),
        }
    }
}
