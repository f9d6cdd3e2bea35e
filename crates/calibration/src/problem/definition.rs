//! The problem of a fit as plain data, which can be stored and sent to other processes.

use crate::data::{UnitConversion, UnitError};
use crate::error::CalibrationError;
use crate::expression::Relation;
use crate::problem::error_model::ErrorModel;
use crate::problem::experiment::{Experiment, InitialState, Measured, Weight};
use crate::problem::goal::{Combination, Goal};
use crate::problem::parameter::{Parameter, Tie};
use crate::problem::resolution::{check_names, check_targets};
use crate::problem::settings::SimulationSettings;
use crate::problem::warning::{
    SetupWarning, clock_change, duplicate_rows, ignored_nominals, other_time_unit, unused_columns,
};
use base::Number;
use fmi::{FmiError, Fmu, ModelDescription};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Path of a model and hash of its content.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelFile {
    /// Absolute path of an `.fmu` file or an unpacked folder.
    pub path: PathBuf,
    /// SHA-256 of the content, in hexadecimal.
    pub content_hash: String,
}

/// Parameters and the terms of the cost that they are fitted to. A problem contains its recordings by value.
/// It refers to its model by path and hash. [`Calibration::from_problem`](crate::Calibration::from_problem)
/// turns it into a calibration that can be evaluated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Problem {
    /// The model.
    pub model: ModelFile,
    /// Parameters of the fit as the user named them. A [local](Parameter::local) parameter is listed once.
    pub parameters: Vec<Parameter>,
    /// Terms of the cost, in the order of their residuals.
    pub experiments: Vec<Experiment>,
    /// Settings of the simulations.
    pub settings: SimulationSettings,
    /// Constraints between the parameters, as written.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub constraints: Vec<Relation>,
    /// Goals of a design. A problem with goals has no measurements.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub goals: Vec<Goal>,
    /// Combination of the goals over several scenarios.
    #[serde(default, skip_serializing_if = "Combination::is_sum")]
    pub combination: Combination,
}

/// A fitted value: an entry of `x`.
#[derive(Debug, Clone)]
pub(crate) struct Element {
    pub(crate) parameter: Parameter,
    /// Index of the parameter of the problem; `None` for a fitted initial state.
    pub(crate) source: Option<usize>,
    /// Index of its only experiment; `None` for all experiments.
    pub(crate) experiment: Option<usize>,
}

impl ModelFile {
    /// Returns the file of an opened model.
    ///
    /// # Errors
    /// Returns an error if the file can no longer be read.
    pub fn of(fmu: &Fmu) -> Result<Self, FmiError> {
        let path = std::path::absolute(fmu.path()).unwrap_or_else(|_| fmu.path().to_owned());
        Ok(Self { path, content_hash: fmu.content_hash()?.to_owned() })
    }

    /// Checks that a model has this content.
    ///
    /// # Errors
    /// Returns [`CalibrationError::OtherModel`] with both hashes if the content differs.
    pub fn check(&self, fmu: &Fmu) -> Result<(), CalibrationError> {
        let found = fmu.content_hash()?;
        if found == self.content_hash {
            return Ok(());
        }
        let (expected, found) = (self.content_hash.clone(), found.to_owned());
        Err(CalibrationError::OtherModel { path: fmu.path().to_owned(), expected, found })
    }
}

impl Problem {
    /// Returns the names of the experiments: the given names, otherwise `run1`, `run2` and so on.
    pub fn experiment_names(&self) -> Vec<String> {
        let name =
            |(k, e): (usize, &Experiment)| e.name.clone().unwrap_or_else(|| Experiment::default_name(k));
        self.experiments.iter().enumerate().map(name).collect()
    }

    /// Returns the name of an experiment if there are several.
    fn name_of_several(&self, experiment: usize) -> Option<String> {
        (self.experiments.len() > 1).then(|| self.experiment_names().swap_remove(experiment))
    }

    /// Adds the name of the experiment to an error if there are several experiments.
    pub(crate) fn error_in(&self, experiment: usize, error: CalibrationError) -> CalibrationError {
        match self.name_of_several(experiment) {
            Some(name) => CalibrationError::Experiment { name, source: Box::new(error) },
            None => error,
        }
    }

