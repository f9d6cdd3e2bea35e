//! A cache of opened FMUs, with the file as key.

use crate::cancel_request::CancelRequest;
use crate::error::{FmiError, Result};
use crate::fmu::Fmu;
use crate::open_options::OpenOptions;
use crate::platform;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// A cache that opens each file once. While the file is unchanged, [`open`](Self::open) returns the same
/// [`Fmu`] for equal options.
///
/// A file counts as unchanged if its path, identity on the disk, size and modification time are unchanged.
/// The file is not read for this check. For a folder, the check covers `modelDescription.xml`, the libraries
/// and the folder itself.
#[derive(Debug)]
pub struct FmuCache {
    capacity: usize,
    /// Entries, the most recently used last.
    entries: Mutex<Vec<Entry>>,
}

/// An open FMU, with its key and its options.
#[derive(Debug)]
struct Entry {
    key: Key,
    options: OpenOptions,
    fmu: Fmu,
}

/// Key that distinguishes a file from others, and from its earlier versions.
type Key = (PathBuf, platform::FileIdentity, Option<platform::FileIdentity>);

impl FmuCache {
    /// Creates a cache for at most `capacity` FMUs (at least one). The least recently used one is removed
    /// first.
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), entries: Mutex::new(Vec::new()) }
    }

    /// Returns the FMU at `path`, from the cache if possible.
    ///
    /// # Errors
    /// Returns the errors of [`Fmu::open`].
    pub fn open(&self, path: impl AsRef<Path>) -> Result<Fmu> {
        self.open_with(path, &OpenOptions::default())
    }

    /// Returns the FMU at `path` with these options, from the cache if possible.
    ///
    /// # Errors
    /// Returns the errors of [`Fmu::open_with`].
    pub fn open_with(&self, path: impl AsRef<Path>, options: &OpenOptions) -> Result<Fmu> {
        let path = path.as_ref();
        let key = key_of(path)?;
        if let Some(fmu) = self.find(&key, options) {
            return Ok(fmu);
        }
        // The lock is not held here, so that opening one file does not block the others. If two threads open
        // a new file at the same time, the first result is kept.
        let fmu = Fmu::open_with(path, options)?;
        if let Some(first) = self.find(&key, options) {
            return Ok(first);
        }
        let dropped: Vec<Entry> = {
            let mut entries = self.entries();
            // An older version of the same file is no longer needed.
            let is_older = |old: &mut Entry| old.key.0 == key.0 && old.key != key;
            let mut dropped: Vec<_> = entries.extract_if(.., is_older).collect();
            if entries.len() >= self.capacity {
                dropped.push(entries.remove(0));
            }
            let options = OpenOptions { cancel: CancelRequest::default(), ..options.clone() };
            entries.push(Entry { key, options, fmu: fmu.clone() });
            dropped
        };
        drop(dropped);
        Ok(fmu)
    }

    /// Removes all entries. FMUs that are in use stay open.
    pub fn clear(&self) {
        let entries = std::mem::take(&mut *self.entries());
        drop(entries);
    }

    fn find(&self, key: &Key, options: &OpenOptions) -> Option<Fmu> {
        let mut entries = self.entries();
        let position = entries.iter().position(|entry| entry.key == *key && entry.options == *options)?;
        if entries[position].fmu.archive().changed_library().is_some() {
            let entry = entries.remove(position);
            drop(entries);
            drop(entry);
            return None;
        }
        let entry = entries.remove(position);
        let fmu = entry.fmu.clone();
        entries.push(entry);
        Some(fmu)
    }

    fn entries(&self) -> std::sync::MutexGuard<'_, Vec<Entry>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn key_of(path: &Path) -> Result<Key> {
    let canonical = path.canonicalize().map_err(FmiError::io("open", path))?;
    let metadata = canonical.metadata().map_err(FmiError::io("open", path))?;
    let inner = if metadata.is_dir() {
        canonical.join("modelDescription.xml").metadata().ok().map(|inner| platform::file_identity(&inner))
    } else {
        None
    };
    Ok((canonical, platform::file_identity(&metadata), inner))
}
