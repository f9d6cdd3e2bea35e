//! An opened FMU: its folder, its description, its library (loaded when first needed), its idle instances.

use crate::archive::Archive;
use crate::description::{Interface, ModelDescription, VariableKind};
use crate::error::FmiError;
use crate::instance::{Instance, Instantiated};
use crate::options::SimulateOptions;
use crate::plan::{Setting, SimulationPlan};
use crate::platform;
use crate::simulation::Simulator;
use crate::source;
use crate::sys::{FloatEnvironment, Library, RawInstance, Request, Shared, Sizes, Spares};
use crate::trajectory::Trajectory;
use std::ffi::CString;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

/// Instances kept for later, per FMU.
const MAX_IDLE: usize = 4;

/// An opened FMU. Clones share everything and are cheap.
///
/// Opening and inspecting run no code of the FMU; the first instance loads its library, which does.
#[derive(Debug, Clone)]
pub struct Fmu {
    inner: Arc<Inner>,
}

/// Fields are dropped in this order: instances, library, folder.
#[derive(Debug)]
struct Inner {
    idle: Arc<Idle>,
    library: Mutex<Option<Arc<Library>>>,
    /// Value references of the variables of type Real, sorted; made when first needed.
    real_references: OnceLock<Vec<u32>>,
    description: ModelDescription,
    path: PathBuf,
    archive: Archive,
}

/// Instances that nobody uses at present, each with everything that was ever set in it. Resetting may leave what was set
/// (the first-use test does not see variables that its plan does not set), so an instance goes only to plans that set all
/// of it again.
#[derive(Debug, Default)]
struct Idle(Mutex<Vec<(RawInstance, Arc<[Setting]>)>>);

impl Idle {
    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<(RawInstance, Arc<[Setting]>)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Spares for Idle {
    fn free_all(&self) {
        let idle = std::mem::take(&mut *self.lock());
        drop(idle);
    }
}

/// How the instances of an FMU are brought back to their beginning between simulations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reuse {
    /// By the FMU's reset function: it was seen to restore everything, bit for bit.
    Reset,
    /// By a new instance for every simulation: reset is missing, fails, or leaves traces.
    Reinstantiate,
}

// Verdicts as the library stores them; 0: none.
const RESET: u8 = 1;
const REINSTANTIATE: u8 = 2;

/// How an instance is made.
#[derive(Debug, Clone, Default)]
pub struct InstanceOptions {
    /// Name of the instance, for log messages; default: the name of the model.
    pub name: Option<String>,
    /// Ask the FMU to log.
    pub logging: bool,
    /// Let the FMU show windows.
    pub visible: bool,
}

impl Fmu {
    /// Opens a `.fmu` file or an unpacked folder and reads its description.
    ///
    /// # Errors
    /// Everything that can be wrong with the file; see [`FmiError`].
    pub fn open(path: impl AsRef<Path>) -> Result<Fmu, FmiError> {
        let path = path.as_ref();
        let archive = Archive::open(path)?;
        let description = ModelDescription::read(&archive)?;
        Ok(Fmu {
            inner: Arc::new(Inner {
                idle: Arc::default(),
                library: Mutex::new(None),
                real_references: OnceLock::new(),
                description,
                path: path.to_owned(),
                archive,
            }),
        })
    }

    /// The model description.
    pub fn description(&self) -> &ModelDescription {
        &self.inner.description
    }

    /// Refuses value references that no variable of type Real has: FMUs use them as indices without looking.
    pub(crate) fn check_real_references(
        &self,
        call: &'static str,
        references: &[u32],
    ) -> Result<(), FmiError> {
        let known = self.inner.real_references.get_or_init(|| {
            let reals = self.description().variables.iter().filter(|v| v.kind == VariableKind::Real);
            let mut known: Vec<u32> = reals.map(|v| v.value_reference).collect();
            known.sort_unstable();
            known.dedup();
            known
        });
        match references.iter().find(|reference| known.binary_search(reference).is_err()) {
            Some(&reference) => Err(FmiError::UnknownReference { call, reference }),
            None => Ok(()),
        }
    }

    /// The path it was opened by.
    pub fn path(&self) -> &Path {
        &self.inner.path
    }

    /// The folder that holds its (unpacked) content.
    pub fn root(&self) -> &Path {
        self.inner.archive.root()
    }

