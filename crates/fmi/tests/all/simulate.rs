//! Simulations of the bundled models against closed forms. The same parameters must give bit-for-bit
//! identical results.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use example_models::ExampleKind;
use fmi::ode::{self, Ignore, Method, Side, Termination};
use fmi::{FmiError, Fmu, Inputs, SharedSimulator, SimulateOptions, SimulationPlan, Simulator, Trajectory};
use std::sync::Arc;
use support::{evil_with, model, model_as};

fn bits(t: &Trajectory) -> Vec<u64> {
    t.columns.iter().flatten().chain(&t.time).map(|v| v.to_bits()).collect()
}

fn close(a: f64, b: f64, tolerance: f64) {
    assert!((a - b).abs() <= tolerance, "{a} is not {b} within {tolerance:e}");
}

#[test]
fn dahlquist_decays_exponentially() {
    let folder = model("dahlquist");
    let options = SimulateOptions::new().final_time(10.0).relative_tolerance(1e-9).start_value("k", 0.5);
    let result = folder.open().simulate(&options).unwrap();
    assert_eq!(result.names, ["x"]);
    assert_eq!((result.time.len(), result.termination), (501, Termination::Finished));
    for (t, x) in result.time.iter().zip(result.get("x").unwrap()) {
        close(*x, (-0.5 * t).exp(), 1e-8);
    }
}

#[test]
fn not_finite_lists_columns_with_times() {
    let options = SimulateOptions::new().final_time(1.0).ncp(4).outputs(["h", "v"]);
    let mut result = model("bouncing_ball").open().simulate(&options).unwrap();
    assert_eq!(result.not_finite(), None);
    result.columns[1][2] = f64::NAN;
    let one = "1 of 2 results is not finite: 'v' (NaN at 0.5 s, first)";
    assert_eq!(result.not_finite().as_deref(), Some(one));
    result.columns[0][3..].fill(f64::INFINITY);
    let two = "2 of 2 results are not finite: 'h' (infinite at 0.75 s, and in all later rows), 'v' (NaN at 0.5 s, \
         first)";
    assert_eq!(result.not_finite().as_deref(), Some(two));
}

