//! Problem with its model loaded, for residuals and cost at any point.

use crate::cost::failure::CostFailure;
use crate::cost::process::Remote;
use crate::cost::residual::{Accumulator, CostRule, StopReason, sum_of_squares};
use crate::cost::simulation::Simulation;
use crate::data::TimeUnit;
use crate::error::CalibrationError;
use crate::problem::assignment::Assignments;
use crate::problem::column_units::convert_columns;
use crate::problem::constraint::Constraints;
use crate::problem::definition::{Element, Problem};
use crate::problem::derived::{DerivedFault, Reported};
use crate::problem::experiment::InitialState;
use crate::problem::parameter::Parameter;
use crate::problem::residual_layout::{PriorResidual, ResidualLayout};
use crate::problem::resolved_goals::Goals;
use crate::problem::row_means::take_means;
use crate::problem::warning::SetupWarning;
use base::Number;
use dfo::FailureKind;
use fmi::error::ReportedError;
use fmi::worker::check_sandbox;
use fmi::{FmiError, Fmu, Simulator};
use ode::{Observer, Report, Stats};
use std::sync::OnceLock;

/// Function that simulates with a borrowed simulator.
pub(crate) type RunOn<'a> = dyn FnMut(&mut Simulator) -> Result<Report, FmiError> + 'a;

/// Checked problem and its model.
#[derive(Debug)]
pub(crate) struct LoadedProblem {
    pub(crate) fmu: Fmu,
    pub(crate) problem: Problem,
    /// Parameters, one per entry of `x`.
    pub(crate) parameters: Vec<Parameter>,
    pub(crate) simulations: Vec<Simulation>,
    pub(crate) n_residuals: usize,
    pub(crate) layout: ResidualLayout,
    pub(crate) warnings: Vec<SetupWarning>,
    /// Derived parameters, in the order of the results.
    pub(crate) derived: Vec<Reported>,
    /// Constraints between the parameters.
    pub(crate) constraints: Constraints,
    /// Goals of a design.
    pub(crate) goals: Goals,
    /// Processes in which the model runs, or the reason why it runs in this one. The reason is `None` if the
    /// user requested it.
    pub(crate) remote: Result<Remote, Option<String>>,
    /// Error after which no further simulation is possible.
    pub(crate) over: OnceLock<ReportedError>,
}

impl LoadedProblem {
    /// Resolves and checks a problem. Loads the model but simulates nothing yet. `lender` lends its
    /// processes.
    pub(crate) fn new(
        fmu: Fmu,
        mut problem: Problem,
        lender: Option<&Remote>,
    ) -> Result<Self, CalibrationError> {
        let fmu = problem.settings.with_units(fmu)?;
        let time_unit = TimeUnit::of_model(fmu.description());
        for k in 0..problem.experiments.len() {
            let converted = problem.experiments[k].data.convert_times(&time_unit);
            converted.map_err(|error| problem.error_in(k, error))?;
        }
        for k in 0..problem.experiments.len() {
            let taken = problem.experiments[k].take_parameter_set(fmu.description(), &problem.parameters);
            taken.map_err(|error| problem.error_in(k, error))?;
        }
        let mut warnings = problem.check(fmu.description())?;
        for k in 0..problem.experiments.len() {
            let taken = take_means(&mut problem.experiments[k], fmu.description());
            taken.map_err(|error| problem.error_in(k, error))?;
        }
        warnings.extend(convert_columns(&mut problem, fmu.description())?);
        let elements = problem.elements()?;
        let simulations = (problem.experiments.iter().zip(problem.experiment_names()).enumerate())
            .map(|(k, (experiment, name))| {
                let assigned = Assignments::new(&problem, k, &elements, fmu.description());
                let (simulation, in_doubt) = assigned
                    .and_then(|assigned| {
                        Simulation::new(&fmu, name, experiment, &problem, &elements, assigned)
                    })
                    .map_err(|error| problem.error_in(k, error))?;
                for warning in in_doubt.into_iter().map(|warning| problem.warning_in(k, warning)) {
                    // Report a setting that is ignored in all experiments only once.
                    if !warnings.contains(&warning) {
                        warnings.push(warning);
                    }
                }
                Ok(simulation)
            })
            .collect::<Result<Vec<_>, CalibrationError>>()?;
        let layout = layout(&problem, &simulations, &elements);
        let n_residuals = layout.n_residuals();
        let derived = problem.reported()?;
        let (constraints, satisfied) = Constraints::new(&problem, &elements)?;
        warnings.extend(satisfied);
        let goals = Goals::new(&problem, &elements)?;
        let parameters = elements.into_iter().map(|element| element.parameter).collect();
        let remote = Remote::of(&fmu, &problem, lender);
        if problem.settings.sandbox && !fmu.is_absent() {
            check_sandbox()?;
            if let Err(reason) = &remote {
                let reason = reason.as_deref().unwrap_or("isolation = \"none\"");
                return Err(FmiError::BadSetting(format!(
                    "sandbox: the model would run in this process, which is not confined ({reason}). Use isolation = \"process\" \
                     and recorded inputs"
                ))
                .into());
            }
        }
        Ok(Self {
            remote,
            fmu,
            problem,
            parameters,
            simulations,
            n_residuals,
            layout,
            warnings,
            derived,
            constraints,
            goals,
            over: OnceLock::new(),
        })
    }

