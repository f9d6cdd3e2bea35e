//! Options of a fit.

use super::noise::NoiseRule;
use super::simulation_executor::SimulationExecutor;
use crate::fit::live::LiveFit;
use crate::fit::phase::CurrentPhase;
use crate::problem::objective::CostKind;
use crate::uncertainty::result::{Estimator, UncertaintyOptions};
use base::RunContext;
use dfo::{
    AnyMethod, Loss, Progress, Record, RecordError, RequestedRun, RobustLoss, RunOptions, Search, StopRule,
    ToleranceMeasure, Tolerances, Value, field_names, read_part,
};
use serde::{Deserialize, Deserializer, Serialize};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fmt;
use std::ops::ControlFlow;
use std::rc::Rc;
use std::sync::Arc;

/// Called after each iteration; `Break` ends the fit.
pub type FitObserver<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;

/// Options of a fit.
pub struct FitOptions<'a> {
    /// The method, tolerances, limits, workers (default: all cores), checkpoint and so on. The time limit
    /// holds for the whole fit, from the search to the standard errors: where it is over before
    /// any evaluation has ended, the result is the start, with a cost of NaN. Model, data, parameters and
    /// settings of the calibration identify the fit's problem: a checkpoint of another one is refused, and
    /// points that are known from another one are evaluated again.
    pub run: RunOptions<AnyMethod>,
    /// Where to start; default: the parameters' start values.
    pub start: Option<Vec<f64>>,
    /// Parameters, by number, that stay at the start as if they were fixed; default: none.
    pub held: Vec<usize>,
    /// True to give up a simulation when its cost can no longer matter; default: true. Changes no decision,
    /// only the work.
    pub cutoffs: bool,
    /// Cost that is minimised; default: the sum of the squared residuals.
    pub objective: CostKind,
    /// Loss function: the contribution of a residual to the cost; default: its square. With another loss
    /// [`Fit::cost`](crate::Fit::cost) is the sum of these contributions, also where the method sees costs
    /// alone.
    pub loss: RobustLoss,
    /// Where the noise of the measurements is taken from, beside which [priors](crate::Prior) count; default:
    /// it is estimated with the parameters where there are priors and the weights do not state it. See
    /// [`EstimatedNoise`](crate::EstimatedNoise) for how: the search is made several times, each from where
    /// the last one ended, and the limits hold for all together. A checkpoint has a file for each:
    /// `fit.ckpt`, `fit.ckpt.round2` and so on.
    pub noise: NoiseRule,
    /// The start is looked at first, see [`Calibration::preflight`](crate::Calibration::preflight); `f_tol`
    /// below the noise of the simulations is raised to it, with a word in the message. Default: no.
    pub preflight: bool,
    /// Options of the uncertainty, which is estimated after the run: standard errors, correlation, parameters
    /// that the data do not determine. Takes at least two simulations for each parameter and one that is more
    /// accurate, in parallel; they are none of the run's evaluations, are not made after an interrupt or when
    /// the time is up, and are part of `stats`. `None`: it is not estimated. Its loss is that of the fit.
    pub uncertainty: Option<UncertaintyOptions>,
    /// Called after each iteration, on the calling thread.
    pub observer: Option<Box<FitObserver<'a>>>,
    /// Who may interrupt the fit: within a step of the simulations that are running. Its function is called
    /// on the calling thread at least every 50 ms. The time limit is that of [`run`](Self::run), or of the
    /// context, if that ends sooner.
    pub context: RunContext<'a>,
    /// Who makes the simulations of the search; default: workers of this machine, as many as
    /// [`run`](Self::run) says. What comes before and after the search is simulated here.
    pub engine: Option<Rc<RefCell<dyn SimulationExecutor>>>,
    /// Where the fit says what it does.
    pub phase: Arc<CurrentPhase>,
    /// Where the search keeps what others see of it while it runs; default: nowhere.
    pub live: Option<Arc<LiveFit>>,
}

