//! Every bad input ends in a typed error with location and values.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use dfo::{
    Barrier, BatchView, Coefficients, DifferentialEvolution, Error, Genetic, Minimize, NelderMead, Outcome,
    ParameterKind, Report, Termination, Transform, fallible, minimize, minimize_batches,
};

const INF: f64 = f64::INFINITY;

fn sum(x: &[f64]) -> f64 {
    x.iter().map(|v| v * v).sum()
}

fn two() -> Minimize<'static, NelderMead> {
    minimize(sum).start(&[1.0, 2.0])
}

fn error(run: Result<Report, Error>) -> (Error, String) {
    let error = run.unwrap_err();
    let text = error.to_string();
    (error, text)
}

#[test]
fn bad_start_points_are_errors() {
    assert_eq!(minimize(sum).run().unwrap_err(), Error::NoStart);
    assert_eq!(minimize(sum).start(&[]).run().unwrap_err(), Error::Empty);
    for value in [f64::NAN, INF, -INF] {
        let (e, _) = error(minimize(sum).start(&[0.0, value]).run());
        assert!(matches!(e, Error::StartNotFinite { index: 1, .. }));
    }
    let (e, text) = error(two().bounds(&[0.0, 3.0], &[2.0, 4.0]).unwrap().run());
    assert_eq!(e, Error::StartOutside { index: 1, value: 2.0, lower: 3.0, upper: 4.0 });
    assert_eq!(text, "x0[1] = 2 is outside its bounds [3, 4]");
}

#[test]
fn bad_bounds_are_errors() {
    let (e, text) = error(two().bounds(&[0.0], &[5.0]).unwrap().run());
    assert_eq!(e, Error::Length { what: "bounds", expected: 2, got: 1 });
    assert_eq!(text, "bounds: expected 2 values, one per parameter; got 1");
    let crossed = two().bounds(&[0.0, 5.0], &[5.0, 0.0]).unwrap_err();
    assert_eq!(crossed.to_string(), "x[1]: the lower bound 5 is above the upper bound 0");
    let tiny = two().bounds(&[0.0, 5e-12], &[5.0, -1e20]).unwrap_err();
    assert_eq!(tiny.to_string(), "x[1]: the lower bound 5e-12 is above the upper bound -1e20");
    assert!(matches!(two().bounds(&[0.0, f64::NAN], &[1.0, 1.0]), Err(Error::BadBound { index: 1, .. })));
    assert!(two().bounds(&[-INF, 2.0], &[INF, 2.0]).unwrap().run().is_ok());
}

#[test]
fn numbers_out_of_range_are_errors() {
    for value in [-1.0, f64::NAN, INF] {
        assert!(matches!(two().x_tol(value).run(), Err(Error::Option { name: "x_tol", .. })));
        assert!(matches!(two().f_tol(value).run(), Err(Error::Option { name: "f_tol", .. })));
    }
    assert!(matches!(two().target(f64::NAN).run(), Err(Error::Option { name: "target", .. })));
    assert!(matches!(two().workers(0).run(), Err(Error::Option { name: "workers", .. })));
    assert!(matches!(two().workers(1 << 16).run(), Err(Error::Option { name: "workers", .. })));
    assert!(matches!(two().max_evaluations(0).run(), Err(Error::Option { name: "max_evaluations", .. })));
    for value in [0.0, -1.0, f64::NAN, INF] {
        let (e, _) = error(two().scales(&[1.0, value]).run());
        assert!(matches!(e, Error::ParameterOption { name: "nominal size", index: 1, .. }));
    }
    assert!(matches!(
        two().scales(&[1.0]).run(),
        Err(Error::Length { what: "nominal sizes", expected: 2, got: 1 })
    ));
    assert!(matches!(
        two().transforms(&[Transform::Log; 3]).run(),
        Err(Error::Length { what: "transforms", .. })
    ));
    let log = minimize(sum).start(&[1.0, -2.0]).transforms(&[Transform::Linear, Transform::Log]).run();
    assert_eq!(log.unwrap_err(), Error::LogScale { index: 1, what: "start value", value: -2.0 });
}

