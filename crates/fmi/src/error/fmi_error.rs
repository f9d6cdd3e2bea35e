//! The error type of this crate. Each error contains its location and the relevant numbers.

use super::entry_problem::EntryProblem;
use super::failure::CallFailure;
use super::worker_failure::{ReportedError, ReportedErrorKind, WorkerEnd};
use crate::value::{Value, VariableKind};
use base::Number;
use std::io;
use std::path::{Path, PathBuf};

/// Result of an operation that may fail with an [`FmiError`].
pub type Result<T, E = FmiError> = std::result::Result<T, E>;

/// Reason why an FMU could not be opened, read, built or run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FmiError {
    /// Opening, unpacking or compiling was cancelled.
    #[error("cancelled")]
    Cancelled,
    /// The initial events, without a simulation, were cancelled.
    #[error(transparent)]
    Stopped(#[from] ode::Stopped),
    /// Not enough memory is available for a large object; nothing was allocated.
    #[error("{what} requires {} MB of memory, more than is available", bytes / 1_000_000)]
    Memory {
        /// Object to be allocated, with its dimensions.
        what: String,
        /// Size in bytes.
        bytes: u64,
    },
    /// An error in a worker process.
    #[error("{}", .0.message)]
    ReportedError(Box<ReportedError>),
    /// A worker process ended during a request.
    #[error("{0}")]
    WorkerEnded(Box<WorkerEnd>),
    /// No worker process can be started.
    #[error(
        "cannot start a worker process for the FMU ({reason}). To run the FMU in this process, set \
             isolation = \"none\""
    )]
    NoWorker {
        /// Reason.
        reason: String,
    },
    /// The model has a library that only another program can run, and that program cannot be started.
    #[error("the model has {models}. {reason}")]
    NoWindowsProgram {
        /// What the model has, and how it runs.
        models: &'static str,
        /// What is missing, and how to provide it.
        reason: String,
    },
    /// Worker processes cannot be confined, or none can be started.
    #[error("sandbox: {reason}. Run the model in a container, or without a sandbox if you trust it")]
    NoSandbox {
        /// Reason.
        reason: String,
    },
    /// An operation of the operating system failed.
    #[error("cannot {action} {}: {source}{}", path.display(), limit_of_files(source.raw_os_error()))]
    Io {
        /// Action that failed, as a verb phrase: "open", "create".
        action: &'static str,
        /// File or folder.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// Only the description of the FMU is available; see [`Fmu::absent`](crate::Fmu::absent).
    #[error("the FMU {} is required with its original content (SHA-256 {content_hash}); {reason}", path.display())]
    Absent {
        /// Former path of the FMU.
        path: PathBuf,
        /// SHA-256 of its content.
        content_hash: String,
        /// Reason why the FMU is unavailable.
        reason: String,
    },
    /// The file is not a zip archive, or it is damaged.
    #[error("{} is not a usable FMU archive: {reason}", path.display())]
    BadArchive {
        /// Path of the archive.
        path: PathBuf,
        /// Defect of the archive.
        reason: String,
    },
    /// An entry of the archive is not allowed in an FMU; nothing was unpacked.
    #[error("{}: entry \"{}\" {problem}", path.display(), entry.escape_debug())]
    BadEntry {
        /// Path of the archive.
        path: PathBuf,
        /// Name of the entry as stored.
        entry: String,
        /// Defect of the entry.
        problem: EntryProblem,
    },
    /// The archive as a whole exceeds a limit of [`ArchiveLimits`](crate::archive::ArchiveLimits).
    #[error("{}: {found} {what}, more than the limit of {limit}", path.display())]
    ArchiveLimit {
        /// Path of the archive.
        path: PathBuf,
        /// Counted quantity.
        what: &'static str,
        /// Count found (lower bound).
        found: u64,
        /// Maximum count.
        limit: u64,
    },
    /// The root contains no `modelDescription.xml`.
    #[error("{} has no modelDescription.xml at its root{}", path.display(), hint.as_deref().unwrap_or(""))]
    NoModelDescription {
        /// The archive or folder.
        path: PathBuf,
        /// Location of another `modelDescription.xml`, as the rest of the sentence.
        hint: Option<String>,
    },
    /// `modelDescription.xml` (or `buildDescription.xml`) cannot be read.
    #[error("{file}, line {line}: {message}")]
    Description {
        /// Name of the file.
        file: &'static str,
        /// Line in the file, counted from 1.
        line: u32,
        /// Description of the defect.
        message: String,
    },
    /// The version of the standard is unknown.
    #[error("FMI version {0} is not supported; expected 1.0, 2.0 or 3.0")]
    UnknownVersion(String),
    /// `modelDescription.xml` is well formed but departs from the standard, and strict reading was requested.
    #[error(
        "the model description violates the FMI standard in {count} places; the first is in line {line}: \
         {first}"
    )]
    NotConforming {
        /// Number of departures.
        count: usize,
        /// Line of the first departure.
        line: u32,
        /// First departure.
        first: String,
    },
    /// The FMU has no sources from which a library can be built.
    #[error("no sources for \"{model_identifier}\": {reason}")]
    NoSources {
        /// Model identifier of the interface.
        model_identifier: String,
        /// Reason, with the missing sources.
        reason: String,
    },
    /// No C compiler was found.
    #[error(
        "no C compiler found to build \"{model_identifier}\" (tried {tried}); install one or set {variable}"
    )]
    NoCompiler {
        /// Model identifier of the interface.
        model_identifier: String,
        /// Compiler names tried.
        tried: String,
        /// Environment variable for the name of another compiler.
        variable: &'static str,
    },
    /// The C compiler rejected the sources.
    #[error("building \"{model_identifier}\" failed ({status}): {command}\n{output}")]
    CompileFailed {
        /// Model identifier of the interface.
        model_identifier: String,
        /// The command.
        command: String,
        /// Exit status of the compiler.
        status: String,
        /// Last lines of the compiler's output.
        output: String,
    },
    /// The FMU has no binary for this platform.
    #[error("{} has no binary for this platform ({wanted}); available: {present}", path.display())]
    NoBinary {
        /// Path of the FMU.
        path: PathBuf,
        /// Searched folders, in order.
        wanted: String,
        /// Folders in the FMU (with their machine types).
        present: String,
    },
    /// The FMU does not support the requested interface.
    #[error("{model} does not support {wanted}; it supports {offered}")]
    NotOffered {
        /// Name of the model.
        model: String,
        /// Requested interface.
        wanted: String,
        /// Interfaces that the FMU supports.
        offered: String,
    },
    /// The dynamic loader rejected the library.
    #[error("cannot load {}: {message}{}", library.display(), limit_of_files(message.contains(TOO_MANY_FILES).then_some(EMFILE)))]
    LoadFailed {
        /// Path of the library.
        library: PathBuf,
        /// Message of the loader.
        message: String,
    },
    /// The library lacks a function that FMI requires.
    #[error("{} does not export the function {symbol}, which the FMI standard requires", library.display())]
    MissingSymbol {
        /// Path of the library.
        library: PathBuf,
        /// Name of the function.
        symbol: &'static str,
    },
    /// A call requires an optional function that the library does not have.
    #[error("the FMU does not implement the function {0}")]
    MissingFunction(&'static str),
    /// A call of the loaded library of the instance, with this path, returned `Fatal`. The standard forbids
    /// all further calls of the library.
    #[error("{} is unusable because one of its calls returned fatal; new instances and simulations use a \
             newly loaded copy", .0.display())]
    LibraryUnusable(PathBuf),
    /// A call into the FMU failed.
    #[error(transparent)]
    Call(Box<CallFailure>),
    /// A call of an instance driven by the user, after this function had returned `Error`; the FMU was not
    /// called.
    #[error("{0} returned error, so the instance can only be reset, freed, or restored to a saved state")]
    AfterError(&'static str),
    /// Slices differ in length, or a vector does not have the size of the model; the FMU was not called.
    #[error("{call}: expected {expected} values, got {found}")]
    Length {
        /// Name of the call.
        call: &'static str,
        /// Expected length.
        expected: usize,
        /// Length given.
        found: usize,
    },
    /// The FMU reports a value with more bytes than its variable allows or than memory can hold.
    #[error(
        "{call}: the FMU returned a value of {size} bytes, which exceeds its maxSize or the available \
             memory"
    )]
    TooLarge {
        /// Name of the call.
        call: &'static str,
        /// Size that the FMU reports.
        size: usize,
    },
    /// The model repeatedly ended a step at its start time, without an event.
    #[error("{call} returned early at t = {time} without advancing and without an event", time = Number(*.time))]
    NoProgress {
        /// Name of the call.
        call: &'static str,
        /// Current time of the model.
        time: f64,
    },
    /// The event iteration did not converge.
    #[error("the event iteration at t = {time} did not end within {limit} iterations", time = Number(*.time))]
    EventIteration {
        /// Time of the event.
        time: f64,
        /// Maximum number of rounds.
        limit: u32,
    },
    /// A call of an instance driven by the user is not allowed in the current phase.
    #[error("{call} requires the phase {needed}, but the instance is in the phase {phase}")]
    WrongPhase {
        /// Name of the call.
        call: &'static str,
        /// Phase of the instance.
        phase: &'static str,
        /// Phases that allow the call.
        needed: &'static str,
    },
    /// A call of a freed instance that the user drives. Contains the reason.
    #[error("{0}")]
    Freed(&'static str),
    /// A saved state belongs to another instance, another FMU or another interface.
    #[error("the saved state belongs to another instance")]
    ForeignState,
    /// A saved state belongs to another phase. Restoring it would contradict the type of the instance.
    #[error("the state was saved in {saved}, but the instance is in {now}")]
    StateOfAnotherPhase {
        /// Phase of the saved state.
        saved: &'static str,
        /// Phase of the instance.
        now: &'static str,
    },
    /// The model has no variable of this name.
    #[error("the model has no variable \"{name}\"{}", did_you_mean(nearest))]
    UnknownVariable {
        /// Requested name.
        name: String,
        /// Similar names, the most similar first.
        nearest: Vec<String>,
    },
    /// No variable of type Real has the value reference; the FMU was not called.
    #[error("{call}: the model has no variable of type Real with the value reference {reference}")]
    UnknownReference {
        /// Name of the call.
        call: &'static str,
        /// Value reference.
        reference: u32,
    },
    /// The value has the wrong type.
    #[error("{name}: expected a value of type {kind}, got {value} ({given})")]
    WrongType {
        /// Name of the variable.
        name: String,
        /// Type of the variable.
        kind: VariableKind,
        /// The value.
        value: Value,
        /// Type of the value.
        given: &'static str,
    },
    /// A number is out of range for the type of its variable.
    #[error("{name} = {value} is out of range for type {kind} ({} bits, from {} to {})", bits(range.0, range.1), range.0, range.1)]
    OutOfRange {
        /// Name of the variable.
        name: String,
        /// Type of the variable.
        kind: VariableKind,
        /// The value.
        value: Value,
        /// Smallest and largest value of the type.
        range: (i128, i128),
    },
    /// The variable cannot be set, or cannot be set in the current phase.
    #[error("{name} cannot be set: {reason}")]
    NotSettable {
        /// Name of the variable.
        name: String,
        /// Reason.
        reason: &'static str,
    },
    /// A parameter does not keep its assigned value, because the model overrides it.
    #[error(
        "{name} was set to {given}, but is {found} after the initialization. The model computes the value \
         itself or ignores the given value",
        given = Number(*.given), found = Number(*.found)
    )]
    NotTaken {
        /// Name of the parameter.
        name: String,
        /// Assigned value.
        given: f64,
        /// Value after the initialization.
        found: f64,
    },
    /// A variable does not have the requested value at the start of a simulation.
    #[error(
        "{name} starts at {found} instead of {given}, because the initialization computes it. In model \
         exchange (kind = \"ME\"), initial states are set after the initialization; otherwise set the \
         parameters from which the model computes it",
        given = Number(*.given), found = Number(*.found)
    )]
    StateNotTaken {
        /// Name of the variable.
        name: String,
        /// Requested value.
        given: f64,
        /// Value after the initialization.
        found: f64,
    },
    /// The model does not come to rest before a simulation that starts from steady state.
    #[error("the model does not come to rest at the inputs of the start: {reason}")]
    NotSteady {
        /// State that moves the most, its derivative, and the limit; or the error of the approach.
        reason: String,
    },
    /// A value is NaN or infinite, but must be finite.
    #[error("{name}: expected a finite number, got {value}", value = Number(*.value))]
    NotFinite {
        /// Name to which the value was assigned.
        name: String,
        /// The value.
        value: f64,
    },
    /// A variable is NaN or infinite, but the continuous state that it represents is finite.
    #[error("{name} is {value}, although the continuous state that it represents according to the model \
             description is finite", value = Number(*.value))]
    StateNotFinite {
        /// Name of the variable.
        name: String,
        /// The value.
        value: f64,
    },
    /// The variable cannot be an output.
    #[error("{name} cannot be an output: {reason}")]
    NotAnOutput {
        /// Name of the variable.
        name: String,
        /// Reason.
        reason: &'static str,
    },
    /// The input cannot be used.
    #[error("input {name}: {problem}")]
    BadInput {
        /// Name of the variable, or a description of the input.
        name: String,
        /// The problem, with numbers.
        problem: String,
    },
    /// Settings of a simulation are invalid; contains the problem, with numbers.
    #[error("{0}")]
    BadSetting(String),
    /// An option of the integration method is invalid.
    #[error(transparent)]
    Options(#[from] ode::OptionsError),
    /// A simulation started but failed.
    #[error(transparent)]
    Simulation(Box<ode::SimulationError>),
    /// The result does not contain this variable.
    #[error("\"{name}\" is not in the result; available: {present}")]
    NotInResult {
        /// Requested name.
        name: String,
        /// Names in the result.
        present: String,
    },
    /// The folder cannot be packed into an FMU.
    #[error("cannot pack {}: {reason}", folder.display())]
    CannotPack {
        /// Path of the folder.
        folder: PathBuf,
        /// Reason.
        reason: String,
    },
}

