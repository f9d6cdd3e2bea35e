//! Formula as a program over names.

use super::error::ExpressionError;
use super::function::Function;
use super::functional::Functional;
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

/// Functional of signals. The arguments are formulas over variables of the model.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Criterion {
    pub(crate) functional: Functional,
    pub(crate) arguments: Vec<Expression>,
}

impl Criterion {
    /// Returns the text that identifies the criterion.
    pub(crate) fn text(&self) -> String {
        let arguments: Vec<&str> = self.arguments.iter().map(Expression::text).collect();
        format!("{}({})", self.functional.name(), arguments.join(", "))
    }
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
    /// Criteria of trajectories, each with the index of its text among the names.
    pub(super) criteria: Vec<(usize, Criterion)>,
}

impl Expression {
    /// Creates an expression without a program.
    pub(super) fn empty(text: &str) -> Self {
        Self {
            text: text.to_owned(),
            names: Vec::new(),
            columns: Vec::new(),
            constants: Vec::new(),
            program: Vec::new(),
            criteria: Vec::new(),
        }
    }

    /// Returns the index of a name, which is added if it is new.
    pub(super) fn index_of(&mut self, name: &str, column: usize) -> usize {
        self.names.iter().position(|known| known == name).unwrap_or_else(|| {
            self.names.push(name.to_owned());
            self.columns.push(column);
            self.names.len() - 1
        })
    }

    /// Adds the program of another expression, which leaves one more value on the stack.
    pub(super) fn append(&mut self, other: &Self) {
        let places: Vec<usize> = other
            .names
            .iter()
            .zip(&other.columns)
            .map(|(name, column)| self.index_of(name, *column))
            .collect();
        self.program.extend(other.program.iter().map(|step| match step {
            Step::Name(index) => Step::Name(places[*index]),
            step => *step,
        }));
        for (constant, column) in &other.constants {
            if self.constants.iter().all(|(listed, _)| listed != constant) {
                self.constants.push((constant, *column));
            }
        }
        for (index, criterion) in &other.criteria {
            if self.criteria.iter().all(|(listed, _)| *listed != places[*index]) {
                self.criteria.push((places[*index], criterion.clone()));
            }
        }
    }

    /// Returns this expression minus another one.
    pub(crate) fn minus(&self, other: &Self) -> Self {
        let mut made = self.clone();
        made.text = format!("{} - ({})", self.text, other.text);
        made.append(other);
        made.program.push(Step::Subtract);
        made
    }

    /// Returns the criteria of trajectories that occur.
    pub(crate) fn criteria(&self) -> impl Iterator<Item = &Criterion> {
        self.criteria.iter().map(|(_, criterion)| criterion)
    }

    /// True if a name is the text of a criterion.
    pub(crate) fn is_criterion(&self, name: &str) -> bool {
        self.criteria.iter().any(|(index, _)| self.names.get(*index).is_some_and(|text| text == name))
    }

    /// Returns the column of the first occurrence of a name, also inside a criterion.
    pub(super) fn column_of(&self, name: &str) -> Option<usize> {
        let own = self.names.iter().position(|listed| listed == name).map(|index| self.columns[index]);
        let inside =
            || self.criteria().flat_map(|c| &c.arguments).find_map(|argument| argument.column_of(name));
        own.or_else(inside)
    }

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
        Self { text, names: vec![name.to_owned()], columns: vec![1], program, ..Self::empty("") }
    }

    /// Returns the text as written.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Returns the names that occur, in the order of their first occurrence.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Returns an error that marks the first occurrence of a name, also inside a criterion.
    pub(crate) fn error_at_name(&self, name: &str, message: impl Into<String>) -> ExpressionError {
        ExpressionError::new(&self.text, self.column_of(name).unwrap_or(1), message)
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
