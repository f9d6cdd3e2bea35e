//! Speed-up by many workers, measured with a simulated clock: each evaluation takes one unit of time, and a
//! fixed fraction of them ten. Prints the table of benches/scaling.md and writes its plot to the path given
//! after `--`.
#![allow(clippy::print_stdout, clippy::unwrap_used, unreachable_pub)]

#[path = "../tests/common/clocked.rs"]
mod clocked;

use clocked::{Clocked, hash, one_in, rosenbrock};
use dfo::{Answer, AnyMethod, CmaEs, EvaluationKind, Multistart, Outcome, Polish, Query, minimize_by};
use std::fmt::Write;

const WIDTHS: [usize; 5] = [1, 4, 10, 100, 1000];
const SEEDS: u64 = 2;

/// Rosenbrock's function, as a sum of squares if residuals are requested.
fn answer(x: &[f64], query: &Query<'_>) -> Answer {
    let pairs = || x.windows(2).flat_map(|w| [10.0 * (w[1] - w[0] * w[0]), 1.0 - w[0]]);
    let residuals = if query.kind == EvaluationKind::Residuals { pairs().collect() } else { Vec::new() };
    Answer { residuals, ..Outcome::Value(rosenbrock(x)).into() }
}

/// Mean simulated time of a run.
fn time(method: &AnyMethod, n: usize, width: usize, length: impl Fn(&[f64]) -> f64 + Copy) -> f64 {
    let run = |seed: u64| {
        let (mut clocked, seen) = Clocked::new(width, length);
        clocked.answer = answer;
        let start: Vec<f64> =
            (0..n).map(|k| (hash(&[k as f64, seed as f64]) % 1000) as f64 / 250.0 - 2.0).collect();
        let run = minimize_by(clocked).with_residuals(true).start(&start);
        let run = run.bounds(&vec![-5.0; n], &vec![5.0; n]).unwrap().method(method.clone());
        run.workers(width).seed(seed).max_evaluations(400 * n).run().unwrap();
        seen.now.get()
    };
    (0..SEEDS).map(run).sum::<f64>() / SEEDS as f64
}

/// Plots a line for each method over the logarithm of the number of workers.
fn picture(lines: &[(String, Vec<f64>)]) -> String {
    let most = (WIDTHS[WIDTHS.len() - 1] as f64).log10();
    let place = |width: usize, gain: f64| {
        (60.0 + 440.0 * (width as f64).log10() / most, 360.0 - 320.0 * gain.max(1.0).log10() / 2.0)
    };
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 720 420\" font-family=\"sans-serif\" font-size=\"13\">\n",
    );
    svg += "<rect width=\"720\" height=\"420\" fill=\"white\"/>\n<text x=\"240\" y=\"405\">workers</text><text x=\"10\" y=\"20\">speed-up</text>\n";
    for width in WIDTHS {
        let (x, y) = place(width, 1.0);
        writeln!(svg, "<text x=\"{x:.0}\" y=\"{:.0}\" text-anchor=\"middle\">{width}</text>", y + 18.0)
            .unwrap();
    }
    for gain in [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0] {
        let (x, y) = place(1, gain);
        writeln!(svg, "<line x1=\"{x:.0}\" y1=\"{y:.1}\" x2=\"500\" y2=\"{y:.1}\" stroke=\"#ddd\"/><text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\">{gain}</text>", x - 6.0, y + 4.0).unwrap();
    }
    let colours = ["#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f"];
    let mut ends: Vec<usize> = (0..lines.len()).collect();
    ends.sort_by(|a, b| lines[*b].1.last().unwrap().total_cmp(lines[*a].1.last().unwrap()));
    let mut above = 0.0f64;
    for k in ends {
        let (name, gains) = &lines[k];
        let points: Vec<String> = WIDTHS
            .iter()
            .zip(gains)
            .map(|(w, g)| place(*w, *g))
            .map(|(x, y)| format!("{x:.1},{y:.1}"))
            .collect();
        let colour = colours[k % colours.len()];
        let y = (place(1, *gains.last().unwrap()).1 + 4.0).max(above + 15.0);
        above = y;
        writeln!(svg, "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/><text x=\"508\" y=\"{y:.1}\" fill=\"{colour}\">{name}</text>", points.join(" ")).unwrap();
    }
    svg + "</svg>\n"
}

fn main() {
    let searches = |polish| AnyMethod::from(Multistart::default().exploration(0.0).polish(polish));
    let named = [
        "least-squares",
        "quadratic-model",
        "cma-es",
        "ga",
        "de",
        "de-classic",
        "pattern-search",
        "nelder-mead",
        "multistart",
    ];
    let mut methods: Vec<(String, AnyMethod)> =
        named.into_iter().map(|name| (name.to_owned(), name.parse().unwrap())).collect();
    methods.insert(3, ("cma-es, lag 64".to_owned(), CmaEs::default().lag(64).into()));
    methods.insert(1, ("multistart, least-squares".to_owned(), searches(Polish::LeastSquares)));
    let mut lines = Vec::new();
    for (n, every) in [(5, 10), (5, 0)] {
        let spread = if every == 0 {
            "all evaluations alike".to_owned()
        } else {
            format!("one in {every} ten times as long")
        };
        println!(
            "\nn = {n}, {spread}\n\n| method |{}",
            WIDTHS[1..].iter().fold(String::new(), |row, w| row + &format!(" {w} |"))
        );
        println!("|---|{}", "---|".repeat(WIDTHS.len() - 1));
        for (name, method) in &methods {
            let times: Vec<f64> = WIDTHS
                .iter()
                .map(|width| {
                    if every == 0 {
                        time(method, n, *width, |_| 1.0)
                    } else {
                        time(method, n, *width, one_in(every))
                    }
                })
                .collect();
            let gains: Vec<f64> = times.iter().map(|t| times[0] / t).collect();
            println!(
                "| {name} |{}",
                gains[1..].iter().fold(String::new(), |row, g| row + &format!(" {g:.1} |"))
            );
            if (n, every) == (5, 10) {
                lines.push((name.clone(), gains));
            }
        }
    }
    if let Some(path) = std::env::args().skip(1).find(|argument| argument.ends_with(".svg")) {
        std::fs::write(path, picture(&lines)).unwrap();
    }
}
