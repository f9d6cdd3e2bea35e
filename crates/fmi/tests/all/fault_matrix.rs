//! Every fault that does not end the process, in every version and with both interfaces. Each results in a
//! typed error with the call, the time and the log of the FMU. The library remains usable for the next run
//! and the next instance.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use example_models::ExampleKind::{
    self, Fmi1CoSimulation, Fmi1ModelExchange, Fmi2CoSimulation, Fmi2ModelExchange, Fmi3,
};
use fmi::ode::{ErrorKind, Ignore, Report, Termination};
use fmi::{FmiError, Fmu, InterfaceChoice, SimulateOptions, SimulationPlan, Simulator, Status};
use std::sync::Arc;
use support::faulty;

const ALL: [(ExampleKind, InterfaceChoice); 6] = [
    (Fmi1ModelExchange, InterfaceChoice::ModelExchange),
    (Fmi1CoSimulation, InterfaceChoice::CoSimulation),
    (Fmi2ModelExchange, InterfaceChoice::ModelExchange),
    (Fmi2CoSimulation, InterfaceChoice::CoSimulation),
    (Fmi3, InterfaceChoice::ModelExchange),
    (Fmi3, InterfaceChoice::CoSimulation),
];

fn plan(fmu: &Fmu, kind: InterfaceChoice) -> Arc<SimulationPlan> {
    let options = SimulateOptions::new().kind(kind).final_time(1.0).parameters(["k"]);
    Arc::new(SimulationPlan::new(fmu, &options).unwrap())
}

/// Expected end of a run with a fault.
#[derive(Debug, Clone, Copy)]
enum Ends {
    /// A failed call with this suffix of its name, a status, a time in this range, and this text in the log.
    Call(&'static str, Status, [f64; 2], &'static str),
    /// An error of the integration that satisfies this condition.
    Integration(fn(&ErrorKind) -> bool),
    /// A stopped event iteration.
    Iteration,
    /// A normal end with this reason. Non-finite values are left to the reader of the results.
    Well(Termination),
    /// Not run, because the FMU processes 10^12 events within one step and does not return.
    NotHere,
}

use Ends::{Call, Integration, Iteration, NotHere, Well};

const START: [f64; 2] = [0.0, 0.0];
const MIDDLE: [f64; 2] = [0.4, 0.6];
const QUARTER: [f64; 2] = [0.24, 0.25];

fn step_too_small(kind: &ErrorKind) -> bool {
    matches!(kind, ErrorKind::StepTooSmall { discarded: true })
}

/// Faults of `tests/evil/model.c`: the value of k for each fault, its name, and its expected end for model
/// exchange and for co-simulation.
const FAULTS: [(f64, &str, Ends, Ends); 12] = [
    (
        10.0,
        "NO_START",
        Call("", Status::Error, START, "no solution for k = 10"),
        Call("", Status::Error, START, "no solution for k = 10"),
    ),
    (
        11.0,
        "DISCARDS_START",
        Call("", Status::Error, START, "cannot be evaluated at its start values"),
        Call("", Status::Error, START, "cannot be evaluated at its start values"),
    ),
    (
        12.0,
        "ERROR_LATE",
        Call("Derivatives", Status::Error, MIDDLE, "broken beyond t = 0.5"),
        Call("DoStep", Status::Error, MIDDLE, "broken beyond t = 0.5"),
    ),
    (13.0, "DISCARD_LATE", Integration(step_too_small), Call("DoStep", Status::Discard, MIDDLE, "DoStep")),
    (14.0, "NAN_LATE", Integration(step_too_small), Well(Termination::Finished)),
    (15.0, "INFINITE_LATE", Integration(step_too_small), Well(Termination::Finished)),
    (16.0, "HUGE_VALUES", Well(Termination::Finished), Well(Termination::Finished)),
    (17.0, "EVENT_STORM", Integration(|kind| matches!(kind, ErrorKind::Chattering { .. })), NotHere),
    (18.0, "ENDLESS_EVENTS", Iteration, Iteration),
    (
        19.0,
        "PAST_EVENT",
        Integration(|kind| matches!(kind, ErrorKind::EventInThePast(time) if *time == -1.0)),
        Call("", Status::Error, START, ""),
    ),
    (20.0, "ENDS_ITSELF", Well(Termination::StoppedByModel), Well(Termination::StoppedByModel)),
    (
        21.0,
        "FAILING_EVENT",
        Call("", Status::Error, QUARTER, "no event at t = 0.25"),
        Call("", Status::Error, QUARTER, "no event at t = 0.25"),
    ),
];

