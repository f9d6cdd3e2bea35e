//! The running search: sampling of a generation, and the update of the distribution.

use super::boundary::Boundary;
use super::distribution::{Distribution, TWO_POINTS_FROM};
use super::integers::{Integers, has_integers};
use super::lagrangian::Lagrangian;
use super::options::{CmaBounds, CmaEs};
use super::restarts::{Schedule, draw_start};
use super::weights::Weights;
use crate::method_interface::interface::{Lookahead, Setup};
use crate::method_interface::rng::{Purpose, Stream};
use crate::method_interface::tolerances::{TestedSet, ToleranceTests};
use crate::methods::shared::cost::Cost;
use crate::methods::shared::generations::{GenerationRules, Generations, Populations};
use crate::methods::shared::ranked_points::RankedPoints;
use crate::outcome::answer::Outcome;
use crate::outcome::termination::Termination;
use crate::problem::constraints::Constraints;
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Number of consecutive generations without any cost after which a run ends.
const MOST_BARREN: usize = 50;

/// Maximum number of generations used by the stagnation test (Hansen 2009).
const MOST_RECENT: usize = 20_000;

/// State of CMA-ES except its population, which is the last generation.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct CmaRules {
    handling: CmaBounds,
    weights: Weights,
    distribution: Distribution,
    /// Concatenated steps of the individuals, and their squared lengths in units of the distribution.
    steps: Vec<f64>,
    squared: Vec<f64>,
    normals: Vec<f64>,
    point: Vec<f64>,
    /// Maximum number of individuals drawn ahead of selection. `ahead` contains the drawn ones, concatenated,
    /// in the coordinates of the distribution.
    #[serde(default)]
    lag: usize,
    #[serde(default)]
    ahead: VecDeque<f64>,
    /// Number of individuals of the last generation drawn from earlier distributions.
    #[serde(default)]
    n_earlier: usize,
    /// The best point since the last restart, in working coordinates.
    best: Vec<f64>,
    best_cost: f64,
    /// Number of generations since the last restart, since the best point changed, and since the last
    /// generation with a cost.
    n_generations: usize,
    idle: usize,
    barren: usize,
    /// Best and median cost of each generation since the best point changed, limited to the last ones.
    #[serde(default)]
    recent: VecDeque<[f64; 2]>,
    /// True if floating-point numbers can no longer resolve the extent of the distribution.
    degenerate: bool,
    schedule: Schedule,
    /// Rules for integers; `None` if all parameters are continuous.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    integers: Option<Integers>,
    /// Coefficients of the nonlinear constraints.
    #[serde(default, skip_serializing_if = "Lagrangian::is_empty")]
    lagrangian: Lagrangian,
}

/// Returns the maximum number of individuals drawn ahead of selection for this population size. With twice
/// the population, the ellipsoid and Rosenbrock's function with 20 parameters were not solved (both are in
/// `benches/lag.rs`).
fn most_ahead(lag: usize, members: usize) -> usize {
    lag.min(members + members / 2)
}

/// Returns the number of generations without a better point after which a run ends if all costs are equal
/// (Hansen 2009, TolFunHist).
fn most_flat(n: usize, members: usize) -> usize {
    10 + (30 * n).div_ceil(members)
}

/// Converts working coordinates to the coordinates of the distribution.
fn unbend(point: &mut [f64], space: &Space, handling: CmaBounds) {
    for (k, u) in point.iter_mut().enumerate() {
        *u = Boundary::new(space, k, handling).unbend(*u);
    }
}

/// Minimum population for two-point adaptation. In a smaller population, its two individuals leave too few
/// for other directions.
const LEAST_FOR_TWO_POINTS: usize = 4;

/// Returns the lead of the first individual over the second in ranks, as a fraction of the generation. Equal
/// costs have equal rank.
fn lead(generation: &RankedPoints) -> f64 {
    let rank = |slot: usize| {
        let cost = generation.cost(slot).value().unwrap_or(f64::INFINITY);
        (0..generation.len())
            .filter(|k| generation.cost(*k).value().is_some_and(|other| other < cost))
            .count() as f64
    };
    (rank(1) - rank(0)) / (generation.len() - 1) as f64
}

