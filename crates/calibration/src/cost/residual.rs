//! Comparison of simulated with measured values, sample by sample during the simulation. No trajectory is
//! stored.

use crate::data::Series;
use crate::problem::input::Shift;
use crate::problem::measurements::Counted;
use crate::problem::residual_layout::OutputResiduals;
use base::RunContext;
use dfo::RobustLoss;
use ode::{Observer, Sample};
use std::ops::ControlFlow;

/// Measurements to compare with the simulation of an experiment, in the order of its residuals: output by
/// output, each in the order of time.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Comparison {
    outputs: Vec<Counted>,
    /// Index of the first residual of each output, followed by the end of the last output.
    begins: Vec<usize>,
    /// Further sample times, which are compared with nothing.
    further: Series,
}

/// Point and its residuals.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PointResiduals {
    pub(crate) x: Vec<f64>,
    pub(crate) residuals: Vec<f64>,
}

/// Sample times of the simulation, and the measurements that each sample is compared with.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Schedule {
    /// Sample times, ascending and without duplicates.
    pub(crate) times: Series,
    /// Index of the sample for each measurement of each output, ascending. If empty, measurement `k` uses
    /// sample `k`.
    samples: Vec<Vec<u32>>,
}

impl Comparison {
    pub(crate) fn new(outputs: &[Counted]) -> Self {
        let begins = outputs.iter().scan(0, |end, output| {
            *end += output.times.len();
            Some(*end)
        });
        let begins = std::iter::once(0).chain(begins).collect();
        Self { begins, outputs: outputs.to_vec(), further: Series::default() }
    }

    /// Adds sample times that are compared with nothing.
    pub(crate) fn with_further(self, further: Vec<f64>) -> Self {
        Self { further: further.into(), ..self }
    }

    /// Returns the number of residuals.
    pub(crate) fn n_residuals(&self) -> usize {
        self.begins[self.outputs.len()]
    }

    /// Returns the samples for outputs with these delays. No sample is before the start of the simulation.
    /// Times that differ only by rounding share a sample.
    pub(crate) fn schedule(&self, delays: impl Fn(usize) -> f64, start: f64) -> Schedule {
        let delays: Vec<f64> = (0..self.outputs.len()).map(delays).collect();
        let time = |output: usize, time: f64| match delays.get(output) {
            Some(delay) => (time - delay).max(start),
            None => time,
        };
        let all = || self.outputs.iter().map(|output| &output.times).chain([&self.further]).enumerate();
        let ends = all().filter_map(|(k, times)| Some(time(k, *times.last()?)));
        let last = ends.fold(start, f64::max);
        let rounding = base::time_tolerance(start, last);
        let is_apart = |times: &[f64]| times.windows(2).all(|pair| pair[1] - pair[0] > rounding);
        if let Some((first, others)) = self.outputs.split_first()
            && self.further.is_empty()
            && delays.iter().all(|delay| *delay == 0.0)
            && others.iter().all(|other| other.times == first.times)
            && first.times.first().is_some_and(|first| *first >= start)
            && is_apart(&first.times)
        {
            return Schedule { times: first.times.clone(), samples: Vec::new() };
        }
        let mut next = vec![0; self.outputs.len() + 1];
        let mut samples: Vec<Vec<u32>> = all().map(|(_, times)| Vec::with_capacity(times.len())).collect();
        let mut times: Vec<f64> = Vec::new();
        // Select the earliest of the remaining measurements.
        while let Some((now, output)) = all()
            .filter_map(|(k, times)| Some((time(k, *times.get(next[k])?), k)))
            .min_by(|a, b| a.0.total_cmp(&b.0))
        {
            next[output] += 1;
            if !times.last().is_some_and(|last| now - last <= rounding) {
                times.push(now);
            }
            samples[output].push(u32::try_from(times.len() - 1).unwrap_or(u32::MAX));
        }
        samples.pop();
        Schedule { times: times.into(), samples }
    }

    /// Creates a comparison whose outputs are only sampled, all at these times.
    pub(crate) fn at_times(times: &[f64], n_outputs: usize) -> Self {
        let none: Series = vec![f64::NAN; times.len()].into();
        let output =
            Counted { times: times.to_vec().into(), values: none.clone(), weights: none, is_log: false };
        Self::new(&vec![output; n_outputs])
    }

