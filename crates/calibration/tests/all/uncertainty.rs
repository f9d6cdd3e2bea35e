//! Uncertainty of a fit, compared with closed forms and published numbers.

#![allow(clippy::print_stderr, clippy::unwrap_used)]

use calibration::RunContext;
use calibration::{
    Calibration, CostKind, Data, Estimator, Experiment, Fit, FitOptions, NamedCost, Parameter,
    PreflightOptions, Prior, Scale, Severity, Uncertainty, UncertaintyOptions,
};
use dfo::{Limits, NelderMead, RunOptions};
use example_models::example_fmu;
use std::path::Path;

fn open(name: &str) -> fmi::Fmu {
    fmi::Fmu::open(example_fmu(name).unwrap()).unwrap()
}

fn data(time: &[f64], columns: &[(&str, Vec<f64>)]) -> Data {
    let columns = columns.iter().map(|(name, values)| ((*name).to_owned(), values.clone()));
    Data::from_columns(time.to_vec(), columns).unwrap()
}

fn uncertainty(calibration: &Calibration, x: &[f64], estimator: Estimator) -> Uncertainty {
    let options = UncertaintyOptions { estimator, ..UncertaintyOptions::default() };
    calibration.uncertainty(x, &options, &RunContext::new()).unwrap()
}

fn near(got: f64, expected: f64, relative: f64) {
    assert!((got - expected).abs() <= relative * expected.abs(), "{got} instead of {expected}");
}

/// Numbers between -1 and 1 that look random.
fn noise(n: usize) -> impl Iterator<Item = f64> {
    (0..n).map(|k| 2.0 * ((k as f64 * 12.9898).sin() * 43758.5453).abs().fract() - 1.0)
}

/// x = x0 exp(-k t), with noise.
fn decay(parameters: impl IntoIterator<Item = Parameter>) -> Calibration {
    let time: Vec<f64> = (0..60).map(|k| 0.05 * f64::from(k)).collect();
    let x = time.iter().zip(noise(60)).map(|(t, e)| (-1.5 * t).exp() + 0.02 * e).collect();
    let builder = Calibration::builder(open("dahlquist"))
        .experiment(Experiment::new(data(&time, &[("x", x)])).output("x", "x"));
    parameters.into_iter().fold(builder, |builder, p| builder.parameter(p)).build().unwrap()
}

#[test]
fn standard_errors_of_decay_match_closed_form() {
    for scale in [Scale::Linear, Scale::Log] {
        let calibration = decay([Parameter::new("k", 1.0).bounds(0.1, 5.0).scale(scale)]);
        let fit = calibration.fit(FitOptions::default()).unwrap();
        let k = fit.x[0];
        let by_k = |t: f64| -t * (-k * t).exp();
        let sum: f64 = (0..60).map(|i| by_k(0.05 * f64::from(i)).powi(2)).sum();
        let uncertainty = fit.uncertainty.unwrap();
        let error = (fit.cost / 59.0 / sum).sqrt();
        near(uncertainty.standard_errors[0], error, 1e-3);
        assert_eq!((uncertainty.degrees_of_freedom, &uncertainty.correlation[..]), (59.0, &[1.0][..]));
        // Quantile of Student's t for 59 degrees of freedom.
        let (low, high) = uncertainty.confidence_intervals(0.95).unwrap()[0];
        match scale {
            Scale::Linear => near(high - low, 2.0 * 2.000_995_4 * error, 2e-3),
            _ => near((high / low).ln(), 2.0 * 2.000_995_4 * error / k, 2e-3),
        }
        assert!(
            uncertainty.confidence_intervals(1.0).is_err()
                && uncertainty.confidence_intervals(f64::NAN).is_err()
        );
        // After a short search, there is no accurate cost.
        uncertainty.accurate_cost.iter().for_each(|cost| near(*cost, fit.cost, 1e-5));
        assert_eq!(fit.report.n_evaluations, fit.report.trace.len());
        // The Jacobian is with respect to the parameter on every scale.
        uncertainty.jacobian.iter().enumerate().for_each(|(i, j)| {
            assert!((j - by_k(0.05 * i as f64)).abs() < 1e-3, "{i}");
        });
    }
}

