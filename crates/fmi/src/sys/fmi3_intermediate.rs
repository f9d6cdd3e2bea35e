//! FMI 3.0's callback during a communication step (FMI 3.0.x, section 4.2.2): inputs are set and the step is cut short in
//! it. An FMU that calls it at another time, from within itself or from two threads at once is answered and ignored.

use super::callbacks::Environment;
use super::environment::OwnMode;
use super::{Component, MidStep, Status, Update, status};
use std::ffi::{c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError, TryLockError};

/// `fmi3IntermediateUpdateCallback`.
pub(super) type IntermediateUpdate =
    unsafe extern "C" fn(*mut c_void, f64, Flag, Flag, Flag, Flag, *mut Flag, *mut f64);

/// A C `bool` as an FMU may pass it: any bits are tolerated.
type Flag = u8;

/// `fmi3SetFloat64`.
pub(super) type SetFloat64 = unsafe extern "C" fn(Component, *const u32, usize, *const f64, usize) -> c_int;

/// What the environment pointer of a co-simulation leads to: first that of all others, as the logger takes it for.
#[repr(C)]
pub(super) struct StepEnvironment {
    log: Environment,
    /// There while a step is made.
    guest: Mutex<Option<Guest>>,
}

/// Who is asked during a step, and where its answers go.
struct Guest {
    mid_step: *mut (dyn MidStep + 'static),
    component: Component,
    set_float64: SetFloat64,
    /// The answer of the last setting of inputs that was not a good one.
    refused: Option<Status>,
}

// SAFETY: both pointers are used under the mutex only, while the thread that owns what they lead to is inside of the step
// (see `StepEnvironment::during`), and `MidStep` is `Send`.
unsafe impl Send for Guest {}

impl StepEnvironment {
    pub(super) fn new(log: &Environment) -> Self {
        Self { log: log.clone(), guest: Mutex::new(None) }
    }

    /// Makes `step`, during which `mid_step` is asked when the FMU calls back. If the FMU refuses what it is told then, that
    /// is the status of the step.
    pub(super) fn during(
        &self,
        mid_step: &mut (dyn MidStep + '_),
        component: Component,
        set_float64: SetFloat64,
        step: impl FnOnce() -> Status,
    ) -> Status {
        /// Takes the guest away in any case; waits for a callback that is under way on another thread.
        struct Leave<'a>(&'a Mutex<Option<Guest>>);
        impl Drop for Leave<'_> {
            fn drop(&mut self) {
                *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
            }
        }
        // SAFETY: only the lifetime changes, and the guest is gone before this function returns.
        let mid_step =
            unsafe { std::mem::transmute::<*mut (dyn MidStep + '_), *mut (dyn MidStep + 'static)>(mid_step) };
        *self.guest.lock().unwrap_or_else(PoisonError::into_inner) =
            Some(Guest { mid_step, component, set_float64, refused: None });
        let leave = Leave(&self.guest);
        let status = step();
        let refused =
            leave.0.lock().unwrap_or_else(PoisonError::into_inner).as_ref().and_then(|guest| guest.refused);
        match (status, refused) {
            (Status::Fatal, _) | (_, None) => status,
            (_, Some(refused)) => refused,
        }
    }
}

/// The callback.
///
/// # Safety
/// `environment` is NULL or the address of a live [`StepEnvironment`]; the last two pointers are NULL or lead to one
/// value each.
pub(super) unsafe extern "C" fn intermediate_update(
    environment: *mut c_void,
    time: f64,
    set_requested: Flag,
    get_allowed: Flag,
    step_finished: Flag,
    can_return_early: Flag,
    return_early: *mut Flag,
    return_time: *mut f64,
) {
    let _ = (get_allowed, step_finished);
    // SAFETY: NULL or one value each.
    unsafe {
        if !return_early.is_null() {
            return_early.write(0);
        }
        if !return_time.is_null() {
            return_time.write(time);
        }
    }
    if environment.is_null() {
        return;
    }
    // SAFETY: FMI 3.0 hands back what it was given at instantiation (section 2.3.1).
    let environment = unsafe { &*environment.cast::<StepEnvironment>() };
    let mut guest = match environment.guest.try_lock() {
        Ok(guest) => guest,
        Err(TryLockError::Poisoned(guest)) => guest.into_inner(),
        Err(TryLockError::WouldBlock) => return,
    };
    let Some(guest) = guest.as_mut() else { return };
    let _mode = OwnMode::enter();
    // A panic must not unwind into C.
    let _ = catch_unwind(AssertUnwindSafe(|| {
        // SAFETY: the guest is there while its owner is inside of the step, and the mutex keeps others out.
        let mid_step = unsafe { &mut *guest.mid_step };
        let update = Update { time, set_requested: set_requested != 0 };
        let leave = mid_step.update(&update, &mut |references, values| {
            if references.is_empty() || references.len() != values.len() {
                return;
            }
            // SAFETY: the component is in its intermediate update mode, where this call is allowed; as many values as
            // references.
            let code = unsafe {
                (guest.set_float64)(
                    guest.component,
                    references.as_ptr(),
                    references.len(),
                    values.as_ptr(),
                    values.len(),
                )
            };
            if !matches!(status(code), Status::Ok | Status::Warning) {
                guest.refused = Some(status(code));
            }
        });
        if leave && can_return_early != 0 && !return_early.is_null() {
            // SAFETY: not NULL.
            unsafe { return_early.write(1) };
        }
    }));
}
