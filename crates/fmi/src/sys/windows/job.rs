//! Job objects: groups of processes that end together.

use std::io;
use std::os::windows::io::{AsRawHandle, FromRawHandle, OwnedHandle};
use std::process::Child;
use windows_sys::Win32::System::JobObjects::{
    AssignProcessToJobObject, CreateJobObjectW, JOB_OBJECT_LIMIT_DIE_ON_UNHANDLED_EXCEPTION,
    JOB_OBJECT_LIMIT_KILL_ON_JOB_CLOSE, JOB_OBJECT_LIMIT_PROCESS_MEMORY,
    JOBOBJECT_EXTENDED_LIMIT_INFORMATION, JobObjectExtendedLimitInformation, SetInformationJobObject,
    TerminateJobObject,
};
use windows_sys::Win32::System::Threading::GetCurrentProcess;

/// A process and all processes that it starts. They end when this value is dropped, and when this process
/// ends in any way.
#[derive(Debug)]
pub(crate) struct Job(OwnedHandle);

impl Job {
    /// Creates a group whose processes may use this much memory in bytes each.
    pub(crate) fn new(memory: Option<u64>) -> io::Result<Self> {
        // SAFETY: null pointers mean the default access and no name.
        let handle = unsafe { CreateJobObjectW(std::ptr::null(), std::ptr::null()) };
        if handle.is_null() {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: a new handle, which nothing else closes.
        let job = Self(unsafe { OwnedHandle::from_raw_handle(handle) });
        let mut limits = JOBOBJECT_EXTENDED_LIMIT_INFORMATION::default();
        limits.BasicLimitInformation.LimitFlags =
            JOB_OBJECT_LIMIT_KILL_ON_JOB_CLOSE | JOB_OBJECT_LIMIT_DIE_ON_UNHANDLED_EXCEPTION;
        if let Some(memory) = memory {
            limits.BasicLimitInformation.LimitFlags |= JOB_OBJECT_LIMIT_PROCESS_MEMORY;
            limits.ProcessMemoryLimit = usize::try_from(memory).unwrap_or(usize::MAX);
        }
        let size = size_of_val(&limits) as u32;
        // SAFETY: the pointer refers to a structure of the kind and size that are given.
        let is_set = unsafe {
            SetInformationJobObject(
                job.0.as_raw_handle(),
                JobObjectExtendedLimitInformation,
                (&raw const limits).cast(),
                size,
            )
        };
        if is_set == 0 { Err(io::Error::last_os_error()) } else { Ok(job) }
    }

    /// Adds a process and all processes that it will start.
    pub(crate) fn add(&self, child: &Child) -> io::Result<()> {
        // SAFETY: both handles are open.
        let is_added = unsafe { AssignProcessToJobObject(self.0.as_raw_handle(), child.as_raw_handle()) };
        if is_added == 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
    }

    /// Adds this process and all processes that it will start.
    pub(crate) fn add_this_process(&self) -> io::Result<()> {
        // SAFETY: the first handle is open, and the second one always refers to this process.
        let is_added = unsafe { AssignProcessToJobObject(self.0.as_raw_handle(), GetCurrentProcess()) };
        if is_added == 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
    }

    /// Ends all processes of the group.
    pub(crate) fn end(&self) {
        // SAFETY: the handle is open.
        let _ = unsafe { TerminateJobObject(self.0.as_raw_handle(), 1) };
    }
}
