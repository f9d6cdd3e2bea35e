//! Ask/tell: the trace equals the trace of the driven run, whatever the order and grouping of the answers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{PLANS, Problem, plan, probe, problems, rosenbrock};
use dfo::{
    Answers, Batch, Bounds, Error, LeastSquares, Lookahead, Method, MethodDetails, MethodOptions,
    NelderMeadState, Outcome, Setup, Space, Status, Termination, minimize,
};

fn search(problem: &Problem, p: Lookahead) -> NelderMeadState {
    let bounds = match &problem.bounds {
        Some((lower, upper)) => Bounds::new(lower, upper).unwrap(),
        None => Bounds::unbounded(problem.x0.len()),
    };
    plan(p).begin(&Setup::new(Space::new(&problem.x0, bounds, &[], &[]).unwrap())).unwrap()
}

#[test]
fn ask_tell_matches_driven_run() {
    for problem in problems() {
        for p in PLANS {
            let mut by_hand: Vec<(Vec<f64>, u64, u64, f64, bool)> = Vec::new();
            let mut s = search(&problem, p);
            let mut batch = Batch::new();
            loop {
                s.ask(&mut batch);
                let mut again = Batch::new();
                s.ask(&mut again);
                assert_eq!(batch, again);
                if batch.is_empty() && s.status() != Status::Running {
                    break;
                }
                let outcomes: Vec<_> = batch.points().map(|x| Outcome::Value((problem.f)(x))).collect();
                s.tell(&Answers::from(&outcomes[..])).unwrap();
                for k in 0..batch.len() {
                    by_hand.push((
                        batch.point(k).to_vec(),
                        batch.id(k),
                        batch.index(),
                        batch.cutoff(k),
                        true,
                    ));
                }
            }
            let report = problem.minimize().method(plan(p)).run().unwrap();
            let driven: Vec<_> =
                report.trace.iter().map(|e| (e.x.to_vec(), e.id, e.batch, e.cutoff, e.used)).collect();
            assert_eq!(by_hand, driven, "{} {p:?}", problem.name);
            assert_eq!(s.best(), Some((&report.x[..], report.fun)));
            // The method does not detect that the cost never changed.
            let ended = match report.termination {
                Termination::ConstantCost => Termination::Converged,
                other => other,
            };
            assert_eq!(s.status(), Status::Ended(ended));
            assert_eq!((s.details().n_iterations, s.details().tests), (report.n_iterations, report.tests));
        }
    }
}

#[test]
fn method_accepts_partial_answers() {
    // Answers are left out in a fixed pattern. The method requests needed points again, and the path is
    // unchanged.
    for problem in problems() {
        for p in PLANS {
            let mut s = search(&problem, p);
            let mut batch = Batch::new();
            let mut counter = 0u32;
            let mut best_used = f64::INFINITY;
            loop {
                s.ask(&mut batch);
                if batch.is_empty() && s.status() != Status::Running {
                    break;
                }
                let outcomes: Vec<_> = batch
                    .points()
                    .map(|x| {
                        counter = counter.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        match counter >> 29 {
                            0 => Outcome::Skipped,
                            1 => Outcome::cancelled(),
                            2 => Outcome::Abort(String::new()),
                            _ => Outcome::Value((problem.f)(x)),
                        }
                    })
                    .collect();
                let reported = batch.len() - (counter >> 10) as usize % batch.len().max(1);
                s.tell(&Answers::from(&outcomes[..reported])).unwrap();
                for value in outcomes[..reported].iter().filter_map(Outcome::value) {
                    best_used = best_used.min(value);
                }
                assert_eq!(s.best().map_or(f64::INFINITY, |b| b.1), best_used, "{}", problem.name);
            }
            let report = problem.minimize().run().unwrap();
            assert_eq!(
                (s.best(), s.details().n_iterations),
                (Some((&report.x[..], report.fun)), report.n_iterations)
            );
            assert_eq!(s.details().simplex.unwrap().to_owned(), report.final_simplex.unwrap());
        }
    }
}

#[test]
fn cloned_method_continues_like_original() {
    let problem = &problems()[6];
    let mut s = search(problem, Lookahead::Points(2));
    let mut batch = Batch::new();
    for _ in 0..25 {
        s.ask(&mut batch);
        let outcomes: Vec<_> = batch.points().map(|x| Outcome::Value(probe(x))).collect();
        s.tell(&Answers::from(&outcomes[..])).unwrap();
    }
    let mut copy = s.clone();
    let mut copied = Batch::new();
    loop {
        s.ask(&mut batch);
        copy.ask(&mut copied);
        assert_eq!(batch, copied);
        if batch.is_empty() {
            break;
        }
        let outcomes: Vec<_> = batch.points().map(|x| Outcome::Value(probe(x))).collect();
        s.tell(&Answers::from(&outcomes[..])).unwrap();
        copy.tell(&Answers::from(&outcomes[..])).unwrap();
    }
}

