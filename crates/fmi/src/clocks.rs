//! Clocks of model exchange and co-simulation: who ticks when, and what happens at a tick.
//!
//! The importer activates input clocks, all that are due at an instant in one visit of event mode, together with every
//! other event of that instant. Ticks of periodic clocks are `start + shift + k * interval`, never sums; fractions are
//! multiplied out before they are divided. The rules are those of FMI 3.0.x, sections 2.2.8.3 and 2.3.5.

use crate::assign::resolve;
use crate::column::{Column, HeldColumn};
use crate::description::{
    Causality, ClockKind, ClockTiming, Interval, ModelDescription, Variable, VariableKind,
};
use crate::error::FmiError;
use crate::instance::{Core, Instance, Readable};
use crate::model_exchange::MAX_EVENT_ITERATIONS;
use crate::outputs::OutputBuffers;
use crate::sys::{IntervalAnswer, Qualifier, RawInstance};
use ode::EventOutcome;
use std::sync::Arc;

/// A tick of a clock.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Tick {
    /// When: exactly by the interval of the clock, where other events within rounding are handled with it.
    pub time: f64,
    /// Name of the clock.
    pub clock: Arc<str>,
}

/// A clock whose ticks the importer schedules.
#[derive(Debug)]
struct Timed {
    reference: u32,
    name: Arc<str>,
    timing: ClockTiming,
    /// 0 where its ticks are left out.
    enabled: Option<Column>,
}

/// A clock that the inputs trigger.
#[derive(Debug)]
struct Triggered {
    reference: u32,
    name: Arc<str>,
    times: Arc<[f64]>,
}

/// An input that may be set only when one of its clocks ticks.
#[derive(Debug, Clone)]
pub(crate) struct Clocked {
    variable: usize,
    kind: VariableKind,
    reference: u32,
    column: HeldColumn,
}

impl Clocked {
    pub(crate) fn new(position: usize, variable: &Variable, column: HeldColumn) -> Self {
        let (kind, reference) = (variable.kind, variable.value_reference);
        let column = if variable.negated { column.negated(kind) } else { column };
        Self { variable: position, kind, reference, column }
    }

    /// Sets the value that is held from `t` on.
    fn set(&self, core: &mut Core, t: f64) -> Result<(), FmiError> {
        let references = [self.reference];
        match self.kind {
            VariableKind::Real => core.set_reals(&references, &[self.column.column.held(t)]),
            kind => core.call(|raw| raw.set_packed(kind, &references, &[self.column.lane(kind, t)])),
        }
    }
}

/// What the inputs say about clocks.
#[derive(Debug, Clone, Default)]
pub(crate) struct ClockInputs {
    /// Position of the clock and its ticks.
    pub(crate) ticks: Vec<(usize, Arc<[f64]>)>,
    /// Position of the clock and where it is enabled.
    pub(crate) enabled: Vec<(usize, Column)>,
    pub(crate) clocked: Vec<Clocked>,
}

/// The clocks of a simulation.
#[derive(Debug, Default)]
pub(crate) struct ClockPlan {
    timed: Vec<Timed>,
    triggered: Vec<Triggered>,
    /// Triggered by the model.
    watched: Vec<(u32, Arc<str>)>,
    watched_references: Vec<u32>,
    /// With the value references of their clocks.
    clocked: Vec<(Clocked, Vec<u32>)>,
    /// Times closer than this are one.
    same: f64,
}

impl ClockPlan {
    /// The clocks of a model that is driven by these inputs.
    pub(crate) fn new(description: &ModelDescription, inputs: &ClockInputs, same: f64) -> Self {
        let mut plan = Self { same, ..Self::default() };
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
                plan.timed.push(Timed { reference, name: name(variable), timing: *timing, enabled });
            }
        }
        for clocked in &inputs.clocked {
            let clocks = &description.variables[clocked.variable].clocks;
            let clocks = clocks.iter().map(|clock| description.variables[*clock].value_reference);
            plan.clocked.push((clocked.clone(), clocks.collect()));
        }
        plan
    }

    /// Whether there is anything to do for clocks.
    pub(crate) fn is_empty(&self) -> bool {
        self.timed.is_empty() && self.triggered.is_empty() && self.watched.is_empty()
    }
}

/// When a clock ticks next.
#[derive(Debug, Clone, Copy)]
struct Schedule {
    origin: f64,
    shift: Interval,
    interval: Interval,
    /// Number of the next tick, counted from 0 at `origin + shift`.
    number: u64,
    /// The next tick; none while it is not known.
    next: Option<f64>,
}

