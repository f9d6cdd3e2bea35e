//! Derived parameters: `k3 = 1 - k1 - k2`.

use calibration::{
    BootstrapOptions, Calibration, CalibrationBuilder, CrossValidationOptions, Data, Experiment, FitOptions,
    Parameter, ProfileOptions, RunContext, SavedFit, Table,
};
use dfo::{AnyMethod, LeastSquares, Limits, NelderMead, RunOptions};
use example_models::example_fmu;
use fmi::Fmu;

/// x' = -k x from x(0) = x0.
fn decay(x0: f64, k: f64) -> Experiment {
    let time: Vec<f64> = (0..21).map(|i| 0.1 * f64::from(i)).collect();
    let noise = |t: f64| 1e-3 * (40.0 * t).sin();
    let x = time.iter().map(|t| x0 * (-k * t).exp() + noise(*t)).collect();
    Experiment::new(Data::from_columns(time, [("x".to_owned(), x)]).unwrap()).output("x", "x")
}

fn builder(experiment: Experiment) -> CalibrationBuilder {
    Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap()).experiment(experiment)
}

fn k() -> Parameter {
    Parameter::new("k", 1.0).bounds(0.1, 10.0)
}

fn derived(name: &str, expr: &str) -> Parameter {
    Parameter::derived(name, expr).unwrap()
}

fn with(method: impl Into<AnyMethod>) -> FitOptions<'static> {
    RunOptions { method: method.into(), ..FitOptions::default_run() }.into()
}

fn calibration(parameters: impl IntoIterator<Item = Parameter>) -> Calibration {
    parameters.into_iter().fold(builder(decay(1.5, 2.0)), CalibrationBuilder::parameter).build().unwrap()
}

fn error(parameters: impl IntoIterator<Item = Parameter>) -> String {
    let builder = parameters.into_iter().fold(builder(decay(1.5, 2.0)), CalibrationBuilder::parameter);
    builder.build().unwrap_err().to_string()
}

/// The start x0 follows from the rate k, which the data determine.
#[test]
fn derived_parameter_has_the_value_and_the_error_of_its_formula() {
    let one = calibration([k(), derived("x", "3 / k").display_name("start")]);
    let explicit = calibration([k(), Parameter::new("x", 1.0)]);
    let context = RunContext::new();
    assert_eq!(
        one.cost(&[1.7], &context).unwrap().to_bits(),
        explicit.cost(&[1.7, 3.0 / 1.7], &context).unwrap().to_bits()
    );
    let fit = one.fit(FitOptions::default()).unwrap();
    assert!((fit.x[0] - 2.0).abs() < 1e-2, "{fit}");
    let [found] = &fit.derived[..] else { panic!("{fit}") };
    assert_eq!((&found.name[..], found.value, found.start), ("x", 3.0 / fit.x[0], 3.0));
    let uncertainty = fit.uncertainty.as_ref().unwrap();
    let expected = 3.0 / (fit.x[0] * fit.x[0]) * uncertainty.standard_errors[0];
    assert!((found.standard_error(uncertainty) / expected - 1.0).abs() < 1e-12);
    assert!(fit.to_string().contains("derived: 3 / k"), "{fit}");
    let json: serde_json::Value = serde_json::from_str(&fit.to_json(&one).unwrap()).unwrap();
    let entry = &json["parameters"][1];
    assert_eq!((&entry["name"], &entry["expr"]), (&"x".into(), &"3 / k".into()), "{json}");
    let csv = fit.csv(&one, Table::Parameters, &context).unwrap();
    assert!(csv.lines().nth(2).unwrap().ends_with(",,3 / k"), "{csv}");

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("decay.fit");
    fit.save(&one, &path).unwrap();
    let saved = SavedFit::load(&path).unwrap();
    assert_eq!(saved.fit, fit);
    assert_eq!(saved.calibration().unwrap().cost(&fit.x, &context).unwrap(), fit.cost);
}

#[test]
fn error_of_derived_parameter_uses_the_covariance() {
    let offset = derived("offset", "2*k - 3*x + 0.5").offset_of("x");
    let both = calibration([k(), Parameter::new("x", 1.0).bounds(0.1, 10.0), offset]);
    let fit = both.fit(FitOptions::default()).unwrap();
    let uncertainty = fit.uncertainty.as_ref().unwrap();
    let [a, b] = [uncertainty.standard_errors[0], uncertainty.standard_errors[1]];
    let expected = (4.0 * a * a + 9.0 * b * b - 12.0 * uncertainty.covariance[1]).sqrt();
    assert_eq!(fit.derived[0].slopes, [2.0, -3.0]);
    assert!((fit.derived[0].standard_error(uncertainty) / expected - 1.0).abs() < 1e-9);
    let (lower, upper) = fit.derived[0].confidence_interval(uncertainty, 0.95).unwrap();
    assert!((0.5 * (lower + upper) - fit.derived[0].value).abs() < 1e-12 && upper - lower > 2.0 * expected);
}

