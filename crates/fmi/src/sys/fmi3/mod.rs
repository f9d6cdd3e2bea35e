//! Functions of an FMI 3.0 library whose types are specific to FMI 3.0, bound by name.

mod functions;
mod values;

pub(super) use functions::Fmi3;
pub(super) use values::Fmi3Values;
