//! Fit of one stage: options, search, and uncertainty of the result.

mod assessment;
mod misfit;
mod modelled_noise;
mod noise;
mod noise_iterations;
mod options;
mod result;
mod search;
mod simulation_executor;
mod tolerance;

pub use modelled_noise::{ModelledNoise, SigmaSeries};
pub use noise::{EstimatedNoise, FitNoise, NoiseRule, OutputNoise};
pub(crate) use noise_iterations::{add_earlier, checkpoint_of, ended_by};
pub use options::{FitObserver, FitOptions, FitRecord};
pub use result::Fit;
pub use simulation_executor::SimulationExecutor;
pub use tolerance::ChosenTolerance;

use crate::cost::comparison::NOT_REPRODUCED;
use crate::cost::parallel::beside;
use crate::cost::process::Remote;
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Origin};
use crate::findings::identifier::FindingId;
use crate::fit::output_fit::KeptResiduals;
use crate::fit::phase::FitPhase;
use crate::loaded::budget::Extra;
use crate::loaded::calibration::Calibration;
use base::RunContext;
use fmi::Reuse;
pub(crate) use noise_iterations::FinalSearch;
use ode::Stats;
pub(crate) use search::{Job, SearchResult, UsedLimits};
use std::convert::Infallible;

/// Finding about a model that requires a separate process for each simulation.
const HIDDEN_STATE: &str = "the model keeps state outside of its instances, which no variable shows. Each evaluation ran in a separate process, so the result is correct";

/// Finding about a fit that could not restart.
const NOT_ANEW: &str = "evaluations depended on earlier ones, and the time limit ended the fit before it could restart. Its costs may be \
                        wrong";

impl Calibration {
    /// Fits the parameters.
    ///
    /// Simulations that are long enough run on separate threads, while the calling thread observes and polls.
    /// Evaluations that can no longer matter are stopped early (see [`dfo::Outcome::Above`]), which does not
    /// change any decision.
    ///
    /// # Errors
    /// Returns an error if the options are invalid, if simulations fail at every starting point, or if the
    /// run ended before any point had a cost. In all other cases, including an early end, returns a [`Fit`]
    /// with the best point found.
    pub fn fit<'a>(&self, options: impl Into<FitOptions<'a>>) -> Result<Fit, CalibrationError> {
        self.fit_and_keep(options.into(), None).map(|(fit, _)| fit)
    }

    /// Fits the parameters and also returns the residuals that the run computed, with the weights of this
    /// calibration. `within` is the context of a run that has already begun; `None` begins a new run.
    pub(crate) fn fit_and_keep(
        &self,
        options: FitOptions<'_>,
        within: Option<RunContext<'_>>,
    ) -> Result<(Fit, KeptResiduals), CalibrationError> {
        let _held = self.hold();
        let mut job = Job::new(self, options, within)?;
        if job.context.is_cancelled() {
            return Err(CalibrationError::Cancelled);
        }
        self.choose_method(&mut job.run, &job.start, &job.held, &job.objective)?;
        let (run, has_preflight) = (job.run.clone(), job.has_preflight);
        let mut stats = Stats::default();
        loop {
            let n_late = self.fmu().n_late();
            let mut made = match self.made(&mut job, &mut stats) {
                Err(error) if !job.context.is_cancelled() => FinalSearch::of(self.start_alone(&job, error)?),
                made => made?,
            };
            let has_processes = self.evaluator().remote.is_ok();
            let is_apart = has_processes && self.fmu().reuse() == Reuse::NewProcess;
            // Evaluations have separate processes now, so no action is needed.
            let handled =
                || Finding::note(FindingId::HiddenState, "FMU", HIDDEN_STATE, "").of(Origin::Search);
            made.searched.raised.extend(is_apart.then(handled));
            job.enter(FitPhase::FreshProcess, &stats);
            let fitted = made.fitted_calibration.take();
            let fitted = fitted.as_ref().unwrap_or(self);
            let best = made.best(fitted.n_residuals(), fitted.n_values(), job.objective.is_sum_of_squares());
            let mut budget = made.budget();
            // Reserve this evaluation even if no comparison follows, and reserve an accurate simulation of
            // the result. Otherwise processes or the number of workers would decide about the other
            // simulations.
            let fits = budget.take(1.0);
            let reserved = if job.has_uncertainty() { fitted.price_of_accurate() } else { 0.0 };
            let most_used = budget.left_beside(reserved);
            if !fits && has_processes && !is_apart {
                budget.skip(Extra::FreshProcess);
            }
            let remote_of_fit = fitted.evaluator().remote.as_ref().ok();
            let compared = remote_of_fit.filter(|_| fits && !is_apart && !job.context.is_over());
            let judge = || Ok::<_, Infallible>(self.assessed(fitted, &job, made, stats, budget));
            let (Ok((mut fit, kept)), checks) = match compared {
                Some(remote) => {
                    let compare = |context: &RunContext<'_>| {
                        let stats = remote.compare_best(&best, job.loss, most_used, context);
                        stats.as_checks(fitted.problem().experiments.len() as u64)
                    };
                    beside(&job.context, compare, judge)
                }
                None => (judge(), None),
            };
            fit.stats.add_checks(checks.unwrap_or_default());
            fit.phases = job.phases.borrow_mut().costs(&fit.stats);
            let is_wrong = self.fmu().n_late() > n_late;
            let doubt = match is_wrong {
                false if remote_of_fit.is_some_and(Remote::is_random) => Some(Finding::warning(
                    FindingId::NotReproducible,
                    "FMU",
                    NOT_REPRODUCED,
                    "Look for random numbers, clocks and files in the model",
                )),
                true if job.context.is_over() => Some(Finding::warning(
                    FindingId::DependentEvaluations,
                    "FMU",
                    NOT_ANEW,
                    "Set a larger max_time",
                )),
                _ => None,
            };
            if doubt.is_some() || !is_wrong {
                fit.setup_findings.extend(doubt);
                if !job.is_part {
                    fit.note_end_before_minimum();
                }
                return Ok((fit, kept));
            }
            stats = fit.stats;
            let model = &self.fmu().description().model_name;
            log::warn!("{model}: evaluations depended on earlier ones, so the fit restarts");
            job.restart(run.clone(), has_preflight);
        }
    }
}
