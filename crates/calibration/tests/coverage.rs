//! How often confidence intervals hold the truth: synthetic recordings of the van der Pol oscillator, with noise of another size on each
//! output; `mu` and both initial states are fitted.

#![allow(clippy::print_stdout, clippy::unwrap_used)]

use calibration::{
    Calibration, Data, Estimator, Experiment, FitOptions, Parameter, SimulationSettings, WorthOptions,
};
use example_models::example_fmu;

const TRUTH: [f64; 3] = [1.5, 2.0, 0.5];
const DEVIATIONS: [f64; 2] = [0.05, 0.3];

/// Normally distributed numbers: uniform ones by a linear congruential generator (Knuth's MMIX), turned by Box and Muller.
fn normal(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut uniform = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    };
    move || (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos()
}

fn calibration(columns: [Vec<f64>; 2]) -> Calibration {
    let time: Vec<f64> = (0..100).map(|k| 0.1 * f64::from(k)).collect();
    let [x0, x1] = columns;
    let data = Data::from_columns(time, [("x0".to_owned(), x0), ("x1".to_owned(), x1)]).unwrap();
    Calibration::builder(fmi::Fmu::open(example_fmu("van_der_pol").unwrap()).unwrap())
        .experiment(Experiment::new(data).output("x0", "x0").output("x1", "x1"))
        .parameter(Parameter::new("mu", 1.2).bounds(0.1, 5.0))
        .parameter(Parameter::new("x0", 1.8))
        .parameter(Parameter::new("x1", 0.3))
        .settings(SimulationSettings { method: ode::Method::Tsit5, ..SimulationSettings::default() })
        .build()
        .unwrap()
}

/// How many of so many recordings have the truth in the interval of each parameter.
fn covered(n: u64, estimator: Estimator) -> [u64; 3] {
    let exact = calibration([vec![0.0; 100], vec![0.0; 100]]).simulate(&TRUTH, None).unwrap().swap_remove(0);
    let mut covered = [0; 3];
    for seed in 0..n {
        let mut noise = normal(seed + 1);
        let columns = [0, 1].map(|k| exact.columns[k].iter().map(|y| y + DEVIATIONS[k] * noise()).collect());
        let worth = Some(WorthOptions { estimator, ..WorthOptions::default() });
        let fit = calibration(columns).fit(FitOptions { worth, ..FitOptions::default() }).unwrap();
        let intervals = fit.worth.unwrap().confidence_intervals(0.95).unwrap();
        for ((count, truth), (low, high)) in covered.iter_mut().zip(TRUTH).zip(intervals) {
            *count += u64::from((low..=high).contains(&truth));
        }
    }
    covered
}

#[test]
fn the_intervals_of_forty_recordings_hold_the_truth() {
    for count in covered(40, Estimator::Sandwich) {
        // 38 are expected; fewer than 34 of 40 have a probability of 1 in 100.
        assert!((34..=40).contains(&count), "{count} of 40");
    }
}

/// Run with `cargo test -p fmufit-calibration --test coverage -- --ignored --nocapture`.
#[test]
#[ignore = "takes a minute"]
fn the_intervals_of_two_hundred_recordings_hold_the_truth() {
    for estimator in [Estimator::Sandwich, Estimator::Pooled] {
        let counts = covered(200, estimator);
        println!("{}: {counts:?} of 200", estimator.name());
        if estimator == Estimator::Sandwich {
            assert!(counts.iter().all(|count| (180..=198).contains(count)), "{counts:?}");
        }
    }
}
