//! Array sizes: constant dimensions, and dimensions that are values of structural parameters.

use super::model::{ModelDescription, Unknown};
use super::variable::{Dimension, Variable};
use crate::value::Value;

/// Values of structural parameters that differ from the start values.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Structure {
    values: Vec<(usize, usize)>,
}

impl Structure {
    /// True if all structural parameters have their start values.
    pub(crate) fn is_default(&self) -> bool {
        self.values.is_empty()
    }

    /// Sets the structural parameter with this index. Negative values count as 0.
    pub(crate) fn set(&mut self, index: usize, value: &Value) {
        let Value::Integer(value) = value else { return };
        let value = usize::try_from(*value).unwrap_or(0);
        match self.values.iter_mut().find(|(entry, _)| *entry == index) {
            Some(entry) => entry.1 = value,
            None => self.values.push((index, value)),
        }
    }

    /// Returns the extents of a variable; empty for a scalar.
    pub(crate) fn extents(&self, model: &ModelDescription, variable: &Variable) -> Vec<usize> {
        variable.dimensions.iter().map(|dimension| self.extent(model, *dimension)).collect()
    }

    fn extent(&self, model: &ModelDescription, dimension: Dimension) -> usize {
        let index = match dimension {
            Dimension::Fixed(extent) => return extent,
            Dimension::Parameter(index) => index,
        };
        if let Some((_, value)) = self.values.iter().find(|(entry, _)| *entry == index) {
            return *value;
        }
        match model.variables.get(index).and_then(|parameter| parameter.start.as_ref()) {
            Some(Value::Integer(value)) => usize::try_from(*value).unwrap_or(0),
            _ => 0,
        }
    }

    /// Returns the number of values of a variable, or `usize::MAX` on overflow.
    pub(crate) fn elements(&self, model: &ModelDescription, variable: &Variable) -> usize {
        let product = variable
            .dimensions
            .iter()
            .try_fold(1usize, |n, dimension| n.checked_mul(self.extent(model, *dimension)));
        product.unwrap_or(usize::MAX)
    }

    /// Returns an error if all arrays together, the states or the event indicators exceed the limit on
    /// elements. The message contains the array with which the sum exceeds the limit.
    pub(crate) fn check(&self, model: &ModelDescription) -> Result<(), (u32, String)> {
        let limit = model.most_elements;
        let refuse = |line, what: &str| {
            let sizes = if self.is_default() { "" } else { " with the specified structural parameters" };
            Err((
                line,
                format!("{what} more than {limit} elements{sizes}; the limit is DescriptionLimits::elements"),
            ))
        };
        let mut sum = 0_usize;
        for variable in model.variables.iter().filter(|variable| !variable.dimensions.is_empty()) {
            let elements = self.elements(model, variable);
            sum = sum.saturating_add(elements);
            if elements > limit {
                let extents =
                    self.extents(model, variable).iter().map(ToString::to_string).collect::<Vec<_>>();
                return refuse(
                    variable.line,
                    &format!("\"{}\" ({}) has", variable.name, extents.join(" x ")),
                );
            }
            if sum > limit {
                let what = format!("the arrays up to \"{}\" together have", variable.name);
                return refuse(variable.line, &what);
            }
        }
        for (what, n) in [("states", self.states(model)), ("event indicators", self.indicators(model))] {
            if n > limit {
                return refuse(0, &format!("the {what} have"));
            }
        }
        Ok(())
    }

    /// Returns the number of continuous states.
    pub(crate) fn states(&self, model: &ModelDescription) -> usize {
        match model.declared_states {
            Some(n) => n,
            None => self.sum(model, &model.structure.derivatives),
        }
    }

    /// Returns the number of event indicators.
    pub(crate) fn indicators(&self, model: &ModelDescription) -> usize {
        match &model.structure.event_indicators[..] {
            [] => model.n_event_indicators,
            list => self.sum(model, list),
        }
    }

    fn sum(&self, model: &ModelDescription, unknowns: &[Unknown]) -> usize {
        unknowns
            .iter()
            .map(|unknown| self.elements(model, &model.variables[unknown.index]))
            .fold(0, usize::saturating_add)
    }
}