    /// Adds the name of the experiment to a warning if there are several experiments. Warnings about the
    /// settings are returned unchanged, because all experiments share the settings.
    pub(crate) fn warning_in(&self, experiment: usize, warning: SetupWarning) -> SetupWarning {
        match (self.name_of_several(experiment), warning) {
            (Some(_), warning @ SetupWarning::NoEffect(_)) | (None, warning) => warning,
            (Some(name), warning) => SetupWarning::Experiment { name, warning: Box::new(warning) },
        }
    }

    /// Returns the entries of `x`. The parameters that are not derived come first, in their order, with one
    /// entry per experiment for a local parameter. The fitted initial states follow, experiment by
    /// experiment.
    pub(crate) fn elements(&self) -> Result<Vec<Element>, CalibrationError> {
        let names = self.experiment_names();
        let mut elements: Vec<Element> = Vec::with_capacity(self.parameters.len());
        for (i, parameter) in self.parameters.iter().enumerate() {
            parameter.check()?;
            let source = Some(i);
            if parameter.is_derived() {
                continue;
            }
            if !parameter.is_local() {
                elements.push(Element { parameter: parameter.clone(), source, experiment: None });
                continue;
            }
            let acting = names.iter().zip(&self.experiments).enumerate();
            for (k, (name, experiment)) in acting.filter(|(_, (name, _))| parameter.acts_in(name)) {
                let given = experiment.start_values.iter().find(|(given, _)| parameter.is_called(given));
                let start = given.map(|(_, value)| {
                    value.as_number().ok_or_else(|| CalibrationError::Parameter {
                        name: parameter.name().to_owned(),
                        message: format!("its start value in {name} is {value}, not a number"),
                    })
                });
                let parameter = parameter.in_experiment(name, start.transpose()?);
                elements.push(Element { parameter, source, experiment: Some(k) });
            }
        }
        for (k, (name, experiment)) in names.iter().zip(&self.experiments).enumerate() {
            for (state, initial) in &experiment.initial_states {
                let InitialState::Fitted(parameter) = initial else { continue };
                let parameter = parameter.for_state(state).in_experiment(name, None);
                elements.push(Element { parameter, source: None, experiment: Some(k) });
            }
        }
        elements.iter().try_for_each(|element| element.parameter.check())?;
        Ok(elements)
    }

    /// Checks the problem against the model description and returns warnings about doubtful parts.
    pub(crate) fn check(
        &self,
        description: &ModelDescription,
    ) -> Result<Vec<SetupWarning>, CalibrationError> {
        if self.parameters.is_empty() {
            return Err(CalibrationError::Setup("parameters is empty. Add a parameter to fit".to_owned()));
        }
        if self.experiments.is_empty() {
            return Err(CalibrationError::Setup("experiments is empty. Add an experiment".to_owned()));
        }
        // Every derived parameter follows from others without a circle, so at least one entry is fitted.
        self.check_formulas()?;
        for (i, parameter) in self.parameters.iter().enumerate() {
            if self.parameters[..i].iter().any(|p| p.name() == parameter.name()) {
                let name = parameter.name().to_owned();
                return Err(CalibrationError::Parameter { name, message: "is given twice".to_owned() });
            }
        }
        let names = self.experiment_names();
        let is_bad = |name: &&String| {
            name.is_empty() || name.contains(|c: char| matches!(c, '[' | ']') || c.is_control())
        };
        if let Some(name) = names.iter().find(is_bad) {
            return Err(CalibrationError::Setup(format!(
                "experiment {name:?}: a name must not be empty or contain brackets or line breaks"
            )));
        }
        if let Some(twice) = (1..names.len()).find(|&k| names[..k].contains(&names[k])) {
            let noun = if self.goals.is_empty() { "experiments" } else { "scenarios" };
            return Err(CalibrationError::Setup(format!("two {noun} are named '{}'", names[twice])));
        }
        for parameter in &self.parameters {
            let given = parameter.given_experiments();
            if let Some(unknown) = given.into_iter().flatten().find(|name| !names.contains(name)) {
                let (name, available) = (parameter.name().to_owned(), names.join(", "));
                let message = format!(
                    "acts in the experiment '{unknown}', which does not exist; available: {available}"
                );
                return Err(CalibrationError::Parameter { name, message });
            }
            if given.is_some_and(<[String]>::is_empty) {
                let (name, message) =
                    (parameter.name().to_owned(), "experiments is empty. Omit it".to_owned());
                return Err(CalibrationError::Parameter { name, message });
            }
        }
        self.check_logarithms(true)?;
        check_targets(&self.parameters, &self.experiments, &names, description)?;
        for parameter in &self.parameters {
            let tie = parameter.tie().filter(|tie| !tie.across_units);
            let other = tie.and_then(|tie| self.parameters.iter().find(|other| other.name() == tie.to));
            if let (Some(tie), Some(other)) = (tie, other) {
                check_units_of_tie(parameter, other, tie, description)?;
            }
        }
        let mut warnings = Vec::new();
        for (k, experiment) in self.experiments.iter().enumerate() {
            let acting = self.parameters.iter().filter(|parameter| parameter.acts_in(&names[k])).cloned();
            let acting: Vec<Parameter> = acting.collect();
            let checked = check_names(experiment, &acting, description)
                .and_then(|()| experiment.check_start_values(description, &acting));
            checked.map_err(|error| self.error_in(k, error))?;
            let doubts = unused_columns(description, experiment).into_iter();
            let doubts = doubts.chain(clock_change(experiment)).chain(duplicate_rows(experiment));
            warnings.extend(doubts.map(|warning| self.warning_in(k, warning)));
        }
        warnings.extend(ignored_nominals(&self.parameters));
        warnings.extend(other_time_unit(self.settings.time_unit.as_deref(), description));
        Ok(warnings)
    }

