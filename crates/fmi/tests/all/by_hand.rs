//! Manually driven instances behave as in a simulation, and a saved state contains everything that affects a
//! later run.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::ode::{Method, Options};
use fmi::worker::Frame;
use fmi::{
    CoSimulation, ContinuousTime, DrivenInstance, FmiError, Fmu, Inputs, Instance, InstanceAnswer,
    InstanceCall, InstanceOptions, InstancePhase, Instantiated, Integrated, InterfaceChoice, InterfaceKind,
    MAX_EVENT_ITERATIONS, SimulateOptions, StepMode, Value,
};
use support::{Folder, arrays, fixture};

fn sampled() -> Folder {
    fixture("sampled", |xml| xml)
}

/// Returns an instance in continuous-time mode at `start`.
fn begun(instance: Instance<Instantiated>, start: f64) -> Instance<ContinuousTime> {
    let mut instance =
        instance.enter_initialization(start, None, None).unwrap().exit_initialization().unwrap();
    instance.update_discrete_states(MAX_EVENT_ITERATIONS).unwrap();
    instance.enter_continuous_time().unwrap()
}

fn to(instance: Instance<ContinuousTime>, start: f64, end: f64, method: Method) -> Instance<ContinuousTime> {
    match instance.integrate(start, end, Options { method, ..Options::default() }).unwrap() {
        Integrated::Reached { instance } => instance,
        ended => panic!("{ended:?}"),
    }
}

fn number<P: fmi::Readable, K>(instance: &mut Instance<P, K>, name: &str) -> f64 {
    instance.get(name).unwrap().as_number().unwrap()
}

/// Checks n after k ticks, and x, the integral of n. The times of steps accumulate rounding errors.
#[test]
fn step_includes_tick_rounded_past_its_end() {
    let folder = sampled();
    let fmu = folder.open();
    for method in Method::ALL {
        for (start, period, step) in
            [(0.0, 0.1, 0.1), (0.0, 0.7, 0.7), (-2.0, 0.3, 0.1), (-5.0, 0.1, 0.1), (1e6, 0.1, 0.1)]
        {
            let mut instance = fmu.instantiate().unwrap();
            instance.set("period", period).unwrap();
            let (mut instance, mut time) = (begun(instance, start), start);
            for k in 1..=100 {
                instance = to(instance, time, time + step, method);
                time += step;
                let n = (step * f64::from(k) / period + 1e-6).floor();
                let what = format!("{} to {time} by {period}", method.name());
                assert_eq!(number(&mut instance, "n"), n, "{what}");
                let x = period * 0.5 * n * (n - 1.0) + n * (f64::from(k) * step - n * period);
                let found = number(&mut instance, "x");
                assert!((found - x).abs() < 1e-6 * x.max(1.0), "{what}: {found}, not {x}");
            }
        }
    }
}

#[test]
fn simulation_includes_tick_rounded_past_its_end() {
    let folder = sampled();
    let fmu = folder.open();
    for method in Method::ALL {
        for k in 1..=100_u32 {
            let end: f64 = format!("{:.1}", 0.1 * f64::from(k)).parse().unwrap();
            let options = SimulateOptions::new().final_time(end).times([end]).outputs(["n"]).method(method);
            let result = fmu.simulate(&options.kind(InterfaceChoice::ModelExchange)).unwrap();
            assert_eq!(result.get("n").unwrap(), [f64::from(k)], "{} to {end}", method.name());
        }
    }
    // In co-simulation no step exceeds the end. All earlier ticks are present, each at its row.
    let times: Vec<f64> =
        (1..=100_u32).map(|k| format!("{:.1}", 0.1 * f64::from(k)).parse().unwrap()).collect();
    for step in [None, Some(0.1), Some(0.05)] {
        let mut options = SimulateOptions::new().final_time(10.05).times(times.clone()).outputs(["n"]);
        options.run.step_size = step;
        let result = fmu.simulate(&options.kind(InterfaceChoice::CoSimulation)).unwrap();
        let expected: Vec<f64> = (1..=100_u32).map(f64::from).collect();
        assert_eq!(result.get("n").unwrap(), expected, "{step:?}");
    }
}

