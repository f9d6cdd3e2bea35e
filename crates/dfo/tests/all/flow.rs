//! Asynchronous evaluation with a simulated clock and arbitrary evaluation times.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../common/clocked.rs"]
#[allow(unreachable_pub)]
mod clocked;
use crate::common;

use clocked::{Clocked, Seen, hash, one_in, rosenbrock};
use common::timeless;
use dfo::{
    Answer, AnyMethod, BatchView, Checkpoint, CmaEs, CutoffUse, DifferentialEvolution, EvaluationKind,
    Evaluator, Lookahead, Minimize, Multistart, NelderMead, Outcome, PatternSearch, Polish, PollResult,
    Query, Report, Restarts, Resume, Termination, Wait, by_hand, minimize, minimize_batches, minimize_by,
};
use std::cell::Cell;
use std::rc::Rc;
use std::time::Duration;

/// Answer with a cost that fails at some points and stops early above the cutoff, and with residuals if
/// requested.
fn answer_at(x: &[f64], query: &Query<'_>) -> Answer {
    let cost = rosenbrock(x);
    if hash(x).is_multiple_of(13) {
        return Outcome::failed("no").into();
    }
    if query.kind == EvaluationKind::Residuals {
        let pairs = x.windows(2).flat_map(|w| [10.0 * (w[1] - w[0] * w[0]), 1.0 - w[0]]);
        return Answer { residuals: pairs.collect(), ..Outcome::Value(cost).into() };
    }
    if cost > query.cutoff { Outcome::Above(query.cutoff) } else { Outcome::Value(cost) }.into()
}

fn described<'a, D>(
    run: Minimize<'a, NelderMead, D>,
    method: &AnyMethod,
    (n, evaluations): (usize, usize),
) -> Minimize<'a, AnyMethod, D> {
    let run = run.start(&vec![-1.2; n]).bounds(&vec![-5.0; n], &vec![5.0; n]).unwrap();
    run.method(method.clone()).seed(1).max_evaluations(evaluations)
}

fn run(method: &AnyMethod, size: (usize, usize), width: usize, every: u64) -> (Report, Rc<Seen>) {
    let (clocked, seen) = Clocked::new(width, one_in(every));
    (described(minimize_by(clocked), method, size).run().unwrap(), seen)
}

fn named(name: &str) -> AnyMethod {
    name.parse().unwrap()
}

/// Evaluator that loses answers: every `every`-th answer, or all answers to one point.
struct Lossy<E> {
    inner: E,
    every: usize,
    n: usize,
    n_lost: Rc<Cell<usize>>,
}

impl<E: Evaluator> Evaluator for Lossy<E> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        self.inner.submit(x, query);
    }
    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
        let polled = self.inner.poll(wait, answer);
        if matches!(polled, PollResult::Answered(_)) && answer.outcome != Outcome::Skipped {
            self.n += 1;
            if self.n.is_multiple_of(self.every) {
                self.n_lost.set(self.n_lost.get() + 1);
                *answer = Outcome::lost("the machine is gone").into();
            }
        }
        polled
    }
    fn cancel(&mut self, id: u64) {
        self.inner.cancel(id);
    }
    fn width(&self) -> usize {
        self.inner.width()
    }
    fn cutoff_use(&self) -> CutoffUse {
        self.inner.cutoff_use()
    }
}

#[test]
fn lost_answers_change_only_their_count() {
    for name in ["nelder-mead", "pattern-search", "de", "cma-es", "multistart", "quadratic-model", "ga"] {
        let method = named(name);
        let whole = described(minimize(rosenbrock), &method, (3, 200)).run().unwrap();
        for (width, every) in [(1, 9), (3, 11), (16, 10)] {
            let n_lost = Rc::new(Cell::new(0));
            let inner = Clocked::new(width, one_in(5)).0;
            let lossy = Lossy { inner, every, n: 0, n_lost: Rc::clone(&n_lost) };
            let report = described(minimize_by(lossy), &method, (3, 200)).run().unwrap();
            assert_eq!(timeless(&report.trace), timeless(&whole.trace), "{name} {width}");
            assert_eq!((report.n_failed, report.n_lost), (whole.n_failed, n_lost.get()), "{name} {width}");
            assert!(report.n_lost > 10 && whole.n_lost == 0, "{name} {width}: {}", report.n_lost);
        }
    }
}

