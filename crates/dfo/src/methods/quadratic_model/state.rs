//! State machine of the search on quadratic models: requested points and the processing of their costs.

use super::constraint_models::Nonlinear;
use super::initial;
use super::inverse::Inverse;
use super::model::{Interpolation, Quadratic};
use super::options::QuadraticModel;
use crate::error::Error;
use crate::method_interface::interface::{
    AnswersSoFar, Batch, Method, MethodDetails, Operation, Roughness, Setup, Status, saved,
};
use crate::method_interface::tolerances::ToleranceTests;
use crate::methods::cma_es::PopulationSearch;
use crate::methods::failure_check::FailureCheck;
use crate::methods::nelder_mead::{NelderMead, SimplexSearch};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::pending_generation::PendingGeneration;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::outcome::answer::Answers;
use crate::outcome::termination::Termination;
use serde::{Deserialize, Serialize};

/// Maximum number of times that a failed first point is retried nearer to the start.
const MOST_RETRIES: u32 = 12;
/// Maximum number of stored failed points.
const MOST_FAILED: usize = 64;

/// Phase of the search, which determines the purpose of the requested points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) enum Phase {
    /// The first points, or the points of a restart.
    Starting,
    /// The next point must be chosen.
    Choosing,
    /// The best point of the model, and the predicted decrease.
    Trial {
        predicted: f64,
    },
    /// A point that improves the model.
    Geometry,
    /// A simplex search or CMA-ES continues.
    HandedOver,
    /// The search has ended next to failed points. CMA-ES searches for a lower cost between them.
    BesideFailures,
    NoStart,
    Ended(Termination),
}

/// A running search with known sizes of all parameters.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ModelSearch {
    pub(super) setup: Setup,
    pub(super) restarts: usize,
    /// Maximum number of interpolation points. `points` contains these points; failed points are not part of
    /// the model.
    pub(super) most_points: usize,
    pub(super) points: RankedPoints,
    /// The trial point.
    pub(super) trial: RankedPoints,
    pub(super) rounds: PendingGeneration,
    /// Model around the best point, with displacements in units of the parameter sizes.
    pub(super) model: Quadratic,
    /// Interpolation conditions of the model; built from the points when needed.
    #[serde(skip)]
    pub(super) interpolation: Option<Interpolation>,
    /// Inverse of the conditions for many parameters, updated from step to step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) inverse: Option<Inverse>,
    /// Trust-region radius, and the resolution, which is its lower limit. Both are in units of the parameter
    /// sizes.
    pub(super) delta: f64,
    pub(super) rho: f64,
    pub(super) phase: Phase,
    /// Number of failures of each of the first points.
    pub(super) retries: Vec<u32>,
    /// Working coordinates of the last failed points.
    pub(super) failed: Vec<Vec<f64>>,
    /// Slope error of the model along a failed step at this resolution. `largest_bend` is the largest such
    /// error in units of the extent, over consecutive resolutions that ended for this reason. `n_refused` is
    /// the number of these at which the error grew.
    pub(super) refused: Option<f64>,
    pub(super) largest_bend: f64,
    pub(super) n_refused: usize,
    /// Radius of the last start, number of consecutive restarts without a gain, and the best cost at the last
    /// restart.
    pub(super) radius: f64,
    pub(super) n_useless: usize,
    pub(super) f_restart: f64,
    pub(super) n_iterations: usize,
    pub(super) operation: Option<Operation>,
    pub(super) tests: Option<ToleranceTests>,
    pub(super) f_0: f64,
    /// True if another search may continue, and the active simplex search.
    #[serde(default)]
    pub(super) hand_over: bool,
    #[serde(default)]
    pub(super) simplex: Option<SimplexSearch>,
    /// The active CMA-ES search, if it continues instead of a simplex search.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) population: Option<Box<PopulationSearch>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) check: Option<FailureCheck>,
    /// Extents of the model since the last start, and the norm of its Hessian, for each exhausted resolution.
    #[serde(default)]
    pub(super) curvatures: Vec<(f64, f64)>,
    /// Evidence of noise or kinks so far, and the number of consecutive later starts without such evidence.
    #[serde(default)]
    pub(super) roughness: Option<Roughness>,
    #[serde(default)]
    pub(super) n_smooth: usize,
    /// Number of exhausted resolutions at which a hand-over was due, but its method undecided.
    #[serde(default)]
    pub(super) n_undecided: usize,
    /// Errors of the model at the last two points since the last start, newest first.
    #[serde(default)]
    pub(super) last_errors: [f64; 2],
    /// Nonlinear constraints, if there are any. The costs of `points` are then merits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) nonlinear: Option<Box<Nonlinear>>,
    /// Number of near points requested since the tests passed, number of consecutive returns to a larger
    /// resolution without a lower cost, and the cost at the last return.
    #[serde(default)]
    pub(super) n_checked: usize,
    #[serde(default)]
    pub(super) n_returns: usize,
    #[serde(default)]
    pub(super) f_return: Option<f64>,
}