    /// Returns the values of each output at its measurements, from columns of samples.
    pub(crate) fn gather(&self, schedule: &Schedule, columns: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let of_output = |(k, output): (usize, &Counted)| {
            (0..output.times.len()).map(|row| columns[k][schedule.sample_of(k, row)]).collect()
        };
        self.outputs.iter().enumerate().map(of_output).collect()
    }

    /// Returns the layout of the residual vector, output by output, starting at position `offset`.
    pub(crate) fn layout(&self, offset: usize) -> Vec<OutputResiduals> {
        let of_output = |(output, counted): (usize, &Counted)| OutputResiduals {
            experiment: 0,
            output,
            variable: String::new(),
            column: String::new(),
            range: offset + self.begins[output]..offset + self.begins[output + 1],
            times: counted.times.clone(),
            measured: counted.values.clone(),
            weights: counted.weights.clone(),
            starts_simulation: false,
            is_noise_known: false,
            is_log: counted.is_log,
        };
        self.outputs.iter().enumerate().map(of_output).collect()
    }
}

impl Schedule {
    /// Returns the index of the sample that a measurement of an output is compared with.
    fn sample_of(&self, output: usize, row: usize) -> usize {
        self.samples.get(output).map_or(row, |samples| samples[row] as usize)
    }
}

/// Loss function of the residuals, and the conditions that end an evaluation.
#[derive(Clone, Copy)]
pub(crate) struct CostRule<'a> {
    /// Loss function that transforms the residuals.
    pub(crate) loss: RobustLoss,
    /// The simulation ends if the sum is strictly above this value.
    pub(crate) cutoff: f64,
    /// Context that is checked before every step.
    pub(crate) context: RunContext<'a>,
}

impl<'a> CostRule<'a> {
    /// Returns the rule for the whole cost, without a cutoff.
    pub(crate) fn whole(loss: RobustLoss, context: &RunContext<'a>) -> Self {
        Self { loss, cutoff: f64::INFINITY, context: *context }
    }
}

/// Returns the cost of residuals: the sum of their squares from the first to the last. The order makes the
/// cost bit-for-bit identical wherever it is computed.
pub(crate) fn sum_of_squares(residuals: &[f64]) -> f64 {
    residuals.iter().fold(0.0, |sum, residual| sum + residual * residual)
}

/// Computes the residuals from the samples of a simulation and adds up their squares, time by time and output
/// by output within a time. The sum shows as early as possible that the cost exceeds a cutoff.
pub(crate) struct Accumulator<'a> {
    comparison: &'a Comparison,
    schedule: &'a Schedule,
    /// Factor and offset of each output.
    shifts: &'a [Shift],
    rule: CostRule<'a>,
    /// Sum so far, which starts with the sum of earlier experiments.
    pub(crate) sum: f64,
    /// Number of samples received.
    seen: usize,
    /// First measurement of each output that is not yet compared.
    next: Vec<usize>,
    /// Destination of the residuals.
    out: &'a mut [f64],
    pub(crate) stop: Option<StopReason>,
}

/// Reason why the accumulator ended the simulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum StopReason {
    /// The partial sum is strictly above the cutoff.
    AboveCutoff,
    /// A simulated value or the sum is not finite. The index of the output is counted from 0.
    NotFinite(usize),
    /// A simulated value whose logarithm is compared is not positive: index of the output, and value.
    NotPositive(usize, f64),
    /// The run was interrupted.
    Cancelled,
}

impl<'a> Accumulator<'a> {
    pub(crate) fn new(
        comparison: &'a Comparison,
        schedule: &'a Schedule,
        shifts: &'a [Shift],
        rule: CostRule<'a>,
        sum: f64,
        out: &'a mut [f64],
    ) -> Self {
        let next = vec![0; comparison.outputs.len()];
        Self { comparison, schedule, shifts, rule, sum, seen: 0, next, out, stop: None }
    }

    /// True if every requested time has been delivered.
    pub(crate) fn is_complete(&self) -> bool {
        self.seen == self.schedule.times.len()
    }

    /// Returns the time of the last compared measurement of an output.
    pub(crate) fn last_time(&self, output: usize) -> Option<f64> {
        self.comparison.outputs[output].times.get(self.next[output].checked_sub(1)?).copied()
    }

