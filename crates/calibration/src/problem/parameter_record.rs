//! Parameters as users describe them by name: one record for Python, files and the command line.

use crate::error::CalibrationError;
use crate::problem::parameter::{Parameter, Scale, Target, Tie};
use crate::problem::prior::Prior;
use dfo::{ParameterKind, Record, Value, read_record};
use serde::{Deserialize, Serialize};

/// Description of a parameter by name; see [`Parameter::from_record`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ParameterRecord {
    /// Name. It is also the variable of the model to set, unless `variables`, `delay_of` or `offset_of` is
    /// given.
    name: String,
    /// Start value of the search.
    start: Option<f64>,
    /// Lower bound; default: none.
    lower: Option<f64>,
    /// Upper bound; default: none.
    upper: Option<f64>,
    /// Scale of the search.
    scale: Scale,
    /// A typical size.
    nominal: Option<f64>,
    /// Kind of values.
    kind: ParameterKind,
    /// Fixes the parameter at its start value.
    fixed: bool,
    /// Uses a separate value in each experiment.
    local: bool,
    /// Variables of the model to set.
    variables: Option<Vec<String>>,
    /// The output or input that the parameter delays, in s.
    #[cfg_attr(feature = "schema", schemars(with = "Option<String>"))]
    delay_of: Value,
    /// The output or input that the parameter is added to.
    offset_of: Option<String>,
    /// The parameter to follow: the value is factor * value + offset.
    tied_to: Option<String>,
    /// Factor of the followed parameter.
    factor: f64,
    /// Offset from the followed parameter.
    offset: f64,
    /// True if the factor has a unit.
    across_units: bool,
    /// Unit of the values, if it differs from the unit of the variable.
    unit: Option<String>,
    /// Name in reports and figures.
    display_name: Option<String>,
    /// Knowledge of the parameter before the fit.
    prior: Option<Prior>,
}

impl Default for ParameterRecord {
    fn default() -> Self {
        Self {
            name: String::new(),
            start: None,
            lower: None,
            upper: None,
            scale: Scale::Linear,
            nominal: None,
            kind: ParameterKind::Continuous,
            fixed: false,
            local: false,
            variables: None,
            delay_of: Value::Nothing,
            offset_of: None,
            tied_to: None,
            factor: 1.0,
            offset: 0.0,
            across_units: false,
            unit: None,
            display_name: None,
            prior: None,
        }
    }
}

impl Parameter {
    /// Creates the parameter of a record. The fields are `name`, `start`, `lower`, `upper`, `scale`,
    /// `nominal`, `kind`, `fixed`, `local`, `unit`, `display_name` and `prior`. At most one of `variables`,
    /// `delay_of` and `offset_of` can be given. A tied parameter has `tied_to` with `factor`, `offset` and
    /// `across_units` instead of a start.
    ///
    /// # Errors
    /// Returns an error if a field has an invalid value, and the errors of [`check`](Self::check).
    pub fn from_record(record: &Record) -> Result<Self, CalibrationError> {
        let asked: ParameterRecord = read_record(record, "field of a parameter")?;
        let name = asked.name;
        let bad = |message: &str| {
            Err(CalibrationError::Parameter { name: name.clone(), message: message.to_owned() })
        };
        let is_plain = (asked.factor, asked.offset, asked.across_units) == (1.0, 0.0, false);
        let mut parameter = match (asked.tied_to, asked.start) {
            (Some(to), None) => {
                Self::tied(&name, to, asked.factor, asked.offset).across_units(asked.across_units)
            }
            (Some(_), Some(_)) => {
                return bad("it is tied to another parameter, which determines the start. Omit start");
            }
            (None, None) => return bad("start is missing. Specify a start value"),
            (None, Some(_)) if !is_plain => {
                return bad(
                    "factor, offset and across_units require tied_to. Specify the parameter to which it is tied",
                );
            }
            (None, Some(start)) => Self::new(&name, start),
        };
        parameter = parameter
            .bounds(asked.lower.unwrap_or(f64::NEG_INFINITY), asked.upper.unwrap_or(f64::INFINITY))
            .scale(asked.scale)
            .kind(asked.kind)
            .fixed(asked.fixed)
            .local(asked.local);
        let delay_of = match asked.delay_of {
            Value::Nothing => None,
            Value::Text(variable) => Some(variable),
            Value::List(_) => {
                return bad(
                    "delay_of names one output or input. For a common delay of several, tie the parameters of the others with \
                     tied_to; write known delays in delays of the recording",
                );
            }
            other => return bad(&format!("delay_of must be the name of an output or input, not {other}")),
        };
        parameter = match (asked.variables, delay_of, asked.offset_of) {
            (None, None, None) => parameter,
            (Some(variables), None, None) => parameter.variables(variables),
            (None, Some(variable), None) => parameter.delay_of(variable),
            (None, None, Some(variable)) => parameter.offset_of(variable),
            _ => {
                return bad(
                    "variables, delay_of and offset_of exclude each other. Specify at most one of them",
                );
            }
        };
        if let Some(nominal) = asked.nominal {
            parameter = parameter.nominal(nominal);
        }
        if let Some(unit) = asked.unit {
            parameter = parameter.in_unit(unit);
        }
        if let Some(shown) = asked.display_name {
            parameter = parameter.display_name(shown);
        }
        if let Some(prior) = asked.prior {
            parameter = parameter.prior(prior);
        }
        parameter.check()?;
        Ok(parameter)
    }

    /// Returns the record of the parameter, with all fields.
    ///
    /// # Errors
    /// Returns an error if the parameter cannot be serialised.
    pub fn record(&self) -> Result<Record, CalibrationError> {
        let is_given = |bound: &f64| bound.is_finite();
        let (lower, upper) = self.given_bounds();
        let mut record = ParameterRecord {
            name: self.name().to_owned(),
            scale: self.scale_kind(),
            nominal: self.nominal_size(),
            kind: self.value_kind(),
            fixed: self.is_fixed(),
            local: self.is_local(),
            unit: self.given_unit().map(str::to_owned),
            display_name: Some(self.shown_name().to_owned()).filter(|shown| shown != self.name()),
            prior: self.known_prior().copied(),
            ..ParameterRecord::default()
        };
        match self.target() {
            Target::Variables(variables) if variables.as_slice() == [self.name()] => {}
            Target::Variables(variables) => record.variables = Some(variables.clone()),
            Target::Delay(variable) => record.delay_of = Value::Text(variable.clone()),
            Target::Offset(variable) => record.offset_of = Some(variable.clone()),
        }
        match self.tie() {
            Some(Tie { to, factor, offset, across_units }) => {
                record.tied_to = Some(to.clone());
                (record.factor, record.offset, record.across_units) = (*factor, *offset, *across_units);
            }
            None => {
                record.start = Some(self.start());
                (record.lower, record.upper) = (Some(lower).filter(is_given), Some(upper).filter(is_given));
            }
        }
        match Value::of(&record)? {
            Value::Record(record) => Ok(record),
            _ => Ok(Record::new()),
        }
    }
}
