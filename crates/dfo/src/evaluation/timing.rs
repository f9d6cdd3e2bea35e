//! Measured times of evaluations, and of handing them to other threads: they decide if that pays.

use std::collections::VecDeque;
use std::time::Duration;

/// Handing work to other threads pays where it saves more than twice the time that it took lately. Before
/// that is measured, it counts as so many seconds: a waiting thread is running after 0.05 to 0.5 ms.
const HANDOVER_SECONDS: f64 = 100e-6;
/// It never counts as less.
const LEAST_HANDOVER_SECONDS: f64 = 20e-6;
/// Evaluations whose median says how long one takes, and jobs whose median says how long handing over takes.
const N_RECENT: usize = 9;
/// Weight of a new measurement beside the longest of all before.
const WEIGHT: f64 = 0.25;
/// An evaluation that takes no longer does not keep the calling thread from looking for interrupts.
const SHORT: Duration = Duration::from_millis(20);

/// The last measurements, the oldest replaced first; their (lower) median is moved by one that was disturbed
/// only while it is alone.
#[derive(Debug)]
struct Recent(VecDeque<f64>);

impl Recent {
    fn new() -> Self {
        Self(VecDeque::with_capacity(N_RECENT))
    }

    fn push(&mut self, seconds: f64) {
        if self.0.len() == N_RECENT {
            self.0.pop_front();
        }
        self.0.push_back(seconds);
    }

    fn median(&self) -> Option<f64> {
        let mut sorted = [f64::INFINITY; N_RECENT];
        sorted.iter_mut().zip(&self.0).for_each(|(place, seconds)| *place = *seconds);
        sorted.sort_by(f64::total_cmp);
        let len = self.0.len();
        (len > 0).then(|| sorted[(len - 1) / 2])
    }
}

/// Measures evaluations, and what handing them over takes.
#[derive(Debug)]
pub(super) struct Timing {
    evaluations: Recent,
    handovers: Recent,
    /// The longest of the last evaluations.
    longest: f64,
}

impl Timing {
    pub(super) fn new() -> Self {
        Self { evaluations: Recent::new(), handovers: Recent::new(), longest: 0.0 }
    }

    /// An evaluation took so long.
    pub(super) fn evaluated(&mut self, seconds: f64) {
        self.evaluations.push(seconds);
        self.longest = seconds.max(self.longest * (1.0 - WEIGHT));
    }

    /// Between handing a job to a thread that was free and its answer lay so many seconds without its
    /// evaluation.
    pub(super) fn handed_over(&mut self, seconds: f64) {
        self.handovers.push(seconds.max(LEAST_HANDOVER_SECONDS));
    }

    /// Seconds that handing over must save.
    fn worthwhile(&self) -> f64 {
        2.0 * self.handovers.median().unwrap_or(HANDOVER_SECONDS)
    }

    /// True if handing over one more point at once pays; `None` while nothing is measured.
    pub(super) fn is_long(&self) -> Option<bool> {
        self.evaluations.median().map(|seconds| seconds >= self.worthwhile())
    }

    /// True if so many points are better evaluated on the calling thread than by so many workers; `None`
    /// while nothing is measured.
    pub(super) fn stays(&self, points: usize, workers: usize) -> Option<bool> {
        let saved = (points - points.div_ceil(workers.max(1))) as f64;
        self.evaluations.median().map(|seconds| saved * seconds <= self.worthwhile())
    }

    /// True if no evaluation keeps the calling thread from other things.
    pub(super) fn is_short(&self) -> bool {
        self.longest <= SHORT.as_secs_f64()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_evaluations_stay_where_they_are() {
        let timing = |handover: f64, evaluation: f64| {
            let mut timing = Timing::new();
            assert!(timing.is_long().is_none() && timing.stays(8, 4).is_none());
            for _ in 0..N_RECENT {
                timing.evaluated(evaluation);
                timing.handed_over(handover);
            }
            timing
        };
        // The second measurement makes good for a first one that was disturbed.
        let mut disturbed = Timing::new();
        disturbed.evaluated(0.05);
        disturbed.evaluated(1e-6);
        assert_eq!((disturbed.is_long(), disturbed.stays(8, 4)), (Some(false), Some(true)));
        // What handing over takes in this run decides, not what it takes as a rule.
        assert_eq!(timing(30e-6, 100e-6).is_long(), Some(true));
        assert_eq!(timing(100e-6, 150e-6).is_long(), Some(false));
        assert_eq!(timing(0.0, 1e-6).is_long(), Some(false));
        // One point has nothing beside it; of many, short ones are worth it.
        assert_eq!(
            (timing(30e-6, 1.0).stays(1, 4), timing(30e-6, 1e-6).stays(1000, 4)),
            (Some(true), Some(false))
        );
        assert!(timing(0.0, 1e-3).is_short() && !timing(0.0, 0.1).is_short());
    }
}