#[test]
fn fixed_parameters_have_zero_standard_error() {
    // The best value for the data is k = 1.5.
    let at_bound = decay([Parameter::new("k", 1.0).bounds(0.1, 1.2), Parameter::new("x", 1.0)]);
    let fit = at_bound.fit(FitOptions::default()).unwrap();
    let uncertainty = fit.uncertainty.unwrap();
    assert_eq!(uncertainty.held, [0]);
    assert!(uncertainty.standard_errors[0] == 0.0 && uncertainty.standard_errors[1] > 0.0);
    assert!(uncertainty.correlation[1].is_nan() && uncertainty.correlation[0].is_nan());
    let fixed = decay([Parameter::new("k", 1.5).fixed(true), Parameter::new("x", 1.0)]);
    assert_eq!(fixed.fit(FitOptions::default()).unwrap().uncertainty.unwrap().held, [0]);
    // Conditional errors are smaller.
    let free = decay([Parameter::new("k", 1.5), Parameter::new("x", 1.0)]);
    let both = uncertainty_of(&free, &[]);
    let one = uncertainty_of(&free, &[0]);
    assert!(one.standard_errors[1] < 0.9 * both.standard_errors[1] && one.standard_errors[0] == 0.0);
    let wrong = UncertaintyOptions { held: vec![2], ..UncertaintyOptions::default() };
    assert!(
        free.uncertainty(&[1.5, 1.0], &wrong, &RunContext::new())
            .unwrap_err()
            .to_string()
            .contains("not below the number of parameters, 2")
    );
}

fn uncertainty_of(calibration: &Calibration, held: &[usize]) -> Uncertainty {
    let options = UncertaintyOptions { held: held.to_vec(), ..UncertaintyOptions::default() };
    calibration.uncertainty(&[1.5, 1.0], &options, &RunContext::new()).unwrap()
}

#[test]
fn uncertainty_is_independent_of_workers_and_uses_no_evaluations() {
    let calibration = decay([Parameter::new("k", 1.0).bounds(0.1, 5.0), Parameter::new("x", 1.2)]);
    let fit = |workers, uncertainty| -> Fit {
        let limits = Limits { max_evaluations: Some(60), ..Limits::default() };
        let run = RunOptions {
            method: NelderMead::default().into(),
            workers: Some(workers),
            limits,
            ..FitOptions::default_run()
        };
        calibration.fit(FitOptions { uncertainty, ..run.into() }).unwrap()
    };
    let fits: Vec<Fit> = [1, 3].map(|workers| fit(workers, Some(UncertaintyOptions::default()))).into();
    assert_eq!(fits[0].uncertainty, fits[1].uncertainty);
    let without = fit(1, None);
    assert_eq!(without.report.n_evaluations, fits[0].report.n_evaluations);
    assert!(without.uncertainty.is_none() && fits[0].uncertainty.as_ref().unwrap().n_simulations > 4);
    let cancelled = calibration
        .uncertainty(&[1.0, 1.0], &UncertaintyOptions::default(), &RunContext::new().polling(&|| true))
        .unwrap_err();
    assert!(matches!(cancelled, calibration::CalibrationError::Cancelled));
    assert!(calibration.uncertainty(&[1.0], &UncertaintyOptions::default(), &RunContext::new()).is_err());
}

