//! Simulated against measured, sample by sample while the simulation runs; no trajectory is stored.

use crate::layout::OutputResiduals;
use dfo::RobustLoss;
use ode::{Observer, Sample};
use std::ops::ControlFlow;

/// Which sample of which output is compared with which measurement, and the position of its residual in the vector.
///
/// The residual vector is ordered output by output, each in the order of time; missing measurements have no position
/// in it, so that it has the same length for every simulation.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Comparison {
    n_outputs: usize,
    /// Per requested time, per output: the measurement (NaN: none).
    measured: Vec<f64>,
    weights: Vec<f64>,
    /// Per requested time, per output: position in the residual vector.
    positions: Vec<u32>,
    n_residuals: usize,
}

const NO_POSITION: u32 = u32::MAX;

impl Comparison {
    /// From one column of measurements per output, all over the same times; returns the times at which anything was
    /// measured together with the comparison. Times twice in a row (an input jumps there) become one.
    pub(crate) fn new(times: &[f64], columns: &[Vec<f64>], weights: &[f64]) -> (Vec<f64>, Self) {
        let n_outputs = columns.len();
        let mut kept: Vec<f64> = Vec::with_capacity(times.len());
        let mut measured = Vec::with_capacity(times.len() * n_outputs);
        for (i, &t) in times.iter().enumerate() {
            if columns.iter().all(|c| c[i].is_nan()) {
                continue;
            }
            if kept.last() != Some(&t) {
                kept.push(t);
                measured.resize(measured.len() + n_outputs, f64::NAN);
            }
            let row = measured.len() - n_outputs;
            for (m, c) in measured[row..].iter_mut().zip(columns) {
                if !c[i].is_nan() {
                    *m = c[i];
                }
            }
        }
        let mut positions = vec![NO_POSITION; measured.len()];
        let mut n_residuals = 0;
        for output in 0..n_outputs {
            for row in 0..kept.len() {
                let at = row * n_outputs + output;
                if !measured[at].is_nan() {
                    positions[at] = n_residuals as u32;
                    n_residuals += 1;
                }
            }
        }
        (kept, Self { n_outputs, measured, weights: weights.to_vec(), positions, n_residuals })
    }

    /// Length of the residual vector.
    pub(crate) fn n_residuals(&self) -> usize {
        self.n_residuals
    }

    /// The rows in which an output was measured: their numbers, in the order of time.
    fn rows(&self, output: usize) -> impl Iterator<Item = usize> {
        let n = self.n_outputs;
        (0..self.measured.len() / n.max(1)).filter(move |row| !self.measured[row * n + output].is_nan())
    }

    /// What stands in the residual vector, output by output; `offset` is the position of the first residual, `times` are those
    /// that [`new`](Self::new) returned.
    pub(crate) fn layout(&self, (mut offset, times): (usize, &[f64])) -> Vec<OutputResiduals> {
        let of_output = |output: usize| {
            let measured: Vec<f64> =
                self.rows(output).map(|row| self.measured[row * self.n_outputs + output]).collect();
            let range = offset..offset + measured.len();
            offset = range.end;
            OutputResiduals {
                experiment: 0,
                output,
                variable: String::new(),
                column: String::new(),
                range,
                times: self.rows(output).map(|row| times[row]).collect(),
                weights: vec![self.weights[output]; measured.len()],
                measured,
            }
        };
        (0..self.n_outputs).map(of_output).collect()
    }
}

/// What a residual counts, and when an evaluation is given up.
#[derive(Clone, Copy)]
pub(crate) struct CostRule<'a> {
    /// Residuals are what it makes of the plain ones.
    pub(crate) loss: RobustLoss,
    /// The simulation ends when the sum is strictly above this.
    pub(crate) cutoff: f64,
    /// Asked before every step.
    pub(crate) cancelled: &'a dyn Fn() -> bool,
}

impl<'a> CostRule<'a> {
    /// The whole cost.
    pub(crate) fn whole(loss: RobustLoss, cancelled: &'a dyn Fn() -> bool) -> Self {
        Self { loss, cutoff: f64::INFINITY, cancelled }
    }
}

/// The cost that residuals make: the sum of their squares from the first to the last, by which it has the same bits wherever it
/// is computed.
pub(crate) fn sum_of_squares(residuals: &[f64]) -> f64 {
    residuals.iter().fold(0.0, |sum, residual| sum + residual * residual)
}

/// Takes the residuals from a simulation as it delivers the samples, and adds up their squares (time by time, output by output
/// within a time), which says when the cost is sure to be above a cutoff.
pub(crate) struct Accumulator<'a> {
    comparison: &'a Comparison,
    rule: CostRule<'a>,
    /// The sum so far; starts with what earlier experiments have left.
    pub(crate) sum: f64,
    /// Samples seen.
    seen: usize,
    /// Where the residuals go.
    out: &'a mut [f64],
    pub(crate) stop: Option<Stop>,
}

