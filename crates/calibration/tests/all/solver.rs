//! The integration method of a calibration is the same inside and outside fits. It is reported, stored, and
//! can be chosen.

#![allow(clippy::unwrap_used, clippy::panic)]

use calibration::RunContext;
use calibration::{Calibration, Data, Experiment, FitOptions, Parameter};
use dfo::{Checkpoint, Limits, Resume, RunOptions};
use example_models::example_fmu;
use fmi::RunSettings;
use fmi::{Fmu, Inputs, SimulateOptions};
use ode::Method;

const TRUE: [(&str, f64); 2] = [("C1", 2500.0), ("C2", 9000.0)];
const INPUTS: [(&str, f64, f64); 5] = [
    ("T_in", 450.0, 450.0),
    ("p_in", 1.1e5, 1.2e5),
    ("w_turb1", 2000.0, 4000.0),
    ("w_turb2", 1500.0, 3500.0),
    ("p_out", 1.013e5, 0.0),
];

/// Two minutes of the exhaust pipe, a stiff model, with rising and falling loads.
fn exhaust() -> Data {
    let time: Vec<f64> = (0..=120).map(f64::from).collect();
    let load = |t: f64| 0.5 - 0.4 * (0.05 * t).cos();
    let column = |from: f64, by: f64| time.iter().map(|t| from + by * load(*t)).collect::<Vec<f64>>();
    let mut inputs = Inputs::new();
    let mut columns = Vec::new();
    for (name, from, by) in INPUTS {
        inputs = inputs.series(name, time.clone(), column(from, by));
        columns.push((name.to_owned(), column(from, by)));
    }
    let fmu = Fmu::open(example_fmu("exhaust").unwrap()).unwrap();
    let options = SimulateOptions::new().relative_tolerance(1e-9);
    let truth = fmu.simulate(&options.times(time.clone()).inputs(inputs).outputs(["T_out"])).unwrap();
    columns.push(("T_out".to_owned(), truth.get("T_out").unwrap().to_vec()));
    Data::from_columns(time, columns).unwrap()
}

fn calibration(method: Method) -> Calibration {
    let mut experiment = Experiment::new(exhaust()).output("T_out", "T_out");
    for (name, ..) in INPUTS {
        experiment = experiment.input(name, name);
    }
    let mut builder = Calibration::builder(Fmu::open(example_fmu("exhaust").unwrap()).unwrap())
        .settings(RunSettings { method, ..RunSettings::default() })
        .experiment(experiment);
    for (name, value) in TRUE {
        builder = builder.parameter(Parameter::new(name, 1.5 * value).bounds(0.1 * value, 10.0 * value));
    }
    builder.build().unwrap()
}

fn few(n: usize) -> FitOptions<'static> {
    let limits = Limits { max_evaluations: Some(n), ..Limits::default() };
    RunOptions { limits, ..FitOptions::default_run() }.into()
}

#[test]
fn cost_is_the_same_inside_and_outside_a_fit() {
    let auto = calibration(Method::Auto);
    let x = [2600.0, 9100.0];
    let cost = auto.cost(&x, &RunContext::new()).unwrap();
    let fit = auto.fit(few(5)).unwrap();
    assert_eq!((fit.solver, auto.solver()), (Method::Auto, Method::Auto));
    assert!(fit.to_string().contains("solver auto"), "{fit}");
    assert_eq!(auto.cost(&x, &RunContext::new()).unwrap().to_bits(), cost.to_bits());
    assert_eq!(auto.cost(&fit.x, &RunContext::new()).unwrap().to_bits(), fit.cost.to_bits());
    let trajectory = &auto.simulate(&x, None, &RunContext::new()).unwrap()[0];
    let rows = trajectory.get("T_out").unwrap().iter().zip(exhaust().column("T_out").unwrap().to_vec());
    let sum: f64 = rows.map(|(simulated, measured)| (simulated - measured).powi(2)).sum();
    assert_eq!(sum.to_bits(), cost.to_bits());
}

#[test]
fn requested_solver_is_used() {
    for method in [Method::Radau5, Method::Bdf] {
        assert_eq!(calibration(method).fit(few(3)).unwrap().solver, method);
    }
}

#[test]
fn checkpoint_of_another_solver_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fit");
    let with = |resume, n| {
        let mut options = few(n);
        options.run.checkpoint = Some(Checkpoint::new(&file).resume(resume));
        options
    };
    calibration(Method::Auto).fit(with(Resume::Auto, 5)).unwrap();
    let resumed = calibration(Method::Auto).fit(with(Resume::Require, 8)).unwrap();
    let whole = calibration(Method::Auto).fit(few(8)).unwrap();
    assert_eq!((&resumed.x, resumed.cost.to_bits()), (&whole.x, whole.cost.to_bits()));
    let message = calibration(Method::Bdf).fit(with(Resume::Auto, 8)).unwrap_err().to_string();
    assert!(message.contains("solver of the simulations: auto in the file"), "{message}");
}
