//! Sensitivity analysis of a calibration.

use super::quantities::{PointResults, Quantities, ValuesOf};
use crate::cost::split::Slots;
use crate::error::CalibrationError;
use crate::loaded::calibration::Calibration;
use crate::problem::parameter::{Parameter, Scale};
use base::RunContext;
use dfo::{
    Answer, Bounds, ByRef, Checkpoint, IntervalOptions, Objective, ParameterKind, Query, RobustLoss,
    Sensitivity, SensitivityDesign, SensitivityMethod, Termination,
};
use fmi::FmiError;
use ode::Stats;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Options of [`Calibration::sensitivity`].
#[derive(Debug, Clone)]
pub struct SensitivityOptions {
    /// Method with its numbers; default: Morris screening with 10 trajectories.
    pub method: SensitivityMethod,
    /// Confidence intervals.
    pub intervals: IntervalOptions,
    /// Seed of the random numbers. Default: drawn, and stored in the result; with a checkpoint 0, so that the
    /// points are the same when it is continued.
    pub seed: Option<u64>,
    /// Number of points that are simulated in parallel; default: all cores. The result does not depend on it.
    pub workers: Option<usize>,
    /// Limit of wall-clock time. The result then contains the effects from the completed trajectories or
    /// rows.
    pub max_time: Option<Duration>,
    /// File with the completed evaluations. An existing file of the same analysis is continued.
    pub checkpoint: Option<PathBuf>,
    /// Progress of the analysis, which the analysis updates. Each analysis starts again from 0.
    pub progress: Arc<SensitivityProgress>,
}

/// Progress of an analysis, for other threads and for functions that the analysis calls.
#[derive(Debug, Default)]
pub struct SensitivityProgress {
    n_evaluated: AtomicUsize,
    n_points: AtomicUsize,
}

impl SensitivityProgress {
    /// Returns the number of points evaluated so far, without those of a checkpoint.
    pub fn n_evaluated(&self) -> usize {
        self.n_evaluated.load(Ordering::Relaxed)
    }

    /// Returns the number of points of the analysis; 0 before it is known.
    pub fn n_points(&self) -> usize {
        self.n_points.load(Ordering::Relaxed)
    }
}

impl Default for SensitivityOptions {
    fn default() -> Self {
        Self {
            method: SensitivityMethod::MORRIS,
            intervals: IntervalOptions::default(),
            seed: None,
            workers: None,
            max_time: None,
            checkpoint: None,
            progress: Arc::default(),
        }
    }
}

/// The quantities of a calibration as an objective, whose residuals are their values.
struct Evaluated<'a> {
    calibration: &'a Calibration,
    values: ValuesOf<'a>,
    slots: Slots,
    progress: &'a SensitivityProgress,
}

impl Objective for Evaluated<'_> {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        let (slots, mut stats) = (Some(&self.slots), Stats::default());
        self.calibration.evaluate_counted(x, query, RobustLoss::default(), slots, answer, &mut stats);
        let criteria = self.calibration.take_criteria(&mut answer.residuals);
        answer.residuals = match answer.outcome.value() {
            Some(cost) => {
                let residuals = &answer.residuals;
                (self.values)(&PointResults { x, cost, residuals, criteria: &criteria })
            }
            None => Vec::new(),
        };
        self.progress.n_evaluated.fetch_add(1, Ordering::Relaxed);
    }

    fn has_residuals(&self) -> bool {
        true
    }

    fn uses_cutoff(&self) -> bool {
        false
    }
}

