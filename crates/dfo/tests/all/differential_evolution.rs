//! Differential evolution: solved problems and reproducibility.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{probe, rosenbrock, timeless};
use dfo::{
    Crossover, DifferentialEvolution, DifferentialWeight, Error, Minimize, ParameterKind, Repair, Report,
    Sampling, Strategy, Termination, Transform, minimize,
};
use std::f64::consts::TAU;

fn rastrigin(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x + 10.0 - 10.0 * (TAU * x).cos()).sum()
}

/// Maps three numbers to a number in [0, 1), for shifts and rotations of test functions.
fn hash(a: u64, b: u64, c: u64) -> f64 {
    let mut z = a.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ b.wrapping_mul(0xBF58_476D_1CE4_E5B9) ^ (c << 17);
    for _ in 0..3 {
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
    }
    (z >> 11) as f64 / (1u64 << 53) as f64
}

/// Returns an orthogonal matrix: Gram-Schmidt on random rows.
fn rotation(n: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for i in 0..n {
        let mut row: Vec<f64> = (0..n).map(|j| hash(seed, i as u64 + 1, j as u64 + 7) - 0.5).collect();
        for other in &rows {
            let dot: f64 = row.iter().zip(other).map(|(a, b)| a * b).sum();
            row.iter_mut().zip(other).for_each(|(a, b)| *a -= dot * b);
        }
        let norm = row.iter().map(|a| a * a).sum::<f64>().sqrt();
        row.iter_mut().for_each(|a| *a /= norm);
        rows.push(row);
    }
    rows
}

type Cost = Box<dyn Fn(&[f64]) -> f64 + Sync>;

/// Global test set: three functions in 5 and 10 dimensions, each with five shifts.
fn global_set() -> Vec<(String, usize, Cost)> {
    let mut set: Vec<(String, usize, Cost)> = Vec::new();
    for n in [5, 10] {
        for seed in 0..5 {
            let shift = move |name: u64| -> Vec<f64> {
                (0..n).map(|k| 6.0 * hash(seed, name, k as u64) - 3.0).collect()
            };
            let moved = |x: &[f64], s: &[f64]| -> Vec<f64> { x.iter().zip(s).map(|(x, s)| x - s).collect() };
            let s = shift(1);
            set.push((format!("rastrigin {n}/{seed}"), n, Box::new(move |x| rastrigin(&moved(x, &s)))));
            let s: Vec<f64> = shift(2).iter().map(|s| 0.5 * s).collect();
            let one = move |x: &[f64]| -> Vec<f64> { x.iter().zip(&s).map(|(x, s)| x - s + 1.0).collect() };
            set.push((format!("rosenbrock {n}/{seed}"), n, Box::new(move |x| rosenbrock(&one(x)))));
            let (s, q) = (shift(3), rotation(n, seed));
            let ellipsoid = move |x: &[f64]| -> f64 {
                let z = moved(x, &s);
                let along = |row: &Vec<f64>| row.iter().zip(&z).map(|(a, b)| a * b).sum::<f64>();
                let scale = |i: usize| 1e6f64.powf(i as f64 / (n - 1) as f64);
                q.iter().enumerate().map(|(i, row)| scale(i) * along(row).powi(2)).sum()
            };
            set.push((format!("ellipsoid {n}/{seed}"), n, Box::new(ellipsoid)));
        }
    }
    set
}

#[test]
fn l_shade_solves_the_global_set() {
    let (mut solved, mut exact) = (0, 0);
    for (k, (name, n, cost)) in global_set().into_iter().enumerate() {
        let report = minimize(cost)
            .bounds(&vec![-5.0; n], &vec![5.0; n])
            .unwrap()
            .method(DifferentialEvolution::default())
            .seed(k as u64)
            .max_evaluations(2000 * n)
            .run()
            .unwrap();
        println!("{name}: {:.2e} in {} ({})", report.fun, report.n_evaluations, report.termination);
        solved += usize::from(report.fun <= 1e-3);
        exact += usize::from(report.fun <= 1e-6);
    }
    println!("L-SHADE: {solved} of 30 to 1e-3, {exact} to 1e-6");
    assert!(solved >= 28, "{solved} of 30");
}

#[test]
fn classic_form_solves_small_problems() {
    let mut solved = 0;
    for seed in 0..10 {
        let report = minimize(rosenbrock)
            .bounds(&[-2.0; 2], &[2.0; 2])
            .unwrap()
            .method(DifferentialEvolution::classic())
            .seed(seed)
            .max_evaluations(4000)
            .run()
            .unwrap();
        assert_eq!((&*report.method, report.seed), ("de-classic", Some(seed)));
        solved += usize::from(report.fun < 1e-6);
    }
    assert!(solved >= 9, "{solved} of 10");
}

