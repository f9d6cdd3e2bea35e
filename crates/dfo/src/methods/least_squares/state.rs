//! State machine of least squares: requested points and the processing of their residuals. The next points
//! are chosen in `trust_region.rs`, in `averaging.rs` after noise has been found, and in `simplex_search.rs`
//! if points fail.

use super::interpolation::Interpolation;
use super::options::{LeastSquares, StepPlan};
use super::points::{Evaluated, distance, norm, sum_of_squares};
use super::subproblem::Room;
use crate::error::Error;
use crate::method_interface::interface::{
    Batch, Lookahead, Method, MethodDetails, Operation, Setup, Status, saved,
};
use crate::method_interface::linear_model::LinearModel;
use crate::method_interface::tolerances::{TestedSet, ToleranceTests};
use crate::methods::nelder_mead::{NelderMead, SimplexSearch};
use crate::outcome::answer::{Answers, Best, EvaluationKind};
use crate::outcome::termination::Termination;
use crate::problem::constraints::quadratic_program::HalfSpace;
use crate::problem::memory;
use crate::problem::space::clamp;
use crate::values::choices::ToleranceMeasure;
use base::RunContext;
use serde::{Deserialize, Serialize};

/// Maximum number of times that a failed neighbour of the start is retried nearer to the start.
const MOST_RETRIES: u32 = 12;
/// Maximum number of searches for unknown parameter sizes.
const MOST_RESIZED: u32 = 8;
/// Maximum number of stored points, in units of n + 1.
const MOST_KEPT: usize = 20;
/// Maximum total number of stored residuals, which further limits the number of points.
const MOST_NUMBERS: usize = 1 << 27;
/// Number of parameters from which the start is evaluated alone. Its residuals show whether the residuals of
/// the other points fit into memory.
const LARGE: usize = 500;

/// Maximum number of stored failed points.
const MOST_FAILED: usize = 64;

/// Relative difference above which the cost of an objective is not the sum of squares. Sums of up to 1e6
/// squares in different orders differ by less.
const ROUNDING: f64 = 1e-9;

/// Phase of the search.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) enum Phase {
    /// The start and its neighbours are evaluated.
    Starting,
    /// Rounds of several points.
    Rounds(Rounds),
    /// Steps on interpolation models.
    Descending,
    /// Steps on regression models, because the residuals are noisy.
    Averaging(Averaging),
    /// A simplex search, because points fail around the best one.
    Simplex(Box<SimplexSearch>),
    NoStart,
    Ended(Termination),
}

/// State of the regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Averaging {
    /// Centre and radius of the points that count, in units of the parameter sizes.
    pub(super) centre: Vec<f64>,
    pub(super) radius: f64,
    /// Number of points requested since noise was found.
    #[serde(rename = "n_asked")]
    pub(super) n_requested: usize,
}

impl Averaging {
    pub(super) fn new(centre: &[f64], radius: f64) -> Self {
        Self { centre: centre.to_vec(), radius, n_requested: 0 }
    }

    pub(super) fn is_sound(&self, n: usize) -> bool {
        self.centre.len() == n && self.centre.iter().all(|z| z.is_finite()) && is_length(self.radius)
    }
}

/// Points next to a centre, one along each coordinate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Differences {
    pub(super) centre: usize,
    pub(super) neighbours: Vec<usize>,
    /// False for the start, whose neighbours are one radius away.
    pub(super) is_fine: bool,
}

/// State of the rounds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Rounds {
    /// The last two differences, oldest first.
    #[serde(rename = "known")]
    pub(super) differences: Vec<Differences>,
    /// Difference step, in units of the parameters.
    pub(super) step: f64,
    /// True if the noise of the residuals has been checked.
    pub(super) is_checked: bool,
    /// Number of consecutive rounds without a better point.
    #[serde(rename = "n_stuck")]
    pub(super) n_without_progress: usize,
    /// Best point before the round.
    pub(super) base: usize,
    /// Centre of the differences of the round, if it is not the first trial point.
    pub(super) around: Option<usize>,
}

impl Rounds {
    pub(super) fn is_sound(&self, n: usize, len: usize) -> bool {
        let of = |d: &Differences| d.neighbours.len() == n && d.points().all(|k| k < len);
        self.differences.iter().all(of)
            && is_length(self.step)
            && self.base < len
            && self.around.is_none_or(|k| k < len)
    }

