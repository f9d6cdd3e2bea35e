//! Tuning of the constants of Nelder-Mead: fraction of solved problems and median of the evaluations. The
//! even halves of the fits and of the boxes tune the constants (`cargo bench --bench simplex`). The odd
//! halves (`-- judge`) and the problems of Moré and Wild are for their assessment.
#![allow(clippy::print_stdout, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../tests/problems/mod.rs"]
mod problems;

use dfo::{BoundsHandling, NelderMead, minimize};
use problems::boxes::boxes;
use problems::calibration::fits;
use problems::instances;

/// Outcome of a run: whether its result is right, its number of evaluations, and whether it reported success.
struct Run {
    solved: bool,
    evaluations: usize,
    success: bool,
}

fn show(title: &str, runs: &[Run]) {
    let count = |p: &dyn Fn(&Run) -> bool| runs.iter().filter(|r| p(r)).count();
    let mut evaluations: Vec<usize> = runs.iter().map(|r| r.evaluations).collect();
    evaluations.sort_unstable();
    let solved = count(&|r| r.solved);
    println!(
        "{title:44} {solved:3} of {:3} = {:3.0} %, median {:5} evaluations, mean {:5}; wrong with success: {}",
        runs.len(),
        100.0 * solved as f64 / runs.len() as f64,
        evaluations[evaluations.len() / 2],
        evaluations.iter().sum::<usize>() / runs.len(),
        count(&|r| r.success && !r.solved)
    );
}

fn main() {
    let judging = std::env::args().any(|a| a == "judge");
    let detail = std::env::args().any(|a| a == "detail");
    let methods = [BoundsHandling::Mirror, BoundsHandling::Clamp, BoundsHandling::Sine];

    let mut runs = Vec::new();
    for (number, fit) in fits().iter().enumerate().filter(|(k, _)| (k % 2 == 1) == judging) {
        for (which, start) in fit.starts().iter().enumerate() {
            let report = minimize(|p: &[f64]| fit.cost(p)).start(start).run().unwrap();
            let run = Run {
                solved: report.fun <= 1e-6,
                evaluations: report.n_evaluations,
                success: report.is_success(),
            };
            if detail && !run.solved {
                println!(
                    "  {number} {} {which}: {:.1e} {:?} {}",
                    fit.name, report.fun, report.x, report.message
                );
            }
            runs.push(run);
        }
    }
    show("fits without bounds", &runs);

    let problems = boxes(judging);
    for handling in methods {
        let mut runs = Vec::new();
        for p in &problems {
            for start in p.starts() {
                let report = minimize(|x: &[f64]| (p.cost)(x))
                    .start(&start)
                    .bounds(&p.lower, &p.upper)
                    .unwrap()
                    .method(NelderMead::default().bounds_handling(handling))
                    .run()
                    .unwrap();
                let first = (p.cost)(&p.start);
                let run = Run {
                    solved: report.fun - p.best <= 1e-6 * (first - p.best),
                    evaluations: report.n_evaluations,
                    success: report.is_success(),
                };
                if detail && !run.solved {
                    let (f, f_0) = (report.fun - p.best, first - p.best);
                    println!("  {} {handling:?} {start:?}: {f:.1e} of {f_0:.1e} {}", p.name, report.message);
                }
                runs.push(run);
            }
        }
        show(&format!("boxes, {handling:?}"), &runs);
    }

    for tau in [1e-3, 1e-5] {
        let mut runs = Vec::new();
        for p in instances() {
            let first = p.cost(&p.start());
            let goal = first - (1.0 - tau) * (first - p.best);
            let run = minimize(|x: &[f64]| p.cost(x))
                .start(&p.start())
                .x_tol(0.0)
                .f_tol(0.0)
                .target(goal)
                .max_evaluations(100 * (p.n + 1))
                .run()
                .unwrap();
            let solved = run.fun <= goal;
            let units = if solved { run.n_evaluations * 10 / (p.n + 1) } else { 1_000_000 };
            if detail && !solved {
                println!("  {p:?}: {:e}", run.fun);
            }
            runs.push(Run { solved, evaluations: units, success: solved });
        }
        if !runs.is_empty() {
            show(&format!("Moré and Wild, tau {tau:e}, tenths of n + 1"), &runs);
        }
    }
}
