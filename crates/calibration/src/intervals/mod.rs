//! Profiles of the cost and bands of the predictions.

pub(crate) mod bands;
pub(crate) mod profile;
