//! How many points to evaluate at once, from what evaluations take: it decides who computes what and when, never what the
//! path of a method is.

use crate::executor::Here;
use crate::method::Lookahead;
use std::collections::VecDeque;
use std::time::Duration;

/// Below so many seconds of work that could be saved, handing it to other threads does not pay: a thread that sleeps is
/// awake after 0.05 to 0.5 ms.
const WORTHWHILE: f64 = 200e-6;
/// Rounds in which a width is tried, and those after which it is tried again; each time that it turns out to be slower it
/// waits twice as long.
const TRIAL_ROUNDS: usize = 4;
const FIRST_WAIT: usize = 32;
const LONGEST_WAIT: usize = 4096;
/// A width is worth another look only if it was not slower than this, in units of the fastest.
const HOPELESS: f64 = 3.0;
/// Evaluations whose median says how long one takes.
const LATELY: usize = 9;
/// How much a new measurement counts beside all before.
const WEIGHT: f64 = 0.25;

/// What handing evaluations over means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HandingOver {
    /// There is nobody to hand them to.
    Never,
    /// Threads that have to be woken.
    Threads,
    /// The user's function takes whole batches: what that costs only measuring tells.
    Batches,
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

/// Measures evaluations and chooses widths.
#[derive(Debug)]
pub(crate) struct Pace {
    handing_over: HandingOver,
    workers: usize,
    /// Seconds of the last evaluations, the oldest replaced first; their median is not moved by one that was disturbed.
    lately: VecDeque<f64>,
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

impl Pace {
    pub(crate) fn new(workers: usize, handing_over: HandingOver) -> Self {
        let mut points = vec![1];
        while points.last().is_some_and(|p| 2 * p < workers) {
            points.push(2 * points[points.len() - 1]);
        }
        if workers > 1 {
            points.push(workers);
        }
        let width = |points| Width { points, seconds: None, due_in: 0, wait: FIRST_WAIT };
        Self {
            handing_over,
            workers,
            lately: VecDeque::with_capacity(LATELY),
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
                let short = self.evaluation().is_none_or(|seconds| seconds < WORTHWHILE);
                if self.widths.len() == 1 || (self.handing_over == HandingOver::Threads && short) {
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

    /// Seconds of an evaluation.
    fn evaluation(&self) -> Option<f64> {
        let mut sorted = [f64::INFINITY; LATELY];
        sorted.iter_mut().zip(&self.lately).for_each(|(place, seconds)| *place = *seconds);
        sorted.sort_by(f64::total_cmp);
        let len = self.lately.len();
        (len > 0).then(|| sorted[len / 2])
    }

    /// Closes the measurement of a width and chooses the next.
    fn next_width(&mut self, n_evaluations: usize) {
        let gained = n_evaluations.saturating_sub(self.n_before);
        if self.n_rounds > 0 && gained > 0 {
            let measured = self.seconds / gained as f64;
            let known = &mut self.widths[self.current].seconds;
            *known = Some(known.map_or(measured, |k| k + WEIGHT * (measured - k)));
        }
        let n_rounds = self.n_rounds;
        self.widths.iter_mut().for_each(|w| w.due_in = w.due_in.saturating_sub(n_rounds));
        let fastest = self.fastest();
        let tried = &mut self.widths[self.current];
        if fastest != Some(self.current) && tried.seconds.is_some() {
            (tried.due_in, tried.wait) = (tried.wait, (2 * tried.wait).min(LONGEST_WAIT));
        }
        self.current = self.untried().or_else(|| self.challenger(fastest)).or(fastest).unwrap_or(0);
        let is_fastest = fastest == Some(self.current);
        self.rounds_left = if is_fastest { FIRST_WAIT / 4 } else { TRIAL_ROUNDS };
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
            Some(*k) != fastest && width.due_in == 0 && width.seconds.is_some_and(|s| s < HOPELESS * least)
        };
        (0..self.widths.len()).find(fits)
    }

    /// A round of evaluations took so long in all; `seconds` of each, the first `needed` for the path.
    pub(crate) fn measured(&mut self, needed: usize, in_all: f64, seconds: &[f64]) {
        for &seconds in seconds {
            if self.lately.len() == LATELY {
                self.lately.pop_front();
            }
            self.lately.push_back(seconds);
        }
        let longest = seconds.iter().fold(0.0, |m: f64, s| m.max(*s));
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
    pub(crate) fn hands_over(&self, points: usize, here: Here, just_measured: Option<f64>) -> bool {
        let Some(evaluation) = just_measured.or_else(|| self.evaluation()).filter(|_| here != Here::Never)
        else {
            return true;
        };
        let at_once = points.div_ceil(self.workers.max(1));
        let saved = (points - at_once) as f64 * evaluation;
        saved > WORTHWHILE || (here == Here::WhenShort && self.longest > SHORT.as_secs_f64())
    }

    /// Whether nothing is known of what an evaluation takes.
    pub(crate) fn is_new(&self) -> bool {
        self.lately.is_empty()
    }
}

/// An evaluation that takes no longer does not keep the calling thread from looking for interrupts.
const SHORT: Duration = Duration::from_millis(20);
