//! An opened FMU: its folder, its description, the store of its loaded library (found when first needed).

use crate::archive::{Archive, Part};
use crate::cancel::Cancel;
use crate::description::{Causality, Interface, ModelDescription, Quirk, QuirkKind, Variable, VariableKind};
use crate::error::FmiError;
use crate::instance::{CoSimulation, Core, Instance, Instantiated};
use crate::open_options::{LogOptions, OpenOptions};
use crate::options::{Kind, SimulateOptions};
use crate::plan::SimulationPlan;
use crate::platform;
use crate::reuse::{
    CopyLease, CopyRequest, CopyStore, Key, LoadedCopy, Reuse, Sharing, Source, StoreUse, set_again,
};
use crate::running::no_instance;
use crate::simulation::Simulator;
use crate::source;
use crate::sys::{InterfaceKind, Library, LoadFrom, LogFilter, RawInstance, Request, Sizes};
use crate::trajectory::Trajectory;
use std::ffi::CString;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

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

/// Fields are dropped in this order: idle instances, folder.
#[derive(Debug)]
struct Inner {
    /// The library of each way of running the model; found when first needed.
    stores: [Mutex<Option<StoreUse>>; 2],
    /// The model computes its variables with the derivatives only.
    has_stale_outputs: AtomicBool,
    /// Of each way: how long the last simulation of a session took, in ns; 0: there was none.
    last_runs: [AtomicU64; 2],
    /// Value references of the variables of type Real and their positions, sorted; made when first needed.
    real_references: OnceLock<Vec<(u32, usize)>>,
    /// Departures from the standard that showed in runs.
    quirks_seen: Mutex<Vec<Quirk>>,
    description: ModelDescription,
    options: OpenOptions,
    archive: Arc<Archive>,
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
        let mut description = ModelDescription::read_with(&archive, &options.description, &options.cancel)?;
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
            stores: Default::default(),
            has_stale_outputs: AtomicBool::new(false),
            last_runs: Default::default(),
            real_references: OnceLock::new(),
            quirks_seen: Mutex::default(),
            description,
            options: OpenOptions { cancel: Cancel::default(), ..options.clone() },
            archive: Arc::new(archive),
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
        self.simulate_with(options, &mut || ControlFlow::Continue(()))
    }

    /// As [`simulate`](Self::simulate); `poll` is asked before every step, and `Break` ends the simulation there.
    ///
    /// # Errors
    /// As [`simulate`](Self::simulate).
    pub fn simulate_with(
        &self,
        options: &SimulateOptions,
        poll: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Trajectory, FmiError> {
        let plan = Arc::new(SimulationPlan::new(self, options)?);
        Simulator::new(Arc::clone(&plan))?.trajectory_with(plan.parameter_starts(), poll)
    }

    /// How long the last simulation of a [`Session`](crate::Session) of this FMU took, by any of its clones; loading the
    /// library does not count. `None`: there was none.
    pub fn last_run(&self, kind: InterfaceKind) -> Option<Duration> {
        let nanoseconds = self.inner.last_runs[kind as usize].load(Ordering::Relaxed);
        (nanoseconds > 0).then(|| Duration::from_nanos(nanoseconds))
    }

    pub(crate) fn note_run(&self, kind: InterfaceKind, took: Duration) {
        let nanoseconds = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        self.inner.last_runs[kind as usize].store(nanoseconds.max(1), Ordering::Relaxed);
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
        let (core, lease) = self.instantiate_by_hand(InterfaceKind::ModelExchange, options)?;
        Ok(Instance::by_hand(core, lease))
    }

    /// Makes a co-simulation instance. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// As [`instantiate`](Self::instantiate).
    pub fn instantiate_co_simulation(
        &self,
        options: &InstanceOptions,
    ) -> Result<Instance<Instantiated, CoSimulation>, FmiError> {
        let (core, lease) = self.instantiate_by_hand(InterfaceKind::CoSimulation, options)?;
        Ok(Instance::by_hand(core, lease))
    }

    /// Makes an instance of either kind in a copy of the library that nobody else uses.
    pub(crate) fn instantiate_by_hand(
        &self,
        kind: InterfaceKind,
        options: &InstanceOptions,
    ) -> Result<(Core, CopyLease), FmiError> {
        let store = self.store(kind)?;
        self.running_root()?;
        let open = |from: LoadFrom<'_>| self.load(from, kind);
        let request = CopyRequest { kind, sharing: Sharing::Copies, tenant: None, open: &open };
        let is_new = |copy: &LoadedCopy| copy.record().keys().is_empty();
        let make = |lease: CopyLease| -> Result<_, FmiError> {
            lease.copy().free_idle();
            let raw = self.instantiate_in(lease.library(), kind, options)?;
            let mut core = Core::new(raw, self.clone(), None);
            let is_new = set_again(&mut core, kind, &lease);
            Ok((core, lease, is_new))
        };
        let lease = store.lend(&request, &mut || true)?.ok_or_else(no_instance)?;
        let (core, lease, is_as_new) = make(lease)?;
        if is_as_new {
            return Ok((core, lease));
        }
        match store.lend_if_free(&request, is_new) {
            Some(other) => {
                drop(core);
                drop(lease);
                make(other).map(|(core, lease, _)| (core, lease))
            }
            None => Ok((core, lease)),
        }
    }

    /// What is done with the log.
    pub(crate) fn logging(&self) -> LogOptions {
        self.inner.options.logging
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
        let store = self.store(kind)?;
        let description = self.description();
        let text = |what: &str, text: &str| {
            CString::new(text)
                .map_err(|_| FmiError::BadSetting { problem: format!("the {what} holds a NUL character") })
        };
        let name = text("name of the instance", options.name.as_deref().unwrap_or(&description.model_name))?;
        let guid = text("guid", &description.guid)?;
        // A cleaner of the folder for temporary files may have been there since the library was loaded.
        let resources = store.resources_of(library.path(), self.running_root()?.join("resources"));
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
            event_mode: interface.capabilities.uses_event_mode() && !store.verdicts.is_event_mode_refused(),
            early_return: interface.capabilities.may_return_early(),
            intermediate: &intermediate,
            visible: options.visible,
            logging: options.logging,
            log_filter: options.log_filter,
        };
        let sizes = Sizes { states: description.n_states(), indicators: description.n_event_indicators };
        let refusal = match RawInstance::new(library, &request, sizes) {
            Err(FmiError::Call(refusal)) if request.event_mode => FmiError::Call(refusal),
            outcome => return outcome,
        };
        // Some models promise an event mode that they do not have.
        request.event_mode = false;
        let raw = RawInstance::new(library, &request, sizes).map_err(|_| refusal)?;
        store.verdicts.refuse_event_mode();
        log::warn!("{}: {NO_EVENT_MODE}", description.model_name);
        Ok(raw)
    }

    /// Departures from the standard that showed when the FMU was run; those of its description are in
    /// [`ModelDescription::quirks`].
    pub fn quirks_seen(&self) -> Vec<Quirk> {
        let store = self.known_store(InterfaceKind::CoSimulation);
        let refused = store.is_some_and(|store| store.verdicts.is_event_mode_refused());
        let stale = self.inner.has_stale_outputs.load(Ordering::Relaxed);
        let quirk = |message: &str| Quirk { kind: QuirkKind::Promise, message: message.to_owned(), line: 0 };
        let mut seen = self.inner.quirks_seen.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let promises = [(refused, NO_EVENT_MODE), (stale, STALE_OUTPUTS)];
        seen.extend(promises.into_iter().filter(|(is_seen, _)| *is_seen).map(|(_, message)| quirk(message)));
        seen
    }

    /// Lists a departure from the standard that showed in a run among the quirks; one that is new goes to the program's
    /// logger, too.
    pub(crate) fn note_quirk(&self, kind: QuirkKind, message: String) {
        let quirk = Quirk { kind, message, line: 0 };
        let mut seen = self.inner.quirks_seen.lock().unwrap_or_else(PoisonError::into_inner);
        if !seen.contains(&quirk) {
            log::warn!("{}: {}", self.description().model_name, quirk.message);
            seen.push(quirk);
        }
    }

    /// Notes that simulations write into the resources, which all of them would see: from now on each has a newly loaded copy of
    /// the library, with the resources as they were in the archive (of a folder: as they are now).
    ///
    /// # Errors
    /// The resources cannot be unpacked again.
    pub(crate) fn note_written_resource(
        &self,
        store: &CopyStore,
        kind: InterfaceKind,
        file: &Path,
    ) -> Result<(), FmiError> {
        self.inner.archive.renew_resources()?;
        store.set_private_resources();
        store.verdicts.set_history(kind, Reuse::Reload);
        let root = self.running_root()?;
        let name = file.strip_prefix(&root).unwrap_or(file).display();
        let message = format!(
            "simulations write into the resources ({name}): every simulation gets a newly loaded copy of the library, with \
             resources of its own, from now on; results from before may be wrong"
        );
        self.note_quirk(QuirkKind::Promise, message);
        Ok(())
    }

    /// Notes that simulations depend on earlier ones: from now on each is begun by `reuse`.
    pub(crate) fn note_history(&self, kind: InterfaceKind, reuse: Reuse) -> Result<(), FmiError> {
        self.store(kind)?.verdicts.set_history(kind, reuse);
        let way = match reuse {
            Reuse::Reload => "a newly loaded copy of the library",
            _ => "a new instance",
        };
        let message = format!(
            "a simulation depends on earlier ones: the model keeps a state that no variable shows, and that resetting does \
             not bring back; every simulation gets {way} from now on, and results from before may be wrong"
        );
        self.note_quirk(QuirkKind::Promise, message);
        Ok(())
    }

    /// Notes that simulations in newly loaded copies differ.
    pub(crate) fn note_not_reproducible(&self, kind: InterfaceKind) -> Result<(), FmiError> {
        self.store(kind)?.verdicts.set_not_reproducible(kind);
        let message = "two simulations in newly loaded copies of the library differ: no result can be reproduced (unless what it keeps \
             in the C library or in files is disturbed by other simulations at the same time: then sharing = serial helps)";
        self.note_quirk(QuirkKind::Promise, message.to_owned());
        Ok(())
    }

    /// How often a simulation was found to depend on earlier ones (see [`quirks_seen`](Self::quirks_seen)): each time, a safer
    /// way of bringing instances back was taken from then on, and results from before may be wrong.
    pub fn n_history_findings(&self, kind: InterfaceKind) -> u64 {
        self.known_store(kind).map_or(0, |store| store.verdicts.n_found(kind))
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

    pub(crate) fn interface(&self, kind: InterfaceKind) -> Option<&Interface> {
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
        let kind = self.choose(kind)?;
        let store = self.store_unless(kind, cancel)?;
        let open = |from: LoadFrom<'_>| self.load(from, kind);
        store
            .lend(&CopyRequest { kind, sharing: Sharing::Copies, tenant: None, open: &open }, &mut || {
                false
            })?;
        Ok(())
    }

    /// How instances are reset, for the interface that is used where nothing else is asked for; `None` before it was tried.
    pub fn reuse(&self) -> Option<Reuse> {
        self.choose(Kind::Auto).ok().and_then(|kind| self.reuse_of(kind))
    }

    /// How instances are reset; `None` before it was tried.
    pub fn reuse_of(&self, kind: InterfaceKind) -> Option<Reuse> {
        self.known_store(kind)?.verdicts.reuse(kind)
    }

    /// How simulations that run in parallel share the process where nothing is asked for: with copies of the library, or one at
    /// a time where these would share state or cannot be loaded. `None` before the library was first needed.
    pub fn sharing_of(&self, kind: InterfaceKind) -> Option<Sharing> {
        self.known_store(kind).map(|store| store.sharing())
    }

    fn slot(&self, kind: InterfaceKind) -> MutexGuard<'_, Option<StoreUse>> {
        self.inner.stores[kind as usize].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The loaded copies of the library; `None` before they are first needed.
    fn known_store(&self, kind: InterfaceKind) -> Option<Arc<CopyStore>> {
        self.slot(kind).as_deref().map(Arc::clone)
    }

    /// The loaded copies of the library for this platform, which is compiled before that if the FMU brings sources only.
    pub(crate) fn store(&self, kind: InterfaceKind) -> Result<Arc<CopyStore>, FmiError> {
        self.store_unless(kind, &Cancel::default())
    }

    /// As [`store`](Self::store), unless `cancel` asks for an early end.
    pub(crate) fn store_unless(
        &self,
        kind: InterfaceKind,
        cancel: &Cancel,
    ) -> Result<Arc<CopyStore>, FmiError> {
        // The lock is held meanwhile: a second thread waits instead of compiling it again.
        let mut slot = self.slot(kind);
        if let Some(store) = &*slot {
            return Ok(Arc::clone(store));
        }
        let library = self.binary(self.check_interface(kind)?, cancel)?;
        let archive = &self.inner.archive;
        if let Some(file) = archive.changed_library() {
            let path = self.path().to_owned();
            let name = file.strip_prefix(archive.unpack()?).unwrap_or(file).display();
            let reason =
                format!("{name} was written over or removed after the folder had been opened; open it again");
            return Err(FmiError::BadArchive { path, reason });
        }
        let (root, loader) = (archive.unpack_part(Part::Running, cancel)?, self.inner.options.loader);
        let (key, identity) = match (library.strip_prefix(&root), archive.fingerprint()) {
            (Ok(place), Some(content)) => (Key::Content(content, place.to_owned(), loader), None),
            _ => {
                let metadata = library.metadata().map_err(FmiError::io("open", &library))?;
                let identity = platform::file_identity(&metadata);
                (Key::File(identity.place(&library), identity.clone(), loader), Some(identity))
            }
        };
        let source = Source { library, root, identity, home: Some(Arc::clone(archive) as _) };
        let store = slot.insert(StoreUse::new(key, source));
        Ok(Arc::clone(store))
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
        match source::build_unchanged(
            &root,
            description,
            interface,
            &hash,
            (cancel, self.inner.options.compile_time),
            check,
        ) {
            // With the binaries of other platforms, for the message.
            Err(FmiError::NoSources { reason, .. }) => find(Part::Binaries)
                .map(|found| found.path)
                .map_err(|no_binary| self.no_library(no_binary, &reason)),
            outcome => outcome,
        }
    }

    /// Loads the library. **This runs its constructors.**
    pub(crate) fn load(&self, from: LoadFrom<'_>, kind: InterfaceKind) -> Result<Library, FmiError> {
        let interface = self.check_interface(kind)?;
        let version = &self.description().fmi_version;
        Library::open(from, version, kind, &interface.model_identifier, &self.inner.options.loader)
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
}
