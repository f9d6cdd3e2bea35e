//! How many points to evaluate at once, from the times that evaluations take: it decides which thread computes what and
//! when, never the path of a method.

use crate::method::Lookahead;
use std::cell::Cell;
use std::collections::VecDeque;
use std::time::Duration;

/// Handing work to other threads pays where it saves more than twice the time that it took lately. Before that is measured,
/// it counts as so many seconds: a waiting thread is running after 0.05 to 0.5 ms.
const DISPATCH_SECONDS: f64 = 100e-6;
/// It never counts as less.
const LEAST_DISPATCH_SECONDS: f64 = 20e-6;
/// Rounds in which a width is tried, and those after which it is tried again. One point at a time advances by one
/// evaluation in each round, so that a single one shows how fast it is; of more points it varies how many are of use.
const TRIAL_ROUNDS: usize = 4;
const FIRST_WAIT: usize = 32;
/// Each time that a width turns out to be slower it waits twice as long, and longer by the square of how much slower it was.
const LONGEST_WAIT: usize = 4096;
/// A width is worth another look only if it was not slower than this, in units of the fastest.
const MOST_SLOWDOWN: f64 = 3.0;
/// So many points at once at most: what the path may need farther ahead, it seldom does.
const WIDEST: usize = 64;
/// Evaluations whose median says how long one takes, and rounds whose median says how long handing over takes.
const N_RECENT: usize = 9;
/// How much a new measurement counts beside all before.
const WEIGHT: f64 = 0.25;

/// What handing evaluations over means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Dispatch {
    /// The calling thread evaluates.
    Never,
    /// Threads that have to be woken.
    Threads,
    /// The user's function takes whole batches: what that costs only measuring tells.
    Batches,
}

/// When the calling thread evaluates rather than a pool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OnCallingThread {
    Never,
    /// When evaluations are known to be short.
    WhenShort,
    /// When they are too short to be handed over; and the first one, which shows how long they are.
    AtFirst,
}

/// A number of points at once, and how fast the path advances with it.
#[derive(Debug, Clone)]
struct Width {
    points: usize,
    /// Seconds per evaluation of the path, once it was tried.
    seconds: Option<f64>,
    /// Rounds before it is tried again, and how long it waits after that.
    due_in: usize,
    wait: usize,
}

/// The last measurements, the oldest replaced first; their median is not moved by one that was disturbed.
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
        (len > 0).then(|| sorted[len / 2])
    }
}

/// Measures evaluations and chooses widths.
#[derive(Debug)]
pub(crate) struct WidthControl {
    dispatch: Dispatch,
    workers: usize,
    /// Seconds of the last evaluations.
    recent: Recent,
    /// Seconds by which the last rounds took longer than the longest of their evaluations, where other threads made them.
    handed: Recent,
    /// Whether the present round is handed over.
    handed_over: Cell<bool>,
    /// The longest of the last evaluations.
    longest: f64,
    widths: Vec<Width>,
    /// Number of the width in use, rounds left for it, seconds spent and evaluations of the path before it.
    current: usize,
    rounds_left: usize,
    seconds: f64,
    n_rounds: usize,
    n_before: usize,
    measuring: bool,
}

impl WidthControl {
    pub(crate) fn new(workers: usize, dispatch: Dispatch) -> Self {
        let widest = workers.min(WIDEST);
        let mut points = vec![1];
        while points.last().is_some_and(|p| 2 * p < widest) {
            points.push(2 * points[points.len() - 1]);
        }
        if widest > 1 {
            points.push(widest);
        }
        let width = |points| Width { points, seconds: None, due_in: 0, wait: FIRST_WAIT };
        Self {
            dispatch,
            workers,
            recent: Recent::new(),
            handed: Recent::new(),
            handed_over: Cell::new(false),
            longest: 0.0,
            widths: points.into_iter().map(width).collect(),
            current: 0,
            rounds_left: 0,
            seconds: 0.0,
            n_rounds: 0,
            n_before: 0,
            measuring: false,
        }
    }

