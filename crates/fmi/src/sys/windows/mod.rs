//! Processes, job objects and shared memory of Windows, for worker processes.

mod job;
mod mapping;
mod process;

pub(crate) use job::Job;
pub(crate) use process::{
    end_on_errors, forget_variable, give_handle, give_socket, memory_of, set_variable, take_handle,
    take_socket,
};
