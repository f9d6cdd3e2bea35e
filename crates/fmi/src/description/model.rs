//! The model description as a whole: header, interfaces, structure, quirks, lookup by name.

use super::names;
use super::names::NameIndex;
use super::unit::Unit;
use super::variable::{TypeDefinition, Variable};
use super::version::FmiVersion;
use crate::macros::words;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::fmt;

/// The content of `modelDescription.xml`.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct ModelDescription {
    /// Version of the FMI standard.
    pub fmi_version: FmiVersion,
    /// Name of the model.
    pub model_name: String,
    /// Key shared by the description and the binary, exactly as in the file
    /// (`guid` in FMI 1.0 and 2.0, `instantiationToken` in 3.0).
    pub guid: String,
    /// Description of the model.
    pub description: Option<String>,
    /// Who made it.
    pub author: Option<String>,
    /// Version of the model.
    pub version: Option<String>,
    /// Copyright notice.
    pub copyright: Option<String>,
    /// Licence.
    pub license: Option<String>,
    /// Tool that made the file.
    pub generation_tool: Option<String>,
    /// When it was made.
    pub generation_date_and_time: Option<String>,
    /// `flat` or `structured`.
    pub variable_naming_convention: Option<String>,
    /// Model exchange, if offered.
    pub model_exchange: Option<Interface>,
    /// Co-simulation, if offered.
    pub co_simulation: Option<Interface>,
    /// Scheduled execution is offered (FMI 3.0). It can be described, not run.
    pub offers_scheduled_execution: bool,
    /// Units.
    pub units: Vec<Unit>,
    /// Types.
    pub type_definitions: Vec<TypeDefinition>,
    /// Categories of log messages.
    pub log_categories: Vec<LogCategory>,
    /// Suggested span, tolerance and step.
    pub default_experiment: DefaultExperiment,
    /// Variables in the order of the file.
    pub variables: Vec<Variable>,
    /// Outputs, derivatives, initial unknowns.
    pub structure: ModelStructure,
    /// Number of event indicators, with structural parameters at their start values.
    pub n_event_indicators: usize,
    /// Number of continuous states where the file gives a number and no list of derivatives (FMI 1.0).
    pub declared_states: Option<usize>,
    /// Where the file departs from the standard.
    pub quirks: Vec<Quirk>,
    /// True if a variable is an array (FMI 3.0).
    pub(crate) has_arrays: bool,
    /// Elements that its arrays may have together.
    pub(crate) most_elements: usize,
    pub(super) names: NameIndex,
    /// Positions of variables by their further names.
    pub(super) aliases: HashMap<String, usize>,
}

impl ModelDescription {
    /// The variable of this name; constant time.
    pub fn variable(&self, name: &str) -> Option<&Variable> {
        self.variable_index(name).map(|index| &self.variables[index])
    }

    /// Position in [`variables`](Self::variables) of the variable of this name; constant time.
    pub fn variable_index(&self, name: &str) -> Option<usize> {
        self.names.find(name, &self.variables).or_else(|| self.aliases.get(name).copied())
    }

    /// All names with the positions of their variables, in the order of the file: each variable by its own
    /// name, then by its aliases (FMI 3.0).
    pub fn names(&self) -> impl Iterator<Item = (&str, usize)> {
        self.variables.iter().enumerate().flat_map(|(position, variable)| {
            let aliases = variable.aliases.iter().map(|alias| alias.name.as_str());
            std::iter::once(variable.name.as_str()).chain(aliases).map(move |name| (name, position))
        })
    }

    /// At most `n` names of variables that `name` may have been meant for, the most similar first.
    pub fn nearest_names(&self, name: &str, n: usize) -> Vec<&str> {
        names::nearest(name, self.names().map(|(name, _)| name), n)
    }
}

/// One way of running the model: model exchange or co-simulation.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Interface {
    /// Base name of the binary (and prefix of FMI 1.0's functions); never holds a path separator.
    pub model_identifier: String,
    /// Capability flags.
    pub capabilities: Capabilities,
    /// Files in `sources/` to compile, relative to it. For FMI 3.0, see `sources/buildDescription.xml`
    /// instead.
    pub source_files: Vec<String>,
}

