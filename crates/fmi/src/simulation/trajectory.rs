//! Recorded simulation: columns of numbers and of other values, events and statistics.

use crate::description::{Value, VariableKind};
use crate::error::{FmiError, Result};
use crate::macros::getters;
use crate::platform::memory;
use crate::simulation::clocks::Tick;
use crate::simulation::outputs::{Recorded, ValueTable, integers, places, width};
use crate::simulation::plan::SimulationPlan;
use base::Number;
use ode::{EventRecord, Observer, Report, Sample, Side, Stats, Termination};
use serde::{Deserialize, Serialize};
use std::ops::{ControlFlow, Index, Range};
use std::sync::Arc;

/// Maximum number of columns listed in a message.
const MOST_NAMED: usize = 6;

/// Recorded simulation. All columns have the same number of rows as `time`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Trajectory {
    /// Times of the rows.
    pub time: Vec<f64>,
    /// Names of the columns.
    pub names: Vec<String>,
    /// Numeric columns. Integers and Booleans are converted to numbers. A 64-bit integer becomes the nearest
    /// representable number; see [`values`](Self::values) for the exact value.
    pub columns: Vec<Vec<f64>>,
    /// Columns of values that a 64-bit float cannot represent: strings, binary variables, and the exact
    /// values of 64-bit integers.
    pub values: Vec<ValueColumn>,
    /// Variables in the requested order, with the ranges of their columns.
    pub recorded: Vec<Recorded>,
    /// Side of each row: value before or after the events at its time.
    #[serde(with = "sides")]
    pub sides: Vec<Side>,
    /// Events.
    pub events: Vec<EventRecord>,
    /// Ticks of clocks, ordered by time.
    pub ticks: Vec<Tick>,
    /// Run statistics. For the meaning of the seconds, see [`Simulator::run`](crate::Simulator::run).
    pub stats: Stats,
    /// Reason for the end of the simulation.
    pub termination: Termination,
    /// Time at which the simulation ended.
    pub end_time: f64,
}

/// Serializes sides as one byte per row.
mod sides {
    use ode::Side;
    use serde::de::{Error, Visitor};
    use serde::{Deserializer, Serializer};
    use std::fmt;

    pub(super) fn serialize<S: Serializer>(sides: &[Side], to: S) -> Result<S::Ok, S::Error> {
        let bytes: Vec<u8> = sides.iter().map(|side| u8::from(*side == Side::Right)).collect();
        to.serialize_bytes(&bytes)
    }

    struct Bytes;

    impl Visitor<'_> for Bytes {
        type Value = Vec<Side>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("one byte per row")
        }

        fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Vec<Side>, E> {
            Ok(bytes.iter().map(|byte| if *byte == 0 { Side::Left } else { Side::Right }).collect())
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Side>, D::Error> {
        from.deserialize_byte_buf(Bytes)
    }
}

/// Column of values of one type that are not all numbers, one value per row. A string or binary value is
/// stored once, even if it occurs in many rows.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ValueColumn {
    /// Name of the variable or array element.
    pub name: String,
    values: Arc<[Value]>,
    places: Vec<usize>,
}

impl ValueColumn {
    getters! {
        /// Index into [`distinct`](Self::distinct) for each row.
        pub places(self) -> &[usize] = &self.places;
        /// Values to which the [`places`](Self::places) refer. For strings and binary values, they include
        /// the values of all columns of the simulation, each once.
        pub distinct(self) -> &[Value] = &self.values;
        /// Number of rows.
        pub len(self) -> usize = self.places.len();
        /// True if there are no rows.
        pub is_empty(self) -> bool = self.places.is_empty();
    }

    /// Creates a column from numbers that are indices into a table of values, or from the halves of integers.
    fn new(name: &str, kind: VariableKind, columns: &[Vec<f64>], table: &Arc<[Value]>) -> Self {
        let (values, places) = match columns {
            [high, low] => (integers(kind, high, low), (0..high.len()).collect()),
            numbers => {
                (Arc::clone(table), numbers.first().map(|numbers| places(numbers)).unwrap_or_default())
            }
        };
        Self { name: name.to_owned(), values, places }
    }

    /// Returns the values in row order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &Value> {
        self.places.iter().map(|place| &self.values[*place])
    }
}

impl Index<usize> for ValueColumn {
    type Output = Value;

    fn index(&self, row: usize) -> &Value {
        &self.values[self.places[row]]
    }
}

impl PartialEq<[Value]> for ValueColumn {
    fn eq(&self, values: &[Value]) -> bool {
        self.iter().eq(values)
    }
}

impl PartialEq for ValueColumn {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name && self.iter().eq(other.iter())
    }
}

impl Trajectory {
    getters! {
        /// Number of rows.
        pub len(self) -> usize = self.time.len();
        /// True if there are no rows.
        pub is_empty(self) -> bool = self.time.is_empty();
        /// Times of the rows, in row order.
        pub times(self) -> &[f64] = &self.time;
    }

    /// True if all columns have the right number of rows and all variables have their columns. A trajectory
    /// received from another process may be inconsistent.
    pub fn is_consistent(&self) -> bool {
        let rows = self.time.len();
        let has = |range: &Range<usize>, n: usize| range.start <= range.end && range.end <= n;
        let is_filled = |column: &ValueColumn| {
            column.places.len() == self.sides.len()
                && column.places.iter().all(|place| *place < column.values.len())
        };
        (self.values.is_empty() || self.sides.len() == rows)
            && self.names.len() == self.columns.len()
            && self.columns.iter().all(|column| column.len() == rows)
            && self.values.iter().all(is_filled)
            && (self.recorded.iter()).all(|variable| {
                has(&variable.columns, self.columns.len()) && has(&variable.values, self.values.len())
            })
    }

