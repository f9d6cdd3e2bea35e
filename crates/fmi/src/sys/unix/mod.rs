//! Processes, signals and shared memory of Unix, for worker processes and compilers.

mod compiler_limits;
mod faults;
mod fork;
mod mapping;

pub(crate) use compiler_limits::limit_compiler;
pub(crate) use faults::tell_faults;
pub(crate) use fork::{close_inherited, fork, overwrite_variable, replace_environment};