#[test]
fn bad_method_options_are_errors() {
    let with = |m: NelderMead| two().method(m).run();
    for steps in [&[1.0][..], &[1.0, 0.0], &[f64::NAN, 1.0]] {
        assert!(with(NelderMead::default().initial_steps(steps)).is_err());
    }
    let flat = vec![vec![0.0, 0.0], vec![1.0, 1.0], vec![2.0, 2.0]];
    let (_, text) = error(with(NelderMead::default().initial_simplex(flat)));
    assert_eq!(text, "the initial simplex is flat: its vertices span only 1 of 2 dimensions");
    assert!(matches!(with(NelderMead::default().initial_simplex(vec![])), Err(Error::SimplexSize { .. })));
    let short = vec![vec![0.0, 0.0], vec![1.0], vec![2.0, 2.0]];
    assert!(matches!(with(NelderMead::default().initial_simplex(short)), Err(Error::Length { .. })));
    let custom = |reflection, expansion, contraction, shrink| {
        with(NelderMead::default().coefficients(Coefficients::Custom {
            reflection,
            expansion,
            contraction,
            shrink,
        }))
    };
    assert!(custom(1.0, 2.5, 0.4, 0.6).is_ok());
    for (r, e, c, s) in
        [(0.0, 2.0, 0.5, 0.5), (1.0, 1.0, 0.5, 0.5), (1.0, 2.0, 1.0, 0.5), (1.0, 2.0, 0.5, f64::NAN)]
    {
        assert!(matches!(custom(r, e, c, s), Err(Error::Option { .. })));
    }
}

#[test]
fn error_lists_reasons_when_objective_always_fails() {
    let cost = fallible(|x: &[f64]| match x[0] > 1.2 {
        true => Err("too large"),
        false => Ok(f64::NAN),
    });
    let (e, text) = error(minimize(cost).start(&[1.0, 2.0]).run());
    assert!(
        text.contains("3 evaluations, 3 failed: 2 x cost is NaN, 1 x too large; first at x = [1.0, 2.0]"),
        "{text}"
    );
    let Error::AllStartsFailed(found) = e else { panic!("{e}") };
    assert_eq!((found.n_evaluations, found.trace.len(), found.x.clone()), (3, 3, Some(vec![1.0, 2.0])));
    assert_eq!(found.failures, [("cost is NaN".to_owned(), 2), ("too large".to_owned(), 1)]);
}

#[test]
fn wrong_number_of_outcomes_ends_the_run() {
    let short = |b: &BatchView<'_>| vec![Outcome::Value(1.0); b.len() - 1];
    let (e, text) = error(minimize_batches(short).start(&[1.0, 2.0]).run());
    assert!(matches!(e, Error::EndedWithoutPoint { termination: Termination::Aborted(_), .. }));
    assert!(text.contains("the objective returned 2 outcomes for a batch of 3 points"), "{text}");

    let mut calls = 0;
    let later = |b: &BatchView<'_>| {
        calls += 1;
        let all: Vec<_> = (0..b.len()).map(|k| Outcome::Value(sum(b.point(k)))).collect();
        if calls < 10 { all } else { vec![] }
    };
    let report = minimize_batches(later).start(&[1.0, 2.0]).run().unwrap();
    assert!(matches!(report.termination, Termination::Aborted(_)));
    assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));

    let mut calls = 0;
    let left_out = |b: &BatchView<'_>| {
        calls += 1;
        (0..b.len())
            .map(|k| if calls < 10 { Outcome::Value(sum(b.point(k))) } else { Outcome::Skipped })
            .collect()
    };
    let report = minimize_batches(left_out).start(&[1.0, 2.0]).run().unwrap();
    assert_eq!(report.termination, Termination::Interrupted);

    let budget = |b: &BatchView<'_>| {
        assert_eq!((b.len(), b.as_flat().len(), b.n()), (2, 4, 2));
        vec![Outcome::Value(1.0); 2]
    };
    let report = minimize_batches(budget).start(&[1.0, 2.0]).max_evaluations(2).run().unwrap();
    assert_eq!((report.n_evaluations, report.termination), (2, Termination::MaxEvaluations));
}

#[test]
fn number_of_failure_reasons_is_limited() {
    let cost = fallible(|x: &[f64]| if x == [0.5] { Ok(1.0) } else { Err(format!("at {x:?}")) });
    let report = minimize(cost).start(&[0.5]).max_iterations(200).run().unwrap();
    assert!(report.failures.len() <= 51 && report.n_failed > 51);
    assert_eq!(report.failures.iter().map(|(_, n)| n).sum::<usize>(), report.n_failed);
}

