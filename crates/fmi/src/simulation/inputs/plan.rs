//! Time-varying inputs and tunable parameters: tables and functions; linear between rows for continuous
//! floating-point inputs, held for everything else.

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

/// Sources that drive the inputs of a model, and its tunable parameters.
///
/// Continuous inputs of floating-point type are linear between the rows of their table, all other inputs
/// (texts, too: [`values`](Self::values)) keep the value of a row until the next; outside of the table the
/// first and the last row hold. A time listed twice is a jump: the first of the two rows is the limit from
/// the left. Jumps and changes of held values are events; changes of slope are hit by steps.
///
/// Tunable parameters are held. They have their first value from before the initialization on, and change at
/// events in model exchange and at communication points in co-simulation.
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

/// A variable, and what drives it.
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
    /// Functions are the same only if they are one.
    fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Numbers(times, values), Self::Numbers(t, v)) => times == t && values == v,
            (Self::Any(times, values), Self::Any(t, v)) => times == t && values == v,
            (Self::Function(function), Self::Function(f)) => function.is_same(f),
            _ => false,
        }
    }

    /// True if they are rows of numbers that are the same but for their sign.
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
    /// True if a function drives an input.
    pub fn has_functions(&self) -> bool {
        self.sources.iter().any(|source| matches!(source.values, SourceValues::Function(_)))
    }

    /// No inputs.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a table: times in ascending order and, for each variable, as many values. Integers and Booleans
    /// are given as numbers. What is wrong with a table is said when a simulation is planned.
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

    /// Adds one variable with times of its own.
    #[must_use]
    pub fn series(
        self,
        name: impl Into<String>,
        times: impl Into<Arc<[f64]>>,
        values: impl Into<Arc<[f64]>>,
    ) -> Self {
        self.source(name, SourceValues::Numbers(times.into(), values.into()))
    }

    /// Adds a variable of any type with times of its own, for what a double cannot hold: texts, bytes,
    /// integers of 64 bits.
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

    /// Adds a continuous real input that is a function of time. It should be smooth; where it returns NaN or
    /// an infinity, the model counts as not defined. It may be called from any thread.
    #[must_use]
    pub fn function(
        self,
        name: impl Into<String>,
        function: impl Fn(f64) -> f64 + Send + Sync + 'static,
    ) -> Self {
        self.function_of(name, InputFunction::new(function))
    }

    /// The same with a function that several simulations share.
    #[must_use]
    pub fn function_of(self, name: impl Into<String>, function: InputFunction) -> Self {
        self.source(name, SourceValues::Function(function))
    }

    /// True if the sources are the same.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        self.sources.len() == other.sources.len()
            && self
                .sources
                .iter()
                .zip(&other.sources)
                .all(|(source, other)| source.name == other.name && source.values.is_same(&other.values))
    }

    /// The names, in the order given.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.sources.iter().map(|source| source.name.as_str())
    }
}

/// A held column and where its value goes.
#[derive(Debug, Clone)]
pub(super) struct Held {
    pub(super) column: HeldTable,
    pub(super) is_parameter: bool,
    pub(super) target: Target,
}

/// Variables that are held from row to row.
#[derive(Debug, Clone, Default)]
pub(super) struct HeldSlots {
    pub(super) reals: Slots<f64>,
    pub(super) packed: Vec<(VariableKind, Slots<i64>)>,
    pub(super) texts: Vec<TextInput>,
}

impl HeldSlots {
    /// The place of a variable of numbers, or of an element of one.
    fn place(&mut self, starts: &Starts<'_>, place: VariableElement) -> Result<Target> {
        let variable = &starts.description.variables[place.variable];
        let (kind, reference) = (variable.kind, variable.value_reference);
        if kind == VariableKind::Real {
            return Ok(Target::Real(self.reals.place(reference, place.element, || starts.reals(place))?));
        }
        let group = match self.packed.iter().position(|(known, _)| *known == kind) {
            Some(group) => group,
            None => {
                self.packed.push((kind, Slots::default()));
                self.packed.len() - 1
            }
        };
        let slots = &mut self.packed[group].1;
        Ok(Target::Packed(group, slots.place(reference, place.element, || starts.words(place))?))
    }

    /// The variables, each by its type and reference.
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
    /// Group and place in it.
    Packed(usize, usize),
    Text(usize),
}

