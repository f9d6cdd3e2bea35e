//! Values of variables: read and set by their references, one call for all of one kind.

use super::{Fault, Outcome, RawInstance};
use crate::description::VariableKind;
use crate::sys::Call;
use std::ffi::{CStr, CString, c_char};

/// What is written on the way between the FMU and the outside.
#[derive(Default)]
pub(super) struct ValueBuffers {
    lanes: Vec<i64>,
}

impl RawInstance {
    pub(crate) fn get_real(&mut self, references: &[u32], values: &mut [f64]) -> Outcome {
        self.lengths(Call::Get(VariableKind::Real), references.len(), values.len())?;
        run!(self, Call::Get(VariableKind::Real), |b, c| b.get_real(c, references, values))
    }

    /// Values of any kind of number but `Real`, in lanes.
    pub(crate) fn get_packed(
        &mut self,
        kind: VariableKind,
        references: &[u32],
        lanes: &mut [i64],
    ) -> Outcome {
        self.lengths(Call::Get(kind), references.len(), lanes.len())?;
        run!(self, Call::Get(kind), |b, c| b.get_packed(c, kind, references, lanes))
    }

    pub(crate) fn get_string(&mut self, references: &[u32], count: usize) -> Result<Vec<String>, Fault> {
        self.lengths(Call::Get(VariableKind::String), references.len(), count)?;
        let mut pointers: Vec<*const c_char> = vec![std::ptr::null(); count];
        run!(self, Call::Get(VariableKind::String), |b, c| b.get_string(c, references, &mut pointers))?;
        Ok(pointers
            .into_iter()
            .map(|pointer| {
                if pointer.is_null() {
                    return String::new();
                }
                // SAFETY: strings an FMU returns end in NUL and stay valid until the next call on it (FMI 2.0.x,
                // section 2.1.7; the same in 1.0 and 3.0), and there is none before the copy.
                unsafe { CStr::from_ptr(pointer) }.to_string_lossy().into_owned()
            })
            .collect())
    }

    pub(crate) fn get_binary(&mut self, references: &[u32], count: usize) -> Result<Vec<Vec<u8>>, Fault> {
        let call = Call::Get(VariableKind::Binary);
        self.lengths(call, references.len(), count)?;
        let mut sizes = vec![0; count];
        let mut pointers: Vec<*const u8> = vec![std::ptr::null(); count];
        run!(self, call, |b, c| b.get_binary(c, references, &mut sizes, &mut pointers))?;
        Ok(pointers
            .into_iter()
            .zip(sizes)
            .map(|(pointer, size)| {
                if pointer.is_null() || size == 0 {
                    return Vec::new();
                }
                // SAFETY: the FMU says how many bytes there are; they stay valid until the next call on it (FMI 3.0,
                // section 2.2.6.2), and there is none before the copy.
                unsafe { std::slice::from_raw_parts(pointer, size) }.to_vec()
            })
            .collect())
    }

    pub(crate) fn set_real(&mut self, references: &[u32], values: &[f64]) -> Outcome {
        self.lengths(Call::Set(VariableKind::Real), references.len(), values.len())?;
        run!(self, Call::Set(VariableKind::Real), |b, c| b.set_real(c, references, values))
    }

    /// Values of any kind of number but `Real`, in lanes.
    pub(crate) fn set_packed(&mut self, kind: VariableKind, references: &[u32], lanes: &[i64]) -> Outcome {
        self.lengths(Call::Set(kind), references.len(), lanes.len())?;
        let mut copy = std::mem::take(&mut self.buffers.lanes);
        copy.clear();
        copy.extend_from_slice(lanes);
        let outcome = self.set_copied(kind, references, &mut copy);
        self.buffers.lanes = copy;
        outcome
    }

    fn set_copied(&mut self, kind: VariableKind, references: &[u32], lanes: &mut [i64]) -> Outcome {
        run!(self, Call::Set(kind), |b, c| b.set_packed(c, kind, references, lanes))
    }

    pub(crate) fn set_string(&mut self, references: &[u32], values: &[CString]) -> Outcome {
        self.lengths(Call::Set(VariableKind::String), references.len(), values.len())?;
        let pointers: Vec<*const c_char> = values.iter().map(|value| value.as_ptr()).collect();
        run!(self, Call::Set(VariableKind::String), |b, c| b.set_string(c, references, &pointers))
    }

    pub(crate) fn set_binary(&mut self, references: &[u32], values: &[Vec<u8>]) -> Outcome {
        let call = Call::Set(VariableKind::Binary);
        self.lengths(call, references.len(), values.len())?;
        let sizes: Vec<usize> = values.iter().map(Vec::len).collect();
        let pointers: Vec<*const u8> = values.iter().map(|value| value.as_ptr()).collect();
        run!(self, call, |b, c| b.set_binary(c, references, &sizes, &pointers))
    }
}
