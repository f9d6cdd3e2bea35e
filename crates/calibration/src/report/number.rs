//! Numbers in tables, with few digits.

use base::Number;

/// Formats a number with `digits` significant digits (at least one), without trailing zeros.
pub(super) fn rounded(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return Number(value).to_string();
    }
    // The shortest representation of the rounded number has no trailing zeros.
    let text = format!("{value:.*e}", digits.max(1) - 1);
    text.parse().map_or(text, |rounded| Number(rounded).to_string())
}

/// Formats a value with the digits that are significant given its standard error: to two digits of the error,
/// 9 digits at most.
pub(super) fn with_error(value: f64, error: f64) -> String {
    if !(value.is_finite() && error.is_finite() && error > 0.0) || value == 0.0 {
        return rounded(value, 8);
    }
    let size = value.abs().log10().floor();
    let digits = (size - error.log10().floor() + 2.0).clamp(2.0, 9.0);
    // Trailing zeros are significant here.
    match digits - 1.0 - size {
        decimals if decimals >= 0.0 && (-4.0..7.0).contains(&size) => {
            format!("{value:.*}", decimals as usize)
        }
        _ => rounded(value, digits as usize),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_follow_the_standard_error() {
        for (value, error, text) in [
            (0.010000441, 1.38e-5, "0.010000"),
            (0.010012441, 1.38e-5, "0.010012"),
            (20311.53, 71.2, "20312"),
            (-1.23456789e-12, 1e-14, "-1.235e-12"),
            (3.0, 100.0, "3.0"),
            (20311.53, 7100.0, "20300"),
            (2.5, f64::INFINITY, "2.5"),
            (1.0 / 3.0, 0.0, "0.33333333"),
            (f64::NAN, 1.0, "NaN"),
        ] {
            assert_eq!(with_error(value, error), text);
        }
        assert_eq!(rounded(1234.5, 2), "1200");
        assert_eq!(rounded(-0.0, 3), "-0");
    }
}