#[test]
fn point_that_is_always_lost_ends_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    let method = named("de");
    let n_lost = Rc::new(Cell::new(0));
    let lossy = Lossy { inner: Clocked::new(2, one_in(5)).0, every: 1, n: 0, n_lost: Rc::clone(&n_lost) };
    let ended = described(minimize_by(lossy), &method, (3, 200)).checkpoint(Checkpoint::new(&path)).run();
    let message = ended.unwrap_err().to_string();
    assert!(message.contains("lost the same point 3 times (the machine is gone)"), "{message}");
    let resumed =
        described(minimize(rosenbrock), &method, (3, 200)).checkpoint(Checkpoint::new(&path)).run().unwrap();
    let whole = described(minimize(rosenbrock), &method, (3, 200)).run().unwrap();
    assert_eq!(timeless(&resumed.trace), timeless(&whole.trace));
    assert_eq!((resumed.n_failed, resumed.x), (whole.n_failed, whole.x));
}

#[test]
fn path_is_independent_of_answer_order() {
    for name in ["nelder-mead", "pattern-search", "de", "cma-es", "multistart", "quadratic-model", "ga"] {
        let method = named(name);
        let serial = described(minimize(rosenbrock), &method, (4, 300)).run().unwrap();
        for width in [1, 2, 7, 64] {
            let (report, _) = run(&method, (4, 300), width, 10);
            assert_eq!(timeless(&report.trace), timeless(&serial.trace), "{name} {width}");
            assert_eq!((&report.x, report.fun, &report.message), (&serial.x, serial.fun, &serial.message));
            assert_eq!(
                (report.n_evaluations, report.n_iterations),
                (serial.n_evaluations, serial.n_iterations)
            );
        }
    }
}

fn same(report: &Report, serial: &Report, what: &str) {
    assert_eq!(timeless(&report.trace), timeless(&serial.trace), "{what}");
    assert_eq!((&report.x, report.fun, &report.message), (&serial.x, serial.fun, &serial.message), "{what}");
    let counts = |r: &Report| (r.n_evaluations, r.n_iterations, r.n_failed, r.n_cached);
    assert_eq!(counts(report), counts(serial), "{what}");
}

/// Methods that look ahead only at certain points.
fn flowing() -> Vec<(&'static str, AnyMethod)> {
    let searches = Multistart::default().exploration(0.0).sample(30);
    vec![
        ("de", named("de")),
        ("without lag", DifferentialEvolution::default().lag(0).into()),
        ("three generations ahead", DifferentialEvolution::default().lag(200).into()),
        ("de-classic", DifferentialEvolution::classic().lag(16).into()),
        ("cma-es, lag 64", CmaEs::default().lag(64).into()),
        ("cma-es, part of a generation", CmaEs::default().lag(3).into()),
        ("cma-es, restarts", CmaEs::default().restarts(Restarts::Bipop).lag(9).sigma(1e-9).into()),
        ("multistart", named("multistart")),
        ("searches", searches.clone().into()),
        ("residuals", searches.polish(Polish::LeastSquares).into()),
    ]
}

