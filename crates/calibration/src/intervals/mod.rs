//! Profile likelihoods and prediction bands.

pub(crate) mod bands;
pub(crate) mod profile;
