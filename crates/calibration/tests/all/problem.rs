//! Problems with several experiments and outputs: order of the sum, order of the parameters, stored problems,
//! cancellation.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::{
    Calibration, CalibrationBuilder, CalibrationError, Data, Experiment, FitOptions, Parameter, Problem,
};
use dfo::{Answer, EvaluationKind, LeastSquares, Limits, Objective, Outcome, Query, RunOptions};
use example_models::example_fmu;
use fmi::Fmu;
use std::sync::atomic::AtomicBool;

fn open(name: &str) -> Fmu {
    Fmu::open(example_fmu(name).unwrap()).unwrap()
}

/// Two outputs of a pendulum at uneven times, twice. The sizes of the numbers make sums in another order
/// differ.
fn furuta() -> Calibration {
    let experiment = |shift: f64| {
        let time: Vec<f64> = (0..40).map(|k| 0.05 * f64::from(k) + 0.003 * f64::from(k % 3)).collect();
        let phi = time.iter().map(|t| (3.0 * t + shift).sin()).collect();
        let theta = time.iter().map(|t| if *t < 0.7 { f64::NAN } else { 0.01 * (5.0 * t).cos() }).collect();
        let data = [("phi", phi), ("theta", theta)].map(|(name, values)| (name.to_owned(), values));
        Experiment::new(Data::from_columns(time, data).unwrap())
            .output("armJoint.phi", "phi")
            .weighted_output("pendulumJoint.phi", "theta", 0.3)
    };
    Calibration::builder(open("furuta"))
        .experiment(experiment(0.0))
        .experiment(experiment(0.4))
        .parameter(Parameter::new("armFriction", 0.012).bounds(0.0, 0.022))
        .parameter(Parameter::new("pendulumFriction", 0.002).bounds(0.0, 0.012))
        .build()
        .unwrap()
}

/// x' = -k x from two starts, with separate rates.
fn decays() -> CalibrationBuilder {
    let time: Vec<f64> = (0..11).map(|i| 0.1 * f64::from(i)).collect();
    let recording = |x0: f64, k: f64| {
        let x = time.iter().map(|t| x0 * (-k * t).exp()).collect();
        Experiment::new(Data::from_columns(time.clone(), [("x".to_owned(), x)]).unwrap()).output("x", "x")
    };
    Calibration::builder(open("dahlquist"))
        .experiment(recording(1.0, 2.0).named("slow").start_value("k", 1.5))
        .experiment(recording(3.0, 4.0))
        .parameter(Parameter::new("k", 3.0).bounds(0.1, 10.0).local(true))
        .parameter(Parameter::new("x", 1.0).bounds(0.1, 10.0).local(true))
}

fn sum(residuals: &[f64]) -> f64 {
    residuals.iter().fold(0.0, |sum, r| sum + r * r)
}

