//! Getters and setters of FMI 3.0, where a reference may stand for an array: the FMU is told the number of
//! values.

use super::functions::Flag;
use crate::error::Status;
use crate::sys::function::{Answer, call};
use crate::sys::packed;
use crate::sys::symbols::table;
use crate::sys::types::Component;
use crate::sys::version::{NO_SUCH_TYPE, Values};
use crate::value::VariableKind;
use std::ffi::{c_char, c_int};

type Get<T> = unsafe extern "C" fn(Component, *const u32, usize, *mut T, usize) -> c_int;
type Set<T> = unsafe extern "C" fn(Component, *const u32, usize, *const T, usize) -> c_int;
type GetBinary =
    unsafe extern "C" fn(Component, *const u32, usize, *mut usize, *mut *const u8, usize) -> c_int;
type SetBinary =
    unsafe extern "C" fn(Component, *const u32, usize, *const usize, *const *const u8, usize) -> c_int;
type GetClock = unsafe extern "C" fn(Component, *const u32, usize, *mut Flag) -> c_int;
type SetClock = unsafe extern "C" fn(Component, *const u32, usize, *const Flag) -> c_int;

table! {
    /// The getters and setters of one library.
    pub(crate) struct Fmi3Values {
        get_float64: Get<f64> = required "fmi3GetFloat64";
        set_float64: Set<f64> = required "fmi3SetFloat64";
        get_string: Get<*const c_char> = optional "fmi3GetString";
        set_string: Set<*const c_char> = optional "fmi3SetString";
        get_binary: GetBinary = optional "fmi3GetBinary";
        set_binary: SetBinary = optional "fmi3SetBinary";
        get_clock: GetClock = optional "fmi3GetClock";
        set_clock: SetClock = optional "fmi3SetClock";
        get_float32: Get<f32> = optional "fmi3GetFloat32";
        set_float32: Set<f32> = optional "fmi3SetFloat32";
        get_int8: Get<i8> = optional "fmi3GetInt8";
        set_int8: Set<i8> = optional "fmi3SetInt8";
        get_uint8: Get<u8> = optional "fmi3GetUInt8";
        set_uint8: Set<u8> = optional "fmi3SetUInt8";
        get_int16: Get<i16> = optional "fmi3GetInt16";
        set_int16: Set<i16> = optional "fmi3SetInt16";
        get_uint16: Get<u16> = optional "fmi3GetUInt16";
        set_uint16: Set<u16> = optional "fmi3SetUInt16";
        get_int32: Get<i32> = optional "fmi3GetInt32";
        set_int32: Set<i32> = optional "fmi3SetInt32";
        get_uint32: Get<u32> = optional "fmi3GetUInt32";
        set_uint32: Set<u32> = optional "fmi3SetUInt32";
        get_int64: Get<i64> = optional "fmi3GetInt64";
        set_int64: Set<i64> = optional "fmi3SetInt64";
        get_uint64: Get<u64> = optional "fmi3GetUInt64";
        set_uint64: Set<u64> = optional "fmi3SetUInt64";
        get_boolean: Get<Flag> = optional "fmi3GetBoolean";
        set_boolean: Set<Flag> = optional "fmi3SetBoolean";
    }
}

/// Evaluates an expression with the getter of numbers of a kind.
macro_rules! with_getter {
    ($self:ident, $kind:expr, |$function:ident| $body:expr, else $other:expr) => {
        match $kind {
            VariableKind::Float32 => {
                let $function = &$self.get_float32;
                $body
            }
            VariableKind::Int8 => {
                let $function = &$self.get_int8;
                $body
            }
            VariableKind::UInt8 => {
                let $function = &$self.get_uint8;
                $body
            }
            VariableKind::Int16 => {
                let $function = &$self.get_int16;
                $body
            }
            VariableKind::UInt16 => {
                let $function = &$self.get_uint16;
                $body
            }
            VariableKind::Integer => {
                let $function = &$self.get_int32;
                $body
            }
            VariableKind::UInt32 => {
                let $function = &$self.get_uint32;
                $body
            }
            VariableKind::Int64 | VariableKind::Enumeration => {
                let $function = &$self.get_int64;
                $body
            }
            VariableKind::UInt64 => {
                let $function = &$self.get_uint64;
                $body
            }
            VariableKind::Boolean => {
                let $function = &$self.get_boolean;
                $body
            }
            _ => $other,
        }
    };
}

/// Evaluates an expression with the setter of numbers of a kind.
macro_rules! with_setter {
    ($self:ident, $kind:expr, |$function:ident| $body:expr, else $other:expr) => {
        match $kind {
            VariableKind::Float32 => {
                let $function = &$self.set_float32;
                $body
            }
            VariableKind::Int8 => {
                let $function = &$self.set_int8;
                $body
            }
            VariableKind::UInt8 => {
                let $function = &$self.set_uint8;
                $body
            }
            VariableKind::Int16 => {
                let $function = &$self.set_int16;
                $body
            }
            VariableKind::UInt16 => {
                let $function = &$self.set_uint16;
                $body
            }
            VariableKind::Integer => {
                let $function = &$self.set_int32;
                $body
            }
            VariableKind::UInt32 => {
                let $function = &$self.set_uint32;
                $body
            }
            VariableKind::Int64 | VariableKind::Enumeration => {
                let $function = &$self.set_int64;
                $body
            }
            VariableKind::UInt64 => {
                let $function = &$self.set_uint64;
                $body
            }
            VariableKind::Boolean => {
                let $function = &$self.set_boolean;
                $body
            }
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
        let answer = with_getter!(
            self,
            kind,
            |function| packed::get(words, |values| call!(function, c, list, n, values, count)),
            else match kind {
                // One value for each clock: the FMU is not told how many there are.
                VariableKind::Clock if n == count => {
                    packed::get(words, |values| call!(self.get_clock, c, list, n, values))
                }
                VariableKind::Clock => Answer { function: self.get_clock.name, status: Status::Error },
                _ => NO_SUCH_TYPE,
            }
        );
        if matches!(kind, VariableKind::Boolean | VariableKind::Clock) {
            packed::normalize(words);
        }
        answer
    }

    unsafe fn set_packed(&self, c: Component, kind: VariableKind, refs: &[u32], words: &mut [i64]) -> Answer {
        let (list, n, count) = (refs.as_ptr(), refs.len(), words.len());
        with_setter!(
            self,
            kind,
            |function| packed::set(words, |values| call!(function, c, list, n, values, count)),
            else match kind {
                VariableKind::Clock if n == count => {
                    packed::set(words, |values| call!(self.set_clock, c, list, n, values))
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
