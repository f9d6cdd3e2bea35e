//! Plain crossings are events and nothing else, whatever the shape of the event function at zero.

#![allow(clippy::unwrap_used)]

use ode::*;

/// `y = cos t`, and an event function with the sign of `v = y - 0.3`; events change nothing, or a third state.
struct Shaped {
    shape: fn(f64) -> f64,
    resets: bool,
    n_events: usize,
}

impl HybridSystem for Shaped {
    fn n_states(&self) -> usize {
        3
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[1.0, 0.0, 0.0]);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[x[1], -x[0], 0.0]);
        Ok(())
    }
    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = (self.shape)(x[0] - 0.3);
        Ok(())
    }
    fn handle_event(&mut self, _: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        self.n_events += 1;
        x[2] += f64::from(u8::from(self.resets));
        Ok(EventOutcome { states_changed: self.resets, ..EventOutcome::default() })
    }
}

type Shape = (&'static str, fn(f64) -> f64);

const SHAPES: [Shape; 10] = [
    ("v", |v| v),
    ("v^3", |v| v * v * v),
    ("v^3 + 1e-3 v", |v| v * v * v + 1e-3 * v),
    ("v |v|", |v| v * v.abs()),
    ("signed root", |v| v.signum() * v.abs().sqrt()),
    ("cube root", f64::cbrt),
    ("atan(1e6 v)", |v| (1e6 * v).atan()),
    ("tanh(1e4 v)", |v| (1e4 * v).tanh()),
    ("sinh(20 v)", |v| (20.0 * v).sinh()),
    ("kinked", |v| if v.abs() < 1e-3 { v } else { 10.0 * v }),
];

#[test]
fn the_shape_of_an_event_function_at_zero_does_not_matter() {
    for method in [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf, Method::Rk4] {
        for relative_tolerance in [1e-3, 1e-6, 1e-9] {
            for (name, shape) in SHAPES {
                for resets in [false, true] {
                    let mut system = Shaped { shape, resets, n_events: 0 };
                    let step_size = (method == Method::Rk4).then_some(0.02);
                    let options = Options { method, relative_tolerance, step_size, ..Options::default() };
                    let run = Driver::new(options).unwrap().run(&mut system, 0.0, 20.0, &[], &mut Ignore);
                    let what = format!("{method:?} {relative_tolerance} {name} {resets}");
                    assert!(run.is_ok(), "{what}: {}", run.unwrap_err());
                    assert_eq!(system.n_events, 6, "{what}");
                }
            }
        }
    }
}

/// `y0' = 0`, `y1' = -1e4 (y1 - y0) / length`, and an event at a time that changes `y0`.
struct Step {
    at: f64,
    length: f64,
    n_events: usize,
}

impl HybridSystem for Step {
    fn n_states(&self) -> usize {
        2
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.fill(1.0);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[0.0, -1e4 * (x[1] - x[0]) / self.length]);
        Ok(())
    }
    fn event_indicators(&mut self, t: f64, _: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = self.at - t;
        Ok(())
    }
    fn handle_event(&mut self, _: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        self.n_events += 1;
        x[0] += 3.7;
        Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
    }
}

#[test]
fn steps_after_an_event_that_are_shorter_than_its_location_show_nothing_of_a_return() {
    for method in [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf] {
        for (start, length) in [(0.0, 1.0), (-7.3, 0.01), (100.0, 0.01), (1e4, 0.01), (1e4, 1.0), (1e6, 1.0)]
        {
            for k in 1..12 {
                let mut system = Step { at: start + length * f64::from(k) / 13.0, length, n_events: 0 };
                let options = Options { method, relative_tolerance: 1e-6, ..Options::default() };
                let run =
                    Driver::new(options).unwrap().run(&mut system, start, start + length, &[], &mut Ignore);
                assert!(run.is_ok(), "{method:?} {start} {length} {k}: {}", run.unwrap_err());
                assert_eq!(system.n_events, 1, "{method:?} {start} {length} {k}");
            }
        }
    }
}

/// A harmonic oscillator whose steps know nothing of an event function of time: `sin(w t) + offset`.
struct Dips {
    w: f64,
    offset: f64,
    times: Vec<f64>,
}

impl HybridSystem for Dips {
    fn n_states(&self) -> usize {
        2
    }
    fn n_event_indicators(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[1.0, 0.0]);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[x[1], -x[0]]);
        Ok(())
    }
    fn event_indicators(&mut self, t: f64, _: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = (self.w * t).sin() + self.offset;
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        self.times.push(visit.time);
        Ok(EventOutcome::default())
    }
}

/// Every crossing and its return in short dips below zero, which lie between long steps.
#[test]
fn short_dips_between_long_steps_are_found() {
    use std::f64::consts::PI;
    for method in [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf] {
        for (w, offset) in [(7.0, 0.99), (7.0, 0.9), (5.0, 0.99), (3.3, 0.95)] {
            let mut system = Dips { w, offset, times: Vec::new() };
            let options = Options { method, ..Options::default() };
            Driver::new(options).unwrap().run(&mut system, 0.0, 40.0, &[], &mut Ignore).unwrap();
            let from = f64::asin(offset) + PI;
            let dips = (0..)
                .map(|k| 2.0 * PI * f64::from(k))
                .flat_map(|turn| [turn + from, turn + 3.0 * PI - from].map(|phase| phase / w));
            let expected: Vec<f64> = dips.take_while(|t| *t < 40.0).collect();
            let what = format!("{method:?}, sin({w} t) + {offset}");
            assert_eq!(system.times.len(), expected.len(), "{what}");
            for (found, expected) in system.times.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-9, "{what}: {found} and {expected}");
            }
        }
    }
}