    fn end(&mut self, why: StopReason) -> ControlFlow<()> {
        self.stop = Some(why);
        ControlFlow::Break(())
    }
}

impl Observer for Accumulator<'_> {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        let Some(index) = sample.index else { return ControlFlow::Continue(()) };
        let Self { comparison, schedule, rule, out, next, .. } = self;
        let simulated = sample.outputs.iter().zip(self.shifts).map(|(output, shift)| shift.of(*output));
        let of_outputs = comparison.outputs.iter().zip(&comparison.begins).zip(next).zip(simulated);
        for (k, (((output, begin), next), simulated)) in of_outputs.enumerate() {
            let (mut row, weights) = (*next, &output.weights);
            while row < weights.len() && schedule.sample_of(k, row) == index {
                if output.is_log && simulated <= 0.0 {
                    *next = row + 1;
                    return self.end(StopReason::NotPositive(k, simulated));
                }
                let compared = if output.is_log { simulated.ln() } else { simulated };
                let residual = rule.loss.transform(weights[row] * (compared - output.values[row]));
                out[begin + row] = residual;
                self.sum += residual * residual;
                row += 1;
                if !self.sum.is_finite() {
                    *next = row;
                    return self.end(StopReason::NotFinite(k));
                }
            }
            *next = row;
        }
        self.seen = index + 1;
        if self.sum > self.rule.cutoff {
            self.end(StopReason::AboveCutoff)
        } else {
            ControlFlow::Continue(())
        }
    }

    fn poll(&mut self) -> ControlFlow<()> {
        if self.rule.context.is_over() { self.end(StopReason::Cancelled) } else { ControlFlow::Continue(()) }
    }
}

