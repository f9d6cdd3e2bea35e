//! Start of a run of an FMU, for both interfaces: values, initialization mode, inputs at the start time,
//! clocks.

use crate::error::FmiError;
use crate::instance::{Core, Initialization, Instance, Instantiated};
use crate::simulation::plan::SimulationPlan;
use crate::simulation::running::{Current, Running};
use crate::simulation::variable_elements::RunInput;
use crate::sys::{InterfaceKind, RawInstance};

impl Running {
    /// Brings a fresh instance into initialization mode at the start time, with all that can be set there:
    /// the values of the plan or others for the same variables. `stop`: the FMU is told that no step leads
    /// beyond it.
    ///
    /// # Errors
    /// The FMU refuses; an input function is not finite at the start time. There is no instance then.
    pub(super) fn begin<K>(
        &mut self,
        raw: RawInstance,
        input: RunInput<'_>,
        stop: Option<f64>,
    ) -> Result<Instance<Initialization, K>, FmiError> {
        self.current = Current::default();
        self.buffers.begin();
        let Self { plan, inputs, clocks, signed, .. } = self;
        let mut instance: Instance<Instantiated, K> = Instance::from_raw(raw, plan.fmu().clone());
        // First, because some models make their data in this call.
        instance.set_up_experiment(plan.start, stop, plan.tolerance)?;
        plan.values.set_up(instance.core(), input, signed)?;
        inputs.begin(&plan.inputs, plan.start);
        if !inputs.continuous_at(&plan.inputs, plan.start) {
            return Err(inputs.bad_function_value(plan.start));
        }
        let mut is_refused = false;
        let set_inputs = |core: &mut Core, signed: &mut Vec<f64>| {
            plan.values.set_up_inputs(core, input, signed)?;
            inputs.set_held(core, &plan.inputs)?;
            plan.inputs.continuous.set(core, &inputs.continuous)
        };
        if plan.communication.as_ref().is_some_and(|communication| communication.extrapolates) {
            // Co-simulations of Dymola extrapolate an input that changes in initialization mode, against the direction of the
            // change.
            is_refused = set_inputs(instance.core(), signed).is_err();
        }
        if is_refused && instance.core().call(RawInstance::reset).is_ok() {
            // Models that take values of inputs in initialization mode only, as FMI 2.0 has it for those without `initial`.
            instance.set_up_experiment(plan.start, stop, plan.tolerance)?;
            plan.values.set_up(instance.core(), input, signed)?;
        }
        let mut instance = instance.enter_initialization_mode()?;
        set_inputs(instance.core(), signed)?;
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
