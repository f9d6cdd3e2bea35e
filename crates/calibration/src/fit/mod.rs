//! Fits in one stage or several stages, their phases and their results.

pub(crate) mod goodness;
pub(crate) mod live;
pub(crate) mod one_stage;
pub(crate) mod output_fit;
pub(crate) mod phase;
#[cfg(feature = "schema")]
pub(crate) mod schema;
pub(crate) mod several_stages;
