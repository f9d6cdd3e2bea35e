//! Columns with units: converted to those of the model's variables, or refused.

#![allow(clippy::unwrap_used)]

use calibration::{Calibration, CalibrationError, Data, Experiment, Parameter, SetupWarning};
use example_models::example_fmu;
use fmi::Fmu;

/// The quadruple tank with its levels in columns of these names, which are recorded in the unit that is 1 m / `per_metre`.
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
    let expected = metres.cost(&[2.7e-6]).unwrap();
    for (names, per_metre, voltages) in [
        (["x1 [m]", "x2 (m)"], 1.0, ("u [V]", 5.0)),
        (["x1 [mm]", "x2 (mm)"], 1e3, ("u [mV]", 5e3)),
        (["x1[cm]", "x2 [cm]"], 1e2, ("u (V)", 5.0)),
    ] {
        let calibration = tank(names, per_metre, voltages).unwrap();
        assert!(calibration.warnings().is_empty(), "{:?}", calibration.warnings());
        let cost = calibration.cost(&[2.7e-6]).unwrap();
        assert!((cost - expected).abs() <= 1e-12 * expected, "{names:?}: {cost} {expected}");
        let data = calibration.problem().experiments[0].data();
        assert_eq!(data.unit(names[0]), Some("m"));
        // What is stored is converted, and is not converted again.
        let again =
            Calibration::from_problem(calibration.fmu().clone(), calibration.problem().clone()).unwrap();
        assert_eq!(again.problem(), calibration.problem());
        assert_eq!(again.cost(&[2.7e-6]).unwrap().to_bits(), cost.to_bits());
    }
}

#[test]
fn units_of_other_quantities_are_refused_and_unknown_ones_named() {
    for (names, expected) in [
        (
            ["x1 [bar]", "x2"],
            "data: column 'x1 [bar]' belongs to 'qt.x1', but 'bar' (kg.m-1.s-2) cannot be converted to 'm' (m): correct",
        ),
        (
            ["x1", "x2 [degC]"],
            "column 'x2 [degC]' belongs to 'qt.x2', but 'degC' (K) cannot be converted to 'm' (m)",
        ),
    ] {
        let message = tank(names, 1.0, ("u", 5.0)).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let calibration = tank(["x1 (raw)", "x2"], 1.0, ("u", 5.0)).unwrap();
    match calibration.warnings() {
        [warning @ SetupWarning::NotConverted { column, .. }] => {
            assert_eq!(column, "x1 (raw)");
            let text = warning.to_string();
            assert!(
                text.contains(
                    "'x1 (raw)' is taken in the unit of 'qt.x1', without conversion: 'raw' is no unit"
                ),
                "{text}"
            );
        }
        other => panic!("{other:?}"),
    }
}
