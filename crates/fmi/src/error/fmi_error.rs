//! The error type of this crate; each error names the place and the numbers.

use super::entry_problem::EntryProblem;
use super::failure::CallFailure;
use super::worker_failure::{ReportedError, ReportedErrorKind, WorkerEnd};
use crate::value::{Value, VariableKind};
use base::Number;
use std::io;
use std::path::{Path, PathBuf};

/// Outcome of what may fail with an [`FmiError`].
pub type Result<T, E = FmiError> = std::result::Result<T, E>;

/// Why an FMU could not be opened, understood, built or run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FmiError {
    /// Opening, unpacking or compiling was ended from outside.
    #[error("cancelled")]
    Cancelled,
    /// The initial events, without a simulation, were ended from outside.
    #[error(transparent)]
    Stopped(#[from] ode::Stopped),
    /// There is not enough memory for something large; nothing was taken.
    #[error("{what} would take {} MB of memory, more than is available", bytes / 1_000_000)]
    Memory {
        /// Object to be allocated, with its numbers.
        what: String,
        /// Size in bytes.
        bytes: u64,
    },
    /// An error in a worker process.
    #[error("{}", .0.message)]
    ReportedError(Box<ReportedError>),
    /// A worker process ended in the middle of what it was asked for.
    #[error("{0}")]
    WorkerEnded(Box<WorkerEnd>),
    /// No worker process can be started.
    #[error("no process can be started for the FMU ({reason}); isolation = \"none\" runs it in this one")]
    NoWorker {
        /// Why.
        reason: String,
    },
    /// Worker processes cannot be confined, or none can be started.
    #[error("sandbox: {reason}. Run the model in a container, or without a sandbox if you trust it")]
    NoSandbox {
        /// Why.
        reason: String,
    },
    /// The operating system refused something.
    #[error("cannot {action} {}: {source}{}", path.display(), limit_of_files(source.raw_os_error()))]
    Io {
        /// Action that failed, as a verb phrase: "open", "create".
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// Of the FMU only its description is at hand; see [`Fmu::absent`](crate::Fmu::absent).
    #[error("the FMU {} is needed with the content that it had (SHA-256 {content_hash}); {reason}", path.display())]
    Absent {
        /// Where it was.
        path: PathBuf,
        /// SHA-256 of its content.
        content_hash: String,
        /// Why it is not at hand.
        reason: String,
    },
    /// The file is not a zip archive, or it is damaged.
    #[error("{} is not a usable FMU archive: {reason}", path.display())]
    BadArchive {
        /// The archive.
        path: PathBuf,
        /// Defect of the archive.
        reason: String,
    },
    /// An entry of the archive is not what an FMU may contain; nothing of it was unpacked.
    #[error("{}: entry \"{}\" {problem}", path.display(), entry.escape_debug())]
    BadEntry {
        /// The archive.
        path: PathBuf,
        /// Name of the entry as stored.
        entry: String,
        /// Defect of the entry.
        problem: EntryProblem,
    },
    /// The archive as a whole exceeds a limit of [`ArchiveLimits`](crate::archive::ArchiveLimits).
    #[error("{}: {found} {what}, more than the limit of {limit}", path.display())]
    ArchiveLimit {
        /// The archive.
        path: PathBuf,
        /// Quantity counted.
        what: &'static str,
        /// Count found (at least).
        found: u64,
        /// Largest count allowed.
        limit: u64,
    },
    /// There is no `modelDescription.xml` at the root.
    #[error("{} has no modelDescription.xml at its root{}", path.display(), hint.as_deref().unwrap_or(""))]
    NoModelDescription {
        /// The archive or folder.
        path: PathBuf,
        /// Where one was found instead, as the rest of the sentence.
        hint: Option<String>,
    },
    /// `modelDescription.xml` (or `buildDescription.xml`) cannot be read as what it should be.
    #[error("{file}, line {line}: {message}")]
    Description {
        /// Name of the file.
        file: &'static str,
        /// Line in the file, counted from 1.
        line: u32,
        /// Description of the defect.
        message: String,
    },
    /// A version of the standard that is unknown.
    #[error("the FMU follows FMI {0}; known are 1.0, 2.0 and 3.0")]
    UnknownVersion(String),
    /// `modelDescription.xml` is well formed but leaves the standard, and strict reading was asked for.
    #[error(
        "the model description departs from the FMI standard in {count} places, first (line {line}): {first}"
    )]
    NotConforming {
        /// Number of quirks.
        count: usize,
        /// Line of the first one.
        line: u32,
        /// The first one.
        first: String,
    },
    /// The FMU has no sources to build a library from.
    #[error("no sources for \"{model_identifier}\": {reason}")]
    NoSources {
        /// Model identifier of the interface.
        model_identifier: String,
        /// Sources that were looked for.
        reason: String,
    },
    /// No C compiler was found.
    #[error("no C compiler found to build \"{model_identifier}\" (tried {tried}); install one or set CC")]
    NoCompiler {
        /// Model identifier of the interface.
        model_identifier: String,
        /// The names tried.
        tried: String,
    },
    /// The C compiler refused the sources.
    #[error("building \"{model_identifier}\" failed ({status}): {command}\n{output}")]
    CompileFailed {
        /// Model identifier of the interface.
        model_identifier: String,
        /// The command.
        command: String,
        /// Exit status of the compiler.
        status: String,
        /// The last lines it wrote.
        output: String,
    },
    /// No binary for this platform.
    #[error("{} has no binary for this platform ({wanted}); present: {present}", path.display())]
    NoBinary {
        /// The FMU.
        path: PathBuf,
        /// The folders looked for, in order.
        wanted: String,
        /// The folders (with their machine types) present.
        present: String,
    },
    /// The FMU cannot be run in the way asked for.
    #[error("{model} offers no {wanted}; it offers {offered}")]
    NotOffered {
        /// Name of the model.
        model: String,
        /// The interface asked for.
        wanted: String,
        /// The interfaces there are.
        offered: String,
    },
    /// The dynamic loader refused the library; its own words.
    #[error("cannot load {}: {message}{}", library.display(), limit_of_files(message.contains(TOO_MANY_FILES).then_some(EMFILE)))]
    LoadFailed {
        /// The library.
        library: PathBuf,
        /// The loader's message.
        message: String,
    },
    /// The library lacks a function that FMI demands.
    #[error("{} has no function {symbol}, which the standard demands", library.display())]
    MissingSymbol {
        /// The library.
        library: PathBuf,
        /// The function.
        symbol: &'static str,
    },
    /// An optional function was called that the library does not have.
    #[error("the FMU has no function {0}")]
    MissingFunction(&'static str),
    /// A call of the instance's loaded library, of this file, returned `Fatal`: the standard lets nothing of
    /// it be called after that.
    #[error("{} is unusable since one of its calls returned fatal; new instances and simulations have a newly loaded copy", .0.display())]
    LibraryUnusable(PathBuf),
    /// A call into the FMU failed.
    #[error(transparent)]
    Call(Box<CallFailure>),
    /// A call of an instance made by hand after this one had returned `Error`; the FMU was not called.
    #[error(
        "after {0} returned error nothing is left but to reset the instance, restore a saved state or free it"
    )]
    AfterError(&'static str),
    /// Slices of different lengths, or a vector that has not the model's size; the FMU was not called.
    #[error("{call}: {found} values where {expected} are needed")]
    Length {
        /// The call.
        call: &'static str,
        /// Length needed.
        expected: usize,
        /// Length given.
        found: usize,
    },
    /// The FMU says that a value has more bytes than its variable may have, or than there is memory for.
    #[error("{call}: the FMU has a value of {size} bytes, more than its maxSize or than memory can hold")]
    TooLarge {
        /// The call.
        call: &'static str,
        /// The size it says.
        size: usize,
    },
    /// A step that the model ended where it began, again and again, without an event.
    #[error("{call} returned early at t = {time} without having gone on, and without an event", time = Number(*.time))]
    NoProgress {
        /// The call.
        call: &'static str,
        /// Time at which the model stands.
        time: f64,
    },
    /// The discrete states do not settle.
    #[error("the event iteration at t = {time} did not end after {limit} rounds", time = Number(*.time))]
    EventIteration {
        /// Time of the event.
        time: f64,
        /// Rounds allowed.
        limit: u32,
    },
    /// A call of an instance driven by hand that its phase does not have.
    #[error("{call} is called in the phase {needed}; the instance is in the phase {phase}")]
    WrongPhase {
        /// The call.
        call: &'static str,
        /// The phase of the instance.
        phase: &'static str,
        /// The phases that have the call.
        needed: &'static str,
    },
    /// A call of an instance driven by hand that was freed, with the reason.
    #[error("{0}")]
    Freed(&'static str),
    /// A saved state of another instance, or written by an instance of another FMU or of another kind.
    #[error("the saved state belongs to another instance")]
    ForeignState,
    /// A saved state of another phase: the instance would be in one and its type would say another.
    #[error("the state was saved in {saved}, the instance is in {now}")]
    StateOfAnotherPhase {
        /// The phase of the saved state.
        saved: &'static str,
        /// The phase of the instance.
        now: &'static str,
    },
    /// The model has no variable of this name.
    #[error("the model has no variable \"{name}\"{}", did_you_mean(nearest))]
    UnknownVariable {
        /// The name.
        name: String,
        /// Names that resemble it, the most similar first.
        nearest: Vec<String>,
    },
    /// A value reference that no variable of type Real has; the FMU was not called.
    #[error("{call}: the model has no variable of type Real with the value reference {reference}")]
    UnknownReference {
        /// The call.
        call: &'static str,
        /// The reference.
        reference: u32,
    },
    /// A value of the wrong type.
    #[error("{name} is of type {kind}, {value} ({given}) does not fit")]
    WrongType {
        /// The variable.
        name: String,
        /// Its type.
        kind: VariableKind,
        /// The value.
        value: Value,
        /// Type of the value.
        given: &'static str,
    },
    /// A number that the type of the variable has no room for.
    #[error("{name} is of type {kind} ({} bits, from {} to {}), {value} does not fit", bits(range.0, range.1), range.0, range.1)]
    OutOfRange {
        /// The variable.
        name: String,
        /// Its type.
        kind: VariableKind,
        /// The value.
        value: Value,
        /// The smallest and the largest value that fit.
        range: (i128, i128),
    },
    /// A variable that cannot be set, or not now.
    #[error("{name} cannot be set: {reason}")]
    NotSettable {
        /// The variable.
        name: String,
        /// Why.
        reason: &'static str,
    },
    /// A parameter does not have the value that it was given: the model overrides it.
    #[error(
        "{name} was given the value {given}, and after the initialization it is {found}: the model sets it by itself, or does not take \
         values from outside",
        given = Number(*.given), found = Number(*.found)
    )]
    NotTaken {
        /// The parameter.
        name: String,
        /// The value that it was given.
        given: f64,
        /// The value that it has.
        found: f64,
    },
    /// A variable that was to have a value at the start of a simulation has another one.
    #[error(
        "{name} starts with {found} instead of {given}: the initialization computes it. In model exchange initial states are set after \
         the initialization (kind = \"ME\"); otherwise set the parameters from which the model computes it",
        given = Number(*.given), found = Number(*.found)
    )]
    StateNotTaken {
        /// The variable.
        name: String,
        /// The value that it was given.
        given: f64,
        /// The value that it has.
        found: f64,
    },
    /// NaN or an infinity where a number is needed.
    #[error("{name} = {value}: a finite number is needed", value = Number(*.value))]
    NotFinite {
        /// Name that was to get the value.
        name: String,
        /// The value.
        value: f64,
    },
    /// A variable that is a continuous state is NaN or infinite, and the state is not.
    #[error("{name} is {value}, and the continuous state that it is by the description is finite", value = Number(*.value))]
    StateNotFinite {
        /// The variable.
        name: String,
        /// The value.
        value: f64,
    },
    /// A variable that cannot be an output.
    #[error("{name} cannot be an output: {reason}")]
    NotAnOutput {
        /// The variable.
        name: String,
        /// Why.
        reason: &'static str,
    },
    /// An input that cannot be used.
    #[error("input {name}: {problem}")]
    BadInput {
        /// The variable, or what stands for it.
        name: String,
        /// The problem, with numbers.
        problem: String,
    },
    /// Settings of a simulation that do not make sense: the problem, with numbers.
    #[error("{0}")]
    BadSetting(String),
    /// An option of the integration method that cannot be used.
    #[error(transparent)]
    Options(#[from] ode::OptionsError),
    /// A simulation that started but failed.
    #[error(transparent)]
    Simulation(Box<ode::SimulationError>),
    /// No result holds this variable.
    #[error("there is no value of \"{name}\"; there are: {present}")]
    NotInResult {
        /// The name.
        name: String,
        /// The names in the result.
        present: String,
    },
    /// The folder cannot be packed into an FMU.
    #[error("cannot pack {}: {reason}", folder.display())]
    CannotPack {
        /// The folder.
        folder: PathBuf,
        /// Why not.
        reason: String,
    },
}

