//! Lends each worker a simulator with an instance of its own; finds out how instances can be reused, and whether several
//! can be used at once.

use crate::description::Variable;
use crate::error::FmiError;
use crate::fmu::Reuse;
use crate::plan::SimulationPlan;
use crate::simulation::{Probe, Simulator};
use ode::{Ignore, Observer, Sample};
use std::ops::{ControlFlow, Deref, DerefMut};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Simulators of one plan, for any number of workers.
///
/// Before the first one is lent, the FMU is tested with the plan itself, from start to end: a run on a reset instance,
/// after one with other parameters and while a second instance is run in between, must have the same bits as a run on a
/// new instance. If reset fails the test, every run gets a new instance. If instances disturb each other (or the FMU
/// allows only one), one simulator is lent at a time, and [`lend`](Self::lend) waits.
#[derive(Debug)]
pub struct Pool {
    plan: Arc<SimulationPlan>,
    /// Parameters of the test.
    reference: Vec<f64>,
    state: Mutex<State>,
    returned: Condvar,
}

#[derive(Debug, Default)]
struct State {
    idle: Vec<Simulator>,
    lent: usize,
    tested: Option<Tested>,
}

/// What the test found.
#[derive(Debug, Clone, Copy)]
struct Tested {
    reuse: Reuse,
    independent: bool,
}

/// A simulator on loan; it goes back to its pool on drop.
#[derive(Debug)]
pub struct Lease<'a> {
    pool: &'a Pool,
    /// `None` only while it is dropped.
    simulator: Option<Simulator>,
}

impl Pool {
    /// A pool of simulators of this plan. Nothing is loaded or run yet. The test is made with the values that the
    /// parameters have in the model.
    pub fn new(plan: Arc<SimulationPlan>) -> Self {
        let reference = plan.parameter_starts().to_vec();
        Self { plan, reference, state: Mutex::default(), returned: Condvar::new() }
    }

    /// The same, with the test made at other values of the parameters: where the model can be simulated at all.
    ///
    /// # Errors
    /// A value is not finite, or there are not as many as parameters.
    pub fn with_reference(plan: Arc<SimulationPlan>, reference: &[f64]) -> Result<Self, FmiError> {
        plan.check_parameters(reference)?;
        Ok(Self { reference: reference.to_vec(), ..Self::new(plan) })
    }

    /// The plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// How instances are brought back to their beginning.
    ///
    /// # Errors
    /// The FMU has to be tested first and cannot be instantiated.
    pub fn reuse(&self) -> Result<Reuse, FmiError> {
        let mut state = self.state();
        self.test(&mut state).map(|tested| tested.reuse)
    }

    /// Whether several instances can be used at the same time.
    ///
    /// # Errors
    /// The FMU has to be tested first and cannot be instantiated.
    pub fn is_concurrent(&self) -> Result<bool, FmiError> {
        let mut state = self.state();
        self.test(&mut state).map(|tested| tested.independent)
    }

