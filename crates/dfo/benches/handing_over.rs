//! Cost and gain of workers for Nelder-Mead with evaluations of 1 us to 10 ms that keep a core busy.
//! Requirement: no number of workers is more than 5 % slower than one worker. Each run with several workers
//! is paired with a run with one worker, alternately before and after it. The result is the median of the
//! ratios of these pairs.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use dfo::minimize;
use std::time::{Duration, Instant};

const WORKERS: [usize; 4] = [2, 3, 4, 8];
const BAR: f64 = 1.05;

/// A cost function that takes the given time.
fn busy(x: &[f64], time: Duration) -> f64 {
    let start = Instant::now();
    let cost = x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum();
    while start.elapsed() < time {
        std::hint::spin_loop();
    }
    cost
}

/// Seconds of a run, rounds, and speculative evaluations.
fn run(time: Duration, workers: usize, evaluations: usize) -> (f64, usize, usize) {
    let start = Instant::now();
    let report = minimize(|x: &[f64]| busy(x, time))
        .start(&[-1.2, 1.0, -1.2, 1.0])
        .workers(workers)
        .max_evaluations(evaluations)
        .run()
        .unwrap();
    (start.elapsed().as_secs_f64(), report.n_batches, report.n_speculative)
}

fn median(list: &mut [f64]) -> f64 {
    list.sort_by(f64::total_cmp);
    list[list.len() / 2]
}

fn main() {
    println!(
        "evaluation, workers: ms of a run, in units of one worker next to it (bar {BAR}), rounds, made in vain"
    );
    for (micros, evaluations, pairs) in [
        (1, 300, 201),
        (10, 300, 101),
        (50, 300, 51),
        (100, 300, 51),
        (200, 300, 31),
        (500, 300, 15),
        (2000, 200, 9),
        (10_000, 100, 5),
    ] {
        let time = Duration::from_micros(micros);
        for workers in WORKERS {
            let (mut seconds, mut ratios, mut counts) = (Vec::new(), Vec::new(), (0, 0));
            // The first pair warms up.
            for pair in 0..=pairs {
                let alone_first = pair % 2 == 0;
                let before = alone_first.then(|| run(time, 1, evaluations).0);
                let (took, rounds, ahead) = run(time, workers, evaluations);
                let alone = before.unwrap_or_else(|| run(time, 1, evaluations).0);
                if pair > 0 {
                    seconds.push(took);
                    ratios.push(took / alone);
                    counts = (rounds, ahead);
                }
            }
            let (ratio, (rounds, ahead)) = (median(&mut ratios), counts);
            let verdict = if ratio > BAR { "  SLOWER" } else { "" };
            let ms = 1e3 * median(&mut seconds);
            println!("{micros:6} us, {workers}: {ms:9.3} {ratio:.3} {rounds:5} {ahead:5}{verdict}");
        }
    }
}