/// Width of a type of integers.
fn bits(least: i128, most: i128) -> u32 {
    i128::BITS - (most - least).leading_zeros()
}

impl FmiError {
    /// True if the error has a cause outside of the model: a file, memory, a compiler, the loader or a
    /// process. It does not depend on the values of the simulation.
    pub fn is_of_machine(&self) -> bool {
        matches!(
            self,
            FmiError::Memory { .. }
                | FmiError::NoWorker { .. }
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

    /// Form of this error for another process: its kind, and the data that are passed on.
    pub fn told(&self) -> ReportedError {
        let (kind, time) = match self {
            FmiError::ReportedError(told) => return (**told).clone(),
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

    /// The failed call at the bottom of this error, if there is one.
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

    /// A library file that is not any more what was loaded from it.
    pub(crate) fn written_over(library: &Path) -> FmiError {
        let message = "the file was written over after this process had loaded it; restart the process, or give the new \
                       version a file of its own";
        FmiError::LoadFailed { library: library.to_owned(), message: message.to_owned() }
    }

    /// An archive, or a folder that should be one, that cannot be used.
    pub(crate) fn bad_archive(path: impl Into<PathBuf>, reason: impl Into<String>) -> FmiError {
        FmiError::BadArchive { path: path.into(), reason: reason.into() }
    }

    /// Wraps an error of the operating system with what was tried on which path.
    pub fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> FmiError {
        let path = path.into();
        move |source| FmiError::Io { action, path, source }
    }
}

/// Number of the system's error for more open files than a process may have, and the C library's words for
/// it.
const EMFILE: i32 = 24;
const TOO_MANY_FILES: &str = "Too many open files";

/// Limit on the number of open files of this process; `None` where the system does not say, or there is no
/// limit.
fn open_files_limit() -> Option<u64> {
    #[cfg(unix)]
    return rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
    #[cfg(not(unix))]
    None
}

/// Addition to an error where the process has as many open files as it may have.
fn limit_of_files(error: Option<i32>) -> String {
    match open_files_limit() {
        Some(limit) if error == Some(EMFILE) => {
            format!(
                "; the process may have {limit} open files (ulimit -n): close models that are not used any more"
            )
        }
        _ => String::new(),
    }
}

/// The end of a sentence about a name that does not exist.
fn did_you_mean(nearest: &[String]) -> String {
    if nearest.is_empty() { String::new() } else { format!("; did you mean {}?", nearest.join(", ")) }
}
