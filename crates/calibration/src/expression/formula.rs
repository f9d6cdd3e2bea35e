//! Formula as a program over names.

use super::error::ExpressionError;
use super::function::Function;
use super::lexer;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Instruction of a program in postfix order. Each takes its operands from a stack and leaves its result
/// there. A program needs no recursion, so its length is not limited by the stack of a thread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Step {
    Number(f64),
    /// Value of the name with this index.
    Name(usize),
    Negate,
    Add,
    Subtract,
    Multiply,
    Divide,
    Power,
    Call(Function),
}

/// Formula over names, such as `1 - k1 - k2`.
///
/// ```
/// use calibration::Expression;
/// let third: Expression = "1 - k1 - k2".parse()?;
/// assert_eq!(third.names(), ["k1", "k2"]);
/// assert_eq!(third.value(&[0.5, 0.25]), 0.25);
/// assert_eq!(third.derivatives(&[0.5, 0.25]), [-1.0, -1.0]);
/// let error = "1 - k1 ^ 2".parse::<Expression>().unwrap_err();
/// assert_eq!((error.column, error.message()), (8, "'^' is not an operator. Write ** for a power"));
/// # Ok::<(), calibration::ExpressionError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Expression {
    pub(super) text: String,
    /// Names in the order of their first occurrence.
    pub(super) names: Vec<String>,
    /// Column of the first occurrence of each name, from 1.
    pub(super) columns: Vec<usize>,
    /// Constants that occur, `pi` or `e`, with the column of their first occurrence.
    pub(super) constants: Vec<(&'static str, usize)>,
    pub(super) program: Vec<Step>,
}

impl Expression {
    /// Creates `factor * name + offset`.
    pub(crate) fn affine(name: &str, factor: f64, offset: f64) -> Self {
        let of_name = [Step::Name(0)];
        let scaled = [Step::Number(factor), Step::Name(0), Step::Multiply, Step::Number(offset), Step::Add];
        // The plain name is exact also for an infinite value.
        let program = if (factor, offset) == (1.0, 0.0) { of_name.to_vec() } else { scaled.to_vec() };
        let text = match (factor, offset) {
            (1.0, 0.0) => quoted(name),
            (factor, 0.0) => format!("{factor} * {}", quoted(name)),
            (1.0, offset) => format!("{} + {offset}", quoted(name)),
            (factor, offset) => format!("{factor} * {} + {offset}", quoted(name)),
        };
        Self { text, names: vec![name.to_owned()], columns: vec![1], constants: Vec::new(), program }
    }

    /// Returns the text as written.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Returns the names that occur, in the order of their first occurrence.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Returns an error that marks the first occurrence of a name.
    pub(crate) fn error_at_name(&self, index: usize, message: impl Into<String>) -> ExpressionError {
        ExpressionError::new(&self.text, self.columns.get(index).copied().unwrap_or(1), message)
    }

    /// Returns an error if a constant of the expression has the name of a parameter, so that its meaning
    /// would be unclear. `is_name` is true for names of parameters.
    pub(crate) fn check_constants(&self, is_name: impl Fn(&str) -> bool) -> Result<(), ExpressionError> {
        let Some((constant, column)) = self.constants.iter().find(|(constant, _)| is_name(constant)) else {
            return Ok(());
        };
        let message =
            format!("'{constant}' is a constant and a parameter. Quote the parameter, '{constant}'");
        Err(ExpressionError::new(&self.text, *column, message))
    }
}

/// Returns a name as an expression contains it: plain if possible, otherwise quoted.
pub(super) fn quoted(name: &str) -> String {
    match (lexer::is_plain(name), name.contains('\'')) {
        (true, _) => name.to_owned(),
        (false, false) => format!("'{name}'"),
        (false, true) => format!("\"{name}\""),
    }
}

impl From<Expression> for String {
    fn from(expression: Expression) -> Self {
        expression.text
    }
}

impl fmt::Display for Expression {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Expression {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Expression".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": "string" })
    }
}
