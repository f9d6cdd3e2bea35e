//! Fits in stages: the free and fixed parameters of each stage, and the settings that apply to all stages.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::dfo::{Checkpoint, Limits, NelderMead, Resume, RunOptions, Termination};
use calibration::{Calibration, Data, Experiment, FindingId, Fit, FitOptions, Parameter, Severity, Stage};
use example_models::example_fmu;
use fmi::RunSettings;
use std::ops::ControlFlow;
use std::path::Path;

const OUTLETS: [&str; 4] = ["qt.a1", "qt.a2", "qt.a3", "qt.a4"];

fn tanks(starts: &[(&str, f64)], window: Option<(f64, f64)>) -> Calibration {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/data/quad_tank.csv");
    let mut experiment = Experiment::new(Data::from_csv(path).unwrap()).input("u1", "u1").input("u2", "u2");
    for column in ["x1", "x2", "x3", "x4"] {
        experiment = experiment.output(format!("qt.{column}"), column);
    }
    if let Some((from, to)) = window {
        experiment = experiment.window(from, to);
    }
    let settings = RunSettings { method: ode::Method::Tsit5, ..RunSettings::default() };
    let fmu = fmi::Fmu::open(example_fmu("quad_tank").unwrap()).unwrap();
    let mut builder = Calibration::builder(fmu).experiment(experiment).settings(settings);
    for name in OUTLETS {
        let start = starts.iter().find(|(n, _)| *n == name).map(|(_, start)| *start);
        let parameter = Parameter::new(name, start.unwrap_or(3e-6)).bounds(2e-6, 4e-6);
        builder = builder.parameter(parameter.fixed(start.is_some()));
    }
    builder.build().unwrap()
}

fn two() -> [Stage; 2] {
    [Stage::new(["qt.a1", "qt.a2"]), Stage::new(["qt.a3", "qt.a4"])]
}

fn limited(n: usize) -> RunOptions<calibration::dfo::AnyMethod> {
    let limits = Limits { max_evaluations: Some(n), ..Limits::default() };
    RunOptions { limits, workers: Some(2), ..FitOptions::default_run() }
}

fn bits(fit: &Fit) -> Vec<u64> {
    fit.report.trace.points().iter().chain([&fit.cost]).map(|v| v.to_bits()).collect()
}

#[test]
fn stage_starts_from_previous_result_and_holds_other_parameters() {
    let calibration = tanks(&[], None);
    let fit = calibration.fit_stages(&two(), FitOptions::default()).unwrap();
    let [first, second] = &fit.stages[..] else { panic!("{fit}") };
    assert_eq!((&first.x[2..], &second.x[..2]), (&[3e-6; 2][..], &first.x[..2]));
    assert_eq!((&second.start, &fit.x, fit.cost), (&first.x, &second.x, second.cost));
    assert_eq!((&fit.start, fit.start_cost), (&calibration.start(), first.start_cost));
    assert!(fit.cost < first.cost && first.is_success() && second.is_success(), "{fit}");
    // The minimum in all parameters is lower.
    assert_eq!(fit.report.termination, Termination::BeforeMinimum, "{fit}");
    assert_eq!(fit.report.n_evaluations, first.report.n_evaluations + second.report.n_evaluations);
    assert_eq!(fit.report.trace.len(), fit.report.n_evaluations);
    let of_costs = (fit.cost / fit.start_cost.unwrap()).sqrt();
    assert!((fit.scaled_rms().unwrap() - of_costs).abs() < 1e-15 * of_costs.max(1.0));
    let rms = |fit: &Fit| fit.outputs.iter().map(|o| (o.rms, o.start_rms)).collect::<Vec<_>>();
    for ((whole, first), second) in rms(&fit).into_iter().zip(rms(first)).zip(rms(second)) {
        assert_eq!(whole, (second.0, first.1));
    }
    assert!(fit.report.jacobian.is_none() && second.report.jacobian.is_some());
    assert!(fit.report.message.contains("stage 1 of 2: converged"), "{}", fit.report.message);
    // Repeat the second stage by hand, with fixed parameters.
    let fixed: Vec<_> = OUTLETS[..2].iter().copied().zip(first.x.iter().copied()).collect();
    let by_hand = tanks(&fixed, None).fit(FitOptions::default()).unwrap();
    assert_eq!(bits(&by_hand), bits(second));
}

/// A decay `x' = -k x` from x(0) = 2 with k = 2 and this size of the noise. The fit starts at k = 1 and a wrong
/// x(0), which a stage that holds it compensates for with k.
fn two_coupled(noise: f64, start: f64) -> Calibration {
    let t: Vec<f64> = (0..61).map(|i| 0.05 * f64::from(i)).collect();
    let x =
        t.iter().enumerate().map(|(i, t)| 2.0 * (-2.0 * t).exp() + if i % 2 == 0 { noise } else { -noise });
    let data = Data::from_columns(t.clone(), [("x".to_owned(), x.collect())]).unwrap();
    let fmu = fmi::Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
    Calibration::builder(fmu)
        .experiment(Experiment::new(data).output("x", "x"))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
        .parameter(Parameter::new("x", start).bounds(0.1, 10.0))
        .build()
        .unwrap()
}

