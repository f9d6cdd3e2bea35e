//! Nelder-Mead: accuracy and number of evaluations.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;
use crate::problems;

use common::{
    helical_valley, plan, powell_singular, probe, probe_fails, quiet_panics_on_purpose, rosenbrock,
};
use dfo::{
    Answers, AnyMethod, Batch, Bounds, BoundsHandling, Lookahead, Method, MethodOptions, NelderMead, Outcome,
    Search, Setup, Space, StopRule, Termination, ToleranceMeasure, Transform, fallible, minimize, with_query,
};
use problems::rotated::{Random, piecewise_linear, smooth};

#[test]
fn nelder_mead_solves_classic_problems() {
    let report = minimize(rosenbrock).start(&[-1.2, 1.0]).target(1e-8).run().unwrap();
    println!("rosenbrock: {} evaluations to 1e-8", report.n_evaluations);
    assert!(
        report.termination == Termination::Target && (60..=200).contains(&report.n_evaluations),
        "{report}"
    );

    let report = minimize(rosenbrock).start(&[-1.2, 1.0]).run().unwrap();
    println!("{report}");
    assert!(report.is_success() && report.fun < 1e-10 && report.n_evaluations < 400, "{report}");

    let report = minimize(powell_singular).start(&[3.0, -1.0, 0.0, 1.0]).target(1e-8).run().unwrap();
    println!("powell singular: {} evaluations to 1e-8", report.n_evaluations);
    assert!(report.n_evaluations < 500, "{report}");

    let report = minimize(helical_valley).start(&[-1.0, 0.0, 0.0]).run().unwrap();
    println!("{report}");
    assert!(report.fun < 1e-10 && report.n_evaluations < 600, "{report}");
    assert!((report.x[0] - 1.0).abs() < 1e-4 && report.x[1].abs() < 1e-4 && report.x[2].abs() < 1e-4);
}

#[test]
fn adaptive_coefficients_solve_ten_parameters() {
    let sphere =
        |x: &[f64]| -> f64 { x.iter().enumerate().map(|(i, x)| (1 + i) as f64 * (x - 1.0).powi(2)).sum() };
    let report = minimize(sphere).start(&[0.0; 10]).run().unwrap();
    println!("{report}");
    assert!(report.is_success() && report.fun < 1e-8 && report.n_evaluations < 3000, "{report}");
    let report = minimize(rosenbrock).start(&[-1.2; 10]).max_evaluations(20_000).run().unwrap();
    println!("{report}");
    assert!(report.is_success() && report.fun < 4.0, "{report}");
}

#[test]
fn nelder_mead_finds_active_bounds() {
    // The minimum over x1 <= 0.5 is at (0.5, 0.25) with (1 - 0.5)^2.
    for handling in [BoundsHandling::Mirror, BoundsHandling::Clamp, BoundsHandling::Sine] {
        let report = minimize(rosenbrock)
            .start(&[-1.2, 1.0])
            .bounds(&[-2.0, -2.0], &[0.5, 2.0])
            .unwrap()
            .method(NelderMead::default().bounds_handling(handling))
            .run()
            .unwrap();
        println!("{handling:?}: {report}");
        assert!((report.fun - 0.25).abs() < 1e-5 && report.is_success(), "{report}");
        assert!((report.x[0] - 0.5).abs() < 1e-5 && (report.x[1] - 0.25).abs() < 1e-4);
    }
    let report = minimize(|x: &[f64]| x[0] + x[1] + x[2])
        .start(&[0.3, 3.0, 0.7])
        .bounds(&[0.0, 0.0, 0.0], &[1.0, f64::INFINITY, 1.0])
        .unwrap()
        .measure(ToleranceMeasure::Absolute)
        .run()
        .unwrap();
    assert!(report.fun < 1e-5, "{report}");
}

/// McKinnon's function: from this simplex, the method contracts repeatedly towards a point that is not a
/// minimum.
fn mckinnon(x: &[f64]) -> f64 {
    let (theta, phi) = (6.0, 60.0);
    theta * x[0].powi(2) * if x[0] <= 0.0 { phi } else { 1.0 } + x[1] + x[1] * x[1]
}

