//! Conversion of recorded columns to the units of the variables that they measure or drive.

use crate::data::{Data, TimeUnit, Unit, UnitConversion, UnitError, find_column, listed, parts};
use crate::error::CalibrationError;
use crate::problem::definition::Problem;
use crate::problem::error_model::{Coefficient, ErrorModel};
use crate::problem::experiment::{Experiment, Measured, Sigma, Weight};
use crate::problem::measurements::{is_mask, weights_of_rows};
use crate::problem::warning::SetupWarning;
use fmi::description::{Causality, Variable, VariableKind};
use fmi::{ModelDescription, Value};

/// Converts columns with a declared unit to the units of their variables, if both units are known. A
/// converted column then declares the unit of the variable, so that it is not converted twice. Returns
/// warnings about unconverted columns.
///
/// # Errors
/// Returns an error if:
/// - a column has two units,
/// - the units of a column and its variable measure different quantities,
/// - the unit of a column is unknown, but the model declares one,
/// - two variables with different units share a column.
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
    // Columns processed so far, with their variables.
    let mut seen: Vec<(String, String)> = Vec::new();
    for (variable_name, column) in experiment.columns_in_use() {
        let data = &mut experiment.data;
        let Some(variable) = declared(description, &variable_name) else { continue };
        let Some(full) = data.full_name(&column).map(str::to_owned) else { continue };
        // The name of a variable may end with text that looks like a unit. A line of units is
        // unambiguous.
        let is_variable = description.variable(&full).is_some();
        if !is_variable {
            data.check_units(&column)?;
        }
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
                        "column '{full}' belongs to '{other}' (in {given}) and to '{variable_name}' (in {unit}). Use separate columns"
                    )));
                }
                convert_weights(experiment, &full, conversion)?;
                experiment.data.convert(&column, conversion, &unit);
                converted.push((full.clone(), given, unit));
            }
            Err(reason @ UnitError::Dimension { .. }) => {
                return Err(bad(format!(
                    "column '{full}' belongs to '{variable_name}', but {reason}. Correct the unit of the column, or choose another \
                     variable"
                )));
            }
            // Models without declared units mostly use SI units.
            Err(UnitError::NotStated { .. }) if Unit::parse(&given).is_ok_and(|unit| unit.is_coherent()) => {}
            // With unconverted values, a fit would converge to a wrong point.
            Err(reason @ UnitError::Unknown { .. }) if Unit::parse(&given).is_err() => {
                let unit = variable.unit.as_deref().unwrap_or_default();
                return Err(bad(format!(
                    "column '{full}' belongs to '{variable_name}' (in {unit}), but {reason}. Correct the unit of the column, or \
                     rename the column if this is not a unit"
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

/// Converts the weights of the outputs that a column measured. Weights are 1 over the standard deviation in
/// the unit of the column. The weight 1 does not declare noise and remains unchanged.
fn convert_weights(
    experiment: &mut Experiment,
    column: &str,
    conversion: UnitConversion,
) -> Result<(), CalibrationError> {
    for k in 0..experiment.outputs.len() {
        let Measured { variable, column: column_name, weight } = &experiment.outputs[k];
        if weight.states_noise() && experiment.data.full_name(column_name) == Some(column) {
            if let Some(model) = weight.error_model() {
                let model = converted_model(model, variable, column, conversion)?;
                experiment.outputs[k].weight = Sigma::Model(model).into();
                continue;
            }
            let weights = weights_of_rows(experiment, variable, column_name, weight)?;
            let is_noise_known = weight.is_known_noise();
            if is_mask(&weights) && !is_noise_known {
                continue;
            }
            let factor = conversion.apply_to_difference(1.0).abs();
            let converted: Vec<f64> = weights.iter().map(|weight| weight / factor).collect();
            experiment.outputs[k].weight = match is_noise_known {
                true => Sigma::of_weights(&converted).into(),
                false => Weight::Rows(converted.into()),
            };
        }
    }
    Ok(())
}

/// Converts an error model to the unit of the variable. Estimated coefficients need no conversion.
fn converted_model(
    model: &ErrorModel,
    variable: &str,
    column: &str,
    conversion: UnitConversion,
) -> Result<ErrorModel, CalibrationError> {
    let is_proportional = model.proportional.stated() != Some(0.0);
    if is_proportional && conversion.apply(0.0) != 0.0 {
        return Err(CalibrationError::Setup(format!(
            "sigma '{model}' of '{variable}' depends on abs(y), but the unit of column '{column}' has a different zero. Convert the column to the \
             unit of the variable"
        )));
    }
    let factor = conversion.apply_to_difference(1.0).abs();
    let constant = match &model.constant {
        Coefficient::Stated(a) => Coefficient::Stated(a * factor),
        fitted => fitted.clone(),
    };
    Ok(ErrorModel { constant, ..model.clone() })
}

/// An input of a model and the column that drives it.
pub type InputColumn = (String, String);

/// Selects the columns that drive a model: those named after an input or a tunable parameter, converted to
/// its unit. Times are converted to the time unit of the model. Units may follow the name. The case may
/// differ if only one column and one input match.
///
/// Returns the recording, the selected columns, and warnings. The warnings report columns that could not be
/// converted, and inputs without a column, unless the input is listed in `given`.
///
/// # Errors
/// Returns an error if no column has the name of an input, or if several columns match one input. Returns an
/// error if a column has two units, a unit of another quantity, or an unknown unit.
pub fn recorded_inputs(
    mut data: Data,
    description: &ModelDescription,
    given: &[String],
) -> Result<(Data, Vec<InputColumn>, Vec<SetupWarning>), CalibrationError> {
    data.convert_times(&TimeUnit::of_model(description))?;
    let bad = |message: String| CalibrationError::Data { source_name: data.source().to_owned(), message };
    let inputs = || description.variables.iter().filter(|v| v.causality == Causality::Input);
    let pairs = input_columns(&data, description).map_err(bad)?;
    if pairs.is_empty() {
        let inputs = match inputs().next() {
            None => "the model has no inputs".to_owned(),
            Some(_) => format!("the inputs are {}", listed(inputs().map(|v| v.name.as_str()))),
        };
        return Err(bad(format!(
            "no column has the name of an input of the model; the columns are {}, and {inputs}. Rename the columns to the inputs, \
             optionally with units in brackets",
            listed(data.all_names())
        )));
    }
    let without_column: Vec<(String, Option<Value>)> = inputs()
        .filter(|v| {
            v.kind != VariableKind::Clock && !is_driven(description, &pairs, v) && !given.contains(&v.name)
        })
        .map(|v| (v.name.clone(), v.start.clone()))
        .collect();
    let mut experiment = Experiment::new(data);
    for (variable, column) in &pairs {
        experiment = experiment.input(variable, column);
    }
    let mut warnings = convert(&mut experiment, description)?;
    let data = experiment.data;
    if !without_column.is_empty() {
        let columns = data.all_names().map(str::to_owned).collect();
        let source = data.source().to_owned();
        warnings.push(SetupWarning::WithoutColumn { data: source, inputs: without_column, columns });
    }
    Ok((data, pairs, warnings))
}

/// Returns the inputs and tunable parameters whose names columns have, with these columns.
fn input_columns(data: &Data, description: &ModelDescription) -> Result<Vec<InputColumn>, String> {
    let can_drive = |v: &Variable| v.causality == Causality::Input || v.is_tunable_parameter();
    let is_input = |name: &&str| declared(description, name).is_some_and(can_drive);
    let driven = |column: &str| [column, parts(column).0].into_iter().find(is_input).map(str::to_owned);
    let mut pairs: Vec<InputColumn> = Vec::new();
    for (variable, column) in data.names().filter_map(|column| Some((driven(column)?, column))) {
        if pairs.iter().any(|(earlier, _)| *earlier == variable) {
            // Use the column with exactly this name; otherwise return an error.
            let index = find_column(data.names(), &variable)?;
            let whole = data.names().nth(index).unwrap_or(column).to_owned();
            pairs
                .iter_mut()
                .filter(|(earlier, _)| *earlier == variable)
                .for_each(|pair| pair.1.clone_from(&whole));
        } else {
            pairs.push((variable, column.to_owned()));
        }
    }
    // Names in a model are case-sensitive, but names in a recording often are not.
    let inputs = || description.variables.iter().filter(|v| v.causality == Causality::Input);
    let open: Vec<&str> =
        inputs().filter(|v| !is_driven(description, &pairs, v)).map(|v| v.name.as_str()).collect();
    let is_free =
        |column: &&str| [column, parts(column).0].iter().all(|name| declared(description, name).is_none());
    let free: Vec<&str> = data.names().filter(is_free).collect();
    for input in &open {
        let is_meant = |column: &&&str| {
            parts(column).0.eq_ignore_ascii_case(input) || column.eq_ignore_ascii_case(input)
        };
        let columns: Vec<_> = free.iter().filter(is_meant).collect();
        let n_inputs = inputs().filter(|v| v.name.eq_ignore_ascii_case(input)).count();
        if let ([column], 1) = (&columns[..], n_inputs) {
            pairs.push(((*input).to_owned(), (**column).to_owned()));
        }
    }
    Ok(pairs)
}

/// True if a column drives an input or an element of it.
fn is_driven(description: &ModelDescription, pairs: &[InputColumn], input: &Variable) -> bool {
    let is_it = |name: &str| declared(description, name).is_some_and(|driven| std::ptr::eq(driven, input));
    pairs.iter().any(|(name, _)| is_it(name))
}

/// Returns the variable with this name, or the array variable that an element with this name belongs to.
pub(crate) fn declared<'d>(description: &'d ModelDescription, name: &str) -> Option<&'d Variable> {
    let array = || name.strip_suffix(']').and_then(|rest| rest.rsplit_once('['));
    description.variable(name).or_else(|| description.variable(array()?.0))
}
