//! An opened FMU: its file, its description, its library.

use crate::archive::{Archive, Part};
use crate::cancel_request::CancelRequest;
use crate::description::{
    Interface, ModelDescription, Quirk, QuirkKind, TERMINALS, Terminal, Variable, VariableKind, terminals,
};
use crate::error::{FmiError, Result};
use crate::fair_lock::FairLock;
use crate::libraries::{
    Libraries, LibraryFile, LibraryRequest, LoadedLibrary, Maker, ResetKnowledge, Reuse, Setting,
};
use crate::macros::getters;
use crate::open_options::{LogOptions, OpenOptions};
use crate::platform::RunsBy;
use crate::sys::{InterfaceKind, Library, LoadFrom, is_worker};
use crate::worker::{WindowsProgram, WorkerLimits, Workers};
use crate::{platform, source};
use base::Number;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

const KINDS: [InterfaceKind; 2] = [InterfaceKind::ModelExchange, InterfaceKind::CoSimulation];

/// Maximum number of characters of an error in a warning.
const LONGEST_ERROR: usize = 200;

const LEAVES_TRACES: &str = "after the reset function, a simulation differs from one in a fresh process. Each simulation gets a new instance, \
                             which takes longer. No action is needed";

const HIDDEN_STATE: &str = "a simulation depends on earlier ones in the same process: the model keeps a state outside of its instances. Each \
                            simulation gets a new process, which takes longer. No action is needed";

/// An opened FMU. Clones share everything and are cheap.
///
/// Opening reads only the description. The first instance unpacks the files that the library may access and
/// loads the library. Opening and inspecting run no code of the FMU; loading does.
///
/// A loaded library stays in the process until the process ends, because threads and exit functions of the
/// library may outlive its instances. If a program opens many FMUs, use a [`FmuCache`](crate::FmuCache) or
/// worker processes ([`workers`](Self::workers)).
#[derive(Debug, Clone)]
pub struct Fmu {
    inner: Arc<Inner>,
    /// Path passed when the FMU was opened.
    path: Arc<Path>,
    /// Description with added units; `None` if the description of the file is used unchanged.
    with_units: Option<Arc<ModelDescription>>,
}

/// The libraries are dropped before the folder.
#[derive(Debug)]
struct Inner {
    libraries: Libraries,
    /// Lock for simulations that must not run at the same time.
    turns: Arc<FairLock>,
    /// Value references of the variables of type Real and their positions, sorted. Built on first use.
    real_references: OnceLock<Vec<(u32, usize)>>,
    /// Departures from the standard detected in runs.
    quirks_seen: Mutex<Vec<Quirk>>,
    /// A [`Reuse`], stored as its number.
    reuse: AtomicU8,
    /// Number of times that earlier answers of worker processes were found to be possibly wrong.
    n_late: AtomicU64,
    /// True if a worker process has left the repetition of a simulation to its caller.
    is_to_be_repeated: AtomicBool,
    /// Subjects of messages that simulations have logged. Each subject is logged once.
    reported: Mutex<Vec<&'static str>>,
    workers: Mutex<std::sync::Weak<Workers>>,
    needed_program: OnceLock<Option<WindowsProgram>>,
    description: ModelDescription,
    options: OpenOptions,
    archive: Arc<Archive>,
}

/// Choice of the interface that runs a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
pub enum InterfaceChoice {
    /// Model exchange if the FMU supports it, otherwise co-simulation.
    #[default]
    Auto,
    /// A method of [`ode`](crate::ode) integrates the equations of the FMU.
    ModelExchange,
    /// The FMU integrates itself, from one communication point to the next.
    CoSimulation,
}

impl std::str::FromStr for InterfaceChoice {
    type Err = FmiError;

    /// Parses `auto`, `me` or `cs`, or a full name (`ModelExchange`, `co-simulation`). Case is ignored.
    fn from_str(text: &str) -> Result<Self> {
        let letters =
            text.chars().filter(char::is_ascii_alphanumeric).collect::<String>().to_ascii_lowercase();
        match letters.as_str() {
            "auto" => Ok(InterfaceChoice::Auto),
            "me" | "modelexchange" => Ok(InterfaceChoice::ModelExchange),
            "cs" | "cosimulation" => Ok(InterfaceChoice::CoSimulation),
            _ => Err(FmiError::BadSetting(format!(
                "kind = '{text}' is invalid; expected one of: 'auto', 'ME' (ModelExchange), 'CS' \
                 (CoSimulation)"
            ))),
        }
    }
}

