//! Evaluates the cost of an example a given number of times in this process, for `benches/instructions.py`,
//! which counts the instructions.
//!
//!     cargo bench --bench evaluations -- furuta tsit5 20
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::panic)]

use fmufit::calibration::{Calibration, Data, Experiment, Parameter, RunContext, SimulationSettings};
use fmufit::example_models::{ExampleKind, example_fmu_as};
use fmufit::fmi::worker::Isolation;
use fmufit::fmi::{Fmu, InterfaceChoice, RunSettings};
use fmufit::ode::Method;

/// A parameter and its start value.
type Fitted = (&'static str, f64);

/// An example and the data it is compared with.
struct Case {
    model: &'static str,
    kind: ExampleKind,
    run_as: InterfaceChoice,
    rows: usize,
    interval: f64,
    /// Variables and the columns of the data they are compared with.
    outputs: &'static [(&'static str, &'static str)],
    parameter: Fitted,
}

const FURUTA: &[(&str, &str)] = &[("armJoint.phi", "phi"), ("pendulumJoint.phi", "theta")];
const FMI2: ExampleKind = ExampleKind::Fmi2ModelExchange;
const OSCILLATOR: Case = Case {
    model: "van_der_pol",
    kind: FMI2,
    run_as: InterfaceChoice::ModelExchange,
    rows: 401,
    interval: 0.05,
    outputs: &[("x0", "x0"), ("x1", "x1")],
    parameter: ("mu", 1.2),
};

/// The cases by name.
fn case(name: &str) -> Case {
    match name {
        "furuta" => Case {
            model: "furuta",
            rows: 801,
            outputs: FURUTA,
            parameter: ("armFriction", 0.012),
            ..OSCILLATOR
        },
        "van_der_pol" => OSCILLATOR,
        "van_der_pol_fmi3" => Case { kind: ExampleKind::Fmi3, ..OSCILLATOR },
        "van_der_pol_co_simulation" => Case {
            kind: ExampleKind::Fmi2CoSimulation,
            run_as: InterfaceChoice::CoSimulation,
            rows: 1001,
            interval: 0.02,
            ..OSCILLATOR
        },
        "bouncing_ball" => Case {
            model: "bouncing_ball",
            rows: 301,
            interval: 0.01,
            outputs: &[("h", "h")],
            parameter: ("e", 0.7),
            ..OSCILLATOR
        },
        other => panic!("there is no case {other}"),
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let [name, solver, evaluations] = &arguments[..] else {
        println!("usage: evaluations CASE SOLVER NUMBER");
        return;
    };
    let case = case(name);
    let method = solver.parse::<Method>().unwrap();
    let data = if case.model == "furuta" {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/data/furuta.csv");
        Data::from_csv(std::path::Path::new(file)).unwrap()
    } else {
        let t: Vec<f64> = (0..case.rows).map(|k| case.interval * k as f64).collect();
        let zeros = case.outputs.iter().map(|(_, column)| ((*column).to_owned(), vec![0.0; t.len()]));
        Data::from_columns(t.clone(), zeros).unwrap()
    };
    let experiment = case
        .outputs
        .iter()
        .fold(Experiment::new(data), |experiment, (variable, column)| experiment.output(*variable, *column));
    let (parameter, start) = case.parameter;
    let calibration =
        Calibration::builder(Fmu::open(example_fmu_as(case.model, case.kind).unwrap()).unwrap())
            .experiment(experiment)
            .parameter(Parameter::new(parameter, start).bounds(0.5 * start, 2.0 * start))
            .settings(SimulationSettings {
                isolation: Isolation::None,
                ..RunSettings { method, kind: case.run_as, ..RunSettings::default() }.into()
            })
            .build()
            .unwrap();
    let cost = (0..evaluations.parse().unwrap())
        .fold(0.0, |_, _| calibration.cost(&[start], &RunContext::new()).unwrap());
    println!("{cost:e} {:016x}", cost.to_bits());
}
