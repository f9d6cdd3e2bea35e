//! Criteria of trajectories, computed from the accepted steps of a simulation.

mod functionals;
mod pieces;
mod recorder;
mod signal;

use crate::cost::failure::CostFailure;
use crate::cost::residual::Accumulator;
use crate::error::CalibrationError;
use crate::expression::{Criterion, Expression, ExpressionError, Functional, nearest};
use crate::problem::column_units::declared;
use crate::problem::definition::Problem;
use crate::problem::experiment::Experiment;
use base::Number;
use dfo::FailureKind;
use fmi::ModelDescription;
use functionals::{BAND, Resolved};
use ode::{CallResult, Observer, Sample, StepOutputs};
use recorder::{Recorder, Space};
use signal::{Signal, Source};
use std::ops::ControlFlow;
use std::sync::{Mutex, PoisonError};

/// Name of the time in signals, unless a variable or a column has this name.
const TIME: &str = "time";

/// Criteria of the simulation of one experiment.
#[derive(Debug, Default)]
pub(crate) struct Criteria {
    texts: Vec<String>,
    signals: Vec<Signal>,
    resolved: Vec<Resolved>,
    /// Outputs of the simulation: the compared ones, then those of the signals.
    outputs: Vec<String>,
    /// True if the engine reports steps.
    pub(crate) has_steps: bool,
    /// Relative tolerance of the simulation.
    pub(crate) tolerance: f64,
    spaces: Mutex<Vec<Space>>,
}

impl Criteria {
    /// Resolves the criteria of a problem in an experiment.
    ///
    /// # Errors
    /// Returns an error for a name that is no variable of the model and no column, with its column in the
    /// text.
    pub(crate) fn new(
        problem: &Problem,
        experiment: &Experiment,
        description: &ModelDescription,
    ) -> Result<Self, CalibrationError> {
        let compared = experiment.outputs.iter().map(|output| output.variable.clone());
        let mut made = Self { outputs: compared.collect(), ..Self::default() };
        for criterion in problem.criteria() {
            let signal = |made: &mut Self, expression: Expression| -> Result<usize, CalibrationError> {
                let source = |name: &String| made.source(name, &criterion, problem, experiment, description);
                let sources =
                    expression.names().to_vec().iter().map(source).collect::<Result<Vec<_>, _>>()?;
                let signal = Signal { expression, sources };
                if let Some(index) = made.signals.iter().position(|listed| *listed == signal) {
                    return Ok(index);
                }
                made.signals.push(signal);
                Ok(made.signals.len() - 1)
            };
            let Some(first) = criterion.arguments.first() else { continue };
            let second = criterion.arguments.get(1);
            let is_step_response = matches!(
                criterion.functional,
                Functional::Overshoot | Functional::RiseTime | Functional::SettlingTime
            );
            let (expression, reference) = match second {
                Some(second) if is_step_response => (first.clone(), Some(signal(&mut made, second.clone())?)),
                Some(second) => (first.minus(second), None),
                None => (first.clone(), None),
            };
            let signal = signal(&mut made, expression)?;
            let band = criterion.arguments.get(2).map_or(BAND, |band| band.value(&[]));
            made.resolved.push(Resolved { functional: criterion.functional, signal, reference, band });
            made.texts.push(criterion.text());
        }
        Ok(made)
    }

    /// Returns the source of a name, and adds its output.
    fn source(
        &mut self,
        name: &str,
        criterion: &Criterion,
        problem: &Problem,
        experiment: &Experiment,
        description: &ModelDescription,
    ) -> Result<Source, CalibrationError> {
        if declared(description, name).is_some() {
            let index = self.outputs.iter().position(|output| output == name).unwrap_or_else(|| {
                self.outputs.push(name.to_owned());
                self.outputs.len() - 1
            });
            return Ok(Source::Output(index));
        }
        if let Some(column) = experiment.data.names().find(|column| *column == name) {
            let values = experiment.data.measured(column, 0..experiment.data.time().len())?.clone();
            return Ok(Source::Column { times: experiment.data.time_series().clone(), values });
        }
        if name == TIME {
            return Ok(Source::Time);
        }
        let names = description.variables.iter().map(|variable| &*variable.name);
        let near = nearest(name, names.chain(experiment.data.names()));
        let near = near.map_or_else(String::new, |near| format!(" ('{near}'?)"));
        let message =
            format!("'{name}'{near} is neither a variable of the model nor a column of the scenario");
        let text = criterion.text();
        let in_goal = problem.goals.iter().find(|goal| goal.criteria().any(|c| c.text() == text));
        let (what, error): (String, ExpressionError) = match in_goal {
            Some(goal) => (format!("objective '{goal}'"), goal.error_at_name(name, message)),
            None => {
                let found = problem.constraints.iter().find(|c| c.criteria().any(|c| c.text() == text));
                let Some(constraint) = found else { return Err(CalibrationError::Setup(message)) };
                (format!("constraint '{constraint}'"), constraint.error_at_name(name, message))
            }
        };
        Err(CalibrationError::Setup(format!("{what}: {error}")))
    }

    /// Returns the number of criteria.
    pub(crate) fn len(&self) -> usize {
        self.resolved.len()
    }

    /// True if there are no criteria.
    pub(crate) fn is_empty(&self) -> bool {
        self.resolved.is_empty()
    }

    /// Returns the criteria as text.
    pub(crate) fn texts(&self) -> &[String] {
        &self.texts
    }

    /// Returns the outputs of the simulation.
    pub(crate) fn outputs(&self) -> &[String] {
        &self.outputs
    }

    /// Runs a simulation with an observer of the criteria and the residuals, and writes the values of the
    /// criteria to `out`.
    pub(crate) fn observe<R>(
        &self,
        accumulator: &mut Accumulator<'_>,
        out: &mut [f64],
        run: impl FnOnce(&mut dyn Observer) -> R,
    ) -> R {
        if self.is_empty() {
            return run(accumulator);
        }
        let spaces = || self.spaces.lock().unwrap_or_else(PoisonError::into_inner);
        let mut space = spaces().pop().unwrap_or_default();
        let recorder =
            Recorder::new(&self.signals, self.outputs.len(), self.has_steps, self.tolerance, &mut space);
        let ran = run(&mut Both { accumulator, recorder, has_steps: self.has_steps });
        for (resolved, out) in self.resolved.iter().zip(out) {
            *out = resolved.value(&space.pieces, &space.at_end);
        }
        spaces().push(space);
        ran
    }

    /// Returns a failure if a value of a criterion is not finite.
    pub(crate) fn check(&self, values: &[f64]) -> Result<(), CostFailure> {
        match self.texts.iter().zip(values).find(|(_, value)| !value.is_finite()) {
            None => Ok(()),
            Some((text, value)) => {
                let (reason, value) = (format!("{text} is not finite"), Number(*value));
                let message = format!("{text} is {value}");
                Err(CostFailure::Failed { kind: FailureKind::NotFinite, reason, message, source: None })
            }
        }
    }
}

/// Observer that passes the reports of a simulation to the residuals and to the criteria.
struct Both<'a, 'b> {
    accumulator: &'a mut Accumulator<'b>,
    recorder: Recorder<'a>,
    has_steps: bool,
}

impl Observer for Both<'_, '_> {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        self.recorder.row(sample);
        self.accumulator.sample(sample)
    }

    fn needs_outputs(&self) -> bool {
        self.has_steps
    }

    fn outputs(&mut self, step: &mut StepOutputs<'_>) -> CallResult<()> {
        self.recorder.step(step)
    }

    fn poll(&mut self) -> ControlFlow<()> {
        self.accumulator.poll()
    }
}
