//! Tests of the optimisers. Allocations are counted per thread, so all tests share one program.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../common/mod.rs"]
mod common;
#[path = "../problems/mod.rs"]
mod problems;

mod any_problem;
mod ask_tell;
mod bad_input;
mod barrier;
mod budgets;
mod checkpoint;
mod checkpoint_file;
mod cma_es;
mod concurrency;
mod constraints_least_squares;
mod constraints_nelder_mead;
mod constraints_populations;
mod constraints_quadratic_model;
mod contract;
mod cutoffs;
mod differential_evolution;
mod far_bounds;
mod flow;
mod forged_states;
mod genetic;
mod hand_over;
mod honest_ends;
mod last_digits;
mod least_squares;
mod least_squares_results;
mod more_wild;
mod multistart;
mod names;
mod nelder_mead;
mod pareto;
mod pattern_search;
mod plans;
mod quadratic_model;
mod regressions;
mod requested_runs;
mod residuals;
mod resumed;
mod simplex_quality;
mod speculation;
mod target;
mod uninformative_ends;
mod valleys;
mod wide_bounds;
mod workers;
