//! A problem with its opened model, for evaluating cost, residuals and trajectories.

use crate::cost::comparison::ProcessChoice;
use crate::cost::failure::{CostFailure, PointFailure};
use crate::cost::loaded_problem::LoadedProblem;
use crate::cost::process::{Evaluation, Remote};
use crate::cost::request::Job;
use crate::cost::residual::CostRule;
use crate::cost::split::Slots;
use crate::error::CalibrationError;
use crate::expression::Relation;
use crate::findings::finding::Severity;
use crate::problem::constraint::Constraints;
use crate::problem::definition::{ModelFile, Problem};
use crate::problem::experiment::Experiment;
use crate::problem::fingerprint::{hash, identity};
use crate::problem::goal::{Combination, Goal};
use crate::problem::objective::CostKind;
use crate::problem::parameter::Parameter;
use crate::problem::residual_layout::ResidualLayout;
use crate::problem::settings::SimulationSettings;
use crate::problem::warning::{SETUP_LOG_TARGET, SetupWarning};
use base::{Number, RunContext};
use dfo::{Answer, Checkpoint, EvaluationKind, Failure, FailureKind, Objective, Outcome, Query, RobustLoss};
use fmi::worker::{Held, Isolation};
use fmi::{CancelRequest, FmiError, Fmu, Trajectory};
use log::Level;
use ode::{Method, Stats, Termination};
use std::ops::ControlFlow;

/// A model, recordings and parameters, checked and ready to be evaluated from any number of threads.
///
/// The cost is the sum of the squared weighted residuals, simulated minus measured, over all experiments,
/// outputs and measured times. It contains neither 1/N nor 1/2. The terms are added in the order of the
/// residual vector. The cost at given parameters is therefore bit-for-bit identical on every worker, inside
/// and outside a fit. It also does not depend on whether residuals are requested or a cutoff is set.
#[derive(Debug)]
pub struct Calibration {
    evaluator: LoadedProblem,
    /// Everything that defines a fit, by name, as text or as a hash.
    identity: Vec<(String, String)>,
}

/// Builder of a [`Calibration`].
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
    constraints: Vec<Relation>,
    goals: Vec<Goal>,
    combination: Combination,
}

impl CalibrationBuilder {
    /// Adds a recording. The cost is the sum over all recordings, in the order of these calls.
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

    /// Adds a constraint between the parameters, such as `"tau1 <= tau2".parse()?`. Linear constraints hold
    /// at every point of the search; nonlinear ones hold at the result within the option `constraint_tol`.
    #[must_use]
    pub fn constraint(mut self, constraint: Relation) -> Self {
        self.constraints.push(constraint);
        self
    }

    /// Adds a goal of a [design](crate::Design). A calibration with goals has no measurements, and its fit
    /// searches for the best value of the first goal.
    #[must_use]
    pub fn goal(mut self, goal: Goal) -> Self {
        self.goals.push(goal);
        self
    }

    /// Sets the combination of the goals over the scenarios.
    #[must_use]
    pub fn combination(self, combination: Combination) -> Self {
        Self { combination, ..self }
    }

    /// Sets the settings of the simulations.
    #[must_use]
    pub fn settings(mut self, settings: impl Into<SimulationSettings>) -> Self {
        self.settings = settings.into();
        self
    }

    /// Checks the setup and loads the model. It does not simulate yet.
    ///
    /// # Errors
    /// Returns an error for unknown names, parameters that cannot be set, and invalid bounds or data. For an
    /// unknown name, the message lists the nearest names.
    pub fn build(self) -> Result<Calibration, CalibrationError> {
        let Self { fmu, experiments, parameters, settings, constraints, goals, combination } = self;
        let model = ModelFile::of(&fmu)?;
        let calibration = Calibration::from_problem(
            fmu,
            Problem { model, parameters, experiments, settings, constraints, goals, combination },
        )?;
        calibration.evaluator.check_derived_at(&calibration.start())?;
        Ok(calibration)
    }
}

