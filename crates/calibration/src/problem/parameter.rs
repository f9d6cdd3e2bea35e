//! Parameters of a fit: a value with a start, bounds and scale, and its target in the model. Python, files
//! and the command line describe parameters by the fields of one serde type.

use crate::error::CalibrationError;
use crate::expression::Expression;
use crate::problem::prior::Prior;
use base::Number;
pub use dfo::Transform as Scale;
use dfo::{ParameterKind, Record, Value, read_record};
use fmi::ModelDescription;
use serde::{Deserialize, Serialize, Serializer, ser};

/// Target of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target<'a> {
    /// Variables of the model, all set to the same value. They are parameters, or variables with a start
    /// value. States are referred to by their names.
    Variables(&'a [String]),
    /// Delay of a compared output or of an input, in the time unit of the model: `y(t - delay)`.
    Delay(&'a str),
    /// Offset that is added to a compared output or to an input.
    Offset(&'a str),
    /// Factor that multiplies a compared output or an input, before the offset is added.
    Factor(&'a str),
}

/// Dependence of a parameter on another one: `factor * value + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tie<'a> {
    /// Name of the parameter that this one follows.
    pub to: &'a str,
    /// Factor of the value of the other parameter.
    pub factor: f64,
    /// Offset, in the unit of the tied parameter.
    pub offset: f64,
    /// True if the factor has a unit, so that the units of the two parameters may differ.
    pub across_units: bool,
}

/// A parameter to be fitted.
///
/// ```
/// use calibration::{Parameter, Prior};
/// let friction = Parameter::new("armFriction", 0.012).bounds(0.0, 0.022);
/// assert_eq!(friction.upper(), 0.022);
/// // One value with a prior for two variables; a delay; a value that is tied to another one.
/// let outlet = Parameter::new("outlet", 3e-6).variables(["qt.a1", "qt.a2"]).prior(Prior::LogNormal { median: 3e-6, sigma: 0.1 });
/// let delay = Parameter::new("tau", 0.05).bounds(0.0, 1.0).delay_of("armJoint.phi");
/// let other = Parameter::tied("qt.a3", "outlet", 0.5, 0.0);
/// let last = Parameter::derived("qt.a4", "2e-6 - outlet / 2")?.bounds(0.0, 1e-6);
/// assert_eq!((outlet.name(), delay.name(), other.is_derived()), ("outlet", "tau", true));
/// # Ok::<(), calibration::CalibrationError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(description = "A parameter to be fitted."))]
#[serde(default, deny_unknown_fields)]
pub struct Parameter {
    /// Name. It is also the variable of the model to set, unless `variables`, `delay_of`, `offset_of` or
    /// `factor_of` is given.
    pub(super) name: String,
    /// Start value of the search.
    #[serde(serialize_with = "finite")]
    pub(super) start: Option<f64>,
    /// Lower bound; default: none.
    #[serde(serialize_with = "finite")]
    pub(super) lower: Option<f64>,
    /// Upper bound; default: none.
    #[serde(serialize_with = "finite")]
    pub(super) upper: Option<f64>,
    /// Scale of the search.
    pub(super) scale: Scale,
    /// A typical size.
    #[serde(serialize_with = "finite")]
    pub(super) nominal: Option<f64>,
    /// Kind of values.
    pub(super) kind: ParameterKind,
    /// Fixes the parameter at its start value.
    pub(super) fixed: bool,
    /// True if the parameter is an angle, whose bounds are the same point.
    pub(super) periodic: bool,
    /// Uses a separate value in each experiment.
    pub(super) local: bool,
    /// Names of the experiments in which it acts; default: all.
    pub(super) experiments: Option<Vec<String>>,
    /// Variables of the model to set; if empty, only formulas use the parameter.
    pub(super) variables: Option<Vec<String>>,
    /// The output or input that the parameter delays.
    pub(super) delay_of: Option<String>,
    /// The output or input that the parameter is added to.
    pub(super) offset_of: Option<String>,
    /// The output or input that the parameter multiplies, before an offset is added.
    pub(super) factor_of: Option<String>,
    /// The parameter to follow: the value is factor * value + offset.
    pub(super) tied_to: Option<String>,
    /// Factor of the followed parameter.
    pub(super) factor: f64,
    /// Offset from the followed parameter.
    pub(super) offset: f64,
    /// True if the factor has a unit.
    pub(super) across_units: bool,
    /// Formula of a derived parameter over other parameters, such as `1 - k1 - k2`.
    pub(super) expr: Option<Expression>,
    /// Unit of the values, if it differs from the unit of the variable.
    pub(super) unit: Option<String>,
    /// Name in reports and figures.
    pub(super) display_name: Option<String>,
    /// Knowledge of the parameter before the fit.
    pub(super) prior: Option<Prior>,
}

/// Serialises a number. JSON has neither NaN nor infinities, and `null` means that no number is given.
fn finite<S: Serializer>(number: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    match number {
        Some(number) if !number.is_finite() => {
            Err(ser::Error::custom(format!("{} is not a finite number", Number(*number))))
        }
        number => number.serialize(serializer),
    }
}

impl Default for Parameter {
    /// Returns a parameter without a name and a start value, which every use requires.
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
            periodic: false,
            local: false,
            experiments: None,
            variables: None,
            delay_of: None,
            offset_of: None,
            factor_of: None,
            tied_to: None,
            factor: 1.0,
            offset: 0.0,
            across_units: false,
            expr: None,
            unit: None,
            display_name: None,
            prior: None,
        }
    }
}

