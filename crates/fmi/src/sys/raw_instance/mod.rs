//! One component of an FMU: the sole owner of its pointer, with every call checked before and after.

/// Runs one call: the component is alive, `$body` is evaluated with the binding and the component, its status checked.
/// The thread is set up for it, and nothing of what it changes there is left.
macro_rules! run {
    ($self:ident, $call:expr, |$binding:ident, $component:ident| $body:expr) => {{
        $self.alive($call)?;
        let status = {
            let ($binding, $component) = ($self.library.binding(), $self.component);
            let _call = crate::sys::environment::OneCall::enter();
            // SAFETY: the component is alive and ours alone (`&mut self`); lengths were checked by the caller of this
            // macro or are those of the slices passed.
            unsafe { $body }
        };
        $self.check($call, status)
    }};
}

mod buffers;
// Behind the macro, which they use.
mod component;
mod fault;
mod saved_states;
mod slots;
mod steps;
mod values;

pub(crate) use component::RawInstance;
pub(crate) use fault::{Fault, Sizes};
pub(crate) use slots::SavedSlot;
