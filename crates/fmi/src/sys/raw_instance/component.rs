//! One component of an FMU: the sole owner of its pointer. Every call is checked before and after.

use super::buffers::ValueBuffers;
use super::fault::{Fault, Outcome, Sizes};
use super::slots::SavedStates;
use crate::description::DependencyKind;
use crate::error::{CallFailure, FmiError, LogLine, Result, Status};
use crate::macros::getters;
use crate::sys::callbacks::Callbacks;
use crate::sys::environment::Inside;
use crate::sys::function::{Answer, Function, call};
use crate::sys::functions::{Functions, GetVector, Plain, derivative};
use crate::sys::library::Library;
use crate::sys::shared_page;
use crate::sys::types::{Component, Direction, ElementDependency, EventInfo, Experiment, Request, StepInfo};
use crate::sys::worker_state::{is_avoided, note_kept, refusal};
use std::ffi::{CString, c_int};
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::sync::Arc;

/// Number of log lines in an error.
const LINES_IN_ERRORS: usize = 8;

/// `fmi3Independent`.
const INDEPENDENT: c_int = 0;

/// Data of earlier calls. Some versions require them as arguments of later calls, or do not return them
/// later.
#[derive(Default)]
pub(super) struct Memory {
    /// Arguments with which the experiment was set up.
    experiment: Experiment,
    /// Events reported by the initialization (FMI 1.0).
    announced: Option<EventInfo>,
    /// True if the last step attempt computed nothing.
    pub(super) is_step_repeated: bool,
}

/// A live component.
pub(crate) struct RawInstance {
    pub(super) component: Component,
    /// Function that returned `Fatal`. No further call is made.
    pub(super) fatal: Option<&'static str>,
    /// Function that returned `Error`, for an instance driven by the user. Only resetting the instance and
    /// restoring a state are then allowed.
    failed: Option<&'static str>,
    is_by_hand: bool,
    pub(super) sizes: Sizes,
    /// Co-simulation: true if events are handled between steps.
    pub(super) event_mode: bool,
    /// True if a reference may refer to several values.
    pub(super) has_arrays: bool,
    /// Time set last, for messages.
    pub(super) time: Option<f64>,
    pub(super) saved: SavedStates,
    pub(super) buffers: Box<ValueBuffers>,
    pub(super) memory: Box<Memory>,
    // Data that the component may reach. They are dropped explicitly after the component, and never after
    // `Fatal`.
    pub(super) callbacks: ManuallyDrop<Callbacks>,
    pub(super) library: ManuallyDrop<Arc<Library>>,
}

// SAFETY: this value alone owns the component and its saved states. All calls take `&mut self`, so calls
// never overlap, and the pointers in its buffers are followed only during a call. FMI allows calls of an
// instance from different threads one after the other (FMI 2.0.x, section 2.1.1). All other fields are
// `Send`. `Sync` is not implemented.
unsafe impl Send for RawInstance {}

impl std::fmt::Debug for RawInstance {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RawInstance")
            .field("fatal", &self.fatal)
            .field("time", &self.time)
            .finish_non_exhaustive()
    }
}

/// Defines calls of functions whose only argument is the component.
macro_rules! plain {
    ($($name:ident)+) => {$(
        pub(crate) fn $name(&mut self) -> Outcome {
            self.plain(|functions| &functions.$name)
        }
    )+};
}

impl RawInstance {
    getters! {
        /// True if a call of this instance, or of another of the same loaded copy of the library, returned
        /// `Fatal`.
        pub(crate) is_fatal(self) -> bool = self.fatal.is_some() || self.library.is_fatal();
        /// True if events are handled between steps (co-simulation).
        pub(crate) has_event_mode(self) -> bool = self.event_mode;
        /// Returns the time set last.
        pub(crate) time(self) -> Option<f64> = self.time;
        /// Returns the path of the library file.
        pub(crate) library_path(self) -> PathBuf = self.library.path().to_owned();
        /// Returns the last lines that the FMU logged, and the number of dropped earlier lines.
        pub(crate) log(self) -> (Vec<LogLine>, u64) = self.callbacks.log().last(usize::MAX);
    }

