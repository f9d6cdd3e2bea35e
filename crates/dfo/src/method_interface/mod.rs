//! Interface of the methods and their shared tools: ranks of points, tolerances, sampling, random numbers and
//! linear model.

pub(crate) mod cost;
pub(crate) mod interface;
pub(crate) mod linear_model;
pub(crate) mod rng;
pub(crate) mod sampling;
pub(crate) mod tolerances;
