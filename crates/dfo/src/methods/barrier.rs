//! Sequential barrier method: Nelder-Mead on the cost plus a barrier term that decreases from stage to stage.
//!
//! Stage `k` minimises `f(x) + mu_k B(x)` from the result of the previous stage. The barrier is `B(x) = sum
//! s_i / (x_i - lower_i) + s_i / (upper_i - x_i)` over the finite bounds (Carroll, Oper. Res. 9, 1961). `s_i`
//! is the size of the parameter. Parameters on a logarithmic scale enter `B` with their logarithm. `B` is
//! positive, so a partial sum of the cost plus the barrier can be compared with a cutoff.
//!
//! By default, each stage uses a tenth of the previous barrier parameter. It also uses a smaller first
//! simplex and tighter tolerances. The method ends if three conditions hold:
//!
//! - The tests of Nelder-Mead pass at the user's tolerances.
//! - The stage has moved the point by at most `x_tol`.
//! - `mu B` is at most `f_tol` of the cost (of the first cost, if that is larger).

use crate::error::Error;
use crate::method_interface::interface::{
    AnswersSoFar, BarrierStage, Batch, Lookahead, Method, MethodDetails, MethodOptions, Operation, Setup,
    Status, restored, saved,
};
use crate::method_interface::tolerances::Tolerances;
use crate::methods::nelder_mead::{Coefficients, NelderMead, NelderMeadState};
use crate::outcome::answer::{Answers, Best, Outcome};
use crate::outcome::termination::Termination;
use crate::problem::option_texts;
use crate::problem::space::Bounds;
use crate::problem::space::Space;
use crate::values::choices::ToleranceMeasure;
use serde::{Deserialize, Serialize};

/// Minimum distance from a bound, in units of the width of the box. Without a box, in units of the parameter
/// size.
const MARGIN: f64 = 1e-10;
/// Maximum term of `B`, and maximum barrier parameter. These limits keep their product finite.
const MAX_TERM: f64 = 1e100;
const MAX_MU: f64 = 1e200;
/// Maximum number of stages. After 40 stages, the barrier is below the resolution of 53-bit numbers.
const MAX_STAGES: usize = 40;

/// Options of the sequential barrier method. The method requires a start strictly inside the bounds, and at
/// least one bound.
///
/// ```
/// let report = dfo::minimize(|x: &[f64]| (x[0] - 2.0).powi(2) + (x[1] + 1.0).powi(2))
///     .start(&[0.5, 0.5])
///     .bounds(&[0.0, -2.0], &[1.0, f64::INFINITY])?
///     .method(dfo::Barrier::default())
///     .run()?;
/// assert!((report.x[0] - 1.0).abs() < 1e-5 && (report.x[1] + 1.0).abs() < 1e-3);
/// assert!(report.schedule.windows(2).all(|w| w[1].mu < w[0].mu));
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Barrier {
    /// First barrier parameter, positive and at most 1e200. By default, the barrier is a tenth of the cost at
    /// the start.
    pub mu: Option<f64>,
    /// Factor by which the barrier parameter is multiplied after each stage; default 0.1.
    pub factor: f64,
    /// Batch plan of Nelder-Mead.
    pub batch: Lookahead,
    /// Coefficients of Nelder-Mead.
    pub coefficients: Coefficients,
}

impl Default for Barrier {
    fn default() -> Self {
        Self { mu: None, factor: 0.1, batch: Lookahead::Measured, coefficients: Coefficients::Auto }
    }
}

impl Barrier {
    /// Sets the first barrier parameter.
    #[must_use]
    pub fn mu(mut self, mu: f64) -> Self {
        self.mu = Some(mu);
        self
    }

    /// Sets the factor by which the barrier parameter is multiplied after each stage.
    #[must_use]
    pub fn factor(mut self, factor: f64) -> Self {
        self.factor = factor;
        self
    }

    /// Sets the number of points that are evaluated at once.
    #[must_use]
    pub fn batch(mut self, points: Lookahead) -> Self {
        self.batch = points;
        self
    }

    /// Sets the coefficients of Nelder-Mead.
    #[must_use]
    pub fn coefficients(mut self, coefficients: Coefficients) -> Self {
        self.coefficients = coefficients;
        self
    }

    /// Returns the method used in the stages.
    fn inner(&self) -> NelderMead {
        NelderMead::default().batch(self.batch).coefficients(self.coefficients)
    }
}

impl MethodOptions for Barrier {
    type Method = BarrierState;

