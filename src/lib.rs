//! Fit the parameters of Functional Mock-up Units (FMUs) to measurements, without derivatives.
//!
//! This crate only re-exports the others; each of them can be used alone.
#![forbid(unsafe_code)]

pub use calibration;
pub use dfo;
pub use example_models;
pub use fmi;
pub use ode;

/// The Rust example of the guide, compiled and run with the other examples in the documentation.
#[cfg(doctest)]
#[doc = include_str!("../docs/rust.md")]
pub struct Guide;