/// Range of a periodic parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cycle {
    lower: f64,
    upper: f64,
}

impl Cycle {
    pub(crate) fn period(&self) -> f64 {
        self.upper - self.lower
    }

    /// Returns the equivalent value from the lower bound up to the upper bound. A value in this range does
    /// not change.
    pub(crate) fn wrapped(&self, value: f64) -> f64 {
        if (self.lower..self.upper).contains(&value) || !value.is_finite() {
            return value;
        }
        let turns = ((value - self.lower) / self.period()).floor();
        let wrapped = value - turns * self.period();
        // Rounding may leave the range.
        if wrapped >= self.upper { self.lower } else { wrapped.max(self.lower) }
    }
}

impl Parameter {
    /// Creates a parameter named as in the model, without bounds, on a linear scale.
    pub fn new(name: impl Into<String>, start: f64) -> Self {
        Self { name: name.into(), start: Some(start), ..Self::default() }
    }

    /// Creates the parameter of a record with the fields of this type. At most one of `variables`, `delay_of`
    /// and `offset_of` can be given. A tied parameter has `tied_to` with `factor`, `offset` and
    /// `across_units` instead of a start.
    ///
    /// # Errors
    /// Returns an error if a field has an invalid value, and the errors of [`check`](Self::check).
    pub fn from_record(record: &Record) -> Result<Self, CalibrationError> {
        let bad = |message: String| {
            let name = record.get("name").and_then(|name| name.read("name").ok()).unwrap_or_default();
            Err(CalibrationError::Parameter { name, message })
        };
        match record.get("delay_of") {
            None | Some(Value::Nothing | Value::Text(_)) => {}
            Some(Value::List(_)) => {
                return bad(
                    "delay_of must be one output or input. For a common delay of several, tie the parameters of the others with \
                     tied_to; set known delays with the argument delays of the recording"
                        .to_owned(),
                );
            }
            Some(other) => {
                return bad(format!("delay_of must be the name of an output or input, not {other}"));
            }
        }
        if let Some(Value::Text(text)) = record.get("expr")
            && let Err(error) = text.parse::<Expression>()
        {
            return bad(format!("expr: {error}"));
        }
        let parameter = read_record::<Self>(record, "field of a parameter")?.normalised();
        parameter.check()?;
        Ok(parameter)
    }