impl Calibration {
    /// Estimates the effect of each free parameter on the cost and on the RMS error of each output, over the
    /// whole box of the bounds: by Morris screening or Sobol' indices. For a design, the effects are those on
    /// the goals and the criteria of each scenario. Parameters vary independently and uniformly on their
    /// scale; constraints between them are ignored. Points whose simulation fails are left out and counted.
    ///
    /// If the context or the time limit ends the analysis, the result contains the effects from the completed
    /// trajectories or rows; see [`Sensitivity::n_missing`].
    ///
    /// ```
    /// use calibration::{Calibration, Data, Experiment, Parameter, RunContext, SensitivityOptions};
    /// let t = vec![0.0, 0.5, 1.0, 1.5];
    /// let x = t.iter().map(|t: &f64| (-2.0 * t).exp()).collect();
    /// let fmu = fmi::Fmu::open(example_models::example_fmu("dahlquist")?)?;
    /// let calibration = Calibration::builder(fmu)
    ///     .experiment(Experiment::new(Data::from_columns(t, [("x".to_owned(), x)])?).output("x", "x"))
    ///     .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
    ///     .build()?;
    /// let found = calibration.sensitivity(&SensitivityOptions::default(), &RunContext::new())?;
    /// assert_eq!((found.n_evaluations, found.outputs[1].name.as_str()), (10 * 2, "rms(x)"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// Returns an error if a free parameter has no finite bounds, if an option is out of range, or if fewer
    /// than two trajectories or rows are complete. Also returns an error if the file contains another
    /// analysis, or cannot be read or written. Returns [`CalibrationError::Cancelled`] if the context ends
    /// before two trajectories or rows are complete.
    pub fn sensitivity(
        &self,
        options: &SensitivityOptions,
        context: &RunContext<'_>,
    ) -> Result<Sensitivity, CalibrationError> {
        let quantities = match self.problem().goals.is_empty() {
            true => Quantities::misfit(self),
            false => Quantities::design(self),
        };
        self.sensitivity_of(quantities, options, context)
    }

    /// Estimates the effect of each free parameter on these quantities.
    fn sensitivity_of(
        &self,
        quantities: Quantities<'_>,
        options: &SensitivityOptions,
        context: &RunContext<'_>,
    ) -> Result<Sensitivity, CalibrationError> {
        let parameters = self.parameters();
        let ends = |side: fn(&Parameter) -> f64| parameters.iter().map(side).collect::<Vec<_>>();
        let scales: Vec<Scale> = parameters.iter().map(Parameter::scale_kind).collect();
        let kinds: Vec<ParameterKind> = parameters.iter().map(Parameter::value_kind).collect();
        let names: Vec<&str> = parameters.iter().map(Parameter::name).collect();
        let seed = options.seed.or_else(|| options.checkpoint.is_some().then_some(0));
        let design = Bounds::new(&ends(Parameter::lower), &ends(Parameter::upper))
            .and_then(|bounds| SensitivityDesign::new(bounds, &scales, &kinds, options.method, seed));
        let design = design.map_err(|error| self.name_parameter(error))?;
        options.intervals.check()?;
        self.prepare()?;
        let _held = self.hold();
        let workers = options.workers.unwrap_or_else(base::available_cores);
        let Quantities { names: quantity_names, values } = quantities;
        let progress = &*options.progress;
        progress.n_evaluated.store(0, Ordering::Relaxed);
        progress.n_points.store(design.points().len(), Ordering::Relaxed);
        let evaluated = Evaluated { calibration: self, values, slots: Slots::new(workers.max(1)), progress };
        let mut run = dfo::minimize(ByRef(&evaluated)).workers(workers).context(*context);
        if let Some(limit) = options.max_time {
            run = run.max_time(limit);
        }
        if let Some(path) = &options.checkpoint {
            run = run.checkpoint(self.tag(Checkpoint::new(path)));
        }
        let mut evaluations = design.evaluate(run)?;
        if let Termination::Aborted(message) = evaluations.termination.ended() {
            return Err(match self.evaluator().over.get() {
                Some(reported) => FmiError::ReportedError(Box::new(reported.clone())).into(),
                None => CalibrationError::Setup(message.clone()),
            });
        }
        if let Ok(remote) = &self.evaluator().remote {
            evaluations.failures.iter_mut().for_each(|(reason, _)| remote.explain_reason(reason));
        }
        design.analyze(&evaluations, &names, &quantity_names, options.intervals).map_err(|error| {
            let is_interrupted = *evaluations.termination.ended() == Termination::Interrupted;
            if is_interrupted { CalibrationError::Cancelled } else { error.into() }
        })
    }
}
