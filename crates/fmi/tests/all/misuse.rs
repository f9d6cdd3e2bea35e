//! Public functions called with invalid arguments: wrong lengths, unknown names, foreign states. Each call
//! returns a typed error, does not call the FMU, and leaves the instance usable.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use example_models::ExampleKind::{Fmi1ModelExchange, Fmi2CoSimulation, Fmi2ModelExchange, Fmi3};
use fmi::ode::Ignore;
use fmi::{
    ArchiveLimits, ContinuousTime, EventMode, FmiError, Fmu, FmuCache, Inputs, Instance, InstanceOptions,
    InterfaceChoice, SavedState, Session, SimulateOptions, SimulationPlan, Simulator, StepMode, Value,
};
use std::sync::Arc;
use support::{arrays, model, model_as};

/// Returns wrong lengths for a vector of length `n`.
fn wrong(n: usize) -> impl Iterator<Item = usize> {
    [0, n.wrapping_sub(1), n + 1, n + 1000]
        .into_iter()
        .filter(move |length| *length != n && *length < 1 << 20)
}

fn is_length(what: &str, expected: usize, found: usize, outcome: Result<(), FmiError>) {
    match outcome {
        Err(FmiError::Length { call, expected: e, found: f }) => {
            assert_eq!((e, f), (expected, found), "{what}: {call}");
            assert!(!call.is_empty());
        }
        other => panic!("{what} with {found} for {expected}: {other:?}"),
    }
}

fn in_event_mode(fmu: &Fmu) -> Instance<EventMode> {
    let instance = fmu.instantiate().unwrap().enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    instance.update_discrete_states(10).unwrap();
    instance
}

fn in_continuous_time(fmu: &Fmu) -> Instance<ContinuousTime> {
    in_event_mode(fmu).enter_continuous_time().unwrap()
}

fn in_step_mode(fmu: &Fmu) -> Instance<StepMode, fmi::CoSimulation> {
    let instance = fmu.instantiate_co_simulation(&InstanceOptions::default()).unwrap();
    instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap()
}

#[test]
fn instance_rejects_state_and_indicator_vectors_of_wrong_length() {
    for (folder, n, z) in [
        (model("furuta"), 4, 0),
        (model("bouncing_ball"), 2, 1),
        (model_as("bouncing_ball", Fmi1ModelExchange, &[], |xml| xml), 2, 1),
        (model_as("bouncing_ball", Fmi3, &[], |xml| xml), 2, 1),
        (arrays(), 3, 0),
    ] {
        let fmu = folder.open();
        let description = fmu.description();
        let z = if description.n_event_indicators == z { z } else { description.n_event_indicators };
        assert_eq!(description.n_states(), n);
        let mut event = in_event_mode(&fmu);
        for length in wrong(n) {
            is_length("states", n, length, event.get_continuous_states(&mut vec![0.0; length]));
            is_length("nominals", n, length, event.get_nominals(&mut vec![0.0; length]));
        }
        for length in wrong(z) {
            is_length("indicators", z, length, event.get_event_indicators(&mut vec![0.0; length]));
        }
        let mut time = event.enter_continuous_time().unwrap();
        let mut before = vec![0.0; n];
        time.get_continuous_states(&mut before).unwrap();
        for length in wrong(n) {
            is_length("states", n, length, time.get_continuous_states(&mut vec![0.0; length]));
            is_length("states", n, length, time.set_continuous_states(&vec![7.0; length]));
            is_length("derivatives", n, length, time.get_derivatives(&mut vec![0.0; length]));
        }
        for length in wrong(z) {
            is_length("indicators", z, length, time.get_event_indicators(&mut vec![0.0; length]));
        }
        let mut after = vec![0.0; n];
        time.get_continuous_states(&mut after).unwrap();
        assert_eq!(before, after);
        time.get_derivatives(&mut after).unwrap();
        time.get_event_indicators(&mut vec![0.0; z]).unwrap();
    }
}