#[test]
fn tied_parameter_equals_its_formula_bit_for_bit() {
    let tied = calibration([k(), Parameter::tied("x", "k", 0.7, 0.1)]);
    let formula = calibration([k(), derived("x", "0.7*k + 0.1")]);
    let run = |calibration: &Calibration| calibration.fit(FitOptions::default()).unwrap();
    let (one, other) = (run(&tied), run(&formula));
    assert_eq!(one.x[0].to_bits(), other.x[0].to_bits());
    assert_eq!(one.cost.to_bits(), other.cost.to_bits());
    assert_eq!(one.derived[0].value.to_bits(), other.derived[0].value.to_bits());
    assert_eq!(one.derived[0].tied_to.as_deref(), Some("k"));
}

#[test]
fn chains_of_derived_parameters_are_evaluated_in_any_order() {
    let chain =
        calibration([derived("x", "half + 0.5"), Parameter::tied("half", "k", 0.5, 0.0).offset_of("x"), k()]);
    let values = chain.derived_values(&[2.0]);
    assert_eq!(values, [("x".to_owned(), 1.5), ("half".to_owned(), 1.0)]);
    let fit = chain.fit(FitOptions::default()).unwrap();
    assert_eq!((fit.derived[0].slopes[0], fit.derived[1].slopes[0]), (0.5, 0.5));
}

/// Two fractions of a sum: `share` and `sum` set no variable, and `ratio` is only a result.
#[test]
fn parameters_without_variables_act_through_formulas() {
    let nothing = || Vec::<String>::new();
    let shares = calibration([
        Parameter::new("sum", 3.0).bounds(0.5, 10.0).variables(nothing()),
        Parameter::new("share", 0.4).bounds(0.05, 0.95).variables(nothing()),
        derived("k", "sum * share"),
        derived("x", "sum * (1 - share)"),
        derived("ratio", "k / x").variables(nothing()),
    ]);
    let direct = calibration([k(), Parameter::new("x", 1.0).bounds(0.1, 10.0)]);
    let (one, other) =
        (shares.fit(FitOptions::default()).unwrap(), direct.fit(FitOptions::default()).unwrap());
    assert!(
        (one.derived[0].value - other.x[0]).abs() < 1e-3 && (one.derived[1].value - other.x[1]).abs() < 1e-3
    );
    assert_eq!(shares.model_values(0, &one.x).len(), 2);
    let [of_one, of_other] = [&one, &other].map(|fit| fit.uncertainty.as_ref().unwrap());
    // The same model in other coordinates has the same errors.
    for i in 0..2 {
        let ratio = one.derived[i].standard_error(of_one) / of_other.standard_errors[i];
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    }
    let error = error([k(), Parameter::new("unused", 1.0).variables(nothing())]);
    assert!(
        error.contains("'unused': variables is empty. Specify the variables that it sets, or use it"),
        "{error}"
    );
}

#[test]
fn mistakes_in_formulas_are_named() {
    for (parameters, expected) in [
        (
            vec![k(), derived("x", "1 - kk")],
            "'x': expr: the expression contains 'kk' ('k'?), which does not exist",
        ),
        (vec![k(), derived("x", "1 - kk")], "(column 5)"),
        (vec![k(), derived("x", "x + k")], "'x': it follows from itself: 'x' from 'x'"),
        (
            vec![k(), derived("x", "b + k"), derived("b", "2*x").offset_of("x")],
            "it follows from itself: 'x' from 'b' from 'x'",
        ),
        (vec![k(), Parameter::tied("x", "kk", 1.0, 0.0)], "it is tied to 'kk' ('k'?), which does not exist"),
        (
            vec![k(), derived("x", "1 - k").bounds(0.5, 2.0)],
            "1 - k is 0 at the start (k = 1), below its lower bound 0.5",
        ),
        (vec![k(), derived("x", "log(k - 3)")], "log(k - 3) is NaN at the start (k = 1), not finite"),
        (
            vec![k(), Parameter::new("e", 1.0).offset_of("x"), derived("x", "k * e")],
            "'e' is a constant and a parameter. Quote the parameter, 'e' (column 5)",
        ),
    ] {
        let message = error(parameters);
        assert!(message.contains(expected), "{message}");
    }
    let error = Parameter::derived("x", "1 - k ^ 2").unwrap_err().to_string();
    assert!(
        error.starts_with("parameter 'x': expr: '^' is not an operator. Write ** for a power (column 7)"),
        "{error}"
    );
}

