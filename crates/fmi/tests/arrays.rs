//! FMI 3.0 beyond single values: arrays, structural parameters, all types.

#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::{FmiError, Fmu, Inputs, Kind, Session, SimulateOptions, SimulationPlan, Simulator, Value};
use std::sync::Arc;
use support::arrays;

fn close(a: f64, b: f64) {
    assert!((a - b).abs() <= 1e-8, "{a} is not {b}");
}

#[test]
fn arrays_are_columns_and_structural_parameters_change_their_number() {
    let folder = arrays();
    let fmu = folder.open();
    assert!(fmu.description().quirks.is_empty(), "{:?}", fmu.description().quirks);
    assert_eq!(fmu.description().n_states(), 3);
    for kind in [Kind::ModelExchange, Kind::CoSimulation] {
        let options = SimulateOptions::new().kind(kind).relative_tolerance(1e-10).ncp(10);
        let result = fmu.simulate(&options).unwrap();
        assert_eq!(result.names, ["x[1]", "x[2]", "x[3]", "sum"]);
        for (i, name) in ["x[1]", "x[2]", "x[3]"].into_iter().enumerate() {
            close(result.final_value(name).unwrap().unwrap(), (i + 1) as f64 * (-1f64).exp());
        }
        close(result.final_value("sum").unwrap().unwrap(), 6.0 * (-1f64).exp());

        // Two states instead of three, with other values, twice with the same bits, and back to three.
        let smaller = options
            .clone()
            .start_value("n", 2)
            .start_value("x", vec![4.0, 5.0])
            .start_value("k", vec![1.0, 2.0])
            .outputs(["level[2]", "matrix[2,1]", "u8", "flags", "sum", "choice", "u64"]);
        let mut simulator = Simulator::new(Arc::new(SimulationPlan::new(&fmu, &smaller).unwrap())).unwrap();
        let first = simulator.trajectory(&[]).unwrap();
        assert_eq!(
            first.names,
            ["level[2]", "matrix[2,1]", "u8", "flags[1]", "flags[2]", "sum", "choice", "u64"]
        );
        let last: Vec<f64> = first.columns.iter().map(|column| *column.last().unwrap()).collect();
        close(last[0], 5.0 * (-2f64).exp());
        close(last[5], 4.0 * (-1f64).exp() + 5.0 * (-2f64).exp());
        assert_eq!(
            (&last[1..5], &last[6..]),
            (&[3.0, 208.0, 1.0, 0.0][..], &[2.0, 18000000000000000064.0][..])
        );
        assert_eq!(simulator.trajectory(&[]).unwrap(), first);
        assert_eq!(fmu.simulate(&options).unwrap(), result);
    }
}

/// Solution of x' = u - k x at `t`.
fn grown(x0: f64, k: f64, u: f64, t: f64) -> f64 {
    u / k + (x0 - u / k) * (-k * t).exp()
}

#[test]
fn elements_are_start_values_parameters_and_inputs() {
    let folder = arrays();
    let fmu = folder.open();
    let inputs = Inputs::new()
        .series("u[2]", vec![0.0, 1.0], vec![3.0, 3.0])
        .series("steps[2]", vec![0.0, 0.5], vec![4.0, 5.0])
        .table(vec![0.0, 1.0], [("u[1]", vec![2.0, 2.0])]);
    for kind in [Kind::ModelExchange, Kind::CoSimulation] {
        let options = SimulateOptions::new()
            .kind(kind)
            .relative_tolerance(1e-10)
            .times([0.0, 0.25, 1.0])
            .start_value("n", 2)
            .start_value("k", vec![2.0, 1.0])
            .start_value("u", vec![0.0, 0.0])
            .start_value("x", vec![9.0, 9.0])
            .start_value("x[2]", 5.0)
            .start_value("x[1]", 4)
            .parameters(["k[2]", "x[1]"])
            .inputs(inputs.clone())
            .outputs(["x", "k[2]", "steps"]);
        let plan = Arc::new(SimulationPlan::new(&fmu, &options).unwrap());
        assert_eq!(plan.parameter_starts(), [1.0, 4.0]);
        let mut simulator = Simulator::new(plan).unwrap();
        for (k2, x1) in [(1.0, 4.0), (3.0, -1.0), (1.0, 4.0)] {
            let result = simulator.trajectory(&[k2, x1]).unwrap();
            let last = |name: &str| result.final_value(name).unwrap().unwrap();
            close(last("x[1]"), grown(x1, 2.0, 2.0, 1.0));
            close(last("x[2]"), grown(5.0, k2, 3.0, 1.0));
            assert_eq!(last("k[2]"), k2);
            // The other element of a driven array keeps its start value.
            assert_eq!(result.get("steps[1]").unwrap(), [1.0, 1.0, 1.0]);
            assert_eq!(result.get("steps[2]").unwrap(), [4.0, 4.0, 5.0]);
            assert_eq!(simulator.value("k").unwrap(), vec![2.0, k2].into());
            assert_eq!(simulator.get("x[2]").unwrap(), last("x[2]"));
        }
    }
    let problem = |options: SimulateOptions| SimulationPlan::new(&fmu, &options).unwrap_err().to_string();
    let new = SimulateOptions::new;
    assert!(problem(new().parameters(["k"])).contains("its elements can be"));
    assert!(problem(new().parameters(["k[1]", "k[1]"])).contains("given twice"));
    assert!(problem(new().start_value("k[4]", 1.0)).contains("k[4]"));
    assert!(problem(new().start_value("n", 2).start_value("k[1]", 1.0)).contains("3 for 2 elements"));
    assert!(problem(new().start_value("k[1]", "one")).contains("Real"));
    assert!(problem(new().inputs(Inputs::new().series("u", vec![0.0], vec![1.0]))).contains("u[...]"));
    let twice =
        new().inputs(Inputs::new().series("u[1]", vec![0.0], vec![1.0]).series("u[1]", vec![0.0], vec![1.0]));
    assert!(problem(twice).contains("twice"));
}

