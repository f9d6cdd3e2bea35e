//! Integration of an instance that the user controls, from one time to another.

use super::core::Core;
use super::model_exchange::MAX_EVENT_ITERATIONS;
use super::phases::{ContinuousTime, EventMode, Instance};
use crate::error::{FmiError, Result};
use crate::sys::{Fault, RawInstance};
use ode::{
    CallError, CallResult, Driver, EventOutcome, EventVisit, HybridSystem, Ignore, Observer, Options,
    StepAction, Termination,
};

/// Result of an integration of an instance that the user controls.
#[derive(Debug)]
pub enum Integrated {
    /// The integration reached its end time.
    Reached {
        /// Instance at the end time.
        instance: Instance<ContinuousTime>,
    },
    /// The model ended the simulation.
    Ended {
        /// Instance whose values can be read.
        instance: Instance<EventMode>,
        /// Time at which the model ended the simulation.
        time: f64,
    },
}

impl Instance<ContinuousTime> {
    /// Integrates the states from `start`, the current time of the instance, to `end`, and handles all
    /// events. Inputs stay unchanged. If setting inputs has changed the domain of an event indicator, an
    /// event is handled at `start`.
    ///
    /// # Errors
    /// Returns an error if the options are invalid, the solver fails ([`FmiError::Simulation`]), or the FMU
    /// returns an error. The instance is then freed.
    pub fn integrate(self, start: f64, end: f64, options: Options) -> Result<Integrated> {
        self.integrate_until(start, end, options, &mut Ignore)
    }

    /// Integrates as [`integrate`](Self::integrate) does. Returns [`FmiError::Cancelled`] if the observer
    /// stops the run.
    pub(crate) fn integrate_until(
        mut self,
        start: f64,
        end: f64,
        options: Options,
        observer: &mut impl Observer,
    ) -> Result<Integrated> {
        let mut driver = Driver::new(options)?;
        let core = self.core();
        let tolerance = core.progress.time_tolerance(end);
        let floor = core.progress.time_at(start, tolerance);
        if core.inputs_cross()? {
            core.call(RawInstance::enter_event_mode)?;
            if core.settle_events(floor, tolerance, MAX_EVENT_ITERATIONS)?.terminate {
                return Ok(Integrated::Ended { instance: self.into_phase(), time: start });
            }
            core.call(RawInstance::enter_continuous_time_mode)?;
        }
        let description = core.fmu.description();
        let (n_states, n_indicators) =
            (core.structure.states(description), core.structure.indicators(description));
        let mut system = ByHand {
            core,
            n_states,
            n_indicators,
            end,
            tolerance,
            is_over: false,
            floor,
            last: (start, Vec::new()),
        };
        let report = driver.run(&mut system, start, end, &[], observer).map_err(FmiError::Simulation)?;
        if report.termination == Termination::StoppedByObserver {
            return Err(FmiError::Cancelled);
        }
        let ByHand { is_over, floor, last: (time, states), .. } = system;
        if is_over || report.termination == Termination::StoppedByModel {
            // The model requests the end in event mode or after a completed step.
            if !is_over {
                self.core().call(RawInstance::enter_event_mode)?;
            }
            self.core().progress.next_event = None;
            return Ok(Integrated::Ended { instance: self.into_phase(), time });
        }
        // The model may have been evaluated last at a different point.
        self.set_time(end.max(floor))?;
        if !states.is_empty() {
            self.set_continuous_states(&states)?;
        }
        Ok(Integrated::Reached { instance: self })
    }
}

/// Adapter through which the driver integrates the instance.
struct ByHand<'a> {
    core: &'a mut Core,
    n_states: usize,
    n_indicators: usize,
    end: f64,
    /// Difference below which two times count as equal. It refers to the whole run, because rounding errors
    /// accumulate over its steps.
    tolerance: f64,
    /// True if the model has ended the simulation in event mode.
    is_over: bool,
    /// Time of the last event. The model never returns to an earlier time.
    floor: f64,
    /// Last committed point.
    last: (f64, Vec<f64>),
}

