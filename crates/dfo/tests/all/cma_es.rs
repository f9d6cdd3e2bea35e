//! CMA-ES: evaluations compared with pycma, bounds, restarts and ends.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::rosenbrock;
use dfo::{
    AnyMethod, CmaBounds, CmaEs, Error, Minimize, ParameterKind, PatternSearch, Record, Report, Restarts,
    Search, Termination, Transform, Value, minimize,
};

/// Quadratic with condition number 1e6 in reflected axes.
fn ellipsoid(x: &[f64]) -> f64 {
    let n = x.len() as f64;
    let along: f64 = x.iter().enumerate().map(|(k, x)| (k as f64 + 1.0) * x).sum();
    let squared = n * (n + 1.0) * (2.0 * n + 1.0) / 6.0;
    let turned = x.iter().enumerate().map(|(k, x)| x - 2.0 * (k as f64 + 1.0) * along / squared);
    turned.enumerate().map(|(k, z)| 10f64.powf(6.0 * k as f64 / (n - 1.0)) * z * z).sum()
}

fn rastrigin(x: &[f64]) -> f64 {
    x.iter().map(|x| 10.0 + (x - 0.7).powi(2) - 10.0 * (std::f64::consts::TAU * (x - 0.7)).cos()).sum()
}

/// Returns the number of evaluations until the cost is 1e-6, the median of 25 seeds.
fn median(f: fn(&[f64]) -> f64, x0: &[f64], lag: usize) -> usize {
    let run = |seed| {
        let method = CmaEs::default().sigma(0.5).lag(lag);
        let search = minimize(f).start(x0).scales(&vec![1.0; x0.len()]).method(method);
        search.seed(seed).x_tol(0.0).f_tol(0.0).target(1e-6).max_evaluations(50_000).run().unwrap()
    };
    let mut counts: Vec<usize> = (0..25).map(|seed| run(seed).n_evaluations).collect();
    counts.sort_unstable();
    counts[12]
}

/// Medians of pycma 4.5 with the same starts, step size, population and number of seeds
/// (`benches/dfo/cma_es.py`).
#[test]
fn cma_es_needs_no_more_evaluations_than_pycma() {
    for (name, f, x0, n, theirs) in [
        ("ellipsoid", ellipsoid as fn(&[f64]) -> f64, 1.0, 5, PYCMA[0]),
        ("ellipsoid", ellipsoid, 1.0, 10, PYCMA[1]),
        ("rosenbrock", rosenbrock, 0.0, 5, PYCMA[2]),
        ("rosenbrock", rosenbrock, 0.0, 10, PYCMA[3]),
    ] {
        // With a lag, the limit is given in tenths of pycma's evaluations. It is less than the number of
        // workers that the lag keeps busy.
        for (lag, most) in [(0, 11), (n, 20), (64, 50)] {
            let ours = median(f, &vec![x0; n], lag);
            assert!(10 * ours <= most * theirs, "{name} {n}, lag {lag}: {ours}, pycma {theirs}");
        }
    }
}

const PYCMA: [usize; 4] = [1214, 3523, 1506, 4710];

fn boxed<'a>(f: fn(&[f64]) -> f64, n: usize, options: CmaEs) -> Minimize<'a, CmaEs> {
    minimize(f).bounds(&vec![-5.0; n], &vec![5.0; n]).unwrap().method(options)
}

#[test]
fn cma_es_finds_minima_at_bounds() {
    // Half of the parameters have their minimum at the upper bound, towards which the cost decreases.
    let f = |x: &[f64]| {
        let shifted: Vec<f64> = x.iter().map(|x| x - 1.0).collect();
        ellipsoid(&shifted) + x.iter().step_by(2).map(|x| 1.0 - x).sum::<f64>()
    };
    let upper = [1.0, 4.0, 1.0, 4.0];
    for handling in [CmaBounds::Smooth, CmaBounds::Mirror] {
        let run = minimize(f).start(&[-2.0; 4]).bounds(&[-4.0; 4], &upper).unwrap();
        let report = run.method(CmaEs::default().bounds_handling(handling)).seed(4).run().unwrap();
        assert!(report.is_success() && report.fun < 1e-6, "{handling:?}: {report}");
        assert!(report.trace.iter().all(|e| (0..4).all(|k| -4.0 <= e.x[k] && e.x[k] <= upper[k])));
    }
}

#[test]
fn restarts_find_the_lowest_of_many_minima() {
    let run = |restarts, seed| {
        let search = boxed(rastrigin, 3, CmaEs::default().restarts(restarts));
        search.seed(seed).target(1e-6).max_evaluations(20_000).run().unwrap()
    };
    let found = |restarts| (0..10).filter(|seed| run(restarts, *seed).fun <= 1e-6).count();
    let counts = [Restarts::None, Restarts::Ipop, Restarts::Bipop].map(found);
    assert!(counts[0] <= 3 && counts[1] >= 9 && counts[2] >= 9, "{counts:?}");
    // Without restarts, the first minimum ends the run.
    assert_eq!(run(Restarts::None, 1).termination, Termination::Converged);
    // A run that converged before a limit ended it is a success.
    let report = boxed(rosenbrock, 3, CmaEs::default().restarts(Restarts::Ipop));
    let report = report.seed(2).max_evaluations(6000).run().unwrap();
    assert!(report.n_evaluations == 6000 && report.fun < 1e-9, "{report}");
    assert_eq!(report.termination, Termination::Converged, "{report}");
}

