//! Samples of the posterior distribution compared with closed forms.

use calibration::{
    Calibration, CalibrationError, CostKind, Data, Experiment, FitOptions, NamedCost, Parameter, Posterior,
    PosteriorOptions, Prior, RunContext, Scale, Sigma, WalkerStart, Weight,
};
use dfo::{Loss, RobustLoss};
use example_models::example_fmu;
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

const SD: f64 = 0.2;

/// Height of a ball without gravity: `h + v t`, a linear model, with deviations of plus and minus one standard
/// deviation.
fn line(n: usize, weight: impl Into<Weight>, parameters: impl IntoIterator<Item = Parameter>) -> Calibration {
    let times: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let heights = times.iter().enumerate().map(|(k, t)| 10.0 + 2.0 * t + if k % 3 == 0 { SD } else { -SD });
    let data = Data::from_columns(times.clone(), [("h".to_owned(), heights.collect())]).unwrap();
    let experiment = Experiment::new(data).weighted_output("h", "h", weight).start_value("g", 0.0);
    let builder = Calibration::builder(fmi::Fmu::open(example_fmu("bouncing_ball").unwrap()).unwrap())
        .experiment(experiment);
    parameters.into_iter().fold(builder, |builder, p| builder.parameter(p)).build().unwrap()
}

fn free() -> [Parameter; 2] {
    [Parameter::new("h", 9.5).bounds(1.0, 20.0), Parameter::new("v", 1.5).bounds(-5.0, 9.0)]
}

fn sample(calibration: &Calibration, options: &PosteriorOptions) -> Posterior {
    let fit = calibration.fit(FitOptions::default()).unwrap();
    calibration.sample(&fit, options, &mut |_| (), &RunContext::new()).unwrap()
}

fn options(n_steps: usize) -> PosteriorOptions {
    PosteriorOptions { n_steps, seed: Some(5), workers: Some(1), ..PosteriorOptions::default() }
}

/// Returns the solution of least squares for `h + v t`, its residual sum of squares, and the diagonal of `(J'J)^-1`.
fn least_squares(n: usize) -> ([f64; 2], f64, [f64; 2]) {
    let t: Vec<f64> = (0..n).map(|k| 0.1 * k as f64).collect();
    let y: Vec<f64> = (0..n).map(|k| 10.0 + 2.0 * t[k] + if k % 3 == 0 { SD } else { -SD }).collect();
    let (sum_t, sum_tt) = (t.iter().sum::<f64>(), t.iter().map(|t| t * t).sum::<f64>());
    let (sum_y, sum_ty) = (y.iter().sum::<f64>(), t.iter().zip(&y).map(|(t, y)| t * y).sum::<f64>());
    let det = n as f64 * sum_tt - sum_t * sum_t;
    let (h, v) = ((sum_tt * sum_y - sum_t * sum_ty) / det, (n as f64 * sum_ty - sum_t * sum_y) / det);
    let squares = t.iter().zip(&y).map(|(t, y)| (h + v * t - y).powi(2)).sum();
    ([h, v], squares, [sum_tt / det, n as f64 / det])
}

/// Checks mean and standard deviation within four Monte Carlo errors of a normal sample.
fn assert_moments(found: &Posterior, k: usize, mean: f64, sd: f64) {
    let p = &found.parameters[k];
    let error = 4.0 / p.effective_draws.sqrt();
    assert!(found.is_converged(), "{found}");
    assert!((p.mean - mean).abs() < error * sd, "{}: mean {} instead of {mean}", p.name, p.mean);
    assert!((p.sd / sd - 1.0).abs() < error, "{}: sd {} instead of {sd}", p.name, p.sd);
}

#[test]
fn posterior_with_known_noise_is_the_normal_distribution_of_least_squares() {
    let found = sample(&line(20, Sigma::Constant(SD), free()), &options(600));
    let (x, _, inverse) = least_squares(20);
    (0..2).for_each(|k| assert_moments(&found, k, x[k], SD * inverse[k].sqrt()));
    let (low, high) = found.interval(1, 0.95);
    let expected = 1.96 * SD * inverse[1].sqrt();
    assert!((0.5 * (high - low) / expected - 1.0).abs() < 0.1, "{low} {high} {expected}");
    assert_eq!((found.n_steps, found.n_warmup, found.n_walkers), (450, 150, 16));
    assert_eq!(found.draws.len(), 450 * 16 * 2);
}

#[test]
fn unknown_noise_is_integrated_out() {
    // Student's t with N - 2 degrees of freedom and the scale of least squares. Its variance is nu / (nu - 2) times
    // the squared scale.
    let found = sample(&line(12, 1.0, free()), &options(1500));
    let (x, squares, inverse) = least_squares(12);
    let degrees = 10.0;
    let factor: f64 = squares / degrees * degrees / (degrees - 2.0);
    (0..2).for_each(|k| assert_moments(&found, k, x[k], (factor * inverse[k]).sqrt()));
}

#[test]
fn bound_cuts_the_posterior() {
    let (x, _, _) = least_squares(20);
    let fixed = Parameter::new("h", x[0]).fixed(true);
    let cut = Parameter::new("v", x[1] + 0.01).bounds(x[1], 9.0);
    let found = sample(&line(20, Sigma::Constant(SD), [fixed, cut]), &options(1000));
    // Half normal with the standard deviation 0.2 / sqrt(sum t^2), because h is fixed.
    let sd = SD / (0..20).map(|k| (0.1 * f64::from(k)).powi(2)).sum::<f64>().sqrt();
    let (mean, of_half) = ((2.0 / std::f64::consts::PI).sqrt(), (1.0 - 2.0 / std::f64::consts::PI).sqrt());
    assert_moments(&found, 0, x[1] + mean * sd, of_half * sd);
    assert!(found.draws.iter().all(|v| *v >= x[1]));
}