/// Capabilities of an interface; false and 0 unless the file says more.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct Capabilities {
    /// Runs only with the tool that made it installed.
    pub needs_execution_tool: bool,
    /// Completed steps need not be announced (model exchange).
    pub completed_integrator_step_not_needed: bool,
    /// One instance per process only.
    pub can_be_instantiated_only_once_per_process: bool,
    /// Does not use the memory callbacks.
    pub can_not_use_memory_management_functions: bool,
    /// State can be saved and restored.
    pub can_get_and_set_state: bool,
    /// Saved state can be turned into bytes.
    pub can_serialize_state: bool,
    /// Directional derivatives.
    pub provides_directional_derivative: bool,
    /// Adjoint derivatives (FMI 3.0).
    pub provides_adjoint_derivative: bool,
    /// Communication steps may vary (co-simulation).
    pub can_handle_variable_communication_step_size: bool,
    /// Inputs are extrapolated from their derivatives (co-simulation).
    pub can_interpolate_inputs: bool,
    /// Steps may return before they are done (co-simulation).
    pub can_run_asynchronuously: bool,
    /// Highest derivative of outputs (co-simulation).
    pub max_output_derivative_order: u32,
    /// The model has an event mode in co-simulation (FMI 3.0).
    pub has_event_mode: bool,
    /// A step may end before its end, at an event (FMI 3.0).
    pub might_return_early_from_do_step: bool,
    /// It calls back during a step (FMI 3.0). No such callback is passed: inputs are set between steps.
    pub provides_intermediate_update: bool,
    /// A step ends early where the callback wishes it (FMI 3.0).
    pub can_return_early_after_intermediate_update: bool,
    /// The model steps from one multiple of this to the next (FMI 3.0); in between it stands at the last one.
    pub fixed_internal_step_size: Option<f64>,
}

impl Capabilities {
    /// True if a co-simulation with it handles events between steps.
    pub(crate) fn uses_event_mode(&self) -> bool {
        self.has_event_mode
    }

    /// True if its steps may end early: only where the next step may have any length.
    pub(crate) fn may_return_early(&self) -> bool {
        self.might_return_early_from_do_step && self.can_handle_variable_communication_step_size
    }
}

/// A category of log messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogCategory {
    /// Name.
    pub name: String,
    /// Description of the category.
    pub description: Option<String>,
}

/// Suggested settings of a simulation; the unit of time is the second.
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

/// Outputs, derivatives and initial unknowns, with the variables that they depend on.
/// All indices are in range of the variables.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModelStructure {
    /// Outputs.
    pub outputs: Vec<Unknown>,
    /// Derivatives of the continuous states; their order is the order of the state vector.
    pub derivatives: Vec<Unknown>,
    /// Unknowns of the initialization.
    pub initial_unknowns: Vec<Unknown>,
    /// Event indicators (FMI 3.0).
    pub event_indicators: Vec<Unknown>,
}

/// A variable computed by the model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unknown {
    /// Index of the variable, counted from 0.
    pub index: usize,
    /// Indices of the variables it depends on; `None`: on all (nothing known), empty: on none.
    pub dependencies: Option<Vec<usize>>,
    /// Kind of its dependency on each of them; empty where the file does not say.
    pub kinds: Vec<DependencyKind>,
}

words! {
    /// Kind of the dependency of an unknown on a known.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    pub enum DependencyKind {
        /// No particular structure.
        Dependent = "dependent",
        /// Linear with a constant factor.
        Constant = "constant",
        /// Linear, with a factor fixed after initialization.
        Fixed = "fixed",
        /// Linear, with a factor that changes with tunable parameters.
        Tunable = "tunable",
        /// Linear, with a factor that changes at events.
        Discrete = "discrete",
    }
}

/// A departure from the standard that was tolerated.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quirk {
    /// Its class.
    pub kind: QuirkKind,
    /// The departure, and how it was treated.
    pub message: String,
    /// Line in the file, counted from 1 (0: the file as a whole).
    pub line: u32,
}

words! {
    /// Classes of departures from the standard.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
    #[non_exhaustive]
    pub enum QuirkKind {
        /// The text is not in the encoding it declares.
        Encoding = "encoding",
        /// A value of an attribute that is not understood; the default was taken.
        Attribute = "attribute",
        /// A mandatory attribute or element is missing.
        Missing = "missing",
        /// An element that is not allowed where it stands, or more often than allowed.
        Element = "element",
        /// A name or value that must be unique is not.
        Duplicate = "duplicate",
        /// A unit, type or variable that is referred to is not defined.
        Undefined = "undefined",
        /// Causality, variability and initial do not go together.
        Combination = "combination",
        /// A start value is missing, superfluous or out of range.
        Start = "start",
        /// A nominal that is zero, negative or not finite; min above max.
        Range = "range",
        /// The model structure is not consistent.
        Structure = "structure",
        /// The model does not do what the description promises.
        Promise = "promise",
        /// A simulation depends on earlier ones in the same process: each one is to have a process of its
        /// own.
        HiddenState = "hidden-state",
        /// Something this version of the importer does not represent was left out.
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
