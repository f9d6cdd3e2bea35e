//! Delivery of the samples at requested times to the observer.

use crate::observer::{Observer, Sample, Side};
use crate::system::{CallResult, HybridSystem};
use std::ops::ControlFlow;

/// Position in the list of requested times, and the outputs of a sample.
#[derive(Debug, Default)]
pub(crate) struct Sampler {
    cursor: usize,
    outputs: Vec<f64>,
    delivered: u64,
    /// Times closer than this are equal.
    time_tolerance: f64,
}

/// Point at which the outputs are evaluated.
pub(crate) struct Here<'a> {
    pub(crate) t: f64,
    pub(crate) x: &'a [f64],
    /// Requested times within this tolerance are equal to `t`.
    pub(crate) time_tolerance: f64,
    /// True if a row is recorded even if this time was not requested.
    pub(crate) record: bool,
}

impl Sampler {
    /// Index of the first invalid time: not finite, smaller than its predecessor, the third equal one, or
    /// outside `[lo, hi]`.
    pub(crate) fn first_bad_time(times: &[f64], lo: f64, hi: f64) -> Option<usize> {
        (0..times.len()).find(|&i| {
            let t = times[i];
            let inside = t >= lo && t <= hi;
            !inside || (i > 0 && t < times[i - 1]) || (i > 1 && t == times[i - 2])
        })
    }

    pub(crate) fn begin(&mut self, n_outputs: usize, time_tolerance: f64) {
        self.time_tolerance = time_tolerance;
        self.cursor = 0;
        self.delivered = 0;
        self.outputs.clear();
        self.outputs.resize(n_outputs, 0.0);
    }

    /// Number of samples delivered since [`begin`](Self::begin).
    pub(crate) fn delivered(&self) -> u64 {
        self.delivered
    }

    /// Next requested time if it is before `limit`.
    pub(crate) fn due_before(&self, times: &[f64], limit: f64) -> Option<f64> {
        times.get(self.cursor).copied().filter(|t| *t < limit)
    }

    /// True if the next requested time is listed twice.
    fn twice(&self, times: &[f64]) -> bool {
        self.cursor + 1 < times.len() && times[self.cursor + 1] - times[self.cursor] <= self.time_tolerance
    }

    fn emit(
        &mut self,
        system: &mut dyn HybridSystem,
        here: &Here<'_>,
        time: f64,
        index: Option<usize>,
        side: Side,
        observer: &mut dyn Observer,
    ) -> CallResult<ControlFlow<()>> {
        system.outputs(here.t, here.x, &mut self.outputs)?;
        self.delivered += 1;
        Ok(observer.sample(&Sample { time, index, side, states: here.x, outputs: &self.outputs }))
    }

    /// Delivers an additional row after an event.
    pub(crate) fn record(
        &mut self,
        system: &mut dyn HybridSystem,
        here: &Here<'_>,
        observer: &mut dyn Observer,
    ) -> CallResult<ControlFlow<()>> {
        self.emit(system, here, here.t, None, Side::Right, observer)
    }

    /// Delivers the sample of the next requested time. The system must be at that point.
    pub(crate) fn deliver(
        &mut self,
        system: &mut dyn HybridSystem,
        times: &[f64],
        here: &Here<'_>,
        observer: &mut dyn Observer,
    ) -> CallResult<ControlFlow<()>> {
        let index = self.cursor;
        let side = if self.twice(times) { Side::Left } else { Side::Right };
        let flow = self.emit(system, here, times[index], Some(index), side, observer)?;
        self.cursor += 1;
        Ok(flow)
    }

    /// Delivers the left limit just before an event, if its time is listed twice or events are recorded.
    pub(crate) fn deliver_left(
        &mut self,
        system: &mut dyn HybridSystem,
        times: &[f64],
        here: &Here<'_>,
        observer: &mut dyn Observer,
    ) -> CallResult<ControlFlow<()>> {
        if self.due_before(times, here.t + here.time_tolerance).is_some() && self.twice(times) {
            self.deliver(system, times, here, observer)
        } else if here.record {
            self.emit(system, here, here.t, None, Side::Left, observer)
        } else {
            Ok(ControlFlow::Continue(()))
        }
    }

    /// Delivers all requested times at this instant, after all its events. Delivers at least one row if
    /// `here.record`.
    pub(crate) fn deliver_here(
        &mut self,
        system: &mut dyn HybridSystem,
        times: &[f64],
        here: &Here<'_>,
        observer: &mut dyn Observer,
    ) -> CallResult<ControlFlow<()>> {
        let mut any = false;
        while times.get(self.cursor).is_some_and(|t| *t <= here.t + here.time_tolerance) {
            any = true;
            if self.deliver(system, times, here, observer)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        if here.record && !any {
            return self.record(system, here, observer);
        }
        Ok(ControlFlow::Continue(()))
    }
}
