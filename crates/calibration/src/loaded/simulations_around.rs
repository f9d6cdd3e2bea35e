//! Parallel simulations around a point, used to estimate the uncertainty of a fit. They are counted
//! separately from the evaluations of the fit.

use crate::cost::accuracy::Accuracy;
use crate::cost::comparison::ProcessChoice;
use crate::cost::failure::CostFailure;
use crate::cost::parallel;
use crate::cost::process::Evaluation;
use crate::cost::residual::CostRule;
use crate::error::CalibrationError;
use crate::loaded::budget::{Budget, Extra};
use crate::loaded::calibration::Calibration;
use crate::loaded::effort::Effort;
use base::RunContext;
use dfo::RobustLoss;
use fmi::{InterfaceKind, SimulationPlan, Simulator};
use ode::Stats;
use std::sync::Arc;
use std::time::Instant;

/// Divisor of the relative tolerance in accurate simulations. The remaining error is a tenth.
pub(crate) const ACCURATE: f64 = 10.0;

/// Work of an accurate simulation, relative to a simulation of the fit. At a tenth of the tolerance, a method
/// of order 5 requires 1.6 times as many steps.
const PRICE_OF_ACCURATE: f64 = 1.6;

/// Work of a simulation with half the step, relative to a simulation of the fit.
const HALF_STEP: f64 = 2.0;

/// Smallest relative tolerance of an integration.
const SMALLEST_TOLERANCE: f64 = 1e-13;

/// Largest relative tolerance at which the size of the residuals indicates the simulation error. At looser
/// tolerances, residuals may be noise.
const LOOSEST_OF_EXACT: f64 = 1e-5;

/// A point to simulate.
#[derive(Debug, Clone)]
pub(crate) struct Point {
    /// Parameter values in the user's units.
    pub(crate) x: Vec<f64>,
    /// True to simulate with a tenth of the relative tolerance or, for a fixed-step method, with half the
    /// step.
    pub(crate) is_accurate: bool,
}

impl Point {
    /// Creates a point to simulate like the evaluations of a fit.
    pub(crate) fn new(x: Vec<f64>) -> Self {
        Self { x, is_accurate: false }
    }
}

/// The residuals as they count in the cost, or the reason of a failure.
pub(crate) type PointResiduals = Result<Vec<f64>, String>;

/// Runs simulations and adds up their effort.
pub(crate) struct Simulations<'a> {
    pub(crate) calibration: &'a Calibration,
    pub(crate) loss: RobustLoss,
    /// Number of parallel simulations.
    pub(crate) workers: usize,
    /// Context, checked on the calling thread.
    pub(crate) context: RunContext<'a>,
    /// Number of simulated points.
    pub(crate) n: usize,
    pub(crate) stats: Stats,
    /// Effort of simulations that do not serve the standard errors; it is a part of `stats`.
    pub(crate) extras: Effort,
    /// Budget of simulations that do not serve the standard errors.
    pub(crate) budget: Budget,
}

impl<'a> Simulations<'a> {
    /// Prepares the model, unless that is done already, and creates an empty record of simulations.
    pub(crate) fn new(
        calibration: &'a Calibration,
        loss: RobustLoss,
        workers: usize,
        context: &RunContext<'a>,
    ) -> Result<Self, CalibrationError> {
        calibration.prepare()?;
        Ok(Self {
            calibration,
            loss,
            workers,
            context: *context,
            n: 0,
            stats: Stats::default(),
            extras: Effort::default(),
            budget: Budget::unlimited(),
        })
    }

    /// Returns the residuals at points that do not serve the standard errors. Returns `None` if the budget
    /// does not allow them.
    ///
    /// # Errors
    /// Returns the errors of [`residuals`](Self::residuals).
    pub(crate) fn extra(
        &mut self,
        extra: Extra,
        points: &[Point],
    ) -> Result<Option<Vec<PointResiduals>>, CalibrationError> {
        let price =
            |point: &Point| if point.is_accurate { self.calibration.price_of_accurate() } else { 1.0 };
        let price = points.iter().map(price).sum();
        if !self.budget.allows(extra, price) {
            return Ok(None);
        }
        self.beside(points).map(Some)
    }

    /// Returns the residuals like [`extra`](Self::extra), for simulations that are never skipped.
    ///
    /// # Errors
    /// Returns the errors of [`residuals`](Self::residuals).
    pub(crate) fn beside(&mut self, points: &[Point]) -> Result<Vec<PointResiduals>, CalibrationError> {
        let (before, began) = (std::mem::take(&mut self.stats), Instant::now());
        let found = self.residuals(points);
        self.extras += Effort::of(&self.stats, began.elapsed());
        self.stats += before;
        found
    }

    /// Returns the residuals at these points, in their order.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Cancelled`], or the error that makes further simulations impossible.
    pub(crate) fn residuals(&mut self, points: &[Point]) -> Result<Vec<PointResiduals>, CalibrationError> {
        let n = self.calibration.n_residuals();
        let mut found = self.values(points)?;
        found.iter_mut().flatten().for_each(|values| values.truncate(n));
        Ok(found)
    }

