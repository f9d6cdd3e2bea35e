//! The Reference-FMUs of the Modelica Association as oracles. The values are published in `<model>_out.csv`
//! of tag v0.0.41, github.com/modelica/Reference-FMUs (2-Clause BSD License, Copyright Modelica Association
//! Project "FMI"), and computed with Euler's method. The bundled models have the same equations. The
//! reference FMUs are also run if the folder `FMUFIT_REFERENCE_FMUS` contains them.
#![allow(clippy::unwrap_used)]

use fmi::ode::Method;
use fmi::{Fmu, SimulateOptions, Trajectory};
use std::path::PathBuf;

/// Returns a bundled model, and the reference FMU with this name if it exists.
fn models(ours: &str, theirs: &str) -> Vec<Fmu> {
    let folder = std::env::var_os("FMUFIT_REFERENCE_FMUS").map(PathBuf::from);
    let built = folder.map(|folder| folder.join(format!("{theirs}.fmu"))).filter(|path| path.is_file());
    let paths = std::iter::once(example_models::example_fmu(ours).unwrap()).chain(built);
    paths.map(|path| Fmu::open(path).unwrap()).collect()
}

/// Runs with Euler's method and steps of `step` to the last of these times.
fn run(fmu: &Fmu, step: f64, times: &[f64]) -> Trajectory {
    let options = SimulateOptions::new()
        .kind(fmi::InterfaceChoice::ModelExchange)
        .method(Method::Euler)
        .step_size(step);
    fmu.simulate(&options.times(times.to_vec())).unwrap()
}

#[test]
fn dahlquist_matches_the_reference_results() {
    let published = [
        (0.1, 0.9),
        (2.1, 0.109_418_989_131_512_35),
        (4.4, 0.009_697_737_297_875_235),
        (6.7, 0.000_859_504_455_171_442_6),
        (9.0, 0.000_076_177_348_045_866_34),
        (10.0, 0.000_026_561_398_887_587_46),
    ];
    let times = published.map(|(time, _)| time);
    for fmu in models("dahlquist", "Dahlquist") {
        let result = run(&fmu, 0.1, &times);
        for ((time, expected), x) in published.iter().zip(result.get("x").unwrap()) {
            assert!(
                (x - expected).abs() < 1e-9 * expected.max(1e-3),
                "x({time}) = {x} instead of {expected}"
            );
        }
    }
}

#[test]
fn van_der_pol_matches_the_reference_results() {
    let published = [
        (0.21, 1.965_022_425_686_879_8, -0.315_015_774_013_839_6),
        (0.67, 1.740_426_787_881_690_1, -0.624_349_016_907_163_2),
        (1.13, 1.404_036_809_971_158_4, -0.851_004_053_556_715_2),
        (1.82, 0.630_925_999_271_511_6, -1.507_723_055_271_932),
        (20.0, 2.014_841_886_154_613_3, 0.244_194_707_519_044_07),
    ];
    let times = published.map(|(time, ..)| time);
    for fmu in models("van_der_pol", "VanDerPol") {
        let result = run(&fmu, 0.01, &times);
        let columns = result.get("x0").unwrap().iter().zip(result.get("x1").unwrap());
        for ((time, x0, x1), (a, b)) in published.iter().zip(columns) {
            assert!(
                (a - x0).abs() < 1e-8 && (b - x1).abs() < 1e-8,
                "at {time}: {a}, {b} instead of {x0}, {x1}"
            );
        }
    }
}

#[test]
fn bouncing_ball_matches_the_reference_results() {
    // The reference uses steps of 0.01 without event location, so only the flight before the first impact and
    // the state at rest are compared.
    let published = [(0.21, 0.784_719_549_999_999_6, -2.060_1), (0.44, 0.052_550_200_000_001_05, -4.316_4)];
    let times = [0.21, 0.44, 3.0];
    for fmu in models("bouncing_ball", "BouncingBall") {
        let result = run(&fmu, 1e-3, &times);
        let (h, v) = (result.get("h").unwrap(), result.get("v").unwrap());
        for (k, (time, height, speed)) in published.iter().enumerate() {
            assert!(
                (h[k] - height).abs() < 0.02 && (v[k] - speed).abs() < 1e-9,
                "at {time}: {}, {}",
                h[k],
                v[k]
            );
        }
        assert!(h[2].abs() < 1e-9 && v[2].abs() < 1e-9, "at rest: {}, {}", h[2], v[2]);
    }
}

#[test]
fn stair_matches_the_reference_results() {
    let published = [(4.2, 5.0), (8.8, 9.0), (9.0, 10.0)];
    let times = published.map(|(time, _)| time);
    for fmu in models("stair", "Stair") {
        let result = run(&fmu, 0.2, &times);
        for ((time, expected), counter) in published.iter().zip(result.get("counter").unwrap()) {
            assert_eq!(counter, expected, "counter({time})");
        }
    }
}
