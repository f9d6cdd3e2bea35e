//! Recording of signals during a simulation, with as many points in each step as their shape requires.

use super::pieces::{MOST_POINTS, Pieces, interpolate, larger, point};
use super::signal::Signal;
use ode::{CallResult, Sample, StepOutputs};

/// Largest number of halvings of a step. A jump of a signal inside a step is then located to a thousandth of
/// it.
const MOST_HALVINGS: u32 = 10;

/// Signals of a simulation under way.
#[derive(Debug)]
pub(crate) struct Recorder<'a> {
    signals: &'a [Signal],
    /// Number of outputs of the model.
    n_outputs: usize,
    /// True if the engine reports steps; false if only rows are known.
    has_steps: bool,
    /// Largest difference from the interpolant, relative to the largest value so far.
    tolerance: f64,
    space: &'a mut Space,
    /// Time of the last row.
    row: Option<f64>,
}

/// Recorded signals and work space, for use in many simulations.
#[derive(Debug, Default)]
pub(crate) struct Space {
    pub(crate) pieces: Pieces,
    /// Values at the last row.
    pub(crate) at_end: Vec<f64>,
    /// Largest absolute value of each signal so far.
    largest: Vec<f64>,
    outputs: Vec<f64>,
    /// Values at the points of one part of a step.
    points: Vec<f64>,
    values: Vec<f64>,
    stack: Vec<f64>,
}

impl<'a> Recorder<'a> {
    pub(crate) fn new(
        signals: &'a [Signal],
        n_outputs: usize,
        has_steps: bool,
        tolerance: f64,
        space: &'a mut Space,
    ) -> Self {
        space.pieces.begin(signals.len());
        space.at_end.clear();
        space.largest.clear();
        space.largest.resize(signals.len(), 0.0);
        space.outputs.resize(n_outputs, 0.0);
        space.points.resize(MOST_POINTS * signals.len(), 0.0);
        Self { signals, n_outputs, has_steps, tolerance, space, row: None }
    }

    /// Receives a row of the simulation.
    pub(crate) fn row(&mut self, sample: &Sample<'_>) {
        let Space { pieces, at_end, values, stack, points, .. } = &mut *self.space;
        let before = self.row.replace(sample.time).filter(|before| !self.has_steps && *before < sample.time);
        points.clear();
        points.extend_from_slice(at_end);
        at_end.clear();
        let of = |signal: &Signal| signal.value(sample.time, sample.outputs, values, stack);
        at_end.extend(self.signals.iter().map(of));
        if let Some(before) = before {
            points.extend_from_slice(at_end);
            pieces.push(before, sample.time, points);
        }
    }

    /// Receives an accepted step.
    pub(crate) fn step(&mut self, step: &mut StepOutputs<'_>) -> CallResult<()> {
        // A refused step is followed by a shorter one.
        self.space.pieces.remove_from(step.start);
        self.space.points.resize(MOST_POINTS * self.signals.len(), 0.0);
        self.cover(step, step.start, step.end, 0)
    }

    /// Adds the pieces from `from` to `to`. A piece has 5 points if the parabola through its ends and its
    /// middle predicts the other two, otherwise 9 points if the 5 points predict the other 4. Otherwise it is
    /// halved. If the model only provides its outputs in the order of time, a step is one piece of 9 points.
    fn cover(&mut self, step: &mut StepOutputs<'_>, from: f64, to: f64, halvings: u32) -> CallResult<()> {
        let (first, others) = match step.is_ordered {
            true => (&[0, 1, 2, 3, 4, 5, 6, 7, 8][..], &[][..]),
            false => (&[0, 4, 8, 2, 6][..], &[1, 3, 5, 7][..]),
        };
        for k in first {
            self.evaluate(step, *k, from, to)?;
        }
        let last = MOST_POINTS - 1;
        let n = if self.predicts(3, 4, &[2, 6]) {
            5
        } else {
            for k in others {
                self.evaluate(step, *k, from, to)?;
            }
            let middle = from + 0.5 * (to - from);
            if !step.is_ordered
                && halvings < MOST_HALVINGS
                && from < middle
                && middle < to
                && !self.predicts(5, 2, &[1, 3, 5, 7])
            {
                self.cover(step, from, middle, halvings + 1)?;
                return self.cover(step, middle, to, halvings + 1);
            }
            MOST_POINTS
        };
        let (n_signals, stride) = (self.signals.len(), last / (n - 1));
        let Space { pieces, points, values, .. } = &mut *self.space;
        values.clear();
        for k in (0..n).map(|k| k * stride) {
            values.extend_from_slice(&points[k * n_signals..(k + 1) * n_signals]);
        }
        pieces.push(from, to, values);
        Ok(())
    }

    /// Evaluates all signals at point `k` of 9.
    fn evaluate(&mut self, step: &mut StepOutputs<'_>, k: usize, from: f64, to: f64) -> CallResult<()> {
        let time = if k == MOST_POINTS - 1 { to } else { from + point(k, MOST_POINTS) * (to - from) };
        let Space { outputs, points, values, stack, largest, .. } = &mut *self.space;
        step.outputs_at(time, &mut outputs[..self.n_outputs])?;
        for (i, (signal, largest)) in self.signals.iter().zip(largest).enumerate() {
            let value = signal.value(time, outputs, values, stack);
            points[k * self.signals.len() + i] = value;
            *largest = larger(*largest, value.abs());
        }
        Ok(())
    }

    /// True if the polynomial through every `stride`-th of 9 points, `n` in all, predicts the values at other
    /// points. A signal that is not a number has no better polynomial.
    fn predicts(&self, n: usize, stride: usize, others: &[usize]) -> bool {
        let Space { points, largest, .. } = &*self.space;
        let n_signals = self.signals.len();
        (0..n_signals).all(|i| {
            let value = |k: usize| points[k * n_signals + i];
            others.iter().all(|k| {
                let predicted = interpolate(n, |j| value(j * stride), point(*k, MOST_POINTS));
                let difference = (predicted - value(*k)).abs();
                difference.is_nan() || difference <= self.tolerance * largest[i]
            })
        })
    }
}
