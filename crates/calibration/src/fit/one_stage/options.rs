//! Options of a fit.

use super::noise::NoiseRule;
use super::simulation_executor::SimulationExecutor;
use crate::fit::live::LiveFit;
use crate::fit::phase::CurrentPhase;
use crate::problem::objective::CostKind;
use crate::uncertainty::result::{Estimator, UncertaintyOptions};
use base::RunContext;
use dfo::{
    AnyMethod, Loss, Nsga2, Progress, Record, RecordError, RequestedRun, RobustLoss, RunOptions, Search,
    StopRule, ToleranceMeasure, Tolerances, Value, field_names, read_part,
};
use serde::{Deserialize, Deserializer, Serialize};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fmt;
use std::ops::ControlFlow;
use std::rc::Rc;
use std::sync::Arc;

/// Called after each iteration. `Break` ends the fit.
pub type FitObserver<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;

/// Options of a fit.
pub struct FitOptions<'a> {
    /// Method, tolerances, limits, workers (default: all cores), checkpoint and other options of the
    /// optimiser.
    ///
    /// The time limit applies to the whole fit, from the search to the standard errors. If it expires before
    /// the end of the first evaluation, the result is the start with a cost of NaN.
    ///
    /// Model, data, parameters and settings of the calibration identify the problem of the fit. A checkpoint
    /// of another problem is rejected, and known points of another problem are evaluated again.
    pub run: RunOptions<AnyMethod>,
    /// Start point; default: the start values of the parameters.
    pub start: Option<Vec<f64>>,
    /// Indices of parameters to fix at the start; default: none.
    pub held: Vec<usize>,
    /// True to stop a simulation when its cost can no longer matter; default: true. This reduces the work but
    /// does not change any decision.
    pub cutoffs: bool,
    /// Cost to minimise; default: the sum of the squared residuals.
    pub objective: CostKind,
    /// Loss function, which maps a residual to its contribution to the cost; default: the square. With
    /// another loss, [`Fit::cost`](crate::Fit::cost) is the sum of these contributions, even if the method
    /// uses only costs.
    pub loss: RobustLoss,
    /// Source of the noise of the measurements, which determines the weight of the [priors](crate::Prior).
    /// Default: the noise is estimated with the parameters if there are priors and the weights do not state
    /// it.
    ///
    /// [`EstimatedNoise`](crate::EstimatedNoise) describes the estimate. It requires several searches, each
    /// from the result of the previous one. The limits apply to all searches together. A checkpoint has one
    /// file for each search: `fit.ckpt`, `fit.ckpt.round2` and so on.
    pub noise: NoiseRule,
    /// True to check the start before the search, see
    /// [`Calibration::preflight`](crate::Calibration::preflight). An `f_tol` below the noise of the
    /// simulations is raised to this noise, and a finding reports the change. Default: false.
    pub preflight: bool,
    /// Options of the uncertainty, which is estimated after the run: standard errors, correlation, and
    /// parameters that the data do not determine. `None` skips the estimate. The loss of these options is
    /// replaced by the loss of the fit.
    ///
    /// The estimate requires at least two simulations for each parameter and one more accurate simulation,
    /// all in parallel. They do not count as evaluations of the run but are part of `stats`. They are skipped
    /// after an interrupt or when the time limit has expired.
    pub uncertainty: Option<UncertaintyOptions>,
    /// Called after each iteration, on the calling thread.
    pub observer: Option<Box<FitObserver<'a>>>,
    /// Context that can interrupt the fit, within one step of the running simulations. Its function is called
    /// on the calling thread at least every 50 ms. The fit uses the time limit of [`run`](Self::run) or of
    /// the context, whichever ends sooner.
    pub context: RunContext<'a>,
    /// Executor of the simulations of the search. Default: workers on this machine, with the number of
    /// workers of [`run`](Self::run). Simulations before and after the search always run on this machine.
    pub engine: Option<Rc<RefCell<dyn SimulationExecutor>>>,
    /// Current phase of the fit, which the fit updates.
    pub phase: Arc<CurrentPhase>,
    /// Shared state of the running search for other threads; default: none.
    pub live: Option<Arc<LiveFit>>,
}

impl FitOptions<'_> {
    /// Returns the default run of a fit. [`AnyMethod::chosen_for`] chooses a method for residuals. Both
    /// tolerances are 1e-4, because the cost of simulations is seldom smooth below that. `x_tol` is in units
    /// of the sizes of the parameters, and `f_tol` is a fraction of the cost. The other options are the
    /// defaults of [`dfo::minimize`].
    pub fn default_run() -> RunOptions<AnyMethod> {
        let tolerances =
            Tolerances { x_tol: 1e-4, f_tol: 1e-4, measure: ToleranceMeasure::Relative, stop: StopRule::All };
        RunOptions { method: AnyMethod::auto(Search::Local), tolerances, ..RunOptions::default() }
    }
}

