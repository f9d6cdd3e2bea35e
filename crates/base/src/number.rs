//! Formatting of numbers in messages.

use std::fmt;

/// Number formatted with its shortest exact digits, with an exponent below 1e-4 and from 1e7. A precision
/// limits the number of significant digits.
#[derive(Debug, Clone, Copy)]
pub struct Number(pub f64);

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rounded =
            f.precision().and_then(|digits| format!("{:.*e}", digits.max(1) - 1, self.0).parse().ok());
        let number = rounded.unwrap_or(self.0);
        let size = number.abs();
        if size.is_finite() && size != 0.0 && !(1e-4..1e7).contains(&size) {
            write!(f, "{number:e}")
        } else {
            write!(f, "{number}")
        }
    }
}

/// Number of bytes formatted with a unit, in powers of 1000.
#[derive(Debug, Clone, Copy)]
pub struct Bytes(pub f64);

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            b if b >= 1e12 => write!(f, "{:.1} TB", b / 1e12),
            b if b >= 1e9 => write!(f, "{:.1} GB", b / 1e9),
            b => write!(f, "{:.1} MB", b / 1e6),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Number;

    #[test]
    fn long_rows_of_zeros_become_exponents() {
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
        for (number, text) in
            [(5.123_456, "5.123"), (1e-7, "1e-7"), (-123_456_789.0, "-1.235e8"), (f64::NAN, "NaN")]
        {
            assert_eq!(format!("{:.4}", Number(number)), text);
        }
    }
}