/// Why the accumulator ended the simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stop {
    /// The partial sum is strictly above the cutoff.
    AboveCutoff,
    /// A simulated value, or the sum, is not finite; the output counted from 0.
    NotFinite(usize),
    /// The run is being ended from outside.
    Cancelled,
}

impl<'a> Accumulator<'a> {
    pub(crate) fn new(comparison: &'a Comparison, rule: CostRule<'a>, sum: f64, out: &'a mut [f64]) -> Self {
        Self { comparison, rule, sum, seen: 0, out, stop: None }
    }

    /// Whether every requested time has been delivered.
    pub(crate) fn is_complete(&self) -> bool {
        self.seen * self.comparison.n_outputs == self.comparison.measured.len()
    }

    fn end(&mut self, why: Stop) -> ControlFlow<()> {
        self.stop = Some(why);
        ControlFlow::Break(())
    }
}

impl Observer for Accumulator<'_> {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        let Some(index) = sample.index else { return ControlFlow::Continue(()) };
        let c = self.comparison;
        let row = index * c.n_outputs..(index + 1) * c.n_outputs;
        for (output, at) in row.enumerate() {
            let measured = c.measured[at];
            if measured.is_nan() {
                continue;
            }
            let residual = self.rule.loss.transform(c.weights[output] * (sample.outputs[output] - measured));
            self.out[c.positions[at] as usize] = residual;
            self.sum += residual * residual;
            if !self.sum.is_finite() {
                return self.end(Stop::NotFinite(output));
            }
        }
        self.seen = index + 1;
        if self.sum > self.rule.cutoff { self.end(Stop::AboveCutoff) } else { ControlFlow::Continue(()) }
    }

    fn poll(&mut self) -> ControlFlow<()> {
        if (self.rule.cancelled)() { self.end(Stop::Cancelled) } else { ControlFlow::Continue(()) }
    }
}

/// Weighted sum of squared errors between measured and simulated series, as the paper's tool computes it: the
/// simulation has its own time grid and is interpolated linearly to the measured times; where a time stands there
/// twice (an event), the mean of both values counts. `y_*` hold one row per quantity; `w` (one per quantity, default 1)
/// multiplies the squared errors. Times outside of the simulated span take its end values.
///
/// # Errors
/// Lengths that do not fit, simulated times that do not ascend, nothing simulated; the message names the numbers.
pub fn quad_err(
    t_meas: &[f64],
    y_meas: &[&[f64]],
    t_sim: &[f64],
    y_sim: &[&[f64]],
    w: Option<&[f64]>,
) -> Result<f64, String> {
    if y_meas.len() != y_sim.len() {
        return Err(format!("{} measured quantities against {} simulated ones", y_meas.len(), y_sim.len()));
    }
    if let Some(w) = w
        && w.len() != y_meas.len()
    {
        return Err(format!("{} weights for {} quantities", w.len(), y_meas.len()));
    }
    for (name, t, rows) in [("measured", t_meas, y_meas), ("simulated", t_sim, y_sim)] {
        if let Some((i, row)) = rows.iter().enumerate().find(|(_, row)| row.len() != t.len()) {
            return Err(format!("{name} quantity {i} has {} values for {} times", row.len(), t.len()));
        }
    }
    if t_sim.is_empty() {
        return Err("there are no simulated times".to_owned());
    }
    if let Some(i) = (1..t_sim.len()).find(|&i| t_sim[i].is_nan() || t_sim[i] < t_sim[i - 1]) {
        return Err(format!("simulated time {} at position {i} comes after {}", t_sim[i], t_sim[i - 1]));
    }
    let mut total = 0.0;
    for (q, (measured, simulated)) in y_meas.iter().zip(y_sim).enumerate() {
        let weight = w.map_or(1.0, |w| w[q]);
        let mut sum = 0.0;
        for (t, m) in t_meas.iter().zip(*measured) {
            let error = interpolate(t_sim, simulated, *t) - m;
            sum += error * error;
        }
        total += weight * sum;
    }
    Ok(total)
}

