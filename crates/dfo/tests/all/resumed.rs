//! A run stopped at any point continues bit for bit, and a finished run returns its stored result.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::{checkpoint, common};

use checkpoint::{Folder, methods, same};
use common::rosenbrock;
use dfo::{
    Checkpoint, Error, LeastSquares, MethodOptions, Outcome, ParameterKind, Query, Report, ResidualFunction,
    Termination, minimize, residuals,
};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

type Model = fn(&[f64], f64) -> f64;

/// Residuals of a model at 20 times, with a limited number of calls.
struct Cut {
    model: Model,
    truth: [f64; 2],
    calls: AtomicUsize,
    most: usize,
}

impl ResidualFunction for Cut {
    fn residuals(&self, x: &[f64], _: &Query<'_>, out: &mut Vec<f64>) -> Result<(), Outcome> {
        if self.calls.fetch_add(1, Ordering::Relaxed) >= self.most {
            return Err(Outcome::Abort("stopped".to_owned()));
        }
        let residual = |t: f64| (self.model)(x, t) - (self.model)(&self.truth, t);
        out.extend((0..20).map(|k| residual(0.25 * f64::from(k))));
        Ok(())
    }
}

/// Smooth models, and models whose steps have no derivatives, which a simplex finally searches.
const MODELS: [(&str, Model); 6] = [
    ("line", |x, t| x[0] + x[1] * t),
    ("decay", |x, t| x[0] * (-x[1] * t).exp()),
    ("rounded line", |x, t| (2.0 * (x[0] + x[1] * t)).round() / 2.0),
    ("rounded decay", |x, t| (10.0 * x[0] * (-x[1] * t).exp()).round() / 10.0),
    ("delay", |x, t| if t >= x[1] { x[0] } else { 0.0 }),
    ("rounded parameters", |x, _| (x[0] - 0.3).round().hypot((x[1] - 0.66).round())),
];

/// Unknown sizes of parameters that start at zero, without a box or in a wide one, are found during the
/// search.
#[test]
fn least_squares_resumes_from_any_evaluation() {
    let folder = Folder::new("least-squares");
    // Only the end is written.
    let file = || Checkpoint::new(folder.file()).interval(Duration::from_secs(3600));
    for (name, model) in MODELS {
        for x0 in [[1.5, 0.0], [0.0, 0.0], [1.0, 1.0]] {
            for bounds in [None, Some([-1e3, 1e3]), Some([0.0, 1e3])] {
                for method in [LeastSquares::default(), LeastSquares::default().rounds()] {
                    let run = |most: usize| -> Result<Report, Error> {
                        let cut = Cut { model, truth: [1.7, 0.66], calls: AtomicUsize::new(0), most };
                        let run = minimize(residuals(cut)).start(&x0);
                        let run = match bounds {
                            Some([lower, upper]) => run.bounds(&[lower; 2], &[upper; 2]).unwrap(),
                            None => run,
                        };
                        let run = run.method(method.clone()).max_evaluations(60);
                        run.checkpoint(file()).run()
                    };
                    let _ = std::fs::remove_file(folder.file());
                    let whole = run(usize::MAX).unwrap();
                    for stop in 1..whole.n_evaluations {
                        let what =
                            format!("{name} {x0:?} {bounds:?} {:?}, stopped after {stop}", method.batch);
                        let _ = std::fs::remove_file(folder.file());
                        let stopped = run(stop).unwrap();
                        assert!(matches!(stopped.termination, Termination::Aborted(_)), "{what}");
                        let resumed = run(usize::MAX).unwrap_or_else(|e| panic!("{what}: {e}"));
                        same(&resumed, &whole, &what);
                    }
                }
            }
        }
    }
}

/// Runs that end at their starting points, during the search for sizes, and without untested integers.
#[test]
fn finished_run_returns_its_stored_result() {
    let folder = Folder::new("over");
    let shifted = |x: &[f64]| 1.0 + rosenbrock(&[x[0] + 2.0, x[1] - 1.0]);
    for method in methods() {
        let needs_bounds = method.starts_inside();
        for (most, target) in
            [(20, None), (100, Some(400.0)), (100, Some(12.0)), (3000, Some(1.5)), (3000, None)]
        {
            for (kind, bounds) in [
                (ParameterKind::Continuous, None),
                (ParameterKind::Continuous, Some(4.0)),
                (ParameterKind::Integer, Some(4.0)),
            ] {
                if needs_bounds && bounds.is_none() {
                    continue;
                }
                let what = format!("{} {most} {target:?} {kind:?} {bounds:?}", method.name());
                let _ = std::fs::remove_file(folder.file());
                let run = |cost: &(dyn Fn(&[f64]) -> f64 + Sync)| -> Result<Report, Error> {
                    let run = minimize(|x: &[f64]| cost(x)).start(&[0.0, 0.0]).kinds(&[kind; 2]);
                    let run = match bounds {
                        Some(bound) => run.bounds(&[-bound; 2], &[bound; 2]).unwrap(),
                        None => run,
                    };
                    let run = match target {
                        Some(target) => run.target(target),
                        None => run,
                    };
                    let run = run.method(method.clone()).seed(3).max_evaluations(most);
                    run.checkpoint(Checkpoint::new(folder.file())).run()
                };
                let first = match run(&shifted) {
                    Err(Error::NotContinuous { .. } | Error::NeedsBox { .. }) => continue,
                    first => first.unwrap_or_else(|e| panic!("{what}: {e}")),
                };
                for _ in 0..2 {
                    let again = run(&|x: &[f64]| panic!("{what}: evaluated again at {x:?}"));
                    same(&again.unwrap_or_else(|e| panic!("{what}: {e}")), &first, &what);
                }
            }
        }
    }
}
