//! Time-varying inputs and tunable parameters from tables and functions. Continuous floating-point inputs are
//! linear between rows. All other inputs are held.

use super::texts::TextInput;
use crate::description::{Causality, ClockKind, Value, Variability, Variable, VariableKind};
use crate::error::{FmiError, Result};
use crate::instance::assignments::convert_one;
use crate::instance::integer_codec;
use crate::simulation::clocks::{ClockInputs, Clocked};
use crate::simulation::input_table::{HeldTable, InputTable};
use crate::simulation::variable_elements::{FloatSlots, Slots, Starts, VariableElement};
use crate::worker::InputFunction;
use ode::InputStop;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

/// Sources that drive the inputs and tunable parameters of a model.
///
/// Continuous inputs of floating-point type are linear between the rows of their table. All other inputs,
/// including strings ([`values`](Self::values)), keep the value of a row until the next row. Outside the
/// table, the first and the last row are held. A time listed twice is a jump: the first of the two rows is
/// the limit from the left. Jumps and changes of held values are events. At a change of slope, a step ends
/// without an event.
///
/// Tunable parameters are held. Their first value applies before and during the initialization. They change
/// at events in model exchange and at communication points in co-simulation.
///
/// ```
/// use fmi::Inputs;
/// let inputs = Inputs::new()
///     .table(vec![0.0, 1.0, 1.0, 5.0], [("u", vec![0.0, 0.0, 1.0, 1.0]), ("mode", vec![1.0, 1.0, 2.0, 2.0])])
///     .function("v", |t| (2.0 * t).sin());
/// ```
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Inputs {
    sources: Vec<Source>,
}

/// Variable with its source.
#[derive(Clone, Serialize, Deserialize)]
struct Source {
    name: String,
    values: SourceValues,
}

#[derive(Clone, Serialize, Deserialize)]
enum SourceValues {
    Numbers(Arc<[f64]>, Arc<[f64]>),
    Function(InputFunction),
    Any(Arc<[f64]>, Arc<[Value]>),
}

impl SourceValues {
    /// True if both sources are equal. Functions are equal only if they are the same object.
    fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Numbers(times, values), Self::Numbers(t, v)) => times == t && values == v,
            (Self::Any(times, values), Self::Any(t, v)) => times == t && values == v,
            (Self::Function(function), Self::Function(f)) => function.is_same(f),
            _ => false,
        }
    }

    /// True if both are rows of numbers that differ only in sign.
    fn is_negative_of(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Numbers(times, values), Self::Numbers(t, v)) => {
                times == t && values.len() == v.len() && values.iter().zip(&**v).all(|(a, b)| *a == -b)
            }
            _ => false,
        }
    }
}

impl fmt::Debug for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.values {
            SourceValues::Numbers(times, _) | SourceValues::Any(times, _) => {
                write!(f, "{}: {} rows", self.name, times.len())
            }
            SourceValues::Function(_) => write!(f, "{}: function", self.name),
        }
    }
}

impl Inputs {
    /// True if an input is driven by a function.
    pub fn has_functions(&self) -> bool {
        self.sources.iter().any(|source| matches!(source.values, SourceValues::Function(_)))
    }

    /// Creates an empty set of inputs.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a table: times in ascending order, and the same number of values for each variable. Integers and
    /// Booleans are passed as numbers. Errors in a table are reported when a simulation is planned.
    #[must_use]
    pub fn table<N, C>(mut self, times: impl Into<Arc<[f64]>>, columns: C) -> Self
    where
        N: Into<String>,
        C: IntoIterator<Item = (N, Vec<f64>)>,
    {
        let times: Arc<[f64]> = times.into();
        for (name, values) in columns {
            self = self.source(name, SourceValues::Numbers(Arc::clone(&times), values.into()));
        }
        self
    }

    fn source(mut self, name: impl Into<String>, values: SourceValues) -> Self {
        self.sources.push(Source { name: name.into(), values });
        self
    }

    /// Adds one variable with separate times.
    #[must_use]
    pub fn series(
        self,
        name: impl Into<String>,
        times: impl Into<Arc<[f64]>>,
        values: impl Into<Arc<[f64]>>,
    ) -> Self {
        self.source(name, SourceValues::Numbers(times.into(), values.into()))
    }

    /// Adds a variable of any type with separate times. Use this for values that a double cannot represent:
    /// strings, bytes, 64-bit integers.
    #[must_use]
    pub fn values(
        self,
        name: impl Into<String>,
        times: impl Into<Arc<[f64]>>,
        values: impl IntoIterator<Item = impl Into<Value>>,
    ) -> Self {
        let values = values.into_iter().map(Into::into).collect();
        self.source(name, SourceValues::Any(times.into(), values))
    }

