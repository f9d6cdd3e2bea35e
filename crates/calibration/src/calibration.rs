//! Experiments and parameters become an objective: cost, residuals, cutoff.

use crate::data::Data;
use crate::error::CalibrationError;
use crate::experiment::{Experiment, SimulationSettings};
use crate::identity::identity;
use crate::parameter::Parameter;
use crate::residual::{Accumulator, Comparison, Stop};
use crate::solver::Choice;
use crate::spot_checks::is_failed_by_history;
use crate::warning::{SETUP_LOG_TARGET, SetupWarning, held_inputs, ignored_nominals, unused_columns};
use dfo::{Answer, Failure, FailureKind, Objective, Outcome, Query, Want};
use fmi::platform::without_private_folders;
use fmi::{FmiError, Fmu, Pool, SimulateOptions, SimulationPlan, Trajectory};
use ode::{ErrorKind, Method, Number, Observer, Report, Stats, Termination};
use std::ops::ControlFlow;
use std::sync::Arc;

/// A model, recordings and parameters, checked and ready to be evaluated from any number of threads.
///
/// The cost is the sum of the squared (weighted) residuals, simulated minus measured, over all experiments, outputs and
/// measured times: no 1/N, no 1/2. It is added up in one fixed order while the simulation runs, so the same parameters
/// give the same bits on every worker. Where no integration method is named, the [`solver`](Self::solver) is found once, by
/// a race at the parameters' start values, and used for everything: a cost is the same function in a fit and outside.
#[derive(Debug)]
pub struct Calibration {
    fmu: Fmu,
    parameters: Vec<Parameter>,
    experiments: Vec<Prepared>,
    n_residuals: usize,
    warnings: Vec<SetupWarning>,
    /// The method that the settings name.
    method: Method,
    choice: Choice,
    /// What a fit is made from, by name and in words or as a hash.
    identity: Vec<(String, String)>,
}

/// An experiment with everything looked up.
#[derive(Debug)]
struct Prepared {
    pool: Pool,
    comparison: Comparison,
    options: SimulateOptions,
    data: Data,
    outputs: Vec<(String, String)>,
}

/// Collects what a [`Calibration`] is made of.
///
/// ```
/// use calibration::{Calibration, Data, Experiment, FitOptions, Parameter};
/// // x' = -k x, recorded at four instants of a decay with k = 2
/// let t = vec![0.0, 0.5, 1.0, 1.5];
/// let x = t.iter().map(|t: &f64| (-2.0 * t).exp()).collect();
/// let fmu = fmi::Fmu::open(example_models::example_fmu("dahlquist")?)?;
/// let calibration = Calibration::builder(fmu)
///     .experiment(Experiment::new(Data::from_columns(t, [("x".to_owned(), x)])?).output("x", "x"))
///     .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
///     .build()?;
/// let fit = calibration.fit(FitOptions::default())?;
/// assert!((fit.x[0] - 2.0).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct CalibrationBuilder {
    fmu: Fmu,
    experiments: Vec<Experiment>,
    parameters: Vec<Parameter>,
    settings: SimulationSettings,
}

/// Why there is no cost at a point.
pub(crate) enum NoCost {
    /// The partial sum is strictly above the cutoff.
    Above,
    /// The run is being ended.
    Cancelled,
    /// No simulation can be made any more, here or at other points.
    Over(Box<FmiError>),
    /// The simulation failed: its kind, a reason that is the same for all failures of that sort, and the error in full.
    Failed { kind: FailureKind, reason: String, source: Option<Box<FmiError>> },
}

impl CalibrationBuilder {
    /// Adds a recording. The cost is the sum over all of them, in the order of these calls.
    #[must_use]
    pub fn experiment(mut self, experiment: Experiment) -> Self {
        self.experiments.push(experiment);
        self
    }

    /// Adds a parameter. Vectors of parameter values follow the order of these calls.
    #[must_use]
    pub fn parameter(mut self, parameter: Parameter) -> Self {
        self.parameters.push(parameter);
        self
    }

    /// How simulations are made.
    #[must_use]
    pub fn settings(mut self, settings: SimulationSettings) -> Self {
        self.settings = settings;
        self
    }