#[test]
fn parameter_of_unreached_event_is_reported() {
    // The ball falls for 0.45 s before it bounces for the first time.
    let time: Vec<f64> = (0..40).map(|k| 0.01 * f64::from(k)).collect();
    let h = time.iter().zip(noise(40)).map(|(t, e)| 1.0 - 0.5 * 9.81 * t * t + 1e-3 * e).collect();
    let calibration = Calibration::builder(open("bouncing_ball"))
        .experiment(Experiment::new(data(&time, &[("h", h)])).output("h", "h"))
        .parameter(Parameter::new("e", 0.7).bounds(0.1, 0.95))
        .parameter(Parameter::new("g", -9.0).bounds(-15.0, -5.0))
        .build()
        .unwrap();
    let fit = calibration.fit(FitOptions::default()).unwrap();
    let uncertainty = fit.uncertainty.clone().unwrap();
    assert_eq!(
        (&uncertainty.undetermined[..], &uncertainty.without_effect[..], &uncertainty.identifiable[..]),
        (&[0][..], &[0][..], &[1][..])
    );
    assert!(uncertainty.standard_errors[0].is_infinite() && uncertainty.standard_errors[1] < 0.01);
    let reported = "the data do not determine e: it changes no measured output. ";
    assert!(
        uncertainty.verdict()[0].starts_with(reported) && fit.findings()[0].severity == Severity::Warning,
        "{fit}"
    );
    // The message describes the run only.
    assert!(!fit.report.message.contains("determine"), "{fit}");
}

#[test]
fn jointly_determined_parameters_are_reported() {
    // The outflows are proportional to a sqrt(2 g).
    let time: Vec<f64> = (0..60).map(f64::from).collect();
    let builder = || {
        let outputs = ["qt.x1", "qt.x2", "qt.x3", "qt.x4"];
        let inputs = [("u1", vec![5.0; 60]), ("u2", vec![6.0; 60])];
        let mut columns = inputs.to_vec();
        columns.extend(outputs.map(|name| (name, noise(60).map(|e| 0.03 + 1e-4 * e).collect())));
        let experiment = Experiment::new(data(&time, &columns)).input("u1", "u1").input("u2", "u2");
        let experiment = outputs.iter().fold(experiment, |e, name| e.output(*name, *name));
        Calibration::builder(open("quad_tank")).experiment(experiment)
    };
    let tanks = |scale| {
        let areas = ["qt.a1", "qt.a2", "qt.a3", "qt.a4"].map(|n| Parameter::new(n, 3e-6).scale(scale));
        let builder = areas.into_iter().fold(builder(), |builder, area| builder.parameter(area));
        builder.parameter(Parameter::new("qt.g", 9.81).scale(scale)).build().unwrap()
    };
    for scale in [Scale::Linear, Scale::Log] {
        let calibration = tanks(scale);
        for x in [[3e-6, 3e-6, 3e-6, 3e-6, 9.81], [2.1e-6, 3.3e-6, 2.9e-6, 3.7e-6, 12.0]] {
            let found = uncertainty(&calibration, &x, Estimator::Sandwich);
            assert_eq!(found.undetermined, [0, 1, 2, 3, 4], "{scale:?} {found:?}");
            assert!(
                found.without_effect.is_empty()
                    && found.verdict()[0].contains("other combinations of their values")
            );
            // If one of them is held, the data determine the other four.
            assert_eq!(found.identifiable.len(), 4, "{found:?}");
        }
    }
}

