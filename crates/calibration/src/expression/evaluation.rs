//! Values and derivatives of formulas.

use super::formula::{Expression, Step};

impl Expression {
    /// Returns the value. `values` contains one value for each of the [names](Self::names). It is NaN where a
    /// function is undefined, and if values are missing.
    pub fn value(&self, values: &[f64]) -> f64 {
        self.value_with(values, &mut Vec::with_capacity(8))
    }

    /// Returns the value like [`value`](Self::value), with work space.
    pub(crate) fn value_with(&self, values: &[f64], stack: &mut Vec<f64>) -> f64 {
        stack.clear();
        for step in &self.program {
            let last = match step {
                Step::Number(value) => *value,
                Step::Name(index) => values.get(*index).copied().unwrap_or(f64::NAN),
                Step::Negate => -pop(stack),
                Step::Call(function) if !function.is_binary() => function.value(pop(stack), f64::NAN),
                step => {
                    let (b, a) = (pop(stack), pop(stack));
                    step.of_two(a, b)
                }
            };
            stack.push(last);
        }
        pop(stack)
    }

    /// Returns the partial derivatives with respect to the [names](Self::names), exact up to rounding
    /// (forward mode: Griewank and Walther, Evaluating Derivatives, 2008, chapter 3).
    pub fn derivatives(&self, values: &[f64]) -> Vec<f64> {
        let n = self.names.len();
        let mut stack: Vec<(f64, Vec<f64>)> = Vec::new();
        for step in &self.program {
            let last = match step {
                Step::Number(value) => (*value, vec![0.0; n]),
                Step::Name(index) => {
                    let mut slopes = vec![0.0; n];
                    slopes.iter_mut().skip(*index).take(1).for_each(|slope| *slope = 1.0);
                    (values.get(*index).copied().unwrap_or(f64::NAN), slopes)
                }
                Step::Negate => {
                    let (value, slopes) = stack.pop().unwrap_or_default();
                    (-value, slopes.iter().map(|slope| -slope).collect())
                }
                Step::Call(function) if !function.is_binary() => {
                    let (a, slopes) = stack.pop().unwrap_or_default();
                    let (da, _) = function.derivatives(a, f64::NAN);
                    let scaled = slopes.iter().map(|slope| times(da, *slope)).collect();
                    (function.value(a, f64::NAN), scaled)
                }
                step => {
                    let (b, of_b) = stack.pop().unwrap_or_default();
                    let (a, of_a) = stack.pop().unwrap_or_default();
                    let (da, db) = step.slopes_of_two(a, b);
                    let pairs = of_a.iter().zip(&of_b);
                    let sums = pairs.map(|(of_a, of_b)| times(da, *of_a) + times(db, *of_b)).collect();
                    (step.of_two(a, b), sums)
                }
            };
            stack.push(last);
        }
        stack.pop().unwrap_or_default().1
    }
}

impl Step {
    pub(super) fn of_two(self, a: f64, b: f64) -> f64 {
        match self {
            Self::Add => a + b,
            Self::Subtract => a - b,
            Self::Multiply => a * b,
            Self::Divide => a / b,
            Self::Power => power(a, b),
            Self::Call(function) => function.value(a, b),
            Self::Number(_) | Self::Name(_) | Self::Negate => f64::NAN,
        }
    }

    fn slopes_of_two(self, a: f64, b: f64) -> (f64, f64) {
        match self {
            Self::Add => (1.0, 1.0),
            Self::Subtract => (1.0, -1.0),
            Self::Multiply => (b, a),
            Self::Divide => (1.0 / b, -a / (b * b)),
            // The power of 0 is constant in a positive exponent.
            Self::Power if a == 0.0 && b > 0.0 => (b * power(a, b - 1.0), 0.0),
            Self::Power => (b * power(a, b - 1.0), power(a, b) * a.ln()),
            Self::Call(function) => function.derivatives(a, b),
            Self::Number(_) | Self::Name(_) | Self::Negate => (f64::NAN, f64::NAN),
        }
    }
}

/// Returns a power. Small integer exponents are products, which are exact where the product is.
fn power(a: f64, b: f64) -> f64 {
    match b {
        2.0 => a * a,
        3.0 => a * a * a,
        _ => a.powf(b),
    }
}

/// Returns the product of a slope of a function and a slope of its argument. A constant argument has no
/// influence, even where the function has no slope: `sqrt(0) * a`.
fn times(outer: f64, inner: f64) -> f64 {
    if inner == 0.0 { 0.0 } else { outer * inner }
}

fn pop(stack: &mut Vec<f64>) -> f64 {
    stack.pop().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_match_central_differences() {
        for text in [
            "a*b + c/a - 2*c",
            "a**b + b**3 + c**-1.5",
            "sqrt(a) + exp(b/3) * log(c) + log10(a*b)",
            "abs(a - 5) + min(a, b, c) + max(a*2, b)",
            "sin(a) * cos(b) + tan(c/7)",
            "asin(a/9) + acos(b/9) + atan(c)",
            "atan2(a, b) + sinh(a/3) + cosh(b/3) + tanh(c/3)",
            "-(a - -b) / (1 + c**2)",
        ] {
            let expression: Expression = text.parse().unwrap();
            let at: Vec<f64> = expression
                .names()
                .iter()
                .map(|name| match &name[..] {
                    "a" => 1.3,
                    "b" => 2.1,
                    _ => 0.7,
                })
                .collect();
            for (i, slope) in expression.derivatives(&at).into_iter().enumerate() {
                let moved = |by: f64| {
                    let mut moved = at.clone();
                    moved[i] += by;
                    expression.value(&moved)
                };
                let expected = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                assert!(
                    (slope - expected).abs() < 1e-8 * (1.0 + expected.abs()),
                    "{text}: {slope} {expected}"
                );
            }
        }
    }

    #[test]
    fn derivatives_at_special_points_are_finite_where_they_exist() {
        let at = |text: &str, values: &[f64]| text.parse::<Expression>().unwrap().derivatives(values);
        assert_eq!(at("a**2", &[0.0]), [0.0]);
        assert_eq!(at("a**2", &[-3.0]), [-6.0]);
        assert_eq!(at("2**a", &[0.0]), [2.0_f64.ln()]);
        assert_eq!(at("sqrt(0)*a", &[5.0]), [0.0]);
        assert_eq!(at("abs(a)", &[0.0]), [0.0]);
        assert_eq!(at("max(a, b)", &[1.0, 1.0]), [1.0, 0.0]);
    }

    #[test]
    fn undefined_values_are_nan() {
        for text in ["sqrt(a)", "log(a)", "max(a, sqrt(a))", "min(sqrt(a), a)", "a**0.5", "asin(a*9)"] {
            assert!(text.parse::<Expression>().unwrap().value(&[-1.0]).is_nan(), "{text}");
        }
        assert!("a + b".parse::<Expression>().unwrap().value(&[1.0]).is_nan());
    }
}
