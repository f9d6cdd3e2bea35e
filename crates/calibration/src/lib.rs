//! (room being built)
#![forbid(unsafe_code)]
