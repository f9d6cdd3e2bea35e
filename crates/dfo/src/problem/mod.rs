//! Optimisation problem: objective, loss and search space.

pub(crate) mod constraints;
pub(crate) mod loss;
pub(crate) mod m_estimator;
pub(crate) mod memory;
pub(crate) mod objective;
pub(crate) mod option_texts;
pub(crate) mod space;
