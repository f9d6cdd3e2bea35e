//! The entry point: `minimize(f).start(&x0)...run()`.

use crate::error::Error;
use crate::evaluation::{
    BatchFunction, BatchView, Batches, CallingThread, ContextPoller, CutoffUse, Evaluator, OnCallingThread,
    Shared, Threads, pool,
};
use crate::method_interface::interface::{Method, MethodOptions};
use crate::method_interface::tolerances::{Limits, Tolerances};
use crate::methods::{AnyMethod, LeastSquares, NelderMead};
use crate::outcome::answer::Outcome;
use crate::outcome::trace::{Trace, TraceEntry};
use crate::problem::loss::RobustLoss;
use crate::problem::objective::{Objective, ResidualFunction, residuals};
use crate::problem::space::Bounds;
use crate::run::checkpoint::Checkpoint;
use crate::run::drive::{Around, Drive, Observer};
use crate::run::optimizer::Optimizer;
use crate::run::options::{KnownPoint, RunOptions};
use crate::run::progress::Progress;
use crate::run::report::Report;
use crate::run::requested::RequestedRun;
use crate::run::start::Description;
use crate::values::choices::{ParameterKind, Search, StopRule, ToleranceMeasure, Transform};
use base::RunContext;
use std::fmt;
use std::marker::PhantomData;
use std::ops::ControlFlow;
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
    let loss = objective.residual_loss();
    Minimize::new(ByRun { loss, ..ByRun::new(Source::Objective(Box::new(objective))) })
}

/// Minimises the sum of the squares of residuals:
/// `minimize(residuals(function)).method(LeastSquares::default())`.
///
/// ```
/// use dfo::least_squares;
///
/// let measured = [(0.0, 2.0), (1.0, 1.25), (2.0, 0.70), (3.0, 0.46), (4.0, 0.26)];
/// let decay = |x: &[f64], out: &mut Vec<f64>| out.extend(measured.map(|(t, y): (f64, f64)| x[0] * (-x[1] * t).exp() - y));
/// let report = least_squares(decay).start(&[1.0, 1.0]).run()?;
/// assert!(report.is_success() && (report.x[1] - 0.5).abs() < 0.02, "{report}");
/// assert_eq!(report.residuals.as_ref().map(Vec::len), Some(5));
/// let deviation = report.covariance().map(|c| c.matrix[3].sqrt());
/// assert!(deviation.is_some_and(|d| d > 0.003 && d < 0.03), "{deviation:?}");
/// # Ok::<(), dfo::Error>(())
/// ```
pub fn least_squares<'a>(function: impl ResidualFunction + 'a) -> Minimize<'a, LeastSquares> {
    minimize(residuals(function)).method(LeastSquares::default())
}

/// Minimises by a function that evaluates whole batches on the calling thread and returns one outcome per
/// point, in order: for vectorised functions and for an executor of the caller's.
///
/// [`Minimize::workers`] then only says how many points such a batch should have. A function that was
/// interrupted returns [`Outcome::Skipped`] for what it left out, which ends the run. After a panic it is
/// given the points of the batch one by one: those that it panics at have failed.
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
    Minimize::new(ByRun::new(Source::Batches(Box::new(function))))
}

/// Minimises by an [`Evaluator`] of one's own, which takes points one by one and answers in any order: an
/// executor, a cluster, a laboratory. Points that are needed go first; where its [`width`](Evaluator::width)
/// leaves room, others follow that may be needed.
pub fn minimize_by<'a>(evaluator: impl Evaluator + 'a) -> Minimize<'a, NelderMead> {
    Minimize::new(ByRun::new(Source::Evaluator(Box::new(evaluator))))
}

