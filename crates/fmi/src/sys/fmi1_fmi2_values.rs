//! Getters and setters of FMI 1.0 and 2.0.

use super::function::{Answer, call};
use super::packed_integers::{self, Element};
use super::symbols::table;
use super::types::Component;
use super::versioned_functions::{NO_SUCH_TYPE, Values};
use crate::value::VariableKind;
use std::ffi::{c_char, c_int};

table! {
    /// Getters and setters of FMI 1.0 and 2.0. Each reference refers to one value. `B` is the Boolean type of
    /// the version.
    pub(super) struct ScalarValues<B> {
        both {
            get_real(*const u32, usize, *mut f64) = required "fmiGetReal" | "fmi2GetReal";
            set_real(*const u32, usize, *const f64) = required "fmiSetReal" | "fmi2SetReal";
            get_integer(*const u32, usize, *mut c_int) = optional "fmiGetInteger" | "fmi2GetInteger";
            set_integer(*const u32, usize, *const c_int) = optional "fmiSetInteger" | "fmi2SetInteger";
            get_boolean(*const u32, usize, *mut B) = optional "fmiGetBoolean" | "fmi2GetBoolean";
            set_boolean(*const u32, usize, *const B) = optional "fmiSetBoolean" | "fmi2SetBoolean";
            get_string(*const u32, usize, *mut *const c_char) = optional "fmiGetString" | "fmi2GetString";
            set_string(*const u32, usize, *const *const c_char) = optional "fmiSetString" | "fmi2SetString";
        }
    }
}

impl<B: Element> Values for ScalarValues<B> {
    unsafe fn get_real(&self, c: Component, refs: &[u32], values: &mut [f64]) -> Answer {
        call!(self.get_real, c, refs.as_ptr(), values.len(), values.as_mut_ptr())
    }

    unsafe fn set_real(&self, c: Component, refs: &[u32], values: &[f64]) -> Answer {
        call!(self.set_real, c, refs.as_ptr(), values.len(), values.as_ptr())
    }

    unsafe fn get_packed(&self, c: Component, kind: VariableKind, refs: &[u32], words: &mut [i64]) -> Answer {
        let (list, n) = (refs.as_ptr(), refs.len());
        match kind {
            VariableKind::Integer | VariableKind::Enumeration => {
                packed_integers::get(words, |values| call!(self.get_integer, c, list, n, values))
            }
            VariableKind::Boolean => {
                let answer =
                    packed_integers::get(words, |values| call!(self.get_boolean, c, list, n, values));
                packed_integers::normalize(words);
                answer
            }
            _ => NO_SUCH_TYPE,
        }
    }

    unsafe fn set_packed(&self, c: Component, kind: VariableKind, refs: &[u32], words: &mut [i64]) -> Answer {
        let (list, n) = (refs.as_ptr(), refs.len());
        match kind {
            VariableKind::Integer | VariableKind::Enumeration => {
                packed_integers::set(words, |values| call!(self.set_integer, c, list, n, values))
            }
            VariableKind::Boolean => {
                packed_integers::set(words, |values| call!(self.set_boolean, c, list, n, values))
            }
            _ => NO_SUCH_TYPE,
        }
    }

    unsafe fn get_string(&self, c: Component, refs: &[u32], values: &mut [*const c_char]) -> Answer {
        call!(self.get_string, c, refs.as_ptr(), values.len(), values.as_mut_ptr())
    }

    unsafe fn set_string(&self, c: Component, refs: &[u32], values: &[*const c_char]) -> Answer {
        call!(self.set_string, c, refs.as_ptr(), values.len(), values.as_ptr())
    }
}
