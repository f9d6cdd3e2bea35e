//! Check that a reused instance has the values it was given: some models, when a saved state is restored,
//! restore the parameters that were in it, at once or later.

use crate::description::{Causality, Initial, ModelDescription, Variable, VariableKind};
use crate::error::FmiError;
use crate::instance::Core;
use crate::instance::assignments::Assignments;
use crate::instance::integer_codec;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// Where the value given to a variable is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Given {
    /// Among the start values of its type.
    Start(usize),
    /// Among the parameters of the run.
    Parameter(usize),
}

/// The variables whose values must be those given, also after the initialization: parameters, and what starts
/// exactly at its start value. Single variables only.
#[derive(Debug, Default)]
pub(crate) struct ReadBack {
    reals: Columns<Given>,
    /// Parameters of the runs that are of type `Float32`, by their place among them.
    singles: Columns<usize>,
    packed: Vec<(VariableKind, Columns<usize>)>,
    /// The model gives some of them other values by itself, also in a new instance: nothing follows from
    /// that.
    overridden: AtomicBool,
}

/// References, and where the values given are found.
#[derive(Debug)]
struct Columns<T> {
    references: Vec<u32>,
    places: Vec<T>,
}

impl<T> Default for Columns<T> {
    fn default() -> Self {
        Self { references: Vec::new(), places: Vec::new() }
    }
}

impl<T: Copy> Columns<T> {
    fn push(&mut self, reference: u32, place: T) {
        self.references.push(reference);
        self.places.push(place);
    }

    /// Of several values given to one variable the last counts.
    fn finish(&mut self) {
        let mut last: HashMap<u32, T> = HashMap::with_capacity(self.places.len());
        last.extend(self.references.iter().copied().zip(self.places.iter().copied()));
        self.references.sort_unstable();
        self.references.dedup();
        self.places = self.references.iter().map(|reference| last[reference]).collect();
    }
}

/// A variable that does not have the value that it was given.
pub(crate) struct Lost<'d> {
    pub(crate) variable: &'d Variable,
    pub(crate) given: f64,
    pub(crate) found: f64,
}

/// Values that differ by no more than this part of them were stored in single precision, or printed and read.
const FEWER_DIGITS: f64 = 1e-6;

/// Buffers for what is read.
#[derive(Debug, Default)]
pub(crate) struct ReadBackBuffers {
    reals: Vec<f64>,
    words: Vec<i64>,
}

/// Reads variables of type `Float32`.
fn read_singles<'b>(
    core: &mut Core,
    references: &[u32],
    buffers: &'b mut ReadBackBuffers,
) -> Result<impl Iterator<Item = f64> + 'b, FmiError> {
    buffers.words.clear();
    buffers.words.resize(references.len(), 0);
    core.call(|raw| raw.get_packed(VariableKind::Float32, references, &mut buffers.words))?;
    Ok(buffers.words.iter().map(|word| integer_codec::number(VariableKind::Float32, *word)))
}

