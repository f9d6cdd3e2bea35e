//! Design optimisation: criteria of trajectories against closed forms, searches, scenarios and mistakes.

use base::RunContext;
use calibration::{
    CalibrationError, Combination, Data, Design, DesignPoint, Experiment, FitOptions, Parameter,
};
use example_models::{ExampleKind, example_fmu_as};
use fmi::{Fmu, RunSettings};

fn fmu(name: &str, kind: ExampleKind) -> Fmu {
    Fmu::open(example_fmu_as(name, kind).unwrap()).unwrap()
}

/// Returns the criteria of a model at its start values, with relative tolerance 1e-9.
fn criteria(name: &str, kind: ExampleKind, end: f64, texts: &[&str]) -> DesignPoint {
    let run = RunSettings { relative_tolerance: Some(1e-9), ..RunSettings::default() };
    let parameter = match name {
        "bouncing_ball" => Parameter::new("g", -9.81),
        _ => Parameter::new("k", 1.0),
    };
    let mut builder = Design::builder(fmu(name, kind))
        .parameter(parameter)
        .scenario(Experiment::default().final_time(end))
        .settings(run);
    for text in texts {
        builder = builder.goal(text.parse().unwrap());
    }
    let design = builder.build().unwrap();
    design.evaluate(&design.calibration().start(), &RunContext::new()).unwrap()
}

#[test]
fn criteria_of_a_decay_match_closed_forms() {
    // x = exp(-t) from 0 to 5.
    let e5 = (-5.0_f64).exp();
    let cases = [
        ("final(x)", e5),
        ("max(x)", 1.0),
        ("min(x)", e5),
        ("integral(x)", 1.0 - e5),
        ("mean(x)", (1.0 - e5) / 5.0),
        ("energy(x)", (1.0 - e5 * e5) / 2.0),
        ("rms(x)", ((1.0 - e5 * e5) / 10.0).sqrt()),
        ("ise(x, 0.5)", (1.0 - e5 * e5) / 2.0 - (1.0 - e5) + 1.25),
        // |x - 0.5| has a kink at ln 2.
        ("iae(x, 0.5)", 2.0 * (0.5 - 0.5 * 2.0_f64.ln()) - (1.0 - e5 - 2.5)),
        ("itae(x)", 1.0 - 6.0 * e5),
        ("crossing_time(x, 0.25)", 4.0_f64.ln()),
        ("crossing_time(x, 2)", 5.0),
        ("crossing_time(time, 3.25)", 3.25),
        ("settling_time(x, 0)", 50.0_f64.ln()),
        ("settling_time(x, 0, 0.1)", 10.0_f64.ln()),
        ("rise_time(x, 0)", 10.0_f64.ln() - (10.0_f64 / 9.0).ln()),
        ("overshoot(x, 0)", 0.0),
        ("overshoot(x, 0.5)", 100.0 * (0.5 - e5) / 0.5),
        ("max(abs(x - 0.5)) * 2 + k", 2.0),
        ("integral(time * x)", 1.0 - 6.0 * e5),
    ];
    let texts = cases.map(|(text, _)| text);
    let point = criteria("dahlquist", ExampleKind::Fmi2ModelExchange, 5.0, &texts);
    for ((text, expected), value) in cases.iter().zip(&point.goals) {
        assert!((value - expected).abs() < 1e-7 * expected.abs().max(1.0), "{text}: {value} {expected}");
    }
    assert_eq!(point.goals.len(), texts.len());
    for kind in [ExampleKind::Fmi3, ExampleKind::Fmi1ModelExchange] {
        let other = criteria("dahlquist", kind, 5.0, &texts);
        assert!(point.goals.iter().zip(&other.goals).all(|(a, b)| (a - b).abs() < 1e-9), "{kind:?}");
    }
}

