//! Variables and their types: name, value reference, causality, variability, start value.

use super::clock::ClockTiming;
use crate::macros::words;
use crate::value::{Value, VariableKind};
use serde::Serialize;

/// Variable of the model: a scalar or an array. Attributes from its type definition are already filled in.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Variable {
    /// Name, unique in the model.
    pub name: String,
    /// Handle for get and set calls. It is unique only per kind. Aliases share it.
    pub value_reference: u32,
    /// Description.
    pub description: Option<String>,
    /// Type of the value.
    pub kind: VariableKind,
    /// Role of the variable in the interface of the model.
    pub causality: Causality,
    /// Times at which the value may change.
    pub variability: Variability,
    /// Initialization as specified in the file, otherwise the standard's default. `None` for inputs and the
    /// independent variable.
    pub initial: Option<Initial>,
    /// The variable may be set several times at one time instant (default true).
    pub can_handle_multiple_set_per_time_instant: bool,
    /// Line in the file, counted from 1.
    pub line: u32,
    /// Name of the type definition.
    pub declared_type: Option<String>,
    /// Physical quantity.
    pub quantity: Option<String>,
    /// Unit of the value and of min, max, nominal and start.
    pub unit: Option<String>,
    /// Unit for displaying the value.
    pub display_unit: Option<String>,
    /// Offsets of display units do not apply, for example for a temperature difference.
    pub relative_quantity: bool,
    /// The state grows without bound, so a relative tolerance should not apply (FMI 2.0 `unbounded`).
    pub unbounded: bool,
    /// Minimum value.
    pub min: Option<f64>,
    /// Maximum value.
    pub max: Option<f64>,
    /// Typical magnitude as specified in the file. It may be 0, negative or NaN.
    pub nominal: Option<f64>,
    /// Start value.
    pub start: Option<Value>,
    /// Index of the variable whose time derivative this variable is.
    pub derivative: Option<usize>,
    /// The state may be reinitialized at events.
    pub reinit: bool,
    /// The value is the model's value with reversed sign, or inverted for a Boolean (negated alias of FMI
    /// 1.0).
    pub negated: bool,
    /// Extents of an array, the last one varying fastest; empty for a scalar.
    pub dimensions: Vec<Dimension>,
    /// Alias names of the variable.
    pub aliases: Vec<Alias>,
    /// Indices of the clocks to which the variable belongs.
    pub clocks: Vec<usize>,
    /// Timing of a clock.
    pub clock: Option<Box<ClockTiming>>,
    /// The variable can be set or read during a co-simulation step (FMI 3.0).
    pub intermediate_update: bool,
    /// Maximum size of a binary value in bytes (FMI 3.0 `maxSize`).
    pub max_size: Option<usize>,
    /// The value is a C `int` regardless of its type (enumerations of FMI 1.0 and 2.0).
    pub(crate) is_narrow: bool,
}

impl Variable {
    /// True for a parameter that may change during a simulation. Simulation inputs may drive it.
    pub fn is_tunable_parameter(&self) -> bool {
        self.causality == Causality::Parameter && self.variability == Variability::Tunable
    }

    /// Returns the minimum and maximum value of a variable of an integer type.
    pub(crate) fn integer_range(&self) -> Option<(i128, i128)> {
        let kind = if self.is_narrow { VariableKind::Integer } else { self.kind };
        kind.range()
    }
}

/// Extent of an array in one dimension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dimension {
    /// Constant extent.
    Fixed(usize),
    /// Value of the structural parameter with this index.
    Parameter(usize),
}

/// Alias name of a variable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Alias {
    /// Name. Lookups and patterns accept it, and results contain a column with this name.
    pub name: String,
    /// Description.
    pub description: Option<String>,
    /// Unit for displaying the value under this name.
    pub display_unit: Option<String>,
}

/// Type to which variables refer by `declaredType`.
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
    /// Unit for displaying values.
    pub display_unit: Option<String>,
    /// Offsets of display units do not apply.
    pub relative_quantity: bool,
    /// The values grow without bound.
    pub unbounded: bool,
    /// Minimum value.
    pub min: Option<f64>,
    /// Maximum value.
    pub max: Option<f64>,
    /// Typical magnitude.
    pub nominal: Option<f64>,
    /// Items of an enumeration.
    pub items: Vec<EnumerationItem>,
}

/// Item of an enumeration.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct EnumerationItem {
    /// Name.
    pub name: String,
    /// Integer value of the item.
    pub value: i64,
    /// Description.
    pub description: Option<String>,
}

words! {
    /// Role of a variable in the interface of the model.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    pub enum Causality {
        /// Set by the environment; constant during a simulation, or tunable between steps.
        Parameter = "parameter",
        /// Parameter on which the dimensions of other variables depend (FMI 3.0).
        StructuralParameter = "structuralParameter",
        /// Computed from parameters.
        CalculatedParameter = "calculatedParameter",
        /// Set by the environment.
        Input = "input",
        /// Available to the environment.
        Output = "output",
        /// Internal variable.
        #[default]
        Local = "local",
        /// Time.
        Independent = "independent",
    }
}

words! {
    /// Times at which a variable may change.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    pub enum Variability {
        /// Never.
        Constant = "constant",
        /// Not after the initialization.
        Fixed = "fixed",
        /// At events triggered by the environment.
        Tunable = "tunable",
        /// At events.
        Discrete = "discrete",
        /// At any time.
        #[default]
        Continuous = "continuous",
    }
}

impl Variability {
    /// Returns the variability if the file does not specify it. The schema's default "continuous" is valid
    /// only for Real variables, and parameters do not change.
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
        /// The start value is the initial value.
        Exact = "exact",
        /// The start value is an initial guess.
        Approx = "approx",
        /// The initial value is computed; there is no start value.
        Calculated = "calculated",
    }
}

impl Initial {
    /// Returns the standard's default if the file does not specify `initial` (FMI 2.0, table in 2.2.7).
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
