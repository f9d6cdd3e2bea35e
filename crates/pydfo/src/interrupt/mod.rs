//! Work on other threads, Ctrl-C, logs.

pub(crate) mod logs;
pub(crate) mod threads;
pub(crate) mod watch;