/// The number of values differs from the number of references, also for a reference to an array of three
/// elements.
#[test]
fn instance_rejects_wrong_number_of_values() {
    let folder = model("van_der_pol");
    let fmu = folder.open();
    let mut instance = in_continuous_time(&fmu);
    let reference = fmu.description().variable("x1").map_or(1, |variable| variable.value_reference);
    for length in wrong(2) {
        let values = &mut vec![0.0; length][..];
        is_length("get_reals", 2, length, instance.get_reals(&[reference, reference], values));
        let seed = vec![1.0; length];
        let directional = instance.directional_derivative(&[reference], &[reference; 2], &seed, &mut [0.0]);
        is_length("directional_derivative", 2, length, directional);
        let directional = instance.directional_derivative(&[reference; 2], &[reference], &[1.0], values);
        is_length("directional_derivative", 2, length, directional);
    }
    let folder = arrays();
    let fmu = folder.open();
    let mut instance = in_continuous_time(&fmu);
    for length in wrong(4) {
        is_length("get_reals", 4, length, instance.get_reals(&[2, 5], &mut vec![0.0; length]));
    }
    let mut values = [0.0; 4];
    instance.get_reals(&[2, 5], &mut values).unwrap();
    assert_eq!(values, [1.0, 2.0, 3.0, 6.0]);
    let mut stepping = in_step_mode(&fmu);
    for length in wrong(3) {
        is_length("get_reals", 3, length, stepping.get_reals(&[2], &mut vec![0.0; length]));
        is_length("input derivatives", 3, length, stepping.set_input_derivatives(&[2], &vec![0.0; length]));
    }
}

#[test]
fn instance_rejects_references_that_are_not_real() {
    let folder = arrays();
    let fmu = folder.open();
    let mut instance = in_continuous_time(&fmu);
    let mut stepping = in_step_mode(&fmu);
    // An unknown reference, and references to an integer, a string and a Float32.
    for bad in [999, u32::MAX, 15, 22, 10] {
        let mut one = [0.0];
        for outcome in [
            instance.get_reals(&[5, bad], &mut [0.0; 2]),
            instance.directional_derivative(&[bad], &[5], &[1.0], &mut one),
            instance.directional_derivative(&[5], &[bad], &[1.0], &mut one),
            stepping.get_reals(&[bad], &mut one),
            stepping.set_input_derivatives(&[bad], &one),
        ] {
            match outcome {
                Err(FmiError::UnknownReference { reference, .. }) => assert_eq!(reference, bad),
                other => panic!("{bad}: {other:?}"),
            }
        }
    }
    assert_eq!(instance.get("sum").unwrap(), Value::Real(6.0));
    assert_eq!(stepping.get("sum").unwrap(), Value::Real(6.0));
}

#[test]
fn unknown_names_are_typed_errors() {
    let folder = model("furuta");
    let fmu = folder.open();
    let mut instance = fmu.instantiate().unwrap();
    let mut session = Session::new(fmu.clone());
    let new_plan = |options: SimulateOptions| SimulationPlan::new(&fmu, &options.final_time(1.0));
    let plan = Arc::new(new_plan(SimulateOptions::new().parameters(["armFriction"])).unwrap());
    let mut simulator = Simulator::new(Arc::clone(&plan)).unwrap();
    let trajectory = simulator.trajectory(&[0.012]).unwrap();
    for name in ["armFrictoin", "", "armFriction ", "armfriction", "armFriction[1]", "\0", "\u{1f600}", "*["]
    {
        let mut outcomes = vec![
            instance.set(name, 1.0),
            session.set(name, 1.0),
            session.get(name).map(|_| ()),
            simulator.value(name).map(|_| ()),
            simulator.get(name).map(|_| ()),
            new_plan(SimulateOptions::new().parameters([name])).map(|_| ()),
            new_plan(SimulateOptions::new().start_value(name, 1.0)).map(|_| ()),
        ];
        outcomes.push(in_event_mode(&fmu).get(name).map(|_| ()));
        for outcome in outcomes {
            let Err(FmiError::UnknownVariable { name: unknown, .. }) = outcome else {
                panic!("{name:?}: {outcome:?}");
            };
            assert_eq!(unknown, name);
        }
        let inputs = Inputs::new().series(name, [0.0, 1.0], [0.0, 1.0]);
        assert!(new_plan(SimulateOptions::new().inputs(inputs)).is_err(), "{name:?}");
        assert!(new_plan(SimulateOptions::new().outputs([name])).is_err(), "{name:?}");
        assert!(matches!(trajectory.get(name), Err(FmiError::NotInResult { .. })));
        assert!(matches!(trajectory.final_value(name), Err(FmiError::NotInResult { .. })));
        assert!(matches!(example_models::example_fmu(name), Err(FmiError::BadSetting(_))));
        assert!(matches!(
            example_models::example_fmu_as(name, Fmi2CoSimulation),
            Err(FmiError::BadSetting(_))
        ));
    }
}

