//! Formulas that are sums of products.

use super::formula::{Expression, Step};
use super::function::Function;

/// Factor of a product.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Factor<'e> {
    Number(f64),
    Name(&'e str),
    /// Absolute value of a name.
    Magnitude(&'e str),
}

impl Expression {
    /// Returns the factors of each term of a sum of products of numbers, names and absolute values of names.
    /// Returns `None` for any other expression, and for one with constants.
    pub(crate) fn terms(&self) -> Option<Vec<Vec<Factor<'_>>>> {
        let mut stack: Vec<Vec<Vec<Factor<'_>>>> = Vec::new();
        for step in self.program.iter().filter(|_| self.constants.is_empty()) {
            let last = match step {
                Step::Number(value) => vec![vec![Factor::Number(*value)]],
                Step::Name(index) => vec![vec![Factor::Name(self.names.get(*index)?)]],
                Step::Call(Function::Abs) => match stack.pop()?.as_slice() {
                    [term] => match term[..] {
                        [Factor::Name(name)] => vec![vec![Factor::Magnitude(name)]],
                        _ => return None,
                    },
                    _ => return None,
                },
                Step::Add => {
                    let (b, mut a) = (stack.pop()?, stack.pop()?);
                    a.extend(b);
                    a
                }
                Step::Multiply => match (stack.pop()?.as_slice(), stack.pop()?.as_slice()) {
                    ([b], [a]) => vec![a.iter().chain(b).copied().collect()],
                    _ => return None,
                },
                _ => return None,
            };
            stack.push(last);
        }
        stack.pop()
    }
}
