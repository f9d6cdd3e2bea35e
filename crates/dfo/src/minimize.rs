//! The front door: `minimize(f).start(&x0)...run()`.

use crate::bounds::Bounds;
use crate::cache::Cache;
use crate::checkpoint::{self, Checkpoint, Writer};
use crate::drive::{Drive, Observer};
use crate::error::Error;
use crate::evaluate::{Desk, Gateway};
use crate::executor::{BatchFunction, BatchView, Executor, WorkerPool};
use crate::ledger::Ledger;
use crate::method::{Method, MethodOptions, Setup};
use crate::nelder_mead::NelderMead;
use crate::objective::{Objective, Outcome};
use crate::observe::Progress;
use crate::report::Report;
use crate::scaling::{Kind, Space, Transform};
use crate::termination::{Limits, Measure, Stop, Tolerances};
use crate::trace::Trace;
use std::fmt;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Minimises an objective: a closure `Fn(&[f64]) -> f64 + Sync`, or anything that is an [`Objective`].
///
/// ```
/// use dfo::{NelderMead, minimize};
///
/// let rosenbrock = |x: &[f64]| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (1.0 - x[0]).powi(2);
/// let report = minimize(rosenbrock)
///     .start(&[-1.2, 1.0])
///     .bounds(&[-2.0, -2.0], &[2.0, 2.0])?
///     .method(NelderMead::default())
///     .workers(4)
///     .run()?;
/// assert!(report.is_success() && report.fun < 1e-8);
/// println!("{report}");
/// # Ok::<(), dfo::Error>(())
/// ```
pub fn minimize<'a>(objective: impl Objective + 'a) -> Minimize<'a, NelderMead> {
    Minimize::new(Source::Objective(Box::new(objective)))
}

/// Minimises by a function that evaluates whole batches on the calling thread and returns one outcome per point, in
/// order: for vectorised functions and for somebody else's executor.
///
/// [`Minimize::workers`] then only says how many points such a batch should have. A function that was interrupted
/// returns [`Outcome::Skipped`] for what it left out, which ends the run. A panic counts as failure of every point.
///
/// ```
/// use dfo::{BatchView, Outcome, minimize_batches};
///
/// let squares = |batch: &BatchView<'_>| {
///     (0..batch.len()).map(|k| Outcome::Value(batch.point(k).iter().map(|x| x * x).sum())).collect()
/// };
/// let report = minimize_batches(squares).start(&[1.0, 2.0]).workers(4).run()?;
/// assert!(report.fun < 1e-8);
/// # Ok::<(), dfo::Error>(())
/// ```
pub fn minimize_batches<'a>(
    function: impl FnMut(&BatchView<'_>) -> Vec<Outcome> + 'a,
) -> Minimize<'a, NelderMead> {
    Minimize::new(Source::Batches(Box::new(function)))
}

enum Source<'a> {
    Objective(Box<dyn Objective + 'a>),
    Batches(Box<BatchFunction<'a>>),
}

/// A minimisation being described; made by [`minimize`] or [`minimize_batches`], ended by [`run`](Self::run).
#[must_use = "nothing happens before run()"]
pub struct Minimize<'a, M> {
    source: Source<'a>,
    method: M,
    x0: Option<Vec<f64>>,
    bounds: Option<Bounds>,
    transforms: Vec<Transform>,
    sizes: Vec<f64>,
    tolerances: Tolerances,
    limits: Limits,
    seed: Option<u64>,
    kinds: Vec<Kind>,
    prior: Vec<(Vec<f64>, f64)>,
    cache: Option<usize>,
    trace_limit: Option<usize>,
    checkpoint: Option<Checkpoint>,
    workers: usize,
    pool: Option<Arc<WorkerPool>>,
    cancel: Option<Arc<AtomicBool>>,
    observer: Option<Box<Observer<'a>>>,
    poll: Option<Box<dyn FnMut() -> bool + 'a>>,
}

impl<'a> Minimize<'a, NelderMead> {
    fn new(source: Source<'a>) -> Self {
        Self {
            source,
            method: NelderMead::default(),
            x0: None,
            bounds: None,
            transforms: Vec::new(),
            sizes: Vec::new(),
            tolerances: Tolerances::default(),
            limits: Limits::default(),
            seed: None,
            kinds: Vec::new(),
            prior: Vec::new(),
            cache: None,
            trace_limit: None,
            checkpoint: None,
            workers: 1,
            pool: None,
            cancel: None,
            observer: None,
            poll: None,
        }
    }
}

