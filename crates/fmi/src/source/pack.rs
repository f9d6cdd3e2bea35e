//! Packs a folder into an `.fmu`: all its files, and a library for this platform built from its sources.

use super::build::{COMPILE_TIME, build_unchanged};
use super::cache;
use super::compiler::Patience;
use crate::archive::{Archive, ArchiveLimits, MODEL_DESCRIPTION, check_names, files_below, hash_of_texts};
use crate::cancel_request::CancelRequest;
use crate::description::{DescriptionLimits, Interface, ModelDescription};
use crate::error::{FmiError, Result};
use crate::platform::{self, BuildTarget};
use base::files::{open_regular, read_regular};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use zip::write::{SimpleFileOptions, ZipWriter};

/// Packs a folder with `modelDescription.xml` and `sources/` into an `.fmu`. The `.fmu` contains all files of
/// the folder and a newly built library for this platform in `binaries/`. Folders without sources are packed
/// unchanged.
///
/// An unchanged folder and compiler result in identical bytes: entries are sorted and have no time stamps.
/// The result replaces `out` atomically, after it has been opened and parsed again.
///
/// # Errors
/// Returns [`FmiError::CannotPack`], and the errors of opening a folder, parsing its description and building
/// its library.
pub fn pack(folder: &Path, out: &Path) -> Result<()> {
    pack_for(folder, out, BuildTarget::Native, &CancelRequest::default())
}

/// Packs a folder as [`pack`] does, with a library for `target`, unless `cancel` requests an early end.
/// Nothing is written in that case.
///
/// # Errors
/// Returns the errors of [`pack`], and [`FmiError::Cancelled`].
pub fn pack_for(folder: &Path, out: &Path, target: BuildTarget, cancel: &CancelRequest) -> Result<()> {
    let source = Archive::open_with(folder, &ArchiveLimits::default(), cancel)?;
    let description = ModelDescription::read_with(&source, &DescriptionLimits::default(), cancel)?;
    let root = source.unpack()?;
    let mut files = files_to_pack(&root, out)?;
    for interface in distinct_interfaces(&description) {
        if root.join("sources").is_dir() {
            let patience = Patience { cancel, limit: COMPILE_TIME };
            let hash = source.content_hash()?;
            let library =
                build_unchanged(&root, &description, interface, hash, target, &patience, || Ok(()))?;
            files.insert(library_name(&description, interface, target), library);
        }
    }
    check_names(files.keys().map(String::as_str)).map_err(|(entry, problem)| FmiError::CannotPack {
        folder: folder.to_owned(),
        reason: format!("\"{}\" {problem}", entry.escape_debug()),
    })?;
    platform::fill_atomically(out, |file, path| {
        cancel.check()?;
        write_archive(file, "write", path, files, &[])?;
        check_result(path, &source, folder)
    })
}

/// Returns the path of an `.fmu` named `file_name` with these files (paths inside the FMU, and contents). The
/// first call packs it as [`pack`] does. It is kept in the cache folder until
/// [`clear_caches`](crate::clear_caches). Different contents result in a different path. If there are many
/// entries, the least recently used ones are removed, as for libraries.
///
/// # Errors
/// Returns the errors of [`pack`], and [`FmiError::Io`] if writing fails.
pub fn pack_texts(file_name: &str, files: &[(String, String)]) -> Result<PathBuf> {
    let platform = [env!("CARGO_PKG_VERSION"), std::env::consts::OS, std::env::consts::ARCH];
    let texts = files.iter().flat_map(|(name, text)| [name.as_str(), text]);
    let hash = hash_of_texts(texts.chain(platform));
    cache::get_or_make(cache::PACKED, &hash, file_name, |target| {
        let folder = target.with_extension("unpacked");
        for (name, text) in files {
            let path = folder.join(name);
            let parent = path.parent().unwrap_or(&folder);
            fs::create_dir_all(parent).map_err(FmiError::io("create", parent))?;
            fs::write(&path, text).map_err(FmiError::io("write", path))?;
        }
        pack(&folder, target)?;
        fs::remove_dir_all(&folder).map_err(FmiError::io("remove", folder))
    })
}

/// Returns all files of the folder with their names in the archive, except `out` itself.
fn files_to_pack(root: &Path, out: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let out = out.canonicalize().ok();
    let files = files_below(root, ArchiveLimits::default().entries)?;
    let is_out = |path: &Path| out.is_some() && path.canonicalize().ok() == out;
    Ok(files.into_iter().filter(|(_, path)| !is_out(path)).collect())
}

/// Returns the interfaces that need a separate library.
fn distinct_interfaces(description: &ModelDescription) -> Vec<&Interface> {
    let mut interfaces: Vec<&Interface> =
        description.model_exchange.iter().chain(&description.co_simulation).collect();
    interfaces.dedup_by_key(|interface| interface.model_identifier.as_str());
    interfaces
}

fn library_name(description: &ModelDescription, interface: &Interface, target: BuildTarget) -> String {
    let folder = target.folder(description.fmi_version.folder_names());
    format!("binaries/{folder}/{}.{}", interface.model_identifier, target.extension())
}

/// Writes an archive of these files. Files in `replaced` have other contents. `action` and `path` are used in
/// errors.
pub(crate) fn write_archive(
    out: &File,
    action: &'static str,
    path: &Path,
    files: impl IntoIterator<Item = (String, PathBuf)>,
    replaced: &[(&str, &[u8])],
) -> Result<()> {
    let failed = |error: zip::result::ZipError| FmiError::io(action, path)(error.into());
    let mut archive = ZipWriter::new(BufWriter::new(out));
    for (name, file) in files {
        let mut content = open_regular(&file).map_err(FmiError::io("read", &file))?;
        let metadata = content.metadata().map_err(FmiError::io("read", &file))?;
        let mode = if platform::is_executable(&metadata) { 0o755 } else { 0o644 };
        // Without a modification time, the crate writes the earliest one of the format, 1980.
        let options = SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Deflated)
            .last_modified_time(zip::DateTime::default())
            .large_file(metadata.len() >= u64::from(u32::MAX))
            .unix_permissions(mode);
        archive.start_file(name.as_str(), options).map_err(failed)?;
        let written = match replaced.iter().find(|(replaced, _)| *replaced == name) {
            Some((_, content)) => archive.write_all(content),
            None => io::copy(&mut content, &mut archive).map(drop),
        };
        written.map_err(FmiError::io(action, path))?;
    }
    archive.finish().map_err(failed)?.flush().map_err(FmiError::io(action, path))
}

/// Opens and unpacks the archive as a user would.
fn check_result(path: &Path, source: &Archive, folder: &Path) -> Result<()> {
    let archive = Archive::open(path)?;
    ModelDescription::read(&archive)?;
    let text = |archive: &Archive| {
        let path = archive.unpack()?.join(MODEL_DESCRIPTION);
        read_regular(&path).map_err(FmiError::io("read", path))
    };
    if text(&archive)? == text(source)? {
        return Ok(());
    }
    let reason = "the model description changed during packing".to_owned();
    Err(FmiError::CannotPack { folder: folder.to_owned(), reason })
}