#[test]
fn result_is_independent_of_parameter_units() {
    let run = |unit: [f64; 2]| -> Report {
        let cost = move |x: &[f64]| rosenbrock(&[x[0] / unit[0], x[1] / unit[1]]);
        minimize(cost).start(&[-1.5 * unit[0], unit[1]]).method(CmaEs::default()).seed(3).run().unwrap()
    };
    // Powers of two are exact.
    let (one, other) = (run([1.0, 1.0]), run([2f64.powi(-20), 2f64.powi(20)]));
    assert!(one.is_success() && one.fun < 1e-10, "{one}");
    assert_eq!((one.fun, one.n_evaluations, &one.message), (other.fun, other.n_evaluations, &other.message));
}

#[test]
fn runs_without_information_end() {
    let flat = boxed(|_| 1.0, 3, CmaEs::default()).seed(1).run().unwrap();
    assert!(!flat.is_success() && flat.n_evaluations < 500, "{flat}");
    let unbounded = minimize(|x: &[f64]| x[0]).start(&[1.0]).method(CmaEs::default()).seed(1).run().unwrap();
    assert_eq!(unbounded.termination, Termination::Unbounded, "{unbounded}");
    let noise = |x: &[f64]| {
        let bits =
            x.iter().fold(1u64, |h, v| (h ^ v.to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (h >> 29));
        x.iter().map(|x| x * x).sum::<f64>() + 1e-3 * (bits >> 40) as f64 / 16_777_216.0
    };
    let noisy = minimize(noise).start(&[1.0, 2.0, 3.0]).method(CmaEs::default()).seed(1).run().unwrap();
    assert!(noisy.termination == Termination::Stalled && noisy.n_evaluations < 4000, "{noisy}");
    assert!(noisy.fun < 2e-3, "{noisy}");
}

/// The start does not show how small the parameters are. Both methods determine the size before they search.
#[test]
fn unknown_parameter_sizes_are_found_when_start_is_zero() {
    for size in [1e-9, 1e-7, 1e-5, 1e-2, 1e3] {
        let cost = move |x: &[f64]| rosenbrock(&[x[0] / size, x[1] / size]) + (x[2] - 4.0).powi(2);
        let run =
            |method: AnyMethod| minimize(cost).start(&[0.0, 0.0, 1.0]).method(method).seed(2).run().unwrap();
        for (method, least) in [(CmaEs::default().into(), 1e-9), (PatternSearch::default().into(), 1e-2)] {
            let report = run(method);
            assert!(report.is_success() && report.fun < least, "{size:e}: {report}");
        }
    }
}

/// No individual is better than a start near the minimum until the first step, which is far too long, has
/// been shortened.
#[test]
fn good_start_does_not_end_the_search_early() {
    for n in [40, 50] {
        let sphere = |x: &[f64]| x.iter().map(|x| (x - 1.0).powi(2)).sum::<f64>();
        let run = minimize(sphere).start(&vec![1.0 + 1e-5; n]).method(CmaEs::default()).seed(1);
        let report = run.run().unwrap();
        assert!(report.is_success() && report.fun < 1e-4 * n as f64 * 1e-10, "{n}: {report}");
        let run = minimize(rosenbrock).start(&vec![0.0; n]).scales(&vec![1.0; n]);
        let run = run.method(CmaEs::default().sigma(0.6)).seed(2).max_evaluations(15_000);
        let report = run.run().unwrap();
        assert!(report.n_evaluations == 15_000 && report.fun < 0.97 * (n - 1) as f64, "{n}: {report}");
    }
}

/// The default first step is too long for a hundred parameters. With the step size from the path, 12 719
/// evaluations are needed.
#[test]
fn first_step_is_shortened_quickly_with_many_parameters() {
    let sphere = |x: &[f64]| x.iter().map(|x| (x - 0.3).powi(2)).sum::<f64>();
    let folder = tempfile::tempdir().unwrap();
    for seed in 1..=3 {
        let file = folder.path().join(seed.to_string());
        let run = |most, file: Option<&std::path::Path>| {
            let search = boxed(sphere, 100, CmaEs::default()).seed(seed).x_tol(0.0).f_tol(0.0).target(1e-8);
            let search = search.max_evaluations(most);
            match file {
                Some(file) => search.checkpoint(dfo::Checkpoint::new(file)).run().unwrap(),
                None => search.run().unwrap(),
            }
        };
        let whole = run(20_000, None);
        assert!(whole.fun <= 1e-8 && whole.n_evaluations < 9000, "{whole}");
        run(2000, Some(&file));
        let resumed = run(20_000, Some(&file));
        assert_eq!((&resumed.x, resumed.n_evaluations), (&whole.x, whole.n_evaluations));
    }
}

/// Returns the kinds of `n` parameters, of which the first `n_integer` are integers.
fn kinds(n: usize, n_integer: usize) -> Vec<ParameterKind> {
    let kind = |k| if k < n_integer { ParameterKind::Integer } else { ParameterKind::Continuous };
    (0..n).map(kind).collect()
}

#[test]
fn cma_es_finds_integers_of_rotated_ellipsoid() {
    for (n, n_integer) in [(4, 2), (4, 4), (8, 4)] {
        for seed in 0..5 {
            let best: Vec<f64> = (0..n).map(|k| if k < n_integer { 3.0 - k as f64 } else { 0.3 }).collect();
            let target = best.clone();
            let cost = move |x: &[f64]| {
                let z: Vec<f64> = x.iter().zip(&target).map(|(x, t)| x - t).collect();
                let sum: f64 = z.iter().sum();
                z.iter().map(|z| z * z).sum::<f64>() + 10.0 * sum * sum
            };
            let run = |workers: usize| {
                let run = minimize(cost.clone()).bounds(&vec![-9.0; n], &vec![11.0; n]).unwrap();
                let method = CmaEs::default().restarts(Restarts::Ipop).patience(3);
                run.kinds(&kinds(n, n_integer)).method(method).seed(seed).workers(workers).run().unwrap()
            };
            let report = run(1);
            assert!(report.method == "cma-es" && report.termination == Termination::Converged, "{report}");
            assert!(report.x[..n_integer] == best[..n_integer] && report.fun < 1e-9, "{report}");
            assert!(report.trace.iter().all(|e| e.x[..n_integer].iter().all(|x| *x == x.round())));
            let parallel = run(3);
            assert_eq!((&parallel.x, parallel.n_evaluations), (&report.x, report.n_evaluations));
        }
    }
}

#[test]
fn cma_es_handles_logarithmic_open_and_binary_integers() {
    let cost = |x: &[f64]| {
        (x[0].ln() - 200f64.ln()).powi(2)
            + (x[1] + 40.0).powi(2)
            + (x[2] - 0.8).powi(2)
            + (x[3] - 0.25).powi(2)
    };
    const INF: f64 = f64::INFINITY;
    let report = minimize(cost)
        .start(&[1.0, 7.0, 0.0, 1.0])
        .bounds(&[1.0, -INF, 0.0, -1.0], &[1e4, INF, 1.0, 1.0])
        .unwrap()
        .kinds(&kinds(4, 3))
        .transforms(&[Transform::Log, Transform::Linear, Transform::Linear, Transform::Linear])
        .method(CmaEs::default())
        .seed(4)
        .run()
        .unwrap();
    assert_eq!(report.x[..3], [200.0, -40.0, 1.0], "{report}");
    assert!(report.is_success() && (report.x[3] - 0.25).abs() < 1e-4, "{report}");
}

#[test]
fn cma_es_rejects_categorical_parameters_and_de_options_select_de() {
    let run = |options: &[(&str, Value)], kind| {
        let record: Record = options.iter().map(|(name, v)| ((*name).to_owned(), v.clone())).collect();
        let method = AnyMethod::auto(Search::Local).with_options(&record).unwrap();
        let run = minimize(|x: &[f64]| x[0] * x[0]).bounds(&[-5.0], &[9.0]).unwrap();
        run.kinds(&[kind]).method(method).seed(1).run().unwrap()
    };
    let report = run(&[("p_best", Value::Number(0.2))], ParameterKind::Integer);
    assert_eq!((&*report.method, report.x[0]), ("de", 0.0));
    assert_eq!(report.method_reason.as_deref(), Some("the option 'p_best' belongs to de"));
    let report = run(&[("sigma", Value::Number(0.5))], ParameterKind::Integer);
    assert_eq!(
        (&*report.method, report.method_reason.as_deref()),
        ("cma-es", Some("all parameters are integers with more than two values"))
    );
    let categorical = minimize(|x: &[f64]| x[0]).bounds(&[0.0], &[3.0]).unwrap();
    let categorical = categorical.kinds(&[ParameterKind::Categorical]).method(CmaEs::default());
    assert!(matches!(categorical.run(), Err(Error::NotContinuous { method: "cma-es", index: 0, .. })));
}

#[test]
fn patience_ends_the_run_after_restarts_without_a_better_point() {
    let sphere = |x: &[f64]| 1.0 + x.iter().map(|x| (x - 0.3).powi(2)).sum::<f64>();
    let counts: Vec<usize> = [0, 1, 3]
        .map(|patience| {
            let method = CmaEs::default().restarts(Restarts::Ipop).patience(patience);
            let report = boxed(sphere, 2, method).seed(1).run().unwrap();
            assert!(report.termination == Termination::Converged && report.fun < 1.0 + 1e-9, "{report}");
            report.n_evaluations
        })
        .to_vec();
    let single = boxed(sphere, 2, CmaEs::default()).seed(1).run().unwrap();
    assert_eq!(counts[0], single.n_evaluations);
    assert!(counts[0] < counts[1] && counts[1] < counts[2] && counts[2] < 3000, "{counts:?}");
}
