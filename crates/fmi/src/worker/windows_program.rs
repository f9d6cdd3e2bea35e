//! The worker programs for Windows, which run models that this process cannot load, and Wine, which runs
//! these programs on Linux.

use super::launcher::Launcher;
use crate::error::FmiError;
use std::env;
use std::path::{Path, PathBuf};

/// Path of Wine.
const WINE: &str = "FMUFIT_WINE";

/// Names of Wine on the search path, and a place outside of it (Debian).
const NAMES: [&str; 2] = ["wine64", "wine"];
const ELSEWHERE: &str = "/usr/lib/wine/wine64";

/// File name of the worker programs.
const PROGRAM: &str = "fmufit-worker.exe";

/// A worker program for Windows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WindowsProgram {
    /// It runs 64-bit models on Linux, under Wine.
    Bits64,
    /// It runs 32-bit models, on Linux under Wine.
    Bits32,
}

impl WindowsProgram {
    /// Checks that the program, and on Linux also Wine, are present.
    ///
    /// # Errors
    /// Returns [`FmiError::NoWindowsProgram`] with what is missing.
    pub fn check(self) -> Result<(), FmiError> {
        self.launcher().map(drop)
    }

    /// Returns the launcher of its workers.
    pub(super) fn launcher(self) -> Result<Launcher, FmiError> {
        let missing = |reason: String| FmiError::NoWindowsProgram { models: self.models(), reason };
        let runs_here = match cfg!(windows) {
            true => self == Self::Bits32,
            false => cfg!(all(target_os = "linux", target_arch = "x86_64")),
        };
        if !runs_here {
            return Err(missing(
                "Models of Windows run under Wine on Linux with an x86_64 processor only".to_owned(),
            ));
        }
        let wine = match cfg!(windows) {
            true => None,
            false => Some(named(WINE).map_err(missing)?.or_else(wine).ok_or_else(|| {
                missing(format!(
                    "Wine was not found. Install it (Debian: apt install wine64), or set {WINE} to its path"
                ))
            })?),
        };
        let program = named(self.variable()).map_err(missing)?.map_or_else(|| self.installed(), Ok);
        let program = program.map_err(missing)?;
        Ok(Launcher { wine, models: Some(self.models()), ..Launcher::of(program) })
    }

    /// Returns the path at which the program is installed, or the reason why it is not.
    fn installed(self) -> Result<PathBuf, String> {
        let program = data_folder().map(|folder| folder.join("fmufit").join(self.folder()).join(PROGRAM));
        let shown = program.as_deref().unwrap_or(Path::new(PROGRAM)).display().to_string();
        program.filter(|program| program.is_file()).ok_or_else(|| {
            format!(
                "The {} worker program for Windows, {shown}, was not found. Build it with `make {}` in the \
                 sources of this program, or set {} to its path",
                self.bits(),
                self.recipe(),
                self.variable()
            )
        })
    }

    /// Returns the name of its folder.
    fn folder(self) -> &'static str {
        match self {
            Self::Bits64 => "win64",
            Self::Bits32 => "win32",
        }
    }

    fn bits(self) -> &'static str {
        match self {
            Self::Bits64 => "64-bit",
            Self::Bits32 => "32-bit",
        }
    }

    /// Returns the target of `make` that builds it.
    fn recipe(self) -> &'static str {
        match self {
            Self::Bits64 => "windows-worker",
            Self::Bits32 => "windows-worker-32",
        }
    }

    /// Returns the environment variable with its path.
    fn variable(self) -> &'static str {
        match self {
            Self::Bits64 => "FMUFIT_WINDOWS_WORKER",
            Self::Bits32 => "FMUFIT_WINDOWS_WORKER_32",
        }
    }

    /// Describes what the models that need the program contain.
    pub(crate) fn models(self) -> &'static str {
        match (self, cfg!(windows)) {
            (Self::Bits64, _) => "a library for Windows only, which runs under Wine",
            (Self::Bits32, false) => "a 32-bit library for Windows only, which runs under Wine",
            (Self::Bits32, true) => "a 32-bit library only, which runs as a 32-bit program",
        }
    }

    /// Describes where it runs, for a message.
    pub(crate) fn place(self) -> &'static str {
        if cfg!(windows) { "as a 32-bit program" } else { "under Wine" }
    }
}

/// Returns the path in an environment variable, if it is set.
fn named(variable: &str) -> Result<Option<PathBuf>, String> {
    let Some(path) = env::var_os(variable).filter(|path| !path.is_empty()).map(PathBuf::from) else {
        return Ok(None);
    };
    match path.is_file() {
        true => Ok(Some(path)),
        false => Err(format!("{variable} = {} is not a file", path.display())),
    }
}

fn wine() -> Option<PathBuf> {
    let folders: Vec<PathBuf> = env::var_os("PATH").iter().flat_map(env::split_paths).collect();
    let found = NAMES.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
    found.chain([PathBuf::from(ELSEWHERE)]).find(|path| path.is_file())
}

/// Returns the user's folder for data of programs.
fn data_folder() -> Option<PathBuf> {
    let folder = |name: &str| env::var_os(name).filter(|path| !path.is_empty()).map(PathBuf::from);
    match cfg!(windows) {
        true => folder("LOCALAPPDATA"),
        false => folder("XDG_DATA_HOME").or_else(|| Some(folder("HOME")?.join(".local/share"))),
    }
}