/// Returns the width of an integer type in bits.
fn bits(least: i128, most: i128) -> u32 {
    i128::BITS - (most - least).leading_zeros()
}

impl FmiError {
    /// True if the cause is outside the model: a file, memory, a compiler, the loader or a process. Such an
    /// error does not depend on the values of the simulation.
    pub fn is_of_machine(&self) -> bool {
        matches!(
            self,
            FmiError::Memory { .. }
                | FmiError::NoWorker { .. }
                | FmiError::NoWindowsProgram { .. }
                | FmiError::NoSandbox { .. }
                | FmiError::Io { .. }
                | FmiError::Absent { .. }
                | FmiError::BadArchive { .. }
                | FmiError::BadEntry { .. }
                | FmiError::ArchiveLimit { .. }
                | FmiError::NoSources { .. }
                | FmiError::NoCompiler { .. }
                | FmiError::CompileFailed { .. }
                | FmiError::NoBinary { .. }
                | FmiError::LoadFailed { .. }
                | FmiError::MissingSymbol { .. }
        )
    }

    /// Converts the error for another process: its kind and the data to be sent.
    pub fn reported(&self) -> ReportedError {
        let (kind, time) = match self {
            FmiError::ReportedError(reported) => return (**reported).clone(),
            FmiError::Memory { .. } => (ReportedErrorKind::Memory, None),
            FmiError::Io { source, .. } if source.kind() == io::ErrorKind::NotFound => {
                (ReportedErrorKind::NoFile, None)
            }
            FmiError::Absent { .. } => (ReportedErrorKind::NoFile, None),
            FmiError::Cancelled => (ReportedErrorKind::Cancelled, None),
            FmiError::WorkerEnded(end) => (ReportedErrorKind::Simulation, end.time),
            FmiError::UnknownVariable { .. } | FmiError::NotInResult { .. } => {
                (ReportedErrorKind::UnknownVariable, None)
            }
            FmiError::WrongType { .. } => (ReportedErrorKind::WrongType, None),
            FmiError::WrongPhase { .. }
            | FmiError::Freed(_)
            | FmiError::NotSettable { .. }
            | FmiError::OutOfRange { .. }
            | FmiError::NotFinite { .. }
            | FmiError::NotAnOutput { .. }
            | FmiError::BadInput { .. }
            | FmiError::BadSetting(_)
            | FmiError::Options(_) => (ReportedErrorKind::Setting, None),
            FmiError::Call(failure) if failure.call.contains("nstantiate") => {
                (ReportedErrorKind::Model, failure.time)
            }
            FmiError::Call(failure) => (ReportedErrorKind::Simulation, failure.time),
            FmiError::EventIteration { time, .. } => (ReportedErrorKind::Simulation, Some(*time)),
            FmiError::Simulation(error) if matches!(error.kind, ode::ErrorKind::TooLargeForDense { .. }) => {
                (ReportedErrorKind::Memory, None)
            }
            FmiError::Simulation(error) => (ReportedErrorKind::Simulation, Some(error.time)),
            _ => (ReportedErrorKind::Model, None),
        };
        let failure = self.call_failure();
        ReportedError {
            message: self.to_string(),
            kind,
            time,
            status: failure.map(|failure| failure.status.to_string()),
            log: failure.map(|f| f.log.iter().map(ToString::to_string).collect()).unwrap_or_default(),
        }
    }