    /// Looks everything up and checks it; loads the model, but simulates nothing yet.
    ///
    /// # Errors
    /// Anything that does not fit: unknown names (the nearest are offered), parameters that cannot be set, bounds, data.
    pub fn build(self) -> Result<Calibration, CalibrationError> {
        let Self { fmu, experiments, parameters, settings } = self;
        if parameters.is_empty() {
            return Err(CalibrationError::Setup("there is no parameter to fit".to_owned()));
        }
        if experiments.is_empty() {
            return Err(CalibrationError::Setup("there is no experiment to fit to".to_owned()));
        }
        for (i, parameter) in parameters.iter().enumerate() {
            parameter.check()?;
            if parameters[..i].iter().any(|p| p.name() == parameter.name()) {
                let name = parameter.name().to_owned();
                return Err(CalibrationError::Parameter { name, message: "is given twice".to_owned() });
            }
        }
        let mut warnings = Vec::new();
        for experiment in &experiments {
            experiment.check_start_values(fmu.description(), &parameters)?;
            warnings.extend(unused_columns(fmu.description(), experiment));
        }
        warnings.extend(ignored_nominals(&parameters));
        let identity = identity(&fmu, &experiments, &parameters, &settings)?;
        let start: Vec<f64> = parameters.iter().map(Parameter::start).collect();
        let names: Vec<String> = parameters.iter().map(|p| p.name().to_owned()).collect();
        let experiments = experiments
            .into_iter()
            .map(|e| Prepared::new(&fmu, e, (&names, &start), &settings, &mut warnings))
            .collect::<Result<Vec<_>, _>>()?;
        for warning in &warnings {
            log::warn!(target: SETUP_LOG_TARGET, "{warning}");
        }
        let n_residuals = experiments.iter().map(|e| e.comparison.n_residuals()).sum();
        let (method, choice) = (settings.method, Choice::default());
        Ok(Calibration { fmu, parameters, experiments, n_residuals, warnings, method, choice, identity })
    }
}

impl Prepared {
    fn new(
        fmu: &Fmu,
        experiment: Experiment,
        (parameters, start): (&[String], &[f64]),
        settings: &SimulationSettings,
        warnings: &mut Vec<SetupWarning>,
    ) -> Result<Self, CalibrationError> {
        let (times, columns) = experiment.measurements()?;
        let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let weights: Vec<f64> = experiment.outputs.iter().map(|o| o.weight).collect();
        let (times, comparison) = Comparison::new(&times, &columns, &weights);
        let start_time =
            experiment.start_time.or(fmu.description().default_experiment.start_time).unwrap_or(0.0);
        let rounding = 100.0 * f64::EPSILON / 2.0 * start_time.abs().max(times[times.len() - 1].abs());
        if times[0] < start_time - rounding {
            let [first, start] = [times[0], start_time].map(Number);
            return Err(CalibrationError::Setup(format!(
                "{}: the first measurement is at {first} s, before the simulation starts at {start} s; give \
                 start_time = {first}, or a window that begins later",
                experiment.data.source()
            )));
        }
        experiment.check_begin(start_time)?;
        warnings.extend(held_inputs(&experiment, (start_time, times[times.len() - 1])));
        let options = SimulateOptions {
            start_time: Some(start_time),
            final_time: times.last().copied(),
            times: Some(times),
            start_values: experiment.start_values.clone(),
            parameters: parameters.to_vec(),
            outputs: Some(experiment.outputs.iter().map(|o| o.variable.clone()).collect()),
            inputs: experiment.input_table()?,
            relative_tolerance: settings.relative_tolerance,
            kind: settings.kind,
            method: settings.method,
            step_size: settings.step_size,
            max_step: settings.max_step,
            timeout: settings.timeout,
            chattering: settings.chattering,
            input_derivatives: settings.input_derivatives,
            sharing: settings.sharing,
            ..SimulateOptions::default()
        };
        let plan = SimulationPlan::new(fmu, &options)?;
        plan.require_single_numbers()?;
        experiment.check_outputs(fmu.description(), parameters)?;
        let ignored = options.without_effect(plan.kind()).into_iter().map(SetupWarning::NoEffect);
        warnings.extend(ignored.filter(|warning| !warnings.contains(warning)).collect::<Vec<_>>());
        let pool = Pool::with_reference(Arc::new(plan), start)?;
        let outputs = experiment.outputs.into_iter().map(|o| (o.variable, o.column)).collect();
        Ok(Self { pool, comparison, options, data: experiment.data, outputs })
    }
}