#[test]
fn all_variants_solve_probe_problem() {
    let runs: Vec<DifferentialEvolution> =
        [Strategy::Rand1, Strategy::Best1, Strategy::CurrentToBest1, Strategy::Rand2]
            .into_iter()
            .flat_map(|strategy| {
                [Crossover::Binomial, Crossover::Exponential].map(|crossover| {
                    DifferentialEvolution::classic().with(
                        strategy,
                        crossover,
                        DifferentialWeight::Dither(0.5, 1.0),
                        0.9,
                    )
                })
            })
            .chain(
                [Repair::Midpoint, Repair::Mirror, Repair::Clamp, Repair::Resample]
                    .map(|repair| DifferentialEvolution::default().repair(repair).sampling(Sampling::Sobol)),
            )
            .collect();
    for options in runs {
        for seed in 0..5 {
            let report = minimize(probe)
                .start(&[-0.5, 1.0])
                .bounds(&[-2.0; 2], &[2.0; 2])
                .unwrap()
                .method(options.clone())
                .seed(seed)
                .max_evaluations(3000)
                .run()
                .unwrap();
            assert!(report.fun < 1e-3 && report.n_failed > 0, "{options:?}: {report}");
            assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
        }
    }
}

fn run(m: Minimize<'_, dfo::NelderMead>, options: &DifferentialEvolution, seed: u64) -> Report {
    m.bounds(&[-2.0; 2], &[2.0; 2])
        .unwrap()
        .method(options.clone())
        .seed(seed)
        .max_evaluations(700)
        .run()
        .unwrap()
}

#[test]
fn result_is_independent_of_number_of_workers() {
    for options in [DifferentialEvolution::default(), DifferentialEvolution::classic()] {
        let one = run(minimize(probe), &options, 3);
        for workers in [2, 7] {
            let many = run(minimize(probe).workers(workers), &options, 3);
            assert_eq!(timeless(&many.trace), timeless(&one.trace));
            assert_eq!((many.x, many.fun, many.message), (one.x.clone(), one.fun, one.message.clone()));
        }
        assert_ne!(timeless(&run(minimize(probe), &options, 4).trace), timeless(&one.trace));
        // A drawn seed is reported and reproduces the run.
        let drawn = minimize(rosenbrock)
            .bounds(&[-2.0; 2], &[2.0; 2])
            .unwrap()
            .method(options.clone())
            .max_evaluations(200)
            .run()
            .unwrap();
        let again = minimize(rosenbrock)
            .bounds(&[-2.0; 2], &[2.0; 2])
            .unwrap()
            .method(options.clone())
            .seed(drawn.seed.unwrap())
            .max_evaluations(200)
            .run()
            .unwrap();
        assert_eq!(timeless(&again.trace), timeless(&drawn.trace));
    }
}

/// Returns members on a spiral in the box of `run`.
fn spiral(members: usize) -> Vec<Vec<f64>> {
    let member = |k: usize| {
        let (radius, angle) = (2.0 * (k + 1) as f64 / members as f64, k as f64);
        vec![radius * angle.cos(), radius * angle.sin()]
    };
    (0..members).map(member).collect()
}

#[test]
fn given_first_population_is_evaluated_exactly_and_has_equal_results_for_all_workers() {
    for options in [DifferentialEvolution::default(), DifferentialEvolution::classic()] {
        let members = spiral(24);
        let options = options.initial_population(members.clone());
        let one = run(minimize(probe).start(&[-0.5, 1.0]), &options, 3);
        let first: Vec<Vec<f64>> = one.trace.iter().filter(|e| e.batch == 0).map(|e| e.x.to_vec()).collect();
        assert_eq!(first, members);
        for workers in [2, 7] {
            let many = run(minimize(probe).start(&[-0.5, 1.0]).workers(workers), &options, 3);
            assert_eq!(timeless(&many.trace), timeless(&one.trace));
            assert_eq!((many.x, many.fun, many.message), (one.x.clone(), one.fun, one.message.clone()));
        }
        // The seed still determines the trials.
        assert_ne!(timeless(&run(minimize(probe), &options, 4).trace), timeless(&one.trace));
    }
}