    fn begin(&self, setup: &Setup) -> Result<BarrierState, Error> {
        let space = &setup.space;
        space.require_continuous("barrier")?;
        self.batch.check()?;
        if let Some(value) = self.mu.filter(|mu| !(*mu > 0.0 && *mu <= MAX_MU)) {
            return Err(Error::Option { name: "mu", value, range: "positive, at most 1e200" });
        }
        if !(self.factor > 0.0 && self.factor < 1.0) {
            return Err(Error::Option { name: "factor", value: self.factor, range: "between 0 and 1" });
        }
        let mut bounded = false;
        for &index in space.free() {
            let (lower, upper) = (space.bounds().lower()[index], space.bounds().upper()[index]);
            let value = space.x0()[index];
            if value <= lower || value >= upper {
                return Err(Error::StartNotInterior { index, value, lower, upper });
            }
            bounded |= lower.is_finite() || upper.is_finite();
        }
        if !bounded && space.n_free() > 0 {
            return Err(Error::NoBounds { method: "barrier" });
        }
        let setup = Setup { space: space.without_far_bounds(), ..setup.clone() };
        let inner = inner_setup(&setup, space.x0(), 0);
        Ok(BarrierState {
            inner: self.inner().begin(&inner)?,
            mu: self.mu,
            options: self.clone(),
            setup,
            requested: Batch::new(),
            cutoffs: Vec::new(),
            translated: Answers::default(),
            working: vec![0.0; space.n_free()],
            best: Best::default(),
            schedule: Vec::new(),
            stage_start: space.x0().to_vec(),
            n_stage: 0,
            n_batches: 0,
            n_points: 0,
            n_iterations: 0,
            f_0: 0.0,
            ended: None,
        })
    }

    fn starts_inside(&self) -> bool {
        true
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<BarrierState, Error> {
        restored(state, |s: &BarrierState| s.options == *self && s.is_sound(setup))
    }
}

/// Returns the setup of a stage. Its bounds are slightly inside the user's bounds. Its tolerances tighten
/// from stage to stage.
fn inner_setup(setup: &Setup, start: &[f64], stage: usize) -> Setup {
    let space = &setup.space;
    let (mut lower, mut upper) = (space.bounds().lower().to_vec(), space.bounds().upper().to_vec());
    let (mut transforms, mut sizes) = (vec![Default::default(); space.n()], vec![None; space.n()]);
    for (k, &i) in space.free().iter().enumerate() {
        (transforms[i], sizes[i]) = (space.transform(k), Some(space.size(k)));
        let width = upper[i] - lower[i];
        let step = |bound: f64| {
            if space.width(k).is_some() && width.is_finite() {
                MARGIN * width
            } else {
                MARGIN * bound.abs().max(space.size(k))
            }
        };
        // A start that is nearer to the bound than the margin may approach it to half that distance.
        let (low, high) = space.limits_of(k);
        if low.is_finite() {
            lower[i] = (lower[i] + step(lower[i])).min(0.5 * lower[i] + 0.5 * start[i]);
        }
        if high.is_finite() {
            upper[i] = (upper[i] - step(upper[i])).max(0.5 * upper[i] + 0.5 * start[i]);
        }
    }
    let loose = 0.1f64.powi(stage.min(300) as i32 + 1);
    let Tolerances { x_tol, f_tol, measure, .. } = setup.tolerances;
    let tolerances = match measure {
        ToleranceMeasure::Relative => {
            Tolerances { x_tol: x_tol.max(0.1 * loose), f_tol: f_tol.max(0.1 * loose), ..setup.tolerances }
        }
        ToleranceMeasure::Absolute => setup.tolerances,
    };
    let inner = Bounds::new(&lower, &upper).and_then(|b| Space::new(start, b, &transforms, &sizes));
    // The bounds contain the start by construction. If rounding violates this, use the user's bounds.
    let space = inner.unwrap_or_else(|_| space.clone());
    Setup { tolerances, ..Setup { space, ..setup.clone() } }
}

/// A running sequential barrier search, created by [`Barrier`].
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct BarrierState {
    setup: Setup,
    options: Barrier,
    /// Barrier parameter of the current stage; `None` until the first cost is known.
    mu: Option<f64>,
    inner: NelderMeadState,
    /// The last requested batch, with the cutoffs of the inner method.
    #[serde(rename = "asked")]
    requested: Batch,
    /// The cutoffs passed to the objective.
    cutoffs: Vec<f64>,
    #[serde(skip)]
    translated: Answers,
    working: Vec<f64>,
    best: Best,
    schedule: Vec<BarrierStage>,
    stage_start: Vec<f64>,
    n_stage: usize,
    /// Number of batches, points and iterations of the previous stages.
    n_batches: u64,
    n_points: u64,
    n_iterations: usize,
    f_0: f64,
    ended: Option<Termination>,
}

impl BarrierState {
    fn is_sound(&self, setup: &Setup) -> bool {
        let space = &setup.space;
        let is_point = |x: &[f64]| x.len() == space.n() && x.iter().all(|v| v.is_finite());
        // The setup of a stage can be built only from valid fields.
        self.setup.space == space.without_far_bounds()
            && self.setup.tolerances.check().is_ok()
            && self.mu.is_none_or(|mu| mu >= 0.0 && mu.is_finite())
            && self.f_0 >= 0.0
            && self.f_0.is_finite()
            && self.working.len() == space.n_free()
            && is_point(&self.stage_start)
            && space.bounds().contains(&self.stage_start)
            && self.schedule.len() <= MAX_STAGES
            && self.schedule.iter().all(|stage| is_point(&stage.x))
            && self.requested.is_sound(space.n())
            && self.best.is_sound(space.n())
            && {
                let inner = inner_setup(&self.setup, &self.stage_start, self.schedule.len());
                self.inner.is_sound(&self.options.inner().prepared(&inner))
            }
    }

