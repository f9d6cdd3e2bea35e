//! The file of a fuzzing process that contains the current archive.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::{env, fs, process};

static FILE: LazyLock<PathBuf> =
    LazyLock::new(|| env::temp_dir().join(format!("fuzz-{}.fmu", process::id())));

/// Writes the bytes and returns the path.
pub fn file(bytes: &[u8]) -> &'static Path {
    fs::write(&*FILE, bytes).expect("the folder for temporary files can be written");
    &FILE
}
