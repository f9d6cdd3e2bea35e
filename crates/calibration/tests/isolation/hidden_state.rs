//! Models with hidden state that no variable shows. Each result must equal the result of a fresh process.

use crate::support::faulty;
use crate::{ALONE, decay, memory_of_this_process, open, settings};
use calibration::{Fit, FitOptions, ModelProcess, RunContext};
use dfo::{AnyMethod, DifferentialEvolution, LeastSquares, Limits, Multistart, NelderMead, RunOptions};
use fmi::worker::{Isolation, WorkerLimits};
use fmi::{Fmu, Reuse, SimulateOptions};
use std::sync::PoisonError;

/// A cost does not depend on previous computations, including outside of fits.
#[test]
fn hidden_state_is_detected_outside_of_fits() {
    // A run with k above 1.2 changes a static variable.
    let folder = faulty(&["SHARED_GLOBALS", "REMEMBERS=1.2"]);
    let points = [1.0, 1.5, 2.0];
    let alone: Vec<_> = points
        .iter()
        .map(|k| {
            decay(open(&folder), settings(Isolation::Process)).residuals(&[*k], &RunContext::new()).unwrap()
        })
        .collect();
    let calibration = decay(open(&folder), settings(Isolation::Process));
    for k in [0, 1, 2, 1, 0] {
        assert_eq!(calibration.residuals(&points[k..=k], &RunContext::new()).unwrap(), alone[k], "{k}");
    }
    let apart = || ModelProcess::new(&open(&folder), WorkerLimits::default()).unwrap();
    let simulated = |process: &ModelProcess, k: f64| {
        let options = SimulateOptions::new().final_time(1.0).start_value("k", k);
        process.simulate(&options, &RunContext::new()).unwrap().columns
    };
    let alone = points.map(|k| simulated(&apart(), k));
    let process = apart();
    for k in [0, 1, 2, 1, 0] {
        assert_eq!(simulated(&process, points[k]), alone[k], "{k}");
    }
}

/// Runs with k above 2.2 change a static variable, but short runs near the start do not. With each method,
/// the result equals the result of a model without hidden state, and a finding reports the state.
#[test]
fn fit_is_correct_when_the_model_has_hidden_state() {
    let (sound, folder) = (faulty(&[]), faulty(&["SHARED_GLOBALS", "REMEMBERS=2.2"]));
    let methods: [AnyMethod; 4] = [
        DifferentialEvolution::default().into(),
        NelderMead::default().into(),
        // The cost has a minimum at the limit above which the model remembers. Rounds may end there.
        LeastSquares::default().serial().into(),
        Multistart::default().into(),
    ];
    for method in methods {
        for start in [1.0, 4.0] {
            let fitted = |fmu: Fmu| {
                let run = RunOptions {
                    method: method.clone(),
                    limits: Limits { max_evaluations: Some(80), ..Limits::default() },
                    // The same process still exists when the fit compares its best point.
                    workers: Some(2),
                    seed: Some(5),
                    ..FitOptions::default_run()
                };
                let options = FitOptions { start: Some(vec![start]), uncertainty: None, ..run.into() };
                decay(fmu, settings(Isolation::Process)).fit(options).unwrap()
            };
            let fmu = open(&folder);
            let found = fitted(fmu.clone());
            let name = &*found.report.method;
            let reports_hidden_state =
                |fit: &Fit| fit.findings().iter().any(|finding| finding.sentence.contains(HIDDEN));
            // From a start of 1, a method may never reach such values.
            assert!(start < 2.2 || reports_hidden_state(&found), "{name} {start}: {:?}", found.findings());
            // The processes of another calibration of the same model give the same result.
            let again = fitted(fmu.clone());
            assert_eq!((&again.x, again.cost), (&found.x, found.cost), "{name} {start}");
            assert!(start < 2.2 || reports_hidden_state(&again), "{name} {start}");
            let alone = decay(open(&folder), settings(Isolation::Process));
            assert_eq!(alone.cost(&found.x, &RunContext::new()).unwrap(), found.cost, "{name} {start}");
            let expected = fitted(open(&sound));
            assert!(!reports_hidden_state(&expected), "{name} {start}");
            assert!((found.x[0] - 1.7).abs() < 0.05, "{name} {start}: {:?}", found.x);
        }
    }
}

