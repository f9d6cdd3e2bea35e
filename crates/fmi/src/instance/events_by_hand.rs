//! Events of an instance that the user controls: clock ticks, inputs that wait for event mode, and the event
//! iteration. They are handled as in a simulation.

use super::assignments::Assignments;
use super::core::Core;
use super::progress::Progress;
use super::schedule::{Schedule, TimedClock, next_instant};
use crate::description::{Causality, ClockKind, Interval, Value, Variability, Variable, VariableKind};
use crate::error::{FmiError, Result};
use crate::sys::{IntervalAnswer, Qualifier, RawInstance};
use ode::EventOutcome;

impl TimedClock {
    /// Returns the first ticks. Reads them from the model in initialization mode if the description does not
    /// define them.
    pub(crate) fn first(&self, core: &mut Core, start: f64) -> Result<Schedule> {
        match self.timing.kind {
            ClockKind::Changing | ClockKind::Countdown => {
                let answer = self.interval(core)?;
                if answer.qualifier == Qualifier::NotYetKnown {
                    return Ok(Schedule::IDLE);
                }
                self.check(answer.interval, false)?;
                Ok(Schedule::once(start + answer.interval.value()))
            }
            _ => {
                if let Some(given) = self.given {
                    core.call(|raw| raw.set_interval(self.reference, given))?;
                }
                let mut shift = self.timing.shift;
                if self.timing.interval.is_none() {
                    let (reference, fraction) = (self.reference, self.timing.supports_fraction);
                    shift = core.call(|raw| raw.get_shift(reference, fraction))?;
                }
                let interval = match self.given.or(self.timing.interval) {
                    Some(interval) => interval,
                    None => self.interval(core)?.interval,
                };
                self.check(interval, true)?;
                self.check(shift, false)?;
                Ok(Schedule::periodic(start, shift, interval, 0))
            }
        }
    }

    fn interval(&self, core: &mut Core) -> Result<IntervalAnswer> {
        let (reference, fraction) = (self.reference, self.timing.supports_fraction);
        core.call(|raw: &mut RawInstance| raw.get_interval(reference, fraction))
    }

    /// Removes the tick that is due within `tolerance` of `t`, if any, and schedules the next one if it is
    /// known. Returns the exact time of the tick.
    pub(crate) fn take_due(&self, schedule: &mut Schedule, t: f64, tolerance: f64) -> Option<f64> {
        let time = schedule.next.filter(|next| *next <= t + tolerance)?;
        match self.timing.kind {
            ClockKind::Changing | ClockKind::Countdown => schedule.next = None,
            _ => schedule.advance(),
        }
        Some(time)
    }

    /// Reads the interval from the model if it may have changed during this visit of event mode. `tick` is
    /// the time at which the clock has ticked in this visit, if any.
    pub(crate) fn learn(
        &self,
        core: &mut Core,
        schedule: &mut Schedule,
        tick: Option<f64>,
        t: f64,
    ) -> Result<()> {
        let asks = match self.timing.kind {
            ClockKind::Changing => tick.is_some(),
            ClockKind::Countdown => true,
            ClockKind::Tunable => self.timing.interval.is_none(),
            _ => false,
        };
        if !asks {
            return Ok(());
        }
        let answer = self.interval(core)?;
        match (self.timing.kind, answer.qualifier) {
            (ClockKind::Tunable, Qualifier::Changed) => {
                self.check(answer.interval, true)?;
                *schedule = Schedule::periodic(tick.unwrap_or(t), Interval::Decimal(0.0), answer.interval, 1);
            }
            (ClockKind::Countdown, Qualifier::NotYetKnown) => schedule.next = None,
            // The standard requires "changed" after a tick. "Unchanged" is accepted because a clock that has
            // just ticked cannot mean anything else.
            (ClockKind::Changing, Qualifier::Unchanged | Qualifier::Changed)
            | (ClockKind::Countdown, Qualifier::Changed) => {
                self.check(answer.interval, false)?;
                *schedule = Schedule::once(tick.unwrap_or(t) + answer.interval.value());
            }
            _ => {}
        }
        Ok(())
    }
}

impl Core {
    /// Determines when the clocks tick, before the initialization of an instance that the user controls ends.
    /// `handles_events` is true if the instance will have an event mode.
    ///
    /// # Errors
    /// Returns an error if a clock ticks without being activated but there is no event mode, or if an
    /// interval is invalid.
    pub(super) fn begin_clocks(&mut self, handles_events: bool) -> Result<()> {
        let start = self.raw.time().unwrap_or(0.0);
        self.progress.start = Some(start);
        let fmu = self.fmu.clone();
        let given = std::mem::take(&mut self.progress.intervals);
        let clocks = fmu.description().variables.iter().enumerate().filter_map(|(index, variable)| {
            let is_input = variable.kind == VariableKind::Clock && variable.causality == Causality::Input;
            let timing = variable.clock.as_deref().filter(|timing| timing.kind != ClockKind::Triggered)?;
            let given = given.iter().find(|(clock, _)| *clock == index).map(|(_, interval)| *interval);
            is_input.then(|| TimedClock::new(variable, *timing, given))
        });
        self.progress.clocks = clocks.collect();
        self.progress.intervals = given;
        if let (false, Some(clock)) = (handles_events, self.progress.clocks.first()) {
            return Err(FmiError::BadSetting(format!(
                "the clock {} ticks in event mode, which this co-simulation does not support",
                clock.name
            )));
        }
        let clocks = self.progress.clocks.clone();
        self.progress.schedules =
            clocks.iter().map(|clock| clock.first(self, start)).collect::<Result<_>>()?;
        Ok(())
    }

