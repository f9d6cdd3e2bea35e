//! Everything that worker processes need from the operating system.
//!
//! The protocol, the set of workers and the serving loop use only the items below. The modules `unix` and
//! `windows` implement them. `absent` replaces them on systems without worker processes.
//!
//! # In the process that starts workers
//!
//! - `HAS_WORKERS`: true if this system can start workers.
//! - `Starter`: starts workers with one program; used by several threads. It ends, with its workers, when it
//!   is dropped.
//!   - `start(launcher)` prepares the start of workers, without waiting. It may run
//!     [`Launcher::command`](super::launcher::Launcher::command) in advance. Returns
//!     [`FmiError::NoWorker`](crate::FmiError::NoWorker) if no worker can be started.
//!   - `load(frame)` offers a first message, for a program that can pass its effect on to later workers
//!     (`has_loaded` in [`Assigned`](super::handshake::Assigned)). It may be ignored: workers that have not
//!     loaded it receive it as a request. Called at most once, before the first worker is started.
//!   - `is_broken()`: true if it cannot start workers any more and must be replaced.
//!   - `start_worker(order, printed)` (of an `Arc`) starts a worker without waiting for it. Returns its
//!     `ProcessHandle`, its `Connection` and the [`Page`](crate::sys::Page). The worker runs the program of
//!     the starter, which calls `await_order`. Its standard output and error go to the pipe `printed`, its
//!     standard input is empty, and Ctrl-C in a terminal does not reach it. It inherits nothing else. It
//!     ends, with all processes that it has started, when this process ends in any way.
//!   - `end()` ends it with all its workers, their processes and their folders. Later calls of
//!     `ProcessHandle::kill` for these workers return immediately. A forked copy of this process ends
//!     nothing.
//! - `ProcessHandle`: a worker process.
//!   - `arrived(id)` is called once with the number of the process ([`std::process::id`]) that the worker has
//!     reported. Returns false if no worker of the starter has this number.
//!   - `has_ended_within(longest)` waits for the end of the process. True if it has ended. If the system
//!     cannot report the end, it returns after a short time: false for a zero `longest`, otherwise true.
//!   - `memory()` returns the memory in use in bytes; `None` if the system does not report it.
//!   - `kill()` ends the process and all processes that it has started, waits for its end, and removes its
//!     folder. Called at most once, also after the end of the process. Describes how the process ended, for
//!     example "segmentation fault"; `None` if that is unknown.
//!   - `unknown_end()` explains why `kill` returned `None`.
//!   - `not_started(reason)` returns the error for a worker that did not arrive. It contains the path of the
//!     program and, if the program has ended, its last output or the way it ended.
//! - `Connection`: the caller's end of a connection in both directions, for bytes. It has these functions of
//!   [`TcpStream`](std::net::TcpStream): `Read`, and `Write` for `&Connection`; `set_read_timeout` and
//!   `set_write_timeout`. After this time, reading and writing return `WouldBlock` or `TimedOut`, and may be
//!   repeated. A read returns 0 bytes, and a write returns `BrokenPipe`, if the other end is closed.
//!
//! # In the process that serves
//!
//! - `Channel`: the worker's end of the connection. `Read` and `Write` for `&Channel`; `try_clone`.
//! - `await_order(load)` is called first, while the process has one thread and has run no foreign code.
//!   Returns the worker ([`Assigned`](super::handshake::Assigned)) in each process that becomes one, and
//!   `None` in any other process, when it is not needed any more. A process that passes its state on to
//!   workers calls `load` with the frame of `Starter::load`. `load` returns true if the frame has been
//!   loaded. For the worker, it applies the [`Surroundings`](super::surroundings::Surroundings) of the order,
//!   except that temporary files go to the folder of the worker, and passes the shared memory to
//!   [`Page::tell_calls`](crate::sys::Page::tell_calls). The folder has been created for this worker.
//! - `limit_self(limits)` limits the memory of this process and disables core files. It also makes faults of
//!   the FMU record their cause in the page.
//! - `confine_self(folder)` confines this process as [`WorkerLimits::sandbox`](super::WorkerLimits::sandbox)
//!   states, except that it may write below `folder`. It cannot be undone. Called while the process has one
//!   thread.
//! - `check_sandbox()` returns [`FmiError::NoSandbox`](crate::FmiError::NoSandbox) with the reason if
//!   `confine_self` would fail on this system.
//! - `wait_until_closed(channel)` returns when the other end is closed. It reads nothing. Another thread
//!   reads and writes at the same time.
//!
//! The shared memory itself is created, mapped and unmapped in `sys`, because that needs unsafe code.
//!
//! # Without `fork`
//!
//! Windows has no `fork`, and needs no template: `Starter::load` does nothing, and `start_worker` starts
//! [`Launcher::command`](super::launcher::Launcher::command) in a group that can be ended as a whole
//! (`separate`).
//!
//! # Wine
//!
//! On Linux, a launcher with the field `wine` starts a Windows program under Wine, also without a template.

#[cfg(not(any(unix, windows)))]
mod absent;
#[cfg(target_os = "linux")]
mod linux;
#[cfg(any(windows, target_os = "linux"))]
mod order;
#[cfg_attr(
    not(all(
        target_os = "linux",
        any(target_arch = "x86_64", target_arch = "aarch64"),
        feature = "sandbox"
    )),
    path = "no_sandbox.rs"
)]
mod sandbox;
#[cfg(any(windows, target_os = "linux"))]
mod separate;
#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;
#[cfg(target_os = "linux")]
mod wine;

#[cfg(not(any(unix, windows)))]
use absent as system;
#[cfg(target_os = "linux")]
use linux as system;
#[cfg(all(unix, not(target_os = "linux")))]
use unix as system;
#[cfg(windows)]
use windows as system;

pub use sandbox::check_sandbox;
pub(super) use sandbox::confine_self;
#[cfg(windows)]
pub(super) use separate::{ProcessHandle, Starter};
pub(super) use system::{Channel, Connection, HAS_WORKERS, await_order, limit_self, wait_until_closed};
#[cfg(not(windows))]
pub(super) use system::{ProcessHandle, Starter};
