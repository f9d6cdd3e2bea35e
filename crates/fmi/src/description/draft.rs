//! A description in the making: what a file says, before its parts are checked against each other.

use super::limits::Reading;
use super::model::{ModelDescription, Unknown};
use super::variable::Variable;
use std::rc::Rc;

/// A description in the making.
pub(super) struct Draft {
    pub(super) model: ModelDescription,
    pub(super) reading: Rc<Reading>,
    /// For each variable which of its flags the file sets, so that a type does not overrule them.
    pub(super) flags: Vec<Flags>,
    /// Lines of the unknowns in the model structure, in the order of outputs, derivatives, initial unknowns,
    /// event indicators.
    pub(super) structure_lines: [Vec<u32>; 4],
}

/// Flags that a variable sets itself, and that its type would else supply.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Flags {
    pub(super) relative_quantity: bool,
    pub(super) unbounded: bool,
}

/// An index that stands for "not a variable"; the checks remove it.
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
        // Its places in the index of names and in the sets that checks make.
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