#[test]
fn flat_simplex_is_rebuilt() {
    let root = 33f64.sqrt();
    let vertices = vec![vec![0.0, 0.0], vec![(1.0 + root) / 8.0, (1.0 - root) / 8.0], vec![1.0, 1.0]];
    let run = |restarts| {
        let method = NelderMead::default().initial_simplex(vertices.clone()).restarts(restarts);
        minimize(mckinnon).start(&[0.0, 0.0]).method(method).run().unwrap()
    };
    let (without, with) = (run(0), run(2));
    println!("{without}\n{with}");
    assert!(without.fun > -1e-6 && without.is_success(), "{without}");
    assert!((with.fun + 0.25).abs() < 1e-6 && (with.x[1] + 0.5).abs() < 1e-3, "{with}");
}

/// A simplex that collapses on a kink away from the minimum claims no success.
#[test]
fn nelder_mead_follows_rotated_kinks_to_minimum() {
    for method in [AnyMethod::from(NelderMead::default()), AnyMethod::auto(Search::Local)] {
        let (mut all, mut solved, mut wrong) = (0, 0, 0);
        for (n, seed) in (2..=6).flat_map(|n| (20..28).map(move |seed| (n, seed))) {
            for f in piecewise_linear(n, seed) {
                let mut random = Random::new(seed * 100 + n as u64);
                let start: Vec<f64> = f.minimum.iter().map(|c| c + 2.0 * random.normal()).collect();
                let run = minimize(|x: &[f64]| f.cost(x)).start(&start).method(method.clone());
                let report = run.run().unwrap();
                let is_solved = report.fun <= 1e-4 * f.cost(&start);
                all += 1;
                solved += usize::from(is_solved);
                wrong += usize::from(report.is_success() && !is_solved);
            }
        }
        println!("{}: {solved} of {all}, {wrong} wrong", method.name());
        assert!(solved * 100 >= 93 * all && wrong * 100 <= 4 * all, "{solved} of {all}, {wrong} wrong");
    }
}

/// Smooth costs are recognised as smooth and cause no restart.
#[test]
fn smooth_costs_cause_no_restart() {
    for (n, seed) in (2..=6).flat_map(|n| (0..4).map(move |seed| (n, seed))) {
        for f in smooth(n, seed) {
            let mut random = Random::new(seed * 100 + n as u64);
            let start: Vec<f64> = f.minimum.iter().map(|c| c + 0.5 * random.normal()).collect();
            let run = |restarts| {
                let method = NelderMead::default().restarts(restarts);
                minimize(|x: &[f64]| f.cost(x)).start(&start).method(method).run().unwrap()
            };
            assert_eq!(run(0).n_evaluations, run(20).n_evaluations, "{}, n = {n}, seed {seed}", f.name);
        }
    }
}

#[test]
fn simplex_flat_on_bound_is_not_rebuilt() {
    // The minimum is in a corner of the box, so vertices end on the bounds.
    for handling in [BoundsHandling::Mirror, BoundsHandling::Clamp] {
        let run = |restarts| {
            minimize(|x: &[f64]| x[0] + 2.0 * x[1] + (x[2] - 0.4).powi(2) + 1.0)
                .start(&[0.5; 3])
                .bounds(&[0.0; 3], &[1.0; 3])
                .unwrap()
                .method(NelderMead::default().bounds_handling(handling).restarts(restarts))
                .run()
                .unwrap()
        };
        let (none, some) = (run(0), run(2));
        assert_eq!((none.n_evaluations, none.fun), (some.n_evaluations, some.fun), "{handling:?}");
    }
}

#[test]
fn nelder_mead_solves_from_every_corner_of_the_box() {
    let (lower, upper) = ([-2.0, -1.0, 0.0], [3.0, 1.5, 4.0]);
    let cost = |x: &[f64]| (x[0] - 1.0).powi(2) + (x[1] + 0.5).powi(2) + (x[2] - 2.0).powi(2);
    for corner in 0..8 {
        let x0: Vec<f64> = (0..3).map(|i| if corner >> i & 1 == 1 { upper[i] } else { lower[i] }).collect();
        let report = minimize(cost).start(&x0).bounds(&lower, &upper).unwrap().run().unwrap();
        assert!(report.fun < 1e-9, "{x0:?}: {report}");
        for e in report.trace.iter() {
            assert!((0..3).all(|i| lower[i] <= e.x[i] && e.x[i] <= upper[i]));
        }
    }
}

