//! Communication steps (performing, querying and abandoning them), and derivatives of inputs and
//! outputs.

use super::component::RawInstance;
use super::fault::{Fault, Outcome};
use crate::error::Status;
use crate::sys::function::call;
use crate::sys::types::StepInfo;
use crate::sys::versioned_functions::Step;

impl RawInstance {
    /// Performs one communication step. Returns `false` if the step was not computed, or only in part; `info`
    /// then contains the time reached. The status of a pending step must be queried with
    /// [`step_status`](Self::step_status).
    pub(crate) fn do_step(&mut self, time: f64, size: f64, info: &mut StepInfo) -> Result<bool, Fault> {
        self.callbacks.log().go_on();
        self.set_call_time(time);
        let no_set_state_prior = !self.saved.may_be_restored();
        let step = Step { time, size, no_set_state_prior, is_new: !self.memory.is_step_repeated };
        let outcome = run!(self, |library, c| library.version.do_step(&library.functions, c, step, info));
        // A step of which nothing was computed will be repeated.
        let is_discarded = matches!(outcome, Err(Fault::Discard(_)));
        self.memory.is_step_repeated = is_discarded && !info.reached.is_some_and(|reached| reached > time);
        completed(outcome, info)
    }

    /// Returns the name of the function that performs a step.
    pub(crate) fn step_function(&self) -> &'static str {
        self.library.version.step_function()
    }

    /// Queries the status of a pending step; returns as [`do_step`](Self::do_step).
    pub(crate) fn step_status(&mut self, info: &mut StepInfo) -> Result<bool, Fault> {
        let outcome = run!(self, |library, c| library.functions.step_status(c, info));
        completed(outcome, info)
    }

    /// Cancels a pending step. If that fails, the instance is abandoned, because no function may be called on
    /// it while the step is pending.
    pub(crate) fn abandon_step(&mut self) {
        let cancel = self.library.functions.cancel;
        let mut give_up = || run!(self, |_library, c| call!(cancel, c));
        if give_up().is_err() {
            self.fatal.get_or_insert(cancel.name);
        }
    }

    /// True if the library has the function that sets derivatives of inputs.
    pub(crate) fn can_set_input_derivatives(&self) -> bool {
        self.library.functions.set_input_derivatives.pointer.is_some()
    }

    /// Sets first derivatives of real inputs with respect to time.
    pub(crate) fn set_input_derivatives(&mut self, references: &[u32], values: &[f64]) -> Outcome {
        self.length(self.library.functions.set_input_derivatives.name, references.len(), values.len())?;
        self.with_first_orders(values.len(), |raw, orders| {
            run!(raw, |library, c| {
                let function = &library.functions.set_input_derivatives;
                let (list, n) = (references.as_ptr(), references.len());
                call!(function, c, list, n, orders.as_ptr(), values.as_ptr())
            })
        })
    }

    /// Returns first derivatives of scalar real outputs with respect to time, at the end of the last step.
    pub(crate) fn get_output_derivatives(&mut self, references: &[u32], values: &mut [f64]) -> Outcome {
        self.length(self.library.functions.get_output_derivatives.name, references.len(), values.len())?;
        self.with_first_orders(values.len(), |raw, orders| {
            run!(raw, |library, c| {
                let functions = &library.functions;
                library.version.get_output_derivatives(functions, c, references, orders, values)
            })
        })
    }

    /// Performs a call that requires the orders of `n` derivatives, with all orders equal to 1.
    fn with_first_orders(&mut self, n: usize, call: impl FnOnce(&mut Self, &[i32]) -> Outcome) -> Outcome {
        let mut orders = std::mem::take(&mut self.buffers.orders);
        orders.clear();
        orders.resize(n, 1);
        let outcome = call(self, &orders);
        self.buffers.orders = orders;
        outcome
    }
}

/// True if a step was completed; `false` if the step ended early or is pending.
fn completed(outcome: Outcome, info: &StepInfo) -> Result<bool, Fault> {
    match outcome {
        Ok(()) => Ok(true),
        Err(Fault::Discard(_)) => Ok(false),
        Err(Fault::Failed(failed)) if failed.status == Status::Pending && info.pending => Ok(false),
        Err(fault) => Err(fault),
    }
}
