//! Numbers as messages show them.

use std::fmt;

/// Shows a number with as many digits as it has, and with an exponent where they would be a long row of
/// zeros: below 1e-4 and from 1e7 on.
#[derive(Debug, Clone, Copy)]
pub struct Number(pub f64);

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = self.0.abs();
        if size.is_finite() && size != 0.0 && !(1e-4..1e7).contains(&size) {
            write!(f, "{:e}", self.0)
        } else {
            write!(f, "{}", self.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Number;

    #[test]
    fn rows_of_zeros_are_exponents() {
        for (number, text) in [
            (0.0, "0"),
            (1.0, "1"),
            (-0.25, "-0.25"),
            (1e-4, "0.0001"),
            (-1.25e-5, "-1.25e-5"),
            (5e-324, "5e-324"),
            (1_234_567.875, "1234567.875"),
            (1e7, "1e7"),
            (-1e300, "-1e300"),
            (f64::INFINITY, "inf"),
            (f64::NAN, "NaN"),
        ] {
            assert_eq!(Number(number).to_string(), text);
        }
    }
}
