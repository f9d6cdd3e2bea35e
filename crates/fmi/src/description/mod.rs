//! Model description: the content of `modelDescription.xml` in types that are independent of the FMI version.

mod checks;
mod clock;
mod draft;
mod limits;
mod model;
mod names;
mod parse;
mod quirks;
mod read;
mod start_texts;
mod structure;
mod terminals;
mod unit;
mod variable;
mod version;

pub use limits::DescriptionLimits;

pub use clock::{ClockKind, ClockTiming, Interval};
pub use model::{
    Capabilities, DefaultExperiment, DependencyKind, Interface, LogCategory, ModelDescription,
    ModelStructure, Quirk, QuirkKind, Unknown,
};
pub use terminals::{StreamMember, Terminal, TerminalIcon, TerminalMember};
pub use unit::{BaseUnit, DisplayUnit, Unit};
pub use variable::{
    Alias, Causality, Dimension, EnumerationItem, Initial, TypeDefinition, Variability, Variable,
};

pub use crate::value::{Value, VariableKind};
pub use version::FmiVersion;

pub(crate) use start_texts::with_start_texts;
pub(crate) use structure::Structure;

pub(crate) use parse::{BUILD_DESCRIPTION, BuildSet, TERMINALS, build_sets, terminals};