/// A run that is driven by hand, point by point: described as [`minimize`] is, ended by
/// [`optimizer`](Minimize::optimizer).
///
/// [`Minimize::workers`] then says how many points are evaluated at once, which a batch plan may follow.
///
/// ```
/// use dfo::{Genetic, Outcome, by_hand};
///
/// let mut optimizer =
///     by_hand().bounds(&[0.0; 2], &[1.0; 2])?.method(Genetic::default()).seed(1).max_evaluations(300).optimizer()?;
/// while optimizer.termination().is_none() {
///     // In any order, in any pieces.
///     for point in optimizer.ask(7).into_iter().rev() {
///         optimizer.tell(point.id, Outcome::Value((point.x[0] - point.x[1]).powi(2)))?;
///     }
/// }
/// assert!(optimizer.report()?.fun < 1e-3);
/// # Ok::<(), dfo::Error>(())
/// ```
pub fn by_hand() -> Minimize<'static, NelderMead, ByHand> {
    Minimize::new(ByHand)
}

enum Source<'a> {
    Objective(Box<dyn Objective + 'a>),
    Batches(Box<BatchFunction<'a>>),
    Evaluator(Box<dyn Evaluator + 'a>),
}

/// Of a [`Minimize`]: what it minimises is evaluated by the run.
pub struct ByRun<'a> {
    source: Source<'a>,
    context: RunContext<'a>,
    observer: Option<Box<Observer<'a>>>,
    has_residuals: bool,
    cutoff_use: CutoffUse,
    loss: RobustLoss,
    spent: Duration,
}

impl<'a> ByRun<'a> {
    fn new(source: Source<'a>) -> Self {
        let (loss, spent) = (RobustLoss::default(), Duration::ZERO);
        Self {
            source,
            context: RunContext::new(),
            observer: None,
            has_residuals: false,
            cutoff_use: CutoffUse::Unknown,
            loss,
            spent,
        }
    }
}

/// Of a [`Minimize`]: the caller evaluates, see [`by_hand`].
#[derive(Debug, Clone, Copy)]
pub struct ByHand;

/// A minimisation being described; made by [`minimize`], [`minimize_batches`], [`minimize_by`] or
/// [`by_hand`], ended by [`run`](Self::run) or [`optimizer`](Self::optimizer).
#[must_use = "nothing happens before run()"]
pub struct Minimize<'a, M, D = ByRun<'a>> {
    description: Description<M>,
    driver: D,
    life: PhantomData<&'a ()>,
}

impl<D> Minimize<'_, NelderMead, D> {
    fn new(driver: D) -> Self {
        Self { description: Description::default(), driver, life: PhantomData }
    }
}

impl<'a, M, D> Minimize<'a, M, D> {
    /// The start point. Must lie in the box; required, unless the method samples its box.
    pub fn start(mut self, x0: &[f64]) -> Self {
        self.description.x0 = Some(x0.to_vec());
        self
    }

    /// Lower and upper bounds; infinite where there is none, equal where a parameter is fixed. Default none.
    /// Of a box that is too wide to tell the size of a parameter see [`Bounds`].
    ///
    /// # Errors
    /// As [`Bounds::new`].
    pub fn bounds(mut self, lower: &[f64], upper: &[f64]) -> Result<Self, Error> {
        self.description.bounds = Some(Bounds::new(lower, upper)?);
        Ok(self)
    }