impl Schedule {
    const IDLE: Schedule = Schedule {
        origin: 0.0,
        shift: Interval::Decimal(0.0),
        interval: Interval::Decimal(0.0),
        number: 0,
        next: None,
    };

    fn periodic(origin: f64, shift: Interval, interval: Interval, number: u64) -> Self {
        let mut schedule = Self { origin, shift, interval, number, next: None };
        schedule.next = Some(schedule.time_of(number));
        schedule
    }

    /// One tick only.
    fn once(time: f64) -> Self {
        Self { next: Some(time), ..Self::IDLE }
    }

    fn time_of(&self, number: u64) -> f64 {
        match (self.shift, self.interval) {
            (Interval::Fraction(shift, r), Interval::Fraction(interval, resolution)) if r == resolution => {
                // Below 2^128 for every number of ticks that a run can have.
                let counter = u128::from(shift) + u128::from(number) * u128::from(interval);
                self.origin + counter as f64 / resolution as f64
            }
            (shift, Interval::Fraction(interval, resolution)) => {
                let counter = u128::from(number) * u128::from(interval);
                self.origin + (shift.value() + counter as f64 / resolution as f64)
            }
            (shift, Interval::Decimal(interval)) => self.origin + (shift.value() + number as f64 * interval),
        }
    }

    fn advance(&mut self) {
        self.number += 1;
        self.next = Some(self.time_of(self.number));
    }
}

/// Where a run stands in its clocks.
#[derive(Debug, Default)]
pub(crate) struct ClockState {
    schedules: Vec<Schedule>,
    /// Ticks of the triggered clocks that have happened.
    passed: Vec<usize>,
    /// Of the timed clocks those that tick in the present round, and the exact times.
    ticked: Vec<(usize, f64)>,
    /// References of the clocks that the importer activates in it.
    active: Vec<u32>,
    lanes: Vec<i64>,
    pub(crate) ticks: Vec<Tick>,
}

impl ClockState {
    /// Before the initialization ends: learns the intervals that only the model knows, and sets clocked inputs, which
    /// may be set once more here without a tick.
    pub(crate) fn begin(&mut self, plan: &ClockPlan, core: &mut Core, start: f64) -> Result<(), FmiError> {
        self.ticks.clear();
        self.schedules.clear();
        self.passed.clear();
        // Ticks before the start are none of this run.
        self.passed.extend(
            plan.triggered.iter().map(|clock| clock.times.partition_point(|time| *time < start - plan.same)),
        );
        for clock in &plan.timed {
            let schedule = clock.first(core, start)?;
            self.schedules.push(schedule);
        }
        for (clocked, _) in &plan.clocked {
            clocked.set(core, start)?;
        }
        Ok(())
    }

    /// The first tick known.
    pub(crate) fn next(&self, plan: &ClockPlan) -> Option<f64> {
        let timed = self.schedules.iter().filter_map(|schedule| schedule.next);
        let triggered = plan
            .triggered
            .iter()
            .zip(&self.passed)
            .filter_map(|(clock, passed)| clock.times.get(*passed).copied());
        timed.chain(triggered).min_by(f64::total_cmp)
    }

    /// Notes and lists the clocks that are due, with the exact times of their ticks, and plans their next ones.
    fn take_due(&mut self, plan: &ClockPlan, t: f64) {
        self.ticked.clear();
        self.active.clear();
        for (i, (clock, schedule)) in plan.timed.iter().zip(&mut self.schedules).enumerate() {
            let Some(time) = schedule.next.filter(|next| *next <= t + plan.same) else { continue };
            match clock.timing.kind {
                ClockKind::Changing | ClockKind::Countdown => schedule.next = None,
                _ => schedule.advance(),
            }
            self.ticked.push((i, time));
            if clock.enabled.as_ref().is_none_or(|enabled| enabled.held(t + plan.same) != 0.0) {
                self.active.push(clock.reference);
                self.ticks.push(Tick { time, clock: Arc::clone(&clock.name) });
            }
        }
        for (clock, passed) in plan.triggered.iter().zip(&mut self.passed) {
            let happened = clock.times.partition_point(|time| *time <= t + plan.same);
            if happened > *passed {
                *passed = happened;
                self.active.push(clock.reference);
                self.ticks.push(Tick { time: clock.times[happened - 1], clock: Arc::clone(&clock.name) });
            }
        }
    }

