//! Start of a run of an FMU, for both interfaces: values, initialization mode, inputs at the start time,
//! clocks.

use crate::error::{FmiError, Result};
use crate::instance::Core;
use crate::simulation::plan::SimulationPlan;
use crate::simulation::running::{Current, Running};
use crate::simulation::variable_elements::RunInput;
use crate::sys::{Experiment, InterfaceKind, RawInstance};

impl Running {
    /// Initializes a fresh instance at the start time, with all that can be set before and in initialization
    /// mode: the values of the plan or others for the same variables. `stop`: the FMU is told that no step
    /// leads beyond it.
    ///
    /// # Errors
    /// The FMU refuses; an input function is not finite at the start time. There is no instance then.
    pub(super) fn begin(
        &mut self,
        raw: RawInstance,
        input: RunInput<'_>,
        stop: Option<f64>,
    ) -> Result<Box<Core>> {
        self.current = Current::default();
        self.buffers.begin();
        let Self { plan, inputs, clocks, signed, .. } = self;
        let mut core = Box::new(Core::new(raw, plan.fmu().clone()));
        let experiment = Experiment { tolerance: plan.tolerance, start: plan.start, stop };
        // First, because some models make their data in this call.
        core.call(|raw| raw.setup_experiment(&experiment))?;
        plan.values.set_up(&mut core, input, signed)?;
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
            is_refused = set_inputs(&mut core, signed).is_err();
        }
        if is_refused && core.call(RawInstance::reset).is_ok() {
            // Models that take values of inputs in initialization mode only, as FMI 2.0 has it for those without `initial`.
            core.call(|raw| raw.setup_experiment(&experiment))?;
            plan.values.set_up(&mut core, input, signed)?;
        }
        core.check_sizes()?;
        core.call(RawInstance::enter_initialization)?;
        set_inputs(&mut core, signed)?;
        check_clocks(plan, &mut core)?;
        clocks.begin(&plan.clocks, &mut core, plan.start)?;
        core.call(RawInstance::exit_initialization)?;
        Ok(core)
    }
}

/// Clocks tick in event mode: refuses a run with clocks on an instance that would not be made with one.
fn check_clocks(plan: &SimulationPlan, core: &mut Core) -> Result<()> {
    if plan.kind == InterfaceKind::ModelExchange || core.raw.has_event_mode() || plan.clocks.is_empty() {
        return Ok(());
    }
    let problem = "the model has clocks, which tick in event mode; its description promises that mode, and the model \
                   refuses to be instantiated with it";
    Err(FmiError::BadSetting(problem.to_owned()))
}
