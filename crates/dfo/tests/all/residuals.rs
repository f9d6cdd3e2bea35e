//! A method that requests residuals receives the same residuals from every evaluator and after a resume.
#![allow(clippy::unwrap_used, clippy::panic)]

use dfo::{
    Answers, AnswersSoFar, Batch, BatchView, Checkpoint, Error, EvaluatedPoint, EvaluationKind, LeastSquares,
    Lookahead, Method, MethodDetails, MethodOptions, Minimize, Objective, Operation, Outcome, Setup, Status,
    Termination, by_hand, minimize, minimize_batches, residuals,
};
use serde::{Deserialize, Serialize};

/// Gauss-Newton on a stencil of forward differences. At the next point, only a cost is requested.
#[derive(Debug, Clone, Default)]
struct Stencils;

#[derive(Debug, Clone, Serialize, Deserialize)]
struct StencilsState {
    #[serde(with = "bits")]
    x: Vec<f64>,
    cost: Option<f64>,
    /// Bits of all values passed to `tell`.
    seen: Vec<u64>,
    round: u64,
    n_points: u64,
}

/// Serialises numbers by their bits, which JSON would round.
mod bits {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(crate) fn serialize<S: Serializer>(x: &[f64], to: S) -> Result<S::Ok, S::Error> {
        x.iter().map(|x| x.to_bits()).collect::<Vec<_>>().serialize(to)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
        Ok(Vec::<u64>::deserialize(from)?.into_iter().map(f64::from_bits).collect())
    }
}

const STEP: f64 = 1e-6;
const ROUNDS: u64 = 12;

impl MethodOptions for Stencils {
    type Method = StencilsState;
    fn begin(&self, setup: &Setup) -> Result<StencilsState, Error> {
        let x = setup.space.x0().to_vec();
        Ok(StencilsState { x, cost: None, seen: Vec::new(), round: 0, n_points: 0 })
    }
    fn restore(&self, _: &Setup, state: &[u8]) -> Result<StencilsState, Error> {
        serde_json::from_slice(state).map_err(|e| Error::State { message: e.to_string() })
    }
}

impl Method for StencilsState {
    fn name(&self) -> &'static str {
        "stencils"
    }
    fn ask(&mut self, batch: &mut Batch) {
        let n = self.x.len();
        batch.start(n, self.round, self.n_points);
        if self.status() != Status::Running {
            return;
        }
        if self.round % 3 == 2 {
            // A cost between two stencils.
            return batch.push(
                &self.x.iter().map(|x| x + 0.5).collect::<Vec<_>>(),
                self.cost.unwrap_or(f64::INFINITY),
            );
        }
        batch.set_kind(EvaluationKind::Residuals);
        for k in 0..=n {
            let mut x = self.x.clone();
            if k > 0 {
                x[k - 1] += STEP;
            }
            batch.push(&x, f64::INFINITY);
        }
    }
    fn speculate(&mut self, wanted: usize, _: &dyn AnswersSoFar, batch: &mut Batch) {
        // Some points that are never needed.
        for k in 0..wanted.min(2) {
            batch.push(&self.x.iter().map(|x| x - 0.25 * (k + 1) as f64).collect::<Vec<_>>(), f64::INFINITY);
        }
    }
    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        if answers.outcomes().iter().any(|o| !o.is_conclusive()) {
            return Ok(());
        }
        let n = self.x.len();
        self.n_points += answers.len() as u64;
        for k in 0..answers.len() {
            self.seen.push(answers.outcomes()[k].value().map_or(1, f64::to_bits));
            self.seen.extend(answers.residuals(k).unwrap_or(&[]).iter().map(|r| r.to_bits()));
        }
        self.round += 1;
        if answers.len() == 1 {
            assert_eq!(answers.residuals(0), None);
            return Ok(());
        }
        let Some(base) = answers.residuals(0) else { return Ok(()) };
        self.cost = answers.outcomes()[0].value();
        // One coordinate at a time is sufficient to make progress.
        for j in 0..n {
            let Some(column) = answers.residuals(j + 1) else { continue };
            let (mut jj, mut jr) = (0.0, 0.0);
            for (r, c) in base.iter().zip(column) {
                let d = (c - r) / STEP;
                jj += d * d;
                jr += d * r;
            }
            self.x[j] -= 0.5 * jr / jj;
        }
        Ok(())
    }
    fn status(&self) -> Status {
        if self.round < ROUNDS { Status::Running } else { Status::Ended(Termination::Converged) }
    }
    fn details(&self) -> MethodDetails<'_> {
        MethodDetails {
            n_iterations: self.round as usize,
            operation: Some(Operation::Generation),
            plan: "serial",
            lookahead: Lookahead::Workers,
            ..MethodDetails::default()
        }
    }
    fn best(&self) -> Option<(&[f64], f64)> {
        None
    }
    fn save(&self) -> Option<Vec<u8>> {
        serde_json::to_vec(self).ok()
    }
}