    /// SHA-256 of its content, in hexadecimal.
    pub fn content_hash(&self) -> &str {
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
        let interface = self.check_runnable()?;
        let library = self.library()?;
        let description = self.description();
        let text = |what: &str, text: &str| {
            CString::new(text)
                .map_err(|_| FmiError::BadSetting { problem: format!("the {what} holds a NUL character") })
        };
        let name = text("name of the instance", options.name.as_deref().unwrap_or(&description.model_name))?;
        let guid = text("guid", &description.guid)?;
        let resources = self.root().join("resources");
        let request = Request {
            name: &name,
            guid: &guid,
            resources: &resources,
            visible: options.visible,
            logging: options.logging,
        };
        let sizes = Sizes { states: description.n_states(), indicators: description.n_event_indicators };
        let only_one = interface.capabilities.can_be_instantiated_only_once_per_process;
        if only_one || library.shared().is_dependent() {
            library.shared().set_dependent();
            library.shared().free_spares();
        }
        // The FMU may change the floating-point mode of this thread and shall not.
        let _guard = FloatEnvironment::standard();
        let raw = RawInstance::new(&library, &request, sizes, only_one)?;
        Ok(Instance::from_raw(raw, self.clone()))
    }

    /// Whether this version can simulate the FMU; the interface it would use.
    ///
    /// # Errors
    /// [`FmiError::UnsupportedVersion`], [`FmiError::NoModelExchange`], [`FmiError::NeedsExecutionTool`].
    pub fn check_runnable(&self) -> Result<&Interface, FmiError> {
        let description = self.description();
        Library::check_version(&description.fmi_version)?;
        let interface = description
            .model_exchange
            .as_ref()
            .ok_or_else(|| FmiError::NoModelExchange { model: description.model_name.clone() })?;
        if interface.capabilities.needs_execution_tool {
            return Err(FmiError::NeedsExecutionTool {
                model: description.model_name.clone(),
                tool: description.generation_tool.clone(),
            });
        }
        Ok(interface)
    }

    /// The library for this platform, loaded at the first call; compiled before that if the FMU brings sources only.
    pub(crate) fn library(&self) -> Result<Arc<Library>, FmiError> {
        // The lock is held while the library loads: a second thread waits instead of loading it again.
        let mut slot = self.inner.library.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(library) = &*slot {
            return Ok(Arc::clone(library));
        }
        let interface = self.check_runnable()?;
        let description = self.description();
        let path = match platform::find_binary(
            self.root(),
            &interface.model_identifier,
            description.fmi_version.major,
        ) {
            Ok(found) => {
                if let Some(note) = &found.note {
                    log::warn!("{}: {note}", self.path().display());
                }
                found.path
            }
            Err(no_binary) => {
                // A folder may have been edited since it was opened: the library belongs to what is there now.
                let hash = self.inner.archive.present_hash()?;
                let check = || match self.inner.archive.present_hash()? {
                    now if now == hash => Ok(()),
                    _ => Err(FmiError::BadArchive {
                        path: self.path().to_owned(),
                        reason: "its files were changed while its library was built".to_owned(),
                    }),
                };
                match source::build_unchanged(self.root(), description, interface, &hash, check) {
                    Ok(path) => path,
                    Err(FmiError::NoSources { .. }) => return Err(self.with_own_path(no_binary)),
                    Err(error) => return Err(error),
                }
            }
        };
        let library = Arc::new(Library::open(&path, &description.fmi_version)?);
        let idle: Weak<Idle> = Arc::downgrade(&self.inner.idle);
        library.shared().add_spares(idle);
        *slot = Some(Arc::clone(&library));
        Ok(library)
    }

    /// Says the path the user knows instead of that of the private folder.
    fn with_own_path(&self, error: FmiError) -> FmiError {
        match error {
            FmiError::NoBinary { wanted, present, .. } => {
                FmiError::NoBinary { path: self.path().to_owned(), wanted, present }
            }
            other => other,
        }
    }

    /// An instance that was used before, in which nothing was set but what `settings` set again; to be reset before use.
    pub(crate) fn take_idle(&self, settings: &[Setting]) -> Option<RawInstance> {
        let mut idle = self.inner.idle.lock();
        let covered = |set: &[Setting]| set.iter().all(|one| settings.binary_search(one).is_ok());
        let place = idle.iter().rposition(|(_, set)| covered(set))?;
        Some(idle.remove(place).0)
    }

