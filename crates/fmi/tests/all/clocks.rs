//! Clocks of FMI 3.0 in model exchange and co-simulation: tick times and the effects of ticks, in closed
//! form.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::description::{ClockKind, Interval};
use fmi::{FmiError, Inputs, InterfaceChoice, SimulateOptions, SimulationPlan, Simulator, Trajectory};
use std::sync::Arc;
use support::{fixture, fixture_with};

const KINDS: [InterfaceChoice; 2] = [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation];

fn inputs() -> Inputs {
    Inputs::new()
        .series("button", vec![0.0, 0.5, 0.7, 1.0], vec![0.0, 1.0, 0.0, 1.0])
        .series("setpoint", vec![0.0, 1.0], vec![0.0, 1.0])
        .series("optional", vec![0.0, 0.7, 1.0], vec![1.0, 0.0, 1.0])
}

fn ticks(result: &Trajectory, clock: &str) -> Vec<f64> {
    result.ticks.iter().filter(|tick| &*tick.clock == clock).map(|tick| tick.time).collect()
}

/// Returns the tick times of each clock between 0 and 2.
fn expected() -> Vec<(&'static str, Vec<f64>)> {
    let multiples = |n: u32, of: &dyn Fn(f64) -> f64| (0..n).map(|k| of(f64::from(k))).collect();
    vec![
        ("sample", multiples(21, &|k| k * 0.1)),
        ("third", multiples(6, &|k| (k + 1.0) / 3.0)),
        ("counted", multiples(7, &|k| (150.0 + 300.0 * k) / 1000.0)),
        ("growing", vec![0.0625, 0.1875, 0.4375, 0.9375, 1.9375]),
        ("later", vec![0.625, 1.125]),
        ("button", vec![0.5, 1.0]),
        ("alarm", vec![0.625, 1.125]),
        ("optional", vec![0.25, 1.25, 1.75]),
        ("retuned", vec![0.25, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0]),
    ]
}

#[test]
fn clock_intervals_are_read_from_description() {
    let folder = fixture("clocks", |xml| xml);
    let fmu = folder.open();
    assert!(fmu.description().quirks.is_empty(), "{:?}", fmu.description().quirks);
    let timing = |name: &str| **fmu.description().variable(name).unwrap().clock.as_ref().unwrap();
    let sample = timing("sample");
    assert_eq!((sample.kind, sample.interval), (ClockKind::Constant, Some(Interval::Decimal(0.1))));
    assert_eq!(
        (timing("third").interval, timing("third").shift),
        (Some(Interval::Fraction(1, 3)), Interval::Fraction(1, 3))
    );
    assert_eq!((timing("later").kind, timing("later").interval), (ClockKind::Countdown, None));
    assert!(timing("optional").can_be_deactivated && timing("counted").supports_fraction);
    assert!(fmu.description().variable("u").unwrap().clock.is_none());
}

#[test]
fn clock_attributes_are_inherited_from_types() {
    let folder = fixture("clocks", |xml| xml);
    let xml = std::fs::read_to_string(folder.path().join("modelDescription.xml")).unwrap();
    let plain = fmi::ModelDescription::parse(xml.as_bytes()).unwrap();
    let (mut edited, mut types) = (xml, String::new());
    for (name, attributes) in [
        (
            "third",
            "intervalVariability=\"constant\" supportsFraction=\"true\" resolution=\"3\" intervalCounter=\"1\" \
             shiftCounter=\"1\" intervalDecimal=\"0.3333333333\" shiftDecimal=\"0.3333333333\"",
        ),
        (
            "optional",
            "intervalVariability=\"fixed\" intervalDecimal=\"0.5\" shiftDecimal=\"0.25\" canBeDeactivated=\"true\"",
        ),
        ("retuned", "intervalVariability=\"tunable\""),
    ] {
        assert!(edited.contains(attributes), "{name}");
        edited = edited.replace(attributes, &format!("declaredType=\"{name} type\""));
        types += &format!("<ClockType name=\"{name} type\" {attributes}/>");
    }
    let definitions = format!("<TypeDefinitions>{types}</TypeDefinitions><ModelVariables>");
    let edited = edited.replace("<ModelVariables>", &definitions);
    let inherited = fmi::ModelDescription::parse(edited.as_bytes()).unwrap();
    assert!(inherited.quirks.is_empty(), "{:?}", inherited.quirks);
    for name in ["third", "optional", "retuned", "sample"] {
        assert_eq!(inherited.variable(name).unwrap().clock, plain.variable(name).unwrap().clock, "{name}");
    }

    // An interval of the variable takes precedence, although the interval of the type is a fraction.
    let with_interval =
        edited.replace("declaredType=\"third type\"", "declaredType=\"third type\" intervalDecimal=\"0.25\"");
    let with_interval = fmi::ModelDescription::parse(with_interval.as_bytes()).unwrap();
    let timing = with_interval.variable("third").unwrap().clock.as_ref().unwrap();
    assert_eq!((timing.interval, timing.shift), (Some(Interval::Decimal(0.25)), Interval::Fraction(1, 3)));
}