    /// The events of an instant, in event mode: activates the clocks that are due, updates the discrete states until they
    /// settle, and notes what ticks follow. `next_time` of the outcome is the next event that the model announced or the
    /// next tick; that of the model alone comes second.
    pub(crate) fn settle(
        &mut self,
        plan: &ClockPlan,
        core: &mut Core,
        t: f64,
        outputs: (&[u32], &mut OutputBuffers),
    ) -> Result<(EventOutcome, Option<f64>), FmiError> {
        if plan.is_empty() {
            let outcome = core.iterate_events(t, plan.same, MAX_EVENT_ITERATIONS)?;
            return Ok((outcome, outcome.next_time));
        }
        let first = self.ticks.len();
        let mut total = EventOutcome::default();
        for _ in 0..MAX_EVENT_ITERATIONS {
            self.take_due(plan, t);
            self.activate(plan, core, t)?;
            let outcome = core.iterate_events_watched(t, plan.same, MAX_EVENT_ITERATIONS, &mut |core| {
                self.watch(plan, core, t)
            })?;
            total.states_changed |= outcome.states_changed;
            total.nominals_changed |= outcome.nominals_changed;
            total.terminate |= outcome.terminate;
            total.next_time = outcome.next_time;
            if outcome.terminate {
                break;
            }
            self.learn(plan, core, t)?;
            // An interval of 0: the next tick of this instant.
            if self.next(plan).is_none_or(|next| next > t + plan.same) {
                break;
            }
        }
        if self.next(plan).is_some_and(|next| next <= t + plan.same) && !total.terminate {
            return Err(FmiError::EventIteration { time: t, limit: MAX_EVENT_ITERATIONS });
        }
        let (references, buffers) = outputs;
        for (reference, ticked) in references.iter().zip(&mut buffers.ticked) {
            let name = plan.name_of(*reference);
            if self.ticks[first..].iter().any(|tick| Some(&tick.clock) == name) {
                *ticked = t;
            }
        }
        let announced = total.next_time;
        total.next_time = [announced, self.next(plan)].into_iter().flatten().min_by(f64::total_cmp);
        Ok((total, announced))
    }

    /// Sets the clocks that tick, and the inputs that belong to them.
    fn activate(&mut self, plan: &ClockPlan, core: &mut Core, t: f64) -> Result<(), FmiError> {
        if self.active.is_empty() {
            return Ok(());
        }
        let Self { active, lanes, .. } = self;
        lanes.clear();
        lanes.resize(active.len(), 1);
        core.call(|raw| raw.set_packed(VariableKind::Clock, active, lanes))?;
        for (clocked, clocks) in &plan.clocked {
            if clocks.iter().any(|clock| active.contains(clock)) {
                clocked.set(core, t + plan.same)?;
            }
        }
        Ok(())
    }

    /// Notes the clocks that the model has activated.
    fn watch(&mut self, plan: &ClockPlan, core: &mut Core, t: f64) -> Result<(), FmiError> {
        if plan.watched.is_empty() {
            return Ok(());
        }
        let Self { lanes, ticks, .. } = self;
        lanes.clear();
        lanes.resize(plan.watched.len(), 0);
        core.call(|raw| raw.get_packed(VariableKind::Clock, &plan.watched_references, lanes))?;
        for ((_, name), lane) in plan.watched.iter().zip(lanes.iter()) {
            if *lane != 0 {
                ticks.push(Tick { time: t, clock: Arc::clone(name) });
            }
        }
        Ok(())
    }

