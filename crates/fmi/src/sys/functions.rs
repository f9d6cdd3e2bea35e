//! Functions of an FMI library. The tables contain the type of each function and, in the same row, its names
//! in the standard. This file contains the functions with one type in all versions that have them.
//!
//! A row has one name, or one name for each of FMI 1.0, 2.0 and 3.0. A fourth name is for co-simulation of
//! FMI 1.0, if it differs. An empty name means that the version does not need the call, which then does
//! nothing. A name in parentheses describes a feature that the version does not have.

use super::function::{Answer, Function, call};
use super::symbols::{signature, table};
use super::types::{Component, Direction, StatePointer, StepInfo, status};
use crate::error::Status;
use std::ffi::{c_char, c_int};

pub(super) type Plain = signature!(());
pub(super) type Text = unsafe extern "C" fn() -> *const c_char;
pub(super) type GetVector = signature!((*mut f64, usize));
pub(super) type GetState = signature!((*mut StatePointer));
pub(super) type Derivative =
    signature!((*const u32, usize, *const u32, usize, *const f64, usize, *mut f64, usize));

table! {
    /// Functions that have the same type in every FMI version that provides them.
    pub(super) struct Functions {
        both {
            get_version[Text] = optional "fmiGetVersion" | "fmi2GetVersion" | "fmi3GetVersion";
            get_types_platform[Text] =
                optional "fmiGetModelTypesPlatform" | "fmi2GetTypesPlatform" | "" | "fmiGetTypesPlatform";
            free[unsafe extern "C" fn(Component)] = required
                "fmiFreeModelInstance" | "fmi2FreeInstance" | "fmi3FreeInstance" | "fmiFreeSlaveInstance";
            terminate() = required "fmiTerminate" | "fmi2Terminate" | "fmi3Terminate" | "fmiTerminateSlave";
            reset() = optional "(reset)" | "fmi2Reset" | "fmi3Reset" | "fmiResetSlave";
            setup_experiment(c_int, f64, f64, c_int, f64) = required "" | "fmi2SetupExperiment" | "";
            exit_initialization() = required "" | "fmi2ExitInitializationMode" | "fmi3ExitInitializationMode";
            enter_event_mode() = optional "" | "fmi2EnterEventMode" | "fmi3EnterEventMode";
            enter_configuration() =
                optional "(configuration mode)" | "(configuration mode)" | "fmi3EnterConfigurationMode";
            exit_configuration() =
                optional "(configuration mode)" | "(configuration mode)" | "fmi3ExitConfigurationMode";
            save_state(*mut StatePointer) = optional "(saved states)" | "fmi2GetFMUstate" | "fmi3GetFMUState";
            restore_state(StatePointer) = optional "(saved states)" | "fmi2SetFMUstate" | "fmi3SetFMUState";
            free_state(*mut StatePointer) = optional "(saved states)" | "fmi2FreeFMUstate" | "fmi3FreeFMUState";
            adjoint_derivative[Derivative] =
                optional "(adjoint derivatives)" | "(adjoint derivatives)" | "fmi3GetAdjointDerivative";
            count_dependencies(u32, *mut usize) = optional
                "(variable dependencies)" | "(variable dependencies)" | "fmi3GetNumberOfVariableDependencies";
            dependencies(u32, *mut usize, *mut u32, *mut usize, *mut c_int, usize) = optional
                "(variable dependencies)" | "(variable dependencies)" | "fmi3GetVariableDependencies";
            interval_decimal(*const u32, usize, *mut f64, *mut c_int) =
                optional "(clocks)" | "(clocks)" | "fmi3GetIntervalDecimal";
            interval_fraction(*const u32, usize, *mut u64, *mut u64, *mut c_int) =
                optional "(clocks)" | "(clocks)" | "fmi3GetIntervalFraction";
            set_interval_decimal(*const u32, usize, *const f64) =
                optional "(clocks)" | "(clocks)" | "fmi3SetIntervalDecimal";
            set_interval_fraction(*const u32, usize, *const u64, *const u64) =
                optional "(clocks)" | "(clocks)" | "fmi3SetIntervalFraction";
            shift_decimal(*const u32, usize, *mut f64) = optional "(clocks)" | "(clocks)" | "fmi3GetShiftDecimal";
            shift_fraction(*const u32, usize, *mut u64, *mut u64) =
                optional "(clocks)" | "(clocks)" | "fmi3GetShiftFraction";
        }
        model_exchange {
            set_time(f64) = required "fmiSetTime" | "fmi2SetTime" | "fmi3SetTime";
            set_continuous_states(*const f64, usize) = required
                "fmiSetContinuousStates" | "fmi2SetContinuousStates" | "fmi3SetContinuousStates";
            get_continuous_states(*mut f64, usize) = required
                "fmiGetContinuousStates" | "fmi2GetContinuousStates" | "fmi3GetContinuousStates";
            get_derivatives(*mut f64, usize) =
                required "fmiGetDerivatives" | "fmi2GetDerivatives" | "fmi3GetContinuousStateDerivatives";
            get_event_indicators(*mut f64, usize) =
                required "fmiGetEventIndicators" | "fmi2GetEventIndicators" | "fmi3GetEventIndicators";
            get_nominals(*mut f64, usize) = required
                "fmiGetNominalContinuousStates" | "fmi2GetNominalsOfContinuousStates"
                | "fmi3GetNominalsOfContinuousStates";
            enter_continuous_time_mode() =
                required "" | "fmi2EnterContinuousTimeMode" | "fmi3EnterContinuousTimeMode";
            get_state_references(*mut u32, usize) = optional
                "fmiGetStateValueReferences" | "(value references of states)" | "(value references of states)";
            count_states(*mut usize) =
                optional "(number of states)" | "(number of states)" | "fmi3GetNumberOfContinuousStates";
            count_indicators(*mut usize) =
                optional "(number of indicators)" | "(number of indicators)" | "fmi3GetNumberOfEventIndicators";
        }
        co_simulation {
            enter_step_mode() = optional "(step mode)" | "(step mode)" | "fmi3EnterStepMode";
            cancel() = optional "fmiCancelStep" | "fmi2CancelStep" | "(pending steps)";
            get_status(c_int, *mut c_int) = optional "fmiGetStatus" | "fmi2GetStatus" | "(pending steps)";
            get_real_status(c_int, *mut f64) =
                optional "fmiGetRealStatus" | "fmi2GetRealStatus" | "(pending steps)";
            get_boolean_status(c_int, *mut c_int) =
                optional "(pending steps)" | "fmi2GetBooleanStatus" | "(pending steps)";
            set_input_derivatives(*const u32, usize, *const c_int, *const f64) = optional
                "fmiSetRealInputDerivatives" | "fmi2SetRealInputDerivatives" | "(input derivatives)";
            get_output_derivatives(*const u32, usize, *const c_int, *mut f64) = optional
                "fmiGetRealOutputDerivatives" | "fmi2GetRealOutputDerivatives" | "(output derivatives)";
        }
    }
}