    /// Creates a component.
    pub(crate) fn new(library: &Arc<Library>, request: &Request<'_>, sizes: Sizes) -> Result<Self> {
        let _inside = Inside::enter(library.lock());
        if library.is_fatal() {
            return Err(FmiError::LibraryUnusable(library.path().to_owned()));
        }
        let callbacks = library.callbacks(request.log_filter);
        // SAFETY: the callbacks are never freed: they are leaked or returned to the library.
        let (component, function) = unsafe {
            callbacks.enter();
            library.version.instantiate(request, &callbacks)
        };
        if component.is_null() {
            let failure = failure(&callbacks, library, function, Status::Error, None);
            library.retire(callbacks);
            return Err(FmiError::Call(Box::new(failure)));
        }
        library.set_used();
        Ok(Self {
            component,
            fatal: None,
            failed: None,
            is_by_hand: false,
            sizes,
            event_mode: request.event_mode,
            has_arrays: library.values.has_arrays(),
            time: None,
            saved: SavedStates::default(),
            buffers: Box::default(),
            memory: Box::default(),
            callbacks: ManuallyDrop::new(callbacks),
            library: ManuallyDrop::new(Arc::clone(library)),
        })
    }

    /// Makes the instance reject calls after an `Error`, as the standard requires. Simulations handle errors
    /// themselves, because they may continue without a value that a model cannot provide at one point.
    pub(crate) fn set_by_hand(&mut self) {
        self.is_by_hand = true;
    }

    /// Performs a call that makes an instance usable again after an `Error`.
    pub(super) fn recover(&mut self, call: impl FnOnce(&mut Self) -> Outcome) -> Outcome {
        let failed = self.failed.take();
        let outcome = call(self);
        if outcome.is_err() {
            self.failed = self.failed.or(failed);
        }
        outcome
    }

    /// Records the time of the following calls.
    #[inline]
    pub(super) fn set_call_time(&mut self, time: f64) {
        self.time = Some(time);
        shared_page::note_time(time);
    }

    /// Clears the log.
    pub(crate) fn clear_log(&mut self) {
        self.callbacks.log().clear();
    }

    /// Keeps only lines of these categories and lines whose status is not ok. An empty list keeps all lines.
    pub(crate) fn keep_log_categories(&mut self, categories: &[String]) {
        self.callbacks.log().lines().categories = categories.to_vec();
    }

    /// Returns the data of an error in `call`.
    pub(crate) fn failure(&self, call: &'static str, status: Status) -> CallFailure {
        failure(&self.callbacks, &self.library, call, status, self.time)
    }

    /// Converts the status of an answer to a result. All calls are checked here.
    pub(super) fn check(&mut self, answer: Answer) -> Outcome {
        if answer.is_good() { Ok(()) } else { self.not_ok(answer) }
    }

    #[cold]
    fn not_ok(&mut self, Answer { function, status }: Answer) -> Outcome {
        match status {
            Status::Ok | Status::Warning => return Ok(()),
            Status::Discard => return Err(Fault::Discard(function)),
            Status::Missing => return Err(Fault::Missing(function)),
            Status::Fatal => {
                self.fatal = Some(function);
                self.library.set_fatal();
            }
            Status::Error | Status::Unknown(_) if self.is_by_hand => self.failed = Some(function),
            Status::Error | Status::Pending | Status::Unknown(_) => {}
        }
        Err(Fault::Failed(Box::new(self.failure(function, status))))
    }

    /// Rejects calls of a component after `Fatal` or `Error`, and calls into an unreliable library.
    #[inline]
    pub(super) fn check_usable(&self) -> Outcome {
        if self.is_fatal() || self.failed.is_some() { self.unusable() } else { Ok(()) }
    }

    #[cold]
    fn unusable(&self) -> Outcome {
        Err(match (self.fatal, self.failed) {
            (Some(function), _) => Fault::Failed(Box::new(self.failure(function, Status::Fatal))),
            (None, Some(function)) if !self.is_fatal() => Fault::AfterError(function),
            _ => Fault::Unusable(self.library_path()),
        })
    }

    /// Checks that there are as many values as references. There may be more if references can refer to
    /// arrays. The caller must then know the number, because the FMU receives the number of values.
    pub(super) fn lengths(&self, references: usize, values: usize) -> Outcome {
        if self.has_arrays { Ok(()) } else { self.length("values by reference", references, values) }
    }

    #[inline(always)]
    pub(super) fn length(&self, function: &'static str, expected: usize, found: usize) -> Outcome {
        if expected == found { Ok(()) } else { wrong_length(function, expected, found) }
    }

    plain! { enter_configuration exit_configuration enter_event_mode enter_continuous_time_mode enter_step_mode }

