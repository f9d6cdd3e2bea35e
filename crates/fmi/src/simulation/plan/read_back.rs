//! Check that a reused instance has its specified values. Some models
//! restore parameters in a reset, immediately or later.

use crate::description::{Causality, Initial, ModelDescription, Variable, VariableKind};
use crate::error::Result;
use crate::instance::Core;
use crate::instance::assignments::Assignments;
use crate::instance::integer_codec;
use crate::value::is_same_number;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// Location of the value specified for a variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum GivenValue {
    /// Index among the start values of its type.
    Start(usize),
    /// Index among the parameters of the run.
    Parameter(usize),
}

/// Variables that must keep their specified values after the initialization: parameters, and variables with
/// `initial = exact`. Only scalars are checked.
#[derive(Debug, Default)]
pub(crate) struct ReadBack {
    groups: Vec<Group>,
    /// True if the model overrides some of the values even in a new instance. The check is then disabled.
    overridden: AtomicBool,
}

/// Variables of one kind, and the locations of their specified values.
#[derive(Debug)]
struct Group {
    kind: VariableKind,
    references: Vec<u32>,
    given: Vec<GivenValue>,
}

/// Variable that does not have its specified value.
pub(crate) struct Lost<'d> {
    pub(crate) variable: &'d Variable,
    pub(crate) given: f64,
    pub(crate) found: f64,
}

/// Buffers for values read from the model.
#[derive(Debug, Default)]
pub(crate) struct ReadBackBuffers {
    reals: Vec<f64>,
    words: Vec<i64>,
}

impl Group {
    /// Reads the variables: floating-point numbers directly, all others as words.
    fn read(&self, core: &mut Core, buffers: &mut ReadBackBuffers) -> Result<()> {
        let (n, ReadBackBuffers { reals, words }) = (self.references.len(), buffers);
        reals.clear();
        if self.kind == VariableKind::Real {
            reals.resize(n, 0.0);
            return core.call(|raw| raw.get_real(&self.references, reals));
        }
        words.clear();
        words.resize(n, 0);
        core.call(|raw| raw.get_packed(self.kind, &self.references, words))?;
        if self.kind.is_float() {
            reals.extend(words.iter().map(|word| integer_codec::number(self.kind, *word)));
        }
        Ok(())
    }

    /// Returns the value specified for a floating-point variable.
    fn number(
        &self,
        given: GivenValue,
        start_values: &Assignments,
        parameter: &impl Fn(usize) -> f64,
    ) -> f64 {
        match given {
            GivenValue::Start(place) if self.kind == VariableKind::Real => start_values.reals.1[place],
            GivenValue::Start(place) => integer_codec::number(self.kind, self.word(place, start_values)),
            GivenValue::Parameter(place) if self.kind == VariableKind::Real => parameter(place),
            GivenValue::Parameter(place) => f64::from(parameter(place) as f32),
        }
    }

    /// Returns the start value at this index among the values of a kind stored as words.
    fn word(&self, place: usize, start_values: &Assignments) -> i64 {
        let group = start_values.packed.iter().find(|(packed_kind, ..)| *packed_kind == self.kind);
        group.map_or(0, |(_, _, words)| words[place])
    }

    /// Removes duplicates. If a variable has several values, the last one is used.
    fn finish(&mut self) {
        let last: HashMap<u32, GivenValue> =
            self.references.iter().copied().zip(self.given.iter().copied()).collect();
        self.references.sort_unstable();
        self.references.dedup();
        self.given = self.references.iter().map(|reference| last[reference]).collect();
    }
}

impl ReadBack {
    /// Records the start value of a variable, which has just been appended to the plan's start values.
    pub(crate) fn add_start(&mut self, variable: &Variable, values: &Assignments) {
        let keeps = variable.causality == Causality::Parameter
            || (variable.initial == Some(Initial::Exact) && variable.causality != Causality::Input);
        if !keeps || !variable.dimensions.is_empty() {
            return;
        }
        let n_values = match variable.kind {
            VariableKind::Real => values.reals.1.len(),
            kind => match values.packed.iter().find(|(packed_kind, ..)| *packed_kind == kind) {
                Some((_, _, words)) => words.len(),
                None => return,
            },
        };
        self.push(variable, GivenValue::Start(n_values - 1));
    }

