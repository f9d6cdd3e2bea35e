//! Relations between formulas: `a <= b`, `k1 + k2 == 1`, `0 <= a <= b`.

use super::error::ExpressionError;
use super::formula::{Criterion, Expression};
use super::parser::Parser;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Relation between two or more expressions over parameters.
///
/// The comparisons are `==`, `<=` and `>=`. `<` and `>` have the same meaning as `<=` and `>=`, because the
/// search cannot distinguish them. In a chain, neighbours are compared: `0 <= a <= b` is `0 <= a` and
/// `a <= b`.
///
/// ```
/// use calibration::Relation;
/// let ordered: Relation = "0.1 <= tau1 <= tau2".parse()?;
/// let [first, second] = &ordered.inequalities()[..] else { panic!() };
/// assert_eq!((first.lower, first.upper), (0.1, f64::INFINITY));
/// assert_eq!((second.lower, second.upper), (f64::NEG_INFINITY, 0.0));
/// assert!(second.expression.linear_form().is_some());
/// # Ok::<(), calibration::ExpressionError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written", into = "String")]
pub struct Relation {
    text: String,
    sides: Vec<Expression>,
    comparisons: Vec<&'static str>,
}

/// Relation as files contain it: a text, or a table with the field `expr`.
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged, expecting = "expected a relation as text, such as \"a <= b\"")]
pub(crate) enum Written {
    Text(String),
    Table(Table),
}

/// Table of a relation.
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub(crate) struct Table {
    /// The relation, such as `k1 + k2 <= 1`.
    expr: String,
}

/// Part of a relation: an expression between two limits.
#[derive(Debug, Clone, PartialEq)]
pub struct Inequality {
    /// The compared part of one comparison, `a <= b`.
    pub text: String,
    /// The expression. If neither side is a number, it is the left side minus the right side.
    pub expression: Expression,
    /// Smallest value, or `-inf`.
    pub lower: f64,
    /// Largest value, or `inf`. It equals `lower` for an equality.
    pub upper: f64,
}

impl Relation {
    /// Returns the text as written.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Returns the names that occur, without duplicates.
    pub fn names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for name in self.sides.iter().flat_map(Expression::names) {
            if !names.contains(&name.as_str()) {
                names.push(name);
            }
        }
        names
    }

    /// Returns the criteria of trajectories that occur.
    pub(crate) fn criteria(&self) -> impl Iterator<Item = &Criterion> {
        self.sides.iter().flat_map(Expression::criteria)
    }

    /// Returns the names that are not the texts of criteria, without duplicates.
    pub(crate) fn names_of_parameters(&self) -> Vec<&str> {
        let is_plain = |name: &&str| !self.sides.iter().any(|side| side.is_criterion(name));
        self.names().into_iter().filter(is_plain).collect()
    }

    /// Returns the comparisons of neighbours.
    pub fn inequalities(&self) -> Vec<Inequality> {
        let pairs = self.sides.windows(2).zip(&self.comparisons);
        pairs
            .filter_map(|(pair, comparison)| Some(compared(pair.first()?, comparison, pair.get(1)?)))
            .collect()
    }

    /// Returns an error that marks the first occurrence of a name.
    pub(crate) fn error_at_name(&self, name: &str, message: impl Into<String>) -> ExpressionError {
        let column = self.sides.iter().find_map(|side| side.column_of(name));
        ExpressionError::new(&self.text, column.unwrap_or(1), message)
    }

    /// Returns an error if a constant has the name of a parameter.
    pub(crate) fn check_constants(&self, is_name: impl Fn(&str) -> bool) -> Result<(), ExpressionError> {
        for side in &self.sides {
            if let Err(error) = side.check_constants(&is_name) {
                return Err(ExpressionError::new(&self.text, error.column, error.message()));
            }
        }
        Ok(())
    }
}

fn compared(left: &Expression, comparison: &str, right: &Expression) -> Inequality {
    let text = format!("{} {comparison} {}", left.text, right.text);
    let number = |side: &Expression| side.names.is_empty().then(|| side.value(&[]));
    // Limits of the left side minus the right side.
    let (low, high) = match comparison {
        "==" => (0.0, 0.0),
        "<=" | "<" => (f64::NEG_INFINITY, 0.0),
        _ => (0.0, f64::INFINITY),
    };
    let (expression, lower, upper) = match (number(left), number(right)) {
        (_, Some(right)) => (left.clone(), low + right, high + right),
        (Some(left), None) => (right.clone(), left - high, left - low),
        (None, None) => (left.minus(right), low, high),
    };
    Inequality { text, expression, lower, upper }
}