impl ModelSearch {
    pub(super) fn new(setup: Setup, options: &QuadraticModel, most_points: usize) -> Self {
        let space = &setup.space;
        let n = space.n_free();
        let n_points = most_points.min(2 * n + 1);
        let radius = options.first_radius(space);
        let mut state = Self {
            points: RankedPoints::new(space, n_points),
            trial: RankedPoints::new(space, 1),
            rounds: PendingGeneration::with_capacity(n_points),
            model: Quadratic::zero(n),
            interpolation: None,
            inverse: None,
            delta: radius,
            rho: radius,
            phase: Phase::Starting,
            retries: vec![0; n_points],
            failed: Vec::new(),
            refused: None,
            largest_bend: 0.0,
            n_refused: 0,
            radius,
            n_useless: 0,
            f_restart: f64::INFINITY,
            n_iterations: 0,
            operation: None,
            tests: None,
            f_0: 0.0,
            restarts: options.restarts,
            hand_over: options.hand_over,
            simplex: None,
            population: None,
            check: None,
            curvatures: Vec::new(),
            roughness: None,
            n_smooth: 0,
            n_undecided: 0,
            last_errors: [f64::INFINITY; 2],
            nonlinear: (!setup.constraints.nonlinear.is_empty()).then(Box::default),
            n_checked: 0,
            n_returns: 0,
            f_return: None,
            most_points,
            setup,
        };
        state.place_first();
        state.place_around();
        state
    }

    pub(super) fn n(&self) -> usize {
        self.setup.space.n_free()
    }

    pub(super) fn is_sound(&self, setup: &Setup) -> bool {
        let space = &setup.space;
        let n = space.n_free();
        // Radii must be positive and finite, and the resolution must not exceed the trust-region radius.
        let is_length = |length: f64| length > 0.0 && length.is_finite();
        *space == self.setup.space
            && self.setup.constraints == setup.constraints
            && self.setup.tolerances.check().is_ok()
            && is_length(self.rho)
            && is_length(self.radius)
            && is_length(self.delta)
            && self.delta >= self.rho
            && !self.f_0.is_nan()
            && !self.f_restart.is_nan()
            && self.points.is_sound(space)
            && self.trial.is_sound(space)
            && self.trial.len() == 1
            && self.rounds.is_sound(space.n())
            && self.model.is_sound(n)
            && self.nonlinear.is_some() != setup.constraints.nonlinear.is_empty()
            && self
                .nonlinear
                .as_ref()
                .is_none_or(|nonlinear| nonlinear.is_sound(n, space.n(), setup.constraints.nonlinear.len()))
            && self.inverse.as_ref().is_none_or(|inverse| inverse.is_sound(n, self.points.len()))
            && self.failed.iter().all(|u| u.len() == n)
            && !self.retries.is_empty()
            && self.points.len() > 0
            && (self.phase != Phase::Starting || self.points.len() == self.retries.len())
            && (self.phase == Phase::HandedOver) == (self.simplex.is_some() != self.population.is_some())
            && self.population.as_ref().is_none_or(|search| search.is_sound(&self.setup))
            && (self.phase != Phase::BesideFailures || self.check.is_some())
            && self.check.as_ref().is_none_or(|check| check.is_sound(&self.setup))
            && self
                .simplex
                .as_ref()
                .is_none_or(|simplex| simplex.is_sound(&NelderMead::default(), &self.setup))
    }

    /// Places all points except the first around the first one.
    pub(super) fn place_around(&mut self) {
        self.retries.fill(0);
        for slot in 1..self.points.len() {
            self.place_start(slot);
        }
    }

    fn place_start(&mut self, slot: usize) {
        let space = &self.setup.space;
        let centre = self.points.u(0).to_vec();
        let mut u = centre.clone();
        initial::place(space, &centre, slot, self.radius, self.retries[slot], &mut u);
        self.place_start_inside(&centre, slot, &mut u);
        self.points.place(slot, &u, space);
    }

    /// Processes the first points after all of them have a cost or have failed.
    fn start_evaluated(&mut self) {
        for slot in 1..self.points.len() {
            if self.points.cost(slot) == Cost::Failed && self.points.cost(0) != Cost::Failed {
                self.remember_failed(self.points.u(slot).to_vec());
                self.retries[slot] += 1;
                if self.retries[slot] <= MOST_RETRIES {
                    self.place_start(slot);
                }
            }
        }
        if self.points.is_pending() {
            return;
        }
        self.points.rank();
        if self.points.n_finite() == 0 {
            self.phase = Phase::NoStart;
            return;
        }
        if self.operation.is_none() {
            let sizes = self.points.costs.iter().filter_map(|cost| cost.value()).map(f64::abs);
            self.f_0 = sizes.filter(|f| *f > 0.0).fold(f64::INFINITY, f64::min);
            if self.f_0 == f64::INFINITY {
                self.f_0 = 0.0;
            }
            self.operation = Some(Operation::Initial);
        } else {
            self.operation = Some(Operation::Restart);
            self.n_iterations += 1;
        }
        if self.n() == 0 {
            self.phase = Phase::Ended(Termination::AllFixed);
            return;
        }
        self.model = Quadratic::zero(self.n());
        self.reset_constraints();
        self.phase = Phase::Choosing;
        let from = self.points.u(self.points.best()).to_vec();
        self.refit(&from);
    }