    /// Returns the indices of the points in use.
    pub(super) fn points(&mut self) -> impl Iterator<Item = &mut usize> {
        let differences =
            self.differences.iter_mut().flat_map(|d| d.neighbours.iter_mut().chain([&mut d.centre]));
        differences.chain([&mut self.base]).chain(&mut self.around)
    }

    pub(super) fn fine_at(&self, centre: usize) -> Option<&Differences> {
        self.differences.iter().find(|d| d.is_fine && d.centre == centre)
    }
}

impl Differences {
    pub(super) fn points(&self) -> impl Iterator<Item = usize> {
        std::iter::once(self.centre).chain(self.neighbours.iter().copied())
    }
}

/// Reference state of a search whose changes have been below the tolerances since then.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Stagnation {
    pub(super) z: Vec<f64>,
    pub(super) cost: f64,
    /// Number of rounds of trial points since then.
    pub(super) n_rounds: usize,
}

fn is_length(length: f64) -> bool {
    length > 0.0 && length.is_finite()
}

/// Reason for requesting a point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) enum Role {
    /// The start, or its neighbour along a coordinate.
    Start(Option<usize>),
    /// Best point of the model within a radius, and the predicted decrease.
    Trial { predicted: f64, radius: f64 },
    /// A point that improves the model and replaces the given point.
    Geometry { instead: usize },
    /// A point that improves the model.
    Near,
    /// A neighbour of the centre of a round along a coordinate.
    Difference,
    /// A point beyond the first neighbour, which shows the noise of the residuals.
    Check,
    /// A point next to the best one, which distinguishes noisy from curved residuals. `misfit` is the error
    /// of the model.
    Probe { misfit: f64 },
}

/// Result for a requested point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(super) enum PointStatus {
    Pending,
    Failed,
    /// Index of the point.
    Point(usize),
}

/// A requested point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Candidate {
    pub(super) role: Role,
    pub(super) z: Vec<f64>,
    pub(super) x: Vec<f64>,
    pub(super) retries: u32,
    #[serde(rename = "known")]
    pub(super) status: PointStatus,
}

/// A running least-squares search, created by [`LeastSquares`].
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct LeastSquaresState {
    pub(super) setup: Setup,
    /// The start in working coordinates.
    origin: Vec<f64>,
    pub(super) options: LeastSquares,
    /// Evaluated points, oldest first.
    pub(super) points: Vec<Evaluated>,
    /// Indices of the n + 1 points that the model interpolates, or fewer if points failed.
    pub(super) set: Vec<usize>,
    pub(super) best_seen: Best,
    /// Trust-region radius, and the resolution, which is its lower limit. Both are in units of the parameter
    /// sizes.
    pub(super) delta: f64,
    pub(super) rho: f64,
    pub(super) phase: Phase,
    pub(super) round: Vec<Candidate>,
    /// Model on the set; rebuilt if missing.
    pub(super) model: Option<Interpolation>,
    #[serde(rename = "asked")]
    requested: Vec<usize>,
    /// The last points requested by the simplex search.
    pub(super) simplex_points: Vec<Vec<f64>>,
    waiting: bool,
    pub(super) n_batches: u64,
    pub(super) n_points: u64,
    pub(super) n_iterations: usize,
    pub(super) operation: Option<Operation>,
    pub(super) tests: Option<ToleranceTests>,
    /// Number of searches for unknown parameter sizes so far.
    n_resized: u32,
    /// Sum of squares at the start.
    pub(super) f_0: f64,
    /// True if the cost is not the sum of squares of the residuals, but another increasing function of it.
    #[serde(default)]
    pub(super) has_other_cost: bool,
    /// Misfit of the model at the last failed step, and the size of the step and the set.
    pub(super) failure: Option<(f64, f64)>,
    /// The last points that failed.
    pub(super) failed: Vec<Vec<f64>>,
    /// Number of consecutive failed trial points, and of consecutive failed points for the model.
    pub(super) n_failed: usize,
    pub(super) n_geometry_failed: usize,
    /// Number of consecutive points for the model at one resolution.
    pub(super) n_geometry: usize,
    /// Number of consecutive signs of noise.
    pub(super) n_noisy: usize,
    /// Error of the model at the last successful step: the change of the Jacobian per length.
    pub(super) curvature: Option<f64>,
    /// Point of the set that should be replaced by a more informative point.
    pub(super) improving: Option<usize>,
    /// Point around which missing directions were last requested, and the number of requests.
    pub(super) completed: (usize, u32),
    /// Stagnation of the search.
    #[serde(default)]
    pub(super) halt: Option<Stagnation>,
}

