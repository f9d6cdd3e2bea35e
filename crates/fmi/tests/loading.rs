//! Loading of libraries: libraries next to them, precedence of symbols, and messages of the loader.

#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::platform::LIBRARY_EXTENSION;
use fmi::{FmiError, Fmu, LoaderOptions, OpenOptions, SimulateOptions};
use support::{Folder, evil, evil_with, evil_with_sibling};

fn open(folder: &Folder, loader: LoaderOptions) -> Fmu {
    Fmu::open_with(folder.path(), &OpenOptions { loader, ..OpenOptions::default() }).unwrap()
}

/// Returns y(1) of y' = -k y, y(0) = 1.
fn end(fmu: &Fmu, k: f64) -> Result<f64, FmiError> {
    let options = SimulateOptions::new().start_value("k", k).relative_tolerance(1e-8);
    fmu.simulate(&options).map(|result| result.final_value("y").unwrap().unwrap())
}

#[test]
fn loader_finds_a_library_next_to_the_model_library() {
    let folder = evil_with_sibling(&[], "present");
    assert!((end(&folder.open(), 2.0).unwrap() - (-2f64).exp()).abs() < 1e-7);
}

#[test]
fn loader_messages_are_passed_on_verbatim() {
    let folder = evil_with_sibling(&[], "absent");
    let beside = folder
        .path()
        .join("binaries")
        .join(&fmi::platform::binary_folders(fmi::platform::FolderNames::SystemAndBits)[0]);
    std::fs::remove_file(beside.join(format!("libabsent.{}", fmi::platform::LIBRARY_EXTENSION))).unwrap();
    let error = end(&folder.open(), 1.0).unwrap_err();
    let FmiError::LoadFailed { message, .. } = &error else { panic!("{error}") };
    // Windows does not name the library.
    let expected = match cfg!(windows) {
        true => "not found: libabsent.dll",
        false => "libabsent.so: cannot open shared object file",
    };
    assert!(message.contains(expected), "{message}");
    if cfg!(windows) {
        return;
    }

    let folder = evil(&["UNDEFINED_SYMBOL"]);
    let error = end(&folder.open(), 1.0).unwrap_err();
    let FmiError::LoadFailed { message, .. } = &error else { panic!("{error}") };
    assert!(message.contains("undefined symbol: not_there"), "{message}");
}

#[test]
#[cfg_attr(windows, ignore = "builds an ELF library")]
fn lazy_loading_tolerates_missing_unused_functions() {
    let folder = evil(&["UNDEFINED_SYMBOL"]);
    // The failed attempt leaves no files.
    end(&folder.open(), 1.0).unwrap_err();
    let fmu = open(&folder, LoaderOptions { lazy: true, ..LoaderOptions::default() });
    assert!((end(&fmu, 2.0).unwrap() - (-2f64).exp()).abs() < 1e-7);
}

/// The model calls `atoi("3")`, and defines another `atoi` that always returns 7.
#[test]
#[cfg_attr(windows, ignore = "builds an ELF library")]
fn deepbind_gives_library_symbols_precedence() {
    if std::env::var_os("ASAN_OPTIONS").is_some() {
        return; // the address sanitizer ends a process that asks for it
    }
    let folder = evil(&["CLASHES"]);
    assert!((end(&folder.open(), 1.0).unwrap() - (-3f64).exp()).abs() < 1e-7);
    let folder = evil(&["CLASHES"]);
    let fmu = open(&folder, LoaderOptions { deepbind: true, ..LoaderOptions::default() });
    assert!((end(&fmu, 1.0).unwrap() - (-7f64).exp()).abs() < 1e-7);
}

#[test]
#[cfg_attr(windows, ignore = "builds an ELF library")]
fn fmu_that_needs_its_tool_reports_the_tool_on_failure() {
    let needing = |defines: &[&str]| {
        evil_with(defines, |xml| {
            let xml = xml
                .replace("modelIdentifier=\"evil\"", "modelIdentifier=\"evil\" needsExecutionTool=\"true\"");
            xml.replacen("<fmiModelDescription ", "<fmiModelDescription generationTool=\"Bench 7\" ", 1)
        })
    };
    assert!((end(&needing(&[]).open(), 2.0).unwrap() - (-2f64).exp()).abs() < 1e-7);
    let hint = "Bench 7 at run time (needsExecutionTool), which may be missing";
    let error = end(&needing(&["NOT_INSTANTIABLE"]).open(), 1.0).unwrap_err().to_string();
    assert!(error.contains("no licence for evil") && error.contains(hint), "{error}");
    let error = end(&needing(&["UNDEFINED_SYMBOL"]).open(), 1.0).unwrap_err().to_string();
    assert!(error.contains("not_there") && error.contains(hint), "{error}");
    let error = end(&evil(&["NOT_INSTANTIABLE"]).open(), 1.0).unwrap_err().to_string();
    assert!(!error.contains("needsExecutionTool"), "{error}");
}

