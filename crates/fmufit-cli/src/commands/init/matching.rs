//! Matching of the columns of a recording with the variables that they measure or drive, by name.

use super::proposal::Proposed;
use crate::error::Error;
use calibration::{Data, find_column};
use fmi::description::{Causality, Variability};
use fmi::{Fmu, Variable};

/// A variable and a column.
pub(super) type Pair = (String, String);

/// Columns of a recording and their matches.
pub(super) struct Columns {
    pub(super) outputs: Vec<Pair>,
    pub(super) inputs: Vec<Pair>,
    /// Columns without a variable, each with candidate variables.
    pub(super) unmatched: Vec<(String, Vec<String>)>,
    /// Inputs without a column.
    pub(super) undriven: Vec<String>,
    /// Variables without a unit in the model, each with the unit of its column.
    pub(super) without_unit: Vec<Pair>,
}

impl Columns {
    /// Matches the columns that are not matched explicitly.
    pub(super) fn matched(
        fmu: &Fmu,
        data: &Data,
        outputs: Vec<Pair>,
        inputs: Vec<Pair>,
    ) -> Result<Self, Error> {
        let description = fmu.description();
        let mut given: Vec<&str> = Vec::new();
        for (variable, column) in outputs.iter().chain(&inputs) {
            if description.variable(variable).is_none() {
                let nearest = description.nearest_names(variable, 3).into_iter().map(str::to_owned).collect();
                return Err(Error::input(calibration::visible_error(&fmi::FmiError::UnknownVariable {
                    name: variable.clone(),
                    nearest,
                })));
            }
            let position = find_column(data.names(), column)
                .map_err(|message| Error::input(format!("{}: {message}", data.source())))?;
            given.extend(data.names().nth(position));
        }
        let mut columns = Self {
            outputs: outputs.to_vec(),
            inputs: inputs.to_vec(),
            unmatched: Vec::new(),
            undriven: Vec::new(),
            without_unit: Vec::new(),
        };
        for name in data.names() {
            let column = stem(name, data);
            if given.contains(&name) {
                continue;
            }
            let mut candidates = candidates(&column, &description.variables);
            candidates
                .retain(|variable| !outputs.iter().chain(&inputs).any(|(name, _)| *name == variable.name));
            match candidates[..] {
                [one] if one.causality == Causality::Input => columns.inputs.push((one.name.clone(), column)),
                [one] => columns.outputs.push((one.name.clone(), column)),
                ref several => {
                    let several = several.iter().map(|variable| variable.name.clone()).collect();
                    columns.unmatched.push((column, several));
                }
            }
        }
        let is_driven = |name: &str| columns.inputs.iter().any(|(input, _)| input == name);
        let inputs = description.variables.iter().filter(|variable| variable.causality == Causality::Input);
        columns.undriven =
            inputs.map(|variable| variable.name.clone()).filter(|name| !is_driven(name)).collect();
        let unit = |(variable, column): &Pair| {
            let stated = description.variable(variable)?.unit.as_deref().unwrap_or_default();
            data.unit(column).filter(|_| stated.is_empty()).map(|unit| (variable.clone(), unit.to_owned()))
        };
        columns.without_unit = columns.outputs.iter().chain(&columns.inputs).filter_map(unit).collect();
        Ok(columns)
    }

    pub(super) fn has_outputs(&self) -> bool {
        !self.outputs.is_empty()
    }

    /// Returns the counts as text.
    pub(super) fn summary(&self, proposed: &Proposed) -> String {
        let count = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
        let mut parts = vec![
            count(self.outputs.len(), "output"),
            count(self.inputs.len(), "input"),
            count(proposed.n_active(), "parameter"),
        ];
        if !self.unmatched.is_empty() {
            parts.push(format!("{} without a variable", count(self.unmatched.len(), "column")));
        }
        parts.join(", ")
    }
}

/// Returns the name of a column without its unit, if the short name still identifies the column.
fn stem(name: &str, data: &Data) -> String {
    let short = name.split(['[', '(']).next().unwrap_or(name).trim_end();
    match find_column(data.names(), short) {
        Ok(_) if !short.is_empty() => short.to_owned(),
        _ => name.to_owned(),
    }
}

/// Returns the variables that a column may belong to. Only the best kind of match is returned.
fn candidates<'v>(column: &str, variables: &'v [Variable]) -> Vec<&'v Variable> {
    let is_result = |variable: &&Variable| match variable.causality {
        Causality::Input | Causality::Output => true,
        Causality::Local => {
            variable.variability != Variability::Constant && variable.variability != Variability::Fixed
        }
        _ => false,
    };
    let all = || variables.iter().filter(is_result).filter(|variable| variable.kind.is_number());
    let is_outside = |variable: &&Variable| variable.causality != Causality::Local;
    let requested = folded(column);
    let kinds: [&dyn Fn(&str) -> bool; 3] =
        [&|name| name == column, &|name| folded(name) == requested, &|name| {
            name.rsplit_once('.').is_some_and(|(_, last)| folded(last) == requested)
        }];
    for is_match in kinds {
        let found: Vec<&Variable> = all().filter(|variable| is_match(&variable.name)).collect();
        // Variables for use outside the model take precedence.
        let outside: Vec<&Variable> = found.iter().copied().filter(is_outside).collect();
        if !outside.is_empty() {
            return outside;
        }
        if !found.is_empty() {
            return found;
        }
    }
    Vec::new()
}

/// Returns a name in lower case without separators, to compare spellings.
fn folded(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}
