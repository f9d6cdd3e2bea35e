//! Costs that are not sums of squares, and user-defined functions.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::dfo::{AnyMethod, LeastSquares, Loss, NelderMead, RobustLoss, RunOptions, Termination};
use calibration::{
    Calibration, Compared, CostKind, CustomCost, CustomFailure, Data, Experiment, Fit, FitOptions, NamedCost,
    OutputScale, Parameter, Stage, Weight,
};
use example_models::example_fmu;

/// x' = -k x with k = 2, with an asymmetric error and one outlier.
fn calibration() -> Calibration {
    let t: Vec<f64> = (0..31).map(|i| f64::from(i) / 10.0).collect();
    let error = |i: usize| if i == 7 { 0.5 } else { [2e-3, -1e-3, 0.0][i % 3] };
    let x = t.iter().enumerate().map(|(i, t)| (-2.0 * t).exp() + error(i)).collect();
    let fmu = fmi::Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
    Calibration::builder(fmu)
        .experiment(Experiment::new(Data::from_columns(t, [("x".to_owned(), x)]).unwrap()).output("x", "x"))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
        .build()
        .unwrap()
}

fn fit(objective: CostKind, method: Option<AnyMethod>) -> Fit {
    let mut run = FitOptions::default_run();
    if let Some(method) = method {
        run.method = method;
    }
    calibration().fit(FitOptions { objective, ..run.into() }).unwrap()
}