    /// Keeps an instance, in which `settings` were set, for later; frees another one if there are many.
    pub(crate) fn put_idle(&self, raw: RawInstance, settings: &Arc<[Setting]>) {
        if raw.is_dead() || raw.is_stale() {
            return;
        }
        let surplus = {
            let mut idle = self.inner.idle.lock();
            idle.push((raw, Arc::clone(settings)));
            (idle.len() > MAX_IDLE).then(|| idle.remove(0))
        };
        drop(surplus);
    }

    /// Frees the idle instances.
    pub(crate) fn drop_idle(&self) {
        self.inner.idle.free_all();
    }

    /// What all users of the library share; `None` before it is loaded.
    pub(crate) fn shared(&self) -> Option<Arc<Shared>> {
        let slot = self.inner.library.lock().unwrap_or_else(PoisonError::into_inner);
        slot.as_ref().map(|library| Arc::clone(library.shared()))
    }

    /// What is known about reset; `None` before it was tried.
    pub fn reuse(&self) -> Option<Reuse> {
        match self.shared()?.reuse() {
            RESET => Some(Reuse::Reset),
            REINSTANTIATE => Some(Reuse::Reinstantiate),
            _ => None,
        }
    }

    pub(crate) fn set_reuse(&self, reuse: Reuse) {
        if let Some(shared) = self.shared() {
            // Once found out, a broken reset stays broken.
            shared.worsen_reuse(match reuse {
                Reuse::Reset => RESET,
                Reuse::Reinstantiate => REINSTANTIATE,
            });
        }
        if reuse == Reuse::Reinstantiate {
            self.drop_idle();
        }
    }
}

/// Opens each file once: as long as a file does not change, [`open`](Self::open) returns the same [`Fmu`].
///
/// A file counts as unchanged while its path, identity on the disk, size and time of modification are the same; it is
/// not read for that. Of a folder, `modelDescription.xml` and the folder itself are looked at.
#[derive(Debug)]
pub struct FmuCache {
    capacity: usize,
    /// The most recently used last.
    entries: Mutex<Vec<(Key, Fmu)>>,
}

/// What tells one file from another, and from its earlier self.
type Key = (PathBuf, platform::FileIdentity, Option<platform::FileIdentity>);

impl FmuCache {
    /// A cache that holds at most `capacity` FMUs (at least one); the one not used for the longest time goes first.
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), entries: Mutex::new(Vec::new()) }
    }

    /// The FMU at `path`, opened now or before.
    ///
    /// # Errors
    /// As [`Fmu::open`].
    pub fn open(&self, path: impl AsRef<Path>) -> Result<Fmu, FmiError> {
        let path = path.as_ref();
        let key = key_of(path)?;
        if let Some(fmu) = self.find(&key) {
            return Ok(fmu);
        }
        // Not under the lock: opening one file does not keep others waiting. Two threads may both open a new file;
        // the first to finish is kept.
        let fmu = Fmu::open(path)?;
        if let Some(first) = self.find(&key) {
            return Ok(first);
        }
        let dropped: Vec<(Key, Fmu)> = {
            let mut entries = self.entries();
            // An older version of the same file will not be asked for again.
            let mut dropped: Vec<_> = entries.extract_if(.., |(old, _)| old.0 == key.0).collect();
            if entries.len() >= self.capacity {
                dropped.push(entries.remove(0));
            }
            entries.push((key, fmu.clone()));
            dropped
        };
        drop(dropped);
        Ok(fmu)
    }

    /// Forgets everything. FMUs that are in use stay open.
    pub fn clear(&self) {
        let entries = std::mem::take(&mut *self.entries());
        drop(entries);
    }

    fn find(&self, key: &Key) -> Option<Fmu> {
        let mut entries = self.entries();
        let position = entries.iter().position(|(known, _)| known == key)?;
        let entry = entries.remove(position);
        let fmu = entry.1.clone();
        entries.push(entry);
        Some(fmu)
    }

    fn entries(&self) -> std::sync::MutexGuard<'_, Vec<(Key, Fmu)>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn key_of(path: &Path) -> Result<Key, FmiError> {
    let canonical = path.canonicalize().map_err(FmiError::io("open", path))?;
    let metadata = canonical.metadata().map_err(FmiError::io("open", path))?;
    let inner = if metadata.is_dir() {
        canonical.join("modelDescription.xml").metadata().ok().map(|inner| platform::file_identity(&inner))
    } else {
        None
    };
    Ok((canonical, platform::file_identity(&metadata), inner))
}
