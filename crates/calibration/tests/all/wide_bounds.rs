//! Fits with bounds from just above the best value to extremely wide.
#![allow(clippy::unwrap_used, clippy::panic)]

use calibration::{Calibration, Data, Experiment, Fit, FitOptions, Parameter, Scale};
use dfo::{AnyMethod, LeastSquares, NelderMead, RunOptions};
use example_models::example_fmu;
use fmi::Fmu;

fn fit(parameters: impl IntoIterator<Item = Parameter>, method: AnyMethod) -> Fit {
    let t: Vec<f64> = (0..51).map(|i| 0.1 * f64::from(i)).collect();
    let x = t.iter().map(|t| 1.5 * (-2.0 * t).exp()).collect();
    let mut builder = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(Experiment::new(Data::from_columns(t, [("x".to_owned(), x)]).unwrap()).output("x", "x"));
    for parameter in parameters {
        builder = builder.parameter(parameter);
    }
    let run = RunOptions { method, workers: Some(1), ..FitOptions::default_run() };
    builder.build().unwrap().fit(run).unwrap()
}

#[test]
fn result_is_independent_of_bound_width() {
    for method in [AnyMethod::from(NelderMead::default()), LeastSquares::default().into()] {
        for upper in [2.002, 2.1, 10.0, 99.0, 1e3, 1e5, 1e7, 1e9, 1e12] {
            let initial = Parameter::new("x", 1.0).bounds(0.0, 3.0);
            for k in [
                Parameter::new("k", 1.0).bounds(0.0, upper),
                Parameter::new("k", 0.0).bounds(0.0, upper),
                Parameter::new("k", 0.0).bounds(0.0, upper).nominal(1.0),
                Parameter::new("k", 1.0).bounds(1.0 / upper, upper).scale(Scale::Log),
            ] {
                let found = fit([k.clone(), initial.clone()], method.clone());
                let is_right = (found.x[0] - 2.0).abs() < 4e-3 && (found.x[1] - 1.5).abs() < 4e-3;
                assert!(is_right && found.report.is_success(), "{upper:e} {k:?}: {found}");
                assert!(found.at_bound.is_empty() && found.without_effect.is_empty(), "{upper:e}: {found}");
                let errors = &found.uncertainty.as_ref().unwrap().standard_errors;
                assert!(errors.iter().all(|e| *e > 0.0 && *e < 0.01), "{upper:e} {k:?}: {errors:?}");
            }
        }
    }
}

#[test]
fn parameter_at_bound_is_detected_for_every_bound_width() {
    for upper in [5.0, 1e7] {
        // The best value is 1.5.
        let below = fit(
            [Parameter::new("k", 2.0).bounds(2.0, 2.0), Parameter::new("x", 3.0).bounds(2.5, upper)],
            LeastSquares::default().into(),
        );
        assert_eq!(below.at_bound.len(), 1, "{below}");
    }
}