impl<'a, M> Minimize<'a, M> {
    /// The start point. Must lie in the box; required, unless the method samples its box.
    pub fn start(mut self, x0: &[f64]) -> Self {
        self.x0 = Some(x0.to_vec());
        self
    }

    /// Lower and upper bounds; infinite where there is none, equal where a parameter is fixed. Default none.
    ///
    /// # Errors
    /// As [`Bounds::new`].
    pub fn bounds(mut self, lower: &[f64], upper: &[f64]) -> Result<Self, Error> {
        self.bounds = Some(Bounds::new(lower, upper)?);
        Ok(self)
    }

    /// The method; default Nelder-Mead.
    pub fn method<N: MethodOptions>(self, method: N) -> Minimize<'a, N> {
        let Self { source, x0, bounds, transforms, sizes, tolerances, limits, seed, kinds, .. } = self;
        let Self { prior, cache, trace_limit, checkpoint, .. } = self;
        let Self { workers, pool, cancel, observer, poll, .. } = self;
        Minimize {
            source,
            method,
            x0,
            bounds,
            transforms,
            sizes,
            tolerances,
            limits,
            seed,
            kinds,
            prior,
            cache,
            trace_limit,
            checkpoint,
            workers,
            pool,
            cancel,
            observer,
            poll,
        }
    }

    /// Evaluations that may run at once, on threads of our own with 16 MiB of stack; 1 (the default): on the calling
    /// thread. The result does not depend on it.
    pub fn workers(mut self, workers: usize) -> Self {
        self.workers = workers;
        self
    }

    /// Evaluates on the threads of this pool, even if it has only one: the calling thread stays free to poll.
    /// Replaces [`workers`](Self::workers).
    pub fn pool(mut self, pool: Arc<WorkerPool>) -> Self {
        self.pool = Some(pool);
        self
    }

    /// Limit of evaluations, exact even inside a batch. At least 1; `usize::MAX` for none.
    ///
    /// Without any of the three limits (evaluations, iterations, time) the method's defaults hold
    /// ([`MethodOptions::default_limits`]), for Nelder-Mead `1000 (n + 1)` iterations or `5000 (n + 1)` evaluations, `n`
    /// being the number of free parameters. Setting one lifts these defaults.
    pub fn max_evaluations(mut self, n: usize) -> Self {
        self.limits.max_evaluations = Some(n);
        self
    }

    /// Limit of iterations; 0 evaluates only the starting points.
    pub fn max_iterations(mut self, n: usize) -> Self {
        self.limits.max_iterations = Some(n);
        self
    }

    /// Limit of wall-clock time: no evaluation starts after it, and running ones see
    /// [`Evaluation::cancelled`](crate::Evaluation::cancelled).
    pub fn max_time(mut self, time: Duration) -> Self {
        self.limits.max_time = Some(time);
        self
    }

    /// Ends the run after the first batch with a used point whose cost is at or below this.
    pub fn target(mut self, cost: f64) -> Self {
        self.limits.target = Some(cost);
        self
    }

    /// All tolerances at once.
    pub fn tolerances(mut self, tolerances: Tolerances) -> Self {
        self.tolerances = tolerances;
        self
    }

    /// Tolerance of the x test, see [`Tolerances`]; default 1e-6.
    pub fn x_tol(mut self, tolerance: f64) -> Self {
        self.tolerances.x_tol = tolerance;
        self
    }

    /// Tolerance of the f test, see [`Tolerances`]; default 1e-6.
    pub fn f_tol(mut self, tolerance: f64) -> Self {
        self.tolerances.f_tol = tolerance;
        self
    }

    /// Whether tolerances are relative (default) or absolute.
    pub fn measure(mut self, measure: Measure) -> Self {
        self.tolerances.measure = measure;
        self
    }

    /// Whether both tests must pass (default) or either.
    pub fn stop(mut self, stop: Stop) -> Self {
        self.tolerances.stop = stop;
        self
    }

    /// Typical sizes of the parameters, positive: the unit of a relative `x_tol`. Default: width of the box, else
    /// |x0|, else 1. For a logarithmic parameter in units of `ln x`.
    pub fn scales(mut self, sizes: &[f64]) -> Self {
        self.sizes = sizes.to_vec();
        self
    }

    /// Seed of the random numbers, for methods that draw them. Default: drawn, and reported.
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = Some(seed);
        self
    }

    /// Starts from what an earlier run has learnt: its points with their costs, as far as they lie in the box and have
    /// the values of the fixed parameters. The best of them is the start point, populations begin with the best of
    /// them, and none is evaluated again. What had failed, or was given up above a cutoff, is left out.
    pub fn warm_start(mut self, trace: &Trace) -> Self {
        let known = trace.iter().filter_map(|e| e.outcome.value().map(|v| (e.x.to_vec(), v)));
        self.prior.extend(known);
        self
    }

    /// How many evaluations to remember, so that exact repeats cost nothing; 0 for none. Default: the method's
    /// ([`MethodOptions::default_cache`]), with discrete parameters at least 10 000.
    pub fn cache(mut self, evaluations: usize) -> Self {
        self.cache = Some(evaluations);
        self
    }

    /// Keeps only the last so many evaluations in the trace (while the run goes on, up to twice as many).
    pub fn trace_limit(mut self, evaluations: usize) -> Self {
        self.trace_limit = Some(evaluations);
        self
    }

    /// Writes the state of the run to a file, and continues from it if it is there.
    pub fn checkpoint(mut self, checkpoint: Checkpoint) -> Self {
        self.checkpoint = Some(checkpoint);
        self
    }

    /// Continuous, integer or categorical, per parameter. Default all continuous; not every method takes the others.
    pub fn kinds(mut self, kinds: &[Kind]) -> Self {
        self.kinds = kinds.to_vec();
        self
    }

    /// Linear or logarithmic, per parameter. Default all linear.
    pub fn transforms(mut self, transforms: &[Transform]) -> Self {
        self.transforms = transforms.to_vec();
        self
    }

    /// Called on the calling thread after the starting points and after each iteration; `Break` ends the run.
    pub fn observer(mut self, observer: impl FnMut(&Progress<'_>) -> ControlFlow<()> + 'a) -> Self {
        self.observer = Some(Box::new(observer));
        self
    }

    /// Called on the calling thread between evaluations, with workers at least every 50 ms; `true` interrupts the
    /// run: no further evaluation starts, and running ones see
    /// [`Evaluation::cancelled`](crate::Evaluation::cancelled).
    pub fn poll(mut self, poll: impl FnMut() -> bool + 'a) -> Self {
        self.poll = Some(Box::new(poll));
        self
    }

    /// A flag that interrupts the run when set, and that the run sets while it waits for running evaluations to end
    /// (and lowers again after it): share it with the simulations.
    pub fn cancel(mut self, flag: Arc<AtomicBool>) -> Self {
        self.cancel = Some(flag);
        self
    }
}

