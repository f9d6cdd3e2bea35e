//! Clocks of model exchange and co-simulation: their ticks and the actions at a tick.
//!
//! The importer activates input clocks. All clocks due at one time are activated in one visit of event mode.
//! All other events at that time are handled in the same visit. Ticks of periodic clocks are `start + shift +
//! k * interval`, never sums. Fractions are multiplied before they are divided. The rules are defined in FMI
//! 3.0.x, sections 2.2.8.3 and 2.3.5.

use super::plan::{ClockPlan, Timed};
use crate::description::VariableKind;
use crate::error::{FmiError, Result};
use crate::instance::{Core, MAX_EVENT_ITERATIONS, Schedule, next_instant};
use crate::simulation::outputs::OutputBuffers;
use crate::simulation::shared_observer::SharedObserver;
use ode::EventOutcome;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Tick of a clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Tick {
    /// Exact time of the tick according to the clock's interval. Other events within rounding are handled
    /// together with it.
    pub time: f64,
    /// Name of the clock.
    pub clock: Arc<str>,
}

/// Clock state of a run.
#[derive(Debug, Default)]
pub(crate) struct ClockState {
    schedules: Vec<Schedule>,
    /// Number of past ticks of each triggered clock.
    passed: Vec<usize>,
    /// Timed clocks that tick in the current round, with the exact times.
    ticked: Vec<(usize, f64)>,
    /// References of the clocks that the importer activates in the current round.
    active: Vec<u32>,
    words: Vec<i64>,
    pub(crate) ticks: Vec<Tick>,
}

