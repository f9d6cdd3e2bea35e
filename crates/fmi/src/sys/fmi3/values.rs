//! Getters and setters of FMI 3.0. A reference may refer to an array, so the FMU receives the number of
//! values.

use super::functions::Flag;
use crate::error::Status;
use crate::sys::function::{Answer, call};
use crate::sys::packed_integers;
use crate::sys::symbols::table;
use crate::sys::types::Component;
use crate::sys::versioned_functions::{NO_SUCH_TYPE, Values};
use crate::value::VariableKind;
use std::ffi::c_char;

table! {
    /// Getters and setters of one library.
    pub(crate) struct Fmi3Values {
        both {
            get_float64(*const u32, usize, *mut f64, usize) = required "fmi3GetFloat64";
            set_float64(*const u32, usize, *const f64, usize) = required "fmi3SetFloat64";
            get_string(*const u32, usize, *mut *const c_char, usize) = optional "fmi3GetString";
            set_string(*const u32, usize, *const *const c_char, usize) = optional "fmi3SetString";
            get_binary(*const u32, usize, *mut usize, *mut *const u8, usize) = optional "fmi3GetBinary";
            set_binary(*const u32, usize, *const usize, *const *const u8, usize) = optional "fmi3SetBinary";
            get_clock(*const u32, usize, *mut Flag) = optional "fmi3GetClock";
            set_clock(*const u32, usize, *const Flag) = optional "fmi3SetClock";
            get_float32(*const u32, usize, *mut f32, usize) = optional "fmi3GetFloat32";
            set_float32(*const u32, usize, *const f32, usize) = optional "fmi3SetFloat32";
            get_int8(*const u32, usize, *mut i8, usize) = optional "fmi3GetInt8";
            set_int8(*const u32, usize, *const i8, usize) = optional "fmi3SetInt8";
            get_uint8(*const u32, usize, *mut u8, usize) = optional "fmi3GetUInt8";
            set_uint8(*const u32, usize, *const u8, usize) = optional "fmi3SetUInt8";
            get_int16(*const u32, usize, *mut i16, usize) = optional "fmi3GetInt16";
            set_int16(*const u32, usize, *const i16, usize) = optional "fmi3SetInt16";
            get_uint16(*const u32, usize, *mut u16, usize) = optional "fmi3GetUInt16";
            set_uint16(*const u32, usize, *const u16, usize) = optional "fmi3SetUInt16";
            get_int32(*const u32, usize, *mut i32, usize) = optional "fmi3GetInt32";
            set_int32(*const u32, usize, *const i32, usize) = optional "fmi3SetInt32";
            get_uint32(*const u32, usize, *mut u32, usize) = optional "fmi3GetUInt32";
            set_uint32(*const u32, usize, *const u32, usize) = optional "fmi3SetUInt32";
            get_int64(*const u32, usize, *mut i64, usize) = optional "fmi3GetInt64";
            set_int64(*const u32, usize, *const i64, usize) = optional "fmi3SetInt64";
            get_uint64(*const u32, usize, *mut u64, usize) = optional "fmi3GetUInt64";
            set_uint64(*const u32, usize, *const u64, usize) = optional "fmi3SetUInt64";
            get_boolean(*const u32, usize, *mut Flag, usize) = optional "fmi3GetBoolean";
            set_boolean(*const u32, usize, *const Flag, usize) = optional "fmi3SetBoolean";
        }
    }
}

/// Evaluates an expression with the function for a numeric type.
macro_rules! by_kind {
    ($self:ident, $kind:expr, $($row:ident for $($variant:ident)|+),+; |$function:ident| $body:expr, else $other:expr) => {
        match $kind {
            $($(VariableKind::$variant)|+ => {
                let $function = &$self.$row;
                $body
            })+
            _ => $other,
        }
    };
}

impl Values for Fmi3Values {
    fn has_arrays(&self) -> bool {
        true
    }

