//! Contracts on random problems of all magnitudes, with failures, bounds and options. Points are finite and
//! in the box, budgets are exact, and the best point is never lost. Workers and cutoffs do not change the
//! result, and a resumed run equals the uninterrupted run.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::timeless;
use dfo::{
    Answer, AnyMethod, Barrier, BoundsHandling, Checkpoint, CmaBounds, CmaEs, Coefficients,
    DifferentialEvolution, Error, Genetic, LeastSquares, Lookahead, MethodOptions, Multistart, NelderMead,
    Objective, Outcome, PatternSearch, QuadraticModel, Query, Report, Restarts, Sampling, Selection,
    StopRule, Termination, ToleranceMeasure, Transform, minimize,
};
use std::path::Path;
use std::time::Duration;

/// A generator of small numbers (Knuth's MMIX constants).
struct Dice(u64);

impl Dice {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }
    fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len() as u64) as usize]
    }
    fn unit(&mut self) -> f64 {
        self.below(1 << 30) as f64 / (1u64 << 30) as f64
    }
}

#[derive(Debug, Clone)]
struct Problem {
    x0: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    transforms: Vec<Transform>,
    sizes: Vec<f64>,
    centre: Vec<f64>,
    unit: Vec<f64>,
    height: f64,
    offset: f64,
    failing: u64,
    flat: bool,
    measure: ToleranceMeasure,
    stop: StopRule,
    tolerance: f64,
    budget: usize,
}

const MAGNITUDES: [f64; 9] = [1.0, 1.0, 1e-6, 1e6, 1e-160, 1e20, 1e150, 5e-324, 1e307];

impl Problem {
    fn new(dice: &mut Dice, boxed: bool) -> Self {
        let n = 1 + dice.below(4) as usize;
        let mut p = Self {
            x0: vec![],
            lower: vec![],
            upper: vec![],
            transforms: vec![],
            sizes: vec![],
            centre: vec![],
            unit: vec![],
            height: dice.pick(&MAGNITUDES),
            offset: dice.pick(&[0.0, 0.0, 1.0, -1e9, 1e300, -1e308]),
            failing: dice.pick(&[0, 0, 2, 5, 20]),
            flat: dice.below(8) == 0,
            measure: dice.pick(&[ToleranceMeasure::Relative, ToleranceMeasure::Absolute]),
            stop: dice.pick(&[StopRule::All, StopRule::Any]),
            tolerance: dice.pick(&[0.0, 1e-6, 1e-3, 1e3]),
            budget: 1 + dice.below(150) as usize,
        };
        let sized = dice.below(3) == 0;
        for _ in 0..n {
            let unit = dice.pick(&MAGNITUDES);
            let log = dice.below(4) == 0;
            let sign = if log { 1.0 } else { dice.pick(&[1.0, -1.0]) };
            let x = sign
                * unit
                * dice.pick(&[1.0, 0.5, 1.7])
                * if log { 1.0 } else { dice.pick(&[1.0, 0.0, 1.0]) };
            let width = unit * dice.pick(&[1.0, 1e-3, 1e-12, 1e-16]);
            let (mut lower, mut upper) = (x - width * dice.unit(), x + width * dice.unit());
            match dice.below(5) {
                0 => lower = x,
                1 => upper = x,
                _ => {}
            }
            if log {
                lower = lower.max(0.5 * x).max(f64::from_bits(1));
            }
            if !boxed {
                match dice.below(4) {
                    0 => lower = if log { 0.0 } else { f64::NEG_INFINITY },
                    1 => upper = f64::INFINITY,
                    2 => (lower, upper) = (if log { 0.0 } else { f64::NEG_INFINITY }, f64::INFINITY),
                    _ => {}
                }
            }
            p.centre.push(x + unit * (dice.unit() - 0.5));
            p.x0.push(x);
            p.lower.push(lower);
            p.upper.push(upper);
            p.unit.push(unit);
            p.transforms.push(if log { Transform::Log } else { Transform::Linear });
            if sized {
                p.sizes.push(dice.pick(&MAGNITUDES));
            }
        }
        p
    }

