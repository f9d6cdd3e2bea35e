//! Recording of outputs: outputs sorted into one call per type, and buffers for the values read.

use super::texts::{self, ValueTable};
use crate::description::{Causality, ModelDescription, Structure, Variability, Variable, VariableKind};
use crate::instance::integer_codec;
use crate::sys::{Fault, RawInstance};
use crate::value::is_same_number;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::ops::Range;

/// Source of an output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OutputSource {
    Time,
    /// State or alias of a state, copied without a call. The indices refer to the state vector and to the
    /// values of type `Real`. In the latter, states follow the values that are read for every row.
    State(usize, usize),
    /// Index among the values of type `Real`.
    Real(usize),
    /// Index among the words of all other numbers.
    Packed(usize, VariableKind),
    /// Upper (`true`) or lower half of a word.
    Half(usize, VariableKind, bool),
    /// Index among the strings.
    Text(usize),
    /// Index among the binary values.
    Bytes(usize),
    /// 1 if a clock ticked at this time, otherwise 0. Index among the recorded clocks.
    Tick(usize),
}

/// Variable that a simulation records, and its columns in the result. An array has a column for each element,
/// the last index varying fastest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Recorded {
    /// Name under which the variable was requested.
    pub name: String,
    /// Type.
    pub kind: VariableKind,
    /// Extents of an array; empty for a scalar or an element.
    pub extents: Vec<usize>,
    /// Its numeric columns; empty for strings and binary variables.
    pub columns: Range<usize>,
    /// Its columns among the values: strings, binary variables and 64-bit integers. A double cannot represent
    /// all 64-bit integers.
    pub values: Range<usize>,
}

/// Column of the results.
#[derive(Debug, Clone, Copy)]
struct OutputColumn {
    source: OutputSource,
    negated: bool,
    /// True if the column may be interpolated.
    is_continuous: bool,
}

/// Variables of one kind for one call: references, and the number of words of their values.
#[derive(Debug)]
struct Group {
    kind: VariableKind,
    references: Vec<u32>,
    n_values: usize,
}

/// Outputs by type, each type for one call.
#[derive(Debug, Default)]
pub(crate) struct OutputPlan {
    columns: Vec<OutputColumn>,
    reals: Vec<u32>,
    n_reals: usize,
    /// References of the states as variables, and the number of their values.
    states: (Vec<u32>, usize),
    groups: Vec<Group>,
    /// Index of the first value of each array variable already added.
    arrays: HashMap<(VariableKind, u32), usize>,
    texts: (Vec<u32>, usize),
    binaries: (Vec<u32>, usize),
    /// Maximum size of each binary value in bytes.
    most_bytes: Vec<Option<usize>>,
    /// Value references of the clocks recorded.
    pub(crate) clocks: Vec<u32>,
    /// Columns without names, which follow the others: see `texts.rs`.
    unnamed: Vec<OutputColumn>,
    /// Names and kinds of the values that the unnamed columns represent.
    pub(crate) values: Vec<(String, VariableKind)>,
    pub(crate) recorded: Vec<Recorded>,
    /// Columns of scalar continuous outputs of type Real that are read unchanged, and their references. These
    /// outputs may have derivatives.
    pub(crate) smooth: (Vec<usize>, Vec<u32>),
}

/// Context for resolving outputs.
pub(crate) struct OutputContext<'a> {
    pub(crate) model: &'a ModelDescription,
    pub(crate) structure: &'a Structure,
    /// First index in the state vector of each state variable, by value reference.
    pub(crate) states: &'a HashMap<u32, usize>,
}

impl OutputPlan {
    /// Returns the number of columns, with and without names.
    pub(crate) fn len(&self) -> usize {
        self.columns.len()
    }

    /// True if states are recorded.
    pub(crate) fn has_states(&self) -> bool {
        self.states.1 > 0
    }

    /// True if a sample needs a call of the FMU.
    pub(crate) fn needs_fmu(&self) -> bool {
        let nothing = self.reals.is_empty() && self.groups.is_empty();
        !(nothing && self.texts.0.is_empty() && self.binaries.0.is_empty())
    }

    /// True if a column contains the time.
    pub(crate) fn is_time(&self, column: usize) -> bool {
        self.columns[column].source == OutputSource::Time
    }

    /// True if a column contains the ticks of a clock, which occur only at events.
    pub(crate) fn is_tick(&self, column: usize) -> bool {
        matches!(self.columns[column].source, OutputSource::Tick(_))
    }

    /// True if a column may be interpolated.
    pub(crate) fn is_continuous(&self, column: usize) -> bool {
        self.columns[column].is_continuous
    }