impl Fmu {
    getters! {
        /// Returns the path passed when the FMU was opened.
        pub path(self) -> &Path = &self.path;
        /// Returns the model description.
        pub description(self) -> &ModelDescription = self.with_units.as_deref().unwrap_or(&self.inner.description);
        /// Returns the options with which the FMU was opened.
        pub options(self) -> &OpenOptions = &self.inner.options;
        /// True if only the description is available, see [`absent`](Self::absent).
        pub is_absent(self) -> bool = self.inner.archive.is_absent();
        pub(crate) archive(self) -> &Arc<Archive> = &self.inner.archive;
        /// Returns the log settings.
        pub(crate) logging(self) -> &LogOptions = &self.inner.options.logging;
        /// Returns the lock for simulations that must not run at the same time.
        pub(crate) turns(self) -> &Arc<FairLock> = &self.inner.turns;
    }

    /// Opens a `.fmu` file or an unpacked folder and reads its description.
    ///
    /// # Errors
    /// Returns an error if the file cannot be used as an FMU; see [`FmiError`].
    pub fn open(path: impl AsRef<Path>) -> Result<Fmu> {
        Self::open_with(path, &OpenOptions::default())
    }

    /// Opens a `.fmu` file or an unpacked folder with other limits or other loader options.
    ///
    /// # Errors
    /// Returns the errors of [`open`](Self::open).
    pub fn open_with(path: impl AsRef<Path>, options: &OpenOptions) -> Result<Fmu> {
        let path = path.as_ref();
        Self::describe(Archive::open_with(path, &options.limits, &options.cancel)?, path, options)
    }

    /// Reads the description of an archive.
    pub(crate) fn describe(archive: Archive, path: &Path, options: &OpenOptions) -> Result<Fmu> {
        let mut description = ModelDescription::read_with(&archive, &options.description, &options.cancel)?;
        if let [first, others @ ..] = &archive.repeated()[..] {
            let more = match others.len() {
                0 => String::new(),
                n => format!(" and {n} more"),
            };
            let message =
                format!("the archive contains \"{first}\"{more} more than once, with identical content");
            description.quirks.insert(0, Quirk { kind: QuirkKind::Duplicate, message, line: 0 });
        }
        let inner = Inner {
            libraries: Libraries::default(),
            turns: Arc::default(),
            real_references: OnceLock::new(),
            quirks_seen: Mutex::default(),
            reuse: AtomicU8::default(),
            n_late: AtomicU64::new(0),
            is_to_be_repeated: AtomicBool::new(false),
            reported: Mutex::default(),
            workers: Mutex::default(),
            needed_program: OnceLock::new(),
            description,
            options: OpenOptions { cancel: CancelRequest::default(), ..options.clone() },
            archive: Arc::new(archive),
        };
        Ok(Fmu { inner: Arc::new(inner), path: path.into(), with_units: None })
    }

    /// Creates an FMU of which only `modelDescription.xml` is available. The FMU had this content when it was
    /// at `path`. It can be inspected, and simulations of it can be planned. Operations that require its
    /// other files fail with [`FmiError::Absent`]. `reason` is the text in that error that explains why the
    /// FMU is unavailable.
    ///
    /// # Errors
    /// Returns an error if the description cannot be read.
    pub fn absent(
        path: impl AsRef<Path>,
        description: Vec<u8>,
        content_hash: String,
        reason: String,
        options: &OpenOptions,
    ) -> Result<Fmu> {
        let path = path.as_ref();
        Self::describe(Archive::absent(path, description, content_hash, reason), path, options)
    }

    /// Returns the current bytes of `modelDescription.xml`.
    ///
    /// # Errors
    /// Returns an error if the file can no longer be read.
    pub fn description_file(&self) -> Result<Vec<u8>> {
        self.inner.archive.description(self.inner.options.description.bytes, &CancelRequest::default())
    }