    fn outcome(&self, x: &[f64], e: &Query<'_>, cutoffs: bool) -> Outcome {
        let inside = |k: usize| x[k].is_finite() && self.lower[k] <= x[k] && x[k] <= self.upper[k];
        if !(0..x.len()).all(inside) {
            // A panic here would count as a failure.
            return Outcome::Abort(format!("asked for {x:?}"));
        }
        let bits =
            x.iter().fold(0u64, |h, v| (h ^ v.to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (h >> 29));
        if self.failing > 0 && x != self.x0 && (bits >> 20).is_multiple_of(self.failing) {
            return match bits % 3 {
                0 => Outcome::Value(f64::NAN),
                1 => Outcome::Value(f64::INFINITY),
                _ => Outcome::failed("no"),
            };
        }
        let square = |k: usize| ((x[k] - self.centre[k]) / self.unit[k]).powi(2);
        let sum: f64 = if self.flat { 1.0 } else { (0..x.len()).map(square).sum() };
        let cost = self.offset + self.height * sum;
        if cutoffs && cost > e.cutoff { Outcome::Above(e.cutoff) } else { Outcome::Value(cost) }
    }

    fn run(
        &self,
        method: &AnyMethod,
        (workers, cutoffs, budget): (usize, bool, usize),
        file: Option<&Path>,
    ) -> Result<Report, Error> {
        let run = minimize(Costs { problem: self, cutoffs, as_squares: method.needs_residuals() })
            .start(&self.x0)
            .bounds(&self.lower, &self.upper)?
            .transforms(&self.transforms)
            .scales(&self.sizes)
            .measure(self.measure)
            .stop(self.stop)
            .x_tol(self.tolerance)
            .f_tol(self.tolerance)
            .workers(workers)
            .seed(7)
            .max_evaluations(budget)
            .method(method.clone());
        match file {
            Some(file) => run.checkpoint(Checkpoint::new(file).interval(Duration::ZERO)).run(),
            None => run.run(),
        }
    }
}

/// A problem as an objective, with residuals if the cost is a sum of squares.
struct Costs<'a> {
    problem: &'a Problem,
    cutoffs: bool,
    as_squares: bool,
}

impl Objective for Costs<'_> {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        answer.outcome = self.problem.outcome(x, query, self.cutoffs);
        if self.as_squares && matches!(answer.outcome, Outcome::Value(v) if v.is_finite()) {
            let Problem { centre, unit, height, offset, flat, .. } = self.problem;
            let residual = |k: usize| height.sqrt() * ((x[k] - centre[k]) / unit[k]);
            answer.residuals.extend((0..x.len()).filter(|_| !flat).map(residual));
            answer.residuals.push(offset.max(0.0).sqrt());
            answer.outcome = Outcome::Value(answer.residuals.iter().map(|r| r * r).sum());
        }
    }
    fn has_residuals(&self) -> bool {
        self.as_squares
    }
}

fn method(dice: &mut Dice) -> AnyMethod {
    let plan =
        dice.pick(&[Lookahead::None, Lookahead::Points(2), Lookahead::Points(4), Lookahead::Points(20)]);
    match dice.below(14) {
        0..=3 => {
            let handling = dice.pick(&[BoundsHandling::Mirror, BoundsHandling::Clamp, BoundsHandling::Sine]);
            let coefficients = dice.pick(&[Coefficients::Standard, Coefficients::Adaptive]);
            NelderMead::default().batch(plan).bounds_handling(handling).coefficients(coefficients).into()
        }
        4 => {
            let barrier = Barrier::default().batch(plan);
            if dice.below(2) == 0 {
                barrier.mu(dice.pick(&[1e200, 1.0, 1e-300])).into()
            } else {
                barrier.into()
            }
        }
        5 => DifferentialEvolution::default().population(8).sampling(Sampling::Sobol).budget(100).into(),
        6 => DifferentialEvolution::classic().population(6).into(),
        7 => {
            let handling = dice.pick(&[CmaBounds::Smooth, CmaBounds::Mirror]);
            let restarts = dice.pick(&[Restarts::None, Restarts::Ipop, Restarts::Bipop]);
            let sigma = dice.pick(&[0.3, 1e-300, 1e300]);
            let cma_es = CmaEs::default().lag(dice.pick(&[0, 5, 20]));
            cma_es.bounds_handling(handling).restarts(restarts).sigma(sigma).into()
        }
        8 => QuadraticModel::default().radius(dice.pick(&[0.1, 1e-3, 1.0])).into(),
        9 => Multistart::default().exploration(0.0).sample(6).side_by_side(dice.pick(&[1, 3])).into(),
        10 | 11 => {
            let least_squares = LeastSquares::default();
            match dice.below(3) {
                0 => least_squares.serial().into(),
                batch => least_squares.batch(2 + 3 * batch as usize).into(),
            }
        }
        12 => {
            let plan = dice.pick(&[Lookahead::None, Lookahead::Points(8)]);
            PatternSearch::default().frame(dice.pick(&[0.3, 1e-300, 1e300])).batch(plan).into()
        }
        _ => {
            let selection = dice.pick(&[Selection::FitnessProportional, Selection::Tournament(3)]);
            Genetic::default().population(10).selection(selection).into()
        }
    }
}