    /// Rejects a variable that compares logarithms without a weight with one column and values with another.
    /// An error model with fitted coefficients is accepted if the fit estimates the noise of both
    /// (`is_estimated`).
    pub(crate) fn check_logarithms(&self, is_estimated: bool) -> Result<(), CalibrationError> {
        let names = self.experiment_names();
        let outputs = self
            .experiments
            .iter()
            .zip(&names)
            .flat_map(|(experiment, name)| experiment.outputs.iter().map(move |output| (name, output)));
        let (logarithms, values): (Vec<_>, Vec<_>) =
            outputs.partition(|(_, output)| matches!(output.weight, Weight::Log(weight) if weight == 1.0));
        for (name, output) in logarithms {
            let is_unweighed = |(_, value): &&(&String, &Measured)| {
                let is_fitted = value.weight.error_model().is_some_and(ErrorModel::is_fitted);
                value.variable == output.variable && !(is_estimated && is_fitted)
            };
            if let Some((other, value)) = values.iter().find(is_unweighed) {
                return Err(CalibrationError::Setup(format!(
                    "sigma of '{}' is 'log' for column '{}' of experiment '{name}', but not for column '{}' of experiment '{other}'. The noise of the logarithms is \
                     unknown, so they have no weight relative to the values. Use 'log' for both or for neither, or 'a + b*abs(y)' with noise 'estimated'",
                    output.variable, output.column, value.column
                )));
            }
        }
        Ok(())
    }
}

/// Rejects a tie between quantities of different kinds, and a tie of equal numbers in different units.
fn check_units_of_tie(
    parameter: &Parameter,
    other: &Parameter,
    tie: Tie<'_>,
    description: &ModelDescription,
) -> Result<(), CalibrationError> {
    let (Some(unit), Some(other_unit)) = (parameter.unit(description), other.unit(description)) else {
        return Ok(());
    };
    let is_equal = tie.factor == 1.0 && tie.offset == 0.0;
    let is_like = unit == other_unit
        || match UnitConversion::between(unit, other_unit) {
            Ok(conversion) => conversion.is_identity() || !is_equal,
            Err(reason) => !matches!(reason, UnitError::Dimension { .. }),
        };
    if is_like {
        return Ok(());
    }
    let (name, to) = (parameter.name().to_owned(), &tie.to);
    let message = format!(
        "is in '{unit}', but '{to}', to which it is tied, is in '{other_unit}'. Set across_units = true if the factor {} converts one \
         to the other",
        Number(tie.factor)
    );
    Err(CalibrationError::Parameter { name, message })
}
