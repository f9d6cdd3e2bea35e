//! Variables that the parameters set in the model, and simulations of all of its variables, not only of those
//! that are compared.

use crate::cost::calibration::Calibration;
use crate::cost::process::Job;
use crate::error::CalibrationError;
use base::RunContext;
use fmi::Trajectory;
use ode::Termination;
use std::ops::ControlFlow;

impl Calibration {
    /// The variables of the model that the parameters set, with their values at `x` in the units of the
    /// model: what a model is given to behave as in the fit. With [local](crate::Parameter::local) parameters
    /// it must be said in which experiment.
    ///
    /// # Errors
    /// [`CalibrationError::Length`]; [`CalibrationError::Setup`]: there is no such experiment, or none is
    /// named and the values differ between them.
    pub fn variable_values(
        &self,
        x: &[f64],
        experiment: Option<&str>,
    ) -> Result<Vec<(String, f64)>, CalibrationError> {
        self.check_length(x)?;
        let k = match experiment {
            Some(name) => self.experiment_index(name)?,
            None => self.index_of_all(x)?,
        };
        Ok(self.values_in(k, x))
    }

    /// Simulates an experiment, counted from 0, at `x` and records variables of the model as they are: by
    /// their names, elements of arrays, patterns with `*` and `?`, or `all`; at the measured times or, if
    /// `times` are given, at those. Outputs are not delayed, and have no offset. The context ends it as in
    /// [`simulate`](Self::simulate).
    ///
    /// # Errors
    /// As [`simulate`](Self::simulate); [`fmi::FmiError::UnknownVariable`] with the nearest names.
    ///
    /// # Panics
    /// There is no such experiment.
    pub fn simulate_variables(
        &self,
        experiment: usize,
        x: &[f64],
        times: Option<&[f64]>,
        variables: &[String],
        context: &RunContext<'_>,
    ) -> Result<Trajectory, CalibrationError> {
        self.check_length(x)?;
        let method = self.solver(context)?.method;
        if let Ok(remote) = &self.evaluator().remote {
            let (times, variables) = (times.map(<[f64]>::to_vec), variables.to_vec());
            let job = Job::Variables { experiment, x: x.to_vec(), method, times, variables };
            return remote.trajectory(&job, context);
        }
        let mut options = self.evaluator().simulations[experiment].recording((x, method), times, variables);
        let values = self.values_in(experiment, x);
        options.start_values.extend(values.into_iter().map(|(name, value)| (name, value.into())));
        let mut poll = || if context.is_over() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let trajectory = self.fmu().simulate_with(&options, &mut poll)?;
        match trajectory.termination {
            Termination::StoppedByObserver => Err(CalibrationError::Cancelled),
            _ => Ok(trajectory),
        }
    }

    pub(super) fn values_in(&self, experiment: usize, x: &[f64]) -> Vec<(String, f64)> {
        let named = self.evaluator().simulations[experiment].named_values(x);
        named.map(|(name, value)| (name.to_owned(), value)).collect()
    }

    /// The experiment of a name.
    pub(crate) fn experiment_index(&self, name: &str) -> Result<usize, CalibrationError> {
        let names = self.problem().experiment_names();
        names.iter().position(|known| known == name).ok_or_else(|| {
            let known = names.join(", ");
            CalibrationError::Setup(format!("there is no experiment '{name}'; there are: {known}"))
        })
    }

    /// The first experiment, where the values are the same in all.
    fn index_of_all(&self, x: &[f64]) -> Result<usize, CalibrationError> {
        let first = self.values_in(0, x);
        let names = self.problem().experiment_names();
        match (1..names.len()).find(|&k| self.values_in(k, x) != first) {
            None => Ok(0),
            Some(_) => {
                let local: Vec<&str> =
                    self.problem().parameters.iter().filter(|p| p.is_local()).map(|p| p.name()).collect();
                let (local, names) = (local.join(", "), names.join("', '"));
                Err(CalibrationError::Setup(format!(
                    "each experiment has its own value of {local}: say of which experiment, experiment = '{names}'"
                )))
            }
        }
    }
}
