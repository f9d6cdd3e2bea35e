//! Costs of a fit that are computed again at its end, in a newly loaded copy of the FMU's library: shows whether they depend on what ran
//! before them.

use crate::calibration::Calibration;
use crate::no_cost::NoCost;
use crate::residual::CostRule;
use fmi::Simulator;
use ode::Stats;
use std::hash::{DefaultHasher, Hasher};
use std::time::{Duration, Instant};

/// At most so many costs are computed again, and one for so many evaluations, but one at least.
const MOST: usize = 16;
const SHARE: usize = 10;

/// No further ones after a second, and after this part of the time that the run took.
const PART_OF_TIME: u32 = 20;

/// A point and its cost.
type Point = (Vec<f64>, f64);

/// The points to be looked at again: that of the lowest cost, and others that a hash of their values chooses, so the choice depends
/// on no order.
#[derive(Debug, Default)]
pub(crate) struct SpotChecks {
    n: usize,
    best: Option<Point>,
    /// Sorted by their hashes, the smallest first.
    chosen: Vec<(u64, Point)>,
}

impl SpotChecks {
    /// Notes an evaluation, and its cost if it has one.
    pub(crate) fn note(&mut self, x: &[f64], cost: Option<f64>) {
        self.n += 1;
        let Some(cost) = cost else { return };
        if self.best.as_ref().is_none_or(|(_, known)| cost < *known) {
            self.best = Some((x.to_vec(), cost));
        }
        let mut hasher = DefaultHasher::new();
        x.iter().for_each(|value| hasher.write_u64(value.to_bits()));
        let hash = hasher.finish();
        let place = self.chosen.partition_point(|(known, _)| *known < hash);
        if place < MOST - 1 && self.chosen.get(place).is_none_or(|(known, _)| *known != hash) {
            self.chosen.truncate(MOST - 2);
            self.chosen.insert(place, (hash, (x.to_vec(), cost)));
        }
    }

    fn points(&self) -> impl Iterator<Item = &Point> {
        let n = (self.n / SHARE).clamp(1, MOST);
        self.best.iter().chain(self.chosen.iter().map(|(_, point)| point)).take(n)
    }
}

impl Calibration {
    /// Whether one of these costs is another one in a newly loaded copy of the library: then every simulation has such a copy from now
    /// on. What cannot be computed again, for there is no copy to be had, is taken as it is.
    pub(crate) fn costs_depend_on_history(
        &self,
        checks: &SpotChecks,
        took: Duration,
        rule: CostRule<'_>,
    ) -> bool {
        let Some(mut simulators) = self.simulators_in_new_copies(rule.cancelled) else { return false };
        let (began, longest) = (Instant::now(), Duration::from_secs(1).max(took / PART_OF_TIME));
        for (x, cost) in checks.points() {
            if began.elapsed() > longest {
                break;
            }
            match self.cost_in(&mut simulators, x, rule) {
                Err(NoCost::Cancelled | NoCost::Over(_)) => return false,
                Ok(found) if found.to_bits() == cost.to_bits() => {}
                _ => {
                    drop(simulators);
                    return self.conclude(x, rule).unwrap_or(false);
                }
            }
        }
        false
    }

    /// Whether the cost at a point, which is not what it was, is the same in two newly loaded copies; `None`: there are none.
    fn conclude(&self, x: &[f64], rule: CostRule<'_>) -> Option<bool> {
        let cost = || {
            let found = self.cost_in(&mut self.simulators_in_new_copies(rule.cancelled)?, x, rule);
            match found {
                Err(NoCost::Cancelled | NoCost::Over(_)) => None,
                found => Some(found.ok().map(f64::to_bits)),
            }
        };
        let is_reproducible = cost()? == cost()?;
        self.pool(0, rule.cancelled).ok()?.note_difference(is_reproducible).ok()?;
        Some(is_reproducible)
    }

    fn cost_in(&self, simulators: &mut [Simulator], x: &[f64], rule: CostRule<'_>) -> Result<f64, NoCost> {
        let mut residuals = vec![0.0; self.n_residuals()];
        self.evaluator()
            .evaluate(x, rule, &mut residuals, &mut Stats::default(), |k, run| Ok(run(&mut simulators[k])))
    }

    /// One for each experiment.
    fn simulators_in_new_copies(&self, cancelled: &dyn Fn() -> bool) -> Option<Vec<Simulator>> {
        let simulator = |k| match self.pool(k, cancelled).ok()?.simulator_in_new_copy() {
            Ok(simulator) => simulator,
            Err(error) => {
                log::info!("costs cannot be computed again in a new copy of the library: {error}");
                None
            }
        };
        (0..self.problem().experiments.len()).map(simulator).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_points_depend_on_no_order() {
        let points: Vec<Point> = (0..300).map(|k| (vec![f64::from(k)], f64::from((k * 77) % 307))).collect();
        let chosen = |points: &mut dyn Iterator<Item = &Point>| {
            let mut checks = SpotChecks::default();
            points.for_each(|(x, cost)| checks.note(x, Some(*cost)));
            checks.points().cloned().collect::<Vec<_>>()
        };
        let one = chosen(&mut points.iter());
        assert_eq!((one.len(), one[0].1), (MOST, 0.0));
        assert_eq!(one, chosen(&mut points.iter().rev()));
        assert_eq!(one, chosen(&mut points.iter().chain(&points)));
        assert_eq!(chosen(&mut points.iter().take(50)).len(), 5);
    }
}
