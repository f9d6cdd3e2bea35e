//! An opened FMU: its folder, its description, its library (loaded when first needed), its idle instances.

mod reuse;

pub use reuse::{Reuse, Sharing};

use crate::archive::{Archive, Part};
use crate::cancel::Cancel;
use crate::copies::{CopyStore, PrivateCopy};
use crate::description::{Causality, Interface, ModelDescription, Quirk, QuirkKind, Variable, VariableKind};
use crate::error::FmiError;
use crate::instance::{CoSimulation, Instance, Instantiated};
use crate::open_options::{LogOptions, OpenOptions};
use crate::options::{Kind, SimulateOptions};
use crate::plan::{Setting, SimulationPlan};
use crate::platform;
use crate::simulation::Simulator;
use crate::source;
use crate::sys::{InterfaceKind, Library, LogFilter, RawInstance, Request, Sizes};
use crate::trajectory::Trajectory;
use reuse::Idle;
use std::ffi::CString;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

const NO_EVENT_MODE: &str = "the description promises an event mode in co-simulation, the model refuses to be instantiated \
                             with it: it is run without";
const STALE_OUTPUTS: &str = "variables read at a new point are those of an earlier one until the derivatives are computed: they are \
                             computed before every reading";

/// An opened FMU. Clones share everything and are cheap.
///
/// Opening reads the description and no other file of it. The first instance unpacks what the library may look for and
/// loads the library. Opening and inspecting run no code of the FMU; loading does.
#[derive(Debug, Clone)]
pub struct Fmu {
    inner: Arc<Inner>,
    /// The path it was opened by; other clones may have been opened by others.
    path: Arc<Path>,
}

/// Fields are dropped in this order: instances and libraries, folder.
#[derive(Debug)]
struct Inner {
    model_exchange: Side,
    co_simulation: Side,
    /// The model computes its variables with the derivatives only.
    has_stale_outputs: AtomicBool,
    /// Value references of the variables of type Real and their positions, sorted; made when first needed.
    real_references: OnceLock<Vec<(u32, usize)>>,
    description: ModelDescription,
    options: OpenOptions,
    archive: Archive,
}

/// One way of running the model. Fields are dropped in this order: instances, library.
#[derive(Debug, Default)]
struct Side {
    idle: Arc<Idle>,
    /// Ways of bringing instances back that passed their trials, each with what was set in the runs of the trial: that
    /// hides what such a way leaves behind, so the verdict is one for plans that set all of it.
    proven: Mutex<Vec<(Reuse, Arc<[Setting]>)>>,
    /// Private copies of the library; made when first needed.
    copies: OnceLock<Arc<CopyStore>>,
    library: Mutex<Option<Arc<Library>>>,
}

/// How an instance is made.
#[derive(Debug, Clone, Default)]
pub struct InstanceOptions {
    /// Name of the instance, for log messages; default: the name of the model.
    pub name: Option<String>,
    /// Ask the FMU to log. FMUs log what they think important without being asked, too.
    pub logging: bool,
    /// Which lines of the log are kept (see [`Instance::log`]); an FMU that goes on logging is held to four lines
    /// for each point of time, step and event iteration, besides its errors, and the rest is counted.
    pub log_filter: LogFilter,
    /// Let the FMU show windows.
    pub visible: bool,
}

impl Fmu {
    /// Opens a `.fmu` file or an unpacked folder and reads its description.
    ///
    /// # Errors
    /// Everything that can be wrong with the file; see [`FmiError`].
    pub fn open(path: impl AsRef<Path>) -> Result<Fmu, FmiError> {
        Self::open_with(path, &OpenOptions::default())
    }