#[test]
fn path_with_failures_and_cutoffs_is_independent_of_answer_order() {
    for (name, method) in flowing() {
        for cutoff_use in [CutoffUse::No, CutoffUse::Yes] {
            let run = |width: usize| {
                let (mut clocked, seen) = Clocked::new(width, one_in(10));
                (clocked.answer, clocked.cutoff_use) = (answer_at, cutoff_use);
                if cutoff_use == CutoffUse::No {
                    clocked.answer =
                        |x, q| answer_at(x, &Query::new(q.id, q.batch, f64::INFINITY).kind(q.kind));
                }
                let run = described(minimize_by(clocked).with_residuals(true), &method, (4, 1500));
                (run.workers(width).run().unwrap(), seen)
            };
            let (serial, _) = run(1);
            for width in [2, 7, 64] {
                let (report, seen) = run(width);
                same(&report, &serial, &format!("{name} {cutoff_use:?} {width}"));
                println!(
                    "{name} {cutoff_use:?} {width}: {} of {} in vain",
                    seen.begun.get() - report.n_evaluations,
                    seen.begun.get()
                );
            }
        }
    }
}

#[test]
fn path_is_independent_of_driver() {
    for (name, method) in flowing() {
        let costs = |x: &[f64]| Outcome::Value(rosenbrock(x));
        if name == "residuals" {
            continue;
        }
        let serial = described(minimize(rosenbrock), &method, (4, 900)).run().unwrap();
        let batches = |view: &BatchView<'_>| {
            (0..view.len()).map(|k| view.set_seconds(k, 1.0)).count();
            (0..view.len()).map(|k| costs(view.point(k))).collect()
        };
        let report = described(minimize_batches(batches).workers(7), &method, (4, 900)).run().unwrap();
        same(&report, &serial, name);
        for workers in [1, 7, 64] {
            let mut optimizer = described(by_hand().workers(workers), &method, (4, 900)).optimizer().unwrap();
            let mut pending = Vec::new();
            while optimizer.termination().is_none() {
                pending.extend(optimizer.ask(workers - pending.len()));
                let next = pending.swap_remove(
                    hash(&[pending.len() as f64, optimizer.trace().len() as f64]) as usize % pending.len(),
                );
                optimizer.tell(next.id, costs(&next.x)).unwrap();
            }
            same(&optimizer.report().unwrap(), &serial, &format!("{name} by hand, {workers}"));
        }
    }
}

#[test]
#[cfg_attr(windows, ignore = "the scheduler of Wine wakes threads late")]
fn workers_stay_busy_with_slow_evaluations() {
    let cma_es: AnyMethod = CmaEs::default().lag(64).into();
    let methods: [(&str, AnyMethod, u64, f64, f64); 5] = [
        ("de", named("de"), 10, 0.8, 0.36),
        ("de-classic, lag 75", DifferentialEvolution::classic().lag(75).into(), 10, 0.8, 0.5),
        ("cma-es, lag 64", cma_es.clone(), 10, 0.8, 0.18),
        ("cma-es, lag 64", cma_es, 20, 0.8, 0.18),
        ("multistart", named("multistart"), 10, 0.6, 0.2),
    ];
    for (name, method, every, least, before) in methods {
        let (_, serial) = run(&method, (5, 5000), 1, every);
        let (report, seen) = run(&method, (5, 5000), 16, every);
        let (useful, all) =
            (serial.now.get() / (16.0 * seen.now.get()), seen.busy.get() / (16.0 * seen.now.get()));
        println!("{name}: {useful:.3} of 16 workers for the path, {all:.3} in all; {before} with barriers");
        assert!(useful >= least, "{name}: {useful}");
        assert!(name == "multistart" || seen.begun.get() < report.n_evaluations + 200, "{name}");
    }
    // One generation at a time.
    let by_generations: AnyMethod = DifferentialEvolution::default().lag(0).into();
    let (_, serial) = run(&by_generations, (5, 5000), 1, 10);
    let (_, seen) = run(&by_generations, (5, 5000), 16, 10);
    assert!(serial.now.get() < 0.4 * 16.0 * seen.now.get());
}

