//! Buffers for values passed between an FMU and its caller.

use std::ffi::c_char;

/// Buffers for values passed between the FMU and its caller. The pointers are valid only during a call.
#[derive(Default)]
pub(super) struct ValueBuffers {
    pub(super) words: Vec<i64>,
    /// Orders of derivatives.
    pub(super) orders: Vec<i32>,
    pub(super) texts: Vec<*const c_char>,
    pub(super) sizes: Vec<usize>,
    pub(super) binaries: Vec<*const u8>,
}

impl ValueBuffers {
    /// Returns the buffers for binary values, empty.
    pub(super) fn take_binaries(&mut self) -> (Vec<usize>, Vec<*const u8>) {
        let (mut sizes, mut pointers) = (std::mem::take(&mut self.sizes), std::mem::take(&mut self.binaries));
        sizes.clear();
        pointers.clear();
        (sizes, pointers)
    }
}