impl LeastSquaresState {
    pub(super) fn new(setup: &Setup, options: &LeastSquares) -> Self {
        let n = setup.space.n_free();
        let mut origin = vec![0.0; n];
        setup.space.to_working(setup.space.x0(), &mut origin);
        let mut state = Self {
            setup: setup.clone(),
            origin,
            options: options.clone(),
            points: Vec::new(),
            set: Vec::new(),
            best_seen: Best::default(),
            delta: options.radius,
            rho: options.radius,
            phase: Phase::Starting,
            round: Vec::new(),
            model: None,
            requested: Vec::new(),
            simplex_points: Vec::new(),
            waiting: false,
            n_batches: 0,
            n_points: 0,
            n_iterations: 0,
            operation: None,
            tests: None,
            n_resized: 0,
            f_0: 0.0,
            has_other_cost: false,
            failure: None,
            failed: Vec::new(),
            n_failed: 0,
            n_geometry_failed: 0,
            n_geometry: 0,
            n_noisy: 0,
            curvature: None,
            improving: None,
            completed: (0, 0),
            halt: None,
        };
        for coordinate in std::iter::once(None).chain((0..n).map(Some)) {
            let z = state.neighbour(coordinate, 0);
            state.ask_for(z, Role::Start(coordinate));
        }
        state.round[0].x.copy_from_slice(setup.space.x0());
        state
    }

    pub(super) fn n(&self) -> usize {
        self.setup.space.n_free()
    }

    pub(super) fn is_sound(&self, setup: &Setup) -> bool {
        let (n, n_user, len) = (setup.space.n_free(), setup.space.n(), self.points.len());
        let m = self.points.first().map_or(0, |point| point.residuals.len());
        let is_place = |z: &[f64], x: &[f64]| {
            z.len() == n
                && z.iter().all(|z| z.is_finite())
                && x.len() == n_user
                && setup.space.bounds().contains(x)
                && (!setup.space.has_linear() || setup.space.admits(x))
        };
        let is_candidate = |c: &Candidate| {
            is_place(&c.z, &c.x)
                && !matches!(c.status, PointStatus::Point(k) if k >= len)
                && match c.role {
                    Role::Start(coordinate) => coordinate.is_none_or(|k| k < n),
                    Role::Geometry { instead } => instead < len,
                    Role::Trial { .. } | Role::Near | Role::Difference | Role::Check | Role::Probe { .. } => {
                        true
                    }
                }
        };
        let is_point = |p: &Evaluated| is_place(&p.z, &p.x) && p.cost.is_finite() && p.residuals.len() == m;
        setup.space.is_same_space(&self.setup.space)
            && self.setup.tolerances.check().is_ok()
            && self.options.check().is_ok()
            && self.origin.len() == n
            && self.origin.iter().enumerate().all(|(k, u)| {
                let (lower, upper) = setup.space.working_bounds(k);
                u.is_finite() && (lower..=upper).contains(u)
            })
            && is_length(self.rho)
            && is_length(self.delta)
            && !self.f_0.is_nan()
            && self.best_seen.is_sound(n_user)
            && self.points.iter().all(is_point)
            && self.round.iter().all(is_candidate)
            && self.failed.iter().all(|z| z.len() == n && z.iter().all(|z| z.is_finite()))
            && self.set.iter().chain(&self.improving).all(|k| *k < len)
            && self.set.len() <= n + 1
            && self.model.as_ref().is_none_or(|model| model.is_sound(n, m) && model.base < self.set.len())
            && self.requested.iter().all(|k| *k < self.round.len())
            && self.halt.as_ref().is_none_or(|halt| halt.z.len() == n)
            && (self.set.is_empty() == matches!(self.phase, Phase::Starting | Phase::NoStart))
            && match &self.phase {
                Phase::Rounds(rounds) => rounds.is_sound(n, len),
                Phase::Averaging(averaging) => averaging.is_sound(n),
                // The simplex search started with the sizes found during the run.
                Phase::Simplex(simplex) => simplex.is_sound(&simplex_method(), &self.setup),
                _ => true,
            }
    }

