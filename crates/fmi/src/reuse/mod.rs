//! Everything that brings instances back to their start or shares a library: loaded copies and who has them, what was ever
//! set in them, ways of resetting and their check, pools of simulators.

mod copies;
mod digest;
mod failed_runs;
mod files;
mod history;
mod lease;
mod linkage;
mod pool;
mod probe;
mod readback;
mod record;
mod renewal;
mod source;
mod store;
mod store_use;
mod tenant;
mod trial;
mod verdict;

pub(crate) use copies::LoadedCopy;
pub(crate) use digest::Digest;
pub(crate) use history::{Aside, Past};
pub(crate) use lease::CopyLease;
pub use pool::{Lease, Pool};
pub(crate) use readback::{ReadBack, ReadBackBuffers};
pub(crate) use record::{Unset, set_again};
pub(crate) use source::{Key, Source};
pub(crate) use store::CopyStore;
pub(crate) use store_use::StoreUse;
pub(crate) use tenant::{CopyRequest, Eviction, Tenant};
pub(crate) use trial::nudge;

use crate::error::FmiError;
use std::fmt;
use std::str::FromStr;

/// How the instances of an FMU are brought back to their start between simulations: the first of these ways that was
/// seen to be right. Right means that runs have the same bits as on a new instance, also after a run with other values;
/// which way is faster is never asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Reuse {
    /// By restoring the state saved when the instance was new (model exchange, FMUs that can save states): it was seen to restore
    /// everything, bit for bit. All values are set again afterwards, and read back.
    Restore,
    /// By the FMU's reset function: it was seen to restore everything, bit for bit.
    Reset,
    /// By a new instance for every simulation: nothing else is offered, or it fails, or it leaves traces.
    Reinstantiate,
    /// By a newly loaded copy of the library, with resources of its own, for every simulation: the model keeps a state outside of its
    /// instances.
    Reload,
}

/// How simulations of an FMU that run in parallel share a process. The results do not depend on it.
///
/// Nothing can be proven about the thread safety of a library by trying it, and a failed trial ends the process: so two
/// threads are never inside one loaded copy of a library, except with [`Together`](Self::Together).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
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
