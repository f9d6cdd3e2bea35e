//! Measurement of the time spent in calls, at low cost: each slow call is timed, but only some fast ones.

use std::time::{Duration, Instant};

/// A call that takes less time (in seconds) is fast.
const FAST: f64 = 1e-6;

/// After this number of consecutive fast calls, only some of the next calls are timed.
const TRUST: u32 = 8;

/// One call out of this number is then timed. It is a prime, so that it is not always the same stage of a
/// step.
const STRIDE: u32 = 61;

/// A call among fast ones that takes longer than this counts only once, because the scheduler probably
/// interrupted it.
const LONGEST: f64 = 1e-4;

/// Times of one kind of calls.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    seconds: f64,
    /// Seconds of the last timed fast call.
    usual: f64,
    /// Number of consecutive fast calls.
    fast: u32,
    /// Number of next calls that are not timed.
    left: u32,
}

impl Tally {
    /// Number of untimed calls between two timed calls.
    fn skipped(&self) -> u32 {
        if self.fast >= TRUST { STRIDE - 1 } else { 0 }
    }

    /// Number of calls since the last timed call.
    fn untimed(&self) -> f64 {
        f64::from(self.skipped() - self.left)
    }
}

/// Estimates the time spent in calls of `KINDS` kinds.
///
/// Reading the clock takes as long as a short call (20 to 30 ns). After 8 consecutive calls of a kind below 1
/// us, only one of 61 calls is timed. Its time also counts for the untimed calls before it. This ends when a
/// timed call takes longer. Otherwise, each call is timed. The time of reading the clock is measured once and
/// subtracted. A call of more than 0.1 ms among fast calls counts only once, because the scheduler, for
/// example, may have interrupted it.
///
/// ```
/// let mut watch = ode::Stopwatch::<1>::new();
/// for _ in 0..3 {
///     let timing = watch.start(0);
///     std::thread::sleep(std::time::Duration::from_millis(2));
///     watch.stop(timing);
/// }
/// assert!(watch.seconds() >= 0.0059);
/// ```
#[derive(Debug, Clone)]
pub struct Stopwatch<const KINDS: usize> {
    tallies: [Tally; KINDS],
    /// Smallest difference of two successive clock readings, in seconds.
    reading: f64,
}

/// A call in progress.
#[derive(Debug)]
#[must_use = "stop() takes it"]
pub struct Timing {
    kind: usize,
    began: Option<Instant>,
}

impl<const KINDS: usize> Default for Stopwatch<KINDS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const KINDS: usize> Stopwatch<KINDS> {
    /// Creates a stopwatch and measures the time of reading the clock.
    pub fn new() -> Self {
        let readings = [(); 4].map(|()| Instant::now());
        let apart = readings.windows(2).map(|pair| pair[1].duration_since(pair[0]));
        let reading = apart.min().unwrap_or(Duration::ZERO).as_secs_f64();
        Self { tallies: [Tally::default(); KINDS], reading }
    }

    /// Resets the times. The kinds known to be fast are kept.
    pub fn reset(&mut self) {
        for tally in &mut self.tallies {
            (tally.seconds, tally.left) = (0.0, tally.skipped());
        }
    }

    /// Starts the measurement of a call of this kind.
    #[inline]
    pub fn start(&mut self, kind: usize) -> Timing {
        if self.skips(kind) { Timing { kind, began: None } } else { self.start_timed(kind) }
    }

    /// True if the starting call of this kind is not timed.
    #[inline]
    pub(crate) fn skips(&mut self, kind: usize) -> bool {
        let tally = &mut self.tallies[kind];
        let skips = tally.left > 0;
        tally.left -= u32::from(skips);
        skips
    }

    /// Starts a measurement that always times the call, for kinds whose duration varies widely.
    #[inline(never)]
    pub fn start_timed(&mut self, kind: usize) -> Timing {
        Timing { kind, began: Some(Instant::now()) }
    }

    /// Ends the measurement. Returns the duration of this call in seconds if it was timed, and otherwise the
    /// duration of the last timed fast call.
    #[inline]
    pub fn stop(&mut self, timing: Timing) -> f64 {
        match timing.began {
            Some(began) => self.take(timing.kind, began),
            None => self.tallies[timing.kind].usual,
        }
    }