impl CmaRules {
    pub(super) fn begin(options: &CmaEs, setup: Setup, members: usize, seed: u64) -> Generations<Self> {
        let (space, n) = (&setup.space, setup.space.n_free());
        let mut best = vec![0.0; n];
        space.to_working(space.x0(), &mut best);
        let mut mean = best.clone();
        unbend(&mut mean, space, options.bounds_handling);
        let mut rules = Self {
            handling: options.bounds_handling,
            weights: Weights::new(n, members),
            distribution: Distribution::new(mean, options.sigma),
            steps: Vec::new(),
            squared: Vec::new(),
            normals: vec![0.0; n],
            point: vec![0.0; n],
            lag: options.lag,
            ahead: VecDeque::new(),
            n_earlier: 0,
            best,
            best_cost: f64::INFINITY,
            n_generations: 0,
            idle: 0,
            barren: 0,
            recent: VecDeque::new(),
            degenerate: false,
            schedule: Schedule::new(options, members),
            integers: Integers::of(space),
            lagrangian: Lagrangian::new(&setup.constraints, !space.rows().is_empty()),
        };
        let mut population = RankedPoints::new(space, members);
        rules.draw(seed, 0, members, space, &mut population);
        // The start point is an individual of the first generation, with a zero step.
        if setup.start_given || n == 0 {
            population.place_exactly(0, space.x0(), space);
            rules.steps[..n].fill(0.0);
            rules.squared[0] = 0.0;
        }
        let candidates = RankedPoints::new(space, members);
        Generations::new(rules, Populations { setup, seed, population, candidates })
    }

    /// Builds a generation from the individuals drawn ahead and from new ones. Then draws the individuals
    /// ahead of the next selection. Each individual uses a separate random stream.
    fn draw(&mut self, seed: u64, generation: u64, members: usize, space: &Space, into: &mut RankedPoints) {
        let n = space.n_free();
        self.steps.resize(members * n, 0.0);
        self.squared.resize(members, 0.0);
        self.n_earlier = members.min(self.n_ahead(n));
        self.lagrangian.start(members);
        let Self { steps, squared, normals, point, distribution, ahead, integers, lagrangian, .. } = self;
        let stretch = |k: usize| integers.as_ref().map_or(1.0, |i| i.stretch(k));
        let mut drawn = vec![0.0; if space.rows().is_empty() { 0 } else { n }];
        let Distribution { mean, sigma, .. } = &*distribution;
        let boundary = |k| Boundary::new(space, k, self.handling);
        for i in 0..members {
            let step = &mut steps[i * n..(i + 1) * n];
            if i < self.n_earlier {
                for (k, v) in ahead.drain(..n).enumerate() {
                    step[k] = (v - mean[k]) / (sigma * space.size(k) * stretch(k));
                    point[k] = boundary(k).bend(v, 0.0);
                }
                squared[i] = distribution.inject(step, normals);
            } else {
                let mut stream = Stream::new(seed, Purpose::Individual, generation, i);
                squared[i] = distribution.draw(&mut stream, normals, step);
                if i < 2 && distribution.has_line() {
                    squared[i] = squared[0];
                    distribution.draw_on_line(i == 0, squared[i], step, normals);
                }
                for (k, u) in point.iter_mut().enumerate() {
                    *u = boundary(k).bend(mean[k] + sigma * space.size(k) * stretch(k) * step[k], mean[k]);
                }
            }
            if !space.satisfies_rows(point) {
                drawn.copy_from_slice(point);
                space.restore(point);
                let moved = drawn.iter().zip(&*point).enumerate();
                lagrangian.set_moved(i, moved.map(|(k, (v, u))| ((v - u) / space.size(k)).powi(2)).sum());
            }
            into.place(i, point, space);
        }
        for i in ahead.len() / n.max(1)..if n == 0 { 0 } else { most_ahead(self.lag, members) } {
            let (later, slot) = (1 + (i / members) as u64, i % members);
            let mut stream = Stream::new(seed, Purpose::Individual, generation + later, slot);
            distribution.draw(&mut stream, normals, point);
            for (k, y) in point.iter().enumerate() {
                let v = mean[k] + sigma * space.size(k) * stretch(k) * y;
                ahead.push_back(if v.is_finite() { v } else { mean[k] });
            }
        }
    }

