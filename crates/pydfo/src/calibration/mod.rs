//! Calibrations, fits, and what follows from them.

pub(crate) mod cost;
pub(crate) mod data;
pub(crate) mod experiment;
pub(crate) mod export;
pub(crate) mod fit;
pub(crate) mod native;
pub(crate) mod profile;
pub(crate) mod recordings;
pub(crate) mod report;
pub(crate) mod uncertainty;
pub(crate) mod validation;
pub(crate) mod worker;
