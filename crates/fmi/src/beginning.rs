//! How a run of an FMU begins, whichever way it goes on: values, initialization mode, inputs at the start time, clocks.

use crate::assign::Assignments;
use crate::clocks::ClockState;
use crate::error::FmiError;
use crate::input::InputState;
use crate::instance::{Initialization, Instance, Instantiated};
use crate::plan::SimulationPlan;
use crate::sys::RawInstance;

/// What a run begins with.
pub(crate) struct Start<'a> {
    pub(crate) plan: &'a SimulationPlan,
    /// For the variables that have start values in the plan.
    pub(crate) start_values: &'a Assignments,
    /// For the plan's parameters, in its order.
    pub(crate) parameters: &'a [f64],
    /// The FMU is told that no step leads beyond it.
    pub(crate) stop: Option<f64>,
}

impl Start<'_> {
    /// Brings a fresh instance into initialization mode at the start time, with all that can be set there; `buffer` is used
    /// on the way.
    ///
    /// # Errors
    /// The FMU refuses; an input function is not finite at the start time.
    pub(crate) fn begin<K>(
        &self,
        raw: RawInstance,
        buffer: &mut Vec<f64>,
        inputs: &mut InputState,
        clocks: &mut ClockState,
    ) -> Result<Instance<Initialization, K>, FmiError> {
        let plan = self.plan;
        let mut instance: Instance<Instantiated, K> = Instance::from_raw(raw, plan.fmu().clone());
        plan.set_up(instance.core(), self.start_values, self.parameters, buffer)?;
        let mut instance =
            instance.enter_initialization(plan.start, self.stop, Some(plan.options.relative_tolerance))?;
        inputs.begin(&plan.inputs, plan.start);
        if !inputs.continuous_at(&plan.inputs, plan.start) {
            return Err(inputs.bad_function_value(plan.start));
        }
        inputs.set_held(instance.core(), &plan.inputs)?;
        instance.core().set_reals(&plan.inputs.continuous.references, &inputs.continuous)?;
        clocks.begin(&plan.clocks, instance.core(), plan.start)?;
        Ok(instance)
    }
}