    /// Returns `B(x)`, which is positive, and finite inside the bounds.
    fn barrier(&mut self, x: &[f64]) -> f64 {
        let space = &self.setup.space;
        space.to_working(x, &mut self.working);
        let mut sum = 0.0;
        for (k, u) in self.working.iter().enumerate() {
            let (lower, upper) = space.limits_of(k);
            let size = space.size(k);
            if lower.is_finite() {
                sum += (size / (u - lower)).min(MAX_TERM);
            }
            if upper.is_finite() {
                sum += (size / (upper - u)).min(MAX_TERM);
            }
        }
        sum
    }

    /// Converts cutoffs of the cost plus the barrier to cutoffs of the cost, for the points from `first` on.
    fn translate_cutoffs(&mut self, batch: &mut Batch, first: usize) {
        let mu = self.mu.unwrap_or(0.0);
        // A cost below the best so far must be known, even if its barrier makes the point useless to the
        // search.
        let best = self.best.cost().unwrap_or(f64::NEG_INFINITY);
        for k in first..batch.len() {
            let cutoff = batch.cutoff(k);
            if cutoff < f64::INFINITY {
                let barrier = mu * self.barrier(batch.point(k));
                // The slack covers rounding, because a stopped evaluation must imply that the search rejects the sum.
                let slack = 4.0 * f64::EPSILON * (cutoff.abs() + barrier);
                batch.set_cutoff(k, (cutoff - barrier + slack).max(best));
            }
        }
    }

    /// Sets the first barrier parameter from the first known cost.
    fn settle_mu(&mut self, outcomes: &[Outcome]) {
        let first_finite = outcomes.iter().position(|o| o.value().is_some());
        let Some((k, cost)) = first_finite.and_then(|k| outcomes[k].value().map(|v| (k, v))) else { return };
        if self.f_0 == 0.0 {
            self.f_0 = cost.abs();
        }
        if self.mu.is_none() {
            let x = self.requested.point(k).to_vec();
            let barrier = self.barrier(&x);
            let mu = 0.1 * cost.abs() / barrier;
            self.mu = Some(if mu > 0.0 && mu.is_finite() { mu } else { 0.1 });
        }
    }

    /// Ends a stage. `inner` is the reason why the inner method ended.
    fn end_stage(&mut self, inner: Termination) -> Result<(), Error> {
        let Some((x, value)) = self.inner.best().map(|(x, v)| (x.to_vec(), v)) else { return Ok(()) };
        let mu = self.mu.unwrap_or(0.0);
        let barrier = self.barrier(&x);
        let cost = value - mu * barrier;
        self.schedule.push(BarrierStage { mu, barrier, x: x.clone(), value, n_evaluations: self.n_stage });
        let stage = self.schedule.len();
        let Tolerances { x_tol, f_tol, measure, .. } = self.setup.tolerances;
        let space = &self.setup.space;
        let mut moved = 0.0f64;
        let mut start = vec![0.0; space.n_free()];
        space.to_working(&self.stage_start, &mut start);
        space.to_working(&x, &mut self.working);
        for (k, &i) in space.free().iter().enumerate() {
            moved = moved.max(match measure {
                ToleranceMeasure::Relative => (self.working[k] - start[k]).abs() / space.size(k),
                ToleranceMeasure::Absolute => (x[i] - self.stage_start[i]).abs(),
            });
        }
        let limit = match measure {
            ToleranceMeasure::Relative => f_tol * cost.abs().max(self.f_0),
            ToleranceMeasure::Absolute => f_tol,
        };
        let tight = inner_setup(&self.setup, &x, stage - 1).tolerances == self.setup.tolerances;
        let settled = stage > 1 && moved <= x_tol && mu * barrier <= limit;
        self.ended = match inner {
            Termination::OneFiniteVertex => Some(inner),
            // After `MAX_STAGES` stages, the barrier is below the resolution of 53-bit numbers.
            _ if (tight && settled) || stage >= MAX_STAGES => Some(inner),
            _ => None,
        };
        if self.ended.is_some() {
            return Ok(());
        }
        self.mu = Some(mu * self.options.factor);
        self.n_batches += self.inner.n_batches();
        self.n_points += self.inner.n_points();
        self.n_iterations += self.inner.details().n_iterations;
        self.n_stage = 0;
        let side = (0.1 * 0.3f64.powi(stage as i32)).max(1e-4);
        let mut steps = vec![1.0; space.n()];
        for (k, &i) in space.free().iter().enumerate() {
            steps[i] = side * space.size(k);
        }
        let method = self.options.inner().initial_steps(&steps);
        self.inner = method.begin(&inner_setup(&self.setup, &x, stage))?;
        self.stage_start = x;
        Ok(())
    }
}

impl Method for BarrierState {
    fn name(&self) -> &'static str {
        "barrier"
    }

