//! State of a running fit for other threads.

use crate::fit::output_fit::KeptResiduals;
use crate::problem::residual_layout::ResidualLayout;
use dfo::{Outcome, Progress, RobustLoss};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Maximum number of recorded costs. If it is reached, about half of them are dropped.
const MOST_COSTS: usize = 4096;

/// Maximum numbers of recorded failed points and of counted failure reasons.
const MOST_FAILED: usize = 10;
const MOST_REASONS: usize = 50;

/// State of a fit while it runs, see [`FitOptions::live`](crate::FitOptions::live). It requires no extra
/// simulations, because the search has already computed the residuals at the best point.
#[derive(Debug, Default)]
pub struct LiveFit {
    state: Mutex<LiveState>,
    /// Evaluations in progress.
    running: Mutex<Vec<RunningPoint>>,
}

/// Snapshot of a running fit.
#[derive(Debug, Clone, Default)]
pub(crate) struct LiveState {
    pub(crate) n_iterations: usize,
    pub(crate) n_evaluations: usize,
    pub(crate) n_failed: usize,
    /// Best point and its cost.
    pub(crate) best: Option<(Vec<f64>, f64)>,
    /// Evaluation numbers and their costs. If there are many, only the improvements and a part of the others.
    pub(crate) costs: Vec<(f64, f64)>,
    /// Failure reasons and the number of evaluations that failed for each.
    pub(crate) failures: Vec<(String, usize)>,
    /// Last points that failed, newest first, with the reasons.
    pub(crate) failed: VecDeque<(Vec<f64>, String)>,
    search: Option<LiveSearch>,
    /// Number of iterations of the previous searches.
    before: usize,
}

/// Current search.
#[derive(Debug, Clone)]
struct LiveSearch {
    layout: ResidualLayout,
    loss: RobustLoss,
    kept: Arc<Mutex<KeptResiduals>>,
}

/// Residuals of a search without weights and loss, at its start and at the best point so far.
pub(crate) struct LiveResiduals {
    pub(crate) layout: ResidualLayout,
    pub(crate) at_start: Option<Vec<f64>>,
    pub(crate) at_best: Vec<f64>,
}

/// Evaluation in progress.
#[derive(Debug, Clone)]
pub(crate) struct RunningPoint {
    id: u64,
    pub(crate) since: Instant,
    pub(crate) x: Vec<f64>,
}

/// Guard of an evaluation in progress, which ends when the guard is dropped.
pub(crate) struct Running<'a> {
    live: &'a LiveFit,
    id: u64,
}

/// Locks a mutex and ignores poisoning, because the data are consistent at all times.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl LiveFit {
    /// Begins a search that stores its residuals in `kept`.
    pub(crate) fn begin(&self, layout: &ResidualLayout, loss: RobustLoss, kept: &Arc<Mutex<KeptResiduals>>) {
        let mut state = lock(&self.state);
        state.search = Some(LiveSearch { layout: layout.clone(), loss, kept: Arc::clone(kept) });
        state.before = state.n_iterations;
        lock(&self.running).clear();
    }

    /// Records an iteration of the search.
    pub(crate) fn note(&self, progress: &Progress<'_>) {
        let mut state = lock(&self.state);
        state.n_iterations = state.before + progress.n_iterations;
        state.best = Some((progress.x.to_vec(), progress.fun));
        for entry in progress.recent() {
            state.n_evaluations += 1;
            match entry.outcome {
                Outcome::Value(cost) => state.add_cost(*cost),
                Outcome::Failed(failure) if failure.kind.is_of_point() => {
                    state.add_failed(entry.x, &failure.message)
                }
                _ => {}
            }
        }
    }

    /// Records the start of an evaluation.
    pub(crate) fn add(&self, id: u64, x: &[f64]) {
        lock(&self.running).push(RunningPoint { id, since: Instant::now(), x: x.to_vec() });
    }

    /// Records the end of an evaluation.
    pub(crate) fn remove(&self, id: u64) {
        lock(&self.running).retain(|running| running.id != id);
    }

    /// Records the start of an evaluation. Dropping the returned guard records its end.
    pub(crate) fn running(&self, id: u64, x: &[f64]) -> Running<'_> {
        self.add(id, x);
        Running { live: self, id }
    }

    /// Returns a snapshot of the state.
    pub(crate) fn state(&self) -> LiveState {
        lock(&self.state).clone()
    }

    /// Returns the evaluations in progress, longest-running first.
    pub(crate) fn under_way(&self) -> Vec<RunningPoint> {
        let mut running = lock(&self.running).clone();
        running.sort_by_key(|running| running.since);
        running
    }
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        self.live.remove(self.id);
    }
}

