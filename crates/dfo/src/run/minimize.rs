//! The entry point: `minimize(f).start(&x0)...run()`.

use crate::error::Error;
use crate::evaluation::{
    BatchFunction, BatchView, Batches, CallingThread, ContextPoller, CutoffUse, Evaluator, OnCallingThread,
    Shared, pools,
};
use crate::method_interface::interface::{Method, MethodOptions};
use crate::method_interface::tolerances::{Limits, Tolerances};
use crate::methods::{AnyMethod, LeastSquares, NelderMead, Nsga2};
use crate::outcome::answer::Outcome;
use crate::outcome::trace::{Trace, TraceEntry};
use crate::problem::constraints::Constraints;
use crate::problem::loss::RobustLoss;
use crate::problem::objective::{Objective, ResidualFunction, residuals};
use crate::problem::space::Bounds;
use crate::run::checkpoint::Checkpoint;
use crate::run::drive::{Around, Drive, Observer};
use crate::run::optimizer::Optimizer;
use crate::run::options::{EvaluatedPoint, RunOptions};
use crate::run::progress::Progress;
use crate::run::report::Report;
use crate::run::requested::RequestedRun;
use crate::run::start::{Description, StartedRun};
use crate::values::choices::{ParameterKind, Search, StopRule, ToleranceMeasure, Transform};
use base::RunContext;
use std::fmt;
use std::marker::PhantomData;
use std::ops::ControlFlow;
use std::time::Duration;

/// Minimises an objective: a closure `Fn(&[f64]) -> f64 + Sync` or any other [`Objective`].
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

/// Minimises a sum of squares of residuals. Short for
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

/// Minimises several criteria at once: searches for their Pareto front by NSGA-II ([`Nsga2`]). The function
/// appends the criteria to the empty vector. Short for
/// `minimize(residuals(function)).method(Nsga2::default())`.
///
/// The criteria take the place of residuals, so every objective with residuals can be used in the same way.
/// Every free parameter requires two finite bounds. The result is [`Report::front`]. Limits of the cost
/// ([`Minimize::target`]) refer to the outcome of an evaluation, which for [`residuals`] is the sum of
/// squares.
///
/// ```
/// // The squared distances to (1, 0) and (-1, 0): the best points are on the line between them.
/// let distances = |x: &[f64], out: &mut Vec<f64>| {
///     out.extend([1.0, -1.0].map(|a: f64| (x[0] - a).powi(2) + x[1] * x[1]));
/// };
/// let report = dfo::pareto(distances).bounds(&[-3.0; 2], &[3.0; 2])?.seed(1).max_evaluations(3000).run()?;
/// let front = report.front.unwrap_or_default();
/// assert_eq!(front.points.len(), 100);
/// // The exact front has 16 - 8/3 = 13.33.
/// assert!(front.hypervolume(&[4.0, 4.0]).is_some_and(|volume| volume > 13.0));
/// let compromise = front.compromise().map(|(point, _)| &point.x);
/// assert!(compromise.is_some_and(|x| x[0].abs() < 0.1));
/// # Ok::<(), dfo::Error>(())
/// ```
pub fn pareto<'a>(function: impl ResidualFunction + 'a) -> Minimize<'a, Nsga2> {
    minimize(residuals(function)).method(Nsga2::default())
}

/// Minimises with a function that evaluates whole batches on the calling thread. Use it for vectorised
/// functions and for your own executor. The function returns one outcome per point, in order.
///
/// [`Minimize::workers`] then sets only the number of points that a batch should have. If the function is
/// interrupted, it returns [`Outcome::Skipped`] for the remaining points, and the run ends. If the function
/// panics, it is called again with each point of the batch separately. The points at which it panics again
/// count as failed.
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

/// Minimises with your own [`Evaluator`], for example an executor, a cluster or a laboratory. The evaluator
/// receives points one by one and answers in any order. Points that the path needs are submitted first. If
/// the evaluator's [`width`](Evaluator::width) allows more, points that may be needed follow.
pub fn minimize_by<'a>(evaluator: impl Evaluator + 'a) -> Minimize<'a, NelderMead> {
    Minimize::new(ByRun::new(Source::Evaluator(Box::new(evaluator))))
}