const HIDDEN: &str = "the model keeps state outside of its instances";

/// A calibration is unaffected by runs of another calibration of the same opened model.
#[test]
fn calibrations_use_separate_processes() {
    let folder = faulty(&["SHARED_GLOBALS", "REMEMBERS=1.2"]);
    let fmu = open(&folder);
    let apart = || decay(fmu.clone(), settings(Isolation::Process));
    let (one, context) = (apart(), RunContext::new());
    let expected = one.residuals(&[1.0], &context).unwrap();
    let other = apart();
    other.residuals(&[2.0], &context).unwrap();
    assert_eq!(apart().residuals(&[1.0], &context).unwrap(), expected);
    assert_eq!(one.residuals(&[1.0], &context).unwrap(), expected);
    drop((one, other));
    assert_eq!(apart().residuals(&[1.0], &context).unwrap(), expected);
}

/// Hidden state that appears after many simulations is detected soon after that.
#[test]
fn late_hidden_state_is_detected_outside_of_fits() {
    let folder = faulty(&["SHARED_GLOBALS", "REMEMBERS=2.2"]);
    let (calibration, context) = (decay(open(&folder), settings(Isolation::Process)), RunContext::new());
    let expected = calibration.residuals(&[1.0], &context).unwrap();
    for k in [1.1, 1.2, 1.3, 3.0] {
        calibration.residuals(&[k], &context).unwrap();
    }
    for k in [1.0, 1.0, 3.0, 1.0] {
        let residuals = calibration.residuals(&[k], &context).unwrap();
        assert!(k > 1.0 || residuals == expected);
    }
    assert_eq!(calibration.fmu().reuse(), Reuse::NewProcess);
}

/// The reset function leaves a trace of runs with k above 2.2, which a new instance does not have.
#[test]
fn fit_restarts_once_if_a_reset_leaves_traces() {
    let folder = faulty(&["REMEMBERS_IN_INSTANCE=2.2"]);
    let fmu = open(&folder);
    let run = RunOptions {
        method: NelderMead::default().into(),
        limits: Limits { max_evaluations: Some(80), ..Limits::default() },
        ..FitOptions::default_run()
    };
    let options = FitOptions { start: Some(vec![4.0]), uncertainty: None, ..run.into() };
    let fit = decay(fmu.clone(), settings(Isolation::Process)).fit(options).unwrap();
    assert!((fit.x[0] - 1.7).abs() < 0.05, "{:?}", fit.x);
    assert_eq!(fmu.reuse(), Reuse::Reinstantiate);
}

#[test]
#[ignore = "takes long"]
fn hidden_state_is_detected_in_twenty_thousand_runs() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = faulty(&["SHARED_GLOBALS", "REMEMBERS=1.2"]);
    let calibration = decay(open(&folder), settings(Isolation::Process));
    let point = |run: u32| [1.0 + 0.25 * f64::from(run % 5)];
    let expected: Vec<_> = (0..5)
        .map(|run| {
            decay(open(&folder), settings(Isolation::Process))
                .residuals(&point(run), &RunContext::new())
                .unwrap()
        })
        .collect();
    for run in 0..5 {
        calibration.cost(&point(run), &RunContext::new()).unwrap();
    }
    let before = memory_of_this_process();
    for run in 0..20_000 {
        assert_eq!(
            calibration.residuals(&point(run), &RunContext::new()).unwrap(),
            expected[run as usize % 5],
            "{run}"
        );
    }
    let grown = memory_of_this_process().saturating_sub(before);
    assert!(grown < 8 << 20, "{grown} bytes");
}
