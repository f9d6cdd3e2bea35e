//! Correct digits and right-hand sides (including those for Jacobians) of every method on the test problems,
//! as lines of `method,problem,rtol,digits,right-hand
//! sides,steps,rejected,jacobians,decompositions,newton,seconds`. `benches/work_precision.py` compares them
//! with CVODE and SciPy.

#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

#[path = "../tests/problems/mod.rs"]
mod problems;

use ode::Method;
use std::time::Instant;

fn main() {
    let stiff = problems::stiff::all();
    let easy = problems::nonstiff::all();
    let implicit = [Method::Radau5, Method::Bdf, Method::Auto];
    let explicit = [Method::Tsit5, Method::Dop853, Method::Auto];
    for (methods, problems) in [(implicit, stiff), (explicit, easy)] {
        for method in methods {
            for problem in &problems {
                for k in 8..=20 {
                    let rtol = 10f64.powf(-f64::from(k) / 2.0);
                    let start = Instant::now();
                    match problem.solve(problem.options(method, rtol)) {
                        Ok((digits, s)) => println!(
                            "{},{},{rtol:e},{digits:.3},{},{},{},{},{},{},{:e}",
                            method.name(),
                            problem.name,
                            s.right_hand_sides,
                            s.accepted_steps,
                            s.rejected_steps,
                            s.jacobians,
                            s.decompositions,
                            s.newton_iterations,
                            start.elapsed().as_secs_f64()
                        ),
                        Err(e) => println!("{},{},{rtol:e},failed: {e}", method.name(), problem.name),
                    }
                }
            }
        }
    }
}