impl Calibration {
    /// Starts to describe a calibration of this model.
    pub fn builder(fmu: Fmu) -> CalibrationBuilder {
        CalibrationBuilder {
            fmu,
            experiments: Vec::new(),
            parameters: Vec::new(),
            settings: SimulationSettings::default(),
        }
    }

    /// What tells this calibration from others, by name.
    pub(crate) fn identity(&self) -> &[(String, String)] {
        &self.identity
    }

    pub(crate) fn choice(&self) -> &Choice {
        &self.choice
    }

    pub(crate) fn method_of_settings(&self) -> Method {
        self.method
    }

    pub(crate) fn pool_of_settings(&self, experiment: usize) -> &Pool {
        &self.experiments[experiment].pool
    }

    /// How the experiments are simulated, but for the choice of the method.
    pub(crate) fn all_options(&self) -> impl Iterator<Item = &SimulateOptions> {
        self.experiments.iter().map(|e| &e.options)
    }

    /// The model.
    pub fn fmu(&self) -> &Fmu {
        &self.fmu
    }

    /// What may not be meant as it was given: columns that nobody uses, inputs that are held. Each was logged once, when
    /// the calibration was built.
    pub fn warnings(&self) -> &[SetupWarning] {
        &self.warnings
    }

    /// The parameters, in the order of every vector of values.
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    /// Length of the residual vector.
    pub fn n_residuals(&self) -> usize {
        self.n_residuals
    }

    /// Per experiment: the recording, and which output was compared with which of its columns.
    pub fn comparisons(&self) -> impl Iterator<Item = (&Data, &[(String, String)])> {
        self.experiments.iter().map(|e| (&e.data, e.outputs.as_slice()))
    }

    /// Start values of all parameters.
    pub fn start(&self) -> Vec<f64> {
        self.parameters.iter().map(Parameter::start).collect()
    }

    /// The cost at `x` (one value per parameter, user's units).
    ///
    /// # Errors
    /// The wrong number of values, or a simulation that failed: then the error says where and why.
    pub fn cost(&self, x: &[f64]) -> Result<f64, CalibrationError> {
        self.cost_until(x, &|| false)
    }

    /// As [`cost`](Self::cost); `cancelled` is asked before every step of the simulation, which ends when it says so.
    ///
    /// # Errors
    /// As [`cost`](Self::cost), and [`CalibrationError::Cancelled`].
    pub fn cost_until(&self, x: &[f64], cancelled: &dyn Fn() -> bool) -> Result<f64, CalibrationError> {
        self.evaluate_fully(x, cancelled, None)
    }

    /// The residuals at `x`, simulated minus measured times weight: experiment by experiment, output by output, in the
    /// order of time, without the missing ones. The length is the same for every `x`.
    ///
    /// # Errors
    /// As [`cost`](Self::cost).
    pub fn residuals(&self, x: &[f64]) -> Result<Vec<f64>, CalibrationError> {
        self.residuals_until(x, &|| false)
    }

