//! Instances that the test controls: phases, values, saved states, directional derivatives.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::{FmiError, Fmu, FmuCache, MAX_EVENT_ITERATIONS, OpenOptions, Session, SimulateOptions, Value};
use std::time::Duration;
use support::{evil, model};

/// Instances are `Send` but not `Sync`, which would let two threads call into one instance.
#[test]
fn instances_move_between_threads() {
    fn is_send<T: Send>() {}
    is_send::<fmi::Instance<fmi::Instantiated>>();
    is_send::<fmi::Simulator>();
    is_send::<Session>();
    fn is_shared<T: Send + Sync>() {}
    is_shared::<Fmu>();
    is_shared::<fmi::SharedSimulator>();
    is_shared::<fmi::SimulationPlan>();
    is_shared::<FmuCache>();
    is_shared::<FmiError>();
}

#[test]
fn instance_supports_explicit_euler_by_hand() {
    let folder = model("dahlquist");
    let fmu = folder.open();
    let mut instance = fmu.instantiate().unwrap();
    instance.set("k", 2.0).unwrap();
    let instance = instance.enter_initialization(0.0, Some(1.0), Some(1e-6)).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    let outcome = instance.update_discrete_states(MAX_EVENT_ITERATIONS).unwrap();
    assert!(!outcome.terminate && outcome.next_time.is_none());
    let mut instance = instance.enter_continuous_time().unwrap();
    let (mut x, mut dx) = ([0.0], [0.0]);
    instance.get_continuous_states(&mut x).unwrap();
    for k in 1..=10 {
        instance.get_derivatives(&mut dx).unwrap();
        x[0] += 0.1 * dx[0];
        instance.set_time(0.1 * f64::from(k)).unwrap();
        instance.set_continuous_states(&x).unwrap();
        assert_eq!(instance.completed_integrator_step().unwrap(), (false, false));
    }
    assert!((x[0] - 0.8f64.powi(10)).abs() < 1e-15);
    assert_eq!(instance.get("x").unwrap(), Value::Real(x[0]));
    assert!(matches!(instance.get("z"), Err(FmiError::UnknownVariable { .. })));
    let mut ended = instance.terminate().unwrap();
    assert!(matches!(ended.set("k", 1.0), Err(FmiError::NotSettable { .. })));
    let mut again = ended.reset().unwrap().enter_initialization(0.0, None, None).unwrap();
    assert_eq!(again.get("k").unwrap(), Value::Real(1.0));
}

#[test]
fn set_accepts_variables_as_the_standard_allows() {
    let folder = model("switched_input");
    let mut instance = folder.open().instantiate().unwrap();
    instance.set("T", 0.25).unwrap();
    instance.set("gear", 3).unwrap();
    assert!(matches!(instance.set("y", 1.0), Err(FmiError::NotSettable { .. })));
    assert!(matches!(instance.set("gear", 1.5), Err(FmiError::WrongType { .. })));
    assert!(matches!(instance.set("u", f64::NAN), Err(FmiError::NotFinite { .. })));
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
    instance.set("u", 2.0).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    instance.set("K", 4.0).unwrap();
    instance.set("enabled", false).unwrap();
    assert!(matches!(instance.set("T", 1.0), Err(FmiError::NotSettable { .. })));
    instance.update_discrete_states(MAX_EVENT_ITERATIONS).unwrap();
    let mut instance = instance.enter_continuous_time().unwrap();
    instance.set("u", 3.0).unwrap();
    assert!(matches!(instance.set("gear", 1), Err(FmiError::NotSettable { .. })));
    assert!(matches!(instance.set("K", 1.0), Err(FmiError::NotSettable { .. })));
    assert_eq!(instance.get("gear").unwrap(), Value::Integer(3));
    assert_eq!(instance.get("enabled").unwrap(), Value::Boolean(false));
}