impl FitOptions<'_> {
    /// The run of a fit by default: the method for residuals that [`AnyMethod::chosen_for`] chooses,
    /// tolerances of 1e-4 each, `x_tol` in units of the parameters' sizes and `f_tol` as a fraction of the
    /// cost, for a cost made of simulations is seldom smooth below that; all else as [`dfo::minimize`] has
    /// it.
    pub fn default_run() -> RunOptions<AnyMethod> {
        let tolerances =
            Tolerances { x_tol: 1e-4, f_tol: 1e-4, measure: ToleranceMeasure::Relative, stop: StopRule::All };
        RunOptions { method: AnyMethod::auto(Search::Local), tolerances, ..RunOptions::default() }
    }
}

impl FitOptions<'_> {
    /// The names of all options that a record of a fit may have.
    ///
    /// # Errors
    /// The options of a method cannot be serialised.
    pub fn option_names() -> Result<BTreeSet<String>, dfo::Error> {
        let mut names = RequestedRun::option_names()?;
        names.extend(field_names::<FitRecord>()?);
        Ok(names)
    }

    /// A fit of `n` parameters as a record asks for it: the options of a [`FitRecord`], and those of its run.
    /// What it does not say is as by default.
    ///
    /// # Errors
    /// An option that there is not, or a value that it cannot have.
    pub fn from_record(record: Record, n: usize) -> Result<Self, dfo::Error> {
        let (own, of_run) = read_part::<FitRecord>(record, "option of a fit")?;
        let mut options = Self {
            loss: RobustLoss::named(own.loss, own.f_scale)?.unwrap_or_default(),
            noise: own.noise,
            preflight: own.preflight,
            ..Self::default()
        };
        if let Some(name) = own.objective {
            let asked = name.to_ascii_lowercase().replace('_', "-");
            options.objective = CostKind::of_name(&asked).ok_or_else(|| {
                let known: Vec<CostKind> = CostKind::named().collect();
                let known: Vec<&str> = known.iter().map(CostKind::name).collect();
                RecordError::unknown("objective", &name, &known)
            })?;
        }
        if let Some(covariance) = own.covariance {
            options.uncertainty =
                covariance.map(|estimator| UncertaintyOptions { estimator, ..UncertaintyOptions::default() });
        }
        options.run = RequestedRun::new(options.run, &of_run, n)?.options;
        Ok(options)
    }

    /// The record that asks for these options, as [`from_record`](Self::from_record) reads it: with all that
    /// holds, also by default. A function of the user's as the objective has its name there.
    ///
    /// # Errors
    /// The options of the method cannot be serialised.
    pub fn record(&self) -> Result<Record, dfo::Error> {
        let own = FitRecord {
            objective: Some(self.objective.name().to_owned()),
            loss: Some(self.loss.kind()),
            f_scale: (!self.loss.is_linear()).then(|| self.loss.scale()),
            noise: self.noise,
            preflight: self.preflight,
            covariance: Some(self.uncertainty.as_ref().map(|uncertainty| uncertainty.estimator)),
        };
        let mut record = RequestedRun::record(&self.run)?;
        if let Value::Record(own) = Value::of(&own)? {
            // Without an estimator there is no uncertainty, which is not the default.
            let said = |name: &str, value: &Value| name == "covariance" || *value != Value::Nothing;
            record.extend(own.into_iter().filter(|(name, value)| said(name, value)));
        }
        Ok(record)
    }
}

/// The options of a fit by name, beside those of its run.
#[derive(Debug, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct FitRecord {
    /// Cost that is minimised.
    #[cfg_attr(feature = "schema", schemars(schema_with = "crate::problem::schema::objective"))]
    objective: Option<String>,
    /// Loss function: the contribution of a residual to the cost.
    loss: Option<Loss>,
    /// Size of the residuals from which on the loss differs from the square.
    #[cfg_attr(feature = "schema", schemars(extend("exclusiveMinimum" = 0)))]
    f_scale: Option<f64>,
    /// Where the noise of the measurements is taken from.
    noise: NoiseRule,
    /// The start is looked at first.
    preflight: bool,
    /// Estimator of the covariance; none: the uncertainty is not estimated.
    #[serde(deserialize_with = "said")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Estimator>"))]
    covariance: Option<Option<Estimator>>,
}

/// A value that is said, `None` too.
fn said<'de, T: Deserialize<'de>, D: Deserializer<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
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