    /// As [`residuals`](Self::residuals), ended as [`cost_until`](Self::cost_until).
    ///
    /// # Errors
    /// As [`cost`](Self::cost), and [`CalibrationError::Cancelled`].
    pub fn residuals_until(
        &self,
        x: &[f64],
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Vec<f64>, CalibrationError> {
        let mut out = vec![0.0; self.n_residuals];
        self.evaluate_fully(x, cancelled, Some(&mut out))?;
        Ok(out)
    }

    /// Simulates every experiment at `x` and keeps the trajectories of the compared outputs, at the measured times or,
    /// if `times` are given, at those.
    ///
    /// # Errors
    /// As [`cost`](Self::cost).
    pub fn simulate(&self, x: &[f64], times: Option<&[f64]>) -> Result<Vec<Trajectory>, CalibrationError> {
        self.simulate_until(x, times, &|| false)
    }

    /// As [`simulate`](Self::simulate), ended as [`cost_until`](Self::cost_until).
    ///
    /// # Errors
    /// As [`cost`](Self::cost), and [`CalibrationError::Cancelled`].
    pub fn simulate_until(
        &self,
        x: &[f64],
        times: Option<&[f64]>,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Vec<Trajectory>, CalibrationError> {
        self.check_length(x)?;
        let method = self.solver_until(cancelled)?.method;
        let mut poll = || if cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let at = |e: &Prepared| {
            let mut options = e.options.clone();
            options.method = method;
            options.parameters.clear();
            let values = self.parameters.iter().zip(x).map(|(p, v)| (p.name().to_owned(), (*v).into()));
            options.start_values.extend(values);
            if let Some(times) = times {
                options.times = Some(times.to_vec());
                options.final_time = times.last().copied();
            }
            let trajectory = self.fmu.simulate_with(&options, &mut poll)?;
            match trajectory.termination {
                Termination::StoppedByObserver => Err(CalibrationError::Cancelled),
                _ => Ok(trajectory),
            }
        };
        self.experiments.iter().map(at).collect()
    }

    /// Has the model tested before its first use (once per process): how instances are reused, and whether several can be
    /// used at once.
    pub(crate) fn prepare(&self) -> Result<(), CalibrationError> {
        for k in 0..self.experiments.len() {
            if let Ok(pool) = self.pool(k, &|| false) {
                pool.is_concurrent()?;
            }
        }
        Ok(())
    }

    /// How often simulations of the model were found to depend on earlier ones.
    pub(crate) fn n_history_findings(&self) -> u64 {
        self.fmu.n_history_findings(self.pool_of_settings(0).plan().kind())
    }

    /// Whether the simulations at `x` are found to depend on earlier ones: each is made in all copies of the library that a fit has
    /// used, and in new ones.
    pub(crate) fn depends_on_history(&self, x: &[f64], cancelled: &dyn Fn() -> bool) -> bool {
        let found = |k: usize| self.pool(k, cancelled).map(|pool| pool.depends_on_history(x, cancelled));
        // A run that fails here, after it has not before, depends on something else than its parameters.
        (0..self.experiments.len()).any(|k| matches!(found(k), Ok(Ok(true))))
    }

    pub(crate) fn check_length(&self, x: &[f64]) -> Result<(), CalibrationError> {
        if x.len() == self.parameters.len() {
            return Ok(());
        }
        let names = self.parameters.iter().map(Parameter::name).collect::<Vec<_>>().join(", ");
        Err(CalibrationError::Length { got: x.len(), expected: self.parameters.len(), names })
    }

    fn evaluate_fully(
        &self,
        x: &[f64],
        cancelled: &dyn Fn() -> bool,
        out: Option<&mut [f64]>,
    ) -> Result<f64, CalibrationError> {
        self.check_length(x)?;
        self.evaluate_into(x, (f64::INFINITY, cancelled), out, &mut Stats::default()).map_err(|no_cost| {
            let at = self.describe(x);
            match no_cost {
                NoCost::Failed { reason, source, .. } => {
                    let message = source.as_ref().map_or(reason, |e| e.to_string());
                    CalibrationError::Simulation { at, message, source }
                }
                NoCost::Above => {
                    CalibrationError::Simulation { at, message: "infinite cost".to_owned(), source: None }
                }
                NoCost::Over(error) => CalibrationError::Model(*error),
                NoCost::Cancelled => CalibrationError::Cancelled,
            }
        })
    }

    fn describe(&self, x: &[f64]) -> String {
        let pairs: Vec<String> =
            self.parameters.iter().zip(x).map(|(p, v)| format!("{} = {}", p.name(), Number(*v))).collect();
        pairs.join(", ")
    }

    /// The answer to a query, what it took added to `stats`. Its work is counted in right-hand sides.
    pub(crate) fn evaluate_counted(
        &self,
        x: &[f64],
        query: &Query<'_>,
        answer: &mut Answer,
        stats: &mut Stats,
    ) {
        let out = (query.want == Want::Residuals).then(|| {
            answer.residuals.resize(self.n_residuals, 0.0);
            &mut answer.residuals[..]
        });
        let before = stats.right_hand_sides;
        answer.outcome = match self.evaluate_into(x, (query.cutoff, &|| query.cancelled()), out, stats) {
            Ok(cost) => Outcome::Value(cost),
            Err(NoCost::Above) => Outcome::Above(query.cutoff),
            Err(NoCost::Cancelled) => Outcome::cancelled(),
            Err(NoCost::Over(error)) => Outcome::Abort(error.to_string()),
            Err(NoCost::Failed { kind, reason, .. }) => Outcome::Failed(Failure { kind, message: reason }),
        };
        answer.work = stats.right_hand_sides - before;
    }

    /// The cost, the residuals into `out`, and what the simulations took added to `stats` (of those that could not even be
    /// started nothing). Ends above the cutoff, and when it is cancelled.
    pub(crate) fn evaluate_into(
        &self,
        x: &[f64],
        ends: (f64, &dyn Fn() -> bool),
        mut out: Option<&mut [f64]>,
        stats: &mut Stats,
    ) -> Result<f64, NoCost> {
        loop {
            let cost = self.evaluate_by(ends, out.as_deref_mut(), stats, |k, observer| {
                let pool = self.pool(k, ends.1)?;
                Ok(pool.lend().and_then(|mut simulator| simulator.run(x, observer)))
            });
            if !is_failed_by_history(&cost) {
                return cost;
            }
        }
    }

    /// The same with the simulation of each experiment made by `run`.
    pub(crate) fn evaluate_by(
        &self,
        ends: (f64, &dyn Fn() -> bool),
        mut out: Option<&mut [f64]>,
        stats: &mut Stats,
        mut run: impl FnMut(usize, &mut dyn Observer) -> Result<Result<Report, FmiError>, NoCost>,
    ) -> Result<f64, NoCost> {
        let mut sum = 0.0;
        let mut place = 0;
        for (k, experiment) in self.experiments.iter().enumerate() {
            let comparison = &experiment.comparison;
            let end = place + comparison.n_residuals();
            let part = out.as_deref_mut().map(|out| &mut out[place..end]);
            place = end;
            let mut accumulator = Accumulator::new(comparison, ends, sum, part);
            let ran = run(k, &mut accumulator)?;
            match &ran {
                Ok(report) => *stats += report.stats,
                Err(FmiError::Simulation(error)) => *stats += error.stats,
                Err(_) => {}
            }
            match accumulator.stop {
                Some(Stop::AboveCutoff) => return Err(NoCost::Above),
                Some(Stop::Cancelled) => return Err(NoCost::Cancelled),
                Some(Stop::NotFinite(output)) => {
                    let name = &experiment.outputs[output].0;
                    let reason = format!("the residual of '{name}' is not finite");
                    return Err(NoCost::Failed { kind: FailureKind::NotFinite, reason, source: None });
                }
                None => {}
            }
            let report = ran.map_err(no_cost)?;
            if !accumulator.complete() {
                let reason = format!(
                    "the model ended the simulation before the last measurement, at t = {}",
                    Number(report.time)
                );
                return Err(NoCost::Failed { kind: FailureKind::Error, reason, source: None });
            }
            sum = accumulator.sum;
        }
        Ok(sum)
    }
}

impl Objective for Calibration {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        self.evaluate_counted(x, query, answer, &mut Stats::default());
    }

    fn has_residuals(&self) -> bool {
        true
    }
}

/// Sorts a failed simulation: its kind, and a reason that is the same for all failures of that sort.
pub(crate) fn no_cost(error: FmiError) -> NoCost {
    if matches!(error, FmiError::NoCopy { .. }) {
        return NoCost::Over(Box::new(error));
    }
    let mut kind = FailureKind::Error;
    let reason = match &error {
        FmiError::Simulation(e) => match &e.kind {
            ErrorKind::Cancelled => return NoCost::Cancelled,
            ErrorKind::Model(inner) => inner.downcast_ref().map_or_else(|| inner.to_string(), call_reason),
            other => {
                if matches!(other, ErrorKind::TimedOut(_)) {
                    kind = FailureKind::TimedOut;
                }
                other.summary()
            }
        },
        other => call_reason(other),
    };
    let reason = without_private_folders(&reason);
    NoCost::Failed { kind, reason, source: Some(Box::new(error)) }
}

/// A failed call without the time at which it happened, with the first line the FMU logged about it.
fn call_reason(error: &FmiError) -> String {
    match error {
        FmiError::Call(failure) => {
            let line = failure.log.first().map(|line| format!(": {line}")).unwrap_or_default();
            format!("{} returned {}{line}", failure.call, failure.status)
        }
        other => other.to_string(),
    }
}