    /// Opens a `.fmu` file or an unpacked folder with other limits, or to be loaded in another way.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_with(path: impl AsRef<Path>, options: &OpenOptions) -> Result<Fmu, FmiError> {
        let path = path.as_ref();
        Self::describe(Archive::open_with(path, &options.limits, &options.cancel)?, path, options)
    }

    /// Reads the description of an archive.
    pub(crate) fn describe(archive: Archive, path: &Path, options: &OpenOptions) -> Result<Fmu, FmiError> {
        let mut description = ModelDescription::read(&archive)?;
        if let [first, others @ ..] = &archive.repeated()[..] {
            let more = match others.len() {
                0 => String::new(),
                n => format!(" and {n} more"),
            };
            let message =
                format!("the archive holds \"{first}\"{more} more than once, with the same content");
            description.quirks.insert(0, Quirk { kind: QuirkKind::Duplicate, message, line: 0 });
        }
        let inner = Inner {
            model_exchange: Side::default(),
            co_simulation: Side::default(),
            has_stale_outputs: AtomicBool::new(false),
            real_references: OnceLock::new(),
            description,
            options: OpenOptions { cancel: Cancel::default(), ..options.clone() },
            archive,
        };
        Ok(Fmu { inner: Arc::new(inner), path: path.into() })
    }

    /// The same FMU, opened by another path.
    pub(crate) fn at(&self, path: &Path) -> Fmu {
        Fmu { inner: Arc::clone(&self.inner), path: path.into() }
    }

    pub(crate) fn archive(&self) -> &Archive {
        &self.inner.archive
    }

    /// Whether both are one: what one of them loads, the other has loaded.
    pub fn is_same(&self, other: &Fmu) -> bool {
        Arc::ptr_eq(&self.inner, &other.inner)
    }

    /// The model description.
    pub fn description(&self) -> &ModelDescription {
        &self.inner.description
    }

    /// The variable of type Real with this value reference (the first one, of aliases).
    #[inline]
    pub(crate) fn real_variable(&self, reference: u32) -> Option<&Variable> {
        let variables = &self.description().variables;
        let known = self.inner.real_references.get_or_init(|| {
            let reals = variables.iter().enumerate().filter(|(_, v)| v.kind == VariableKind::Real);
            let mut known: Vec<(u32, usize)> = reals.map(|(i, v)| (v.value_reference, i)).collect();
            known.sort_unstable();
            known.dedup_by_key(|(reference, _)| *reference);
            known
        });
        // Most tools count their references up from one number: then the place is known.
        let offset = reference.wrapping_sub(known.first()?.0) as usize;
        let place = match known.get(offset) {
            Some((guessed, _)) if *guessed == reference => offset,
            _ => known.binary_search_by_key(&reference, |(reference, _)| *reference).ok()?,
        };
        Some(&variables[known[place].1])
    }

    /// Refuses value references that no variable of type Real has: FMUs use them as indices without looking.
    #[inline]
    pub(crate) fn check_real_references(
        &self,
        call: &'static str,
        references: &[u32],
    ) -> Result<(), FmiError> {
        match references.iter().find(|reference| self.real_variable(**reference).is_none()) {
            Some(&reference) => Err(FmiError::UnknownReference { call, reference }),
            None => Ok(()),
        }
    }

    /// The path it was opened by.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The folder that holds all of its content, unpacked now if it was not before.
    ///
    /// # Errors
    /// As [`Archive::unpack`].
    pub fn root(&self) -> Result<PathBuf, FmiError> {
        self.inner.archive.unpack()
    }

    /// The folder that holds what the library may look for when it runs; unpacked now if it was not before, or if somebody
    /// has removed it.
    pub(crate) fn running_root(&self) -> Result<PathBuf, FmiError> {
        self.inner.archive.unpack_part(Part::Running, &Cancel::default())
    }

    /// SHA-256 of its content, in hexadecimal; computed when it is first asked for.
    ///
    /// # Errors
    /// As [`Archive::content_hash`].
    pub fn content_hash(&self) -> Result<&str, FmiError> {
        self.inner.archive.content_hash()
    }

    /// Simulates once.
    ///
    /// # Errors
    /// Options that do not fit the model, and everything that can go wrong in a simulation.
    pub fn simulate(&self, options: &SimulateOptions) -> Result<Trajectory, FmiError> {
        let plan = Arc::new(SimulationPlan::new(self, options)?);
        Simulator::new(Arc::clone(&plan))?.trajectory(plan.parameter_starts())
    }

    /// Makes a model-exchange instance. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// The FMU cannot be run here (see [`FmiError`]), or it refuses to be instantiated.
    pub fn instantiate(&self) -> Result<Instance<Instantiated>, FmiError> {
        self.instantiate_with(&InstanceOptions::default())
    }

    /// Makes a model-exchange instance with a name, with logging.
    ///
    /// # Errors
    /// As [`instantiate`](Self::instantiate).
    pub fn instantiate_with(&self, options: &InstanceOptions) -> Result<Instance<Instantiated>, FmiError> {
        let raw = self.instantiate_raw(InterfaceKind::ModelExchange, options)?;
        Ok(Instance::from_raw(raw, self.clone()))
    }

    /// Makes a co-simulation instance. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// As [`instantiate`](Self::instantiate).
    pub fn instantiate_co_simulation(
        &self,
        options: &InstanceOptions,
    ) -> Result<Instance<Instantiated, CoSimulation>, FmiError> {
        let raw = self.instantiate_raw(InterfaceKind::CoSimulation, options)?;
        Ok(Instance::from_raw(raw, self.clone()))
    }

    /// Makes an instance of either kind.
    pub(crate) fn instantiate_raw(
        &self,
        kind: InterfaceKind,
        options: &InstanceOptions,
    ) -> Result<RawInstance, FmiError> {
        self.check_interface(kind)?;
        self.instantiate_in(&self.library(kind)?, kind, options)
    }

    /// Makes an instance for simulations.
    pub(crate) fn instantiate_for_runs(
        &self,
        library: &Arc<Library>,
        kind: InterfaceKind,
    ) -> Result<RawInstance, FmiError> {
        let LogOptions { asked, filter, .. } = self.inner.options.logging;
        let options = InstanceOptions { logging: asked, log_filter: filter, ..InstanceOptions::default() };
        self.instantiate_in(library, kind, &options)
    }

    /// The level at which lines of its log go to the program's logger.
    pub(crate) fn log_level(&self) -> log::Level {
        if self.inner.options.logging.shown { log::Level::Info } else { log::Level::Debug }
    }

    /// Makes an instance of either kind with this library, which is that of the FMU or a copy of it.
    pub(crate) fn instantiate_in(
        &self,
        library: &Arc<Library>,
        kind: InterfaceKind,
        options: &InstanceOptions,
    ) -> Result<RawInstance, FmiError> {
        let interface = self.check_interface(kind)?;
        let description = self.description();
        let text = |what: &str, text: &str| {
            CString::new(text)
                .map_err(|_| FmiError::BadSetting { problem: format!("the {what} holds a NUL character") })
        };
        let name = text("name of the instance", options.name.as_deref().unwrap_or(&description.model_name))?;
        let guid = text("guid", &description.guid)?;
        // A cleaner of the folder for temporary files may have been there since the library was loaded.
        let resources = self.running_root()?.join("resources");
        let is_intermediate = |v: &&Variable| {
            v.intermediate_update && v.causality == Causality::Input && v.kind == VariableKind::Real
        };
        let intermediate: Vec<u32> = match interface.capabilities.provides_intermediate_update {
            true => description.variables.iter().filter(is_intermediate).map(|v| v.value_reference).collect(),
            false => Vec::new(),
        };
        let mut request = Request {
            name: &name,
            guid: &guid,
            resources: &resources,
            kind,
            event_mode: interface.capabilities.uses_event_mode() && !library.shared().is_event_mode_refused(),
            early_return: interface.capabilities.may_return_early(),
            intermediate: &intermediate,
            visible: options.visible,
            logging: options.logging,
            log_filter: options.log_filter,
        };
        let sizes = Sizes { states: description.n_states(), indicators: description.n_event_indicators };
        let only_one = interface.capabilities.can_be_instantiated_only_once_per_process;
        if only_one || library.shared().is_dependent() {
            library.shared().set_dependent();
            library.shared().free_spares();
        }
        let refusal = match RawInstance::new(library, &request, sizes, only_one) {
            Err(FmiError::Call(refusal)) if request.event_mode => FmiError::Call(refusal),
            outcome => return outcome,
        };
        // Some models promise an event mode that they do not have.
        request.event_mode = false;
        let raw = RawInstance::new(library, &request, sizes, only_one).map_err(|_| refusal)?;
        library.shared().refuse_event_mode();
        log::warn!("{}: {NO_EVENT_MODE}", description.model_name);
        Ok(raw)
    }

    /// Departures from the standard that showed when the FMU was run; those of its description are in
    /// [`ModelDescription::quirks`].
    pub fn quirks_seen(&self) -> Vec<Quirk> {
        let refused = self.shared(InterfaceKind::CoSimulation).is_some_and(|s| s.is_event_mode_refused());
        let stale = self.inner.has_stale_outputs.load(Ordering::Relaxed);
        let quirk = |message: &str| Quirk { kind: QuirkKind::Promise, message: message.to_owned(), line: 0 };
        let seen = [(refused, NO_EVENT_MODE), (stale, STALE_OUTPUTS)];
        seen.into_iter().filter(|(is_seen, _)| *is_seen).map(|(_, message)| quirk(message)).collect()
    }

    /// Notes, and says once, that variables are computed with the derivatives only.
    pub(crate) fn note_stale_outputs(&self) {
        if !self.inner.has_stale_outputs.swap(true, Ordering::Relaxed) {
            log::warn!("{}: {STALE_OUTPUTS}", self.description().model_name);
        }
    }

    /// Whether the FMU can be simulated, one way or the other; the interface that would be used.
    ///
    /// # Errors
    /// [`FmiError::NotOffered`], [`FmiError::NeedsExecutionTool`].
    pub fn check_runnable(&self) -> Result<&Interface, FmiError> {
        self.check_interface(self.choose(Kind::Auto)?)
    }

    /// As [`check_runnable`](Self::check_runnable), for one way of running it.
    ///
    /// # Errors
    /// As [`check_runnable`](Self::check_runnable).
    pub fn check_runnable_as(&self, kind: Kind) -> Result<InterfaceKind, FmiError> {
        let kind = self.choose(kind)?;
        self.check_interface(kind).map(|_| kind)
    }

    /// The interface that a simulation would use.
    ///
    /// # Errors
    /// [`FmiError::NotOffered`].
    pub fn choose(&self, kind: Kind) -> Result<InterfaceKind, FmiError> {
        let wanted = match kind {
            Kind::ModelExchange => InterfaceKind::ModelExchange,
            Kind::CoSimulation => InterfaceKind::CoSimulation,
            Kind::Auto if self.interface(InterfaceKind::ModelExchange).is_some() => {
                InterfaceKind::ModelExchange
            }
            Kind::Auto => InterfaceKind::CoSimulation,
        };
        if self.interface(wanted).is_some() {
            return Ok(wanted);
        }
        let description = self.description();
        let known = [InterfaceKind::ModelExchange, InterfaceKind::CoSimulation];
        let mut offered: Vec<String> = known
            .into_iter()
            .filter(|kind| self.interface(*kind).is_some())
            .map(|kind| kind.to_string())
            .collect();
        if description.offers_scheduled_execution {
            offered.push("scheduled execution".to_owned());
        }
        Err(FmiError::NotOffered {
            model: description.model_name.clone(),
            wanted: if kind == Kind::Auto {
                "model exchange nor co-simulation".to_owned()
            } else {
                wanted.to_string()
            },
            offered: if offered.is_empty() { "nothing".to_owned() } else { offered.join(" and ") },
        })
    }

    fn interface(&self, kind: InterfaceKind) -> Option<&Interface> {
        match kind {
            InterfaceKind::ModelExchange => self.description().model_exchange.as_ref(),
            InterfaceKind::CoSimulation => self.description().co_simulation.as_ref(),
        }
    }

    /// Whether the FMU can be run in this way; the interface.
    pub(crate) fn check_interface(&self, kind: InterfaceKind) -> Result<&Interface, FmiError> {
        let description = self.description();
        let interface = self.interface(kind).ok_or_else(|| FmiError::NotOffered {
            model: description.model_name.clone(),
            wanted: kind.to_string(),
            offered: "the other interface".to_owned(),
        })?;
        if interface.capabilities.needs_execution_tool && !self.inner.options.tool_is_present {
            return Err(FmiError::NeedsExecutionTool {
                model: description.model_name.clone(),
                tool: description.generation_tool.clone(),
            });
        }
        Ok(interface)
    }

    /// Unpacks, compiles and loads what the first simulation needs, so that it is not kept waiting; ends early when
    /// `cancel` asks for it. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// The FMU cannot be run here (see [`FmiError`]); [`FmiError::Cancelled`].
    pub fn prepare(&self, kind: Kind, cancel: &Cancel) -> Result<(), FmiError> {
        self.library_unless(self.choose(kind)?, cancel).map(drop)
    }

    /// The library for this platform, loaded at the first call; compiled before that if the FMU brings sources only.
    pub(crate) fn library(&self, kind: InterfaceKind) -> Result<Arc<Library>, FmiError> {
        self.library_unless(kind, &Cancel::default())
    }

    /// As [`library`](Self::library), unless `cancel` asks for an early end.
    pub(crate) fn library_unless(
        &self,
        kind: InterfaceKind,
        cancel: &Cancel,
    ) -> Result<Arc<Library>, FmiError> {
        // The lock is held while the library loads: a second thread waits instead of loading it again.
        let mut slot = self.side(kind).library.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(library) = &*slot {
            return Ok(Arc::clone(library));
        }
        let interface = self.check_interface(kind)?;
        let path = self.binary(interface, cancel)?;
        let library = Arc::new(self.load(&path, kind, interface)?);
        let idle: Weak<Idle> = Arc::downgrade(&self.side(kind).idle);
        library.shared().add_spares(idle);
        *slot = Some(Arc::clone(&library));
        Ok(library)
    }

    /// The file of the library for this platform: unpacked, or built from the sources.
    fn binary(&self, interface: &Interface, cancel: &Cancel) -> Result<PathBuf, FmiError> {
        let (archive, description) = (&self.inner.archive, self.description());
        let find = |part| {
            let root = archive.unpack_part(part, cancel)?;
            let names = description.fmi_version.folder_names();
            platform::find_binary(&root, &interface.model_identifier, names)
        };
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
        let root = archive.unpack_part(Part::Sources, cancel)?;
        // A folder may have been edited since it was opened: the library belongs to what is there now.
        let hash = archive.present_hash()?;
        let check = || match archive.present_hash()? {
            now if now == hash => Ok(()),
            _ => Err(FmiError::BadArchive {
                path: self.path().to_owned(),
                reason: "its files were changed while its library was built".to_owned(),
            }),
        };
        match source::build_unchanged(&root, description, interface, &hash, check) {
            // With the binaries of other platforms, for the message.
            Err(FmiError::NoSources { reason, .. }) => find(Part::Binaries)
                .map(|found| found.path)
                .map_err(|no_binary| self.no_library(no_binary, &reason)),
            outcome => outcome,
        }
    }

    /// Lends a private copy of the library.
    ///
    /// # Errors
    /// The library cannot be copied, or the copy cannot be loaded: there are too many already, the disk is full, there is
    /// no room for its thread-local storage.
    pub(crate) fn private_copy(&self, kind: InterfaceKind) -> Result<PrivateCopy, FmiError> {
        let interface = self.check_interface(kind)?;
        let library = self.library(kind)?;
        let root = self.running_root()?;
        let make = || CopyStore::new(library.path(), &root);
        let store = self.side(kind).copies.get_or_init(|| library.shared().copy_store(make));
        store.lend(|path| self.load(path, kind, interface))
    }

    fn load(&self, path: &Path, kind: InterfaceKind, interface: &Interface) -> Result<Library, FmiError> {
        let version = &self.description().fmi_version;
        Library::open(path, version, kind, &interface.model_identifier, &self.inner.options.loader)
    }

    /// Says the path the user knows instead of that of the private folder, and why there is nothing to build either.
    fn no_library(&self, no_binary: FmiError, no_sources: &str) -> FmiError {
        match no_binary {
            FmiError::NoBinary { wanted, present, .. } => FmiError::NoBinary {
                path: self.path().to_owned(),
                wanted,
                present: format!("{present}; none can be built: {no_sources}"),
            },
            other => other,
        }
    }

    fn side(&self, kind: InterfaceKind) -> &Side {
        match kind {
            InterfaceKind::ModelExchange => &self.inner.model_exchange,
            InterfaceKind::CoSimulation => &self.inner.co_simulation,
        }
    }
}
