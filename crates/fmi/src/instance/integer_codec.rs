//! Conversion of values that are not 64-bit floating-point numbers to and from FMUs. All of them are stored
//! in 64-bit words.
//!
//! Integers keep their sign. `UInt64` keeps its bits. Booleans and clocks are 0 and 1. `Float32` is stored as
//! the bits of the equal `f64`.

use crate::description::{Value, Variable, VariableKind};

/// Converts a word to a number.
pub(crate) fn number(kind: VariableKind, word: i64) -> f64 {
    match kind {
        VariableKind::Float32 => f64::from_bits(word as u64),
        VariableKind::UInt64 => word as u64 as f64,
        _ => word as f64,
    }
}

/// Converts a word to a value.
pub(crate) fn value(kind: VariableKind, word: i64) -> Value {
    match kind {
        VariableKind::Float32 => Value::Real(f64::from_bits(word as u64)),
        VariableKind::UInt64 => Value::Integer((word as u64).into()),
        VariableKind::Boolean | VariableKind::Clock => Value::Boolean(word != 0),
        _ => Value::Integer(word.into()),
    }
}

/// Converts a value of its variable's type to a word. Returns `None` if the value does not fit.
pub(crate) fn word(kind: VariableKind, value: &Value) -> Option<i64> {
    match (kind, value) {
        (VariableKind::Float32, Value::Real(x)) => Some(single(*x).to_bits() as i64),
        (VariableKind::Boolean | VariableKind::Clock, Value::Boolean(b)) => Some(i64::from(*b)),
        (kind, Value::Integer(i)) => {
            let (least, most) = kind.range()?;
            (least..=most).contains(i).then_some(*i as i64)
        }
        _ => None,
    }
}

/// Converts a number to a word. Returns `None` if the number is not a value of the type.
pub(crate) fn word_of_number(kind: VariableKind, x: f64) -> Option<i64> {
    match kind {
        VariableKind::Float32 => Some(single(x).to_bits() as i64),
        VariableKind::Boolean | VariableKind::Clock => (x == 0.0 || x == 1.0).then_some(i64::from(x != 0.0)),
        kind => whole(x).and_then(|i| word(kind, &Value::Integer(i))),
    }
}

/// True if a number is a valid value of a variable.
pub(crate) fn is_of(variable: &Variable, x: f64) -> bool {
    let fits = |(least, most): (i128, i128)| whole(x).is_some_and(|i| (least..=most).contains(&i));
    word_of_number(variable.kind, x).is_some() && variable.integer_range().is_none_or(fits)
}

/// Returns the nearest single-precision number.
fn single(x: f64) -> f64 {
    f64::from(x as f32)
}

/// Converts a real to an integer. Returns `None` if the real is not an integer.
pub(crate) fn whole(x: f64) -> Option<i128> {
    let i = x as i128;
    (i as f64 == x).then_some(i)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_survive_the_round_trip_through_words() {
        for (kind, given) in [
            (VariableKind::Int8, Value::Integer(-128)),
            (VariableKind::UInt8, Value::Integer(255)),
            (VariableKind::UInt32, Value::Integer(4_294_967_295)),
            (VariableKind::Int64, Value::Integer(i64::MIN.into())),
            (VariableKind::UInt64, Value::Integer(u64::MAX.into())),
            (VariableKind::Boolean, Value::Boolean(true)),
            (VariableKind::Float32, Value::Real(0.5)),
        ] {
            assert_eq!(word(kind, &given).map(|word| value(kind, word)), Some(given));
        }
        assert_eq!(number(VariableKind::UInt64, -1), 18446744073709551615.0);
        assert_eq!(
            number(VariableKind::Float32, word_of_number(VariableKind::Float32, 0.1).unwrap()),
            f64::from(0.1f32)
        );
    }

    #[test]
    fn word_is_none_for_values_out_of_range() {
        assert_eq!(word(VariableKind::Int8, &Value::Integer(128)), None);
        assert_eq!(word(VariableKind::UInt8, &Value::Integer(-1)), None);
        assert_eq!(word(VariableKind::UInt64, &Value::Integer(1 << 64)), None);
        assert_eq!(word_of_number(VariableKind::Integer, 1.5), None);
        assert_eq!(word_of_number(VariableKind::Integer, f64::NAN), None);
        assert_eq!(word_of_number(VariableKind::Boolean, 2.0), None);
    }
}