    pub(crate) fn terminate(&mut self) -> Outcome {
        match is_avoided(self.library.functions.terminate.name) {
            true => Ok(()),
            false => self.plain(|functions| &functions.terminate),
        }
    }

    /// Calls a function whose only argument is the component.
    fn plain(&mut self, function: impl Fn(&Functions) -> &Function<Plain>) -> Outcome {
        run!(self, |library, c| call!(function(&library.functions), c))
    }
}

impl RawInstance {
    /// Switches logging on or off for these categories; an empty list means all categories.
    pub(crate) fn set_debug_logging(&mut self, on: bool, categories: &[CString]) -> Outcome {
        let categories: Vec<_> = categories.iter().map(|category| category.as_ptr()).collect();
        run!(self, |library, c| library.version.set_debug_logging(c, on, &categories))
    }

    /// Sets up the experiment. Calls the FMU if its version has a call for this before the initialization.
    pub(crate) fn setup_experiment(&mut self, experiment: &Experiment) -> Outcome {
        let Experiment { tolerance, start, stop } = *experiment;
        self.set_call_time(start);
        self.memory.experiment = *experiment;
        run!(self, |library, c| {
            let function = &library.functions.setup_experiment;
            let (has_tolerance, tolerance) = (tolerance.is_some().into(), tolerance.unwrap_or(0.0));
            call!(function, c, has_tolerance, tolerance, start, stop.is_some().into(), stop.unwrap_or(0.0))
        })
    }

    /// Enters initialization mode with the experiment set up before.
    pub(crate) fn enter_initialization(&mut self) -> Outcome {
        let experiment = self.memory.experiment;
        run!(self, |library, c| library.version.enter_initialization(&library.functions, c, &experiment))
    }

    pub(crate) fn exit_initialization(&mut self) -> Outcome {
        let (experiment, mut announced) = (self.memory.experiment, None);
        let outcome = run!(self, |library, c| {
            library.version.exit_initialization(&library.functions, c, &experiment, &mut announced)
        });
        self.memory.announced = announced;
        outcome
    }

    /// Returns the current sizes of the model's vectors as reported by the FMU; `None` if it has no function
    /// for this.
    pub(crate) fn ask_sizes(&mut self) -> Result<Option<Sizes>, Fault> {
        let Sizes { mut states, mut indicators } = self.sizes;
        match run!(self, |library, c| call!(library.functions.count_states, c, &raw mut states)) {
            Err(Fault::Missing(_)) => return Ok(None),
            outcome => outcome?,
        }
        run!(self, |library, c| call!(library.functions.count_indicators, c, &raw mut indicators))?;
        Ok(Some(Sizes { states, indicators }))
    }

    /// Changes the sizes of the model's vectors after a change of its structure.
    pub(crate) fn set_sizes(&mut self, sizes: Sizes) {
        self.sizes = sizes;
    }

    pub(crate) fn reset(&mut self) -> Outcome {
        (self.time, self.memory.is_step_repeated) = (None, false);
        let name = self.library.functions.reset.name;
        if is_avoided(name) {
            return Err(Fault::Missing(name));
        }
        self.recover(|raw| raw.plain(|functions| &functions.reset))
    }

    pub(crate) fn directional_derivative(&mut self, along: Direction<'_>, out: &mut [f64]) -> Outcome {
        run!(self, |library, c| library.version.directional_derivative(c, along, out))
    }

    pub(crate) fn adjoint_derivative(&mut self, along: Direction<'_>, out: &mut [f64]) -> Outcome {
        let function = self.library.functions.adjoint_derivative;
        run!(self, |_library, c| derivative(&function, c, along, out))
    }

