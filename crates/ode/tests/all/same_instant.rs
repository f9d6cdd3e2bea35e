//! Events that differ only by rounding, or from the end of the run, happen at one instant, with every method.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

/// Ticks at `start + k period`, and `x' = n`. A tick counts only if the system receives exactly its time.
struct Ticks {
    start: f64,
    period: f64,
    n: u32,
    /// The system must not receive an event before this time.
    shown: f64,
}

impl Ticks {
    fn next(&self) -> f64 {
        self.start + f64::from(self.n + 1) * self.period
    }
}

impl HybridSystem for Ticks {
    fn n_states(&self) -> usize {
        1
    }
    fn n_outputs(&self) -> usize {
        1
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        (self.start, self.n, self.shown, x[0]) = (t0, 0, t0, 0.0);
        Ok(EventOutcome { next_time: Some(self.next()), ..EventOutcome::default() })
    }
    fn derivatives(&mut self, _: f64, _: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx[0] = f64::from(self.n);
        Ok(())
    }
    fn outputs(&mut self, _: f64, _: &[f64], y: &mut [f64]) -> CallResult<()> {
        y[0] = f64::from(self.n);
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, _: &mut [f64]) -> CallResult<EventOutcome> {
        assert!(visit.time >= self.shown && visit.cause.time);
        self.shown = visit.time;
        self.n += u32::from(visit.time >= self.next());
        Ok(EventOutcome { next_time: Some(self.next()), ..EventOutcome::default() })
    }
}

/// The end of a run is the number that a user would write for `start + k * period`.
#[test]
fn tick_at_end_counts_when_rounded_past_end() {
    let mut behind = 0;
    for method in Method::ALL {
        for start in [0.0, -3.0, 0.1, 1e3, 1e6] {
            for (period, digits) in [(0.1, 1), (0.3, 1), (1.0 / 3.0, 17), (0.7, 1)] {
                for k in (1..=100_u32).step_by(if start == 0.0 { 1 } else { 7 }) {
                    let tick = start + f64::from(k) * period;
                    let end: f64 = format!("{tick:.digits$}").parse().unwrap();
                    behind += u32::from(tick > end);
                    let mut seen = Recorder::default();
                    let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
                    let mut system = Ticks { start, period, n: 0, shown: start };
                    let report = driver.run(&mut system, start, end, &[end], &mut seen).unwrap();
                    let what = format!("{} from {start} to {end} by {period}", method.name());
                    assert_eq!((report.termination, report.time), (Termination::Finished, end), "{what}");
                    assert_eq!(report.stats.time_events, u64::from(k), "{what}");
                    // x is the integral of the previous ticks.
                    let [found, n] = seen.rows.last().unwrap().3[..] else { panic!("{what}") };
                    let x = 0.5 * f64::from(k * (k - 1)) * period;
                    assert_eq!(n, f64::from(k), "{what}");
                    assert!((found - x).abs() < 1e-6 * x.max(1.0), "{what}: {found}, not {x}");
                }
            }
        }
    }
    assert!(behind > 100, "{behind}");
}

/// A time event at `at` and an indicator of a state that crosses zero there, or two indicators. Each event
/// adds 1 to the last state.
struct Two {
    at: f64,
    by_time: bool,
}

impl HybridSystem for Two {
    fn n_states(&self) -> usize {
        2
    }
    fn n_event_indicators(&self) -> usize {
        2
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[0.5 * t0, 0.0]);
        Ok(EventOutcome { next_time: Some(self.at).filter(|_| self.by_time), ..EventOutcome::default() })
    }
    fn derivatives(&mut self, _: f64, _: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[0.5, 0.0]);
        Ok(())
    }
    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = 3.0 * (x[0] - 0.5 * self.at);
        z[1] = if self.by_time { -1.0 } else { t - self.at };
        Ok(())
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let crossed = visit.crossings.iter().filter(|c| **c != 0).count();
        x[1] += crossed as f64 + f64::from(u8::from(visit.cause.time));
        Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
    }
}

#[test]
fn row_follows_all_events_of_its_time() {
    let mut wrong = Vec::new();
    for method in Method::ALL {
        for relative_tolerance in [1e-4, 1e-6, 1e-9] {
            for (start, span) in [(0.0, 3.0), (-1.0, 2.0), (1000.0, 3.0)] {
                for k in 0..40 {
                    for (by_time, record_events) in [(false, false), (true, false), (true, true)] {
                        let at = start + span * (0.1 + 0.8 * (0.618_033_988_749_895 * f64::from(k)).fract());
                        let options =
                            Options { method, relative_tolerance, record_events, ..Options::default() };
                        let mut seen = Recorder::default();
                        let mut driver = Driver::new(options).unwrap();
                        let times = [at, start + span];
                        let mut system = Two { at, by_time };
                        driver.run(&mut system, start, start + span, &times, &mut seen).unwrap();
                        let requested = seen.rows.iter().filter(|row| row.1.is_some());
                        let counts: Vec<f64> = requested.map(|row| row.3[1]).collect();
                        if counts != [2.0, 2.0] {
                            let name = method.name();
                            wrong.push(format!("{name} {relative_tolerance:e} {at} {by_time}: {counts:?}"));
                        }
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong[..wrong.len().min(12)].join("\n"));
}