/// Computes a directional or adjoint derivative of FMI 3.0.
///
/// # Safety
/// As for the methods of [`Version`](super::versioned_functions::Version).
pub(super) unsafe fn derivative(
    function: &Function<Derivative>,
    c: Component,
    along: Direction<'_>,
    out: &mut [f64],
) -> Answer {
    let Direction { unknowns, knowns, seed } = along;
    let (list, n) = (unknowns.as_ptr(), unknowns.len());
    let (knowns_pointer, n_knowns) = (knowns.as_ptr(), knowns.len());
    let (out, n_out) = (out.as_mut_ptr(), out.len());
    call!(function, c, list, n, knowns_pointer, n_knowns, seed.as_ptr(), seed.len(), out, n_out)
}

/// `fmiStatusKind` and `fmi2StatusKind`.
const DO_STEP_STATUS: c_int = 0;
const LAST_SUCCESSFUL_TIME: c_int = 2;
const TERMINATED: c_int = 3;

impl Functions {
    /// Queries the status of a pending step.
    ///
    /// # Safety
    /// As for the methods of [`Version`](super::versioned_functions::Version).
    pub(super) unsafe fn step_status(&self, c: Component, info: &mut StepInfo) -> Answer {
        let mut code = 0;
        let mut answer = call!(self.get_status, c, DO_STEP_STATUS, &raw mut code);
        if answer.status == Status::Ok {
            answer.status = status(code);
        }
        // SAFETY: as for this call.
        unsafe { self.explain_step(c, answer.status, info) };
        answer
    }

    /// Queries the result of an incomplete step.
    ///
    /// # Safety
    /// As for the methods of [`Version`](super::versioned_functions::Version).
    pub(super) unsafe fn explain_step(&self, component: Component, status: Status, info: &mut StepInfo) {
        info.pending = status == Status::Pending;
        if status != Status::Discard {
            return;
        }
        let (mut reached, mut terminated) = (f64::NAN, 0);
        // Both queries may fail; the result is then unknown.
        let status = call!(self.get_real_status, component, LAST_SUCCESSFUL_TIME, &raw mut reached).status;
        info.reached = (status == Status::Ok && reached.is_finite()).then_some(reached);
        let status = call!(self.get_boolean_status, component, TERMINATED, &raw mut terminated).status;
        info.terminate = status == Status::Ok && terminated != 0;
        info.may_have_ended = status != Status::Ok && info.reached.is_some();
    }
}
