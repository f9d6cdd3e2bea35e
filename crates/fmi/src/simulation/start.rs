//! How a run of an FMU begins, whichever way it goes on: values, initialization mode, inputs at the start time, clocks.

use crate::error::FmiError;
use crate::instance::{Core, Initialization, Instance, Instantiated};
use crate::simulation::clocks::ClockState;
use crate::simulation::inputs::InputState;
use crate::simulation::plan::SimulationPlan;
use crate::simulation::start_values::{StartValues, Unset};
use crate::sys::{InterfaceKind, RawInstance};

/// What a run begins with.
pub(crate) struct Start<'a> {
    pub(crate) plan: &'a SimulationPlan,
    /// What is set besides the settings of the plan, before them.
    pub(crate) unset: &'a Unset,
    /// For the variables that have start values in the plan.
    pub(crate) start_values: &'a StartValues,
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
        plan.values.set_up(instance.core(), self.unset, self.start_values, self.parameters, buffer)?;
        let mut instance =
            instance.enter_initialization(plan.start, self.stop, Some(plan.options.relative_tolerance))?;
        instance.core().apply(&self.unset.inputs)?;
        plan.values.set_up_inputs(instance.core(), self.start_values, self.parameters, buffer)?;
        inputs.begin(&plan.inputs, plan.start);
        if !inputs.continuous_at(&plan.inputs, plan.start) {
            return Err(inputs.bad_function_value(plan.start));
        }
        inputs.set_held(instance.core(), &plan.inputs)?;
        instance.core().set_reals(&plan.inputs.continuous.references, &inputs.continuous)?;
        check_clocks(plan, instance.core())?;
        clocks.begin(&plan.clocks, instance.core(), plan.start)?;
        Ok(instance)
    }
}

/// Clocks tick in event mode: refuses a run with clocks on an instance that would not be made with one.
fn check_clocks(plan: &SimulationPlan, core: &mut Core) -> Result<(), FmiError> {
    if plan.kind == InterfaceKind::ModelExchange || core.raw.has_event_mode() || plan.clocks.is_empty() {
        return Ok(());
    }
    let problem = "the model has clocks, which tick in event mode; its description promises that mode, and the model \
                   refuses to be instantiated with it";
    Err(FmiError::BadSetting { problem: problem.to_owned() })
}
