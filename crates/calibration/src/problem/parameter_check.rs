//! Checks of the numbers of a parameter.

use crate::error::CalibrationError;
use crate::expression::Expression;
use crate::problem::parameter::{Parameter, Scale, Target, Tie};
use crate::problem::prior::Prior;
use base::Number;
use dfo::ParameterKind;

impl Parameter {
    /// Checks that the numbers are valid and consistent.
    ///
    /// # Errors
    /// Returns an error with the name of the parameter and the inconsistent numbers.
    pub fn check(&self) -> Result<(), CalibrationError> {
        let name = &self.name;
        let bad = |message: String| Err(CalibrationError::Parameter { name: name.clone(), message });
        if name.is_empty() {
            return bad("a parameter needs a name".to_owned());
        }
        let n_targets = [
            self.variables.is_some(),
            self.delay_of.is_some(),
            self.offset_of.is_some(),
            self.factor_of.is_some(),
        ];
        if n_targets.into_iter().filter(|is_given| *is_given).count() > 1 {
            return bad(
                "variables, delay_of, offset_of and factor_of exclude each other. Specify at most one of them"
                    .to_owned(),
            );
        }
        if let (Target::Factor(_), Some(unit)) = (self.target(), &self.unit) {
            return bad(format!("is a factor, which has no unit, but unit is '{unit}'. Omit unit"));
        }
        match (self.tie(), &self.expr) {
            (Some(_), Some(_)) => return bad("has tied_to and expr. Specify one of them".to_owned()),
            (Some(tie), None) => return self.check_tie(tie),
            (None, Some(expr)) => return self.check_derived(expr),
            (None, None) => {}
        }
        if (self.factor, self.offset, self.across_units) != (1.0, 0.0, false) {
            return bad(
                "factor, offset and across_units require tied_to. Specify the parameter to which it is tied"
                    .to_owned(),
            );
        }
        let Some(start) = self.start else {
            return bad("start is missing. Specify a start value, or expr for a derived parameter".to_owned());
        };
        let (lower, upper) = self.given_bounds();
        let [first, low, high] = [start, lower, upper].map(Number);
        if !start.is_finite() {
            return bad(format!("start {first} is not finite"));
        }
        if lower.is_nan() || upper.is_nan() {
            return bad(format!("bounds {low} and {high} must not be NaN"));
        }
        if lower > upper {
            return bad(format!("lower bound {low} is above upper bound {high}"));
        }
        if !self.fixed && !(lower..=upper).contains(&start) {
            return bad(format!("start {first} is outside of the bounds {low} and {high}"));
        }
        if self.kind != ParameterKind::Continuous && !self.fixed {
            if lower.ceil() > upper.floor() {
                let kind = self.kind;
                return bad(format!("is {kind}, but its bounds {low} and {high} contain no integer"));
            }
            if start.fract() != 0.0 {
                return bad(format!("is {}, so start {first} must be an integer", self.kind));
            }
        }
        if self.scale == Scale::Log && !self.fixed && (start <= 0.0 || (lower.is_finite() && lower <= 0.0)) {
            return bad(format!(
                "a log scale requires values above 0, but the start is {first} and the lower bound {low}"
            ));
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
        if let Some((what, value)) = likeliest.filter(|(_, value)| !(lower..=upper).contains(value))
            && !self.fixed
        {
            let value = Number(value);
            return bad(format!(
                "the {what} of its prior, {value}, is outside of its bounds {low} and {high}. Widen the bounds, or correct the prior"
            ));
        }
        if matches!(self.prior, Some(Prior::LogNormal { .. }))
            && !self.fixed
            && self.scale != Scale::Log
            && lower <= 0.0
        {
            return bad(format!(
                "its log-normal prior requires values above 0, but its lower bound is {low}. Set a lower bound above 0, or scale = log"
            ));
        }
        if self.periodic {
            let others = [
                (self.scale == Scale::Log, "a log scale"),
                (self.kind != ParameterKind::Continuous, "integer values"),
                (self.prior.is_some(), "a prior"),
                (matches!(self.target(), Target::Delay(_)), "delay_of"),
            ];
            if let Some((_, other)) = others.into_iter().find(|(is_given, _)| *is_given) {
                return bad(format!(
                    "is periodic, which cannot be combined with {other}. Remove one of them"
                ));
            }
            if !(lower < upper && (upper - lower).is_finite()) {
                return bad(format!(
                    "is periodic, so its period is the difference of its bounds, but they are {low} and {high}. Set both bounds"
                ));
            }
        }
        if matches!(self.target(), Target::Delay(_)) && !self.lower().is_finite() {
            return bad(format!(
                "a delay requires a finite lower bound, not {low}. Set lower = 0, for example"
            ));
        }
        Ok(())
    }

    fn check_derived(&self, expr: &Expression) -> Result<(), CalibrationError> {
        let name = &self.name;
        let bad = |message: String| Err(CalibrationError::Parameter { name: name.clone(), message });
        if self.start.is_some() {
            return bad(format!("its value follows from expr, '{expr}'. Omit start"));
        }
        if expr.names().is_empty() {
            return bad(format!("expr '{expr}' contains no parameter. Use a start with fixed = true"));
        }
        let (lower, upper) = self.given_bounds();
        let [low, high] = [lower, upper].map(Number);
        if lower.is_nan() || upper.is_nan() {
            return bad(format!("bounds {low} and {high} must not be NaN"));
        }
        if lower > upper {
            return bad(format!("lower bound {low} is above upper bound {high}"));
        }
        let (own_lower, own_upper) = (self.lower, self.upper);
        let display_name = self.display_name.clone();
        let searched = Self { periodic: false, ..self.without_search() };
        let bare = Self {
            display_name,
            lower: own_lower,
            upper: own_upper,
            prior: None,
            factor: 1.0,
            offset: 0.0,
            across_units: false,
            ..searched
        };
        if *self != bare {
            return bad(format!(
                "its value follows from expr, '{expr}', so scale, nominal, kind, fixed, periodic, local, prior, factor, offset and \
                 across_units have no meaning. Omit them"
            ));
        }
        Ok(())
    }

    fn check_tie(&self, Tie { to, factor, offset, .. }: Tie<'_>) -> Result<(), CalibrationError> {
        let name = &self.name;
        let bad = |message: String| Err(CalibrationError::Parameter { name: name.clone(), message });
        if self.start.is_some() {
            return bad("it is tied to another parameter, which determines the start. Omit start".to_owned());
        }
        if !factor.is_finite() || factor == 0.0 || !offset.is_finite() {
            let [factor, offset] = [factor, offset].map(Number);
            return bad(format!(
                "it is tied to '{to}' with factor {factor} and offset {offset}. Both must be finite, and the factor must not be 0"
            ));
        }
        // The other parameter determines the settings of the search and the prior.
        if self.periodic {
            return bad(format!(
                "it is tied to '{to}', which determines whether it is periodic. Omit periodic"
            ));
        }
        let bare = Self { display_name: self.display_name.clone(), prior: None, ..self.without_search() };
        if *self != bare {
            return bad(format!(
                "it is tied to '{to}', which determines start, bounds, scale, nominal, kind, fixed, local and prior. Omit them here"
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameter_check_names_bad_numbers() {
        let p = |start: f64, lower: f64, upper: f64| Parameter::new("k", start).bounds(lower, upper);
        for (parameter, expected) in [
            (p(f64::NAN, 0.0, 1.0), "start NaN"),
            (p(0.5, 2.0, 1.0), "lower bound 2 is above upper bound 1"),
            (p(3.0, 0.0, 1.0), "start 3 is outside of the bounds 0 and 1"),
            (p(0.5, f64::NAN, 1.0), "NaN"),
            (p(0.0, f64::NEG_INFINITY, 1.0).scale(Scale::Log), "above 0, but the start is 0"),
            (p(0.5, 0.0, 1.0).scale(Scale::Log), "above 0, but the start is 0.5 and the lower bound 0"),
            (p(0.5, 0.0, 1.0).nominal(0.0), "nominal 0"),
            (p(0.5, 0.0, 1.0).nominal(-3.0), "nominal -3 must be positive"),
            (p(0.5, 0.0, 1.0).kind(ParameterKind::Integer), "is integer, so start 0.5 must be an integer"),
            (p(0.5, 0.1, 0.9).kind(ParameterKind::Categorical), "is categorical, but its bounds 0.1 and 0.9"),
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
            (relative(0.0, 0.1), "Set a lower bound above 0"),
            (normal(1.5, 1.0), "the mean of its prior, 1.5, is outside of its bounds 0 and 1"),
            (
                p(0.5, 0.2, 0.9).prior(Prior::LogNormal { median: 0.1, sigma: 1.0 }),
                "the median of its prior, 0.1, is outside",
            ),
            (p(0.5, f64::NEG_INFINITY, 1.0).delay_of("y"), "a delay requires a finite lower bound"),
            (Parameter::tied("k", "c", 0.0, 1.0), "factor 0 and offset 1"),
            (Parameter::tied("k", "c", 1.0, f64::INFINITY), "offset inf"),
            (Parameter::tied("k", "c", 1.0, 0.0).bounds(0.0, 1.0), "which determines start"),
            (Parameter::tied("k", "c", 1.0, 0.0).local(true), "Omit them here"),
            (Parameter::derived("k", "2*3").unwrap(), "contains no parameter"),
            (Parameter::derived("k", "c").unwrap().bounds(2.0, 1.0), "lower bound 2 is above upper bound 1"),
            (Parameter::derived("k", "c").unwrap().fixed(true), "so scale, nominal, kind, fixed"),
            (Parameter::derived("k", "c").unwrap().scale(Scale::Log), "so scale, nominal, kind, fixed"),
            (Parameter::tied("k", "c", 1.0, 0.0).expression("c").unwrap(), "has tied_to and expr"),
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
