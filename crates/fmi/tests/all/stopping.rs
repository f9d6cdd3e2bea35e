//! A run can be stopped from outside wherever the model is called repeatedly: in the rounds of an event
//! iteration, and at the rows inside a step.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use example_models::ExampleKind::{self, Fmi2ModelExchange, Fmi3};
use fmi::ode::{ErrorKind, Ignore, Observer, Sample, Termination};
use fmi::{FmiError, Fmu, InterfaceChoice, SimulateOptions, SimulationPlan, Simulator};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use support::{faulty, fixture_with, model_as};

const KINDS: [InterfaceChoice; 2] = [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation];

/// Values of k for which the event iteration of `tests/evil/model.c` never ends, with the time from which it
/// is endless: t = 0 and t = 0.25.
const ENDLESS: [(f64, f64); 2] = [(18.0, 0.0), (23.0, 0.25)];

const LIMIT: Duration = Duration::from_millis(400);

/// Way in which a run is stopped.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Way {
    Observer,
    Flag,
    Limit,
}

const WAYS: [Way; 3] = [Way::Observer, Way::Flag, Way::Limit];

/// Stops a run at poll number `at`, counted from the previous sample. Counts later polls.
struct Ends {
    way: Way,
    at: u32,
    polls: u32,
    after: u32,
    flag: Arc<AtomicBool>,
}

impl Ends {
    fn new(way: Way, at: u32) -> Self {
        Self { way, at, polls: 0, after: 0, flag: Arc::default() }
    }

    fn options(&self) -> SimulateOptions {
        let options = SimulateOptions::new().final_time(1.0).output_interval(0.05);
        match self.way {
            Way::Observer => options,
            Way::Flag => options.cancel(Arc::clone(&self.flag)),
            Way::Limit => options.timeout(LIMIT),
        }
    }
}

impl Observer for Ends {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        if self.polls < self.at {
            self.polls = 0;
        }
        ControlFlow::Continue(())
    }

    fn poll(&mut self) -> ControlFlow<()> {
        self.after += u32::from(self.polls >= self.at);
        self.polls += 1;
        if self.polls == self.at {
            match self.way {
                Way::Observer => return ControlFlow::Break(()),
                Way::Flag => self.flag.store(true, Ordering::Relaxed),
                Way::Limit => {
                    let began = Instant::now();
                    while began.elapsed() < LIMIT {
                        std::thread::sleep(LIMIT - began.elapsed().min(LIMIT));
                    }
                }
            }
        }
        ControlFlow::Continue(())
    }
}

/// Runs until an event iteration is stopped in this way, and returns the time of the stop.
fn ended(fmu: &Fmu, way: Way, options: impl Fn(SimulateOptions) -> SimulateOptions, values: &[f64]) -> f64 {
    let mut ends = Ends::new(way, 30);
    let plan = SimulationPlan::new(fmu, &options(ends.options())).unwrap();
    let mut simulator = Simulator::new(Arc::new(plan)).unwrap();
    let ended = simulator.run(values, &mut ends);
    assert_eq!(ends.after, 0, "{way:?}: {ended:?}");
    let time = match (ended, way) {
        (Ok(report), Way::Observer) if report.termination == Termination::StoppedByObserver => report.time,
        (Err(FmiError::Simulation(error)), _) => {
            let is_right = match error.kind {
                ErrorKind::Cancelled => way == Way::Flag,
                ErrorKind::TimedOut(limit) => way == Way::Limit && limit == LIMIT,
                _ => false,
            };
            assert!(is_right, "{way:?}: {error}");
            error.time
        }
        (ended, _) => panic!("{way:?}: {ended:?}"),
    };
    // An instance stopped inside its events is not used again.
    if way == Way::Observer && !values.is_empty() {
        simulator.run(&[1.0], &mut Ignore).unwrap();
    }
    time
}

#[test]
fn endless_event_iteration_can_be_stopped() {
    let models: [(ExampleKind, InterfaceChoice); 3] = [
        (Fmi2ModelExchange, InterfaceChoice::ModelExchange),
        (Fmi3, InterfaceChoice::ModelExchange),
        (Fmi3, InterfaceChoice::CoSimulation),
    ];
    for (version, kind) in models {
        for (k, time) in ENDLESS {
            for way in WAYS {
                // A separate library for each run.
                let folder = faulty(version, &[]);
                let found = ended(&folder.open(), way, |options| options.kind(kind).parameters(["k"]), &[k]);
                assert!((found - time).abs() < 1e-12, "{version:?} {kind:?} {k} {way:?}: {found}");
            }
        }
    }
}

#[test]
fn endless_clock_iteration_can_be_stopped() {
    for time in [0.0, 0.5] {
        for kind in KINDS {
            for way in WAYS {
                let folder = fixture_with("clocks", &[&format!("ENDLESS={time:?}")], |xml| xml);
                let found = ended(&folder.open(), way, |options| options.kind(kind), &[]);
                assert!((found - time).abs() < 1e-12, "{kind:?} {way:?}: {found}");
            }
        }
    }
}

/// Sets a flag at the tenth sample, and counts all samples.
struct Rows(Arc<AtomicBool>, usize);

impl Observer for Rows {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        self.1 += 1;
        self.0.store(self.1 == 10, Ordering::Relaxed);
        ControlFlow::Continue(())
    }
}

#[test]
fn cancelled_run_delivers_no_further_rows_within_a_step() {
    let only_whole_steps = |xml: String| {
        xml.replace(
            "canHandleVariableCommunicationStepSize=\"true\"",
            "canHandleVariableCommunicationStepSize=\"false\"",
        )
    };
    let folder = model_as("dahlquist", Fmi3, &[], only_whole_steps);
    for kind in KINDS {
        let mut rows = Rows(Arc::default(), 0);
        let options = SimulateOptions::new()
            .kind(kind)
            .method(fmi::ode::Method::Rk4)
            .step_size(0.5)
            .final_time(1.0)
            .ncp(100)
            .cancel(Arc::clone(&rows.0));
        let plan = SimulationPlan::new(&folder.open(), &options).unwrap();
        let error = Simulator::new(Arc::new(plan)).unwrap().run(&[], &mut rows).unwrap_err();
        assert!(
            matches!(&error, FmiError::Simulation(error) if matches!(error.kind, ErrorKind::Cancelled)),
            "{kind:?}: {error}"
        );
        assert_eq!(rows.1, 10, "{kind:?}");
    }
}
