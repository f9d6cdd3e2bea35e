//! Formulas over parameters: text, values, exact derivatives, and the linear form of linear ones.
//!
//! The grammar, from the weakest to the strongest operator:
//!
//! ```text
//! relation   = sum (("==" | "<=" | ">=" | "<" | ">") sum)+
//! sum        = product (("+" | "-") product)*
//! product    = sign (("*" | "/") sign)*
//! sign       = ("+" | "-") sign | power
//! power      = atom ("**" sign)?
//! atom       = number | name | function "(" sum ("," sum)* ")" | criterion "(" sum ("," sum)* ")" | "(" sum ")"
//! ```
//!
//! A criterion is a number that a simulation determines, such as `max(T)` or `ise(level, 0.3)`. Its arguments
//! are formulas over variables of the model instead of parameters. `max` and `min` of one argument are
//! criteria. The rest of the formula treats a criterion like a name.
//!
//! A name is written as in FMI, `arm.friction` or `k[1]`. Names with other characters are quoted, `'my name'`
//! or `"it's"`. The crate exmex is the closest alternative, but its errors have no column, its names are
//! enclosed in braces, its power is `^`, and it does not recognise linear expressions.

mod error;
mod evaluation;
mod formula;
mod function;
mod functional;
mod lexer;
mod linear;
mod parser;
mod relation;
mod terms;

pub use error::ExpressionError;
pub(crate) use formula::Criterion;
pub use formula::Expression;
pub(crate) use function::nearest;
pub(crate) use functional::Functional;
pub(crate) use linear::Affine;
pub use linear::LinearForm;
pub use relation::{Inequality, Relation};
pub(crate) use terms::Factor;
