//! Variables and their types: name, value reference, causality, variability, start value.

use super::clock::ClockTiming;
use std::fmt;

/// A variable of the model: one value, or an array of them. Attributes that a type definition supplies are already filled in.
#[derive(Debug, Clone, PartialEq)]
pub struct Variable {
    /// Name, unique in the model.
    pub name: String,
    /// Handle for get and set calls; unique per kind only, aliases share it.
    pub value_reference: u32,
    /// What it means.
    pub description: Option<String>,
    /// Type of the value.
    pub kind: VariableKind,
    /// Role towards the outside.
    pub causality: Causality,
    /// When it may change.
    pub variability: Variability,
    /// How its initial value comes about: as the file says, else the standard's default;
    /// `None` for inputs and the independent variable.
    pub initial: Option<Initial>,
    /// May be set several times at one instant (default true).
    pub can_handle_multiple_set_per_time_instant: bool,
    /// Line in the file, counted from 1.
    pub line: u32,
    /// Name of the type definition.
    pub declared_type: Option<String>,
    /// Physical quantity.
    pub quantity: Option<String>,
    /// Unit of the value, min, max, nominal and start.
    pub unit: Option<String>,
    /// Unit for showing it.
    pub display_unit: Option<String>,
    /// Offsets of display units do not apply (a difference of temperatures).
    pub relative_quantity: bool,
    /// A state that grows without bound: relative tolerance should not apply (FMI 2.0 `unbounded`).
    pub unbounded: bool,
    /// Smallest value.
    pub min: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
    /// Typical magnitude, as the file says: may be 0, negative or NaN.
    pub nominal: Option<f64>,
    /// Start value.
    pub start: Option<Value>,
    /// Index of the variable this one is the time derivative of.
    pub derivative: Option<usize>,
    /// A state that events may set anew.
    pub reinit: bool,
    /// The model's value with its sign (a Boolean: its truth) reversed: a negated alias of FMI 1.0.
    pub negated: bool,
    /// Extents of an array, the last one varying fastest; empty for a single value.
    pub dimensions: Vec<Dimension>,
    /// Further names of the variable.
    pub aliases: Vec<Alias>,
    /// Positions of the clocks it belongs to.
    pub clocks: Vec<usize>,
    /// Of a clock: when it ticks.
    pub clock: Option<Box<ClockTiming>>,
    /// It can be set or read while a co-simulation makes a step (FMI 3.0).
    pub intermediate_update: bool,
    /// Its value is an `int` whatever its type: enumerations of FMI 1.0 and 2.0.
    pub(crate) is_narrow: bool,
}

impl Variable {
    /// Smallest and largest value of a variable of an integer type.
    pub(crate) fn integer_range(&self) -> Option<(i128, i128)> {
        let kind = if self.is_narrow { VariableKind::Integer } else { self.kind };
        kind.range()
    }
}

/// Extent of an array in one direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dimension {
    /// Always the same.
    Fixed(usize),
    /// The value of a structural parameter, by its position.
    Parameter(usize),
}

/// A further name of a variable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Alias {
    /// The name; lookups find the variable by it.
    pub name: String,
    /// What it means.
    pub description: Option<String>,
    /// Unit for showing the value under this name.
    pub display_unit: Option<String>,
}

/// A type that variables refer to by `declaredType`.
#[derive(Debug, Clone, PartialEq)]
pub struct TypeDefinition {
    /// Name.
    pub name: String,
    /// What it means.
    pub description: Option<String>,
    /// Type of the values.
    pub kind: VariableKind,
    /// Physical quantity.
    pub quantity: Option<String>,
    /// Unit.
    pub unit: Option<String>,
    /// Unit for showing values.
    pub display_unit: Option<String>,
    /// Offsets of display units do not apply.
    pub relative_quantity: bool,
    /// Values grow without bound.
    pub unbounded: bool,
    /// Smallest value.
    pub min: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
    /// Typical magnitude.
    pub nominal: Option<f64>,
    /// Items of an enumeration.
    pub items: Vec<EnumerationItem>,
}

/// One item of an enumeration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EnumerationItem {
    /// Name.
    pub name: String,
    /// The integer that stands for it.
    pub value: i64,
    /// What it means.
    pub description: Option<String>,
}

/// Type of a variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum VariableKind {
    /// Double precision number (`Float64` of FMI 3.0).
    Real,
    /// Single precision number.
    Float32,
    /// 32-bit integer (`Int32` of FMI 3.0).
    Integer,
    /// Signed 8-bit integer.
    Int8,
    /// Unsigned 8-bit integer.
    UInt8,
    /// Signed 16-bit integer.
    Int16,
    /// Unsigned 16-bit integer.
    UInt16,
    /// Unsigned 32-bit integer.
    UInt32,
    /// Signed 64-bit integer.
    Int64,
    /// Unsigned 64-bit integer.
    UInt64,
    /// True or false.
    Boolean,
    /// Text.
    String,
    /// Bytes.
    Binary,
    /// One of the items of a type definition, passed as an integer.
    Enumeration,
    /// A clock: true while it ticks.
    Clock,
}