    /// Returns the best individual of a generation, with its cost, if it is better than the best point since
    /// the last restart. Coefficients of constraints change the Lagrangian from generation to generation, so
    /// this compares costs and violations themselves.
    fn improved(&mut self, generation: &RankedPoints) -> Option<(usize, f64)> {
        if self.lagrangian.is_empty() {
            let slot = generation.best();
            return Some((slot, generation.cost(slot).value().filter(|cost| *cost < self.best_cost)?));
        }
        let (slot, rank) = self.lagrangian.best()?;
        let stored = match self.lagrangian.best_violation {
            0.0 => Cost::Value(self.best_cost),
            violation => Cost::Infeasible(violation),
        };
        if !rank.better_than(stored) {
            return None;
        }
        self.lagrangian.best_violation = match rank {
            Cost::Infeasible(violation) => violation,
            _ => 0.0,
        };
        Some((slot, rank.value().unwrap_or(f64::INFINITY)))
    }

    /// Ranks a complete generation with nonlinear constraints, and learns from it.
    fn learn_with_constraints(&mut self, generation: &mut RankedPoints, setup: &Setup) {
        let Setup { space, constraints, .. } = setup;
        let n = space.n_free();
        let variance = (0..n).map(|k| self.distribution.deviation(k).powi(2)).sum::<f64>() / n.max(1) as f64;
        self.lagrangian.prepare(generation, constraints, (n, variance));
        self.learn(generation, space);
        self.lagrangian.adapt(generation, &self.weights, constraints, space.n_free());
    }

    /// Returns the number of individuals drawn ahead of selection.
    fn n_ahead(&self, n: usize) -> usize {
        self.ahead.len() / n.max(1)
    }

    /// Updates the distribution from a ranked generation.
    fn learn(&mut self, generation: &RankedPoints, space: &Space) {
        let n = space.n_free();
        self.n_generations += 1;
        self.idle += 1;
        if self.recent.len() >= MOST_RECENT {
            self.recent.pop_front();
        }
        let cost = |rank: usize| generation.cost(generation.order()[rank]).value().unwrap_or(f64::INFINITY);
        self.recent.push_back([cost(0), cost(generation.len() / 2)]);
        if generation.cost(generation.best()).is_ranked() {
            let improved = self.improved(generation);
            if let Some(integers) = &mut self.integers {
                let points = improved.map(|(slot, _)| (&*self.best, generation.u(slot)));
                integers.record_best(points, space);
            }
            if let Some((slot, cost)) = improved {
                self.best_cost = cost;
                self.best.copy_from_slice(generation.u(slot));
                self.idle = 0;
                self.recent.clear();
            }
            self.barren = 0;
        } else {
            self.barren += 1;
            self.point.copy_from_slice(&self.best);
            unbend(&mut self.point, space, self.handling);
            self.distribution.retreat(&self.point);
            return;
        }
        if let Some(integers) = &self.integers {
            let ranked = &generation.order()[..generation.n_finite()];
            integers.centre(&self.distribution, space, &self.weights, ranked, &mut self.steps);
        }
        let step_of =
            |&slot: &usize| Some((self.steps.get(slot * n..(slot + 1) * n)?, *self.squared.get(slot)?));
        let ranked = generation.order()[..generation.n_finite()].iter().filter_map(step_of);
        let lead = (self.lag == 0 && n >= TWO_POINTS_FROM && generation.len() >= LEAST_FOR_TWO_POINTS)
            .then(|| lead(generation));
        let stretch = |k: usize| self.integers.as_ref().map_or(1.0, |integers| integers.stretch(k));
        self.distribution
            .update(&self.weights, ranked, self.n_earlier == 0, lead, |k| space.size(k) * stretch(k));
        // If it were wider than the box along every parameter, the distribution would be almost uniform.
        let excess = |k: usize| match space.width(k) {
            Some(width) => self.distribution.deviation(k) * stretch(k) * space.size(k) / (0.5 * width),
            None => 0.0,
        };
        let least = (0..n).map(excess).fold(f64::INFINITY, f64::min);
        if least > 1.0 && least.is_finite() {
            self.distribution.sigma /= least;
        }
        if let Some(integers) = &mut self.integers {
            integers.widen(&self.distribution, space, &self.weights);
        }
    }

