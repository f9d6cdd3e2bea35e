//! Instances of an FMU, created in its loaded library.

use crate::cancel_request::CancelRequest;
use crate::description::QuirkKind;
use crate::error::FmiError;
use crate::fmu::Fmu;
use crate::instance::{CoSimulation, Core, Instance, Instantiated};
use crate::libraries::{LoadedLibrary, Setting};
use crate::log::LogFilter;
use crate::open_options::LogOptions;
use crate::sys::{InterfaceKind, Library, RawInstance, Request, Sizes, instance_suffix};
use serde::{Deserialize, Serialize};
use std::ffi::CString;
use std::sync::Arc;

const NO_EVENT_MODE: &str = "the model description declares event mode in co-simulation, but the model \
                             cannot be instantiated with event mode and runs without it";

const SO_OFTEN: &str = "a loaded library supports only a limited number of instances; simulations continue in newly loaded \
     copies";

/// Options for creating an instance.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct InstanceOptions {
    /// Name of the instance. Default: the name of the model. Worker processes that run at the same time
    /// append `_2`, `_3` and so on.
    pub name: Option<String>,
    /// Requests logging from the FMU. FMUs also log important messages without a request.
    pub logging: bool,
    /// Names of the log categories to request; empty for all categories (see [`Instance::log_categories`]).
    pub log_categories: Vec<String>,
    /// Filter for the log lines (see [`Instance::log`]). An FMU that logs continuously is limited to four
    /// lines per time point, step and event iteration, plus its errors. The remaining lines are only counted.
    pub log_filter: LogFilter,
    /// Allows the FMU to show windows.
    pub visible: bool,
}

impl Fmu {
    /// Creates a model-exchange instance. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// Returns an error if the FMU cannot be run on this machine (see [`FmiError`]), or its instantiation
    /// fails.
    pub fn instantiate(&self) -> Result<Instance<Instantiated>, FmiError> {
        self.instantiate_with(&InstanceOptions::default())
    }

    /// Creates a model-exchange instance with a name and logging options.
    ///
    /// # Errors
    /// Returns the errors of [`instantiate`](Self::instantiate).
    pub fn instantiate_with(&self, options: &InstanceOptions) -> Result<Instance<Instantiated>, FmiError> {
        let (core, library) = self.instantiate_by_hand(InterfaceKind::ModelExchange, options)?;
        Ok(Instance::by_hand(core, library))
    }

    /// Creates a co-simulation instance. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// Returns the errors of [`instantiate`](Self::instantiate).
    pub fn instantiate_co_simulation(
        &self,
        options: &InstanceOptions,
    ) -> Result<Instance<Instantiated, CoSimulation>, FmiError> {
        let (core, library) = self.instantiate_by_hand(InterfaceKind::CoSimulation, options)?;
        Ok(Instance::by_hand(core, library))
    }

    /// Creates an instance of either kind, and returns it with its loaded library.
    pub(crate) fn instantiate_by_hand(
        &self,
        kind: InterfaceKind,
        options: &InstanceOptions,
    ) -> Result<(Core, Arc<LoadedLibrary>), FmiError> {
        let mut library = self.library(kind, None, &CancelRequest::default(), &mut || true)?;
        let raw = self.instantiate_in(&mut library, kind, None, options)?;
        Ok((Core::new(raw, self.clone()), library))
    }

    /// Creates an instance for simulations that set these variables.
    pub(crate) fn instantiate_for_runs(
        &self,
        library: &mut Arc<LoadedLibrary>,
        kind: InterfaceKind,
        settings: &[Setting],
    ) -> Result<RawInstance, FmiError> {
        let LogOptions { requested, categories, filter, .. } = self.logging();
        let options = InstanceOptions {
            logging: *requested,
            log_categories: categories.clone(),
            log_filter: *filter,
            ..InstanceOptions::default()
        };
        self.instantiate_in(library, kind, Some(settings), &options)
    }

    /// Creates an instance of either kind. If a model can be instantiated only a limited number of times per
    /// loaded library, another copy is loaded.
    fn instantiate_in(
        &self,
        library: &mut Arc<LoadedLibrary>,
        kind: InterfaceKind,
        settings: Option<&[Setting]>,
        options: &InstanceOptions,
    ) -> Result<RawInstance, FmiError> {
        let is_used = library.is_used();
        let refused = match self.instantiate_once(&library.functions(kind)?, kind, options) {
            Err(refused @ FmiError::Call(_)) if is_used && !library.is_fatal() => refused,
            outcome => return outcome,
        };
        self.give_up_library(library);
        let Ok(other) = self.library(kind, settings, &CancelRequest::default(), &mut || true) else {
            return Err(refused);
        };
        // If instantiation fails here as well, the use of the library was not the cause.
        let made = self.instantiate_once(&other.functions(kind)?, kind, options).map_err(|_| refused)?;
        *library = other;
        self.note_quirk(QuirkKind::Promise, SO_OFTEN);
        Ok(made)
    }

    fn instantiate_once(
        &self,
        library: &Arc<Library>,
        kind: InterfaceKind,
        options: &InstanceOptions,
    ) -> Result<RawInstance, FmiError> {
        let interface = self.check_interface(kind)?;
        let description = self.description();
        let text = |what: &str, text: &str| {
            CString::new(text)
                .map_err(|_| FmiError::BadSetting(format!("the {what} contains a NUL character")))
        };
        // The name is unique among the processes that run at the same time, because some models derive file
        // names from it.
        let default = || format!("{}{}", description.model_name, instance_suffix());
        let name = text("instance name", &options.name.clone().unwrap_or_else(default))?;
        let guid = text("guid", &description.guid)?;
        // Temporary files may have been deleted since the library was loaded.
        let resources = self.running_root()?.join("resources");
        let mut request = Request {
            name: &name,
            guid: &guid,
            resources: &resources,
            kind,
            event_mode: interface.capabilities.uses_event_mode() && !self.reset_knowledge(kind).no_event_mode,
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
        // Some models declare an event mode that they do not support.
        request.event_mode = false;
        let raw = RawInstance::new(library, &request, sizes).map_err(|_| refusal)?;
        self.reset_knowledge(kind).no_event_mode = true;
        self.note_quirk(QuirkKind::Promise, NO_EVENT_MODE);
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
