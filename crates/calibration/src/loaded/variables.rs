//! Variables that the parameters set in the model, typical sizes of the parameters, and simulations that
//! record any variable of the model.

use crate::cost::request::Job;
use crate::error::CalibrationError;
use crate::loaded::calibration::Calibration;
use crate::problem::parameter::{Parameter, Scale};
use base::RunContext;
use dfo::typical_size;
use fmi::Trajectory;
use ode::Termination;
use std::ops::ControlFlow;

impl Calibration {
    /// Returns the variables of the model that the parameters set, with their values at `x` in the units of
    /// the model. A model with these values behaves as in the fit. With [local](crate::Parameter::local)
    /// parameters, `experiment` selects the experiment.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Length`], or [`CalibrationError::Setup`] if the experiment does not exist,
    /// or if no experiment is given and the values differ between experiments.
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

    /// Simulates an experiment, counted from 0, at `x` and records variables of the model without delays and
    /// offsets. The `variables` are names, array elements, patterns with `*` and `?`, or `all`. The values
    /// are recorded at the measured times or, if given, at `times`. The context interrupts it as in
    /// [`simulate`](Self::simulate).
    ///
    /// # Errors
    /// Returns the errors of [`simulate`](Self::simulate), and [`fmi::FmiError::UnknownVariable`] with the
    /// nearest names.
    ///
    /// # Panics
    /// Panics if the experiment does not exist.
    pub fn simulate_variables(
        &self,
        experiment: usize,
        x: &[f64],
        times: Option<&[f64]>,
        variables: &[String],
        context: &RunContext<'_>,
    ) -> Result<Trajectory, CalibrationError> {
        self.check_length(x)?;
        if let Ok(remote) = &self.evaluator().remote {
            let (times, variables) = (times.map(<[f64]>::to_vec), variables.to_vec());
            let job = Job::Variables { experiment, x: x.to_vec(), times, variables };
            return remote.trajectory(&job, None, context);
        }
        let mut options = self.evaluator().simulations[experiment].recording(x, times, variables);
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

    /// Returns the index of the experiment with this name.
    pub(crate) fn experiment_index(&self, name: &str) -> Result<usize, CalibrationError> {
        let names = self.problem().experiment_names();
        names.iter().position(|listed| listed == name).ok_or_else(|| {
            let available = names.join(", ");
            CalibrationError::Setup(format!("experiment '{name}' not found; available: {available}"))
        })
    }

    /// Returns the index of the first experiment if the values are the same in all experiments.
    fn index_of_all(&self, x: &[f64]) -> Result<usize, CalibrationError> {
        let first = self.values_in(0, x);
        let names = self.problem().experiment_names();
        match (1..names.len()).find(|&k| self.values_in(k, x) != first) {
            None => Ok(0),
            Some(_) => {
                let local: Vec<&str> = self
                    .problem()
                    .parameters
                    .iter()
                    .filter(|p| p.is_local() || p.given_experiments().is_some())
                    .map(|p| p.name())
                    .collect();
                let (local, names) = (local.join(", "), names.join("', '"));
                Err(CalibrationError::Setup(format!(
                    "each experiment has a separate value of {local}. Specify one of '{names}' (experiment = in Python, `fmufit report --experiment` \
                     for a saved fit)"
                )))
            }
        }
    }

    /// Returns the given size of a parameter on a linear scale. It is the user's nominal value, otherwise the
    /// nominal value of the model, limited to the width of the bounds.
    pub(crate) fn given_size(&self, parameter: &Parameter) -> Option<f64> {
        if parameter.scale_kind() == Scale::Log {
            return None;
        }
        let variable = parameter.variable().and_then(|name| self.fmu().description().variable(name));
        // The nominal value of the model is in the unit of the model.
        let nominal = variable.filter(|_| parameter.given_unit().is_none()).and_then(|v| v.nominal);
        let width = parameter.upper() - parameter.lower();
        let of_model = nominal.map(|n| if width > 0.0 { n.abs().min(width) } else { n.abs() });
        parameter.nominal_size().or(of_model).map(f64::abs).filter(|size| size.is_finite() && *size > 0.0)
    }

    /// Returns the typical size of a parameter near a value, by the rule of the search
    /// ([`dfo::typical_size`]). On a logarithmic scale, it is the size of the logarithm. The default is 1.
    /// For a value that has approached zero, the size at the start is used.
    pub(crate) fn size_of(&self, parameter: &Parameter, at: f64) -> f64 {
        let (bounds, given) = (parameter.search_bounds(), self.given_size(parameter));
        let largest = at.abs().max(parameter.start().abs());
        typical_size(parameter.scale_kind(), largest, bounds, given).unwrap_or(1.0)
    }
}