    pub(super) fn remember_failed(&mut self, u: Vec<f64>) {
        if self.failed.len() == MOST_FAILED {
            self.failed.remove(0);
        }
        self.failed.push(u);
    }
}

impl Method for ModelSearch {
    fn name(&self) -> &'static str {
        "quadratic-model"
    }

    fn ask(&mut self, batch: &mut Batch) {
        if self.phase == Phase::Choosing {
            self.complete();
            self.choose();
        }
        if let Some(simplex) = &mut self.simplex {
            return simplex.ask(batch);
        }
        if let Some(population) = &mut self.population {
            return population.ask(batch);
        }
        if let (Phase::BesideFailures, Some(check)) = (&self.phase, &mut self.check) {
            return check.ask(batch);
        }
        let n = self.setup.space.n();
        match self.phase {
            Phase::Starting => self.rounds.ask(batch, n, &self.points, |_| f64::INFINITY),
            Phase::Trial { .. } | Phase::Geometry => {
                self.rounds.ask(batch, n, &self.trial, |_| f64::INFINITY);
            }
            Phase::Choosing
            | Phase::HandedOver
            | Phase::BesideFailures
            | Phase::NoStart
            | Phase::Ended(_) => {
                self.rounds.ask_nothing(batch, n);
            }
        }
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        if let Some(simplex) = &mut self.simplex {
            return simplex.state.tell(answers);
        }
        if let Some(population) = &mut self.population {
            return population.search.tell(answers);
        }
        if let (Phase::BesideFailures, Some(check)) = (&self.phase, &mut self.check) {
            if let Some(termination) = check.tell(answers, &self.setup)? {
                self.phase = Phase::Ended(termination);
            }
            return Ok(());
        }
        if self.phase == Phase::Starting {
            let is_complete = self.rounds.tell(answers, &mut self.points)?;
            self.take_constraints(answers, true);
            if is_complete {
                self.start_evaluated();
            }
        } else if self.rounds.tell(answers, &mut self.trial)? {
            self.take_constraints(answers, false);
            self.complete();
            self.n_iterations += 1;
            self.operation = Some(Operation::TrustRegionStep);
            match std::mem::replace(&mut self.phase, Phase::Choosing) {
                Phase::Trial { predicted } => self.trial_evaluated(predicted),
                Phase::Geometry => self.geometry_evaluated(),
                other => self.phase = other,
            }
        }
        Ok(())
    }

    fn speculate(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        if let Some(simplex) = &mut self.simplex {
            simplex.state.speculate(wanted, answers_so_far, batch);
        }
    }

    fn status(&self) -> Status {
        if let Some(simplex) = &self.simplex {
            return simplex.state.status();
        }
        if let Some(population) = &self.population {
            return population.search.status();
        }
        match &self.phase {
            Phase::NoStart => Status::NoStart,
            Phase::Ended(termination) => Status::Ended(termination.clone()),
            _ => Status::Running,
        }
    }

    fn details(&self) -> MethodDetails<'_> {
        let details = MethodDetails {
            n_iterations: self.n_iterations,
            operation: self.operation,
            tests: self.tests,
            plan: "serial",
            roughness: self.roughness,
            ..MethodDetails::default()
        };
        if let Some(simplex) = &self.simplex {
            return simplex.details(details);
        }
        if let Some(population) = &self.population {
            return population.details(details);
        }
        let mut view = self.points.view();
        if let Some(nonlinear) = self.nonlinear.as_ref().filter(|n| n.costs.len() == self.points.len()) {
            view.costs = &nonlinear.costs;
        }
        let multipliers = self.active_constraints();
        let details = MethodDetails { population: Some(view), multipliers, ..details };
        match &self.check {
            Some(check) => check.details(details),
            None => details,
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        let of_rounds = self.nonlinear.as_ref().map_or(self.rounds.best(), |nonlinear| nonlinear.best());
        let found = match &self.check {
            Some(check) => Some(check.best()),
            None => match (&self.simplex, &self.population) {
                (Some(simplex), _) => simplex.state.best(),
                (None, Some(population)) => population.search.best(),
                (None, None) => None,
            },
        };
        match (of_rounds, found) {
            (Some((_, f)), Some((_, g))) if g >= f => of_rounds,
            (of_rounds, found) => found.or(of_rounds),
        }
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }
}