#[test]
fn instance_rejects_slices_of_wrong_length() {
    let folder = model("van_der_pol");
    let instance = folder.open().instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    assert!(matches!(
        instance.get_nominals(&mut [0.0; 3]),
        Err(FmiError::Length { expected: 2, found: 3, .. })
    ));
    instance.update_discrete_states(1).unwrap();
    let mut instance = instance.enter_continuous_time().unwrap();
    assert!(matches!(instance.get_derivatives(&mut [0.0]), Err(FmiError::Length { .. })));
    assert!(matches!(instance.set_continuous_states(&[]), Err(FmiError::Length { .. })));
    assert!(matches!(instance.get_event_indicators(&mut [0.0]), Err(FmiError::Length { .. })));
    assert!(matches!(instance.get_reals(&[0, 1], &mut [0.0]), Err(FmiError::Length { .. })));
    assert!(matches!(
        instance.directional_derivative(&[0], &[1], &[1.0, 2.0], &mut [0.0]),
        Err(FmiError::Length { .. })
    ));
    // The instance is still usable.
    instance.get_derivatives(&mut [0.0; 2]).unwrap();
}

#[test]
fn instance_saves_and_restores_states() {
    let folder = model("dahlquist");
    let fmu = folder.open();
    let running = || {
        let instance = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
        let mut instance = instance.exit_initialization().unwrap();
        instance.update_discrete_states(1).unwrap();
        instance.enter_continuous_time().unwrap()
    };
    let (mut a, mut b) = (running(), running());
    let mut x = [0.0];
    a.set_continuous_states(&[0.25]).unwrap();
    let saved = a.save_state().unwrap();
    a.set_continuous_states(&[0.5]).unwrap();
    a.restore_state(&saved).unwrap();
    a.get_continuous_states(&mut x).unwrap();
    assert_eq!(x, [0.25]);

    // A state of another instance.
    assert!(matches!(b.restore_state(&saved), Err(FmiError::ForeignState)));
    b.set_continuous_states(&[0.125]).unwrap();
    let first = b.save_state().unwrap();

    // Saved states may outlive their instance. The memory of dropped states is used again.
    drop(a);
    assert!(matches!(b.restore_state(&saved), Err(FmiError::ForeignState)));
    for k in 0..100 {
        b.set_continuous_states(&[f64::from(k)]).unwrap();
        let saved = b.save_state().unwrap();
        b.restore_state(&saved).unwrap();
    }
    b.restore_state(&first).unwrap();
    b.get_continuous_states(&mut x).unwrap();
    assert_eq!(x, [0.125]);
}

#[test]
fn restore_state_rejects_states_of_another_phase() {
    let folder = model("dahlquist");
    let instance = folder.open().instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap().enter_continuous_time().unwrap();
    let saved = instance.save_state().unwrap();
    let mut instance = instance.reset().unwrap();
    let error = instance.restore_state(&saved).unwrap_err().to_string();
    assert_eq!(error, "the state was saved in ContinuousTime, but the instance is in Instantiated");
    instance.set("k", 2.0).unwrap();
    instance.enter_initialization(0.0, None, None).unwrap();
}

#[test]
fn directional_derivative_matches_the_equation() {
    let folder = model("dahlquist");
    let fmu = folder.open();
    let description = fmu.description();
    let derivative = &description.variables[description.structure.derivatives[0].index];
    let state = &description.variables[derivative.derivative.unwrap()];
    let mut instance = fmu.instantiate().unwrap();
    instance.set("k", 3.0).unwrap();
    let instance = instance.enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    instance.update_discrete_states(1).unwrap();
    let mut instance = instance.enter_continuous_time().unwrap();
    let mut out = [0.0];
    instance
        .directional_derivative(&[derivative.value_reference], &[state.value_reference], &[2.0], &mut out)
        .unwrap();
    assert_eq!(out, [-6.0]);
}