#[test]
fn given_first_population_handles_logarithmic_integer_and_fixed_parameters() {
    let members: Vec<Vec<f64>> = (1..9).map(|k| vec![f64::from(k), 0.7f64.powi(k), 4.0]).collect();
    let run = |members: Vec<Vec<f64>>| {
        minimize(|x: &[f64]| (x[0] - 5.0).powi(2) + (x[1].ln() + 2.0).powi(2))
            .bounds(&[0.0, 1e-6, 4.0], &[20.0, 1e3, 4.0])
            .unwrap()
            .kinds(&[ParameterKind::Integer, ParameterKind::Continuous, ParameterKind::Continuous])
            .transforms(&[Transform::Linear, Transform::Log, Transform::Linear])
            .method(DifferentialEvolution::classic().initial_population(members))
            .seed(2)
            .max_evaluations(200)
            .run()
    };
    let report = run(members.clone()).unwrap();
    assert!(report.trace.iter().take(8).map(|e| e.x).eq(members.iter()), "{report}");
    assert!(report.trace.iter().all(|e| e.x[0] == e.x[0].round() && e.x[2] == 4.0) && report.x[0] == 5.0);
    let with = |member: [f64; 3]| run([&members[1..], &[member.to_vec()]].concat()).unwrap_err();
    let text = with([2.5, 1.0, 4.0]).to_string();
    assert_eq!(
        text,
        "initial population of x[0] = 2.5 must be an integer, because the parameter is discrete"
    );
    assert!(matches!(with([2.0, 0.0, 4.0]), Error::MemberOutside { member: 7, index: 1, .. }));
    assert!(matches!(with([2.0, 1.0, 5.0]), Error::MemberOutside { member: 7, index: 2, .. }));
}

#[test]
fn checkpoint_of_given_first_population_is_bound_to_it() {
    let path = std::env::temp_dir().join(format!("dfo_initial_population_{}", std::process::id()));
    let run = |options: DifferentialEvolution| {
        let checkpoint = dfo::Checkpoint::new(&path);
        minimize(rosenbrock)
            .bounds(&[-2.0; 2], &[2.0; 2])
            .unwrap()
            .method(options)
            .seed(1)
            .max_evaluations(60)
            .checkpoint(checkpoint)
            .run()
    };
    let options = DifferentialEvolution::classic().initial_population(spiral(12));
    let (first, again) = (run(options.clone()).unwrap(), run(options).unwrap());
    assert_eq!(timeless(&first.trace), timeless(&again.trace));
    let other = run(DifferentialEvolution::classic().initial_population(spiral(13))).unwrap_err();
    let _ = std::fs::remove_file(&path);
    assert!(other.to_string().contains("initial_population: 12 points ("), "{other}");
}

#[test]
fn cutoffs_do_not_change_decisions() {
    for options in [DifferentialEvolution::default(), DifferentialEvolution::classic()] {
        let plain = run(minimize(probe), &options, 5);
        let cut = run(minimize(common::cutting(probe)), &options, 5);
        let steps = |r: &Report| -> Vec<_> {
            r.trace.iter().map(|e| (e.x.to_vec(), e.id, e.batch, e.cutoff.to_bits(), e.used)).collect()
        };
        assert_eq!(steps(&plain), steps(&cut));
        assert_eq!((&plain.x, plain.fun, &plain.final_population), (&cut.x, cut.fun, &cut.final_population));
        assert_eq!(plain.tests, cut.tests);
        let saved = cut.trace.iter().filter(|e| matches!(e.outcome, dfo::Outcome::Above(_))).count();
        assert!(saved > 200, "{saved}");
    }
}

#[test]
fn differential_evolution_handles_integer_logarithmic_and_fixed_parameters() {
    let cost = |x: &[f64]| (x[0] - 7.3).powi(2) + (x[1].ln() - 1e-3f64.ln()).powi(2) + (x[2] - 1.5).powi(2);
    for options in [DifferentialEvolution::default(), DifferentialEvolution::classic()] {
        let report = minimize(cost)
            .bounds(&[0.0, 1e-6, 1.0, 4.0], &[20.0, 1e3, 2.0, 4.0])
            .unwrap()
            .kinds(&[
                ParameterKind::Integer,
                ParameterKind::Continuous,
                ParameterKind::Continuous,
                ParameterKind::Continuous,
            ])
            .transforms(&[Transform::Linear, Transform::Log, Transform::Linear, Transform::Linear])
            .method(options)
            .seed(2)
            .max_evaluations(4000)
            .run()
            .unwrap();
        assert!(report.trace.iter().all(|e| e.x[0] == e.x[0].round() && e.x[3] == 4.0));
        assert_eq!(report.x[0], 7.0);
        assert!((report.x[1] / 1e-3 - 1.0).abs() < 0.01 && (report.x[2] - 1.5).abs() < 1e-3, "{report}");
    }
    let fixed = minimize(|x: &[f64]| x[0])
        .bounds(&[2.0], &[2.0])
        .unwrap()
        .method(DifferentialEvolution::default())
        .run()
        .unwrap();
    assert_eq!((fixed.x, fixed.termination, fixed.n_evaluations), (vec![2.0], Termination::AllFixed, 1));
}

