//! Signals of criteria: formulas over outputs of the model, columns of the recording, and time.

use crate::data::Series;
use crate::expression::Expression;

/// Source of a name of a signal.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Source {
    /// Output with this index.
    Output(usize),
    /// Column of the recording, interpolated linearly and constant beyond its ends.
    Column { times: Series, values: Series },
    /// Time of the model.
    Time,
}

/// Formula with the sources of its names.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Signal {
    pub(super) expression: Expression,
    pub(super) sources: Vec<Source>,
}

impl Source {
    fn value(&self, time: f64, outputs: &[f64]) -> f64 {
        match self {
            Self::Output(index) => outputs.get(*index).copied().unwrap_or(f64::NAN),
            Self::Time => time,
            Self::Column { times, values } => {
                let after = times.partition_point(|t| *t <= time);
                match (after.checked_sub(1), times.get(after)) {
                    (None, _) => values.first().copied().unwrap_or(f64::NAN),
                    (Some(before), None) => values[before],
                    (Some(before), Some(next)) => {
                        let part = (time - times[before]) / (next - times[before]);
                        values[before] + part * (values[after] - values[before])
                    }
                }
            }
        }
    }
}

impl Signal {
    /// Returns the value. `values` and `stack` are work space.
    pub(super) fn value(
        &self,
        time: f64,
        outputs: &[f64],
        values: &mut Vec<f64>,
        stack: &mut Vec<f64>,
    ) -> f64 {
        values.clear();
        values.extend(self.sources.iter().map(|source| source.value(time, outputs)));
        self.expression.value_with(values, stack)
    }
}
