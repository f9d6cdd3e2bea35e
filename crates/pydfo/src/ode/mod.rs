//! Systems written in Python.

pub(crate) mod solve;
pub(crate) mod system;
