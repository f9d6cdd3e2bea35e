//! Linear form of formulas.

use super::formula::{Expression, Step};

/// Linear expression: a constant plus a sum of names times coefficients.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearForm {
    /// Names and their coefficients, in the order of the names in the expression.
    pub coefficients: Vec<(String, f64)>,
    /// Constant term.
    pub constant: f64,
}

/// Linear form of a part of an expression.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Affine {
    /// One coefficient for each name of the expression.
    pub(crate) slopes: Vec<f64>,
    pub(crate) constant: f64,
}

impl Affine {
    pub(crate) fn constant(n: usize, value: f64) -> Self {
        Self { slopes: vec![0.0; n], constant: value }
    }

    pub(crate) fn is_constant(&self) -> bool {
        self.slopes.iter().all(|slope| *slope == 0.0)
    }

    /// Returns `self + factor * other`.
    pub(crate) fn plus(&self, factor: f64, other: &Self) -> Self {
        let pairs = self.slopes.iter().zip(&other.slopes);
        let slopes = pairs.map(|(a, b)| a + factor * b).collect();
        Self { slopes, constant: self.constant + factor * other.constant }
    }

    /// Returns the factor by which the coefficients are those of another form, if there is one.
    pub(crate) fn multiple_of(&self, other: &Self) -> Option<f64> {
        let at = other.slopes.iter().position(|slope| *slope != 0.0)?;
        let factor = self.slopes.get(at)? / other.slopes[at];
        let is_multiple = self.slopes.iter().zip(&other.slopes).all(|(a, b)| *a == factor * b);
        (factor != 0.0 && is_multiple).then_some(factor)
    }

    /// Returns the lowest and the highest value for names within bounds.
    pub(crate) fn range(&self, bounds: &[(f64, f64)]) -> (f64, f64) {
        let (mut low, mut high) = (0.0, 0.0);
        for (slope, (lower, upper)) in self.slopes.iter().zip(bounds).filter(|(slope, _)| **slope != 0.0) {
            let (one, other) = (slope * lower, slope * upper);
            low += one.min(other);
            high += one.max(other);
        }
        (low + self.constant, high + self.constant)
    }

    fn map(&self, of: impl Fn(f64) -> f64) -> Self {
        Self { slopes: self.slopes.iter().map(|slope| of(*slope)).collect(), constant: of(self.constant) }
    }

    fn is_finite(&self) -> bool {
        self.constant.is_finite() && self.slopes.iter().all(|slope| slope.is_finite())
    }
}

impl Expression {
    /// Returns the linear form of a linear expression, and `None` for any other. `2*(a + b)/4 - 3` is linear,
    /// `a*b` and `1/a` are not.
    pub fn linear_form(&self) -> Option<LinearForm> {
        let Affine { slopes, constant } = self.affine_form()?;
        Some(LinearForm { coefficients: self.names.iter().cloned().zip(slopes).collect(), constant })
    }

    pub(crate) fn affine_form(&self) -> Option<Affine> {
        let n = self.names.len();
        let mut stack: Vec<Affine> = Vec::new();
        for step in &self.program {
            let last = match step {
                Step::Number(value) => Affine::constant(n, *value),
                Step::Name(index) => {
                    let mut form = Affine::constant(n, 0.0);
                    form.slopes.iter_mut().skip(*index).take(1).for_each(|slope| *slope = 1.0);
                    form
                }
                Step::Negate => stack.pop()?.map(|value| -value),
                Step::Call(function) if !function.is_binary() => {
                    let a = stack.pop().filter(Affine::is_constant)?;
                    Affine::constant(n, function.value(a.constant, f64::NAN))
                }
                step => {
                    let (b, a) = (stack.pop()?, stack.pop()?);
                    step.linear(n, &a, &b)?
                }
            };
            if !last.is_finite() {
                return None;
            }
            stack.push(last);
        }
        stack.pop()
    }
}

impl Step {
    fn linear(self, n: usize, a: &Affine, b: &Affine) -> Option<Affine> {
        match self {
            Self::Add => Some(a.plus(1.0, b)),
            Self::Subtract => Some(a.plus(-1.0, b)),
            _ if a.is_constant() && b.is_constant() => {
                Some(Affine::constant(n, self.of_two(a.constant, b.constant)))
            }
            Self::Multiply if a.is_constant() => Some(b.map(|value| a.constant * value)),
            Self::Multiply if b.is_constant() => Some(a.map(|value| value * b.constant)),
            Self::Divide if b.is_constant() => Some(a.map(|value| value / b.constant)),
            Self::Power if b.is_constant() && b.constant == 1.0 => Some(a.clone()),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_expressions_are_recognised_with_their_coefficients() {
        for (text, coefficients, constant) in [
            ("2*(a + b)/4 - 3", &[("a", 0.5), ("b", 0.5)][..], -3.0),
            ("1 - k1 - k2", &[("k1", -1.0), ("k2", -1.0)], 1.0),
            ("-(a - 2*b) + a", &[("a", 0.0), ("b", 2.0)], 0.0),
            ("a**1 * sqrt(4) + max(1, 3)", &[("a", 2.0)], 3.0),
            ("(a - a + 2) * b", &[("a", 0.0), ("b", 2.0)], 0.0),
            ("5", &[], 5.0),
        ] {
            let form = text.parse::<Expression>().unwrap().linear_form().unwrap();
            let expected: Vec<_> =
                coefficients.iter().map(|(name, slope)| ((*name).to_owned(), *slope)).collect();
            assert_eq!((form.coefficients, form.constant), (expected, constant), "{text}");
        }
        for text in ["a*b", "1/a", "a**2", "2**a", "sqrt(a)", "abs(a)", "a/0", "a*1e300*1e300", "min(a, b)"] {
            assert_eq!(text.parse::<Expression>().unwrap().linear_form(), None, "{text}");
        }
    }
}
