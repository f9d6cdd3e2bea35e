//! Work on other threads, Ctrl-C, logs.

pub(crate) mod interrupt_guard;
pub(crate) mod logs;
pub(crate) mod threads;