/// The joint minimum is a fifth below the cost of the stages.
#[test]
fn stages_slightly_above_the_joint_minimum_do_not_count_as_converged() {
    let calibration = two_coupled(0.1, 1.7);
    let apart = [Stage::new(["k"]), Stage::new(["x"])];
    let fit = calibration.fit_stages(&apart, FitOptions::default()).unwrap();
    let joint = calibration.fit(FitOptions::default()).unwrap();
    let excess = 1.0 - joint.cost / fit.cost;
    assert!((excess - 0.197).abs() < 1e-3 && joint.is_success(), "{excess} {fit}");
    assert!(!fit.is_success() && fit.report.termination == Termination::BeforeMinimum, "{fit}");
    assert!(fit.findings().iter().any(|f| f.id == FindingId::StagesApart), "{fit}");
    assert!(fit.skipped.iter().all(|skipped| !skipped.contains("shorter steps")), "{:?}", fit.skipped);
    assert!(fit.report.message.starts_with("not converged: one more"), "{}", fit.report.message);
}

#[test]
fn stages_without_standard_errors_report_the_missing_test() {
    let calibration = two_coupled(1e-3, 1.0);
    let is_reported = |stages: &[Stage]| {
        let options = FitOptions { uncertainty: None, ..FitOptions::default() };
        let fit = calibration.fit_stages(stages, options).unwrap();
        fit.findings().iter().any(|f| f.id == FindingId::StagesApart && f.severity == Severity::Warning)
    };
    assert!(is_reported(&[Stage::new(["k"]), Stage::new(["x"])]));
    assert!(!is_reported(&[Stage::new(["k"]), Stage::new(["k", "x"])]));
}

#[test]
fn stages_with_wrong_fixed_values_do_not_count_as_converged() {
    let calibration = two_coupled(1e-3, 1.0);
    let fitted = |stages: &[Stage]| calibration.fit_stages(stages, FitOptions::default()).unwrap();
    let apart = fitted(&[Stage::new(["k"]), Stage::new(["x"])]);
    let printed = apart.to_string();
    assert!((apart.x[0] - 2.0).abs() > 0.1 && !apart.is_success(), "{apart}");
    assert_eq!(apart.report.termination, Termination::BeforeMinimum, "{apart}");
    for reported in [
        "Each stage converged, but all parameters together did not",
        "% of the cost, although each stage ended normally. The values depend on what the stages held fixed",
        "Add a last stage with all parameters, because smaller tolerances do not help",
    ] {
        assert!(printed.contains(reported), "{apart}");
    }
    let joint = fitted(&[Stage::new(["k"]), Stage::new(["k", "x"])]);
    assert!((joint.x[0] - 2.0).abs() < 1e-2 && joint.is_success(), "{joint}");
    assert!(joint.to_string().contains("The fit converged"), "{joint}");
}

#[test]
fn stage_uses_its_method_and_window() {
    let calibration = tanks(&[], None);
    let stages = [
        Stage::new(["qt.a1", "qt.a2"]).window(0.0, 30.0).method(NelderMead::default()),
        Stage::new(["qt.a3", "qt.a4"]),
    ];
    let fit = calibration.fit_stages(&stages, FitOptions::default()).unwrap();
    let methods: Vec<_> = fit.stages.iter().map(|stage| stage.report.method.clone()).collect();
    assert_eq!(methods, ["nelder-mead", "least-squares"]);
    let half = tanks(&[("qt.a3", 3e-6), ("qt.a4", 3e-6)], Some((0.0, 30.0)));
    assert_eq!(fit.stages[0].cost, half.cost(&fit.stages[0].x, &RunContext::new()).unwrap());
    assert_eq!(fit.start_cost, Some(calibration.cost(&calibration.start(), &RunContext::new()).unwrap()));
    // The costs of the first stage belong to another window.
    assert_eq!(fit.report.trace.len(), fit.stages[1].report.n_evaluations);
    let last = [stages[1].clone(), stages[0].clone()];
    let fit = calibration.fit_stages(&last, FitOptions::default()).unwrap();
    assert_eq!(fit.cost, calibration.cost(&fit.x, &RunContext::new()).unwrap());
    assert!(fit.cost > fit.stages[1].cost);
    let sum: f64 = fit.outputs.iter().map(|o| o.n as f64 * o.rms * o.rms).sum();
    assert!((sum / fit.cost - 1.0).abs() < 1e-9 && fit.n_measurements == 4 * 61);
}

