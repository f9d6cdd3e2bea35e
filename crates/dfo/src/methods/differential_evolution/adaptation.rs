//! Adaptation of L-SHADE: memories of successful factors, the archive of replaced targets, and the shrinking
//! of the population.

use super::options::Adaptive;
use crate::method_interface::rng::Stream;
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use serde::{Deserialize, Serialize};

/// Maximum number of values for which the archive reserves memory at the start.
const MOST_RESERVED: usize = 1 << 20;

/// Memories, archive and the factors of the current generation.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Adaptation {
    pub(super) options: Adaptive,
    first_population: usize,
    budget: usize,
    memory_f: Vec<f64>,
    /// `None` if every success of the entry had zero crossover probability. Such an entry stays `None`.
    memory_cr: Vec<Option<f64>>,
    next: usize,
    /// Concatenated working coordinates of replaced targets.
    archive: Vec<f64>,
    n: usize,
    successes: Vec<Success>,
}

/// A trial that beat its target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Success {
    f: f64,
    cr: f64,
    gain: f64,
    /// True if the gain is a decrease of the violation of constraints.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    is_of_violation: bool,
}

/// Decrease of the cost, or of the violation if the target is infeasible. `None` if the decrease is unknown
/// or zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gain {
    decrease: f64,
    is_of_violation: bool,
}

impl Gain {
    pub(super) fn between(before: Cost, after: Cost) -> Option<Self> {
        let (decrease, is_of_violation) = match (before, after) {
            (Cost::Value(before), Cost::Value(after)) => (before - after, false),
            (Cost::Infeasible(before), Cost::Infeasible(after)) => (before - after, true),
            (Cost::Infeasible(before), Cost::Value(_)) => (before, true),
            _ => return None,
        };
        (decrease > 0.0).then_some(Self { decrease, is_of_violation })
    }
}

impl Adaptation {
    pub(super) fn new(options: Adaptive, first_population: usize, budget: usize, n: usize) -> Self {
        let capacity = (options.archive * first_population as f64) as usize + first_population + 1;
        // The memory of a huge archive is allocated when it fills.
        let capacity = capacity.saturating_mul(n).min(MOST_RESERVED);
        Self {
            options,
            first_population,
            budget,
            memory_f: vec![0.5; options.memory],
            memory_cr: vec![Some(0.5); options.memory],
            next: 0,
            archive: Vec::with_capacity(capacity),
            n,
            successes: Vec::with_capacity(first_population),
        }
    }

    /// Draws `F` and `CR` of an individual from a Cauchy and a normal distribution around a memory entry,
    /// width 0.1.
    pub(super) fn factors(&self, stream: &mut Stream) -> (f64, f64) {
        let entry = stream.below(self.memory_f.len());
        let cr = match self.memory_cr[entry] {
            Some(mean) => stream.normal(mean, 0.1).clamp(0.0, 1.0),
            None => 0.0,
        };
        loop {
            let f = stream.cauchy(self.memory_f[entry], 0.1);
            if f > 0.0 {
                return (f.min(1.0), cr);
            }
        }
    }

    /// Creates the donor of a target: current-to-pbest/1 with archive.
    pub(super) fn donor(
        &self,
        stream: &mut Stream,
        population: &RankedPoints,
        target: usize,
        weight: f64,
        out: &mut [f64],
    ) {
        let len = population.len();
        let elite = ((self.options.p_best * len as f64).round() as usize).max(2);
        // Only members with a cost can be among the best.
        let elite = elite.min(population.n_finite()).max(1);
        let best = population.order()[stream.below(elite)];
        let r1 = loop {
            let candidate = stream.below(len);
            if candidate != target {
                break candidate;
            }
        };
        let r2 = loop {
            let candidate = stream.below(len + self.n_archived());
            if candidate != target && candidate != r1 {
                break candidate;
            }
        };
        let second = match r2.checked_sub(len) {
            None => population.u(r2),
            Some(archived) => &self.archive[archived * self.n..(archived + 1) * self.n],
        };
        let (x, best, first) = (population.u(target), population.u(best), population.u(r1));
        for (k, v) in out.iter_mut().enumerate() {
            *v = x[k] + weight * (best[k] - x[k]) + weight * (first[k] - second[k]);
        }
    }

    fn n_archived(&self) -> usize {
        self.archive.len().checked_div(self.n).unwrap_or(0)
    }

    /// Records a trial that ranks strictly better than a target with a known cost or violation.
    pub(super) fn succeeded(&mut self, f: f64, cr: f64, gain: Gain, target: &[f64]) {
        self.archive.extend_from_slice(target);
        let Gain { decrease, is_of_violation } = gain;
        self.successes.push(Success { f, cr, gain: decrease, is_of_violation });
    }

    /// Updates the memories with the gain-weighted Lehmer means of the successes of a generation.
    pub(super) fn learn(&mut self) {
        if self.successes.is_empty() {
            return;
        }
        // Weights are relative to the largest gain, so that the sum cannot overflow.
        // Costs and violations have different units.
        let largest_of = |is_of_violation: bool| {
            let same_unit = self.successes.iter().filter(|s| s.is_of_violation == is_of_violation);
            same_unit.fold(0.0f64, |m, s| m.max(s.gain))
        };
        let largest = [largest_of(false), largest_of(true)];
        let weight = |s: &Success| {
            let largest = largest[usize::from(s.is_of_violation)];
            if largest.is_finite() { s.gain / largest } else { 1.0 }
        };
        let lehmer = |value: fn(&Success) -> f64| {
            let (mut squares, mut sum) = (0.0, 0.0);
            for s in &self.successes {
                squares += weight(s) * value(s) * value(s);
                sum += weight(s) * value(s);
            }
            (sum > 0.0).then(|| squares / sum)
        };
        if let Some(f) = lehmer(|s| s.f) {
            self.memory_f[self.next] = f;
        }
        let was_ended = self.memory_cr[self.next].is_none();
        self.memory_cr[self.next] = if was_ended { None } else { lehmer(|s| s.cr) };
        self.next = (self.next + 1) % self.memory_f.len();
        self.successes.clear();
    }

