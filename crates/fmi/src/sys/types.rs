//! Arguments and results of calls into an FMU, in types that do not depend on the FMI version.

use crate::description::{DependencyKind, Interval};
use crate::error::Status;
use crate::log::LogFilter;
use crate::macros::words;
use serde::{Deserialize, Serialize};
use std::ffi::{CStr, CString, c_void};
use std::path::Path;

/// `fmiComponent`, `fmi2Component` or `fmi3Instance`: the handle of a component. An FMU creates it and
/// receives it in all calls of the component. Values come from C only, so no other pointer can be mistaken
/// for a component.
#[repr(transparent)]
#[derive(Debug, Clone, Copy)]
pub(super) struct Component(*mut c_void);

impl Component {
    pub(super) const NULL: Self = Self(std::ptr::null_mut());

    /// True if the FMU has not created a component.
    pub(super) fn is_null(self) -> bool {
        self.0.is_null()
    }
}

/// `fmi2FMUstate` or `fmi3FMUState`: the handle of a saved state of a component.
#[repr(transparent)]
#[derive(Debug, Clone, Copy)]
pub(super) struct StatePointer(*mut c_void);

impl StatePointer {
    /// No state.
    pub(super) const NULL: Self = Self(std::ptr::null_mut());

    pub(super) fn is_null(self) -> bool {
        self.0.is_null()
    }
}

/// `fmiOK`, `fmi2OK`, `fmi3OK`.
pub(super) const OK: std::ffi::c_int = 0;

/// Converts a code of `fmiStatus`. All versions share the codes (1.0 for model exchange and 3.0 have no
/// `Pending`).
#[cold]
pub(super) fn status(code: std::ffi::c_int) -> Status {
    match code {
        OK => Status::Ok,
        1 => Status::Warning,
        2 => Status::Discard,
        3 => Status::Error,
        4 => Status::Fatal,
        5 => Status::Pending,
        other => Status::Unknown(other),
    }
}

/// Returns a `file:///...` URI with all characters percent-encoded except unreserved ones (RFC 3986), as FMI
/// 1.0 and 2.0 require.
pub(super) fn file_uri(path: &Path) -> CString {
    let mut uri = String::from("file://");
    let text = path.to_string_lossy().replace(std::path::MAIN_SEPARATOR, "/");
    if !text.starts_with('/') {
        uri.push('/');
    }
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || b"/-._~:".contains(&byte) {
            uri.push(char::from(byte));
        } else {
            uri.push_str(&format!("%{byte:02X}"));
        }
    }
    CString::new(uri).unwrap_or_default()
}

/// Result of an event iteration.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct EventInfo {
    /// The model requests another iteration.
    pub(crate) new_discrete_states_needed: bool,
    /// The model requests the end of the simulation.
    pub(crate) terminate: bool,
    /// The nominals of the states have changed.
    pub(crate) nominals_changed: bool,
    /// The continuous states have changed.
    pub(crate) values_changed: bool,
    /// Time of the next time event.
    pub(crate) next_event_time: Option<f64>,
}

/// Interval until the next tick of a clock, as reported by the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct IntervalAnswer {
    pub(crate) qualifier: Qualifier,
    pub(crate) interval: Interval,
}

/// Qualifier of an interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Qualifier {
    NotYetKnown,
    /// The interval has not changed since it was last reported.
    Unchanged,
    Changed,
}

words! {
    /// The two interfaces that can run a model.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
    pub enum InterfaceKind {
        /// The importer integrates the model.
        ModelExchange = "model exchange",
        /// The model has its own solver and steps from one communication point to the next.
        CoSimulation = "co-simulation",
    }
}

/// Result of a communication step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct StepInfo {
    /// Time that the model has reached, if it differs from the end of the step or may differ. FMI 3.0: the
    /// time of the model after every step.
    pub(crate) reached: Option<f64>,
    /// The model returned before the end of the step and continues from the time it reached (FMI 3.0).
    pub(crate) early: bool,
    /// The model requests the end of the simulation.
    pub(crate) terminate: bool,
    /// The model reports the time it reached but cannot report the end of a simulation, so it may have ended
    /// it.
    pub(crate) may_have_ended: bool,
    /// The model requests event mode.
    pub(crate) event: bool,
    /// The step is still being computed.
    pub(crate) pending: bool,
}

/// An element of a variable that depends on an element of another one (FMI 3.0).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ElementDependency {
    /// Position of the element in the array, counted from 0; `None` for the whole variable.
    pub element: Option<usize>,
    /// Value reference of the variable on which the element depends.
    pub known: u32,
    /// Position of the element in that variable; `None` for the whole variable.
    pub known_element: Option<usize>,
    /// Kind of the dependency.
    pub kind: DependencyKind,
}

/// A requested derivative. Directional: the derivative of `unknowns` along `seed`, in the space of `knowns`.
/// Adjoint: the derivative with respect to `knowns`, weighted with `seed` in the space of `unknowns`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Direction<'a> {
    pub(crate) unknowns: &'a [u32],
    pub(crate) knowns: &'a [u32],
    pub(crate) seed: &'a [f64],
}

/// Arguments for creating an instance.
#[derive(Debug)]
pub(crate) struct Request<'a> {
    pub(crate) name: &'a CStr,
    pub(crate) guid: &'a CStr,
    pub(crate) resources: &'a Path,
    pub(crate) kind: InterfaceKind,
    /// Co-simulation: events are handled between steps, and an event may end a step early.
    pub(crate) event_mode: bool,
    pub(crate) early_return: bool,
    pub(crate) visible: bool,
    pub(crate) logging: bool,
    pub(crate) log_filter: LogFilter,
}

/// Arguments for setting up an experiment.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Experiment {
    pub(crate) tolerance: Option<f64>,
    pub(crate) start: f64,
    pub(crate) stop: Option<f64>,
}
