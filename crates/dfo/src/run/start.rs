//! Description of a run, and its conversion to a method, a round and a checkpoint.

use crate::error::Error;
use crate::evaluation::counted_batch::CountedBatch;
use crate::evaluation::ledger::Ledger;
use crate::evaluation::store::Store;
use crate::method_interface::interface::{Method, MethodOptions, ProblemClass, Setup};
use crate::method_interface::tolerances::Limits;
use crate::methods::{BoxedMethod, NelderMead};
use crate::outcome::answer::{Answer, Outcome};
use crate::problem::constraints::Constraints;
use crate::problem::loss::RobustLoss;
use crate::problem::option_texts;
use crate::problem::space::Bounds;
use crate::problem::space::Space;
use crate::run::checkpoint::{self, Writer};
use crate::run::options::{EvaluatedPoint, RunOptions};
use crate::run::report::Resumed;
use crate::values::choices::{ParameterKind, Search, Transform};

/// Complete description of a run except for the evaluator.
#[derive(Debug, Default)]
pub(crate) struct Description<M = NelderMead> {
    pub(crate) options: RunOptions<M>,
    pub(crate) x0: Option<Vec<f64>>,
    pub(crate) bounds: Option<Bounds>,
    pub(crate) transforms: Vec<Transform>,
    pub(crate) sizes: Vec<Option<f64>>,
    pub(crate) kinds: Vec<ParameterKind>,
}

/// A run that is ready to be driven.
#[derive(Debug)]
pub(crate) struct StartedRun {
    pub(crate) method: BoxedMethod,
    pub(crate) round: CountedBatch,
    pub(crate) limits: Limits,
    pub(crate) workers: usize,
    pub(crate) writer: Option<Writer>,
    pub(crate) observed: Option<usize>,
    pub(crate) first_recent: usize,
    /// Seconds of the run before it was resumed.
    pub(crate) before: f64,
    /// True if the method needs residuals. The next field is the reason why the method was chosen.
    pub(crate) needs_residuals: bool,
    pub(crate) method_reason: Option<String>,
    /// Options of the method and tolerances as text.
    pub(crate) options: Vec<(String, String)>,
    /// Checkpoint from which the run was continued.
    pub(crate) resumed: Option<Resumed>,
}

impl<M> Description<M> {
    /// Returns the description with another method.
    pub(crate) fn with_method<N>(self, method: N) -> Description<N> {
        let Self { options, x0, bounds, transforms, sizes, kinds } = self;
        Description { options: options.with_method(method), x0, bounds, transforms, sizes, kinds }
    }
}

impl<M: MethodOptions> Description<M> {
    /// Chooses the method for this problem, if the choice is open.
    fn choose(&mut self, residuals: bool) -> Result<(), Error> {
        let n = self.bounds.as_ref().map_or(self.x0.as_ref().map_or(0, Vec::len), Bounds::len);
        let unbounded = Bounds::unbounded(n);
        let bounds = self.bounds.as_ref().unwrap_or(&unbounded);
        let (lower, upper) = (bounds.lower(), bounds.upper());
        // Fixed parameters do not affect the choice.
        let kind = |(i, kind): (usize, &ParameterKind)| {
            if lower.get(i) == upper.get(i) { ParameterKind::Continuous } else { *kind }
        };
        let kinds: Vec<ParameterKind> = self.kinds.iter().enumerate().map(kind).collect();
        let constraints = &self.options.constraints;
        let class = ProblemClass {
            lower,
            upper,
            kinds: &kinds,
            residuals,
            search: Search::Local,
            linear: !constraints.linear.is_empty(),
            nonlinear: !constraints.nonlinear.is_empty(),
            equalities: constraints.has_equalities(),
        };
        self.options.choose(&class)
    }