#[test]
fn a_session_knows_elements() {
    let folder = arrays();
    let mut session = Session::new(folder.open());
    session.set("k[2]", 3.0).unwrap();
    session.set("matrix[2,1]", 30).unwrap();
    assert_eq!(session.get("k").unwrap(), vec![1.0, 3.0, 1.0].into());
    assert_eq!((session.get("k[2]").unwrap(), session.get("k[1]").unwrap()), (3.0.into(), 1.0.into()));
    session.simulate(&SimulateOptions::new().ncp(1).relative_tolerance(1e-10)).unwrap();
    assert_eq!(session.get("matrix").unwrap(), vec![0, 1, 2, 30, 4, 5].into());
    let Value::Real(x) = session.get("x[2]").unwrap() else { panic!("x[2] is real") };
    close(x, 2.0 * (-3f64).exp());
    assert_eq!((session.extents("k").unwrap(), session.extents("matrix").unwrap()), (vec![3], vec![2, 3]));
    session.set("n", 5).unwrap();
    assert_eq!((session.extents("k").unwrap(), session.extents("i8").unwrap()), (vec![5], vec![]));
}

#[test]
fn values_of_all_types_are_set_and_read() {
    let folder = arrays();
    let mut session = Session::new(folder.open());
    let values: [(&str, Value); 15] = [
        ("f32", Value::Real(0.25)),
        ("i8", (-128).into()),
        ("u8", 255.into()),
        ("i16", (-32768).into()),
        ("u16", 65535.into()),
        ("i32", i32::MIN.into()),
        ("u32", u32::MAX.into()),
        ("i64", i64::MIN.into()),
        ("u64", u64::MAX.into()),
        ("choice", 1.into()),
        ("flags", vec![false, true].into()),
        ("matrix", vec![9, 8, 7, 6, 5, 4].into()),
        ("text", vec!["a", "\u{e4}"].into()),
        ("bytes", Value::Binary(vec![0, 1, 255])),
        ("k", vec![0.5, 1.0, 2.0].into()),
    ];
    for (name, value) in &values {
        session.set(name, value.clone()).unwrap();
    }
    session.simulate(&SimulateOptions::new().ncp(1)).unwrap();
    for (name, value) in &values {
        assert_eq!(session.get(name).unwrap(), *value, "{name}");
    }
    session.reset();
    session.simulate(&SimulateOptions::new().ncp(1)).unwrap();
    assert_eq!(session.get("bytes").unwrap(), Value::Binary(vec![0xca, 0xfe]));
    assert_eq!(session.get("text").unwrap(), vec!["one", "two"].into());
    assert_eq!(session.get("u64").unwrap(), 18_000_000_000_000_000_064u64.into());
}

#[test]
fn values_that_do_not_fit_are_refused_by_name() {
    let folder = arrays();
    let fmu = folder.open();
    let problem = |name: &str, value: Value| {
        SimulationPlan::new(&fmu, &SimulateOptions::new().start_value(name, value)).unwrap_err().to_string()
    };
    for (name, value, text) in [
        ("i8", 128.into(), "i8 is of type Int8 (8 bits, from -128 to 127), 128"),
        ("u64", (-1).into(), "64 bits, from 0 to 18446744073709551615"),
        ("k", vec![1.0, 2.0].into(), "array of another size"),
        ("k", 1.0.into(), "one value for an array"),
        ("k", vec![1.0, f64::NAN, 1.0].into(), "NaN"),
        ("flags", vec![1, 0].into(), "Boolean"),
        ("bytes", "text".into(), "Binary"),
        ("f32", vec![1.0].into(), "array"),
    ] {
        let problem = problem(name, value);
        assert!(problem.contains(text), "{problem}");
    }
    for (output, text) in [("text", "text or binary"), ("x[4]", "no variable"), ("x[0]", "no variable")] {
        let error =
            SimulationPlan::new(&fmu, &SimulateOptions::new().outputs([output])).unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
    }
    let error = SimulationPlan::new(&fmu, &SimulateOptions::new().parameters(["k"])).unwrap_err();
    assert!(matches!(error, FmiError::NotSettable { .. }), "{error}");
}

#[test]
fn instances_know_the_sizes_of_their_arrays() {
    let folder = arrays();
    let fmu: Fmu = folder.open();
    let mut instance = fmu.instantiate().unwrap();
    instance.set("n", 2).unwrap();
    instance.set("x", vec![7.0, 8.0]).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
    assert!(matches!(instance.set("n", 3), Err(FmiError::NotSettable { .. })));
    assert_eq!(instance.get("x").unwrap(), vec![7.0, 8.0].into());
    let mut values = [0.0; 3];
    assert!(matches!(instance.get_reals(&[2], &mut values), Err(FmiError::Length { expected: 2, .. })));
    instance.get_reals(&[2, 5], &mut values).unwrap();
    assert_eq!(values, [7.0, 8.0, 15.0]);
    let mut instance = instance.exit_initialization().unwrap();
    assert!(matches!(instance.get_continuous_states(&mut values), Err(FmiError::Length { expected: 2, .. })));
    instance.get_continuous_states(&mut values[..2]).unwrap();
    let fresh = instance.terminate().unwrap().reset().unwrap();
    let mut instance = fresh.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    instance.get_continuous_states(&mut values).unwrap();
    assert_eq!(values, [1.0, 2.0, 3.0]);
}
