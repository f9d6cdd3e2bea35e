//! Measured durations of evaluations and of handing them to other threads. They determine whether handing
//! over is worthwhile.

use std::collections::VecDeque;
use std::time::Duration;

/// Assumed handover time in seconds before it is measured: a waiting thread starts after 0.05 to 0.5 ms.
/// Handing work to other threads is worthwhile if it saves more than twice the recent handover time.
const HANDOVER_SECONDS: f64 = 100e-6;
/// Lower limit of the measured handover time in seconds.
const LEAST_HANDOVER_SECONDS: f64 = 20e-6;
/// Number of recent evaluations and handovers whose medians are the current estimates.
const N_RECENT: usize = 9;
/// Weight of a new measurement relative to the previous maximum.
const WEIGHT: f64 = 0.25;
/// Maximum duration of an evaluation that does not prevent the calling thread from checking for interrupts.
const SHORT: Duration = Duration::from_millis(20);

/// The most recent measurements; the oldest is replaced first. A single outlier has little effect on their
/// (lower) median.
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

/// Measures the durations of evaluations and handovers.
#[derive(Debug)]
pub(super) struct Timing {
    evaluations: Recent,
    handovers: Recent,
    /// Longest of the recent evaluations, in seconds.
    longest: f64,
}

impl Timing {
    pub(super) fn new() -> Self {
        Self { evaluations: Recent::new(), handovers: Recent::new(), longest: 0.0 }
    }

    /// Records the duration of an evaluation in seconds.
    pub(super) fn evaluated(&mut self, seconds: f64) {
        self.evaluations.push(seconds);
        self.longest = seconds.max(self.longest * (1.0 - WEIGHT));
    }

    /// Records a handover time in seconds: the time between handing a job to a free thread and its answer,
    /// without its evaluation.
    pub(super) fn handed_over(&mut self, seconds: f64) {
        self.handovers.push(seconds.max(LEAST_HANDOVER_SECONDS));
    }

    /// Returns the time in seconds that handing over must save.
    fn worthwhile(&self) -> f64 {
        2.0 * self.handovers.median().unwrap_or(HANDOVER_SECONDS)
    }

    /// True if it is worthwhile to hand over one more point; `None` without measurements.
    pub(super) fn is_long(&self) -> Option<bool> {
        self.evaluations.median().map(|seconds| seconds >= self.worthwhile())
    }

    /// True if it is faster to evaluate this number of points on the calling thread than with this number of
    /// workers. `None` without measurements.
    pub(super) fn stays(&self, points: usize, workers: usize) -> Option<bool> {
        let saved = (points - points.div_ceil(workers.max(1))) as f64;
        self.evaluations.median().map(|seconds| saved * seconds <= self.worthwhile())
    }

    /// True if evaluations are short enough for the calling thread to remain responsive.
    pub(super) fn is_short(&self) -> bool {
        self.longest <= SHORT.as_secs_f64()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_evaluations_stay_on_the_calling_thread() {
        let timing = |handover: f64, evaluation: f64| {
            let mut timing = Timing::new();
            assert!(timing.is_long().is_none() && timing.stays(8, 4).is_none());
            for _ in 0..N_RECENT {
                timing.evaluated(evaluation);
                timing.handed_over(handover);
            }
            timing
        };
        // The second measurement compensates for a disturbed first one.
        let mut disturbed = Timing::new();
        disturbed.evaluated(0.05);
        disturbed.evaluated(1e-6);
        assert_eq!((disturbed.is_long(), disturbed.stays(8, 4)), (Some(false), Some(true)));
        // The handover time of this run matters, not the default.
        assert_eq!(timing(30e-6, 100e-6).is_long(), Some(true));
        assert_eq!(timing(100e-6, 150e-6).is_long(), Some(false));
        assert_eq!(timing(0.0, 1e-6).is_long(), Some(false));
        // A single point cannot run in parallel. With many points, even short evaluations are worth handing
        // over.
        assert_eq!(
            (timing(30e-6, 1.0).stays(1, 4), timing(30e-6, 1e-6).stays(1000, 4)),
            (Some(true), Some(false))
        );
        assert!(timing(0.0, 1e-3).is_short() && !timing(0.0, 0.1).is_short());
    }
}