    /// Adds a continuous real input that is a function of time. The function should be smooth. If it returns
    /// NaN or an infinity, the model counts as undefined at that time. It may be called from any thread.
    #[must_use]
    pub fn function(
        self,
        name: impl Into<String>,
        function: impl Fn(f64) -> f64 + Send + Sync + 'static,
    ) -> Self {
        self.function_of(name, InputFunction::new(function))
    }

    /// Adds an input as [`function`](Self::function) does, with a function that several simulations share.
    #[must_use]
    pub fn function_of(self, name: impl Into<String>, function: InputFunction) -> Self {
        self.source(name, SourceValues::Function(function))
    }

    /// True if the sources are equal.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        self.sources.len() == other.sources.len()
            && self
                .sources
                .iter()
                .zip(&other.sources)
                .all(|(source, other)| source.name == other.name && source.values.is_same(&other.values))
    }

    /// Returns the names in the order in which they were added.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.sources.iter().map(|source| source.name.as_str())
    }
}

/// Column whose values are held until the next row, and the variable that receives them.
#[derive(Debug, Clone)]
pub(super) struct Held {
    pub(super) column: HeldTable,
    pub(super) is_parameter: bool,
    pub(super) target: Target,
}

/// Variables whose values are held between rows.
#[derive(Debug, Clone, Default)]
pub(super) struct HeldSlots {
    pub(super) reals: Slots<f64>,
    pub(super) packed: Vec<(VariableKind, Slots<i64>)>,
    pub(super) texts: Vec<TextInput>,
}

impl HeldSlots {
    /// Returns the target for a numeric variable or an element of one.
    fn place(&mut self, starts: &Starts<'_>, place: VariableElement) -> Result<Target> {
        let variable = &starts.description.variables[place.variable];
        let (kind, reference) = (variable.kind, variable.value_reference);
        if kind == VariableKind::Real {
            return Ok(Target::Real(self.reals.place(reference, place.element, || starts.reals(place))?));
        }
        let group = match self.packed.iter().position(|(packed_kind, _)| *packed_kind == kind) {
            Some(group) => group,
            None => {
                self.packed.push((kind, Slots::default()));
                self.packed.len() - 1
            }
        };
        let slots = &mut self.packed[group].1;
        Ok(Target::Packed(group, slots.place(reference, place.element, || starts.words(place))?))
    }

    /// Returns the variables with their types and references.
    fn references(&self) -> impl Iterator<Item = (VariableKind, u32)> + '_ {
        let of = |kind: VariableKind| move |reference: &u32| (kind, *reference);
        let packed = self.packed.iter().flat_map(move |(kind, slots)| slots.references.iter().map(of(*kind)));
        let reals = self.reals.references.iter().map(of(VariableKind::Real));
        reals.chain(self.texts.iter().map(TextInput::reference)).chain(packed)
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Target {
    Real(usize),
    /// Index of the group and index of the value in it.
    Packed(usize, usize),
    Text(usize),
}

/// Resolved and checked inputs of one simulation.
#[derive(Clone, Default)]
pub(crate) struct InputPlan {
    /// Columns of continuous inputs, with the indices of their values.
    pub(super) linear: Vec<(InputTable, usize)>,
    /// Functions with the sign and the index of their values.
    pub(super) functions: Vec<(InputFunction, f64, usize)>,
    pub(crate) continuous: FloatSlots,
    pub(super) held: Vec<Held>,
    pub(super) held_inputs: HeldSlots,
    /// Tunable parameters.
    pub(super) parameters: HeldSlots,
    /// Times of jumps, ascending.
    pub(super) jumps: Vec<f64>,
    /// Jumps and changes of slope, ascending.
    pub(super) stops: Vec<InputStop>,
    /// Times of rows at which a continuous input differs from the previous row, ascending. Empty unless the
    /// inputs are sampled.
    pub(super) rows: Vec<f64>,
    pub(super) is_sampled: bool,
    /// Difference below which two times count as equal.
    pub(super) time_tolerance: f64,
    /// Variables that the inputs drive.
    pub(crate) driven: Vec<VariableElement>,
    /// Data for clocks and clocked inputs.
    pub(crate) clocks: ClockInputs,
}

impl fmt::Debug for InputPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("InputPlan")
            .field("continuous", &self.continuous)
            .field("held", &self.held.len())
            .field("stops", &self.stops.len())
            .finish_non_exhaustive()
    }
}

