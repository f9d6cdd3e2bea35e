//! Numbers as sentences show them.

use base::Number;

/// A number with four digits.
pub(crate) fn digits(value: f64) -> Number {
    Number(format!("{value:.3e}").parse().unwrap_or(value))
}