impl Calibration {
    /// Creates a builder for a calibration of this model.
    pub fn builder(fmu: Fmu) -> CalibrationBuilder {
        CalibrationBuilder {
            fmu,
            experiments: Vec::new(),
            parameters: Vec::new(),
            settings: SimulationSettings::default(),
            constraints: Vec::new(),
            goals: Vec::new(),
            combination: Combination::default(),
        }
    }

    /// Creates a calibration from its model and a problem stored by or received from another process.
    /// It checks the problem, but does not simulate yet.
    ///
    /// # Errors
    /// Returns the errors of [`CalibrationBuilder::build`], and [`CalibrationError::OtherModel`] if the
    /// content of the model differs.
    pub fn from_problem(fmu: Fmu, problem: Problem) -> Result<Self, CalibrationError> {
        problem.model.check(&fmu)?;
        let evaluator = LoadedProblem::new(fmu, problem, None)?;
        for warning in &evaluator.warnings {
            let level = if warning.severity() == Severity::Note { Level::Info } else { Level::Warn };
            log::log!(target: SETUP_LOG_TARGET, level, "{warning}");
        }
        let identity = identity(&evaluator.problem, &evaluator.parameters)?;
        Ok(Self { evaluator, identity })
    }

    /// Creates a calibration of another problem with the same model. Warnings of the problem are not logged
    /// again.
    pub(crate) fn derived(&self, problem: Problem) -> Result<Self, CalibrationError> {
        self.derived_in(problem, None)
    }

    /// Creates a calibration of another problem that uses the worker processes of this one. It is meant for a
    /// few simulations while this calibration is idle.
    pub(crate) fn derived_beside(&self, problem: Problem) -> Result<Self, CalibrationError> {
        self.derived_in(problem, self.evaluator.remote.as_ref().ok())
    }

    fn derived_in(&self, problem: Problem, lender: Option<&Remote>) -> Result<Self, CalibrationError> {
        let evaluator = LoadedProblem::new(self.fmu().clone(), problem, lender)?;
        let identity = identity(&evaluator.problem, &evaluator.parameters)?;
        Ok(Self { evaluator, identity })
    }

    /// Copies the warnings of the calibration from which this one is derived.
    pub(crate) fn keep_warnings(&mut self, from: &Self) {
        self.evaluator.warnings.clone_from(&from.evaluator.warnings);
    }

    /// Creates a calibration with other windows in all experiments. Its simulations start at the same time
    /// and in the same state as the simulations of this calibration.
    pub(crate) fn windowed(&self, windows: &[(f64, f64)]) -> Result<Self, CalibrationError> {
        if windows.is_empty() {
            return Err(CalibrationError::Setup("windows is empty. Specify at least one window".to_owned()));
        }
        let mut problem = self.problem().clone();
        for (experiment, simulation) in problem.experiments.iter_mut().zip(&self.evaluator.simulations) {
            experiment.windows = windows.to_vec();
            simulation.keep_start(experiment);
        }
        self.derived(problem)
    }

    pub(crate) fn evaluator(&self) -> &LoadedProblem {
        &self.evaluator
    }

    /// Returns the problem of the calibration, as plain data.
    pub fn problem(&self) -> &Problem {
        &self.evaluator.problem
    }

    /// Returns the model.
    pub fn fmu(&self) -> &Fmu {
        &self.evaluator.fmu
    }

    /// Returns the warnings about the setup, for example unused columns and units read from column names.
    /// Each warning was logged once, when the calibration was built.
    pub fn warnings(&self) -> &[SetupWarning] {
        &self.evaluator.warnings
    }

    /// Returns the parameters, one per entry of every vector of values, in the given order. A
    /// [local](Parameter::local) parameter occurs once per experiment.
    pub fn parameters(&self) -> &[Parameter] {
        &self.evaluator.parameters
    }

    /// Returns the length of the residual vector.
    pub fn n_residuals(&self) -> usize {
        self.evaluator.n_residuals
    }