    /// The method; default Nelder-Mead.
    pub fn method<N: MethodOptions>(self, method: N) -> Minimize<'a, N, D> {
        let Self { description, driver, life } = self;
        Minimize { description: description.with_method(method), driver, life }
    }

    /// Sets the goal of the search; the run chooses the method for it ([`AnyMethod::chosen_for`]), and its
    /// report says which and why.
    ///
    /// ```
    /// use dfo::{Search, minimize};
    ///
    /// let cost = |x: &[f64]| (x[0] * x[0] - 1.0).powi(2) + 0.1 * x[0];
    /// let report = minimize(cost).start(&[1.5]).bounds(&[-2.0], &[2.0])?.search(Search::Global).seed(1).run()?;
    /// assert!(report.x[0] < 0.0 && report.method == "multistart", "{report}");
    /// # Ok::<(), dfo::Error>(())
    /// ```
    pub fn search(self, search: Search) -> Minimize<'a, AnyMethod, D> {
        self.method(AnyMethod::auto(search))
    }

    /// All options at once, the method with them.
    pub fn options<N: MethodOptions>(self, options: RunOptions<N>) -> Minimize<'a, N, D> {
        let Self { description, driver, life } = self;
        let Description { x0, bounds, transforms, sizes, kinds, .. } = description;
        Minimize { description: Description { options, x0, bounds, transforms, sizes, kinds }, driver, life }
    }

    /// All that was requested by name.
    pub fn requested(self, requested: RequestedRun) -> Minimize<'a, AnyMethod, D> {
        let RequestedRun { options, scale, nominal, kinds } = requested;
        self.options(options).transforms(&scale).known_scales(&nominal).kinds(&kinds)
    }

    /// Evaluations that may run at once, on threads of our own with 16 MiB of stack; 1 (the default): on the
    /// calling thread. The result does not depend on it. Evaluations that are too short to be worth handing
    /// over stay on the calling thread; so does the first one, which shows that, unless its
    /// [`context`](Self::context) has a function.
    pub fn workers(mut self, workers: usize) -> Self {
        self.description.options.workers = Some(workers);
        self
    }

    /// Limit of evaluations of the path, exact even inside a batch. At least 1.
    ///
    /// Without any of the three limits (evaluations, iterations, time) the method's defaults hold
    /// ([`MethodOptions::default_limits`]), for Nelder-Mead `1000 (n + 1)` iterations or `5000 (n + 1)`
    /// evaluations, `n` being the number of free parameters. Setting one lifts these defaults.
    pub fn max_evaluations(mut self, n: usize) -> Self {
        self.description.options.limits.max_evaluations = Some(n);
        self
    }

    /// Limit of iterations; 0 evaluates only the starting points.
    pub fn max_iterations(mut self, n: usize) -> Self {
        self.description.options.limits.max_iterations = Some(n);
        self
    }

    /// Limit of wall-clock time: no evaluation starts after it, and running ones see
    /// [`Query::cancelled`](crate::Query::cancelled).
    pub fn max_time(mut self, time: Duration) -> Self {
        self.description.options.limits.max_time = Some(time);
        self
    }

    /// Ends the run with the first evaluation of the path whose cost is at or below this, see
    /// [`Limits::target`].
    pub fn target(mut self, cost: f64) -> Self {
        self.description.options.limits.target = Some(cost);
        self
    }

    /// Ends the run where more than this share of its evaluations has failed, see [`Limits::max_failed`].
    pub fn max_failed(mut self, share: f64) -> Self {
        self.description.options.limits.max_failed = Some(share);
        self
    }

    /// Where no limit is set, none holds: not even the method's defaults.
    pub fn unlimited(mut self) -> Self {
        self.description.options.unlimited = true;
        self
    }

    /// All limits at once.
    pub fn limits(mut self, limits: Limits) -> Self {
        self.description.options.limits = limits;
        self
    }

    /// All tolerances at once.
    pub fn tolerances(mut self, tolerances: Tolerances) -> Self {
        self.description.options.tolerances = tolerances;
        self
    }

    /// Tolerance of the x test, see [`Tolerances`]; default 1e-6.
    pub fn x_tol(mut self, tolerance: f64) -> Self {
        self.description.options.tolerances.x_tol = tolerance;
        self
    }

    /// Tolerance of the f test, see [`Tolerances`]; default 1e-6.
    pub fn f_tol(mut self, tolerance: f64) -> Self {
        self.description.options.tolerances.f_tol = tolerance;
        self
    }

    /// Sets relative (default) or absolute tolerances.
    pub fn measure(mut self, measure: ToleranceMeasure) -> Self {
        self.description.options.tolerances.measure = measure;
        self
    }

    /// Sets the number of tests that must pass: both (default) or either.
    pub fn stop(mut self, stop: StopRule) -> Self {
        self.description.options.tolerances.stop = stop;
        self
    }

    /// Typical sizes of the parameters, positive: the unit of a relative `x_tol`. Default: see
    /// [`typical_size`](crate::typical_size), else what the method finds out (see
    /// [`InitialSimplex::Auto`](crate::InitialSimplex::Auto)). For a logarithmic parameter in units of `ln
    /// x`.
    pub fn scales(self, sizes: &[f64]) -> Self {
        let sizes: Vec<_> = sizes.iter().copied().map(Some).collect();
        self.known_scales(&sizes)
    }

    /// The same where only some of the sizes are known; the default holds for the others.
    pub fn known_scales(mut self, sizes: &[Option<f64>]) -> Self {
        self.description.sizes = sizes.to_vec();
        self
    }

    /// Seed of the random numbers, for methods that draw them. Default: drawn, and reported.
    pub fn seed(mut self, seed: u64) -> Self {
        self.description.options.seed = Some(seed);
        self
    }

    /// Sets the identity of the problem, a word or a hash that the caller vouches for: it stands for
    /// everything that a cost depends on but the point (model, data, settings), neither bounds nor start.
    /// Costs that are known from elsewhere are only used where they belong to the same problem; a checkpoint
    /// of another one is refused.
    pub fn problem(mut self, identity: impl Into<String>) -> Self {
        self.description.options.problem = Some(identity.into());
        self
    }

    /// Starts from what an earlier run has learnt: its points, as far as they lie in the box and have the
    /// values of the fixed parameters. The best of them is the start point, and populations begin with the
    /// best of them. What had failed, or was given up above a cutoff, is left out.
    ///
    /// Where both runs name the same [`problem`](Self::problem), none of the points is evaluated again. Else
    /// their costs only say where to start.
    pub fn warm_start(self, trace: &Trace) -> Self {
        let problem = trace.problem().map(str::to_owned);
        let known = |e: TraceEntry<'_>| {
            let (cost, residuals) = (e.outcome.value()?, e.residuals.to_vec());
            Some(KnownPoint { x: e.x.to_vec(), cost, residuals, problem: problem.clone() })
        };
        self.known(trace.iter().filter_map(known))
    }

    /// The same with points that were kept otherwise; those whose costs are not finite are left out.
    pub fn known(mut self, points: impl IntoIterator<Item = KnownPoint>) -> Self {
        self.description.options.known.extend(points);
        self
    }

    /// Sets the number of evaluations to remember, so that exact repeats cost nothing; 0 for none. Default:
    /// the method's ([`MethodOptions::default_cache`]), with discrete parameters at least 10 000.
    pub fn cache(mut self, evaluations: usize) -> Self {
        self.description.options.cache = Some(evaluations);
        self
    }

    /// Keeps only the last so many evaluations in the trace (while the run goes on, up to twice as many).
    pub fn trace_limit(mut self, evaluations: usize) -> Self {
        self.description.options.trace_limit = Some(evaluations);
        self
    }

    /// Keeps the residuals of the points for which the method wanted them in the trace, too.
    pub fn trace_residuals(mut self) -> Self {
        self.description.options.trace_residuals = true;
        self
    }

    /// Writes the state of the run to a file, and continues from it if it is there.
    pub fn checkpoint(mut self, checkpoint: Checkpoint) -> Self {
        self.description.options.checkpoint = Some(checkpoint);
        self
    }

    /// Continuous, integer or categorical, per parameter. Default all continuous; not every method takes the
    /// others.
    pub fn kinds(mut self, kinds: &[ParameterKind]) -> Self {
        self.description.kinds = kinds.to_vec();
        self
    }

    /// Linear or logarithmic, per parameter. Default all linear.
    pub fn transforms(mut self, transforms: &[Transform]) -> Self {
        self.description.transforms = transforms.to_vec();
        self
    }
}