/// x' = -x: the error is relative to the size of x, unless the description declares x unbounded.
#[test]
fn unbounded_states_use_the_absolute_tolerance() {
    let run = |start: &str| {
        let folder = evil_with(&[], |xml| {
            let edited = xml.replacen(r#"<Real start="1"/>"#, start, 1);
            assert!(edited.contains(start));
            edited
        });
        let options = SimulateOptions::new().relative_tolerance(1e-6);
        let result = folder.open().simulate(&options).unwrap();
        let error = (result.final_value("y").unwrap().unwrap() - (-1f64).exp()).abs();
        (error, result.stats.right_hand_sides)
    };
    let (bound, cheap) = run(r#"<Real start="1" unbounded="false"/>"#);
    let (free, dear) = run(r#"<Real start="1" unbounded="true"/>"#);
    assert!(free < 0.2 * bound, "{bound:e} and {free:e}");
    assert!(2 * dear > 3 * cheap, "{dear} and {cheap} right-hand sides");
}

#[test]
fn fixed_step_methods_match_closed_forms() {
    let folder = model("dahlquist");
    let fmu = folder.open();
    let run = |method, step| {
        let options = SimulateOptions::new().final_time(1.0).method(method).step_size(step).ncp(1);
        fmu.simulate(&options).unwrap().final_value("x").unwrap().unwrap()
    };
    close(run(Method::Euler, 0.1), 0.9f64.powi(10), 1e-14);
    close(run(Method::Rk4, 0.01), (-1f64).exp(), 1e-10);
}

#[test]
fn bouncing_ball_bounces_at_the_exact_times() {
    let folder = model("bouncing_ball");
    let options = SimulateOptions::new().final_time(3.0).relative_tolerance(1e-6).record_events(true);
    let result = folder.open().simulate(&options).unwrap();
    let first = (2.0f64 / 9.81).sqrt();
    let expected: Vec<f64> =
        (0..11).map(|n| first * (1.0 + 2.0 * 0.7 * (1.0 - 0.7f64.powi(n)) / (1.0 - 0.7))).collect();
    let times: Vec<f64> = result.events.iter().map(|event| event.time).collect();
    assert_eq!(times.len(), expected.len(), "{times:?}");
    for (found, expected) in times.iter().zip(&expected) {
        close(*found, *expected, 1e-10);
    }
    assert!(result.events.iter().all(|event| event.cause.state && !event.cause.time));
    // Both sides of the first bounce: down with v, up with 0.7 v.
    let rows: Vec<usize> = (0..result.time.len()).filter(|&i| result.time[i] == times[0]).collect();
    assert_eq!(rows.len(), 2);
    assert_eq!((result.sides[rows[0]], result.sides[rows[1]]), (Side::Left, Side::Right));
    let v = result.get("v").unwrap();
    close(v[rows[0]], -(2.0f64 * 9.81).sqrt(), 1e-9);
    close(v[rows[1]], -0.7 * v[rows[0]], 1e-12);
    assert_eq!(result.final_value("h").unwrap(), Some(0.0));
}

#[test]
fn stair_climbs_at_time_events_and_ends_the_simulation() {
    let folder = model("stair");
    let options = SimulateOptions::new().start_time(0.0).final_time(20.0).output_interval(0.5);
    let result = folder.open().simulate(&options).unwrap();
    assert_eq!(result.termination, Termination::StoppedByModel);
    assert_eq!(result.end_time, 9.0);
    let events: Vec<f64> = result.events.iter().map(|event| event.time).collect();
    assert_eq!(events, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
    assert!(result.events.iter().all(|event| event.cause.time));
    for (t, counter) in result.time.iter().zip(result.get("counter").unwrap()) {
        assert_eq!(*counter, (1.0 + t.floor()).min(10.0), "t = {t}");
    }
    assert_eq!(result.time.last(), Some(&9.0));
}

fn steps_of_inputs() -> Inputs {
    Inputs::new()
        .table(vec![0.0, 10.0], [("u", vec![1.0, 1.0])])
        .series("gear", vec![0.0, 1.0], vec![1.0, 2.0])
        .series("enabled", vec![0.0, 2.0], vec![1.0, 0.0])
}

#[test]
fn inputs_of_all_types_jump_at_events() {
    let folder = model("switched_input");
    let options = SimulateOptions::new()
        .times([0.0, 0.5, 1.0, 1.0, 2.0, 2.0, 3.0])
        .final_time(3.0)
        .relative_tolerance(1e-10)
        .inputs(steps_of_inputs())
        .outputs(["x", "target", "gear", "limit", "enabled"]);
    let result = folder.open().simulate(&options).unwrap();
    let x = result.get("x").unwrap();
    close(x[1], 2.0 * (1.0 - (-1f64).exp()), 1e-9);
    close(x[3], 1.7293294335267746, 1e-9);
    close(x[5], 3.6926981557493064, 1e-9);
    close(x[6], 3.6926981557493064 * (-2f64).exp(), 1e-9);
    assert_eq!(result.get("target").unwrap(), [2.0, 2.0, 2.0, 4.0, 4.0, 0.0, 0.0]);
    assert_eq!(result.get("gear").unwrap(), [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0]);
    assert_eq!(result.get("enabled").unwrap(), [1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0]);
    let at = |kind: fn(&ode::EventCause) -> bool| -> Vec<f64> {
        result.events.iter().filter(|e| kind(&e.cause)).map(|e| e.time).collect()
    };
    assert_eq!(at(|c| c.input), [1.0, 2.0]);
    let switches = at(|c| c.state);
    assert_eq!(switches.len(), 2, "{switches:?}");
    close(switches[0], 0.5 * 4f64.ln(), 1e-8);
    close(switches[1], 2.6531786991853, 1e-8);
}

#[test]
fn inputs_follow_ramps_jumps_and_functions() {
    let folder = model("switched_input");
    let fmu = folder.open();
    let ramp = |t: f64| 2.0 * 0.3 * (t - 0.5 * (1.0 - (-t / 0.5).exp()));
    let base = SimulateOptions::new().final_time(2.0).relative_tolerance(1e-10);
    let table = Inputs::new().series("u", vec![0.0, 0.7, 2.0], vec![0.0, 0.21, 0.6]);
    let function = Inputs::new().function("u", |t| 0.3 * t);
    for inputs in [table, function] {
        let result = fmu.simulate(&base.clone().inputs(inputs)).unwrap();
        for (t, y) in result.time.iter().zip(result.get("y").unwrap()) {
            close(*y, ramp(*t), 1e-8);
        }
        assert!(result.events.is_empty());
    }
    // A jump of a continuous input between rows of equal time.
    let jump = Inputs::new().series("u", vec![0.0, 1.0, 1.0, 2.0], vec![0.0, 0.0, 1.0, 1.0]);
    let result = fmu.simulate(&base.times([1.0, 1.0, 2.0]).inputs(jump).outputs(["u", "x"])).unwrap();
    assert_eq!(result.get("u").unwrap(), [0.0, 1.0, 1.0]);
    assert_eq!(result.get("x").unwrap()[0], 0.0);
    close(result.get("x").unwrap()[2], 2.0 * (1.0 - (-2f64).exp()), 1e-8);
}

#[test]
fn van_der_pol_reaches_the_reference_values() {
    let folder = model("van_der_pol");
    let fmu = folder.open();
    let states: Vec<String> = fmu
        .description()
        .structure
        .derivatives
        .iter()
        .map(|d| {
            let variables = &fmu.description().variables;
            variables[variables[d.index].derivative.unwrap()].name.clone()
        })
        .collect();
    let options =
        SimulateOptions::new().final_time(20.0).relative_tolerance(1e-11).ncp(1).outputs(states.clone());
    let result = fmu.simulate(&options).unwrap();
    close(result.final_value(&states[0]).unwrap().unwrap(), 2.008149762174948592, 1e-7);
    close(result.final_value(&states[1]).unwrap().unwrap(), -4.250887527320214699e-2, 1e-7);
}

fn furuta(fmu: &Fmu) -> Arc<SimulationPlan> {
    let options = SimulateOptions::new()
        .final_time(40.0)
        .output_interval(0.1)
        .parameters(["armFriction", "pendulumFriction"])
        .outputs(["armJoint.phi", "pendulumJoint.phi"]);
    Arc::new(SimulationPlan::new(fmu, &options).unwrap())
}

#[test]
fn simulator_repeats_a_run_bit_for_bit() {
    let folder = model("furuta");
    let fmu = folder.open();
    let mut simulator = Simulator::new(furuta(&fmu)).unwrap().resetting();
    let first = simulator.trajectory(&[0.012, 0.002]).unwrap();
    let other = simulator.trajectory(&[0.010, 0.001]).unwrap();
    let second = simulator.trajectory(&[0.012, 0.002]).unwrap();
    assert_eq!(bits(&first), bits(&second));
    assert_eq!(first.stats, second.stats);
    assert_ne!(bits(&first), bits(&other));
    let fresh = model("furuta");
    let foreign = Simulator::new(furuta(&fresh.open())).unwrap().trajectory(&[0.010, 0.001]).unwrap();
    assert_eq!(bits(&other), bits(&foreign));
    assert_eq!(simulator.get("armJoint.phi").unwrap(), second.final_value("armJoint.phi").unwrap().unwrap());
}

#[test]
fn shared_simulator_is_bit_for_bit_repeatable_across_threads() {
    let folder = model("furuta");
    let pool = SharedSimulator::new(furuta(&folder.open()));
    let run = |values: [f64; 2]| {
        pool.with_simulator(&base::RunContext::new(), |simulator| simulator.trajectory(&values))
    };
    let truth = bits(&run([0.011, 0.0015]).unwrap());
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| {
                for other in [0.012, 0.013, 0.014] {
                    run([other, 0.002]).unwrap();
                    assert_eq!(bits(&run([0.011, 0.0015]).unwrap()), truth);
                }
            });
        }
    });
}