#[test]
fn outputs_have_separate_variances_unless_pooled() {
    // A line h = h0 + v0 t without gravity, measured twice with errors of two sizes.
    let time: Vec<f64> = (0..50).map(|k| 0.01 * f64::from(k)).collect();
    let recording = |phase: usize| {
        let e: Vec<f64> = noise(150).skip(phase).collect();
        let h = time.iter().zip(&e).map(|(t, e)| 10.0 + 2.0 * t + 0.3 * e).collect();
        let v = e.iter().skip(50).take(50).map(|e| 2.0 + 0.01 * e).collect();
        Experiment::new(data(&time, &[("h", h), ("v", v)]))
            .output("h", "h")
            .output("v", "v")
            .start_value("g", 0.0)
    };
    let calibration = Calibration::builder(open("bouncing_ball"))
        .experiment(recording(0))
        .experiment(recording(17))
        .parameter(Parameter::new("h", 10.0))
        .parameter(Parameter::new("v", 2.0))
        .build()
        .unwrap();
    let x = calibration.fit(FitOptions::default()).unwrap().x;
    // The rows are (1, t) for h and (0, 1) for v, for each recording.
    let (mut normal, mut middle) = ([[0.0; 2]; 2], [[0.0; 2]; 2]);
    let residuals = calibration.residuals(&x, &RunContext::new()).unwrap();
    let sum = |from: usize| residuals[from..from + 50].iter().map(|r| r * r).sum::<f64>();
    let mut of_output = [[[0.0; 2]; 2]; 2];
    for t in time.iter().chain(&time) {
        for (row, of_output) in [[1.0, *t], [0.0, 1.0]].iter().zip(&mut of_output) {
            for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                normal[i][j] += row[i] * row[j];
                of_output[i][j] += row[i] * row[j];
            }
        }
    }
    let determinant = normal[0][0] * normal[1][1] - normal[0][1] * normal[1][0];
    let inverse = [
        [normal[1][1] / determinant, -normal[0][1] / determinant],
        [-normal[1][0] / determinant, normal[0][0] / determinant],
    ];
    let product = |a: [[f64; 2]; 2], b: [[f64; 2]; 2]| {
        [0, 1].map(|i| [0, 1].map(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j]))
    };
    // The means of the sums of squares of h and v are linear in both variances.
    let shares = of_output.map(|share| product(inverse, share));
    let trace = |a: [[f64; 2]; 2]| a[0][0] + a[1][1];
    let n_effective = |k: usize| 100.0 - 2.0 * trace(shares[k]) + trace(product(shares[k], shares[k]));
    let (first, second, between) = (n_effective(0), n_effective(1), trace(product(shares[0], shares[1])));
    let (of_h, of_v) = (sum(0) + sum(100), sum(50) + sum(150));
    let of_both = first * second - between * between;
    let variances = [(second * of_h - between * of_v) / of_both, (first * of_v - between * of_h) / of_both];
    for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        middle[i][j] = variances[0] * of_output[0][i][j] + variances[1] * of_output[1][i][j];
    }
    let sandwich = product(product(inverse, middle), inverse).concat();
    let pooled = sum(0) + sum(50) + sum(100) + sum(150);
    for (estimator, expected) in [
        (Estimator::Sandwich, sandwich),
        (Estimator::Pooled, inverse.concat().iter().map(|i| i * pooled / 198.0).collect()),
    ] {
        let found = uncertainty(&calibration, &x, estimator).uncorrected();
        found.covariance.iter().zip(&expected).for_each(|(got, expected)| near(*got, *expected, 1e-4));
    }
}

#[test]
fn autocorrelated_residuals_are_reported_and_corrected() {
    let time: Vec<f64> = (0..80).map(|k| 0.05 * f64::from(k)).collect();
    let x = time.iter().map(|t| (-1.5 * t).exp() + 0.02 * (4.0 * t).sin()).collect();
    let calibration = Calibration::builder(open("dahlquist"))
        .experiment(Experiment::new(data(&time, &[("x", x)])).output("x", "x"))
        .parameter(Parameter::new("k", 1.0))
        .build()
        .unwrap();
    let uncertainty = calibration.fit(FitOptions::default()).unwrap().uncertainty.unwrap();
    assert!(uncertainty.residual_checks[0].autocorrelation > 0.9);
    assert!(uncertainty.autocorrelations[0] > 0.9 && uncertainty.effective_degrees_of_freedom[0] < 40.0);
    // All results use the corrected errors. Uncorrected errors are available on request.
    let uncorrected = uncertainty.uncorrected();
    assert_eq!(uncertainty.uncorrected_errors().unwrap(), uncorrected.standard_errors);
    assert!(uncertainty.standard_errors[0] > 2.0 * uncorrected.standard_errors[0]);
    let width = |uncertainty: &Uncertainty| {
        uncertainty.confidence_intervals(0.95).map(|ends| ends[0].1 - ends[0].0).unwrap()
    };
    assert!(width(&uncertainty) > 2.0 * width(&uncorrected));
    near(uncorrected.effective_degrees_of_freedom[0], 79.0, 1e-9);
    assert_eq!(uncorrected.autocorrelations, [0.0]);
    assert!(uncertainty.to_string().contains("corrected for autocorrelated residuals"), "{uncertainty}");
    let verdict = uncertainty.verdict();
    assert!(verdict.iter().any(|reported| reported.contains("autocorrelated (0.9")), "{verdict:?}");
}