    /// Returns the start, or its neighbour along a coordinate. The first neighbour is on the side with more
    /// space, the second on the other side. Further retries alternate nearer to the start.
    fn neighbour(&self, coordinate: Option<usize>, retries: u32) -> Vec<f64> {
        let mut z = vec![0.0; self.n()];
        if let Some(k) = coordinate {
            let room = self.room_around(&z);
            let (below, above) = (&room.lower, &room.upper);
            let nearer: f64 = if self.setup.space.size_is_unknown(k) { 0.03 } else { 0.5 };
            let length = self.delta * nearer.powi((retries / 2) as i32);
            let forward = if above[k] >= length || above[k] >= -below[k] { 1.0 } else { -1.0 };
            let sign = if retries.is_multiple_of(2) { forward } else { -forward };
            z[k] = (sign * length).clamp(below[k], above[k]);
            if z[k] == 0.0 {
                z[k] = (-sign * length).clamp(below[k], above[k]);
            }
            if !room.rows.iter().all(|row| row.contains(&z)) {
                let unit: Vec<f64> = (0..z.len()).map(|j| if j == k { 1.0 } else { 0.0 }).collect();
                z = room.along(&unit, z[k]);
            }
        }
        z
    }

    /// Adds a point to the round. The box and the rounding of the user's units shift the point slightly.
    pub(super) fn ask_for(&mut self, z: Vec<f64>, role: Role) {
        let (z, x) = self.placed(&z);
        self.round.push(Candidate { role, z, x, retries: 0, status: PointStatus::Pending });
    }

    fn placed(&self, z: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let space = &self.setup.space;
        let inside = |(k, z): (usize, &f64)| {
            let ((lower, upper), size) = (space.working_bounds(k), space.size(k));
            let u = clamp(self.origin[k] + z * size, lower, upper, self.origin[k]);
            // Rounding must not keep a point from its bound.
            let near = |bound: f64| (u - bound).abs() <= 8.0 * f64::EPSILON * bound.abs().max(size);
            [lower, upper].into_iter().find(|bound| bound.is_finite() && near(*bound)).unwrap_or(u)
        };
        let mut u: Vec<f64> = z.iter().enumerate().map(inside).collect();
        space.restore(&mut u);
        let mut x = vec![0.0; space.n()];
        space.to_user(&u, &mut x);
        (u.iter().enumerate().map(|(k, u)| self.scaled(k, *u)).collect(), x)
    }

    /// Returns the displacement of a working coordinate from the start, in units of the parameter size.
    pub(super) fn scaled(&self, k: usize, u: f64) -> f64 {
        (u - self.origin[k]) / self.setup.space.size(k)
    }

    /// Returns the absolute value of a working coordinate, in units of the parameter size.
    pub(super) fn magnitude(&self, z: &[f64], k: usize) -> f64 {
        (self.origin[k] / self.setup.space.size(k) + z[k]).abs()
    }

    /// Returns the unit of `x_tol`, in units of the parameter sizes.
    fn x_unit(&self) -> f64 {
        let space = &self.setup.space;
        match self.setup.tolerances.measure {
            ToleranceMeasure::Relative => 1.0,
            ToleranceMeasure::Absolute => (0..space.n_free()).map(|k| space.size(k)).fold(0.0, f64::max),
        }
    }

    /// Returns the largest distance that passes the x test, in units of the parameter sizes.
    pub(super) fn x_limit(&self) -> f64 {
        self.setup.tolerances.x_tol / self.x_unit()
    }

    /// Applies the tolerance tests to a distance in units of the parameter sizes and a decrease.
    pub(super) fn judge(&self, distance: f64, decrease: f64, f: f64) -> ToleranceTests {
        let tests = self.setup.tolerances.judge(distance * self.x_unit(), Some(decrease), f, self.f_0);
        ToleranceTests { extent: TestedSet::Model, is_of_squares: self.has_other_cost, ..tests }
    }

