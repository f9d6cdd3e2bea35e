//! Properties that every opened archive and every accepted description must have, whatever the bytes are.
//! Property tests, the replay of stored inputs and the fuzz targets check them.
#![allow(clippy::unwrap_used, clippy::expect_used, unreachable_pub, dead_code)]

use fmi::description::QuirkKind;
use fmi::{Archive, ArchiveLimits, CancelRequest, FmiError, ModelDescription};
use std::fs;
use std::path::Path;

/// Limits under which reading any input needs little memory and time.
pub const SMALL: ArchiveLimits = ArchiveLimits {
    entries: 200,
    folders: 100,
    file_bytes: 4 << 20,
    total_bytes: 8 << 20,
    ratio: 200,
    ratio_free_bytes: 1 << 20,
};

/// Opens the archive at `path` under [`SMALL`] limits and unpacks it. The result is an informative error, or
/// a folder within the limits. The folder contains a model description and only files and folders, and is
/// removed with the archive.
pub fn hold_for_archive(path: &Path) {
    match Archive::open_with(path, &SMALL, &CancelRequest::default()) {
        Err(error) => assert_has_message(&error),
        Ok(archive) => {
            let root = archive.unpack();
            match &root {
                Err(error) => assert_has_message(error),
                Ok(root) => {
                    assert!(root.join("modelDescription.xml").is_file());
                    assert!(size_below(root) <= SMALL.total_bytes);
                }
            }
            match ModelDescription::read(&archive) {
                Err(error) => assert_has_message(&error),
                Ok(description) => hold_for_description(&description),
            }
            drop(archive);
            assert!(root.is_err() || !root.unwrap().exists());
        }
    }
}

/// Parses any bytes as a model description.
pub fn hold_for_document(bytes: &[u8]) {
    match ModelDescription::parse(bytes) {
        Err(error) => assert_has_message(&error),
        Ok(description) => hold_for_description(&description),
    }
}

/// Checks that all indices are in range, all variables are found by name, and all quirks have a message.
pub fn hold_for_description(model: &ModelDescription) {
    let n = model.variables.len();
    let structure = &model.structure;
    for unknown in structure.outputs.iter().chain(&structure.derivatives).chain(&structure.initial_unknowns) {
        assert!(unknown.index < n);
        assert!(unknown.dependencies.iter().flatten().all(|&index| index < n));
        let dependencies = unknown.dependencies.as_ref().map(Vec::len);
        assert!(unknown.kinds.is_empty() || Some(unknown.kinds.len()) == dependencies);
    }
    for variable in &model.variables {
        assert!(variable.derivative.is_none_or(|index| index < n));
        let found = model.variable(&variable.name).expect("a variable is found by its name");
        assert_eq!(found.name, variable.name);
    }
    if let Some(first) = model.variables.first() {
        assert!(model.nearest_names(&first.name, 2).len() <= 2);
    }
    let departs = model.quirks.iter().any(|quirk| quirk.kind != QuirkKind::Unsupported);
    assert_eq!(model.require_conforming().is_err(), departs);
    assert!(model.quirks.iter().all(|quirk| !quirk.message.is_empty()));
}

fn assert_has_message(error: &FmiError) {
    assert!(error.to_string().len() > 10, "{error}");
}

/// Returns the size in bytes of all files below a folder that contains only files and folders.
fn size_below(folder: &Path) -> u64 {
    let sizes = fs::read_dir(folder).unwrap().map(|entry| {
        let path = entry.unwrap().path();
        let metadata = path.symlink_metadata().unwrap();
        assert!(metadata.is_file() || metadata.is_dir(), "{}", path.display());
        if metadata.is_dir() { size_below(&path) } else { metadata.len() }
    });
    sizes.sum()
}