    /// Adds a variable: one column, or one for each element of an array. If `element` is specified, adds only
    /// that element. Returns the names of the numeric columns.
    pub(crate) fn add(
        &mut self,
        context: &OutputContext<'_>,
        variable: &Variable,
        name: &str,
        element: Option<usize>,
    ) -> Vec<String> {
        let (kind, negated) = (variable.kind, variable.negated);
        let extents = match element {
            Some(_) => Vec::new(),
            None => context.structure.extents(context.model, variable),
        };
        let (first_column, first_value) = (self.columns.len(), self.values.len());
        let is_continuous = kind.is_float() && variable.variability == Variability::Continuous;
        let n = context.structure.elements(context.model, variable);
        let wanted = element.map_or(0..n, |element| element..element + 1);
        let is_array = element.is_none() && !variable.dimensions.is_empty();
        let column_name = |element| match is_array {
            true => format!("{name}{}", subscript(element, &extents)),
            false => name.to_owned(),
        };
        let state = context.states.get(&variable.value_reference).filter(|_| kind == VariableKind::Real);
        let first = match variable.causality {
            Causality::Independent => 0,
            _ => self.place(variable, n, state.is_some()),
        };
        let mut names = Vec::new();
        for element in wanted {
            let place = first + element;
            let column = |source| OutputColumn { source, negated, is_continuous };
            let source = match (kind, state) {
                _ if variable.causality == Causality::Independent => OutputSource::Time,
                (_, Some(first)) => OutputSource::State(first + element, place),
                (VariableKind::Real, _) => OutputSource::Real(place),
                (VariableKind::String, _) => OutputSource::Text(place),
                (VariableKind::Binary, _) => OutputSource::Bytes(place),
                (VariableKind::Clock, _) => OutputSource::Tick(place),
                (kind, _) => OutputSource::Packed(place, kind),
            };
            if kind.is_number() {
                if is_continuous && !negated && variable.causality == Causality::Output && n == 1 && !is_array
                {
                    self.smooth.0.push(self.columns.len());
                    self.smooth.1.push(variable.value_reference);
                }
                names.push(column_name(element));
                self.columns.push(column(source));
            }
            match texts::width(kind) {
                0 => continue,
                1 => self.unnamed.push(column(source)),
                _ => self
                    .unnamed
                    .extend([true, false].map(|upper| column(OutputSource::Half(place, kind, upper)))),
            }
            self.values.push((column_name(element), kind));
        }
        self.recorded.push(Recorded {
            name: name.to_owned(),
            kind,
            extents,
            columns: first_column..self.columns.len(),
            values: first_value..self.values.len(),
        });
        names
    }

    /// Returns the index of the first value of a variable. Words are counted per group; see
    /// [`finish`](Self::finish).
    fn place(&mut self, variable: &Variable, n: usize, is_state: bool) -> usize {
        let (kind, reference) = (variable.kind, variable.value_reference);
        if let Some(first) = self.arrays.get(&(kind, reference)) {
            return *first;
        }
        let (references, count) = if is_state {
            (&mut self.states.0, &mut self.states.1)
        } else if kind == VariableKind::Real {
            (&mut self.reals, &mut self.n_reals)
        } else if kind == VariableKind::String {
            (&mut self.texts.0, &mut self.texts.1)
        } else if kind == VariableKind::Binary {
            self.most_bytes.extend(std::iter::repeat_n(variable.max_size, n));
            (&mut self.binaries.0, &mut self.binaries.1)
        } else if kind == VariableKind::Clock {
            self.clocks.push(reference);
            return self.clocks.len() - 1;
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

    /// Completes the plan after everything has been added. States follow the other values of type `Real`. The
    /// words of all kinds form one row. Unnamed columns follow the others.
    pub(crate) fn finish(&mut self) {
        self.columns.append(&mut self.unnamed);
        for column in &mut self.columns {
            if let OutputSource::State(_, place) = &mut column.source {
                *place += self.n_reals;
            }
        }
        let mut start = 0;
        for group in &self.groups {
            for column in &mut self.columns {
                if let OutputSource::Packed(place, kind) | OutputSource::Half(place, kind, _) =
                    &mut column.source
                    && *kind == group.kind
                {
                    *place += start;
                }
            }
            start += group.n_values;
        }
    }
}

/// Returns a subscript such as `[2]` or `[1,3]`, counted from 1, the last index varying fastest.
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

/// Splits `name[1,3]` into the name and the index of the element. Returns `None` if the name does not have
/// this form.
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
    words: Vec<i64>,
    texts: Vec<f64>,
    binaries: Vec<f64>,
    /// True if the states are read as variables instead of from the state vector.
    pub(crate) reads_states: bool,
    /// Times of the last ticks of the recorded clocks.
    pub(crate) ticked: Vec<f64>,
    /// Strings and binary values of the run.
    pub(crate) table: ValueTable,
}

impl OutputBuffers {
    pub(crate) fn new(plan: &OutputPlan) -> Self {
        let n_words = plan.groups.iter().map(|group| group.n_values).sum();
        Self {
            reals: vec![0.0; plan.n_reals + plan.states.1],
            words: vec![0; n_words],
            texts: vec![0.0; plan.texts.1],
            binaries: vec![0.0; plan.binaries.1],
            reads_states: false,
            ticked: vec![f64::NAN; plan.clocks.len()],
            table: ValueTable::default(),
        }
    }

