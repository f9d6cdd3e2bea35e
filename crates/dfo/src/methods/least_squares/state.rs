//! The state machine: which point is asked for, and what follows from its residuals.

use super::model::Model;
use super::subproblem::{Subproblem, longest};
use crate::answer::{Answers, Best, Want};
use crate::error::Error;
use crate::linear_model::LinearModel;
use crate::method::{Batch, Details, Method, Operation, Setup, Status, saved};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::space::Space;
use crate::termination::Termination;
use crate::tolerances::Tests;
use serde::{Deserialize, Serialize};

/// A radius below this cannot be resolved.
const SMALLEST: f64 = 1e-15;
/// Refinements without success that mean noise, restarts without progress that end the run, and what progress is.
const MOST_REFINED: usize = 4;
const MOST_USELESS: usize = 30;
const USELESS: f64 = 1e-9;
/// How often a starting point that failed is tried nearer to the start.
const MOST_RETRIES: u32 = 12;

/// What the last point asked for is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Phase {
    /// The start and its neighbours.
    Starting,
    /// The next point is to be chosen.
    Choosing,
    /// The model's best point: coordinates in units of sizes, and the decrease that it predicts.
    Trial {
        z: Vec<f64>,
        predicted: f64,
    },
    /// A point that makes the model better, in the place of this slot.
    Geometry {
        z: Vec<f64>,
        slot: usize,
    },
    NoStart,
    Ended(Termination),
}

/// A running least-squares search; made by [`LeastSquares`](super::LeastSquares).
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct LeastSquaresState {
    setup: Setup,
    points: RankedPoints,
    residuals: Vec<Vec<f64>>,
    best_seen: Best,
    /// The trust region, and the resolution that it is not smaller than: both in units of the parameters' sizes.
    delta: f64,
    rho: f64,
    phase: Phase,
    asked: Vec<usize>,
    retries: Vec<u32>,
    /// Whether the point of the last step of geometry improvement may be followed by a smaller resolution.
    waiting: bool,
    n_batches: u64,
    n_points: u64,
    n_iterations: usize,
    operation: Option<Operation>,
    tests: Option<Tests>,
    f_0: f64,
    /// The first radius, restarts so far, those in a row that brought nothing, and the best cost before the last.
    radius: f64,
    n_restarts: usize,
    n_useless: usize,
    f_restart: f64,
    /// Refinements since the last step that did what the model predicted.
    n_refined: usize,
}

impl LeastSquaresState {
    pub(super) fn new(setup: &Setup, radius: f64) -> Self {
        let space = &setup.space;
        let n = space.n_free();
        let mut state = Self {
            setup: setup.clone(),
            points: RankedPoints::new(space, n + 1),
            residuals: vec![Vec::new(); n + 1],
            best_seen: Best::default(),
            delta: radius,
            rho: radius,
            phase: Phase::Starting,
            asked: Vec::new(),
            retries: vec![0; n + 1],
            waiting: false,
            n_batches: 0,
            n_points: 0,
            n_iterations: 0,
            operation: None,
            tests: None,
            f_0: 0.0,
            radius,
            n_restarts: 0,
            n_useless: 0,
            f_restart: f64::INFINITY,
            n_refined: 0,
        };
        for slot in 0..=n {
            state.place_start(slot);
        }
        state
    }

    fn n(&self) -> usize {
        self.setup.space.n_free()
    }

    pub(super) fn is_sound(&self, setup: &Setup) -> bool {
        let n = setup.space.n_free();
        setup.space == self.setup.space
            && self.points.is_sound(&setup.space)
            && self.points.len() == n + 1
            && self.residuals.len() == n + 1
            && self.retries.len() == n + 1
            && self.asked.iter().all(|slot| *slot <= n)
            && match &self.phase {
                Phase::Trial { z, .. } => z.len() == n,
                Phase::Geometry { z, slot } => z.len() == n && *slot <= n,
                _ => true,
            }
    }