#[test]
fn observer_ends_a_run_at_any_sample() {
    struct Stop(usize);
    impl ode::Observer for Stop {
        fn sample(&mut self, sample: &ode::Sample<'_>) -> std::ops::ControlFlow<()> {
            if sample.index == Some(self.0) {
                std::ops::ControlFlow::Break(())
            } else {
                std::ops::ControlFlow::Continue(())
            }
        }
    }
    let folder = model("furuta");
    let mut simulator = Simulator::new(furuta(&folder.open())).unwrap();
    let whole = bits(&simulator.trajectory(&[0.012, 0.002]).unwrap());
    for sample in [0, 1, 57, 300] {
        let report = simulator.run(&[0.012, 0.002], &mut Stop(sample)).unwrap();
        assert_eq!(report.termination, Termination::StoppedByObserver);
    }
    assert_eq!(bits(&simulator.trajectory(&[0.012, 0.002]).unwrap()), whole);
}

#[test]
fn furuta_follows_the_reference_values() {
    let folder = model("furuta");
    let options = SimulateOptions::new()
        .times([0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0])
        .relative_tolerance(1e-8)
        .outputs(["armJoint.phi", "armJoint.w", "pendulumJoint.phi", "pendulumJoint.w"]);
    let result = folder.open().simulate(&options).unwrap();
    let expected = [
        [-0.0041406, -0.156646, 1.4964534, 4.519823],
        [-0.6383550, 0.365409, 4.5759667, 4.542071],
        [-0.1262264, 2.133603, 2.9798923, -6.714783],
        [-0.3160798, -0.959566, 2.5627129, 4.794907],
        [-0.2469733, -0.081592, 2.4889246, -1.429577],
        [-0.3010835, 0.0, 3.2130159, -0.261144],
        [-0.3010835, 0.0, 3.1422248, 0.0],
    ];
    for (row, expected) in expected.iter().enumerate() {
        for (column, value) in expected.iter().enumerate() {
            close(result.columns[column][row], *value, 2e-6);
        }
    }
}