    /// Returns the residuals at these points, each followed by the criteria of the simulations.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Cancelled`], or the error that makes further simulations impossible.
    pub(crate) fn values(&mut self, points: &[Point]) -> Result<Vec<PointResiduals>, CalibrationError> {
        if self.context.is_over() {
            return Err(CalibrationError::Cancelled);
        }
        let (calibration, loss) = (self.calibration, self.loss);
        let task = |k: usize, context: &RunContext<'_>| {
            let mut residuals = vec![0.0; calibration.n_values()];
            let (mut stats, rule) = (Stats::default(), CostRule::whole(loss, context));
            let Point { x, is_accurate } = &points[k];
            let accuracy = is_accurate.then(|| calibration.accurate());
            let cost = calibration.evaluate_with(accuracy, x, rule, &mut residuals, &mut stats);
            (cost.map(|_| residuals), stats)
        };
        let answers = parallel::map(points.len(), self.workers, &self.context, &task);
        let mut found = Vec::with_capacity(points.len());
        for answer in answers {
            let Some((residuals, stats)) = answer else { return Err(CalibrationError::Cancelled) };
            self.n += 1;
            self.stats += stats;
            found.push(match residuals {
                Ok(residuals) => Ok(residuals),
                Err(no_cost) => Err(no_cost.of_point()?.message),
            });
        }
        Ok(found)
    }
}

impl Calibration {
    /// True if the residuals of a cost are within ten relative tolerances of the measurements. They are then
    /// mostly simulation error.
    pub(crate) fn is_within_tolerance(&self, cost: f64) -> bool {
        let tolerance = self.relative_tolerance().min(LOOSEST_OF_EXACT);
        cost <= (10.0 * tolerance * self.residual_layout().size_of_measurements()).powi(2)
    }

    /// Returns the relative tolerance of the simulations.
    pub(crate) fn relative_tolerance(&self) -> f64 {
        self.evaluator().simulations[0].pool.plan().relative_tolerance()
    }

    /// True if the simulations use a fixed step.
    pub(crate) fn has_fixed_step(&self) -> bool {
        let plan = self.evaluator().simulations[0].pool.plan();
        plan.kind() == InterfaceKind::ModelExchange && self.problem().settings.run.method.is_fixed_step()
    }

    /// Returns the fixed step of the simulations, or the communication step of a co-simulation, in s.
    pub(crate) fn step_in_use(&self) -> Option<f64> {
        let plan = self.evaluator().simulations[0].pool.plan();
        let given = self.problem().settings.run.step_size;
        let of_experiment = || self.fmu().description().default_experiment.step_size;
        match self.has_fixed_step() {
            true => given.or_else(of_experiment),
            false => plan.communication_step(),
        }
    }

    /// True if the model is a co-simulation, which integrates itself.
    pub(crate) fn is_co_simulation(&self) -> bool {
        self.evaluator().simulations[0].pool.plan().kind() == InterfaceKind::CoSimulation
    }

    /// Returns the work of an accurate simulation, relative to a simulation of the fit.
    pub(crate) fn price_of_accurate(&self) -> f64 {
        if self.has_fixed_step() || self.is_co_simulation() { HALF_STEP } else { PRICE_OF_ACCURATE }
    }

    /// Returns the accuracy with a tenth of the relative tolerance or half the step.
    fn accurate(&self) -> Accuracy {
        let tolerance = self.relative_tolerance();
        match self.has_fixed_step() {
            true => Accuracy::HalfStep,
            false => Accuracy::Tolerance((tolerance / ACCURATE).max(SMALLEST_TOLERANCE).min(tolerance)),
        }
    }

    /// Returns the residuals at `x` as they count in the cost. Returns `None` if the simulation fails.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Cancelled`].
    pub(crate) fn residuals_with(
        &self,
        accuracy: Option<Accuracy>,
        x: &[f64],
        loss: RobustLoss,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Result<Option<Vec<f64>>, CalibrationError> {
        let mut residuals = vec![0.0; self.n_values()];
        match self.evaluate_with(accuracy, x, CostRule::whole(loss, context), &mut residuals, stats) {
            Ok(_) => {
                residuals.truncate(self.n_residuals());
                Ok(Some(residuals))
            }
            Err(CostFailure::Cancelled) => Err(CalibrationError::Cancelled),
            Err(_) => Ok(None),
        }
    }

    /// Evaluates like [`evaluate_into`](Self::evaluate_into), with a different accuracy if one is given.
    pub(crate) fn evaluate_with(
        &self,
        accuracy: Option<Accuracy>,
        x: &[f64],
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
    ) -> Result<f64, CostFailure> {
        let Some(accuracy) = accuracy else { return self.evaluate_into(x, rule, out, stats) };
        if let Ok(remote) = &self.evaluator().remote {
            let evaluation = Evaluation { accuracy: Some(accuracy), ..Evaluation::whole(ProcessChoice::Any) };
            return remote.evaluate(x, evaluation, rule, (out, self.n_residuals()), stats);
        }
        self.evaluator().evaluate(x, rule, out, stats, |k, run| {
            let mut options = self.evaluator().simulations[k].options_at_start();
            let run_settings = &mut options.run;
            match accuracy {
                Accuracy::Tolerance(tolerance) => run_settings.relative_tolerance = Some(tolerance),
                Accuracy::HalfStep => {
                    let communication = self.evaluator().simulations[k].pool.plan().communication_step();
                    run_settings.step_size = communication.map(|step| 0.5 * step).or(run_settings.step_size);
                    options.halve_steps = true;
                }
            }
            Ok(SimulationPlan::new(self.fmu(), &options)
                .and_then(|plan| run(&mut Simulator::new(Arc::new(plan))?)))
        })
    }
}