    /// Returns the dependencies of the elements of a variable.
    pub(crate) fn variable_dependencies(&mut self, reference: u32) -> Result<Vec<ElementDependency>, Fault> {
        let Functions { count_dependencies, dependencies, .. } = self.library.functions;
        let mut n = 0;
        run!(self, |_library, c| call!(count_dependencies, c, reference, &raw mut n))?;
        if n == 0 {
            return Ok(Vec::new());
        }
        let too_many = || Fault::TooLarge { call: count_dependencies.name, size: n };
        let mut elements = zeros::<usize>(n).ok_or_else(too_many)?;
        let mut references = zeros::<u32>(n).ok_or_else(too_many)?;
        let mut known_elements = zeros::<usize>(n).ok_or_else(too_many)?;
        let mut kinds = zeros::<c_int>(n).ok_or_else(too_many)?;
        run!(self, |_library, c| call!(
            dependencies,
            c,
            reference,
            elements.as_mut_ptr(),
            references.as_mut_ptr(),
            known_elements.as_mut_ptr(),
            kinds.as_mut_ptr(),
            n
        ))?;
        let entries = (0..n).filter(|&i| kinds[i] != INDEPENDENT).map(|i| ElementDependency {
            element: elements[i].checked_sub(1),
            known: references[i],
            known_element: known_elements[i].checked_sub(1),
            kind: match kinds[i] {
                1 => DependencyKind::Constant,
                2 => DependencyKind::Fixed,
                3 => DependencyKind::Tunable,
                4 => DependencyKind::Discrete,
                _ => DependencyKind::Dependent,
            },
        });
        Ok(entries.collect())
    }

    /// Returns the value references of the states (FMI 1.0). The reference is `u32::MAX` for states that are
    /// not variables.
    pub(crate) fn state_references(&mut self) -> Result<Vec<u32>, Fault> {
        let mut references = vec![u32::MAX; self.sizes.states];
        let (list, n) = (references.as_mut_ptr(), references.len());
        run!(self, |library, c| call!(library.functions.get_state_references, c, list, n))?;
        Ok(references)
    }

    pub(crate) fn new_discrete_states(&mut self, info: &mut EventInfo) -> Outcome {
        self.callbacks.log().go_on();
        if let Some(announced) = self.memory.announced.take() {
            *info = announced;
            return Ok(());
        }
        run!(self, |library, c| library.version.new_discrete_states(c, info))
    }

    /// Returns true if the model requests an event, and true if it requests the end of the simulation.
    pub(crate) fn completed_integrator_step(&mut self) -> Result<(bool, bool), Fault> {
        self.callbacks.log().go_on();
        let (mut info, no_set_state_prior) = (StepInfo::default(), !self.saved.may_be_restored());
        run!(self, |library, c| library.version.completed_integrator_step(c, no_set_state_prior, &mut info))?;
        Ok((info.event, info.terminate))
    }

    pub(crate) fn set_time(&mut self, time: f64) -> Outcome {
        self.callbacks.log().go_on();
        self.set_call_time(time);
        run!(self, |library, c| call!(library.functions.set_time, c, time))
    }

    pub(crate) fn set_continuous_states(&mut self, states: &[f64]) -> Outcome {
        let function = self.library.functions.set_continuous_states;
        self.length(function.name, self.sizes.states, states.len())?;
        run!(self, |_library, c| call!(function, c, states.as_ptr(), states.len()))
    }

    /// Calls a function that fills a vector of the model with this size.
    fn get_vector(&mut self, function: Function<GetVector>, size: usize, values: &mut [f64]) -> Outcome {
        self.length(function.name, size, values.len())?;
        run!(self, |_library, c| call!(function, c, values.as_mut_ptr(), values.len()))
    }

    pub(crate) fn get_continuous_states(&mut self, states: &mut [f64]) -> Outcome {
        self.get_vector(self.library.functions.get_continuous_states, self.sizes.states, states)
    }

    pub(crate) fn get_nominals(&mut self, nominals: &mut [f64]) -> Outcome {
        self.get_vector(self.library.functions.get_nominals, self.sizes.states, nominals)
    }

    pub(crate) fn get_derivatives(&mut self, derivatives: &mut [f64]) -> Outcome {
        self.derivatives_at(None, derivatives)
    }

    pub(crate) fn get_event_indicators(&mut self, indicators: &mut [f64]) -> Outcome {
        self.indicators_at(None, indicators)
    }

    pub(crate) fn right_hand_side(&mut self, time: f64, states: &[f64], derivatives: &mut [f64]) -> Outcome {
        self.derivatives_at(Some((time, states)), derivatives)
    }

    /// Computes the derivatives at a point, or at the current point.
    #[inline]
    pub(crate) fn derivatives_at(
        &mut self,
        point: Option<(f64, &[f64])>,
        derivatives: &mut [f64],
    ) -> Outcome {
        self.vector_at(point, |all| &all.get_derivatives, self.sizes.states, derivatives)
    }

    /// Computes the event indicators at a point, or at the current point.
    #[inline]
    pub(crate) fn indicators_at(&mut self, point: Option<(f64, &[f64])>, indicators: &mut [f64]) -> Outcome {
        self.vector_at(point, |all| &all.get_event_indicators, self.sizes.indicators, indicators)
    }

