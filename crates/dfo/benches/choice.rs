//! Benchmark for the choice of a method for costs without residuals: `auto` and the methods it can choose, on
//! smooth, noisy, non-smooth, bounded and calibration-like problems. Prints the fraction of solved problems
//! and the median number of evaluations in units of n + 1, in which unsolved problems count as infinite.
//! `ratio`: the median in units of the smallest number of the single methods.
//!
//! `cargo bench --bench choice -- [seed K] [set PART] [each] [own]`. `seed`: other starts (each parameter
//! times 1 + u/4, u uniform in (-1, 1)) and other noise. `set`: only sets whose name contains PART. `each`: a
//! line per problem. `default_tolerances`: runs with default tolerances until they terminate.
#![allow(clippy::print_stdout, clippy::unwrap_used, clippy::panic)]

#[path = "../tests/problems/mod.rs"]
mod problems;

use dfo::{AnyMethod, CmaEs, NelderMead, PatternSearch, QuadraticModel, Report, Search, minimize};
use problems::boxes::{BOUNDED, bounded_box, boxes};
use problems::calibration::fits;
use problems::nist::regressions;
use problems::solve::least_squares;
use problems::{Instance, instances, residuals, start};

type Cost = Box<dyn Fn(&[f64]) -> f64 + Send + Sync>;

/// A problem: the cost that a method evaluates, and the cost for the assessment of its result.
struct Problem {
    name: String,
    start: Vec<f64>,
    bounds: Option<(Vec<f64>, Vec<f64>)>,
    seen: Cost,
    assessed: Cost,
    best: f64,
}

impl Problem {
    fn new(
        name: impl Into<String>,
        start: Vec<f64>,
        best: f64,
        f: impl Fn(&[f64]) -> f64 + Clone + Send + Sync + 'static,
    ) -> Self {
        Self {
            name: name.into(),
            start,
            bounds: None,
            seen: Box::new(f.clone()),
            assessed: Box::new(f),
            best,
        }
    }

    fn bounded(self, lower: Vec<f64>, upper: Vec<f64>) -> Self {
        Self { bounds: Some((lower, upper)), ..self }
    }

    fn seen(self, f: impl Fn(&[f64]) -> f64 + Send + Sync + 'static) -> Self {
        Self { seen: Box::new(f), ..self }
    }
}