impl<'a, M> Minimize<'a, M> {
    /// Called on the calling thread after the starting points and after each iteration; `Break` ends the run.
    pub fn observer(mut self, observer: impl FnMut(&Progress<'_>) -> ControlFlow<()> + 'a) -> Self {
        self.driver.observer = Some(Box::new(observer));
        self
    }

    /// Who may interrupt the run: no further evaluation starts then, and running ones see
    /// [`Query::cancelled`](crate::Query::cancelled). The function of the context is called on the calling
    /// thread between evaluations, with workers at least every 50 ms. Several runs can share a flag. The time
    /// that the context has left ends the run as [`max_time`](Self::max_time) does, if it ends sooner.
    pub fn context(mut self, context: RunContext<'a>) -> Self {
        self.driver.context = context;
        self
    }

    /// Says whether a function of [`minimize_batches`] gives up above cutoffs: then a cost above one counts
    /// as given up, whoever evaluates.
    pub fn cutoff_use(mut self, cutoff_use: CutoffUse) -> Self {
        self.driver.cutoff_use = cutoff_use;
        self
    }

    /// Says whether an [`Evaluator`] of one's own gives residuals: then a method that is chosen for the
    /// problem may ask for them.
    pub fn with_residuals(mut self, has_residuals: bool) -> Self {
        self.driver.has_residuals = has_residuals;
        self
    }

    /// Says what the residuals that a function of [`minimize_batches`] gives have gone through already
    /// ([`RobustLoss::transform`]), so that the [`Report`] gives back the plain ones.
    pub fn loss(mut self, loss: RobustLoss) -> Self {
        self.driver.loss = loss;
        self
    }

    /// Sets the part of the limit of wall-clock time ([`max_time`](Self::max_time)) that was used before the
    /// run begins. The message of a run that ends by time names the whole limit.
    pub fn spent(mut self, time: Duration) -> Self {
        self.driver.spent = time;
        self
    }
}

impl<M: MethodOptions> Minimize<'_, M> {
    /// Runs.
    ///
    /// # Errors
    /// Options that cannot be used; an objective that failed at every starting point; a run that was ended
    /// before any point had a finite cost. Every other end is a [`Report`].
    pub fn run(mut self) -> Result<Report, Error> {
        let ByRun { mut source, context, mut observer, has_residuals, cutoff_use, loss, spent } = self.driver;
        if let Source::Evaluator(evaluator) = &source {
            self.description.options.workers = Some(evaluator.width().max(1));
        }
        if let Some(checkpoint) = self.description.options.checkpoint.as_mut().filter(|_| !loss.is_linear()) {
            checkpoint.tags.push(("loss".to_owned(), loss.to_string()));
        }
        // A batch function shows by its first answer whether it has some.
        let (has_residuals, may_have_some) = match &source {
            Source::Objective(objective) => (objective.has_residuals(), objective.has_residuals()),
            Source::Batches(_) | Source::Evaluator(_) => (has_residuals, true),
        };
        let started = self.description.begin(has_residuals, loss, false)?;
        if started.needs_residuals && !may_have_some {
            return Err(Error::NeedsResiduals { method: started.method.name() });
        }
        let before = Duration::try_from_secs_f64(started.before).unwrap_or(Duration::MAX);
        let left = started.limits.max_time.map(|t| t.saturating_sub(before).saturating_sub(spent));
        let context = context.within(left);
        let here =
            if context.function().is_some() { OnCallingThread::WhenShort } else { OnCallingThread::AtFirst };
        let control = ContextPoller::new(context);
        let (workers, signals) = (started.workers, control.signals());
        let drive = Drive::new(started, false);
        let go = |evaluator: &mut dyn Evaluator| {
            let observer = observer.as_deref_mut();
            drive.run(Around { evaluator, control: &control, observer })
        };
        let mut report = match &mut source {
            Source::Objective(objective) if workers == 1 => go(&mut CallingThread::new(&**objective)),
            Source::Objective(objective) => std::thread::scope(|run| match pool(run, workers) {
                Some(pool) => {
                    let shared = Shared::new(&**objective, signals, pool.current_num_threads());
                    pool.in_place_scope_fifo(|scope| go(&mut Threads::new(scope, &shared, here)))
                }
                None => go(&mut CallingThread::new(&**objective)),
            }),
            Source::Batches(function) => go(&mut Batches::new(function.as_mut(), workers, cutoff_use)),
            Source::Evaluator(evaluator) => go(evaluator),
        }?;
        report.undo(loss);
        Ok(report)
    }
}

impl<M> Minimize<'_, M, ByHand>
where
    M: MethodOptions,
    M::Method: Send + 'static,
{
    /// Starts, or continues from a checkpoint, and hands the run over.
    ///
    /// # Errors
    /// Options that cannot be used.
    pub fn optimizer(self) -> Result<Optimizer, Error> {
        Optimizer::start(self.description.begin(false, RobustLoss::default(), true)?)
    }
}

impl<M: fmt::Debug, D> fmt::Debug for Minimize<'_, M, D> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Minimize").field(&self.description).finish()
    }
}