    /// A starting point: the start itself, or its neighbour along a coordinate.
    fn place_start(&mut self, slot: usize) {
        let space = &self.setup.space;
        let mut u = vec![0.0; space.n_free()];
        if self.n_restarts == 0 {
            space.to_working(space.x0(), &mut u);
        } else {
            u.copy_from_slice(self.points.u(0));
        }
        if slot > 0 {
            let k = slot - 1;
            let (lower, upper) = space.working_bounds(k);
            let retries = self.retries[slot] as i32;
            let length = self.delta * space.size(k) * 0.5f64.powi(retries / 2);
            let (below, above) = (u[k] - lower, upper - u[k]);
            let forward = if self.n_restarts % 2 == 0 {
                if above >= length || above >= below { 1.0 } else { -1.0 }
            } else if below >= length || below >= above {
                -1.0
            } else {
                1.0
            };
            let sign = if retries % 2 == 0 { forward } else { -forward };
            let moved = (u[k] + sign * length).clamp(lower, upper);
            u[k] = if moved == u[k] { (u[k] - sign * length).clamp(lower, upper) } else { moved };
        }
        place(&mut self.points, slot, &u, space);
        if slot == 0 && self.n_restarts == 0 {
            self.points.x_mut(0).copy_from_slice(self.setup.space.x0());
        }
    }

    /// Coordinates of a slot in units of the sizes.
    fn z(&self, slot: usize) -> Vec<f64> {
        let space = &self.setup.space;
        self.points.u(slot).iter().enumerate().map(|(k, u)| u / space.size(k)).collect()
    }

    fn cost(&self, slot: usize) -> f64 {
        self.points.cost(slot).value().unwrap_or(f64::INFINITY)
    }

    fn best_slot(&self) -> usize {
        (0..self.points.len()).min_by(|a, b| self.cost(*a).total_cmp(&self.cost(*b))).unwrap_or(0)
    }

    /// Displacements from a slot to another, in units of the sizes.
    fn displacement(&self, from: usize, to: usize) -> Vec<f64> {
        self.z(to).iter().zip(self.z(from)).map(|(a, b)| a - b).collect()
    }

    fn model(&self, base: usize) -> Option<Model> {
        let others = (0..self.points.len()).filter(|slot| *slot != base);
        let others = others.map(|slot| (self.displacement(base, slot), &self.residuals[slot][..]));
        Model::interpolate(self.n(), &self.residuals[base], others)
    }

    /// How far a step from a slot may go along each coordinate.
    fn space_around(&self, slot: usize) -> (Vec<f64>, Vec<f64>) {
        let (space, z) = (&self.setup.space, self.z(slot));
        let ends = |k: usize| {
            let (lower, upper) = space.working_bounds(k);
            ((lower / space.size(k) - z[k]).min(0.0), (upper / space.size(k) - z[k]).max(0.0))
        };
        (0..z.len()).map(ends).unzip()
    }

    /// The other slot that lies farthest from this one, and its distance.
    fn farthest(&self, base: usize) -> (usize, f64) {
        (0..self.points.len())
            .filter(|slot| *slot != base)
            .map(|slot| (slot, norm(&self.displacement(base, slot))))
            .fold((base, 0.0), |far, other| if other.1 > far.1 { other } else { far })
    }