#[test]
fn differential_evolution_reports_convergence() {
    let report = minimize(|x: &[f64]| 1.0 + x.iter().map(|v| v * v).sum::<f64>())
        .bounds(&[-1.0; 3], &[1.5; 3])
        .unwrap()
        .method(DifferentialEvolution::classic().with(
            Strategy::Best1,
            Crossover::Binomial,
            DifferentialWeight::Fixed(0.6),
            0.9,
        ))
        .seed(1)
        .run()
        .unwrap();
    assert_eq!(report.termination, Termination::Converged, "{report}");
    assert!(report.message.contains("population size") && (report.fun - 1.0).abs() < 1e-6, "{report}");
}

#[test]
fn bad_options_return_typed_errors() {
    let run = |options: DifferentialEvolution, upper: f64| {
        minimize(rosenbrock)
            .bounds(&[-2.0; 2], &[2.0, upper])
            .unwrap()
            .start(&[0.0, 0.0])
            .method(options)
            .max_evaluations(50)
            .run()
    };
    let endless = run(DifferentialEvolution::default(), f64::INFINITY);
    assert!(matches!(endless, Err(Error::NeedsBox { method: "de", index: 1, .. })));
    let classic = DifferentialEvolution::classic;
    let weight = |w, p| classic().with(Strategy::Rand2, Crossover::Binomial, w, p);
    for bad in [
        weight(DifferentialWeight::Fixed(2.1), 0.5),
        weight(DifferentialWeight::Fixed(f64::NAN), 0.5),
        weight(DifferentialWeight::Dither(1.0, 0.5), 0.5),
        weight(DifferentialWeight::Fixed(0.5), 1.5),
        weight(DifferentialWeight::Fixed(0.5), 0.5).population(5),
        classic().population(3),
        DifferentialEvolution::default().population(3),
    ] {
        assert!(matches!(run(bad.clone(), 2.0), Err(Error::Option { .. })), "{bad:?}");
    }
    let members = |x: &[&[f64]]| classic().initial_population(x.iter().map(|x| x.to_vec()).collect());
    let square: [&[f64]; 4] = [&[0.0, 0.0], &[1.0, 0.0], &[0.0, 1.0], &[1.0, 1.0]];
    assert!(run(members(&square), 2.0).is_ok() && run(members(&square).population(4), 2.0).is_ok());
    for bad in [members(&[]), members(&square[1..]), members(&square).population(5)] {
        assert!(matches!(run(bad, 2.0), Err(Error::Option { name: "population", .. })));
    }
    let with = |x: &[f64]| run(members(&[&square[..], &[x]].concat()), 2.0).unwrap_err();
    assert_eq!(
        with(&[0.5]).to_string(),
        "member of the initial population: expected 2 values, one per parameter; got 1"
    );
    assert_eq!(
        with(&[0.5, 3.0]).to_string(),
        "initial population: coordinate x[1] = 3 of member 4 is outside its bounds [-2, 2]"
    );
    assert!(matches!(with(&[f64::NAN, 0.5]), Error::MemberOutside { member: 4, index: 0, .. }));
    let flat = run(members(&[&[0.0, 0.5], &[1.0, 0.5], &[2.0, 0.5], &[-1.0, 0.5]]), 2.0).unwrap_err();
    assert_eq!((flat.clone(), flat.parameter()), (Error::FlatPopulation { index: 1, value: 0.5 }, Some(1)));
    let choice = minimize(rosenbrock)
        .bounds(&[0.0; 2], &[2.0; 2])
        .unwrap()
        .kinds(&[ParameterKind::Categorical, ParameterKind::Continuous])
        .method(classic())
        .run();
    assert!(matches!(choice, Err(Error::NotContinuous { index: 0, .. })));
    let failing =
        minimize(|_: &[f64]| f64::NAN).bounds(&[0.0; 2], &[2.0; 2]).unwrap().method(classic()).run();
    assert!(matches!(failing, Err(Error::AllStartsFailed(_))));
    assert!(matches!(minimize(rosenbrock).method(classic()).run(), Err(Error::NoStart)));
}
