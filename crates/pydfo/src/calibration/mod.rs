//! Calibrations, fits, and the computations based on them.

pub(crate) mod calibration_class;
pub(crate) mod check;
pub(crate) mod cost;
pub(crate) mod data_files;
pub(crate) mod experiment;
pub(crate) mod fit;
pub(crate) mod live_page;
pub(crate) mod posterior;
pub(crate) mod profile;
pub(crate) mod recordings;
pub(crate) mod saved_fit;
pub(crate) mod sensitivity;
pub(crate) mod shared;
pub(crate) mod uncertainty;
pub(crate) mod validation;
pub(crate) mod worker;
