//! Work of a fit in addition to its evaluations: every simulation is counted once, and one time limit covers
//! all work.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::panic)]

use calibration::RunContext;
use calibration::{
    Calibration, CheckOptions, CurrentPhase, Data, Experiment, FitOptions, FitPhase, Parameter, SavedFit,
    Stage,
};
use dfo::{Limits, NelderMead, RunOptions, Termination};
use example_models::example_fmu;
use fmi::Fmu;
use fmi::RunSettings;
use ode::{Method, Stats};
use std::sync::Arc;
use std::time::{Duration, Instant};

fn decay(parameter: Parameter, method: Method, step: Option<f64>) -> Calibration {
    let t: Vec<f64> = (0..51).map(|i| 0.1 * f64::from(i)).collect();
    let x = t.iter().map(|t| (-2.0 * t).exp()).collect();
    let settings = RunSettings { method, step_size: step, ..RunSettings::default() };
    Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(Experiment::new(Data::from_columns(t, [("x".to_owned(), x)]).unwrap()).output("x", "x"))
        .parameter(parameter)
        .settings(settings)
        .build()
        .unwrap()
}

fn limited(method: NelderMead, limits: Limits) -> RunOptions<dfo::AnyMethod> {
    RunOptions { method: method.into(), limits, workers: Some(1), ..FitOptions::default_run() }
}

/// A fixed step gives all simulations the same length, so the right-hand sides determine their number.
#[test]
fn phases_count_every_simulation_once() {
    let evaluations = 12;
    let calibration = decay(Parameter::new("k", 1.0).bounds(0.1, 10.0), Method::Rk4, Some(0.01));
    let limits = Limits { max_evaluations: Some(evaluations), ..Limits::default() };
    let options = FitOptions { cutoffs: false, ..limited(NelderMead::default(), limits).into() };
    let fit = calibration.fit(options).unwrap();
    let one = calibration.simulate(&[1.0], None, &RunContext::new()).unwrap()[0].stats.right_hand_sides;
    let uncertainty = fit.uncertainty.as_ref().unwrap();
    // The start and the end were among the evaluations. The accurate simulation has twice as many steps, and
    // one initialisation.
    let expected = evaluations + fit.report.n_speculative + fit.n_checks + uncertainty.n_simulations;
    assert_eq!(fit.stats.right_hand_sides, one * expected as u64 + (one - 1), "{fit}");
    // The end is not a minimum, so one more least-squares step was simulated.
    assert_eq!(uncertainty.n_simulations, 1 + 2 + 1);
}

/// A fit that is interrupted after its search has a result and reports what is missing.
#[test]
fn fit_reports_interrupted_checks() {
    let calibration = decay(Parameter::new("k", 1.0).bounds(0.1, 10.0), Method::Tsit5, None);
    let phase = Arc::new(CurrentPhase::default());
    let seen = Arc::clone(&phase);
    let is_requested = move || seen.get() == FitPhase::Uncertainty;
    let context = RunContext::new().polling(&is_requested);
    let fit = calibration.fit(FitOptions { context, phase, ..FitOptions::default() }).unwrap();
    let reports_interruption = |fit: &calibration::Fit| {
        fit.findings().iter().any(|f| f.sentence.contains("ended during the checks after the search"))
    };
    assert!(fit.is_success() && fit.uncertainty.is_none() && reports_interruption(&fit), "{fit}");
    assert!(!reports_interruption(&calibration.fit(FitOptions::default()).unwrap()));
}

/// With `auto`, neither the first nor the second fit runs simulations outside its trace.
#[test]
fn fit_runs_only_the_simulations_of_its_trace() {
    let calibration = decay(Parameter::new("k", 1.0).bounds(0.1, 10.0), Method::Auto, None);
    let limits = Limits { max_evaluations: Some(5), ..Limits::default() };
    let options =
        || FitOptions { uncertainty: None, cutoffs: false, ..limited(NelderMead::default(), limits).into() };
    let (first, second) = (calibration.fit(options()).unwrap(), calibration.fit(options()).unwrap());
    assert_eq!(first.stats, second.stats);
    assert_eq!(first.report.trace.len(), 5);
    let mut total = Stats::default();
    for entry in first.report.trace.iter() {
        total += calibration.simulate(entry.x, None, &RunContext::new()).unwrap()[0].stats;
    }
    assert_eq!(first.stats, total);
    for (one, other) in first.report.trace.iter().zip(second.report.trace.iter()) {
        assert_eq!((one.x, one.outcome), (other.x, other.outcome));
    }
}

