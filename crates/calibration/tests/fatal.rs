//! FMUs that answer `Fatal` at some values of the parameters: the loaded copy of their library is abandoned, the evaluation has
//! failed, and the next one is as if nothing had happened.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

mod support;

use dfo::Termination;
use fmi::Fmu;
use support::{calibration, costs, faulty, fit};

#[test]
fn fatal_costs_no_more_than_an_error() {
    use fmi::Sharing::{Copies, Serial};
    let (error, fatal) = (faulty(&["ERROR_ABOVE=2.2"]), faulty(&["FATAL_ABOVE=2.2", "SHARED_GLOBALS"]));
    let expected = fit(&calibration(Fmu::open(error.path()).unwrap(), Copies), 1, 200);
    assert!((expected.x[0] - 1.7).abs() < 1e-2, "{:?}", expected.x);
    assert!(expected.report.n_failed > 20, "{}", expected.report.n_failed);
    for (workers, sharing) in [(1, Copies), (3, Copies), (3, Serial)] {
        // Each time by another who opens it.
        let calibration = calibration(Fmu::open(fatal.path()).unwrap(), sharing);
        let found = fit(&calibration, workers, 200);
        assert_eq!(costs(&found), costs(&expected), "{workers} {sharing}");
        assert_eq!(found.x, expected.x);
        assert_eq!(found.report.n_failed, expected.report.n_failed);
        assert!(calibration.cost(&[1.7]).unwrap() < 1e-8);
    }
}

/// Copies run out: the fit ends with the best point it has seen, and says why.
#[cfg(target_env = "gnu")]
#[test]
fn a_fit_that_has_no_copy_left_ends_with_its_best_point() {
    let folder = faulty(&["FATAL_ABOVE=2.2", "LARGE_TLS=400"]);
    let calibration = calibration(Fmu::open(folder.path()).unwrap(), fmi::Sharing::Copies);
    let fit = fit(&calibration, 2, 200);
    let Termination::Aborted(reason) = &fit.report.termination else {
        unreachable!("{}", fit.report.termination);
    };
    assert!(reason.contains("static TLS") && reason.contains("evil.so"), "{reason}");
    assert!(fit.cost.is_finite() && fit.x[0] < 2.2, "{fit}");
    let best = costs(&fit).into_iter().flatten().map(f64::from_bits).fold(f64::INFINITY, f64::min);
    assert_eq!(fit.cost, best);
    let error = calibration.cost(&[1.0]).unwrap_err().to_string();
    assert!(error.contains("static TLS"), "{error}");
}

/// The library ends the process when two threads are in it at once, and keeps its parameter in a static variable.
#[test]
fn workers_have_copies_of_their_own() {
    let folder = faulty(&["DIES_WITH_TWO", "SHARED_GLOBALS"]);
    let alone = fit(&calibration(Fmu::open(folder.path()).unwrap(), fmi::Sharing::Copies), 1, 100);
    for sharing in [fmi::Sharing::Copies, fmi::Sharing::Serial] {
        let together = fit(&calibration(Fmu::open(folder.path()).unwrap(), sharing), 4, 100);
        assert_eq!(costs(&together), costs(&alone), "{sharing}");
    }
}

/// An instance of a session and the simulators of a fit do not get in each other's way, whatever the flag says.
#[test]
fn a_model_that_was_simulated_can_be_calibrated() {
    let folder = faulty(&["STATIC_PARAMETERS"]);
    let description = folder.path().join("modelDescription.xml");
    let xml = std::fs::read_to_string(&description).unwrap();
    let once = xml.replace("\"evil\"/>", "\"evil\" canBeInstantiatedOnlyOncePerProcess=\"true\"/>");
    std::fs::write(&description, once).unwrap();
    let fmu = Fmu::open(folder.path()).unwrap();
    let mut session = fmi::Session::new(fmu.clone());
    let options = fmi::SimulateOptions::new();
    let first = session.simulate(&options).unwrap();
    let calibration = calibration(fmu.clone(), fmi::Sharing::Copies);
    let cost = calibration.cost(&[3.0]).unwrap();
    fit(&calibration, 2, 50);
    assert_eq!(calibration.cost(&[3.0]).unwrap(), cost);
    assert_eq!(session.get("y").unwrap().as_number(), first.final_value("y").unwrap());
    assert_eq!(session.simulate(&options).unwrap().columns, first.columns);
    assert_eq!(fmu.simulate(&options).unwrap().columns, first.columns);
}
