//! The relative tolerance that a fit chooses for its simulations.
#![allow(clippy::unwrap_used, clippy::panic)]

use calibration::RunContext;
use calibration::{
    Calibration, CalibrationBuilder, Data, Experiment, Fit, FitOptions, Parameter, ProfileOptions, SavedFit,
    Severity, Stage,
};
use dfo::{AnyMethod, LeastSquares, RunOptions, Tolerances};
use example_models::example_fmu;
use fmi::Fmu;
use fmi::RunSettings;
use std::fs::File;
use tempfile::TempDir;

/// An example model whose description declares a different tolerance.
fn stating(model: &str, tolerance: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let file = File::open(example_fmu(model).unwrap()).unwrap();
    zip::ZipArchive::new(file).unwrap().extract(folder.path()).unwrap();
    let path = folder.path().join("modelDescription.xml");
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains("tolerance=\"1e-6\""));
    std::fs::write(path, text.replace("tolerance=\"1e-6\"", &format!("tolerance=\"{tolerance}\""))).unwrap();
    folder
}

/// A recording of the van der Pol oscillator, with noise of this size.
fn recording(noise: f64) -> Data {
    let time: Vec<f64> = (0..201).map(|k| 0.1 * f64::from(k)).collect();
    let fmu = Fmu::open(example_fmu("van_der_pol").unwrap()).unwrap();
    let options = fmi::SimulateOptions {
        times: Some(time.clone()),
        start_values: vec![("mu".to_owned(), 1.5.into())],
        outputs: Some(vec!["x0".to_owned()]),
        ..fmi::SimulateOptions::new().relative_tolerance(1e-11)
    };
    let exact = fmu.simulate(&options).unwrap().columns.swap_remove(0);
    let wave = |k: usize| (12.9898 * (k as f64 + 1.0)).sin() * 43_758.547;
    let noisy = exact.iter().enumerate().map(|(k, x)| x + noise * (4.0 * wave(k).fract().abs() - 2.0));
    let noisy = noisy.collect();
    Data::from_columns(time, [("x0".to_owned(), noisy)]).unwrap()
}

fn oscillator(folder: &TempDir, noise: f64) -> CalibrationBuilder {
    Calibration::builder(Fmu::open(folder.path()).unwrap())
        .experiment(Experiment::new(recording(noise)).output("x0", "x0"))
        .parameter(Parameter::new("mu", 1.2).bounds(0.1, 5.0))
}

fn run(f_tol: f64) -> RunOptions<AnyMethod> {
    let run = FitOptions::default_run();
    let (method, tolerances) =
        (LeastSquares::default().serial().into(), Tolerances { f_tol, ..run.tolerances });
    RunOptions { method, tolerances, workers: Some(1), ..run }
}

/// True if a finding reports a noisy cost.
fn is_noisy(fit: &Fit) -> bool {
    fit.findings()
        .iter()
        .any(|f| f.severity != Severity::Note && f.to_string().contains("relative_tolerance"))
}

#[test]
fn chosen_tolerance_keeps_cost_smooth_for_f_tol() {
    let folder = stating("van_der_pol", "1e-4");
    let mut used = Vec::new();
    for noise in [0.3, 0.03, 3e-3, 3e-4] {
        for f_tol in [1e-3, 1e-4, 1e-6] {
            let calibration = oscillator(&folder, noise).build().unwrap();
            let fit = calibration.fit(run(f_tol)).unwrap();
            let chosen = fit.tolerance.unwrap();
            let uncertainty = fit.uncertainty.as_ref().unwrap();
            let tight = RunSettings { relative_tolerance: Some(1e-11), ..RunSettings::default() };
            let accurate = oscillator(&folder, noise).settings(tight).build().unwrap();
            let accurate = accurate.cost(&fit.x, &RunContext::new()).unwrap();
            let uncertain = (accurate / uncertainty.cost - 1.0).abs();
            assert!(!is_noisy(&fit) && uncertain <= f_tol, "{noise} {f_tol}: {uncertain} {fit}");
            assert!(chosen.stated == 1e-4 && chosen.noise.is_some());
            assert!((fit.x[0] - 1.5).abs() < 5.0 * uncertainty.standard_errors[0], "{fit}");
            let text = fit.findings().iter().map(ToString::to_string).collect::<String>();
            assert!(text.contains("Set relative_tolerance to override it") && chosen.used <= 1e-6, "{text}");
            used.push(chosen.used);
        }
    }
    for of_noise in used.chunks(3) {
        assert!(of_noise.is_sorted_by(|a, b| a >= b), "{used:?}");
    }
    assert!(used[0] > used[11], "{used:?}");
}

#[test]
fn chosen_tolerance_equals_calibration_when_irrelevant() {
    let folder = stating("van_der_pol", "1e-3");
    let given = RunSettings { relative_tolerance: Some(1e-4), ..RunSettings::default() };
    let fit = oscillator(&folder, 0.03).settings(given).build().unwrap().fit(run(1e-4)).unwrap();
    assert!(fit.tolerance.is_none(), "{fit}");
    let fit = oscillator(&folder, 0.03).build().unwrap().fit(run(0.1)).unwrap();
    let chosen = fit.tolerance.unwrap();
    assert_eq!((chosen.used, chosen.noise), (1e-6, None));
    let folder = stating("van_der_pol", "1e-6");
    let calibration = oscillator(&folder, 0.03).build().unwrap();
    let fit = calibration.fit(run(1e-4)).unwrap();
    assert_eq!((fit.tolerance.unwrap().used, fit.tolerance.unwrap().noise), (1e-6, None));
    assert_eq!(calibration.cost(&fit.x, &RunContext::new()).unwrap(), fit.cost);
}

#[test]
fn chosen_tolerance_is_reproducible_and_stored() {
    let folder = stating("van_der_pol", "1e-4");
    let calibration = oscillator(&folder, 1e-3).build().unwrap();
    let one = calibration.fit(run(1e-4)).unwrap();
    let other =
        oscillator(&folder, 1e-3).build().unwrap().fit(RunOptions { workers: Some(4), ..run(1e-4) }).unwrap();
    assert_eq!((one.tolerance, one.x[0].to_bits()), (other.tolerance, other.x[0].to_bits()));
    assert!(one.tolerance.unwrap().used < 1e-6 && !is_noisy(&one), "{one}");
    let saved = SavedFit::from_bytes(&one.to_bytes(&calibration).unwrap(), "fit").unwrap();
    assert_eq!(saved.fit.tolerance, one.tolerance);
    let profile = calibration.profile(&one, &ProfileOptions::default(), &RunContext::new()).unwrap();
    let (low, high) = profile.parameters[0].interval();
    assert!(low < one.x[0] && one.x[0] < high, "{low} {high} {one}");
    let staged = calibration.fit_stages(&[Stage::new(["mu"])], run(1e-4)).unwrap();
    assert_eq!((staged.tolerance, staged.x[0].to_bits()), (one.tolerance, one.x[0].to_bits()));
    assert!(staged.stages[0].tolerance.is_none());
}
