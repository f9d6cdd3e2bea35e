//! A warm driver allocates nothing: not per step, not per event, not per run.

#![allow(clippy::unwrap_used)]

mod common;

use common::*;
use ode::*;
use std::ops::ControlFlow;

struct Sum(f64);

impl Observer for Sum {
    fn sample(&mut self, s: &Sample<'_>) -> ControlFlow<()> {
        self.0 += s.states[0];
        ControlFlow::Continue(())
    }
}

#[test]
fn a_warm_driver_allocates_nothing() {
    let times: Vec<f64> = (0..=400).map(|k| f64::from(k) * 0.01).collect();
    for method in
        [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf, Method::Rk4, Method::Euler]
    {
        let options = Options { method, record_events: true, ..Options::default() };
        let mut driver = Driver::new(options).unwrap();
        let mut ball = Ball { v_min: 0.1, resting: false };
        driver.run(&mut ball, 0.0, 4.0, &times, &mut Sum(0.0)).unwrap();
        let counted = allocation_counter::measure(|| {
            let report = driver.run(&mut ball, 0.0, 4.0, &times, &mut Sum(0.0)).unwrap();
            assert!(report.stats.accepted_steps > 10 && report.stats.events > 5);
        });
        assert_eq!(counted.count_total, 0, "{}: {counted:?}", method.name());
    }
}
