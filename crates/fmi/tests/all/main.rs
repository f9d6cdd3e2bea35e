//! Tests of the importer that can share a process. Tests that count allocations, start themselves again,
//! inspect the libraries of the process or change its threads are separate programs.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../promises/mod.rs"]
mod promises;
#[path = "../support/mod.rs"]
mod support;

mod arrays;
mod by_hand;
mod clocks;
mod co_simulation;
mod description;
mod early_return;
mod fault_matrix;
mod faults;
mod history;
mod initial_states;
mod instance;
mod introspection;
mod jacobian;
mod misuse;
mod quirks;
mod reference_results;
mod reset_methods;
mod seeds;
mod session;
mod simulate;
mod standard;
mod start_values;
mod stopping;
mod tanks_and_pipes;
mod times;
mod tunable_parameters;
mod versions;
