//! Model description: header, interfaces, structure, quirks, and lookup by name.

use super::names;
use super::names::NameIndex;
use super::unit::Unit;
use super::variable::{Causality, TypeDefinition, Variable};
use super::version::FmiVersion;
use crate::macros::words;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::fmt;

/// Content of `modelDescription.xml`.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct ModelDescription {
    /// Version of the FMI standard.
    pub fmi_version: FmiVersion,
    /// Name of the model.
    pub model_name: String,
    /// Key shared by the description and the binary, exactly as in the file (`guid` in FMI 1.0 and 2.0,
    /// `instantiationToken` in 3.0).
    pub guid: String,
    /// Description of the model.
    pub description: Option<String>,
    /// Author of the model.
    pub author: Option<String>,
    /// Version of the model.
    pub version: Option<String>,
    /// Copyright notice.
    pub copyright: Option<String>,
    /// License.
    pub license: Option<String>,
    /// Tool that generated the file.
    pub generation_tool: Option<String>,
    /// Date and time of the generation.
    pub generation_date_and_time: Option<String>,
    /// `flat` or `structured`.
    pub variable_naming_convention: Option<String>,
    /// Model-exchange interface, if supported.
    pub model_exchange: Option<Interface>,
    /// Co-simulation interface, if supported.
    pub co_simulation: Option<Interface>,
    /// True if the model supports scheduled execution (FMI 3.0). This library can describe such models but
    /// not run them.
    pub offers_scheduled_execution: bool,
    /// Units.
    pub units: Vec<Unit>,
    /// Type definitions.
    pub type_definitions: Vec<TypeDefinition>,
    /// Categories of log messages.
    pub log_categories: Vec<LogCategory>,
    /// Unit of the time, if it was given with [`Fmu::with_time_unit`](crate::Fmu::with_time_unit).
    pub(crate) given_time_unit: Option<String>,
    /// Suggested time span, tolerance and step size.
    pub default_experiment: DefaultExperiment,
    /// Variables in the order of the file.
    pub variables: Vec<Variable>,
    /// Outputs, derivatives, initial unknowns.
    pub structure: ModelStructure,
    /// Number of event indicators, with structural parameters at their start values.
    pub n_event_indicators: usize,
    /// Number of continuous states if the file contains a number instead of a list of derivatives (FMI 1.0).
    pub declared_states: Option<usize>,
    /// Deviations of the file from the standard.
    pub quirks: Vec<Quirk>,
    /// True if a variable is an array (FMI 3.0).
    pub(crate) has_arrays: bool,
    /// Maximum total number of array elements.
    pub(crate) most_elements: usize,
    pub(super) names: NameIndex,
    /// Indices of variables by their alias names.
    pub(super) aliases: HashMap<String, usize>,
}

impl ModelDescription {
    /// Returns the unit in which the model counts its time: the unit of the independent variable, otherwise s
    /// (FMI 2.0.4, section 2.2.7; FMI 3.0.1, section 2.4.7.4). All times of simulations are in this unit.
    pub fn time_unit(&self) -> &str {
        let independent = || self.variables.iter().find(|v| v.causality == Causality::Independent);
        let stated = || independent()?.unit.as_deref().map(str::trim).filter(|unit| !unit.is_empty());
        self.given_time_unit.as_deref().or_else(stated).unwrap_or("s")
    }

    /// Returns the variable with this name, in constant time.
    pub fn variable(&self, name: &str) -> Option<&Variable> {
        self.variable_index(name).map(|index| &self.variables[index])
    }

    /// Returns the index in [`variables`](Self::variables) of the variable with this name, in constant time.
    pub fn variable_index(&self, name: &str) -> Option<usize> {
        self.names.find(name, &self.variables).or_else(|| self.aliases.get(name).copied())
    }

    /// Returns all names with the indices of their variables, in file order. Each variable is listed under
    /// its name and then under its aliases (FMI 3.0).
    pub fn names(&self) -> impl Iterator<Item = (&str, usize)> {
        self.variables.iter().enumerate().flat_map(|(position, variable)| {
            let aliases = variable.aliases.iter().map(|alias| alias.name.as_str());
            std::iter::once(variable.name.as_str()).chain(aliases).map(move |name| (name, position))
        })
    }

    /// Returns at most `n` variable names similar to `name`, the most similar first.
    pub fn nearest_names(&self, name: &str, n: usize) -> Vec<&str> {
        names::nearest(name, self.names().map(|(name, _)| name), n)
    }
}

/// Interface for running the model: model exchange or co-simulation.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Interface {
    /// Base name of the binary and function prefix of FMI 1.0. It never contains a path separator.
    pub model_identifier: String,
    /// Capability flags.
    pub capabilities: Capabilities,
    /// Files in `sources/` to compile, relative to that folder. For FMI 3.0, see
    /// `sources/buildDescription.xml` instead.
    pub source_files: Vec<String>,
}

