//! What a simulation records: outputs sorted into one call per type, and the buffers they are read into.

use crate::description::{Causality, ModelDescription, Structure, Variability, Variable, VariableKind};
use crate::error::FmiError;
use crate::lanes;
use crate::sys::{Fault, RawInstance};
use std::collections::HashMap;

/// Where an output comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OutputSource {
    Time,
    /// A state or an alias of one: copied, without a call.
    State(usize),
    /// Place among the values of type `Real`.
    Real(usize),
    /// Place among the lanes of all other numbers.
    Packed(usize, VariableKind),
}

/// A column of results.
#[derive(Debug, Clone, Copy)]
struct Column {
    source: OutputSource,
    negated: bool,
    /// Whether it may be interpolated.
    is_continuous: bool,
}

/// Variables of one kind, for one call: references, and the lanes that their values take.
#[derive(Debug)]
struct Group {
    kind: VariableKind,
    references: Vec<u32>,
    n_values: usize,
}

/// The outputs by type, each type for one call.
#[derive(Debug, Default)]
pub(crate) struct OutputPlan {
    columns: Vec<Column>,
    reals: Vec<u32>,
    n_reals: usize,
    groups: Vec<Group>,
    /// Of the array variables already there: first place of their values.
    arrays: HashMap<(VariableKind, u32), usize>,
}

/// What outputs are resolved against.
pub(crate) struct OutputContext<'a> {
    pub(crate) model: &'a ModelDescription,
    pub(crate) structure: &'a Structure,
    /// First place in the state vector of the state variables, by value reference.
    pub(crate) states: &'a HashMap<u32, usize>,
}

impl OutputPlan {
    /// Number of columns.
    pub(crate) fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether a sample needs a call at all.
    pub(crate) fn needs_fmu(&self) -> bool {
        !(self.reals.is_empty() && self.groups.is_empty())
    }

    /// Whether a column is time itself.
    pub(crate) fn is_time(&self, column: usize) -> bool {
        self.columns[column].source == OutputSource::Time
    }

    /// Whether a column may be interpolated.
    pub(crate) fn is_continuous(&self, column: usize) -> bool {
        self.columns[column].is_continuous
    }

    /// Adds a variable: one column, or one for each element of an array (only `element`, if given). Returns the names
    /// of the columns.
    ///
    /// # Errors
    /// The variable is text or binary.
    pub(crate) fn add(
        &mut self,
        context: &OutputContext<'_>,
        variable: &Variable,
        name: &str,
        element: Option<usize>,
    ) -> Result<Vec<String>, FmiError> {
        if !variable.kind.is_number() {
            let reason = "it is text or binary, and results are numbers";
            return Err(FmiError::NotAnOutput { name: variable.name.clone(), reason });
        }
        let is_continuous = variable.kind.is_float() && variable.variability == Variability::Continuous;
        let mut push =
            |source| self.columns.push(Column { source, negated: variable.negated, is_continuous });
        if variable.causality == Causality::Independent {
            push(OutputSource::Time);
            return Ok(vec![name.to_owned()]);
        }
        let n = context.structure.elements(context.model, variable);
        let state =
            context.states.get(&variable.value_reference).filter(|_| variable.kind == VariableKind::Real);
        let wanted = element.map_or(0..n, |element| element..element + 1);
        let names = match element {
            Some(_) => vec![name.to_owned()],
            None if variable.dimensions.is_empty() => vec![name.to_owned()],
            None => {
                let extents = context.structure.extents(context.model, variable);
                (0..n).map(|element| format!("{name}{}", subscript(element, &extents))).collect()
            }
        };
        if let Some(first) = state {
            wanted.for_each(|element| push(OutputSource::State(first + element)));
            return Ok(names);
        }
        let first = self.place(variable, n);
        for element in wanted {
            let source = match variable.kind {
                VariableKind::Real => OutputSource::Real(first + element),
                kind => OutputSource::Packed(first + element, kind),
            };
            self.columns.push(Column { source, negated: variable.negated, is_continuous });
        }
        Ok(names)
    }