#[test]
fn session_keeps_values_until_reset() {
    let folder = model("furuta");
    let fmu = folder.open();
    let mut session = Session::new(fmu.clone());
    assert_eq!(session.get("armFriction").unwrap(), Value::Real(0.012));
    session.set("armFriction", 0.01).unwrap();
    assert_eq!(session.get("armFriction").unwrap(), Value::Real(0.01));
    let options = SimulateOptions::new().final_time(2.0).outputs(["armJoint.phi"]);
    let first = session.simulate(&options).unwrap();
    assert_eq!(
        session.get("armJoint.phi").unwrap(),
        Value::Real(first.final_value("armJoint.phi").unwrap().unwrap())
    );
    assert_eq!(session.get("armFriction").unwrap(), Value::Real(0.01));
    assert_eq!(session.simulate(&options).unwrap(), first);
    session.set("armFriction", 0.02).unwrap();
    assert_eq!(session.get("armFriction").unwrap(), Value::Real(0.02));
    assert_ne!(session.simulate(&options).unwrap(), first);
    // Values of a single simulation.
    let once = options.clone().start_value("armFriction", 0.01);
    assert_eq!(session.simulate(&once).unwrap(), first);
    assert_eq!(session.get("armFriction").unwrap(), Value::Real(0.01));
    session.reset();
    assert_eq!(session.get("armFriction").unwrap(), Value::Real(0.012));
    let nominal = session.simulate(&options).unwrap();
    assert_eq!(Session::new(fmu).simulate(&options).unwrap(), nominal);
    assert!(matches!(session.set("armFriktion", 1.0), Err(FmiError::UnknownVariable { .. })));
}

#[test]
fn session_returns_initialized_values_before_a_simulation() {
    let folder = evil(&[]);
    let mut session = Session::new(folder.open());
    assert_eq!(session.get("twice_k").unwrap(), Value::Real(2.0));
    session.set("k", 4.0).unwrap();
    assert_eq!(session.get("twice_k").unwrap(), Value::Real(8.0));
    assert_eq!(session.get("x").unwrap(), Value::Real(1.0));
    assert_eq!(session.get("der(x)").unwrap(), Value::Real(-4.0));
    assert_eq!(session.get("label").unwrap(), Value::String("none".into()));
}

#[test]
fn cache_opens_an_unchanged_file_once() {
    let path = example_models::example_fmu("dahlquist").unwrap();
    let cache = FmuCache::new(2);
    let first = cache.open(&path).unwrap();
    let second = cache.open(&path).unwrap();
    assert!(first.is_same(&second));

    // A changed file is opened again.
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("copy.fmu");
    std::fs::copy(&path, &copy).unwrap();
    let before = cache.open(&copy).unwrap();
    assert!(!before.is_same(&first) && before.path() == copy && first.path() == path);
    std::fs::copy(example_models::example_fmu("stair").unwrap(), &copy).unwrap();
    let after = cache.open(&copy).unwrap();
    assert_eq!(after.description().model_name, "Stair");
    assert!(matches!(cache.open(folder.path().join("none.fmu")), Err(FmiError::Io { .. })));
    // Other options give a separate FMU. Both are kept.
    let options = OpenOptions { compile_time: Duration::from_secs(1), ..OpenOptions::default() };
    let plain = cache.open(&path).unwrap();
    let other = cache.open_with(&path, &options).unwrap();
    assert!(!other.is_same(&plain));
    assert!(cache.open_with(&path, &options).unwrap().is_same(&other));
    assert!(cache.open(&path).unwrap().is_same(&plain));
    cache.clear();
    assert!(!cache.open(&path).unwrap().is_same(&first));
}

#[test]
fn examples_open_and_run() {
    for name in example_models::example_names() {
        let fmu = Fmu::open(example_models::example_fmu(name).unwrap()).unwrap();
        fmu.simulate(&SimulateOptions::new().final_time(0.5)).unwrap();
    }
    assert!(example_models::example_fmu("furutta").unwrap_err().to_string().contains("furuta"));
}

#[test]
fn two_thousand_simulations_of_one_fmu_succeed() {
    let folder = model("bouncing_ball");
    let fmu = folder.open();
    let options = SimulateOptions::new().final_time(1.0).ncp(2);
    for _ in 0..2000 {
        fmu.simulate(&options).unwrap();
    }
}