#[test]
fn misuse_returns_typed_error() {
    let mut s = search(&problems()[0], Lookahead::None);
    assert_eq!(s.tell(&Answers::from(&[][..])), Err(Error::TellWithoutAsk));
    let mut batch = Batch::new();
    s.ask(&mut batch);
    assert_eq!(
        s.tell(&Answers::from(&vec![Outcome::Value(1.0); 4][..])),
        Err(Error::TooManyOutcomes { requested: 3, received: 4 })
    );
    s.tell(&Answers::from(&[Outcome::Value(f64::NAN), Outcome::failed("x"), Outcome::Above(0.0)][..]))
        .unwrap();
    assert_eq!((s.status(), s.best()), (Status::NoStart, None));
    s.ask(&mut batch);
    assert!(batch.is_empty());
    assert_eq!(s.tell(&Answers::from(&[][..])), Err(Error::TellWithoutAsk));
}

#[test]
fn ask_and_tell_allocate_nothing_after_first_rounds() {
    for (n, p) in [
        (2, Lookahead::None),
        (10, Lookahead::Points(2)),
        (10, Lookahead::Points(4)),
        (6, Lookahead::Points(20)),
    ] {
        let problem = Problem { name: "", f: rosenbrock, x0: vec![-1.2; n], bounds: None };
        let mut s = search(&problem, p);
        let mut batch = Batch::new();
        let mut answers = Answers::default();
        let mut round = |s: &mut NelderMeadState| {
            s.ask(&mut batch);
            answers.clear();
            // Occasionally, all points except the vertices fail, which forces shrinks.
            let bad = batch.index() % 37 == 5;
            answers
                .extend(batch.points().map(|x| Outcome::Value(if bad { f64::NAN } else { rosenbrock(x) })));
            s.tell(&answers).unwrap();
        };
        for _ in 0..5 {
            round(&mut s);
        }
        let counted = allocation_counter::measure(|| {
            for _ in 0..60 {
                round(&mut s);
            }
        });
        assert_eq!(counted.count_total, 0, "{n} {p:?}: {counted:?}");
        assert!(s.details().n_iterations > 20 && s.status() == Status::Running);
    }
}

#[test]
fn custom_method_can_be_driven() {
    /// Tries the integers from 0 and ends at 20.
    struct Count(u64, Option<f64>, [f64; 1]);
    struct CountOptions;
    impl MethodOptions for CountOptions {
        type Method = Count;
        fn begin(&self, _: &Setup) -> Result<Count, Error> {
            Ok(Count(0, None, [0.0]))
        }
    }
    impl Method for Count {
        fn name(&self) -> &'static str {
            "count"
        }
        fn ask(&mut self, batch: &mut Batch) {
            batch.start(1, self.0, self.0);
            if self.0 < 20 {
                batch.push(&[self.0 as f64], f64::INFINITY);
            }
        }
        fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
            if let Some(v) = answers.outcomes()[0].value().filter(|v| self.1.is_none_or(|b| *v < b)) {
                (self.1, self.2) = (Some(v), [self.0 as f64]);
            }
            self.0 += 1;
            Ok(())
        }
        fn status(&self) -> Status {
            if self.0 < 20 { Status::Running } else { Status::Ended(dfo::Termination::Converged) }
        }
        fn details(&self) -> MethodDetails<'_> {
            MethodDetails { n_iterations: self.0 as usize, plan: "serial", ..MethodDetails::default() }
        }
        fn best(&self) -> Option<(&[f64], f64)> {
            self.1.map(|v| (&self.2[..], v))
        }
    }
    let report = minimize(|x: &[f64]| (x[0] - 7.0).abs()).start(&[0.0]).method(CountOptions).run().unwrap();
    assert_eq!((report.x, report.fun, report.n_evaluations, &*report.method), (vec![7.0], 0.0, 20, "count"));
}

/// A round of many residuals is processed without copying them, because a copy could not be interrupted.
#[test]
fn tell_last_does_not_copy_residuals() {
    const N: usize = 20;
    const M: usize = 100_000;
    let setup = Setup::new(Space::new(&[1.0; N], Bounds::unbounded(N), &[], &[]).unwrap());
    let mut search = LeastSquares::default().begin(&setup).unwrap();
    let (mut batch, mut answers) = (Batch::new(), Answers::default());
    search.ask(&mut batch);
    assert_eq!(batch.len(), N + 1);
    for x in batch.points() {
        let residuals: Vec<f64> = (0..M).map(|i| x[i % N] - (i as f64).cos()).collect();
        answers.push(Outcome::Value(residuals.iter().map(|r| r * r).sum()), &residuals);
    }
    let counted = allocation_counter::measure(|| search.tell_last(&mut answers).unwrap());
    // The method checks that memory for a second copy is available, without using it.
    let probed = 2 * (N + 1) * M * size_of::<f64>();
    assert!(counted.bytes_total < (probed + M * size_of::<f64>()) as u64, "{counted:?}");
}
