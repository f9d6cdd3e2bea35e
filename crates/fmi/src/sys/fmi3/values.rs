//! Getters and setters of FMI 3.0, where a reference may stand for an array: the FMU is told the number of values.

use super::functions::{Flag, Get, GetBinary, GetClock, Set, SetBinary, SetClock};
use super::numbers::Numbers;
use crate::description::VariableKind;
use crate::error::{FmiError, Status};
use crate::sys::call::{Call, Values};
use crate::sys::functions::{Table, call, optional, table};
use crate::sys::packed;
use crate::sys::symbols::Symbols;
use crate::sys::types::{Component, status};
use std::ffi::c_char;

/// The getters and setters of one library.
pub(super) struct Fmi3Values {
    pub(super) functions: ValueFunctions,
    numbers: Numbers,
}

table! {
    /// Those of all types but small numbers.
    pub(super) struct ValueFunctions {
        required {
            get_float64: Get<f64> = Call::Get(VariableKind::Real);
            set_float64: Set<f64> = Call::Set(VariableKind::Real);
        }
        optional {
            get_string: Get<*const c_char> = Call::Get(VariableKind::String);
            set_string: Set<*const c_char> = Call::Set(VariableKind::String);
            get_binary: GetBinary = Call::Get(VariableKind::Binary);
            set_binary: SetBinary = Call::Set(VariableKind::Binary);
            get_clock: GetClock = Call::Get(VariableKind::Clock);
            set_clock: SetClock = Call::Set(VariableKind::Clock);
        }
    }
}

impl Fmi3Values {
    /// # Errors
    /// A function that must be there is missing.
    ///
    /// # Safety
    /// As for `Fmi3::load`.
    pub(super) unsafe fn load(
        symbols: &Symbols<'_>,
        name: impl Fn(Call) -> &'static str,
    ) -> Result<Self, FmiError> {
        // SAFETY: the caller's promises.
        unsafe {
            Ok(Self { functions: ValueFunctions::load(symbols, name)?, numbers: Numbers::load(symbols) })
        }
    }
}

impl Values for Fmi3Values {
    fn has_arrays(&self) -> bool {
        true
    }

    unsafe fn get_real(&self, component: Component, references: &[u32], values: &mut [f64]) -> Status {
        call!(
            self.functions.get_float64,
            component,
            references.as_ptr(),
            references.len(),
            values.as_mut_ptr(),
            values.len()
        )
    }

    unsafe fn set_real(&self, component: Component, references: &[u32], values: &[f64]) -> Status {
        call!(
            self.functions.set_float64,
            component,
            references.as_ptr(),
            references.len(),
            values.as_ptr(),
            values.len()
        )
    }

    unsafe fn get_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status {
        let status = match kind {
            VariableKind::Clock => {
                let Some(function) = self.functions.get_clock else { return Status::Missing };
                let (list, n) = (references.as_ptr(), references.len());
                if lanes.len() != n {
                    return Status::Error;
                }
                // SAFETY: the caller's promises are those of the trait; there are as many lanes as references.
                status(packed::get::<Flag>(lanes, |values| unsafe { function(component, list, n, values) }))
            }
            // SAFETY: the same.
            VariableKind::Enumeration => unsafe {
                self.numbers.get(component, VariableKind::Int64, references, lanes)
            },
            // SAFETY: the same.
            kind => unsafe { self.numbers.get(component, kind, references, lanes) },
        };
        if matches!(kind, VariableKind::Boolean | VariableKind::Clock) {
            packed::normalize(lanes);
        }
        status
    }

    unsafe fn set_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Status {
        match kind {
            VariableKind::Clock => {
                let Some(function) = self.functions.set_clock else { return Status::Missing };
                let (list, n) = (references.as_ptr(), references.len());
                if lanes.len() != n {
                    return Status::Error;
                }
                // SAFETY: as for getting.
                status(packed::set::<Flag>(lanes, |values| unsafe { function(component, list, n, values) }))
            }
            // SAFETY: as for getting.
            VariableKind::Enumeration => unsafe {
                self.numbers.set(component, VariableKind::Int64, references, lanes)
            },
            // SAFETY: as for getting.
            kind => unsafe { self.numbers.set(component, kind, references, lanes) },
        }
    }

    unsafe fn get_string(
        &self,
        component: Component,
        references: &[u32],
        values: &mut [*const c_char],
    ) -> Status {
        optional!(
            self.functions.get_string,
            component,
            references.as_ptr(),
            references.len(),
            values.as_mut_ptr(),
            values.len()
        )
    }

    unsafe fn set_string(
        &self,
        component: Component,
        references: &[u32],
        values: &[*const c_char],
    ) -> Status {
        optional!(
            self.functions.set_string,
            component,
            references.as_ptr(),
            references.len(),
            values.as_ptr(),
            values.len()
        )
    }

    unsafe fn get_binary(
        &self,
        component: Component,
        references: &[u32],
        sizes: &mut [usize],
        values: &mut [*const u8],
    ) -> Status {
        optional!(
            self.functions.get_binary,
            component,
            references.as_ptr(),
            references.len(),
            sizes.as_mut_ptr(),
            values.as_mut_ptr(),
            values.len()
        )
    }

    unsafe fn set_binary(
        &self,
        component: Component,
        references: &[u32],
        sizes: &[usize],
        values: &[*const u8],
    ) -> Status {
        optional!(
            self.functions.set_binary,
            component,
            references.as_ptr(),
            references.len(),
            sizes.as_ptr(),
            values.as_ptr(),
            values.len()
        )
    }
}