/// A simulation of 10^12 steps.
fn endless() -> Calibration {
    decay(Parameter::new("k", 1.0).bounds(0.1, 10.0), Method::Euler, Some(1e-12))
}

/// Without its limit, this check would take hours.
#[test]
fn check_respects_time_limit_when_a_simulation_is_endless() {
    let began = Instant::now();
    let options = CheckOptions { max_time: Some(Duration::from_millis(300)), ..CheckOptions::default() };
    let check = endless().check_with(&options, &RunContext::new()).unwrap();
    assert!(
        check
            .to_string()
            .contains("the time limit of 0.3 s ended the check during the simulation at the start"),
        "{check}"
    );
    assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
}

/// Without the limit, this fit would take hours.
#[test]
fn fit_returns_start_when_a_simulation_is_endless() {
    let limit = Duration::from_millis(300);
    let limits = Limits { max_time: Some(limit), ..Limits::default() };
    let calibration = endless();
    let phase = Arc::new(CurrentPhase::default());
    let options = FitOptions {
        preflight: true,
        phase: Arc::clone(&phase),
        ..limited(NelderMead::default(), limits).into()
    };
    let fit = calibration.fit(options).unwrap();
    assert_eq!((&fit.x[..], &fit.report.termination), (&[1.0][..], &Termination::MaxTime));
    assert!(fit.cost.is_nan() && fit.uncertainty.is_none() && !fit.report.is_success());
    assert!(fit.report.message.contains("The result is the start"), "{}", fit.report.message);
    assert_eq!(phase.get(), FitPhase::Uncertainty);
    let stages = [Stage::new(["k"])];
    let fit = calibration.fit_stages(&stages, limited(NelderMead::default(), limits)).unwrap();
    assert_eq!((&fit.x[..], &fit.report.termination), (&[1.0][..], &Termination::MaxTime));
    assert!(fit.report.message.contains("The result is the start"), "{}", fit.report.message);
}

/// If the limit ends a search, its best point is the result, and nothing is simulated afterwards.
#[test]
fn fit_runs_no_simulation_after_time_limit() {
    let calibration = decay(Parameter::new("k", 1.0).bounds(0.1, 10.0), Method::Euler, Some(1e-5));
    // The first use tests the model, once per process.
    calibration.preflight(&calibration::PreflightOptions::default(), &RunContext::new()).unwrap();
    let began = Instant::now();
    calibration.cost(&[1.0], &RunContext::new()).unwrap();
    let limits = Limits { max_time: Some(10 * began.elapsed()), ..Limits::default() };
    let mut run = limited(NelderMead::default(), limits);
    (run.tolerances.x_tol, run.tolerances.f_tol) = (0.0, 0.0);
    let fit = calibration.fit(run).unwrap();
    assert_eq!(fit.report.termination, Termination::MaxTime);
    assert!(fit.uncertainty.is_none() && fit.n_checks == 0 && fit.setup_findings.is_empty());
    assert!(fit.cost.is_finite() && fit.outputs.len() == 1);
}

/// The message reports the limit of the user, or of the stage, and not the time left for the search.
#[test]
fn message_reports_the_given_time_limit() {
    let calibration = decay(Parameter::new("k", 1.0).bounds(0.1, 10.0), Method::Euler, Some(1e-5));
    calibration.preflight(&calibration::PreflightOptions::default(), &RunContext::new()).unwrap();
    // The first simulation also starts the process.
    calibration.cost(&[1.0], &RunContext::new()).unwrap();
    let began = Instant::now();
    calibration.cost(&[1.0], &RunContext::new()).unwrap();
    let one = Duration::from_millis(1) + began.elapsed();
    let given = |times: u32| Limits { max_time: Some(times * one), ..Limits::default() };
    let (limits, of_stage) = (given(16), given(5));
    let named = |limits: Limits| format!("time limit of {} s", limits.max_time.unwrap().as_secs_f64());
    let endless = |limits| {
        let mut run = limited(NelderMead::default(), limits);
        (run.tolerances.x_tol, run.tolerances.f_tol) = (0.0, 0.0);
        run
    };
    let fit = calibration.fit(endless(limits)).unwrap();
    assert!(fit.report.message.contains(&named(limits)), "{}", fit.report.message);
    let stages = [Stage::new(["k"]).limits(of_stage), Stage::new(["k"])];
    let fit = calibration.fit_stages(&stages, endless(limits)).unwrap();
    let [first, second] = &fit.stages[..] else { panic!("{fit}") };
    assert!(first.report.message.contains(&named(of_stage)), "{}", first.report.message);
    assert!(second.report.message.contains(&named(limits)), "{}", second.report.message);
}