impl ByHand<'_> {
    fn call(&mut self, body: impl FnOnce(&mut RawInstance) -> Result<(), Fault>) -> CallResult<()> {
        body(&mut self.core.raw).map_err(|fault| match fault {
            Fault::Discard(_) => CallError::Discard,
            fault => CallError::failed(self.core.error(fault)),
        })
    }

    fn set_point(&mut self, t: f64, x: &[f64]) -> CallResult<()> {
        let t = t.max(self.floor);
        self.call(|raw| raw.set_time(t))?;
        if x.is_empty() { Ok(()) } else { self.call(|raw| raw.set_continuous_states(x)) }
    }

    /// Returns the next time event. An event at the end time, apart from rounding, is moved to the end time.
    fn next_event(&self) -> Option<f64> {
        let is_at_end = |next: f64| next > self.end && next - self.end <= self.tolerance;
        self.core.progress.next_event.map(|next| if is_at_end(next) { self.end } else { next })
    }

    fn read_states(&mut self, x: &mut [f64]) -> CallResult<()> {
        if x.is_empty() { Ok(()) } else { self.call(|raw| raw.get_continuous_states(x)) }
    }

    fn commit(&mut self, t: f64, x: &[f64]) {
        self.last.0 = t;
        self.last.1.clear();
        self.last.1.extend_from_slice(x);
    }
}

impl HybridSystem for ByHand<'_> {
    fn n_states(&self) -> usize {
        self.n_states
    }

    fn n_event_indicators(&self) -> usize {
        self.n_indicators
    }

    fn nominals(&mut self, nominals: &mut [f64]) -> CallResult<()> {
        if nominals.is_empty() {
            return Ok(());
        }
        match self.call(|raw| raw.get_nominals(nominals)) {
            Err(CallError::Discard) => nominals.fill(1.0),
            outcome => outcome?,
        }
        // The standard requires positive nominal values (FMI 2.0.x, section 2.2.7).
        for nominal in nominals.iter_mut().filter(|nominal| !(nominal.is_finite() && **nominal > 0.0)) {
            *nominal = if nominal.is_finite() && *nominal < 0.0 { -*nominal } else { 1.0 };
        }
        Ok(())
    }

    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        self.read_states(x)?;
        self.commit(t0, x);
        Ok(EventOutcome { next_time: self.next_event(), ..EventOutcome::default() })
    }

    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        self.set_point(t, x)?;
        if dx.is_empty() { Ok(()) } else { self.call(|raw| raw.get_derivatives(dx)) }
    }

    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        self.set_point(t, x)?;
        self.call(|raw| raw.get_event_indicators(z))
    }

    fn step_completed(&mut self, t: f64, x: &[f64]) -> CallResult<StepAction> {
        self.set_point(t, x)?;
        self.commit(t, x);
        let model = self.core.fmu.description();
        let interface = model.model_exchange.as_ref();
        if interface.is_some_and(|interface| interface.capabilities.completed_integrator_step_not_needed) {
            return Ok(StepAction::default());
        }
        let completed = self.core.call(RawInstance::completed_integrator_step);
        let (event, terminate) = completed.map_err(CallError::failed)?;
        Ok(StepAction { event, terminate })
    }

    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let announced = self.core.progress.next_event.filter(|_| visit.cause.time);
        let is_here = |next: &f64| *next - visit.time <= self.tolerance;
        let time = visit.time.max(self.floor).max(announced.filter(is_here).unwrap_or(visit.time));
        self.set_point(time, x)?;
        self.floor = time;
        self.core.progress.floor = Some(time);
        self.call(RawInstance::enter_event_mode)?;
        let settled = self.core.settle_events(time, self.tolerance, MAX_EVENT_ITERATIONS);
        let outcome = settled.map_err(CallError::failed)?;
        self.read_states(x)?;
        self.commit(time, x);
        if outcome.terminate {
            self.is_over = true;
        } else {
            self.call(RawInstance::enter_continuous_time_mode)?;
        }
        Ok(EventOutcome { next_time: self.next_event(), ..outcome })
    }
}