/// Parses a side. A side without names must have a finite value.
fn side(parser: &mut Parser<'_>, text: &str) -> Result<Expression, ExpressionError> {
    let column = parser.column();
    let side = parser.sum_of_its_own()?;
    match side.names.is_empty().then(|| side.value(&[])).filter(|value| !value.is_finite()) {
        Some(value) => {
            let message = format!("'{}' is {value}, but a constant side must be finite", side.text);
            Err(ExpressionError::new(text, column, message))
        }
        None => Ok(side),
    }
}

impl FromStr for Relation {
    type Err = ExpressionError;

    fn from_str(text: &str) -> Result<Self, ExpressionError> {
        let mut parser = Parser::new(text)?;
        let mut sides = vec![side(&mut parser, text)?];
        let mut comparisons = Vec::new();
        while let Some(comparison) = parser.comparison() {
            comparisons.push(comparison);
            sides.push(side(&mut parser, text)?);
        }
        match parser.next() {
            Some(word) => Err(parser.unexpected(&word)),
            None if comparisons.is_empty() => {
                Err(parser.error_at_end("a comparison is missing. Write ==, <= or >= and a second side"))
            }
            None => Ok(Self { text: text.to_owned(), sides, comparisons }),
        }
    }
}

impl TryFrom<Written> for Relation {
    type Error = ExpressionError;

    fn try_from(written: Written) -> Result<Self, ExpressionError> {
        match written {
            Written::Text(text) | Written::Table(Table { expr: text }) => text.parse(),
        }
    }
}

impl From<Relation> for String {
    fn from(relation: Relation) -> Self {
        relation.text
    }
}

impl fmt::Display for Relation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Relation {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Relation".into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        Written::json_schema(generator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(text: &str) -> Vec<Inequality> {
        text.parse::<Relation>().unwrap().inequalities()
    }

    #[test]
    fn relations_become_expressions_between_limits() {
        let infinity = f64::INFINITY;
        for (text, expression, lower, upper) in [
            ("k1 + k2 + k3 == 1", "k1 + k2 + k3", 1.0, 1.0),
            ("tau1 <= tau2", "tau1 - (tau2)", -infinity, 0.0),
            ("tau1 > tau2", "tau1 - (tau2)", 0.0, infinity),
            ("0.5 < a", "a", 0.5, infinity),
            ("0.5 >= a", "a", -infinity, 0.5),
            ("m * g / k <= 1/10", "m * g / k", -infinity, 0.1),
            ("1 == a", "a", 1.0, 1.0),
        ] {
            let [row] = &rows(text)[..] else { panic!("{text}") };
            assert_eq!((row.expression.text(), row.lower, row.upper), (expression, lower, upper), "{text}");
        }
        let chain = rows("0 <= a <= b == c");
        let texts: Vec<&str> = chain.iter().map(|row| &row.text[..]).collect();
        assert_eq!(texts, ["0 <= a", "a <= b", "b == c"]);
        let [row] = &rows("a*2 + b <= c - a + 1")[..] else { panic!() };
        let form = row.expression.linear_form().unwrap();
        assert_eq!(form.coefficients, [("a".to_owned(), 3.0), ("b".to_owned(), 1.0), ("c".to_owned(), -1.0)]);
        assert_eq!(form.constant, -1.0);
        // The sign of b is unknown, so the relation is not multiplied out.
        assert_eq!(rows("a / b <= 2")[0].expression.linear_form(), None);
    }

    #[test]
    fn relation_errors_have_columns_of_the_whole_text() {
        for (text, column, expected) in [
            ("a + b", 6, "a comparison is missing"),
            ("a <= ", 5, "is missing at the end"),
            ("a = 1", 3, "Write == for equality"),
            ("a != 1", 3, "Write ==, <= or >="),
            ("a <= b ^ 2", 8, "Write **"),
            ("(a <= b)", 4, "expected an operator"),
            ("<= b", 1, "expected a number, a name"),
            ("a =< b", 3, "Write =="),
            ("a <= 1/0", 6, "'1/0' is inf, but a constant side must be finite"),
            ("log(-1) < a", 1, "is NaN"),
        ] {
            let error = text.parse::<Relation>().unwrap_err();
            assert_eq!(error.column, column, "{text}: {error}");
            assert!(error.to_string().contains(expected), "{text}: {error}");
        }
        let relation: Relation = "a + 1 <= 2 * b".parse().unwrap();
        assert_eq!(relation.error_at_name("b", "unknown").column, 14);
    }

    #[test]
    fn relation_is_read_from_a_text_and_from_a_table() {
        let relation: Relation = serde_json::from_str("\"a <= b\"").unwrap();
        assert_eq!(serde_json::from_str::<Relation>("{\"expr\": \"a <= b\"}").unwrap(), relation);
        assert_eq!(serde_json::to_string(&relation).unwrap(), "\"a <= b\"");
        assert!(serde_json::from_str::<Relation>("\"a ^ b\"").unwrap_err().to_string().contains("column 3"));
    }
}
