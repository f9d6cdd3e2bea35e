//! A simulation through an FMU allocates nothing per step: a long run takes as many allocations as a short one.

#![allow(clippy::unwrap_used, clippy::panic)]

mod support;

use fmi::ode::{Ignore, Observer, Sample};
use fmi::{Fmu, Inputs, SimulateOptions, SimulationPlan, Simulator};
use std::ops::ControlFlow;
use std::sync::Arc;
use support::model;

struct Sum(f64);

impl Observer for Sum {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        self.0 += sample.outputs.iter().sum::<f64>();
        ControlFlow::Continue(())
    }
}

/// Allocations and steps of a warm run until `end`.
fn count(fmu: &Fmu, options: &SimulateOptions, end: f64, parameters: &[f64]) -> (u64, u64) {
    let plan = SimulationPlan::new(fmu, &options.clone().final_time(end)).unwrap();
    let mut simulator = Simulator::new(Arc::new(plan)).unwrap();
    for _ in 0..3 {
        simulator.run(parameters, &mut Ignore).unwrap();
    }
    let mut sum = Sum(0.0);
    let mut steps = 0;
    let counted = allocation_counter::measure(|| {
        steps = simulator.run(parameters, &mut sum).unwrap().stats.accepted_steps;
    });
    assert!(sum.0.is_finite());
    (counted.count_total, steps)
}

#[test]
fn furuta_with_events() {
    let folder = model("furuta");
    let options = SimulateOptions::new().parameters(["armFriction", "pendulumFriction"]).record_events(true);
    let (short, few) = count(&folder.open(), &options, 2.0, &[0.012, 0.002]);
    let (long, many) = count(&folder.open(), &options, 40.0, &[0.012, 0.002]);
    assert!(many > few + 100, "{few} and {many} steps");
    assert_eq!(short, long);
    assert!(long <= 4, "{long} allocations per run");
}

#[test]
fn inputs_that_jump() {
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