    /// Returns the column with this name. `time` is also a name.
    ///
    /// # Errors
    /// Returns [`FmiError::NotInResult`], which lists the available names.
    pub fn get(&self, name: &str) -> Result<&[f64]> {
        if let Some(i) = self.names.iter().position(|n| n == name) {
            return Ok(&self.columns[i]);
        }
        if name == "time" {
            return Ok(&self.time);
        }
        Err(not_in_result(name, std::iter::once("time").chain(self.names.iter().map(String::as_str))))
    }

    /// Returns the values of a string, a binary variable or a 64-bit integer, one per row.
    ///
    /// # Errors
    /// Returns [`FmiError::NotInResult`], which lists the available names.
    pub fn values_of(&self, name: &str) -> Result<&ValueColumn> {
        match self.values.iter().find(|column| column.name == name) {
            Some(column) => Ok(column),
            None => Err(not_in_result(name, self.values.iter().map(|column| column.name.as_str()))),
        }
    }

    /// Returns a sentence that lists the columns with non-finite values and the time of the first such value.
    /// Returns `None` if all values are finite.
    pub fn not_finite(&self) -> Option<String> {
        let first = |(name, column): (&String, &Vec<f64>)| {
            let row = column.iter().position(|value| !value.is_finite())?;
            let what = if column[row].is_nan() { "NaN" } else { "infinite" };
            let later = match column[row..].iter().any(|value| value.is_finite()) {
                true => "first",
                false => "and in all later rows",
            };
            Some(format!("'{name}' ({what} at {} s, {later})", Number(self.time[row])))
        };
        let mut found: Vec<String> = self.names.iter().zip(&self.columns).filter_map(first).collect();
        let (n, n_columns) = (found.len(), self.columns.len());
        if n > MOST_NAMED {
            found.truncate(MOST_NAMED);
            found.push("...".to_owned());
        }
        let are = if n == 1 { "is" } else { "are" };
        (n > 0).then(|| format!("{n} of {n_columns} results {are} not finite: {}", found.join(", ")))
    }

    /// Returns the last value of the column with this name, or `None` if there are no rows.
    ///
    /// # Errors
    /// Returns [`FmiError::NotInResult`], which lists the available names.
    pub fn final_value(&self, name: &str) -> Result<Option<f64>> {
        Ok(self.get(name)?.last().copied())
    }
}

fn not_in_result<'a>(name: &str, present: impl Iterator<Item = &'a str>) -> FmiError {
    let mut present: Vec<&str> = present.take(22).collect();
    if present.len() > 21 {
        present[21] = "...";
    }
    FmiError::NotInResult { name: name.to_owned(), present: present.join(", ") }
}

/// Writes samples into columns.
pub(crate) struct Recorder<'a> {
    time: Vec<f64>,
    columns: Vec<Vec<f64>>,
    sides: Vec<Side>,
    events: Vec<EventRecord>,
    /// Called before every step, every round of an event iteration and every row inside a step.
    poll: &'a mut dyn FnMut() -> ControlFlow<()>,
}

impl<'a> Recorder<'a> {
    /// Creates a recorder for the plan's rows.
    ///
    /// # Errors
    /// Returns [`FmiError::Memory`] if the rows and columns need too much memory.
    pub(crate) fn new(plan: &SimulationPlan, poll: &'a mut dyn FnMut() -> ControlFlow<()>) -> Result<Self> {
        let (rows, columns) = (plan.times().len(), plan.outputs().len() + 1);
        let cells = (rows as u64).saturating_mul(columns as u64);
        memory::check(|| format!("a result of {rows} rows and {columns} columns"), cells.saturating_mul(8))?;
        Ok(Self {
            time: Vec::with_capacity(rows),
            columns: (0..plan.outputs().len()).map(|_| Vec::with_capacity(rows)).collect(),
            sides: Vec::with_capacity(rows),
            events: Vec::new(),
            poll,
        })
    }

    /// Assembles the trajectory. `table` contains the values to which the numbers in unnamed columns refer.
    pub(crate) fn finish(
        mut self,
        plan: &SimulationPlan,
        table: ValueTable,
        ticks: Vec<Tick>,
        report: Report,
    ) -> Trajectory {
        let unnamed = self.columns.split_off(plan.output_names().len());
        let mut rest = &unnamed[..];
        let table = table.into_values();
        let mut values = Vec::with_capacity(plan.outputs().values.len());
        for (name, kind) in &plan.outputs().values {
            let (columns, others) = rest.split_at(width(*kind));
            values.push(ValueColumn::new(name, *kind, columns, &table));
            rest = others;
        }
        Trajectory {
            time: self.time,
            names: plan.output_names().to_vec(),
            columns: self.columns,
            values,
            recorded: plan.recorded().to_vec(),
            sides: self.sides,
            events: self.events,
            ticks,
            stats: report.stats,
            termination: report.termination,
            end_time: report.time,
        }
    }
}

impl Observer for Recorder<'_> {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        self.time.push(sample.time);
        self.sides.push(sample.side);
        for (column, value) in self.columns.iter_mut().zip(sample.outputs) {
            column.push(*value);
        }
        ControlFlow::Continue(())
    }

    fn event(&mut self, event: &EventRecord) {
        self.events.push(*event);
    }

    fn poll(&mut self) -> ControlFlow<()> {
        (self.poll)()
    }
}
