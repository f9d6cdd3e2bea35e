//! Parameters of a fit: a value with start, bounds and scale, and its target in the model.

use crate::error::CalibrationError;
use crate::problem::prior::Prior;
use base::Number;
use dfo::ParameterKind;
pub use dfo::Transform as Scale;
use fmi::ModelDescription;
use serde::{Deserialize, Serialize};

/// Target of a parameter.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Target {
    /// These variables of the model, all to the same value: parameters, or start values of variables, of
    /// states by their names.
    Variables(Vec<String>),
    /// The delay of an output that is compared, or of an input, in s: `y(t - delay)`.
    Delay(String),
    /// An offset that is added to an output that is compared, or to an input.
    Offset(String),
}

/// The value of a parameter that follows another one: `factor * value + offset`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tie {
    /// The name of the parameter that it follows.
    pub to: String,
    /// Factor.
    pub factor: f64,
    /// Offset, in the unit of the parameter that is tied.
    pub offset: f64,
    /// True if the factor has a unit, so that the units of the two parameters may differ.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub across_units: bool,
}

/// A parameter to be fitted.
///
/// ```
/// use calibration::{Parameter, Prior};
/// let friction = Parameter::new("armFriction", 0.012).bounds(0.0, 0.022);
/// assert_eq!(friction.upper(), 0.022);
/// // One value for two variables, of which something is known; a delay; a value that follows another.
/// let outlet = Parameter::new("outlet", 3e-6).variables(["qt.a1", "qt.a2"]).prior(Prior::LogNormal { median: 3e-6, sigma: 0.1 });
/// let delay = Parameter::new("tau", 0.05).bounds(0.0, 1.0).delay_of("armJoint.phi");
/// let other = Parameter::tied("qt.a3", "outlet", 0.5, 0.0);
/// assert_eq!((outlet.name(), delay.name(), other.is_tied()), ("outlet", "tau", true));
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    name: String,
    target: Target,
    start: f64,
    lower: f64,
    upper: f64,
    scale: Scale,
    nominal: Option<f64>,
    kind: ParameterKind,
    fixed: bool,
    local: bool,
    unit: Option<String>,
    display_name: Option<String>,
    prior: Option<Prior>,
    tie: Option<Tie>,
}

impl Parameter {
    /// A parameter named as in the model, without bounds, on a linear scale.
    pub fn new(name: impl Into<String>, start: f64) -> Self {
        let name = name.into();
        Self {
            target: Target::Variables(vec![name.clone()]),
            name,
            start,
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            scale: Scale::Linear,
            nominal: None,
            kind: ParameterKind::Continuous,
            fixed: false,
            local: false,
            unit: None,
            display_name: None,
            prior: None,
            tie: None,
        }
    }

    /// A parameter whose value is `factor * p + offset` with the value p of the parameter `to`, which is none
    /// itself that is tied. It is no entry of the vectors of values; the results list its value. Of a
    /// [local](Self::local) one it follows the value in each experiment. Bounds, scale, prior and the like
    /// are those of the other one.
    pub fn tied(name: impl Into<String>, to: impl Into<String>, factor: f64, offset: f64) -> Self {
        let tie = Tie { to: to.into(), factor, offset, across_units: false };
        Self { tie: Some(tie), ..Self::new(name, 0.0) }
    }

    /// Says that the factor of a [tied](Self::tied) parameter has a unit: without it both parameters must be
    /// quantities of one kind, and have one unit where the factor is 1.
    #[must_use]
    pub fn across_units(mut self, across_units: bool) -> Self {
        if let Some(tie) = &mut self.tie {
            tie.across_units = across_units;
        }
        self
    }

    /// The variables of the model that it sets, all to the same value; its name is free then.
    #[must_use]
    pub fn variables<N: Into<String>>(mut self, names: impl IntoIterator<Item = N>) -> Self {
        self.target = Target::Variables(names.into_iter().map(Into::into).collect());
        self
    }

    /// It is the delay in s of an output that is compared, `y(t - tau)` with what was measured at t, or of an
    /// input, `u(t - tau)`; its name is free then. Before its start an output has the value of the start, an
    /// input that of its first row. The lower bound must be finite; negative delays are ones of the
    /// recording.
    #[must_use]
    pub fn delay_of(mut self, variable: impl Into<String>) -> Self {
        self.target = Target::Delay(variable.into());
        self
    }

    /// It is added to an output that is compared, or to an input; its name is free then.
    #[must_use]
    pub fn offset_of(mut self, variable: impl Into<String>) -> Self {
        self.target = Target::Offset(variable.into());
        self
    }

