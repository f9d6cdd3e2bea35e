//! Export of a fit as tables: comma-separated values (RFC 4180) for spreadsheets and other programs.

use super::files::{check_belongs, write};
use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use crate::problem::parameter::Parameter;
use crate::uncertainty::derived_value::DerivedValue;
use base::RunContext;
use dfo::Outcome;
use std::path::Path;

/// Kind of table of a fit. Names of the model and of the recordings are not escaped. A spreadsheet interprets
/// a cell that begins with `=`, `+`, `-` or `@` as a formula, so import tables of untrusted models as text.
/// Numbers have enough digits to be read back exactly. Missing numbers are empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Table {
    /// A row for each entry of `x`: name, value, standard errors (if the fit has them), start, bounds, unit,
    /// and the bound at which it ended. Then a row for each derived parameter: name, unit, bounds, the
    /// parameter that it is tied to, its formula, and the value, standard errors and start that follow.
    #[default]
    Parameters,
    /// A row for each measurement that counts: experiment, variable, column, unit, time in s, measured value,
    /// simulated value, weight, residual.
    Trajectories,
    /// A row for each evaluation: number, batch, a flag that is true if the method used it, cost, the lower
    /// bound of the cost if the evaluation was stopped early, seconds, the reason for a failure, and the
    /// values of the parameters.
    Trace,
}

impl Fit {
    /// Returns a table of the fit as text. The context can end the simulations for the trajectories.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Setup`] if the fit does not belong to this calibration. Also returns the
    /// errors of simulating.
    pub fn csv(
        &self,
        calibration: &Calibration,
        table: Table,
        context: &RunContext<'_>,
    ) -> Result<String, CalibrationError> {
        check_belongs(self, calibration)?;
        let rows = match table {
            Table::Parameters => self.parameter_rows(calibration),
            Table::Trajectories => self.trajectory_rows(calibration, context)?,
            Table::Trace => self.trace_rows(),
        };
        let mut writer = csv::Writer::from_writer(Vec::new());
        let failed =
            |e: &dyn std::fmt::Display| CalibrationError::Setup(format!("the table cannot be written: {e}"));
        rows.into_iter().try_for_each(|row| writer.write_record(row)).map_err(|e| failed(&e))?;
        let bytes = writer.into_inner().map_err(|e| failed(&e))?;
        String::from_utf8(bytes).map_err(|e| failed(&e))
    }

    /// Writes a table to a file atomically.
    ///
    /// # Errors
    /// Returns the errors of [`csv`](Self::csv) and [`fmi::FmiError::Io`].
    pub fn write_csv(
        &self,
        calibration: &Calibration,
        path: impl AsRef<Path>,
        table: Table,
        context: &RunContext<'_>,
    ) -> Result<(), CalibrationError> {
        write(path.as_ref(), calibration, self.csv(calibration, table, context)?.as_bytes())
    }

    fn parameter_rows(&self, calibration: &Calibration) -> Vec<Vec<String>> {
        let header = [
            "name",
            "value",
            "standard_error",
            "uncorrected_error",
            "start",
            "lower",
            "upper",
            "unit",
            "at_bound",
            "tied_to",
            "expr",
        ];
        let row = |(k, p): (usize, &Parameter)| {
            let uncertainty = self.uncertainty.as_ref();
            let error = uncertainty.map(|uncertainty| uncertainty.standard_errors[k]);
            let uncorrected = uncertainty
                .and_then(crate::uncertainty::result::Uncertainty::uncorrected_errors)
                .map(|errors| errors[k]);
            let side = self.at_bound.iter().find(|(index, _)| *index == k).map(|(_, side)| side.name());
            vec![
                p.name().to_owned(),
                number(self.x[k]),
                error.map_or_else(String::new, number),
                uncorrected.map_or_else(String::new, number),
                number(self.start[k]),
                number(p.lower()),
                number(p.upper()),
                unit_of(p, calibration).unwrap_or_default(),
                side.unwrap_or_default().to_owned(),
                String::new(),
                String::new(),
            ]
        };
        let derived = |derived: &DerivedValue| {
            let uncertainty = self.uncertainty.as_ref();
            let error = uncertainty.map(|uncertainty| derived.standard_error(uncertainty));
            let uncorrected = uncertainty.and_then(|uncertainty| derived.uncorrected_error(uncertainty));
            let bound = |bound: f64| if bound.is_finite() { number(bound) } else { String::new() };
            vec![
                derived.name.clone(),
                number(derived.value),
                error.map_or_else(String::new, number),
                uncorrected.map_or_else(String::new, number),
                number(derived.start),
                bound(derived.bounds.0),
                bound(derived.bounds.1),
                derived.unit.clone().unwrap_or_default(),
                String::new(),
                derived.tied_to.clone().unwrap_or_default(),
                derived.expression.clone(),
            ]
        };
        let rows = calibration.parameters().iter().enumerate().map(row);
        let rows = rows.chain(self.derived.iter().map(derived));
        std::iter::once(header.map(str::to_owned).to_vec()).chain(rows).collect()
    }

