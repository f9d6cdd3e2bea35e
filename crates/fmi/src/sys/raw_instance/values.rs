//! Values of variables: read and set by their references, one call for all values of one type.

use super::component::RawInstance;
use super::fault::{Fault, Outcome};
use crate::description::VariableKind;
use crate::platform::memory;
use std::ffi::{CStr, CString};

impl RawInstance {
    pub(crate) fn get_real(&mut self, references: &[u32], values: &mut [f64]) -> Outcome {
        self.lengths(references.len(), values.len())?;
        run!(self, |library, c| library.values.get_real(c, references, values))
    }

    pub(crate) fn set_real(&mut self, references: &[u32], values: &[f64]) -> Outcome {
        self.lengths(references.len(), values.len())?;
        run!(self, |library, c| library.values.set_real(c, references, values))
    }

    /// Reads values of any numeric type except `Real`, as 64-bit words.
    pub(crate) fn get_packed(
        &mut self,
        kind: VariableKind,
        references: &[u32],
        words: &mut [i64],
    ) -> Outcome {
        self.lengths(references.len(), words.len())?;
        run!(self, |library, c| library.values.get_packed(c, kind, references, words))
    }

    /// Sets values of any numeric type except `Real`, from 64-bit words.
    pub(crate) fn set_packed(&mut self, kind: VariableKind, references: &[u32], words: &[i64]) -> Outcome {
        self.lengths(references.len(), words.len())?;
        let mut copy = std::mem::take(&mut self.buffers.words);
        copy.clear();
        copy.extend_from_slice(words);
        let outcome = run!(self, |library, c| library.values.set_packed(c, kind, references, &mut copy));
        self.buffers.words = copy;
        outcome
    }

    /// Sets values of type `Float32`. The numbers are rounded to single precision.
    pub(crate) fn set_singles(&mut self, references: &[u32], values: &[f64]) -> Outcome {
        self.lengths(references.len(), values.len())?;
        let mut words = std::mem::take(&mut self.buffers.words);
        words.clear();
        words.extend(values.iter().map(|value| f64::from(*value as f32).to_bits() as i64));
        let kind = VariableKind::Float32;
        let outcome = run!(self, |library, c| library.values.set_packed(c, kind, references, &mut words));
        self.buffers.words = words;
        outcome
    }

    /// Reads `count` strings and passes each to `take`. Invalid UTF-8 is replaced.
    pub(crate) fn get_string(
        &mut self,
        references: &[u32],
        count: usize,
        mut take: impl FnMut(&str),
    ) -> Outcome {
        self.lengths(references.len(), count)?;
        let mut pointers = std::mem::take(&mut self.buffers.texts);
        pointers.clear();
        pointers.resize(count, std::ptr::null());
        let outcome = run!(self, |library, c| library.values.get_string(c, references, &mut pointers));
        if outcome.is_ok() {
            for pointer in &pointers {
                if pointer.is_null() {
                    take("");
                    continue;
                }
                // SAFETY: strings returned by an FMU are NUL-terminated and stay valid until its next call
                // (FMI 2.0.x, section 2.1.7; also 1.0 and 3.0). There is no call while this instance is
                // borrowed.
                take(&unsafe { CStr::from_ptr(*pointer) }.to_string_lossy());
            }
        }
        self.buffers.texts = pointers;
        outcome
    }

    pub(crate) fn set_string(&mut self, references: &[u32], values: &[CString]) -> Outcome {
        self.lengths(references.len(), values.len())?;
        let mut pointers = std::mem::take(&mut self.buffers.texts);
        pointers.clear();
        pointers.extend(values.iter().map(|value| value.as_ptr()));
        let outcome = run!(self, |library, c| library.values.set_string(c, references, &pointers));
        self.buffers.texts = pointers;
        outcome
    }

    /// Reads `count` binary values and passes each to `take`, which may copy it. `most` returns the maximum
    /// size of each value in bytes. A value that is larger, or larger than the available memory, is an error
    /// before any value is read.
    pub(crate) fn get_binary(
        &mut self,
        references: &[u32],
        count: usize,
        most: impl Fn(usize) -> Option<usize>,
        mut take: impl FnMut(&[u8]),
    ) -> Outcome {
        self.lengths(references.len(), count)?;
        let (mut sizes, mut pointers) = self.buffers.take_binaries();
        sizes.resize(count, 0);
        pointers.resize(count, std::ptr::null());
        let read =
            run!(self, |library, c| library.values.get_binary(c, references, &mut sizes, &mut pointers));
        let is_too_large = |(k, size): (usize, &usize)| {
            let is_there = || memory::check(String::new, *size as u64).is_ok();
            isize::try_from(*size).is_err() || most(k).is_some_and(|most| *size > most) || !is_there()
        };
        let outcome = read.and_then(|()| {
            match sizes.iter().enumerate().position(|(k, size)| is_too_large((k, size))) {
                Some(k) => Err(Fault::TooLarge { call: "fmi3GetBinary", size: sizes[k] }),
                None => Ok(()),
            }
        });
        for (pointer, size) in pointers.iter().zip(&sizes).filter(|_| outcome.is_ok()) {
            if pointer.is_null() || *size == 0 {
                take(&[]);
                continue;
            }
            // SAFETY: the FMU reports the number of bytes, which is at most the maximum length of a slice.
            // The bytes stay valid until the next call of the FMU (FMI 3.0, section 2.2.6.2), and there is no
            // call while this instance is borrowed.
            take(unsafe { std::slice::from_raw_parts(*pointer, *size) });
        }
        (self.buffers.sizes, self.buffers.binaries) = (sizes, pointers);
        outcome
    }

    pub(crate) fn set_binary(&mut self, references: &[u32], values: &[Vec<u8>]) -> Outcome {
        self.lengths(references.len(), values.len())?;
        let (mut sizes, mut pointers) = self.buffers.take_binaries();
        sizes.extend(values.iter().map(Vec::len));
        pointers.extend(values.iter().map(|value| value.as_ptr()));
        let outcome = run!(self, |library, c| library.values.set_binary(c, references, &sizes, &pointers));
        (self.buffers.sizes, self.buffers.binaries) = (sizes, pointers);
        outcome
    }
}
