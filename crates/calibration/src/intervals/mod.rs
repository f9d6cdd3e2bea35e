//! Profile likelihoods, prediction bands and samples of the posterior distribution.

pub(crate) mod bands;
pub(crate) mod posterior;
pub(crate) mod profile;