#[test]
fn clocks_of_all_kinds_tick_at_exact_times() {
    let folder = fixture("clocks", |xml| xml);
    let fmu = folder.open();
    for kind in KINDS {
        let options = SimulateOptions::new().kind(kind).inputs(inputs()).ncp(40).relative_tolerance(1e-10);
        let result = fmu.simulate(&options).unwrap();
        let mut instants: Vec<f64> = vec![0.0];
        for (clock, times) in expected() {
            assert_eq!(ticks(&result, clock), times, "{kind:?} {clock}");
            instants.extend(times);
        }
        for tick in result.ticks.windows(2) {
            assert!(tick[0].time <= tick[1].time + 1e-13);
        }
        // One visit for all events at one time. The visit at 0.75 belongs to a skipped tick.
        instants.push(0.75);
        instants.sort_by(f64::total_cmp);
        instants.dedup_by(|a, b| (*a - *b).abs() < 1e-12);
        let last = |name: &str| result.final_value(name).unwrap().unwrap();
        assert_eq!(last("visits"), instants.len() as f64, "{kind:?}");
        assert_eq!(result.events.len(), instants.len() - 1, "{kind:?}");
        for (clock, times) in expected() {
            assert_eq!(last(&format!("n_{clock}")), times.len() as f64, "{kind:?} {clock}");
        }

        // x' = u with u = K (s - x) held between ticks: s + (1 - h K)^k (x0 - s).
        let x = result.get("x").unwrap();
        let mut state = 1.0;
        for k in 0..20usize {
            let setpoint = if k < 10 { 0.0 } else { 1.0 };
            let next = state + 0.1 * 2.0 * (setpoint - state);
            assert!(
                (x[2 * k] - state).abs() < 1e-9,
                "{kind:?}: x({}) = {} is not {state}",
                result.time[2 * k],
                x[2 * k]
            );
            assert!((x[2 * k + 1] - 0.5 * (state + next)).abs() < 1e-9, "{kind:?} between ticks");
            state = next;
        }
        let analytic = 1.0 - 0.8f64.powi(10) * (1.0 - 0.8f64.powi(10));
        assert!((last("x") - analytic).abs() < 1e-9 && (state - analytic).abs() < 1e-12);

        // Clocks as outputs are 1 in the rows of their ticks.
        let options = SimulateOptions { ncp: None, ..options }
            .times([0.0, 0.3, 0.5, 0.6, 0.625, 0.625, 0.9])
            .outputs(["alarm", "sample", "button"]);
        let result = fmu.simulate(&options).unwrap();
        assert_eq!(result.get("alarm").unwrap(), [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0], "{kind:?}");
        assert_eq!(result.get("sample").unwrap(), [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0], "{kind:?}");
        assert_eq!(result.get("button").unwrap(), [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], "{kind:?}");
    }
}

#[test]
fn clock_runs_are_reproducible_and_follow_interval_parameters() {
    let folder = fixture("clocks", |xml| xml);
    let fmu = folder.open();
    for kind in KINDS {
        let options =
            SimulateOptions::new().kind(kind).inputs(inputs()).ncp(10).parameters(["period", "gap"]);
        let mut simulator = Simulator::new(Arc::new(SimulationPlan::new(&fmu, &options).unwrap())).unwrap();
        let first = simulator.trajectory(&[0.3, 0.0625]).unwrap();
        let other = simulator.trajectory(&[0.8, 0.25]).unwrap();
        assert_eq!(ticks(&other, "counted"), [0.4, 1.2, 2.0], "{kind:?}");
        assert_eq!(ticks(&other, "growing"), [0.25, 0.75, 1.75], "{kind:?}");
        assert_eq!(simulator.trajectory(&[0.3, 0.0625]).unwrap(), first, "{kind:?}");
        assert_eq!(first.ticks.len(), expected().iter().map(|(_, times)| times.len()).sum::<usize>());
    }
}