#[test]
fn nelder_mead_survives_failing_regions() {
    type ParameterKind = fn(&[f64]) -> Outcome;
    let kinds: [(&str, ParameterKind); 4] = [
        ("nan", |x| Outcome::Value(probe(x))),
        ("inf", |x| Outcome::Value(if probe_fails(x) { f64::INFINITY } else { rosenbrock(x) })),
        ("error", |x| if probe_fails(x) { Outcome::failed("no") } else { Outcome::Value(rosenbrock(x)) }),
        ("panic", |x| if probe_fails(x) { panic!("on purpose") } else { Outcome::Value(rosenbrock(x)) }),
    ];
    quiet_panics_on_purpose();
    let reports = kinds.map(|(name, kind)| {
        let report = minimize(with_query(move |x: &[f64], _: &dfo::Query<'_>| kind(x)))
            .start(&[-0.5, 1.0])
            .bounds(&[-2.0, -2.0], &[2.0, 2.0])
            .unwrap()
            .max_evaluations(2000)
            .run()
            .unwrap();
        (name, report)
    });
    for (name, report) in &reports {
        println!("{name}: {report}");
        assert!(report.fun < 1e-6 && report.n_failed > 0 && report.is_success(), "{name}: {report}");
        assert_eq!(report.x, reports[0].1.x);
        assert_eq!(report.failures.len(), 1);
    }
}

#[test]
fn parameters_may_be_fixed_one_sided_and_logarithmic() {
    let cost = |x: &[f64]| (x[0] - 3.0).powi(2) + (x[1].ln() - 1e-3f64.ln()).powi(2) + (x[2] + 1.0).powi(2);
    let report = minimize(cost)
        .start(&[1.0, 1.0, 0.5, 7.0])
        .bounds(&[f64::NEG_INFINITY, 1e-6, 0.0, 7.0], &[2.0, 1e3, f64::INFINITY, 7.0])
        .unwrap()
        .transforms(&[Transform::Linear, Transform::Log, Transform::Linear, Transform::Linear])
        .run()
        .unwrap();
    assert!((report.x[0] - 2.0).abs() < 1e-5 && (report.x[1] / 1e-3 - 1.0).abs() < 1e-3, "{report}");
    assert!(report.x[2] < 1e-3 && report.x[3] == 7.0, "{report}");
    assert_eq!(report.trace.get(0).unwrap().x, [1.0, 1.0, 0.5, 7.0]);

    let all_fixed = minimize(|x: &[f64]| x[0]).start(&[2.0]).bounds(&[2.0], &[2.0]).unwrap().run().unwrap();
    assert_eq!(
        (all_fixed.n_evaluations, all_fixed.fun, all_fixed.termination),
        (1, 2.0, Termination::AllFixed)
    );
}

#[test]
fn nelder_mead_handles_small_parameters_and_costs() {
    let cost = |x: &[f64]| 1e-8 * rosenbrock(&[x[0] * 1e6, x[1] * 1e6]);
    let report =
        minimize(cost).start(&[-1.2e-6, 1e-6]).bounds(&[-2e-6, -2e-6], &[2e-6, 2e-6]).unwrap().run().unwrap();
    assert!(report.fun < 1e-16 && (report.x[0] - 1e-6).abs() < 1e-10, "{report}");
}

#[test]
fn nelder_mead_stops_at_zero_cost() {
    // Starts at the minimum, where |f_best| = 0 from the first evaluation.
    for x0 in [0.0, 1.0] {
        let report = minimize(move |x: &[f64]| x.iter().map(|v| (v - x0).powi(2)).sum())
            .start(&[x0; 2])
            .run()
            .unwrap();
        assert!(report.is_success() && report.fun == 0.0 && report.n_evaluations < 400, "{report}");
    }
    let report = minimize(|_: &[f64]| 0.0).start(&[0.5, 0.5]).run().unwrap();
    // A cost of zero everywhere ends as early but does not determine x.
    assert!(report.termination == Termination::ConstantCost && report.n_evaluations < 400, "{report}");
}

#[test]
fn single_finite_point_is_not_reported_as_success() {
    let lonely = |x: &[f64]| if x == [0.25, 0.5] { Ok(1.0) } else { Err("outside") };
    // The x test alone passes at the end, because the simplex of failures shrinks to the single point.
    for (stop, measure) in
        [(StopRule::All, ToleranceMeasure::Relative), (StopRule::Any, ToleranceMeasure::Absolute)]
    {
        let run = minimize(fallible(lonely)).start(&[0.25, 0.5]).stop(stop).measure(measure);
        let report = run.run().unwrap();
        assert_eq!((&report.termination, &report.x[..]), (&Termination::OneFiniteVertex, &[0.25, 0.5][..]));
        assert!(!report.is_success() && report.message.contains("only one vertex"), "{report}");
        assert_eq!(report.failures, [("outside".to_owned(), report.n_failed)]);
        assert!(report.n_evaluations < 500);
    }
}

#[test]
fn success_requires_passed_tests() {
    // Tolerances that cannot be met: the simplex collapses to a point.
    let bowl = |x: &[f64]| 1.0 + (x[0] - 0.3).abs() + (x[1] - 0.7).abs().sqrt();
    let report = minimize(bowl).start(&[1.0, 1.0]).x_tol(1e-30).f_tol(0.0).run().unwrap();
    let passed = report.tests.unwrap().passed;
    assert_eq!(
        (report.termination == Termination::Converged, report.is_success()),
        (passed, passed),
        "{report}"
    );
    for termination in [
        Termination::Collapsed,
        Termination::OneFiniteVertex,
        Termination::AllFailed,
        Termination::Stalled,
        Termination::MaxEvaluations,
    ] {
        assert!(!termination.is_success(), "{termination}");
    }
}

#[test]
fn either_test_stops_only_after_an_iteration() {
    // 1e-8 times Rosenbrock's function: the starting simplex already passes the f test.
    let run = |stop| {
        minimize(|x: &[f64]| 1e-8 * rosenbrock(x))
            .start(&[-1.2, 1.0])
            .measure(ToleranceMeasure::Absolute)
            .stop(stop)
            .run()
            .unwrap()
    };
    let any = run(StopRule::Any);
    assert!(any.n_iterations >= 1 && any.message.contains("f test passed"), "{any}");
    let all = run(StopRule::All);
    assert!(all.message.contains("x test passed") && all.message.contains("f test passed"), "{all}");
    let tests = all.tests.unwrap();
    assert!(tests.x_size <= 1e-6 && tests.f_spread.unwrap() <= 1e-6 && all.n_iterations > 20);
}

#[test]
fn absolute_x_test_uses_units_of_x() {
    let cost = |x: &[f64]| (x[0] / 1e4 - 3.0).powi(2) + (x[1] - 2.0).powi(2) + 1.0;
    for transforms in [[Transform::Linear; 2], [Transform::Log; 2]] {
        let report = minimize(cost)
            .start(&[1e4, 1.0])
            .bounds(&[1e3, 0.1], &[1e5, 10.0])
            .unwrap()
            .transforms(&transforms)
            .measure(ToleranceMeasure::Absolute)
            .stop(StopRule::Any)
            .x_tol(1e-3)
            .f_tol(0.0)
            .run()
            .unwrap();
        let simplex = report.final_simplex.clone().unwrap();
        let size = |i: usize| {
            simplex.vertices.iter().map(|v| (v[i] - simplex.vertices[0][i]).abs()).fold(0.0, f64::max)
        };
        if report.termination == Termination::Converged && report.tests.unwrap().x_passed {
            assert_eq!(size(0).max(size(1)), report.tests.unwrap().x_size);
            assert!(report.tests.unwrap().x_size <= 1e-3);
        }
        assert!((report.x[0] - 3e4).abs() < 5.0, "{report}");
    }
}

#[test]
fn given_steps_and_vertices_are_evaluated() {
    let report = minimize(rosenbrock)
        .start(&[0.0, 0.0])
        .method(NelderMead::default().initial_steps(&[0.5, -0.25]))
        .max_iterations(0)
        .run()
        .unwrap();
    assert_eq!(report.trace.points(), [0.0, 0.0, 0.5, 0.0, 0.0, -0.25]);
    assert_eq!((report.n_iterations, report.termination), (0, Termination::MaxIterations));
    let vertices = vec![vec![1.0, 2.0], vec![3.0, 4.0], vec![5.0, 9.0]];
    let report = minimize(rosenbrock)
        .start(&[0.0, 0.0])
        .method(NelderMead::default().initial_simplex(vertices))
        .max_iterations(0)
        .run()
        .unwrap();
    assert_eq!(report.trace.points(), [1.0, 2.0, 3.0, 4.0, 5.0, 9.0]);
}

#[test]
fn first_iterations_match_hand_calculation() {
    // f = x^2 + y^2 from (4, 3), (5, 3), (4, 4), costs 25, 34, 32. Centroid of the best two: (4, 3.5).
    // Reflection (3, 4): 25 is not below the best but below the second worst, so it is accepted, after the
    // older 25. Then the worst is (4, 4); centroid (3.5, 3.5); reflection (3, 3): 18 < 25; expansion (2.5,
    // 2.5): 12.5.
    let report = minimize(|x: &[f64]| x[0] * x[0] + x[1] * x[1])
        .start(&[4.0, 3.0])
        .method(plan(Lookahead::None).initial_steps(&[1.0, 1.0]))
        .max_iterations(2)
        .run()
        .unwrap();
    let points = [4.0, 3.0, 5.0, 3.0, 4.0, 4.0, 3.0, 4.0, 3.0, 3.0, 2.5, 2.5];
    assert_eq!(report.trace.points(), points);
    let simplex = report.final_simplex.unwrap();
    assert_eq!(simplex.vertices, [[2.5, 2.5], [4.0, 3.0], [3.0, 4.0]]);
    let cutoffs: Vec<f64> = report.trace.iter().map(|e| e.cutoff).collect();
    assert_eq!(cutoffs[3..], [34.0, 32.0, 18.0]);
}

/// Returns the reflection of a given simplex (best, second, worst) in the unit square.
fn reflection(vertices: [[f64; 2]; 3]) -> Vec<f64> {
    let space = Space::new(&vertices[0], Bounds::new(&[0.0; 2], &[1.0; 2]).unwrap(), &[], &[]).unwrap();
    let options = NelderMead::default()
        .bounds_handling(BoundsHandling::Mirror)
        .initial_simplex(vertices.iter().map(|v| v.to_vec()).collect());
    let mut search = options.begin(&Setup::new(space)).unwrap();
    let mut batch = Batch::new();
    search.ask(&mut batch);
    search.tell(&Answers::from(&[0.0, 1.0, 2.0].map(Outcome::Value)[..])).unwrap();
    search.ask(&mut batch);
    batch.point(0).to_vec()
}

#[test]
fn mirroring_keeps_the_simplex_nondegenerate() {
    // Unbounded: (-0.25, 0.375). Its mirror image is on the line through the other two vertices, so the point
    // moves to the bound.
    assert_eq!(reflection([[0.25, 0.25], [0.25, 0.5], [0.75, 0.375]]), [0.0, 0.375]);
    // Unbounded: (-0.25, 0.25). Its mirror image is the best vertex.
    assert_eq!(reflection([[0.25, 0.25], [0.375, 0.5], [0.875, 0.5]]), [0.0, 0.25]);
    // An ordinary mirror image is kept.
    assert_eq!(reflection([[0.25, 0.25], [0.25, 0.5], [0.625, 0.375]]), [0.125, 0.375]);
}

#[test]
fn simplex_clamped_to_one_point_is_not_reported_as_success() {
    // Starts on and inside a bound, with arbitrary minima: vertices are clamped to bounds on which others
    // already are.
    for width in [1.0, 0.5, 2.0, 0.13] {
        for optimum in [0.4f64, 0.01, -0.3, -0.9, -0.9999, 0.95] {
            for lower in [-1.0, -2.3] {
                for start in [lower, width, 0.0] {
                    for other in [-0.5, 0.05] {
                        let cost = |x: &[f64]| {
                            let rest = if x.len() > 1 { x[1] - 0.2 * x[0] - other } else { 0.0 };
                            (x[0] - optimum).powi(2) + rest * rest
                        };
                        for n in [1, 2] {
                            let report = minimize(cost)
                                .start(&[start, 0.0][..n])
                                .bounds(&[lower, 0.0][..n], &[width, 1.0][..n])
                                .unwrap()
                                .method(NelderMead::default().bounds_handling(BoundsHandling::Clamp))
                                .run()
                                .unwrap();
                            let grid = (0..=4000).map(|k| lower + (width - lower) * f64::from(k) / 4000.0);
                            let rest = |x: f64| (0.2 * x + other).clamp(0.0, 1.0);
                            let least = grid.map(|x| cost(&[x, rest(x)][..n])).fold(f64::INFINITY, f64::min);
                            let size = report.tests.unwrap().x_size;
                            assert!(report.is_success() && size > 0.0, "{start} {optimum}: {report}");
                            if n == 1 {
                                assert!(report.fun < least + 1e-6, "{start} {optimum}: {report}");
                            }
                        }
                    }
                }
            }
        }
    }
}