    /// Returns the record of the parameter, with all fields.
    ///
    /// # Errors
    /// Returns an error if a number is not finite.
    pub fn record(&self) -> Result<Record, CalibrationError> {
        match Value::of(self)? {
            Value::Record(record) => Ok(record),
            _ => Ok(Record::new()),
        }
    }

    /// Returns the parameter in the form in which equal parameters have equal fields.
    fn normalised(mut self) -> Self {
        self.lower = self.lower.filter(|lower| *lower != f64::NEG_INFINITY);
        self.upper = self.upper.filter(|upper| *upper != f64::INFINITY);
        self.variables = self.variables.filter(|variables| *variables != [self.name.as_str()]);
        self.display_name = self.display_name.filter(|shown| *shown != self.name);
        self
    }

    /// Creates a parameter whose value is `factor * p + offset`, where p is the value of the parameter `to`.
    /// A tied parameter is not an entry of the vectors of values; the results list its value. It is a
    /// [derived](Self::derived) parameter with a linear formula. If `to` is [local](Self::local), the tied
    /// parameter follows its value in each experiment. Bounds, scale, prior and the other settings are taken
    /// from `to`.
    pub fn tied(name: impl Into<String>, to: impl Into<String>, factor: f64, offset: f64) -> Self {
        Self { name: name.into(), tied_to: Some(to.into()), factor, offset, ..Self::default() }
    }

    /// Creates a derived parameter, whose value follows from other parameters by a formula such as
    /// `1 - k1 - k2`. It is not an entry of the vectors of values; the results list its value, with the
    /// standard error that follows from theirs. Other derived parameters may occur in the formula. Values
    /// outside its [bounds](Self::bounds) are failed evaluations. If the formula contains a
    /// [local](Self::local) parameter, there is a value for each experiment.
    ///
    /// # Errors
    /// Returns an error with the column of a mistake in the formula.
    pub fn derived(name: impl Into<String>, expr: &str) -> Result<Self, CalibrationError> {
        Self { name: name.into(), ..Self::default() }.expression(expr)
    }

    /// Makes the parameter a [derived](Self::derived) one, without a start value.
    ///
    /// # Errors
    /// Returns an error with the column of a mistake in the formula.
    pub fn expression(self, expr: &str) -> Result<Self, CalibrationError> {
        match expr.parse() {
            Ok(expr) => Ok(Self { expr: Some(expr), start: None, ..self }),
            Err(error) => {
                Err(CalibrationError::Parameter { name: self.name, message: format!("expr: {error}") })
            }
        }
    }

    /// Declares that the factor of a [tied](Self::tied) parameter has a unit. Without it, both parameters
    /// must be quantities of the same kind. If the factor is also 1, they must have the same unit.
    #[must_use]
    pub fn across_units(mut self, across_units: bool) -> Self {
        self.across_units = across_units;
        self
    }

    /// Sets the variables of the model that the parameter sets, all to the same value. The name of the
    /// parameter can then be chosen freely. Without variables, the parameter only acts through the formulas
    /// of [derived](Self::derived) parameters, and a derived parameter is only a result.
    #[must_use]
    pub fn variables<N: Into<String>>(self, names: impl IntoIterator<Item = N>) -> Self {
        let variables = Some(names.into_iter().map(Into::into).collect());
        Self { variables, delay_of: None, offset_of: None, factor_of: None, ..self }.normalised()
    }

    /// Makes the parameter the delay tau of a compared output or of an input, in the time unit of the model.
    /// An output `y(t - tau)` is compared with the measurement at t. An input is `u(t - tau)`. The name of
    /// the parameter can then be chosen freely. Before the start, an output has its value at the start, and
    /// an input has the value of its first row. The lower bound must be finite. Negative values delay the
    /// recording instead.
    #[must_use]
    pub fn delay_of(self, variable: impl Into<String>) -> Self {
        Self { variables: None, delay_of: Some(variable.into()), offset_of: None, factor_of: None, ..self }
    }