fn check(what: &str, ends: Ends, outcome: &Result<Report, FmiError>) {
    let shown = outcome.as_ref().map(|report| report.termination);
    match (ends, outcome) {
        (Well(expected), Ok(report)) => assert_eq!(report.termination, expected, "{what}"),
        (Integration(holds), Err(FmiError::Simulation(error))) => {
            assert!(holds(&error.kind), "{what}: {error}")
        }
        (Iteration, Err(error)) => {
            let text = error.to_string();
            assert!(
                text.contains("did not end within 100 iterations") || text.contains("do not end"),
                "{what}: {text}"
            );
        }
        (Call(call, status, [from, to], words), Err(error)) => {
            let Some(failure) = error.call_failure() else { panic!("{what}: {error}") };
            assert!(failure.call.starts_with("fmi") && failure.call.ends_with(call), "{what}: {error}");
            assert_eq!(failure.status, status, "{what}: {error}");
            assert!(failure.time.is_some_and(|time| time >= from && time <= to), "{what}: {error}");
            assert!(failure.log.iter().any(|line| line.text.contains(words)), "{what}: {error}");
            // The message contains all data.
            let text = error.to_string();
            for part in [failure.call, &status.to_string(), words, "t = "] {
                assert!(text.contains(part), "{what}: {text}");
            }
        }
        _ => panic!("{what}: {shown:?}"),
    }
}

#[test]
fn faults_return_typed_errors_and_keep_library_usable() {
    for version in [Fmi1ModelExchange, Fmi1CoSimulation, Fmi2ModelExchange, Fmi2CoSimulation, Fmi3] {
        let folder = faulty(version, &[]);
        for kind in ALL.iter().filter(|(of, _)| *of == version).map(|(_, kind)| *kind) {
            let fmu = folder.open();
            let mut simulator = Simulator::new(plan(&fmu, kind)).unwrap();
            let truth = simulator.trajectory(&[1.0]).unwrap();
            let error = truth.final_value("x").unwrap().unwrap() - (-1f64).exp();
            assert!(error.abs() < 1e-6, "{version:?} {kind:?}: {error}");
            for (k, name, exchange, stepping) in FAULTS {
                let what = format!("{name} of {version:?} {kind:?}");
                let ends = match (version, kind) {
                    (_, InterfaceChoice::ModelExchange) => exchange,
                    // In FMI 1.0, a rejected step may also mean that the model has ended the simulation.
                    (Fmi1CoSimulation, _) if name == "DISCARD_LATE" => Well(Termination::StoppedByModel),
                    _ => stepping,
                };
                if matches!(ends, NotHere) {
                    continue;
                }
                let first = simulator.run(&[k], &mut Ignore);
                check(&what, ends, &first);
                assert_eq!(simulator.trajectory(&[1.0]).unwrap(), truth, "after {what}");
                // Repeat the fault in a new instance, next to a healthy one.
                let mut other = Simulator::new(plan(&fmu, kind)).unwrap();
                let second = other.run(&[k], &mut Ignore);
                assert_eq!(
                    first.map(|_| ()).map_err(|error| error.to_string()),
                    second.map(|_| ()).map_err(|error| error.to_string()),
                    "{what}"
                );
                assert_eq!(simulator.trajectory(&[1.0]).unwrap(), truth, "beside {what}");
            }
            drop(simulator);
            assert_eq!(
                Simulator::new(plan(&folder.open(), kind)).unwrap().trajectory(&[1.0]).unwrap(),
                truth
            );
        }
    }
}

/// Faults that end or hang the process are built and can be inspected, because inspection runs no code of the
/// FMU.
#[test]
fn crashing_model_can_be_inspected() {
    for version in [Fmi1CoSimulation, Fmi2ModelExchange, Fmi3] {
        let folder = faulty(version, &["CRASHES_WHEN_LOADED"]);
        let fmu = folder.open();
        assert!(fmu.description().variable("x").is_some());
        plan(&fmu, InterfaceChoice::Auto);
    }
}