    /// Chooses the next point.
    fn choose(&mut self) {
        // Each turn shrinks the resolution.
        while self.phase == Phase::Choosing {
            let base = self.best_slot();
            let Some(model) = self.model(base) else {
                self.repair(base);
                return;
            };
            let (lower, upper) = self.space_around(base);
            let problem = Subproblem {
                jacobian: &model.jacobian,
                residuals: &self.residuals[base],
                radius: self.delta,
                lower: &lower,
                upper: &upper,
            };
            let (step, predicted) = problem.solve();
            let length = norm(&step);
            let f = self.cost(base);
            let tests = self.setup.tolerances.judge(self.rho, Some(predicted), f, self.f_0);
            self.tests = Some(tests);
            if tests.passed || f == 0.0 {
                self.phase = Phase::Ended(Termination::Converged);
            } else if length < 0.5 * self.rho || predicted <= 0.0 || predicted <= f64::EPSILON * f {
                // Nothing to gain at this resolution, if the model is right.
                self.delta = self.rho.max(0.1 * self.delta);
                if self.delta <= 1.5 * self.rho {
                    self.delta = self.rho;
                }
                let (slot, distance) = self.farthest(base);
                if distance > (2.0 * self.delta).max(10.0 * self.rho) {
                    self.improve(base, &model, slot, distance);
                } else if self.delta <= self.rho {
                    self.refine();
                }
            } else {
                let z = self.z(base).iter().zip(&step).map(|(z, s)| z + s).collect();
                self.phase = Phase::Trial { z, predicted };
            }
        }
    }

    /// A smaller resolution.
    fn refine(&mut self) {
        self.delta = 0.5 * self.rho;
        self.rho *= 0.1;
        self.delta = self.delta.max(self.rho);
        self.n_refined += 1;
        if self.n_refined >= MOST_REFINED || self.rho < SMALLEST {
            self.restart();
        }
    }

    /// What the model predicts has not come true at several resolutions: there is noise. New points around the best one, as far away as
    /// the first.
    fn restart(&mut self) {
        let best = self.best_slot();
        let f = self.cost(best);
        let useless = f > self.f_restart * (1.0 - USELESS);
        self.n_useless = if useless { self.n_useless + 1 } else { 0 };
        if self.n_useless >= MOST_USELESS {
            self.phase = Phase::Ended(Termination::Collapsed);
            return;
        }
        self.f_restart = f;
        self.n_restarts += 1;
        self.n_refined = 0;
        (self.delta, self.rho) = (self.radius, self.radius);
        if best != 0 {
            let (u, x) = (self.points.u(best).to_vec(), self.points.x(best).to_vec());
            self.points.set(0, &u, &x);
            self.points.set_cost(0, Cost::Value(f));
            self.residuals.swap(0, best);
        }
        for slot in 1..self.points.len() {
            self.retries[slot] = 0;
            self.place_start(slot);
        }
        self.phase = Phase::Starting;
    }

    /// Replaces a slot that lies too far away by one that tells more.
    fn improve(&mut self, base: usize, model: &Model, slot: usize, distance: f64) {
        let radius = (0.1 * distance).min(0.5 * self.delta).max(self.rho);
        let (lower, upper) = self.space_around(base);
        let other = if slot > base { slot - 1 } else { slot };
        let step = longest(&model.gradient(other), radius, &lower, &upper);
        let z = self.z(base).iter().zip(&step).map(|(z, s)| z + s).collect();
        self.phase = Phase::Geometry { z, slot };
    }

    /// The points lie in a plane: the one that lies farthest is placed along a coordinate.
    fn repair(&mut self, base: usize) {
        let (slot, _) = self.farthest(base);
        let (lower, upper) = self.space_around(base);
        let k = self.n_iterations % self.n();
        let mut z = self.z(base);
        z[k] += if upper[k] >= -lower[k] { self.delta.min(upper[k]) } else { -self.delta.min(-lower[k]) };
        self.n_iterations += 1;
        self.phase =
            Phase::Geometry { z, slot: if slot == base { (base + 1) % self.points.len() } else { slot } };
    }

    /// Working coordinates of a point in units of the sizes.
    fn working(&self, z: &[f64]) -> Vec<f64> {
        let space = &self.setup.space;
        let inside = |(k, z): (usize, &f64)| {
            let (lower, upper) = space.working_bounds(k);
            (z * space.size(k)).clamp(lower, upper)
        };
        z.iter().enumerate().map(inside).collect()
    }