/// Describes a run that the caller drives point by point. Describe it like a [`minimize`] run and finish with
/// [`optimizer`](Minimize::optimizer).
///
/// [`Minimize::workers`] then sets the number of points that the caller evaluates at once. A batch plan may
/// use this number.
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

/// Driver of a [`Minimize`] whose run evaluates the objective.
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

    /// True if the objective is known to return residuals.
    fn has_residuals(&self) -> bool {
        match &self.source {
            Source::Objective(objective) => objective.has_residuals(),
            Source::Batches(_) | Source::Evaluator(_) => self.has_residuals,
        }
    }

    /// Drives a started run to its end.
    fn run(self, started: StartedRun) -> Result<Report, Error> {
        // The first answer of a batch function shows whether it has residuals.
        let cannot_have_residuals = matches!(self.source, Source::Objective(_)) && !self.has_residuals();
        if started.needs_residuals && cannot_have_residuals {
            return Err(Error::NeedsResiduals { method: started.method.name() });
        }
        let Self { mut source, context, mut observer, cutoff_use, loss, spent, .. } = self;
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
            Source::Objective(objective) => std::thread::scope(|run| match &pools(run, workers)[..] {
                [] => go(&mut CallingThread::new(&**objective)),
                pools => Shared::run(pools, &**objective, signals, here, |threads| go(threads)),
            }),
            Source::Batches(function) => go(&mut Batches::new(function.as_mut(), workers, cutoff_use)),
            Source::Evaluator(evaluator) => go(evaluator),
        }?;
        report.undo(loss);
        Ok(report)
    }
}

/// Driver of a [`Minimize`] whose caller evaluates the points, see [`by_hand`].
#[derive(Debug, Clone, Copy)]
pub struct ByHand;

