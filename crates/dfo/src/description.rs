//! A run before it begins: what was said about it, and how that becomes a method, a desk and a checkpoint.

use crate::answer::{Answer, Outcome};
use crate::checkpoint::{self, Checkpoint, Writer};
use crate::choices::{Kind, Transform};
use crate::error::Error;
use crate::gateway::cache::Cache;
use crate::gateway::desk::Desk;
use crate::gateway::ledger::Ledger;
use crate::method::{Method, MethodOptions, Setup};
use crate::methods::NelderMead;
use crate::space::Bounds;
use crate::space::Space;
use crate::tolerances::{Limits, Tolerances};
use serde::{Deserialize, Serialize};

/// A point with its cost, and the problem that they belong to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Known {
    /// The point, in the user's units.
    pub x: Vec<f64>,
    /// Its cost.
    pub cost: f64,
    /// Its residuals; empty where they are not known.
    pub residuals: Vec<f64>,
    /// What the cost belongs to; of another problem, or of none in particular, it only says where to start.
    pub problem: Option<String>,
}

/// Everything that can be said about a run but who evaluates.
#[derive(Debug, Default)]
pub(crate) struct Description<M = NelderMead> {
    pub(crate) method: M,
    pub(crate) x0: Option<Vec<f64>>,
    pub(crate) bounds: Option<Bounds>,
    pub(crate) transforms: Vec<Transform>,
    pub(crate) sizes: Vec<Option<f64>>,
    pub(crate) tolerances: Tolerances,
    pub(crate) limits: Limits,
    pub(crate) seed: Option<u64>,
    pub(crate) kinds: Vec<Kind>,
    pub(crate) prior: Vec<Known>,
    pub(crate) problem: Option<String>,
    /// No limit is what the user said: the method's defaults do not step in.
    pub(crate) unlimited: bool,
    pub(crate) cache: Option<usize>,
    pub(crate) trace_limit: Option<usize>,
    pub(crate) trace_residuals: bool,
    pub(crate) checkpoint: Option<Checkpoint>,
    pub(crate) workers: Option<usize>,
}

/// A run that can be driven.
#[derive(Debug)]
pub(crate) struct Begun<T> {
    pub(crate) method: T,
    pub(crate) desk: Desk,
    pub(crate) limits: Limits,
    pub(crate) workers: usize,
    pub(crate) writer: Option<Writer>,
    pub(crate) observed: Option<usize>,
    pub(crate) first_recent: usize,
    /// Seconds of the run before it was resumed.
    pub(crate) before: f64,
}

impl<M> Description<M> {
    /// The same run with another method.
    pub(crate) fn with_method<N>(self, method: N) -> Description<N> {
        let Self { x0, bounds, transforms, sizes, tolerances, limits, seed, kinds, prior, .. } = self;
        let Self { problem, unlimited, cache, trace_limit, trace_residuals, checkpoint, workers, .. } = self;
        Description {
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
            problem,
            unlimited,
            cache,
            trace_limit,
            trace_residuals,
            checkpoint,
            workers,
        }
    }
}

impl<M: MethodOptions> Description<M> {
    /// Checks everything, and starts or continues.
    pub(crate) fn begin(mut self) -> Result<Begun<M::Method>, Error> {
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
        let workers = self.workers.unwrap_or(1);
        if workers == 0 {
            return Err(Error::Option { name: "workers", value: 0.0, range: "at least 1" });
        }
        if !self.unlimited {
            self.limits.fill(self.method.default_limits(space.n_free()));
        }
        let prior = usable(self.prior, &space);
        let is_inside = |x: &[f64]| !self.method.starts_inside() || space.is_inside(x);
        let best = prior.iter().find(|known| is_inside(&known.x)).map(|known| known.x.clone());
        let start_given = start_given || best.is_some();
        if let Some(best) = best {
            space = space.starting_at(&best);
        }
        let n = space.n();
        let discrete = (0..space.n_free()).any(|k| space.kind(k) != Kind::Continuous);
        let default = self.method.default_cache().max(if discrete { 10_000 } else { 0 });
        let capacity = self.cache.unwrap_or(default);
        let setup = Setup {
            tolerances: self.tolerances,
            seed: self.seed,
            max_evaluations: self.limits.max_evaluations,
            start_given,
            prior: prior.iter().map(|known| known.x.clone()).collect(),
            ..Setup::new(space)
        };
        let mut cache = Cache::new(capacity);
        // A cost of no problem in particular is a cost of none.
        let belongs = |known: &&Known| self.problem.is_some() && known.problem == self.problem;
        for Known { x, cost, residuals, .. } in prior.iter().filter(belongs) {
            cache.pin(x, Answer { residuals: residuals.clone(), ..Outcome::Value(*cost).into() });
        }
        let mut begun = Begun {
            method: self.method.begin(&setup)?,
            desk: Desk::new(Ledger::new(n, self.trace_limit, self.trace_residuals), cache),
            limits: self.limits,
            workers,
            writer: None,
            observed: None,
            first_recent: 0,
            before: 0.0,
        };
        begun.desk.ledger.trace.set_problem(self.problem.clone());
        let Some(options) = self.checkpoint else { return Ok(begun) };
        let words = (begun.method.name(), self.method.describe(), self.method.plans_with_budget());
        let fingerprint = checkpoint::fingerprint(
            words,
            &setup,
            (capacity, self.trace_limit, begun.desk.cache.n_pinned()),
            (self.problem.as_deref(), &options.tags),
        );
        if let Some(stored) = checkpoint::read(&options, &fingerprint, setup.seed, n)? {
            begun.method = self.method.restore(&setup, &stored.method)?;
            begun.desk = Desk::new(stored.ledger, stored.cache);
            begun.desk.ledger.ahead.forget_aborts();
            (begun.desk.replay, begun.desk.stale) = (stored.replay, stored.stale);
            (begun.observed, begun.first_recent) = (stored.observed, stored.first_recent);
            begun.before = stored.seconds;
        }
        begun.writer = Some(Writer::new(options, fingerprint)?);
        Ok(begun)
    }
}

/// The points of earlier runs that lie in this space, each once, the best first of its problem.
fn usable(mut prior: Vec<Known>, space: &Space) -> Vec<Known> {
    let discrete: Vec<usize> =
        (0..space.n_free()).filter(|&k| space.kind(k) != Kind::Continuous).map(|k| space.free()[k]).collect();
    prior.retain(|known| {
        space.bounds().contains(&known.x) && discrete.iter().all(|&i| known.x[i] == known.x[i].round())
    });
    prior.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    prior.dedup_by(|a, b| a.x == b.x && a.problem == b.problem);
    prior
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
