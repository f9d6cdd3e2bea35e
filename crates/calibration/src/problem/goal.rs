//! Goals of a design: criteria of trajectories to minimise or maximise.

use crate::error::CalibrationError;
use crate::expression::{Criterion, Expression, ExpressionError};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Goal of a design: a formula over criteria and parameters, such as `itae(level, 0.3) + 0.1 * max(u)`. It is
/// minimised unless the text begins with `maximize`.
///
/// ```
/// use calibration::Goal;
/// let goal: Goal = "maximize final(yield) - 0.1 * max(T)".parse()?;
/// assert!(goal.is_maximum());
/// # Ok::<(), calibration::ExpressionError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Goal {
    text: String,
    is_maximum: bool,
    expression: Expression,
}

/// Combination of the values of a goal in several scenarios. Each value is multiplied by the
/// [weight](crate::Experiment::scenario_weight) of its scenario.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Combination {
    /// Sum over the scenarios.
    #[default]
    Sum,
    /// Mean over the scenarios.
    Mean,
    /// The worst scenario: the largest value of a goal to minimise, the smallest of one to maximise.
    Worst,
}

impl Combination {
    /// True for the default.
    pub(crate) fn is_sum(&self) -> bool {
        *self == Self::Sum
    }

    /// Returns "sum", "mean" or "worst".
    pub fn name(self) -> &'static str {
        match self {
            Self::Sum => "sum",
            Self::Mean => "mean",
            Self::Worst => "worst",
        }
    }

    /// Returns the combination with this name.
    ///
    /// # Errors
    /// Returns an error that lists the names.
    pub fn named(name: &str) -> Result<Self, CalibrationError> {
        let all = [Self::Sum, Self::Mean, Self::Worst];
        all.into_iter().find(|one| one.name() == name).ok_or_else(|| {
            let names = all.map(Self::name).join(", ");
            CalibrationError::Setup(format!("combine = '{name}' is unknown; available: {names}"))
        })
    }

    /// Returns the combination of costs.
    pub(crate) fn of(self, costs: impl ExactSizeIterator<Item = f64>) -> f64 {
        let n = costs.len() as f64;
        match self {
            Self::Sum => costs.sum(),
            Self::Mean => costs.sum::<f64>() / n,
            Self::Worst => costs.fold(f64::NEG_INFINITY, |worst, cost| {
                if worst.is_nan() || cost.is_nan() { f64::NAN } else { worst.max(cost) }
            }),
        }
    }
}

/// Words before a formula, with their meaning.
const DIRECTIONS: [(&str, bool); 4] =
    [("minimize", false), ("minimise", false), ("maximize", true), ("maximise", true)];

impl Goal {
    /// Returns the text as written.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// True if the formula is maximised.
    pub fn is_maximum(&self) -> bool {
        self.is_maximum
    }

    pub(crate) fn expression(&self) -> &Expression {
        &self.expression
    }

    pub(crate) fn criteria(&self) -> impl Iterator<Item = &Criterion> {
        self.expression.criteria()
    }

    /// Returns an error that marks the first occurrence of a name.
    pub(crate) fn error_at_name(&self, name: &str, message: impl Into<String>) -> ExpressionError {
        let error = self.expression.error_at_name(name, message);
        ExpressionError::new(&self.text, error.column, error.message())
    }
}

impl FromStr for Goal {
    type Err = ExpressionError;

    fn from_str(text: &str) -> Result<Self, ExpressionError> {
        let begin = text.len() - text.trim_start().len();
        let word = text[begin..].split(|c: char| !c.is_alphabetic()).next().unwrap_or_default();
        let rest = text[begin + word.len()..].trim_start();
        // `minimize` may also be the name of a parameter: `minimize + 1`.
        let is_word = rest.starts_with(|c: char| c.is_alphanumeric() || "_('\".-".contains(c));
        let direction = DIRECTIONS.iter().find(|(listed, _)| is_word && listed.eq_ignore_ascii_case(word));
        // Blanks keep the columns.
        let formula = match direction {
            Some(_) => format!("{}{}", " ".repeat(begin + word.len()), &text[begin + word.len()..]),
            None => text.to_owned(),
        };
        let expression: Expression = formula
            .parse()
            .map_err(|error: ExpressionError| ExpressionError::new(text, error.column, error.message()))?;
        let is_maximum = direction.is_some_and(|(_, is_maximum)| *is_maximum);
        Ok(Self { text: text.to_owned(), is_maximum, expression })
    }
}

impl TryFrom<String> for Goal {
    type Error = ExpressionError;

    fn try_from(text: String) -> Result<Self, ExpressionError> {
        text.parse()
    }
}

impl From<Goal> for String {
    fn from(goal: Goal) -> Self {
        goal.text
    }
}

impl fmt::Display for Goal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Goal {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Goal".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": "string" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn goals_have_a_direction_and_columns_of_their_text() {
        for (text, is_maximum) in [
            ("ise(y, 1)", false),
            ("minimize ise(y, 1)", false),
            ("  Maximise (final(y))", true),
            ("maximize -max(y)", true),
            ("maximize + max(y)", false),
        ] {
            let goal: Goal = text.parse().unwrap();
            assert_eq!((goal.is_maximum(), goal.to_string().as_str()), (is_maximum, text));
        }
        for (text, column, expected) in [
            ("maximize final(y", 17, "')' is missing; '(' is at column 15"),
            ("maximize fnal(y)", 10, "'fnal' is not a function; 'final'?"),
            ("", 1, "empty"),
        ] {
            let error = text.parse::<Goal>().unwrap_err();
            assert_eq!(error.column, column, "{text}: {error}");
            assert!(error.to_string().contains(expected), "{error}");
        }
    }

    #[test]
    fn combinations_of_scenarios_match_their_names() {
        let of = |combination: Combination| combination.of([1.0, 4.0, -2.0].into_iter());
        assert_eq!([Combination::Sum, Combination::Mean, Combination::Worst].map(of), [3.0, 1.0, 4.0]);
        assert!(Combination::Worst.of([f64::NAN, 1.0].into_iter()).is_nan());
        assert_eq!(Combination::named("mean").unwrap(), Combination::Mean);
        assert!(Combination::named("best").unwrap_err().to_string().contains("available: sum, mean, worst"));
    }
}