    /// The unit of its values, bounds and results, where it is not that of the variable in the model: values
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
        self
    }

    /// Sets the prior: the knowledge of the parameter before the fit.
    #[must_use]
    pub fn prior(mut self, prior: Prior) -> Self {
        self.prior = Some(prior);
        self
    }

    /// Smallest and largest value; infinities leave a side open.
    #[must_use]
    pub fn bounds(mut self, lower: f64, upper: f64) -> Self {
        (self.lower, self.upper) = (lower, upper);
        self
    }

    /// The scale the optimiser works on: [`Scale::Log`] for positive parameters known only to an order of
    /// magnitude. Values and bounds are in the user's units either way.
    #[must_use]
    pub fn scale(mut self, scale: Scale) -> Self {
        self.scale = scale;
        self
    }

    /// A typical size, from which step lengths and tolerances are taken. On a log scale these are factors, so
    /// it is not used there.
    #[must_use]
    pub fn nominal(mut self, nominal: f64) -> Self {
        self.nominal = Some(nominal);
        self
    }

    /// Sets the kind of values: any (the default), whole numbers, or whole numbers that stand for choices.
    /// Not every method searches over the latter two: [`dfo::DifferentialEvolution`] takes integers,
    /// [`dfo::Genetic`] both.
    #[must_use]
    pub fn kind(mut self, kind: ParameterKind) -> Self {
        self.kind = kind;
        self
    }

    /// Holds the parameter at its start value.
    #[must_use]
    pub fn fixed(mut self, fixed: bool) -> Self {
        self.fixed = fixed;
        self
    }

    /// Gives it a value of its own in each experiment, instead of one for all: `T0[run1]`, `T0[run2]` (see
    /// [`Experiment::named`](crate::Experiment::named)). The start in an experiment is the
    /// [start value](crate::Experiment::start_value) of this variable there, if there is one.
    #[must_use]
    pub fn local(mut self, local: bool) -> Self {
        self.local = local;
        self
    }

    /// The value that a local parameter has in one experiment, as a parameter.
    pub(crate) fn in_experiment(&self, experiment: &str, start: Option<f64>) -> Self {
        let name = format!("{}[{experiment}]", self.name);
        let display_name = self.display_name.as_ref().map(|shown| format!("{shown} [{experiment}]"));
        let start = start.unwrap_or(self.start);
        Self { name, display_name, start, local: false, ..self.clone() }
    }

    /// What costs depend on, without how it is searched and shown.
    pub(crate) fn without_search(&self) -> Self {
        let Self { name, target, unit, prior, tie, .. } = self.clone();
        Self { target, unit, prior, tie, ..Self::new(name, 0.0) }
    }

    /// The same for a state of the model.
    pub(crate) fn for_state(&self, state: &str) -> Self {
        let target = Target::Variables(vec![state.to_owned()]);
        Self { name: state.to_owned(), target, ..self.clone() }
    }

    /// Its name; of the value that a local one has in an experiment followed by the name of the experiment.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Target of the parameter.
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// The variables of the model that it sets; none for a delay and an offset.
    pub fn variable_names(&self) -> &[String] {
        match &self.target {
            Target::Variables(names) => names,
            Target::Delay(_) | Target::Offset(_) => &[],
        }
    }

    /// The variable whose unit and nominal value are its own: the first that it sets, or the one that it is
    /// the offset of; `None` for a delay, which is in s.
    pub fn variable(&self) -> Option<&str> {
        match &self.target {
            Target::Variables(names) => names.first().map(String::as_str),
            Target::Offset(variable) => Some(variable),
            Target::Delay(_) => None,
        }
    }

    /// True if a start value of this name is one of this parameter.
    pub(crate) fn is_called(&self, name: &str) -> bool {
        self.name == name || self.variable_names().iter().any(|variable| variable == name)
    }

    /// The unit that was given for its values.
    pub fn given_unit(&self) -> Option<&str> {
        self.unit.as_deref()
    }

    /// The unit of its values: the one that was given, or else that of its variable, s for a delay; `None`:
    /// the model states none.
    pub fn unit<'a>(&'a self, description: &'a ModelDescription) -> Option<&'a str> {
        let of_model = || match self.variable() {
            Some(name) => description.variable(name).and_then(|v| v.unit.as_deref()),
            None => Some("s"),
        };
        self.unit.as_deref().or_else(of_model)
    }

    /// Name in reports and figures: the display name, or else the name of the parameter.
    pub fn shown_name(&self) -> &str {
        self.display_name.as_deref().unwrap_or(&self.name)
    }

    /// Prior of the parameter, if it has one.
    pub fn known_prior(&self) -> Option<&Prior> {
        self.prior.as_ref()
    }

    /// The parameter that it follows, if it is tied to one.
    pub fn tie(&self) -> Option<&Tie> {
        self.tie.as_ref()
    }

    /// True if the parameter is tied to another one, and no entry of the vectors of values.
    pub fn is_tied(&self) -> bool {
        self.tie.is_some()
    }

    /// True if each experiment has a value of its own.
    pub fn is_local(&self) -> bool {
        self.local
    }

    /// Where the fit starts.
    pub fn start(&self) -> f64 {
        self.start
    }

    /// Smallest value; the start value of a fixed parameter.
    pub fn lower(&self) -> f64 {
        if self.fixed { self.start } else { self.lower }
    }

    /// Largest value; the start value of a fixed parameter.
    pub fn upper(&self) -> f64 {
        if self.fixed { self.start } else { self.upper }
    }

    /// Smallest and largest value as they were given, also of a fixed parameter.
    pub fn given_bounds(&self) -> (f64, f64) {
        (self.lower, self.upper)
    }

    /// The scale the optimiser works on.
    pub fn scale_kind(&self) -> Scale {
        self.scale
    }

    /// The typical size, if one was given.
    pub fn nominal_size(&self) -> Option<f64> {
        self.nominal
    }

    /// Kind of values.
    pub fn value_kind(&self) -> ParameterKind {
        self.kind
    }

    /// True if the parameter is held.
    pub fn is_fixed(&self) -> bool {
        self.fixed
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// Names the parameter and the numbers that do not fit together.
    pub fn check(&self) -> Result<(), CalibrationError> {
        let Self { name, start, lower, upper, .. } = self;
        let bad = |message: String| Err(CalibrationError::Parameter { name: name.clone(), message });
        let [first, low, high] = [*start, *lower, *upper].map(Number);
        if name.is_empty() {
            return bad("a parameter needs a name".to_owned());
        }
        if matches!(&self.target, Target::Variables(names) if names.is_empty()) {
            return bad(
                "variables is empty: name what it sets in the model, or leave variables out".to_owned()
            );
        }
        if let Some(tie) = &self.tie {
            return self.check_tie(tie);
        }
        if !start.is_finite() {
            return bad(format!("start {first} is not finite"));
        }
        if lower.is_nan() || upper.is_nan() {
            return bad(format!("bounds {low} and {high}: neither may be NaN"));
        }
        if lower > upper {
            return bad(format!("lower bound {low} is above upper bound {high}"));
        }
        if !self.fixed && !(*lower..=*upper).contains(start) {
            return bad(format!("start {first} is outside of the bounds {low} and {high}"));
        }
        if self.kind != ParameterKind::Continuous && !self.fixed {
            if lower.ceil() > upper.floor() {
                let kind = self.kind;
                return bad(format!(
                    "is {kind}, but between its bounds {low} and {high} there is no whole number"
                ));
            }
            if start.fract() != 0.0 {
                return bad(format!("is {}, so start {first} must be a whole number", self.kind));
            }
        }
        if self.scale == Scale::Log && !self.fixed && (*start <= 0.0 || (lower.is_finite() && *lower <= 0.0))
        {
            return bad(format!("a log scale needs values above 0; start {first}, lower bound {low}"));
        }
        if let Some(nominal) = self.nominal
            && !(nominal.is_finite() && nominal > 0.0)
        {
            return bad(format!("nominal {} must be positive and finite", Number(nominal)));
        }
        if let Some(problem) = self.prior.and_then(|prior| prior.problem()) {
            return bad(problem);
        }
        let likeliest = self.prior.map(|prior| match prior {
            Prior::Normal { mean, .. } => ("mean", mean),
            Prior::LogNormal { median, .. } => ("median", median),
        });
        if let Some((what, value)) = likeliest.filter(|(_, value)| !(*lower..=*upper).contains(value))
            && !self.fixed
        {
            let value = Number(value);
            return bad(format!(
                "the {what} of its prior, {value}, is outside of its bounds {low} and {high}: widen the bounds, or correct the prior"
            ));
        }
        if matches!(self.prior, Some(Prior::LogNormal { .. }))
            && !self.fixed
            && self.scale != Scale::Log
            && *lower <= 0.0
        {
            return bad(format!(
                "its log-normal prior needs values above 0, and its lower bound is {low}: give a lower bound above 0, or \
                 scale = log"
            ));
        }
        if matches!(self.target, Target::Delay(_)) && !self.lower().is_finite() {
            return bad(format!(
                "a delay needs a finite lower bound, and it is {low}: give lower = 0, for example"
            ));
        }
        Ok(())
    }

    fn check_tie(&self, Tie { to, factor, offset, across_units }: &Tie) -> Result<(), CalibrationError> {
        let Self { name, target, unit, display_name, .. } = self;
        let bad = |message: String| Err(CalibrationError::Parameter { name: name.clone(), message });
        if !factor.is_finite() || *factor == 0.0 || !offset.is_finite() {
            let [factor, offset] = [*factor, *offset].map(Number);
            return bad(format!(
                "it is tied to '{to}' with factor {factor} and offset {offset}: both must be finite, the factor not 0"
            ));
        }
        // All else comes from the other one.
        let bare = Self {
            target: target.clone(),
            unit: unit.clone(),
            display_name: display_name.clone(),
            ..Self::tied(name, to, *factor, *offset).across_units(*across_units)
        };
        if *self != bare {
            return bad(format!(
                "it is tied to '{to}', so start, bounds, scale, nominal, kind, fixed, local and prior are those of '{to}': \
                 leave them out here"
            ));
        }
        Ok(())
    }
}