impl FitOptions<'_> {
    /// Returns the names of all options that a record of a fit may contain.
    ///
    /// # Errors
    /// Returns an error if the options of a method cannot be serialised.
    pub fn option_names() -> Result<BTreeSet<String>, dfo::Error> {
        let mut names = RequestedRun::option_names()?;
        names.extend(field_names::<FitRecord>()?);
        Ok(names)
    }

    /// Creates the options of a fit of `n` parameters from a record, which contains the options of a
    /// [`FitRecord`] and of the run. Missing options have their default values.
    ///
    /// # Errors
    /// Returns an error if an option does not exist or its value is invalid.
    pub fn from_record(record: Record, n: usize) -> Result<Self, dfo::Error> {
        Self::from_record_or(record, n, Self::default_run())
    }

    /// Creates the options of a search for a Pareto front of `n` parameters from a record without a method,
    /// see [`from_record`](Self::from_record). The record may contain the options of [`dfo::Nsga2`].
    ///
    /// # Errors
    /// Returns an error if an option does not exist or its value is invalid.
    pub fn of_front(record: Record, n: usize) -> Result<Self, dfo::Error> {
        let run = RunOptions { method: Nsga2::default().into(), ..Self::default_run() };
        Self::from_record_or(record, n, run)
    }

    fn from_record_or(record: Record, n: usize, run: RunOptions<AnyMethod>) -> Result<Self, dfo::Error> {
        let (of_fit, of_run) = read_part::<FitRecord>(record, "option of a fit")?;
        let mut options = Self {
            loss: RobustLoss::named(of_fit.loss, of_fit.f_scale)?.unwrap_or_default(),
            noise: of_fit.noise,
            preflight: of_fit.preflight,
            run,
            ..Self::default()
        };
        if let Some(name) = of_fit.objective {
            let requested = name.to_ascii_lowercase().replace('_', "-");
            options.objective = CostKind::of_name(&requested).ok_or_else(|| {
                let available: Vec<CostKind> = CostKind::named().collect();
                let available: Vec<&str> = available.iter().map(CostKind::name).collect();
                RecordError::unknown("objective", &name, &available)
            })?;
        }
        if let Some(covariance) = of_fit.covariance {
            options.uncertainty =
                covariance.map(|estimator| UncertaintyOptions { estimator, ..UncertaintyOptions::default() });
        }
        options.run = RequestedRun::new(options.run, &of_run, n)?.options;
        Ok(options)
    }

    /// Returns the record of these options, which [`from_record`](Self::from_record) can read. The record
    /// also contains the default values. A user-defined objective appears with its name.
    ///
    /// # Errors
    /// Returns an error if the options of the method cannot be serialised.
    pub fn record(&self) -> Result<Record, dfo::Error> {
        let of_fit = FitRecord {
            // The goals are part of the problem.
            objective: (!matches!(self.objective, CostKind::Goals)).then(|| self.objective.name().to_owned()),
            loss: Some(self.loss.kind()),
            f_scale: (!self.loss.is_linear()).then(|| self.loss.scale()),
            noise: self.noise,
            preflight: self.preflight,
            covariance: Some(self.uncertainty.as_ref().map(|uncertainty| uncertainty.estimator)),
        };
        let mut record = RequestedRun::record(&self.run)?;
        if let Value::Record(of_fit) = Value::of(&of_fit)? {
            // "No estimator" skips the uncertainty, which is not the default.
            let is_listed = |name: &str, value: &Value| name == "covariance" || *value != Value::Nothing;
            record.extend(of_fit.into_iter().filter(|(name, value)| is_listed(name, value)));
        }
        Ok(record)
    }
}

/// Options of a fit by name, without the options of its run.
#[derive(Debug, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct FitRecord {
    /// Cost to minimise.
    #[cfg_attr(feature = "schema", schemars(schema_with = "crate::problem::schema::objective"))]
    objective: Option<String>,
    /// Loss function, which maps a residual to its contribution to the cost.
    loss: Option<Loss>,
    /// Size of a residual above which the loss differs from the square.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    f_scale: Option<f64>,
    /// Source of the noise of the measurements.
    noise: NoiseRule,
    /// True to check the start before the search.
    preflight: bool,
    /// Estimator of the covariance. If null, the uncertainty is not estimated.
    #[serde(deserialize_with = "present")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Estimator>"))]
    covariance: Option<Option<Estimator>>,
}

/// Deserializes a value that is present, even if it is `None`.
fn present<'de, T: Deserialize<'de>, D: Deserializer<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}

impl Default for FitOptions<'_> {
    fn default() -> Self {
        Self {
            run: Self::default_run(),
            start: None,
            held: Vec::new(),
            cutoffs: true,
            objective: CostKind::default(),
            loss: RobustLoss::default(),
            noise: NoiseRule::default(),
            preflight: false,
            uncertainty: Some(UncertaintyOptions::default()),
            observer: None,
            context: RunContext::new(),
            engine: None,
            phase: Arc::default(),
            live: None,
        }
    }
}

impl<'a> From<RunOptions<AnyMethod>> for FitOptions<'a> {
    fn from(run: RunOptions<AnyMethod>) -> Self {
        Self { run, ..Self::default() }
    }
}

impl fmt::Debug for FitOptions<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FitOptions")
            .field("run", &self.run)
            .field("start", &self.start)
            .finish_non_exhaustive()
    }
}