#[test]
fn nonzero_start_time_shifts_all_clocks() {
    let folder = fixture("clocks", |xml| xml);
    let fmu = folder.open();
    for kind in KINDS {
        let options = SimulateOptions::new().kind(kind).start_time(10.0).final_time(11.0).ncp(1);
        let result = fmu.simulate(&options).unwrap();
        let sample: Vec<f64> = (0..=10).map(|k| 10.0 + f64::from(k) * 0.1).collect();
        assert_eq!(ticks(&result, "sample"), sample, "{kind:?}");
        assert_eq!(ticks(&result, "third"), [10.0 + 1.0 / 3.0, 10.0 + 2.0 / 3.0, 11.0], "{kind:?}");
        assert!(ticks(&result, "later").is_empty() && ticks(&result, "button").is_empty());
    }
}

#[test]
fn unsupported_clock_uses_are_reported() {
    let folder = fixture("clocks", |xml| xml);
    let fmu = folder.open();
    let problem = |inputs: Inputs| {
        SimulationPlan::new(&fmu, &SimulateOptions::new().inputs(inputs)).unwrap_err().to_string()
    };
    let one = |name: &str, value: f64| Inputs::new().series(name, vec![0.0], vec![value]);
    assert!(problem(one("sample", 1.0)).contains("constant intervals"), "{}", problem(one("sample", 1.0)));
    assert!(problem(one("button", 0.5)).contains("0.5 in row 0 is not 0 or 1"));
    assert!(problem(one("alarm", 1.0)).contains("causality is output"));

    // A changing clock whose interval is always 0 prevents time from advancing.
    for kind in KINDS {
        let error = fmu.simulate(&SimulateOptions::new().kind(kind).start_value("gap", 0.0)).unwrap_err();
        assert!(error.to_string().contains("event iteration"), "{error}");
        let error = fmu.simulate(&SimulateOptions::new().kind(kind).start_value("period", 0.0)).unwrap_err();
        assert!(error.to_string().contains("clock counted"), "{error}");
    }

    // Fixed steps that would skip a tick.
    let fixed = fixture("clocks", |xml| xml.replace("canHandleVariableCommunicationStepSize=\"true\"", ""));
    let options = SimulateOptions::new().kind(InterfaceChoice::CoSimulation).step_size(0.25).ncp(8);
    let error = fixed.open().simulate(&options).unwrap_err().to_string();
    assert!(error.contains("the clock growing ticks at 0.0625, within the step from 0 to 0.25"), "{error}");

    // Without event mode, clocks cannot be triggered, and time-based clocks would not tick.
    let by_themselves = "intervalVariability=\"triggered\"";
    let plain = |silence: bool| {
        fixture("clocks", |xml| {
            let xml = xml.replace("hasEventMode=\"true\"", "");
            let all = ["constant", "fixed", "changing", "countdown", "tunable"];
            let clock = |kind| format!("intervalVariability=\"{kind}\"");
            all.iter().filter(|_| silence).fold(xml, |xml, kind| xml.replace(&clock(kind), by_themselves))
        })
    };
    let refused = |folder: support::Folder, options: SimulateOptions| {
        let error =
            SimulationPlan::new(&folder.open(), &options.kind(InterfaceChoice::CoSimulation)).unwrap_err();
        assert!(matches!(error, FmiError::BadSetting(_)), "{error}");
        error.to_string()
    };
    let message = refused(plain(false), SimulateOptions::new());
    assert!(message.contains("the clock sample ticks in event mode"), "{message}");
    let message = refused(plain(true), SimulateOptions::new().inputs(one("button", 1.0)));
    assert!(message.contains("the inputs trigger clocks"), "{message}");
    let message = refused(plain(true), SimulateOptions::new().outputs(["alarm"]));
    assert!(message.contains("recorded clocks"), "{message}");
    let message =
        refused(plain(true), SimulateOptions::new().clock_interval("counted", Interval::Decimal(1.0)));
    assert!(message.contains("an interval of the clock counted is specified"), "{message}");
    let quiet = SimulateOptions::new().kind(InterfaceChoice::CoSimulation).outputs(["x"]);
    SimulationPlan::new(&plain(true).open(), &quiet).unwrap();
}