    fn ask(&mut self, batch: &mut Batch) {
        if self.ended.is_some() {
            return batch.start(self.setup.space.n(), self.n_batches, self.n_points);
        }
        self.inner.ask(batch);
        self.requested.clone_from(batch);
        batch.renumber(self.n_batches + batch.index(), self.n_points);
        self.translate_cutoffs(batch, 0);
        self.cutoffs.clear();
        self.cutoffs.extend((0..batch.len()).map(|k| batch.cutoff(k)));
    }

    fn speculate(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        let first = batch.len();
        // Points of the next stage are not predicted.
        if self.ended.is_none() {
            self.inner.speculate(wanted, answers_so_far, batch);
            self.translate_cutoffs(batch, first);
        }
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        let outcomes = answers.outcomes();
        let requested = self.requested.len();
        if requested == 0 && self.inner.status() != Status::Running {
            return Err(Error::TellWithoutAsk);
        }
        if outcomes.len() > requested {
            return Err(Error::TooManyOutcomes { requested, received: outcomes.len() });
        }
        self.settle_mu(outcomes);
        let mu = self.mu.unwrap_or(0.0);
        let points = std::mem::take(&mut self.requested);
        self.translated.clear();
        for (k, outcome) in outcomes.iter().enumerate() {
            let translated = match outcome.value() {
                // The cost is finite, so the cost plus the barrier must stay finite.
                Some(v) => Outcome::Value((v + mu * self.barrier(points.point(k))).min(f64::MAX)),
                None => outcome.clone(),
            };
            self.translated.push(translated, &[]);
        }
        let received = self.inner.tell(&self.translated);
        self.requested = points;
        received?;
        for (k, outcome) in outcomes.iter().enumerate() {
            self.n_stage += usize::from(outcome.is_conclusive());
            let Some(v) = outcome.value() else { continue };
            // An evaluation above its cutoff might have been stopped. The best point must not depend on
            // cutoffs.
            if self.cutoffs.get(k).is_some_and(|c| v > *c) {
                continue;
            }
            self.best.offer(self.requested.point(k), v);
        }
        // No points are pending until the next `ask`.
        self.requested.start(self.setup.space.n(), 0, 0);
        match self.inner.status() {
            Status::Running | Status::NoStart => Ok(()),
            Status::Ended(Termination::AllFixed) => {
                self.ended = Some(Termination::AllFixed);
                Ok(())
            }
            Status::Ended(termination) => self.end_stage(termination),
        }
    }

    fn status(&self) -> Status {
        match (&self.ended, self.inner.status()) {
            (Some(termination), _) => Status::Ended(termination.clone()),
            (None, Status::NoStart) if self.schedule.is_empty() => Status::NoStart,
            // Later stages start from a point with a known cost.
            (None, Status::NoStart) => Status::Ended(Termination::AllFailed),
            (None, _) => Status::Running,
        }
    }

    fn details(&self) -> MethodDetails<'_> {
        let inner = self.inner.details();
        // A run that ended without a stage has no inner iterations.
        let is_counted = self.ended.is_some() && self.schedule.is_empty();
        let operation = match inner.operation {
            None if !self.schedule.is_empty() => Some(Operation::Initial),
            operation => operation,
        };
        MethodDetails {
            n_iterations: self.n_iterations + if is_counted { 0 } else { inner.n_iterations },
            operation,
            schedule: &self.schedule,
            ..inner
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        self.best.get()
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }
}
