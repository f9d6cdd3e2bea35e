//! Opening reads only the description. The files that a library needs are unpacked when it is loaded, and
//! again if they were removed since. All other files are unpacked on request.
#![allow(clippy::unwrap_used, clippy::panic)]

mod zip_bytes;

use fmi::platform::{FolderNames, LIBRARY_EXTENSION, binary_folders};
use fmi::{Fmu, Instance, Instantiated, ModelDescription, SimulateOptions};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use zip_bytes::{Entry, zip};

/// Returns the files of a bundled example as entries of an archive.
fn example_entries() -> Vec<Entry> {
    let fmu = Fmu::open(example_models::example_fmu("dahlquist").unwrap()).unwrap();
    let root = fmu.root().unwrap();
    let mut entries = Vec::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(&root).unwrap().to_str().unwrap().to_owned();
                entries.push(Entry::deflated(&name, &fs::read(&path).unwrap()));
            }
        }
    }
    entries
}

/// Writes the example with a resource, documentation and a library for another platform.
fn write_archive(path: &Path, more: &[Entry]) {
    let mut entries = example_entries();
    entries.push(Entry::stored("resources/deep/table.txt", b"1 2 3"));
    entries.push(Entry::stored("documentation/index.html", b"<p>"));
    entries.push(Entry::stored("binaries/plan9/dahlquist.so", b"not a library"));
    entries.extend_from_slice(more);
    fs::write(path, zip(&entries)).unwrap();
}

fn simulate(fmu: &Fmu) -> Vec<f64> {
    let result = fmu.simulate(&SimulateOptions::new().final_time(1.0).ncp(4)).unwrap();
    result.get("x").unwrap().to_vec()
}

fn private_folders(base: &Path) -> Vec<PathBuf> {
    let names = fs::read_dir(base).unwrap().map(|entry| entry.unwrap().path());
    names.filter(|path| path.join("fmu").is_dir()).map(|path| path.join("fmu")).collect()
}

/// Runs a test again in a process with a separate folder for temporary files, which no other process changes.
/// Returns true in that process.
fn is_alone(test: &str) -> bool {
    const INSIDE: &str = "FMUFIT_TEST_INSIDE";
    if std::env::var_os(INSIDE).is_some() {
        return true;
    }
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", test, "--nocapture"])
        .env(INSIDE, "1")
        .envs(["TMPDIR", "TMP", "TEMP"].map(|variable| (variable, folder.path())))
        .output()
        .unwrap();
    let reported = String::from_utf8_lossy(&output.stdout);
    let complaints = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && reported.contains("1 passed"), "{reported}{complaints}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "files were left");
    false
}

fn instantiate(fmu: &Fmu) -> Instance<Instantiated> {
    fmu.instantiate().unwrap()
}

#[test]
#[cfg_attr(windows, ignore = "a loaded library cannot be removed")]
fn archive_part_is_unpacked_when_it_is_needed() {
    if !is_alone("archive_part_is_unpacked_when_it_is_needed") {
        return;
    }
    let (base, folder) = (std::env::temp_dir(), tempfile::tempdir().unwrap());
    let path = folder.path().join("m.fmu");
    write_archive(&path, &[]);
    let fmu = Fmu::open(&path).unwrap();
    assert_eq!(fmu.description().model_name, "Dahlquist");
    assert_eq!(fmu.content_hash().unwrap().len(), 64);
    assert_eq!(private_folders(&base), Vec::<PathBuf>::new(), "opening unpacks nothing");
    drop(instantiate(&fmu));
    let [root] = &private_folders(&base)[..] else { panic!("one folder") };
    let library =
        format!("binaries/{}/dahlquist.{LIBRARY_EXTENSION}", binary_folders(FolderNames::SystemAndBits)[0]);
    for name in ["modelDescription.xml", "resources/deep/table.txt", &library] {
        assert!(root.join(name).is_file(), "{name}");
    }
    for name in ["documentation", "sources", "binaries/plan9"] {
        assert!(!root.join(name).exists(), "{name}");
    }
    assert_eq!(&fmu.root().unwrap(), root);
    for name in ["documentation/index.html", "sources/model.c", "binaries/plan9/dahlquist.so"] {
        assert!(root.join(name).is_file(), "{name}");
    }
}

