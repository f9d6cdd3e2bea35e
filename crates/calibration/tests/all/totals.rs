//! Totals of a fit: the sum over its simulations, in all processes and with every outcome.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::{Calibration, Data, Experiment, FitOptions, Parameter};
use dfo::{Limits, Lookahead, NelderMead, RunOptions};
use example_models::example_fmu;
use fmi::Fmu;
use fmi::RunSettings;
use ode::{Method, Stats};

/// A bouncing ball, measured at four instants. With less restitution, it stops bouncing earlier.
fn calibration() -> Calibration {
    let time = vec![0.0, 0.5, 1.0, 1.5];
    let data = Data::from_columns(time, [("h".to_owned(), vec![1.0, 0.3, 0.2, 0.1])]).unwrap();
    Calibration::builder(Fmu::open(example_fmu("bouncing_ball").unwrap()).unwrap())
        .experiment(Experiment::new(data).output("h", "h"))
        .parameter(Parameter::new("e", 0.7).bounds(0.1, 0.95))
        .settings(RunSettings { method: Method::Tsit5, ..RunSettings::default() })
        .build()
        .unwrap()
}

fn options(evaluations: usize, workers: usize, cutoffs: bool) -> FitOptions<'static> {
    let limits = Limits { max_evaluations: Some(evaluations), ..Limits::default() };
    // Speculation is disabled, because its evaluations would count and their number depends on the machine.
    let mut method = NelderMead::default();
    method.batch = Lookahead::None;
    let run =
        RunOptions { method: method.into(), limits, workers: Some(workers), ..FitOptions::default_run() };
    // The uncertainty of the fit would use further simulations.
    FitOptions { cutoffs, uncertainty: None, ..run.into() }
}

#[test]
fn totals_equal_sum_over_all_evaluations() {
    let calibration = calibration();
    for workers in [1, 3] {
        let fit = calibration.fit(options(12, workers, false)).unwrap();
        assert_eq!(fit.report.trace.len(), 12);
        let mut total = Stats::default();
        for entry in fit.report.trace.iter() {
            total += calibration.simulate(entry.x, None, &RunContext::new()).unwrap()[0].stats;
        }
        assert_eq!(fit.stats, total);
        assert!(fit.stats.state_events > 12 && fit.stats.event_indicators > fit.stats.state_events);
        let (seconds, in_model) = (fit.stats.seconds.get(), fit.stats.seconds_in_model.get());
        assert!(in_model > 0.0 && in_model <= seconds, "{in_model} of {seconds}");
        assert!(fit.to_string().contains("inside the model"), "{fit}");
    }
}

#[test]
fn totals_include_partial_simulations() {
    let calibration = calibration();
    let all = calibration.fit(options(30, 1, false)).unwrap().stats;
    let some = calibration.fit(options(30, 1, true)).unwrap().stats;
    assert!(some.right_hand_sides < all.right_hand_sides && some.right_hand_sides > 0);
}
