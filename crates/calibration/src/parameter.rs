//! What is fitted: a parameter of the model with start, bounds and scale.

use crate::error::CalibrationError;
use dfo::Kind;
pub use dfo::Transform as Scale;
use ode::Number;
use serde::{Deserialize, Serialize};

/// A parameter to be fitted.
///
/// ```
/// use calibration::Parameter;
/// let friction = Parameter::new("armFriction", 0.012).bounds(0.0, 0.022);
/// assert_eq!(friction.upper(), 0.022);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    name: String,
    variable: String,
    start: f64,
    lower: f64,
    upper: f64,
    scale: Scale,
    nominal: Option<f64>,
    kind: Kind,
    fixed: bool,
    local: bool,
}

impl Parameter {
    /// A parameter named as in the model, without bounds, on a linear scale.
    pub fn new(name: impl Into<String>, start: f64) -> Self {
        let name = name.into();
        Self {
            variable: name.clone(),
            name,
            start,
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            scale: Scale::Linear,
            nominal: None,
            kind: Kind::Continuous,
            fixed: false,
            local: false,
        }
    }

    /// Smallest and largest value; infinities leave a side open.
    #[must_use]
    pub fn bounds(mut self, lower: f64, upper: f64) -> Self {
        (self.lower, self.upper) = (lower, upper);
        self
    }

    /// The scale the optimiser works on: [`Scale::Log`] for positive parameters known only to an order of magnitude. Values and
    /// bounds are in the user's units either way.
    #[must_use]
    pub fn scale(mut self, scale: Scale) -> Self {
        self.scale = scale;
        self
    }

    /// A typical size, from which step lengths and tolerances are taken. On a log scale these are factors, so it is not
    /// used there.
    #[must_use]
    pub fn nominal(mut self, nominal: f64) -> Self {
        self.nominal = Some(nominal);
        self
    }

    /// What values it takes: any (the default), whole numbers, or whole numbers that stand for choices. Not every method
    /// searches over the latter two: [`dfo::DifferentialEvolution`] takes integers, [`dfo::Genetic`] both.
    #[must_use]
    pub fn kind(mut self, kind: Kind) -> Self {
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
        let name = format!("{}[{experiment}]", self.variable);
        Self { name, start: start.unwrap_or(self.start), local: false, ..self.clone() }
    }

    /// Its name: that of the [variable](Self::variable), of a local one followed by the name of the experiment.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The variable of the model that it sets.
    pub fn variable(&self) -> &str {
        &self.variable
    }

    /// Whether each experiment has a value of its own.
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

    /// The scale the optimiser works on.
    pub fn scale_kind(&self) -> Scale {
        self.scale
    }

    /// The typical size, if one was given.
    pub fn nominal_size(&self) -> Option<f64> {
        self.nominal
    }

    /// What values it takes.
    pub fn value_kind(&self) -> Kind {
        self.kind
    }

    /// Whether it is held.
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
        if self.kind != Kind::Continuous && !self.fixed {
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
        Ok(())
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
            (p(0.5, 0.0, 1.0).kind(Kind::Integer), "is integer, so start 0.5 must be a whole number"),
            (p(0.5, 0.1, 0.9).kind(Kind::Categorical), "is categorical, but between its bounds 0.1 and 0.9"),
        ] {
            let e = parameter.check().unwrap_err().to_string();
            assert!(e.contains("'k'") && e.contains(expected), "{e}");
        }
        assert!(p(0.5, 0.0, f64::INFINITY).check().is_ok());
        let held = p(0.5, 0.0, 1.0).fixed(true);
        assert_eq!((held.lower(), held.upper()), (0.5, 0.5));
    }
}