    /// Adds the parameter to a compared output or to an input. The name of the parameter can then be chosen
    /// freely.
    #[must_use]
    pub fn offset_of(self, variable: impl Into<String>) -> Self {
        Self { variables: None, delay_of: None, offset_of: Some(variable.into()), factor_of: None, ..self }
    }

    /// Multiplies a compared output or an input by the parameter, before an [offset](Self::offset_of) is
    /// added. The name of the parameter can then be chosen freely.
    #[must_use]
    pub fn factor_of(self, variable: impl Into<String>) -> Self {
        Self { variables: None, delay_of: None, offset_of: None, factor_of: Some(variable.into()), ..self }
    }

    /// Sets the unit of its values, bounds and results, if it differs from the unit of the variable. Values
    /// are converted for the model.
    #[must_use]
    pub fn in_unit(mut self, unit: impl Into<String>) -> Self {
        self.unit = Some(unit.into());
        self
    }

    /// Sets the name in reports and figures.
    #[must_use]
    pub fn display_name(mut self, name: impl Into<String>) -> Self {
        self.display_name = Some(name.into());
        self.normalised()
    }

    /// Sets the prior: the knowledge of the parameter before the fit.
    #[must_use]
    pub fn prior(mut self, prior: Prior) -> Self {
        self.prior = Some(prior);
        self
    }

    /// Sets the smallest and the largest value; infinite bounds leave a side open.
    #[must_use]
    pub fn bounds(mut self, lower: f64, upper: f64) -> Self {
        (self.lower, self.upper) = (Some(lower), Some(upper));
        self.normalised()
    }

    /// Sets the scale of the optimiser. Use [`Scale::Log`] for positive parameters known only to an order of
    /// magnitude. Values and bounds remain in the user's units.
    #[must_use]
    pub fn scale(mut self, scale: Scale) -> Self {
        self.scale = scale;
        self
    }

    /// Sets a typical size, from which step lengths and tolerances are derived. It is unused on a log scale,
    /// where steps and tolerances are factors.
    #[must_use]
    pub fn nominal(mut self, nominal: f64) -> Self {
        self.nominal = Some(nominal);
        self
    }

    /// Sets the kind of values: continuous (the default), integers, or integers that represent choices. Not
    /// every method supports the last two: [`dfo::CmaEs`] and [`dfo::DifferentialEvolution`] support
    /// integers, [`dfo::Genetic`] both.
    #[must_use]
    pub fn kind(mut self, kind: ParameterKind) -> Self {
        self.kind = kind;
        self
    }

    /// Fixes the parameter at its start value.
    #[must_use]
    pub fn fixed(mut self, fixed: bool) -> Self {
        self.fixed = fixed;
        self
    }

    /// Makes the parameter an angle: the period is the difference of its bounds, which are the same point.
    /// The search crosses the bounds. The model receives values from the lower to the upper bound, and so do
    /// results.
    #[must_use]
    pub fn periodic(mut self, periodic: bool) -> Self {
        self.periodic = periodic;
        self
    }

    /// True if the parameter is an angle that is not fixed.
    pub fn is_periodic(&self) -> bool {
        self.periodic && !self.fixed
    }

    /// Returns the range of a periodic parameter.
    pub(crate) fn cycle(&self) -> Option<Cycle> {
        let (lower, upper) = self.given_bounds();
        self.is_periodic().then_some(Cycle { lower, upper })
    }

    /// Returns the bounds of a search. For a periodic parameter, they are half a period wider on both sides,
    /// so that each value lies within half a period of a start without a bound between.
    pub(crate) fn search_bounds(&self) -> (f64, f64) {
        let half = self.cycle().map_or(0.0, |cycle| 0.5 * cycle.period());
        (self.lower() - half, self.upper() + half)
    }

    pub(crate) fn search_lower(&self) -> f64 {
        self.search_bounds().0
    }

    pub(crate) fn search_upper(&self) -> f64 {
        self.search_bounds().1
    }

    /// Returns the value of a periodic parameter within its bounds; the value itself for other parameters.
    pub(crate) fn reported(&self, value: f64) -> f64 {
        self.cycle().map_or(value, |cycle| cycle.wrapped(value))
    }