#[test]
fn invalid_options_are_typed_errors_with_names() {
    let folder = model("furuta");
    let fmu = folder.open();
    let plan = |options: SimulateOptions| SimulationPlan::new(&fmu, &options.final_time(1.0));
    let new = SimulateOptions::new;
    match plan(new().start_value("armFrictoin", 1.0)) {
        Err(FmiError::UnknownVariable { name, nearest }) => {
            assert_eq!(name, "armFrictoin");
            assert!(nearest.contains(&"armFriction".to_owned()), "{nearest:?}");
        }
        other => panic!("{other:?}"),
    }
    assert!(matches!(plan(new().outputs(["armJoint.phy"])), Err(FmiError::UnknownVariable { .. })));
    assert!(matches!(plan(new().parameters(["nothing"])), Err(FmiError::UnknownVariable { .. })));
    assert!(matches!(plan(new().start_value("armFriction", "text")), Err(FmiError::WrongType { .. })));
    assert!(matches!(plan(new().start_value("armFriction", f64::NAN)), Err(FmiError::NotFinite { .. })));
    assert!(matches!(plan(new().start_value("time", 1.0)), Err(FmiError::NotSettable { .. })));
    let inputs = Inputs::new().function("armFriction", |_| 1.0);
    assert!(matches!(plan(new().inputs(inputs)), Err(FmiError::BadInput { .. })));
    let mut simulator = Simulator::new(furuta(&fmu)).unwrap();
    assert!(matches!(
        simulator.run(&[1.0], &mut Ignore),
        Err(FmiError::Length { expected: 2, found: 1, .. })
    ));
    assert!(matches!(simulator.run(&[f64::NAN, 0.0], &mut Ignore), Err(FmiError::NotFinite { .. })));
    assert!(matches!(plan(new().relative_tolerance(-1.0)), Err(FmiError::Options(_))));
}