    /// Returns the population size after `n_evaluations`. It decreases linearly from the first to the final
    /// size.
    pub(super) fn population_after(&self, n_evaluations: usize) -> usize {
        let (first, last) = (self.first_population as f64, self.options.final_population as f64);
        let done = (n_evaluations as f64 / self.budget.max(1) as f64).min(1.0);
        (first + (last - first) * done).round() as usize
    }

    /// Removes random members of the archive until its size fits the population size.
    pub(super) fn trim_archive(&mut self, members: usize, stream: &mut Stream) {
        let capacity = (self.options.archive * members as f64).round() as usize;
        while self.n_archived() > capacity {
            let (out, last) = (stream.below(self.n_archived()), self.n_archived() - 1);
            self.archive.copy_within(last * self.n..(last + 1) * self.n, out * self.n);
            self.archive.truncate(last * self.n);
        }
    }

    /// True if the state is consistent with the numbers of parameters and members.
    pub(super) fn is_sound(&self, n: usize, members: usize) -> bool {
        // Without free parameters, the population has one member.
        let is_whole = n == 0 || self.options.final_population <= members;
        let is_factor = |f: &f64| *f > 0.0 && *f <= 1.0;
        is_whole
            && members <= self.first_population
            && self.n == n
            && self.archive.iter().all(|u| u.is_finite())
            && self.successes.iter().all(|s| is_factor(&s.f) && (0.0..=1.0).contains(&s.cr) && s.gain >= 0.0)
            && self.memory_cr.iter().flatten().all(|cr| (0.0..=1.0).contains(cr))
            && self.archive.len().is_multiple_of(n.max(1))
            && !self.memory_f.is_empty()
            && self.memory_f.len() == self.memory_cr.len()
            && self.next < self.memory_f.len()
            && self.memory_f.iter().all(is_factor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method_interface::rng::Purpose;

    fn gain(decrease: f64) -> Gain {
        Gain { decrease, is_of_violation: false }
    }

    #[test]
    fn gains_of_costs_and_violations_are_weighed_separately() {
        let mut a = adaptation();
        a.succeeded(0.4, 0.2, gain(1e6), &[0.0]);
        let of_violation = Gain::between(Cost::Infeasible(1e-3), Cost::Value(1e9)).unwrap();
        a.succeeded(0.8, 0.6, of_violation, &[1.0]);
        a.learn();
        // Equal weights: (0.16 + 0.64) / (0.4 + 0.8)
        assert!((a.memory_f[0] - 0.8 / 1.2).abs() < 1e-15, "{:?}", a.memory_f);
        assert_eq!(Gain::between(Cost::Failed, Cost::Value(1.0)), None);
        assert_eq!(Gain::between(Cost::Infeasible(1.0), Cost::Infeasible(1.0)), None);
    }

    fn adaptation() -> Adaptation {
        Adaptation::new(Adaptive::default(), 36, 1000, 1)
    }

    #[test]
    fn memories_are_weighted_lehmer_means() {
        let mut a = adaptation();
        a.succeeded(0.4, 0.2, gain(1.0), &[0.0]);
        a.succeeded(0.8, 0.6, gain(3.0), &[1.0]);
        a.learn();
        // (0.25 * 0.16 + 0.75 * 0.64) / (0.25 * 0.4 + 0.75 * 0.8)
        assert!((a.memory_f[0] - 0.52 / 0.7).abs() < 1e-15, "{:?}", a.memory_f);
        assert!((a.memory_cr[0].unwrap() - (0.04 + 3.0 * 0.36) / (0.2 + 3.0 * 0.6)).abs() < 1e-15);
        assert_eq!((a.next, a.memory_f[1], a.n_archived()), (1, 0.5, 2));
        a.learn();
        assert_eq!(a.next, 1);
    }

    #[test]
    fn crossover_memory_stays_none_after_zero_crossover() {
        let mut a = adaptation();
        for round in 0..2 {
            a.next = 0;
            a.succeeded(0.5, if round == 0 { 0.0 } else { 0.9 }, gain(1.0), &[0.0]);
            a.learn();
            assert_eq!(a.memory_cr[0], None);
        }
        a.memory_cr.fill(None);
        let (f, cr) = a.factors(&mut Stream::new(1, Purpose::Individual, 0, 0));
        assert!(cr == 0.0 && f > 0.0 && f <= 1.0);
    }

    #[test]
    fn population_shrinks_linearly() {
        let a = adaptation();
        assert_eq!([0, 500, 1000, 5000].map(|e| a.population_after(e)), [36, 20, 4, 4]);
    }

    #[test]
    fn archive_size_is_bounded() {
        let mut a = adaptation();
        (0..100).for_each(|k| a.succeeded(0.5, 0.5, gain(1.0), &[f64::from(k)]));
        a.trim_archive(10, &mut Stream::new(1, Purpose::Generation, 0, 0));
        let mut left = a.archive.clone();
        left.dedup();
        assert_eq!((a.n_archived(), left.len()), (26, 26));
    }

    #[test]
    fn memories_stay_finite_when_gain_is_infinite() {
        let mut a = adaptation();
        a.succeeded(0.4, 0.2, gain(f64::INFINITY), &[0.0]);
        a.succeeded(0.8, 0.6, gain(1.0), &[1.0]);
        a.learn();
        assert!(a.memory_f[0].is_finite() && a.memory_cr[0].unwrap().is_finite());
    }
}