#[test]
fn likelihood_errors_match_curvature_and_report_parameters_without_effect() {
    // The ball does not bounce, and the costs are negative.
    let time: Vec<f64> = (0..40).map(|k| 0.01 * f64::from(k)).collect();
    let h = time.iter().zip(noise(40)).map(|(t, e)| 1.0 - 0.5 * 9.81 * t * t + 1e-3 * e).collect();
    let calibration = Calibration::builder(open("bouncing_ball"))
        .experiment(Experiment::new(data(&time, &[("h", h)])).output("h", "h"))
        .parameter(Parameter::new("g", -9.0).bounds(-15.0, -5.0))
        .parameter(Parameter::new("e", 0.7).bounds(0.1, 0.95))
        .build()
        .unwrap();
    let fit =
        |objective, held| calibration.fit(FitOptions { objective, held, ..FitOptions::default() }).unwrap();
    let likelihood = CostKind::Named(NamedCost::Likelihood);
    let found = fit(likelihood.clone(), vec![]);
    assert!(found.cost < -200.0 && found.without_effect == [1], "{found}");
    assert!(found.to_string().contains("data do not determine e"), "{found}");
    let (found, expected) = (fit(likelihood, vec![1]), fit(CostKind::default(), vec![1]));
    let error = |fit: &Fit| fit.uncertainty.as_ref().unwrap().standard_errors[0];
    near(found.x[0], expected.x[0], 1e-4);
    near(error(&found), error(&expected), 1e-3);
    assert_eq!(found.uncertainty.unwrap().cost.to_bits(), found.cost.to_bits());
    // Curvature of N / 2 ln(r'r / N), computed by hand.
    let half = |g: f64| 20.0 * (calibration.cost(&[g, 0.7], &RunContext::new()).unwrap() / 40.0).ln();
    let h = 0.3 * error(&expected);
    let g = expected.x[0];
    let curvature = (half(g + h) - 2.0 * half(g) + half(g - h)) / (h * h);
    near(error(&expected), (40.0 / 39.0 / curvature).sqrt(), 0.02);
}

#[test]
fn noise_free_data_cause_no_accuracy_finding() {
    let time: Vec<f64> = (0..6).map(|k| 0.2 * f64::from(k)).collect();
    let x = time.iter().map(|t| (-2.0 * t).exp()).collect();
    let calibration = Calibration::builder(open("dahlquist"))
        .experiment(Experiment::new(data(&time, &[("x", x)])).output("x", "x"))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 5.0))
        .build()
        .unwrap();
    let fit = calibration.fit(FitOptions { preflight: true, ..FitOptions::default() }).unwrap();
    let uncertainty = fit.uncertainty.clone().unwrap();
    assert!(uncertainty.is_exact && !fit.to_string().contains("relative_tolerance"), "{fit}");
    assert_eq!(uncertainty.undetermined, [] as [usize; 0]);
    let at_truth = PreflightOptions { start: Some(vec![2.0]), ..PreflightOptions::default() };
    assert_eq!(calibration.preflight(&at_truth, &RunContext::new()).unwrap().noise, 0.0);
}

