//! `auto` compared with the best of the other methods: right-hand sides, including those for Jacobians, at
//! equal digits, as a table. Run with `cargo bench -p fmufit-ode --bench auto`. Problem names restrict the
//! run to these problems. `--tuning` selects the problems used to tune the constants of `auto`. The recorded
//! table is in `benches/work_precision.md`.

#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

#[path = "../tests/problems/mod.rs"]
mod problems;

use ode::Method;
use problems::Problem;

const METHODS: [Method; 4] = [Method::Tsit5, Method::Dop853, Method::Radau5, Method::Bdf];
/// Maximum number of right-hand sides; more are not needed to find the best method.
const MOST: u64 = 200_000;

/// Digits and logarithm of the right-hand sides; `None` if the run fails.
fn point(problem: &Problem, method: Method, rtol: f64) -> Option<(f64, f64)> {
    let mut options = problem.options(method, rtol);
    options.limits.max_right_hand_sides =
        Some(if problem.name == "Ring modulator" { 20 * MOST } else { MOST });
    let (digits, stats) = problem.solve(options).ok()?;
    Some((digits, (stats.right_hand_sides as f64).ln()))
}

/// Work-precision curve of a method over all tolerances, ascending in work and in digits (runs out of order
/// are replaced by their mean).
fn curve(problem: &Problem, method: Method) -> Vec<(f64, f64)> {
    let mut points: Vec<_> =
        (4..=24).filter_map(|k| point(problem, method, 10f64.powf(-f64::from(k) / 2.0))).collect();
    points.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut pools: Vec<(f64, f64, f64)> = Vec::new();
    for (digits, work) in points {
        let mut pool = (digits, work, 1.0);
        while let Some(last) = pools.pop_if(|last| last.0 >= pool.0) {
            let count = last.2 + pool.2;
            let mean = |a: f64, b: f64| (a * last.2 + b * pool.2) / count;
            pool = (mean(last.0, pool.0), mean(last.1, pool.1), count);
        }
        pools.push(pool);
    }
    pools.into_iter().map(|(digits, work, _)| (digits, work)).collect()
}

/// Logarithm of the work for the given number of digits. Below the first point of the curve, the work of that
/// point; `None` beyond the last point.
fn at(curve: &[(f64, f64)], digits: f64) -> Option<f64> {
    let after = curve.iter().position(|p| p.0 >= digits)?;
    let (b, a) = (curve[after], curve[after.saturating_sub(1)]);
    let share = if b.0 > a.0 { (digits - a.0) / (b.0 - a.0) } else { 1.0 };
    Some(a.1 + share.clamp(0.0, 1.0) * (b.1 - a.1))
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let tuning = arguments.iter().any(|a| a == "--tuning");
    let wanted = |p: &Problem| {
        let mut names = arguments.iter().filter(|a| !a.starts_with("--")).peekable();
        names.peek().is_none() || names.any(|a| p.name.contains(a.as_str()))
    };
    let problems = if tuning { problems::tuning::all() } else { problems::judging() };
    println!(
        "problem            rtol   digits    auto  ratio  best     | the same for a method at this tolerance, digits/right-hand sides (ratio)"
    );
    let mut all: Vec<f64> = Vec::new();
    for problem in problems.iter().filter(|p| wanted(p)) {
        let curves = METHODS.map(|method| curve(problem, method));
        let best = |digits: f64| {
            let works = METHODS.iter().zip(&curves).filter_map(|(m, c)| Some((at(c, digits)?, *m)));
            works.min_by(|a, b| a.0.total_cmp(&b.0))
        };
        for rtol in [1e-4, 1e-6, 1e-8] {
            let show = |method| match point(problem, method, rtol) {
                Some((digits, work)) => {
                    let ratio = best(digits).map_or(f64::NAN, |(least, _)| (work - least).exp());
                    (format!("{digits:5.2}/{:<7.0}({ratio:5.2})", work.exp()), ratio)
                }
                None => ("failed".to_owned(), f64::INFINITY),
            };
            let (auto, ratio) = show(Method::Auto);
            all.push(ratio);
            let digits = point(problem, Method::Auto, rtol).map_or(f64::NAN, |p| p.0);
            let name = best(digits).map_or("-", |(_, m)| m.name());
            let others: Vec<String> = METHODS.iter().map(|m| show(*m).0).collect();
            println!("{:17} {rtol:e} {auto} {name:7} | {}", problem.name, others.join("  "));
        }
    }
    let mean = (all.iter().map(|r| r.ln()).sum::<f64>() / all.len() as f64).exp();
    println!(
        "{} entries, geometric mean {mean:.3}, largest {:.2}, above 1.3: {}",
        all.len(),
        all.iter().fold(0.0, |a: f64, b| a.max(*b)),
        all.iter().filter(|r| r.is_nan() || **r > 1.3).count()
    );
}
