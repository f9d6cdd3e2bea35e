//! Getters and setters of FMI 3.0 for all numbers but `Float64`: one function of the library for each type, one of ours
//! for all of them.

use super::functions::{Flag, Get, Set};
use crate::description::VariableKind;
use crate::error::Status;
use crate::sys::packed::{self, Element};
use crate::sys::symbols::Symbols;
use crate::sys::types::{Component, status};

/// Getters and setters of numbers but `Float64`.
macro_rules! numbers {
    ($($kind:ident, $type:ty, $get:ident $get_name:literal, $set:ident $set_name:literal;)+) => {
        pub(super) struct Numbers {
            $($get: Option<Get<$type>>, $set: Option<Set<$type>>,)+
        }

        impl Numbers {
            /// # Safety
            /// As for `Fmi3::load`.
            pub(super) unsafe fn load(symbols: &Symbols<'_>) -> Self {
                // SAFETY: as in `Fmi3::load`.
                unsafe {
                    Self { $($get: symbols.optional($get_name), $set: symbols.optional($set_name),)+ }
                }
            }

            /// # Safety
            /// As for the methods of [`Binding`].
            pub(super) unsafe fn get(
                &self,
                component: Component,
                kind: VariableKind,
                references: &[u32],
                lanes: &mut [i64],
            ) -> Status {
                match kind {
                    // SAFETY: the caller's promises are those of the trait.
                    $(VariableKind::$kind => unsafe { get_numbers(component, self.$get, references, lanes) },)+
                    _ => Status::Missing,
                }
            }

            /// # Safety
            /// As for the methods of [`Binding`].
            pub(super) unsafe fn set(
                &self,
                component: Component,
                kind: VariableKind,
                references: &[u32],
                lanes: &mut [i64],
            ) -> Status {
                match kind {
                    // SAFETY: the caller's promises are those of the trait.
                    $(VariableKind::$kind => unsafe { set_numbers(component, self.$set, references, lanes) },)+
                    _ => Status::Missing,
                }
            }
        }

        pub(super) fn get_name(kind: VariableKind) -> &'static str {
            match kind {
                $(VariableKind::$kind => $get_name,)+
                VariableKind::Real => "fmi3GetFloat64",
                VariableKind::Enumeration => "fmi3GetInt64",
                VariableKind::String => "fmi3GetString",
                VariableKind::Binary => "fmi3GetBinary",
                VariableKind::Clock => "fmi3GetClock",
            }
        }

        pub(super) fn set_name(kind: VariableKind) -> &'static str {
            match kind {
                $(VariableKind::$kind => $set_name,)+
                VariableKind::Real => "fmi3SetFloat64",
                VariableKind::Enumeration => "fmi3SetInt64",
                VariableKind::String => "fmi3SetString",
                VariableKind::Binary => "fmi3SetBinary",
                VariableKind::Clock => "fmi3SetClock",
            }
        }
    };
}
numbers! {
    Float32, f32, get_float32 "fmi3GetFloat32", set_float32 "fmi3SetFloat32";
    Int8, i8, get_int8 "fmi3GetInt8", set_int8 "fmi3SetInt8";
    UInt8, u8, get_uint8 "fmi3GetUInt8", set_uint8 "fmi3SetUInt8";
    Int16, i16, get_int16 "fmi3GetInt16", set_int16 "fmi3SetInt16";
    UInt16, u16, get_uint16 "fmi3GetUInt16", set_uint16 "fmi3SetUInt16";
    Integer, i32, get_int32 "fmi3GetInt32", set_int32 "fmi3SetInt32";
    UInt32, u32, get_uint32 "fmi3GetUInt32", set_uint32 "fmi3SetUInt32";
    Int64, i64, get_int64 "fmi3GetInt64", set_int64 "fmi3SetInt64";
    UInt64, u64, get_uint64 "fmi3GetUInt64", set_uint64 "fmi3SetUInt64";
    Boolean, Flag, get_boolean "fmi3GetBoolean", set_boolean "fmi3SetBoolean";
}

/// # Safety
/// As for the methods of [`Binding`]; the function takes elements of this type.
unsafe fn get_numbers<T: Element>(
    component: Component,
    function: Option<Get<T>>,
    references: &[u32],
    lanes: &mut [i64],
) -> Status {
    let Some(function) = function else { return Status::Missing };
    let (list, n, count) = (references.as_ptr(), references.len(), lanes.len());
    // SAFETY: the caller's promises; there is room for as many values as the FMU is told.
    status(packed::get::<T>(lanes, |values| unsafe { function(component, list, n, values, count) }))
}

/// # Safety
/// As for the methods of [`Binding`]; the function takes elements of this type.
unsafe fn set_numbers<T: Element>(
    component: Component,
    function: Option<Set<T>>,
    references: &[u32],
    lanes: &mut [i64],
) -> Status {
    let Some(function) = function else { return Status::Missing };
    let (list, n, count) = (references.as_ptr(), references.len(), lanes.len());
    // SAFETY: the caller's promises; there are as many values as the FMU is told.
    status(packed::set::<T>(lanes, |values| unsafe { function(component, list, n, values, count) }))
}
