//! Instances of an FMU, made in its loaded library.

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

const NO_EVENT_MODE: &str = "the description promises an event mode in co-simulation, the model refuses to be instantiated with it: it \
                             is run without";

const SO_OFTEN: &str =
    "a loaded library can be instantiated only so often: simulations go on in newly loaded copies of it";

/// Options with which an instance is made.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct InstanceOptions {
    /// Name of the instance; default: the name of the model, in the worker processes of a program that run at
    /// the same time with `_2`, `_3` and so on.
    pub name: Option<String>,
    /// Ask the FMU to log. FMUs log what they think important without being asked, too.
    pub logging: bool,
    /// Of which categories, by their names; none: of all (see [`Instance::log_categories`]).
    pub log_categories: Vec<String>,
    /// Filter for the lines of the log (see [`Instance::log`]); an FMU that goes on logging is held to four
    /// lines for each point of time, step and event iteration, besides its errors, and the rest is counted.
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
        let (core, library) = self.instantiate_by_hand(InterfaceKind::ModelExchange, options)?;
        Ok(Instance::by_hand(core, library))
    }

    /// Makes a co-simulation instance. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// As [`instantiate`](Self::instantiate).
    pub fn instantiate_co_simulation(
        &self,
        options: &InstanceOptions,
    ) -> Result<Instance<Instantiated, CoSimulation>, FmiError> {
        let (core, library) = self.instantiate_by_hand(InterfaceKind::CoSimulation, options)?;
        Ok(Instance::by_hand(core, library))
    }

    /// Makes an instance of either kind, and says in which loaded library.
    pub(crate) fn instantiate_by_hand(
        &self,
        kind: InterfaceKind,
        options: &InstanceOptions,
    ) -> Result<(Core, Arc<LoadedLibrary>), FmiError> {
        let mut library = self.library(kind, None, &CancelRequest::default(), &mut || true)?;
        let raw = self.instantiate_in(&mut library, kind, None, options)?;
        Ok((Core::new(raw, self.clone()), library))
    }

    /// Makes an instance for simulations that set these variables.
    pub(crate) fn instantiate_for_runs(
        &self,
        library: &mut Arc<LoadedLibrary>,
        kind: InterfaceKind,
        settings: &[Setting],
    ) -> Result<RawInstance, FmiError> {
        let LogOptions { asked, categories, filter, .. } = self.logging();
        let options = InstanceOptions {
            logging: *asked,
            log_categories: categories.clone(),
            log_filter: *filter,
            ..InstanceOptions::default()
        };
        self.instantiate_in(library, kind, Some(settings), &options)
    }

    /// Makes an instance of either kind. Some models can be instantiated only so often in one loaded library:
    /// then another is loaded.
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
        // Where that fails, too, it is not because the library was used.
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
            CString::new(text).map_err(|_| FmiError::BadSetting(format!("the {what} holds a NUL character")))
        };
        // Unique among the processes that run at the same time: models name files by it.
        let default = || format!("{}{}", description.model_name, instance_suffix());
        let name = text("name of the instance", &options.name.clone().unwrap_or_else(default))?;
        let guid = text("guid", &description.guid)?;
        // A cleaner of the folder for temporary files may have been there since the library was loaded.
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
        // Some models promise an event mode that they do not have.
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
