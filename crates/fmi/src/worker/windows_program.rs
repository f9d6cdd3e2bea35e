//! The worker programs for Windows, which run models that this process cannot load, and Wine, which runs
//! these programs on Linux.

use super::launcher::Launcher;
use crate::error::FmiError;
use std::env;
use std::path::{Path, PathBuf};

/// Path of Wine.
const WINE: &str = "FMUFIT_WINE";

/// Folder of Wine outside of the search path (Debian).
const ELSEWHERE: &str = "/usr/lib/wine";

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
        let models = self.models();
        let missing = |reason: String| FmiError::NoWindowsProgram { models, reason };
        if !cfg!(any(windows, all(target_os = "linux", target_arch = "x86_64"))) {
            return Err(missing(
                "Models of Windows run under Wine on Linux with an x86_64 processor only".to_owned(),
            ));
        }
        let wine = match cfg!(windows) {
            true => None,
            false => Some(self.wine().map_err(missing)?.ok_or_else(|| {
                let package = self.pick("wine64", "wine32:i386");
                missing(format!(
                    "Wine was not found. Install it (Debian: apt install {package}), or set {WINE} to its path"
                ))
            })?),
        };
        let program = named(self.variable()).map_err(missing)?.map_or_else(|| self.installed(), Ok);
        let program = program.map_err(missing)?;
        Ok(Launcher { wine, models: Some(models), ..Launcher::of(program) })
    }

    /// Returns the path of Wine. `wine64` would start a 32-bit program as a process of its own, whose memory
    /// could not be limited and which could not be ended. `wine` replaces itself by the program.
    fn wine(self) -> Result<Option<PathBuf>, String> {
        if let Some(path) = named(WINE)? {
            let other = path.with_file_name("wine");
            let is_replaced = self == Self::Bits32 && path.ends_with("wine64") && other.is_file();
            return Ok(Some(if is_replaced { other } else { path }));
        }
        let mut folders: Vec<PathBuf> = env::var_os("PATH").iter().flat_map(env::split_paths).collect();
        folders.push(PathBuf::from(ELSEWHERE));
        let names: &[&str] = self.pick(&["wine64", "wine"], &["wine"]);
        let mut found = names.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
        Ok(found.find(|path| path.is_file()))
    }

    /// Returns the path at which the program is installed, or the reason why it is not.
    fn installed(self) -> Result<PathBuf, String> {
        let folder = Path::new("fmufit").join(self.pick("win64", "win32"));
        let program = data_folder().map(|data| data.join(folder).join(PROGRAM));
        let shown = program.as_deref().unwrap_or(Path::new(PROGRAM)).display().to_string();
        program.filter(|program| program.is_file()).ok_or_else(|| {
            let (bits, recipe) = self.pick(("64-bit", "windows-worker"), ("32-bit", "windows-worker-32"));
            let place = if cfg!(windows) { ", on Linux, and copy it there" } else { "" };
            format!(
                "The {bits} worker program for Windows, {shown}, was not found. Build it with `make {recipe}` in \
                 the sources of this program{place}, or set {} to its path",
                self.variable()
            )
        })
    }

    /// Returns the environment variable with its path.
    fn variable(self) -> &'static str {
        self.pick("FMUFIT_WINDOWS_WORKER", "FMUFIT_WINDOWS_WORKER_32")
    }

    /// Describes what the models that need the program contain.
    fn models(self) -> &'static str {
        if cfg!(windows) {
            return "a 32-bit library only, which runs as a 32-bit program";
        }
        self.pick(
            "a library for Windows only, which runs under Wine",
            "a 32-bit library for Windows only, which runs under Wine for 32 bits (Debian: wine32:i386)",
        )
    }

    /// Describes where it runs, for a message.
    pub(crate) fn place(self) -> &'static str {
        if cfg!(windows) { "as a 32-bit program" } else { "under Wine" }
    }

    fn pick<T>(self, bits_64: T, bits_32: T) -> T {
        match self {
            Self::Bits64 => bits_64,
            Self::Bits32 => bits_32,
        }
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

/// Returns the user's folder for data of programs.
fn data_folder() -> Option<PathBuf> {
    let folder = |name: &str| env::var_os(name).filter(|path| !path.is_empty()).map(PathBuf::from);
    match cfg!(windows) {
        true => folder("LOCALAPPDATA"),
        false => folder("XDG_DATA_HOME").or_else(|| Some(folder("HOME")?.join(".local/share"))),
    }
}