/// Capabilities of an interface. The defaults are false and 0.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct Capabilities {
    /// The model requires an installation of the tool that generated it.
    pub needs_execution_tool: bool,
    /// Completed steps need not be reported to the model (model exchange).
    pub completed_integrator_step_not_needed: bool,
    /// Only one instance per process is possible.
    pub can_be_instantiated_only_once_per_process: bool,
    /// The model does not use the memory callbacks.
    pub can_not_use_memory_management_functions: bool,
    /// The state can be saved and restored.
    pub can_get_and_set_state: bool,
    /// A saved state can be serialized to bytes.
    pub can_serialize_state: bool,
    /// The model provides directional derivatives.
    pub provides_directional_derivative: bool,
    /// The model provides adjoint derivatives (FMI 3.0).
    pub provides_adjoint_derivative: bool,
    /// The communication step size may vary (co-simulation).
    pub can_handle_variable_communication_step_size: bool,
    /// The model extrapolates inputs from their derivatives (co-simulation).
    pub can_interpolate_inputs: bool,
    /// A step may be computed asynchronously (co-simulation).
    pub can_run_asynchronuously: bool,
    /// Maximum order of output derivatives (co-simulation).
    pub max_output_derivative_order: u32,
    /// The model has an event mode in co-simulation (FMI 3.0).
    pub has_event_mode: bool,
    /// A step may return before its end because of an event (FMI 3.0).
    pub might_return_early_from_do_step: bool,
    /// The model supports callbacks during a step (FMI 3.0). This library passes no such callback: inputs are
    /// set between steps.
    pub provides_intermediate_update: bool,
    /// A step ends early if the callback requests it (FMI 3.0).
    pub can_return_early_after_intermediate_update: bool,
    /// Internal step size of the model (FMI 3.0). The model advances only between multiples of this step.
    /// Between two multiples it stays at the previous one.
    pub fixed_internal_step_size: Option<f64>,
}

impl Capabilities {
    /// True if the co-simulation handles events between steps.
    pub(crate) fn uses_event_mode(&self) -> bool {
        self.has_event_mode
    }

    /// True if steps may end early. This requires that the next step may have any length.
    pub(crate) fn may_return_early(&self) -> bool {
        self.might_return_early_from_do_step && self.can_handle_variable_communication_step_size
    }
}

/// Category of log messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogCategory {
    /// Name.
    pub name: String,
    /// Description of the category.
    pub description: Option<String>,
}

/// Suggested settings of a simulation. Times are in the [time unit](ModelDescription::time_unit) of the
/// model.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct DefaultExperiment {
    /// Start time.
    pub start_time: Option<f64>,
    /// Final time.
    pub stop_time: Option<f64>,
    /// Relative tolerance.
    pub tolerance: Option<f64>,
    /// Step size.
    pub step_size: Option<f64>,
}

/// Outputs, derivatives and initial unknowns, with the variables on which they depend. All indices are valid
/// indices of variables.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModelStructure {
    /// Outputs.
    pub outputs: Vec<Unknown>,
    /// Derivatives of the continuous states, in the order of the state vector.
    pub derivatives: Vec<Unknown>,
    /// Unknowns of the initialization.
    pub initial_unknowns: Vec<Unknown>,
    /// Event indicators (FMI 3.0).
    pub event_indicators: Vec<Unknown>,
}

/// Variable computed by the model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unknown {
    /// Index of the variable, counted from 0.
    pub index: usize,
    /// Indices of the variables on which it depends. `None` means all variables (nothing is known); an empty
    /// list means none.
    pub dependencies: Option<Vec<usize>>,
    /// Kind of each dependency; empty if the file does not specify the kinds.
    pub kinds: Vec<DependencyKind>,
}

words! {
    /// Kind of the dependency of an unknown on a known variable.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    pub enum DependencyKind {
        /// No specific structure.
        Dependent = "dependent",
        /// Linear with a constant factor.
        Constant = "constant",
        /// Linear, with a factor that is fixed after the initialization.
        Fixed = "fixed",
        /// Linear, with a factor that changes with tunable parameters.
        Tunable = "tunable",
        /// Linear, with a factor that changes at events.
        Discrete = "discrete",
    }
}

/// Tolerated deviation from the standard.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quirk {
    /// Class of the deviation.
    pub kind: QuirkKind,
    /// Description of the deviation and its treatment.
    pub message: String,
    /// Line in the file, counted from 1; 0 for the file as a whole.
    pub line: u32,
}

words! {
    /// Classes of deviations from the standard.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
    #[non_exhaustive]
    pub enum QuirkKind {
        /// The text is not in its declared encoding.
        Encoding = "encoding",
        /// An attribute value is invalid; its default is used.
        Attribute = "attribute",
        /// A mandatory attribute or element is missing.
        Missing = "missing",
        /// An element is not allowed at its location, or occurs too often.
        Element = "element",
        /// A name or value is not unique.
        Duplicate = "duplicate",
        /// A referenced unit, type or variable is not defined.
        Undefined = "undefined",
        /// The combination of causality, variability and initial is not allowed.
        Combination = "combination",
        /// A start value is missing, superfluous or out of range.
        Start = "start",
        /// A nominal value is zero, negative or not finite, or min is greater than max.
        Range = "range",
        /// The model structure is not consistent.
        Structure = "structure",
        /// The model does not behave as its description specifies.
        Promise = "promise",
        /// A simulation depends on earlier simulations in the same process. Each simulation needs a separate
        /// process.
        HiddenState = "hidden-state",
        /// A feature that this version of the importer does not support was ignored.
        Unsupported = "unsupported",
    }
}

impl fmt::Display for Quirk {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => f.write_str(&self.message),
            line => write!(f, "line {line}: {}", self.message),
        }
    }
}
