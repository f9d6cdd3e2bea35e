//! FMUs in processes of their own: same bits, deaths as outcomes, nothing left behind.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

mod support;

use calibration::{Calibration, Data, Experiment, FitOptions, Parameter, SimulationSettings};
use dfo::{Limits, RunOptions};
use fmi::Fmu;
use fmi::worker::{Isolation, Launcher};
use std::path::PathBuf;
use std::time::{Duration, Instant};
use support::{costs, faulty, fit};

/// Has workers started by the program for that.
fn launch() {
    Launcher { program: PathBuf::from(env!("CARGO_BIN_EXE_fmufit-worker")), arguments: Vec::new() }.set();
}

fn settings(isolation: Isolation) -> SimulationSettings {
    SimulationSettings { isolation, ..SimulationSettings::default() }
}

/// y = exp(-1.7 t), which the model follows at k = 1.7.
fn decay(fmu: Fmu, settings: SimulationSettings) -> Calibration {
    launch();
    let t: Vec<f64> = (0..=20).map(|i| 0.05 * f64::from(i)).collect();
    let y = t.iter().map(|t: &f64| (-1.7 * t).exp()).collect();
    let calibration = Calibration::builder(fmu)
        .experiment(Experiment::new(Data::from_columns(t, [("y".to_owned(), y)]).unwrap()).output("y", "y"))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 5.0))
        .settings(settings)
        .build()
        .unwrap();
    assert_eq!(calibration.isolation().1, None);
    calibration
}

fn open(folder: &tempfile::TempDir) -> Fmu {
    Fmu::open(folder.path()).unwrap()
}

#[test]
fn the_bits_are_the_same_in_this_process_and_in_others() {
    let folder = faulty(&[]);
    let alone = decay(open(&folder), settings(Isolation::None));
    let expected = fit(&alone, 1, 100);
    for workers in [1, 2, 7] {
        let apart = decay(open(&folder), settings(Isolation::Process));
        let found = fit(&apart, workers, 100);
        assert_eq!(costs(&found), costs(&expected), "{workers}");
        assert_eq!(found.worth, expected.worth);
        assert_eq!(apart.residuals(&[2.0]).unwrap(), alone.residuals(&[2.0]).unwrap());
        let (one, other) = (apart.simulate(&[2.0], None).unwrap(), alone.simulate(&[2.0], None).unwrap());
        assert_eq!(one, other);
        let variables = ["x".to_owned(), "der(x)".to_owned()];
        let recorded = |calibration: &Calibration| {
            calibration.simulate_variables_until(0, &[2.0], Some(&[0.0, 0.5]), &variables, &|| false)
        };
        assert_eq!(recorded(&apart).unwrap(), recorded(&alone).unwrap());
        assert_eq!(apart.solver().unwrap(), alone.solver().unwrap());
    }
}

/// What happens, from k = 2.2 on, and what is said of it.
const DEATHS: [(&str, &str); 5] = [
    ("raise(SIGSEGV)", "segmentation fault in fmi2GetDerivatives"),
    ("abort()", "abort in fmi2GetDerivatives"),
    ("exit(3)", "the process was ended with exit(3) in fmi2GetDerivatives"),
    ("overflow(m->time)", "in fmi2GetDerivatives"),
    ("close_all()", "in fmi2GetDerivatives"),
];

#[test]
fn a_death_costs_one_evaluation() {
    for (fault, said) in DEATHS {
        let folder = faulty(&["FAULT_ABOVE=2.2", &format!("FAULT={fault}")]);
        let calibration = decay(open(&folder), settings(Isolation::Process));
        let found = fit(&calibration, 2, 60);
        assert!((found.x[0] - 1.7).abs() < 1e-2, "{fault}: {:?}", found.x);
        let failed: Vec<_> = found.report.failures.iter().map(|(message, _)| message.as_str()).collect();
        assert!(failed.iter().all(|message| message.contains(said)) && !failed.is_empty(), "{fault}: {failed:?}");
        let error = calibration.cost(&[3.0]).unwrap_err().to_string();
        assert!(error.contains(said) && error.contains("k = 3"), "{error}");
    }
}

#[test]
fn a_hang_is_ended_soon_after_its_limit() {
    let folder = faulty(&["FAULT_ABOVE=2.2", "FAULT=hang()"]);
    let timeout = Some(Duration::from_millis(300));
    let calibration =
        decay(open(&folder), SimulationSettings { timeout, ..settings(Isolation::Process) });
    assert!(calibration.cost(&[1.0]).is_ok());
    let error = calibration.cost(&[3.0]).unwrap_err().to_string();
    assert!(error.contains("no answer within the time limit in fmi2GetDerivatives"), "{error}");
    // Without a limit it is ended with what it is part of.
    let calibration = decay(open(&folder), settings(Isolation::Process));
    let limits = Limits { max_time: Some(Duration::from_secs(2)), ..Limits::default() };
    let run = RunOptions { limits, workers: Some(1), ..FitOptions::default_run() };
    let found = calibration.fit(FitOptions { start: Some(vec![2.0]), ..run.into() });
    assert!(found.is_ok(), "{:?}", found.err());
    let began = Instant::now();
    let cancelled = || began.elapsed() > Duration::from_millis(200);
    assert!(calibration.cost_until(&[3.0], &cancelled).is_err());
}

/// Processes and folders of this test program.
fn remains() -> Vec<String> {
    let this = std::process::id().to_string();
    let is_worker = |pid: &str| {
        let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
        status.lines().any(|line| line.strip_prefix("PPid:").is_some_and(|parent| parent.trim() == this))
    };
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    processes.filter_map(|entry| entry.file_name().into_string().ok()).filter(|pid| is_worker(pid)).collect()
}

#[test]
fn nothing_is_left_of_the_processes() {
    let folder = faulty(&[]);
    let calibration = decay(open(&folder), settings(Isolation::Process));
    calibration.cost(&[1.0]).unwrap();
    assert!(!remains().is_empty());
    drop(calibration);
    // Those of other tests end with them.
}

#[test]
fn a_leak_does_not_grow_for_ever() {
    let folder = faulty(&["LEAKS=(64 << 20)"]);
    let calibration = decay(open(&folder), settings(Isolation::Process));
    let found = fit(&calibration, 1, 60);
    assert!((found.x[0] - 1.7).abs() < 0.1, "{:?}", found.x);
}
