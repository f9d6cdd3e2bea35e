//! Processes that run FMUs. Failures of an FMU do not affect the calling process.
//!
//! An FMU is foreign machine code. It may crash, hang, leak memory, call `exit`, or keep values in static
//! variables. Callers that evaluate a model more than once use [`Workers`]. A program that calls
//! [`serve_if_worker`] first in its `main` is started to serve. If the system can copy processes, it is
//! started once, loads the problem to be evaluated, and is copied whenever a worker is needed.
//!
//! A worker communicates through a channel (see [`Frame`] for the messages). It has the working folder and
//! the environment variables of its caller, and a separate folder for temporary files. It sets limits on
//! itself. It runs one FMU in one thread. It ends when the channel is closed, no later than the end of its
//! parent process.
//!
//! `platform` contains all code that depends on the operating system.

mod ahead;
mod exceptions;
mod folder;
mod frame;
mod handshake;
mod input_function;
mod isolation;
mod launcher;
mod limits;
mod load;
mod notes;
mod platform;
mod printed;
mod service;
mod surroundings;
mod windows_program;
mod worker_main;
mod worker_process;
mod workers;

pub use ahead::{StartedAhead, start_ahead};
pub use frame::{Frame, FrameSize, is_in_frame};
pub use handshake::is_worker_start;
pub use input_function::InputFunction;
pub use isolation::{Isolation, Question, Repeat, RequestedProcess};
pub use launcher::Launcher;
pub use limits::{AnswerLimits, WorkerLimits};
pub use load::Load;
pub use platform::check_sandbox;
pub use service::Service;
pub use windows_program::WindowsProgram;
pub use worker_main::serve_if_worker;
pub use workers::{Held, PinnedProcess, Workers};
