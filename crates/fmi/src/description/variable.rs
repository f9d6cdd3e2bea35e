//! Variables and their types: name, value reference, causality, variability, start value.

use std::fmt;

/// A scalar variable of the model. Attributes that a type definition supplies are already filled in.
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
    pub value: i32,
    /// What it means.
    pub description: Option<String>,
}

/// Type of a variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum VariableKind {
    /// Double precision number.
    Real,
    /// 32-bit integer.
    Integer,
    /// True or false.
    Boolean,
    /// Text.
    String,
    /// One of the items of a type definition, passed as an integer.
    Enumeration,
}

impl VariableKind {
    /// The word FMI 2.0 uses for it.
    pub fn name(self) -> &'static str {
        match self {
            VariableKind::Real => "Real",
            VariableKind::Integer => "Integer",
            VariableKind::Boolean => "Boolean",
            VariableKind::String => "String",
            VariableKind::Enumeration => "Enumeration",
        }
    }
}

impl fmt::Display for VariableKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A value of a variable. Enumerations are integers.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A number.
    Real(f64),
    /// An integer, or the value of an enumeration.
    Integer(i32),
    /// True or false.
    Boolean(bool),
    /// Text.
    String(String),
}

impl Value {
    /// The word for its type.
    pub fn kind_name(&self) -> &'static str {
        match self {
            Value::Real(_) => "Real",
            Value::Integer(_) => "Integer",
            Value::Boolean(_) => "Boolean",
            Value::String(_) => "String",
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
        }
    }
}

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        Value::Real(value)
    }
}

impl From<i32> for Value {
    fn from(value: i32) -> Self {
        Value::Integer(value)
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
            Causality::Parameter | Causality::CalculatedParameter => Variability::Fixed,
            _ if kind == VariableKind::Real => Variability::Continuous,
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
            (Causality::Parameter, _) | (_, Variability::Constant) => Some(Initial::Exact),
            _ => Some(Initial::Calculated),
        }
    }
}

impl fmt::Display for Causality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Causality::Parameter => "parameter",
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
