//! A run before it begins: what was said about it, and how that becomes a method, a desk and a checkpoint.

use crate::bounds::Bounds;
use crate::cache::Cache;
use crate::checkpoint::{self, Checkpoint, Writer};
use crate::error::Error;
use crate::evaluate::Desk;
use crate::ledger::Ledger;
use crate::method::{Method, MethodOptions, Setup};
use crate::nelder_mead::NelderMead;
use crate::objective::Outcome;
use crate::scaling::{Kind, Space, Transform};
use crate::termination::{Limits, Tolerances};

/// Everything that can be said about a run but who evaluates.
#[derive(Debug, Default)]
pub(crate) struct Description<M = NelderMead> {
    pub(crate) method: M,
    pub(crate) x0: Option<Vec<f64>>,
    pub(crate) bounds: Option<Bounds>,
    pub(crate) transforms: Vec<Transform>,
    pub(crate) sizes: Vec<f64>,
    pub(crate) tolerances: Tolerances,
    pub(crate) limits: Limits,
    pub(crate) seed: Option<u64>,
    pub(crate) kinds: Vec<Kind>,
    pub(crate) prior: Vec<(Vec<f64>, f64)>,
    pub(crate) cache: Option<usize>,
    pub(crate) trace_limit: Option<usize>,
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
        let Self { cache, trace_limit, checkpoint, workers, .. } = self;
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
            cache,
            trace_limit,
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
        self.limits.fill(self.method.default_limits(space.n_free()));
        let (prior, best) = usable(self.prior, &space);
        if let Some(best) = best {
            space = space.starting_at(&best);
        }
        let n = space.n();
        let discrete = (0..space.n_free()).any(|k| space.kind(k) != Kind::Continuous);
        let default = self.method.default_cache().max(if discrete { 10_000 } else { 0 });
        let capacity = self.cache.unwrap_or(default);
        let setup = Setup {
            tolerances: self.tolerances,
            workers,
            seed: self.seed,
            max_evaluations: self.limits.max_evaluations,
            start_given: start_given || !prior.is_empty(),
            prior,
            ..Setup::new(space)
        };
        let mut cache = Cache::new(capacity);
        for (x, value) in &setup.prior {
            cache.pin(x, &Outcome::Value(*value));
        }
        let mut begun = Begun {
            method: self.method.begin(&setup)?,
            desk: Desk::new(Ledger::new(n, self.trace_limit), cache),
            limits: self.limits,
            workers,
            writer: None,
            observed: None,
            first_recent: 0,
            before: 0.0,
        };
        let Some(options) = self.checkpoint else { return Ok(begun) };
        let words = (begun.method.name(), self.method.describe(), self.method.plans_with_budget());
        let fingerprint = checkpoint::fingerprint(words, &setup, (capacity, self.trace_limit), &options.tags);
        if let Some(stored) = checkpoint::read(&options, &fingerprint, setup.seed, n)? {
            begun.method = self.method.restore(&setup, &stored.method)?;
            begun.desk = Desk::new(stored.ledger, stored.cache);
            (begun.desk.replay, begun.desk.stale) = (stored.replay, stored.stale);
            (begun.observed, begun.first_recent) = (stored.observed, stored.first_recent);
            begun.before = stored.seconds;
        }
        begun.writer = Some(Writer::new(options, fingerprint)?);
        Ok(begun)
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
