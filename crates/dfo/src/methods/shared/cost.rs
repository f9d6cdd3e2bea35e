//! Cost of a stored point.

pub(crate) use crate::method_interface::cost::Cost;