    /// Returns the equivalent value of a periodic parameter that is nearest to another value.
    pub(crate) fn nearest_to(&self, center: f64, value: f64) -> f64 {
        let turns = |cycle: Cycle| ((center - value) / cycle.period()).round() * cycle.period();
        self.cycle().map_or(value, |cycle| value + turns(cycle))
    }

    /// Makes the parameter local: it has a separate value in each experiment, such as `T0[run1]` and
    /// `T0[run2]` (see [`Experiment::named`](crate::Experiment::named)). If an experiment has a [start
    /// value](crate::Experiment::start_value) for this variable, the search starts from it there.
    #[must_use]
    pub fn local(mut self, local: bool) -> Self {
        self.local = local;
        self
    }

    /// Restricts the parameter to these experiments. In the others, its variables keep the values of the
    /// model, a start value or another parameter.
    #[must_use]
    pub fn experiments<N: Into<String>>(mut self, names: impl IntoIterator<Item = N>) -> Self {
        self.experiments = Some(names.into_iter().map(Into::into).collect());
        self
    }

    /// Returns the experiments in which the parameter acts; `None` for all.
    pub fn given_experiments(&self) -> Option<&[String]> {
        self.experiments.as_deref()
    }

    /// Returns the parameter for a problem with these experiments only, or `None` if it acts in none of them.
    pub(crate) fn restricted_to(&self, experiments: &[String]) -> Option<Self> {
        let Some(names) = &self.experiments else { return Some(self.clone()) };
        let names: Vec<String> = names.iter().filter(|name| experiments.contains(name)).cloned().collect();
        (!names.is_empty()).then(|| Self { experiments: Some(names), ..self.clone() })
    }

    /// Returns the parameter without its target, for a problem in which only formulas use it.
    pub(crate) fn without_target(&self) -> Self {
        let variables = Some(Vec::new());
        Self {
            experiments: None,
            variables,
            delay_of: None,
            offset_of: None,
            factor_of: None,
            ..self.clone()
        }
    }

    /// True if the parameter acts in the experiment with this name.
    pub(crate) fn acts_in(&self, experiment: &str) -> bool {
        self.experiments.as_ref().is_none_or(|names| names.iter().any(|name| name == experiment))
    }

    /// Returns the parameter that represents a local parameter in one experiment.
    pub(crate) fn in_experiment(&self, experiment: &str, start: Option<f64>) -> Self {
        let name = format!("{}[{experiment}]", self.name);
        let display_name = self.display_name.as_ref().map(|shown| format!("{shown} [{experiment}]"));
        let variables = match self.target() {
            Target::Variables(variables) => Some(variables.to_vec()),
            Target::Delay(_) | Target::Offset(_) | Target::Factor(_) => None,
        };
        Self { name, display_name, variables, start: start.or(self.start), local: false, ..self.clone() }
    }

    /// Returns the part that costs depend on, without the settings of the search and the display.
    pub(crate) fn without_search(&self) -> Self {
        // A derived value outside its bounds is a failure.
        let has_effect = self.periodic || self.expr.is_some();
        let (lower, upper) = if has_effect { (self.lower, self.upper) } else { (None, None) };
        Self {
            start: None,
            lower,
            upper,
            scale: Scale::Linear,
            nominal: None,
            kind: ParameterKind::Continuous,
            fixed: false,
            local: false,
            display_name: None,
            ..self.clone()
        }
    }

    /// Returns the parameter with a state of the model as its name and target.
    pub(crate) fn for_state(&self, state: &str) -> Self {
        let name = state.to_owned();
        Self { name, variables: None, delay_of: None, offset_of: None, factor_of: None, ..self.clone() }
    }