fn exhaust() -> Option<Calibration> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/exhaust_measurements.csv");
    let Ok(data) = Data::from_csv(&path) else {
        eprintln!("{} is not there: the numbers of the exhaust pipe are not compared", path.display());
        return None;
    };
    let inputs = ["T_in", "p_in", "w_turb1", "w_turb2", "p_out"];
    let experiment = inputs.iter().fold(Experiment::new(data), |e, name| e.input(*name, *name));
    let builder = Calibration::builder(open("exhaust"))
        .experiment(experiment.output("T_out", "T_out").window(0.0, 600.0));
    [("C1", 1.0, 50000.0), ("G1", 0.01, 500.0), ("C2", 1.0, 50000.0), ("G2", 0.01, 500.0)]
        .into_iter()
        .fold(builder, |builder, (name, lower, upper)| {
            builder.parameter(Parameter::new(name, 100.0).bounds(lower, upper))
        })
        .build()
        .ok()
}

#[test]
fn exhaust_pipe_has_four_confounded_parameters() {
    let Some(calibration) = exhaust() else { return };
    for (x, pairs, are_all) in [
        ([13893.0, 211.9, 16089.0, 47.4], &[(0, 3, -0.95), (1, 3, -0.92), (1, 2, 0.85)][..], true),
        ([19460.0, 158.5, 4080.0, 80.8], &[(1, 2, -0.96), (0, 2, -0.94), (0, 1, 0.93)], true),
        ([337.0, 16.4, 21576.0, 248.2], &[(0, 3, -0.92)], false),
    ] {
        let found = uncertainty(&calibration, &x, Estimator::Pooled);
        let independent = found.uncorrected();
        for (i, j, expected) in pairs {
            let correlation = independent.correlation[i * 4 + j];
            assert!((correlation - expected).abs() < 0.03, "{x:?} {i} {j}: {correlation}");
            let is_named = found.confounded.iter().any(|(a, b, _)| (a, b) == (i, j));
            assert_eq!(is_named, expected.abs() > 0.9, "{:?}", found.confounded);
        }
        assert_eq!(found.weakest.len(), if are_all { 4 } else { 0 });
        assert!((0.5..0.7).contains(&found.residual_checks[0].autocorrelation));
    }
    let at_bound = uncertainty(&calibration, &[50000.0, 7.6, 21091.0, 255.4], Estimator::Pooled);
    assert_eq!(at_bound.held, [0]);
}

#[test]
fn preflight_reports_problems_of_the_start() {
    let time: Vec<f64> = (0..40).map(|k| 0.01 * f64::from(k)).collect();
    let h = time.iter().map(|t| 1.0 - 0.5 * 9.81 * t * t).collect();
    let ball = Calibration::builder(open("bouncing_ball"))
        .experiment(Experiment::new(data(&time, &[("h", h)])).output("h", "h"))
        .parameter(Parameter::new("e", 0.7).bounds(0.1, 0.95))
        .parameter(Parameter::new("g", -9.0).bounds(-15.0, -5.0))
        .parameter(Parameter::new("v", 0.0).fixed(true))
        .build()
        .unwrap();
    let found = ball.preflight(&PreflightOptions::default(), &RunContext::new()).unwrap();
    let effects: Vec<_> = found.parameters.iter().map(|p| (p.has_effect, p.moved_to.is_some())).collect();
    assert_eq!(effects, [(false, true), (true, true), (false, false)]);
    assert!(
        found.findings.len() == 1 && found.findings[0].sentence.starts_with("e changes no measured output"),
        "{found}"
    );
    // h decreases by g t^2 / 2; the size of g is the width of its bounds.
    let by_g = time.iter().map(|t| (0.5 * t * t).powi(2)).sum::<f64>() / 40.0;
    near(found.parameters[1].sensitivity.unwrap(), 10.0 * by_g.sqrt() / (0.5 * 9.81 * 0.39 * 0.39), 1e-3);
    assert_eq!((found.expected_evaluations, found.n_simulations), (36, 4));
    for reported in ["changes no output", "fixed", "sensitivity", "36 evaluations"] {
        assert!(found.to_string().contains(reported), "{found}");
    }
    let fit = ball.fit(FitOptions { preflight: true, ..FitOptions::default() }).unwrap();
    assert_eq!(fit.preflight.unwrap().findings, found.findings);
    assert!(ball.preflight(&PreflightOptions::default(), &RunContext::new().polling(&|| true)).is_err());
}

