//! The Furuta pendulum compared with reference trajectories and event sequences.

#![allow(clippy::unwrap_used)]

use crate::common;

use common::*;
use fmufit::calibration::Data;
use fmufit::fmi::SimulateOptions;
use fmufit::ode::Method;

fn options(friction: (f64, f64)) -> SimulateOptions {
    SimulateOptions {
        start_values: vec![
            ("armFriction".to_owned(), friction.0.into()),
            ("pendulumFriction".to_owned(), friction.1.into()),
        ],
        outputs: Some(vec!["armJoint.phi".to_owned(), "pendulumJoint.phi".to_owned()]),
        final_time: Some(40.0),
        ..SimulateOptions::new().relative_tolerance(1e-8)
    }
}

#[test]
fn trajectories_match_reference_to_1e_6() {
    let fmu = example("furuta");
    for (file, friction) in
        [("furuta_reference_nominal.csv", (0.012, 0.002)), ("furuta_reference_optimal.csv", (0.010, 0.001))]
    {
        let times: Vec<f64> = (0..=400).map(|k| 0.1 * f64::from(k)).collect();
        // Without the data, the reference is an implicit method of another family. Its tolerance is a thousand
        // times tighter.
        let reference = shared_data(file).map(|path| Data::from_csv(path).unwrap());
        let options_without_reference = SimulateOptions {
            times: Some(times.clone()),
            ..options(friction).method(Method::Radau5).relative_tolerance(1e-11)
        };
        let simulated_reference =
            reference.is_none().then(|| fmu.simulate(&options_without_reference).unwrap());
        reference.is_none().then(|| fmu.simulate(&options_without_reference).unwrap());
        let times = reference.as_ref().map_or(times, |reference| reference.time().to_vec());
        let result = fmu.simulate(&SimulateOptions { times: Some(times), ..options(friction) }).unwrap();
        for name in ["armJoint.phi", "pendulumJoint.phi"] {
            let published = reference.as_ref().map(|reference| reference.column(name).unwrap());
            let computed = simulated_reference
                .as_ref()
                .map(|simulated_reference| simulated_reference.get(name).unwrap());
            let (simulated, expected) = (result.get(name).unwrap(), published.or(computed).unwrap());
            assert_eq!(simulated.len(), 401);
            let worst = simulated.iter().zip(expected).map(|(s, e)| (s - e).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-6, "{name} of {file}: off by {worst:e}");
        }
    }
}

#[test]
fn rest_positions_and_event_counts_match_reference() {
    let fmu = example("furuta");
    // Values at t = 40 and event counts of the original model.
    for (friction, phi, theta, events) in
        [((0.012, 0.002), -0.301_083_5, 3.142_224_8, 49), ((0.010, 0.001), -0.314_328_3, 3.131_115_9, 74)]
    {
        let result = fmu.simulate(&SimulateOptions { times: Some(vec![40.0]), ..options(friction) }).unwrap();
        assert!((result.final_value("armJoint.phi").unwrap().unwrap() - phi).abs() < 1e-6);
        assert!((result.final_value("pendulumJoint.phi").unwrap().unwrap() - theta).abs() < 1e-6);
        assert_eq!(result.stats.state_events, events, "{friction:?}");
        let expected_first = if friction.0 > 0.011 { 0.418_602 } else { 0.205_273 };
        assert!((result.events[0].time - expected_first).abs() < 1e-6, "{}", result.events[0].time);
    }
}

#[test]
fn pendulum_keeps_swinging_without_friction() {
    let fmu = example("furuta");
    let result = fmu.simulate(&SimulateOptions { ncp: Some(400), ..options((0.0, 0.0)) }).unwrap();
    assert_eq!(result.time.len(), 401);
    let theta = result.get("pendulumJoint.phi").unwrap();
    let late = &theta[300..];
    let swing = late.iter().fold(f64::MIN, |a, b| a.max(*b)) - late.iter().fold(f64::MAX, |a, b| a.min(*b));
    assert!(swing > 1.0, "{swing}");
}
