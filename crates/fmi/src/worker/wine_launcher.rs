//! The programs that run models of Windows on Linux: Wine, and the worker program for Windows.

use super::launcher::Launcher;
use crate::error::FmiError;
use std::env;
use std::path::{Path, PathBuf};

/// Path of Wine.
const WINE: &str = "FMUFIT_WINE";

/// Path of the worker program for Windows.
const WORKER: &str = "FMUFIT_WINDOWS_WORKER";

/// Names on the search path, and a place outside of it (Debian).
const NAMES: [&str; 2] = ["wine64", "wine"];
const ELSEWHERE: &str = "/usr/lib/wine/wine64";

/// File name of the worker program, and its folder below the user's data folder.
const PROGRAM: &str = "fmufit-worker.exe";
const FOLDER: &str = "fmufit/windows";

/// Returns the launcher of workers for models of Windows.
pub(super) fn wine_launcher() -> Result<Launcher, FmiError> {
    let missing = |reason: String| FmiError::NoWine { reason };
    if !cfg!(all(target_os = "linux", target_arch = "x86_64")) {
        return Err(missing(
            "Models of Windows run under Wine on Linux with an x86_64 processor only".to_owned(),
        ));
    }
    let wine = named(WINE)?.or_else(wine).ok_or_else(|| {
        missing(format!(
            "Wine was not found. Install it (Debian: apt install wine64), or set {WINE} to its path"
        ))
    })?;
    let program = match named(WORKER)? {
        Some(program) => program,
        None => {
            let folder = data_folder().map(|folder| folder.join(FOLDER).join(PROGRAM));
            let shown = folder.as_deref().unwrap_or(Path::new(PROGRAM)).display().to_string();
            folder.filter(|program| program.is_file()).ok_or_else(|| {
                missing(format!(
                    "The worker program for Windows, {shown}, was not found. Build it with `make windows-worker` \
                     in the sources of this program, or set {WORKER} to its path"
                ))
            })?
        }
    };
    Ok(Launcher { wine: Some(wine), ..Launcher::of(program) })
}

/// Checks that the programs that run models of Windows on Linux are present.
///
/// # Errors
/// Returns [`FmiError::NoWine`] with what is missing.
pub fn check_wine() -> Result<(), FmiError> {
    wine_launcher().map(drop)
}

/// Returns the path in an environment variable, if it is set.
fn named(variable: &str) -> Result<Option<PathBuf>, FmiError> {
    let Some(path) = env::var_os(variable).filter(|path| !path.is_empty()).map(PathBuf::from) else {
        return Ok(None);
    };
    match path.is_file() {
        true => Ok(Some(path)),
        false => Err(FmiError::NoWine { reason: format!("{variable} = {} is not a file", path.display()) }),
    }
}

fn wine() -> Option<PathBuf> {
    let folders: Vec<PathBuf> = env::var_os("PATH").iter().flat_map(env::split_paths).collect();
    let found = NAMES.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
    found.chain([PathBuf::from(ELSEWHERE)]).find(|path| path.is_file())
}

fn data_folder() -> Option<PathBuf> {
    let folder = |name: &str| env::var_os(name).filter(|path| !path.is_empty()).map(PathBuf::from);
    folder("XDG_DATA_HOME").or_else(|| Some(folder("HOME")?.join(".local/share")))
}
