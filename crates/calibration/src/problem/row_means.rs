//! Replacement of the rows of recordings by means, and the weights of these means.

use crate::data::{Means, Series};
use crate::error::CalibrationError;
use crate::problem::column_units::declared;
use crate::problem::experiment::{Experiment, Measured, Sigma, Weight};
use crate::problem::measurements::{is_mask, weights_of_rows};
use fmi::ModelDescription;
use fmi::description::VariableKind;

/// Replaces the rows of a recording by means if the experiment specifies an interval. Weights of rows that
/// declare noise become weights of the means: the root of the sum of their squares. Weights that are only 0
/// and 1 select the rows to average. Columns that drive inputs with discrete values (Boolean, integer) are
/// not averaged: they keep their values and the times of their changes. The same applies to held inputs.
///
/// # Errors
/// Returns the errors of [`Data::resampled`](crate::Data::resampled). Returns an error if weights are
/// invalid, or if two outputs with different weights share a column.
pub(crate) fn take_means(
    experiment: &mut Experiment,
    description: &ModelDescription,
) -> Result<(), CalibrationError> {
    let Some(interval) = experiment.resample else { return Ok(()) };
    let names: Vec<String> = experiment.data.names().map(str::to_owned).collect();
    let place = |column: &str| {
        let full = experiment.data.full_name(column)?;
        names.iter().position(|name| name == full)
    };
    // Weights of the rows, per column.
    let mut weighted: Vec<Option<Series>> = vec![None; names.len()];
    for Measured { variable, column, weight } in experiment.outputs.iter().filter(|o| o.weight.states_noise())
    {
        let weights = weights_of_rows(experiment, variable, column, weight)?;
        let Some(place) = place(column) else { continue };
        if weighted[place].as_ref().is_some_and(|other| *other != weights) {
            return Err(CalibrationError::Setup(format!(
                "resample: column '{column}' is compared with two outputs that have different weights, so its means differ. Use a \
                 separate column for each output"
            )));
        }
        weighted[place] = Some(weights);
    }
    let is_held = |variable: &str| {
        let is_real = |kind| matches!(kind, VariableKind::Float32 | VariableKind::Real);
        declared(description, variable).is_some_and(|variable| !is_real(variable.kind))
    };
    let held: Vec<Option<usize>> = experiment
        .driving_columns()
        .filter(|(input, _)| is_held(input) || experiment.holds(input))
        .map(|(_, column)| place(column))
        .collect();
    let of_output: Vec<Option<usize>> =
        experiment.outputs.iter().map(|o| place(&o.column).filter(|_| o.weight.states_noise())).collect();
    let (data, weights) = experiment.data.clone().resampled(interval, |column| match &weighted[column] {
        Some(weights) => Means::Weighted(weights),
        None if held.contains(&Some(column)) => Means::Held,
        None => Means::Plain,
    })?;
    for (output, column) in experiment.outputs.iter_mut().zip(of_output) {
        if let Some(column) = column {
            if output.weight.is_known_noise() {
                output.weight = Sigma::of_weights(&weights[column]).into();
                continue;
            }
            let is_mask = weighted[column].as_ref().is_some_and(|weights| is_mask(weights));
            let counted = |weight: &f64| if is_mask { f64::from(u8::from(*weight > 0.0)) } else { *weight };
            output.weight = Weight::Rows(weights[column].iter().map(counted).collect());
        }
    }
    (experiment.data, experiment.resample) = (data, None);
    Ok(())
}
