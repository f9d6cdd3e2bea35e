//! Saved fits: bit-for-bit round trip, results without the model, and rejection of invalid files.
#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::{
    Calibration, CalibrationError, Data, Experiment, Fit, FitOptions, Parameter, SavedFit, Stage,
};
use ciborium::Value;
use fmi::{FmiError, Fmu};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// x' = -k x with k = 2, two recordings with separate start values, and a gap in one of them.
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
fn saved_fit_round_trips_bit_for_bit() {
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
    assert_eq!(again.solver(), fit.solver);
    assert_eq!(again.cost(&fit.x, &RunContext::new()).unwrap().to_bits(), fit.cost.to_bits());
    assert_eq!(saved.fit.to_bytes(&again).unwrap(), bytes);
}

#[test]
fn saved_fit_shows_its_results_without_the_model() {
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
    assert_eq!(described.rms(&fit.x, fit.cost), fit.rms);
    assert_eq!(described.fmu().description().variable("x").unwrap().name, "x");
    assert_eq!(saved.fit.to_bytes(&described).unwrap(), bytes, "it can be saved again");
    let check = |error: CalibrationError, expected: &str| {
        let text = error.to_string();
        assert!(text.contains("model.fmu") && text.contains(&hash) && text.contains(expected), "{text}");
    };
    check(described.cost(&fit.x, &RunContext::new()).unwrap_err(), "no longer exists");
    check(described.simulate(&fit.x, None, &RunContext::new()).unwrap_err(), "no longer exists");
    assert!(described.fit(FitOptions::default()).is_err());
    // Another model has replaced the file.
    std::fs::copy(example_models::example_fmu("van_der_pol").unwrap(), &place).unwrap();
    let described = saved.calibration().unwrap();
    check(
        described.cost(&fit.x, &RunContext::new()).unwrap_err(),
        "the file has changed and now has the content",
    );
    let other = saved.calibration_with(Fmu::open(&place).unwrap()).unwrap_err();
    assert!(matches!(other, CalibrationError::OtherModel { .. }), "{other}");
    let again = saved.calibration_with(Fmu::open(&moved).unwrap()).unwrap();
    assert_eq!(again.cost(&fit.x, &RunContext::new()).unwrap().to_bits(), fit.cost.to_bits());
    assert_eq!(again.problem().model.path, moved);
}

/// Changes the items of the file: the header, and the content after it. The header contains the hash of the
/// content.
fn changed(mut bytes: &[u8], change: impl Fn(&mut [Value])) -> Vec<u8> {
    let mut items: Vec<Value> = (0..3).map(|_| ciborium::from_reader(&mut bytes).unwrap()).collect();
    change(&mut items);
    let written = |items: &[Value]| {
        let mut bytes = Vec::new();
        items.iter().for_each(|item| ciborium::into_writer(item, &mut bytes).unwrap());
        bytes
    };
    let rest = written(&items[1..]);
    let hash: String = Sha256::digest(&rest).iter().map(|byte| format!("{byte:02x}")).collect();
    *field(&mut items[0], "hash") = hash.into();
    [written(&items[..1]), rest].concat()
}

/// Returns the part of an item at a path of names and, for lists, indices.
fn field<'v>(item: &'v mut Value, path: &str) -> &'v mut Value {
    path.split('.').fold(item, |value, name| match value {
        Value::Array(items) => &mut items[name.parse::<usize>().unwrap()],
        Value::Map(entries) => {
            &mut entries.iter_mut().find(|(key, _)| key.as_text() == Some(name)).unwrap().1
        }
        other => panic!("{name} in {other:?}"),
    })
}

#[test]
fn saved_fit_rejects_invalid_files() {
    let (_, _, bytes) = fitted();
    let refusal = |bytes: &[u8]| {
        let error = SavedFit::from_bytes(bytes, "a.fit").unwrap_err().to_string();
        assert!(error.starts_with("a.fit: "), "{error}");
        error
    };
    assert_eq!(changed(&bytes, |_| ()), bytes);
    let other = refusal(&changed(&bytes, |items| *field(&mut items[0], "format_version") = 99.into()));
    assert!(other.contains("format 99") && other.contains("reads format 8"), "{other}");
    let kind = refusal(&changed(&bytes, |items| *field(&mut items[0], "format") = "something".into()));
    assert!(kind.contains("not a saved fit"), "{kind}");
    let renamed = |from: &str, to: &str| {
        let bytes = changed(&bytes, |items| {
            let Value::Map(fit) = field(&mut items[1], "0") else { panic!("a fit is a map") };
            let entry = fit.iter_mut().find(|(key, _)| key.as_text() == Some(from)).unwrap();
            entry.0 = to.into();
        });
        refusal(&bytes)
    };
    assert!(renamed("n_checks", "n_check").contains("n_checks"));
    // An optional field with another name must not be ignored.
    let unknown = renamed("in_this_process", "later");
    assert!(unknown.contains("data that this version does not support"), "{unknown}");
    let edited = |place: &str, new: Value| {
        refusal(&changed(&bytes, |items| *field(&mut items[1], &format!("0.{place}")) = new.clone()))
    };
    assert!(edited("without_effect", Value::Array(vec![9.into()])).contains("inconsistent"));
    for field in ["names", "start", "units", "bounds"] {
        let error = edited(field, Value::Array(Vec::new()));
        assert!(error.contains(&format!("fit.{field} has 0 entries; expected 3")), "{error}");
    }
    for field in ["names", "x", "is_log", "covariance", "standard_errors", "correlation"] {
        let error = edited(&format!("uncertainty.{field}"), Value::Array(Vec::new()));
        assert!(error.contains(&format!("fit.uncertainty.{field} has 0 entries")), "{error}");
    }
    let weakest = edited("uncertainty.weakest", Value::Array(vec![0.into(), 7.into()]));
    assert!(weakest.contains("fit.uncertainty.weakest contains the parameter index 7"), "{weakest}");
    let description = refusal(&changed(&bytes, |items| items[2] = Value::Null));
    assert!(description.contains("model description"), "{description}");
    assert!(refusal(b"").contains("not a saved fit") && refusal(b"k = 2").contains("not a saved fit"));
    for cut in [1, 30, bytes.len() / 2, bytes.len() - 1] {
        refusal(&bytes[..cut]);
    }
    assert!(refusal(&bytes[..bytes.len() / 2]).contains("truncated"));
    // Lists with a large declared length or depth use no more memory than the data.
    assert!(
        refusal(&[&bytes[..1], &[0x9b, 0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0]].concat())
            .contains("not a saved fit")
    );
    assert!(refusal(&[0x81; 1 << 20]).contains("not a saved fit"));
    // A file with any changed byte is rejected.
    for k in (0..bytes.len()).step_by(37) {
        let mut damaged = bytes.clone();
        damaged[k] ^= 0x15;
        refusal(&damaged);
    }
}

#[test]
fn saved_fit_reports_unwritable_parts() {
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
    // The fit has other parameters.
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
fn saved_fit_in_stages_round_trips() {
    let calibration = calibration(&model());
    let stages = [Stage::new(["k"]), Stage::new(["x"]).window(0.0, 0.8)];
    let fit = calibration.fit_stages(&stages, FitOptions::default()).unwrap();
    let bytes = fit.to_bytes(&calibration).unwrap();
    let saved = SavedFit::from_bytes(&bytes, "stages.fit").unwrap();
    assert_eq!(format!("{:?}", saved.fit), format!("{fit:?}"));
}