fn decay(x: &[f64], out: &mut Vec<f64>) {
    let at = |t: f64| (2.0 * (-0.7 * t).exp() + 0.3) - (x[0] * (-x[1] * t).exp() + x[2]);
    out.extend((0..9).map(|k| at(0.4 * f64::from(k))));
}

fn described<D>(run: Minimize<'_, dfo::NelderMead, D>) -> Minimize<'_, Stencils, D> {
    run.start(&[1.0, 1.0, 0.0]).method(Stencils)
}

/// Returns the values seen by the last state of the run, from its checkpoint.
fn seen(path: &std::path::Path) -> Vec<u64> {
    let bytes = std::fs::read(path).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    let from = text.rfind("\"seen\":[").unwrap() + 8;
    text[from..].split(']').next().unwrap().split(',').map(|n| n.parse().unwrap()).collect()
}

#[test]
fn residuals_are_identical_for_every_evaluator_and_after_resume() {
    let folder = std::env::temp_dir().join(format!("dfo-residuals-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = |name: &str| folder.join(name);
    let objective = residuals(decay);
    let with = |name: &str, workers: usize| {
        described(minimize(residuals(decay)))
            .workers(workers)
            .checkpoint(Checkpoint::new(file(name)))
            .run()
            .unwrap()
    };
    let serial = with("serial", 1);
    let bits = seen(&file("serial"));
    // Rounds of residuals: four points with nine residuals and a cost each. Rounds of costs: one number.
    assert_eq!(bits.len(), 8 * 4 * 10 + 4);
    assert!(serial.fun < 0.2 && serial.is_success(), "{serial}");
    for workers in [2, 5] {
        let name = format!("pool {workers}");
        let pooled = with(&name, workers);
        assert_eq!(seen(&file(&name)), bits);
        assert_eq!(
            (pooled.x, pooled.fun, pooled.n_evaluations),
            (serial.x.clone(), serial.fun, serial.n_evaluations)
        );
    }
    let batches = |view: &BatchView<'_>| {
        let answer = |k| {
            let answer = objective.answer(view.point(k), &view.query(k));
            view.set_residuals(k, &answer.residuals);
            answer.outcome
        };
        (0..view.len()).map(answer).collect()
    };
    let run = described(minimize_batches(batches)).workers(3).checkpoint(Checkpoint::new(file("batches")));
    assert_eq!((run.run().unwrap().x, seen(&file("batches"))), (serial.x.clone(), bits.clone()));
    let mut optimizer = described(by_hand()).checkpoint(Checkpoint::new(file("hand"))).optimizer().unwrap();
    while optimizer.termination().is_none() {
        for point in optimizer.ask(3).into_iter().rev() {
            optimizer.tell(point.id, objective.answer(&point.x, &point.query())).unwrap();
        }
    }
    assert_eq!((optimizer.report().unwrap().x, seen(&file("hand"))), (serial.x.clone(), bits.clone()));
    // Also interrupted within batches: completed evaluations are not repeated.
    for limit in 1..serial.n_evaluations {
        let run = described(minimize(residuals(decay))).checkpoint(Checkpoint::new(file("resumed")));
        let report = run.max_evaluations(limit).run().unwrap();
        assert_eq!(report.n_evaluations, limit);
    }
    let resumed = with("resumed", 2);
    assert_eq!((resumed.x, resumed.n_evaluations), (serial.x, serial.n_evaluations));
    assert_eq!(seen(&file("resumed")), bits);
    // Windows does not remove open files.
    drop(optimizer);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn residuals_in_the_trace_are_not_recomputed() {
    let run = || described(minimize(residuals(decay))).problem("decay");
    let first = run().trace_residuals().run().unwrap();
    let kept: Vec<usize> = first.trace.iter().map(|e| e.residuals.len()).collect();
    assert_eq!((kept.iter().filter(|m| **m == 9).count(), kept.iter().filter(|m| **m == 0).count()), (32, 4));
    let point_of = |e: dfo::TraceEntry<'_>| {
        let (cost, problem) = (e.outcome.value().unwrap(), Some("decay".to_owned()));
        EvaluatedPoint {
            x: e.x.to_vec(),
            cost,
            residuals: e.residuals.to_vec(),
            constraints: Vec::new(),
            problem,
        }
    };
    let wanted = || first.trace.iter().filter(|e| !e.residuals.is_empty()).map(point_of);
    let again =
        |points: Vec<EvaluatedPoint>| run().evaluated_points(points).max_evaluations(20).run().unwrap();
    // If residuals are known at the start, they are used. If only the cost is known, residuals are requested.
    assert_eq!(again(wanted().collect()).n_cached, 1);
    let costs = again(wanted().map(|point| EvaluatedPoint { residuals: Vec::new(), ..point }).collect());
    assert_eq!((costs.n_cached, costs.n_failed), (0, 0));
    // Inconsistent residuals are reported.
    let mut wrong: Vec<EvaluatedPoint> = wanted().collect();
    wrong.iter_mut().for_each(|point| point.residuals.truncate(5));
    let error = run().evaluated_points(wrong).max_evaluations(20).run().unwrap_err();
    assert!(matches!(error, Error::ResidualCount { got: 9, expected: 5, .. }), "{error}");
}

#[test]
fn invalid_residual_vector_is_a_failure() {
    let run = |residuals: fn(&[f64]) -> Vec<f64>| {
        let objective = move |view: &BatchView<'_>| {
            let one = |k| {
                let vector = residuals(view.point(k));
                view.set_residuals(k, &vector);
                Outcome::Value(vector.iter().map(|r| r * r).filter(|r| r.is_finite()).sum())
            };
            (0..view.len()).map(one).collect()
        };
        let report = described(minimize_batches(objective)).max_evaluations(2).run().unwrap();
        (report.n_failed, report.failures.first().map_or_else(String::new, |(why, _)| why.clone()))
    };
    assert_eq!(run(|x| vec![x[0], 1.0]).0, 0);
    assert_eq!(
        run(|x| vec![1.0, if x[0] > 1.0 { f64::NAN } else { 0.0 }]),
        (1, "residual 1 is NaN".to_owned())
    );
    let costs = described(minimize(|x: &[f64]| x[0])).max_evaluations(1).run();
    let Err(Error::EndedWithoutPoint { found, .. }) = costs else { panic!("{costs:?}") };
    assert_eq!(found.failures[0].0, "the objective returned a cost without residuals");
}

#[test]
fn changed_number_of_residuals_is_an_error_for_any_workers() {
    let changing = |x: &[f64], out: &mut Vec<f64>| out.extend(vec![1.0; 1 + (x[0].abs() * 1e6) as usize % 3]);
    let run = |workers| {
        let run = minimize(residuals(changing)).start(&[1.0]).method(LeastSquares::default());
        run.workers(workers).run().unwrap_err()
    };
    let error = run(1);
    assert_eq!(error.to_string(), "the objective returned 3 residuals at x = [1.1], but 2 at earlier points");
    assert!((2..6).all(|workers| run(workers) == error));
    // This also ends a run with ask/tell.
    let mut optimizer = by_hand().start(&[1.0]).method(LeastSquares::default()).optimizer().unwrap();
    let reported = loop {
        let points = optimizer.ask(1);
        let answer = residuals(changing).answer(&points[0].x, &points[0].query());
        if let Err(error) = optimizer.tell(points[0].id, answer) {
            break error;
        }
    };
    assert_eq!(reported, error);
    assert!(matches!(optimizer.termination(), Some(Termination::Aborted(_))) && optimizer.ask(1).is_empty());
}