    /// Sets the time, then the states, and calls a function that fills a vector of the model with this size.
    #[inline(always)]
    fn vector_at(
        &mut self,
        point: Option<(f64, &[f64])>,
        get: impl Fn(&Functions) -> &Function<GetVector>,
        size: usize,
        values: &mut [f64],
    ) -> Outcome {
        let functions = &self.library.functions;
        if let Some((_, states)) = point {
            self.length(functions.set_continuous_states.name, self.sizes.states, states.len())?;
        }
        self.length(get(functions).name, size, values.len())?;
        self.check_usable()?;
        if let Some((time, _)) = point {
            self.callbacks.log().go_on();
            self.set_call_time(time);
        }
        let functions = &self.library.functions;
        let _inside = Inside::enter_for_call(self.library.lock());
        self.callbacks.enter();
        let c = self.component;
        // SAFETY (of the three calls): the component is alive and owned exclusively (`&mut self`). Both
        // slices have as many elements as the function reads or writes.
        let set = |(time, states): (f64, &[f64])| {
            call!(&functions.set_time, c, time).good()?;
            call!(&functions.set_continuous_states, c, states.as_ptr(), states.len()).good()
        };
        let outcome = point
            .map_or(Ok(()), set)
            .and_then(|()| call!(get(functions), c, values.as_mut_ptr(), values.len()).good());
        match outcome {
            Ok(()) => Ok(()),
            Err(answer) => self.not_ok(answer),
        }
    }
}

#[cold]
fn wrong_length(call: &'static str, expected: usize, found: usize) -> Outcome {
    Err(Fault::Length { call, expected, found })
}

/// Returns the data of an error in `call`, with the last lines of the log.
fn failure(
    callbacks: &Callbacks,
    library: &Library,
    call: &'static str,
    status: Status,
    time: Option<f64>,
) -> CallFailure {
    let (log, dropped_log_lines) = callbacks.log().last(LINES_IN_ERRORS);
    let hints = library.hint().cloned().into_iter().chain(refusal().map(Arc::from)).collect();
    CallFailure { call, status, variables: Vec::new(), time, log, dropped_log_lines, hints }
}

/// Returns a vector of `n` zeros; `None` if there is not enough memory.
fn zeros<T: Copy + Default>(n: usize) -> Option<Vec<T>> {
    let mut vector = Vec::new();
    vector.try_reserve_exact(n).ok()?;
    vector.resize(n, T::default());
    Some(vector)
}

/// A component to be freed, with the data that it may reach.
struct Left {
    component: Component,
    saved: SavedStates,
    callbacks: Callbacks,
    library: Arc<Library>,
}

// SAFETY: as for `RawInstance`, whose parts these are.
unsafe impl Send for Left {}

impl Left {
    /// Frees the component. The thread is inside the library.
    fn free(mut self) {
        let is_kept = is_avoided(self.library.functions.free.name);
        if is_kept {
            note_kept();
        }
        if is_kept || self.library.is_fatal() {
            // This also applies if a call of another instance has returned `Fatal` in the meantime.
            std::mem::forget(self);
            return;
        }
        let _inside = Inside::enter(self.library.lock());
        self.callbacks.enter();
        let functions = &self.library.functions;
        if !is_avoided(functions.free_state.name) {
            // SAFETY: the component is alive and made these states.
            unsafe { self.saved.free(&functions.free_state, self.component) };
        }
        if let Some(free) = functions.free.pointer {
            functions.free.note_call();
            // SAFETY: the component is alive, owned exclusively, and not used after this call.
            unsafe { free(self.component) };
        }
        self.library.retire(self.callbacks);
    }
}

impl Drop for RawInstance {
    fn drop(&mut self) {
        if self.is_fatal() {
            // Invariant 6: no further call is made. Data that the component may still reach are leaked:
            // library, callbacks, log.
            return;
        }
        // SAFETY: both are taken only once.
        let (callbacks, library) =
            unsafe { (ManuallyDrop::take(&mut self.callbacks), ManuallyDrop::take(&mut self.library)) };
        let saved = std::mem::take(&mut self.saved);
        let left = Left { component: self.component, saved, callbacks, library };
        let lock = Arc::clone(left.library.lock());
        // This does not wait, because the dropping thread may hold a lock for which the thread inside the
        // library waits.
        lock.when_free(move || left.free());
    }
}
