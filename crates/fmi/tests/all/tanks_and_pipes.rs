//! The two bundled models with recorded inputs: derivatives, closed forms, directional derivatives, limits.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::{Fmu, MAX_EVENT_ITERATIONS, SimulateOptions, Value};
use support::model;

fn real(value: Value) -> f64 {
    let Value::Real(value) = value else { panic!("{value:?} is not real") };
    value
}

/// Returns the values of `names` at the start of a simulation with these start values.
fn at_start(fmu: &Fmu, start: &[(&str, f64)], names: &[&str]) -> Vec<f64> {
    let mut instance = fmu.instantiate().unwrap();
    for (name, value) in start {
        instance.set(name, *value).unwrap();
    }
    let instance = instance.enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    names.iter().map(|name| real(instance.get(name).unwrap())).collect()
}

fn assert_close(found: &[f64], expected: &[f64], relative: f64) {
    assert_eq!(found.len(), expected.len());
    for (f, e) in found.iter().zip(expected) {
        assert!((f - e).abs() <= relative * e.abs(), "{found:?} instead of {expected:?}");
    }
}

#[test]
fn exhaust_pipe_derivatives_match_the_equations() {
    let folder = model("exhaust");
    let start = [
        ("p1", 1.5e5),
        ("T1", 700.0),
        ("Tw1", 650.0),
        ("p2", 1.1e5),
        ("T2", 620.0),
        ("Tw2", 580.0),
        ("T_in", 800.0),
        ("p_in", 2.2e5),
        ("w_turb1", 5000.0),
        ("w_turb2", 4000.0),
        ("p_out", 1.03e5),
    ];
    let flows = at_start(&folder.open(), &start, &["m1", "Ta", "m2", "Tb", "m3", "T_out"]);
    assert_close(&flows, &[0.32998356, 746.4529803, 0.36613756, 658.5823759, 0.38753134, 620.0], 2e-8);
    let names = ["der(p1)", "der(T1)", "der(Tw1)", "der(p2)", "der(T2)", "der(Tw2)"];
    let derivatives = at_start(&folder.open(), &start, &names);
    let expected = [-982582.12824, 1073.72134, 1.54356, -50631.61763, 1147.55161, -0.02691111];
    assert_close(&derivatives, &expected, 5e-8);
}

/// No flow is reversed, and zero flow causes no division by zero.
#[test]
fn exhaust_pipe_has_no_flow_without_pressure_drop() {
    let folder = model("exhaust");
    let start = [("p_in", 1e5), ("p1", 1e5), ("p2", 1.01e5), ("p_out", 1.02e5), ("w_turb1", 0.0)];
    let found = at_start(&folder.open(), &start, &["m1", "m2", "m3", "Ta", "T_in"]);
    assert_eq!(found[..3], [0.0; 3]);
    assert_eq!(found[3], found[4]);
}

#[test]
fn exhaust_pipe_rejects_invalid_parameters() {
    let folder = model("exhaust");
    let fmu = folder.open();
    let refused = |name: &str, value: f64| {
        let options = SimulateOptions {
            start_values: vec![(name.to_owned(), value.into())],
            final_time: Some(0.01),
            ..SimulateOptions::default()
        };
        fmu.simulate(&options).unwrap_err().to_string()
    };
    for (name, value) in [("C1", 0.0), ("C2", -1.0), ("V1", 0.0), ("p1", -1.0), ("T2", 0.0), ("p_in", 0.0)] {
        let message = refused(name, value);
        assert!(message.contains(&format!("{name} = {value}")), "{message}");
    }
    assert!(refused("cp", 100.0).contains("R = 287.5"));
}

#[test]
fn tank_derivatives_match_the_equations() {
    let folder = model("quad_tank");
    let names = ["der(qt.x1)", "der(qt.x2)", "der(qt.x3)", "der(qt.x4)"];
    let found = at_start(&folder.open(), &[("u1", 5.0), ("u2", 6.0)], &names);
    let expected = [-8.7505179956e-04, -4.9714664121e-04, 5.9873286206e-04, -1.1280950193e-04];
    assert_close(&found, &expected, 1e-9);
    // There is no outflow below zero.
    let found = at_start(&folder.open(), &[("qt.x1", -1e-9), ("qt.x3", -1e-9)], &names);
    assert_eq!((found[0], found[2]), (0.0, 0.0));
}