    /// Returns the bounds and the linear inequalities for steps from a point.
    pub(super) fn room_around(&self, z: &[f64]) -> Room {
        let space = &self.setup.space;
        let ends = |(k, z): (usize, &f64)| {
            let (lower, upper) = space.working_bounds(k);
            ((self.scaled(k, lower) - z).min(0.0), (self.scaled(k, upper) - z).max(0.0))
        };
        let (lower, upper) = z.iter().enumerate().map(ends).unzip();
        let u: Vec<f64> = (0..z.len()).map(|k| self.origin[k] + z[k] * space.size(k)).collect();
        let row = |row: &HalfSpace| {
            let normal: Vec<f64> = row.normal.iter().enumerate().map(|(k, a)| a * space.size(k)).collect();
            let (length, limit) = (norm(&normal), row.limit - row.value(&u));
            HalfSpace {
                normal: normal.iter().map(|a| a / length).collect(),
                limit: (limit / length).max(0.0),
            }
        };
        Room { lower, upper, rows: space.rows().iter().map(row).collect() }
    }

    /// Returns the point with the smallest sum of squares, the oldest if they are equal.
    pub(super) fn best_of(&self, points: impl Iterator<Item = usize>) -> Option<usize> {
        points.min_by(|a, b| self.points[*a].cost.total_cmp(&self.points[*b].cost).then(a.cmp(b)))
    }

    /// Returns the base point of the model.
    pub(super) fn base(&self) -> usize {
        self.best_of(self.set.iter().copied()).unwrap_or(0)
    }

    /// Records the answer for a requested point. A failed neighbour of the start is retried at another
    /// position.
    fn take(&mut self, place: usize, answer: Option<(f64, Vec<f64>)>) {
        let Candidate { role, z, x, retries, .. } = &self.round[place];
        if answer.is_none() {
            if self.failed.len() == MOST_FAILED {
                self.failed.remove(0);
            }
            self.failed.push(z.clone());
        }
        let status = match (answer, role) {
            (Some((cost, residuals)), _) => {
                let (z, x) = (z.clone(), x.clone());
                self.keep(z, x, cost, residuals);
                PointStatus::Point(self.points.len() - 1)
            }
            (None, Role::Start(Some(coordinate))) if *retries < MOST_RETRIES && !self.points.is_empty() => {
                let retries = retries + 1;
                let (z, x) = self.placed(&self.neighbour(Some(*coordinate), retries));
                self.round[place] = Candidate { z, x, retries, ..self.round[place].clone() };
                return;
            }
            (None, _) => PointStatus::Failed,
        };
        self.round[place].status = status;
    }

    /// Stores a point with its cost and residuals.
    pub(super) fn keep(&mut self, z: Vec<f64>, x: Vec<f64>, cost: f64, residuals: Vec<f64>) {
        self.best_seen.offer(&x, cost);
        let squares = sum_of_squares(&residuals);
        self.has_other_cost |= (cost - squares).abs() > ROUNDING * squares;
        self.points.push(Evaluated { z, x, cost: squares, residuals });
    }

    /// Processes a round after all its points are known.
    fn conclude(&mut self) {
        let round = std::mem::take(&mut self.round);
        match &self.phase {
            Phase::Starting => {
                if !self.resized(&round) {
                    self.started();
                }
            }
            Phase::Rounds(_) => self.rounded(&round),
            Phase::Descending => self.descended(&round),
            Phase::Averaging(_) => self.averaged(&round),
            Phase::Simplex(_) | Phase::NoStart | Phase::Ended(_) => {}
        }
        self.forget();
    }

