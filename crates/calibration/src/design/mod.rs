//! Design optimisation: parameters for which criteria of simulated trajectories are best.

mod front;
mod result;

pub use front::DesignFront;
pub use result::DesignResult;

use crate::error::CalibrationError;
use crate::expression::Relation;
use crate::fit::one_stage::{Fit, FitOptions};
use crate::loaded::calibration::{Calibration, CalibrationBuilder};
use crate::loaded::design_point::DesignPoint;
use crate::problem::definition::Problem;
use crate::problem::experiment::Experiment;
use crate::problem::goal::{Combination, Goal};
use crate::problem::parameter::Parameter;
use crate::problem::settings::SimulationSettings;
use crate::sensitivity::SensitivityOptions;
use base::RunContext;
use dfo::{AnyMethod, Nsga2, Sensitivity};
use fmi::Fmu;
use std::sync::Arc;

/// A model, scenarios, parameters and goals, checked and ready to be optimised.
///
/// A goal is a formula over criteria of the simulated trajectories, such as `ise(y, 1)`. Criteria follow from
/// the accepted steps of the integration, so that a maximum between two rows counts. A design uses the worker
/// processes, methods, constraints, limits and checkpoints of a [`Calibration`].
#[derive(Debug)]
pub struct Design {
    calibration: Arc<Calibration>,
}

/// Builder of a [`Design`].
///
/// ```
/// use calibration::{Design, Experiment, FitOptions, Parameter};
/// // x' = -k x, x(0) = 1: the area under x and the effort k^2 are balanced at k = 0.7937.
/// let fmu = fmi::Fmu::open(example_models::example_fmu("dahlquist")?)?;
/// let design = Design::builder(fmu)
///     .goal("integral(x) + k**2".parse()?)
///     .parameter(Parameter::new("k", 2.0).bounds(0.1, 10.0))
///     .scenario(Experiment::default().final_time(50.0))
///     .build()?;
/// let result = design.optimize(FitOptions::default())?;
/// assert!((result.x[0] - 0.5_f64.cbrt()).abs() < 1e-2, "{result}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct DesignBuilder {
    inner: CalibrationBuilder,
    has_goals: bool,
    has_scenarios: bool,
}

impl DesignBuilder {
    /// Adds a goal. With several goals, [`Design::optimize`] searches for the best value of the first one.
    #[must_use]
    pub fn goal(mut self, goal: Goal) -> Self {
        self.inner = self.inner.goal(goal);
        self.has_goals = true;
        self
    }

    /// Adds a parameter. Vectors of parameter values follow the order of these calls.
    #[must_use]
    pub fn parameter(mut self, parameter: Parameter) -> Self {
        self.inner = self.inner.parameter(parameter);
        self
    }

    /// Adds a scenario: inputs, start values and the span of a simulation. Without scenarios, the model is
    /// simulated from its start time to its stop time.
    #[must_use]
    pub fn scenario(mut self, scenario: Experiment) -> Self {
        self.inner = self.inner.experiment(scenario);
        self.has_scenarios = true;
        self
    }

    /// Adds a constraint between parameters and criteria, such as `"overshoot(y, 1) <= 5".parse()?`. A
    /// constraint with criteria applies in each scenario.
    #[must_use]
    pub fn constraint(mut self, constraint: Relation) -> Self {
        self.inner = self.inner.constraint(constraint);
        self
    }

    /// Sets the combination of the goals over several scenarios. Default: the sum.
    #[must_use]
    pub fn combine(mut self, combination: Combination) -> Self {
        self.inner = self.inner.combination(combination);
        self
    }

    /// Sets the settings of the simulations.
    #[must_use]
    pub fn settings(mut self, settings: impl Into<SimulationSettings>) -> Self {
        self.inner = self.inner.settings(settings);
        self
    }

    /// Checks the setup and loads the model. It does not simulate yet.
    ///
    /// # Errors
    /// Returns the errors of [`CalibrationBuilder::build`], and an error if there is no goal or if a scenario
    /// has compared outputs.
    pub fn build(self) -> Result<Design, CalibrationError> {
        if !self.has_goals {
            return Err(no_goal());
        }
        let inner = match self.has_scenarios {
            true => self.inner,
            false => self.inner.experiment(Experiment::default()),
        };
        Design::of(Arc::new(inner.build()?))
    }
}

fn no_goal() -> CalibrationError {
    CalibrationError::Setup("objective is missing. Give a formula such as ise(y, 1)".to_owned())
}

