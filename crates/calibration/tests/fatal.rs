//! FMUs that return `Fatal` at some values of the parameters. The loaded copy of the library is abandoned,
//! the evaluation fails, and the next evaluation is unaffected.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

mod support;

use calibration::RunContext;
use dfo::Termination;
use fmi::Fmu;
use support::{calibration, costs, faulty, fit};

#[test]
fn fatal_status_fails_only_one_evaluation() {
    let (error, fatal) = (faulty(&["ERROR_ABOVE=2.2"]), faulty(&["FATAL_ABOVE=2.2", "SHARED_GLOBALS"]));
    let expected = fit(&calibration(Fmu::open(error.path()).unwrap()), 1, 200);
    assert!((expected.x[0] - 1.7).abs() < 1e-2, "{:?}", expected.x);
    assert!(expected.report.n_failed > 20, "{}", expected.report.n_failed);
    for workers in [1, 3] {
        // Open the FMU again for each number of workers.
        let calibration = calibration(Fmu::open(fatal.path()).unwrap());
        let found = fit(&calibration, workers, 200);
        assert_eq!(costs(&found), costs(&expected), "{workers}");
        assert_eq!(found.x, expected.x);
        assert_eq!(found.report.n_failed, expected.report.n_failed);
        assert!(calibration.cost(&[1.7], &RunContext::new()).unwrap() < 1e-8);
    }
}

/// If the library copies run out, the fit ends with its best point and reports the reason.
#[cfg(target_env = "gnu")]
#[test]
fn fit_returns_its_best_point_when_library_copies_run_out() {
    let folder = faulty(&["FATAL_ABOVE=2.2", "LARGE_TLS=400"]);
    let calibration = calibration(Fmu::open(folder.path()).unwrap());
    let fit = fit(&calibration, 2, 200);
    let Termination::Aborted(reason) = &fit.report.termination else {
        unreachable!("{}", fit.report.termination);
    };
    assert!(reason.contains("static TLS") && reason.contains("evil.so"), "{reason}");
    assert!(fit.cost.is_finite() && fit.x[0] < 2.2, "{fit}");
    let best = costs(&fit).into_iter().flatten().map(f64::from_bits).fold(f64::INFINITY, f64::min);
    assert_eq!(fit.cost, best);
    let error = calibration.cost(&[1.0], &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("static TLS"), "{error}");
}

/// The library ends the process if two threads use it at once, and stores its parameter in a static variable.
#[test]
fn workers_use_a_shared_library_one_at_a_time() {
    let folder = faulty(&["DIES_WITH_TWO", "SHARED_GLOBALS"]);
    let alone = fit(&calibration(Fmu::open(folder.path()).unwrap()), 1, 100);
    let together = fit(&calibration(Fmu::open(folder.path()).unwrap()), 4, 100);
    assert_eq!(costs(&together), costs(&alone));
}

/// An instance that cannot be terminated makes its loaded library unusable but fails no evaluation.
#[test]
fn fatal_status_at_the_end_of_a_run_does_not_change_the_cost() {
    let honest = faulty(&[]);
    let expected = fit(&calibration(Fmu::open(honest.path()).unwrap()), 1, 60);
    for (status, workers) in [("fmi2Fatal", 1), ("fmi2Fatal", 3), ("fmi2Error", 2)] {
        let folder = faulty(&[&format!("TERMINATE={status}"), "SHARED_GLOBALS"]);
        let found = fit(&calibration(Fmu::open(folder.path()).unwrap()), workers, 60);
        assert_eq!(costs(&found), costs(&expected), "{status} {workers}");
        assert_eq!(found.report.n_failed, 0);
    }
}

/// The instance of a session and the simulators of a fit are independent. The model declares that it can only be
/// instantiated once per process.
#[test]
fn calibration_works_after_a_simulation_of_the_model() {
    let folder = faulty(&["STATIC_PARAMETERS"]);
    let description = folder.path().join("modelDescription.xml");
    let xml = std::fs::read_to_string(&description).unwrap();
    let once = xml.replace("\"evil\"/>", "\"evil\" canBeInstantiatedOnlyOncePerProcess=\"true\"/>");
    std::fs::write(&description, once).unwrap();
    let fmu = Fmu::open(folder.path()).unwrap();
    let mut session = fmi::Session::new(fmu.clone());
    let options = fmi::SimulateOptions::new();
    let first = session.simulate(&options).unwrap();
    let calibration = calibration(fmu.clone());
    let cost = calibration.cost(&[3.0], &RunContext::new()).unwrap();
    fit(&calibration, 2, 50);
    assert_eq!(calibration.cost(&[3.0], &RunContext::new()).unwrap(), cost);
    assert_eq!(session.get("y").unwrap().as_number(), first.final_value("y").unwrap());
    assert_eq!(session.simulate(&options).unwrap().columns, first.columns);
    assert_eq!(fmu.simulate(&options).unwrap().columns, first.columns);
}
