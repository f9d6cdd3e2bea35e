//! Types of variables, and their values.

use crate::macros::words;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Relative difference of two numbers up to which they count as equal. A value stored in single precision, or
/// printed and read, may differ by this much.
const FEWER_DIGITS: f64 = 1e-6;

/// True if two values are the same number, up to a loss of digits.
pub(crate) fn is_same_number(one: f64, other: f64) -> bool {
    one == other || (one - other).abs() <= FEWER_DIGITS * one.abs().max(other.abs()).min(f64::MAX)
}

words! {
    /// Type of a variable. The name follows FMI 2.0, or FMI 3.0 for types that FMI 2.0 does not have.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    #[non_exhaustive]
    pub enum VariableKind {
        /// Double precision number (`Float64` of FMI 3.0).
        #[default]
        Real = "Real",
        /// Single precision number.
        Float32 = "Float32",
        /// 32-bit integer (`Int32` of FMI 3.0).
        Integer = "Integer",
        /// Signed 8-bit integer.
        Int8 = "Int8",
        /// Unsigned 8-bit integer.
        UInt8 = "UInt8",
        /// Signed 16-bit integer.
        Int16 = "Int16",
        /// Unsigned 16-bit integer.
        UInt16 = "UInt16",
        /// Unsigned 32-bit integer.
        UInt32 = "UInt32",
        /// Signed 64-bit integer.
        Int64 = "Int64",
        /// Unsigned 64-bit integer.
        UInt64 = "UInt64",
        /// Boolean.
        Boolean = "Boolean",
        /// String.
        String = "String",
        /// Bytes.
        Binary = "Binary",
        /// One of the items of a type definition, passed as an integer.
        Enumeration = "Enumeration",
        /// A clock: true while it ticks.
        Clock = "Clock",
    }
}

impl VariableKind {
    /// True for floating-point types.
    pub fn is_float(self) -> bool {
        matches!(self, VariableKind::Real | VariableKind::Float32)
    }

    /// True for integer types and enumerations.
    pub fn is_integer(self) -> bool {
        self.range().is_some()
    }

    /// Returns the smallest and the largest value of an integer type.
    pub(crate) fn range(self) -> Option<(i128, i128)> {
        Some(match self {
            VariableKind::Int8 => (i8::MIN.into(), i8::MAX.into()),
            VariableKind::UInt8 => (0, u8::MAX.into()),
            VariableKind::Int16 => (i16::MIN.into(), i16::MAX.into()),
            VariableKind::UInt16 => (0, u16::MAX.into()),
            VariableKind::Integer => (i32::MIN.into(), i32::MAX.into()),
            VariableKind::UInt32 => (0, u32::MAX.into()),
            VariableKind::Int64 | VariableKind::Enumeration => (i64::MIN.into(), i64::MAX.into()),
            VariableKind::UInt64 => (0, u64::MAX.into()),
            _ => return None,
        })
    }

    /// True if values are numbers and can be stored in results.
    pub fn is_number(self) -> bool {
        !matches!(self, VariableKind::String | VariableKind::Binary)
    }
}

/// A value of a variable. Enumerations are stored as integers, clocks as Booleans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Value {
    /// A floating-point number.
    Real(f64),
    /// An integer of any width, or the value of an enumeration.
    Integer(i128),
    /// Boolean.
    Boolean(bool),
    /// String.
    String(String),
    /// Bytes.
    Binary(Vec<u8>),
    /// The elements of an array, all of one type, in row-major order (the last index varies fastest).
    Array(Vec<Value>),
}

impl Value {
    /// Returns the nearest floating-point number; Booleans are 0 or 1. Returns `None` for strings, bytes and
    /// arrays.
    pub fn as_number(&self) -> Option<f64> {
        match self {
            Value::Real(x) => Some(*x),
            Value::Integer(i) => Some(*i as f64),
            Value::Boolean(b) => Some(f64::from(u8::from(*b))),
            Value::String(_) | Value::Binary(_) | Value::Array(_) => None,
        }
    }

    /// Returns the name of the type.
    pub fn kind_name(&self) -> &'static str {
        match self {
            Value::Real(_) => "Real",
            Value::Integer(_) => "Integer",
            Value::Boolean(_) => "Boolean",
            Value::String(_) => "String",
            Value::Binary(_) => "Binary",
            Value::Array(_) => "array",
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Real(x) => write!(f, "{x:?}"),
            Value::Integer(i) => write!(f, "{i}"),
            Value::Boolean(b) => write!(f, "{b}"),
            Value::String(s) => write!(f, "{s:?}"),
            Value::Binary(bytes) => write!(f, "{} bytes", bytes.len()),
            Value::Array(values) => {
                f.write_str("[")?;
                for (i, value) in values.iter().take(10).enumerate() {
                    if i > 0 {
                        f.write_str(", ")?;
                    }
                    value.fmt(f)?;
                }
                f.write_str(if values.len() > 10 { ", ...]" } else { "]" })
            }
        }
    }
}

macro_rules! from {
    ($($type:ty => |$value:ident| $made:expr;)+) => {
        $(impl From<$type> for Value {
            fn from($value: $type) -> Self {
                $made
            }
        })+
    };
}
from! {
    f64 => |x| Value::Real(x);
    i8 => |i| Value::Integer(i.into());
    u8 => |i| Value::Integer(i.into());
    i16 => |i| Value::Integer(i.into());
    u16 => |i| Value::Integer(i.into());
    i32 => |i| Value::Integer(i.into());
    u32 => |i| Value::Integer(i.into());
    i64 => |i| Value::Integer(i.into());
    u64 => |i| Value::Integer(i.into());
    i128 => |i| Value::Integer(i);
    bool => |truth| Value::Boolean(truth);
    &str => |text| Value::String(text.to_owned());
    String => |text| Value::String(text);
}

impl<T: Into<Value>> From<Vec<T>> for Value {
    fn from(values: Vec<T>) -> Self {
        Value::Array(values.into_iter().map(Into::into).collect())
    }
}
