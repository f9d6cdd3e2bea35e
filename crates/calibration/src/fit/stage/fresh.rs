//! The best point of a fit, evaluated again in a process that was never asked before: whether its cost
//! depends on what ran before it.

use crate::cost::calibration::Calibration;
use crate::cost::failure::NoCost;
use crate::cost::parallel::beside;
use crate::cost::process::{Asked, Remote};
use crate::cost::residual::CostRule;
use base::RunContext;
use dfo::RobustLoss;
use ode::Stats;
use std::convert::Infallible;

/// Result of the comparison with a fresh process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fresh {
    /// The same bits, or nothing that says anything.
    Same,
    /// Other bits, the same in two such processes.
    Other,
    /// Other bits in each.
    Random,
}

/// A point, and its residuals as they count.
pub(crate) struct KnownPoint {
    pub(crate) x: Vec<f64>,
    pub(crate) residuals: Vec<f64>,
}

impl Calibration {
    /// Does `work` while a point is evaluated again; `best`: the point.
    /// Where these are others, each evaluation has a process of its own from now on.
    pub(super) fn beside_fresh_process<T>(
        &self,
        best: Option<&KnownPoint>,
        loss: RobustLoss,
        context: &RunContext<'_>,
        work: impl FnOnce() -> T,
    ) -> (T, Fresh) {
        let remote = self.evaluator().remote.as_ref().ok().filter(|remote| !remote.is_always_fresh());
        let (Some(remote), Some(best), false) = (remote, best, context.is_over()) else {
            return (work(), Fresh::Same);
        };
        let task = |context: &RunContext<'_>| self.again(remote, best, loss, context);
        let (Ok(done), found) = beside(context, task, || Ok::<T, Infallible>(work()));
        (done, found.unwrap_or(Fresh::Same))
    }

    fn again(
        &self,
        remote: &Remote,
        KnownPoint { x, residuals: known }: &KnownPoint,
        loss: RobustLoss,
        context: &RunContext<'_>,
    ) -> Fresh {
        // The bits of the residuals, none of a point that fails; `Err`: nothing was found out.
        let residuals = || -> Result<Option<Vec<u64>>, ()> {
            let rule = CostRule::whole(loss, context);
            let mut residuals = vec![0.0; self.n_residuals()];
            let method = self.method(context).map_err(drop)?;
            let asked = (None, Asked::Fresh);
            match remote.evaluate((x, method), rule, asked, &mut residuals, &mut Stats::default()) {
                Ok(_) => Ok(Some(residuals.iter().map(|residual| residual.to_bits()).collect())),
                Err(NoCost::Failed { .. }) => Ok(None),
                Err(_) => Err(()),
            }
        };
        let known = Some(known.iter().map(|residual| residual.to_bits()).collect::<Vec<_>>());
        let Ok(first) = residuals() else { return Fresh::Same };
        if first == known {
            return Fresh::Same;
        }
        match residuals() {
            Ok(second) if second == first => {
                remote.set_always_fresh();
                Fresh::Other
            }
            Ok(_) => Fresh::Random,
            Err(()) => Fresh::Same,
        }
    }
}
