//! Approach to steady state before a simulation, at constant time and inputs.

use crate::error::{FmiError, Result};
use crate::simulation::model_exchange::Integration;
use crate::simulation::plan::{SimulationPlan, span_of};
use base::Number;
use ode::{
    CallResult, Driver, ErrorKind, Evaluated, EventCause, EventOutcome, EventVisit, HybridSystem,
    JacobianPattern, Limits, Method, NotFinite, Observer, Options, Report, Sample, StepAction, Termination,
};
use std::ops::ControlFlow;

/// Maximum number of steps of an approach. Near rest, steps grow by factors, so a model that needs more
/// oscillates or drifts.
const MOST_STEPS: u64 = 10_000;

/// Returns the driver of the approach. Radau5 damps all modes whose time constants are shorter than the step.
pub(super) fn settling_driver(plan: &SimulationPlan) -> Result<Box<Driver>> {
    let limits = Limits { max_steps: Some(MOST_STEPS), ..plan.options.limits };
    Ok(Box::new(Driver::new(Options {
        method: Method::Radau5,
        step_size: None,
        max_step: None,
        first_step: None,
        halve_steps: false,
        record_events: false,
        limits,
        ..plan.options.clone()
    })?))
}

/// Starts the system and brings it to rest. Returns the report of the approach.
///
/// # Errors
/// Returns [`FmiError::NotSteady`] if the system is not at rest at the limit or the approach fails. Returns
/// [`FmiError::Simulation`] if the run was cancelled or reached its time limit.
pub(super) fn settle(integration: &mut Integration<'_>, driver: &mut Driver, limit: f64) -> Result<Report> {
    let plan = std::sync::Arc::clone(&integration.running.plan);
    let n = plan.n_states;
    let mut observer = EndOnly(integration.outside);
    let mut frozen = Frozen {
        start: plan.start,
        span: span_of(plan.start, plan.end),
        limit,
        tolerance: plan.options.relative_tolerance,
        nominals: vec![1.0; n],
        is_held: vec![false; n],
        window: (0.0, vec![0.0; n]),
        t: 0.0,
        x: vec![0.0; n],
        change: None,
        is_at_rest: false,
        is_over: false,
        inner: integration,
    };
    let ended = driver.run(&mut frozen, 0.0, limit, &[], &mut observer);
    let not_steady = |reason: String| Err(FmiError::NotSteady { reason });
    match ended {
        Ok(report) if frozen.is_at_rest || report.termination == Termination::StoppedByObserver => Ok(report),
        Ok(_) if frozen.is_over => {
            not_steady("the model ended the simulation before it was at rest".to_owned())
        }
        Ok(_) => not_steady(frozen.reason(&plan, limit)),
        Err(error) => match error.kind {
            ErrorKind::Cancelled | ErrorKind::TimedOut(_) => Err(FmiError::Simulation(error)),
            ErrorKind::TooManySteps(steps) => {
                not_steady(format!("{} ({steps} steps)", frozen.reason(&plan, error.time)))
            }
            _ => not_steady(format!("after {} units of time, {error}", Number(error.time))),
        },
    }
}

/// Observer that only ends a run.
struct EndOnly<'a>(&'a super::shared_observer::SharedObserver<'a>);

impl Observer for EndOnly<'_> {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
    fn poll(&mut self) -> ControlFlow<()> {
        let mut outside = self.0;
        outside.poll()
    }
}

/// System at a constant time, whose independent variable counts the time of the approach.
struct Frozen<'a, 'b> {
    inner: &'a mut Integration<'b>,
    start: f64,
    /// Length of the simulation that follows.
    span: f64,
    /// End of the approach.
    limit: f64,
    tolerance: f64,
    nominals: Vec<f64>,
    /// True for the states that keep their values.
    is_held: Vec<bool>,
    /// Begin of the current window and the states there.
    window: (f64, Vec<f64>),
    /// Time and states after the last step.
    t: f64,
    x: Vec<f64>,
    /// State that changed most in the last complete window, its change, and the length of the window.
    change: Option<(usize, f64, f64)>,
    is_at_rest: bool,
    /// True if the model requested the end of the simulation.
    is_over: bool,
}

impl Frozen<'_, '_> {
    fn hold(&self, dx: &mut [f64]) {
        dx.iter_mut().zip(&self.is_held).filter(|(_, held)| **held).for_each(|(dx, _)| *dx = 0.0);
    }