/// Linear interpolation; the mean of all values where `t` stands in `times`; end values outside.
fn interpolate(times: &[f64], values: &[f64], t: f64) -> f64 {
    let first = times.partition_point(|s| *s < t);
    let after = first + times[first..].partition_point(|s| *s <= t);
    if after > first {
        return values[first..after].iter().sum::<f64>() / (after - first) as f64;
    }
    if t.is_nan() {
        return f64::NAN;
    }
    if first == 0 {
        return values[0];
    }
    if first == times.len() {
        return values[first - 1];
    }
    let (t0, t1) = (times[first - 1], times[first]);
    values[first - 1] + (values[first] - values[first - 1]) * ((t - t0) / (t1 - t0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ode::Side;

    const NAN: f64 = f64::NAN;

    #[test]
    fn the_vector_is_ordered_output_by_output_and_skips_what_is_missing() {
        let (times, c) = Comparison::new(
            &[0.0, 1.0, 1.0, 2.0, 3.0],
            &[vec![1.0, NAN, 2.0, NAN, 3.0], vec![10.0, 20.0, NAN, NAN, NAN]],
            &[1.0, 2.0],
        );
        assert_eq!(times, [0.0, 1.0, 3.0]);
        assert_eq!(c.n_residuals(), 5);
        let mut out = [NAN; 5];
        let mut a = Accumulator::new(&c, CostRule::whole(RobustLoss::default(), &|| false), 100.0, &mut out);
        for (i, t) in times.iter().enumerate() {
            let outputs = [0.0, 0.0];
            let s = Sample { time: *t, index: Some(i), side: Side::Right, states: &[], outputs: &outputs };
            assert!(a.sample(&s).is_continue());
        }
        assert!(a.is_complete());
        assert_eq!(a.sum, 100.0 + 1.0 + 400.0 + 4.0 + 1600.0 + 9.0);
        assert_eq!(out, [-1.0, -2.0, -3.0, -20.0, -40.0]);
    }

    #[test]
    fn stops_strictly_above_the_cutoff_and_at_nan() {
        let (_, c) = Comparison::new(&[0.0, 1.0], &[vec![0.0, 0.0]], &[1.0]);
        let [mut first, mut second] = [[0.0; 2]; 2];
        let sample = |i: usize, y: &[f64], a: &mut Accumulator<'_>| {
            a.sample(&Sample { time: 0.0, index: Some(i), side: Side::Right, states: &[], outputs: y })
                .is_break()
        };
        let rule = CostRule { cutoff: 4.0, ..CostRule::whole(RobustLoss::default(), &|| false) };
        let mut a = Accumulator::new(&c, rule, 0.0, &mut first);
        assert!(!sample(0, &[2.0], &mut a));
        assert!(sample(1, &[1e-3], &mut a));
        assert_eq!(a.stop, Some(Stop::AboveCutoff));
        let mut a = Accumulator::new(&c, rule, 0.0, &mut second);
        assert!(sample(0, &[NAN], &mut a));
        assert_eq!(a.stop, Some(Stop::NotFinite(0)));
        assert!(!a.is_complete());
    }

    #[test]
    fn quad_err_interpolates_linearly_and_weights_the_squares() {
        let (t_sim, y) = ([0.0, 1.0, 3.0], [0.0, 2.0, 6.0]);
        let e = quad_err(&[0.5, 2.0, 3.0], &[&[0.0, 4.0, 7.0]], &t_sim, &[&y], None).unwrap();
        assert_eq!(e, 1.0 + 0.0 + 1.0);
        let e = quad_err(&[0.5], &[&[0.0], &[0.0]], &t_sim, &[&y, &y], Some(&[2.0, 3.0])).unwrap();
        assert_eq!(e, 2.0 + 3.0);
        // beyond the ends: the end values; at an event: the mean of both sides
        let e = quad_err(&[-1.0, 4.0], &[&[1.0, 1.0]], &[0.0, 1.0], &[&[0.0, 3.0]], None).unwrap();
        assert_eq!(e, 1.0 + 4.0);
        let e = quad_err(&[1.0], &[&[0.0]], &[0.0, 1.0, 1.0, 2.0], &[&[0.0, 2.0, 4.0, 4.0]], None).unwrap();
        assert_eq!(e, 9.0);
    }

    #[test]
    fn quad_err_names_what_does_not_fit() {
        for (e, expected) in [
            (quad_err(&[0.0], &[&[0.0]], &[0.0], &[], None), "1 measured quantities against 0"),
            (quad_err(&[0.0], &[&[0.0]], &[], &[&[]], None), "no simulated times"),
            (
                quad_err(&[0.0, 1.0], &[&[0.0]], &[0.0], &[&[0.0]], None),
                "measured quantity 0 has 1 values for 2",
            ),
            (
                quad_err(&[0.0], &[&[0.0]], &[1.0, 0.0], &[&[0.0, 0.0]], None),
                "simulated time 0 at position 1",
            ),
            (quad_err(&[0.0], &[&[0.0]], &[0.0], &[&[0.0]], Some(&[])), "0 weights for 1"),
        ] {
            let e = e.unwrap_err();
            assert!(e.contains(expected), "{e}");
        }
    }
}