/// Compares with an instance that was never saved.
#[test]
fn restored_state_continues_as_unsaved_instance() {
    let folder = sampled();
    let fmu = folder.open();
    let method = Method::Auto;
    let plain = |ends: &[f64]| {
        let mut instance = begun(fmu.instantiate().unwrap(), 0.0);
        for pair in ends.windows(2) {
            instance = to(instance, pair[0], pair[1], method);
        }
        (number(&mut instance, "x"), number(&mut instance, "n"), instance.next_event())
    };
    for at in [0.05, 0.3, 0.55] {
        let mut instance = to(begun(fmu.instantiate().unwrap(), 0.0), 0.0, at, method);
        let saved = instance.save_state().unwrap();
        instance = to(instance, at, 1.05, method);
        instance.restore_state(&saved).unwrap();
        let mut instance = to(instance, at, 0.85, method);
        let found = (number(&mut instance, "x"), number(&mut instance, "n"), instance.next_event());
        assert_eq!(found, plain(&[0.0, at, 0.85]), "{at}");
        // Also after a reset.
        let mut instance = to(begun(instance.reset().unwrap(), 0.0), 0.0, 0.2, method);
        instance.restore_state(&saved).unwrap();
        let mut instance = to(instance, at, 0.85, method);
        let found = (number(&mut instance, "x"), number(&mut instance, "n"), instance.next_event());
        assert_eq!(found, plain(&[0.0, at, 0.85]), "{at} after a reset");
    }
}

#[test]
fn reset_and_restore_discard_later_start_values() {
    let folder = sampled();
    let fmu = folder.open();
    let period = |instance: Instance<Instantiated>| {
        number(&mut instance.enter_initialization(0.0, None, None).unwrap(), "period")
    };
    let mut instance = fmu.instantiate().unwrap();
    instance.set("period", 0.5).unwrap();
    assert_eq!(period(instance.reset().unwrap()), 0.1);
    let mut instance = fmu.instantiate().unwrap();
    instance.set("period", 0.25).unwrap();
    let saved = instance.save_state().unwrap();
    instance.set("period", 0.5).unwrap();
    instance.restore_state(&saved).unwrap();
    assert_eq!(period(instance), 0.25);
}

#[test]
fn arrays_and_structural_parameters_can_be_set_in_any_order() {
    let folder = arrays();
    let fmu = folder.open();
    let two = || Value::Array(vec![3.0.into(), 4.0.into()]);
    for is_array_first in [false, true] {
        let mut instance = fmu.instantiate().unwrap();
        if is_array_first {
            instance.set("k", two()).unwrap();
        }
        instance.set("n", 2).unwrap();
        if !is_array_first {
            instance.set("k", two()).unwrap();
        }
        let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
        assert_eq!(instance.get("k").unwrap(), two());
    }
    // An array that does not fit at the end is rejected.
    let mut instance = fmu.instantiate().unwrap();
    instance.set("k", two()).unwrap();
    let error = instance.enter_initialization(0.0, None, None).unwrap_err().to_string();
    assert!(error.contains("array of different size"), "{error}");
}

