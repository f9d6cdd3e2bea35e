//! Tests of the stepper that can share a process. Tests that count allocations are separate programs.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../common/mod.rs"]
mod common;
#[path = "../problems/mod.rs"]
mod problems;

mod accumulation;
mod accuracy;
mod adams;
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