    /// Records a parameter of the runs by its index. Parameters are set after the start values.
    pub(crate) fn add_parameter(&mut self, variable: &Variable, place: usize) {
        if variable.causality == Causality::Parameter || variable.initial == Some(Initial::Exact) {
            self.push(variable, GivenValue::Parameter(place));
        }
    }

    fn push(&mut self, variable: &Variable, given: GivenValue) {
        let (kind, reference) = (variable.kind, variable.value_reference);
        match self.groups.iter_mut().find(|group| group.kind == kind) {
            Some(group) => {
                group.references.push(reference);
                group.given.push(given);
            }
            None => self.groups.push(Group { kind, references: vec![reference], given: vec![given] }),
        }
    }

    /// Completes the list after all values are recorded.
    pub(crate) fn finish(&mut self) {
        self.groups.iter_mut().for_each(Group::finish);
        self.groups.sort_by_key(|group| group.kind);
    }

    /// True if an initialized instance has its specified values. `parameter` returns the parameter values as
    /// set in the FMU. Errors come from the FMU.
    pub(crate) fn agrees(
        &self,
        core: &mut Core,
        start_values: &Assignments,
        parameter: impl Fn(usize) -> f64,
        buffers: &mut ReadBackBuffers,
    ) -> Result<bool> {
        if self.overridden.load(Ordering::Relaxed) {
            return Ok(true);
        }
        for group in &self.groups {
            group.read(core, buffers)?;
            // The values are not compared by bits, because a model may lose the sign of a zero.
            let mut numbers = group.given.iter().zip(&buffers.reals);
            let is_number = |(given, found): (&GivenValue, &f64)| {
                group.number(*given, start_values, &parameter) == *found
            };
            let mut words = group.given.iter().zip(&buffers.words);
            let is_word = |(given, found): (&GivenValue, &i64)| match given {
                GivenValue::Start(place) => group.word(*place, start_values) == *found,
                GivenValue::Parameter(_) => true,
            };
            if !(if group.kind.is_float() { numbers.all(is_number) } else { words.all(is_word) }) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Returns the first floating-point variable that does not have its value in a new instance. Parameters
    /// take precedence over other variables. A difference in the last digits is ignored, because the model
    /// may store fewer digits. Errors come from the FMU.
    pub(crate) fn first_lost<'d>(
        &self,
        core: &mut Core,
        description: &'d ModelDescription,
        start_values: &Assignments,
        parameter: impl Fn(usize) -> f64,
    ) -> Result<Option<Lost<'d>>> {
        let (mut first, mut buffers) = (None, ReadBackBuffers::default());
        for group in self.groups.iter().filter(|group| group.kind.is_float()) {
            group.read(core, &mut buffers)?;
            for ((reference, given), found) in group.references.iter().zip(&group.given).zip(&buffers.reals) {
                let given = group.number(*given, start_values, &parameter);
                if is_same_number(given, *found) {
                    continue;
                }
                let is = |v: &&Variable| v.kind == group.kind && v.value_reference == *reference;
                let Some(variable) = description.variables.iter().find(is) else { continue };
                let sign = if variable.negated { -1.0 } else { 1.0 };
                let lost = Lost { variable, given: sign * given, found: sign * found };
                if variable.causality == Causality::Parameter {
                    return Ok(Some(lost));
                }
                first.get_or_insert(lost);
            }
        }
        Ok(first)
    }

    /// Records that a new instance does not have its specified values either.
    pub(crate) fn set_overridden(&self) {
        self.overridden.store(true, Ordering::Relaxed);
    }
}