    /// True if a variable is set only in event mode. In a co-simulation with event mode, this applies to all
    /// variables except continuous inputs.
    pub(super) fn waits_for_events(&self, variable: &Variable) -> bool {
        self.raw.has_event_mode() && variable.variability != Variability::Continuous
    }

    /// True if events must be handled at `t`. Either the model has requested event mode, a clock is due, or
    /// an input without clock waits.
    pub(super) fn has_events_at(&self, t: f64, tolerance: f64) -> bool {
        let variables = &self.fmu.description().variables;
        let is_ready =
            |index: usize| variables[index].kind == VariableKind::Clock || variables[index].clocks.is_empty();
        self.progress.needs_event
            || self.progress.next_tick().is_some_and(|tick| tick <= t + tolerance)
            || self.progress.waiting.iter().any(|(index, _)| is_ready(*index))
    }

    /// Stores the event indicators before inputs are set in continuous-time mode. They later determine
    /// whether setting the inputs caused an event.
    pub(super) fn note_indicators(&mut self) {
        if self.progress.before_inputs.is_none() {
            self.progress.before_inputs = self.indicators().ok();
        }
    }

    /// True if the domain of an event indicator has changed since before the inputs were set.
    ///
    /// # Errors
    /// Returns an error if the FMU does.
    pub(super) fn inputs_cross(&mut self) -> Result<bool> {
        let Some(before) = self.progress.before_inputs.take() else { return Ok(false) };
        let now = self.indicators()?;
        Ok(before.iter().zip(&now).any(|(before, now)| (*before > 0.0) != (*now > 0.0)))
    }

    fn indicators(&mut self) -> Result<Vec<f64>> {
        let mut indicators = vec![0.0; self.structure.indicators(self.fmu.description())];
        if !indicators.is_empty() {
            self.call(|raw| raw.get_event_indicators(&mut indicators))?;
        }
        Ok(indicators)
    }

    /// Handles the events at one time of a run that the user controls, in event mode. Sets due clocks and
    /// waiting inputs, updates the discrete states until they settle, and stores the next event. Times closer
    /// than `tolerance` count as equal.
    pub(super) fn settle_events(&mut self, time: f64, tolerance: f64, limit: u32) -> Result<EventOutcome> {
        let mut total = EventOutcome::default();
        self.progress.before_inputs = None;
        self.progress.needs_event = false;
        for _ in 0..limit {
            let ticked = self.activate(time, tolerance)?;
            let outcome = self.iterate_events(time, tolerance, limit, &mut |_| Ok(()))?;
            total.states_changed |= outcome.states_changed;
            total.nominals_changed |= outcome.nominals_changed;
            total.terminate |= outcome.terminate;
            total.next_time = outcome.next_time;
            if outcome.terminate {
                self.progress.next_event = None;
                return Ok(total);
            }
            let (clocks, mut schedules) =
                (self.progress.clocks.clone(), std::mem::take(&mut self.progress.schedules));
            let mut learnt = Ok(());
            for ((clock, schedule), tick) in clocks.iter().zip(&mut schedules).zip(ticked) {
                learnt = learnt.and_then(|()| clock.learn(self, schedule, tick, time));
            }
            self.progress.schedules = schedules;
            learnt?;
            // With an interval of 0, the next tick is at the same time.
            let tick = self.progress.next_tick();
            if tick.is_none_or(|tick| tick > time + tolerance) {
                total.next_time = next_instant(total.next_time, tick, tolerance);
                self.progress.next_event = total.next_time;
                return Ok(total);
            }
        }
        Err(FmiError::EventIteration { time, limit })
    }

    /// Sets the clocks that tick and the values that wait for event mode. Clocked inputs wait for a tick of
    /// one of their clocks. Returns the exact times of the ticks.
    fn activate(&mut self, time: f64, tolerance: f64) -> Result<Vec<Option<f64>>> {
        let Progress { clocks, schedules, waiting, .. } = &mut self.progress;
        let ticked: Vec<Option<f64>> = clocks
            .iter()
            .zip(schedules)
            .map(|(clock, schedule)| clock.take_due(schedule, time, tolerance))
            .collect();
        let due = clocks.iter().zip(&ticked).filter(|(_, tick)| tick.is_some());
        let mut active: Vec<u32> = due.map(|(clock, _)| clock.reference).collect();
        let waiting = std::mem::take(waiting);
        let fmu = self.fmu.clone();
        let variables = &fmu.description().variables;
        let (triggers, inputs): (Vec<_>, Vec<_>) =
            waiting.into_iter().partition(|(index, _)| variables[*index].kind == VariableKind::Clock);
        let set = triggers.iter().filter(|(_, value)| *value == Value::Boolean(true));
        active.extend(set.map(|(index, _)| variables[*index].value_reference));
        if !active.is_empty() {
            let words = vec![1; active.len()];
            self.call(|raw| raw.set_packed(VariableKind::Clock, &active, &words))?;
        }
        let mut values = Assignments::default();
        for (index, value) in inputs {
            let variable = &variables[index];
            let clocks = &variable.clocks;
            let ticks = |clock: &usize| active.contains(&variables[*clock].value_reference);
            if clocks.is_empty() || clocks.iter().any(ticks) {
                values.push(variable, &value, self.elements(variable))?;
            } else {
                self.progress.waiting.push((index, value));
            }
        }
        self.apply(&values)?;
        Ok(ticked)
    }
}
