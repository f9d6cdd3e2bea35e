//! Run times of simulations, and the part inside the FMU. Sleeping gives lower bounds only.

#![allow(clippy::unwrap_used, clippy::panic)]

use example_models::{ExampleKind, example_fmu_as};
use fmi::{Fmu, Inputs, SimulateOptions, SimulationPlan, Simulator};
use ode::Ignore;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::sleep;
use std::time::Duration;

#[test]
fn model_time_excludes_input_functions_in_every_kind() {
    for kind in ExampleKind::ALL {
        let fmu = Fmu::open(example_fmu_as("switched_input", kind).unwrap()).unwrap();
        let naps = Arc::new(AtomicU32::new(0));
        let counted = Arc::clone(&naps);
        let nap = Duration::from_millis(1);
        let inputs = Inputs::new().function("u", move |t| {
            sleep(nap);
            counted.fetch_add(1, Ordering::Relaxed);
            0.3 * t
        });
        let options = SimulateOptions::new().final_time(1.0).ncp(20).inputs(inputs).outputs(["y"]);
        let plan = Arc::new(SimulationPlan::new(&fmu, &options).unwrap());
        let mut simulator = Simulator::new(plan).unwrap();
        // The first run has a new instance. Test runs may precede the second. The third only resets.
        for _ in 0..3 {
            let before = naps.load(Ordering::Relaxed);
            let stats = simulator.run(&[], &mut Ignore).unwrap().stats;
            let made = naps.load(Ordering::Relaxed) - before;
            let (seconds, in_model) = (stats.seconds.get(), stats.seconds_in_model.get());
            assert!(made >= 20 && in_model > 0.0 && in_model <= seconds, "{kind:?}: {stats:?}");
            // Test runs do not count; only the evaluations of this run remain.
            assert!(
                seconds - in_model > 0.99 * 20.0 * nap.as_secs_f64(),
                "{kind:?}: {in_model} of {seconds}"
            );
        }
    }
}
