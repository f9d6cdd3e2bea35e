//! Choice of the method that integrates the simulations of a calibration: the one that was named, or the best
//! of a comparison.

use crate::cost::failure::CostFailure;
use crate::cost::loaded_problem::LoadedProblem;
use crate::cost::residual::{Accumulator, CostRule};
use crate::cost::solver_comparison::{
    ComparisonOutcome, ComparisonRun, ComparisonTask, SolverComparison, compare_solvers,
};
use crate::error::CalibrationError;
use base::RunContext;
use dfo::RobustLoss;
use fmi::{FmiError, InterfaceKind, SharedSimulator, SimulateOptions, SimulationPlan, Simulator};
use ode::{ErrorKind, Method, Observer, Sample, Stats};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// The absolute tolerance of an output is this share of the relative one and its nominal value, as for
/// states.
const ABSOLUTE_SHARE: f64 = 0.01;

/// The method in use, and how it was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ChosenSolver {
    /// The method.
    pub method: Method,
    /// The comparison that it won; `None`: it was named, or taken from a checkpoint, or the model integrates
    /// itself.
    pub comparison: Option<SolverComparison>,
}

/// A choice that is made once.
#[derive(Debug, Default)]
pub(crate) struct Choice {
    made: OnceLock<Chosen>,
    turn: Mutex<()>,
}

#[derive(Debug)]
pub(crate) struct Chosen {
    pub(crate) solver: ChosenSolver,
    /// Simulators with this method, per experiment; none: those of the settings.
    pools: Vec<SharedSimulator>,
}

/// Evaluation at the start of a fit that was made before its search.
#[derive(Debug, Clone)]
pub(crate) struct AtStart {
    /// The residuals: without a loss from a comparison of methods, else as they count.
    pub(crate) residuals: Vec<f64>,
    /// Statistics of its simulations.
    pub(crate) stats: Stats,
}

/// Keeps the samples of one simulation, and compares them with what was measured.
struct Samples<'a> {
    values: Vec<f64>,
    /// Numbers of a sample that have a name.
    named: usize,
    compared: Accumulator<'a>,
    context: RunContext<'a>,
    was_cancelled: bool,
}

