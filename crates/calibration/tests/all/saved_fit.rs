//! A fit in a file: it comes back with all bits, shows what it is without its model, and files that are none are refused.
#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::dfo::RobustLoss;
use calibration::{
    Calibration, CalibrationError, Data, Experiment, Fit, FitOptions, Parameter, SavedFit, Stage,
};
use fmi::{FmiError, Fmu};
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};

/// x' = -k x with k = 2, two recordings with their own start values, and a hole in one of them.
fn calibration(model: &Path) -> Calibration {
    let t: Vec<f64> = (0..12).map(|k| 0.1 * f64::from(k)).collect();
    let recorded = |x0: f64| {
        let mut x: Vec<f64> = t.iter().map(|t| x0 * (-2.0 * t).exp() + 1e-3 * (40.0 * t).sin()).collect();
        x[3] = f64::NAN;
        Experiment::new(Data::from_columns(t.clone(), [("x".to_owned(), x)]).unwrap()).output("x", "x")
    };
    Calibration::builder(Fmu::open(model).unwrap())
        .experiment(recorded(1.0).named("cold"))
        .experiment(recorded(3.0).named("hot"))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, f64::INFINITY))
        .parameter(Parameter::new("x", 2.0).local(true))
        .build()
        .unwrap()
}

fn model() -> PathBuf {
    example_models::example_fmu("dahlquist").unwrap()
}

fn fitted() -> (Calibration, Fit, Vec<u8>) {
    let calibration = calibration(&model());
    let fit = calibration.fit(FitOptions::default()).unwrap();
    let bytes = fit.to_bytes(&calibration).unwrap();
    (calibration, fit, bytes)
}

#[test]
fn a_fit_comes_back_with_all_bits() {
    let (calibration, fit, bytes) = fitted();
    assert_eq!(fit.names, ["k", "x[cold]", "x[hot]"]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("decay.fit");
    fit.save(&calibration, &path).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), bytes, "the same fit gives the same bytes");
    let saved = SavedFit::load(&path).unwrap();
    assert_eq!(format!("{:?}", saved.fit), format!("{fit:?}"), "NaN is not equal to itself");
    assert_eq!(saved.fit.stats.seconds.get().to_bits(), fit.stats.seconds.get().to_bits());
    assert_eq!(format!("{:?}", saved.problem), format!("{:?}", calibration.problem()));
    let again = saved.calibration().unwrap();
    assert_eq!(again.known_solver(), Some(&fit.solver));
    assert_eq!(again.cost(&fit.x, &RunContext::new()).unwrap().to_bits(), fit.cost.to_bits());
    assert_eq!(saved.fit.to_bytes(&again).unwrap(), bytes);
}

#[test]
fn without_its_model_a_fit_shows_its_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("model.fmu");
    std::fs::copy(model(), &place).unwrap();
    let calibration = calibration(&place);
    let fit = calibration.fit(FitOptions::default()).unwrap();
    let bytes = fit.to_bytes(&calibration).unwrap();
    drop(calibration);
    let hash = Fmu::open(&place).unwrap().content_hash().unwrap().to_owned();
    let moved = folder.path().join("moved.fmu");
    std::fs::rename(&place, &moved).unwrap();
    let saved = SavedFit::from_bytes(&bytes, "decay.fit").unwrap();
    let described = saved.calibration().unwrap();
    assert_eq!(described.rms(&fit.x, fit.cost, RobustLoss::default()), fit.rms);
    assert_eq!(described.fmu().description().variable("x").unwrap().name, "x");
    assert_eq!(saved.fit.to_bytes(&described).unwrap(), bytes, "it can be saved again");
    let check = |error: CalibrationError, expected: &str| {
        let text = error.to_string();
        assert!(text.contains("model.fmu") && text.contains(&hash) && text.contains(expected), "{text}");
    };
    check(described.cost(&fit.x, &RunContext::new()).unwrap_err(), "not there any more");
    check(described.simulate(&fit.x, None, &RunContext::new()).unwrap_err(), "not there any more");
    assert!(described.fit(FitOptions::default()).is_err());
    // Another content at its place.
    std::fs::copy(example_models::example_fmu("van_der_pol").unwrap(), &place).unwrap();
    let described = saved.calibration().unwrap();
    check(described.cost(&fit.x, &RunContext::new()).unwrap_err(), "what is there now has the content");
    let other = saved.calibration_with(Fmu::open(&place).unwrap()).unwrap_err();
    assert!(matches!(other, CalibrationError::OtherModel { .. }), "{other}");
    let again = saved.calibration_with(Fmu::open(&moved).unwrap()).unwrap();
    assert_eq!(again.cost(&fit.x, &RunContext::new()).unwrap().to_bits(), fit.cost.to_bits());
    assert_eq!(again.problem().model.path, moved);
}