#[test]
fn preflight_reports_pairs_confounded_at_the_start() {
    let Some(calibration) = exhaust() else { return };
    let start = Some(vec![13893.0, 211.9, 16089.0, 47.4]);
    let found =
        calibration.preflight(&PreflightOptions { start, ..PreflightOptions::default() }, &RunContext::new());
    let found = found.unwrap();
    assert!(found.confounded.iter().any(|(i, j, c)| (*i, *j) == (0, 3) && *c < -0.9), "{found}");
}

#[test]
fn preflight_correlation_is_independent_of_step_direction() {
    // h = h0 + v t + g t^2 / 2, so a larger v is compensated by a smaller g.
    let time: Vec<f64> = (0..40).map(|k| 0.01 * f64::from(k)).collect();
    let h: Vec<f64> = time.iter().map(|t| 1.0 + t - 0.5 * 9.81 * t * t).collect();
    for (lower, upper) in [(-10.0, -1.0), (-15.0, -8.9)] {
        let ball = Calibration::builder(open("bouncing_ball"))
            .experiment(Experiment::new(data(&time, &[("h", h.clone())])).output("h", "h"))
            .parameter(Parameter::new("v", 1.0))
            .parameter(Parameter::new("g", -9.0).bounds(lower, upper))
            .build()
            .unwrap();
        let found = ball.preflight(&PreflightOptions::default(), &RunContext::new()).unwrap();
        assert!(matches!(found.confounded[..], [(0, 1, c)] if c < -0.95), "{found}");
    }
}

#[test]
fn parameter_known_only_from_prior_is_reported() {
    let time: Vec<f64> = (0..30).map(|k| 0.01 * f64::from(k)).collect();
    let h = time.iter().zip(noise(30)).map(|(t, e)| 10.0 + 2.0 * t + 0.01 * e).collect();
    let ball = Calibration::builder(open("bouncing_ball"))
        .experiment(Experiment::new(data(&time, &[("h", h)])).output("h", "h").start_value("g", 0.0))
        .parameter(Parameter::new("v", 2.0).prior(Prior::Normal { mean: 2.0, sd: 1.0 }))
        .parameter(Parameter::new("e", 0.7).prior(Prior::Normal { mean: 0.7, sd: 0.1 }))
        .build()
        .unwrap();
    let verdict = uncertainty(&ball, &[2.0, 0.7], Estimator::Sandwich).verdict();
    let reported: Vec<&String> = verdict.iter().filter(|reported| reported.contains("prior alone")).collect();
    assert!(
        reported.len() == 1 && reported[0].starts_with("e is known from its prior alone."),
        "{verdict:?}"
    );
}

#[test]
fn noise_free_data_cause_one_note_and_no_pairs() {
    // h = h0 + v t in steps that round, and two parameters without a common output.
    let time: Vec<f64> = (0..30).map(|k| 0.1 * f64::from(k)).collect();
    let h = time.iter().map(|t| 10.0 + 2.0 * t).collect();
    let ball = Calibration::builder(open("bouncing_ball"))
        .experiment(
            Experiment::new(data(&time, &[("h", h), ("v", vec![2.0; 30])]))
                .output("h", "h")
                .output("v", "v")
                .start_value("g", 0.0),
        )
        .parameter(Parameter::new("h", 9.0))
        .parameter(Parameter::new("v", 1.0))
        .build()
        .unwrap();
    let uncertainty = ball.fit(FitOptions::default()).unwrap().uncertainty.unwrap();
    assert!(
        uncertainty.confounded.is_empty() && uncertainty.uncorrected_covariance.is_none(),
        "{:?}",
        uncertainty.verdict()
    );
    assert!(
        uncertainty.findings.len() == 1
            && uncertainty.verdict()[0].contains("Standard errors are then meaningless"),
        "{:?}",
        uncertainty.verdict()
    );
}