#[test]
fn sizes_beyond_memory_are_rejected() {
    let run = || minimize(sum).start(&[1.0, 2.0]).bounds(&[0.0; 2], &[5.0; 2]).unwrap();
    for members in [0, 1_000_001, 1 << 62, usize::MAX] {
        let (e, _) = error(run().method(Genetic::default().population(members)).run());
        assert!(matches!(e, Error::Option { name: "population", .. }), "{e}");
        for method in [DifferentialEvolution::default(), DifferentialEvolution::classic()] {
            let (e, _) = error(run().method(method.population(members)).run());
            assert!(matches!(e, Error::Option { name: "population", .. }), "{e}");
        }
    }
    for size in [0, 51, usize::MAX] {
        let (e, _) =
            error(run().method(Genetic::default().selection(dfo::Selection::Tournament(size))).run());
        assert!(matches!(e, Error::Option { name: "selection", .. }), "{e}");
    }
    let wide = minimize(sum).start(&[1.0]).bounds(&[0.0], &[1e20]).unwrap().kinds(&[ParameterKind::Integer]);
    let (_, text) = error(wide.method(Genetic::default()).run());
    assert!(text.contains("bound of x[0] = 1e20 must be at most 2^53"), "{text}");
}

#[test]
fn logarithmic_parameter_rejects_box_that_includes_zero() {
    let run =
        minimize(sum).start(&[1.0]).bounds(&[0.0], &[1e-12 + 1.0]).unwrap().transforms(&[Transform::Log]);
    let (e, text) = error(run.method(DifferentialEvolution::default()).run());
    assert!(matches!(e, Error::LogScale { index: 0, what: "lower bound", .. }), "{text}");
}

#[test]
fn error_names_bounds_when_discrete_parameter_has_no_value() {
    for (lower, upper) in [(0.2, 0.8), (-0.9, -0.1)] {
        let run = minimize(sum).start(&[1.0, 0.5 * (lower + upper)]).bounds(&[0.0, lower], &[5.0, upper]);
        let run = run.unwrap().kinds(&[ParameterKind::Continuous, ParameterKind::Integer]);
        let (e, text) = error(run.method(Genetic::default()).run());
        assert!(matches!(e, Error::NoWholeNumber { index: 1, .. }), "{text}");
        assert!(text.contains("[1]") && text.contains(&format!("{lower} and {upper}")), "{text}");
        // The error does not ask for a start that cannot be given.
        let run = dfo::by_hand().bounds(&[lower], &[upper]).unwrap().kinds(&[ParameterKind::Categorical]);
        let e = run.method(Genetic::default()).optimizer().unwrap_err();
        assert!(matches!(e, Error::NoWholeNumber { index: 0, .. }), "{e}");
    }
}

#[test]
fn errors_report_option_and_range() {
    let run = || minimize(sum).start(&[1.0, 2.0]).bounds(&[0.0; 2], &[5.0; 2]).unwrap();
    for mu in [1e308, f64::INFINITY, f64::NAN, 0.0, -1.0] {
        let (e, text) = error(run().method(Barrier::default().mu(mu)).run());
        assert!(matches!(e, Error::Option { name: "mu", .. }) && text.contains("at most 1e200"), "{text}");
    }
    // A barrier that outweighs every cost keeps the search in the middle and stays finite.
    let report = run().method(Barrier::default().mu(1e200)).max_evaluations(300).run().unwrap();
    assert!(report.fun.is_finite() && report.n_failed == 0 && report.schedule[0].value.is_finite());
    let (e, text) = error(run().method(DifferentialEvolution::default().budget(0)).run());
    assert!(
        matches!(e, Error::Option { name: "budget", .. }) && text == "budget = 0 must be at least 1",
        "{e}"
    );
    let (_, text) = error(run().scales(&[1.0, 0.0]).run());
    assert!(text.contains("nominal size of x[1] = 0 must be positive and finite"), "{text}");
    let (_, text) = error(run().kinds(&[ParameterKind::Continuous, ParameterKind::Categorical]).run());
    assert_eq!(text, "nelder-mead does not support x[1], which is categorical");
}