    /// Returns an error if a derived parameter is undefined or outside its bounds at start values.
    pub(crate) fn check_derived_at(&self, start: &[f64]) -> Result<(), CalibrationError> {
        let fault = self.simulations.iter().find_map(|simulation| simulation.derivation().fault(start));
        let Some(DerivedFault { name, value, expression, at, fault }) = fault else { return Ok(()) };
        let message = format!(
            "{expression} is {} at the start ({at}), {fault}. Change the start values or the bounds",
            Number(value)
        );
        Err(CalibrationError::Parameter { name, message })
    }

    /// Returns the values of the derived parameters, in the order of the results.
    pub(crate) fn derived_values<'a>(&'a self, x: &'a [f64]) -> impl Iterator<Item = (&'a Reported, f64)> {
        self.derived.iter().map(|reported| {
            let derivation = self.simulations[reported.experiment].derivation();
            let entry = derivation.entry_of(reported.parameter);
            let value = entry.and_then(|entry| derivation.extended(x).get(entry).copied());
            (reported, value.unwrap_or(f64::NAN))
        })
    }

    /// Returns the number of criteria of all experiments.
    pub(crate) fn n_criteria(&self) -> usize {
        self.simulations.iter().map(|simulation| simulation.criteria.len()).sum()
    }

    /// Returns the number of values that an evaluation computes: the residuals, then the criteria.
    pub(crate) fn n_values(&self) -> usize {
        self.n_residuals + self.n_criteria()
    }

    /// Returns the start values of all entries of `x`.
    pub(crate) fn start(&self) -> Vec<f64> {
        self.parameters.iter().map(Parameter::start).collect()
    }

    /// Returns the cost at `x`: the sum of the squares of the residuals, from the first to the last. Writes
    /// the residuals to `out`, followed by the criteria of all experiments. Adds the statistics of the
    /// simulations to `stats`, without simulations that could not start. `lend` passes a simulator of an
    /// experiment to the function that runs it. The evaluation ends if the cost exceeds the cutoff or the
    /// context is cancelled.
    ///
    /// # Panics
    /// Panics if the length of `x` or `out` differs from the number of parameters or
    /// [values](Self::n_values).
    pub(crate) fn evaluate(
        &self,
        x: &[f64],
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
        mut lend: impl FnMut(usize, &mut RunOn<'_>) -> Result<Result<Report, FmiError>, CostFailure>,
    ) -> Result<f64, CostFailure> {
        self.fmu.repeat_if_learned(|| self.evaluate_once(x, rule, out, stats, &mut lend))
    }

    fn evaluate_once(
        &self,
        x: &[f64],
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
        lend: &mut impl FnMut(usize, &mut RunOn<'_>) -> Result<Result<Report, FmiError>, CostFailure>,
    ) -> Result<f64, CostFailure> {
        let running = self.running(rule);
        let (residuals, mut criteria) = out.split_at_mut(self.n_residuals);
        let (mut rest, priors) = residuals.split_at_mut(self.layout.n_measurements());
        let mut sum = self.prior_residuals(x, priors)?;
        if sum > running.cutoff {
            return Err(CostFailure::Above);
        }
        for (k, simulation) in self.simulations.iter().enumerate() {
            let (part, others) = rest.split_at_mut(simulation.comparison.n_residuals());
            let (values, other_criteria) = criteria.split_at_mut(simulation.criteria.len());
            (rest, criteria) = (others, other_criteria);
            sum = self.simulate_recording(k, x, running, sum, (part, values), stats, lend)?;
        }
        let cost = sum_of_squares(residuals);
        if cost > rule.cutoff { Err(CostFailure::Above) } else { Ok(cost) }
    }

    /// Returns the cost of a single recording, without priors. Writes its residuals to `out`, followed by its
    /// criteria; see [`evaluate`](Self::evaluate).
    pub(crate) fn evaluate_recording(
        &self,
        k: usize,
        x: &[f64],
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
        mut lend: impl FnMut(usize, &mut RunOn<'_>) -> Result<Result<Report, FmiError>, CostFailure>,
    ) -> Result<f64, CostFailure> {
        let (residuals, criteria) = out.split_at_mut(self.simulations[k].comparison.n_residuals());
        let mut simulate = || {
            let out = (&mut *residuals, &mut *criteria);
            self.simulate_recording(k, x, self.running(rule), 0.0, out, stats, &mut lend)
        };
        self.fmu.repeat_if_learned(&mut simulate)?;
        let cost = sum_of_squares(residuals);
        if cost > rule.cutoff { Err(CostFailure::Above) } else { Ok(cost) }
    }

    /// Simulates a recording and writes its residuals and its criteria to `out`. Returns `sum` plus the sum
    /// of their squares.
    #[allow(clippy::too_many_arguments)]
    fn simulate_recording(
        &self,
        k: usize,
        x: &[f64],
        running: CostRule<'_>,
        sum: f64,
        (out, values): (&mut [f64], &mut [f64]),
        stats: &mut Stats,
        lend: &mut impl FnMut(usize, &mut RunOn<'_>) -> Result<Result<Report, FmiError>, CostFailure>,
    ) -> Result<f64, CostFailure> {
        let simulation = &self.simulations[k];
        if let Some(DerivedFault { name, value, expression, at, fault }) = simulation.derivation().fault(x) {
            let kind = if value.is_finite() { FailureKind::Error } else { FailureKind::NotFinite };
            let reason = format!("the derived parameter '{name}' is {fault}");
            let message = format!("'{name}' = {expression} is {}, {fault}, at {at}", Number(value));
            return Err(CostFailure::Failed { kind, reason, message, source: None });
        }
        let (schedule, shifts) = (simulation.schedule(x), simulation.output_shifts(x));
        let mut accumulator = Accumulator::new(&simulation.comparison, &schedule, &shifts, running, sum, out);
        let ran = lend(k, &mut |simulator| {
            let run = |observer: &mut dyn Observer| simulation.run(simulator, x, &schedule, observer);
            simulation.criteria.observe(&mut accumulator, values, run)
        })?;
        match &ran {
            Ok(report) => *stats += report.stats,
            Err(FmiError::Simulation(error)) => *stats += error.stats,
            Err(_) => {}
        }
        let sum = self.running_sum(k, &accumulator, ran);
        let sum = sum.and_then(|sum| simulation.criteria.check(values).map(|()| sum));
        sum.map_err(|no_cost| match self.simulations.len() {
            1 => no_cost,
            _ => no_cost.in_experiment(&simulation.name),
        })
    }

    /// Returns the rule for a running sum. It is in the order of time, the cost in the order of the
    /// residuals. The sums of n positive numbers in two orders differ by less than 2 n units of rounding
    /// (Higham, Accuracy and Stability of Numerical Algorithms, 2002, section 4.2).
    fn running<'a>(&self, rule: CostRule<'a>) -> CostRule<'a> {
        CostRule { cutoff: rule.cutoff * (1.0 + 2.0 * self.n_residuals as f64 * f64::EPSILON), ..rule }
    }

    /// Computes the residuals of the priors and returns the sum of their squares. No loss is applied, because
    /// only measurements have outliers.
    pub(crate) fn prior_residuals(&self, x: &[f64], out: &mut [f64]) -> Result<f64, CostFailure> {
        for (PriorResidual { parameter, prior, .. }, out) in self.layout.priors.iter().zip(&mut *out) {
            *out = prior.residual(x[*parameter]);
            if !out.is_finite() {
                let (name, value) = (self.parameters[*parameter].name(), Number(x[*parameter]));
                let reason = format!("the prior of '{name}' is not defined at {value}");
                return Err(CostFailure::failed(FailureKind::NotFinite, reason));
            }
        }
        Ok(sum_of_squares(out))
    }

    /// Returns the running sum after the simulation of an experiment.
    fn running_sum(
        &self,
        k: usize,
        accumulator: &Accumulator<'_>,
        ran: Result<Report, FmiError>,
    ) -> Result<f64, CostFailure> {
        let name = |output: usize| &self.problem.experiments[k].outputs[output].variable;
        let failure = |output: usize, reason: String, value: &str| {
            let time = Number(accumulator.last_time(output).unwrap_or(f64::NAN));
            let message = format!("{reason}{value} at t = {time}");
            CostFailure::Failed { kind: FailureKind::NotFinite, reason, message, source: None }
        };
        match accumulator.stop {
            Some(StopReason::AboveCutoff) => return Err(CostFailure::Above),
            Some(StopReason::Cancelled) => return Err(CostFailure::Cancelled),
            Some(StopReason::NotFinite(output)) => {
                let reason = format!("the residual of '{}' is not finite", name(output));
                return Err(failure(output, reason, ""));
            }
            Some(StopReason::NotPositive(output, value)) => {
                let reason = format!("the simulated '{}' is not positive, but sigma is 'log'", name(output));
                return Err(failure(output, reason, &format!(": {}", Number(value))));
            }
            None => {}
        }
        let end = Number(ran?.time);
        if accumulator.is_complete() {
            return Ok(accumulator.sum);
        }
        let last = if self.problem.goals.is_empty() { "the last measurement" } else { "the final time" };
        let reason = format!("the model ended the simulation before {last}, at t = {end}");
        Err(CostFailure::failed(FailureKind::Error, reason))
    }
}

/// Returns the layout of the residual vector.
fn layout(problem: &Problem, simulations: &[Simulation], elements: &[Element]) -> ResidualLayout {
    let mut layout = ResidualLayout::default();
    for (k, (experiment, simulation)) in problem.experiments.iter().zip(simulations).enumerate() {
        let of_experiment = simulation.comparison.layout(layout.n_measurements());
        for (mut residuals, measured) in of_experiment.into_iter().zip(&experiment.outputs) {
            residuals.experiment = k;
            residuals.variable = measured.variable.clone();
            residuals.column = measured.column.clone();
            let belongs_to_output = |(state, initial): &(String, InitialState)| {
                initial.measured_output(state) == Some(&*residuals.variable)
            };
            residuals.is_noise_known = experiment.outputs[residuals.output].weight.is_known_noise();
            residuals.starts_simulation = experiment.initial_states.iter().any(belongs_to_output)
                && residuals
                    .times
                    .first()
                    .is_some_and(|first| simulation.starts_at(residuals.output, *first));
            layout.outputs.push(residuals);
        }
    }
    // The prior of a fixed parameter has no effect.
    let free = elements.iter().map(|e| &e.parameter).enumerate().filter(|(_, p)| p.lower() < p.upper());
    let priors = free.filter_map(|(i, p)| p.stated_prior().map(|prior| (i, *prior)));
    let n = layout.n_measurements();
    let tolerances = simulations.iter().map(|simulation| simulation.pool.plan().relative_tolerance());
    layout.relative_tolerance = tolerances.fold(0.0, f64::max);
    layout.priors = priors
        .zip(n..)
        .map(|((parameter, prior), index)| PriorResidual { parameter, prior, index })
        .collect();
    layout
}