#[test]
fn slow_evaluations_delay_only_dependent_points() {
    for (every, least) in [(10, 1.85), (20, 1.95)] {
        let method = named("nelder-mead");
        let (_, serial) = run(&method, (5, 600), 1, every);
        let (report, seen) = run(&method, (5, 600), 16, every);
        let gain = serial.now.get() / seen.now.get();
        println!("one in {every}: {gain:.2} times as fast, {} ahead in vain", report.n_speculative);
        assert!(gain >= least, "{gain}");
    }
}

#[test]
fn unneeded_evaluations_are_limited() {
    let ahead: AnyMethod = NelderMead::default().batch(Lookahead::Workers).into();
    let poll = |n: usize| -> AnyMethod { PatternSearch::default().batch(Lookahead::Points(2 * n)).into() };
    for (width, most) in [(16, 2), (64, 2), (300, 4), (1000, 4)] {
        for (method, n) in [(&ahead, 5), (&poll(5), 5), (&poll(200), 200)] {
            let (report, seen) = run(method, (n, 400), width, 10);
            let in_vain = seen.begun.get() - report.n_evaluations;
            println!("{width} workers, n = {n}, {}: {in_vain} in vain", report.method);
            assert!(in_vain <= most * report.n_evaluations, "{} {width} {n}: {in_vain}", report.method);
        }
    }
}

#[test]
fn answers_are_kept_from_the_first_evaluation() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["de", "cma-es", "nelder-mead", "quadratic-model", "multistart"] {
        let whole = described(minimize(rosenbrock), &named(name), (6, 120)).run().unwrap();
        for (killed_at, width) in [(1usize, 1), (5, 1), (37, 1), (90, 7)] {
            let path = folder.path().join(format!("{name}-{killed_at}"));
            let checkpoint = || Checkpoint::new(&path).interval(Duration::ZERO);
            // The program dies during an evaluation, so nothing more is written.
            let calls = Cell::new(0);
            let dies = |x: &[f64]| {
                calls.set(calls.get() + 1);
                if calls.get() > killed_at {
                    std::panic::resume_unwind(Box::new("killed"));
                }
                rosenbrock(x)
            };
            let (mut inner, _) = Clocked::new(width, |_| 1.0);
            let dying = Dying { inner: &mut inner, dies: &dies };
            let run = described(minimize_by(dying), &named(name), (6, 120)).checkpoint(checkpoint());
            assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| run.run())).is_err());

            // With one worker, no evaluation starts speculatively.
            let (clocked, seen) = Clocked::new(1, |_| 1.0);
            let run = described(minimize_by(clocked), &named(name), (6, 120));
            let report = run.checkpoint(checkpoint().resume(Resume::Require)).run().unwrap();
            assert_eq!(timeless(&report.trace), timeless(&whole.trace), "{name} {killed_at}");
            assert_eq!(report.termination, Termination::MaxEvaluations);
            let again = seen.begun.get() + killed_at;
            // The first answer is written immediately; later ones when writing has taken at most a tenth of
            // the time.
            assert!(width > 1 || again < 120 + killed_at, "{name} {killed_at}: {again} evaluations in all");
        }
    }
}

/// Calls a function before each answer.
struct Dying<'a, L> {
    inner: &'a mut Clocked<L>,
    dies: &'a dyn Fn(&[f64]) -> f64,
}

impl<L: Fn(&[f64]) -> f64> Evaluator for Dying<'_, L> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        self.inner.submit(x, query);
    }
    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
        let polled = self.inner.poll(wait, answer);
        if let (PollResult::Answered(_), Outcome::Value(_)) = (polled, &answer.outcome) {
            (self.dies)(&[0.0, 0.0]);
        }
        polled
    }
    fn cancel(&mut self, id: u64) {
        self.inner.cancel(id);
    }
    fn width(&self) -> usize {
        self.inner.width()
    }
    fn cutoff_use(&self) -> CutoffUse {
        CutoffUse::No
    }
}
