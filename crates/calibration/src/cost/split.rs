//! Simultaneous simulation of the recordings of one point in several worker processes.

use crate::cost::comparison::ProcessChoice;
use crate::cost::failure::CostFailure;
use crate::cost::loaded_problem::LoadedProblem;
use crate::cost::parallel::map;
use crate::cost::process::{Evaluation, Remote};
use crate::cost::residual::{CostRule, sum_of_squares};
use base::RunContext;
use ode::Stats;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Shortest simulation, in s per recording, for which recordings are simulated separately. To start a thread
/// and to hand over a request costs about a tenth of it (`benches/overhead.md`).
const SHORTEST: f64 = 1e-3;

/// Interval between two checks of the context while a point waits for a worker.
const POLL: Duration = Duration::from_millis(20);

/// Evaluation of a point of a search.
const SEARCHED: Evaluation = Evaluation::whole(ProcessChoice::ComparedFirst);

/// Workers of a search, shared by the points that are evaluated at the same time.
#[derive(Debug)]
pub(crate) struct Slots {
    free: Mutex<usize>,
    released: Condvar,
    /// Simulation time of the last point in s, as bits. It only decides which process simulates.
    seconds: AtomicU64,
}

/// Workers held by a point.
struct HeldSlots<'a> {
    slots: &'a Slots,
    n: usize,
}

impl Slots {
    pub(crate) fn new(workers: usize) -> Self {
        Self { free: Mutex::new(workers), released: Condvar::new(), seconds: AtomicU64::new(0) }
    }

    fn free(&self) -> MutexGuard<'_, usize> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for a worker. `None` if the context ends before one is free.
    fn wait(&self, context: &RunContext<'_>) -> Option<HeldSlots<'_>> {
        let mut free = self.free();
        while *free == 0 {
            if context.is_over() {
                return None;
            }
            free = self.released.wait_timeout(free, POLL).unwrap_or_else(PoisonError::into_inner).0;
        }
        *free -= 1;
        Some(HeldSlots { slots: self, n: 1 })
    }

    fn seconds(&self) -> f64 {
        f64::from_bits(self.seconds.load(Ordering::Relaxed))
    }
}

impl HeldSlots<'_> {
    /// Takes up to `n` further workers that are free now.
    fn take(&mut self, n: usize) {
        let mut free = self.slots.free();
        let taken = n.min(*free);
        *free -= taken;
        self.n += taken;
    }
}

impl Drop for HeldSlots<'_> {
    fn drop(&mut self) {
        *self.slots.free() += self.n;
        self.slots.released.notify_all();
    }
}

impl LoadedProblem {
    /// Returns the cost like [`Remote::evaluate`], with the recordings on all workers that are free.
    /// Residuals, cost and failure are the same, because the recordings count in their order. The statistics
    /// are also the same, except that a finite cutoff stops fewer simulations.
    pub(crate) fn evaluate_on(
        &self,
        slots: &Slots,
        remote: &Remote,
        x: &[f64],
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
    ) -> Result<f64, CostFailure> {
        let mut held = slots.wait(&rule.context).ok_or(CostFailure::Cancelled)?;
        let n = self.simulations.len();
        if n > 1 && slots.seconds() > SHORTEST * n as f64 && remote.is_reset_tested() {
            held.take(n - 1);
        }
        let mut taken = Stats::default();
        let cost = match held.n {
            1 => remote.evaluate(x, SEARCHED, rule, (out, self.n_residuals), &mut taken),
            workers => self.evaluate_recordings(workers, remote, x, rule, out, &mut taken),
        };
        slots.seconds.store(taken.seconds.get().to_bits(), Ordering::Relaxed);
        *stats += taken;
        cost
    }

    /// Simulates each recording in a worker process, `workers` at a time.
    fn evaluate_recordings(
        &self,
        workers: usize,
        remote: &Remote,
        x: &[f64],
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
    ) -> Result<f64, CostFailure> {
        let (residuals, mut criteria) = out.split_at_mut(self.n_residuals);
        let (measured, priors) = residuals.split_at_mut(self.layout.n_measurements());
        if self.prior_residuals(x, priors)? > rule.cutoff {
            return Err(CostFailure::Above);
        }
        let n_residuals = |k: usize| self.simulations[k].comparison.n_residuals();
        let first_failed = AtomicUsize::new(usize::MAX);
        let simulate = |k: usize, context: &RunContext<'_>| {
            if k > first_failed.load(Ordering::Relaxed) {
                return None;
            }
            let n = n_residuals(k) + self.simulations[k].criteria.len();
            let (mut values, mut stats) = (vec![0.0; n], Stats::default());
            let (rule, evaluation) =
                (CostRule { context: *context, ..rule }, Evaluation { recording: Some(k), ..SEARCHED });
            let cost = remote.evaluate(x, evaluation, rule, (&mut values, n_residuals(k)), &mut stats);
            if cost.is_err() {
                first_failed.fetch_min(k, Ordering::Relaxed);
            }
            Some((cost, values, stats))
        };
        let mut rest = measured;
        for (k, simulated) in
            map(self.simulations.len(), workers, &rule.context, &simulate).into_iter().enumerate()
        {
            let (cost, values, taken) = simulated.flatten().ok_or(CostFailure::Cancelled)?;
            *stats += taken;
            match cost {
                Ok(_) => {}
                // In order, the cost may pass the cutoff before the failure.
                Err(CostFailure::Failed { .. }) if rule.cutoff.is_finite() => {
                    return remote.evaluate(x, SEARCHED, rule, (out, self.n_residuals), stats);
                }
                Err(failure) => return Err(failure),
            }
            let (part, others) = rest.split_at_mut(n_residuals(k));
            let (values_here, other_criteria) = criteria.split_at_mut(values.len() - part.len());
            let (of_residuals, of_criteria) = values.split_at(part.len());
            part.copy_from_slice(of_residuals);
            values_here.copy_from_slice(of_criteria);
            (rest, criteria) = (others, other_criteria);
        }
        let cost = sum_of_squares(&out[..self.n_residuals]);
        if cost > rule.cutoff { Err(CostFailure::Above) } else { Ok(cost) }
    }
}