impl InputPlan {
    /// Resolves and checks the inputs. Times closer than `time_tolerance` count as equal. `is_sampled` is
    /// true if the model receives input values only at communication points.
    ///
    /// # Errors
    /// Returns an error if a name is unknown, a variable cannot be driven, or the rows of a table are
    /// invalid.
    pub(crate) fn new(
        starts: &Starts<'_>,
        inputs: &Inputs,
        time_tolerance: f64,
        is_sampled: bool,
    ) -> Result<Self> {
        let description = starts.description;
        let mut plan = Self { time_tolerance, is_sampled, ..Self::default() };
        let mut stops = Vec::new();
        // Variables of type Real come first, as `FloatSlots` requires.
        let place_of =
            |source: &Source| VariableElement::of_name(description, starts.structure, &source.name);
        let mut sources: Vec<(VariableElement, &Source)> =
            inputs.sources.iter().map(|source| Ok((place_of(source)?, source))).collect::<Result<_>>()?;
        sources.sort_by_key(|(place, _)| description.variables[place.variable].kind != VariableKind::Real);
        for (k, (place, source)) in sources.iter().enumerate() {
            let (place, Source { name, values: source }) = (*place, source);
            let variable = &description.variables[place.variable];
            if variable.causality != Causality::Input && !variable.is_tunable_parameter() {
                return Err(bad(
                    variable,
                    format!(
                        "it is neither an input nor a tunable parameter; its causality is {} and its \
                         variability is {}",
                        variable.causality, variable.variability
                    ),
                ));
            }
            let earlier = sources[..k].iter().find(|(driven, _)| driven.overlaps(place, description));
            if let Some((driven, first)) = earlier {
                let is_equal = match description.variables[driven.variable].negated == variable.negated {
                    true => first.values.is_same(source),
                    false => is_linear(variable) && first.values.is_negative_of(source),
                };
                // A recording may contain a variable under all its names.
                if is_equal && first.name != *name && driven.element == place.element {
                    continue;
                }
                let problem = match &first.name {
                    first if first == name => "it is specified twice".to_owned(),
                    first => format!(
                        "it is the same variable as {first}, which is also specified, with different values"
                    ),
                };
                return Err(FmiError::BadInput { name: name.clone(), problem });
            }
            plan.driven.push(place);
            if !variable.dimensions.is_empty() && place.element.is_none() {
                let problem = format!("it is an array; drive its elements {name}[...], with indices from 1");
                return Err(bad(variable, problem));
            }
            match source {
                SourceValues::Function(function) if is_linear(variable) => {
                    let sign = if variable.negated { -1.0 } else { 1.0 };
                    let at = plan.continuous.place(starts, place)?;
                    plan.functions.push((function.clone(), sign, at));
                }
                SourceValues::Function(_) => {
                    let problem = "a function can drive only continuous floating-point inputs; use a table, \
                                   whose changes are events";
                    return Err(bad(variable, problem.to_owned()));
                }
                SourceValues::Any(times, values) if !variable.kind.is_number() => {
                    if place.element.is_some() || !variable.clocks.is_empty() {
                        let problem = "strings can drive only scalar variables without a clock";
                        return Err(bad(variable, problem.to_owned()));
                    }
                    let (text, numbers) = TextInput::new(variable, values)?;
                    check_rows(variable, times, &numbers)?;
                    let column = InputTable { times: Arc::clone(times), values: numbers.into() };
                    column.held_stops(&mut stops);
                    let slots = plan.held_slots(variable);
                    slots.texts.push(text);
                    let target = Target::Text(slots.texts.len() - 1);
                    let is_parameter = variable.is_tunable_parameter();
                    plan.held.push(Held { column: column.into(), is_parameter, target });
                }
                SourceValues::Any(times, values) => {
                    let converted: Vec<Value> =
                        values.iter().map(|value| convert_one(variable, value)).collect::<Result<_, _>>()?;
                    if matches!(variable.kind, VariableKind::Int64 | VariableKind::UInt64) {
                        let words: Vec<i64> = converted
                            .iter()
                            .filter_map(|value| integer_codec::word(variable.kind, value))
                            .collect();
                        let column = HeldTable::of_words(times, &words);
                        check_rows(variable, times, &column.column.values)?;
                        plan.add_held(starts, place, column, &mut stops)?;
                    } else {
                        let numbers: Vec<f64> = converted.iter().filter_map(Value::as_number).collect();
                        let column = InputTable { times: Arc::clone(times), values: numbers.into() };
                        plan.add_numbers(starts, place, column, &mut stops)?;
                    }
                }
                SourceValues::Numbers(times, values) => {
                    let column = InputTable { times: Arc::clone(times), values: Arc::clone(values) };
                    plan.add_numbers(starts, place, column, &mut stops)?;
                }
            }
        }
        plan.take_stops(stops);
        Ok(plan)
    }