    /// Asks for the intervals that may have changed in this visit.
    fn learn(&mut self, plan: &ClockPlan, core: &mut Core, t: f64) -> Result<(), FmiError> {
        for (i, clock) in plan.timed.iter().enumerate() {
            let tick = self.ticked.iter().find(|(clock, _)| *clock == i).map(|(_, time)| *time);
            let asks = match clock.timing.kind {
                ClockKind::Changing => tick.is_some(),
                ClockKind::Countdown => true,
                ClockKind::Tunable => clock.timing.interval.is_none(),
                _ => false,
            };
            if !asks {
                continue;
            }
            let answer = clock.interval(core)?;
            let schedule = &mut self.schedules[i];
            match (clock.timing.kind, answer.qualifier) {
                (ClockKind::Tunable, Qualifier::Changed) => {
                    clock.check(answer.interval, true)?;
                    *schedule =
                        Schedule::periodic(tick.unwrap_or(t), Interval::Decimal(0.0), answer.interval, 1);
                }
                (ClockKind::Countdown, Qualifier::NotYetKnown) => schedule.next = None,
                // The standard wants "changed" after a tick; what else can be meant with a clock that has just ticked?
                (ClockKind::Changing, Qualifier::Unchanged | Qualifier::Changed)
                | (ClockKind::Countdown, Qualifier::Changed) => {
                    clock.check(answer.interval, false)?;
                    *schedule = Schedule::once(tick.unwrap_or(t) + answer.interval.value());
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl ClockPlan {
    fn name_of(&self, reference: u32) -> Option<&Arc<str>> {
        let timed = self.timed.iter().map(|clock| (clock.reference, &clock.name));
        let triggered = self.triggered.iter().map(|clock| (clock.reference, &clock.name));
        let watched = self.watched.iter().map(|(reference, name)| (*reference, name));
        timed.chain(triggered).chain(watched).find(|(known, _)| *known == reference).map(|(_, name)| name)
    }

    /// Names of the clock that ticks at `time`, for messages.
    pub(crate) fn name_of_next<'a>(&'a self, state: &ClockState) -> Option<&'a str> {
        let next = state.next(self)?;
        let timed = self.timed.iter().zip(&state.schedules);
        let timed = timed.filter(|(_, schedule)| schedule.next == Some(next)).map(|(clock, _)| &*clock.name);
        let triggered = self.triggered.iter().zip(&state.passed);
        let triggered = triggered
            .filter(|(clock, passed)| clock.times.get(**passed) == Some(&next))
            .map(|(clock, _)| &*clock.name);
        timed.chain(triggered).next()
    }
}

impl Timed {
    /// The first ticks, asked for in initialization mode where the description does not say them.
    fn first(&self, core: &mut Core, start: f64) -> Result<Schedule, FmiError> {
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
                let (shift, interval) = match self.timing.interval {
                    Some(interval) => (self.timing.shift, interval),
                    None => {
                        let interval = self.interval(core)?.interval;
                        let mut shift = Interval::Decimal(0.0);
                        let (reference, fraction) = (self.reference, self.timing.supports_fraction);
                        core.call(|raw| raw.get_shift(reference, fraction, &mut shift))?;
                        (shift, interval)
                    }
                };
                self.check(interval, true)?;
                self.check(shift, false)?;
                Ok(Schedule::periodic(start, shift, interval, 0))
            }
        }
    }

    fn interval(&self, core: &mut Core) -> Result<IntervalAnswer, FmiError> {
        let (reference, fraction) = (self.reference, self.timing.supports_fraction);
        core.call(|raw: &mut RawInstance| raw.get_interval(reference, fraction))
    }

    fn check(&self, interval: Interval, positive: bool) -> Result<(), FmiError> {
        let value = interval.value();
        if value.is_finite() && (value > 0.0 || (value == 0.0 && !positive)) {
            return Ok(());
        }
        let least = if positive { "positive" } else { "not negative" };
        Err(FmiError::BadSetting {
            problem: format!(
                "the {} clock {} has an interval or shift of {interval:?}: it must be finite and {least}",
                self.timing.kind.name(),
                self.name
            ),
        })
    }
}

impl<P: Readable, K> Instance<P, K> {
    /// What the model says about the interval before the next tick of a clock, in initialization or event mode; `None`
    /// while a countdown does not run.
    ///
    /// # Errors
    /// There is no such variable or it is no clock; the FMU cannot tell, or refuses.
    pub fn clock_interval(&mut self, name: &str) -> Result<Option<Interval>, FmiError> {
        let core = self.core();
        let fmu = core.fmu().clone();
        let variable = &fmu.description().variables[resolve(fmu.description(), name)?];
        let Some(timing) = &variable.clock else {
            return Err(FmiError::BadSetting { problem: format!("{name} is no clock") });
        };
        let (reference, fraction) = (variable.value_reference, timing.supports_fraction);
        let answer = core.call(|raw| raw.get_interval(reference, fraction))?;
        Ok((answer.qualifier != Qualifier::NotYetKnown).then_some(answer.interval))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_multiples_never_sums() {
        let mut schedule = Schedule::periodic(1.0, Interval::Decimal(0.25), Interval::Decimal(0.1), 0);
        for k in 0..1000u32 {
            assert_eq!(schedule.next, Some(1.0 + (0.25 + f64::from(k) * 0.1)));
            schedule.advance();
        }
        // A third: exact where the fraction is, at every third tick.
        let mut third = Schedule::periodic(0.0, Interval::Fraction(0, 3), Interval::Fraction(1, 3), 0);
        for k in 0..3000u32 {
            assert_eq!(third.next, Some(f64::from(k) / 3.0));
            if k % 3 == 0 {
                assert_eq!(third.next, Some(f64::from(k / 3)));
            }
            third.advance();
        }
        let mixed = Schedule::periodic(2.0, Interval::Fraction(1, 4), Interval::Fraction(1, 8), 3);
        assert_eq!(mixed.next, Some(2.625));
    }
}
