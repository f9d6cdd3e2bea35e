//! Ctrl-C, logs, locks.

pub(crate) mod interrupt_guard;
pub(crate) mod lock;
pub(crate) mod logs;
