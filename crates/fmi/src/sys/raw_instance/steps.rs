//! Communication steps: made, asked for while they are pending, given up; derivatives of inputs and outputs with them.

use super::component::RawInstance;
use super::fault::{Fault, Outcome};
use crate::error::Status;
use crate::sys::call::Call;
use crate::sys::types::StepInfo;

impl RawInstance {
    /// One communication step. A step that was not (or only in part) computed is no fault here: `info` says how far the
    /// model got, and the answer is `false`. A pending step has to be asked for with [`step_status`](Self::step_status).
    pub(crate) fn do_step(&mut self, (time, step): (f64, f64), info: &mut StepInfo) -> Result<bool, Fault> {
        self.callbacks.log().go_on();
        self.time = Some(time);
        let no_set_state_prior = !self.saved.may_be_restored();
        let outcome = run!(self, Call::DoStep, |b, c| b.do_step(c, (time, step), no_set_state_prior, info));
        completed(outcome, info)
    }

    /// What the function that makes a step is called.
    pub(crate) fn step_function(&self) -> &'static str {
        self.library.binding().name(Call::DoStep)
    }

    /// How a pending step stands; as [`do_step`](Self::do_step).
    pub(crate) fn step_status(&mut self, info: &mut StepInfo) -> Result<bool, Fault> {
        let outcome = run!(self, Call::StepStatus, |b, c| b.step_status(c, info));
        completed(outcome, info)
    }

    pub(crate) fn enter_step_mode(&mut self) -> Outcome {
        run!(self, Call::EnterStepMode, |b, c| b.enter_step_mode(c))
    }

    /// Gives a pending step up. An instance that does not let go is abandoned: nothing may be called on it meanwhile.
    pub(crate) fn abandon_step(&mut self) {
        self.dead |= self.cancel_step().is_err();
    }

    fn cancel_step(&mut self) -> Outcome {
        run!(self, Call::CancelStep, |b, c| b.cancel_step(c))
    }

    /// Sets first derivatives of real inputs with respect to time.
    pub(crate) fn set_input_derivatives(&mut self, references: &[u32], values: &[f64]) -> Outcome {
        self.length(Call::SetInputDerivatives, references.len(), values.len())?;
        self.with_first_orders(values.len(), |raw, orders| {
            run!(raw, Call::SetInputDerivatives, |b, c| {
                b.set_input_derivatives(c, references, orders, values)
            })
        })
    }

    /// First derivatives of single real outputs with respect to time, at the end of the last step.
    pub(crate) fn get_output_derivatives(&mut self, references: &[u32], values: &mut [f64]) -> Outcome {
        self.length(Call::GetOutputDerivatives, references.len(), values.len())?;
        self.with_first_orders(values.len(), |raw, orders| {
            run!(raw, Call::GetOutputDerivatives, |b, c| {
                b.get_output_derivatives(c, references, orders, values)
            })
        })
    }

    /// Makes a call that wants the orders of `n` derivatives: all are first ones.
    fn with_first_orders(&mut self, n: usize, call: impl FnOnce(&mut Self, &[i32]) -> Outcome) -> Outcome {
        let mut orders = std::mem::take(&mut self.orders);
        orders.clear();
        orders.resize(n, 1);
        let outcome = call(self, &orders);
        self.orders = orders;
        outcome
    }
}

/// Whether a step was completed; `false` for one that was cut short or is pending.
fn completed(outcome: Outcome, info: &StepInfo) -> Result<bool, Fault> {
    match outcome {
        Ok(()) => Ok(true),
        Err(Fault::Discard(_)) => Ok(false),
        Err(Fault::Failed(failed)) if failed.status == Status::Pending && info.pending => Ok(false),
        Err(fault) => Err(fault),
    }
}