/// Builder of a minimisation. Created by [`minimize`], [`minimize_batches`], [`minimize_by`] or [`by_hand`];
/// finished by [`run`](Self::run) or [`optimizer`](Self::optimizer).
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
    /// Sets the start point. It must be in the box. It is required unless the method samples its box.
    pub fn start(mut self, x0: &[f64]) -> Self {
        self.description.x0 = Some(x0.to_vec());
        self
    }

    /// Sets lower and upper bounds; default none. An infinite bound means no bound. Equal bounds fix a
    /// parameter. See [`Bounds`] for boxes that are too wide to determine the size of a parameter.
    ///
    /// # Errors
    /// Returns the errors of [`Bounds::new`].
    pub fn bounds(mut self, lower: &[f64], upper: &[f64]) -> Result<Self, Error> {
        self.description.bounds = Some(Bounds::new(lower, upper)?);
        Ok(self)
    }

    /// Sets the method; default Nelder-Mead.
    pub fn method<N: MethodOptions>(self, method: N) -> Minimize<'a, N, D> {
        let Self { description, driver, life } = self;
        Minimize { description: description.with_method(method), driver, life }
    }

    /// Sets the goal of the search. The run chooses a suitable method ([`AnyMethod::chosen_for`]), and the
    /// report contains the method and the reason for the choice.
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

    /// Sets all options at once, including the method.
    pub fn options<N: MethodOptions>(self, options: RunOptions<N>) -> Minimize<'a, N, D> {
        let Self { description, driver, life } = self;
        let Description { x0, bounds, transforms, sizes, kinds, .. } = description;
        Minimize { description: Description { options, x0, bounds, transforms, sizes, kinds }, driver, life }
    }

    /// Sets all options requested by name.
    pub fn requested(self, requested: RequestedRun) -> Minimize<'a, AnyMethod, D> {
        let RequestedRun { options, scale, nominal, kinds } = requested;
        self.options(options).transforms(&scale).optional_scales(&nominal).kinds(&kinds)
    }

    /// Sets the number of evaluations that may run at once. The result does not depend on it. With 1 (the
    /// default), evaluations run on the calling thread. With more, they run on separate threads with 16 MiB
    /// of stack each.
    ///
    /// Evaluations that are too short to be worth a transfer stay on the calling thread. The first evaluation
    /// also runs there, to measure its duration, unless the [`context`](Self::context) has a function.
    pub fn workers(mut self, workers: usize) -> Self {
        self.description.options.workers = Some(workers);
        self
    }

    /// Sets the limit of evaluations of the path, at least 1. The limit is exact even within a batch.
    ///
    /// If none of the three limits (evaluations, iterations, time) is set, the method's defaults apply
    /// ([`MethodOptions::default_limits`]). For Nelder-Mead, these are `1000 (n + 1)` iterations or
    /// `5000 (n + 1)` evaluations for `n` free parameters. Setting one limit removes these defaults.
    pub fn max_evaluations(mut self, n: usize) -> Self {
        self.description.options.limits.max_evaluations = Some(n);
        self
    }

    /// Sets the limit of iterations; 0 evaluates only the starting points.
    pub fn max_iterations(mut self, n: usize) -> Self {
        self.description.options.limits.max_iterations = Some(n);
        self
    }

    /// Sets the limit of wall-clock time. No evaluation starts after it. Evaluations that are running at that
    /// time see [`Query::cancelled`](crate::Query::cancelled).
    pub fn max_time(mut self, time: Duration) -> Self {
        self.description.options.limits.max_time = Some(time);
        self
    }

    /// Ends the run at the first evaluation of the path with a cost at or below `cost`, see
    /// [`Limits::target`].
    pub fn target(mut self, cost: f64) -> Self {
        self.description.options.limits.target = Some(cost);
        self
    }

    /// Ends the run if more than this fraction of its evaluations has failed, see [`Limits::max_failed`].
    pub fn max_failed(mut self, share: f64) -> Self {
        self.description.options.limits.max_failed = Some(share);
        self
    }

    /// Disables the method's default limits if no limit is set.
    pub fn unlimited(mut self) -> Self {
        self.description.options.unlimited = true;
        self
    }

    /// Sets all limits at once.
    pub fn limits(mut self, limits: Limits) -> Self {
        self.description.options.limits = limits;
        self
    }

    /// Sets all tolerances at once.
    pub fn tolerances(mut self, tolerances: Tolerances) -> Self {
        self.description.options.tolerances = tolerances;
        self
    }

    /// Sets the tolerance of the x test, see [`Tolerances`]; default 1e-6.
    pub fn x_tol(mut self, tolerance: f64) -> Self {
        self.description.options.tolerances.x_tol = tolerance;
        self
    }

    /// Sets the tolerance of the f test, see [`Tolerances`]; default 1e-6.
    pub fn f_tol(mut self, tolerance: f64) -> Self {
        self.description.options.tolerances.f_tol = tolerance;
        self
    }

    /// Sets relative (default) or absolute tolerances.
    pub fn measure(mut self, measure: ToleranceMeasure) -> Self {
        self.description.options.tolerances.measure = measure;
        self
    }

    /// Sets the stop rule: both tests must pass (default), or either one.
    pub fn stop(mut self, stop: StopRule) -> Self {
        self.description.options.tolerances.stop = stop;
        self
    }

    /// Sets the typical sizes of the parameters, which are positive. They are the unit of a relative `x_tol`.
    /// The size of a logarithmic parameter is in units of `ln x`. Default: see
    /// [`typical_size`](crate::typical_size); otherwise a size that the method estimates (see
    /// [`InitialSimplex::Auto`](crate::InitialSimplex::Auto)).
    pub fn scales(self, sizes: &[f64]) -> Self {
        let sizes: Vec<_> = sizes.iter().copied().map(Some).collect();
        self.optional_scales(&sizes)
    }

    /// Sets the typical sizes of some parameters. `None` selects the default, see [`scales`](Self::scales).
    pub fn optional_scales(mut self, sizes: &[Option<f64>]) -> Self {
        self.description.sizes = sizes.to_vec();
        self
    }

    /// Sets the seed of the random numbers, for methods that draw random numbers. By default, a seed is drawn
    /// and reported.
    pub fn seed(mut self, seed: u64) -> Self {
        self.description.options.seed = Some(seed);
        self
    }

    /// Sets the identity of the problem: a word or a hash that the caller vouches for. It must represent
    /// everything that a cost depends on except the point: model, data and settings, but neither bounds nor
    /// start. Costs from other runs are used only if they belong to the same problem. A checkpoint of another
    /// problem is rejected.
    pub fn problem(mut self, identity: impl Into<String>) -> Self {
        self.description.options.problem = Some(identity.into());
        self
    }

    /// Starts from the points of an earlier run. Points outside the box and points with other values of the
    /// fixed parameters are left out. Points that failed or were abandoned above a cutoff are also left out.
    /// The best remaining point is the start point, and populations begin with the best remaining points.
    /// With nonlinear constraints, points without the values of all constraints are left out, and feasible
    /// points rank first.
    ///
    /// If both runs have the same [`problem`](Self::problem), none of these points is evaluated again.
    /// Otherwise, their costs only determine where to start.
    pub fn warm_start(self, trace: &Trace) -> Self {
        let problem = trace.problem().map(str::to_owned);
        let point_of = |e: TraceEntry<'_>| {
            let (cost, residuals) = (e.outcome.value()?, e.residuals.to_vec());
            let (x, constraints) = (e.x.to_vec(), e.constraints.to_vec());
            Some(EvaluatedPoint { x, cost, residuals, constraints, problem: problem.clone() })
        };
        self.evaluated_points(trace.iter().filter_map(point_of))
    }

    /// Starts from points of any origin, like [`warm_start`](Self::warm_start). Points whose costs are not
    /// finite are left out.
    pub fn evaluated_points(mut self, points: impl IntoIterator<Item = EvaluatedPoint>) -> Self {
        self.description.options.evaluated.extend(points);
        self
    }

    /// Sets the number of evaluations to remember, so that exact repeats cost nothing. 0 disables the cache.
    /// Default: the method's ([`MethodOptions::default_cache`]), and at least 10 000 with discrete
    /// parameters.
    pub fn cache(mut self, evaluations: usize) -> Self {
        self.description.options.cache = Some(evaluations);
        self
    }

    /// Keeps only the last `evaluations` entries in the trace. During the run, the trace may contain twice as
    /// many, or 64 more if that is larger.
    pub fn trace_limit(mut self, evaluations: usize) -> Self {
        self.description.options.trace_limit = Some(evaluations);
        self
    }

    /// Also keeps residuals in the trace, for the points at which the method requested them.
    pub fn trace_residuals(mut self) -> Self {
        self.description.options.trace_residuals = true;
        self
    }

    /// Writes the state of the run to a file. If the file exists, the run continues from it.
    pub fn checkpoint(mut self, checkpoint: Checkpoint) -> Self {
        self.description.options.checkpoint = Some(checkpoint);
        self
    }

    /// Sets the kind of each parameter: continuous, integer or categorical. Default: all continuous. Not
    /// every method supports the other kinds.
    pub fn kinds(mut self, kinds: &[ParameterKind]) -> Self {
        self.description.kinds = kinds.to_vec();
        self
    }

    /// Sets constraints beyond bounds. The objective returns the values of the nonlinear ones, see
    /// [`constrained`](crate::constrained).
    ///
    /// ```
    /// use dfo::{Constraints, LinearConstraint, QuadraticModel, minimize};
    ///
    /// let sum = LinearConstraint { coefficients: vec![1.0, 1.0], lower: 1.0, upper: 1.0 };
    /// let report = minimize(|x: &[f64]| x[0] * x[0] + 2.0 * x[1] * x[1])
    ///     .start(&[0.0, 0.0])
    ///     .constraints(Constraints { linear: vec![sum], ..Constraints::default() })
    ///     .method(QuadraticModel::default())
    ///     .run()?;
    /// assert!((report.x[0] - 2.0 / 3.0).abs() < 1e-5 && (report.x[1] - 1.0 / 3.0).abs() < 1e-5);
    /// # Ok::<(), dfo::Error>(())
    /// ```
    pub fn constraints(mut self, constraints: Constraints) -> Self {
        self.description.options.constraints = constraints;
        self
    }

    /// Sets the scale of each parameter: linear or logarithmic. Default: all linear.
    pub fn transforms(mut self, transforms: &[Transform]) -> Self {
        self.description.transforms = transforms.to_vec();
        self
    }
}