    /// Checks all options and starts or continues the run. `residuals` is true if the objective is known to
    /// return residuals, and `loss` has already been applied to them. `by_hand` is true if the caller
    /// supplies the answers.
    pub(crate) fn begin(
        mut self,
        residuals: bool,
        loss: RobustLoss,
        by_hand: bool,
    ) -> Result<StartedRun, Error> {
        self.choose(residuals)?;
        let Self { options, x0, bounds, transforms, sizes, kinds } = self;
        let (method, mut limits) = (&options.method, options.limits);
        let start_given = x0.is_some();
        let x0 = match (x0, &bounds) {
            (Some(x0), _) => x0,
            (None, Some(bounds)) if !method.needs_start() => {
                let Some(middle) = middle(bounds, &transforms, &kinds) else {
                    return Err(open_box(method, bounds));
                };
                middle
            }
            (None, _) => return Err(Error::NoStart),
        };
        let bounds = bounds.unwrap_or_else(|| Bounds::unbounded(x0.len()));
        let mut space = Space::new(&x0, bounds, &transforms, &sizes)?;
        if !kinds.is_empty() {
            space = space.with_kinds(&kinds)?;
        }
        options.check()?;
        options.constraints.check(x0.len())?;
        space = space.with_linear(&options.constraints.linear)?;
        if !options.unlimited {
            let (evaluations, iterations) = method.default_limits(space.n_free());
            limits.fill(evaluations, iterations);
        }
        let prior = usable(&options.evaluated, &space, &options.constraints);
        let is_inside = |x: &[f64]| !method.starts_inside() || space.is_inside(x);
        let best = prior.iter().find(|point| is_inside(&point.x)).map(|point| point.x.clone());
        let start_given = start_given || best.is_some();
        if let Some(best) = best {
            space = space.starting_at(&best);
        }
        let n = space.n();
        let discrete = (0..space.n_free()).any(|k| space.kind(k) != ParameterKind::Continuous);
        let default = method.default_cache().max(if discrete { 10_000 } else { 0 });
        let capacity = options.cache.unwrap_or(default);
        let setup = Setup {
            tolerances: options.tolerances,
            seed: options.seed,
            max_evaluations: limits.max_evaluations,
            start_given,
            prior: prior.iter().map(|point| point.x.clone()).collect(),
            loss,
            constraints: Constraints { linear: Vec::new(), ..options.constraints.clone() },
            workers: options.workers.unwrap_or(1),
            ..Setup::new(space)
        };
        let mut store = Store::new(capacity);
        // A cost without a problem identity does not belong to any problem.
        let belongs = |point: &&EvaluatedPoint| options.problem.is_some() && point.problem == options.problem;
        for EvaluatedPoint { x, cost, residuals, constraints, .. } in prior.iter().copied().filter(belongs) {
            let (residuals, constraints) = (residuals.clone(), constraints.clone());
            store.pin(x, Answer { residuals, constraints, ..Outcome::Value(*cost).into() });
        }
        let mut started = StartedRun {
            method: BoxedMethod::new(begin(method, &setup, &options.constraints)?),
            round: CountedBatch::new(Ledger::new(n, options.trace_limit, options.trace_residuals), store),
            limits,
            workers: options.workers.unwrap_or(1),
            writer: None,
            observed: None,
            first_recent: 0,
            before: 0.0,
            needs_residuals: method.needs_residuals(),
            method_reason: options.method_reason,
            options: (method.describe().into_iter().chain(option_texts::fields(&options.tolerances)))
                .map(|(name, value)| (checkpoint::words(&name).to_owned(), value))
                .collect(),
            resumed: None,
        };
        started.round.ledger.constraints = setup.constraints.clone();
        started.round.ledger.trace.set_problem(options.problem.clone());
        let Some(place) = options.checkpoint else { return Ok(started) };
        let words = (started.method.name(), method.describe(), method.plans_with_budget());
        let fingerprint = checkpoint::fingerprint(
            words,
            &setup,
            (capacity, options.trace_limit, started.round.store.n_pinned()),
            (options.problem.as_deref(), &place),
        );
        if let Some(stored) = checkpoint::read(&place, &fingerprint, setup.seed, n)? {
            started.method = BoxedMethod::new(method.restore(&setup, &stored.method)?);
            started.round = CountedBatch::new(stored.ledger.into_owned(), stored.store.into_owned());
            started.round.ledger.constraints = setup.constraints.clone();
            started.round.store.forget_aborts();
            started.round.stale = stored.stale;
            let n_finished = stored.finished.len();
            for finished_evaluation in stored.finished.into_owned() {
                started.round.store.keep(finished_evaluation);
            }
            (started.observed, started.first_recent) = (stored.observed, stored.first_recent);
            started.before = stored.seconds;
            let n_evaluations = started.round.ledger.n_evaluations + n_finished;
            started.resumed = Some(Resumed { path: place.path.clone(), n_evaluations });
        }
        started.writer = Some(Writer::new(place, fingerprint, by_hand)?);
        Ok(started)
    }
}