/// The inputs of one simulation, resolved and checked.
#[derive(Clone, Default)]
pub(crate) struct InputPlan {
    /// Columns of continuous inputs, and where their values go.
    pub(super) linear: Vec<(InputTable, usize)>,
    /// Functions with the sign of their values, and where these go.
    pub(super) functions: Vec<(InputFunction, f64, usize)>,
    pub(crate) continuous: FloatSlots,
    pub(super) held: Vec<Held>,
    pub(super) held_inputs: HeldSlots,
    /// Tunable parameters.
    pub(super) parameters: HeldSlots,
    /// Instants of jumps, ascending.
    pub(super) jumps: Vec<f64>,
    /// Jumps and kinks, ascending.
    pub(super) stops: Vec<InputStop>,
    /// Times of rows at which a continuous input has another value than in the row before, ascending; in
    /// co-simulation.
    pub(super) rows: Vec<f64>,
    pub(super) is_sampled: bool,
    /// Times closer than this are one.
    pub(super) time_tolerance: f64,
    /// Variables that are driven.
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
    /// Resolves and checks the inputs; `time_tolerance` is the distance within which times are equal.
    /// `is_sampled`: the model sees values of inputs at communication points only.
    ///
    /// # Errors
    /// Unknown names, variables that cannot be driven, tables whose rows cannot be used.
    pub(crate) fn new(
        starts: &Starts<'_>,
        inputs: &Inputs,
        time_tolerance: f64,
        is_sampled: bool,
    ) -> Result<Self> {
        let description = starts.description;
        let mut plan = Self { time_tolerance, is_sampled, ..Self::default() };
        let mut stops = Vec::new();
        // Those of type Real come first, as `FloatSlots` wants it.
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
                        "it is neither an input nor a tunable parameter, but a variable of causality {} and variability {}",
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
                // A recording may hold a variable under all its names.
                if is_equal && first.name != *name && driven.element == place.element {
                    continue;
                }
                let problem = match &first.name {
                    first if first == name => "it is given twice".to_owned(),
                    first => format!(
                        "it is the same variable as {first}, which is given too, with different values"
                    ),
                };
                return Err(FmiError::BadInput { name: name.clone(), problem });
            }
            plan.driven.push(place);
            if !variable.dimensions.is_empty() && place.element.is_none() {
                let problem = format!("it is an array; drive its elements, {name}[...], counted from 1");
                return Err(bad(variable, problem));
            }
            match source {
                SourceValues::Function(function) if is_linear(variable) => {
                    let sign = if variable.negated { -1.0 } else { 1.0 };
                    let at = plan.continuous.place(starts, place)?;
                    plan.functions.push((function.clone(), sign, at));
                }
                SourceValues::Function(_) => {
                    let problem = "a function can drive continuous inputs of floating-point type only; use a table, whose changes are \
                         events";
                    return Err(bad(variable, problem.to_owned()));
                }
                SourceValues::Any(times, values) if !variable.kind.is_number() => {
                    if place.element.is_some() || !variable.clocks.is_empty() {
                        let problem = "texts drive single variables that belong to no clock";
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

    /// A column of numbers for a variable or an element of one.
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

    /// A held column for a variable that is no clock, or an element of one.
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
            let problem = "elements of arrays cannot be clocks, nor be driven by clocks";
            return Err(bad(variable, problem.to_owned()));
        }
        if is_clocked {
            self.clocks.clocked.push(Clocked::new(place.variable, variable, column));
            return Ok(());
        }
        column.column.held_stops(stops);
        self.hold(starts, place, column)
    }

    /// The held variables that this one belongs to.
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

    /// A clock: the rows of a triggered one that hold 1 are its ticks; one that can be deactivated leaves its
    /// ticks out where it holds 0.
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
                    "it is a clock with {} intervals, which the model determines, and cannot be deactivated",
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

    /// Merges stops of all columns that are one instant, and moves the rows there onto it.
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

    /// The variables that are driven, each by its type and reference.
    pub(crate) fn references(&self) -> impl Iterator<Item = (VariableKind, u32)> + '_ {
        let held = self.held_inputs.references().chain(self.parameters.references());
        self.continuous.references().chain(held)
    }

    /// Those that are set before the initialization, too.
    pub(crate) fn early_references(&self) -> impl Iterator<Item = (VariableKind, u32)> + '_ {
        self.parameters.references()
    }

    /// Number of the times between these at which the inputs jump or change their slope, or if they are held
    /// between communication points, have another value.
    pub(crate) fn n_points_within(&self, start: f64, end: f64, are_held: bool) -> usize {
        let is_within = |time: f64| time > start + self.time_tolerance && time <= end - self.time_tolerance;
        let stops = self.stops.iter().filter(|stop| is_within(stop.time)).count();
        let rows = self.rows.iter().filter(|row| is_within(**row)).count();
        if are_held { stops.max(rows) } else { stops }
    }

    /// The first stop after `t`.
    pub(crate) fn next_stop(&self, t: f64) -> Option<InputStop> {
        let next = self.stops.partition_point(|stop| stop.time <= t + self.time_tolerance);
        self.stops.get(next).copied()
    }

    /// The first row after `t` with another value of a continuous input.
    pub(crate) fn next_row(&self, t: f64) -> Option<f64> {
        let next = self.rows.partition_point(|row| *row <= t + self.time_tolerance);
        self.rows.get(next).copied()
    }
}

impl Starts<'_> {
    /// All start values of a variable of type Real; 0 for a single value, which is written before it is set.
    pub(crate) fn reals(&self, place: VariableElement) -> Result<Vec<f64>> {
        if place.element.is_none() {
            return Ok(vec![0.0]);
        }
        let values = self.elements(place.variable)?;
        Ok(values.into_iter().map(|value| if let Value::Real(x) = value { x } else { 0.0 }).collect())
    }

    /// The same of a variable of any other type of numbers.
    fn words(&self, place: VariableElement) -> Result<Vec<i64>> {
        if place.element.is_none() {
            return Ok(vec![0]);
        }
        let kind = self.description.variables[place.variable].kind;
        let values = self.elements(place.variable)?;
        Ok(values.iter().map(|value| integer_codec::word(kind, value).unwrap_or_default()).collect())
    }
}

/// True if an input is interpolated linearly from row to row.
fn is_linear(variable: &Variable) -> bool {
    variable.kind.is_float() && variable.variability == Variability::Continuous
}

fn bad(variable: &Variable, problem: String) -> FmiError {
    FmiError::BadInput { name: variable.name.clone(), problem }
}

/// Refuses what cannot be held, and values that are none of the type.
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
            return Err(bad(variable, format!("times must ascend: row {} has {time} after {before}", row)));
        }
    }
    Ok(())
}