#[test]
fn cost_is_bitwise_identical_on_every_path() {
    let calibration = furuta();
    let x = [0.0113, 0.0021];
    let residuals = calibration.residuals(&x, &RunContext::new()).unwrap();
    let cost = calibration.cost(&x, &RunContext::new()).unwrap();
    assert_eq!(cost.to_bits(), sum(&residuals).to_bits());
    assert_ne!(cost.to_bits(), sum(&residuals.iter().rev().copied().collect::<Vec<_>>()).to_bits());

    let ask = |kind, cutoff| {
        let mut answer = Answer::default();
        calibration.evaluate(&x, &Query::new(0, 0, cutoff).kind(kind), &mut answer);
        answer
    };
    for (kind, cutoff) in [
        (EvaluationKind::Cost, f64::INFINITY),
        (EvaluationKind::Cost, cost),
        (EvaluationKind::Residuals, f64::INFINITY),
    ] {
        let answer = ask(kind, cutoff);
        assert_eq!(answer.outcome, Outcome::Value(cost));
        let expected = if kind == EvaluationKind::Residuals { &residuals[..] } else { &[] };
        assert_eq!(answer.residuals, expected);
    }
    // Only a cost strictly above the cutoff is rejected, however small the difference.
    let below = f64::from_bits(cost.to_bits() - 1);
    assert_eq!(ask(EvaluationKind::Cost, below).outcome, Outcome::Above(below));

    let mut found = Vec::new();
    for (workers, cutoffs) in [(1, true), (1, false), (3, true)] {
        let limits = Limits { max_evaluations: Some(40), ..Limits::default() };
        let method = LeastSquares::default().serial().into();
        let run = RunOptions { method, limits, workers: Some(workers), ..FitOptions::default_run() };
        let fit = calibration.fit(FitOptions { cutoffs, ..run.into() }).unwrap();
        assert_eq!(fit.cost.to_bits(), calibration.cost(&fit.x, &RunContext::new()).unwrap().to_bits());
        assert_eq!(
            fit.cost.to_bits(),
            sum(&calibration.residuals(&fit.x, &RunContext::new()).unwrap()).to_bits()
        );
        for entry in fit.report.trace.iter() {
            if let Outcome::Value(cost) = entry.outcome {
                assert_eq!(cost.to_bits(), calibration.cost(entry.x, &RunContext::new()).unwrap().to_bits());
            }
        }
        found.push((fit.x, fit.cost));
    }
    assert!(found.iter().all(|one| *one == found[0]));
}

#[test]
fn local_parameters_occur_once_per_experiment_in_order() {
    let calibration = decays().build().unwrap();
    let names: Vec<&str> = calibration.parameters().iter().map(Parameter::name).collect();
    assert_eq!(names, ["k[slow]", "k[run2]", "x[slow]", "x[run2]"]);
    assert_eq!(calibration.start(), [1.5, 3.0, 1.0, 1.0]);
    assert!(calibration.cost(&[2.0, 4.0, 1.0, 3.0], &RunContext::new()).unwrap() < 1e-8);
    // The second experiment does not depend on the first entry.
    let residuals = |x: [f64; 4]| calibration.residuals(&x, &RunContext::new()).unwrap();
    let (one, other) = (residuals([2.0, 4.0, 1.0, 3.0]), residuals([1.0, 4.0, 1.0, 3.0]));
    assert!(one[1..11] != other[1..11] && one[11..] == other[11..]);
    let rows = calibration.simulate(&[2.0, 4.0, 1.0, 3.0], None, &RunContext::new()).unwrap();
    assert!((rows[1].columns[0][10] - 3.0 * (-4.0f64).exp()).abs() < 1e-4);

    let fit = calibration.fit(FitOptions::default()).unwrap();
    for (found, expected) in fit.x.iter().zip([2.0, 4.0, 1.0, 3.0]) {
        assert!((found - expected).abs() < 1e-2 * expected, "{fit}");
    }
    assert_eq!(fit.names, names);

    let shared = Parameter::new("lambda", 1.0).local(true);
    let e = decays().parameter(shared).build().unwrap_err().to_string();
    assert!(e.contains("lambda"), "{e}");
}

#[test]
fn problem_rejects_duplicate_experiment_and_parameter_names() {
    let twice = decays().experiment(
        Experiment::new(Data::from_columns(vec![0.0], [("x".to_owned(), vec![1.0])]).unwrap())
            .output("x", "x")
            .named("slow"),
    );
    let e = twice.build().unwrap_err().to_string();
    assert_eq!(e, "two experiments are named 'slow'");
    let outside = decays().parameter(Parameter::new("k", 1.0)).build().unwrap_err().to_string();
    assert!(outside.contains("'k': is given twice"), "{outside}");
}

#[test]
fn problem_round_trips_through_a_file() {
    let calibration = decays().build().unwrap();
    let mut bytes = Vec::new();
    ciborium::into_writer(calibration.problem(), &mut bytes).unwrap();
    let problem: Problem = ciborium::from_reader(&bytes[..]).unwrap();
    assert_eq!(&problem, calibration.problem());
    let again = Calibration::from_problem(open("dahlquist"), problem.clone()).unwrap();
    let x = [2.1, 3.9, 1.0, 3.1];
    assert_eq!(
        again.cost(&x, &RunContext::new()).unwrap().to_bits(),
        calibration.cost(&x, &RunContext::new()).unwrap().to_bits()
    );

    let other = open("van_der_pol");
    let found = other.content_hash().unwrap().to_owned();
    let e = Calibration::from_problem(other, problem).unwrap_err().to_string();
    assert!(e.contains(&calibration.problem().model.content_hash) && e.contains(&found), "{e}");
}

