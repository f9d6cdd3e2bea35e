//! The integration method of a calibration is found by a comparison at its start, kept, reported, stored, and can be named.

#![allow(clippy::unwrap_used, clippy::panic)]

use calibration::RunContext;
use calibration::{Calibration, CalibrationError, Data, Experiment, FitOptions, Parameter, Verdict};
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

/// Two minutes of the exhaust pipe, which is stiff, under loads that go up and down.
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
fn a_stiff_model_is_compared_once_and_the_winner_is_used_everywhere() {
    let compared = calibration(Method::Auto);
    assert_eq!(compared.known_solver(), None);
    let x = [2600.0, 9100.0];
    let cost = compared.cost(&x, &RunContext::new()).unwrap();
    let solver = compared.solver(&RunContext::new()).unwrap().clone();
    let comparison = solver.comparison.as_ref().unwrap();
    let methods: Vec<_> = comparison.entries.iter().map(|e| e.method).collect();
    // The model has six states: no comparison with BDF.
    assert_eq!((methods, solver.method), (vec![Method::Auto, Method::Radau5], Method::Radau5));
    let [auto, radau5] = &comparison.entries[..] else { panic!("{comparison:?}") };
    assert!(radau5.work.unwrap() <= 2.0 * auto.work.unwrap(), "{comparison:?}");
    assert!(matches!(auto.verdict, Verdict::Agrees(_) | Verdict::Differs(_)), "{comparison:?}");
    let fit = compared.fit(few(5)).unwrap();
    assert_eq!(fit.solver, solver);
    assert!(fit.to_string().contains(&format!("solver {}", solver.method.name())), "{fit}");
    // A cost is the same function before, in and after a fit, and with the winner named.
    assert_eq!(compared.cost(&x, &RunContext::new()).unwrap().to_bits(), cost.to_bits());
    assert_eq!(compared.cost(&fit.x, &RunContext::new()).unwrap().to_bits(), fit.cost.to_bits());
    let named = calibration(solver.method);
    assert_eq!(named.cost(&x, &RunContext::new()).unwrap().to_bits(), cost.to_bits());
    assert_eq!(named.solver(&RunContext::new()).unwrap().method, solver.method);
    let trajectory = &compared.simulate(&x, None, &RunContext::new()).unwrap()[0];
    let rows = trajectory.get("T_out").unwrap().iter().zip(exhaust().column("T_out").unwrap().to_vec());
    let sum: f64 = rows.map(|(simulated, measured)| (simulated - measured).powi(2)).sum();
    assert_eq!(sum.to_bits(), cost.to_bits());
}

#[test]
fn the_comparison_has_the_same_winner_and_numbers_again() {
    let [one, two] = [0, 1].map(|_| calibration(Method::Auto));
    assert_eq!(one.solver(&RunContext::new()).unwrap(), two.solver(&RunContext::new()).unwrap());
}

#[test]
fn a_named_method_is_used_and_nothing_is_compared() {
    for method in [Method::Radau5, Method::Bdf] {
        let named = calibration(method);
        let fit = named.fit(few(3)).unwrap();
        assert_eq!((fit.solver.method, fit.solver.comparison), (method, None));
    }
}

#[test]
fn a_model_that_is_not_stiff_keeps_auto() {
    let t = vec![0.0, 0.5, 1.0, 1.5];
    let x: Vec<f64> = t.iter().map(|t: &f64| (-2.0 * t).exp()).collect();
    let calibration = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(Experiment::new(Data::from_columns(t, [("x".to_owned(), x)]).unwrap()).output("x", "x"))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
        .build()
        .unwrap();
    let fit = calibration.fit(FitOptions::default()).unwrap();
    assert_eq!(fit.solver.method, Method::Auto);
    let comparison = fit.solver.comparison.unwrap();
    assert_eq!(comparison.entries.len(), 1);
    assert_eq!(comparison.entries[0].verdict, Verdict::NotCompared);
}

#[test]
fn a_resumed_fit_takes_the_solver_from_its_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fit");
    let with = |resume, n| {
        let mut options = few(n);
        options.run.checkpoint = Some(Checkpoint::new(&file).resume(resume));
        options
    };
    let first = calibration(Method::Auto);
    let begun = first.fit(with(Resume::Auto, 5)).unwrap();
    assert!(begun.solver.comparison.is_some());
    let second = calibration(Method::Auto);
    let resumed = second.fit(with(Resume::Require, 8)).unwrap();
    assert_eq!((resumed.solver.method, &resumed.solver.comparison), (begun.solver.method, &None));
    let whole = calibration(Method::Auto).fit(few(8)).unwrap();
    assert_eq!((&resumed.x, resumed.cost.to_bits()), (&whole.x, whole.cost.to_bits()));
    // A file of another calibration binds nobody: the difference is named, as ever.
    let third = calibration(if begun.solver.method == Method::Bdf { Method::Radau5 } else { Method::Bdf });
    let message = third.fit(with(Resume::Auto, 8)).unwrap_err().to_string();
    assert!(message.contains("solver of the simulations: auto in the file"), "{message}");
}

#[test]
fn a_fit_can_be_interrupted_in_the_comparison() {
    let slow = calibration(Method::Auto);
    let options = FitOptions { context: RunContext::new().asking(&|| true), ..few(5) };
    let ended = slow.fit(options);
    // Either the comparison was over before the first look, or nothing was found.
    match ended {
        Err(CalibrationError::Cancelled) => assert_eq!(slow.known_solver(), None),
        Err(CalibrationError::Optimiser(_)) | Ok(_) => assert!(slow.known_solver().is_some()),
        Err(other) => panic!("{other}"),
    }
    assert!(slow.fit(few(3)).is_ok());
}

#[test]
#[ignore = "a table to read"]
#[allow(clippy::print_stdout)]
fn table() {
    println!("{:?}", calibration(Method::Auto).solver(&RunContext::new()).unwrap());
    for method in [Method::Auto, Method::Bdf, Method::Radau5] {
        let fit = calibration(method).fit(few(400)).unwrap();
        let method = if method == Method::Auto { "comparison" } else { method.name() };
        println!(
            "{method}: cost {:e} at {:?} after {} evaluations",
            fit.cost, fit.x, fit.report.n_evaluations
        );
    }
}
