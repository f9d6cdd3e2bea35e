//! Runs that are asked for by name.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use dfo::{
    AnyMethod, Coefficients, DifferentialWeight, Error, Lookahead, MethodOptions, NelderMead, ParameterKind,
    ProblemClass, QuadraticModel, Record, RequestedRun, RunOptions, Search, Selection, StopRule,
    ToleranceMeasure, Transform, Value,
};
use std::time::Duration;

fn record(json: serde_json::Value) -> Record {
    match Value::from(json) {
        Value::Record(record) => record,
        other => Record::from([("no record".to_owned(), other)]),
    }
}

fn asked(json: serde_json::Value) -> Result<RequestedRun, Error> {
    RequestedRun::new(RunOptions::default(), &record(json), 2)
}

/// The method that is chosen for costs in a box of two parameters.
fn chosen(mut json: serde_json::Value) -> Result<(AnyMethod, String), Error> {
    json["method"] = "auto".into();
    let method = asked(json)?.options.method;
    let class = ProblemClass {
        lower: &[0.0; 2],
        upper: &[1.0; 2],
        kinds: &[],
        residuals: false,
        search: Search::Local,
    };
    Ok(method.chosen(&class)?.unwrap_or((method, "the choice was not open".to_owned())))
}

#[test]
fn names_find_their_places() {
    let run = asked(serde_json::json!({
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
fn options_of_variants_are_options_like_the_others() {
    let run =
        asked(serde_json::json!({ "method": "de-classic", "weight": [0.5, 1], "population": 30 })).unwrap();
    let AnyMethod::DifferentialEvolution(options) = run.options.method else { panic!("another method") };
    assert_eq!(options.population, Some(30));
    assert!(matches!(
        options.scheme,
        dfo::Scheme::Classic { weight: DifferentialWeight::Dither(0.5, 1.0), .. }
    ));
    let run = asked(serde_json::json!({ "method": "ga", "selection": 3, "stall": null })).unwrap();
    let AnyMethod::Genetic(options) = run.options.method else { panic!("another method") };
    assert_eq!((options.selection, options.stall), (Selection::Tournament(3), None));
}

#[test]
fn infinite_limits_are_none() {
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
fn open_choices_carry_their_options() {
    let (method, _) = chosen(serde_json::json!({ "points": 6 })).unwrap();
    assert_eq!(method, QuadraticModel::default().points(6).hand_over(true).into());
    let (method, reason) = chosen(serde_json::json!({ "batch": "ahead" })).unwrap();
    assert_eq!(method, NelderMead::default().batch(Lookahead::Workers).into());
    assert_eq!(reason, "the batch plan 'ahead' is one of nelder-mead");
    let (method, reason) = chosen(serde_json::json!({ "initial_simplex": [0.1, 0.2] })).unwrap();
    assert_eq!(method, NelderMead::default().initial_steps(&[0.1, 0.2]).into());
    assert_eq!(reason, "the option 'initial_simplex' is one of nelder-mead");
    let error = chosen(serde_json::json!({ "batsch": 2 })).unwrap_err().to_string();
    assert!(error.starts_with("quadratic-model has no option 'batsch'"), "{error}");
}

#[test]
fn errors_name_option_and_value() {
    for (json, message, is_type) in [
        (serde_json::json!({ "x_tol": "small" }), "x_tol must be a number, not 'small'", true),
        (serde_json::json!({ "max_fevals": 0 }), "max_fevals = 0 must be a whole number, at least 1", false),
        (serde_json::json!({ "stop": "both" }), "stop = 'both' is none of 'any', 'all'", false),
        (serde_json::json!({ "stop": 1 }), "stop must be a string, not 1", true),
        (serde_json::json!({ "max_time": 0 }), "max_time = 0 must be a positive number of seconds", false),
        (
            serde_json::json!({ "method": "ga", "selection": -3 }),
            "option 'selection' of ga must be 'fitness', or a number of members: the size of a tournament, not -3",
            false,
        ),
        (
            serde_json::json!({ "method": "cma-es", "population": true }),
            "option 'population' of cma-es must be a whole number, at least 0 or None, not true",
            true,
        ),
        (serde_json::json!({ "kinds": ["integer"] }), "kinds has 1 values for 2 parameters", false),
    ] {
        let error = asked(json).unwrap_err();
        let Error::Record(refused) = &error else { panic!("{error}") };
        assert_eq!((error.to_string().as_str(), refused.is_type()), (message, is_type));
    }
    let error = asked(serde_json::json!({ "method": "nm", "batsch": 2 })).unwrap_err().to_string();
    assert!(
        error.starts_with("nelder-mead has no option 'batsch'; did you mean 'batch'? it has batch, "),
        "{error}"
    );
    let error = asked(serde_json::json!({ "method": "de", "search": "global" })).unwrap_err().to_string();
    assert!(error.contains("leaves the choice of the method to the run"), "{error}");
}
