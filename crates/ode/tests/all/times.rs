//! Time of a run inside and outside the model. Sleeping gives lower bounds only.

#![allow(clippy::unwrap_used, clippy::panic)]

use ode::*;
use std::ops::ControlFlow;
use std::thread::sleep;
use std::time::Duration;

const NAP: Duration = Duration::from_millis(2);

/// A decay that is reset at `t = 0.5`, and sleeps in each of the named calls.
struct Sleepy {
    in_derivatives: bool,
    in_events: bool,
    naps: u32,
}

impl Sleepy {
    fn nap(&mut self, wanted: bool) {
        if wanted {
            sleep(NAP);
            self.naps += 1;
        }
    }
}

impl HybridSystem for Sleepy {
    fn n_states(&self) -> usize {
        1
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        self.nap(self.in_events);
        x[0] = 1.0;
        Ok(EventOutcome { next_time: Some(0.5), ..EventOutcome::default() })
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        self.nap(self.in_derivatives);
        dx[0] = -x[0];
        Ok(())
    }
    fn handle_event(&mut self, _: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        self.nap(self.in_events);
        x[0] = 1.0;
        Ok(EventOutcome { states_changed: true, ..EventOutcome::default() })
    }
}

/// Sleeps at every sample.
struct SleepyObserver(u32);

impl Observer for SleepyObserver {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        sleep(NAP);
        self.0 += 1;
        ControlFlow::Continue(())
    }
}

fn naps(n: u32) -> f64 {
    (NAP * n).as_secs_f64()
}

#[test]
fn slow_calls_count_as_time_in_model() {
    for (in_derivatives, in_events) in [(true, false), (false, true)] {
        let mut system = Sleepy { in_derivatives, in_events, naps: 0 };
        let mut driver = Driver::new(Options::default()).unwrap();
        let stats = driver.run(&mut system, 0.0, 1.0, &[], &mut Ignore).unwrap().stats;
        let (seconds, in_model) = (stats.seconds.get(), stats.seconds_in_model.get());
        assert!(system.naps >= if in_events { 2 } else { 20 }, "{}", system.naps);
        // The time of reading the clock is subtracted.
        assert!(in_model > 0.99 * naps(system.naps) && in_model <= seconds, "{in_model} of {seconds}");
    }
}

#[test]
fn observer_time_is_excluded_from_time_in_model() {
    let mut system = Sleepy { in_derivatives: false, in_events: false, naps: 0 };
    let mut observer = SleepyObserver(0);
    let mut driver = Driver::new(Options::default()).unwrap();
    let times = [0.0, 0.3, 0.6, 1.0];
    let stats = driver.run(&mut system, 0.0, 1.0, &times, &mut observer).unwrap().stats;
    assert_eq!(observer.0, 4);
    assert!(stats.seconds.get() - stats.seconds_in_model.get() >= naps(4), "{stats:?}");
    assert!(stats.seconds_in_model.get() > 0.0);
}

#[test]
fn failed_runs_report_times_and_stats_compare_by_counts() {
    let mut system = Sleepy { in_derivatives: true, in_events: false, naps: 0 };
    let limits = Limits { max_right_hand_sides: Some(20), ..Limits::default() };
    let mut driver = Driver::new(Options { limits, ..Options::default() }).unwrap();
    let mut stats = || driver.run(&mut system, 0.0, 1.0, &[], &mut Ignore).unwrap_err().stats;
    let (first, second) = (stats(), stats());
    assert!(first.seconds_in_model.get() > 0.99 * naps(20), "{first:?}");
    assert_eq!(first, second);
    let mut sum = first;
    sum += second;
    assert_eq!(sum.seconds.get(), first.seconds.get() + second.seconds.get());
    assert_eq!(sum.seconds_in_model.get(), first.seconds_in_model.get() + second.seconds_in_model.get());
}
