//! Tunable parameters driven by inputs: held between rows, changed at events or communication points.

#![allow(clippy::unwrap_used)]

use example_models::{ExampleKind, example_fmu_as};
use fmi::{FmiError, Fmu, Inputs, Session, SimulateOptions};

fn model(kind: ExampleKind) -> Fmu {
    Fmu::open(example_fmu_as("switched_input", kind).unwrap()).unwrap()
}

/// Returns options for x' = (K u - x) / 0.5 from x = 0.
fn options(times: Vec<f64>, gains: Vec<f64>) -> SimulateOptions {
    let inputs = Inputs::new().series("K", times, gains).series("u", [0.0], [1.0]);
    SimulateOptions::new()
        .times([0.0, 0.5, 1.0, 1.5, 2.0])
        .relative_tolerance(1e-10)
        .inputs(inputs)
        .outputs(["x"])
}

#[test]
fn tunable_parameter_changes_at_the_rows_of_its_table() {
    let at_one = 3.0 * (1.0 - (-2f64).exp());
    for kind in [ExampleKind::Fmi2ModelExchange, ExampleKind::Fmi2CoSimulation, ExampleKind::Fmi3] {
        let result = model(kind).simulate(&options(vec![0.0, 1.0], vec![3.0, -1.0])).unwrap();
        let after = |t: f64| -1.0 + (at_one + 1.0) * (-2.0 * (t - 1.0)).exp();
        let exact = [0.0, 3.0 * (1.0 - (-1f64).exp()), at_one, after(1.5), after(2.0)];
        for (found, exact) in result.get("x").unwrap().iter().zip(exact) {
            assert!((found - exact).abs() < 1e-8, "{kind:?}: {found}, not {exact}");
        }
    }
}

#[test]
fn tunable_parameter_is_set_before_the_initialization() {
    let fmu = model(ExampleKind::Fmi2ModelExchange);
    let driven = fmu.simulate(&options(vec![0.0], vec![1.25])).unwrap();
    let set = SimulateOptions {
        inputs: Some(Inputs::new().series("u", [0.0], [1.0])),
        ..options(vec![0.0], vec![0.0])
    };
    let set = fmu.simulate(&set.start_value("K", 1.25)).unwrap();
    assert_eq!(driven.columns, set.columns);
    // The value set before the simulation has no effect.
    let mut session = Session::new(fmu);
    session.set("K", 7.0).unwrap();
    assert_eq!(session.simulate(&options(vec![0.0], vec![1.25])).unwrap().columns, set.columns);
}

#[test]
fn inputs_reject_a_parameter_that_is_not_tunable() {
    let inputs = Inputs::new().series("T", vec![0.0, 1.0], vec![0.5, 1.0]);
    let error = model(ExampleKind::Fmi2ModelExchange)
        .simulate(&SimulateOptions::new().final_time(1.0).inputs(inputs))
        .unwrap_err();
    assert!(
        matches!(&error, FmiError::BadInput { name, problem } if name == "T" && problem.contains("variability is fixed")),
        "{error}"
    );
}