/// Mixes the bits (Steele, Lea and Flood, OOPSLA 2014: SplitMix64).
fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Noise that is uniform in (-1, 1) and a function of the point, as an adaptive integrator adds to a smooth
/// cost.
fn noise(x: &[f64], seed: u64, number: usize) -> f64 {
    let bits = x.iter().fold(seed + 1, |h, v| mixed(h ^ v.to_bits()));
    let bits = mixed(bits.wrapping_add(0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(number as u64 + 1)));
    (bits >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Moré and Wild's deterministic noise: a cubic Chebyshev polynomial of sines and cosines of norms of 100 x.
fn wiggle(x: &[f64]) -> f64 {
    let one: f64 = x.iter().map(|v| v.abs()).sum();
    let most = x.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let two = x.iter().map(|v| v * v).sum::<f64>().sqrt();
    let phi = 0.9 * (100.0 * one).sin() * (100.0 * most).cos() + 0.1 * two.cos();
    phi * (4.0 * phi * phi - 3.0)
}

fn squares(r: &[f64]) -> f64 {
    r.iter().map(|r| r * r).sum()
}

struct Set {
    name: &'static str,
    problems: Vec<Problem>,
    budget: usize,
    taus: [f64; 3],
}

fn sets(seed: u64) -> Vec<Set> {
    let mut all = Vec::new();
    let mut add = |name, problems, budget, taus| all.push(Set { name, problems, budget, taus });
    let name = |p: &Instance| format!("{}/{}/{}", p.number, p.n, p.scale);
    let each = |of: &dyn Fn(Instance) -> Problem| instances().into_iter().map(of).collect::<Vec<_>>();
    let smooth = |p: Instance| Problem::new(name(&p), p.start(), p.best, move |x| p.cost(x));
    add("smooth: Moré and Wild", each(&smooth), 100, [1e-1, 1e-3, 1e-5]);
    let mut nist = Vec::new();
    for (k, which) in (0..27).flat_map(|k| [(k, 0), (k, 1)]) {
        let r = regressions().remove(k);
        nist.push(Problem::new(format!("{} {which}", r.name), r.starts[which].clone(), r.best, {
            let r = std::sync::Arc::new(r);
            move |x: &[f64]| r.cost(x)
        }));
    }
    add("smooth: NIST StRD", nist, 200, [1e-1, 1e-3, 1e-5]);
    for (title, sigma) in [("noisy: random 1e-3", 1e-3), ("noisy: random 1e-6", 1e-6)] {
        let noisy = |p: Instance| {
            smooth(p).seen(move |x| {
                let each =
                    |(k, r): (usize, f64)| (r * (1.0 + 3f64.sqrt() * sigma * noise(x, seed, k))).powi(2);
                residuals(p.number, p.m, x).into_iter().enumerate().map(each).sum()
            })
        };
        add(title, each(&noisy), 100, [1e-1, 1e-3, 1e-5]);
    }
    let wavy = |p: Instance| smooth(p).seen(move |x| p.cost(x) * (1.0 + 1e-3 * wiggle(x)));
    add("noisy: deterministic 1e-3", each(&wavy), 100, [1e-1, 1e-3, 1e-5]);
    let range = |p: &Instance| p.cost(&p.start()) - p.best;
    for (title, level) in [("noisy: 10 % of the range", 0.1), ("noisy: 1 % of the range", 0.01)] {
        let noisy = |p: Instance| {
            let size = 3f64.sqrt() * level * range(&p);
            smooth(p).seen(move |x| p.cost(x) + size * noise(x, seed, 0))
        };
        add(title, each(&noisy), 100, [1e-1, 1e-2, 1e-3]);
    }
    for (title, level) in [("steps: 1 % of the range", 0.01), ("steps: 0.1 % of the range", 1e-3)] {
        let rounded = |p: Instance| {
            let step = level * range(&p);
            smooth(p).seen(move |x| (p.cost(x) / step).round() * step)
        };
        add(title, each(&rounded), 100, [1e-1, 1e-2, 1e-3]);
    }
    let kinked = |p: Instance| {
        let clipped = [8, 9, 13, 16, 17, 18].contains(&p.number);
        Problem::new(name(&p), p.start(), f64::INFINITY, move |x: &[f64]| {
            let x: Vec<f64> = x.iter().map(|v| if clipped { v.max(0.0) } else { *v }).collect();
            residuals(p.number, p.m, &x).iter().map(|r| r.abs()).sum()
        })
    };
    add("kinks: absolute residuals", each(&kinked), 100, [1e-1, 1e-2, 1e-3]);
    let largest = |p: Instance| {
        Problem::new(name(&p), p.start(), f64::INFINITY, move |x: &[f64]| {
            residuals(p.number, p.m, x).iter().fold(0.0, |m: f64, r| m.max(r.abs()))
        })
    };
    add("kinks: largest residual", each(&largest), 100, [1e-1, 1e-2, 1e-3]);
    for (title, active) in [("bounded: minimum inside", false), ("bounded: bounds active", true)] {
        let mut problems = Vec::new();
        for (number, n, m) in BOUNDED {
            let (lower, upper) = bounded_box(number, n, m, active);
            let f = move |x: &[f64]| residuals(number, m, x);
            let best = least_squares(&f, &start(number, n), (&lower, &upper), 2000).1;
            let p = Problem::new(format!("{number}/{n}"), start(number, n), best, move |x: &[f64]| {
                squares(&f(x))
            });
            problems.push(p.bounded(lower, upper));
        }
        add(title, problems, 200, [1e-1, 1e-3, 1e-5]);
    }
    let boxed = boxes(true).into_iter().map(|p| {
        let (start, best, cost) = (p.start, p.best, std::sync::Arc::new(p.cost));
        Problem::new(p.name, start, best, move |x: &[f64]| cost(x)).bounded(p.lower, p.upper)
    });
    add("bounded: boxes", boxed.collect(), 200, [1e-1, 1e-3, 1e-5]);
    for title in ["fits", "fits in boxes", "fits, noise 1e-5", "fits, noise 1e-3", "fits, absolute residuals"]
    {
        let mut problems = Vec::new();
        for (k, which) in (0..fits().len()).flat_map(|k| [(k, 0), (k, 1), (k, 2)]) {
            let fit = std::sync::Arc::new(fits().remove(k));
            let (start, truth) = (fit.starts()[which].clone(), fit.truth.clone());
            // Measurement noise of 1 % of a range of four standard deviations.
            let errors = move |m: usize| {
                (0..m).map(move |i| 0.04 / (m as f64).sqrt() * 1.7 * noise(&[k as f64], seed, i))
            };
            let absolute = title.ends_with("residuals");
            let cost = move |x: &[f64]| {
                let r = fit.residuals(x);
                let each = r
                    .iter()
                    .zip(errors(r.len()))
                    .map(|(r, e)| if absolute { (r + e).abs() } else { (r + e).powi(2) });
                each.sum::<f64>()
            };
            let level = if title.ends_with("1e-5") {
                1e-5
            } else if title.ends_with("1e-3") {
                1e-3
            } else {
                0.0
            };
            let mut p = Problem::new(format!("{k}/{which}"), start, f64::INFINITY, cost.clone());
            if level > 0.0 {
                p = p.seen(move |x| cost(x) * (1.0 + level * noise(x, seed, 0)));
            }
            if title == "fits in boxes" {
                let ends = |inner: f64, outer: f64| {
                    truth.iter().map(|t| t * if *t > 0.0 { inner } else { outer }).collect()
                };
                p = p.bounded(ends(0.2, 3.0), ends(3.0, 0.2));
            }
            problems.push(p);
        }
        add(title, problems, 200, [1e-1, 1e-3, 1e-5]);
    }
    if seed > 0 {
        for (s, p) in all.iter_mut().flat_map(|set| set.problems.iter_mut()).enumerate() {
            for i in 0..p.start.len() {
                let moved = p.start[i] * (1.0 + 0.25 * noise(&[s as f64], seed, i));
                let (low, high) =
                    p.bounds.as_ref().map_or((f64::NEG_INFINITY, f64::INFINITY), |(l, u)| (l[i], u[i]));
                p.start[i] = moved.clamp(low, high);
            }
        }
    }
    all
}

/// Index of `auto`, after the single methods.
const AUTO: usize = 4;

fn methods() -> [(&'static str, AnyMethod); AUTO + 1] {
    [
        ("nelder-mead", NelderMead::default().into()),
        ("quadratic-model", QuadraticModel::default().into()),
        ("cma-es", CmaEs::default().into()),
        ("pattern-search", PatternSearch::default().into()),
        ("auto", AnyMethod::auto(Search::Local)),
    ]
}

fn run(p: &Problem, method: AnyMethod, budget: usize, default_tolerances: bool) -> Report {
    let run = minimize(|x: &[f64]| (p.seen)(x)).start(&p.start).method(method);
    let run = match &p.bounds {
        Some((lower, upper)) => run.bounds(lower, upper).unwrap(),
        None => run,
    };
    let run = if default_tolerances {
        run
    } else {
        run.x_tol(0.0).f_tol(0.0).max_evaluations(budget * (p.start.len() + 1))
    };
    run.run().unwrap()
}

/// Running minimum of the noise-free costs of all evaluations.
fn history(p: &Problem, report: &Report) -> Vec<f64> {
    let mut least = f64::INFINITY;
    let each = report.trace.iter().map(|e| {
        let cost = (p.assessed)(e.x);
        least = if cost < least { cost } else { least };
        least
    });
    each.collect()
}

fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let words: Vec<String> = std::env::args().collect();
    let after = |word: &str| words.iter().position(|w| w == word).and_then(|k| words.get(k + 1)).cloned();
    let has = |word: &str| words.iter().any(|w| w == word);
    let seed = after("seed").map_or(0, |s| s.parse().unwrap());
    let part = after("set").unwrap_or_default();
    for set in sets(seed).iter().filter(|set| set.name.contains(&part)) {
        let runs: Vec<Vec<(Report, Vec<f64>)>> = methods()
            .iter()
            .map(|(_, method)| {
                let each = |p: &Problem| {
                    let report = run(p, method.clone(), set.budget, has("own"));
                    let seen = history(p, &report);
                    (report, seen)
                };
                set.problems.iter().map(each).collect()
            })
            .collect();
        let best: Vec<f64> = (0..set.problems.len())
            .map(|k| {
                runs.iter().fold(set.problems[k].best, |best, runs| best.min(*runs[k].1.last().unwrap()))
            })
            .collect();
        let goal = |k: usize, tau: f64| {
            let first = (set.problems[k].assessed)(&set.problems[k].start);
            first - (1.0 - tau) * (first - best[k])
        };
        println!("\n{}: {} problems, {} (n + 1) evaluations", set.name, best.len(), set.budget);
        let units: Vec<Vec<Vec<f64>>> = runs
            .iter()
            .map(|runs| {
                let of = |tau: f64| {
                    let each = runs.iter().enumerate().map(|(k, (_, seen))| {
                        let n = set.problems[k].start.len();
                        let place = seen.iter().position(|cost| *cost <= goal(k, tau));
                        place.map_or(f64::INFINITY, |place| (place + 1) as f64 / (n + 1) as f64)
                    });
                    each.collect()
                };
                set.taus.map(of).to_vec()
            })
            .collect();
        for (which, (name, _)) in methods().iter().enumerate() {
            let mut line = format!("{name:16}");
            for (t, tau) in set.taus.iter().enumerate() {
                let of = |m: usize| median(&units[m][t]);
                let solved = |m: usize| {
                    100.0 * units[m][t].iter().filter(|u| u.is_finite()).count() as f64 / best.len() as f64
                };
                let ratio = of(which) / (0..AUTO).map(of).fold(f64::INFINITY, f64::min);
                line += &format!(" | {tau:5.0e} {:4.0} % {:6.1} ratio {ratio:4.2}", solved(which), of(which));
            }
            let ends: Vec<f64> =
                runs[which].iter().map(|(r, _)| r.n_evaluations as f64 / (r.x.len() + 1) as f64).collect();
            let last = set.taus.len() - 1;
            let wrong = (0..best.len())
                .filter(|&k| runs[which][k].0.is_success() && units[which][last][k].is_infinite())
                .count();
            line += &format!(" | to the end {:5.1}, wrong {wrong}", median(&ends));
            println!("{line}");
        }
        if has("each") {
            for (k, p) in set.problems.iter().enumerate() {
                let cells: Vec<String> =
                    units.iter().map(|u| format!("{:6.1} {:6.1}", u[1][k], u[AUTO][k])).collect();
                println!(
                    "  {:24} n {:2} {} {}",
                    p.name,
                    p.start.len(),
                    cells.join(" | "),
                    runs[AUTO][k].0.message
                );
            }
        }
    }
}
