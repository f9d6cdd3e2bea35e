//! Population, step size and start point of restarts.

use super::options::{CmaEs, Restarts};
use crate::method_interface::rng::Stream;
use crate::methods::shared::population::MAX_MEMBERS;
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};

/// Maximum number of times that the population is doubled (Auger and Hansen 2005, Hansen 2009).
const MOST_DOUBLED: u32 = 9;

/// The previous runs and the current run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Schedule {
    kind: Restarts,
    /// Population and step size of the first run.
    members: usize,
    sigma: f64,
    n_doubled: u32,
    /// True if the current run uses a small population.
    is_small: bool,
    /// Number of evaluations of all runs with large populations, of all with small ones, and of the last with
    /// a large one.
    n_large: usize,
    n_small: usize,
    n_last_large: usize,
    n_runs: usize,
    /// Limit of the successive restarts without a better point, and their number so far.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    patience: Option<usize>,
    #[serde(default, skip_serializing_if = "is_zero")]
    n_idle: usize,
    /// Best cost of the runs before the current run; `None` in the first run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    best: Option<f64>,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

impl Schedule {
    pub(super) fn new(options: &CmaEs, members: usize) -> Self {
        Self {
            kind: options.restarts,
            members,
            sigma: options.sigma,
            n_doubled: 0,
            is_small: false,
            n_large: 0,
            n_small: 0,
            n_last_large: 0,
            n_runs: 0,
            patience: options.patience,
            n_idle: 0,
            best: None,
        }
    }

    /// True if a run must end after `n_generations`. The limit is `100 + 50 (n + 3)^2 / sqrt(population)`
    /// generations (Hansen 2009, MaxIter). A run with a small population also ends after half of the
    /// evaluations of the last run with a large population.
    pub(super) fn is_over(&self, n: usize, members: usize, n_generations: usize) -> bool {
        let most = 100.0 + 50.0 * (n as f64 + 3.0).powi(2) / (members as f64).sqrt();
        let spent = self.is_small && n_generations * members >= self.n_last_large / 2;
        self.kind != Restarts::None && (spent || n_generations as f64 > most)
    }

    /// Records the best cost of the ended run. Returns true if the limit of restarts without a better point
    /// is reached. A decrease below `least`, the limit of the f test, does not count.
    pub(super) fn is_out_of_patience(&mut self, cost: f64, least: f64) -> bool {
        let Some(most) = self.patience else { return false };
        match self.best {
            Some(best) if best - cost.min(best) <= least => self.n_idle += 1,
            _ => self.n_idle = 0,
        }
        self.best = Some(self.best.map_or(cost, |best| best.min(cost))).filter(|best| best.is_finite());
        self.n_idle >= most
    }

    /// Returns the population and step size of the next run, if there is one. `n_evaluations` is the number
    /// of evaluations of the ended run.
    pub(super) fn next(&mut self, n_evaluations: usize, stream: &mut Stream) -> Option<(usize, f64)> {
        if self.kind == Restarts::None {
            return None;
        }
        if self.is_small {
            self.n_small += n_evaluations;
        } else if self.n_runs > 0 {
            self.n_large += n_evaluations;
            self.n_last_large = n_evaluations;
        }
        self.n_runs += 1;
        self.is_small = self.kind == Restarts::Bipop && self.n_small < self.n_large;
        if self.is_small {
            let (u, v) = (stream.uniform(), stream.uniform());
            let ratio = 0.5 * f64::from(2u32.pow(self.n_doubled));
            let members = (self.members as f64 * ratio.powf(u * u)) as usize;
            return Some((members.clamp(2, MAX_MEMBERS), self.sigma * 10f64.powf(-2.0 * v)));
        }
        self.n_doubled += 1;
        let members = self.members.saturating_mul(2usize.pow(self.n_doubled.min(MOST_DOUBLED)));
        (self.n_doubled <= MOST_DOUBLED && members <= MAX_MEMBERS).then_some((members, self.sigma))
    }

    /// Returns the index of the current run; the first is 0.
    pub(super) fn n_runs(&self) -> usize {
        self.n_runs
    }
}

/// Draws the start point of a restart, in working coordinates. The point is uniform in the box. Along a
/// parameter without a box, it is normally distributed around the start point. The standard deviation is then
/// the size of the parameter.
pub(super) fn draw_start(space: &Space, stream: &mut Stream, u: &mut [f64]) {
    space.to_working(space.x0(), u);
    for (k, u) in u.iter_mut().enumerate() {
        let (lower, upper) = space.working_bounds(k);
        let drawn = match space.width(k) {
            Some(_) => stream.between(lower, upper),
            None => stream.normal(*u, space.size(k)),
        };
        *u = if drawn.is_finite() { drawn.clamp(lower, upper) } else { *u };
    }
    space.restore(u);
}