#[test]
fn limits_apply_to_all_stages_together() {
    let calibration = tanks(&[], None);
    let whole = calibration.fit_stages(&two(), limited(1000)).unwrap();
    let first = whole.stages[0].report.n_evaluations;
    for n in [1, first - 1, first, first + 1] {
        let fit = calibration.fit_stages(&two(), limited(n)).unwrap();
        assert_eq!(fit.report.n_evaluations, n);
        assert_eq!(fit.report.termination, Termination::MaxEvaluations);
        assert_eq!(fit.stages.len(), 1 + usize::from(n > first), "{fit}");
    }
    let limits_of_stage = Limits { max_evaluations: Some(4), ..Limits::default() };
    let [one, two] = two();
    let fit = calibration.fit_stages(&[one.limits(limits_of_stage), two], FitOptions::default()).unwrap();
    assert_eq!((fit.stages.len(), fit.stages[0].report.n_evaluations), (2, 4));
    assert!(!fit.report.is_success(), "{fit}");
}

#[test]
fn observer_ends_all_stages_and_continues_its_count() {
    let calibration = tanks(&[], None);
    let (mut counts, first) =
        (Vec::new(), calibration.fit_stages(&two()[..1], limited(1000)).unwrap().report.n_evaluations);
    let options = FitOptions {
        observer: Some(Box::new(|progress| {
            counts.push(progress.n_evaluations);
            if progress.n_evaluations > first + 1 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        })),
        ..FitOptions::default()
    };
    let fit = calibration.fit_stages(&two(), options).unwrap();
    assert_eq!((fit.stages.len(), &fit.report.termination), (2, &Termination::StoppedByObserver));
    assert!(counts.is_sorted() && counts[counts.len() - 1] == fit.report.n_evaluations, "{counts:?}");
    assert!(fit.cost <= fit.stages[0].cost);
}

#[test]
fn checkpoint_uses_one_file_per_stage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fit.ckpt");
    let with = |n: usize, resume: Resume| RunOptions {
        checkpoint: Some(Checkpoint::new(&path).resume(resume)),
        ..limited(n)
    };
    let calibration = tanks(&[], None);
    let whole = calibration.fit_stages(&two(), limited(1000)).unwrap();
    let first = whole.stages[0].report.n_evaluations;
    assert!(calibration.fit_stages(&two(), with(1000, Resume::Require)).is_err());
    for n in [first - 1, first + 2, 1000] {
        let fit = calibration.fit_stages(&two(), with(n, Resume::Auto)).unwrap();
        assert_eq!(fit.report.n_evaluations, n.min(whole.report.n_evaluations));
        assert!(folder.path().join("fit.ckpt.stage1").is_file() && !path.exists());
        assert_eq!(folder.path().join("fit.ckpt.stage2").is_file(), n > first);
    }
    let again = calibration.fit_stages(&two(), with(1000, Resume::Require)).unwrap();
    assert_eq!(bits(&again), bits(&whole));
    // The uncertainty of the whole fit uses some simulations too.
    let of_stages: u64 = again.stages.iter().map(|s| s.stats.right_hand_sides).sum();
    assert!(again.stats.right_hand_sides > of_stages);
    // A fit with other stages is a different fit.
    let other = [Stage::new(["qt.a1", "qt.a3"]), Stage::new(["qt.a2"])];
    let error = calibration.fit_stages(&other, with(1000, Resume::Auto)).unwrap_err().to_string();
    assert!(error.contains("stage 1: ") && error.contains("fit.ckpt.stage1"), "{error}");
}

#[test]
fn stage_errors_name_the_stage_and_reason() {
    let calibration = tanks(&[("qt.a4", 3e-6)], None);
    let stage = |names: &[&str]| Stage::new(names.iter().copied());
    for (stages, expected) in [
        (vec![], "stages is empty"),
        (vec![stage(&["qt.a1"]), stage(&[])], "stage 2: the stage has no parameters. Specify at least one"),
        (vec![stage(&["qt.a1", "a2"])], "stage 1: parameter 'a2' not found; available: qt.a1, qt.a2"),
        (vec![stage(&["qt.a4"])], "stage 1: parameter 'qt.a4' is fixed"),
        (vec![stage(&["qt.a1", "qt.a1"])], "'qt.a1' is listed twice"),
        (vec![stage(&["qt.a1"]).window(70.0, 80.0)], "stage 1: "),
        (vec![stage(&["qt.a1"]).window(5.0, 1.0)], "stage 1: window from 5 to 1"),
    ] {
        let error = calibration.fit_stages(&stages, FitOptions::default()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let fit = calibration.fit_stages(&[stage(&["qt.a1"])], limited(3)).unwrap();
    assert!(
        fit.to_string().contains(
            "\nnote     no stage frees qt.a2, qt.a3, which remain at the start values [F030 unused-parameter]"
        ),
        "{fit}"
    );
}
