//! Evaluations and sequential rounds of least squares until `f - best <= tau (f_0 - best)`, tau = 1e-5, for
//! each batch plan. A round evaluates at most as many points as there are workers. Medians over the problems
//! of a set; a problem that is not solved within 200 (n + 1) evaluations counts as infinite.
//!
//! `cargo bench --bench rounds -- [set PART] [plan PART] [seed K] [each]`. With `serve`, the bench answers
//! questions about its problems on its standard streams, so that `rounds_peers.py` can run other solvers on
//! them: `list`, or the number of a problem and a point.
#![allow(clippy::print_stdout, clippy::unwrap_used, clippy::panic)]

#[path = "../tests/problems/mod.rs"]
mod problems;

use dfo::{LeastSquares, least_squares};
use problems::boxes::BOUNDED;
use problems::calibration::fits;
use problems::nist::regressions;
use problems::rotated::Random;
use problems::solve::least_squares as reference;
use problems::{residuals, start};
use std::io::{BufRead, Write};

type Residuals = Box<dyn Fn(&[f64]) -> Vec<f64> + Send + Sync>;

struct Problem {
    set: &'static str,
    name: String,
    start: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    residuals: Residuals,
    best: f64,
}

const TAU: f64 = 1e-5;

fn squares(r: &[f64]) -> f64 {
    r.iter().map(|r| r * r).sum()
}

/// A problem without bounds. A `best` of NaN is computed from the start.
fn open(
    set: &'static str,
    name: String,
    start: Vec<f64>,
    best: f64,
    residuals: impl Fn(&[f64]) -> Vec<f64> + Send + Sync + 'static,
) -> Problem {
    let n = start.len();
    let (lower, upper) = (vec![f64::NEG_INFINITY; n], vec![f64::INFINITY; n]);
    let best = if best.is_nan() { reference(&residuals, &start, (&lower, &upper), 300).1 } else { best };
    Problem { set, name, start, lower, upper, residuals: Box::new(residuals), best }
}

fn curves(seed: u64) -> Vec<Problem> {
    let mut random = Random::new(seed);
    let mut all = Vec::new();
    for k in 0..27 {
        for which in 0..2 {
            let r = regressions().remove(k);
            let mut start = r.starts[which].clone();
            if seed > 0 {
                start.iter_mut().for_each(|x| *x *= 1.0 + 0.3 * (random.uniform() - 0.5));
            }
            all.push(open("curves", format!("{} {which}", r.name), start, r.best, move |x| r.residuals(x)));
        }
    }
    for k in 0..fits().len() {
        let fit = fits().remove(k);
        let (start, truth) = (fit.starts()[(seed % 3) as usize].clone(), fit.truth.clone());
        let len = fit.residuals(&truth).len();
        let errors: Vec<f64> = random.normals(len).iter().map(|e| 0.02 * e / (len as f64).sqrt()).collect();
        let name = fit.name.to_owned();
        let f = move |x: &[f64]| fit.residuals(x).iter().zip(&errors).map(|(r, e)| r + e).collect::<Vec<_>>();
        let bounds = (vec![f64::NEG_INFINITY; truth.len()], vec![f64::INFINITY; truth.len()]);
        let best = reference(&f, &truth, (&bounds.0, &bounds.1), 200).1;
        all.push(open("curves", name, start, best, f));
    }
    all
}

