//! Models: files, descriptions, inputs, simulations, trajectories.

pub(crate) mod description;
pub(crate) mod files;
pub(crate) mod inputs;
pub(crate) mod instance;
pub(crate) mod model_class;
pub(crate) mod trajectory;