    fn started(&mut self) {
        if self.cost(0).is_infinite() {
            self.phase = Phase::NoStart;
            return;
        }
        if self.n_restarts == 0 {
            self.f_0 = self.cost(0);
        }
        self.operation = Some(if self.n_restarts == 0 { Operation::Initial } else { Operation::Restart });
        self.phase = if self.n() == 0 { Phase::Ended(Termination::AllFixed) } else { Phase::Choosing };
    }

    /// Takes a point into the place of a slot.
    fn replace(&mut self, slot: usize, z: &[f64], cost: f64, residuals: &[f64]) {
        let u = self.working(z);
        place(&mut self.points, slot, &u, &self.setup.space);
        self.points.set_cost(slot, Cost::Value(cost));
        self.residuals[slot].clear();
        self.residuals[slot].extend_from_slice(residuals);
    }

    /// What follows from the model's best point. `answer`: its cost and residuals; `None`: it failed.
    fn tried(&mut self, z: &[f64], predicted: f64, answer: Option<(f64, &[f64])>) {
        self.n_iterations += 1;
        self.operation = Some(Operation::TrustRegionStep);
        let base = self.best_slot();
        let step: Vec<f64> = z.iter().zip(self.z(base)).map(|(z, b)| z - b).collect();
        let length = norm(&step);
        let ratio = answer.map_or(-1.0, |(cost, _)| (self.cost(base) - cost) / predicted);
        if ratio >= 0.1 {
            self.n_refined = 0;
        }
        self.delta = if ratio < 0.1 {
            (0.5 * self.delta).min(length)
        } else if ratio < 0.7 {
            (0.5 * self.delta).max(length)
        } else {
            (2.0 * self.delta).min((0.5 * self.delta).max(4.0 * length)).max(self.delta)
        };
        if self.delta <= 1.5 * self.rho {
            self.delta = self.rho;
        }
        if let (Some((cost, residuals)), Some(model)) = (answer, self.model(base)) {
            let lagrange = model.lagrange(&step);
            let of_base = 1.0 - lagrange.iter().sum::<f64>();
            let better = cost < self.cost(base);
            let mut others = lagrange.iter();
            let mut chosen = None;
            for slot in 0..self.points.len() {
                let value = if slot == base { of_base } else { others.next().copied().unwrap_or(0.0) };
                if slot == base && !better {
                    continue;
                }
                let from = if better { z.to_vec() } else { self.z(base) };
                let distance = norm(&self.z(slot).iter().zip(from).map(|(a, b)| a - b).collect::<Vec<_>>());
                let weight = value.abs() * (distance / self.delta).powi(2).max(1.0);
                if chosen.is_none_or(|(_, most)| weight > most) {
                    chosen = Some((slot, weight));
                }
            }
            if let Some((slot, weight)) = chosen.filter(|(_, weight)| *weight > 0.0) {
                let _ = weight;
                self.replace(slot, z, cost, residuals);
            }
        }
        self.phase = Phase::Choosing;
        if ratio < 0.1 {
            let base = self.best_slot();
            let (slot, distance) = self.farthest(base);
            if distance > (2.0 * self.delta).max(10.0 * self.rho) {
                if let Some(model) = self.model(base) {
                    self.improve(base, &model, slot, distance);
                }
            } else if self.delta.max(length) <= self.rho && ratio < 0.0 {
                self.refine();
            }
        }
    }
}

