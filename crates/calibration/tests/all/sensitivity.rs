//! Sensitivity analysis of calibrations.

use calibration::dfo::{Effects, SensitivityMethod};
use calibration::{Calibration, Data, Experiment, Parameter, RunContext, SensitivityOptions};
use example_models::example_fmu;

/// x = exp(-k t) in two experiments, with a fixed start value.
fn decay() -> Calibration {
    let experiment = |k: f64| {
        let time: Vec<f64> = (0..20).map(|row| 0.1 * f64::from(row)).collect();
        let x = time.iter().map(|t| (-k * t).exp()).collect();
        Experiment::new(Data::from_columns(time, [("x".to_owned(), x)]).unwrap()).output("x", "x")
    };
    Calibration::builder(fmi::Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(experiment(1.0))
        .experiment(experiment(2.0))
        .parameter(Parameter::new("k", 1.5).bounds(0.5, 3.0))
        .parameter(Parameter::new("x", 1.0).bounds(0.5, 1.5).fixed(true))
        .build()
        .unwrap()
}

#[test]
fn sensitivity_evaluates_cost_and_error_of_each_output_of_each_experiment() {
    let calibration = decay();
    let names = calibration.problem().experiment_names();
    let method = SensitivityMethod::Sobol { n: 16, second_order: false };
    let results = [1, 3].map(|workers| {
        let options =
            SensitivityOptions { method, seed: Some(1), workers: Some(workers), ..Default::default() };
        let found = calibration.sensitivity(&options, &RunContext::new()).unwrap();
        assert_eq!((options.progress.n_evaluated(), options.progress.n_points()), (48, 48));
        found
    });
    assert_eq!(results[0], results[1]);
    let found = &results[0];
    let outputs: Vec<&str> = found.outputs.iter().map(|output| output.name.as_str()).collect();
    let expected = [0, 1].map(|k: usize| format!("rms({}: x)", names[k]));
    assert_eq!((outputs, found.n_evaluations), (vec!["cost", &expected[0], &expected[1]], 16 * 3));
    assert_eq!(found.parameters, ["k"]);
    for (x, values) in found.points.iter().zip(&found.values) {
        let cost = calibration.cost(x, &RunContext::new()).unwrap();
        assert_eq!((values[0], x[1]), (cost, 1.0));
        let squares = 20.0 * (values[1] * values[1] + values[2] * values[2]);
        assert!((squares - cost).abs() <= 1e-13 * cost, "{squares} instead of {cost}");
    }
    // The only free parameter causes all of the variance.
    for output in &found.outputs {
        let Effects::Sobol(indices) = &output.effects else { unreachable!() };
        assert!((indices.s1[0] - 1.0).abs() < indices.s1_conf[0], "{found}");
    }
}

#[test]
fn sensitivity_requires_finite_bounds_and_names_the_parameter() {
    let time = vec![0.0, 1.0];
    let data = Data::from_columns(time, [("x".to_owned(), vec![1.0, 0.4])]).unwrap();
    let calibration = Calibration::builder(fmi::Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(Experiment::new(data).output("x", "x"))
        .parameter(Parameter::new("k", 1.0))
        .build()
        .unwrap();
    let error =
        calibration.sensitivity(&SensitivityOptions::default(), &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("finite bounds") && error.contains("'k'"), "{error}");
}
