//! Evaluations flow: an evaluator with a clock of its own, whose points take as long as it likes.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::timeless;
use dfo::{
    Answer, AnyMethod, BatchPlan, Checkpoint, Evaluator, GivesUp, Minimize, NelderMead, Outcome,
    PatternSearch, PollPlan, Polled, Query, Report, Resume, Termination, Wait, minimize, minimize_by,
};
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;

fn rosenbrock(x: &[f64]) -> f64 {
    x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
}

fn hash(x: &[f64]) -> u64 {
    let mix = |h: u64, v: &f64| (h ^ v.to_bits()).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
    x.iter().fold(7, mix).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 33
}

/// One in so many points takes ten times as long.
fn one_in(every: u64) -> impl Fn(&[f64]) -> f64 {
    move |x| if hash(x).is_multiple_of(every) { 10.0 } else { 1.0 }
}

/// What is seen from outside.
#[derive(Default)]
struct Seen {
    /// The clock, the time that points took in all, how many began.
    now: Cell<f64>,
    busy: Cell<f64>,
    begun: Cell<usize>,
    begun_at: RefCell<Vec<Vec<f64>>>,
}

/// Workers on a clock of their own: what ends first answers first.
struct Clocked<L> {
    width: usize,
    length: L,
    waiting: VecDeque<(u64, Vec<f64>)>,
    /// When it ends, when it began, the point.
    running: Vec<(f64, f64, u64, Vec<f64>)>,
    cancelled: Vec<u64>,
    seen: Rc<Seen>,
}

impl<L: Fn(&[f64]) -> f64> Clocked<L> {
    fn new(width: usize, length: L) -> (Self, Rc<Seen>) {
        let seen = Rc::new(Seen::default());
        let own = Rc::clone(&seen);
        let (waiting, running, cancelled) = (VecDeque::new(), Vec::new(), Vec::new());
        (Self { width, length, waiting, running, cancelled, seen: own }, seen)
    }

    fn begin(&mut self) {
        while self.running.len() < self.width
            && let Some((id, x)) = self.waiting.pop_front()
        {
            let now = self.seen.now.get();
            self.seen.begun.set(self.seen.begun.get() + 1);
            self.seen.begun_at.borrow_mut().push(x.clone());
            self.running.push((now + (self.length)(&x), now, id, x));
        }
    }
}

impl<L: Fn(&[f64]) -> f64> Evaluator for Clocked<L> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        self.waiting.push_back((query.id, x.to_vec()));
    }

    fn poll(&mut self, _: &Wait<'_>, answer: &mut Answer) -> Polled {
        answer.clear();
        if let Some(id) = self.cancelled.pop() {
            return Polled::Answered(id);
        }
        self.begin();
        let first = (0..self.running.len()).min_by(|a, b| self.running[*a].0.total_cmp(&self.running[*b].0));
        let Some(first) = first else { return Polled::Idle };
        let (end, began, id, x) = self.running.swap_remove(first);
        self.seen.now.set(end);
        self.seen.busy.set(self.seen.busy.get() + end - began);
        answer.outcome = Outcome::Value(rosenbrock(&x));
        Polled::Answered(id)
    }

    /// A simulation stops at its next step.
    fn cancel(&mut self, id: u64) {
        let now = self.seen.now.get();
        if let Some(place) = self.running.iter().position(|r| r.2 == id) {
            let (_, began, ..) = self.running.swap_remove(place);
            self.seen.busy.set(self.seen.busy.get() + now - began);
            self.cancelled.push(id);
        } else if let Some(place) = self.waiting.iter().position(|w| w.0 == id) {
            self.waiting.remove(place);
            self.cancelled.push(id);
        }
    }

    fn width(&self) -> usize {
        self.width
    }

    fn gives_up(&self) -> GivesUp {
        GivesUp::No
    }
}

fn described<'a>(
    run: Minimize<'a, NelderMead>,
    method: &AnyMethod,
    (n, evaluations): (usize, usize),
) -> Minimize<'a, AnyMethod> {
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

#[test]
fn whoever_answers_first_the_path_is_the_same() {
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

#[test]
fn stragglers_hold_up_only_those_who_need_them() {
    for (every, least) in [(10, 1.6), (20, 1.6)] {
        let method = named("nelder-mead");
        let (_, serial) = run(&method, (5, 600), 1, every);
        let (report, seen) = run(&method, (5, 600), 16, every);
        let gain = serial.now.get() / seen.now.get();
        println!("one in {every}: {gain:.2} times as fast, {} ahead in vain", report.n_speculative);
        assert!(gain >= least, "{gain}");
    }
}

#[test]
fn evaluations_in_vain_are_bounded() {
    let ahead: AnyMethod = NelderMead::default().batch(BatchPlan::Ahead).into();
    let poll: AnyMethod = PatternSearch::default().batch(PollPlan::Poll).into();
    for (width, most) in [(16, 2), (64, 2), (300, 4), (1000, 4)] {
        for (method, n) in [(&ahead, 5), (&poll, 5), (&poll, 200)] {
            let (report, seen) = run(method, (n, 400), width, 10);
            let in_vain = seen.begun.get() - report.n_evaluations;
            println!("{width} workers, n = {n}, {}: {in_vain} in vain", report.method);
            assert!(in_vain <= most * report.n_evaluations, "{} {width} {n}: {in_vain}", report.method);
        }
    }
}

#[test]
fn what_was_answered_is_kept_from_the_first_evaluation_on() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["de", "cma-es", "nelder-mead", "quadratic-model", "multistart"] {
        let whole = described(minimize(rosenbrock), &named(name), (6, 120)).run().unwrap();
        for killed_at in [1usize, 5, 37] {
            let path = folder.path().join(format!("{name}-{killed_at}"));
            let checkpoint = || Checkpoint::new(&path).interval(Duration::ZERO);
            // The program dies in an evaluation: nothing is written any more.
            let calls = Cell::new(0);
            let dies = |x: &[f64]| {
                calls.set(calls.get() + 1);
                if calls.get() > killed_at {
                    std::panic::resume_unwind(Box::new("killed"));
                }
                rosenbrock(x)
            };
            let (mut inner, _) = Clocked::new(1, |_| 1.0);
            let dying = Dying { inner: &mut inner, dies: &dies };
            let run = described(minimize_by(dying), &named(name), (6, 120)).checkpoint(checkpoint());
            assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| run.run())).is_err());

            // One worker: nothing is begun ahead of need.
            let (clocked, seen) = Clocked::new(1, |_| 1.0);
            let run = described(minimize_by(clocked), &named(name), (6, 120));
            let report = run.checkpoint(checkpoint().resume(Resume::Require)).run().unwrap();
            assert_eq!(timeless(&report.trace), timeless(&whole.trace), "{name} {killed_at}");
            assert_eq!(report.termination, Termination::MaxEvaluations);
            let again = seen.begun.get() + killed_at;
            // The first answer is written at once, others when writing has taken no more than a tenth of the time.
            assert!(again < 120 + killed_at, "{name} {killed_at}: {again} evaluations in all");
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
    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> Polled {
        let polled = self.inner.poll(wait, answer);
        if let (Polled::Answered(_), Outcome::Value(_)) = (polled, &answer.outcome) {
            (self.dies)(&[0.0, 0.0]);
        }
        polled
    }
    fn cancel(&mut self, id: u64) {
        self.inner.cancel(id);
    }
    fn width(&self) -> usize {
        1
    }
    fn gives_up(&self) -> GivesUp {
        GivesUp::No
    }
}