/// The archive with one file changed (`None`: left out).
fn changed(bytes: &[u8], name: &str, change: impl Fn(&[u8]) -> Option<Vec<u8>>) -> Vec<u8> {
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).unwrap();
    let mut out = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for k in 0..archive.len() {
        let mut file = archive.by_index(k).unwrap();
        let found = file.name().unwrap().into_owned();
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).unwrap();
        let new = if found == name { change(&bytes) } else { Some(bytes) };
        if let Some(new) = new {
            out.start_file(found, zip::write::SimpleFileOptions::default()).unwrap();
            out.write_all(&new).unwrap();
        }
    }
    out.finish().unwrap().into_inner()
}

#[test]
fn files_that_are_no_fits_are_refused() {
    let (_, _, bytes) = fitted();
    let refusal = |bytes: &[u8]| {
        let error = SavedFit::from_bytes(bytes, "a.fit").unwrap_err().to_string();
        assert!(error.starts_with("a.fit: "), "{error}");
        error
    };
    let text = |from: &'static str, to: &'static str| {
        let bytes = changed(&bytes, "fit.json", |text| {
            let text = std::str::from_utf8(text).unwrap();
            assert!(text.contains(from), "{text}");
            Some(text.replacen(from, to, 1).into_bytes())
        });
        refusal(&bytes)
    };
    let other = text("\"format_version\": 2", "\"format_version\": 3");
    assert!(other.contains("format 3") && other.contains("reads format 2"), "{other}");
    assert!(text("\"fmufit fit\"", "\"something\"").contains("no saved fit"));
    let unknown = text("\"n_checks\"", "\"later\": 1, \"n_checks\"");
    assert!(unknown.contains("fit.later"), "{unknown}");
    let missing = text("\"n_checks\"", "\"n_check\"");
    assert!(missing.contains("n_checks"), "{missing}");
    assert!(text("\"without_effect\": []", "\"without_effect\": [9]").contains("do not fit together"));
    let edited = |place: &str, new: serde_json::Value| {
        let bytes = changed(&bytes, "fit.json", |text| {
            let mut json: serde_json::Value = serde_json::from_slice(text).unwrap();
            *json.pointer_mut(place).unwrap() = new.clone();
            Some(serde_json::to_vec(&json).unwrap())
        });
        refusal(&bytes)
    };
    for field in ["names", "start", "units", "bounds"] {
        let error = edited(&format!("/fit/{field}"), serde_json::json!([]));
        assert!(error.contains(&format!("fit.{field} has 0 entries where there should be 3")), "{error}");
    }
    for field in ["names", "x", "is_log", "covariance", "standard_errors", "correlation"] {
        let error = edited(&format!("/fit/uncertainty/{field}"), serde_json::json!([]));
        assert!(error.contains(&format!("fit.uncertainty.{field} has 0 entries")), "{error}");
    }
    let weakest = edited("/fit/uncertainty/weakest", serde_json::json!([0, 7]));
    assert!(weakest.contains("fit.uncertainty.weakest names parameter 7"), "{weakest}");
    // What takes many times the size of the file.
    let large = changed(&bytes, "modelDescription.xml", |_| Some(vec![b' '; 9 << 20]));
    assert!(refusal(&large).contains("more than the 8388608 that a file of"));
    let many = changed(&bytes, "fit.json", |_| Some(format!("[{}1]", "[],".repeat(1 << 18)).into_bytes()));
    assert!(refusal(&many).contains("fit.json has some 524289 values, more than the 262144"));
    let twice = edited("/written_by", serde_json::json!({ "$array": "arrays/0.npy" }));
    assert!(twice.contains("it refers to arrays/0.npy twice"), "{twice}");
    let without = |name: &str| refusal(&changed(&bytes, name, |_| None));
    assert!(without("fit.json").contains("holds no fit.json"));
    assert!(without("modelDescription.xml").contains("modelDescription.xml"));
    assert!(without("arrays/0.npy").contains("arrays/0.npy"));
    assert!(refusal(b"").contains("no saved fit") && refusal(b"k = 2").contains("no saved fit"));
    for cut in [1, 30, bytes.len() / 2, bytes.len() - 1] {
        refusal(&bytes[..cut]);
    }
    assert!(refusal(&bytes[..bytes.len() / 2]).contains("cut off"));
    // Whatever byte is changed, the file is refused, or the same fit comes out of it (bytes that nobody reads).
    let whole = format!("{:?}", SavedFit::from_bytes(&bytes, "a.fit").unwrap());
    for k in (0..bytes.len()).step_by(37) {
        let mut damaged = bytes.clone();
        damaged[k] ^= 0x15;
        if let Ok(read) = SavedFit::from_bytes(&damaged, "a.fit") {
            assert_eq!(format!("{read:?}"), whole, "byte {k}");
        }
    }
}

