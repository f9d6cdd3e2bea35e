//! Only crossings are events, for any shape of the event function at zero.

#![allow(clippy::unwrap_used, clippy::panic)]

use ode::*;

const ADAPTIVE: [Method; 5] = [Method::Auto, Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf];

/// `y = cos t` with an event function that has the sign of `v = y - 0.3`. Events change nothing, or a third
/// state.
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
fn crossings_are_located_for_any_shape_at_zero() {
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

/// `y0' = 0`, `y1' = -1e4 (y1 - y0) / length`, and a time event that changes `y0`.
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
fn returns_are_ignored_in_steps_shorter_than_event_location() {
    for method in ADAPTIVE {
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

/// `x'' = -x`, `x = cos t`, with an event function of the time and of `x`.
struct Oscillator<F> {
    z: F,
    times: Vec<f64>,
}

impl<F: Fn(f64, f64) -> f64> HybridSystem for Oscillator<F> {
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
    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = (self.z)(t, x[0]);
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        self.times.push(visit.time);
        Ok(EventOutcome::default())
    }
}

/// Returns the times of the events of `sin(w t) + offset` between 0 and 40, or the error of the run. This
/// event function does not affect the steps.
fn dips(method: Method, relative_tolerance: f64, (w, offset): (f64, f64)) -> Result<Vec<f64>, String> {
    let mut system = Oscillator { z: |t: f64, _| (w * t).sin() + offset, times: Vec::new() };
    let options = Options { method, relative_tolerance, ..Options::default() };
    let run = Driver::new(options).unwrap().run(&mut system, 0.0, 40.0, &[], &mut Ignore);
    run.map(|_| system.times).map_err(|error| error.to_string())
}

/// Returns the times at which this event function crosses zero. It is negative around three quarters of each
/// period.
fn crossings((w, offset): (f64, f64)) -> impl Iterator<Item = f64> {
    use std::f64::consts::PI;
    let from = f64::asin(offset) + PI;
    let turns = (0..).map(|k| 2.0 * PI * f64::from(k));
    turns.flat_map(move |turn| [turn + from, turn + 3.0 * PI - from].map(|phase| phase / w))
}

/// Every crossing and return is found in short dips below zero between the ends of long steps.
#[test]
fn short_dips_in_long_steps_are_located() {
    for method in ADAPTIVE {
        for shape in [(7.0, 0.99), (7.0, 0.9), (5.0, 0.99), (3.3, 0.95)] {
            let found = dips(method, Options::default().relative_tolerance, shape).unwrap();
            let expected: Vec<f64> = crossings(shape).take_while(|t| *t < 40.0).collect();
            assert_eq!(found.len(), expected.len(), "{method:?}, {shape:?}");
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-9, "{method:?}, {shape:?}: {found} and {expected}");
            }
        }
    }
}

/// A step from one dip to another, several periods later, may miss the dips between them, but it reports no
/// false returns.
#[test]
fn steps_longer_than_indicator_period_locate_only_true_crossings() {
    for method in ADAPTIVE {
        for rtol in [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8] {
            for w in [3.3, 7.0, 9.1, 13.0, 20.0, 61.0] {
                for offset in [0.999, 0.99, 0.9, 0.5] {
                    let what = format!("{method:?} {rtol:e}, sin({w} t) + {offset}");
                    let found =
                        dips(method, rtol, (w, offset)).unwrap_or_else(|error| panic!("{what}: {error}"));
                    let exact: Vec<f64> = crossings((w, offset)).take_while(|t| *t < 41.0).collect();
                    for t in found {
                        let nearest =
                            exact.iter().map(|exact| (exact - t).abs()).fold(f64::INFINITY, f64::min);
                        assert!(nearest < 1e-3 * rtol + 1e-9, "{what}: {t}");
                    }
                }
            }
        }
    }
}

/// An event function that is below zero for 12 % of each period.
#[test]
fn crossing_and_return_are_located_when_step_resolves_them() {
    for method in [Method::Dop853, Method::Radau5, Method::Bdf] {
        for relative_tolerance in [1e-5, 1e-6, 1e-7, 1e-8, 1e-9] {
            let mut system = Oscillator { z: |_, x| x + 0.99833, times: Vec::new() };
            let mut driver =
                Driver::new(Options { method, relative_tolerance, ..Options::default() }).unwrap();
            let stats = driver.run(&mut system, 0.0, 25.0, &[], &mut Ignore).unwrap().stats;
            assert_eq!(stats.state_events, 8, "{} at {relative_tolerance:e}", method.name());
        }
    }
}
