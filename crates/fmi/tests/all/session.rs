//! A session returns the same results as a new session, whatever was simulated before and whichever plan it
//! reuses.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::{Fmu, Inputs, Session, SimulateOptions, Trajectory};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use support::{evil, model};

fn bits(trajectory: &Trajectory) -> Vec<Vec<u64>> {
    let columns = trajectory.columns.iter().chain([&trajectory.time]);
    columns.map(|column| column.iter().map(|value| value.to_bits()).collect()).collect()
}

/// Simulates in a new session with these values set.
fn fresh(fmu: &Fmu, values: &[(&str, f64)], options: &SimulateOptions) -> Trajectory {
    let mut session = Session::new(fmu.clone());
    for (name, value) in values {
        session.set(name, *value).unwrap();
    }
    session.simulate(options).unwrap()
}

#[test]
fn session_matches_a_new_session_after_changed_settings() {
    let folder = model("van_der_pol");
    let fmu = folder.open();
    let span = || SimulateOptions::new().final_time(5.0);
    let mut session = Session::new(fmu.clone());
    // The order matters: some cases reuse the plan of the previous one.
    let cases: [(&[(&str, f64)], SimulateOptions); 9] = [
        (&[("mu", 1.0)], span()),
        (&[("mu", 2.0)], span()),
        (&[("mu", 2.0)], span().times([1.0, 5.0])),
        (&[("mu", 2.0)], span().times([2.0, 5.0])),
        (&[("mu", 3.0), ("x0", 1.5)], span().times([2.0, 5.0])),
        (&[("mu", 3.0), ("x0", 1.0)], span().times([2.0, 5.0]).outputs(["x1"])),
        (&[("mu", 0.5), ("x0", 1.0)], span().times([2.0, 5.0]).outputs(["x1"])),
        (&[("mu", 0.5), ("x0", 1.0)], span().relative_tolerance(1e-9)),
        (&[("mu", 0.5), ("x0", 1.0)], span().relative_tolerance(1e-9).method(fmi::ode::Method::Bdf)),
    ];
    for (values, options) in &cases {
        for (name, value) in *values {
            session.set(name, *value).unwrap();
        }
        let found = session.simulate(options).unwrap();
        assert_eq!(bits(&found), bits(&fresh(&fmu, values, options)), "{values:?} {options:?}");
        for (name, value) in *values {
            assert_eq!(session.get(name).is_ok_and(|found| found.as_number() == Some(*value)), *name == "mu");
        }
    }
    // Values of a single simulation do not affect the next one, even if they override others.
    let once = session.simulate(&span().start_value("mu", 4.0)).unwrap();
    assert_eq!(bits(&once), bits(&fresh(&fmu, &[("mu", 4.0), ("x0", 1.0)], &span())));
    let again = session.simulate(&span()).unwrap();
    assert_eq!(bits(&again), bits(&fresh(&fmu, &[("mu", 0.5), ("x0", 1.0)], &span())));
    assert_ne!(bits(&once), bits(&again));
}

#[test]
fn session_rejects_invalid_values_when_a_plan_exists() {
    let folder = model("dahlquist");
    let fmu = folder.open();
    let mut session = Session::new(fmu.clone());
    let options = |k: f64| SimulateOptions::new().final_time(1.0).start_value("k", k);
    session.simulate(&options(1.0)).unwrap();
    let refused = session.simulate(&options(f64::NAN)).unwrap_err().to_string();
    assert!(refused.contains('k') && refused.contains("NaN"), "{refused}");
    let options = SimulateOptions::new().final_time(1.0).start_value("der(x)", 1.0);
    assert!(session.simulate(&options).unwrap_err().to_string().contains("der(x)"));
    let plain = SimulateOptions::new().final_time(1.0);
    assert_eq!(bits(&session.simulate(&plain).unwrap()), bits(&fresh(&fmu, &[], &plain)));
}

#[test]
fn session_uses_changed_inputs() {
    let folder = model("quad_tank");
    let fmu = folder.open();
    let driven = |u: f64| {
        let table = Inputs::new().table(vec![0.0, 10.0], [("u1", vec![u, 3.0]), ("u2", vec![u, 2.0])]);
        SimulateOptions::new().final_time(10.0).inputs(table)
    };
    let mut session = Session::new(fmu.clone());
    for u in [1.0, 1.0, 2.0, 1.0] {
        assert_eq!(bits(&session.simulate(&driven(u)).unwrap()), bits(&fresh(&fmu, &[], &driven(u))), "{u}");
    }
    // A function may change at every call.
    let with = |rate: f64| {
        let inputs = Inputs::new().function("u1", move |t| 1.0 + rate * t).function("u2", |_| 2.0);
        SimulateOptions::new().final_time(10.0).inputs(inputs)
    };
    for rate in [0.1, 0.2] {
        assert_eq!(
            bits(&session.simulate(&with(rate)).unwrap()),
            bits(&fresh(&fmu, &[], &with(rate))),
            "{rate}"
        );
    }
}

#[test]
fn cancel_flag_ends_only_simulations_while_set() {
    let flag = Arc::new(AtomicBool::new(false));
    let options = SimulateOptions::new().final_time(1.0).cancel(Arc::clone(&flag));
    let folder = model("dahlquist");
    let mut session = Session::new(folder.open());
    let first = session.simulate(&options).unwrap();
    flag.store(true, Ordering::Relaxed);
    session.simulate(&options).unwrap_err();
    flag.store(false, Ordering::Relaxed);
    assert_eq!(bits(&session.simulate(&options).unwrap()), bits(&first));
}

/// The model keeps its parameter in a static variable. Its reset function restores the value at
/// instantiation, as in models of Simulink.
#[test]
fn session_resets_start_values_before_every_run() {
    let folder = evil(&["STATIC_PARAMETERS", "RESET_AS_MADE"]);
    let mut session = Session::new(folder.open());
    let plain = SimulateOptions::new().final_time(1.0);
    let truth = bits(&session.simulate(&plain).unwrap());
    for round in 0..3 {
        let set = session.simulate(&plain.clone().start_value("k", 3.0)).unwrap();
        assert_ne!(bits(&set), truth);
        for run in 0..6 {
            assert!(bits(&session.simulate(&plain).unwrap()) == truth, "round {round}, run {run}");
        }
    }
}
