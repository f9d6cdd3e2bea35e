//! Ends without information are not successes, and ends at integer minima are.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::methods_for_costs;
use dfo::{AnyMethod, DifferentialEvolution, Outcome, ParameterKind, Termination, minimize};

#[test]
fn constant_cost_is_not_reported_as_success() {
    for name in methods_for_costs().iter().map(AnyMethod::name) {
        let run = || {
            let method: AnyMethod = name.parse().unwrap();
            let problem = minimize(|_: &[f64]| 7.5).start(&[0.3, 0.6]).bounds(&[0.0; 2], &[1.0; 2]).unwrap();
            problem.method(method).seed(3).max_evaluations(20_000)
        };
        let report = run().run().unwrap();
        assert!(!report.is_success(), "{report}");
        let all = format!("the cost was 7.5 at all {} points", report.n_evaluations);
        assert!(report.message.ends_with(&all), "{report}");
        if matches!(name, "nelder-mead" | "barrier") {
            assert_eq!(report.termination, Termination::ConstantCost, "{name}");
            assert!(report.message.starts_with("not informative"), "{report}");
        }
        assert_eq!(run().workers(3).run().unwrap().termination, report.termination, "{name}");
    }
    // A cost that differs at a single point is not constant.
    let mut first = true;
    let flat = |_: &[f64]| Outcome::Value(if std::mem::take(&mut first) { 8.0 } else { 7.5 });
    let mut flat = flat;
    let report = dfo::minimize_batches(|batch| (0..batch.len()).map(|k| flat(batch.point(k))).collect())
        .start(&[0.3, 0.6])
        .run()
        .unwrap();
    assert_eq!(report.termination, Termination::Converged);
}

#[test]
fn unbounded_descent_is_not_reported_as_success() {
    for n in [1, 2, 4] {
        let report = minimize(|x: &[f64]| x.iter().sum::<f64>() * x[0].abs())
            .start(&vec![-1.0; n])
            .max_evaluations(50_000)
            .run()
            .unwrap();
        assert_eq!(report.termination, Termination::Unbounded, "{report}");
        assert!(!report.is_success() && report.message.contains("the cost has no minimum"), "{report}");
    }
}

#[test]
fn integer_minimum_is_reported_as_success() {
    for seed in 0..20 {
        let cost = |x: &[f64]| (x[0] - 3.0).powi(2) + (x[1] + 2.0).powi(2);
        let report = minimize(cost)
            .bounds(&[-9.0; 2], &[9.0; 2])
            .unwrap()
            .kinds(&[ParameterKind::Integer; 2])
            .method(DifferentialEvolution::default())
            .seed(seed)
            .run()
            .unwrap();
        assert_eq!(
            (&report.x[..], &report.termination),
            (&[3.0, -2.0][..], &Termination::Converged),
            "{report}"
        );
    }
}

#[test]
fn integer_minimum_is_found_for_every_end() {
    let cost = |x: &[f64]| x.iter().zip([3.2, -1.6, 0.3]).map(|(x, t)| (x - t).powi(2)).sum::<f64>();
    for method in [DifferentialEvolution::default(), DifferentialEvolution::classic()] {
        for n in 1..=3 {
            for seed in 0..10 {
                for budget in [None, Some(150), Some(400), Some(1000)] {
                    let m = minimize(cost).bounds(&vec![-6.0; n], &vec![6.0; n]).unwrap();
                    let m = m.kinds(&vec![ParameterKind::Integer; n]).method(method.clone()).seed(seed);
                    let report = budget.into_iter().fold(m, |m, b| m.max_evaluations(b)).run().unwrap();
                    let tests = report.tests.unwrap();
                    assert_eq!(report.is_success(), tests.passed, "{budget:?}: {report}");
                    if budget.is_none() {
                        assert!(report.is_success() && report.x == [3.0, -2.0, 0.0][..n], "{report}");
                    }
                }
            }
        }
    }
}