/// Boxes that exclude the unbounded minimum in about half of the coordinates.
fn bounded(seed: u64) -> Vec<Problem> {
    let mut random = Random::new(1000 + seed);
    let mut all = Vec::new();
    for (number, n, m) in BOUNDED {
        for turn in 0..2 {
            let f = move |x: &[f64]| residuals(number, m, x);
            let x0 = start(number, n);
            let far = (vec![f64::NEG_INFINITY; n], vec![f64::INFINITY; n]);
            let (end, _) = reference(&f, &x0, (&far.0, &far.1), 500);
            let (mut lower, mut upper, mut from) = (Vec::new(), Vec::new(), Vec::new());
            for k in 0..n {
                let width = (end[k] - x0[k]).abs().max(0.1 * end[k].abs()).max(0.1);
                let (mut low, mut high) = (x0[k].min(end[k]) - width, x0[k].max(end[k]) + width);
                if random.uniform() < 0.5 {
                    let cut = end[k] + (x0[k] - end[k]) * (0.1 + 0.5 * random.uniform());
                    if x0[k] > end[k] { low = cut } else { high = cut }
                }
                lower.push(low);
                upper.push(high);
                from.push(x0[k].clamp(low, high));
            }
            let tried = [from.clone(), end.clone(), lower.clone(), upper.clone()];
            let costs = tried.iter().map(|s| reference(&f, s, (&lower, &upper), 500).1);
            let best = costs.fold(f64::INFINITY, f64::min);
            let name = format!("{number}/{n} {turn}");
            all.push(Problem {
                set: "bounds",
                name,
                start: from,
                lower,
                upper,
                residuals: Box::new(f),
                best,
            });
        }
    }
    all
}

/// Curved residuals whose Jacobians have a condition number of 1e4 to 1e6.
fn correlated(seed: u64) -> Vec<Problem> {
    let each = |k: u64| {
        let mut random = Random::new(5000 * (seed + 1) + k);
        let n = [2, 3, 4, 6, 8][(k % 5) as usize];
        let (m, digits) = (4 * n, 4.0 + (k % 3) as f64);
        let (rows, turn) = (random.rotation(m), random.rotation(n));
        let size = |j: usize| 10f64.powf(-digits * j as f64 / (n as f64 - 1.0));
        let a: Vec<Vec<f64>> = (0..m)
            .map(|i| (0..n).map(|c| (0..n).map(|j| rows[j][i] * size(j) * turn[j][c]).sum()).collect())
            .collect();
        let truth: Vec<f64> = (0..n).map(|_| 0.5 + 1.5 * random.uniform()).collect();
        let off: Vec<f64> = random.normals(m).iter().map(|v| 0.002 * v).collect();
        let start: Vec<f64> = truth.iter().map(|t| t * (1.4 * random.uniform() - 0.7).exp()).collect();
        let bend = [0.05, 0.2, 0.01][(k % 3) as usize];
        let center = truth.clone();
        let f = move |x: &[f64]| {
            let each = |(row, off): (&Vec<f64>, &f64)| {
                let along: f64 = row.iter().zip(x.iter().zip(&center)).map(|(a, (x, t))| a * (x - t)).sum();
                along + bend * along * along + off
            };
            a.iter().zip(&off).map(each).collect::<Vec<f64>>()
        };
        let far = (vec![f64::NEG_INFINITY; n], vec![f64::INFINITY; n]);
        let best = reference(&f, &truth, (&far.0, &far.1), 300).1;
        open("correlated", format!("{n}/{k}"), start, best, f)
    };
    (0..33).map(each).collect()
}