/// The value that the optimiser sees as this one.
pub(crate) fn outer(parameter: &Parameter, value: f64) -> f64 {
    match parameter.scale_kind() {
        Scale::Linear => value,
        Scale::Log => value.exp().clamp(parameter.lower(), parameter.upper()),
    }
}

/// A value as the optimiser sees it.
pub(crate) fn inner(parameter: &Parameter, value: f64) -> f64 {
    match parameter.scale_kind() {
        Scale::Linear => value,
        Scale::Log => value.max(0.0).ln(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_numbers_are_named() {
        let p = |start: f64, lower: f64, upper: f64| Parameter::new("k", start).bounds(lower, upper);
        for (parameter, expected) in [
            (p(f64::NAN, 0.0, 1.0), "start NaN"),
            (p(0.5, 2.0, 1.0), "lower bound 2 is above upper bound 1"),
            (p(3.0, 0.0, 1.0), "start 3 is outside of the bounds 0 and 1"),
            (p(0.5, f64::NAN, 1.0), "NaN"),
            (p(0.0, f64::NEG_INFINITY, 1.0).scale(Scale::Log), "above 0; start 0"),
            (p(0.5, 0.0, 1.0).scale(Scale::Log), "above 0; start 0.5, lower bound 0"),
            (p(0.5, 0.0, 1.0).nominal(0.0), "nominal 0"),
            (p(0.5, 0.0, 1.0).nominal(-3.0), "nominal -3 must be positive"),
            (
                p(0.5, 0.0, 1.0).kind(ParameterKind::Integer),
                "is integer, so start 0.5 must be a whole number",
            ),
            (
                p(0.5, 0.1, 0.9).kind(ParameterKind::Categorical),
                "is categorical, but between its bounds 0.1 and 0.9",
            ),
        ] {
            let e = parameter.check().unwrap_err().to_string();
            assert!(e.contains("'k'") && e.contains(expected), "{e}");
        }
        let normal = |mean, sd| p(0.5, 0.0, 1.0).prior(Prior::Normal { mean, sd });
        let relative = |lower, sigma| p(0.5, lower, 1.0).prior(Prior::LogNormal { median: 1.0, sigma });
        for (parameter, expected) in [
            (normal(f64::NAN, 1.0), "mean NaN and sd 1"),
            (normal(0.5, 0.0), "mean 0.5 and sd 0"),
            (relative(0.1, -1.0), "median 1 and sigma -1"),
            (relative(0.0, 0.1), "give a lower bound above 0"),
            (normal(1.5, 1.0), "the mean of its prior, 1.5, is outside of its bounds 0 and 1"),
            (
                p(0.5, 0.2, 0.9).prior(Prior::LogNormal { median: 0.1, sigma: 1.0 }),
                "the median of its prior, 0.1, is outside",
            ),
            (p(0.5, f64::NEG_INFINITY, 1.0).delay_of("y"), "a delay needs a finite lower bound"),
            (p(0.5, 0.0, 1.0).variables([""; 0]), "variables is empty"),
            (Parameter::tied("k", "c", 0.0, 1.0), "factor 0 and offset 1"),
            (Parameter::tied("k", "c", 1.0, f64::INFINITY), "offset inf"),
            (Parameter::tied("k", "c", 1.0, 0.0).bounds(0.0, 1.0), "are those of 'c'"),
            (Parameter::tied("k", "c", 1.0, 0.0).local(true), "leave them out here"),
        ] {
            let e = parameter.check().unwrap_err().to_string();
            assert!(e.contains("'k'") && e.contains(expected), "{e}");
        }
        assert!(relative(0.0, 0.1).scale(Scale::Log).bounds(0.1, 1.0).check().is_ok());
        assert!(Parameter::tied("k", "c", 2.0, 0.0).in_unit("mm").display_name("outlet").check().is_ok());
        assert!(p(0.5, 0.0, f64::INFINITY).check().is_ok());
        let held = p(0.5, 0.0, 1.0).fixed(true);
        assert_eq!((held.lower(), held.upper()), (0.5, 0.5));
    }
}
