//! A loaded copy on loan.

use super::copies::LoadedCopy;
use super::store::CopyStore;
use crate::sys::Library;
use std::sync::Arc;

/// A loaded copy on loan to one owner, for as long as it has instances; given back on drop, after them.
pub(crate) struct CopyLease {
    pub(super) store: Arc<CopyStore>,
    pub(super) library: Arc<Library>,
    /// After the library: a copy that is unloaded takes its folder with it.
    pub(super) copy: Arc<LoadedCopy>,
    pub(super) id: u64,
}

impl CopyLease {
    /// The functions of the copy.
    pub(crate) fn library(&self) -> &Arc<Library> {
        &self.library
    }

    /// The copy.
    pub(crate) fn copy(&self) -> &LoadedCopy {
        &self.copy
    }

    /// Gives the copy up for good, where it can be unloaded; else it is kept for others.
    pub(crate) fn retire(self) {
        if self.store.may_unload() {
            self.copy.free_idle();
            self.copy.unload_when_unused();
        }
    }

    /// The copies of this library.
    pub(crate) fn store(&self) -> &Arc<CopyStore> {
        &self.store
    }

    /// Whether a call of this copy has returned `Fatal`.
    #[inline]
    pub(crate) fn is_fatal(&self) -> bool {
        self.library.shared().is_fatal()
    }
}

impl Drop for CopyLease {
    fn drop(&mut self) {
        self.store.give_back(&self.copy, self.id);
    }
}

impl std::fmt::Debug for CopyLease {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "CopyLease({})", self.library.path().display())
    }
}