#[test]
fn fmu_of_a_draft_version_reports_the_draft_on_failure() {
    let draft = |defines: &[&str]| {
        evil_with(defines, |xml| xml.replace("fmiVersion=\"2.0\"", "fmiVersion=\"2.0-beta.4\""))
    };
    assert!((end(&draft(&[]).open(), 2.0).unwrap() - (-2f64).exp()).abs() < 1e-7);
    let error = end(&draft(&["NOT_INSTANTIABLE"]).open(), 1.0).unwrap_err().to_string();
    assert!(error.contains("FMI 2.0-beta.4, a draft whose functions differ from FMI 2.0"), "{error}");
}

#[test]
fn log_messages_reach_the_instance_with_any_environment() {
    for environment in ["NULL", "(void*)1", "m->functions.componentEnvironment"] {
        let folder = evil(&["NO_START", &format!("LOG_ENVIRONMENT={environment}")]);
        let error = end(&folder.open(), 1.0).unwrap_err().to_string();
        assert!(error.contains("no solution for"), "{environment}: {error}");
    }
}

/// Returns the library of an FMU in a folder.
fn library_of(folder: &Folder, name: &str) -> std::path::PathBuf {
    let platform = &fmi::platform::binary_folders(fmi::platform::FolderNames::SystemAndBits)[0];
    folder.path().join("binaries").join(platform).join(format!("{name}.{}", fmi::platform::LIBRARY_EXTENSION))
}

/// The Linux loader ends the process if it reads beyond the end of a file.
#[cfg(target_os = "linux")]
#[test]
fn truncated_library_is_rejected_with_its_length() {
    let whole = std::fs::read(library_of(&evil(&[]), "evil")).unwrap();
    for share in [1, 2, 10, 30, 50, 70] {
        let folder = evil(&[]);
        let length = whole.len() * share / 100;
        std::fs::write(library_of(&folder, "evil"), &whole[..length]).unwrap();
        let error = end(&folder.open(), 1.0).unwrap_err();
        assert!(matches!(error, FmiError::LoadFailed { .. }), "{share} %: {error}");
        let message = error.to_string();
        for part in ["evil.so", "truncated", &format!("the file has {length} bytes")] {
            assert!(message.contains(part), "{share} %: {message}");
        }
    }
    // A sibling library, which the loader loads together with the model's library.
    let folder = evil_with_sibling(&[], "short");
    let sibling = library_of(&folder, "libshort");
    let whole = std::fs::read(&sibling).unwrap();
    std::fs::write(&sibling, &whole[..whole.len() / 2]).unwrap();
    let message = end(&folder.open(), 1.0).unwrap_err().to_string();
    assert!(message.contains("libshort.so") && message.contains("truncated"), "{message}");
}

#[test]
fn invalid_library_file_is_an_error_with_its_type() {
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n";
    let other_bits = b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0\x03\0\x03\0\x01\0\0\0";
    let cases: [(&[u8], &str); 5] = [
        (b"", "an empty file"),
        (pointer, "git lfs pull"),
        (b"<html>404</html>", "a text file"),
        (b"\x7fELF\x02", "truncated"),
        (other_bits, "ELF x86"),
    ];
    for (bytes, part) in cases {
        let folder = evil(&[]);
        std::fs::write(library_of(&folder, "evil"), bytes).unwrap();
        let error = end(&folder.open(), 1.0).unwrap_err();
        assert!(matches!(error, FmiError::NoBinary { .. }), "{error}");
        assert!(error.to_string().contains(part), "{error}");
    }
}

/// The description would belong to another version.
#[test]
fn library_replaced_after_opening_is_rejected() {
    let (folder, other) = (evil(&[]), evil(&["FASTER"]));
    let cache = fmi::FmuCache::new(4);
    let open = || cache.open(folder.path()).unwrap();
    let fmu = open();
    assert!(open().is_same(&fmu));
    let library = library_of(&folder, "evil");
    std::fs::remove_file(&library).unwrap();
    std::fs::copy(library_of(&other, "evil"), &library).unwrap();
    let message = end(&fmu, 1.0).unwrap_err().to_string();
    assert!(
        message.contains(&format!("evil.{LIBRARY_EXTENSION} has been modified or removed"))
            && message.contains("open the folder again"),
        "{message}"
    );
    assert!((end(&open(), 1.0).unwrap() - (-1.5f64).exp()).abs() < 1e-7);
}
