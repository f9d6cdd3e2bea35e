//! FMUs for the tests: the bundled models, and small C sources with one fault each. They are compiled into
//! temporary folders.
#![allow(dead_code, clippy::unwrap_used)]

use example_models::ExampleKind;
use fmi::Fmu;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Bundled models with the final time of their simulations. No model ends itself before that time.
pub(crate) const MODELS: [(&str, f64); 8] = [
    ("dahlquist", 5.0),
    ("van_der_pol", 5.0),
    ("bouncing_ball", 2.9),
    ("stair", 8.5),
    ("furuta", 5.0),
    ("switched_input", 3.0),
    ("quad_tank", 20.0),
    ("exhaust", 5.0),
];

/// Returns the folder of this crate.
fn here() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Returns the folder of the bundled models.
pub(crate) fn models() -> PathBuf {
    here().join("../example-models/models")
}

/// Compiles `sources` into the library of an unpacked FMU.
fn compile(root: &Path, identifier: &str, sources: &[PathBuf], defines: &[&str]) {
    compile_with(root, identifier, sources, defines, &[]);
}

/// Compiles `sources` into the library of an unpacked FMU, with further arguments.
fn compile_with(root: &Path, identifier: &str, sources: &[PathBuf], defines: &[&str], arguments: &[String]) {
    let folder = root
        .join("binaries")
        .join(&fmi::platform::binary_folders(fmi::platform::FolderNames::SystemAndBits)[0]);
    std::fs::create_dir_all(&folder).unwrap();
    let library = folder.join(format!("{identifier}.{}", fmi::platform::LIBRARY_EXTENSION));
    let output = Command::new("cc")
        .args(["-shared", "-fPIC", "-O1", "-ffp-contract=off", "-fno-builtin-atoi", "-Wl,-z,lazy", "-o"])
        .arg(&library)
        .args(defines.iter().map(|define| format!("-D{define}")))
        .arg("-I")
        .arg(models().join("frontend"))
        .args(sources)
        .args(arguments)
        .arg("-lm")
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Folder with an FMU. It is removed when the value is dropped.
pub(crate) struct Folder {
    folder: tempfile::TempDir,
}

impl Folder {
    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn open(&self) -> Fmu {
        Fmu::open(self.path()).unwrap()
    }
}

/// Returns a bundled model.
pub(crate) fn model(name: &str) -> Folder {
    let folder = tempfile::tempdir().unwrap();
    let model = models().join(name);
    std::fs::copy(model.join("modelDescription.xml"), folder.path().join("modelDescription.xml")).unwrap();
    compile(folder.path(), name, &[model.join("model.c"), models().join("frontend/fmi2_me.c")], &[]);
    Folder { folder }
}

/// Returns a bundled model in another version, compiled with these macros and an edited description.
pub(crate) fn model_as(
    name: &str,
    kind: ExampleKind,
    defines: &[&str],
    edit: impl FnOnce(String) -> String,
) -> Folder {
    let folder = tempfile::tempdir().unwrap();
    let packed = Fmu::open(example_models::example_fmu_as(name, kind).unwrap()).unwrap();
    let xml = std::fs::read_to_string(packed.root().unwrap().join("modelDescription.xml")).unwrap();
    std::fs::write(folder.path().join("modelDescription.xml"), edit(xml)).unwrap();
    let mut sources: Vec<PathBuf> = std::fs::read_dir(packed.root().unwrap().join("sources"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "c"))
        .collect();
    sources.sort();
    compile(folder.path(), name, &sources, defines);
    Folder { folder }
}

/// Returns the FMI 3.0 model with arrays and all types (`tests/arrays`).
pub(crate) fn arrays() -> Folder {
    fixture("arrays", |xml| xml)
}

/// Returns the FMI 3.0 model in `tests/<name>` with an edited description.
pub(crate) fn fixture(name: &str, edit: impl FnOnce(String) -> String) -> Folder {
    fixture_with(name, &[], edit)
}

/// Returns the FMI 3.0 model in `tests/<name>`, compiled with these macros and an edited description.
pub(crate) fn fixture_with(name: &str, defines: &[&str], edit: impl FnOnce(String) -> String) -> Folder {
    let folder = tempfile::tempdir().unwrap();
    let source = here().join("tests").join(name);
    let xml = std::fs::read_to_string(source.join("modelDescription.xml")).unwrap();
    std::fs::write(folder.path().join("modelDescription.xml"), edit(xml)).unwrap();
    compile(folder.path(), name, &[source.join(format!("{name}.c"))], defines);
    Folder { folder }
}

/// Returns the evil model (`tests/evil/evil.c`) with these faults.
pub(crate) fn evil(faults: &[&str]) -> Folder {
    evil_with(faults, |xml| xml)
}

/// Returns the evil model with these faults and an edited description.
pub(crate) fn evil_with(faults: &[&str], edit: impl FnOnce(String) -> String) -> Folder {
    let folder = tempfile::tempdir().unwrap();
    let xml = std::fs::read_to_string(here().join("tests/evil/modelDescription.xml")).unwrap();
    std::fs::write(folder.path().join("modelDescription.xml"), edit(xml)).unwrap();
    compile(folder.path(), "evil", &[here().join("tests/evil/evil.c")], faults);
    Folder { folder }
}

/// Returns the evil model with these faults and its parameter in a second library in the same folder. The
/// loader identifies libraries by name. If two libraries in a process have the same name, it uses the first.
pub(crate) fn evil_with_sibling(faults: &[&str], name: &str) -> Folder {
    let folder = evil(faults);
    let faults: Vec<&str> = faults.iter().copied().chain(["SIBLING_GLOBALS"]).collect();
    compile(folder.path(), &format!("lib{name}"), &[here().join("tests/evil/sibling.c")], &[]);
    let beside = folder
        .path()
        .join("binaries")
        .join(&fmi::platform::binary_folders(fmi::platform::FolderNames::SystemAndBits)[0]);
    let arguments = [format!("-L{}", beside.display()), format!("-l{name}"), "-Wl,-rpath,$ORIGIN".to_owned()];
    compile_with(folder.path(), "evil", &[here().join("tests/evil/evil.c")], &faults, &arguments);
    folder
}

/// Returns the equation with faults (`tests/evil/model.c`) with one of the bundled front ends.
pub(crate) fn faulty(kind: ExampleKind, defines: &[&str]) -> Folder {
    let folder = tempfile::tempdir().unwrap();
    let packed = Fmu::open(example_models::example_fmu_as("dahlquist", kind).unwrap()).unwrap();
    let xml = std::fs::read_to_string(packed.root().unwrap().join("modelDescription.xml")).unwrap();
    let xml = match kind {
        ExampleKind::Fmi3 => {
            // In FMI 3.0 an event indicator is a variable.
            let variable = "<Float64 name=\"z\" valueReference=\"4\"/>\n  </ModelVariables>";
            let indicator = "<EventIndicator valueReference=\"4\"/>\n  </ModelStructure>";
            xml.replacen("</ModelVariables>", variable, 1).replacen("</ModelStructure>", indicator, 1)
        }
        _ => {
            let xml = xml.replace("numberOfEventIndicators=\"0\"", "");
            xml.replacen("modelName=", "numberOfEventIndicators=\"1\" modelName=", 1)
        }
    };
    std::fs::write(folder.path().join("modelDescription.xml"), xml).unwrap();
    let mut sources: Vec<PathBuf> = std::fs::read_dir(packed.root().unwrap().join("sources"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "c"))
        .filter(|path| path.file_name().is_some_and(|name| name != "model.c"))
        .collect();
    sources.push(here().join("tests/evil/model.c"));
    compile(folder.path(), "dahlquist", &sources, defines);
    Folder { folder }
}