    /// Determines unknown parameter sizes from steps along the coordinates. A step of one size changes the
    /// residuals by about their own magnitude. Requests new steps for all changed sizes. Returns false if no
    /// size has changed.
    fn resized(&mut self, round: &[Candidate]) -> bool {
        let Some(start) = self.points.first().filter(|_| self.n_resized < MOST_RESIZED) else { return false };
        let mut found = Vec::new();
        for candidate in round {
            let (Role::Start(Some(k)), PointStatus::Point(new)) = (&candidate.role, candidate.status) else {
                continue;
            };
            let new = &self.points[new];
            let way = (new.z[*k] - start.z[*k]).abs();
            if !self.setup.space.size_is_unknown(*k) || way == 0.0 {
                continue;
            }
            let change = distance(&new.residuals, &start.residuals) / way;
            let factor = (start.cost.sqrt() / change).clamp(1e-6, 1e6);
            let factor = if change == 0.0 { 1e3 } else { factor };
            // A step must not exceed the width of the box.
            let (lower, upper) = self.setup.space.working_bounds(*k);
            let before = self.setup.space.size(*k);
            let size = (before * factor).clamp(1e-150, 1e150).min(upper - lower);
            if !(0.2..=5.0).contains(&factor) && size != before {
                found.push((*k, size));
            }
        }
        self.n_resized += 1;
        if !found.is_empty() {
            // The coordinates of failed points used the old units.
            self.failed.clear();
        }
        found.iter().for_each(|(k, size)| self.setup.space.set_unit(*k, *size));
        let mut u = vec![0.0; self.n()];
        for point in 0..self.points.len() {
            self.setup.space.to_working(&self.points[point].x, &mut u);
            self.points[point].z = u.iter().enumerate().map(|(k, u)| self.scaled(k, *u)).collect();
        }
        for (k, _) in &found {
            self.ask_for(self.neighbour(Some(*k), 0), Role::Start(Some(*k)));
        }
        !found.is_empty()
    }

    fn started(&mut self) {
        let Some(best) = self.best_of(0..self.points.len()) else {
            self.phase = Phase::NoStart;
            return;
        };
        // The start is the first requested point. If it failed, another point is used.
        self.f_0 = self.points[0].cost;
        self.operation = Some(Operation::Initial);
        self.phase = if self.n() == 0 { Phase::Ended(Termination::AllFixed) } else { self.first_phase() };
        if self.points.len() == self.n() + 1 {
            self.set = (0..self.points.len()).collect();
        } else {
            self.choose_set(best);
        }
    }

    /// Removes the farthest points if there are too many. Removes a sixteenth more than necessary, so that
    /// this does not happen again immediately.
    pub(super) fn forget(&mut self) {
        let m = self.points.first().map_or(1, |point| point.residuals.len().max(1));
        let most = (MOST_KEPT * (self.n() + 1)).min(MOST_NUMBERS / m).max(2 * (self.n() + 1));
        if self.points.len() <= most
            || self.set.is_empty()
            || !self.round.is_empty()
            || self.improving.is_some()
        {
            return;
        }
        let centre = self.points[self.base()].z.clone();
        let mut is_kept = vec![false; self.points.len()];
        self.set.iter().for_each(|k| is_kept[*k] = true);
        if let Phase::Rounds(rounds) = &mut self.phase {
            rounds.points().for_each(|k| is_kept[*k] = true);
        }
        let far = |k: usize| (distance(&self.points[k].z, &centre), k);
        let mut others: Vec<(f64, usize)> = (0..is_kept.len()).filter(|k| !is_kept[*k]).map(far).collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let n_kept = is_kept.iter().filter(|kept| **kept).count();
        let places = (most - most / 16).saturating_sub(n_kept);
        others.iter().take(places).for_each(|(_, k)| is_kept[*k] = true);
        let moved = |k: &mut usize| *k = is_kept.iter().take(*k).filter(|kept| **kept).count();
        self.set.iter_mut().for_each(moved);
        moved(&mut self.completed.0);
        if let Phase::Rounds(rounds) = &mut self.phase {
            rounds.points().for_each(moved);
        }
        let mut kept = is_kept.iter();
        self.points.retain(|_| kept.next() == Some(&true));
    }
}