impl LiveState {
    fn add_cost(&mut self, cost: f64) {
        self.costs.push((self.n_evaluations as f64, cost));
        if self.costs.len() >= MOST_COSTS {
            let mut best = f64::INFINITY;
            let (mut k, mut n_better) = (0, 0);
            let mut is_kept = |cost: f64| {
                let is_better = cost < best;
                best = best.min(cost);
                k += 1;
                n_better += usize::from(is_better);
                // If there are many improvements, drop every second one.
                if is_better { n_better < MOST_COSTS / 4 || n_better % 2 == 0 } else { k % 2 == 0 }
            };
            self.costs.retain(|(_, cost)| is_kept(*cost));
        }
    }

    fn add_failed(&mut self, x: &[f64], reason: &str) {
        self.n_failed += 1;
        match self.failures.iter().position(|(state, _)| state == reason) {
            Some(k) => self.failures[k].1 += 1,
            None if self.failures.len() < MOST_REASONS => self.failures.push((reason.to_owned(), 1)),
            None => {}
        }
        if self.failed.len() == MOST_FAILED {
            self.failed.pop_back();
        }
        self.failed.push_front((x.to_vec(), reason.to_owned()));
    }

    /// Returns the residuals of the current search. Returns `None` before the first successful simulation and
    /// while the best point comes from an earlier search.
    pub(crate) fn residuals(&self) -> Option<LiveResiduals> {
        let LiveSearch { layout, loss, kept } = self.search.as_ref()?;
        // Hold the lock briefly because the search waits for it.
        let (at_start, at_best) = {
            let kept = lock(kept);
            let at_best = match &self.best {
                Some((_, cost)) => kept.at_best_within(*cost),
                None => kept.at_best(),
            };
            (kept.at_start().map(<[f64]>::to_vec), at_best?.to_vec())
        };
        let plain = |residuals: Vec<f64>| {
            let weights = layout.outputs.iter().flat_map(|output| output.weights.iter());
            residuals.iter().zip(weights).map(|(r, weight)| loss.inverse(*r) / weight).collect()
        };
        Some(LiveResiduals { at_start: at_start.map(plain), at_best: plain(at_best), layout: layout.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn live_costs_are_thinned_but_keep_rare_improvements() {
        let mut state = LiveState::default();
        for k in 1..=100_000_usize {
            state.n_evaluations = k;
            state.add_cost(if k.is_multiple_of(10_000) { 1.0 / k as f64 } else { 5.0 });
        }
        assert!(state.costs.len() < MOST_COSTS, "{}", state.costs.len());
        let best = |k: usize| state.costs.contains(&(k as f64, 1.0 / k as f64));
        assert!((1..=10).all(|k| best(k * 10_000)));
        assert!(state.costs.is_sorted_by(|a, b| a.0 < b.0));
        let mut falling = LiveState::default();
        for k in 1..=100_000_usize {
            falling.n_evaluations = k;
            falling.add_cost(1.0 / k as f64);
        }
        assert!(falling.costs.len() < MOST_COSTS, "{}", falling.costs.len());
    }

    #[test]
    fn live_state_counts_failure_reasons_and_keeps_last_failed_points() {
        let mut state = LiveState::default();
        (0..200).for_each(|k| state.add_failed(&[f64::from(k)], &format!("reason {}", k % 70)));
        assert_eq!(
            (state.n_failed, state.failures.len(), state.failed.len()),
            (200, MOST_REASONS, MOST_FAILED)
        );
        assert_eq!(state.failures[0], ("reason 0".to_owned(), 3));
        assert_eq!(state.failed[0], (vec![199.0], "reason 59".to_owned()));
    }

    #[test]
    fn evaluation_is_in_progress_until_its_guard_is_dropped() {
        let live = LiveFit::default();
        let first = live.running(1, &[1.0]);
        let second = live.running(2, &[2.0]);
        let x = |live: &LiveFit| live.under_way().into_iter().map(|running| running.x).collect::<Vec<_>>();
        assert_eq!(x(&live), [[1.0], [2.0]]);
        drop(first);
        assert_eq!(x(&live), [[2.0]]);
        drop(second);
        assert!(live.under_way().is_empty());
    }
}
