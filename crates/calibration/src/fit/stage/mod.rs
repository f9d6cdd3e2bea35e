//! The fit: what is asked for, the search, and the uncertainty of its result; parameters with names come out.

mod engine;
mod fresh;
mod judge;
mod noise;
mod options;
mod result;
mod rounds;
mod search;
mod tolerance;

pub use engine::Engine;
pub use noise::{EstimatedNoise, FitNoise, NoiseRule, OutputNoise};
pub use options::{FitObserver, FitOptions};
pub use result::Fit;
pub(crate) use rounds::{add_earlier, checkpoint_of, ended_by};
pub use tolerance::ChosenTolerance;

use crate::cost::calibration::Calibration;
use crate::error::CalibrationError;
use crate::fit::output_fit::KeptResiduals;
use base::RunContext;
use ode::Stats;
pub(crate) use rounds::Made;
pub(crate) use search::{Job, Searched, Spent};

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
        let mut job = Job::new(self, options, within)?;
        self.choose_method(&mut job.run, &job.held, &job.objective)?;
        let mut stats = Stats::default();
        let made = match self.made(&mut job, &mut stats) {
            Err(error) if !job.context.is_cancelled() => Made::of(self.start_alone(&job, error)?),
            made => made?,
        };
        Ok(self.judged(&job, made, stats))
    }
}