/// x' = n + 10 on. "on" is true if u was above 0.5 at the last event. At 1 s, u jumps.
#[test]
fn input_change_across_zero_between_steps_is_an_event() {
    let folder = sampled();
    let fmu = folder.open();
    let by_hand = |values: &[(f64, f64)]| {
        let mut instance = fmu.instantiate().unwrap();
        instance.set("period", 10.0).unwrap();
        let mut instance = begun(instance, 0.0);
        for (k, (first, second)) in values.iter().enumerate() {
            instance.set("u", *first).unwrap();
            instance.set("u", *second).unwrap();
            instance = to(instance, k as f64, k as f64 + 1.0, Method::Auto);
        }
        [number(&mut instance, "on"), number(&mut instance, "x"), number(&mut instance, "visits")]
    };
    assert_eq!(by_hand(&[(0.0, 0.4), (0.2, 0.5)]), [0.0, 0.0, 1.0]);
    let [on, x, visits] = by_hand(&[(0.0, 0.0), (0.0, 1.0), (1.0, 1.0)]);
    assert!(on == 1.0 && (x - 20.0).abs() < 1e-9 && visits == 2.0, "{on} {x} {visits}");
    let [on, x, visits] = by_hand(&[(1.0, 1.0), (1.0, 0.0), (1.0, 0.0)]);
    assert!(on == 0.0 && (x - 10.0).abs() < 1e-9 && visits == 3.0, "{on} {x} {visits}");
    // As in a simulation.
    let inputs = Inputs::new().series("u", vec![0.0, 1.0, 1.0, 3.0], vec![0.0, 0.0, 1.0, 1.0]);
    let options =
        SimulateOptions::new().start_value("period", 10.0).final_time(3.0).inputs(inputs).outputs(["x"]);
    let simulated = fmu.simulate(&options.kind(InterfaceChoice::ModelExchange)).unwrap();
    assert!((simulated.final_value("x").unwrap().unwrap() - 20.0).abs() < 1e-9);
}

fn stepping(fmu: &Fmu) -> Instance<StepMode, CoSimulation> {
    let instance = fmu.instantiate_co_simulation(&InstanceOptions::default()).unwrap();
    instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap()
}

#[test]
fn discrete_inputs_of_co_simulation_are_set_in_event_mode() {
    let folder = sampled();
    let fmu = folder.open();
    let mut instance = stepping(&fmu);
    instance.do_step(0.0, 0.0625).unwrap();
    instance.set("gear", 2.0).unwrap();
    assert_eq!(number(&mut instance, "gear"), 2.0);
    // Pending inputs are part of the state.
    let saved = instance.save_state().unwrap();
    instance.set("gear", 3.0).unwrap();
    instance.do_step(0.0625, 0.03125).unwrap();
    assert_eq!(number(&mut instance, "x"), 300.0 * 0.03125);
    instance.restore_state(&saved).unwrap();
    let step = instance.do_step(0.0625, 0.0625).unwrap();
    assert!(step.complete && step.event);
    assert_eq!((number(&mut instance, "x"), number(&mut instance, "visits")), (12.5, 2.0));
    // Together with the events that the model requests, in one visit.
    instance.set("gear", 0.0).unwrap();
    assert_eq!(instance.handle_events(0.125).unwrap().next_time, Some(0.2));
    assert_eq!(instance.next_event(), Some(0.2));
    assert_eq!((number(&mut instance, "n"), number(&mut instance, "visits")), (1.0, 3.0));
    instance.do_step(0.125, 0.0625).unwrap();
    assert_eq!((number(&mut instance, "x"), number(&mut instance, "visits")), (12.5 + 0.0625, 3.0));
}

/// Manually driven clocks tick as often as in a simulation. The triggered input clock is set explicitly.
#[test]
fn manual_clock_ticks_match_simulation() {
    let folder = fixture("clocks", |xml| xml);
    let fmu = folder.open();
    let clocks = ["sample", "third", "counted", "growing", "later", "optional", "retuned"];
    let end = 1.0625;
    let counts = |get: &mut dyn FnMut(&str) -> f64| clocks.map(|clock| get(&format!("n_{clock}")));
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let names: Vec<String> =
            clocks.iter().map(|clock| format!("n_{clock}")).chain(["x".to_owned()]).collect();
        let options =
            SimulateOptions::new().kind(kind).final_time(end).relative_tolerance(1e-10).outputs(names);
        let result = fmu.simulate(&options).unwrap();
        let expected = counts(&mut |name| result.final_value(name).unwrap().unwrap());
        let x = result.final_value("x").unwrap().unwrap();
        for step in [end, 0.53125, 0.0625] {
            let mut time = 0.0;
            let (found, found_x) = if kind == InterfaceChoice::ModelExchange {
                let mut instance = begun(fmu.instantiate().unwrap(), 0.0);
                while time < end {
                    instance = to(instance, time, time + step, Method::Dop853);
                    time += step;
                }
                (counts(&mut |name| number(&mut instance, name)), number(&mut instance, "x"))
            } else {
                let mut instance = stepping(&fmu);
                while time < end {
                    let outcome = instance.do_step(time, step).unwrap();
                    time += step;
                    assert!(outcome.complete, "{outcome:?}");
                    if outcome.event {
                        instance.handle_events(time).unwrap();
                    }
                }
                (counts(&mut |name| number(&mut instance, name)), number(&mut instance, "x"))
            };
            assert_eq!(found, expected, "{kind:?} in steps of {step}");
            assert!((found_x - x).abs() < 1e-5, "{kind:?} in steps of {step}: {found_x}, not {x}");
        }
    }
}

