//! Runs requested by name.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use dfo::{
    AnyMethod, Coefficients, DifferentialWeight, Error, LeastSquares, Lookahead, MethodOptions, NelderMead,
    ParameterKind, ProblemClass, QuadraticModel, Record, RequestedRun, RunOptions, Search, Selection,
    StopRule, ToleranceMeasure, Transform, Value,
};
use std::time::Duration;

fn record(json: serde_json::Value) -> Record {
    match Value::from(json) {
        Value::Record(record) => record,
        other => Record::from([("no record".to_owned(), other)]),
    }
}

fn requested(json: serde_json::Value) -> Result<RequestedRun, Error> {
    RequestedRun::new(RunOptions::default(), &record(json), 2)
}

/// Returns the method chosen for costs in a box of two parameters.
fn chosen(json: serde_json::Value) -> Result<(AnyMethod, String), Error> {
    chosen_for(json, false)
}

fn chosen_for(mut json: serde_json::Value, residuals: bool) -> Result<(AnyMethod, String), Error> {
    json["method"] = "auto".into();
    let method = requested(json)?.options.method;
    let class = ProblemClass {
        lower: &[0.0; 2],
        upper: &[1.0; 2],
        kinds: &[],
        residuals,
        search: Search::Local,
        linear: false,
        nonlinear: false,
        equalities: false,
    };
    Ok(method.chosen(&class)?.unwrap_or((method, "the choice was not open".to_owned())))
}

#[test]
fn record_sets_options_by_name() {
    let run = requested(serde_json::json!({
        "method": "NELDER_MEAD", "x_tol": 1e-3, "tolerances": "Absolute", "stop": "any", "max_fevals": 40.0, "max_time": 2,
        "cache": null, "batch": "Ahead", "coefficients": [1, 2, 0.5, 0.4], "scale": "log", "kinds": ["integer", "continuous"],
        "nominal": [null, 3], "checkpoint": "a.ckpt", "checkpoint_interval": 5
    }))
    .unwrap();
    let options = &run.options;
    assert_eq!(options.tolerances.x_tol, 1e-3);
    assert_eq!((options.tolerances.f_tol, options.tolerances.stop), (1e-6, StopRule::Any));
    assert_eq!(options.tolerances.measure, ToleranceMeasure::Absolute);
    assert_eq!(options.limits.max_evaluations, Some(40));
    assert_eq!(options.limits.max_time, Some(Duration::from_secs(2)));
    assert_eq!(options.checkpoint.as_ref().unwrap().interval, Duration::from_secs(5));
    assert_eq!((run.scale, run.nominal), (vec![Transform::Log; 2], vec![None, Some(3.0)]));
    assert_eq!(run.kinds, [ParameterKind::Integer, ParameterKind::Continuous]);
    let coefficients =
        Coefficients::Custom { reflection: 1.0, expansion: 2.0, contraction: 0.5, shrink: 0.4 };
    let expected = NelderMead::default().batch(Lookahead::Workers).coefficients(coefficients);
    assert_eq!(options.method, expected.into());
}

#[test]
fn options_of_variants_are_set_by_name() {
    let run = requested(serde_json::json!({ "method": "de-classic", "weight": [0.5, 1], "population": 30 }))
        .unwrap();
    let AnyMethod::DifferentialEvolution(options) = run.options.method else { panic!("another method") };
    assert_eq!(options.population, Some(30));
    assert!(matches!(
        options.scheme,
        dfo::Scheme::Classic { weight: DifferentialWeight::Dither(0.5, 1.0), .. }
    ));
    let run = requested(serde_json::json!({ "method": "ga", "selection": 3, "stall": null })).unwrap();
    let AnyMethod::Genetic(options) = run.options.method else { panic!("another method") };
    assert_eq!((options.selection, options.stall), (Selection::Tournament(3), None));
}

/// The options of a run reproduce its record.
#[test]
fn record_of_a_run_requests_the_same_run() {
    for json in [
        serde_json::json!({ "method": "auto", "search": "global", "x_tol": 1e-5, "seed": 3, "workers": 2 }),
        serde_json::json!({ "method": "nelder-mead", "coefficients": [1, 2, 0.5, 0.4], "initial_simplex": [0.1, 0.2], "stop": "any" }),
        serde_json::json!({ "method": "least-squares", "batch": "rounds", "max_time": 2.5, "target": 1e-3, "max_failed": 0.25 }),
        serde_json::json!({ "method": "de-classic", "weight": [0.5, 1], "population": 30, "max_evaluations": 70, "unlimited": true }),
        serde_json::json!({ "method": "de", "initial_population": [[0.1, 0.2], [1, 2], [3, 4], [5, 6]], "lag": 0 }),
        serde_json::json!({ "method": "ga", "selection": 3, "stall": null, "max_iterations": 9, "tolerances": "absolute" }),
        serde_json::json!({ "method": "de", "checkpoint": "a.ckpt", "checkpoint_interval": 5, "resume": "never", "cache": 8 }),
        serde_json::json!({ "warm_start": [{ "x": [1.5, 2.5], "cost": 0.5, "residuals": [], "problem": "p" }], "trace_limit": 4 }),
    ] {
        let options = requested(json.clone()).unwrap().options;
        let record = RequestedRun::record(&options).unwrap();
        let again = RequestedRun::new(RunOptions::default(), &record, 2).unwrap().options;
        assert_eq!(again, options, "{json}: {record:?}");
    }
    for name in AnyMethod::NAMES {
        let method = name.parse::<AnyMethod>().unwrap();
        let options = RunOptions { method, ..RunOptions::default() };
        let record = RequestedRun::record(&options).unwrap();
        let again = RequestedRun::new(RunOptions::default(), &record, 2).unwrap().options;
        assert_eq!(again.method, options.method, "{record:?}");
    }
}

