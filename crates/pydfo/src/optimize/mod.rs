//! Minimisation of Python functions.

pub(crate) mod futures;
pub(crate) mod methods;
pub(crate) mod minimize;
pub(crate) mod objective;
pub(crate) mod optimizer;
pub(crate) mod quad_err;
pub(crate) mod sensitivity;
