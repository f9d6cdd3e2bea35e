//! Calls of an instance, by topic. `component` contains the instance.

/// Performs a call of a live component: evaluates `$body` with the library and the component, and checks the
/// answer. No other thread is inside the library during the call.
macro_rules! run {
    ($self:ident, |$library:ident, $component:ident| $body:expr) => {{
        match $self.check_usable() {
            Err(fault) => Err(fault),
            Ok(()) => {
                let answer = {
                    let ($library, $component) = (&**$self.library, $self.component);
                    let _inside = crate::sys::environment::Inside::enter_for_call($library.lock());
                    $self.callbacks.enter();
                    // SAFETY: the component is alive and owned exclusively (`&mut self`). Lengths were
                    // checked by the caller of this macro or are the lengths of the slices passed.
                    #[allow(unused_unsafe)]
                    unsafe {
                        $body
                    }
                };
                $self.check(answer)
            }
        }
    }};
}

mod buffers;
// After the macro, which these modules use.
mod clocks;
mod component;
mod fault;
mod saved_states;
mod slots;
mod steps;
mod values;

pub(crate) use component::RawInstance;
pub(crate) use fault::{Fault, Sizes};
pub(crate) use slots::SavedSlot;