#[test]
fn input_errors_contain_variable_row_and_number() {
    let folder = model("switched_input");
    let fmu = folder.open();
    let problem = |inputs: Inputs| {
        let options = SimulateOptions::new().final_time(1.0).inputs(inputs);
        SimulationPlan::new(&fmu, &options).unwrap_err().to_string()
    };
    let new = Inputs::new;
    for (inputs, text) in [
        (
            new().series("u", vec![0.0, 2.0, 1.0], vec![0.0; 3]),
            "input u: times must not decrease: row 2 has 1 after 2",
        ),
        (new().series("u", vec![0.0, 1.0], vec![0.0; 3]), "input u: 3 values for 2 times"),
        (new().series("u", vec![0.0, 1.0], vec![0.0, f64::NAN]), "row 1 (time 1, value NaN)"),
        (new().series("u", vec![], vec![]), "no rows"),
        (new().series("gear", vec![0.0, 1.0], vec![1.0, 1.5]), "input gear: 1.5 in row 1 is not an integer"),
        (new().series("enabled", vec![0.0, 1.0], vec![1.0, 2.0]), "input enabled: 2 in row 1 is not 0 or 1"),
        (new().function("gear", |t| t), "only continuous floating-point inputs"),
        (new().function("u", |t| t).function("u", |t| t), "input u: it is specified twice"),
        (new().function("T", |t| t), "input T: it is neither an input nor a tunable parameter"),
        (new().function("K", |t| t), "only continuous floating-point inputs"),
        (new().function("uu", |t| t), "did you mean u"),
    ] {
        let problem = problem(inputs);
        assert!(problem.contains(text), "{problem}");
    }
    // A function that becomes undefined ends the run at that time.
    let inputs = new().function("u", |t| if t < 0.5 { 1.0 } else { f64::NAN });
    let error = fmu.simulate(&SimulateOptions::new().final_time(1.0).inputs(inputs)).unwrap_err();
    let FmiError::Simulation(error) = error else { panic!("{error}") };
    assert!(error.time <= 0.5 && error.time > 0.4, "{error}");
    let inputs = new().function("u", |_| f64::NAN);
    let error = fmu.simulate(&SimulateOptions::new().final_time(1.0).inputs(inputs)).unwrap_err();
    assert!(matches!(error, FmiError::NotFinite { .. }), "{error}");
}

#[test]
fn outputs_are_selected_by_name_pattern_or_all() {
    let folder = model("switched_input");
    let fmu = folder.open();
    let names = |options: SimulateOptions| fmu.simulate(&options.final_time(0.1).ncp(1)).unwrap().names;
    let chosen = |outputs: &[&str]| names(SimulateOptions::new().outputs(outputs.iter().copied()));
    // Outputs in file order, followed by the state.
    assert_eq!(names(SimulateOptions::new()), ["y", "target", "limit", "x"]);
    assert_eq!(chosen(&["x", "time"]), ["x", "time"]);
    // A variable that a pattern matches again is recorded once.
    assert_eq!(chosen(&["limit", "?", "*i*t"]), ["limit", "x", "y", "u", "K", "T"]);
    let all = chosen(&["all"]);
    assert!(
        all.len() == fmu.description().variables.len() - 1 && !all.contains(&"time".to_owned()),
        "{all:?}"
    );
    assert_eq!(chosen(&["*"]), all);
    let error = |output: &str| {
        let options = SimulateOptions::new().final_time(1.0).outputs([output]);
        SimulationPlan::new(&fmu, &options).unwrap_err()
    };
    assert!(error("arm*").to_string().contains("\"arm*\""));
    assert!(matches!(error("limitt"), FmiError::UnknownVariable { .. }));
}

#[test]
fn model_without_outputs_and_states_records_changing_variables() {
    let folder = model_as("dahlquist", ExampleKind::Fmi1ModelExchange, &[], |xml| {
        xml.replace(r#"causality="output""#, r#"causality="internal""#)
    });
    let result = folder.open().simulate(&SimulateOptions::new().final_time(1.0).ncp(4)).unwrap();
    assert_eq!(result.names, ["x", "der(x)"]);
    close(*result.get("x").unwrap().last().unwrap(), (-1.0f64).exp(), 1e-6);
}

#[test]
fn simulation_supports_a_short_span_at_a_large_time() {
    let folder = model("dahlquist");
    for span in [1e-5, 1e-3] {
        let options = SimulateOptions::new().start_time(1e9).final_time(1e9 + span);
        let result = folder.open().simulate(&options).unwrap();
        assert!(result.time[0] == 1e9 && result.time.windows(2).all(|pair| pair[0] < pair[1]));
    }
}