    /// Returns the FMU with additional units, by variable name, for variables whose description declares no
    /// unit. The units change the description only, not the simulations.
    ///
    /// # Errors
    /// Returns an error if there is no such variable, or if it has a different unit.
    pub fn with_units<'a>(&self, units: impl IntoIterator<Item = (&'a str, &'a str)>) -> Result<Fmu> {
        let mut description = self.description().clone();
        for (name, unit) in units {
            let Some(variable) = description.variables.iter().position(|variable| variable.name == name)
            else {
                let nearest = description.nearest_names(name, 3).into_iter().map(str::to_owned).collect();
                return Err(FmiError::UnknownVariable { name: name.to_owned(), nearest });
            };
            let variable = &mut description.variables[variable];
            match variable.unit.as_deref() {
                Some(stated) if !stated.trim().is_empty() && stated != unit => {
                    return Err(FmiError::BadSetting(format!(
                        "units: the model declares the unit '{stated}' for '{name}', not '{unit}'"
                    )));
                }
                _ => variable.unit = Some(unit.to_owned()),
            }
        }
        Ok(Fmu { with_units: Some(Arc::new(description)), ..self.clone() })
    }

    /// Returns the FMU with the unit in which the model counts its time, which replaces the
    /// [unit in its description](ModelDescription::time_unit). It does not change the simulations.
    pub fn with_time_unit(&self, unit: &str) -> Fmu {
        let mut description = self.description().clone();
        description.given_time_unit = Some(unit.to_owned());
        Fmu { with_units: Some(Arc::new(description)), ..self.clone() }
    }

    /// True if both share one state: a library that one of them has loaded is also loaded for the other.
    pub fn is_same(&self, other: &Fmu) -> bool {
        Arc::ptr_eq(&self.inner, &other.inner)
    }

    /// Returns the variable of type Real with this value reference (the first one if there are aliases).
    #[inline]
    pub(crate) fn real_variable(&self, reference: u32) -> Option<&Variable> {
        let variables = &self.description().variables;
        let references = self.inner.real_references.get_or_init(|| {
            let reals = variables.iter().enumerate().filter(|(_, v)| v.kind == VariableKind::Real);
            let mut references: Vec<(u32, usize)> = reals.map(|(i, v)| (v.value_reference, i)).collect();
            references.sort_unstable();
            references.dedup_by_key(|(reference, _)| *reference);
            references
        });
        // Most tools use consecutive value references, so the position is the offset from the first one.
        let offset = reference.wrapping_sub(references.first()?.0) as usize;
        let place = match references.get(offset) {
            Some((guessed, _)) if *guessed == reference => offset,
            _ => references.binary_search_by_key(&reference, |(reference, _)| *reference).ok()?,
        };
        Some(&variables[references[place].1])
    }

    /// Rejects value references that no variable of type Real has. FMUs use value references as indices
    /// without checking them.
    #[inline]
    pub(crate) fn check_real_references(&self, call: &'static str, references: &[u32]) -> Result<()> {
        match references.iter().find(|reference| self.real_variable(**reference).is_none()) {
            Some(&reference) => Err(FmiError::UnknownReference { call, reference }),
            None => Ok(()),
        }
    }

    /// Reads the terminals of the model (`terminalsAndIcons/terminalsAndIcons.xml`). Returns an empty list if
    /// the FMU has no such file. The members of a terminal are names of variables that need not exist.
    ///
    /// # Errors
    /// Returns [`FmiError::Description`] with a line if the file is invalid, and the errors of reading the
    /// file.
    pub fn terminals(&self) -> Result<Vec<Terminal>> {
        let limits = &self.inner.options.description;
        let name = format!("terminalsAndIcons/{TERMINALS}");
        let bytes = self.inner.archive.read(&name, limits.bytes, &CancelRequest::default())?;
        bytes.map_or(Ok(Vec::new()), |bytes| terminals(&bytes, limits))
    }

    /// Returns the folder with all files of the FMU. Unpacks it if necessary.
    ///
    /// # Errors
    /// Returns the errors of [`Archive::unpack`].
    pub fn root(&self) -> Result<PathBuf> {
        self.inner.archive.unpack()
    }

    /// Returns the folder with the files that the library may access at run time. Unpacks it on first use, or
    /// if it has been removed.
    pub(crate) fn running_root(&self) -> Result<PathBuf> {
        self.inner.archive.unpack_part(Part::Running, &CancelRequest::default())
    }

    /// Returns the SHA-256 of the content, in hexadecimal. The first call computes it.
    ///
    /// # Errors
    /// Returns the errors of [`Archive::content_hash`].
    pub fn content_hash(&self) -> Result<&str> {
        self.inner.archive.content_hash()
    }

    /// Returns worker processes with these limits. Existing processes of this FMU with equal limits are
    /// shared. The processes end when their last user drops them. Returns `None` if this program cannot start
    /// worker processes (see [`Launcher`](crate::worker::Launcher)). The processes run the program that the
    /// model [needs](Self::needed_program), if any.
    ///
    /// # Errors
    /// Returns [`FmiError::NoWindowsProgram`] if the needed program or Wine is missing, and
    /// [`FmiError::NoSandbox`] if the limits request a sandbox for such a model.
    pub fn workers(&self, limits: WorkerLimits) -> Result<Option<Arc<Workers>>> {
        let mut shared = self.inner.workers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(workers) = shared.upgrade().filter(|workers| *workers.limits() == limits) {
            return Ok(Some(workers));
        }
        // With a sandbox, sources are compiled in confined processes only.
        let program = match limits.sandbox && self.runs_by(RunsBy::Compiling) {
            true => None,
            false => self.needed_program(),
        };
        let workers = match program {
            Some(program) => Some(Workers::of_program(program, limits)?),
            None => Workers::new(limits),
        };
        if let Some(workers) = &workers {
            *shared = Arc::downgrade(workers);
        }
        Ok(workers)
    }

    /// Returns the folders with the binaries of the FMU, and `sources`, with how they run on this platform.
    /// Files are listed only, so a library for another processor is not detected.
    ///
    /// # Errors
    /// Returns [`FmiError::Absent`], or an error if a folder cannot be listed.
    pub fn platforms(&self) -> Result<Vec<platform::Platform>> {
        let files = self.inner.archive.file_names()?;
        Ok(platform::platforms(
            files.iter().map(String::as_str),
            self.description().fmi_version.folder_names(),
        ))
    }

    /// Returns the worker program for Windows without which the FMU does not run here: it has a library for
    /// that program, no library for this platform, and no sources. If it has sources, and the program is
    /// present, the first call compiles the sources; they count as absent if that fails.
    pub fn needed_program(&self) -> Option<WindowsProgram> {
        *self.inner.needed_program.get_or_init(|| {
            let is_without_sources = || !self.runs_by(RunsBy::Compiling);
            self.windows_program()
                .filter(|program| is_without_sources() || (program.check().is_ok() && !self.compiles()))
        })
    }

    /// Returns the worker program for a library of the FMU, if it has none for this platform.
    pub fn windows_program(&self) -> Option<WindowsProgram> {
        let platforms = self.platforms().ok()?;
        let has = |runs_by| platforms.iter().any(|platform| platform.runs_by == runs_by);
        if has(RunsBy::Loading) {
            None
        } else if has(RunsBy::Wine) {
            Some(WindowsProgram::Bits64)
        } else {
            has(RunsBy::Process32).then_some(WindowsProgram::Bits32)
        }
    }

    /// True if a part of the FMU runs like this. An error counts as false; it is reported when the files are
    /// unpacked.
    fn runs_by(&self, runs_by: RunsBy) -> bool {
        self.platforms().is_ok_and(|platforms| platforms.iter().any(|platform| platform.runs_by == runs_by))
    }

    /// Compiles the sources. Returns false, and logs the error, if they cannot be compiled.
    fn compiles(&self) -> bool {
        for (_, interface) in self.interfaces() {
            let error = match self.binary(interface, &CancelRequest::default()) {
                Err(error @ (FmiError::NoCompiler { .. } | FmiError::CompileFailed { .. })) => error,
                Err(error @ FmiError::NoBinary { .. }) => error,
                _ => continue,
            };
            let text = error.to_string();
            let start: String = text.lines().next().unwrap_or_default().chars().take(LONGEST_ERROR).collect();
            log::warn!(
                "{}: the sources do not compile here, so the library for Windows runs in a worker process. \
                 The error begins: {start}",
                self.path().display()
            );
            return false;
        }
        true
    }

    /// Adds departures from the standard detected in a worker process. New ones are also sent to
    /// the program's logger.
    pub fn add_quirks(&self, quirks: Vec<Quirk>) {
        for Quirk { kind, message, .. } in quirks {
            self.note_quirk(kind, message);
        }
    }

    /// Returns how worker processes reset the model between simulations. Comparisons with fresh processes
    /// determine it.
    pub fn reuse(&self) -> Reuse {
        let code = usize::from(self.inner.reuse.load(Ordering::Relaxed));
        Reuse::ALL.get(code).copied().unwrap_or(Reuse::NewProcess)
    }

    /// Uses `reuse` from now on. Worker processes receive it with every request.
    pub fn set_reuse(&self, reuse: Reuse) {
        self.inner.reuse.store(reuse as u8, Ordering::Relaxed);
    }

    /// Switches to the method after `reuse`, because the result of a simulation after others differed from
    /// the result in a fresh process. Adds a quirk. `is_late`: an earlier comparison had agreed, so answers
    /// since then may be wrong.
    pub fn give_up(&self, reuse: Reuse, is_late: bool) {
        let (next, kind, message) = match reuse {
            Reuse::Reset => (Reuse::Reinstantiate, QuirkKind::Promise, LEAVES_TRACES),
            _ => (Reuse::NewProcess, QuirkKind::HiddenState, HIDDEN_STATE),
        };
        self.inner.reuse.fetch_max(next as u8, Ordering::Relaxed);
        self.inner.n_late.fetch_add(u64::from(is_late), Ordering::Relaxed);
        self.note_quirk(kind, message);
    }

    /// Returns the number of calls of [`give_up`](Self::give_up) in which a difference appeared late.
    pub fn n_late(&self) -> u64 {
        self.inner.n_late.load(Ordering::Relaxed)
    }

    /// Returns the level at which log lines of the FMU are sent to the program's logger.
    pub(crate) fn log_level(&self) -> log::Level {
        if self.inner.options.logging.shown { log::Level::Info } else { log::Level::Debug }
    }

    /// Adds a departure from the standard, detected in a run, to the quirks. A new one is also sent to
    /// the program's logger.
    pub(crate) fn note_quirk(&self, kind: QuirkKind, message: impl AsRef<str> + Into<String>) {
        let mut seen = self.inner.quirks_seen.lock().unwrap_or_else(PoisonError::into_inner);
        if !seen.iter().any(|quirk| quirk.kind == kind && quirk.message == message.as_ref()) {
            // A worker sends the quirk to its parent process, which logs it.
            if !is_worker() {
                log::warn!("{}: {}", self.description().model_name, message.as_ref());
            }
            seen.push(Quirk { kind, message: message.into(), line: 0 });
        }
    }

    /// Sends a message about simulations of the FMU to the program's logger, once per subject.
    pub(crate) fn say_once(&self, level: log::Level, subject: &'static str, message: &str) {
        let mut reported = self.inner.reported.lock().unwrap_or_else(PoisonError::into_inner);
        if !reported.contains(&subject) {
            log::log!(level, "{}: {message}", self.description().model_name);
            reported.push(subject);
        }
    }

    /// Runs a simulation, and repeats it if it failed and revealed how the model must be run. An example is a
    /// co-simulation that rejected the step to its stop time. In a worker process the repetition is [left to
    /// the caller](Self::take_repetition), so that the caller knows how many simulations an answer can
    /// require.
    pub fn repeat_if_learned<T, E>(&self, mut simulate: impl FnMut() -> Result<T, E>) -> Result<T, E> {
        let stop_time = || self.reset_knowledge(InterfaceKind::CoSimulation).stop_time;
        loop {
            let before = stop_time();
            match simulate() {
                Err(_) if stop_time() != before && !is_worker() => {}
                outcome => {
                    let is_left = outcome.is_err() && stop_time() != before;
                    self.inner.is_to_be_repeated.fetch_or(is_left, Ordering::Relaxed);
                    return outcome;
                }
            }
        }
    }

    /// True if a repetition has been left to the caller since the last call.
    pub fn take_repetition(&self) -> bool {
        self.inner.is_to_be_repeated.swap(false, Ordering::Relaxed)
    }

    /// Returns the departures from the standard detected in runs of the FMU. The departures in its
    /// description are in [`ModelDescription::quirks`](crate::ModelDescription::quirks).
    pub fn quirks_seen(&self) -> Vec<Quirk> {
        self.inner.quirks_seen.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Records that the start value of a state is not its value after the initialization. The description
    /// declares such a start value as a guess.
    pub(crate) fn note_ineffective_start_value(&self, name: &str, given: f64, found: f64) {
        let message = format!(
            "{}, but is {} after the initialization, because the start value is a guess \
             (initial=\"approx\"). In model exchange, set the state with initial_states; otherwise set the \
             parameters from which the model computes it",
            start_value_given(name, given),
            Number(found)
        );
        self.note_quirk(QuirkKind::Start, message);
    }

    /// Returns the message that the start value of a state had no effect in a simulation. The description
    /// declares such a start value as a guess.
    pub fn ineffective_start_value(&self, name: &str, value: f64) -> Option<String> {
        let beginning = start_value_given(name, value) + ",";
        let mut messages = self.quirks_seen().into_iter().filter(|quirk| quirk.kind == QuirkKind::Start);
        messages.find(|quirk| quirk.message.starts_with(&beginning)).map(|quirk| quirk.message)
    }

    /// Returns the knowledge about the reset of instances of one interface.
    pub(crate) fn reset_knowledge(&self, kind: InterfaceKind) -> MutexGuard<'_, ResetKnowledge> {
        self.inner.libraries.reset_knowledge(kind)
    }

    /// Unpacks the files that simulations need, for this process and for copies made with `fork` (POSIX). The
    /// copies share the unpacked files. Runs no code of the FMU. Does nothing if the FMU has resources,
    /// because simulations may change them.
    ///
    /// # Errors
    /// Returns the errors of [`Archive::unpack`].
    pub fn unpack_for_copies(&self) -> Result<()> {
        let archive = self.archive();
        if archive.serves_copies() {
            let root = archive.unpack_part(Part::Running, &CancelRequest::default())?;
            if self.interfaces().any(|(_, interface)| self.find_binary(&root, interface).is_err()) {
                archive.unpack()?;
            }
        }
        Ok(())
    }

    /// Unpacks or builds the libraries for this platform of all interfaces that the FMU offers. Runs no code
    /// of the libraries.
    ///
    /// # Errors
    /// Returns an error if a library is missing and cannot be built.
    pub fn provide_libraries(&self) -> Result<()> {
        let (archive, loader) = (self.archive(), self.inner.options.loader);
        let cancel = CancelRequest::default();
        for (kind, interface) in self.interfaces() {
            let find = || self.library_file(interface, &cancel);
            self.inner.libraries.source(kind, archive, loader, &find)?;
        }
        Ok(())
    }

    /// Unpacks, compiles and loads everything that the first simulation needs, to avoid a delay there. Ends
    /// early if `cancel` requests it. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// Returns [`FmiError::Cancelled`], and other variants of [`FmiError`] if the FMU cannot be run on this
    /// machine.
    pub fn prepare(&self, kind: InterfaceChoice, cancel: &CancelRequest) -> Result<()> {
        self.library(self.choose(kind)?, Some(&[]), cancel, &mut || !cancel.is_requested()).map(|_| ())
    }

    /// Returns the loaded library for this platform, for an instance with these settings. `settings` are
    /// sorted; `None` means any settings, made by calls of the user. If the FMU contains only sources, they
    /// are compiled first. Ends early if `cancel` requests it. If another thread is loading the library,
    /// waits while `wait` (called every 20 ms) returns true.
    ///
    /// # Errors
    /// Returns [`FmiError::Cancelled`], and other variants of [`FmiError`] if the FMU cannot be run on this
    /// machine.
    pub(crate) fn library(
        &self,
        kind: InterfaceKind,
        settings: Option<&[Setting]>,
        cancel: &CancelRequest,
        wait: &mut dyn FnMut() -> bool,
    ) -> Result<Arc<LoadedLibrary>> {
        let interface = self.check_interface(kind)?;
        self.note_needed_tool();
        let only_one = interface.capabilities.can_be_instantiated_only_once_per_process;
        let maker = Maker {
            archive: self.archive(),
            loader: self.inner.options.loader,
            find: &|| self.library_file(interface, cancel),
            open: &|from| self.load(from, kind),
        };
        let library = self.inner.libraries.get(LibraryRequest { kind, settings, only_one }, &maker, wait)?;
        // The unpacked files may have been removed in the meantime.
        self.running_root()?;
        Ok(library)
    }

    /// Returns the library file for this platform, unchanged since the FMU was opened.
    fn library_file(&self, interface: &Interface, cancel: &CancelRequest) -> Result<LibraryFile> {
        let library = self.binary(interface, cancel)?;
        let archive = self.archive();
        if let Some(file) = archive.changed_library() {
            let name = file.strip_prefix(archive.unpack()?).unwrap_or(file).display();
            let reason = format!(
                "{name} has been modified or removed since the folder was opened; open the folder again"
            );
            return Err(FmiError::bad_archive(self.path(), reason));
        }
        Ok(LibraryFile { library, root: archive.unpack_part(Part::Running, cancel)? })
    }

    /// Stops using a loaded library. The next request gets another copy.
    pub(crate) fn give_up_library(&self, library: &Arc<LoadedLibrary>) {
        self.inner.libraries.give_up(library);
    }

    /// Checks that the FMU supports this interface. Returns the interface that would be used.
    ///
    /// # Errors
    /// Returns [`FmiError::NotOffered`] if the FMU does not support the interface.
    pub fn check_runnable_as(&self, kind: InterfaceChoice) -> Result<InterfaceKind> {
        let kind = self.choose(kind)?;
        self.check_interface(kind).map(|_| kind)
    }

    /// Returns the interface that a simulation would use.
    ///
    /// # Errors
    /// Returns [`FmiError::NotOffered`] if the FMU does not support the interface.
    pub fn choose(&self, kind: InterfaceChoice) -> Result<InterfaceKind> {
        let wanted = match kind {
            InterfaceChoice::ModelExchange => InterfaceKind::ModelExchange,
            InterfaceChoice::CoSimulation => InterfaceKind::CoSimulation,
            InterfaceChoice::Auto if self.interface(InterfaceKind::ModelExchange).is_some() => {
                InterfaceKind::ModelExchange
            }
            InterfaceChoice::Auto => InterfaceKind::CoSimulation,
        };
        if self.interface(wanted).is_some() {
            return Ok(wanted);
        }
        Err(self.not_offered(match kind {
            InterfaceChoice::Auto => "model exchange or co-simulation".to_owned(),
            _ => wanted.to_string(),
        }))
    }

    fn not_offered(&self, wanted: String) -> FmiError {
        let description = self.description();
        let interfaces = InterfaceKind::WORDS.iter().filter(|(_, kind)| self.interface(*kind).is_some());
        let mut offered: Vec<&str> = interfaces.map(|(word, _)| *word).collect();
        if description.offers_scheduled_execution {
            offered.push("scheduled execution");
        }
        let offered = if offered.is_empty() { "nothing".to_owned() } else { offered.join(" and ") };
        FmiError::NotOffered { model: description.model_name.clone(), wanted, offered }
    }

    pub(crate) fn interface(&self, kind: InterfaceKind) -> Option<&Interface> {
        match kind {
            InterfaceKind::ModelExchange => self.description().model_exchange.as_ref(),
            InterfaceKind::CoSimulation => self.description().co_simulation.as_ref(),
        }
    }

    /// Returns all interfaces that the FMU offers.
    fn interfaces(&self) -> impl Iterator<Item = (InterfaceKind, &Interface)> {
        KINDS.into_iter().filter_map(|kind| Some((kind, self.interface(kind)?)))
    }

    /// Checks that the FMU offers this interface, and returns the interface.
    pub(crate) fn check_interface(&self, kind: InterfaceKind) -> Result<&Interface> {
        self.interface(kind).ok_or_else(|| self.not_offered(kind.to_string()))
    }

    /// Returns the name of the tool that the model calls at run time (`needsExecutionTool`), for messages.
    fn needed_tool(&self) -> Option<String> {
        let needs = |(_, interface): (_, &Interface)| interface.capabilities.needs_execution_tool;
        let tool = || self.description().generation_tool.as_deref().unwrap_or("the tool that exported it");
        self.interfaces().any(needs).then(|| tool().to_owned())
    }

    /// Logs once that the model requires a tool.
    pub fn note_needed_tool(&self) {
        if let Some(tool) = self.needed_tool().filter(|_| !is_worker()) {
            let message = format!("the model requires {tool} at run time (needsExecutionTool)");
            self.say_once(log::Level::Warn, "tool", &message);
        }
    }

    /// Returns possible causes of a failure of the model. A required tool may be missing, or the model may
    /// follow a draft of the standard.
    pub fn hint(&self) -> Option<String> {
        let tool = self.needed_tool().map(|tool| {
            format!("the model requires {tool} at run time (needsExecutionTool), which may be missing")
        });
        let version = &self.description().fmi_version;
        let draft = version.is_draft().then(|| {
            format!(
                "the model uses FMI {version}, a draft whose functions differ from FMI {}.{}",
                version.major, version.minor
            )
        });
        let hints: Vec<String> = tool.into_iter().chain(draft).collect();
        (!hints.is_empty()).then(|| hints.join("; "))
    }

    /// Finds the library file for this platform in an unpacked part.
    fn find_binary(&self, root: &Path, interface: &Interface) -> Result<platform::FoundBinary> {
        let names = self.description().fmi_version.folder_names();
        platform::find_binary(root, &interface.model_identifier, names)
    }

    /// Returns the library file for this platform, unpacked or built from the sources.
    pub(crate) fn binary(&self, interface: &Interface, cancel: &CancelRequest) -> Result<PathBuf> {
        let (archive, description) = (&self.inner.archive, self.description());
        let find = |part| self.find_binary(&archive.unpack_part(part, cancel)?, interface);
        match find(Part::Running) {
            Ok(found) => {
                if let Some(note) = &found.note {
                    log::warn!("{}: {note}", self.path().display());
                }
                return Ok(found.path);
            }
            Err(FmiError::NoBinary { .. }) => {}
            Err(error) => return Err(error),
        }
        self.warn_of_unusable(archive.unpack_part(Part::Running, cancel)?.as_ref(), interface);
        let root = archive.unpack_part(Part::Sources, cancel)?;
        // A folder may have been edited since it was opened. The library must match its present files.
        let hash = archive.present_hash()?;
        let check = || match archive.present_hash()? {
            now if now == hash => Ok(()),
            _ => Err(FmiError::bad_archive(self.path(), "the files changed while the library was built")),
        };
        match source::build_unchanged(
            &root,
            description,
            interface,
            &hash,
            platform::BuildTarget::Native,
            &source::Patience { cancel, limit: self.inner.options.compile_time },
            check,
        ) {
            // The message also lists the binaries of other platforms.
            Err(FmiError::NoSources { reason, .. }) => find(Part::Binaries)
                .map(|found| found.path)
                .map_err(|no_binary| self.no_library(no_binary, &reason)),
            outcome => outcome,
        }
    }

    /// Warns that the library for this platform cannot be used.
    fn warn_of_unusable(&self, root: &Path, interface: &Interface) {
        let names = self.description().fmi_version.folder_names();
        if let Some(file) = platform::unusable_binary(root, &interface.model_identifier, names) {
            let file = file.strip_prefix(root).unwrap_or(&file).display().to_string();
            log::warn!(
                "{}: {file} is not a library for this platform; the sources are compiled instead, if \
                 available",
                self.path().display()
            );
        }
    }

    /// Loads the library. **This runs its constructors.**
    fn load(&self, from: LoadFrom<'_>, kind: InterfaceKind) -> Result<Library> {
        let interface = self.check_interface(kind)?;
        let version = &self.description().fmi_version;
        let (identifier, loader, hint) =
            (&interface.model_identifier, &self.inner.options.loader, self.hint());
        let library = Library::open(from, version, kind, identifier, loader, hint.as_deref());
        let library = library.map_err(|error| match (error, hint) {
            (FmiError::LoadFailed { library, message }, Some(hint)) => {
                FmiError::LoadFailed { library, message: format!("{message}; {hint}") }
            }
            (FmiError::MissingSymbol { library, symbol }, Some(hint)) => {
                let message = format!(
                    "the library does not export the function {symbol}, which the FMI \
                                       standard requires; {hint}"
                );
                FmiError::LoadFailed { library, message }
            }
            (error, _) => error,
        })?;
        // Versions with equal first two numbers have the same interface.
        let numbers = |text: &str| {
            text.split(|c: char| !c.is_ascii_digit()).take(2).map(str::to_owned).collect::<Vec<_>>()
        };
        let described = &version.text;
        match library.version_text() {
            Some(found) if numbers(&found) != numbers(described) => self.note_quirk(
                QuirkKind::Promise,
                format!(
                    "the model description declares FMI {described}, but the library reports \"{}\"",
                    found.escape_debug()
                ),
            ),
            _ => {}
        }
        Ok(library)
    }

    /// Replaces the private folder in the error by the user's path, and adds why no library can be built.
    fn no_library(&self, no_binary: FmiError, no_sources: &str) -> FmiError {
        match no_binary {
            FmiError::NoBinary { wanted, present, .. } => FmiError::NoBinary {
                path: self.path().to_owned(),
                wanted,
                present: match self.windows_program().filter(|_| !self.runs_by(RunsBy::Compiling)) {
                    Some(program) => match program.check() {
                        Err(FmiError::NoWindowsProgram { reason, .. }) => {
                            format!("{present}, which runs {}. {reason}", program.place())
                        }
                        _ => format!("{present}, which runs {} in a worker process", program.place()),
                    },
                    None => format!("{present}; cannot build one: {no_sources}"),
                },
            },
            other => other,
        }
    }
}

/// Returns the beginning of the message about a start value without effect.
fn start_value_given(name: &str, value: f64) -> String {
    format!("{name} was set to the start value {}", Number(value))
}