impl VariableKind {
    /// The word of FMI 2.0 for it, and of FMI 3.0 where FMI 2.0 has none.
    pub fn name(self) -> &'static str {
        match self {
            VariableKind::Real => "Real",
            VariableKind::Float32 => "Float32",
            VariableKind::Integer => "Integer",
            VariableKind::Int8 => "Int8",
            VariableKind::UInt8 => "UInt8",
            VariableKind::Int16 => "Int16",
            VariableKind::UInt16 => "UInt16",
            VariableKind::UInt32 => "UInt32",
            VariableKind::Int64 => "Int64",
            VariableKind::UInt64 => "UInt64",
            VariableKind::Boolean => "Boolean",
            VariableKind::String => "String",
            VariableKind::Binary => "Binary",
            VariableKind::Enumeration => "Enumeration",
            VariableKind::Clock => "Clock",
        }
    }

    /// A floating-point number.
    pub fn is_float(self) -> bool {
        matches!(self, VariableKind::Real | VariableKind::Float32)
    }

    /// An integer, of an enumeration too.
    pub fn is_integer(self) -> bool {
        self.range().is_some()
    }

    /// Smallest and largest value of an integer type.
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

    /// Whether values are numbers, so that results can hold them.
    pub fn is_number(self) -> bool {
        !matches!(self, VariableKind::String | VariableKind::Binary)
    }
}

impl fmt::Display for VariableKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A value of a variable. Enumerations are integers, clocks Booleans.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Value {
    /// A number.
    Real(f64),
    /// An integer of any width, or the value of an enumeration.
    Integer(i128),
    /// True or false.
    Boolean(bool),
    /// Text.
    String(String),
    /// Bytes.
    Binary(Vec<u8>),
    /// The elements of an array, all of one type, the last index varying fastest.
    Array(Vec<Value>),
}

impl Value {
    /// The (nearest) number: also of integers, and 0 or 1 for Booleans; `None` for texts, bytes and arrays.
    pub fn as_number(&self) -> Option<f64> {
        match self {
            Value::Real(x) => Some(*x),
            Value::Integer(i) => Some(*i as f64),
            Value::Boolean(b) => Some(f64::from(u8::from(*b))),
            Value::String(_) | Value::Binary(_) | Value::Array(_) => None,
        }
    }

    /// The word for its type.
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

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        Value::Real(value)
    }
}

macro_rules! from_integers {
    ($($integer:ty),+) => {
        $(impl From<$integer> for Value {
            fn from(value: $integer) -> Self {
                Value::Integer(value.into())
            }
        })+
    };
}
from_integers!(i8, u8, i16, u16, i32, u32, i64, u64, i128);

impl<T: Into<Value>> From<Vec<T>> for Value {
    fn from(values: Vec<T>) -> Self {
        Value::Array(values.into_iter().map(Into::into).collect())
    }
}

impl From<bool> for Value {
    fn from(value: bool) -> Self {
        Value::Boolean(value)
    }
}

impl From<&str> for Value {
    fn from(value: &str) -> Self {
        Value::String(value.to_owned())
    }
}

impl From<String> for Value {
    fn from(value: String) -> Self {
        Value::String(value)
    }
}

/// Role of a variable towards the outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Causality {
    /// Given from outside, constant during a simulation (or tunable between steps).
    Parameter,
    /// A parameter that other variables' dimensions depend on (FMI 3.0).
    StructuralParameter,
    /// Computed from parameters.
    CalculatedParameter,
    /// Given from outside.
    Input,
    /// For use outside.
    Output,
    /// Internal.
    Local,
    /// Time.
    Independent,
}

/// When a variable may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Variability {
    /// Never.
    Constant,
    /// Not after initialization.
    Fixed,
    /// At events triggered from outside.
    Tunable,
    /// At events.
    Discrete,
    /// At any time.
    Continuous,
}

impl Variability {
    /// What is meant where a file does not say: the schema's "continuous" fits Real variables only, and parameters
    /// do not change.
    pub(super) fn default_for(causality: Causality, kind: VariableKind) -> Variability {
        match causality {
            Causality::Parameter | Causality::StructuralParameter | Causality::CalculatedParameter => {
                Variability::Fixed
            }
            _ if kind.is_float() => Variability::Continuous,
            _ => Variability::Discrete,
        }
    }
}

/// How an initial value comes about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Initial {
    /// The start value is the value.
    Exact,
    /// The start value is a guess.
    Approx,
    /// Computed; there is no start value.
    Calculated,
}

impl Initial {
    /// What the standard prescribes where a file does not say (FMI 2.0, table in 2.2.7).
    pub(super) fn default_for(causality: Causality, variability: Variability) -> Option<Initial> {
        match (causality, variability) {
            (Causality::Input | Causality::Independent, _) => None,
            (Causality::Parameter | Causality::StructuralParameter, _) | (_, Variability::Constant) => {
                Some(Initial::Exact)
            }
            _ => Some(Initial::Calculated),
        }
    }
}

impl fmt::Display for Causality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Causality::Parameter => "parameter",
            Causality::StructuralParameter => "structuralParameter",
            Causality::CalculatedParameter => "calculatedParameter",
            Causality::Input => "input",
            Causality::Output => "output",
            Causality::Local => "local",
            Causality::Independent => "independent",
        })
    }
}

impl fmt::Display for Variability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Variability::Constant => "constant",
            Variability::Fixed => "fixed",
            Variability::Tunable => "tunable",
            Variability::Discrete => "discrete",
            Variability::Continuous => "continuous",
        })
    }
}

impl fmt::Display for Initial {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Initial::Exact => "exact",
            Initial::Approx => "approx",
            Initial::Calculated => "calculated",
        })
    }
}
