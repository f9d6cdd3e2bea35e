//! Interface of the methods and their shared tools: tolerances, sampling, random numbers and linear model.

pub(crate) mod interface;
pub(crate) mod linear_model;
pub(crate) mod rng;
pub(crate) mod sampling;
pub(crate) mod tolerances;