    /// Returns the failed call that caused this error, if any.
    pub fn call_failure(&self) -> Option<&CallFailure> {
        match self {
            FmiError::Call(failure) => Some(failure),
            FmiError::Simulation(error) => match &error.kind {
                ode::ErrorKind::Model(inner) => {
                    inner.downcast_ref::<FmiError>().and_then(FmiError::call_failure)
                }
                _ => None,
            },
            _ => None,
        }
    }

    /// Returns the error for a library file that has been modified since it was loaded.
    pub(crate) fn written_over(library: &Path) -> FmiError {
        let message = "the file has been modified since this process loaded it. Restart the process, or use \
                       a separate file for the new version";
        FmiError::LoadFailed { library: library.to_owned(), message: message.to_owned() }
    }

    /// Returns the error for an unusable archive, or a folder used as one.
    pub(crate) fn bad_archive(path: impl Into<PathBuf>, reason: impl Into<String>) -> FmiError {
        FmiError::BadArchive { path: path.into(), reason: reason.into() }
    }

    /// Returns a function that wraps an error of the operating system, with the action and its path.
    pub fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> FmiError {
        let path = path.into();
        move |source| FmiError::Io { action, path, source }
    }
}

/// Error number of the system for too many open files in a process, and the corresponding message of the C
/// library.
const EMFILE: i32 = 24;
const TOO_MANY_FILES: &str = "Too many open files";

/// Returns the limit on the number of open files of this process. Returns `None` if the system does not
/// report a limit or has none.
fn open_files_limit() -> Option<u64> {
    #[cfg(unix)]
    return rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
    #[cfg(not(unix))]
    None
}

/// Returns an addition to an error message if the process has reached its limit of open files.
fn limit_of_files(error: Option<i32>) -> String {
    match open_files_limit() {
        Some(limit) if error == Some(EMFILE) => {
            format!("; the limit is {limit} open files per process (ulimit -n). Close unused models")
        }
        _ => String::new(),
    }
}

/// Returns the end of the message about an unknown name.
fn did_you_mean(nearest: &[String]) -> String {
    if nearest.is_empty() { String::new() } else { format!("; did you mean {}?", nearest.join(", ")) }
}