    /// Returns the meaning of each entry of the residual vector, with the measurement, its time and its
    /// weight.
    pub fn residual_layout(&self) -> &ResidualLayout {
        &self.evaluator.layout
    }

    /// Returns the number of values of an evaluation: the residuals, then the criteria of all experiments.
    pub(crate) fn n_values(&self) -> usize {
        self.evaluator.n_values()
    }

    /// Returns the number of measurements that count. It is the length of the residual vector without the
    /// priors at its end.
    pub fn n_measurements(&self) -> usize {
        self.evaluator.layout.n_measurements()
    }

    /// Returns the root mean square of the weighted residuals of the measurements, computed from the cost at
    /// `x`. With a loss, the residuals count as transformed by the loss. The contribution of the priors to
    /// the cost is subtracted.
    ///
    /// # Panics
    /// Panics if the length of `x` differs from the number of parameters.
    pub fn rms(&self, x: &[f64], cost: f64) -> f64 {
        let priors = if self.residual_layout().priors.is_empty() { 0.0 } else { self.prior_cost(x) };
        let squares = cost - priors;
        // The difference may be slightly negative because of rounding.
        (if squares < 0.0 { 0.0 } else { squares } / self.n_measurements() as f64).sqrt()
    }

    /// Returns the contribution of the priors to the cost at `x`: the sum of the squares of their residuals.
    /// It does not depend on the loss of a fit. Returns NaN if the residual of a prior is undefined.
    ///
    /// # Panics
    /// Panics if the length of `x` differs from the number of parameters.
    pub fn prior_cost(&self, x: &[f64]) -> f64 {
        let mut residuals = vec![0.0; self.residual_layout().priors.len()];
        self.evaluator.prior_residuals(x, &mut residuals).unwrap_or(f64::NAN)
    }

    /// Returns the [derived](Parameter::derived) and [tied](Parameter::tied) parameters with their values at
    /// `x`. A value that follows from a local parameter occurs once per experiment.
    ///
    /// # Panics
    /// Panics if the length of `x` differs from the number of parameters.
    pub fn derived_values(&self, x: &[f64]) -> Vec<(String, f64)> {
        self.evaluator.derived_values(x).map(|(reported, value)| (reported.name.clone(), value)).collect()
    }

    /// Returns the variables that are set in the model at `x`, with their values in the units of the model.
    /// The simulation belongs to the experiment with index `experiment`, from 0. Derived values are included;
    /// delays and offsets are not.
    ///
    /// # Panics
    /// Panics if the experiment does not exist, or if the length of `x` differs from the number of
    /// parameters.
    pub fn model_values(&self, experiment: usize, x: &[f64]) -> Vec<(String, f64)> {
        let simulation = &self.evaluator.simulations[experiment];
        simulation.named_values(x).map(|(name, value)| (name.to_owned(), value)).collect()
    }

    /// Returns the outcome at `x` from the sum of squares, the residuals and the criteria. Residuals that
    /// differ from those of the measurements are written to `out`: those of a user-defined function, and the
    /// values to minimise of the goals of a design.
    pub(crate) fn outcome_of(
        &self,
        kind: &CostKind,
        x: &[f64],
        sum: f64,
        (residuals, criteria): (&[f64], &[f64]),
        out: &mut Vec<f64>,
    ) -> Outcome {
        if !matches!(kind, CostKind::Goals) {
            return kind.outcome(self.residual_layout(), sum, residuals, out);
        }
        let goals = &self.evaluator.goals;
        out.clear();
        out.extend((0..goals.len()).map(|k| goals.cost(k, x, criteria)));
        match out.iter().position(|cost| !cost.is_finite()) {
            Some(k) => {
                let goal = self.problem().goals.get(k).map_or("", |goal| goal.text());
                let message = format!("the objective '{goal}' is not finite");
                Outcome::Failed(Failure { kind: FailureKind::NotFinite, message })
            }
            None => Outcome::Value(out.first().copied().unwrap_or(f64::NAN)),
        }
    }