#[test]
#[cfg_attr(windows, ignore = "a loaded library cannot be removed")]
fn removed_files_are_unpacked_again() {
    if !is_alone("removed_files_are_unpacked_again") {
        return;
    }
    let (base, folder) = (std::env::temp_dir(), tempfile::tempdir().unwrap());
    let path = folder.path().join("m.fmu");
    write_archive(&path, &[]);
    let fmu = Fmu::open(&path).unwrap();
    let expected = simulate(&fmu);
    let [root] = &private_folders(&base)[..] else { panic!("one folder") };
    let table = root.join("resources/deep/table.txt");
    type Cleaner = fn(&Path);
    let cleaners: [Cleaner; 3] = [
        |root| fs::remove_file(root.join("resources/deep/table.txt")).unwrap(),
        |root| fs::remove_dir_all(root).unwrap(),
        |root| fs::remove_dir_all(root.parent().unwrap()).unwrap(),
    ];
    for clean in cleaners {
        // While the library is loaded.
        clean(root);
        drop(instantiate(&fmu));
        assert_eq!(fs::read_to_string(&table).unwrap(), "1 2 3");
        assert_eq!(simulate(&fmu), expected);
    }
    // Before the library is loaded, but after a file was unpacked.
    for clean in &cleaners[1..] {
        let fmu = Fmu::open(&path).unwrap();
        clean(&fmu.root().unwrap());
        assert_eq!(simulate(&fmu), expected);
    }
}

#[test]
#[cfg_attr(windows, ignore = "an open file cannot be replaced")]
fn files_that_cannot_be_unpacked_again_are_reported() {
    if !is_alone("files_that_cannot_be_unpacked_again_are_reported") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.fmu");
    write_archive(&path, &[]);
    let fmu = Fmu::open(&path).unwrap();
    fs::remove_dir_all(fmu.root().unwrap().parent().unwrap()).unwrap();
    write_archive(&path, &[Entry::stored("resources/new.txt", b"4")]);
    let message = fmu.instantiate().unwrap_err().to_string();
    for part in ["m.fmu", "were removed from", "unpacking them again failed", "has been modified since"] {
        assert!(message.contains(part), "{message}");
    }
    // A folder that is not a private one.
    let loose = tempfile::tempdir().unwrap();
    fs::write(loose.path().join("modelDescription.xml"), zip_bytes::DESCRIPTION).unwrap();
    let fmu = Fmu::open(loose.path()).unwrap();
    loose.close().unwrap();
    let message = fmu.root().unwrap_err().to_string();
    assert!(message.contains("cannot open"), "{message}");
}

#[test]
#[cfg_attr(windows, ignore = "an open file cannot be replaced")]
fn open_fmu_detects_a_modified_file() {
    let folder = tempfile::tempdir().unwrap();
    let (path, new) = (folder.path().join("m.fmu"), folder.path().join("new.fmu"));
    write_archive(&path, &[]);
    let first = Fmu::open(&path).unwrap();
    // The opened file still exists, although another file has its name.
    write_archive(&new, &[Entry::stored("resources/new.txt", b"4")]);
    fs::rename(&new, &path).unwrap();
    assert!(!first.root().unwrap().join("resources/new.txt").exists());
    // Its bytes change, so packed files are lost.
    let second = Fmu::open(&path).unwrap();
    write_archive(&path, &[Entry::stored("resources/newer.txt", b"5")]);
    for error in [second.instantiate().map(drop).unwrap_err(), second.content_hash().map(drop).unwrap_err()] {
        assert!(error.to_string().contains("modified since it was opened"), "{error}");
    }
    assert!(Fmu::open(&path).unwrap().root().unwrap().join("resources/newer.txt").exists());
    // The size is unchanged, and the modification time is restored.
    let third = Fmu::open(&path).unwrap();
    third.root().unwrap();
    let written = fs::metadata(&path).unwrap().modified().unwrap();
    write_archive(&path, &[Entry::stored("resources/newer.txt", b"6")]);
    fs::File::options().write(true).open(&path).unwrap().set_modified(written).unwrap();
    let error = third.content_hash().map(drop).unwrap_err();
    assert!(error.to_string().contains("modified since it was opened"), "{error}");
    // A change of the mode does not change the content.
    let fourth = Fmu::open(&path).unwrap();
    let mut mode = fs::metadata(&path).unwrap().permissions();
    mode.set_readonly(true);
    fs::set_permissions(&path, mode).unwrap();
    fourth.content_hash().unwrap();
}

#[test]
fn unpacking_rejects_damaged_entries() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.fmu");
    for (name, is_needed) in [("resources/a", true), ("documentation/a", false)] {
        write_archive(&path, &[Entry::deflated(name, b"12345").with(|entry| entry.crc32 ^= 1)]);
        let fmu = Fmu::open(&path).unwrap();
        let message = fmu.root().unwrap_err().to_string();
        assert!(message.contains(name) && message.contains("damaged"), "{message}");
        assert_eq!(fmu.instantiate().is_err(), is_needed, "{name}");
    }
    // The description is checked when it is read.
    let damaged = zip_bytes::description().with(|entry| entry.crc32 ^= 1);
    fs::write(&path, zip(&[damaged])).unwrap();
    let archive = fmi::Archive::open(&path).unwrap();
    assert!(ModelDescription::read(&archive).unwrap_err().to_string().contains("damaged"));
}
