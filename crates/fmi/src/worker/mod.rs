//! Processes that run FMUs. Failures of an FMU do not affect the calling process.
//!
//! An FMU is foreign machine code. It may crash, hang, leak memory, call `exit`, or keep values in static
//! variables. Callers that evaluate a model more than once use [`Workers`]. A program that calls
//! [`serve_if_worker`] first in its `main` is started once, as a template. The template loads the problem to
//! be evaluated, and forks itself whenever a worker is needed.
//!
//! A worker communicates through a socket pair (see [`Frame`] for the messages). It has the working folder
//! and the environment variables of its caller, and a separate folder for temporary files. It sets limits on
//! itself. It runs one FMU in one thread. It ends when the socket is closed, no later than the end of its
//! parent process.

#[cfg(not(unix))]
mod absent;
#[cfg(unix)]
mod end;
#[cfg(unix)]
mod folder;
#[cfg(unix)]
mod fork_server;
#[cfg(unix)]
mod fork_server_main;
mod frame;
mod handshake;
mod input_function;
mod isolation;
mod launcher;
mod limits;
mod load;
#[cfg(unix)]
mod notes;
#[cfg(unix)]
mod printed;
#[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64"), feature = "sandbox"))]
mod sandbox;
#[cfg(not(all(
    target_os = "linux",
    any(target_arch = "x86_64", target_arch = "aarch64"),
    feature = "sandbox"
)))]
#[path = "no_sandbox.rs"]
mod sandbox;
mod service;
#[cfg(unix)]
mod surroundings;
#[cfg(unix)]
mod worker_main;
#[cfg(unix)]
mod worker_process;
#[cfg(unix)]
mod workers;

#[cfg(not(unix))]
pub use absent::{ForkServer, Held, PinnedProcess, Workers, serve_if_worker, start_fork_server};
#[cfg(unix)]
pub use fork_server::{ForkServer, start_fork_server};
#[cfg(unix)]
pub use fork_server_main::serve_if_worker;
pub use frame::{Frame, FrameSize, is_in_frame};
pub use handshake::is_asked;
pub use input_function::InputFunction;
pub use isolation::{AskedProcess, Isolation, Question, Repeat};
pub use launcher::Launcher;
pub use limits::{AnswerLimits, WorkerLimits};
pub use load::Load;
pub use sandbox::check_sandbox;
pub use service::Service;
#[cfg(unix)]
pub use workers::{Held, PinnedProcess, Workers};