    /// Returns the start and the end of the simulation of an experiment, counted from 0.
    ///
    /// # Panics
    /// Panics if the experiment does not exist.
    pub fn span(&self, experiment: usize) -> (f64, f64) {
        let plan = self.evaluator.simulations[experiment].pool.plan();
        (plan.start_time(), plan.final_time())
    }

    /// Returns the constraints between the parameters.
    pub fn constraints(&self) -> &Constraints {
        &self.evaluator.constraints
    }

    /// Returns the start values of all parameters.
    pub fn start(&self) -> Vec<f64> {
        self.evaluator.start()
    }

    /// Returns the integration method of the simulations of this calibration, inside and outside fits.
    pub fn solver(&self) -> Method {
        self.problem().settings.run.method
    }

    /// Returns the cost at `x` (one value per parameter, in the user's units).
    ///
    /// # Errors
    /// Returns an error if the number of values is wrong or a simulation fails. The error of a simulation
    /// reports the parameter values and the reason.
    pub fn cost(&self, x: &[f64], context: &RunContext<'_>) -> Result<f64, CalibrationError> {
        self.evaluate_fully(x, context, &mut Stats::default()).map(|(cost, _)| cost)
    }

    /// Returns the residuals at `x`, simulated minus measured times weight. Their order is experiment by
    /// experiment, output by output, by time, without missing measurements. The length is the same for every
    /// `x`.
    ///
    /// # Errors
    /// Returns the errors of [`cost`](Self::cost).
    pub fn residuals(&self, x: &[f64], context: &RunContext<'_>) -> Result<Vec<f64>, CalibrationError> {
        self.residuals_counted(x, context, &mut Stats::default())
    }