    /// How many points to evaluate at once where the path needs fewer. `n_evaluations`: evaluations of the path so far.
    pub(crate) fn width(&mut self, lookahead: Lookahead, n_evaluations: usize) -> usize {
        self.measuring = false;
        match lookahead {
            Lookahead::None => 1,
            Lookahead::Points(points) => points,
            Lookahead::Workers => self.workers,
            Lookahead::Measured => {
                let short = || self.recent.median().is_none_or(|seconds| seconds < self.worthwhile());
                if self.widths.len() == 1 || (self.dispatch == Dispatch::Threads && short()) {
                    return 1;
                }
                self.measuring = true;
                if self.rounds_left == 0 {
                    self.next_width(n_evaluations);
                }
                self.rounds_left -= 1;
                self.widths[self.current].points
            }
        }
    }

    /// Seconds that handing over must save.
    fn worthwhile(&self) -> f64 {
        2.0 * self.handed.median().unwrap_or(DISPATCH_SECONDS)
    }

    /// Closes the measurement of a width and chooses the next.
    fn next_width(&mut self, n_evaluations: usize) {
        let gained = n_evaluations.saturating_sub(self.n_before);
        if self.n_rounds > 0 && gained > 0 {
            let mut measured = self.seconds / gained as f64;
            if self.dispatch == Dispatch::Threads && self.current == 0 {
                // Beside others an evaluation is not faster than alone: one that took longer was disturbed.
                measured = self.recent.median().map_or(measured, |evaluation| measured.min(evaluation));
            }
            let known = &mut self.widths[self.current].seconds;
            *known = Some(known.map_or(measured, |k| k + WEIGHT * (measured - k)));
        }
        let n_rounds = self.n_rounds;
        self.widths.iter_mut().for_each(|w| w.due_in = w.due_in.saturating_sub(n_rounds));
        let fastest = self.fastest();
        let least = fastest.and_then(|k| self.widths[k].seconds);
        let tried = &mut self.widths[self.current];
        if let (Some(seconds), Some(least)) = (tried.seconds, least.filter(|_| fastest != Some(self.current)))
        {
            tried.due_in = (tried.wait as f64 * (seconds / least).powi(2)) as usize;
            tried.wait = (2 * tried.wait).min(LONGEST_WAIT);
        }
        self.current = self.untried().or_else(|| self.challenger(fastest)).or(fastest).unwrap_or(0);
        let is_fastest = fastest == Some(self.current);
        self.rounds_left = match self.current {
            _ if is_fastest => FIRST_WAIT / 4,
            0 => 1,
            _ => TRIAL_ROUNDS,
        };
        (self.seconds, self.n_rounds, self.n_before) = (0.0, 0, n_evaluations);
    }