    /// Adds a column of numbers for a variable or an element.
    fn add_numbers(
        &mut self,
        starts: &Starts<'_>,
        place: VariableElement,
        column: InputTable,
        stops: &mut Vec<InputStop>,
    ) -> Result<()> {
        let variable = &starts.description.variables[place.variable];
        check_rows(variable, &column.times, &column.values)?;
        if is_linear(variable) {
            let column = column.times(if variable.negated { -1.0 } else { 1.0 });
            column.linear_stops(self.time_tolerance, stops);
            if self.is_sampled {
                self.rows.extend(column.changes());
            }
            let at = self.continuous.place(starts, place)?;
            self.linear.push((column, at));
            return Ok(());
        }
        let column = check_held(variable, column)?;
        if variable.kind == VariableKind::Clock && place.element.is_none() {
            return self.clock(variable, place.variable, column, stops);
        }
        self.add_held(starts, place, column.into(), stops)
    }

    /// Adds a held column for a variable that is not a clock, or for an element.
    fn add_held(
        &mut self,
        starts: &Starts<'_>,
        place: VariableElement,
        column: HeldTable,
        stops: &mut Vec<InputStop>,
    ) -> Result<()> {
        let variable = &starts.description.variables[place.variable];
        let is_clocked = !variable.clocks.is_empty();
        if place.element.is_some() && (variable.kind == VariableKind::Clock || is_clocked) {
            let problem = "an array element must not be a clock or depend on a clock";
            return Err(bad(variable, problem.to_owned()));
        }
        if is_clocked {
            self.clocks.clocked.push(Clocked::new(place.variable, variable, column));
            return Ok(());
        }
        column.column.held_stops(stops);
        self.hold(starts, place, column)
    }

    /// Returns the group of held variables to which this variable belongs.
    fn held_slots(&mut self, variable: &Variable) -> &mut HeldSlots {
        if variable.is_tunable_parameter() { &mut self.parameters } else { &mut self.held_inputs }
    }

    fn hold(&mut self, starts: &Starts<'_>, place: VariableElement, column: HeldTable) -> Result<()> {
        let variable = &starts.description.variables[place.variable];
        let target = self.held_slots(variable).place(starts, place)?;
        let column = if variable.negated { column.negated(variable.kind) } else { column };
        self.held.push(Held { column, is_parameter: variable.is_tunable_parameter(), target });
        Ok(())
    }

    /// Adds a clock. A triggered clock ticks at the rows with value 1. A clock that can be deactivated omits
    /// its ticks while its value is 0.
    fn clock(
        &mut self,
        variable: &Variable,
        index: usize,
        column: InputTable,
        stops: &mut Vec<InputStop>,
    ) -> Result<()> {
        match variable.clock.as_deref() {
            Some(timing) if timing.kind != ClockKind::Triggered && timing.can_be_deactivated => {
                self.clocks.enabled.push((index, column));
                Ok(())
            }
            Some(timing) if timing.kind != ClockKind::Triggered => Err(bad(
                variable,
                format!(
                    "it is a clock with {} intervals; the model determines its ticks, so it cannot be \
                     deactivated",
                    timing.kind.name()
                ),
            )),
            _ => {
                let rows = column.times.iter().zip(&*column.values);
                let ticks: Arc<[f64]> = rows.filter(|(_, on)| **on != 0.0).map(|(time, _)| *time).collect();
                stops.extend(ticks.iter().map(|time| InputStop { time: *time, jump: true }));
                self.clocks.ticks.push((index, ticks));
                Ok(())
            }
        }
    }

    /// Merges stops of all columns that are within the time tolerance, and moves the corresponding rows to
    /// the merged time.
    pub(super) fn take_stops(&mut self, mut stops: Vec<InputStop>) {
        self.rows.sort_by(f64::total_cmp);
        self.rows.dedup();
        stops.sort_by(|a, b| a.time.total_cmp(&b.time));
        let mut first = f64::NEG_INFINITY;
        for stop in stops {
            match self.stops.last_mut() {
                Some(last) if stop.time - first <= self.time_tolerance => {
                    last.time = stop.time;
                    last.jump |= stop.jump;
                }
                _ => {
                    first = stop.time;
                    self.stops.push(stop);
                }
            }
        }
        self.jumps = self.stops.iter().filter(|stop| stop.jump).map(|stop| stop.time).collect();
        let linear = self.linear.iter_mut().map(|(column, _)| column);
        for column in linear.chain(self.held.iter_mut().map(|held| &mut held.column.column)) {
            column.snap(&self.jumps, self.time_tolerance);
        }
    }