/// Moré, Garbow and Hillstrom (1981), problems 21, 22, 25, 26, 28, 29, 30 and 31.
fn large(set: &'static str, n: usize) -> Vec<Problem> {
    let h = 1.0 / (n as f64 + 1.0);
    let t = move |i: usize| (i as f64 + 1.0) * h;
    let at = |x: &[f64], i: isize| usize::try_from(i).ok().and_then(|i| x.get(i)).copied().unwrap_or(0.0);
    let curve: Vec<f64> = (0..n).map(|i| t(i) * (t(i) - 1.0)).collect();
    let pairs: Vec<f64> = (0..n).map(|i| [-1.2, 1.0][i % 2]).collect();
    let fours: Vec<f64> = (0..n).map(|i| [3.0, -1.0, 0.0, 1.0][i % 4]).collect();
    let named =
        |name: &str, start: Vec<f64>, best: f64, f: Residuals| open(set, name.to_owned(), start, best, f);
    vec![
        named(
            "rosenbrock",
            pairs,
            0.0,
            Box::new(|x| x.chunks(2).flat_map(|x| [10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]).collect()),
        ),
        named(
            "powell",
            fours[..n - n % 4].to_vec(),
            0.0,
            Box::new(|x| {
                x.chunks(4)
                    .flat_map(|x| {
                        let (b, d) = (x[1] - 2.0 * x[2], x[0] - x[3]);
                        [x[0] + 10.0 * x[1], 5f64.sqrt() * (x[2] - x[3]), b * b, 10f64.sqrt() * d * d]
                    })
                    .collect()
            }),
        ),
        named(
            "variably dimensioned",
            (0..n).map(|i| 1.0 - t(i)).collect(),
            0.0,
            Box::new(move |x| {
                let sum: f64 = x.iter().enumerate().map(|(i, x)| t(i) * (x - 1.0)).sum();
                x.iter().map(|x| x - 1.0).chain([sum, sum * sum]).collect()
            }),
        ),
        named(
            "trigonometric",
            vec![1.0 / n as f64; n],
            f64::NAN,
            Box::new(move |x| {
                let cosines: f64 = x.iter().map(|x| x.cos()).sum();
                let each =
                    |(i, x): (usize, &f64)| n as f64 - cosines + (i as f64 + 1.0) * (1.0 - x.cos()) - x.sin();
                x.iter().enumerate().map(each).collect()
            }),
        ),
        named(
            "boundary value",
            curve.clone(),
            0.0,
            Box::new(move |x| {
                let each = |i: usize| {
                    let k = i as isize;
                    2.0 * x[i] - at(x, k - 1) - at(x, k + 1) + h * h * (x[i] + t(i) + 1.0).powi(3) / 2.0
                };
                (0..n).map(each).collect()
            }),
        ),
        named(
            "integral equation",
            curve,
            0.0,
            Box::new(move |x| {
                let cube = |j: usize| (x[j] + t(j) + 1.0).powi(3);
                let below = |i: usize| (0..=i).map(|j| t(j) * cube(j)).sum::<f64>();
                let above = |i: usize| (i + 1..n).map(|j| (1.0 - t(j)) * cube(j)).sum::<f64>();
                (0..n).map(|i| x[i] + h * ((1.0 - t(i)) * below(i) + t(i) * above(i)) / 2.0).collect()
            }),
        ),
        named(
            "broyden tridiagonal",
            vec![-1.0; n],
            0.0,
            Box::new(move |x| {
                let each = |i: usize| {
                    let k = i as isize;
                    (3.0 - 2.0 * x[i]) * x[i] - at(x, k - 1) - 2.0 * at(x, k + 1) + 1.0
                };
                (0..n).map(each).collect()
            }),
        ),
        named(
            "broyden banded",
            vec![-1.0; n],
            0.0,
            Box::new(move |x| {
                let each = |i: usize| {
                    let near = (i.saturating_sub(5)..(i + 2).min(n)).filter(|j| *j != i);
                    x[i] * (2.0 + 5.0 * x[i] * x[i]) + 1.0 - near.map(|j| x[j] * (1.0 + x[j])).sum::<f64>()
                };
                (0..n).map(each).collect()
            }),
        ),
    ]
}

fn all(seed: u64) -> Vec<Problem> {
    let mut all = curves(seed);
    all.extend(bounded(seed));
    all.extend(correlated(seed));
    all.extend(large("n = 30", 30).into_iter().chain(large("n = 60", 60)).chain(large("n = 100", 100)));
    all
}