impl Method for LeastSquaresState {
    fn name(&self) -> &'static str {
        "least-squares"
    }

    fn ask(&mut self, batch: &mut Batch) {
        self.ask_unless(&RunContext::new(), batch);
    }

    fn ask_unless(&mut self, context: &RunContext<'_>, batch: &mut Batch) {
        batch.start(self.setup.space.n(), self.n_batches, self.n_points);
        batch.set_kind(EvaluationKind::Residuals);
        self.requested.clear();
        if self.round.is_empty() {
            let filled = self.ask_round(context).and_then(|()| self.descend(context));
            if filled.is_err() {
                self.waiting = false;
                return;
            }
            if let Phase::Averaging(_) = &self.phase {
                self.average();
            }
        }
        if let Phase::Simplex(simplex) = &mut self.phase {
            simplex.ask(batch);
            batch.set_kind(EvaluationKind::Residuals);
            self.simplex_points = batch.points().map(<[f64]>::to_vec).collect();
            self.waiting = !batch.is_empty();
            return;
        }
        let is_first = |c: &Candidate| c.role == Role::Start(None) && c.status == PointStatus::Pending;
        let is_first = self.n() >= LARGE && self.round.first().is_some_and(is_first);
        let at_once = match &self.phase {
            _ if is_first => 1,
            Phase::Rounds(_) => self.options.batch.width(self.n()),
            _ => self.round.len(),
        };
        let pending = self.round.iter().enumerate().filter(|(_, c)| c.status == PointStatus::Pending);
        for (k, candidate) in pending.take(at_once) {
            batch.push(&candidate.x, f64::INFINITY);
            self.requested.push(k);
        }
        self.waiting = !self.requested.is_empty();
    }

    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        self.tell_last(&mut answers.clone())
    }

    fn tell_last(&mut self, answers: &mut Answers) -> Result<(), Error> {
        if matches!(self.phase, Phase::Simplex(_)) {
            return self.tell_simplex(answers);
        }
        let requested = self.requested.len();
        let received = answers.len();
        if !self.waiting {
            return Err(Error::TellWithoutAsk);
        }
        if received > requested {
            return Err(Error::TooManyOutcomes { requested, received });
        }
        if let Some(m) = (0..received).find_map(|k| answers.residuals(k)).map(<[f64]>::len)
            && self.points.is_empty()
        {
            // The residuals of the method, and a working copy.
            memory::check("the residuals of n + 1 points", &[2 * m, self.n() + 1])?;
        }
        self.waiting = false;
        self.n_batches += 1;
        self.n_points += requested as u64;
        for k in 0..received {
            let outcome = &answers.outcomes()[k];
            if outcome.is_conclusive() {
                let cost = outcome.value();
                let value = cost.zip(answers.take_residuals(k));
                self.take(self.requested[k], value.filter(|(_, r)| sum_of_squares(r).is_finite()));
            }
        }
        self.requested.clear();
        if self.round.iter().all(|candidate| candidate.status != PointStatus::Pending) {
            self.conclude();
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

    fn details(&self) -> MethodDetails<'_> {
        let details = MethodDetails {
            n_iterations: self.n_iterations,
            operation: self.operation,
            tests: self.tests,
            plan: if self.options.batch == StepPlan::Rounds { "rounds" } else { "serial" },
            lookahead: match self.options.batch {
                StepPlan::Points(points) if points > 1 => Lookahead::Points(points),
                _ => Lookahead::None,
            },
            ..MethodDetails::default()
        };
        match &self.phase {
            Phase::Simplex(simplex) => {
                let details = simplex.details(details);
                let is_of_squares = self.has_other_cost;
                let tests = details.tests.map(|tests| ToleranceTests { is_of_squares, ..tests });
                MethodDetails { simplex: None, tests, ..details }
            }
            _ => details,
        }
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        self.best_seen.get()
    }

    fn linear_model(&self, context: &RunContext<'_>) -> Option<LinearModel> {
        let best = self.best_of(0..self.points.len())?;
        let jacobian = self.jacobian(best, context)?;
        let (space, Evaluated { x, residuals, .. }) = (&self.setup.space, &self.points[best]);
        let derivative = |i: usize, k: usize| jacobian[(i, k)] / space.size(k);
        let mut model = LinearModel::new(space, x, residuals.len(), derivative)?;
        if space.has_linear() {
            let gradient =
                |k: usize| residuals.iter().enumerate().map(|(i, r)| 2.0 * r * derivative(i, k)).sum();
            let hessian = |k: usize, j: usize| {
                (0..residuals.len()).map(|i| 2.0 * derivative(i, k) * derivative(i, j)).sum()
            };
            model.constrain(space, x, gradient, hessian);
            if self.has_other_cost {
                model.multipliers.clear();
            }
        }
        Some(model)
    }

    fn save(&self) -> Option<Vec<u8>> {
        saved(self)
    }
}

/// Returns the simplex method used after points have failed.
pub(super) fn simplex_method() -> NelderMead {
    NelderMead::default().batch(Lookahead::None)
}
