//! The calls into an FMU, in house words, and what reads and sets its values.

use super::types::Component;
use crate::error::Status;
use crate::value::VariableKind;
use std::ffi::c_char;

/// The calls, in house words; [`Binding::name`] gives the standard's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Call {
    Instantiate,
    SetDebugLogging,
    SetupExperiment,
    EnterInitialization,
    ExitInitialization,
    Terminate,
    Reset,
    FreeInstance,
    Get(VariableKind),
    Set(VariableKind),
    EnterConfiguration,
    ExitConfiguration,
    CountStates,
    CountIndicators,
    EnterStepMode,
    SaveState,
    RestoreState,
    FreeState,
    SerializedSize,
    Serialize,
    Deserialize,
    DirectionalDerivative,
    EnterEventMode,
    NewDiscreteStates,
    EnterContinuousTimeMode,
    CompletedIntegratorStep,
    SetTime,
    SetContinuousStates,
    GetContinuousStates,
    GetDerivatives,
    GetEventIndicators,
    GetNominals,
    DoStep,
    StepStatus,
    /// Of kinds of status that are real numbers and Booleans.
    StepRealStatus,
    StepBooleanStatus,
    CancelStep,
    SetInputDerivatives,
    /// Of clocks; as a fraction or not.
    GetInterval(bool),
    GetShift(bool),
    SetInterval(bool),
    GetOutputDerivatives,
}

impl Call {
    /// What a call is spoken of as where a version has no function for it. No symbol has such a name.
    pub(super) fn in_brackets(self) -> &'static str {
        match self {
            Call::SetupExperiment => "(experiment)",
            Call::Reset => "(reset)",
            Call::Get(_) | Call::Set(_) => "(variables of this type)",
            Call::SaveState | Call::RestoreState | Call::FreeState => "(saved states)",
            Call::SerializedSize | Call::Serialize | Call::Deserialize => "(serialized states)",
            Call::DirectionalDerivative => "(directional derivatives)",
            Call::EnterEventMode | Call::EnterContinuousTimeMode | Call::EnterStepMode => "(modes)",
            Call::EnterConfiguration | Call::ExitConfiguration => "(configuration mode)",
            Call::CountStates | Call::CountIndicators => "(number of states)",
            Call::GetInterval(_) | Call::GetShift(_) | Call::SetInterval(_) => "(clocks)",
            Call::StepStatus | Call::StepRealStatus | Call::StepBooleanStatus | Call::CancelStep => {
                "(pending steps)"
            }
            Call::SetInputDerivatives => "(input derivatives)",
            Call::GetOutputDerivatives => "(output derivatives)",
            _ => "(no function)",
        }
    }
}

/// Getters and setters of one library in house types.
///
/// # Safety
/// As for [`Binding`].
#[allow(clippy::missing_safety_doc)]
pub(super) trait Values {
    /// Whether a reference may stand for several values. If not, there are as many values as references.
    fn has_arrays(&self) -> bool {
        false
    }
    unsafe fn get_real(&self, component: Component, references: &[u32], values: &mut [f64]) -> Status;
    unsafe fn set_real(&self, component: Component, references: &[u32], values: &[f64]) -> Status;
    /// Values of all other kinds of numbers, in lanes (see `instance/integer_codec.rs`).
    unsafe fn get_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status;
    /// The lanes are used up.
    unsafe fn set_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status;
    unsafe fn get_string(
        &self,
        component: Component,
        references: &[u32],
        values: &mut [*const c_char],
    ) -> Status;
    unsafe fn set_string(&self, component: Component, references: &[u32], values: &[*const c_char])
    -> Status;
    /// Addresses and sizes of binary values; they stay valid until the next call on the component.
    unsafe fn get_binary(
        &self,
        component: Component,
        references: &[u32],
        sizes: &mut [usize],
        values: &mut [*const u8],
    ) -> Status {
        let _ = (component, references, sizes, values);
        Status::Missing
    }
    unsafe fn set_binary(
        &self,
        component: Component,
        references: &[u32],
        sizes: &[usize],
        values: &[*const u8],
    ) -> Status {
        let _ = (component, references, sizes, values);
        Status::Missing
    }
}
