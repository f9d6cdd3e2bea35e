//! The best point of a fit, evaluated again in a process that was never asked before, and in those that the
//! fit has used: whether a cost depends on what ran before it.

use crate::cost::calibration::Calibration;
use crate::cost::failure::NoCost;
use crate::cost::parallel::{beside, map};
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

/// A point, and its residuals as they count, where they are known.
pub(crate) struct BestPoint {
    pub(crate) x: Vec<f64>,
    pub(crate) residuals: Option<Vec<f64>>,
}

/// The bits of the residuals at a point; none where it fails.
type Bits = Option<Vec<u64>>;

fn bits(residuals: &[f64]) -> Bits {
    Some(residuals.iter().map(|residual| residual.to_bits()).collect())
}

impl Calibration {
    /// True if each evaluation has a process of its own.
    pub(super) fn is_apart(&self) -> bool {
        self.evaluator().remote.is_ok() && self.fmu().has_hidden_state()
    }

    /// Evaluates a point again in each process that is not asked at the moment, and in a fresh one while
    /// `work` is done. Where these give others than before, each evaluation has a process of its own from now
    /// on.
    pub(super) fn beside_fresh_process<T>(
        &self,
        best: &BestPoint,
        loss: RobustLoss,
        context: &RunContext<'_>,
        work: impl FnOnce() -> T,
    ) -> (T, Fresh) {
        let remote = self.evaluator().remote.as_ref().ok().filter(|_| !self.is_apart());
        let (Some(remote), false) = (remote, context.is_over()) else { return (work(), Fresh::Same) };
        let n = remote.n_idle();
        let ask = |_, context: &RunContext<'_>| self.again(remote, best, loss, Asked::LongestIdle, context);
        let used = map(n, n, context, &ask).into_iter().flatten().flatten();
        let known: Vec<Bits> = best.residuals.iter().map(|known| bits(known)).chain(used).collect();
        let task = |context: &RunContext<'_>| self.compare(remote, best, loss, &known, context);
        let (Ok(done), found) = beside(context, task, || Ok::<T, Infallible>(work()));
        (done, found.unwrap_or(Fresh::Same))
    }

    fn compare(
        &self,
        remote: &Remote,
        best: &BestPoint,
        loss: RobustLoss,
        known: &[Bits],
        context: &RunContext<'_>,
    ) -> Fresh {
        let fresh = || self.again(remote, best, loss, Asked::Fresh, context);
        let Some(first) = fresh() else { return Fresh::Same };
        if known.iter().all(|known| *known == first) {
            return Fresh::Same;
        }
        match fresh() {
            Some(second) if second == first => {
                self.fmu().note_hidden_state();
                Fresh::Other
            }
            Some(_) => Fresh::Random,
            None => Fresh::Same,
        }
    }

    /// The residuals at a point by such a process; `None`: nothing was found out.
    fn again(
        &self,
        remote: &Remote,
        best: &BestPoint,
        loss: RobustLoss,
        process: Asked,
        context: &RunContext<'_>,
    ) -> Option<Bits> {
        let rule = CostRule::whole(loss, context);
        let mut residuals = vec![0.0; self.n_residuals()];
        let method = self.method(context).ok()?;
        let asked = (None, process);
        match remote.evaluate((&best.x, method), rule, asked, &mut residuals, &mut Stats::default()) {
            Ok(_) => Some(bits(&residuals)),
            Err(NoCost::Failed { .. }) => Some(None),
            Err(_) => None,
        }
    }
}