fn mean_absolute(compared: &[Compared<'_>]) -> f64 {
    let [one] = compared else { return f64::NAN };
    let sum: f64 = one.simulated.iter().zip(one.measured).map(|(s, m)| (s - m).abs()).sum();
    sum / one.measured.len() as f64
}

#[test]
fn named_costs_are_minimised_by_scalar_methods() {
    let calibration = calibration();
    let squares = fit(CostKind::SumOfSquares, None);
    assert_eq!((&*squares.report.method, squares.objective.as_str()), ("least-squares", "sum-of-squares"));
    for named in [NamedCost::Mae, NamedCost::Rmse, NamedCost::Nrmse, NamedCost::Likelihood] {
        let found = fit(CostKind::Named(named), None);
        let is_likelihood = named == NamedCost::Likelihood;
        let method = if is_likelihood { "least-squares" } else { "quadratic-model" };
        assert_eq!((&*found.report.method, found.objective.as_str()), (method, named.name()));
        assert!(found.report.is_success() && found.uncertainty.is_some() == is_likelihood, "{found}");
        let r = calibration.residuals(&found.x, &RunContext::new()).unwrap();
        let n = r.len() as f64;
        let sum: f64 = r.iter().map(|r| r * r).sum();
        let expected = match named {
            NamedCost::Mae => r.iter().map(|r| r.abs()).sum::<f64>() / n,
            NamedCost::Rmse => (sum / n).sqrt(),
            NamedCost::Nrmse => (sum / n).sqrt() / (1.002 - (-6.0_f64).exp() - 2e-3),
            _ => 0.5 * n * (sum / n).ln(),
        };
        assert!((found.cost / expected - 1.0).abs() < 2e-3, "{named:?}: {} {expected}", found.cost);
        assert!((found.rms - (sum / n).sqrt()).abs() < 1e-12 && found.scaled_rms() < Some(0.9));
        match named {
            // One outlier counts as much as any other residual.
            NamedCost::Mae => assert!((found.x[0] - 2.0).abs() < 0.01 && (squares.x[0] - 2.0).abs() > 0.05),
            _ => assert!((found.x[0] / squares.x[0] - 1.0).abs() < 1e-3, "{found}"),
        }
    }
}

#[test]
fn custom_functions_return_costs_or_residuals() {
    let named = fit(CostKind::Named(NamedCost::Mae), None);
    let custom = CustomCost::cost("mine", |compared| Ok(mean_absolute(compared)));
    let found = fit(CostKind::Custom(custom), None);
    assert_eq!((&*found.report.method, found.objective.as_str()), ("quadratic-model", "mine"));
    assert!((found.x[0] - named.x[0]).abs() < 1e-4, "{found}");
    let weighted = CustomCost::residuals("weighted", |compared| {
        let pairs = compared.iter().flat_map(|c| c.simulated.iter().zip(c.measured));
        Ok(pairs.map(|(s, m)| 2.0 * (s - m)).chain([0.0]).collect())
    });
    let (found, squares) = (fit(CostKind::Custom(weighted), None), fit(CostKind::SumOfSquares, None));
    assert_eq!(found.report.method, "least-squares");
    assert!((found.x[0] - squares.x[0]).abs() < 1e-4 && (found.cost / squares.cost - 4.0).abs() < 1e-6);
    assert!((found.rms - squares.rms).abs() < 1e-9);
    // The cost also works in stages.
    let custom = CustomCost::cost("mine", |compared| Ok(mean_absolute(compared)));
    let options = FitOptions { objective: CostKind::Custom(custom), ..FitOptions::default() };
    let staged = calibration().fit_stages(&[Stage::new(["k"])], options).unwrap();
    assert_eq!(
        (staged.x[0], staged.objective.as_str()),
        (fit(CostKind::Custom(CustomCost::cost("mine", |c| Ok(mean_absolute(c)))), None).x[0], "mine")
    );
}

#[test]
fn custom_function_can_fail_at_a_point_or_end_the_fit() {
    let failing = |k: fn(f64) -> Result<f64, CustomFailure>| {
        CostKind::Custom(CustomCost::cost("failing", move |compared| k(mean_absolute(compared))))
    };
    let run =
        || RunOptions { method: NelderMead::default().into(), workers: Some(1), ..FitOptions::default_run() };
    let some =
        failing(|cost| if cost > 0.05 { Err(CustomFailure::Failed("too far".to_owned())) } else { Ok(cost) });
    let options = FitOptions { objective: some, start: Some(vec![2.2]), ..run().into() };
    let found = calibration().fit(options).unwrap();
    assert!((found.x[0] - 2.0).abs() < 0.01, "{found}");
    let ended =
        failing(|cost| if cost < 0.03 { Err(CustomFailure::Abort("enough".to_owned())) } else { Ok(cost) });
    let found = calibration().fit(FitOptions { objective: ended, ..run().into() }).unwrap();
    assert_eq!(found.report.termination, Termination::Aborted("enough".to_owned()));
    assert!(found.cost >= 0.03);
}

#[test]
fn incompatible_cost_options_are_rejected() {
    let error = |objective: CostKind, loss: RobustLoss, method: AnyMethod| {
        let run = RunOptions { method, ..FitOptions::default_run() };
        calibration().fit(FitOptions { objective, loss, ..run.into() }).unwrap_err().to_string()
    };
    let mae = || CostKind::Named(NamedCost::Mae);
    let reported = error(mae(), RobustLoss::default(), LeastSquares::default().into());
    assert!(
        reported.contains("least-squares requires a sum of squares, and the objective 'mae' is not one"),
        "{reported}"
    );
    let huber = RobustLoss::new(Loss::Huber, 1.0).unwrap();
    let reported = error(mae(), huber, NelderMead::default().into());
    assert!(reported.contains("Remove it with the objective 'mae'"), "{reported}");
    // A checkpoint of one objective cannot be used for another.
    let folder = tempfile::tempdir().unwrap();
    let with = |objective: CostKind| {
        let checkpoint = Some(calibration::dfo::Checkpoint::new(folder.path().join("fit.ckpt")));
        let run =
            RunOptions { checkpoint, method: NelderMead::default().into(), ..FitOptions::default_run() };
        calibration().fit(FitOptions { objective, ..run.into() })
    };
    with(mae()).unwrap();
    let reported = with(CostKind::Named(NamedCost::Rmse)).unwrap_err().to_string();
    assert!(reported.contains("problem"), "{reported}");
}

#[test]
fn outputs_are_weighted_by_the_scale_of_measurements() {
    let (t, x) = (vec![0.0, 0.5, 1.0, 1.5], vec![4.0, f64::NAN, 1.0, 1.0]);
    let make = |x: Vec<f64>, scale: OutputScale| {
        let data = Data::from_columns(t.clone(), [("x".to_owned(), x)]).unwrap();
        let experiment =
            Experiment::new(data).weighted_output("x", "x", Weight::Inverse(scale)).window(1.0, 1.5);
        Calibration::builder(fmi::Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
            .experiment(experiment)
            .parameter(Parameter::new("k", 1.0))
            .build()
    };
    for (scale, size) in
        [(OutputScale::Range, 3.0), (OutputScale::Mean, 2.0), (OutputScale::Sd, 3.0_f64.sqrt())]
    {
        // The whole recording determines the scale, even if only a part counts in the fit.
        let calibration = make(x.clone(), scale).unwrap();
        assert_eq!(calibration.residual_layout().outputs[0].weights[..], [1.0 / size; 2]);
        let reported = make(vec![0.0; 4], scale).unwrap_err().to_string();
        assert!(
            reported.contains(&format!("have the {} 0, which cannot be used as a weight", scale.name())),
            "{reported}"
        );
    }
}
