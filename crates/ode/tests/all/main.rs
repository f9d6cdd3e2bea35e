//! The tests of the stepper that may share a process. Those that count allocations are programs of their own.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../common/mod.rs"]
mod common;
#[path = "../problems/mod.rs"]
mod problems;

mod accumulation;
mod accuracy;
mod auto;
mod backward;
mod chattering;
mod crossings;
mod dae;
mod directions;
mod edges;
mod hybrid;
mod inside_steps;
mod limits_of_numbers;
mod listed_twice;
mod mass_matrix;
mod methods;
mod pulses;
mod reasons;
mod same_instant;
mod sliding;
mod sparse;
mod stopping;
mod times;
mod vectors;