    /// Returns the name. For the value of a local parameter in an experiment, the name of the experiment
    /// follows.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the target of the parameter.
    pub fn target(&self) -> Target<'_> {
        match (&self.variables, &self.delay_of, &self.offset_of, &self.factor_of) {
            (Some(variables), ..) => Target::Variables(variables),
            (None, Some(variable), ..) => Target::Delay(variable),
            (None, None, Some(variable), _) => Target::Offset(variable),
            (None, None, None, Some(variable)) => Target::Factor(variable),
            (None, None, None, None) => Target::Variables(std::slice::from_ref(&self.name)),
        }
    }

    /// Returns the variables of the model that the parameter sets; empty for a delay, an offset and a factor.
    pub fn variable_names(&self) -> &[String] {
        match self.target() {
            Target::Variables(names) => names,
            Target::Delay(_) | Target::Offset(_) | Target::Factor(_) => &[],
        }
    }

    /// Returns the variable that defines the unit and nominal value: the first variable that the parameter
    /// sets, or the one that it offsets. Returns `None` for a delay, which is a time, and for a factor.
    pub fn variable(&self) -> Option<&str> {
        match self.target() {
            Target::Variables(names) => names.first().map(String::as_str),
            Target::Offset(variable) => Some(variable),
            Target::Delay(_) | Target::Factor(_) => None,
        }
    }

    /// True if a start value of this name belongs to this parameter.
    pub(crate) fn is_called(&self, name: &str) -> bool {
        self.name == name || self.variable_names().iter().any(|variable| variable == name)
    }

    /// Returns the unit given for its values, if any.
    pub fn given_unit(&self) -> Option<&str> {
        self.unit.as_deref()
    }

    /// Returns the unit of its values: the given unit, otherwise the unit of its variable, or the time unit
    /// of the model for a delay. Returns `None` if the model declares no unit.
    pub fn unit<'a>(&'a self, description: &'a ModelDescription) -> Option<&'a str> {
        let of_model = || match self.variable() {
            Some(name) => description.variable(name).and_then(|v| v.unit.as_deref()),
            None => matches!(self.target(), Target::Delay(_)).then(|| description.time_unit()),
        };
        self.unit.as_deref().or_else(of_model)
    }

    /// Returns the name in reports and figures: the display name, otherwise the name of the parameter.
    pub fn shown_name(&self) -> &str {
        self.display_name.as_deref().unwrap_or(&self.name)
    }

    /// Returns the prior of the parameter, if it has one.
    pub fn stated_prior(&self) -> Option<&Prior> {
        self.prior.as_ref()
    }

    /// Returns the tie to another parameter, if there is one.
    pub fn tie(&self) -> Option<Tie<'_>> {
        let Self { factor, offset, across_units, .. } = *self;
        self.tied_to.as_deref().map(|to| Tie { to, factor, offset, across_units })
    }

    /// True if the value follows from other parameters. It is then not an entry of the vectors of values.
    pub fn is_derived(&self) -> bool {
        self.tied_to.is_some() || self.expr.is_some()
    }

    /// Returns the formula of a derived parameter, also of a tied one.
    pub fn derivation(&self) -> Option<Expression> {
        let of_tie = || self.tie().map(|tie| Expression::affine(tie.to, tie.factor, tie.offset));
        self.expr.clone().or_else(of_tie)
    }

    /// True if the parameter has a separate value in each experiment.
    pub fn is_local(&self) -> bool {
        self.local
    }

    /// Returns the start value of the fit; 0 for a derived parameter.
    pub fn start(&self) -> f64 {
        self.start.unwrap_or(0.0)
    }

    /// Returns the smallest value; the start value for a fixed parameter.
    pub fn lower(&self) -> f64 {
        if self.fixed { self.start() } else { self.given_bounds().0 }
    }

    /// Returns the largest value; the start value for a fixed parameter.
    pub fn upper(&self) -> f64 {
        if self.fixed { self.start() } else { self.given_bounds().1 }
    }

    /// Returns the smallest and the largest value as given, even for a fixed parameter.
    pub fn given_bounds(&self) -> (f64, f64) {
        (self.lower.unwrap_or(f64::NEG_INFINITY), self.upper.unwrap_or(f64::INFINITY))
    }

    /// Returns the scale of the optimiser.
    pub fn scale_kind(&self) -> Scale {
        self.scale
    }

    /// Returns the typical size, if given.
    pub fn nominal_size(&self) -> Option<f64> {
        self.nominal
    }

    /// Returns the kind of values.
    pub fn value_kind(&self) -> ParameterKind {
        self.kind
    }

    /// True if the parameter is fixed.
    pub fn is_fixed(&self) -> bool {
        self.fixed
    }
}

