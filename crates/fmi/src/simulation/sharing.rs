//! How simulations that run in parallel share a process.

use crate::error::FmiError;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// How simulations of an FMU that run in parallel share a process. The results do not depend on it.
///
/// Nothing can be proven about the thread safety of a library by trying it, and a failed trial ends the process: so two
/// threads are never inside one loaded copy of a library, except with [`Together`](Self::Together).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Sharing {
    /// Each simulator has a loaded copy of the library of its own: a copied file, for which the loader makes static
    /// variables of its own. Where copies would still share state, or no further copy can be loaded, simulations run one at
    /// a time, and the log says why: the library defines variables that the loader makes once per process
    /// (`STB_GNU_UNIQUE`), it is linked with another library of the FMU; the
    /// disk, the memory or the room for static thread-local storage is used up.
    #[default]
    Copies,
    /// All share one loaded copy of the library, one run at a time.
    Serial,
    /// All share one loaded copy and run in it at the same time. The user asserts that the FMU is thread-safe: nothing
    /// checks it, and a wrong assertion ends in wrong results or ends the process.
    Together,
}

impl Sharing {
    /// All ways, by their names.
    pub const NAMES: [(&'static str, Sharing); 3] =
        [("copies", Sharing::Copies), ("serial", Sharing::Serial), ("together", Sharing::Together)];

    /// The name by which it is asked for.
    pub fn name(self) -> &'static str {
        match self {
            Sharing::Copies => "copies",
            Sharing::Serial => "serial",
            Sharing::Together => "together",
        }
    }
}

impl fmt::Display for Sharing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Sharing {
    type Err = FmiError;

    fn from_str(name: &str) -> Result<Self, FmiError> {
        let found = Self::NAMES.iter().find(|(known, _)| *known == name);
        found.map(|(_, sharing)| *sharing).ok_or_else(|| FmiError::BadSetting {
            problem: format!("sharing = \"{name}\"; there are: \"copies\", \"serial\", \"together\""),
        })
    }
}
