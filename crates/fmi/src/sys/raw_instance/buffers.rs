//! Buffers for values on the way between an FMU and the outside.

use std::ffi::c_char;

/// Buffers for values passed between the FMU and its caller. The pointers are valid during a call only.
#[derive(Default)]
pub(super) struct ValueBuffers {
    pub(super) words: Vec<i64>,
    /// Of derivatives.
    pub(super) orders: Vec<i32>,
    pub(super) texts: Vec<*const c_char>,
    pub(super) sizes: Vec<usize>,
    pub(super) binaries: Vec<*const u8>,
}

impl ValueBuffers {
    /// The buffers for binary values, empty.
    pub(super) fn take_binaries(&mut self) -> (Vec<usize>, Vec<*const u8>) {
        let (mut sizes, mut pointers) = (std::mem::take(&mut self.sizes), std::mem::take(&mut self.binaries));
        sizes.clear();
        pointers.clear();
        (sizes, pointers)
    }
}
