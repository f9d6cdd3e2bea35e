//! A recorded simulation: columns of numbers, events, what it cost.

use crate::error::FmiError;
use crate::plan::SimulationPlan;
use crate::selection::ArrayColumns;
use ode::{EventRecord, Observer, Report, Sample, Side, Stats, Termination};
use std::ops::ControlFlow;

/// A recorded simulation. All columns have as many rows as `time`.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Trajectory {
    /// Times of the rows.
    pub time: Vec<f64>,
    /// Names of the columns.
    pub names: Vec<String>,
    /// Position in the description of the variable of each column; all elements of an array have the same.
    pub variables: Vec<usize>,
    /// The arrays among the columns.
    pub arrays: Vec<ArrayColumns>,
    /// The columns. Integers and Booleans are numbers here.
    pub columns: Vec<Vec<f64>>,
    /// Of each row: value before or after the events at its time.
    pub sides: Vec<Side>,
    /// The events.
    pub events: Vec<EventRecord>,
    /// What it cost.
    pub stats: Stats,
    /// How it ended.
    pub termination: Termination,
    /// Time at which it ended.
    pub end_time: f64,
}

impl Trajectory {
    /// The column of this name; `time` is one.
    ///
    /// # Errors
    /// [`FmiError::NotInResult`] lists the names there are.
    pub fn get(&self, name: &str) -> Result<&[f64], FmiError> {
        if let Some(i) = self.names.iter().position(|n| n == name) {
            return Ok(&self.columns[i]);
        }
        if name == "time" {
            return Ok(&self.time);
        }
        let mut present = vec!["time"];
        present.extend(self.names.iter().map(String::as_str).take(20));
        if self.names.len() > 20 {
            present.push("...");
        }
        Err(FmiError::NotInResult { name: name.to_owned(), present: present.join(", ") })
    }

    /// The last value of the column of this name; `None` if there are no rows.
    ///
    /// # Errors
    /// [`FmiError::NotInResult`] lists the names there are.
    pub fn final_value(&self, name: &str) -> Result<Option<f64>, FmiError> {
        Ok(self.get(name)?.last().copied())
    }
}

/// Writes samples into columns.
#[derive(Debug)]
pub(crate) struct Recorder {
    time: Vec<f64>,
    columns: Vec<Vec<f64>>,
    sides: Vec<Side>,
    events: Vec<EventRecord>,
}

impl Recorder {
    pub(crate) fn new(plan: &SimulationPlan) -> Self {
        let rows = plan.times().len();
        Self {
            time: Vec::with_capacity(rows),
            columns: plan.output_names().iter().map(|_| Vec::with_capacity(rows)).collect(),
            sides: Vec::with_capacity(rows),
            events: Vec::new(),
        }
    }

    pub(crate) fn finish(self, plan: &SimulationPlan, report: Report) -> Trajectory {
        Trajectory {
            time: self.time,
            names: plan.output_names().to_vec(),
            variables: plan.output_variables().to_vec(),
            arrays: plan.output_arrays().to_vec(),
            columns: self.columns,
            sides: self.sides,
            events: self.events,
            stats: report.stats,
            termination: report.termination,
            end_time: report.time,
        }
    }
}

impl Observer for Recorder {
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
}