/// Sends calls and answers through serialization, as to another process.
struct Driver(DrivenInstance, Vec<f64>);

impl Driver {
    fn call(&mut self, call: InstanceCall, given: &[f64]) -> Result<InstanceAnswer, FmiError> {
        let call = Frame::of(&call).unwrap().head().unwrap();
        let answer = self.0.call(call, given, &mut self.1, &base::RunContext::new())?;
        Ok(Frame::of(&answer).unwrap().head().unwrap())
    }

    fn phase(&mut self) -> InstancePhase {
        match self.call(InstanceCall::Phase, &[]).unwrap() {
            InstanceAnswer::Phase(phase) => phase,
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn driven_instance_rejects_calls_of_other_phases() {
    let folder = sampled();
    let fmu = Fmu::open(folder.path()).unwrap();
    let new = DrivenInstance::new(&fmu, InterfaceKind::ModelExchange, &InstanceOptions::default()).unwrap();
    let mut driver = Driver(new, Vec::new());
    let refused = driver.call(InstanceCall::States, &[]).unwrap_err().to_string();
    assert_eq!(
        refused,
        "reading the states requires the phase event or continuous, but the instance is in the phase \
         instantiated"
    );
    let enter = InstanceCall::EnterInitialization { start_time: 0.0, stop_time: None, tolerance: None };
    let lead = [
        (enter.clone(), InstancePhase::Initialization),
        (InstanceCall::ExitInitialization, InstancePhase::Event),
        (InstanceCall::UpdateDiscreteStates, InstancePhase::Event),
        (InstanceCall::EnterContinuousTime, InstancePhase::Continuous),
    ];
    for (call, phase) in lead {
        driver.call(call, &[]).unwrap();
        assert_eq!(driver.phase(), phase);
    }
    assert!(matches!(driver.call(enter, &[]), Err(FmiError::WrongPhase { phase: "continuous", .. })));
    driver.call(InstanceCall::States, &[]).unwrap();
    let states = driver.1.clone();
    let shifted: Vec<f64> = states.iter().map(|x| x + 1.0).collect();
    let InstanceAnswer::State(number) = driver.call(InstanceCall::SaveState(Vec::new()), &[]).unwrap() else {
        panic!("no state");
    };
    driver.call(InstanceCall::SetStates, &shifted).unwrap();
    driver.call(InstanceCall::RestoreState(number), &[]).unwrap();
    driver.call(InstanceCall::States, &[]).unwrap();
    assert_eq!(driver.1, states);
    assert!(matches!(driver.call(InstanceCall::RestoreState(number + 1), &[]), Err(FmiError::ForeignState)));
    // Invalid arguments do not free the instance; a cancelled integration does.
    let integrate = |relative_tolerance| InstanceCall::Integrate {
        start: 0.0,
        end: 1.0,
        method: Method::Auto,
        relative_tolerance,
        step_size: None,
    };
    assert!(matches!(driver.call(integrate(-1.0), &[]), Err(FmiError::Options(_))));
    assert_eq!(driver.phase(), InstancePhase::Continuous);
    let over = base::RunContext::new().within(Some(std::time::Duration::ZERO));
    let cancelled = driver.0.call(integrate(1e-6), &[], &mut Vec::new(), &over);
    assert!(matches!(cancelled, Err(FmiError::Cancelled)), "{cancelled:?}");
    assert!(matches!(driver.call(InstanceCall::Reset, &[]), Err(FmiError::Freed(_))));
    assert_eq!(driver.phase(), InstancePhase::Closed);
}