    /// Returns the driven variables with their types and references.
    pub(crate) fn references(&self) -> impl Iterator<Item = (VariableKind, u32)> + '_ {
        let held = self.held_inputs.references().chain(self.parameters.references());
        self.continuous.references().chain(held)
    }

    /// Returns the driven variables that are also set before the initialization.
    pub(crate) fn early_references(&self) -> impl Iterator<Item = (VariableKind, u32)> + '_ {
        self.parameters.references()
    }

    /// Returns the number of times between `start` and `end` at which the inputs jump or change their slope.
    /// If `are_held` is true, changes of value at rows count as well.
    pub(crate) fn n_points_within(&self, start: f64, end: f64, are_held: bool) -> usize {
        let is_within = |time: f64| time > start + self.time_tolerance && time <= end - self.time_tolerance;
        let stops = self.stops.iter().filter(|stop| is_within(stop.time)).count();
        let rows = self.rows.iter().filter(|row| is_within(**row)).count();
        if are_held { stops.max(rows) } else { stops }
    }

    /// Returns the first stop after `t`.
    pub(crate) fn next_stop(&self, t: f64) -> Option<InputStop> {
        let next = self.stops.partition_point(|stop| stop.time <= t + self.time_tolerance);
        self.stops.get(next).copied()
    }

    /// Returns the first row after `t` at which a continuous input changes its value.
    pub(crate) fn next_row(&self, t: f64) -> Option<f64> {
        let next = self.rows.partition_point(|row| *row <= t + self.time_tolerance);
        self.rows.get(next).copied()
    }
}

impl Starts<'_> {
    /// Returns all start values of a variable of type Real. The value of a scalar is 0, because it is written
    /// before it is set.
    pub(crate) fn reals(&self, place: VariableElement) -> Result<Vec<f64>> {
        if place.element.is_none() {
            return Ok(vec![0.0]);
        }
        let values = self.elements(place.variable)?;
        Ok(values.into_iter().map(|value| if let Value::Real(x) = value { x } else { 0.0 }).collect())
    }

    /// Returns the start values of a variable of any other numeric type, as words. The value of a scalar is
    /// 0.
    fn words(&self, place: VariableElement) -> Result<Vec<i64>> {
        if place.element.is_none() {
            return Ok(vec![0]);
        }
        let kind = self.description.variables[place.variable].kind;
        let values = self.elements(place.variable)?;
        Ok(values.iter().map(|value| integer_codec::word(kind, value).unwrap_or_default()).collect())
    }
}

/// True if an input is interpolated linearly between rows.
fn is_linear(variable: &Variable) -> bool {
    variable.kind.is_float() && variable.variability == Variability::Continuous
}

fn bad(variable: &Variable, problem: String) -> FmiError {
    FmiError::BadInput { name: variable.name.clone(), problem }
}

/// Returns an error for a variable that cannot be held, or for values outside its type.
fn check_held(variable: &Variable, column: InputTable) -> Result<InputTable> {
    let kind = variable.kind;
    if !kind.is_number() {
        return Err(bad(variable, "text and binary inputs cannot vary with time".to_owned()));
    }
    let misfit =
        column.values.iter().position(|v| kind != VariableKind::Real && !integer_codec::is_of(variable, *v));
    let Some(row) = misfit else { return Ok(column) };
    let what = match kind {
        VariableKind::Boolean | VariableKind::Clock => "0 or 1".to_owned(),
        VariableKind::Integer | VariableKind::Enumeration => "an integer".to_owned(),
        kind => format!("of type {kind}"),
    };
    Err(bad(variable, format!("{} in row {} is not {what}", column.values[row], row)))
}

fn check_rows(variable: &Variable, times: &[f64], values: &[f64]) -> Result<()> {
    if times.len() != values.len() {
        return Err(bad(variable, format!("{} values for {} times", values.len(), times.len())));
    }
    if times.is_empty() {
        return Err(bad(variable, "the table has no rows".to_owned()));
    }
    for (row, (time, value)) in times.iter().zip(values).enumerate() {
        if !time.is_finite() || !value.is_finite() {
            return Err(bad(variable, format!("row {} (time {time}, value {value}) is not finite", row)));
        }
        if row > 0 && *time < times[row - 1] {
            let before = times[row - 1];
            return Err(bad(
                variable,
                format!("times must not decrease: row {} has {time} after {before}", row),
            ));
        }
    }
    Ok(())
}