    /// True if a run is stuck. If all costs are equal, uses the limit of the test for equal function values
    /// (Hansen 2009). Otherwise, uses its stagnation test, which requires that neither the best nor the
    /// median costs decrease. With a start near the minimum and a first step that is far too long, these
    /// costs decrease first. A point that is better than the start follows much later.
    fn has_stalled(&self, n: usize, members: usize, is_flat: bool) -> bool {
        let rate = (30 * n).div_ceil(members);
        let most = (120 + rate + self.n_generations / 5).min(MOST_RECENT - 1);
        if is_flat {
            self.idle > most_flat(n, members)
        } else {
            self.recent.len() > most && !self.falls(most)
        }
    }

    /// True if the best or the median costs decrease over the given number of generations. Compares the
    /// median of the last three tenths with the median of the first three tenths.
    fn falls(&self, generations: usize) -> bool {
        let (first, share) = (self.recent.len() - generations, generations * 3 / 10);
        let median = |first: usize, which: usize| {
            let mut costs: Vec<f64> = self.recent.range(first..first + share).map(|of| of[which]).collect();
            costs.select_nth_unstable_by(share / 2, f64::total_cmp);
            costs[share / 2]
        };
        (0..2).any(|which| median(self.recent.len() - share, which) < median(first, which))
    }
}

