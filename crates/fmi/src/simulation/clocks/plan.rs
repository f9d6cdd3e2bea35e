//! Resolved and checked clocks of a simulation: the source of their ticks, and the variables that are set at
//! a tick.

use crate::description::{Causality, ClockKind, Interval, ModelDescription, Variable, VariableKind};
use crate::error::{FmiError, Result};
use crate::instance::assignments::resolve;
use crate::instance::{Core, TimedClock, check_interval};
use crate::simulation::input_table::{HeldTable, InputTable};
use std::collections::HashMap;
use std::sync::Arc;

/// Clock whose ticks the importer schedules.
#[derive(Debug)]
pub(super) struct Timed {
    pub(super) clock: TimedClock,
    /// Table whose value is 0 while ticks are omitted.
    pub(super) enabled: Option<InputTable>,
}

/// Clock that the inputs trigger.
#[derive(Debug)]
pub(super) struct Triggered {
    pub(super) reference: u32,
    pub(super) name: Arc<str>,
    pub(super) times: Arc<[f64]>,
}

/// Input that may be set only when one of its clocks ticks.
#[derive(Debug, Clone)]
pub(crate) struct Clocked {
    variable: usize,
    kind: VariableKind,
    pub(super) reference: u32,
    column: HeldTable,
}

impl Clocked {
    pub(crate) fn new(position: usize, variable: &Variable, column: HeldTable) -> Self {
        let (kind, reference) = (variable.kind, variable.value_reference);
        let column = if variable.negated { column.negated(kind) } else { column };
        Self { variable: position, kind, reference, column }
    }

    /// Sets the value that is held from `t` onward.
    pub(super) fn set(&self, core: &mut Core, t: f64) -> Result<()> {
        let references = [self.reference];
        match self.kind {
            VariableKind::Real => core.set_reals(&references, &[self.column.column.held(t)]),
            kind => core.call(|raw| raw.set_packed(kind, &references, &[self.column.word(kind, t)])),
        }
    }
}

/// Ticks and values of clocks and clocked variables, from the inputs.
#[derive(Debug, Clone, Default)]
pub(crate) struct ClockInputs {
    /// Index of the clock and its ticks.
    pub(crate) ticks: Vec<(usize, Arc<[f64]>)>,
    /// Index of the clock and the table that enables it.
    pub(crate) enabled: Vec<(usize, InputTable)>,
    pub(crate) clocked: Vec<Clocked>,
}

/// Clocks of a simulation.
#[derive(Debug, Default)]
pub(crate) struct ClockPlan {
    pub(super) timed: Vec<Timed>,
    pub(super) triggered: Vec<Triggered>,
    /// Clocks that the model triggers.
    pub(super) watched: Vec<(u32, Arc<str>)>,
    pub(super) watched_references: Vec<u32>,
    /// Clocked inputs with the value references of their clocks.
    pub(super) clocked: Vec<(Clocked, Vec<u32>)>,
    /// Difference below which two times count as equal.
    pub(super) time_tolerance: f64,
}

impl ClockPlan {
    /// Resolves the clocks of a model with these inputs and clock intervals.
    ///
    /// # Errors
    /// Returns an error if an interval cannot be set for its clock.
    pub(crate) fn new(
        description: &ModelDescription,
        inputs: &ClockInputs,
        intervals: &[(String, Interval)],
        time_tolerance: f64,
    ) -> Result<Self> {
        let mut given = HashMap::new();
        for (name, interval) in intervals {
            let index = resolve(description, name)?;
            check_interval(&description.variables[index], *interval)?;
            given.insert(index, *interval);
        }
        let mut plan = Self { time_tolerance, ..Self::default() };
        let name = |variable: &Variable| Arc::from(variable.name.as_str());
        for (index, variable) in description.variables.iter().enumerate() {
            let Some(timing) = variable.clock.as_deref().filter(|_| variable.kind == VariableKind::Clock)
            else {
                continue;
            };
            let reference = variable.value_reference;
            if variable.causality != Causality::Input {
                plan.watched.push((reference, name(variable)));
                plan.watched_references.push(reference);
            } else if timing.kind == ClockKind::Triggered {
                if let Some((_, times)) = inputs.ticks.iter().find(|(clock, _)| *clock == index) {
                    plan.triggered.push(Triggered {
                        reference,
                        name: name(variable),
                        times: Arc::clone(times),
                    });
                }
            } else {
                let enabled = inputs.enabled.iter().find(|(clock, _)| *clock == index);
                let enabled = enabled.map(|(_, column)| column.clone());
                let clock = TimedClock::new(variable, *timing, given.get(&index).copied());
                plan.timed.push(Timed { clock, enabled });
            }
        }
        for clocked in &inputs.clocked {
            let clocks = &description.variables[clocked.variable].clocks;
            let clocks = clocks.iter().map(|clock| description.variables[*clock].value_reference);
            plan.clocked.push((clocked.clone(), clocks.collect()));
        }
        Ok(plan)
    }

    /// Returns an empty plan for a co-simulation without event mode.
    ///
    /// # Errors
    /// Returns an error if the model has clocks that tick without being triggered, or the options or inputs
    /// refer to its clocks.
    pub(crate) fn without_event_mode(
        description: &ModelDescription,
        inputs: &ClockInputs,
        intervals: &[(String, Interval)],
    ) -> Result<Self> {
        let ticks = |v: &&Variable| {
            v.causality == Causality::Input
                && v.clock.as_ref().is_some_and(|clock| clock.kind != ClockKind::Triggered)
        };
        let problem = if let Some(clock) = description.variables.iter().find(ticks) {
            format!("the clock {} ticks in event mode, which this co-simulation does not support", clock.name)
        } else if let Some((name, _)) = intervals.first() {
            format!(
                "an interval of the clock {name} is specified, but this co-simulation does not support \
                     event mode"
            )
        } else if !inputs.ticks.is_empty() {
            "the inputs trigger clocks in event mode, which this co-simulation does not support".to_owned()
        } else {
            return Ok(Self::default());
        };
        Err(FmiError::BadSetting(problem))
    }

    /// True if there are no clocks to handle.
    pub(crate) fn is_empty(&self) -> bool {
        self.timed.is_empty() && self.triggered.is_empty() && self.watched.is_empty()
    }
}

impl ClockPlan {
    pub(super) fn name_of(&self, reference: u32) -> Option<&Arc<str>> {
        let timed = self.timed.iter().map(|timed| (timed.clock.reference, &timed.clock.name));
        let triggered = self.triggered.iter().map(|clock| (clock.reference, &clock.name));
        let watched = self.watched.iter().map(|(reference, name)| (*reference, name));
        timed.chain(triggered).chain(watched).find(|(clock, _)| *clock == reference).map(|(_, name)| name)
    }
}
