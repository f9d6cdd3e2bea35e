//! Systems `F(t, x, x') = 0`: known solutions, consistent initial values, index, what cannot be done.

#![allow(clippy::unwrap_used, clippy::panic)]

#[path = "problems/dae.rs"]
mod problems;

use ode::*;
use problems::{ALL, Dae};

fn solved(problem: &Dae, rtol: f64) -> (f64, Stats) {
    let solution = solve_dae(problem.residual, 0.0..problem.end, problem.x0, &vec![0.0; problem.x0.len()])
        .relative_tolerance(rtol)
        .absolute_tolerance(problem.atol * rtol)
        .times(&[problem.end])
        .run()
        .unwrap();
    (problem.digits(solution.last()), solution.report.stats)
}

#[test]
#[ignore = "a table to read"]
fn table() {
    for problem in &ALL {
        for k in [4, 6, 8, 10] {
            let (digits, s) = solved(problem, 10f64.powi(-k));
            println!(
                "{:10} {k:2} digits {digits:5.2} res {:5} steps {:5} rejected {:3} J {:4} LU {:4} N {:5}",
                problem.name,
                s.right_hand_sides,
                s.accepted_steps,
                s.rejected_steps,
                s.jacobians,
                s.decompositions,
                s.newton_iterations
            );
        }
    }
}