#[test]
fn fmu_without_binary_is_compiled_from_sources() {
    let folder = tempfile::tempdir().unwrap();
    let models = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../example-models/models");
    let sources = folder.path().join("sources");
    std::fs::create_dir(&sources).unwrap();
    std::fs::copy(models.join("dahlquist/modelDescription.xml"), folder.path().join("modelDescription.xml"))
        .unwrap();
    for file in [
        "dahlquist/model.c",
        "frontend/model.h",
        "frontend/instance.h",
        "frontend/fmi2.h",
        "frontend/fmi2_common.h",
        "frontend/fmi2_me.c",
    ] {
        let from = models.join(file);
        std::fs::copy(&from, sources.join(from.file_name().unwrap())).unwrap();
    }
    let result = Fmu::open(folder.path()).unwrap().simulate(&SimulateOptions::new().final_time(1.0)).unwrap();
    assert!((result.final_value("x").unwrap().unwrap() - (-1f64).exp()).abs() < 1e-5);
}

/// Returns an instance in continuous-time mode at 0 s.
fn running(fmu: &Fmu) -> fmi::Instance<fmi::ContinuousTime> {
    let instance = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    instance.update_discrete_states(MAX_EVENT_ITERATIONS).unwrap();
    instance.enter_continuous_time().unwrap()
}

/// The exact solution is h = 1 - g t^2 / 2 until the impact at t1 = sqrt(2 / g). After it, the speed is e v1.
/// The integration has two parts.
#[test]
fn integrate_handles_events() {
    let folder = model("bouncing_ball");
    let options = || fmi::ode::Options { relative_tolerance: 1e-10, ..fmi::ode::Options::default() };
    let mut instance = running(&folder.open());
    for (start, end) in [(0.0, 0.3), (0.3, 0.7)] {
        instance = match instance.integrate(start, end, options()).unwrap() {
            fmi::Integrated::Reached { instance } if instance.next_event().is_none() => instance,
            other => panic!("{other:?}"),
        };
    }
    let (g, e) = (9.81, 0.7);
    let t1 = f64::sqrt(2.0 / g);
    let v1 = e * g * t1;
    let (h, v) = (v1 * (0.7 - t1) - g * (0.7 - t1).powi(2) / 2.0, v1 - g * (0.7 - t1));
    let mut x = [0.0; 2];
    instance.get_continuous_states(&mut x).unwrap();
    assert!((x[0] - h).abs() < 1e-8 && (x[1] - v).abs() < 1e-8, "{x:?} for {h}, {v}");
}

/// The stair model ends the simulation at 9 s with a time event.
#[test]
fn integrate_ends_when_the_model_terminates() {
    let folder = model("stair");
    let fmu = folder.open();
    let instance = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    let next = instance.update_discrete_states(MAX_EVENT_ITERATIONS).unwrap().next_time;
    assert_eq!(next, Some(1.0));
    let instance = instance.enter_continuous_time().unwrap();
    match instance.integrate(0.0, 20.0, fmi::ode::Options::default()).unwrap() {
        fmi::Integrated::Ended { mut instance, time } => {
            assert_eq!(time, 9.0);
            assert_eq!(instance.get("counter").unwrap(), Value::Integer(10));
        }
        other => panic!("{other:?}"),
    }
}

/// x0' = x1, x1' = mu (1 - x0^2) x1 - x0 at (2, 0) with mu = 1: the second row is (-2 mu x0 x1 - 1, mu (1 -
/// x0^2)).
#[test]
fn linearize_matches_the_van_der_pol_equations() {
    let folder = model("van_der_pol");
    let mut instance = running(&folder.open());
    for differences in [false, true] {
        let linear = instance.linearize(differences).unwrap();
        assert_eq!(linear.states, ["x0", "x1"]);
        assert!(linear.inputs.is_empty() && linear.b.is_empty() && linear.d.is_empty());
        for (found, exact) in linear.a.iter().zip([0.0, 1.0, -1.0, -3.0]) {
            assert!((found - exact).abs() < 1e-9, "{:?}", linear.a);
        }
        assert_eq!(linear.c.len(), 2 * linear.outputs.len());
    }
    let mut x = [0.0; 2];
    instance.get_continuous_states(&mut x).unwrap();
    assert_eq!(x, [2.0, 0.0]);
}
