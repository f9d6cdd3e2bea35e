//! A time listed twice gives the values before and after the events of that instant, with every method and for every cause.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Cause {
    Indicator,
    FallingIndicator,
    /// An indicator of a state that equals the time.
    Clock,
    Time,
    /// A step event at the end of a step that an input shortens.
    Step,
    Input,
}

/// `x' = -rate x`, set to 10 by the event at `at`, and a state that equals the time.
struct Jump {
    cause: Cause,
    at: f64,
    rate: f64,
    done: bool,
}

impl HybridSystem for Jump {
    fn n_states(&self) -> usize {
        2
    }
    fn n_event_indicators(&self) -> usize {
        usize::from(matches!(self.cause, Cause::Indicator | Cause::FallingIndicator | Cause::Clock))
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&[1.0, t0]);
        self.done = false;
        let next_time = (self.cause == Cause::Time).then_some(self.at);
        Ok(EventOutcome { next_time, ..EventOutcome::default() })
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.copy_from_slice(&[-self.rate * x[0], 1.0]);
        Ok(())
    }
    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z.fill(match self.cause {
            Cause::FallingIndicator => self.at - t,
            Cause::Clock => x[1] - self.at,
            _ => t - self.at,
        });
        Ok(())
    }
    fn step_completed(&mut self, t: f64, _: &[f64]) -> CallResult<StepAction> {
        let event = self.cause == Cause::Step && !self.done && t >= self.at;
        Ok(StepAction { event, terminate: false })
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let expected = match self.cause {
            Cause::Time => visit.cause.time,
            Cause::Step => visit.cause.step,
            Cause::Input => visit.cause.input,
            Cause::FallingIndicator => visit.crossings == [-1],
            _ => visit.crossings == [1],
        };
        assert!(expected, "{visit:?}");
        x[0] = 10.0;
        self.done = true;
        Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
    }
    fn next_input_stop(&mut self, t: f64) -> Option<InputStop> {
        let jump = self.cause == Cause::Input;
        let has = jump || self.cause == Cause::Step;
        (has && t < self.at).then_some(InputStop { time: self.at, jump })
    }
}

#[test]
fn time_listed_twice_yields_values_before_and_after_event() {
    const CAUSES: [Cause; 6] =
        [Cause::Indicator, Cause::FallingIndicator, Cause::Clock, Cause::Time, Cause::Step, Cause::Input];
    let mut wrong = Vec::new();
    for method in Method::ALL {
        let name = method.name();
        for cause in CAUSES {
            for (start, span) in [(0.0, 2.0), (-1.0, 2.0), (1000.0, 2.0), (0.0, 1e5)] {
                for k in 0..40 {
                    for record_events in [false, true] {
                        // Multiples of the golden ratio avoid regular remainders.
                        let at = start + span * (0.1 + 0.8 * (0.618_033_988_749_895 * f64::from(k)).fract());
                        let mut seen = Recorder::default();
                        let options = Options { method, record_events, ..Options::default() };
                        let mut driver = Driver::new(options).unwrap();
                        let mut system = Jump { cause, at, rate: 0.6 / span, done: false };
                        driver.run(&mut system, start, start + span, &[at, at], &mut seen).unwrap();
                        let rows: Vec<_> = seen.rows.iter().filter(|row| row.1.is_some()).collect();
                        let right = rows.len() == 2
                            && rows[0].3[0] < 2.0
                            && rows[1].3[0] > 9.99
                            && (rows[0].2, rows[1].2) == (Side::Left, Side::Right)
                            && seen.rows.len() == 2;
                        if !right {
                            let late = seen.events[0].time - at;
                            wrong.push(format!(
                                "{name} {cause:?} {start} {span} {at}, late {late:e}: {:?}",
                                seen.rows
                            ));
                        }
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong[..wrong.len().min(12)].join("\n"));
}

/// Two requested times that differ only by rounding count as one time that is listed twice.
#[test]
fn times_within_rounding_count_as_listed_twice() {
    for method in Method::ALL {
        let name = method.name();
        let at = 0.3 * 3.0 + 0.1;
        let times = [at - 4e-16, at + 4e-16];
        let mut seen = Recorder::default();
        let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
        let mut system = Jump { cause: Cause::Time, at, rate: 0.3, done: false };
        driver.run(&mut system, 0.0, 2.0, &times, &mut seen).unwrap();
        assert!(seen.rows[0].3[0] < 2.0 && seen.rows[1].3[0] > 9.99, "{name}: {:?}", seen.rows);
    }
}