    /// First place of the values of a variable; lanes are counted group by group, see [`finish`](Self::finish).
    fn place(&mut self, variable: &Variable, n: usize) -> usize {
        let (kind, reference) = (variable.kind, variable.value_reference);
        if let Some(first) = self.arrays.get(&(kind, reference)) {
            return *first;
        }
        let (references, count) = if kind == VariableKind::Real {
            (&mut self.reals, &mut self.n_reals)
        } else {
            let group = match self.groups.iter().position(|group| group.kind == kind) {
                Some(group) => group,
                None => {
                    self.groups.push(Group { kind, references: Vec::new(), n_values: 0 });
                    self.groups.len() - 1
                }
            };
            let group = &mut self.groups[group];
            (&mut group.references, &mut group.n_values)
        };
        references.push(reference);
        let first = *count;
        *count += n;
        if n != 1 {
            self.arrays.insert((kind, reference), first);
        }
        first
    }

    /// Puts the lanes of all kinds into one row, when everything has been added.
    pub(crate) fn finish(&mut self) {
        let mut start = 0;
        for group in &self.groups {
            for column in &mut self.columns {
                if let OutputSource::Packed(place, kind) = &mut column.source
                    && *kind == group.kind
                {
                    *place += start;
                }
            }
            start += group.n_values;
        }
    }
}

/// `[2]`, `[1,3]`: counted from 1, the last index varying fastest.
fn subscript(element: usize, extents: &[usize]) -> String {
    let mut indices = Vec::with_capacity(extents.len());
    let mut rest = element;
    for extent in extents.iter().rev() {
        indices.push((rest % extent.max(&1) + 1).to_string());
        rest /= extent.max(&1);
    }
    indices.reverse();
    format!("[{}]", indices.join(","))
}

/// Splits `name[1,3]` into the name and the place of the element; `None` if that is not what it is.
pub(crate) fn element_of(name: &str, extents: impl Fn(&str) -> Option<Vec<usize>>) -> Option<(&str, usize)> {
    let inner = name.strip_suffix(']')?;
    let at = inner.rfind('[')?;
    let (array, indices) = (&name[..at], &inner[at + 1..]);
    let extents = extents(array)?;
    let indices: Vec<usize> = indices.split(',').map(|i| i.trim().parse().ok()).collect::<Option<_>>()?;
    if indices.len() != extents.len() || extents.is_empty() {
        return None;
    }
    let mut place = 0;
    for (index, extent) in indices.into_iter().zip(extents) {
        if index == 0 || index > extent {
            return None;
        }
        place = place * extent + index - 1;
    }
    Some((array, place))
}

/// Buffers for the values of one sample.
#[derive(Debug)]
pub(crate) struct OutputBuffers {
    reals: Vec<f64>,
    lanes: Vec<i64>,
}

impl OutputBuffers {
    pub(crate) fn new(plan: &OutputPlan) -> Self {
        let n_lanes = plan.groups.iter().map(|group| group.n_values).sum();
        Self { reals: vec![0.0; plan.n_reals], lanes: vec![0; n_lanes] }
    }

    /// Reads what comes from calls, one call per type.
    pub(crate) fn read(&mut self, plan: &OutputPlan, raw: &mut RawInstance) -> Result<(), Fault> {
        if !self.reals.is_empty() {
            raw.get_real(&plan.reals, &mut self.reals)?;
        }
        let mut rest = &mut self.lanes[..];
        for group in &plan.groups {
            let (lanes, others) = rest.split_at_mut(group.n_values);
            raw.get_packed(group.kind, &group.references, lanes)?;
            rest = others;
        }
        Ok(())
    }

    /// Puts the row together.
    pub(crate) fn row(&self, plan: &OutputPlan, t: f64, x: &[f64], y: &mut [f64]) {
        for (column, value) in plan.columns.iter().zip(y.iter_mut()) {
            *value = match column.source {
                OutputSource::Time => t,
                OutputSource::State(i) => x[i],
                OutputSource::Real(i) => self.reals[i],
                OutputSource::Packed(i, kind) => lanes::number(kind, self.lanes[i]),
            };
            if column.negated {
                *value = match column.source {
                    OutputSource::Packed(_, VariableKind::Boolean) => 1.0 - *value,
                    _ => -*value,
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_have_names_and_names_find_elements() {
        assert_eq!(subscript(0, &[3]), "[1]");
        assert_eq!(subscript(4, &[2, 3]), "[2,2]");
        let extents = |name: &str| (name == "m").then(|| vec![2, 3]);
        assert_eq!(element_of("m[2,2]", extents), Some(("m", 4)));
        for bad in ["m[0,1]", "m[3,1]", "m[1]", "m[1,2,3]", "m", "m[a,b]", "n[1,1]", "m[1,1", "[1,1]"] {
            assert_eq!(element_of(bad, extents), None, "{bad}");
        }
    }
}
