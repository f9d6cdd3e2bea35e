//! The C headers of the standard, for source-code FMUs that include them but do not contain them
//! (`headers/readme.md`: origin and licence).

use crate::error::{FmiError, Result};
use std::fs;
use std::path::Path;

/// Defines a list of names and contents.
macro_rules! headers {
    [$($name:literal),+ $(,)?] => {
        &[$(($name, include_str!(concat!("../../headers/", $name)))),+]
    };
}

const HEADERS: &[(&str, &str)] = headers![
    "fmi2TypesPlatform.h",
    "fmi2FunctionTypes.h",
    "fmi2Functions.h",
    "fmi3PlatformTypes.h",
    "fmi3FunctionTypes.h",
    "fmi3Functions.h",
];

/// Header that lists the functions of FMI 2.0.
pub(super) const FMI2_FUNCTIONS: &str = HEADERS[2].1;

/// Writes the headers to a new folder.
pub(super) fn write(folder: &Path) -> Result<()> {
    fs::create_dir(folder).map_err(FmiError::io("create", folder))?;
    for (name, text) in HEADERS {
        let path = folder.join(name);
        fs::write(&path, text).map_err(FmiError::io("write", path))?;
    }
    Ok(())
}