    /// Not inlined, because most calls are not timed.
    #[inline(never)]
    fn take(&mut self, kind: usize, began: Instant) -> f64 {
        self.enter(kind, began.elapsed().as_secs_f64() - self.reading)
    }

    fn enter(&mut self, kind: usize, seconds: f64) -> f64 {
        let tally = &mut self.tallies[kind];
        let (seconds, untimed) = (seconds.max(0.0), tally.untimed());
        if seconds < FAST {
            tally.fast = tally.fast.saturating_add(1);
            tally.usual = seconds;
        } else {
            tally.fast = 0;
        }
        let each = if seconds < LONGEST { seconds } else { tally.usual };
        tally.seconds += seconds + untimed * each;
        tally.left = tally.skipped();
        seconds
    }

    /// Estimated time of all calls so far, in seconds.
    pub fn seconds(&self) -> f64 {
        self.tallies.iter().map(|tally| tally.seconds + tally.untimed() * tally.usual).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Makes calls with these durations in nanoseconds. Returns the number of timed calls and the estimate in
    /// ns.
    fn estimate(calls: impl IntoIterator<Item = f64>) -> (usize, f64) {
        let mut watch = Stopwatch::<2>::new();
        let mut timed = 0;
        for nanoseconds in calls {
            let timing = watch.start(1);
            if timing.began.is_some() {
                timed += 1;
                watch.enter(1, 1e-9 * nanoseconds);
            }
        }
        (timed, (1e9 * watch.seconds()).round())
    }

    #[test]
    fn fast_calls_are_sampled() {
        // The first 8, then each 61st.
        assert_eq!(estimate([20.0; 8 + 610]), (8 + 10, 618.0 * 20.0));
        // The last calls are not timed, but they count.
        assert_eq!(estimate([20.0; 8 + 660]), (8 + 10, 668.0 * 20.0));
    }

    #[test]
    fn every_slow_call_is_timed() {
        assert_eq!(estimate([2000.0; 50]), (50, 100_000.0));
        // The first slow call that is timed also counts for those before it. From then on, each call is
        // timed.
        let calls = [20.0; 8].into_iter().chain([5000.0; 161]);
        assert_eq!(estimate(calls), (8 + 101, 8.0 * 20.0 + 161.0 * 5000.0));
        // Occasional slow calls: each call is timed.
        let calls: Vec<f64> = (0..300).map(|k| if k % 8 == 3 { 3e6 } else { 20.0 }).collect();
        assert_eq!(estimate(calls.iter().copied()), (300, calls.iter().sum()));
    }

    #[test]
    fn long_call_among_fast_ones_counts_once() {
        // The 69th call is timed and takes 4 ms.
        let calls = (0..900).map(|k| if k == 68 { 4e6 } else { 20.0 });
        let (timed, estimate) = estimate(calls);
        assert_eq!(estimate, 4e6 + 899.0 * 20.0);
        assert_eq!(timed, 8 + 1 + 8 + (900 - 8 - 61 - 8) / 61);
    }

    #[test]
    fn kinds_are_independent_and_reset_keeps_fast_kinds() {
        let mut watch = Stopwatch::<2>::new();
        for _ in 0..TRUST {
            watch.enter(0, 1e-7);
            // Less than the time of reading the clock.
            watch.enter(1, -1.0);
        }
        watch.enter(1, 1.0);
        assert!((watch.seconds() - 1e-7 * f64::from(TRUST) - 1.0).abs() < 1e-15);
        assert!(
            watch.start(0).began.is_none()
                && watch.start(1).began.is_some()
                && watch.start_timed(0).began.is_some()
        );
        watch.reset();
        assert_eq!(watch.seconds(), 0.0);
        assert!(watch.start(0).began.is_none() && watch.start(1).began.is_some());
    }

    #[test]
    fn untimed_call_returns_last_fast_duration() {
        let mut watch = Stopwatch::<1>::new();
        for nanoseconds in [2000.0, 10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 20.0] {
            assert_eq!(watch.enter(0, 1e-9 * nanoseconds), 1e-9 * nanoseconds);
        }
        let timing = watch.start(0);
        assert!(timing.began.is_none());
        assert_eq!(watch.stop(timing), 2e-8);
    }
}