/// Returns the weighted sum of squared errors between measured and simulated series, as the tool of the paper
/// computes it. The simulation has its own time grid and is interpolated linearly at the measured times. If a
/// time occurs twice in it (an event), the mean of both values counts. `y_*` contain one row per quantity.
/// `w` (one per quantity, default 1) multiplies the squared errors. Times outside the simulated span use its
/// end values.
///
/// # Errors
/// Returns an error if lengths differ, simulated times do not ascend, or nothing is simulated. The message
/// contains the numbers.
pub fn quad_err(
    t_meas: &[f64],
    y_meas: &[&[f64]],
    t_sim: &[f64],
    y_sim: &[&[f64]],
    w: Option<&[f64]>,
) -> Result<f64, String> {
    if y_meas.len() != y_sim.len() {
        return Err(format!("{} measured quantities, but {} simulated ones", y_meas.len(), y_sim.len()));
    }
    if let Some(w) = w
        && w.len() != y_meas.len()
    {
        return Err(format!("{} weights for {} quantities", w.len(), y_meas.len()));
    }
    for (name, t, rows) in [("measured", t_meas, y_meas), ("simulated", t_sim, y_sim)] {
        if let Some((i, row)) = rows.iter().enumerate().find(|(_, row)| row.len() != t.len()) {
            return Err(format!(
                "{name} quantity {i} has {} values, but there are {} times",
                row.len(),
                t.len()
            ));
        }
    }
    if t_sim.is_empty() {
        return Err("the simulation has no times".to_owned());
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

/// Interpolates linearly. Returns the mean of all values if `t` occurs in `times`, and end values outside.
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

    fn measured(rows: &[(f64, f64)]) -> Counted {
        Counted {
            times: rows.iter().map(|row| row.0).collect(),
            values: rows.iter().map(|row| row.1).collect(),
            weights: vec![1.0; rows.len()].into(),
            is_log: false,
        }
    }

    fn shift(offset: f64) -> Shift {
        Shift { delay: 0.0, factor: 1.0, offset }
    }

    fn sample<'a>(index: usize, outputs: &'a [f64]) -> Sample<'a> {
        Sample { time: 0.0, index: Some(index), side: Side::Right, states: &[], outputs }
    }

    #[test]
    fn residual_vector_is_ordered_output_by_output() {
        let mut second = measured(&[(0.0, 10.0), (1.0, 20.0)]);
        second.weights = vec![2.0; 2].into();
        let c = Comparison::new(&[measured(&[(0.0, 1.0), (1.0, 2.0), (3.0, 3.0)]), second]);
        let schedule = c.schedule(|_| 0.0, 0.0);
        assert_eq!(schedule.times[..], [0.0, 1.0, 3.0]);
        assert_eq!(c.n_residuals(), 5);
        let mut out = [f64::NAN; 5];
        let rule = CostRule::whole(RobustLoss::default(), &RunContext::new());
        let shifts = [shift(0.0), shift(0.5)];
        let mut a = Accumulator::new(&c, &schedule, &shifts, rule, 100.0, &mut out);
        for i in 0..schedule.times.len() {
            assert!(!a.is_complete());
            assert!(a.sample(&sample(i, &[0.0, -0.5])).is_continue());
        }
        assert!(a.is_complete());
        assert_eq!(a.sum, 100.0 + 1.0 + 400.0 + 4.0 + 1600.0 + 9.0);
        assert_eq!(out, [-1.0, -2.0, -3.0, -20.0, -40.0]);
    }

    #[test]
    fn schedule_shifts_samples_of_delayed_outputs_but_not_before_the_start() {
        let c = Comparison::new(&[
            measured(&[(0.0, 1.0), (1.0, 2.0), (3.0, 3.0)]),
            measured(&[(0.7, 4.0), (1.0, 5.0)]),
        ]);
        let schedule = c.schedule(|output| [0.4, 0.1][output], 0.0);
        // 1 - 0.4 and 0.7 - 0.1 are equal up to rounding.
        assert_eq!(schedule.times.len(), 4);
        assert_eq!(schedule.samples, [vec![0, 1, 3], vec![1, 2]], "{:?}", schedule.times);
    }

    #[test]
    fn accumulator_stops_strictly_above_the_cutoff_and_at_nan() {
        let c = Comparison::new(&[measured(&[(0.0, 0.0), (1.0, 0.0)])]);
        let schedule = c.schedule(|_| 0.0, 0.0);
        let [mut first, mut second] = [[0.0; 2]; 2];
        let rule = CostRule { cutoff: 4.0, ..CostRule::whole(RobustLoss::default(), &RunContext::new()) };
        let shifts = [shift(0.0)];
        let mut a = Accumulator::new(&c, &schedule, &shifts, rule, 0.0, &mut first);
        assert!(a.sample(&sample(0, &[2.0])).is_continue());
        assert!(a.sample(&sample(1, &[1e-3])).is_break());
        assert_eq!(a.stop, Some(StopReason::AboveCutoff));
        let mut a = Accumulator::new(&c, &schedule, &shifts, rule, 0.0, &mut second);
        assert!(a.sample(&sample(0, &[f64::NAN])).is_break());
        assert_eq!(a.stop, Some(StopReason::NotFinite(0)));
        assert!(!a.is_complete());
    }

    #[test]
    fn quad_err_interpolates_linearly_and_weights_the_squares() {
        let (t_sim, y) = ([0.0, 1.0, 3.0], [0.0, 2.0, 6.0]);
        let e = quad_err(&[0.5, 2.0, 3.0], &[&[0.0, 4.0, 7.0]], &t_sim, &[&y], None).unwrap();
        assert_eq!(e, 1.0 + 0.0 + 1.0);
        let e = quad_err(&[0.5], &[&[0.0], &[0.0]], &t_sim, &[&y, &y], Some(&[2.0, 3.0])).unwrap();
        assert_eq!(e, 2.0 + 3.0);
        // Beyond the ends, the end values count. At an event, the mean of both sides counts.
        let e = quad_err(&[-1.0, 4.0], &[&[1.0, 1.0]], &[0.0, 1.0], &[&[0.0, 3.0]], None).unwrap();
        assert_eq!(e, 1.0 + 4.0);
        let e = quad_err(&[1.0], &[&[0.0]], &[0.0, 1.0, 1.0, 2.0], &[&[0.0, 2.0, 4.0, 4.0]], None).unwrap();
        assert_eq!(e, 9.0);
    }

    #[test]
    fn quad_err_reports_inconsistent_lengths() {
        for (e, expected) in [
            (quad_err(&[0.0], &[&[0.0]], &[0.0], &[], None), "1 measured quantities, but 0"),
            (quad_err(&[0.0], &[&[0.0]], &[], &[&[]], None), "the simulation has no times"),
            (
                quad_err(&[0.0, 1.0], &[&[0.0]], &[0.0], &[&[0.0]], None),
                "measured quantity 0 has 1 values, but there are 2",
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