#[test]
fn fit_can_be_cancelled_before_its_first_evaluation() {
    let calibration = furuta();
    let flag = AtomicBool::new(true);
    for context in [RunContext::new().flagged(&flag), RunContext::new().polling(&|| true)] {
        let options = FitOptions { context, ..FitOptions::default() };
        assert!(matches!(calibration.fit(options), Err(CalibrationError::Cancelled)));
    }
}

#[test]
fn residual_layout_describes_each_residual() {
    let nan = f64::NAN;
    let columns = [("x".to_owned(), vec![1.0, nan, 0.5, 0.2]), ("z".to_owned(), vec![nan, 0.7, nan, 0.1])];
    let data = Data::from_columns(vec![0.0, 0.5, 1.0, 1.5], columns).unwrap();
    let one = Experiment::new(data.clone()).output("x", "x").weighted_output("der(x)", "z", 2.0);
    let calibration = Calibration::builder(open("dahlquist"))
        .experiment(one)
        .experiment(Experiment::new(data).output("x", "z").window(1.0, 2.0))
        .parameter(Parameter::new("k", 1.0))
        .build()
        .unwrap();
    let layout = calibration.residual_layout();
    let rows: Vec<_> = (layout.outputs.iter())
        .map(|o| (o.experiment, o.output, o.variable.as_str(), o.column.as_str(), o.range.clone()))
        .collect();
    assert_eq!(rows, [(0, 0, "x", "x", 0..3), (0, 1, "der(x)", "z", 3..5), (1, 0, "x", "z", 5..6)]);
    assert_eq!(layout.outputs[1].times[..], [0.5, 1.5]);
    assert_eq!(layout.outputs[1].measured[..], [0.7, 0.1]);
    assert_eq!(layout.outputs[1].weights[..], [2.0, 2.0]);
    assert_eq!(layout.n_residuals(), calibration.n_residuals());
    // Together with a simulation, they reproduce the residuals.
    let (residuals, trajectories) = (
        calibration.residuals(&[1.3], &RunContext::new()).unwrap(),
        calibration.simulate(&[1.3], None, &RunContext::new()).unwrap(),
    );
    for o in &layout.outputs {
        let trajectory = &trajectories[o.experiment];
        for (i, t) in o.times.iter().enumerate() {
            let row = trajectory.time.iter().position(|s| s == t).unwrap();
            let difference = trajectory.columns[o.output][row] - o.measured[i];
            assert_eq!(residuals[o.range.start + i], o.weights[i] * difference);
        }
    }
}

/// The message contains the variable of the NaN state, as declared in the model description.
#[test]
fn nan_state_is_reported_with_its_time() {
    let reported = |value: &str| {
        let folder = crate::support::faulty(&[&format!("STATE_VALUE={value}")]);
        let data = Data::from_columns(vec![0.0, 0.5, 1.0], [("x".to_owned(), vec![1.0, 0.4, 0.2])]).unwrap();
        let calibration = Calibration::builder(Fmu::open(folder.path()).unwrap())
            .experiment(Experiment::new(data).output("x", "x"))
            .parameter(Parameter::new("k", 1.0).bounds(0.1, 5.0))
            .build()
            .unwrap();
        calibration.cost(&[1.0], &RunContext::new()).unwrap_err().to_string()
    };
    let from_start = reported("NAN");
    assert!(from_start.contains("the residual of 'x' is not finite at t = 0"), "{from_start}");
    let later = reported("m->time>0.6?NAN:m->x");
    assert!(later.contains("at t = 1: x is NaN"), "{later}");
}

