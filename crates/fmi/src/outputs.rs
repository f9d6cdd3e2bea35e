//! What a simulation records: outputs sorted into one call per type, and the buffers they are read into.

use crate::description::{Causality, Variability, Variable, VariableKind};
use crate::error::FmiError;
use crate::sys::{Fault, RawInstance};
use std::collections::HashMap;

/// Where an output comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OutputSource {
    Time,
    /// A state or an alias of one: copied, without a call.
    State(usize),
    Real(usize),
    Integer(usize),
    Boolean(usize),
}

/// The outputs by type, each type for one call.
#[derive(Debug, Default)]
pub(crate) struct OutputPlan {
    pub(crate) sources: Vec<OutputSource>,
    pub(crate) reals: Vec<u32>,
    pub(crate) integers: Vec<u32>,
    pub(crate) booleans: Vec<u32>,
    /// Of each column: whether it may be interpolated.
    pub(crate) is_continuous: Vec<bool>,
}

impl OutputPlan {
    /// Whether a sample needs a call at all.
    pub(crate) fn needs_fmu(&self) -> bool {
        !(self.reals.is_empty() && self.integers.is_empty() && self.booleans.is_empty())
    }

    /// Whether a column is time itself.
    pub(crate) fn is_time(&self, column: usize) -> bool {
        self.sources[column] == OutputSource::Time
    }

    /// Adds a column; `states` are the places of the state variables by value reference.
    ///
    /// # Errors
    /// The variable is text.
    pub(crate) fn add(&mut self, variable: &Variable, states: &HashMap<u32, usize>) -> Result<(), FmiError> {
        self.is_continuous
            .push(variable.kind == VariableKind::Real && variable.variability == Variability::Continuous);
        let reference = variable.value_reference;
        let place = |list: &mut Vec<u32>| {
            list.push(reference);
            list.len() - 1
        };
        self.sources.push(match variable.kind {
            _ if variable.causality == Causality::Independent => OutputSource::Time,
            VariableKind::Real => match states.get(&reference) {
                Some(state) => OutputSource::State(*state),
                None => OutputSource::Real(place(&mut self.reals)),
            },
            VariableKind::Integer | VariableKind::Enumeration => {
                OutputSource::Integer(place(&mut self.integers))
            }
            VariableKind::Boolean => OutputSource::Boolean(place(&mut self.booleans)),
            VariableKind::String => {
                let reason = "it is text, and results are numbers";
                return Err(FmiError::NotAnOutput { name: variable.name.clone(), reason });
            }
        });
        Ok(())
    }
}

/// Buffers for the values of one sample.
#[derive(Debug)]
pub(crate) struct OutputBuffers {
    reals: Vec<f64>,
    integers: Vec<i32>,
    booleans: Vec<bool>,
}

impl OutputBuffers {
    pub(crate) fn new(plan: &OutputPlan) -> Self {
        Self {
            reals: vec![0.0; plan.reals.len()],
            integers: vec![0; plan.integers.len()],
            booleans: vec![false; plan.booleans.len()],
        }
    }

    /// Reads what comes from calls, one call per type.
    pub(crate) fn read(&mut self, plan: &OutputPlan, raw: &mut RawInstance) -> Result<(), Fault> {
        if !self.reals.is_empty() {
            raw.get_real(&plan.reals, &mut self.reals)?;
        }
        if !self.integers.is_empty() {
            raw.get_integer(&plan.integers, &mut self.integers)?;
        }
        if !self.booleans.is_empty() {
            raw.get_boolean(&plan.booleans, &mut self.booleans)?;
        }
        Ok(())
    }

    /// Puts the row together.
    pub(crate) fn row(&self, plan: &OutputPlan, t: f64, x: &[f64], y: &mut [f64]) {
        for (source, value) in plan.sources.iter().zip(y.iter_mut()) {
            *value = match *source {
                OutputSource::Time => t,
                OutputSource::State(i) => x[i],
                OutputSource::Real(i) => self.reals[i],
                OutputSource::Integer(i) => f64::from(self.integers[i]),
                OutputSource::Boolean(i) => f64::from(u8::from(self.booleans[i])),
            };
        }
    }
}