impl ReadBack {
    /// Notes the start value of a variable, which has just been added to those of the plan.
    pub(crate) fn add_start(&mut self, variable: &Variable, values: &Assignments) {
        let keeps = variable.causality == Causality::Parameter
            || (variable.initial == Some(Initial::Exact) && variable.causality != Causality::Input);
        if !keeps || !variable.dimensions.is_empty() {
            return;
        }
        let (kind, reference) = (variable.kind, variable.value_reference);
        if kind == VariableKind::Real {
            return self.reals.push(reference, Given::Start(values.reals.1.len() - 1));
        }
        let Some((_, _, words)) = values.packed.iter().find(|(known, ..)| *known == kind) else { return };
        let place = words.len() - 1;
        match self.packed.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, columns)) => columns.push(reference, place),
            None => {
                self.packed.push((kind, Columns { references: vec![reference], places: vec![place] }));
            }
        }
    }

    /// Notes a parameter of the runs, by its place among them. They are set after the start values.
    pub(crate) fn add_parameter(&mut self, variable: &Variable, place: usize) {
        if variable.causality == Causality::Parameter || variable.initial == Some(Initial::Exact) {
            match variable.kind {
                VariableKind::Real => self.reals.push(variable.value_reference, Given::Parameter(place)),
                _ => self.singles.push(variable.value_reference, place),
            }
        }
    }

    /// All are noted.
    pub(crate) fn finish(&mut self) {
        self.reals.finish();
        self.singles.finish();
        self.packed.iter_mut().for_each(|(_, columns)| columns.finish());
    }

    /// True if an initialized instance has the values given; `parameter` returns those of the parameters as
    /// the FMU was given them. An error is one of the FMU's.
    pub(crate) fn agrees(
        &self,
        core: &mut Core,
        start_values: &Assignments,
        parameter: impl Fn(usize) -> f64,
        buffers: &mut ReadBackBuffers,
    ) -> Result<bool, FmiError> {
        if self.overridden.load(Ordering::Relaxed) {
            return Ok(true);
        }
        let mut agrees = true;
        let Columns { references, places } = &self.reals;
        if !references.is_empty() {
            buffers.reals.clear();
            buffers.reals.resize(references.len(), 0.0);
            core.call(|raw| raw.get_real(references, &mut buffers.reals))?;
            agrees &= places.iter().zip(&buffers.reals).all(|(given, found)| {
                let given = match *given {
                    Given::Start(place) => start_values.reals.1[place],
                    Given::Parameter(place) => parameter(place),
                };
                // Not by bits: a model may lose the sign of a zero.
                given == *found
            });
        }
        let Columns { references, places } = &self.singles;
        if !references.is_empty() {
            let found = read_singles(core, references, buffers)?;
            agrees &=
                places.iter().zip(found).all(|(place, found)| f64::from(parameter(*place) as f32) == found);
        }
        for (kind, Columns { references, places }) in &self.packed {
            let Some((_, _, given)) = start_values.packed.iter().find(|(known, ..)| known == kind) else {
                continue;
            };
            buffers.words.clear();
            buffers.words.resize(references.len(), 0);
            core.call(|raw| raw.get_packed(*kind, references, &mut buffers.words))?;
            agrees &= places.iter().zip(&buffers.words).all(|(place, found)| given[*place] == *found);
        }
        Ok(agrees)
    }

    /// The first of the real variables that a new instance did not give its value: of the parameters, else of
    /// the others. What differs in its last digits was stored with fewer of them. An error is one of the
    /// FMU's.
    pub(crate) fn first_lost<'d>(
        &self,
        core: &mut Core,
        description: &'d ModelDescription,
        start_values: &Assignments,
        parameter: impl Fn(usize) -> f64,
    ) -> Result<Option<Lost<'d>>, FmiError> {
        let Columns { references, places } = &self.reals;
        let mut values = vec![0.0; references.len()];
        if !references.is_empty() {
            core.call(|raw| raw.get_real(references, &mut values))?;
        }
        let reals = references.iter().zip(places).zip(values).map(|((reference, place), found)| {
            let given = match *place {
                Given::Start(place) => start_values.reals.1[place],
                Given::Parameter(place) => parameter(place),
            };
            (VariableKind::Real, reference, given, found)
        });
        let Columns { references, places } = &self.singles;
        let mut buffers = ReadBackBuffers::default();
        let values: Vec<f64> = match references.is_empty() {
            true => Vec::new(),
            false => read_singles(core, references, &mut buffers)?.collect(),
        };
        let singles = references.iter().zip(places).zip(values);
        let singles = singles
            .map(|((reference, place), found)| (VariableKind::Float32, reference, parameter(*place), found));
        let mut first = None;
        for (kind, reference, given, found) in reals.chain(singles) {
            let is_kept = (given - found).abs() <= FEWER_DIGITS * given.abs().max(found.abs());
            let is = |v: &&Variable| v.kind == kind && v.value_reference == *reference;
            let Some(variable) = description.variables.iter().find(is).filter(|_| !is_kept) else { continue };
            let sign = if variable.negated { -1.0 } else { 1.0 };
            let lost = Lost { variable, given: sign * given, found: sign * found };
            if variable.causality == Causality::Parameter {
                return Ok(Some(lost));
            }
            first.get_or_insert(lost);
        }
        Ok(first)
    }

    /// A new instance does not have the values given either.
    pub(crate) fn set_overridden(&self) {
        self.overridden.store(true, Ordering::Relaxed);
    }
}
