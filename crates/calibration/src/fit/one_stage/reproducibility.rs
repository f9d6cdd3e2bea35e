//! The best point of a fit, evaluated again in a process that was never asked before, and in those that the
//! fit has used: whether a cost depends on what ran before it.

use crate::cost::failure::CostFailure;
use crate::cost::parallel::{beside, map};
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
    /// serve more than one evaluation.
    pub(super) fn is_comparable(&self) -> bool {
        self.evaluator().remote.is_ok() && !self.is_apart()
    }

    /// Evaluates a point again in at most `most_used` processes that have evaluated others and are idle, and
    /// in a fresh one while `work` is done; with what that takes. `None`: in none. Where these give other
    /// residuals than before, each evaluation has a process of its own from now on.
    pub(super) fn beside_fresh_process<T>(
        &self,
        best: &BestPoint,
        most_used: Option<usize>,
        loss: RobustLoss,
        context: &RunContext<'_>,
        work: impl FnOnce() -> T,
    ) -> (T, Reproducibility, Checks) {
        let remote = self.evaluator().remote.as_ref().ok().filter(|_| !context.is_over());
        let (Some(remote), Some(most_used)) = (remote, most_used) else {
            return (work(), Reproducibility::Same, Checks::default());
        };
        let repeated = Repeated { calibration: self, remote, best, loss, taken: Mutex::default() };
        let n = remote.n_idle().min(most_used);
        let used = map(n, n, context, &|_, context| repeated.by(ProcessChoice::LongestIdle, context));
        let used = used.into_iter().flatten().flatten();
        let known: Vec<Bits> = best.residuals.iter().map(|known| bits(known)).chain(used).collect();
        let task = |context: &RunContext<'_>| repeated.compare(&known, context);
        let (Ok(done), found) = beside(context, task, || Ok::<T, Infallible>(work()));
        let taken = repeated.taken.into_inner().unwrap_or_else(PoisonError::into_inner);
        (done, found.unwrap_or(Reproducibility::Same), taken)
    }
}

impl Repeated<'_> {
    fn compare(&self, known: &[Bits], context: &RunContext<'_>) -> Reproducibility {
        let fresh = || self.by(ProcessChoice::Fresh, context);
        let Some(first) = fresh() else { return Reproducibility::Same };
        if known.iter().all(|known| *known == first) {
            return Reproducibility::Same;
        }
        match fresh() {
            Some(second) if second == first => {
                self.calibration.fmu().note_hidden_state();
                Reproducibility::Other
            }
            Some(_) => Reproducibility::Random,
            None => Reproducibility::Same,
        }
    }

    /// The residuals at the point by such a process; `None`: nothing was found out.
    fn by(&self, process: ProcessChoice, context: &RunContext<'_>) -> Option<Bits> {
        let rule = CostRule::whole(self.loss, context);
        let mut residuals = vec![0.0; self.calibration.n_residuals()];
        let method = self.calibration.method(context).ok()?;
        let (evaluation, mut stats) = (Evaluation { method, accuracy: None, process }, Stats::default());
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
