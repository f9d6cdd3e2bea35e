//! A copy of an FMU with other start values. All other content stays unchanged in every version.
#![allow(clippy::unwrap_used)]

use example_models::{ExampleKind, example_fmu_as};
use fmi::{FmiError, Fmu, Value};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use zip::ZipArchive;

/// Name, properties (method, time, mode), checksum and packed bytes of all entries except the description,
/// and the description.
type Entries = (Vec<(String, String, u32, Vec<u8>)>, String);

fn entries(path: &Path) -> Entries {
    let mut archive = ZipArchive::new(File::open(path).unwrap()).unwrap();
    let (mut others, mut description) = (Vec::new(), String::new());
    for k in 0..archive.len() {
        let mut entry = archive.by_index_raw(k).unwrap();
        let name = entry.name().unwrap().into_owned();
        let what = format!("{:?} {:?} {:?}", entry.compression(), entry.last_modified(), entry.unix_mode());
        let (crc, mut bytes) = (entry.crc32(), Vec::new());
        if name == "modelDescription.xml" {
            drop(entry);
            archive.by_index(k).unwrap().read_to_string(&mut description).unwrap();
        } else {
            entry.read_to_end(&mut bytes).unwrap();
            others.push((name, what, crc, bytes));
        }
    }
    (others, description)
}

fn copied(fmu: &Fmu, values: &[(&str, f64)], to: &Path) -> Result<Fmu, FmiError> {
    let values: Vec<(String, f64)> =
        values.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
    fmu.write_with_start_values(&values, &File::create(to).unwrap())?;
    Fmu::open(to)
}

/// Removes the start attributes with these values from a document.
fn without_starts(text: &str, texts: &[&str]) -> String {
    texts.iter().fold(text.to_owned(), |text, start| text.replacen(&format!("start=\"{start}\""), "start", 1))
}

#[test]
fn write_with_start_values_changes_only_start_values() {
    let folder = tempfile::tempdir().unwrap();
    for kind in [
        ExampleKind::Fmi1ModelExchange,
        ExampleKind::Fmi1CoSimulation,
        ExampleKind::Fmi2ModelExchange,
        ExampleKind::Fmi3,
    ] {
        let path = example_fmu_as("furuta", kind).unwrap();
        let fmu = Fmu::open(&path).unwrap();
        let to = folder.path().join("copy.fmu");
        let copy = copied(&fmu, &[("armFriction", 0.1 + 0.2), ("pendulumFriction", 1e-5)], &to).unwrap();
        let start = |fmu: &Fmu, name: &str| fmu.description().variable(name).unwrap().start.clone();
        assert_eq!(start(&copy, "armFriction"), Some(Value::Real(0.1 + 0.2)), "{kind:?}");
        assert_eq!(start(&copy, "pendulumFriction"), Some(Value::Real(1e-5)));
        for variable in &fmu.description().variables {
            if !["armFriction", "pendulumFriction"].contains(&variable.name.as_str()) {
                assert_eq!(start(&copy, &variable.name), variable.start, "{}", variable.name);
            }
        }
        let ((others, before), (copies, after)) = (entries(&path), entries(&to));
        assert!(others == copies, "{kind:?}: the other files are as they were packed");
        assert_eq!(
            without_starts(&before, &["0.012", "0.002"]),
            without_starts(&after, &["0.30000000000000004", "1e-5"])
        );
        let trajectory = copy.simulate(&fmi::SimulateOptions { final_time: Some(0.1), ..Default::default() });
        assert!(trajectory.is_ok(), "{kind:?}: {trajectory:?}");
    }
}

#[test]
fn write_with_start_values_packs_a_folder() {
    let fmu = Fmu::open(example_fmu_as("dahlquist", ExampleKind::Fmi2ModelExchange).unwrap()).unwrap();
    let (folder, to) = (fmu.root().unwrap(), tempfile::tempdir().unwrap());
    let copy = copied(&Fmu::open(folder).unwrap(), &[("k", 3.0)], &to.path().join("copy.fmu")).unwrap();
    assert_eq!(copy.description().variable("k").unwrap().start, Some(Value::Real(3.0)));
    assert!(copy.simulate(&fmi::SimulateOptions { final_time: Some(0.1), ..Default::default() }).is_ok());
}

#[test]
fn write_with_start_values_rejects_invalid_values() {
    let fmu = Fmu::open(example_fmu_as("furuta", ExampleKind::Fmi2ModelExchange).unwrap()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let refusal =
        |name: &str, value: f64| copied(&fmu, &[(name, value)], &folder.path().join("copy.fmu")).unwrap_err();
    assert!(
        matches!(refusal("armFricton", 1.0), FmiError::UnknownVariable { nearest, .. } if nearest[0] == "armFriction")
    );
    assert!(matches!(refusal("armFriction", f64::NAN), FmiError::NotFinite { .. }));
    assert!(matches!(
        refusal("der(armJoint.phi)", 1.0),
        FmiError::NotSettable { .. } | FmiError::UnknownVariable { .. }
    ));
}

/// Uses all parameters of the FMUs in a folder, if it is specified: `FMUFIT_FMUS=/a/folder cargo test`.
#[test]
fn write_with_start_values_preserves_files_of_other_tools() {
    let Some(folder) = std::env::var_os("FMUFIT_FMUS") else { return };
    let to = tempfile::tempdir().unwrap();
    for file in std::fs::read_dir(folder).unwrap() {
        let path = file.unwrap().path();
        let Ok(fmu) = Fmu::open(&path) else { continue };
        let is_one = |v: &&fmi::Variable| {
            v.causality == fmi::description::Causality::Parameter
                && v.variability != fmi::description::Variability::Constant
                && v.kind == fmi::description::VariableKind::Real
                && matches!(v.start, Some(Value::Real(x)) if x.is_finite())
        };
        let values: Vec<(String, f64)> = fmu
            .description()
            .variables
            .iter()
            .filter(is_one)
            .map(|v| (v.name.clone(), 1.25 + v.start.as_ref().and_then(Value::as_number).unwrap()))
            .collect();
        let copy = to.path().join("copy.fmu");
        let written = fmu.write_with_start_values(&values, &File::create(&copy).unwrap());
        assert!(written.is_ok(), "{}: {written:?}", path.display());
        let new = Fmu::open(&copy).unwrap();
        for (name, value) in &values {
            let start = new.description().variable(name).unwrap().start.clone();
            assert_eq!(start, Some(Value::Real(*value)), "{}: {name}", path.display());
        }
        assert!(entries(&path).0 == entries(&copy).0, "{}", path.display());
    }
}