/// Returns the number of evaluations until solved, and the sequential rounds with each number of workers.
fn run(p: &Problem, method: LeastSquares, workers: &[usize]) -> (f64, Vec<f64>) {
    let n = p.start.len();
    let goal = p.best + TAU * (squares(&(p.residuals)(&p.start)) - p.best);
    let f = |x: &[f64], out: &mut Vec<f64>| out.extend((p.residuals)(x));
    let run = least_squares(f).start(&p.start).bounds(&p.lower, &p.upper).unwrap().method(method);
    let report = run.max_evaluations(200 * (n + 1)).run().unwrap();
    let mut sizes: Vec<usize> = Vec::new();
    let (mut last, mut first, mut count) = (u64::MAX, None, 0usize);
    for e in report.trace.iter() {
        count += 1;
        if first.is_some() && last != e.batch {
            break;
        }
        if last != e.batch {
            sizes.push(0);
            last = e.batch;
        }
        *sizes.last_mut().unwrap() += 1;
        if first.is_none() && e.outcome.value().is_some_and(|f| f <= goal) {
            first = Some(count);
        }
    }
    let rounds = |w: &usize| match first {
        Some(_) => sizes.iter().map(|s| s.div_ceil(*w)).sum::<usize>() as f64,
        None => f64::INFINITY,
    };
    (first.map_or(f64::INFINITY, |k| k as f64 / (n + 1) as f64), workers.iter().map(rounds).collect())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn serve(all: &[Problem]) {
    let out = std::io::stdout();
    for line in std::io::stdin().lock().lines() {
        let line = line.unwrap();
        let mut out = out.lock();
        if line == "list" {
            for (k, p) in all.iter().enumerate() {
                writeln!(
                    out,
                    "{k}|{}|{}|{:?}|{:?}|{:?}|{:e}",
                    p.set, p.name, p.start, p.lower, p.upper, p.best
                )
                .unwrap();
            }
            writeln!(out, "end").unwrap();
        } else {
            let mut words = line.split(' ');
            let p = &all[words.next().unwrap().parse::<usize>().unwrap()];
            let x: Vec<f64> = words.map(|w| w.parse().unwrap()).collect();
            let r: Vec<String> = (p.residuals)(&x).iter().map(|r| format!("{r:e}")).collect();
            writeln!(out, "{}", r.join(" ")).unwrap();
        }
        out.flush().unwrap();
    }
}

fn main() {
    let words: Vec<String> = std::env::args().collect();
    let after = |word: &str| words.iter().position(|w| w == word).and_then(|k| words.get(k + 1)).cloned();
    let all = all(after("seed").map_or(0, |seed| seed.parse().unwrap()));
    if words.iter().any(|w| w == "serve") {
        return serve(&all);
    }
    let (set, plan) = (after("set").unwrap_or_default(), after("plan").unwrap_or_default());
    let each = words.iter().any(|w| w == "each");
    for set in
        ["curves", "bounds", "correlated", "n = 30", "n = 60", "n = 100"].iter().filter(|s| s.contains(&set))
    {
        let of_set: Vec<&Problem> = all.iter().filter(|p| p.set == *set).collect();
        println!("\n{set}: {} problems", of_set.len());
        type Plan = fn(usize) -> LeastSquares;
        let plans: [(&str, Plan); 5] = [
            ("serial", |_| LeastSquares::default().serial()),
            ("rounds", |_| LeastSquares::default().rounds()),
            ("batch 8", |_| LeastSquares::default().batch(8)),
            ("batch 32", |_| LeastSquares::default().batch(32)),
            ("batch n + 2", |n| LeastSquares::default().batch(n + 2)),
        ];
        for (name, method) in plans.iter().filter(|(name, _)| name.contains(&plan)) {
            let (mut units, mut rounds) = (Vec::new(), [Vec::new(), Vec::new(), Vec::new()]);
            for p in &of_set {
                let n = p.start.len();
                let (unit, of_run) = run(p, method(n), &[8, 32, n + 2]);
                if each {
                    println!("  {:24} {unit:7.1} {of_run:?}", p.name);
                }
                units.push(unit);
                rounds.iter_mut().zip(of_run).for_each(|(all, one)| all.push(one));
            }
            let solved = units.iter().filter(|u| u.is_finite()).count() as f64 / units.len() as f64;
            let [a, b, c] = rounds.map(median);
            println!(
                "{name:12}: solved {:5.1} %, evaluations {:5.2} (n + 1); rounds with 8 workers {a:4.0}, 32 {b:4.0}, n + 2 {c:4.0}",
                100.0 * solved,
                median(units)
            );
        }
    }
}
