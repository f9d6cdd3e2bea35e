//! The fit: what is asked for, the search, and the uncertainty of its result; parameters with names come out.

mod assessment;
mod misfit;
mod noise;
mod noise_iterations;
mod options;
mod reproducibility;
mod result;
mod search;
mod simulation_executor;
mod tolerance;

pub use noise::{EstimatedNoise, FitNoise, NoiseRule, OutputNoise};
pub(crate) use noise_iterations::{add_earlier, checkpoint_of, ended_by};
pub use options::{FitObserver, FitOptions, FitRecord};
pub use result::Fit;
pub use simulation_executor::SimulationExecutor;
pub use tolerance::ChosenTolerance;

use crate::cost::process::HIDDEN_STATE;
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Origin, Severity};
use crate::fit::output_fit::KeptResiduals;
use crate::fit::phase::FitPhase;
use crate::loaded::budget::Extra;
use crate::loaded::calibration::Calibration;
use base::RunContext;
pub(crate) use noise_iterations::FinalSearch;
use ode::Stats;
use reproducibility::Reproducibility;
pub(crate) use search::{Job, SearchResult, UsedLimits};

/// Finding about an FMU whose results depend on more than what is set.
const NOT_REPRODUCED: &str =
    "two evaluations of the best point in fresh processes differ: no cost can be reproduced";

/// An FMU that runs in this process keeps a state.
const STATE_HERE: &str = "a simulation depends on those before it in this process (a state that the model keeps and no variable shows): the result \
                          may be wrong; isolation = \"process\" gives each evaluation a process of its own";

/// The same, where there was no time for a fit without that.
const NOT_ANEW: &str = "a cost depends on what ran before it in the same process (a state that the model keeps and no variable shows): the costs \
                        of this fit may be wrong, and its time was over before it could begin anew";

fn finding_about_fmu(sentence: &str) -> Finding {
    Finding::warning("FMU", sentence, "")
}

impl Calibration {
    /// Fits the parameters.
    ///
    /// Simulations run on threads of their own where they are long enough for that; the calling thread
    /// observes and polls. Evaluations that can no longer matter are given up early (see
    /// [`dfo::Outcome::Above`]); this changes no decision.
    ///
    /// # Errors
    /// Options that cannot be used, simulations that fail at every starting point, a run ended before any
    /// point had a cost. Every other end, early ones included, is a [`Fit`] with the best point seen.
    pub fn fit<'a>(&self, options: impl Into<FitOptions<'a>>) -> Result<Fit, CalibrationError> {
        self.fit_and_keep(options.into(), None).map(|(fit, _)| fit)
    }

    /// The same, with the residuals that the run has computed, by the weights of this calibration; within a
    /// time that has begun already, or begins now.
    pub(crate) fn fit_and_keep(
        &self,
        options: FitOptions<'_>,
        within: Option<RunContext<'_>>,
    ) -> Result<(Fit, KeptResiduals), CalibrationError> {
        let _held = self.hold();
        let mut job = Job::new(self, options, within)?;
        self.choose_method(&mut job.run, &job.held, &job.objective)?;
        let (run, wants_preflight) = (job.run.clone(), job.wants_preflight);
        let mut stats = Stats::default();
        loop {
            let is_apart = self.is_apart();
            let mut made = match self.made(&mut job, &mut stats) {
                Err(error) if !job.context.is_cancelled() => FinalSearch::of(self.start_alone(&job, error)?),
                made => made?,
            };
            // Each has a process of its own: nothing is to be done.
            let handled = || Finding::new(Severity::Note, "FMU", HIDDEN_STATE, "").of(Origin::Search);
            made.searched.raised.extend(is_apart.then(handled));
            job.enter(FitPhase::FreshProcess, &stats);
            let (own, best) = (made.own.take(), made.best());
            let own = own.as_ref().unwrap_or(self);
            let mut budget = made.budget(self, &job.start);
            // Taken where nothing is compared, too, and with room left for an accurate simulation of the result:
            // neither a process nor the number of workers decides what else is simulated.
            let has_room = budget.take(1.0);
            let reserved = if job.has_uncertainty() { own.price_of_accurate() } else { 0.0 };
            let most_used = has_room.then(|| budget.left_beside(reserved));
            // What is compared is known, or a used process has to tell it.
            let most_used = most_used.filter(|most| best.residuals.is_some() || *most > 0);
            if most_used.is_none() && own.is_comparable() {
                budget.skip(Extra::FreshProcess);
            }
            let most_used = most_used.filter(|_| own.is_comparable());
            let ((mut fit, kept), again, checks) =
                own.beside_fresh_process(&best, most_used, job.loss, &job.context, || {
                    self.judged(own, &job, made, stats, budget)
                });
            fit.stats.add_checks(checks);
            fit.phases = job.phases.borrow_mut().costs(&fit.stats);
            // A worker may have found it out by itself.
            let is_found_out = !is_apart && self.is_apart();
            let doubt = match again {
                Reproducibility::Random => Some(NOT_REPRODUCED),
                _ if is_found_out && job.context.is_over() => Some(NOT_ANEW),
                _ => None,
            };
            if doubt.is_some() || !is_found_out {
                let is_here = self.evaluator().remote.is_err() && self.fmu().has_hidden_state();
                let doubt = doubt.or(is_here.then_some(STATE_HERE));
                fit.setup_findings.extend(doubt.map(finding_about_fmu));
                if !job.is_part {
                    fit.note_end_before_minimum();
                }
                return Ok((fit, kept));
            }
            stats = fit.stats;
            log::warn!("{}: {HIDDEN_STATE}: the fit begins anew", self.fmu().description().model_name);
            job.begin_anew(run.clone(), wants_preflight);
        }
    }
}