#[test]
fn criteria_see_peaks_between_steps_and_both_sides_of_events() {
    // Apex after the first impact: e^2 h, at the middle of the second flight. The velocity jumps from -v to e v.
    let v = (2.0 * 9.81_f64).sqrt();
    let texts =
        ["min(v)", "max(v)", "min(h)", "crossing_time(v, 2)", "max(h - 0.6*(1 - time))", "integral(h)"];
    let point = criteria("bouncing_ball", ExampleKind::Fmi2ModelExchange, 1.0, &texts);
    let (t1, e) = (v / 9.81, 0.7);
    let flight = 1.0 - t1;
    let area = 2.0 / 3.0 * t1 + (e * v * flight * flight / 2.0 - 9.81 * flight.powi(3) / 6.0);
    // h - 0.6 (1 - t) has a maximum in each flight, where the velocity is -0.6.
    let s = (e * v + 0.6) / 9.81;
    let peak = e * v * s - 9.81 * s * s / 2.0 - 0.6 * (1.0 - t1 - s);
    let first = 0.4 + 0.36 / (2.0 * 9.81);
    let expected = [-v, e * v, 0.0, t1, peak.max(first), area];
    for ((text, expected), value) in texts.iter().zip(expected).zip(&point.goals) {
        assert!((value - expected).abs() < 1e-7, "{text}: {value} {expected}");
    }
}

#[test]
fn criteria_of_a_co_simulation_follow_its_communication_points() {
    let texts = ["max(x)", "final(x)", "integral(x)", "crossing_time(x, 0.25)"];
    let point = criteria("dahlquist", ExampleKind::Fmi2CoSimulation, 5.0, &texts);
    let exact = criteria("dahlquist", ExampleKind::Fmi2ModelExchange, 5.0, &texts);
    for ((text, value), exact) in texts.iter().zip(&point.goals).zip(&exact.goals) {
        assert!((value - exact).abs() < 2e-2, "{text}: {value} {exact}");
    }
}

fn tank() -> Fmu {
    fmu("dahlquist", ExampleKind::Fmi2ModelExchange)
}

#[test]
fn goal_with_constraint_ends_at_the_limit() {
    // The area 1/k + k^2 has its minimum at 0.7937, where x(1) = 0.452. The limit of 0.4 requires k = ln 2.5.
    let design = |limit: Option<&str>, goal: &str| {
        let mut builder = Design::builder(tank())
            .goal(goal.parse().unwrap())
            .parameter(Parameter::new("k", 2.0).bounds(0.1, 10.0))
            .scenario(Experiment::default().final_time(50.0));
        if let Some(limit) = limit {
            builder = builder.constraint(limit.parse().unwrap());
        }
        builder.build().unwrap()
    };
    let free = design(None, "integral(x) + k**2").optimize(FitOptions::default()).unwrap();
    assert!(free.is_success(), "{free}");
    assert!((free.x[0] - 0.5_f64.cbrt()).abs() < 2e-3, "{free}");
    assert!((free.value - 1.889_881_574_842_309_8).abs() < 1e-4, "{free}");
    let limited = design(Some("crossing_time(x, 0.4) <= 1"), "integral(x) + k**2");
    let limited = limited.optimize(FitOptions::default()).unwrap();
    assert!(limited.is_success() && limited.fit.report.constr_violation <= 1e-6, "{limited}");
    assert!((limited.x[0] - 2.5_f64.ln()).abs() < 1e-3, "{limited}");
    assert_eq!(limited.point.as_ref().unwrap().constraints[0].text, "crossing_time(x, 0.4) <= 1");
    // A goal to maximise reports its own value.
    let most = design(None, "maximize -integral(x) - k**2").optimize(FitOptions::default()).unwrap();
    assert!((most.value + free.value).abs() < 1e-9 && most.x == free.x, "{most} {free}");
}