#[test]
fn clock_intervals_can_be_set_in_options() {
    let folder = fixture("clocks", |xml| xml);
    let fmu = folder.open();
    for kind in KINDS {
        let options = SimulateOptions::new().kind(kind).ncp(4);
        let given = options
            .clone()
            .clock_interval("counted", Interval::Fraction(1, 4))
            .clock_interval("optional", Interval::Decimal(1.0))
            .clock_interval("retuned", Interval::Decimal(0.75));
        let result = fmu.simulate(&given).unwrap();
        // The shift of "counted" is half of its interval. The model sets "retuned" to 0.25 after its second
        // tick.
        let counted: Vec<f64> = (0..8).map(|k| (125.0 + 250.0 * f64::from(k)) / 1000.0).collect();
        assert_eq!(ticks(&result, "counted").len(), counted.len(), "{kind:?}");
        for (found, expected) in ticks(&result, "counted").iter().zip(counted) {
            assert!((found - expected).abs() < 1e-15, "{kind:?}: {found} is not {expected}");
        }
        assert_eq!(ticks(&result, "optional"), [0.25, 1.25], "{kind:?}");
        assert_eq!(ticks(&result, "retuned"), [0.25, 1.0, 1.25, 1.5, 1.75, 2.0], "{kind:?}");
        // Intervals of one simulation do not affect the next one.
        assert_eq!(ticks(&fmu.simulate(&options).unwrap(), "counted"), expected()[2].1, "{kind:?}");
        let error = fmu.simulate(&options.clone().clock_interval("counted", Interval::Decimal(101.0)));
        let error = error.unwrap_err().to_string();
        assert!(error.contains("fmi3SetInterval"), "{error}");
    }
    for (name, interval, text) in [
        ("sample", Interval::Decimal(0.5), "constant intervals"),
        ("optional", Interval::Fraction(1, 2), "does not support fractions"),
        ("counted", Interval::Decimal(0.0), "not positive"),
        ("counted", Interval::Fraction(1, 0), "not positive"),
        ("alarm", Interval::Decimal(1.0), "not a clock that the importer activates"),
        ("x", Interval::Decimal(1.0), "not a clock that the importer activates"),
        ("y", Interval::Decimal(1.0), "no variable"),
    ] {
        let error = SimulationPlan::new(&fmu, &SimulateOptions::new().clock_interval(name, interval));
        let error = error.unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
    }
    let error = SimulationPlan::new(&fmu, &SimulateOptions::new().start_value("sample", true)).unwrap_err();
    assert!(error.to_string().contains("it is a clock"), "{error}");
}

#[test]
fn clocks_require_event_mode() {
    let folder = fixture_with("clocks", &["NO_EVENT_MODE"], |xml| xml);
    let error =
        folder.open().simulate(&SimulateOptions::new().kind(InterfaceChoice::CoSimulation)).unwrap_err();
    assert!(error.to_string().contains("the clocks of the model tick in event mode"), "{error}");
}

#[test]
fn clocks_can_be_set_on_instance() {
    let folder = fixture("clocks", |xml| xml);
    let fmu = folder.open();
    let instance = fmu.instantiate().unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
    assert_eq!(instance.clock_interval("counted").unwrap(), Some(Interval::Fraction(300, 1000)));
    assert_eq!(instance.clock_interval("later").unwrap(), None);
    instance.set_clock_interval("counted", Interval::Fraction(1, 8)).unwrap();
    assert_eq!(instance.clock_interval("counted").unwrap(), Some(Interval::Fraction(125, 1000)));
    assert!(instance.set_clock_interval("later", Interval::Decimal(1.0)).is_err());
    assert!(instance.clock_interval("x").unwrap_err().to_string().contains("x is not a clock"));
    let mut instance = instance.exit_initialization().unwrap();
    instance.set("button", true).unwrap();
    instance.set("sample", true).unwrap();
    instance.update_discrete_states(10).unwrap();
    assert_eq!(instance.clock_interval("later").unwrap(), Some(Interval::Decimal(0.125)));
    assert_eq!(instance.get("u").unwrap(), (-2.0).into());
    assert!(instance.set("alarm", true).unwrap_err().to_string().contains("only inputs"));
    let mut instance = instance.enter_continuous_time().unwrap();
    assert!(instance.set("sample", true).unwrap_err().to_string().contains("only continuous inputs"));
}