    fn trajectory_rows(
        &self,
        calibration: &Calibration,
        context: &RunContext<'_>,
    ) -> Result<Vec<Vec<String>>, CalibrationError> {
        let header = [
            "experiment",
            "variable",
            "column",
            "unit",
            "time",
            "measured",
            "simulated",
            "weight",
            "residual",
        ];
        let trajectories = calibration.simulate(&self.x, None, context)?;
        let layout = self.residual_layout(calibration);
        let residuals = calibration.residuals(&self.x, context)?;
        let residuals = layout.reweighed(&residuals, calibration.residual_layout());
        let names = calibration.problem().experiment_names();
        let mut rows = vec![header.map(str::to_owned).to_vec()];
        match calibration.fmu().description().time_unit() {
            "s" => {}
            unit => rows[0][4] = format!("time [{unit}]"),
        }
        for output in &layout.outputs {
            let trajectory = &trajectories[output.experiment];
            let column = trajectory.columns.get(output.output);
            let variable = calibration.fmu().description().variable(&output.variable);
            let unit = variable.and_then(|variable| variable.unit.clone()).unwrap_or_default();
            for (k, index) in output.range.clone().enumerate() {
                let at = trajectory.time.partition_point(|time| *time < output.times[k]);
                let simulated = column.and_then(|column| column.get(at)).copied();
                rows.push(vec![
                    names[output.experiment].clone(),
                    output.variable.clone(),
                    output.column.clone(),
                    unit.clone(),
                    number(output.times[k]),
                    number(output.value(output.measured[k])),
                    simulated.map_or_else(String::new, number),
                    number(output.weights[k]),
                    number(residuals[index]),
                ]);
            }
        }
        Ok(rows)
    }

    fn trace_rows(&self) -> Vec<Vec<String>> {
        let header = ["evaluation", "batch", "used", "cost", "above", "seconds", "message"];
        let trace = &self.report.trace;
        let row = |entry: dfo::TraceEntry<'_>| {
            let (cost, above, message) = match entry.outcome {
                Outcome::Value(cost) => (number(*cost), String::new(), String::new()),
                Outcome::Above(cutoff) => (String::new(), number(*cutoff), String::new()),
                Outcome::Failed(failure) => (String::new(), String::new(), failure.message.clone()),
                Outcome::Abort(message) => (String::new(), String::new(), message.clone()),
                _ => Default::default(),
            };
            let used = if entry.used { "true" } else { "false" };
            let [id, batch] = [entry.id, entry.batch].map(|number| number.to_string());
            let first = [id, batch, used.to_owned(), cost, above, number(entry.seconds), message];
            first.into_iter().chain(entry.x.iter().map(|value| number(*value))).collect()
        };
        let header = header.iter().copied().chain(self.names.iter().map(String::as_str)).map(str::to_owned);
        let rows = trace.iter().chain(trace.speculative()).map(row);
        std::iter::once(header.collect()).chain(rows).collect()
    }
}

/// Returns the unit of the values of a parameter, if it is known.
pub(super) fn unit_of(parameter: &Parameter, calibration: &Calibration) -> Option<String> {
    let of_variable = || {
        let variable = calibration.fmu().description().variable(parameter.variable()?)?;
        variable.unit.clone()
    };
    parameter.given_unit().map(str::to_owned).or_else(of_variable)
}

/// Returns the shortest text that represents the number exactly.
fn number(value: f64) -> String {
    match value {
        value if value.is_nan() => String::new(),
        f64::INFINITY => "inf".to_owned(),
        f64::NEG_INFINITY => "-inf".to_owned(),
        value => format!("{value:?}"),
    }
}