    /// Returns the residuals at `x` and adds the statistics of the simulations to `stats`.
    pub(crate) fn residuals_counted(
        &self,
        x: &[f64],
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Result<Vec<f64>, CalibrationError> {
        self.evaluate_fully(x, context, stats).map(|(_, residuals)| residuals)
    }

    /// Simulates every experiment at `x` and returns the trajectories of the compared outputs. The
    /// trajectories are at the measured times or, if given, at `times`.
    ///
    /// # Errors
    /// Returns the errors of [`cost`](Self::cost).
    pub fn simulate(
        &self,
        x: &[f64],
        times: Option<&[f64]>,
        context: &RunContext<'_>,
    ) -> Result<Vec<Trajectory>, CalibrationError> {
        (0..self.problem().experiments.len())
            .map(|k| self.simulate_experiment(k, x, times, context))
            .collect()
    }

    /// Simulates one experiment, counted from 0, like [`simulate`](Self::simulate).
    ///
    /// # Errors
    /// Returns the errors of [`cost`](Self::cost), and [`CalibrationError::Cancelled`].
    ///
    /// # Panics
    /// Panics if the experiment does not exist.
    pub fn simulate_experiment(
        &self,
        experiment: usize,
        x: &[f64],
        times: Option<&[f64]>,
        context: &RunContext<'_>,
    ) -> Result<Trajectory, CalibrationError> {
        self.check_length(x)?;
        if let Ok(remote) = &self.evaluator.remote {
            let times = times.map(<[f64]>::to_vec);
            let job = Job::Experiment { experiment, x: x.to_vec(), times };
            let n_columns = self.problem().experiments[experiment].outputs.len();
            return remote.trajectory(&job, Some(n_columns), context);
        }
        let mut poll = || if context.is_over() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let simulation = &self.evaluator.simulations[experiment];
        let trajectory = simulation.trajectory(self.fmu(), x, times, &mut poll)?;
        match trajectory.termination {
            Termination::StoppedByObserver => Err(CalibrationError::Cancelled),
            _ => Ok(trajectory),
        }
    }

    /// Marks the start of many simulations. Until the returned guard is dropped, worker processes use the
    /// current working folder and environment variables.
    pub(crate) fn hold(&self) -> Option<Held> {
        self.evaluator.remote.as_ref().ok().map(Remote::hold)
    }

    /// Compiles and loads the model before its first use, in this process or in a further worker process.
    pub(crate) fn prepare(&self) -> Result<(), CalibrationError> {
        if let Ok(remote) = &self.evaluator.remote {
            remote.prepare_second();
            return Ok(());
        }
        Ok(self.fmu().prepare(self.problem().settings.run.kind, &CancelRequest::default())?)
    }

    pub(crate) fn check_length(&self, x: &[f64]) -> Result<(), CalibrationError> {
        if x.len() == self.parameters().len() {
            return Ok(());
        }
        let names = self.parameters().iter().map(Parameter::name).collect::<Vec<_>>().join(", ");
        Err(CalibrationError::Length { got: x.len(), expected: self.parameters().len(), names })
    }

    fn evaluate_fully(
        &self,
        x: &[f64],
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Result<(f64, Vec<f64>), CalibrationError> {
        let (cost, mut values) = self.evaluate_values(x, context, stats)?;
        values.truncate(self.n_residuals());
        Ok((cost, values))
    }

    /// Returns the cost and the values at `x`: the residuals, then the criteria of all experiments.
    pub(crate) fn evaluate_values(
        &self,
        x: &[f64],
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Result<(f64, Vec<f64>), CalibrationError> {
        self.check_length(x)?;
        let mut values = vec![0.0; self.n_values()];
        let rule = CostRule::whole(RobustLoss::default(), context);
        let cost = self.evaluate_in(ProcessChoice::Compared, x, rule, &mut values, stats);
        cost.map(|cost| (cost, values)).map_err(|no_cost| match no_cost.of_point() {
            Ok(PointFailure { message, source }) => self.failed_at(x, message, source),
            Err(error) => error,
        })
    }

    /// Returns the error of a failed simulation at these parameter values.
    pub(crate) fn failed_at(
        &self,
        x: &[f64],
        message: String,
        source: Option<Box<FmiError>>,
    ) -> CalibrationError {
        let pairs = self.parameters().iter().zip(x);
        let at = pairs.map(|(p, v)| format!("{} = {}", p.name(), Number(*v))).collect::<Vec<_>>().join(", ");
        CalibrationError::Simulation { at, message, source }
    }

    /// Evaluates a query and adds its statistics to `stats`. The residuals of the answer are followed by the
    /// criteria of all experiments; see [`take_criteria`](Self::take_criteria). The work is counted in
    /// right-hand sides. `slots`: workers that may simulate recordings of the point at the same time.
    pub(crate) fn evaluate_counted(
        &self,
        x: &[f64],
        query: &Query<'_>,
        loss: RobustLoss,
        slots: Option<&Slots>,
        answer: &mut Answer,
        stats: &mut Stats,
    ) {
        let before = stats.right_hand_sides;
        let ended = || query.cancelled();
        answer.residuals.resize(self.n_values(), 0.0);
        let rule = CostRule { loss, cutoff: query.cutoff, context: RunContext::new().polling(&ended) };
        let cost = match (slots, &self.evaluator.remote) {
            (Some(slots), Ok(remote)) => {
                self.evaluator.evaluate_on(slots, remote, x, rule, &mut answer.residuals, stats)
            }
            _ => self.evaluate_into(x, rule, &mut answer.residuals, stats),
        };
        answer.outcome = match cost {
            Ok(cost) => Outcome::Value(cost),
            Err(CostFailure::Above) => Outcome::Above(query.cutoff),
            Err(CostFailure::Cancelled) => Outcome::cancelled(),
            Err(CostFailure::Over(error)) => {
                let reported = self.evaluator.over.get_or_init(|| error.reported());
                Outcome::Abort(reported.message.clone())
            }
            Err(CostFailure::Failed { kind, reason, .. }) => {
                Outcome::Failed(Failure { kind, message: reason })
            }
        };
        answer.work = stats.right_hand_sides - before;
    }

    /// Returns the error that made further simulations impossible, if it ended the search. Otherwise returns
    /// `error`.
    pub(crate) fn over_or(&self, error: CalibrationError) -> CalibrationError {
        match (error, self.evaluator.over.get()) {
            (CalibrationError::Optimiser(search), Some(reported))
                if search.to_string().contains(&reported.message) =>
            {
                FmiError::ReportedError(Box::new(reported.clone())).into()
            }
            (error, _) => error,
        }
    }

    /// Returns the cost and writes the residuals and the criteria to `out`; see [`LoadedProblem::evaluate`].
    pub(crate) fn evaluate_into(
        &self,
        x: &[f64],
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
    ) -> Result<f64, CostFailure> {
        self.evaluate_in(ProcessChoice::ComparedFirst, x, rule, out, stats)
    }

    /// Returns the cost like [`evaluate_into`](Self::evaluate_into). If worker processes are used, `process`
    /// selects the kind of process.
    fn evaluate_in(
        &self,
        process: ProcessChoice,
        x: &[f64],
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
    ) -> Result<f64, CostFailure> {
        if let Ok(remote) = &self.evaluator.remote {
            return remote.evaluate(x, Evaluation::whole(process), rule, (out, self.n_residuals()), stats);
        }
        self.evaluator.evaluate(x, rule, out, stats, |k, run| {
            Ok(self.evaluator.simulations[k].pool.with_simulator(&rule.context, run))
        })
    }

    /// Returns the cost of a single recording; see [`LoadedProblem::evaluate_recording`].
    pub(crate) fn evaluate_recording(
        &self,
        k: usize,
        x: &[f64],
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
    ) -> Result<f64, CostFailure> {
        self.evaluator.evaluate_recording(k, x, rule, out, stats, |k, run| {
            Ok(self.evaluator.simulations[k].pool.with_simulator(&rule.context, run))
        })
    }

    /// Removes the criteria from the values of an answer and returns them.
    pub(crate) fn take_criteria(&self, values: &mut Vec<f64>) -> Vec<f64> {
        values.split_off(self.n_residuals().min(values.len()))
    }

    /// Returns the number of residuals and criteria of a recording.
    ///
    /// # Errors
    /// Returns an error if there is no recording with this index.
    pub(crate) fn n_values_of(&self, k: usize) -> Result<usize, CalibrationError> {
        let simulation = self.evaluator.simulations.get(k);
        simulation.map(|s| s.comparison.n_residuals() + s.criteria.len()).ok_or_else(|| {
            let n = self.evaluator.simulations.len();
            CalibrationError::Setup(format!("recording {k} was requested, but there are {n}"))
        })
    }

    /// Returns where the model runs, and the reason if it runs in this process although a separate process
    /// was requested.
    pub fn isolation(&self) -> (Isolation, Option<&str>) {
        match &self.evaluator.remote {
            Ok(_) => (Isolation::Process, None),
            Err(reason) => (Isolation::None, reason.as_deref()),
        }
    }

    /// Returns the names and values that identify a fit.
    pub(crate) fn tags(&self) -> impl Iterator<Item = (&str, &str)> {
        self.identity.iter().map(|(name, value)| (name.as_str(), value.as_str()))
    }

    /// Returns a hash of everything that a cost depends on, except the values of the parameters. It covers
    /// the model, data, settings, and targets of the parameters. Bounds and starts are not included.
    pub(crate) fn problem_hash(&self) -> String {
        hash(self.tags())
    }

    /// Adds the identity of the problem to a checkpoint.
    pub(crate) fn tag(&self, checkpoint: Checkpoint) -> Checkpoint {
        self.tags().fold(checkpoint, |checkpoint, (name, value)| checkpoint.tag(name, value))
    }
}

impl Objective for Calibration {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        self.evaluate_counted(x, query, RobustLoss::default(), None, answer, &mut Stats::default());
        let criteria = self.take_criteria(&mut answer.residuals);
        self.constraints().nonlinear(x, &criteria, &mut answer.constraints);
        if query.kind == EvaluationKind::Cost {
            answer.residuals.clear();
        }
    }

    fn has_residuals(&self) -> bool {
        true
    }
}
