//! Columns with units, which are converted to the units of the variables or rejected.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::{Calibration, CalibrationError, Data, Experiment, FitOptions, Parameter, Severity};
use example_models::example_fmu;
use fmi::Fmu;

/// The quadruple tank with its levels in columns of these names. The levels are recorded in a unit of 1 m /
/// `per_metre`.
fn tank(names: [&str; 2], per_metre: f64, voltages: (&str, f64)) -> Result<Calibration, CalibrationError> {
    let time: Vec<f64> = (0..31).map(f64::from).collect();
    let level = |k: f64| time.iter().map(|t| (k - 1e-4 * t) * per_metre).collect::<Vec<f64>>();
    let columns = [
        (names[0].to_owned(), level(0.06)),
        (names[1].to_owned(), level(0.055)),
        (voltages.0.to_owned(), vec![voltages.1; 31]),
    ];
    let data = Data::from_columns(time, columns)?;
    let stem = |name: &str| name.split(['[', '(']).next().unwrap_or_default().trim().to_owned();
    let experiment = Experiment::new(data)
        .output("qt.x1", names[0])
        .output("qt.x2", stem(names[1]))
        .input("u1", stem(voltages.0))
        .input("u2", voltages.0);
    Calibration::builder(Fmu::open(example_fmu("quad_tank").unwrap()).unwrap())
        .experiment(experiment)
        .parameter(Parameter::new("qt.a1", 3e-6).bounds(2e-6, 4e-6))
        .build()
}

#[test]
fn columns_are_converted_to_the_units_of_the_model() {
    let metres = tank(["x1", "x2"], 1.0, ("u", 5.0)).unwrap();
    let expected = metres.cost(&[2.7e-6], &RunContext::new()).unwrap();
    for (names, per_metre, voltages) in [
        (["x1 [m]", "x2 (m)"], 1.0, ("u [V]", 5.0)),
        (["x1 [mm]", "x2 (mm)"], 1e3, ("u [mV]", 5e3)),
        (["x1[cm]", "x2 [cm]"], 1e2, ("u (V)", 5.0)),
    ] {
        let calibration = tank(names, per_metre, voltages).unwrap();
        // Only the conversion is reported, and only as a note, because brackets may have another meaning.
        let reported: Vec<String> = calibration.warnings().iter().map(ToString::to_string).collect();
        assert!(calibration.warnings().iter().all(|w| w.severity() == Severity::Note), "{reported:?}");
        let converted = "columns were converted from the units that they state: 'x1 [mm]' from mm to m, 'x2 (mm)' from mm to m, 'u [mV]' from mV to V";
        assert_eq!(
            reported.iter().any(|reported| reported.contains(converted)),
            names[0] == "x1 [mm]",
            "{reported:?}"
        );
        assert_eq!(reported.is_empty(), per_metre == 1.0, "{reported:?}");
        let (check, fit) = (calibration.check(), calibration.fit(FitOptions::default()).unwrap());
        for printed in [check.to_string(), fit.to_string()] {
            assert_eq!(printed.contains(converted), names[0] == "x1 [mm]", "{printed}");
        }
        let cost = calibration.cost(&[2.7e-6], &RunContext::new()).unwrap();
        assert!((cost - expected).abs() <= 1e-12 * expected, "{names:?}: {cost} {expected}");
        let data = calibration.problem().experiments[0].data();
        assert_eq!(data.unit(names[0]), Some("m"));
        // The stored problem is converted already and is not converted again.
        let again =
            Calibration::from_problem(calibration.fmu().clone(), calibration.problem().clone()).unwrap();
        assert_eq!(again.problem(), calibration.problem());
        assert_eq!(again.cost(&[2.7e-6], &RunContext::new()).unwrap().to_bits(), cost.to_bits());
    }
}

#[test]
fn units_of_other_quantities_are_rejected_and_unknown_units_reported() {
    for (names, expected) in [
        (
            ["x1 [bar]", "x2"],
            "data: column 'x1 [bar]' belongs to 'qt.x1', but 'bar' (kg.m-1.s-2) cannot be converted to 'm' (m). Correct",
        ),
        (
            ["x1", "x2 [degC]"],
            "column 'x2 [degC]' belongs to 'qt.x2', but 'degC' (K) cannot be converted to 'm' (m)",
        ),
    ] {
        let message = tank(names, 1.0, ("u", 5.0)).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let message = tank(["x1 (raw)", "x2"], 1.0, ("u", 5.0)).unwrap_err().to_string();
    assert!(
        message.contains("column 'x1 (raw)' belongs to 'qt.x1' (in m), but 'raw' is not a known unit")
            && message.contains("rename the column if this is not a unit")
            && !message.contains("parse"),
        "{message}"
    );
}

#[test]
fn number_after_a_name_is_not_a_unit() {
    let expected = tank(["x1", "x2"], 1.0, ("u", 5.0)).unwrap().cost(&[2.7e-6], &RunContext::new()).unwrap();
    for names in [["x1 [2]", "x2 (3)"], ["x1 (2)", "x2 [3]"]] {
        let cost = tank(names, 1.0, ("u", 5.0)).unwrap().cost(&[2.7e-6], &RunContext::new()).unwrap();
        assert_eq!(cost.to_bits(), expected.to_bits(), "{names:?}");
    }
}

#[test]
fn line_of_units_applies_to_columns_named_as_variables() {
    let recording = |unit: &str, per_metre: f64| {
        let mut text = format!("time,qt.x1,u\ns,{unit},V\n");
        for k in 0..31 {
            text += &format!("{k},{},5\n", (0.06 - 1e-4 * f64::from(k)) * per_metre);
        }
        let data = Data::from_csv_text(text.as_bytes(), "tank.csv", None).unwrap();
        let experiment = Experiment::new(data).output("qt.x1", "qt.x1").input("u1", "u").input("u2", "u");
        Calibration::builder(Fmu::open(example_fmu("quad_tank").unwrap()).unwrap())
            .experiment(experiment)
            .parameter(Parameter::new("qt.a1", 3e-6).bounds(2e-6, 4e-6))
            .build()
    };
    let expected = recording("m", 1.0).unwrap().cost(&[2.7e-6], &RunContext::new()).unwrap();
    let cost = recording("mm", 1e3).unwrap().cost(&[2.7e-6], &RunContext::new()).unwrap();
    assert!((cost - expected).abs() <= 1e-9 * expected, "{cost} {expected}");
    let message = recording("bar", 1.0).unwrap_err().to_string();
    assert!(message.contains("'bar' (kg.m-1.s-2) cannot be converted to 'm'"), "{message}");
}