fn bits(x: &[f64]) -> Vec<u64> {
    x.iter().map(|v| v.to_bits()).collect()
}

fn check(problem: &Problem, method: &AnyMethod, report: &Report) {
    let case = || format!("{method:?} on {problem:?}: {report}");
    assert!(
        report.n_evaluations <= problem.budget && report.trace.len() == report.n_evaluations,
        "{}",
        case()
    );
    assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)), "{}", case());
    // No cost on the path is smaller.
    let smallest = report.trace.iter().filter(|e| e.used).filter_map(|e| e.outcome.value());
    assert!(smallest.fold(f64::INFINITY, f64::min) >= report.fun, "{}", case());
    let failed = report.trace.iter().filter(|e| matches!(e.outcome, Outcome::Failed(_))).count();
    assert_eq!(report.n_failed, failed, "{}", case());
}

fn examine(case: u64, folder: &Path) {
    let mut dice = Dice(case.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ 0x55);
    dice.below(2);
    let method = method(&mut dice);
    let boxed = matches!(
        method,
        AnyMethod::DifferentialEvolution(_) | AnyMethod::Genetic(_) | AnyMethod::Multistart(_)
    );
    let problem = Problem::new(&mut dice, boxed);
    let plain = problem.run(&method, (1, false, problem.budget), None);
    match &plain {
        Err(Error::EndedWithoutPoint { termination: Termination::Aborted(what), .. }) => {
            panic!("case {case}: {what}: {method:?} on {problem:?}")
        }
        Ok(Report { termination: Termination::Aborted(what), .. }) => {
            panic!("case {case}: {what}: {method:?} on {problem:?}")
        }
        Ok(report) => check(&problem, &method, report),
        Err(Error::AllStartsFailed(found) | Error::EndedWithoutPoint { found, .. }) => {
            let used = found.trace.iter().filter(|e| e.used && e.outcome.value().is_some()).count();
            assert!(
                found.n_evaluations <= problem.budget && used == 0,
                "case {case}: {found:?} {method:?} on {problem:?}"
            );
        }
        // Unsupported problems are rejected before any evaluation.
        Err(_) => return,
    }
    let reported = |r: &Result<Report, Error>| match r {
        Ok(r) => Ok((timeless(&r.trace), bits(&r.x), r.fun.to_bits(), r.termination.clone(), r.n_iterations)),
        Err(e) => Err(e.to_string()),
    };
    let same = |a: &Result<Report, Error>, b: &Result<Report, Error>, what: &str| {
        assert_eq!(reported(a), reported(b), "case {case}, {what}: {method:?} on {problem:?}");
    };
    same(&plain, &problem.run(&method, (3, false, problem.budget), None), "workers");
    // With cutoffs, the decisions are identical.
    if let (Ok(a), Ok(b)) = (&plain, &problem.run(&method, (1, true, problem.budget), None)) {
        assert_eq!(
            (bits(&a.x), a.fun.to_bits(), a.n_iterations, &a.termination),
            (bits(&b.x), b.fun.to_bits(), b.n_iterations, &b.termination),
            "case {case}, cutoffs: {method:?} on {problem:?}"
        );
    }
    // Interrupted by the budget and then continued. If the budget is part of the plan, another budget is
    // rejected.
    if method.plans_with_budget() {
        return;
    }
    let path = folder.join(format!("{case}"));
    let first = 1 + dice.below(problem.budget as u64) as usize;
    drop(problem.run(&method, (2, false, first), Some(&path)));
    same(&plain, &problem.run(&method, (1, false, problem.budget), Some(&path)), "resumed");
    std::fs::remove_file(&path).unwrap_or_default();
}

#[test]
fn contracts_hold_on_random_problems() {
    let folder = tempfile::tempdir().unwrap();
    let cases = std::env::var("DFO_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(400);
    let bad =
        (0..cases).filter(|case| std::panic::catch_unwind(|| examine(*case, folder.path())).is_err()).count();
    assert_eq!(bad, 0);
}