/// Python's names of options have the same meaning in a record.
#[test]
fn record_accepts_python_option_names() {
    let run = requested(serde_json::json!({ "rng": 7, "workers": 3, "batch": "workers" })).unwrap().options;
    assert_eq!((run.seed, run.workers), (Some(7), Some(3)));
    assert_eq!(run.method, NelderMead::default().batch(Lookahead::Points(3)).into());
    let cores = std::thread::available_parallelism().unwrap().get();
    assert_eq!(requested(serde_json::json!({ "workers": -1 })).unwrap().options.workers, Some(cores));
    for workers in [0, -2] {
        let error = requested(serde_json::json!({ "workers": workers })).unwrap_err().to_string();
        assert_eq!(error, format!("workers = {workers} must be at least 1, or -1 for all cores"));
    }
}

#[test]
fn infinite_limits_mean_no_limit() {
    let limits = Record::from([
        ("max_evaluations".to_owned(), Value::Number(f64::INFINITY)),
        ("max_time".to_owned(), Value::Number(f64::INFINITY)),
        ("target".to_owned(), Value::Number(f64::NEG_INFINITY)),
    ]);
    let limits = RequestedRun::new(RunOptions::default(), &limits, 1).unwrap().options.limits;
    assert_eq!((limits.max_evaluations, limits.max_time), (None, None));
    assert_eq!(limits.target, Some(f64::NEG_INFINITY));
}

#[test]
fn chosen_method_receives_given_options() {
    let (method, _) = chosen(serde_json::json!({ "points": 6 })).unwrap();
    assert_eq!(method, QuadraticModel::default().points(6).hand_over(true).into());
    let (method, reason) = chosen(serde_json::json!({ "batch": "ahead" })).unwrap();
    assert_eq!(method, NelderMead::default().batch(Lookahead::Workers).into());
    assert_eq!(reason, "the batch plan 'ahead' belongs to nelder-mead");
    let (method, reason) = chosen(serde_json::json!({ "initial_simplex": [0.1, 0.2] })).unwrap();
    assert_eq!(method, NelderMead::default().initial_steps(&[0.1, 0.2]).into());
    assert_eq!(reason, "the option 'initial_simplex' belongs to nelder-mead");
    // A plan of the chosen method is applied to it, and "auto" applies to any method.
    let residuals = "the objective returns residuals".to_owned();
    let rounds = AnyMethod::from(LeastSquares::default().rounds());
    for (plan, method) in [
        (serde_json::json!("Serial"), LeastSquares::default().serial().into()),
        (serde_json::json!("auto"), LeastSquares::default().into()),
        (serde_json::json!("rounds"), rounds),
        (serde_json::json!(3), LeastSquares::default().batch(3).into()),
    ] {
        let chosen = chosen_for(serde_json::json!({ "batch": plan }), true).unwrap();
        assert_eq!(chosen, (method, residuals.clone()), "{plan}");
    }
    let (method, reason) = chosen_for(serde_json::json!({ "batch": "ahead" }), true).unwrap();
    assert_eq!((method.name(), &*reason), ("nelder-mead", "the batch plan 'ahead' belongs to nelder-mead"));
    let (method, _) = chosen(serde_json::json!({ "batch": "auto" })).unwrap();
    assert_eq!(method, QuadraticModel::default().hand_over(true).into());
    let error = chosen(serde_json::json!({ "batsch": 2 })).unwrap_err().to_string();
    assert!(error.starts_with("quadratic-model has no option 'batsch'"), "{error}");
}

#[test]
fn errors_name_option_and_value() {
    for (json, message, is_type) in [
        (serde_json::json!({ "x_tol": "small" }), "x_tol must be a number, not 'small'", true),
        (serde_json::json!({ "max_fevals": 0 }), "max_fevals = 0 must be an integer of at least 1", false),
        (
            serde_json::json!({ "stop": "both" }),
            "stop = 'both' is invalid; expected one of: 'any', 'all'",
            false,
        ),
        (serde_json::json!({ "stop": 1 }), "stop must be a string, not 1", true),
        (serde_json::json!({ "max_time": 0 }), "max_time = 0 must be a positive number of seconds", false),
        (
            serde_json::json!({ "method": "ga", "selection": -3 }),
            "option 'selection' of ga must be 'fitness', or the number of members in a tournament, not -3",
            false,
        ),
        (
            serde_json::json!({ "method": "cma-es", "population": true }),
            "option 'population' of cma-es must be an integer of at least 0 or None, not true",
            true,
        ),
        (
            serde_json::json!({ "kinds": ["integer"] }),
            "kinds: expected 2 values, one per parameter; got 1",
            false,
        ),
    ] {
        let error = requested(json).unwrap_err();
        let Error::Record(refused) = &error else { panic!("{error}") };
        assert_eq!((error.to_string().as_str(), refused.is_type()), (message, is_type));
    }
    let error = requested(serde_json::json!({ "method": "nm", "batsch": 2 })).unwrap_err().to_string();
    assert!(
        error
            .starts_with("nelder-mead has no option 'batsch'; did you mean 'batch'? its options are batch, "),
        "{error}"
    );
    let error = requested(serde_json::json!({ "method": "de", "search": "global" })).unwrap_err().to_string();
    assert!(error.contains("selects the method automatically"), "{error}");
}