impl<M: MethodOptions> Minimize<'_, M> {
    /// Runs.
    ///
    /// # Errors
    /// Options that cannot be used; an objective that failed at every starting point; a run that was ended before any
    /// point had a finite cost. Every other end is a [`Report`].
    pub fn run(mut self) -> Result<Report, Error> {
        let start_given = self.x0.is_some();
        let x0 = match (self.x0, &self.bounds) {
            (Some(x0), _) => x0,
            (None, Some(bounds)) if !self.method.needs_start() => {
                middle(bounds, &self.transforms, &self.kinds).ok_or(Error::NoStart)?
            }
            (None, _) => return Err(Error::NoStart),
        };
        let bounds = self.bounds.unwrap_or_else(|| Bounds::unbounded(x0.len()));
        let mut space = Space::new(&x0, bounds, &self.transforms, &self.sizes)?;
        if !self.kinds.is_empty() {
            space = space.with_kinds(&self.kinds)?;
        }
        self.limits.check()?;
        if self.workers == 0 {
            return Err(Error::Option { name: "workers", value: 0.0, range: "at least 1" });
        }
        self.limits.fill(self.method.default_limits(space.n_free()));
        let (prior, best) = usable(std::mem::take(&mut self.prior), &space);
        if let Some(best) = best {
            space = space.starting_at(&best);
        }
        let n = space.n();
        let discrete = (0..space.n_free()).any(|k| space.kind(k) != Kind::Continuous);
        let default = self.method.default_cache().max(if discrete { 10_000 } else { 0 });
        let capacity = self.cache.unwrap_or(default);
        let workers = self.pool.as_ref().map_or(self.workers, |p| p.workers());
        let setup = Setup {
            tolerances: self.tolerances,
            workers,
            seed: self.seed,
            max_evaluations: self.limits.max_evaluations,
            start_given: start_given || !prior.is_empty(),
            prior,
            ..Setup::new(space)
        };
        let begun = self.method.begin(&setup)?;
        let mut cache = Cache::new(capacity);
        for (x, value) in &setup.prior {
            cache.pin(x, &Outcome::Value(*value));
        }
        let mut desk = Desk::new(Ledger::new(n, self.trace_limit), cache);
        let (mut method, mut observed, mut first_recent, mut before) = (begun, None, 0, 0.0);
        let writer = match self.checkpoint {
            None => None,
            Some(options) => {
                let name = format!("{}: {}", method.name(), self.method.describe());
                let words = (name, self.method.plans_with_budget());
                let fingerprint =
                    checkpoint::fingerprint(words, &setup, (capacity, self.trace_limit), &options.tags);
                if let Some(stored) = checkpoint::read(&options, &fingerprint, setup.seed, n)? {
                    method = self.method.restore(&setup, &stored.method)?;
                    desk = Desk::new(stored.ledger, stored.cache);
                    (desk.replay, desk.stale) = (stored.replay, stored.stale);
                    (observed, first_recent) = (stored.observed, stored.first_recent);
                    before = stored.seconds;
                }
                Some(Writer::new(options, fingerprint))
            }
        };
        let pool = match (self.pool, &self.source) {
            (Some(pool), _) => Some(pool),
            (None, Source::Objective(_)) if workers > 1 => Some(Arc::new(WorkerPool::new(workers)?)),
            (None, _) => None,
        };
        let executor = match (&mut self.source, &pool) {
            (Source::Objective(objective), Some(pool)) => Executor::Pool(pool, &**objective),
            (Source::Objective(objective), None) => Executor::Serial(&**objective),
            (Source::Batches(function), _) => Executor::Foreign(function.as_mut()),
        };
        let cancel = self.cancel.unwrap_or_default();
        let poll = self.poll.as_mut().map(|p| p.as_mut() as &mut dyn FnMut() -> bool);
        let gateway = Gateway::new(executor, desk, self.limits, before, &cancel, poll);
        let limits = self.limits;
        let drive = Drive { method, gateway, limits, workers, writer, observed, first_recent };
        drive.run(self.observer.as_deref_mut())
    }
}