#[test]
fn log_normal_prior_is_sampled_on_both_scales() {
    // The measurements hardly count, so that the posterior is the prior: its mean is exp(sigma^2 / 2).
    for scale in [Scale::Linear, Scale::Log] {
        let prior = Prior::LogNormal { median: 1.0, sigma: 0.3 };
        let v = Parameter::new("v", 1.2).bounds(0.01, 50.0).scale(scale).prior(prior);
        let found = sample(&line(12, 1e-6, [Parameter::new("h", 10.0).fixed(true), v]), &options(1200));
        let (mean, variance) = ((0.5f64 * 0.09).exp(), (0.09f64.exp() - 1.0) * 0.09f64.exp());
        assert_moments(&found, 0, mean, variance.sqrt());
    }
}

#[test]
fn sample_has_the_same_bits_for_any_number_of_workers_and_after_a_restart() {
    let calibration = line(12, Sigma::Constant(SD), free());
    let whole = sample(&calibration, &options(40));
    let parallel = sample(&calibration, &PosteriorOptions { workers: Some(3), ..options(40) });
    assert_eq!((&whole.draws, &whole.log_densities), (&parallel.draws, &parallel.log_densities));
    // Interrupted after 15 steps, then continued.
    let folder = tempfile::tempdir().unwrap();
    let checkpoint = Some(folder.path().join("chain"));
    let stored = PosteriorOptions { checkpoint, ..options(40) };
    let fit = calibration.fit(FitOptions::default()).unwrap();
    let (cancelled, reached) = (AtomicBool::new(false), Cell::new(0));
    let mut progress = |step: usize| {
        reached.set(step);
        cancelled.store(step == 15, Ordering::Relaxed);
    };
    let context = RunContext::new().flagged(&cancelled);
    let part = calibration.sample(&fit, &stored, &mut progress, &context).unwrap();
    assert!(part.is_interrupted && reached.get() == 15, "{part}");
    let rest = calibration.sample(&fit, &stored, &mut |_| (), &RunContext::new()).unwrap();
    assert_eq!((&whole.draws, whole.n_simulations), (&rest.draws, rest.n_simulations));
    // Another fit is rejected.
    let other = PosteriorOptions { seed: Some(6), ..stored };
    let message = calibration.sample(&fit, &other, &mut |_| (), &RunContext::new()).unwrap_err().to_string();
    assert!(message.contains("another seed"), "{message}");
}

#[test]
fn sample_interrupted_within_a_step_continues_with_the_same_bits() {
    let calibration = line(12, Sigma::Constant(SD), free());
    let fit = calibration.fit(FitOptions::default()).unwrap();
    let whole = sample(&calibration, &options(12));
    // The context is checked several times in each half of a step.
    for interval in [1100_u32, 1300, 1500, 1700] {
        let folder = tempfile::tempdir().unwrap();
        let stored = PosteriorOptions { checkpoint: Some(folder.path().join("chain")), ..options(12) };
        let mut n_runs = 0;
        let found = loop {
            let left = Cell::new(interval);
            let is_requested = || left.replace(left.get().saturating_sub(1)) == 0;
            let context = RunContext::new().polling(&is_requested);
            n_runs += 1;
            match calibration.sample(&fit, &stored, &mut |_| (), &context) {
                Ok(found) if !found.is_interrupted => break found,
                Ok(_) | Err(CalibrationError::Cancelled) if n_runs < 100 => {}
                other => panic!("{interval}: {other:?}"),
            }
        };
        assert!(n_runs > 1 && found.draws == whole.draws, "{interval}: {n_runs} runs");
    }
}

#[test]
fn walkers_can_start_in_the_box() {
    let found = sample(
        &line(20, Sigma::Constant(SD), free()),
        &PosteriorOptions { start: WalkerStart::Box, ..options(1500) },
    );
    let (x, _, inverse) = least_squares(20);
    (0..2).for_each(|k| assert_moments(&found, k, x[k], SD * inverse[k].sqrt()));
    let open = line(20, Sigma::Constant(SD), [Parameter::new("v", 1.5)]);
    let fit = open.fit(FitOptions::default()).unwrap();
    let from_box = PosteriorOptions { start: WalkerStart::Box, ..options(10) };
    let error = open.sample(&fit, &from_box, &mut |_| (), &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("'v'") && error.contains("no finite bounds"), "{error}");
}

#[test]
fn unsuitable_fits_and_options_are_rejected() {
    let calibration = line(20, Sigma::Constant(SD), free());
    let error = |fit: FitOptions<'_>, options: &PosteriorOptions| {
        let fit = calibration.fit(fit).unwrap();
        match calibration.sample(&fit, options, &mut |_| (), &RunContext::new()) {
            Err(CalibrationError::Setup(message)) => message,
            other => panic!("{other:?}"),
        }
    };
    let mae = FitOptions { objective: CostKind::Named(NamedCost::Mae), ..FitOptions::default() };
    assert!(error(mae, &options(10)).contains("another cost (mae)"));
    let robust = FitOptions { loss: RobustLoss::new(Loss::Huber, 1.0).unwrap(), ..FitOptions::default() };
    assert!(error(robust, &options(10)).contains("robust loss"));
    let few = PosteriorOptions { n_walkers: Some(5), ..options(10) };
    assert!(
        error(FitOptions::default(), &few)
            .contains("5 walkers are too few for 2 parameters; the minimum is 6")
    );
    let none = PosteriorOptions { n_warmup: Some(10), ..options(10) };
    assert!(error(FitOptions::default(), &none).contains("no step remains"));
}