impl Observer for Samples<'_> {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        if sample.index.is_some() {
            self.values.extend_from_slice(&sample.outputs[..self.named]);
        }
        // A residual that is not finite ends no comparison.
        if self.compared.stop.is_none() {
            let _ = self.compared.sample(sample);
        }
        ControlFlow::Continue(())
    }

    fn poll(&mut self) -> ControlFlow<()> {
        self.was_cancelled = self.context.is_over();
        if self.was_cancelled { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

impl Choice {
    /// The method in use, if it is known already.
    pub(crate) fn known(&self) -> Option<&ChosenSolver> {
        self.made.get().map(|chosen| &chosen.solver)
    }

    /// The simulators of an experiment with the method in use.
    pub(crate) fn pool<'a>(
        &'a self,
        problem: &'a LoadedProblem,
        experiment: usize,
        context: &RunContext<'_>,
    ) -> Result<&'a SharedSimulator, CostFailure> {
        let chosen = self.chosen(problem, context, &mut Stats::default()).map_err(|error| match error {
            CalibrationError::Model(error) => error.into(),
            _ => CostFailure::Cancelled,
        })?;
        let chosen = chosen.0;
        Ok(chosen.pools.get(experiment).unwrap_or(&problem.simulations[experiment].pool))
    }

    /// The choice, made now if it is not yet: then with the evaluation at the start by the method that was
    /// chosen. What its simulations take is added to `stats`.
    pub(crate) fn chosen(
        &self,
        problem: &LoadedProblem,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Result<(&Chosen, Option<AtStart>), CalibrationError> {
        if let Some(chosen) = self.made.get() {
            return Ok((chosen, None));
        }
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(chosen) = self.made.get() {
            return Ok((chosen, None));
        }
        let method = problem.problem.settings.run.method;
        let integrates = problem.simulations[0].pool.plan().kind() == InterfaceKind::ModelExchange;
        let (solver, at_start) = if method == Method::Auto && integrates {
            let (comparison, at_start) = compare_on_problem(problem, context, stats)?;
            (ChosenSolver { method: comparison.method, comparison: Some(comparison) }, at_start)
        } else {
            (ChosenSolver { method, comparison: None }, None)
        };
        Ok((self.choose(problem, solver)?, at_start))
    }

    /// Fixes the choice, unless it is made.
    pub(crate) fn choose(
        &self,
        problem: &LoadedProblem,
        solver: ChosenSolver,
    ) -> Result<&Chosen, CalibrationError> {
        let mut pools = Vec::new();
        if solver.method != problem.problem.settings.run.method {
            for simulation in &problem.simulations {
                let options = simulation.options_at_start().method(solver.method);
                let plan = Arc::new(SimulationPlan::new(&problem.fmu, &options)?);
                pools.push(SharedSimulator::new(plan));
            }
        }
        Ok(self.made.get_or_init(|| Chosen { solver, pools }))
    }
}

/// Compares the methods on the simulations of a problem, at the start values of its parameters; with the
/// evaluation there by the winner.
fn compare_on_problem(
    problem: &LoadedProblem,
    context: &RunContext<'_>,
    stats: &mut Stats,
) -> Result<(SolverComparison, Option<AtStart>), CalibrationError> {
    let plan = problem.simulations[0].pool.plan();
    let (relative, n) = (plan.relative_tolerance(), plan.n_states());
    let variables = &problem.fmu.description().variables;
    let nominal = |v: &usize| variables[*v].nominal.map(f64::abs).filter(|n| n.is_finite() && *n > 0.0);
    // The samples of all experiments stand one after the other, so their tolerances have to be laid out likewise.
    let absolute: Vec<f64> = (problem.simulations.iter())
        .flat_map(|simulation| {
            let plan = simulation.pool.plan();
            let row = plan.output_variables().iter().map(nominal);
            let row: Vec<f64> = row.map(|n| ABSOLUTE_SHARE * relative * n.unwrap_or(1.0)).collect();
            plan.times().iter().flat_map(move |_| row.clone())
        })
        .collect();
    let mut evaluated: Vec<(Method, AtStart)> = Vec::new();
    let compared = compare_solvers(relative, &absolute, n, |task| {
        let (outcome, at_start) = match &problem.remote {
            Ok(remote) => remote.compare(*task, (absolute.len(), problem.n_residuals), context, stats)?,
            Err(_) => simulate_compared(problem, task, context, stats)?,
        };
        if let (Some(residuals), ComparisonOutcome::Finished { stats, .. }) = (at_start, &outcome) {
            evaluated.push((task.method, AtStart { residuals, stats: *stats }));
        }
        Ok::<_, CalibrationError>(outcome)
    })?;
    let of_winner = evaluated.into_iter().find(|(method, _)| *method == compared.method);
    Ok((compared, of_winner.map(|(_, at_start)| at_start)))
}

/// A simulation of a comparison; with the residuals where they are those of an evaluation.
pub(crate) fn simulate_compared(
    problem: &LoadedProblem,
    task: &ComparisonTask,
    context: &RunContext<'_>,
    stats: &mut Stats,
) -> Result<ComparisonRun, CalibrationError> {
    let plan = problem.simulations[0].pool.plan();
    let (relative, n) = (plan.relative_tolerance(), plan.n_states());
    let start = problem.start();
    let rule = CostRule::whole(RobustLoss::default(), &RunContext::new());
    let (mut all, mut total) = (Vec::new(), Stats::default());
    let mut residuals = vec![0.0; problem.n_residuals];
    let (mut rest, priors) = residuals.split_at_mut(problem.layout.n_measurements());
    let mut is_whole = problem.prior_residuals(&start, priors).is_ok();
    for simulation in &problem.simulations {
        let (part, others) = rest.split_at_mut(simulation.comparison.n_residuals());
        rest = others;
        let (schedule, offsets) = (simulation.schedule(&start), simulation.output_offsets(&start));
        let compared = Accumulator::new(&simulation.comparison, &schedule, &offsets, rule, 0.0, part);
        let options = SimulateOptions {
            max_work: task.max_work.map(|most| (most - total.work(n)).max(0.0)),
            ..simulation.options_at_start().method(task.method).relative_tolerance(task.relative_tolerance)
        };
        let plan = Arc::new(SimulationPlan::new(&problem.fmu, &options)?);
        let named = plan.output_names().len();
        let mut simulator = Simulator::new(plan)?;
        let mut samples = Samples { values: all, named, compared, context: *context, was_cancelled: false };
        let ran = simulation.run(&mut simulator, &start, &schedule, &mut samples);
        match &ran {
            Ok(report) => *stats += report.stats,
            Err(FmiError::Simulation(error)) => *stats += error.stats,
            Err(_) => {}
        }
        if samples.was_cancelled {
            return Err(CalibrationError::Cancelled);
        }
        is_whole &= samples.compared.stop.is_none() && samples.compared.is_complete();
        all = samples.values;
        match ran {
            Ok(report) => total += report.stats,
            Err(FmiError::Simulation(e)) if matches!(e.kind, ErrorKind::TooMuchWork(_)) => {
                return Ok((ComparisonOutcome::GivenUp, None));
            }
            Err(error) => {
                return Ok((ComparisonOutcome::Failed(CostFailure::from(error).of_point()?.reason), None));
            }
        }
    }
    let is_evaluation = is_whole && task.relative_tolerance == relative;
    let at_start = is_evaluation.then_some(residuals);
    Ok((ComparisonOutcome::Finished { samples: all, stats: total }, at_start))
}
