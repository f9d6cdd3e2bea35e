//! Getters and setters of FMI 1.0 and 2.0.

use super::function::{Answer, call};
use super::functions::{Get, Set};
use super::packed::{self, Element};
use super::symbols::table;
use super::types::Component;
use super::version::{NO_SUCH_TYPE, Values};
use crate::value::VariableKind;
use std::ffi::{c_char, c_int};

table! {
    /// Getters and setters of FMI 1.0 and 2.0, where a reference stands for one value; `B` is the version's Boolean.
    pub(super) struct ScalarValues<B> {
        get_real: Get<f64> = required "fmiGetReal" | "fmi2GetReal";
        set_real: Set<f64> = required "fmiSetReal" | "fmi2SetReal";
        get_integer: Get<c_int> = optional "fmiGetInteger" | "fmi2GetInteger";
        set_integer: Set<c_int> = optional "fmiSetInteger" | "fmi2SetInteger";
        get_boolean: Get<B> = optional "fmiGetBoolean" | "fmi2GetBoolean";
        set_boolean: Set<B> = optional "fmiSetBoolean" | "fmi2SetBoolean";
        get_string: Get<*const c_char> = optional "fmiGetString" | "fmi2GetString";
        set_string: Set<*const c_char> = optional "fmiSetString" | "fmi2SetString";
    }
}

impl<B: Element> Values for ScalarValues<B> {
    fn getter(&self, kind: VariableKind) -> &'static str {
        match kind {
            VariableKind::Real => self.get_real.name,
            VariableKind::Boolean => self.get_boolean.name,
            VariableKind::String => self.get_string.name,
            _ => self.get_integer.name,
        }
    }

    fn setter(&self, kind: VariableKind) -> &'static str {
        match kind {
            VariableKind::Real => self.set_real.name,
            VariableKind::Boolean => self.set_boolean.name,
            VariableKind::String => self.set_string.name,
            _ => self.set_integer.name,
        }
    }

    unsafe fn get_real(&self, component: Component, references: &[u32], values: &mut [f64]) -> Answer {
        call!(self.get_real, component, references.as_ptr(), values.len(), values.as_mut_ptr())
    }

    unsafe fn set_real(&self, component: Component, references: &[u32], values: &[f64]) -> Answer {
        call!(self.set_real, component, references.as_ptr(), values.len(), values.as_ptr())
    }

    unsafe fn get_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        words: &mut [i64],
    ) -> Answer {
        let (list, n) = (references.as_ptr(), references.len());
        match kind {
            VariableKind::Integer | VariableKind::Enumeration => {
                packed::get(words, |values| call!(self.get_integer, component, list, n, values))
            }
            VariableKind::Boolean => {
                let answer = packed::get(words, |values| call!(self.get_boolean, component, list, n, values));
                packed::normalize(words);
                answer
            }
            _ => NO_SUCH_TYPE,
        }
    }

    unsafe fn set_packed(
        &self,
        component: Component,
        kind: VariableKind,
        references: &[u32],
        words: &mut [i64],
    ) -> Answer {
        let (list, n) = (references.as_ptr(), references.len());
        match kind {
            VariableKind::Integer | VariableKind::Enumeration => {
                packed::set(words, |values| call!(self.set_integer, component, list, n, values))
            }
            VariableKind::Boolean => {
                packed::set(words, |values| call!(self.set_boolean, component, list, n, values))
            }
            _ => NO_SUCH_TYPE,
        }
    }

    unsafe fn get_string(
        &self,
        component: Component,
        references: &[u32],
        values: &mut [*const c_char],
    ) -> Answer {
        call!(self.get_string, component, references.as_ptr(), values.len(), values.as_mut_ptr())
    }

    unsafe fn set_string(
        &self,
        component: Component,
        references: &[u32],
        values: &[*const c_char],
    ) -> Answer {
        call!(self.set_string, component, references.as_ptr(), values.len(), values.as_ptr())
    }
}