    /// Clears the data of the previous run.
    pub(crate) fn begin(&mut self) {
        self.reads_states = false;
        self.table.clear();
        self.ticked.fill(f64::NAN);
    }

    /// Reads the values that require calls, one call per type.
    pub(crate) fn read(&mut self, plan: &OutputPlan, raw: &mut RawInstance) -> Result<(), Fault> {
        if plan.n_reals > 0 {
            raw.get_real(&plan.reals, &mut self.reals[..plan.n_reals])?;
        }
        if self.reads_states {
            self.read_states(plan, raw)?;
        }
        let mut rest = &mut self.words[..];
        for group in &plan.groups {
            let (words, others) = rest.split_at_mut(group.n_values);
            raw.get_packed(group.kind, &group.references, words)?;
            rest = others;
        }
        if !self.texts.is_empty() {
            let mut places = self.texts.iter_mut();
            let table = &mut self.table;
            raw.get_string(&plan.texts.0, places.len(), |text| {
                places.next().into_iter().for_each(|place| *place = table.text(text, *place));
            })?;
        }
        if !self.binaries.is_empty() {
            let mut places = self.binaries.iter_mut();
            let table = &mut self.table;
            let most = |k: usize| plan.most_bytes[k];
            raw.get_binary(&plan.binaries.0, places.len(), most, |bytes| {
                places.next().into_iter().for_each(|place| *place = table.bytes(bytes, *place));
            })?;
        }
        Ok(())
    }

    /// Reads the recorded states as variables.
    pub(crate) fn read_states(&mut self, plan: &OutputPlan, raw: &mut RawInstance) -> Result<(), Fault> {
        raw.get_real(&plan.states.0, &mut self.reals[plan.n_reals..])
    }

    /// Returns the column of a state whose variable differs from the state vector, and the value of the
    /// variable. A value that is not finite takes precedence.
    pub(crate) fn contradiction(&self, plan: &OutputPlan, x: &[f64]) -> Option<(usize, f64)> {
        let differs = |(k, column): (usize, &OutputColumn)| match column.source {
            OutputSource::State(i, place) => {
                let found = self.reals[place];
                (!is_same_number(found, x[i])).then_some((k, found))
            }
            _ => None,
        };
        plan.columns.iter().enumerate().filter_map(differs).min_by_key(|(_, found)| found.is_finite())
    }

    /// Assembles the row. Times closer than `time_tolerance` count as equal.
    pub(crate) fn row(&self, plan: &OutputPlan, t: f64, time_tolerance: f64, x: &[f64], y: &mut [f64]) {
        for (column, value) in plan.columns.iter().zip(y.iter_mut()) {
            *value = match column.source {
                OutputSource::Time => t,
                OutputSource::State(_, place) if self.reads_states => self.reals[place],
                OutputSource::State(i, _) => x[i],
                OutputSource::Real(i) => self.reals[i],
                OutputSource::Packed(i, kind) => integer_codec::number(kind, self.words[i]),
                OutputSource::Half(i, _, upper) => texts::half(self.words[i], upper),
                OutputSource::Text(i) => self.texts[i],
                OutputSource::Bytes(i) => self.binaries[i],
                OutputSource::Tick(i) => f64::from(u8::from((t - self.ticked[i]).abs() <= time_tolerance)),
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
    fn subscript_and_element_of_convert_element_names() {
        assert_eq!(subscript(0, &[3]), "[1]");
        assert_eq!(subscript(4, &[2, 3]), "[2,2]");
        let extents = |name: &str| (name == "m").then(|| vec![2, 3]);
        assert_eq!(element_of("m[2,2]", extents), Some(("m", 4)));
        for bad in ["m[0,1]", "m[3,1]", "m[1]", "m[1,2,3]", "m", "m[a,b]", "n[1,1]", "m[1,1", "[1,1]"] {
            assert_eq!(element_of(bad, extents), None, "{bad}");
        }
    }
}
