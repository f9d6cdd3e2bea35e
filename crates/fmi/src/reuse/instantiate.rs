//! Instances of an FMU, made in a loaded copy of its library.

use super::copies::LoadedCopy;
use super::copy_use::CopyRequest;
use super::lend::CopyLease;
use super::restored_values::set_again;
use crate::description::Variable;
use crate::error::FmiError;
use crate::fmu::Fmu;
use crate::instance::{CoSimulation, Core, Instance, Instantiated, SetRecord};
use crate::log::LogFilter;
use crate::open_options::LogOptions;
use crate::simulation::running::no_instance;
use crate::sys::{InterfaceKind, Library, RawInstance, Request, Sizes};
use std::ffi::CString;
use std::sync::Arc;

pub(super) const NO_EVENT_MODE: &str = "the description promises an event mode in co-simulation, the model refuses to be instantiated \
                             with it: it is run without";

/// How an instance is made.
#[derive(Debug, Clone, Default)]
pub struct InstanceOptions {
    /// Name of the instance, for log messages; default: the name of the model.
    pub name: Option<String>,
    /// Ask the FMU to log. FMUs log what they think important without being asked, too.
    pub logging: bool,
    /// Of which categories, by their names; none: of all (see [`Instance::log_categories`]).
    pub log_categories: Vec<String>,
    /// Which lines of the log are kept (see [`Instance::log`]); an FMU that goes on logging is held to four lines
    /// for each point of time, step and event iteration, besides its errors, and the rest is counted.
    pub log_filter: LogFilter,
    /// Let the FMU show windows.
    pub visible: bool,
}

impl Fmu {
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
        Ok(Instance::by_hand(core, Box::new(lease)))
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
        Ok(Instance::by_hand(core, Box::new(lease)))
    }

    /// Makes an instance of either kind in a copy of the library that nobody else uses.
    pub(crate) fn instantiate_by_hand(
        &self,
        kind: InterfaceKind,
        options: &InstanceOptions,
    ) -> Result<(Core, CopyLease), FmiError> {
        let store = self.store(kind)?;
        self.running_root()?;
        let request = CopyRequest::for_good(self, kind);
        let is_new = |copy: &LoadedCopy| copy.record().keys().is_empty();
        let make = |lease: CopyLease| -> Result<_, FmiError> {
            lease.copy().free_idle();
            let raw = self.instantiate_in(lease.library(), kind, options)?;
            let mut core = Core::new(raw, self.clone());
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

    /// Makes an instance for simulations.
    pub(crate) fn instantiate_for_runs(
        &self,
        library: &Arc<Library>,
        kind: InterfaceKind,
    ) -> Result<RawInstance, FmiError> {
        let LogOptions { asked, categories, filter, .. } = self.logging();
        let options = InstanceOptions {
            logging: *asked,
            log_categories: categories.clone(),
            log_filter: *filter,
            ..InstanceOptions::default()
        };
        self.instantiate_in(library, kind, &options)
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
        let mut request = Request {
            name: &name,
            guid: &guid,
            resources: &resources,
            kind,
            event_mode: interface.capabilities.uses_event_mode() && !store.verdict(kind).no_event_mode,
            early_return: interface.capabilities.may_return_early(),
            visible: options.visible,
            logging: options.logging,
            log_filter: options.log_filter,
        };
        let sizes = Sizes { states: description.n_states(), indicators: description.n_event_indicators };
        let refusal = match RawInstance::new(library, &request, sizes) {
            Err(FmiError::Call(refusal)) if request.event_mode => FmiError::Call(refusal),
            outcome => return self.with_log_categories(outcome?, options),
        };
        // Some models promise an event mode that they do not have.
        request.event_mode = false;
        let raw = RawInstance::new(library, &request, sizes).map_err(|_| refusal)?;
        store.verdict(kind).no_event_mode = true;
        log::warn!("{}: {NO_EVENT_MODE}", description.model_name);
        self.with_log_categories(raw, options)
    }

    fn with_log_categories(
        &self,
        raw: RawInstance,
        options: &InstanceOptions,
    ) -> Result<RawInstance, FmiError> {
        if !options.logging || options.log_categories.is_empty() {
            return Ok(raw);
        }
        let mut core = Core::new(raw, self.clone());
        core.set_logging(true, &options.log_categories)?;
        Ok(core.raw)
    }
}

impl SetRecord for CopyLease {
    fn note_set(&self, variable: &Variable) {
        self.copy().record().note([(variable.kind, variable.value_reference)]);
    }
}
