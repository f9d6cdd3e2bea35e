//! Simulations and fits from measurements, through the public interface. The memory of a process is measured
//! in a separate process.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../common/mod.rs"]
mod common;

mod fit_errors;
mod fit_furuta;
mod fit_quad_tank;
mod simulate_furuta;
