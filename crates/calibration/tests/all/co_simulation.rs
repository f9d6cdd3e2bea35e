//! A model that integrates itself is calibrated like any other.

#![allow(clippy::unwrap_used)]

use calibration::{Calibration, Data, Experiment, FitOptions, Parameter};
use example_models::{ExampleKind, example_fmu_as};
use fmi::Fmu;

#[test]
fn a_decay_is_fitted_in_every_version() {
    // x' = -k x, recorded at four instants of a decay with k = 2
    let t = vec![0.0, 0.513, 1.0, 1.5];
    let x: Vec<f64> = t.iter().map(|t: &f64| (-2.0 * t).exp()).collect();
    for kind in ExampleKind::ALL {
        let fmu = Fmu::open(example_fmu_as("dahlquist", kind).unwrap()).unwrap();
        let data = Data::from_columns(t.clone(), [("x".to_owned(), x.clone())]).unwrap();
        let calibration = Calibration::builder(fmu)
            .experiment(Experiment::new(data).output("x", "x"))
            .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
            .build()
            .unwrap();
        let fit = calibration.fit(FitOptions::default()).unwrap();
        assert!((fit.x[0] - 2.0).abs() < 1e-3, "{kind:?}: {:?}", fit.x);
    }
}
