//! Fit the parameters of Functional Mock-up Units (FMUs) to measurements, without derivatives.
//!
//! This crate re-exports the other crates, which can also be used separately.
#![forbid(unsafe_code)]

pub use calibration;
pub use dfo;
pub use example_models;
pub use fmi;
pub use ode;

/// The Rust example of the guide, compiled and run as a documentation test.
#[cfg(doctest)]
#[doc = include_str!("../docs/rust.md")]
pub struct Guide;
