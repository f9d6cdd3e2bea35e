//! The interface of the methods and their common tools: tolerances, sampling, random numbers, linear model.

pub(crate) mod interface;
pub(crate) mod linear_model;
pub(crate) mod rng;
pub(crate) mod sampling;
pub(crate) mod tolerances;