#[test]
fn scenarios_are_combined_as_requested() {
    let best = |combination: Combination, weight: f64| {
        let scenario = |start: f64| Experiment::default().final_time(50.0).start_value("x", start);
        let design = Design::builder(tank())
            .goal("integral(x) + k**2".parse().unwrap())
            .parameter(Parameter::new("k", 2.0).bounds(0.1, 10.0))
            .scenario(scenario(1.0))
            .scenario(scenario(8.0).scenario_weight(weight))
            .combine(combination)
            .build()
            .unwrap();
        design.optimize(FitOptions::default()).unwrap()
    };
    // Minimum of s/k + w k^2 for the sums s and w of start values and weights.
    for (combination, weight, s, w) in [
        (Combination::Sum, 1.0, 9.0, 2.0),
        (Combination::Mean, 1.0, 9.0, 2.0),
        (Combination::Worst, 1.0, 8.0, 1.0),
        (Combination::Sum, 0.25, 3.0, 1.25),
    ] {
        let result = best(combination, weight);
        let expected = f64::cbrt(s / (2.0 * w));
        assert!((result.x[0] / expected - 1.0).abs() < 3e-3, "{combination:?}: {result} {expected}");
    }
}

#[test]
fn references_may_be_columns_of_the_scenario() {
    let data = Data::from_columns(vec![0.0, 5.0], [("target".to_owned(), vec![1.0, 0.0])]).unwrap();
    let design = Design::builder(tank())
        .goal("ise(x, target)".parse().unwrap())
        .parameter(Parameter::new("k", 1.0))
        .scenario(Experiment::new(data))
        .build()
        .unwrap();
    let value = design.evaluate(&[1.0], &RunContext::new()).unwrap().goals[0];
    let e5 = (-5.0_f64).exp();
    // Integrals of x^2, of 2 x (1 - t / 5) and of (1 - t / 5)^2.
    let expected = (1.0 - e5 * e5) / 2.0 - 2.0 * (1.0 - (1.0 - e5) / 5.0) + 5.0 / 3.0;
    assert!((value - expected).abs() < 1e-4, "{value} {expected}");
}

#[test]
fn mistakes_in_designs_are_named_with_their_columns() {
    let built =
        |goal: &str, constraint: Option<&str>, scenario: Experiment| -> Result<Design, CalibrationError> {
            let mut builder = Design::builder(tank()).parameter(Parameter::new("k", 1.0)).scenario(scenario);
            builder = builder.goal(goal.parse().unwrap());
            if let Some(constraint) = constraint {
                builder = builder.constraint(constraint.parse().unwrap());
            }
            builder.build()
        };
    let whole = || Experiment::default().final_time(1.0);
    for (goal, constraint, scenario, expected) in [
        (
            "ise(X2, 1)",
            None,
            whole(),
            "objective 'ise(X2, 1)': 'X2' ('x'?) is neither a variable of the model nor a column of the scenario (column 5)",
        ),
        (
            "maximize final(x) + kk",
            None,
            whole(),
            "'kk' ('k'?) is not a parameter; available: k. A variable of the model needs a criterion, such as final(kk) (column 21)",
        ),
        ("final(x)", Some("max(y) <= 1"), whole(), "constraint 'max(y) <= 1': 'y' ('x'?) is neither"),
        ("final(x)", Some("final(x) <= q"), whole(), "'q' ('k'?) is not a parameter"),
        (
            "final(x)",
            None,
            whole().final_time(-1.0),
            "final_time = -1 must be later than the start of the simulation, 0",
        ),
        (
            "final(x)",
            None,
            whole().scenario_weight(-2.0),
            "weight = -2 must be a finite number of at least 0",
        ),
    ] {
        let error = built(goal, constraint, scenario).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let none = Design::builder(tank()).parameter(Parameter::new("k", 1.0)).build().unwrap_err();
    assert!(none.to_string().contains("objective is missing"), "{none}");
    let derived = Parameter::derived("d", "max(x)").unwrap();
    let error = Design::builder(tank())
        .goal("final(x)".parse().unwrap())
        .parameter(Parameter::new("k", 1.0))
        .parameter(derived)
        .build()
        .unwrap_err();
    assert!(error.to_string().contains("max(x) needs a simulation"), "{error}");
}