#[test]
fn what_cannot_be_written_is_named() {
    let (calibration, fit, _) = fitted();
    let folder = tempfile::tempdir().unwrap();
    let refusal = |path: &Path| fit.save(&calibration, path).unwrap_err();
    let e = refusal(&folder.path().join("none").join("a.fit"));
    assert!(
        matches!(&e, CalibrationError::Model(FmiError::Io { .. })) && e.to_string().contains("none"),
        "{e}"
    );
    let e = refusal(folder.path());
    assert!(matches!(&e, CalibrationError::Model(FmiError::Io { .. })), "{e}");
    assert_eq!(folder.path().read_dir().unwrap().count(), 0, "nothing stays");
    let e = refusal(calibration.fmu().path());
    assert!(e.to_string().contains("is the model itself"), "{e}");
    let e = SavedFit::load(folder.path().join("none.fit")).unwrap_err();
    assert!(
        matches!(&e, CalibrationError::Model(FmiError::Io { .. })) && e.to_string().contains("none.fit"),
        "{e}"
    );
    // A fit of other parameters.
    let t = vec![0.0, 1.0];
    let other = Calibration::builder(Fmu::open(model()).unwrap())
        .experiment(
            Experiment::new(Data::from_columns(t.clone(), [("x".to_owned(), t)]).unwrap()).output("x", "x"),
        )
        .parameter(Parameter::new("k", 1.0))
        .build()
        .unwrap();
    let e = fit.to_bytes(&other).unwrap_err().to_string();
    assert!(e.contains("k, x[cold], x[hot]"), "{e}");
}

#[test]
fn a_fit_in_stages_comes_back() {
    let calibration = calibration(&model());
    let stages = [Stage::new(["k"]), Stage::new(["x"]).window(0.0, 0.8)];
    let fit = calibration.fit_stages(&stages, FitOptions::default()).unwrap();
    let bytes = fit.to_bytes(&calibration).unwrap();
    let saved = SavedFit::from_bytes(&bytes, "stages.fit").unwrap();
    assert_eq!(format!("{:?}", saved.fit), format!("{fit:?}"));
}
