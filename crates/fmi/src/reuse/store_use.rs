//! The stores of loaded copies of this process, each used by all who have the FMU open.

use super::source::{Key, Source};
use super::store::CopyStore;
use std::collections::HashMap;
use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};

/// The stores of this process, which loaded libraries do not leave either.
static STORES: Mutex<Option<HashMap<Key, Arc<CopyStore>>>> = Mutex::new(None);

/// A use of a store by an open FMU.
#[derive(Debug)]
pub(crate) struct StoreUse(Arc<CopyStore>);

impl StoreUse {
    /// The store of a library; made if there is none.
    pub(crate) fn new(key: Key, source: Source) -> Self {
        let store = {
            let mut stores = STORES.lock().unwrap_or_else(PoisonError::into_inner);
            Arc::clone(
                stores.get_or_insert_default().entry(key).or_insert_with(|| Arc::new(CopyStore::new())),
            )
        };
        let mut state = store.state();
        state.users += 1;
        // The folder of the first of several users stays as long as there is any.
        state.source.get_or_insert(source);
        drop(state);
        Self(store)
    }
}

impl Deref for StoreUse {
    type Target = Arc<CopyStore>;

    fn deref(&self) -> &Arc<CopyStore> {
        &self.0
    }
}

impl Drop for StoreUse {
    fn drop(&mut self) {
        let mut state = self.0.state();
        state.users -= 1;
        if state.users > 0 {
            return;
        }
        let source = state.source.take();
        let idle = state.idle.clone();
        state.refused = None;
        drop(state);
        for copy in &idle {
            copy.free_idle();
            copy.leave_home();
        }
        drop(source);
    }
}
