//! Tests of calibrations that can share a process. Tests that start worker processes, or whose models use up
//! a resource of the process, are separate programs.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../support/mod.rs"]
mod support;

mod check;
mod co_simulation;
mod constrained_fits;
mod coverage;
mod derived;
mod design;
mod error_model;
mod expression;
mod initial_states;
mod likelihood;
mod live_page;
mod mistakes;
mod noise;
mod objective;
mod parameters;
mod phases;
mod posterior;
mod prediction;
mod problem;
mod profile;
mod saved_fit;
mod sensitivity;
mod setups;
mod solver;
mod stages;
mod steady_start;
mod time_unit;
mod tolerance;
mod totals;
mod uncertainty;
mod units;
mod validation;
mod wide_bounds;