#[test]
fn fit_without_finished_simulation_can_be_saved_and_loaded() {
    let limits = Limits { max_time: Some(Duration::from_millis(100)), ..Limits::default() };
    let calibration = endless();
    let fit = calibration.fit(limited(NelderMead::default(), limits)).unwrap();
    assert!(fit.report.is_sound() && fit.report.trace.n() == 1);
    let saved = SavedFit::from_bytes(&fit.to_bytes(&calibration).unwrap(), "fit").unwrap();
    assert!(saved.fit.cost.is_nan() && saved.fit.x == fit.x);
}

/// Standard errors use two simulations for each parameter. All other work uses at most 0.3 of the search and
/// four simulations. Skipped work is listed.
#[test]
fn extra_simulations_stay_within_their_share_of_the_search() {
    let decay = |start: f64| {
        let t: Vec<f64> = (0..51).map(|i| 0.1 * f64::from(i)).collect();
        let noisy = |(i, t): (usize, &f64)| (-2.0 * t).exp() + 0.01 * (78.233 * (i as f64 + 1.0)).sin();
        let x = t.iter().enumerate().map(noisy).collect();
        (t, "dahlquist", "x", x, Parameter::new("k", start).bounds(0.1, 10.0))
    };
    let oscillator = |start: f64| {
        let t: Vec<f64> = (0..201).map(|i| 0.1 * f64::from(i)).collect();
        let options = fmi::SimulateOptions::new().relative_tolerance(1e-11).times(t.clone()).outputs(["x0"]);
        let options = fmi::SimulateOptions { start_values: vec![("mu".to_owned(), 1.5.into())], ..options };
        let exact = Fmu::open(example_fmu("van_der_pol").unwrap()).unwrap().simulate(&options).unwrap();
        let noisy = |(i, x): (usize, &f64)| x + 0.02 * (78.233 * (i as f64 + 1.0)).sin();
        let x = exact.get("x0").unwrap().iter().enumerate().map(noisy).collect();
        (t, "van_der_pol", "x0", x, Parameter::new("mu", start).bounds(0.1, 5.0))
    };
    let all = [decay(1.9), decay(1.0), decay(8.0), oscillator(1.4), oscillator(0.5), oscillator(2.5)];
    for (t, model, output, values, parameter) in all {
        let start = parameter.start();
        let data = Data::from_columns(t, [(output.to_owned(), values)]).unwrap();
        let calibration = Calibration::builder(Fmu::open(example_fmu(model).unwrap()).unwrap())
            .experiment(Experiment::new(data).output(output, output))
            .parameter(parameter)
            .build()
            .unwrap();
        let run = RunOptions { workers: Some(1), ..FitOptions::default_run() };
        let fit = calibration.fit(run).unwrap();
        let taken = |wanted: &dyn Fn(FitPhase) -> bool| {
            let extra = fit.phases.iter().filter(|cost| wanted(cost.phase));
            extra.fold((0, 0), |(n, work), cost| {
                (n + cost.taken.simulations, work + cost.taken.right_hand_sides)
            })
        };
        let search = taken(&|phase| phase == FitPhase::Search);
        let errors = taken(&|phase| phase == FitPhase::Uncertainty);
        let others = taken(&|phase| !matches!(phase, FitPhase::Search | FitPhase::Uncertainty));
        assert_eq!(search.0, fit.report.n_evaluations as u64, "{model} from {start}: {fit}");
        assert!(errors.0 == 2 && fit.uncertainty.is_some(), "{model} from {start}: {errors:?}");
        let most = (0.3 * search.1 as f64).min(4.0 * search.1 as f64 / search.0 as f64);
        assert!(others.1 as f64 <= most, "{model} from {start}: {others:?} next to {search:?}");
        let is_skipped = fit.skipped.iter().any(|name| name == "simulation of higher accuracy");
        assert_eq!(is_skipped, fit.uncertainty.as_ref().unwrap().accurate_cost.is_none());
        // In addition to the fresh process, 1.6 simulations do not fit into a quarter of 5 evaluations but
        // fit into a quarter of 12.
        assert!(is_skipped || fit.report.n_evaluations > 5, "{model} from {start}: {fit}");
        assert!(!is_skipped || fit.report.n_evaluations < 12, "{model} from {start}: {fit}");
    }
}