/// Converts a value of the optimiser to the value of the parameter.
pub(crate) fn outer(parameter: &Parameter, value: f64) -> f64 {
    match parameter.scale_kind() {
        Scale::Linear => value,
        Scale::Log => value.exp().clamp(parameter.lower(), parameter.upper()),
    }
}

/// Converts a value of the parameter to the value of the optimiser.
pub(crate) fn inner(parameter: &Parameter, value: f64) -> f64 {
    match parameter.scale_kind() {
        Scale::Linear => value,
        Scale::Log => value.max(0.0).ln(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A missing bound is `null` in JSON. Other numbers that are not finite are errors when they are written,
    /// because JSON would show them as `null`, too.
    #[test]
    fn parameter_survives_json() {
        let p = |start: f64| Parameter::new("k", start);
        for parameter in [
            p(0.5),
            p(0.5).bounds(f64::NEG_INFINITY, f64::INFINITY),
            p(0.5).bounds(0.1, f64::INFINITY).scale(Scale::Log).nominal(2.0).in_unit("mm"),
            p(0.5).variables(["a", "b"]).prior(Prior::Normal { mean: 0.4, sd: 0.1 }).local(true),
            p(0.5).bounds(0.0, 1.0).delay_of("y").display_name("lag"),
            p(1.0).variables(["k"]).kind(ParameterKind::Integer).fixed(true),
            Parameter::tied("k", "c", 2.0, -1.0).offset_of("u").across_units(true),
            Parameter::derived("k", "1 - c").unwrap().bounds(0.0, f64::INFINITY).in_unit("mm"),
        ] {
            let json = serde_json::to_string(&parameter).unwrap();
            assert_eq!(serde_json::from_str::<Parameter>(&json).unwrap(), parameter, "{json}");
            assert_eq!(Parameter::from_record(&parameter.record().unwrap()).unwrap(), parameter);
        }
        assert_eq!(p(0.5).bounds(f64::NEG_INFINITY, f64::INFINITY), p(0.5));
        for parameter in [
            p(f64::NAN),
            p(f64::INFINITY),
            p(0.5).nominal(f64::NAN),
            p(0.5).bounds(f64::NAN, 1.0),
            p(0.5).bounds(f64::INFINITY, 1.0),
            p(0.5).bounds(0.0, f64::NEG_INFINITY),
        ] {
            let error = serde_json::to_string(&parameter).unwrap_err().to_string();
            assert!(error.contains("is not a finite number") && parameter.check().is_err(), "{error}");
        }
        // NaN where a number is required becomes null, which cannot be read.
        for parameter in [
            p(0.5).prior(Prior::Normal { mean: f64::NAN, sd: 1.0 }),
            Parameter::tied("k", "c", f64::NAN, 0.0),
        ] {
            let json = serde_json::to_string(&parameter).unwrap();
            assert!(serde_json::from_str::<Parameter>(&json).is_err(), "{json}");
        }
        let error = serde_json::from_str::<Parameter>(r#"{"name": "k", "strat": 1}"#).unwrap_err();
        assert!(error.to_string().contains("strat"), "{error}");
        let infinite = [("name", Value::Text("k".to_owned())), ("start", Value::Number(1.0))];
        let infinite = infinite.into_iter().chain([("upper", Value::Number(f64::INFINITY))]);
        let infinite: Record = infinite.map(|(name, value)| (name.to_owned(), value)).collect();
        assert_eq!(Parameter::from_record(&infinite).unwrap(), p(1.0));
    }
}
