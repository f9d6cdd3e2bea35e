//! The library of a source-code FMU: built, or found in the cache.

use super::build::Recipe;
use super::cache;
use super::compiler::{Compiler, Patience};
use crate::cancel::Cancel;
use crate::description::{Interface, ModelDescription};
use crate::error::Result;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Default time limit of a compiler.
pub(crate) const COMPILE_TIME: Duration = Duration::from_secs(300);

/// Builds the library of an interface from the sources of an FMU with the system's C compiler (`CC`, else
/// `cc`, `gcc`, `clang`), or finds it in the cache.
///
/// * `root`: the unpacked FMU, `content_hash` the hash of its content.
/// * Compiled are the files the description lists, or `sources/buildDescription.xml`, or else all `.c` files
///   in `sources/`. Compiler options in an FMU are ignored.
///
/// The library is kept in a cache folder (`FMUFIT_CACHE`, else where the system keeps caches of a user) by
/// content, compiler and options; the oldest go when there are more than 256 or 512 MiB of them.
///
/// The headers of FMI 2.0 and 3.0 are found where the FMU does not bring them. The compiler is ended after
/// five minutes.
///
/// Errors: [`FmiError::NoSources`](crate::FmiError::NoSources),
/// [`FmiError::NoCompiler`](crate::FmiError::NoCompiler),
/// [`FmiError::CompileFailed`](crate::FmiError::CompileFailed) with the command, the first error and the last
/// lines of the compiler; [`FmiError::Io`](crate::FmiError::Io).
pub fn build_library(
    root: &Path,
    description: &ModelDescription,
    interface: &Interface,
    content_hash: &str,
) -> Result<PathBuf> {
    let (cancel, limit) = (&Cancel::default(), COMPILE_TIME);
    build_unchanged(root, description, interface, content_hash, (cancel, limit), || Ok(()))
}

/// The same; the compiler is ended when `cancel` asks for it and after `limit`, and the library is kept only
/// if `check` finds the sources unchanged after the compiler has run.
pub(crate) fn build_unchanged(
    root: &Path,
    description: &ModelDescription,
    interface: &Interface,
    content_hash: &str,
    (cancel, limit): (&Cancel, Duration),
    check: impl FnOnce() -> Result<()>,
) -> Result<PathBuf> {
    let recipe = Recipe::find(root, description, interface)?;
    let patience = Patience { cancel, limit };
    let compiler = Compiler::find(&interface.model_identifier, &patience)?;
    let key = recipe.key(&compiler, content_hash);
    let file_name = format!("{}.{}", interface.model_identifier, crate::platform::LIBRARY_EXTENSION);
    cache::get_or_make(cache::LIBRARIES, &key, &file_name, |target| {
        recipe.build(&compiler, target, &patience)?;
        check()
    })
}