    /// Lends a simulator: an idle one, else a new one. Where only one may be used at a time, waits until it is returned;
    /// a thread that keeps a lease and asks for a second one then waits for itself.
    ///
    /// # Errors
    /// The FMU cannot be loaded or instantiated.
    pub fn lend(&self) -> Result<Lease<'_>, FmiError> {
        let mut state = self.state();
        let tested = self.test(&mut state)?;
        while !tested.independent && state.lent > 0 {
            state = self.returned.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.lent += 1;
        let idle = state.idle.pop();
        drop(state);
        let simulator = match idle {
            Some(simulator) => Ok(simulator),
            None => Simulator::new(Arc::clone(&self.plan)),
        };
        match simulator {
            Ok(simulator) => Ok(Lease { pool: self, simulator: Some(simulator) }),
            Err(error) => {
                self.state().lent -= 1;
                self.returned.notify_one();
                Err(error)
            }
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tests the FMU, once. The lock is held meanwhile: nobody can use a simulator before the test is over.
    fn test(&self, state: &mut State) -> Result<Tested, FmiError> {
        if let Some(tested) = state.tested {
            return Ok(tested);
        }
        let mut simulator = Simulator::new(Arc::clone(&self.plan))?;
        let Some(tested) = examine(&self.plan, &self.reference, &mut simulator)? else {
            // It says nothing about the FMU, so it binds nobody but this pool.
            log::warn!(
                "{}: the model cannot be simulated at {:?}, so reset and concurrency cannot be tested; simulations run \
                 one at a time",
                self.plan.fmu().description().model_name,
                self.reference
            );
            let cautious = Tested { reuse: Reuse::Reinstantiate, independent: false };
            state.idle.push(simulator);
            state.tested = Some(cautious);
            return Ok(cautious);
        };
        self.plan.set_reuse(tested.reuse);
        if tested.reuse == Reuse::Reinstantiate {
            log::warn!(
                "{}: reset cannot be relied on; every simulation gets a new instance",
                self.plan.fmu().description().model_name
            );
        }
        if !tested.independent {
            log::warn!(
                "{}: several instances at once cannot be relied on; simulations run one at a time",
                self.plan.fmu().description().model_name
            );
        }
        state.idle.push(simulator);
        state.tested = Some(tested);
        Ok(tested)
    }
}

/// The test; see [`Pool`]. `None`: the model cannot be started with `base`, or not in time, and there is nothing to compare.
fn examine(
    plan: &Arc<SimulationPlan>,
    base: &[f64],
    simulator: &mut Simulator,
) -> Result<Option<Tested>, FmiError> {
    let other = other_parameters(plan, base);
    let fmu = plan.fmu();
    let only_one = fmu.check_interface(plan.kind)?.capabilities.can_be_instantiated_only_once_per_process;
    let truth = simulator.probe_new(base, &mut Ignore)?;
    if truth == Probe::Nothing {
        return Ok(None);
    }
    // A run with other parameters in between shows whether reset leaves any behind.
    let after_other = match simulator.probe_reset(&other, true, &mut Ignore)? {
        Some(_) => simulator.probe_reset(base, false, &mut Ignore)?,
        None => None,
    };
    // A run that fails leaves no instance to reset: then at least the same run twice.
    let reset = match after_other {
        Some(probe) => probe == truth,
        None => {
            simulator.probe_new(base, &mut Ignore)? == truth
                && simulator.probe_reset(base, false, &mut Ignore)? == Some(truth)
        }
    };
    let reuse =
        if reset && plan.reuse() != Some(Reuse::Reinstantiate) { Reuse::Reset } else { Reuse::Reinstantiate };
    if only_one {
        return Ok(Some(Tested { reuse, independent: false }));
    }
    let mut interleaved = Interleave { plan, parameters: &other, begun: false, refused: false };
    let independent = simulator.probe_new(base, &mut interleaved)? == truth && !interleaved.refused;
    Ok(Some(Tested { reuse, independent }))
}

/// Parameters a little off, within their bounds.
fn other_parameters(plan: &SimulationPlan, base: &[f64]) -> Vec<f64> {
    let description = plan.fmu().description();
    plan.parameter_names()
        .iter()
        .zip(base)
        .map(|(name, &value)| description.variable(name).map_or(value, |variable| nudge(variable, value)))
        .collect()
}

fn nudge(variable: &Variable, value: f64) -> f64 {
    let size = if value != 0.0 {
        value.abs()
    } else {
        variable.nominal.filter(|n| n.is_normal()).unwrap_or(1.0).abs()
    };
    let fits = |x: &f64| variable.min.is_none_or(|min| *x >= min) && variable.max.is_none_or(|max| *x <= max);
    [value + 0.02 * size, value - 0.02 * size].into_iter().find(fits).unwrap_or(value)
}

/// Makes and runs a second instance while the first one is running.
struct Interleave<'a> {
    plan: &'a Arc<SimulationPlan>,
    parameters: &'a [f64],
    begun: bool,
    /// The second instance could not be made.
    refused: bool,
}

impl Observer for Interleave<'_> {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn poll(&mut self) -> ControlFlow<()> {
        if !std::mem::replace(&mut self.begun, true) {
            let second = Simulator::new(Arc::clone(self.plan))
                .and_then(|mut second| second.probe_new(self.parameters, &mut Ignore));
            self.refused = second.is_err();
        }
        ControlFlow::Continue(())
    }
}

impl Deref for Lease<'_> {
    type Target = Simulator;

    fn deref(&self) -> &Simulator {
        match &self.simulator {
            Some(simulator) => simulator,
            None => unreachable!("a lease has its simulator until it is dropped"),
        }
    }
}

impl DerefMut for Lease<'_> {
    fn deref_mut(&mut self) -> &mut Simulator {
        match &mut self.simulator {
            Some(simulator) => simulator,
            None => unreachable!("a lease has its simulator until it is dropped"),
        }
    }
}

impl Drop for Lease<'_> {
    fn drop(&mut self) {
        let mut state = self.pool.state();
        state.lent -= 1;
        state.idle.extend(self.simulator.take());
        drop(state);
        self.pool.returned.notify_one();
    }
}
