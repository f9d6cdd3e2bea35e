//! The promises hold for the stored inputs of the fuzz targets, including all that caused a failure.

#![allow(clippy::unwrap_used, clippy::expect_used)]

use crate::promises;

use std::fs;
use std::path::{Path, PathBuf};

fn kept(target: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/seeds").join(target);
    let mut files: Vec<PathBuf> = fs::read_dir(&folder)
        .expect("the seeds are next to the fuzz targets")
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    assert!(files.len() >= 3, "{}: {} seeds", folder.display(), files.len());
    files
}

#[test]
fn archive_seeds_keep_the_fuzz_promises() {
    for path in kept("archive") {
        promises::hold_for_archive(&path);
    }
}

#[test]
fn description_seeds_keep_the_fuzz_promises() {
    for path in kept("description") {
        promises::hold_for_document(&fs::read(path).unwrap());
    }
}

/// The seeds start the fuzzer in the parsers of all three versions, so they must be parsed successfully.
#[test]
fn description_seeds_parse_for_each_version() {
    for version in 1..=3 {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join(format!("../../fuzz/seeds/description/fmi{version}.xml"));
        let model = fmi::ModelDescription::parse(&fs::read(path).unwrap()).unwrap();
        assert!(model.variables.len() >= 8, "{version}: {}", model.variables.len());
    }
}
