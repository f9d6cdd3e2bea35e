//! Recorded columns in the units of the variables that they measure or drive.

use crate::data::{Data, Unit, UnitConversion, UnitError, listed, parts};
use crate::error::CalibrationError;
use crate::problem::definition::Problem;
use crate::problem::experiment::Experiment;
use crate::problem::warning::SetupWarning;
use fmi::ModelDescription;
use fmi::description::{Causality, Variable};

/// Converts the columns that state a unit to the units of their variables, where both are known; they state
/// the unit of the variable then, so that nothing is converted twice. What is not converted comes back.
///
/// # Errors
/// A column and its variable have units of different quantities; a unit that is not known, where the model
/// states one; two variables with different units have one column.
pub(crate) fn convert_columns(
    problem: &mut Problem,
    description: &ModelDescription,
) -> Result<Vec<SetupWarning>, CalibrationError> {
    let mut warnings = Vec::new();
    for k in 0..problem.experiments.len() {
        let found = convert(&mut problem.experiments[k], description);
        let found = found.map_err(|error| problem.error_in(k, error))?;
        warnings.extend(found.into_iter().map(|warning| problem.warning_in(k, warning)));
    }
    Ok(warnings)
}

fn convert(
    experiment: &mut Experiment,
    description: &ModelDescription,
) -> Result<Vec<SetupWarning>, CalibrationError> {
    let (mut warnings, mut converted) = (Vec::new(), Vec::new());
    // Columns that have been looked at, with the variable that they were converted for.
    let mut seen: Vec<(String, String)> = Vec::new();
    for (variable_name, column) in experiment.columns_in_use() {
        let data = &mut experiment.data;
        let Some(variable) = declared(description, &variable_name) else { continue };
        let Some(full) = data.full_name(&column).map(str::to_owned) else { continue };
        // The name of a variable may end with what looks like a unit; a line of units is none.
        let is_variable = description.variable(&full).is_some();
        let beside = data.unit_beside_name(&column);
        let given = if is_variable { beside } else { data.unit(&column) };
        let Some(given) = given.map(str::to_owned) else { continue };
        let bad = |message: String| CalibrationError::Data { source_name: data.source().to_owned(), message };
        let earlier = seen.iter().find(|(name, _)| *name == full).map(|(_, variable)| variable);
        match UnitConversion::to_variable(&given, variable, description) {
            Ok(conversion) if conversion.is_identity() => {}
            Ok(conversion) => {
                let unit = variable.unit.clone().unwrap_or_default();
                if let Some(other) = earlier {
                    return Err(bad(format!(
                        "column '{full}' belongs to '{other}' (in {given}) and to '{variable_name}' (in {unit}): give each a column \
                         of its own"
                    )));
                }
                data.convert(&column, conversion, &unit);
                converted.push((full.clone(), given, unit));
            }
            Err(reason @ UnitError::Dimension { .. }) => {
                return Err(bad(format!(
                    "column '{full}' belongs to '{variable_name}', but {reason}: correct the unit of the column, or choose the variable \
                     that it measures or drives"
                )));
            }
            // Models without units are mostly in those of the SI.
            Err(UnitError::NotStated { .. }) if Unit::parse(&given).is_ok_and(|unit| unit.is_coherent()) => {}
            // With the raw values a fit would converge at a wrong point.
            Err(reason @ UnitError::Unknown { .. }) if Unit::parse(&given).is_err() => {
                let unit = variable.unit.as_deref().unwrap_or_default();
                return Err(bad(format!(
                    "column '{full}' belongs to '{variable_name}' (in {unit}), but {reason}: correct the unit of the column, or rename the \
                     column if this is none"
                )));
            }
            Err(reason) => warnings.push(SetupWarning::NotConverted {
                data: data.source().to_owned(),
                column: full.clone(),
                variable: variable_name.clone(),
                reason,
            }),
        }
        seen.push((full, variable_name));
    }
    if !converted.is_empty() {
        let data = experiment.data.source().to_owned();
        warnings.push(SetupWarning::Converted { data, columns: converted });
    }
    Ok(warnings)
}

/// An input of a model, and the column that drives it.
pub type InputColumn = (String, String);

/// The recording with those of its columns that have the names of inputs of a model (units may follow the
/// name) in the units of these; which they are; and what could not be converted.
///
/// # Errors
/// No column has the name of an input; a unit is one of another quantity, or not known.
pub fn recorded_inputs(
    data: Data,
    description: &ModelDescription,
) -> Result<(Data, Vec<InputColumn>, Vec<SetupWarning>), CalibrationError> {
    let is_input = |name: &&str| declared(description, name).is_some_and(|v| v.causality == Causality::Input);
    let driven = |column: &str| [column, parts(column).0].into_iter().find(is_input).map(str::to_owned);
    let pairs: Vec<InputColumn> =
        data.names().filter_map(|column| Some((driven(column)?, column.to_owned()))).collect();
    if pairs.is_empty() {
        let inputs = description.variables.iter().filter(|v| v.causality == Causality::Input);
        let message = format!(
            "no column has the name of an input of the model; the columns are {}, the inputs {}",
            listed(data.all_names()),
            listed(inputs.map(|v| v.name.as_str()))
        );
        return Err(CalibrationError::Data { source_name: data.source().to_owned(), message });
    }
    let mut experiment = Experiment::new(data);
    for (variable, column) in &pairs {
        experiment = experiment.input(variable, column);
    }
    let warnings = convert(&mut experiment, description)?;
    Ok((experiment.data, pairs, warnings))
}

/// The variable of a name, which may be that of an element of an array.
pub(crate) fn declared<'d>(description: &'d ModelDescription, name: &str) -> Option<&'d Variable> {
    let array = || name.strip_suffix(']').and_then(|rest| rest.rsplit_once('['));
    description.variable(name).or_else(|| description.variable(array()?.0))
}