impl Design {
    /// Creates a builder for a design of this model.
    pub fn builder(fmu: Fmu) -> DesignBuilder {
        DesignBuilder { inner: Calibration::builder(fmu), has_goals: false, has_scenarios: false }
    }

    /// Creates a design from its model and a problem.
    ///
    /// # Errors
    /// Returns the errors of [`Calibration::from_problem`] and of [`DesignBuilder::build`].
    pub fn from_problem(fmu: Fmu, problem: Problem) -> Result<Self, CalibrationError> {
        Self::of(Arc::new(Calibration::from_problem(fmu, problem)?))
    }

    /// Creates a design from a calibration with goals.
    ///
    /// # Errors
    /// Returns an error if the calibration has no goals.
    pub fn of(calibration: Arc<Calibration>) -> Result<Self, CalibrationError> {
        match calibration.problem().goals.is_empty() {
            true => Err(no_goal()),
            false => Ok(Self { calibration }),
        }
    }

    /// Returns the calibration that evaluates the design. It has no residuals.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// Returns the goals.
    pub fn goals(&self) -> &[Goal] {
        &self.calibration.problem().goals
    }

    /// Simulates all scenarios at `x` and returns the goals, criteria and constraints.
    ///
    /// # Errors
    /// Returns the errors of [`Calibration::cost`].
    pub fn evaluate(&self, x: &[f64], context: &RunContext<'_>) -> Result<DesignPoint, CalibrationError> {
        self.calibration.design_point(x, context)
    }

    /// Searches for the parameters with the best value of the first goal that satisfy the constraints. The
    /// [method](FitOptions::run) is chosen as for a cost without residuals. Options that concern residuals,
    /// their noise and their uncertainty must have their defaults.
    ///
    /// # Errors
    /// Returns the errors of [`Calibration::fit`].
    pub fn optimize<'a>(&self, options: impl Into<FitOptions<'a>>) -> Result<DesignResult, CalibrationError> {
        let options: FitOptions<'a> = options.into();
        let context = options.context;
        let fit = self.calibration.fit(options)?;
        Ok(self.result(fit, &context))
    }

    /// Searches for the Pareto front of the goals by NSGA-II ([`Nsga2`]). Every parameter requires two finite
    /// bounds. The [method](FitOptions::run) of the options is replaced unless it is [`AnyMethod::Nsga2`].
    ///
    /// # Errors
    /// Returns an error if there is only one goal, and the errors of [`Calibration::fit`].
    pub fn pareto<'a>(&self, options: impl Into<FitOptions<'a>>) -> Result<DesignFront, CalibrationError> {
        let mut options: FitOptions<'a> = options.into();
        self.check_several()?;
        if !matches!(options.run.method, AnyMethod::Nsga2(_)) {
            options.run.method = Nsga2::default().into();
        }
        Ok(self.front(self.calibration.fit(options)?))
    }

    /// Returns the front of a [fit](Calibration::fit) of the [calibration](Self::calibration) by
    /// [`Nsga2`]. It is empty if another method searched, or if no design satisfies the constraints.
    pub fn front(&self, fit: Fit) -> DesignFront {
        DesignFront::new(&self.calibration, fit)
    }

    /// Estimates the effect of each parameter on the goals and on the criteria of each scenario, see
    /// [`Calibration::sensitivity`].
    ///
    /// # Errors
    /// Returns the errors of [`Calibration::sensitivity`].
    pub fn sensitivity(
        &self,
        options: &SensitivityOptions,
        context: &RunContext<'_>,
    ) -> Result<Sensitivity, CalibrationError> {
        self.calibration.sensitivity(options, context)
    }

    /// Returns an error if there is only one goal.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Setup`].
    pub fn check_several(&self) -> Result<(), CalibrationError> {
        match self.goals() {
            [goal] => Err(CalibrationError::Setup(format!(
                "a Pareto front requires several objectives, but there is only '{goal}'. Give a list of objectives"
            ))),
            _ => Ok(()),
        }
    }

    /// Returns the result of a [fit](Calibration::fit) of the [calibration](Self::calibration), which is a
    /// search for the best design. It simulates the result and the start.
    pub fn result(&self, fit: Fit, context: &RunContext<'_>) -> DesignResult {
        // The simulations of the result and of the start are part of neither the budget nor the time limit.
        let evaluate = |x: &[f64]| match context.is_cancelled() {
            true => None,
            false => self.evaluate(x, &RunContext::new()).ok(),
        };
        let (point, start) = (evaluate(&fit.x), evaluate(&fit.start));
        DesignResult::new(&self.calibration, fit, point, start)
    }
}