#[test]
fn tanks_settle_and_empty_at_the_exact_levels() {
    let folder = model("quad_tank");
    let fmu = folder.open();
    let options = SimulateOptions {
        start_values: vec![("u1".to_owned(), 5.0.into()), ("u2".to_owned(), 6.0.into())],
        final_time: Some(2000.0),
        ..SimulateOptions::new().relative_tolerance(1e-10)
    };
    let settled = fmu.simulate(&options).unwrap();
    for (name, level) in
        [("qt.x1", 0.0577011213), ("qt.x2", 0.0498868728), ("qt.x3", 0.0313280326), ("qt.x4", 0.0217555782)]
    {
        assert!((settled.final_value(name).unwrap().unwrap() - level).abs() < 1e-9, "{name}");
    }
    // Torricelli: without voltage the level of an upper tank is a parabola.
    let emptied = fmu
        .simulate(&SimulateOptions {
            start_values: vec![],
            final_time: Some(100.0),
            ncp: Some(100),
            ..options
        })
        .unwrap();
    let end = 4.9e-4 / 0.03e-4 * (2.0 * 0.024 / 9.81f64).sqrt();
    for (t, x) in emptied.time.iter().zip(emptied.get("qt.x3").unwrap()) {
        let expected = 0.024 * (1.0 - t / end).max(0.0).powi(2);
        assert!((x - expected).abs() < 1e-8, "{x} instead of {expected} at {t}");
    }
}

#[test]
fn tank_directional_derivatives_match_differences() {
    let folder = model("quad_tank");
    let fmu = folder.open();
    let description = fmu.description();
    let names: Vec<&str> = description.variables.iter().map(|v| v.name.as_str()).collect();
    let reference = |name: &str| description.variable(name).unwrap().value_reference;
    let start = [("u1", 5.0), ("u2", 6.0), ("qt.a3", 0.025e-4), ("qt.g1_nmp", 0.4), ("qt.k2_nmp", 0.5e-6)];
    let rates = ["der(qt.x1)", "der(qt.x2)", "der(qt.x3)", "der(qt.x4)"];
    let unknowns = rates.map(reference);
    let mut instance = fmu.instantiate().unwrap();
    for (name, value) in start {
        instance.set(name, value).unwrap();
    }
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
    for name in names.iter().filter(|name| **name != "time" && !name.starts_with("der(")) {
        let value = real(instance.get(name).unwrap());
        let step = 1e-4 * value;
        let moved = |by: f64| {
            let mut with = start.to_vec();
            with.push((name, value + by));
            at_start(&fmu, &with, &rates)
        };
        let (up, down) = (moved(step), moved(-step));
        let mut found = [0.0; 4];
        instance.directional_derivative(&unknowns, &[reference(name)], &[1.0], &mut found).unwrap();
        let largest = found.iter().fold(0.0f64, |a, b| a.max(b.abs()));
        assert!(largest > 0.0, "{name}");
        for k in 0..4 {
            let difference = (up[k] - down[k]) / (2.0 * step);
            assert!((found[k] - difference).abs() < 1e-6 * largest, "{} by {name}", rates[k]);
        }
    }
    // The derivatives are also right in continuous-time mode, and finite in an empty tank.
    let mut instance = instance.exit_initialization().unwrap();
    instance.update_discrete_states(MAX_EVENT_ITERATIONS).unwrap();
    let mut instance = instance.enter_continuous_time().unwrap();
    instance.set_continuous_states(&[0.0; 4]).unwrap();
    let mut found = [1.0; 4];
    instance.directional_derivative(&unknowns, &[reference("qt.x3")], &[1.0], &mut found).unwrap();
    assert_eq!(found, [0.0; 4]);
}