    /// Ends a window if it is long enough, or at the limit, and compares the states at its ends.
    fn compare(&mut self, t: f64, x: &[f64]) {
        let (began, before) = &self.window;
        let length = t - began;
        if length < self.span || (length < *began && t < self.limit) {
            return;
        }
        let excess = |i: usize| (x[i] - before[i]).abs() / (self.tolerance * (x[i].abs() + self.nominals[i]));
        let largest = (0..x.len()).max_by(|a, b| excess(*a).total_cmp(&excess(*b)));
        self.is_at_rest = largest.is_none_or(|i| excess(i) <= 1.0);
        self.change = largest.map(|i| (i, x[i] - before[i], length));
        self.window = (t, x.to_vec());
    }

    /// Returns the reason why the system is not at rest after this time.
    fn reason(&mut self, plan: &SimulationPlan, limit: f64) -> String {
        let x = std::mem::take(&mut self.x);
        let mut dx = vec![0.0; x.len()];
        let derivatives = self.derivatives(0.0, &x, &mut dx);
        let slope = |i: usize| dx[i].abs() / (x[i].abs() + self.nominals[i]);
        let moving = (0..x.len()).max_by(|a, b| slope(*a).total_cmp(&slope(*b)));
        let of = |index: usize| {
            let state =
                NotFinite { what: Evaluated::State, index, value: x[index], time: plan.start, name: None };
            plan.name_of(&state).unwrap_or_else(|| format!("state {index}"))
        };
        let speed = match (derivatives, moving) {
            (Ok(()), Some(i)) => format!(", where the derivative of '{}' is {}", of(i), Number(dx[i])),
            _ => String::new(),
        };
        let change = self.change.map_or_else(String::new, |(i, change, length)| {
            format!("; '{}' changed by {} in the last {}", of(i), Number(change), Number(length))
        });
        format!(
            "it still moves after {} units of time{speed}{change}. Set a larger steady_limit, other start values or bounds, or give the \
             states that have no equilibrium a number or a parameter",
            Number(limit)
        )
    }
}

impl HybridSystem for Frozen<'_, '_> {
    fn n_states(&self) -> usize {
        self.inner.n_states()
    }

    fn n_event_indicators(&self) -> usize {
        self.inner.n_event_indicators()
    }

    fn nominals(&mut self, nominals: &mut [f64]) -> CallResult<()> {
        self.inner.nominals(nominals)?;
        self.nominals.copy_from_slice(nominals);
        Ok(())
    }

    fn is_unbounded(&self, state: usize) -> bool {
        self.inner.is_unbounded(state)
    }

    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        let outcome = self.inner.start(self.start, x)?;
        let held: Vec<usize> = self.inner.given_states().collect();
        for i in held {
            if let Some(is_held) = self.is_held.get_mut(i) {
                *is_held = true;
            }
        }
        self.window.1.copy_from_slice(x);
        self.x.copy_from_slice(x);
        self.is_over |= outcome.terminate;
        self.is_at_rest = x.is_empty();
        Ok(EventOutcome { next_time: None, ..outcome })
    }

    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        self.inner.derivatives(self.start, x, dx)?;
        self.hold(dx);
        Ok(())
    }

    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        self.inner.jacobian_pattern()
    }

    fn directional_derivative(
        &mut self,
        _: f64,
        x: &[f64],
        seed: &[f64],
        derivative: &mut [f64],
    ) -> CallResult<bool> {
        let is_known = self.inner.directional_derivative(self.start, x, seed, derivative)?;
        self.hold(derivative);
        Ok(is_known)
    }

    fn event_indicators(&mut self, _: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        self.inner.event_indicators(self.start, x, z)
    }

    fn step_completed(&mut self, t: f64, x: &[f64]) -> CallResult<StepAction> {
        let action = self.inner.step_completed(self.start, x)?;
        self.x.copy_from_slice(x);
        self.t = t;
        self.is_over |= action.terminate;
        if !action.event && !action.terminate {
            self.compare(t, x);
        }
        Ok(StepAction { terminate: action.terminate || self.is_at_rest, ..action })
    }

    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let cause = EventCause { time: false, input: false, ..visit.cause };
        let outcome = self.inner.handle_event(&EventVisit { time: self.start, cause, ..*visit }, x)?;
        // The states may jump, so a new window begins.
        self.window.0 = self.t;
        self.window.1.copy_from_slice(x);
        self.x.copy_from_slice(x);
        self.is_over |= outcome.terminate;
        self.is_at_rest = false;
        Ok(EventOutcome { next_time: None, ..outcome })
    }
}
