//! Variables and their types: name, value reference, causality, variability, start value.

use super::clock::ClockTiming;
use crate::macros::words;
use crate::value::{Value, VariableKind};
use serde::Serialize;

/// A variable of the model: one value, or an array of them. Attributes that a type definition supplies are
/// already filled in.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Variable {
    /// Name, unique in the model.
    pub name: String,
    /// Handle for get and set calls; unique per kind only, aliases share it.
    pub value_reference: u32,
    /// Description.
    pub description: Option<String>,
    /// Type of the value.
    pub kind: VariableKind,
    /// Role towards the outside.
    pub causality: Causality,
    /// When it may change.
    pub variability: Variability,
    /// Initialization: as the file says, else the standard's default; `None` for inputs and the independent
    /// variable.
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
    /// The most bytes that a binary value has (FMI 3.0 `maxSize`).
    pub max_size: Option<usize>,
    /// Its value is an `int` whatever its type: enumerations of FMI 1.0 and 2.0.
    pub(crate) is_narrow: bool,
}

impl Variable {
    /// True for a parameter that may change during a simulation. Inputs of a simulation may drive it.
    pub fn is_tunable_parameter(&self) -> bool {
        self.causality == Causality::Parameter && self.variability == Variability::Tunable
    }

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
    /// The name; lookups find the variable by it, patterns fit it, and results have a column of it.
    pub name: String,
    /// Description.
    pub description: Option<String>,
    /// Unit for showing the value under this name.
    pub display_unit: Option<String>,
}

/// A type that variables refer to by `declaredType`.
#[derive(Debug, Clone, PartialEq)]
pub struct TypeDefinition {
    /// Name.
    pub name: String,
    /// Description.
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
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct EnumerationItem {
    /// Name.
    pub name: String,
    /// The integer that stands for it.
    pub value: i64,
    /// Description.
    pub description: Option<String>,
}

words! {
    /// Role of a variable towards the outside.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    pub enum Causality {
        /// Given from outside, constant during a simulation (or tunable between steps).
        Parameter = "parameter",
        /// A parameter that other variables' dimensions depend on (FMI 3.0).
        StructuralParameter = "structuralParameter",
        /// Computed from parameters.
        CalculatedParameter = "calculatedParameter",
        /// Given from outside.
        Input = "input",
        /// For use outside.
        Output = "output",
        /// Internal.
        #[default]
        Local = "local",
        /// Time.
        Independent = "independent",
    }
}

words! {
    /// When a variable may change.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    pub enum Variability {
        /// Never.
        Constant = "constant",
        /// Not after initialization.
        Fixed = "fixed",
        /// At events triggered from outside.
        Tunable = "tunable",
        /// At events.
        Discrete = "discrete",
        /// At any time.
        #[default]
        Continuous = "continuous",
    }
}

impl Variability {
    /// Variability where a file does not say: the schema's "continuous" fits Real variables only, and
    /// parameters do not change.
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

words! {
    /// Initialization of a variable (attribute `initial`).
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    pub enum Initial {
        /// The start value is the value.
        Exact = "exact",
        /// The start value is a guess.
        Approx = "approx",
        /// Computed; there is no start value.
        Calculated = "calculated",
    }
}

impl Initial {
    /// Default of the standard where a file does not say (FMI 2.0, table in 2.2.7).
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