    fn fastest(&self) -> Option<usize> {
        let known = |k: &usize| self.widths[*k].seconds.map(|s| (s, *k));
        (0..self.widths.len()).filter_map(|k| known(&k)).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, k)| k)
    }

    /// A width that nothing is known of: the largest and the smallest first, those between only where the largest was not
    /// much faster than the smallest.
    fn untried(&self) -> Option<usize> {
        let last = self.widths.len() - 1;
        let missing = |k: &usize| self.widths[*k].seconds.is_none();
        if let Some(k) = [last, 0].into_iter().find(missing) {
            return Some(k);
        }
        let (wide, one) = (self.widths[last].seconds?, self.widths[0].seconds?);
        if 1.4 * wide < one { None } else { (0..last).rev().find(missing) }
    }

    /// A width that has waited long enough for another look.
    fn challenger(&self, fastest: Option<usize>) -> Option<usize> {
        let least = self.widths[fastest?].seconds?;
        let fits = |k: &usize| {
            let width = &self.widths[*k];
            Some(*k) != fastest
                && width.due_in == 0
                && width.seconds.is_some_and(|s| s < MOST_SLOWDOWN * least)
        };
        (0..self.widths.len()).find(fits)
    }

    /// A round of evaluations took so long in all; `seconds` of each, the first `needed` for the path.
    pub(crate) fn measured(
        &mut self,
        needed: usize,
        in_all: f64,
        seconds: impl ExactSizeIterator<Item = f64> + Clone,
    ) {
        let longest = seconds.clone().fold(0.0, f64::max);
        // Of more points than workers some waited, and the first one of all was not handed over.
        if self.handed_over.take() && !self.is_new() && seconds.len() <= self.workers {
            self.handed.push((in_all - longest).max(LEAST_DISPATCH_SECONDS));
        }
        seconds.for_each(|seconds| self.recent.push(seconds));
        self.longest = longest.max(self.longest * (1.0 - WEIGHT));
        // Vertices that are needed all at once say nothing about looking ahead.
        if self.measuring && needed == 1 {
            self.seconds += in_all;
            self.n_rounds += 1;
        } else if self.measuring {
            (self.rounds_left, self.n_rounds) = (0, 0);
        }
    }

    /// Whether to hand points to other threads rather than to evaluate them on the calling one. `just_measured`: seconds of
    /// an evaluation, where it was the first.
    pub(crate) fn hands_over(
        &self,
        points: usize,
        here: OnCallingThread,
        just_measured: Option<f64>,
    ) -> bool {
        let Some(evaluation) =
            just_measured.or_else(|| self.recent.median()).filter(|_| here != OnCallingThread::Never)
        else {
            return true;
        };
        let at_once = points.div_ceil(self.workers.max(1));
        let saved = (points - at_once) as f64 * evaluation;
        let handed_over = saved > self.worthwhile()
            || (here == OnCallingThread::WhenShort && self.longest > SHORT.as_secs_f64());
        self.handed_over.set(handed_over);
        handed_over
    }

    /// Whether nothing is known of what an evaluation takes.
    pub(crate) fn is_new(&self) -> bool {
        self.recent.0.is_empty()
    }
}

/// An evaluation that takes no longer does not keep the calling thread from looking for interrupts.
const SHORT: Duration = Duration::from_millis(20);

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounds that are not as wide as there are workers, of so many; `model` gives for a width the seconds of a round and
    /// the evaluations by which the path advances in it.
    fn narrow(
        workers: usize,
        rounds: usize,
        evaluation: f64,
        model: impl Fn(usize) -> (f64, usize),
    ) -> usize {
        let mut width_control = WidthControl::new(workers, Dispatch::Threads);
        let (mut n_evaluations, mut n_narrow) = (4, 0);
        width_control.measured(4, 4.0 * evaluation, [evaluation; 4].into_iter());
        for _ in 0..rounds {
            let width = width_control.width(Lookahead::Measured, n_evaluations);
            n_narrow += usize::from(width < workers);
            let (seconds, gained) = model(width);
            width_control.hands_over(width, OnCallingThread::AtFirst, None);
            width_control.measured(1, seconds, vec![evaluation; width].into_iter());
            n_evaluations += gained;
        }
        n_narrow
    }

    #[test]
    fn few_rounds_are_spent_on_finding_the_width() {
        // Twice as fast: one round alone, and one more where it has waited long enough.
        let twice = |width: usize| (1.05e-3, if width > 1 { 2 } else { 1 });
        assert!(narrow(4, 100, 1e-3, twice) <= 2);
        // No faster: one trial, and seldom again.
        let never = |width: usize| (1e-3 * width as f64, if width > 1 { 2 } else { 1 });
        assert!(narrow(4, 100, 1e-3, never) >= 80);
    }

    #[test]
    fn short_evaluations_stay_where_they_are() {
        let width_control = |dispatch: f64, evaluation: f64| {
            let mut width_control = WidthControl::new(4, Dispatch::Threads);
            width_control.measured(1, evaluation, [evaluation].into_iter());
            for _ in 0..N_RECENT {
                width_control.hands_over(1000, OnCallingThread::AtFirst, None);
                width_control.measured(2, evaluation + dispatch, [evaluation; 2].into_iter());
            }
            width_control.width(Lookahead::Measured, 3) > 1
        };
        // What handing over takes in this run decides, not what it takes as a rule.
        assert!(width_control(30e-6, 100e-6) && width_control(300e-6, 1e-3));
        assert!(!width_control(100e-6, 150e-6) && !width_control(2e-3, 1e-3) && !width_control(0.0, 1e-6));
    }
}