impl<'a, M> Minimize<'a, M> {
    /// Sets a function that is called on the calling thread after the starting points and after each
    /// iteration. `Break` ends the run.
    pub fn observer(mut self, observer: impl FnMut(&Progress<'_>) -> ControlFlow<()> + 'a) -> Self {
        self.driver.observer = Some(Box::new(observer));
        self
    }

    /// Sets the context that may interrupt the run. After an interrupt, no further evaluation starts, and
    /// running ones see [`Query::cancelled`](crate::Query::cancelled). The function of the context is called
    /// on the calling thread between evaluations; with workers, at least every 50 ms. Several runs can share
    /// a flag. If the remaining time of the context is shorter than [`max_time`](Self::max_time), it ends the
    /// run in the same way.
    pub fn context(mut self, context: RunContext<'a>) -> Self {
        self.driver.context = context;
        self
    }

    /// Declares whether a function of [`minimize_batches`] stops early above cutoffs. If it does, every cost
    /// above its cutoff counts as abandoned, whichever code evaluates the point.
    pub fn cutoff_use(mut self, cutoff_use: CutoffUse) -> Self {
        self.driver.cutoff_use = cutoff_use;
        self
    }

    /// Declares whether your [`Evaluator`] provides residuals. If it does, a method that is chosen for the
    /// problem may request them.
    pub fn with_residuals(mut self, has_residuals: bool) -> Self {
        self.driver.has_residuals = has_residuals;
        self
    }

    /// Sets the loss that a function of [`minimize_batches`] has already applied to its residuals
    /// ([`RobustLoss::transform`]). The [`Report`] then contains the plain residuals.
    pub fn loss(mut self, loss: RobustLoss) -> Self {
        self.driver.loss = loss;
        self
    }

    /// Sets the part of the time limit ([`max_time`](Self::max_time)) already used before the run begins. If
    /// the run ends at the limit, its message reports the whole limit.
    pub fn spent(mut self, time: Duration) -> Self {
        self.driver.spent = time;
        self
    }
}

impl<M: MethodOptions> Minimize<'_, M> {
    /// Runs the minimisation.
    ///
    /// # Errors
    /// Returns an error if options are unusable, or if the objective failed at every starting point. Also
    /// returns an error if the run ended before any point had a finite cost. Every other end returns a
    /// [`Report`].
    pub fn run(mut self) -> Result<Report, Error> {
        let (options, driver) = (&mut self.description.options, self.driver);
        if let Source::Evaluator(evaluator) = &driver.source {
            options.workers = Some(evaluator.width().max(1));
        }
        if let Some(checkpoint) = options.checkpoint.as_mut().filter(|_| !driver.loss.is_linear()) {
            checkpoint.tags.push(("loss".to_owned(), driver.loss.to_string()));
        }
        let started = self.description.begin(driver.has_residuals(), driver.loss, false)?;
        driver.run(started)
    }
}

impl<M: MethodOptions> Minimize<'_, M, ByHand> {
    /// Starts the run, or continues it from a checkpoint, and returns its optimizer.
    ///
    /// # Errors
    /// Returns an error if options are unusable.
    pub fn optimizer(self) -> Result<Optimizer, Error> {
        Optimizer::start(self.description.begin(false, RobustLoss::default(), true)?)
    }
}

impl<M: fmt::Debug, D> fmt::Debug for Minimize<'_, M, D> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Minimize").field(&self.description).finish()
    }
}