fn place(points: &mut RankedPoints, slot: usize, u: &[f64], space: &Space) {
    points.u_mut(slot).copy_from_slice(u);
    space.to_user(u, points.x_mut(slot));
    points.set_cost(slot, Cost::Pending);
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

impl Method for LeastSquaresState {
    fn name(&self) -> &'static str {
        "least-squares"
    }

    fn ask(&mut self, batch: &mut Batch) {
        batch.start(self.setup.space.n(), self.n_batches, self.n_points);
        batch.set_want(Want::Residuals);
        self.asked.clear();
        if self.phase == Phase::Choosing {
            self.choose();
        }
        match &self.phase {
            Phase::Starting => {
                for slot in 0..self.points.len() {
                    if self.points.cost(slot) == Cost::Pending {
                        batch.push(self.points.x(slot), f64::INFINITY);
                        self.asked.push(slot);
                    }
                }
            }
            Phase::Trial { z, .. } | Phase::Geometry { z, .. } => {
                let mut x = vec![0.0; self.setup.space.n()];
                self.setup.space.to_user(&self.working(z), &mut x);
                batch.push(&x, f64::INFINITY);
                self.asked.push(0);
            }
            Phase::Choosing | Phase::NoStart | Phase::Ended(_) => {}
        }
        self.waiting = !self.asked.is_empty();
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        let asked = self.asked.len();
        let outcomes = answers.outcomes();
        if !self.waiting {
            return Err(Error::TellWithoutAsk);
        }
        if outcomes.len() > asked {
            return Err(Error::TooManyOutcomes { asked, told: outcomes.len() });
        }
        self.waiting = false;
        self.n_batches += 1;
        self.n_points += asked as u64;
        if self.phase == Phase::Starting {
            for (k, outcome) in outcomes.iter().enumerate().filter(|(_, o)| o.is_known()) {
                let slot = self.asked[k];
                match (outcome.value(), answers.residuals(k)) {
                    (Some(cost), Some(residuals)) => {
                        self.points.set_cost(slot, Cost::Value(cost));
                        self.residuals[slot] = residuals.to_vec();
                        self.best_seen.offer(self.points.x(slot), cost);
                    }
                    _ if slot == 0 || self.retries[slot] >= MOST_RETRIES => {
                        self.points.set_cost(slot, Cost::Failed);
                    }
                    _ => {
                        self.retries[slot] += 1;
                        self.place_start(slot);
                    }
                }
            }
            if self.points.cost(0) == Cost::Failed || !self.points.is_pending() {
                self.started();
            }
            return Ok(());
        }
        let Some(outcome) = outcomes.first().filter(|outcome| outcome.is_known()) else { return Ok(()) };
        let answer = outcome.value().zip(answers.residuals(0));
        match std::mem::replace(&mut self.phase, Phase::Choosing) {
            Phase::Trial { z, predicted } => {
                if let Some((cost, _)) = answer {
                    let mut x = vec![0.0; self.setup.space.n()];
                    self.setup.space.to_user(&self.working(&z), &mut x);
                    self.best_seen.offer(&x, cost);
                }
                self.tried(&z, predicted, answer);
            }
            Phase::Geometry { z, slot } => match answer {
                Some((cost, residuals)) => {
                    self.replace(slot, &z, cost, residuals);
                    self.best_seen.offer(self.points.x(slot), cost);
                }
                None => {
                    self.delta *= 0.5;
                    self.rho = self.rho.min(self.delta);
                }
            },
            other => self.phase = other,
        }
        Ok(())
    }

    fn status(&self) -> Status {
        match &self.phase {
            Phase::NoStart => Status::NoStart,
            Phase::Ended(termination) => Status::Ended(termination.clone()),
            _ => Status::Running,
        }
    }

    fn details(&self) -> Details<'_> {
        Details {
            n_iterations: self.n_iterations,
            operation: self.operation,
            tests: self.tests,
            plan: "serial",
            ..Details::default()
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        self.best_seen.get()
    }

    fn linear_model(&self) -> Option<LinearModel> {
        let (base, space) = (self.best_slot(), &self.setup.space);
        if self.n() == 0 || self.phase == Phase::Starting || self.cost(base).is_infinite() {
            return None;
        }
        let model = self.model(base)?;
        let derivative = |i: usize, k: usize| model.jacobian[(i, k)] / space.size(k);
        LinearModel::new(space, self.points.x(base), self.residuals[base].len(), derivative)
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }
}