/// A record of plain data, written as JSON.
fn record(json: &str) -> dfo::Record {
    match serde_json::from_str::<serde_json::Value>(json).unwrap().into() {
        dfo::Value::Record(record) => record,
        other => panic!("{other}"),
    }
}

#[test]
fn experiment_from_record_equals_experiment_from_methods() {
    let folder = tempfile::tempdir().unwrap();
    let rows: String =
        (0..5).map(|i| format!("{i},{},{},{},1\n", 2 * i, i * i, if i < 4 { 1 } else { 0 })).collect();
    std::fs::write(folder.path().join("run.csv"), format!("t,a,b,valid,u\n{rows}")).unwrap();
    let requested = |json: &str| Experiment::from_record(&record(json), folder.path(), &RunContext::new());
    let given = requested(
        r#"{"name": "cold", "data": "run.csv", "time": "t", "outputs": [["y", "b"], ["x", "a"]], "weights": {"x": 2},
            "inputs": {"u": "u", "v": 3, "w": {"column": "u", "hold": true}}, "start_values": {"n": 3, "on": true}, "windows": [[0, 1], [2, 4]], "warm_up": 0.5,
            "initial_states": {"p": "measured", "q": 1, "r": {"start": 1, "lower": 0, "upper": 2}},
            "mask": "valid", "delays": {"x": 0.1}, "hold_inputs": true}"#,
    )
    .unwrap();
    let columns = ["a", "b", "valid", "u"].map(str::to_owned);
    let request = calibration::CsvRequest { time: Some("t"), columns: Some(&columns), ..Default::default() };
    let data = Data::read_csv(folder.path().join("run.csv"), request).unwrap();
    let expected = Experiment::new(data.masked_by(&["b", "a"], "valid").unwrap())
        .named("cold")
        .output("y", "b")
        .weighted_output("x", "a", 2.0)
        .input("u", "u")
        .constant_input("v", 3.0)
        .held_input("w", "u")
        .start_value("n", 3u8)
        .start_value("on", true)
        .initial_state("p", calibration::InitialState::Measured)
        .initial_state("q", 1.0)
        .initial_state("r", Parameter::new("r", 1.0).bounds(0.0, 2.0))
        .windows([(0.0, 1.0), (2.0, 4.0)])
        .warm_up(0.5)
        .delay("x", 0.1)
        .hold_inputs(true);
    assert_eq!(format!("{given:?}"), format!("{expected:?}"));
    let message = |json: &str| requested(json).unwrap_err().to_string();
    for (json, expected) in [
        (r#"{"outputs": ["a"]}"#, "data is missing"),
        (
            r#"{"data": "run.csv", "output": {"x": "a"}}"#,
            "unknown field of an experiment 'output'; did you mean 'outputs'?",
        ),
        (r#"{"data": "none.csv", "time": "t"}"#, "cannot read"),
        (r#"{"data": "run.csv", "time": "t", "outputs": 3}"#, "outputs must assign a value to each name"),
        (r#"{"data": "run.csv", "outputs": {"x": 3}}"#, "outputs: 'x' must be a string, not 3"),
        (
            r#"{"data": "run.csv", "outputs": ["x"], "weights": {"xx": 3}}"#,
            "unknown output for the weight 'xx'; expected one of: x",
        ),
        (r#"{"data": "run.csv", "outputs": ["x"], "weights": "rnge"}"#, "'range'"),
        (r#"{"data": "run.csv", "inputs": {"u": [1]}}"#, "must be the name of a column, { column = "),
        (
            r#"{"data": "run.csv", "inputs": {"u": {"hodl": true}}}"#,
            "unknown field of an input 'hodl'; expected one of: column, hold",
        ),
        (
            r#"{"data": "run.csv", "time": "t", "initial_states": {"x": "recorded"}}"#,
            "a number, 'measured', 'measured:' and the name of an output, or a parameter",
        ),
        (
            r#"{"data": "run.csv", "time": "t", "initial_states": {"x": {"strat": 1}}}"#,
            "did you mean 'start'?",
        ),
    ] {
        assert!(message(json).contains(expected), "{}", message(json));
    }
}