/// The points of earlier runs that lie in this space, best first and each once, and the best of them.
type Prior = Vec<(Vec<f64>, f64)>;
fn usable(mut prior: Prior, space: &Space) -> (Prior, Option<Vec<f64>>) {
    let discrete: Vec<usize> =
        (0..space.n_free()).filter(|&k| space.kind(k) != Kind::Continuous).map(|k| space.free()[k]).collect();
    prior.retain(|(x, _)| space.bounds().contains(x) && discrete.iter().all(|&i| x[i] == x[i].round()));
    prior.sort_by(|a, b| a.1.total_cmp(&b.1));
    prior.dedup_by(|a, b| a.0 == b.0);
    let best = prior.first().map(|(x, _)| x.clone());
    (prior, best)
}

/// The middle of a box, where no start was given; `None` if it has none.
fn middle(bounds: &Bounds, transforms: &[Transform], kinds: &[Kind]) -> Option<Vec<f64>> {
    (0..bounds.len())
        .map(|i| {
            let (lower, upper) = (bounds.lower()[i], bounds.upper()[i]);
            let middle = match transforms.get(i) {
                Some(Transform::Log) if lower > 0.0 => (0.5 * lower.ln() + 0.5 * upper.ln()).exp(),
                _ => 0.5 * lower + 0.5 * upper,
            };
            let whole = lower != upper && kinds.get(i).is_some_and(|k| *k != Kind::Continuous);
            let middle = if whole { middle.floor().max(lower.ceil()) } else { middle };
            middle.is_finite().then(|| middle.clamp(lower, upper))
        })
        .collect()
}

impl<M: fmt::Debug> fmt::Debug for Minimize<'_, M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Minimize")
            .field("method", &self.method)
            .field("x0", &self.x0)
            .field("bounds", &self.bounds)
            .field("tolerances", &self.tolerances)
            .field("limits", &self.limits)
            .field("workers", &self.workers)
            .finish_non_exhaustive()
    }
}
