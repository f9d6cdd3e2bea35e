//! The best point of a fit, evaluated again in a process that was never asked before: whether a cost depends
//! on what ran before it.

use crate::cost::failure::CostFailure;
use crate::cost::parallel::beside;
use crate::cost::process::{Evaluation, ProcessChoice, Remote};
use crate::cost::residual::CostRule;
use crate::loaded::calibration::Calibration;
use base::RunContext;
use dfo::RobustLoss;
use ode::{Checks, Stats};
use std::convert::Infallible;
use std::sync::{Mutex, PoisonError};

/// Result of the comparison with a fresh process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reproducibility {
    /// The same bits, or nothing that says anything.
    Same,
    /// Other bits, the same in two such processes.
    Other,
    /// Other bits in each.
    Random,
}

/// The best point of a fit, and its residuals as they count, where they are known.
pub(crate) struct BestPoint {
    pub(crate) x: Vec<f64>,
    pub(crate) residuals: Option<Vec<f64>>,
}

/// The bits of the residuals at a point; none where it fails.
type Bits = Option<Vec<u64>>;

fn bits(residuals: &[f64]) -> Bits {
    Some(residuals.iter().map(|residual| residual.to_bits()).collect())
}

/// The evaluations of the best point that are made again, and what they take.
struct Repeated<'a> {
    calibration: &'a Calibration,
    remote: &'a Remote,
    best: &'a BestPoint,
    loss: RobustLoss,
    taken: Mutex<Checks>,
}

impl Calibration {
    /// True if each evaluation has a process of its own.
    pub(super) fn is_apart(&self) -> bool {
        self.evaluator().remote.is_ok() && self.fmu().has_hidden_state()
    }

    /// True if the best point of a fit can be compared with a fresh process: the model runs in processes that
    /// serve more than one evaluation, none of its fits was compared before, and its residuals are known.
    pub(super) fn is_comparable(&self, best: &BestPoint) -> bool {
        let is_open = self.evaluator().remote.as_ref().is_ok_and(|remote| !remote.is_compared());
        is_open && !self.is_apart() && best.residuals.is_some()
    }

    /// Evaluates a point again in a fresh process while `work` is done, if that `is_due`; with what that
    /// takes. Where it gives other residuals than before, each evaluation has a process of its own from now
    /// on.
    pub(super) fn beside_fresh_process<T>(
        &self,
        best: &BestPoint,
        is_due: bool,
        loss: RobustLoss,
        context: &RunContext<'_>,
        work: impl FnOnce() -> T,
    ) -> (T, Reproducibility, Checks) {
        let remote = self.evaluator().remote.as_ref().ok().filter(|_| is_due && !context.is_over());
        let (Some(remote), Some(known)) = (remote, &best.residuals) else {
            return (work(), Reproducibility::Same, Checks::default());
        };
        let repeated = Repeated { calibration: self, remote, best, loss, taken: Mutex::default() };
        let known = bits(known);
        let task = |context: &RunContext<'_>| repeated.compare(&known, context);
        let (Ok(done), found) = beside(context, task, || Ok::<T, Infallible>(work()));
        let taken = repeated.taken.into_inner().unwrap_or_else(PoisonError::into_inner);
        (done, found.unwrap_or(Reproducibility::Same), taken)
    }
}

impl Repeated<'_> {
    fn compare(&self, known: &Bits, context: &RunContext<'_>) -> Reproducibility {
        let Some(first) = self.in_fresh(context) else { return Reproducibility::Same };
        self.remote.set_compared();
        if *known == first {
            return Reproducibility::Same;
        }
        match self.in_fresh(context) {
            Some(second) if second == first => {
                self.calibration.fmu().note_hidden_state();
                Reproducibility::Other
            }
            Some(_) => Reproducibility::Random,
            None => Reproducibility::Same,
        }
    }

    /// The residuals at the point by a fresh process; `None`: nothing was found out.
    fn in_fresh(&self, context: &RunContext<'_>) -> Option<Bits> {
        let rule = CostRule::whole(self.loss, context);
        let mut residuals = vec![0.0; self.calibration.n_residuals()];
        let method = self.calibration.method(context).ok()?;
        let (evaluation, mut stats) =
            (Evaluation { method, accuracy: None, process: ProcessChoice::Fresh }, Stats::default());
        let found = self.remote.evaluate(&self.best.x, evaluation, rule, &mut residuals, &mut stats);
        let n_simulations = self.calibration.problem().experiments.len() as u64;
        *self.taken.lock().unwrap_or_else(PoisonError::into_inner) += stats.as_checks(n_simulations);
        match found {
            Ok(_) => Some(bits(&residuals)),
            Err(CostFailure::Failed { .. }) => Some(None),
            Err(_) => None,
        }
    }
}