#[test]
fn derived_value_outside_its_bounds_is_a_failed_evaluation() {
    let bounded = calibration([k(), derived("x", "3 / k").bounds(0.5, 3.0)]);
    let message = bounded.cost(&[0.5], &RunContext::new()).unwrap_err().to_string();
    assert!(message.contains("'x' = 3 / k is 6, above its upper bound 3, at k = 0.5"), "{message}");
    for options in [FitOptions::default(), with(NelderMead::default())] {
        let fit = bounded.fit(options).unwrap();
        assert!((fit.x[0] - 2.0).abs() < 1e-2, "{fit}");
    }
    let start = FitOptions { start: Some(vec![0.5]), ..FitOptions::default() };
    let message = bounded.fit(start).unwrap_err().to_string();
    assert!(message.contains("3 / k is 6 at the start (k = 0.5), above its upper bound 3"), "{message}");
    // The optimum of k is outside the bounds of x.
    let fit = calibration([k(), derived("x", "3 / k").bounds(1.6, 4.0)]).fit(FitOptions::default()).unwrap();
    assert!(fit.report.n_failed > 0 && fit.derived[0].value >= 1.6, "{fit}");
    let reason = &fit.report.failures[0].0;
    assert_eq!(reason, "the derived parameter 'x' is below its lower bound 1.6");
}

#[test]
fn derived_parameters_work_in_all_analyses() {
    let experiments = [decay(1.5, 2.0).named("a"), decay(1.5, 2.02).named("b"), decay(1.5, 1.98).named("c")];
    let all = experiments
        .into_iter()
        .fold(
            Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap()),
            CalibrationBuilder::experiment,
        )
        .parameter(k())
        .parameter(derived("x", "k - half"))
        .parameter(derived("half", "0.25 * k").offset_of("x").experiments(["c"]))
        .build();
    let all = all.unwrap();
    let fit = all.fit(FitOptions::default()).unwrap();
    assert!((fit.derived[0].value - 0.75 * fit.x[0]).abs() < 1e-15, "{fit}");
    let context = RunContext::new();
    let crossed = all.cross_validate(&CrossValidationOptions::default(), &context).unwrap();
    assert_eq!(crossed.folds.len(), 3);
    let profile = all.profile(&fit, &ProfileOptions::default(), &context).unwrap();
    assert_eq!(profile.parameters.len(), 1);
    let options = BootstrapOptions { n: 3, seed: Some(1), ..BootstrapOptions::default() };
    assert_eq!(all.bootstrap(&fit, &options, &context).unwrap().samples.len(), 3);
    let other = all.fit(with(LeastSquares::default())).unwrap();
    fit.compare(&other).unwrap();
}

/// Same bits for any number of workers, and after a resume.
#[test]
fn fits_with_derived_parameters_are_repeatable() {
    let folder = tempfile::tempdir().unwrap();
    let one = calibration([k(), derived("x", "3 / k").bounds(0.5, 3.0)]);
    let run = |workers: usize, most: Option<usize>, checkpoint: bool| {
        let limits = Limits { max_evaluations: most, ..Limits::default() };
        let checkpoint = checkpoint.then(|| {
            dfo::Checkpoint::new(folder.path().join("fit.ckpt")).interval(std::time::Duration::ZERO)
        });
        let method = NelderMead::default().into();
        let run =
            RunOptions { workers: Some(workers), limits, checkpoint, method, ..FitOptions::default_run() };
        one.fit(FitOptions { run, ..FitOptions::default() }).unwrap()
    };
    let (whole, parallel) = (run(1, None, false), run(3, None, false));
    assert_eq!(whole.x[0].to_bits(), parallel.x[0].to_bits());
    run(1, Some(8), true);
    let resumed = run(1, None, true);
    assert!(resumed.report.resumed.is_some());
    assert_eq!(resumed.x[0].to_bits(), whole.x[0].to_bits());
}

#[test]
fn derived_parameter_of_local_parameter_has_a_value_per_experiment() {
    let both = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(decay(1.0, 1.0).named("slow"))
        .experiment(decay(2.0, 2.0))
        .parameter(k().local(true))
        .parameter(derived("x", "(k + k) / 2"))
        .build()
        .unwrap();
    let expected = [("x[slow]".to_owned(), 1.0), ("x[run2]".to_owned(), 2.0)];
    assert_eq!(both.derived_values(&[1.0, 2.0]), expected);
    let fit = both.fit(FitOptions::default()).unwrap();
    assert_eq!(
        fit.derived.iter().map(|derived| &derived.slopes[..]).collect::<Vec<_>>(),
        [[1.0, 0.0], [0.0, 1.0]]
    );
}

#[test]
fn bounds_of_a_derived_delay_limit_the_simulation() {
    let delayed = calibration([k(), derived("tau", "0.1 * k - 0.2").delay_of("x")]);
    assert!(delayed.cost(&[1.0], &RunContext::new()).is_ok());
    let message = error([k(), derived("tau", "-0.1 * k**2").delay_of("x")]);
    assert!(message.contains("'tau': its delay may reach -inf"), "{message}");
    calibration([k(), derived("tau", "-0.1 * k**2").bounds(-1.0, 0.0).delay_of("x")]);
}