#[test]
fn run_rejects_wrong_number_of_parameters_and_non_finite_values() {
    let folder = model("furuta");
    let options = SimulateOptions::new().final_time(0.1).parameters(["armFriction", "pendulumFriction"]);
    let plan = Arc::new(SimulationPlan::new(&folder.open(), &options).unwrap());
    let mut simulator = Simulator::new(plan).unwrap();
    for length in wrong(2) {
        let values = vec![0.001; length];
        is_length("run", 2, length, simulator.run(&values, &mut Ignore).map(|_| ()));
        is_length("trajectory", 2, length, simulator.trajectory(&values).map(|_| ()));
    }
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let outcome = simulator.run(&[0.001, bad], &mut Ignore).map(|_| ());
        assert!(
            matches!(&outcome, Err(FmiError::NotFinite { name, .. }) if name == "pendulumFriction"),
            "{outcome:?}"
        );
    }
    simulator.run(&[0.001, 0.001], &mut Ignore).unwrap();
}

/// Foreign states: of another instance of the same FMU, of another FMU, of the other interface, and of an
/// instance that no longer exists.
#[test]
fn restore_state_rejects_foreign_states() {
    let dahlquist = model("dahlquist");
    let fmu = dahlquist.open();
    let mut instance = in_continuous_time(&fmu);
    let mut sibling = in_continuous_time(&fmu);
    let other = model("furuta");
    let mut stranger = in_continuous_time(&other.open());
    let slave = model_as("dahlquist", Fmi2CoSimulation, &[], |xml| xml);
    let slave = slave.open();
    let mut stepping = in_step_mode(&slave);
    let new = model_as("dahlquist", Fmi3, &[], |xml| xml);
    let new = new.open();
    // Both interfaces of one FMU.
    let mut exchanging = in_continuous_time(&new);
    let mut slaving = in_step_mode(&new);
    let gone = in_continuous_time(&fmu).save_state().unwrap();
    let kept = instance.save_state().unwrap();
    let foreign: Vec<SavedState> = vec![
        sibling.save_state().unwrap(),
        stranger.save_state().unwrap(),
        stepping.save_state().unwrap(),
        exchanging.save_state().unwrap(),
        slaving.save_state().unwrap(),
        gone,
    ];
    for (i, state) in foreign.iter().enumerate() {
        assert!(matches!(instance.restore_state(state), Err(FmiError::ForeignState)), "{i}");
    }
    for (i, state) in foreign.iter().enumerate().filter(|(i, _)| *i != 3) {
        assert!(matches!(exchanging.restore_state(state), Err(FmiError::ForeignState)), "{i}");
    }
    for (i, state) in foreign.iter().enumerate().filter(|(i, _)| *i != 4) {
        assert!(matches!(slaving.restore_state(state), Err(FmiError::ForeignState)), "{i}");
    }
    // In another phase.
    let mut event = instance.enter_event_mode().unwrap();
    assert!(matches!(event.restore_state(&kept), Err(FmiError::StateOfAnotherPhase { .. })));
    let mut instance = event.enter_continuous_time().unwrap();
    instance.restore_state(&kept).unwrap();
}

#[test]
fn unsupported_interface_is_a_typed_error() {
    let folders =
        [Fmi2ModelExchange, Fmi2CoSimulation].map(|kind| model_as("dahlquist", kind, &[], |xml| xml));
    let [exchange, stepping] = [folders[0].open(), folders[1].open()];
    for outcome in [
        exchange.instantiate_co_simulation(&InstanceOptions::default()).map(|_| ()),
        stepping.instantiate().map(|_| ()),
        exchange.choose(InterfaceChoice::CoSimulation).map(|_| ()),
        stepping.choose(InterfaceChoice::ModelExchange).map(|_| ()),
    ] {
        assert!(matches!(outcome, Err(FmiError::NotOffered { .. })), "{outcome:?}");
    }
    let name = InstanceOptions { name: Some("a\0b".to_owned()), ..InstanceOptions::default() };
    assert!(matches!(exchange.instantiate_with(&name), Err(FmiError::BadSetting(_))));
}

#[test]
fn missing_path_appears_in_the_error() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = folder.path().join("no.fmu");
    let limits = ArchiveLimits::default();
    for outcome in [
        Fmu::open(&nowhere).map(|_| ()),
        FmuCache::new(0).open(&nowhere).map(|_| ()),
        fmi::Archive::open_with(&nowhere, &limits, &fmi::CancelRequest::default()).map(|_| ()),
        fmi::Archive::open(folder.path())
            .and_then(|archive| fmi::ModelDescription::read(&archive))
            .map(|_| ()),
        fmi::pack(&nowhere, &folder.path().join("out.fmu")),
    ] {
        let error = outcome.unwrap_err();
        let path = folder.path().to_string_lossy().into_owned();
        assert!(error.to_string().contains(&path), "{error}");
    }
    assert!(matches!(
        fmi::platform::find_binary(folder.path(), "m", fmi::platform::FolderNames::SystemAndBits),
        Err(FmiError::NoBinary { .. })
    ));
}