    unsafe fn get_real(&self, c: Component, refs: &[u32], values: &mut [f64]) -> Answer {
        let (list, n) = (refs.as_ptr(), refs.len());
        call!(self.get_float64, c, list, n, values.as_mut_ptr(), values.len())
    }

    unsafe fn set_real(&self, c: Component, refs: &[u32], values: &[f64]) -> Answer {
        let (list, n) = (refs.as_ptr(), refs.len());
        call!(self.set_float64, c, list, n, values.as_ptr(), values.len())
    }

    unsafe fn get_packed(&self, c: Component, kind: VariableKind, refs: &[u32], words: &mut [i64]) -> Answer {
        let (list, n, count) = (refs.as_ptr(), refs.len(), words.len());
        let answer = by_kind!(
            self, kind, get_float32 for Float32, get_int8 for Int8, get_uint8 for UInt8, get_int16 for Int16,
            get_uint16 for UInt16, get_int32 for Integer, get_uint32 for UInt32,
            get_int64 for Int64 | Enumeration, get_uint64 for UInt64, get_boolean for Boolean;
            |function| packed_integers::get(words, |values| call!(function, c, list, n, values, count)),
            else match kind {
                // One value for each clock, because the FMU does not receive the number of values.
                VariableKind::Clock if n == count => {
                    packed_integers::get(words, |values| call!(self.get_clock, c, list, n, values))
                }
                VariableKind::Clock => Answer { function: self.get_clock.name, status: Status::Error },
                _ => NO_SUCH_TYPE,
            }
        );
        if matches!(kind, VariableKind::Boolean | VariableKind::Clock) {
            packed_integers::normalize(words);
        }
        answer
    }

    unsafe fn set_packed(&self, c: Component, kind: VariableKind, refs: &[u32], words: &mut [i64]) -> Answer {
        let (list, n, count) = (refs.as_ptr(), refs.len(), words.len());
        by_kind!(
            self, kind, set_float32 for Float32, set_int8 for Int8, set_uint8 for UInt8, set_int16 for Int16,
            set_uint16 for UInt16, set_int32 for Integer, set_uint32 for UInt32,
            set_int64 for Int64 | Enumeration, set_uint64 for UInt64, set_boolean for Boolean;
            |function| packed_integers::set(words, |values| call!(function, c, list, n, values, count)),
            else match kind {
                VariableKind::Clock if n == count => {
                    packed_integers::set(words, |values| call!(self.set_clock, c, list, n, values))
                }
                VariableKind::Clock => Answer { function: self.set_clock.name, status: Status::Error },
                _ => NO_SUCH_TYPE,
            }
        )
    }

    unsafe fn get_string(&self, c: Component, refs: &[u32], values: &mut [*const c_char]) -> Answer {
        let (list, n) = (refs.as_ptr(), refs.len());
        call!(self.get_string, c, list, n, values.as_mut_ptr(), values.len())
    }

    unsafe fn set_string(&self, c: Component, refs: &[u32], values: &[*const c_char]) -> Answer {
        let (list, n) = (refs.as_ptr(), refs.len());
        call!(self.set_string, c, list, n, values.as_ptr(), values.len())
    }

    unsafe fn get_binary(
        &self,
        c: Component,
        refs: &[u32],
        sizes: &mut [usize],
        values: &mut [*const u8],
    ) -> Answer {
        let (list, n) = (refs.as_ptr(), refs.len());
        call!(self.get_binary, c, list, n, sizes.as_mut_ptr(), values.as_mut_ptr(), values.len())
    }

    unsafe fn set_binary(&self, c: Component, refs: &[u32], sizes: &[usize], values: &[*const u8]) -> Answer {
        let (list, n) = (refs.as_ptr(), refs.len());
        call!(self.set_binary, c, list, n, sizes.as_ptr(), values.as_ptr(), values.len())
    }
}
