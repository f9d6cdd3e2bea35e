//! Signatures of the functions of FMI 3.0 (FMI 3.0.x, chapters 2, 3 and 4), as far as they are bound.

use crate::sys::types::Component;
use std::ffi::{c_char, c_int, c_void};

/// A C `bool` as an FMU may write it: any bits are tolerated.
pub(super) type Flag = u8;
pub(super) type LogMessage = unsafe extern "C" fn(*mut c_void, c_int, *const c_char, *const c_char);

pub(super) type InstantiateModelExchange = unsafe extern "C" fn(
    *const c_char,
    *const c_char,
    *const c_char,
    bool,
    bool,
    *mut c_void,
    LogMessage,
) -> Component;
/// Never given: inputs are set between steps.
type IntermediateUpdate = unsafe extern "C" fn(*mut c_void, f64, Flag, Flag, Flag, Flag, *mut Flag, *mut f64);
pub(super) type InstantiateCoSimulation = unsafe extern "C" fn(
    *const c_char,
    *const c_char,
    *const c_char,
    bool,
    bool,
    bool,
    bool,
    *const u32,
    usize,
    *mut c_void,
    LogMessage,
    Option<IntermediateUpdate>,
) -> Component;
pub(super) type EnterInitialization = unsafe extern "C" fn(Component, bool, f64, f64, bool, f64) -> c_int;
pub(super) type SetDebugLogging = unsafe extern "C" fn(Component, bool, usize, *const *const c_char) -> c_int;
pub(super) type Get<T> = unsafe extern "C" fn(Component, *const u32, usize, *mut T, usize) -> c_int;
pub(super) type Set<T> = unsafe extern "C" fn(Component, *const u32, usize, *const T, usize) -> c_int;
pub(super) type GetBinary =
    unsafe extern "C" fn(Component, *const u32, usize, *mut usize, *mut *const u8, usize) -> c_int;
pub(super) type SetBinary =
    unsafe extern "C" fn(Component, *const u32, usize, *const usize, *const *const u8, usize) -> c_int;
pub(super) type GetClock = unsafe extern "C" fn(Component, *const u32, usize, *mut Flag) -> c_int;
pub(super) type SetClock = unsafe extern "C" fn(Component, *const u32, usize, *const Flag) -> c_int;
pub(super) type DirectionalDerivative = unsafe extern "C" fn(
    Component,
    *const u32,
    usize,
    *const u32,
    usize,
    *const f64,
    usize,
    *mut f64,
    usize,
) -> c_int;
pub(super) type UpdateDiscreteStates =
    unsafe extern "C" fn(Component, *mut Flag, *mut Flag, *mut Flag, *mut Flag, *mut Flag, *mut f64) -> c_int;
pub(super) type CompletedStep = unsafe extern "C" fn(Component, bool, *mut Flag, *mut Flag) -> c_int;
pub(super) type Count = unsafe extern "C" fn(Component, *mut usize) -> c_int;
pub(super) type GetOutputDerivatives =
    unsafe extern "C" fn(Component, *const u32, usize, *const c_int, *mut f64, usize) -> c_int;
pub(super) type DoStep =
    unsafe extern "C" fn(Component, f64, f64, bool, *mut Flag, *mut Flag, *mut Flag, *mut f64) -> c_int;
