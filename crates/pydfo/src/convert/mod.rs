//! Python objects from results and errors, and settings from Python objects.

pub(crate) mod dict;
pub(crate) mod error;
pub(crate) mod fmu_error;
pub(crate) mod object;
mod os_error;
pub(crate) mod record;
pub(crate) mod report;
pub(crate) mod values;
