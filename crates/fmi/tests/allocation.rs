//! A simulation of an FMU allocates no memory per step: long and short runs need equally many allocations.

#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use example_models::ExampleKind;
use fmi::ode::{Ignore, Observer, Sample};
use fmi::{Fmu, Inputs, InterfaceChoice, SimulateOptions, SimulationPlan, Simulator, Value};
use std::ops::ControlFlow;
use std::sync::Arc;
use support::{arrays, fixture, fixture_with, model, model_as};

struct Sum(f64);

impl Observer for Sum {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        self.0 += sample.outputs.iter().sum::<f64>();
        ControlFlow::Continue(())
    }
}

/// Returns the numbers of allocations and steps of a warm run until `end`.
fn count(fmu: &Fmu, options: &SimulateOptions, end: f64, parameters: &[f64]) -> (u64, u64) {
    let plan = SimulationPlan::new(fmu, &options.clone().final_time(end)).unwrap();
    let mut simulator = Simulator::new(Arc::new(plan)).unwrap().resetting();
    for _ in 0..3 {
        simulator.run(parameters, &mut Ignore).unwrap();
    }
    let mut sum = Sum(0.0);
    let mut steps = 0;
    let mut measured = || {
        let counted = allocation_counter::measure(|| {
            steps = simulator.run(parameters, &mut sum).unwrap().stats.accepted_steps;
        });
        counted.count_total
    };
    // On a slow machine, one of the first runs also checks the reset.
    let least = (0..8).map(|_| measured()).min().unwrap();
    assert!(sum.0.is_finite());
    (least, steps)
}

#[test]
fn events_allocate_nothing_per_step() {
    let folder = model("furuta");
    let options = SimulateOptions::new().parameters(["armFriction", "pendulumFriction"]).record_events(true);
    let (short, few) = count(&folder.open(), &options, 2.0, &[0.012, 0.002]);
    let (long, many) = count(&folder.open(), &options, 40.0, &[0.012, 0.002]);
    assert!(many > few + 100, "{few} and {many} steps");
    assert_eq!(short, long);
    assert!(long <= 4, "{long} allocations per run");
}

#[test]
fn discontinuous_inputs_allocate_nothing_per_step() {
    let folder = model("switched_input");
    let times: Vec<f64> = (0..100).map(f64::from).collect();
    let inputs = Inputs::new().table(
        times.clone(),
        [
            ("u", times.iter().map(|t| (0.3 * t).sin()).collect::<Vec<f64>>()),
            ("gear", times.iter().map(|t| (t % 3.0).floor()).collect()),
            ("enabled", times.iter().map(|t| f64::from(*t as i32 % 7 != 0)).collect()),
        ],
    );
    let options = SimulateOptions::new().inputs(inputs).outputs(["x", "y", "target", "limit", "gear"]);
    let (short, few) = count(&folder.open(), &options, 5.0, &[]);
    let (long, many) = count(&folder.open(), &options, 99.0, &[]);
    assert!(many > few + 100, "{few} and {many} steps");
    assert_eq!(short, long);
}

/// Asserts that short and long runs need equally many allocations.
fn allocates_nothing_per_step(fmu: &Fmu, options: &SimulateOptions, ends: [f64; 2]) {
    let counts = ends.map(|end| count(fmu, options, end, &[]));
    let [(short, few), (long, many)] = counts;
    assert!(many > few + 50, "{few} and {many} steps");
    assert_eq!(short, long, "{few} and {many} steps");
}

#[test]
fn co_simulation_allocates_nothing_per_step() {
    let options = SimulateOptions::new().kind(InterfaceChoice::CoSimulation).step_size(0.01);
    for kind in [ExampleKind::Fmi1CoSimulation, ExampleKind::Fmi2CoSimulation, ExampleKind::Fmi3] {
        let folder = model_as("van_der_pol", kind, &[], |xml| xml);
        allocates_nothing_per_step(&folder.open(), &options, [1.0, 20.0]);
    }
    let times: Vec<f64> = (0..40).map(f64::from).collect();
    let inputs =
        Inputs::new().table(times.clone(), [("u", times.iter().map(|t| t.sin()).collect::<Vec<f64>>())]);
    let folder = fixture("early_return", |xml| xml);
    allocates_nothing_per_step(&folder.open(), &options.inputs(inputs), [1.0, 20.0]);
}

#[test]
fn clocks_allocate_nothing_per_step() {
    let folder = fixture("clocks", |xml| xml);
    let fmu = folder.open();
    let times: Vec<f64> = (0..200).map(|k| 0.1 * f64::from(k)).collect();
    let levels =
        |of: i32| times.iter().enumerate().map(|(k, _)| f64::from(k as i32 % of)).collect::<Vec<f64>>();
    let inputs = Inputs::new()
        .table(times.clone(), [("setpoint", levels(7)), ("button", levels(2)), ("optional", levels(2))]);
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = SimulateOptions::new()
            .kind(kind)
            .inputs(inputs.clone())
            .outputs(["x", "u", "sample", "alarm", "n_button"]);
        allocates_nothing_per_step(&fmu, &options, [2.0, 20.0]);
    }
}

#[test]
fn repeated_text_is_stored_once_in_results() {
    const SIZE: usize = 1 << 20;
    let folder = fixture_with("arrays", &[&format!("LONG_TEXT={SIZE}")], |xml| xml);
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = SimulateOptions::new().kind(kind).final_time(1.0).ncp(200).outputs(["label"]);
        let plan = SimulationPlan::new(&folder.open(), &options).unwrap();
        let mut simulator = Simulator::new(Arc::new(plan)).unwrap();
        simulator.trajectory(&[]).unwrap();
        let mut result = None;
        let counted = allocation_counter::measure(|| result = Some(simulator.trajectory(&[]).unwrap()));
        let result = result.unwrap();
        let column = result.values_of("label").unwrap();
        let text = |letter: &str| Value::String(letter.repeat(SIZE));
        assert_eq!((column.len(), column.distinct().len()), (201, 2), "{kind:?}");
        assert!(column[0] == text("e") && column[200] == text("l"), "{kind:?}");
        assert!(counted.bytes_max < 3 * SIZE as u64, "{kind:?}: {counted:?}");
    }
}

#[test]
fn strings_and_bytes_allocate_nothing_per_step() {
    let folder = arrays();
    let fmu = folder.open();
    let times: Vec<f64> = (0..400).map(|k| 0.05 * f64::from(k)).collect();
    let word = |k: usize| Value::from(["left", "right"][k % 2]);
    let packet = |k: usize| Value::Binary(vec![(k % 3) as u8; k % 3]);
    let inputs = Inputs::new().values("word", times.clone(), (0..400).map(word)).values(
        "packet",
        times.clone(),
        (0..400).map(packet),
    );
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = SimulateOptions::new()
            .kind(kind)
            .inputs(inputs.clone())
            .outputs(["label", "blob", "text", "word", "packet", "count"])
            .output_interval(0.05);
        allocates_nothing_per_step(&fmu, &options, [4.0, 20.0]);
    }
}
