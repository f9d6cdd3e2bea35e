//! Calibrations of a small model with one fault each, and normally distributed numbers.
#![allow(dead_code, clippy::unwrap_used)]

use calibration::{Calibration, Data, Experiment, Fit, FitOptions, Parameter};
use dfo::{DifferentialEvolution, Limits, RunOptions};
use fmi::Fmu;
use std::path::Path;
use std::process::Command;

/// Compiles x' = -k x with these faults (see the source).
pub(crate) fn faulty(defines: &[&str]) -> tempfile::TempDir {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fmi");
    let folder = tempfile::tempdir().unwrap();
    let description = source.join("tests/evil/modelDescription.xml");
    std::fs::copy(description, folder.path().join("modelDescription.xml")).unwrap();
    let binaries = folder.path().join("binaries");
    let place = binaries.join(&fmi::platform::binary_folders(fmi::platform::FolderNames::SystemAndBits)[0]);
    std::fs::create_dir_all(&place).unwrap();
    let compiled = Command::new("cc")
        .args(["-shared", "-fPIC", "-O1", "-ffp-contract=off", "-o"])
        .arg(place.join(format!("evil.{}", fmi::platform::LIBRARY_EXTENSION)))
        .args(defines.iter().map(|define| format!("-D{define}")))
        .arg("-I")
        .arg(source.join("../example-models/models/frontend"))
        .arg(source.join("tests/evil/evil.c"))
        .arg("-lm")
        .status()
        .unwrap();
    assert!(compiled.success());
    folder
}

pub(crate) fn calibration(fmu: Fmu) -> Calibration {
    let t = vec![0.0, 0.25, 0.5, 1.0];
    let y = t.iter().map(|t: &f64| (-1.7 * t).exp()).collect();
    Calibration::builder(fmu)
        .experiment(Experiment::new(Data::from_columns(t, [("y".to_owned(), y)]).unwrap()).output("y", "y"))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 5.0))
        .build()
        .unwrap()
}

pub(crate) fn fit(calibration: &Calibration, workers: usize, evaluations: usize) -> Fit {
    let options = RunOptions {
        method: DifferentialEvolution::default().into(),
        limits: Limits { max_evaluations: Some(evaluations), ..Limits::default() },
        workers: Some(workers),
        seed: Some(5),
        ..FitOptions::default_run()
    };
    calibration.fit(options).unwrap()
}

pub(crate) fn costs(fit: &Fit) -> Vec<Option<u64>> {
    fit.report.trace.iter().map(|entry| entry.outcome.value().map(f64::to_bits)).collect()
}

/// Returns normally distributed numbers: uniform numbers from a linear congruential generator (Knuth's MMIX),
/// transformed by the Box-Muller method.
pub(crate) fn normal(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut uniform = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    };
    move || (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos()
}