impl ClockState {
    /// Returns the name of the clock that ticks next, for messages.
    pub(crate) fn name_of_next<'a>(&self, plan: &'a ClockPlan) -> Option<&'a str> {
        let next = self.next(plan)?;
        let timed = plan.timed.iter().zip(&self.schedules);
        let timed =
            timed.filter(|(_, schedule)| schedule.next == Some(next)).map(|(timed, _)| &*timed.clock.name);
        let triggered = plan.triggered.iter().zip(&self.passed);
        let triggered = triggered
            .filter(|(clock, passed)| clock.times.get(**passed) == Some(&next))
            .map(|(clock, _)| &*clock.name);
        timed.chain(triggered).next()
    }

    /// Prepares the clocks before the initialization ends. Reads the intervals that only the model defines,
    /// and sets clocked inputs, which may be set here without a tick.
    pub(crate) fn begin(&mut self, plan: &ClockPlan, core: &mut Core, start: f64) -> Result<()> {
        self.ticks.clear();
        self.schedules.clear();
        self.passed.clear();
        // Ticks before the start do not belong to this run.
        self.passed.extend(
            plan.triggered
                .iter()
                .map(|clock| clock.times.partition_point(|time| *time < start - plan.time_tolerance)),
        );
        for timed in &plan.timed {
            let schedule = timed.clock.first(core, start)?;
            self.schedules.push(schedule);
        }
        for (clocked, _) in &plan.clocked {
            clocked.set(core, start)?;
        }
        Ok(())
    }

    /// Returns the first known tick.
    pub(crate) fn next(&self, plan: &ClockPlan) -> Option<f64> {
        let timed = self.schedules.iter().filter_map(|schedule| schedule.next);
        let triggered = plan
            .triggered
            .iter()
            .zip(&self.passed)
            .filter_map(|(clock, passed)| clock.times.get(*passed).copied());
        timed.chain(triggered).min_by(f64::total_cmp)
    }

    /// Lists the clocks that are due with the exact times of their ticks, and schedules their next ticks.
    fn take_due(&mut self, plan: &ClockPlan, t: f64) {
        self.ticked.clear();
        self.active.clear();
        for (i, (Timed { clock, enabled }, schedule)) in
            plan.timed.iter().zip(&mut self.schedules).enumerate()
        {
            let Some(time) = clock.take_due(schedule, t, plan.time_tolerance) else { continue };
            self.ticked.push((i, time));
            if enabled.as_ref().is_none_or(|enabled| enabled.held(t + plan.time_tolerance) != 0.0) {
                self.active.push(clock.reference);
                self.ticks.push(Tick { time, clock: Arc::clone(&clock.name) });
            }
        }
        for (clock, passed) in plan.triggered.iter().zip(&mut self.passed) {
            let happened = clock.times.partition_point(|time| *time <= t + plan.time_tolerance);
            if happened > *passed {
                *passed = happened;
                self.active.push(clock.reference);
                self.ticks.push(Tick { time: clock.times[happened - 1], clock: Arc::clone(&clock.name) });
            }
        }
    }

    /// Handles the events at one time, in event mode. Activates the due clocks, updates the discrete states
    /// until they settle, and schedules the next ticks. In the result, `next_time` is the next event
    /// announced by the model or the next tick. `outside` may end each round.
    pub(crate) fn iterate_events(
        &mut self,
        plan: &ClockPlan,
        core: &mut Core,
        t: f64,
        outputs: (&[u32], &mut OutputBuffers),
        outside: &SharedObserver<'_>,
    ) -> Result<EventOutcome> {
        let first = self.ticks.len();
        let mut total = EventOutcome::default();
        for _ in 0..MAX_EVENT_ITERATIONS {
            self.take_due(plan, t);
            self.activate(plan, core, t)?;
            let mut before_round = |core: &mut Core| {
                outside.check()?;
                self.watch(plan, core, t)
            };
            let outcome =
                core.iterate_events(t, plan.time_tolerance, MAX_EVENT_ITERATIONS, &mut before_round)?;
            total.states_changed |= outcome.states_changed;
            total.nominals_changed |= outcome.nominals_changed;
            total.terminate |= outcome.terminate;
            total.next_time = outcome.next_time;
            if outcome.terminate {
                break;
            }
            self.learn(plan, core, t)?;
            // With an interval of 0, the next tick is at the same time.
            if self.next(plan).is_none_or(|next| next > t + plan.time_tolerance) {
                break;
            }
        }
        if self.next(plan).is_some_and(|next| next <= t + plan.time_tolerance) && !total.terminate {
            return Err(FmiError::EventIteration { time: t, limit: MAX_EVENT_ITERATIONS });
        }
        let (references, buffers) = outputs;
        for (reference, ticked) in references.iter().zip(&mut buffers.ticked) {
            let name = plan.name_of(*reference);
            if self.ticks[first..].iter().any(|tick| Some(&tick.clock) == name) {
                *ticked = t;
            }
        }
        total.next_time = next_instant(total.next_time, self.next(plan), plan.time_tolerance);
        Ok(total)
    }

    /// Sets the clocks that tick and their inputs.
    fn activate(&mut self, plan: &ClockPlan, core: &mut Core, t: f64) -> Result<()> {
        if self.active.is_empty() {
            return Ok(());
        }
        let Self { active, words, .. } = self;
        words.clear();
        words.resize(active.len(), 1);
        core.call(|raw| raw.set_packed(VariableKind::Clock, active, words))?;
        for (clocked, clocks) in &plan.clocked {
            if clocks.iter().any(|clock| active.contains(clock)) {
                clocked.set(core, t + plan.time_tolerance)?;
            }
        }
        Ok(())
    }

    /// Records the clocks that the model has activated.
    fn watch(&mut self, plan: &ClockPlan, core: &mut Core, t: f64) -> Result<()> {
        if plan.watched.is_empty() {
            return Ok(());
        }
        let Self { words, ticks, .. } = self;
        words.clear();
        words.resize(plan.watched.len(), 0);
        core.call(|raw| raw.get_packed(VariableKind::Clock, &plan.watched_references, words))?;
        for ((_, name), word) in plan.watched.iter().zip(words.iter()) {
            if *word != 0 {
                ticks.push(Tick { time: t, clock: Arc::clone(name) });
            }
        }
        Ok(())
    }

    /// Reads the intervals that may have changed in this visit.
    fn learn(&mut self, plan: &ClockPlan, core: &mut Core, t: f64) -> Result<()> {
        for (i, timed) in plan.timed.iter().enumerate() {
            let tick = self.ticked.iter().find(|(clock, _)| *clock == i).map(|(_, time)| *time);
            timed.clock.learn(core, &mut self.schedules[i], tick, t)?;
        }
        Ok(())
    }
}
