//! Private copies of a library, for FMUs whose instances disturb each other: each copy is a file of its own, for which the
//! loader makes globals of its own.
//!
//! What stays shared: libraries that it depends on (the loader finds them by name among those it has loaded), symbols that
//! the linker has marked as unique in the process, and everything of the process itself (environment, files, locale).
//! Whether that matters is for the trial runs to say. Like all libraries, a copy is never unloaded while the process lives,
//! and takes its share of the memory for static thread-local storage, which is small: hence [`MAX_COPIES`].

use crate::archive::PrivateFolder;
use crate::error::FmiError;
use crate::platform;
use crate::sys::Library;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Copies that one process makes of all libraries together. Of one library there are as many as simulators have been in
/// use at once, and at least the three of the trial runs.
pub(crate) const MAX_COPIES: usize = 64;

/// Copies made by this process.
static MADE: AtomicUsize = AtomicUsize::new(0);

/// The copies of one library that nobody uses at present. Their folders go when the store goes.
#[derive(Debug)]
pub(crate) struct CopyStore {
    original: PathBuf,
    /// The content of the FMU, if the library is one of its files.
    root: Option<PathBuf>,
    idle: Mutex<Vec<CopiedFile>>,
}

/// A copy, and the folder it lies in.
#[derive(Debug)]
struct CopiedFile {
    path: PathBuf,
    _folder: PrivateFolder,
}

/// A copy on loan, loaded; goes back to its store on drop.
#[derive(Debug)]
pub(crate) struct PrivateCopy {
    library: Arc<Library>,
    file: Option<CopiedFile>,
    store: Arc<CopyStore>,
}

impl CopyStore {
    /// A store for copies of the library `original` of the FMU unpacked at `root`.
    pub(crate) fn new(original: &Path, root: &Path) -> Self {
        let root = original.starts_with(root).then(|| root.to_owned());
        Self { original: original.to_owned(), root, idle: Mutex::default() }
    }

    /// Lends a copy that nobody uses, or a new one, loaded by `open`.
    ///
    /// # Errors
    /// There are [`MAX_COPIES`] already; the system refuses to copy or to load.
    pub(crate) fn lend(
        self: &Arc<Self>,
        open: impl FnOnce(&Path) -> Result<Library, FmiError>,
    ) -> Result<PrivateCopy, FmiError> {
        let idle = self.idle().pop();
        let file = match idle {
            Some(file) => file,
            None => self.copy()?,
        };
        let library = open(&file.path).inspect_err(|_| {
            // Nothing of it stays in the process.
            MADE.fetch_sub(1, Ordering::Relaxed);
        })?;
        // One instance each.
        library.shared().set_dependent();
        Ok(PrivateCopy { library: Arc::new(library), file: Some(file), store: Arc::clone(self) })
    }

    fn idle(&self) -> std::sync::MutexGuard<'_, Vec<CopiedFile>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes a copy: the same place in a folder of its own, with the files beside it and the resources, which the
    /// library may look for from where it lies.
    fn copy(&self) -> Result<CopiedFile, FmiError> {
        let room = |made: usize| (made < MAX_COPIES).then_some(made + 1);
        if MADE.fetch_update(Ordering::Relaxed, Ordering::Relaxed, room).is_err() {
            return Err(FmiError::TooManyCopies { library: self.original.clone(), limit: MAX_COPIES });
        }
        self.copy_files().inspect_err(|_| {
            MADE.fetch_sub(1, Ordering::Relaxed);
        })
    }

    fn copy_files(&self) -> Result<CopiedFile, FmiError> {
        let folder = PrivateFolder::create()?;
        let beside = self.original.parent().unwrap_or(Path::new(""));
        let place = match &self.root {
            Some(root) => beside.strip_prefix(root).unwrap_or(Path::new("")),
            None => Path::new("binaries"),
        };
        let target = folder.path().join(place);
        fs::create_dir_all(&target).map_err(FmiError::io("create", &target))?;
        let path = target.join(self.original.file_name().unwrap_or_default());
        fs::copy(&self.original, &path).map_err(FmiError::io("copy to", &path))?;
        if let Some(root) = &self.root {
            self.link_beside(beside, &target)?;
            let resources = root.join("resources");
            if resources.is_dir() {
                let link = folder.path().join("resources");
                platform::link_folder(&resources, &link).map_err(FmiError::io("link", &link))?;
            }
        }
        Ok(CopiedFile { path, _folder: folder })
    }

    /// Links (or copies, where links cannot be made) what lies beside the library.
    fn link_beside(&self, beside: &Path, target: &Path) -> Result<(), FmiError> {
        let entries = fs::read_dir(beside).map_err(FmiError::io("list", beside))?;
        for entry in entries {
            let from = entry.map_err(FmiError::io("list", beside))?.path();
            if from == self.original {
                continue;
            }
            let to = target.join(from.file_name().unwrap_or_default());
            let linked = if from.is_dir() {
                platform::link_folder(&from, &to)
            } else {
                fs::hard_link(&from, &to).or_else(|_| fs::copy(&from, &to).map(drop))
            };
            linked.map_err(FmiError::io("link", &to))?;
        }
        Ok(())
    }
}

impl PrivateCopy {
    /// The loaded copy.
    pub(crate) fn library(&self) -> &Arc<Library> {
        &self.library
    }
}

impl Drop for PrivateCopy {
    fn drop(&mut self) {
        // After `Fatal` nothing of it can be trusted.
        let file = self.file.take().filter(|_| !self.library.shared().is_fatal());
        self.store.idle().extend(file);
    }
}