impl GenerationRules for CmaRules {
    fn name(&self) -> &'static str {
        "cma-es"
    }

    fn make_candidates(&mut self, generation: u64, pool: &mut Populations) {
        let Populations { setup, seed, candidates, .. } = pool;
        self.degenerate = !self.distribution.refresh(&self.weights);
        let members = self.weights.of_rank.len();
        candidates.resize(members);
        self.draw(*seed, generation, members, &setup.space, candidates);
    }

    /// Returns infinity, because every rank counts.
    fn cutoff(&self, _: &Populations, _: usize) -> f64 {
        f64::INFINITY
    }

    /// Replaces the population by the candidates, whatever their costs.
    fn select(&mut self, pool: &mut Populations) {
        let Populations { setup, population, candidates, .. } = pool;
        if self.lagrangian.is_empty() {
            candidates.rank();
            self.learn(candidates, &setup.space);
        } else {
            self.learn_with_constraints(candidates, setup);
        }
        std::mem::swap(population, candidates);
    }

    fn started(&mut self, pool: &mut Populations) {
        let Populations { setup, population, .. } = pool;
        if population.n_finite() == 0 {
            return;
        }
        if self.lagrangian.is_empty() {
            self.learn(population, &setup.space);
        } else {
            self.learn_with_constraints(population, setup);
        }
    }

    /// With nonlinear constraints, individuals rank by the augmented Lagrangian.
    fn cost_of(&mut self, slot: usize, outcome: &Outcome, constraints: &Constraints, values: &[f64]) -> Cost {
        if self.lagrangian.is_empty() {
            Cost::of(outcome, constraints, values)
        } else {
            self.lagrangian.enter(slot, outcome, constraints, values)
        }
    }

    fn lookahead(&self) -> Lookahead {
        if self.lag == 0 { Lookahead::None } else { Lookahead::Measured }
    }

    /// Offers the individuals drawn ahead.
    fn look_ahead(
        &mut self,
        pool: &Populations,
        _: bool,
        _: &dyn Fn(usize) -> Option<Cost>,
        found: &mut dyn FnMut(&[f64], f64) -> bool,
    ) {
        let (space, n) = (&pool.setup.space, pool.setup.space.n_free());
        let mut x = space.x0().to_vec();
        for i in 0..self.n_ahead(n) {
            for (k, v) in self.ahead.range(i * n..(i + 1) * n).enumerate() {
                self.point[k] = Boundary::new(space, k, self.handling).bend(*v, 0.0);
            }
            space.restore(&mut self.point);
            space.to_user(&self.point, &mut x);
            if !found(&x, f64::INFINITY) {
                break;
            }
        }
    }

    /// Tests the individuals with the integers of the best one, because the others differ by whole numbers.
    fn judge_others(&self, pool: &Populations, f_0: f64) -> Option<ToleranceTests> {
        let Populations { setup: Setup { space, tolerances, .. }, population, .. } = pool;
        self.integers.as_ref().map(|_| population.judge(TestedSet::SameIntegers, space, tolerances, f_0))
    }

    /// True while the integers of the best point are new.
    fn tries_neighbours(&self, space: &Space) -> bool {
        let most = most_flat(space.n_free(), self.weights.of_rank.len());
        self.integers.as_ref().is_some_and(|integers| integers.is_young(most))
    }

    fn ended(&mut self, pool: &Populations, _: Cost) -> Option<Termination> {
        let Populations { setup: Setup { space, .. }, population, .. } = pool;
        let (n, members) = (space.n_free(), population.len());
        let is_flat = population.f_spread(population.order()) == Some(0.0);
        if self.degenerate || population.is_collapsed(space) {
            Some(Termination::Collapsed)
        } else if self.barren >= MOST_BARREN {
            Some(Termination::AllFailed)
        } else if self.has_stalled(n, members, is_flat)
            || self.schedule.is_over(n, members, self.n_generations)
        {
            Some(Termination::Stalled)
        } else {
            None
        }
    }

    fn restart(&mut self, pool: &Populations, f_0: f64) -> bool {
        let (space, n) = (&pool.setup.space, pool.setup.space.n_free());
        let least = pool.setup.tolerances.judge(0.0, None, self.best_cost, f_0).f_limit;
        if self.schedule.is_out_of_patience(self.best_cost, least) {
            return false;
        }
        let mut stream = Stream::new(pool.seed, Purpose::Restart, 0, self.schedule.n_runs());
        let n_evaluations = self.n_generations * self.weights.of_rank.len();
        let Some((members, sigma)) = self.schedule.next(n_evaluations, &mut stream) else { return false };
        self.weights = Weights::new(n, members);
        draw_start(space, &mut stream, &mut self.best);
        let mut mean = self.best.clone();
        unbend(&mut mean, space, self.handling);
        self.distribution = Distribution::new(mean, sigma);
        self.integers = Integers::of(space);
        self.ahead.clear();
        self.lagrangian = Lagrangian::new(&pool.setup.constraints, !space.rows().is_empty());
        self.best_cost = f64::INFINITY;
        (self.n_generations, self.idle, self.barren, self.degenerate) = (0, 0, 0, false);
        self.recent.clear();
        true
    }

    fn is_sound(&self, pool: &Populations) -> bool {
        let (n, members) = (pool.setup.space.n_free(), self.weights.of_rank.len());
        let n_drawn = self.squared.len();
        self.distribution.is_sound(n)
            && self.weights.is_sound(members)
            && members >= 1
            && self.steps.len() == n_drawn * n
            && (n_drawn == pool.candidates.len() || n_drawn == pool.population.len())
            && [&self.normals, &self.point, &self.best].iter().all(|v| v.len() == n)
            && self.n_earlier <= n_drawn
            && self.integers.is_some() == has_integers(&pool.setup.space)
            && self.integers.as_ref().is_none_or(|integers| integers.is_sound(n))
            && (self.ahead.is_empty() || self.ahead.len() == most_ahead(self.lag, members) * n)
            && self.ahead.iter().all(|v| v.is_finite())
            && pool.population.len() >= 1
            && self.lagrangian.is_sound(&pool.setup.constraints, n_drawn)
            && self.lagrangian.has_rows() != pool.setup.space.rows().is_empty()
    }
}