/// Returns the error for a box without a middle. If the method requires a finite box, its error names the
/// bound; otherwise the start is missing.
fn open_box<M: MethodOptions>(method: &M, bounds: &Bounds) -> Error {
    let inside =
        bounds.lower().iter().zip(bounds.upper()).map(|(lower, upper)| 0.0_f64.max(*lower).min(*upper));
    let space = Space::new(&inside.collect::<Vec<f64>>(), bounds.clone(), &[], &[]);
    match space.and_then(|space| method.begin(&Setup::new(space)).map(drop)) {
        Err(error @ Error::NeedsBox { .. }) => error,
        _ => Error::NoStart,
    }
}

/// Methods that support each kind of constraints, for messages.
const FOR_LINEAR: &str = "least-squares, quadratic-model, cma-es, de, ga, nelder-mead or pattern-search";
const FOR_NONLINEAR: &str = "quadratic-model, cma-es, de, ga or multistart";
const FOR_EQUALITIES: &str = "quadratic-model, cma-es or multistart";

/// Starts a method that supports the constraints.
fn begin<M: MethodOptions>(
    options: &M,
    setup: &Setup,
    constraints: &Constraints,
) -> Result<M::Method, Error> {
    let method = options.begin(setup)?;
    let unsupported =
        |kind, use_instead| Err(Error::NoConstraints { method: method.name(), kind, use_instead });
    if !constraints.linear.is_empty() && !options.supports_linear() {
        return unsupported("linear", FOR_LINEAR);
    }
    if !constraints.nonlinear.is_empty() && !options.supports_nonlinear() {
        return unsupported("nonlinear", FOR_NONLINEAR);
    }
    // Populations of discrete points can satisfy equalities.
    let space = &setup.space;
    let has_continuous = (0..space.n_free()).any(|k| space.kind(k) == ParameterKind::Continuous);
    if constraints.has_equalities() && has_continuous && !options.supports_equalities() {
        return unsupported("nonlinear equality", FOR_EQUALITIES);
    }
    Ok(method)
}

/// Returns the points of earlier runs that are in this space and have the values of all nonlinear
/// constraints, without duplicates, best first.
fn usable<'a>(
    evaluated: &'a [EvaluatedPoint],
    space: &Space,
    constraints: &Constraints,
) -> Vec<&'a EvaluatedPoint> {
    let discrete: Vec<usize> = (0..space.n_free())
        .filter(|&k| space.kind(k) != ParameterKind::Continuous)
        .map(|k| space.free()[k])
        .collect();
    let is_inside = |point: &&EvaluatedPoint| {
        space.admits(&point.x)
            && discrete.iter().all(|&i| point.x[i] == point.x[i].round())
            && point.constraints.len() == constraints.nonlinear.len()
            && constraints.violation(&point.constraints).is_finite()
            && !constraints.forbids(&point.constraints)
    };
    let mut prior: Vec<&EvaluatedPoint> =
        evaluated.iter().filter(|point| point.cost.is_finite()).filter(is_inside).collect();
    let rank = |point: &EvaluatedPoint| constraints.rank(&point.constraints);
    prior.sort_by(|a, b| rank(a).total_cmp(&rank(b)).then(a.cost.total_cmp(&b.cost)));
    prior.dedup_by(|a, b| a.x == b.x && a.problem == b.problem);
    prior
}

/// Returns the middle of a box, for runs without a start point. `None` if the box has no finite middle.
fn middle(bounds: &Bounds, transforms: &[Transform], kinds: &[ParameterKind]) -> Option<Vec<f64>> {
    (0..bounds.len())
        .map(|i| {
            let (lower, upper) = (bounds.lower()[i], bounds.upper()[i]);
            let middle = match transforms.get(i) {
                Some(Transform::Log) if lower > 0.0 => (0.5 * lower.ln() + 0.5 * upper.ln()).exp(),
                _ => 0.5 * lower + 0.5 * upper,
            };
            let whole = lower != upper && kinds.get(i).is_some_and(|k| *k != ParameterKind::Continuous);
            let middle = if whole { middle.floor().max(lower.ceil()) } else { middle };
            middle.is_finite().then(|| middle.clamp(lower, upper))
        })
        .collect()
}
