//! The calls of an instance, by topic; `component` owns it.

/// Runs one call: the component is alive, `$body` is evaluated with the library and the component, its answer
/// checked. No other thread is inside of the library.
macro_rules! run {
    ($self:ident, |$library:ident, $component:ident| $body:expr) => {{
        match $self.check_usable() {
            Err(fault) => Err(fault),
            Ok(()) => {
                let answer = {
                    let ($library, $component) = (&**$self.library, $self.component);
                    let _inside = crate::sys::environment::Inside::enter_for_call($library.lock());
                    $self.callbacks.enter();
                    // SAFETY: the component is alive and ours alone (`&mut self`); lengths were checked by the caller of
                    // this macro or are those of the slices passed.
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
// Behind the macro, which they use.
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
