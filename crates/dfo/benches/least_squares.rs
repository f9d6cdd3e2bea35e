//! Termination of least squares: evaluations until the end in units of n + 1 (median and mean), and the share
//! of problems solved at the end (`f - best <= tau (f_0 - best)`). Also prints the digits of the cost: the
//! median of `-log10` of `(f - best) / (f_0 - best)`, at most 20.
//!
//! `cargo bench --bench least_squares -- [seed K] [set PART] [each]`. `seed`: other starts (each parameter
//! times 1 + u/4, u uniform in (-1, 1)). `set`: only sets whose name contains PART. `each`: a line per
//! problem.
#![allow(clippy::print_stdout, clippy::unwrap_used, clippy::panic)]

#[path = "../tests/problems/mod.rs"]
mod problems;

use dfo::{Report, least_squares};
use problems::calibration::fits;
use problems::nist::regressions;
use problems::solve::least_squares as reference;
use problems::{Instance, instances, residuals};

type Residuals = Box<dyn Fn(&[f64]) -> Vec<f64> + Send + Sync>;

struct Problem {
    name: String,
    start: Vec<f64>,
    residuals: Residuals,
    best: f64,
}

/// Uniform in (-1, 1).
fn noise(key: &[usize]) -> f64 {
    // SplitMix64 (Steele, Lea and Flood, OOPSLA 2014).
    let mixed = key.iter().fold(0u64, |z, k| {
        let z = (z ^ *k as u64).wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    });
    (mixed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

fn squares(r: &[f64]) -> f64 {
    r.iter().map(|r| r * r).sum()
}

/// Fits to data with noise of this fraction of their range, from three starts each.
fn fits_with(share: f64) -> Vec<Problem> {
    let each = |(k, which): (usize, usize)| {
        let fit = fits().remove(k);
        let (start, truth) = (fit.starts()[which].clone(), fit.truth.clone());
        let errors: Vec<f64> = (0..fit.residuals(&truth).len()).map(|i| noise(&[7, k, i])).collect();
        let scale = 4.0 * 3f64.sqrt() * share / (errors.len() as f64).sqrt();
        let residuals: Residuals = Box::new(move |x| {
            fit.residuals(x).iter().zip(&errors).map(|(r, e)| r + scale * e).collect::<Vec<f64>>()
        });
        let open = (vec![f64::NEG_INFINITY; truth.len()], vec![f64::INFINITY; truth.len()]);
        let best = reference(&*residuals, &truth, (&open.0, &open.1), 200).1;
        Problem { name: format!("{k}/{which}"), start, residuals, best }
    };
    (0..fits().len()).flat_map(|k| (0..3).map(move |which| (k, which))).map(each).collect()
}

fn sets(seed: usize) -> Vec<(&'static str, Vec<Problem>)> {
    let of = |p: Instance| Problem {
        name: format!("{}/{}/{}", p.number, p.n, p.scale),
        start: p.start(),
        best: p.best,
        residuals: Box::new(move |x| residuals(p.number, p.m, x)),
    };
    let regression = |(k, which): (usize, usize)| {
        let r = regressions().remove(k);
        let (name, start, best) = (format!("{} {which}", r.name), r.starts[which].clone(), r.best);
        Problem { name, start, best, residuals: Box::new(move |x| r.residuals(x)) }
    };
    let mut all = vec![
        ("Moré and Wild", instances().into_iter().map(of).collect::<Vec<_>>()),
        ("NIST StRD", (0..27).flat_map(|k| [(k, 0), (k, 1)]).map(regression).collect()),
        ("fits without noise in the data", fits_with(0.0)),
        ("fits, 1 % noise in the data", fits_with(0.01)),
    ];
    if seed > 0 {
        for (s, problem) in all.iter_mut().flat_map(|(_, problems)| problems).enumerate() {
            problem.start.iter_mut().enumerate().for_each(|(i, x)| *x *= 1.0 + 0.25 * noise(&[seed, s, i]));
        }
    }
    all
}

fn run(p: &Problem, tolerance: Option<f64>) -> Report {
    let f = |x: &[f64], out: &mut Vec<f64>| out.extend((p.residuals)(x));
    let run = least_squares(f).start(&p.start).max_evaluations(200 * (p.start.len() + 1));
    let run = match tolerance {
        Some(tolerance) => run.x_tol(tolerance).f_tol(tolerance),
        None => run,
    };
    run.run().unwrap()
}

fn main() {
    let words: Vec<String> = std::env::args().collect();
    let after = |word: &str| words.iter().position(|w| w == word).and_then(|k| words.get(k + 1)).cloned();
    let seed = after("seed").map_or(0, |s| s.parse().unwrap());
    let part = after("set").unwrap_or_default();
    for (name, problems) in sets(seed).iter().filter(|(name, _)| name.contains(&part)) {
        println!("\n{name}: {} problems", problems.len());
        for (title, tolerance) in [("tolerances 0", Some(0.0)), ("default tolerances", None)] {
            let (mut units, mut left) = (Vec::new(), Vec::new());
            for p in problems {
                let report = run(p, tolerance);
                let first = squares(&(p.residuals)(&p.start));
                units.push(report.n_evaluations as f64 / (p.start.len() + 1) as f64);
                left.push(((report.fun - p.best) / (first - p.best)).max(1e-20));
                if words.iter().any(|w| w == "each") {
                    let (units, left) = (units.last().unwrap(), left.last().unwrap());
                    println!("  {:16} {units:6.1} left {left:8.1e} {}", p.name, report.termination);
                }
            }
            let solved = |tau: f64| {
                100.0 * left.iter().filter(|left| **left <= tau).count() as f64 / left.len() as f64
            };
            let shares = [1e-3, 1e-5, 1e-7, 1e-10].map(|tau| format!("{:3.0} %", solved(tau))).join(" ");
            let mean = units.iter().sum::<f64>() / units.len() as f64;
            units.sort_by(f64::total_cmp);
            left.sort_by(f64::total_cmp);
            let (median, digits) = (units[units.len() / 2], -left[left.len() / 2].log10());
            println!(
                "{title:18}: to the end {median:5.1} (mean {mean:5.1}); solved at 1e-3 1e-5 1e-7 1e-10: {shares}; digits {digits:4.1}"
            );
        }
    }
}
