//! Incomplete description: the content of a file before its parts are checked against each other.

use super::limits::Reading;
use super::model::{ModelDescription, Unknown};
use super::variable::Variable;
use std::rc::Rc;

/// Incomplete description.
pub(super) struct Draft {
    pub(super) model: ModelDescription,
    pub(super) reading: Rc<Reading>,
    /// For each variable, the flags that the file sets. A type definition does not override them.
    pub(super) flags: Vec<Flags>,
    /// Lines of the unknowns in the model structure: outputs, derivatives, initial unknowns, event
    /// indicators.
    pub(super) structure_lines: [Vec<u32>; 4],
}

/// Flags that a variable sets. The remaining flags come from its type.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Flags {
    pub(super) relative_quantity: bool,
    pub(super) unbounded: bool,
}

/// Index that means "not a variable". The checks remove it.
pub(super) const NOWHERE: usize = usize::MAX;

/// The lists of the model structure.
#[derive(Clone, Copy)]
pub(super) enum StructureList {
    Outputs,
    Derivatives,
    InitialUnknowns,
    EventIndicators,
}

impl Draft {
    /// Adds a variable.
    pub(super) fn add_variable(&mut self, variable: Variable, flags: Flags) {
        // Memory for the entries in the name index and in the sets used by the checks.
        self.reading.take(64);
        self.reading.push(&mut self.model.variables, variable);
        self.reading.push(&mut self.flags, flags);
    }

    pub(super) fn add_unknown(&mut self, list: StructureList, unknown: Unknown, line: u32) {
        let structure = &mut self.model.structure;
        let (unknowns, lines) = match list {
            StructureList::Outputs => (&mut structure.outputs, &mut self.structure_lines[0]),
            StructureList::Derivatives => (&mut structure.derivatives, &mut self.structure_lines[1]),
            StructureList::InitialUnknowns => (&mut structure.initial_unknowns, &mut self.structure_lines[2]),
            StructureList::EventIndicators => (&mut structure.event_indicators, &mut self.structure_lines[3]),
        };
        self.reading.push(unknowns, unknown);
        self.reading.push(lines, line);
    }
}
