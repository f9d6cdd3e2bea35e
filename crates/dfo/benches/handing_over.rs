//! What workers cost and gain for Nelder-Mead with evaluations of 1 us to 10 ms, which keep a core busy: the bar is that no
//! number of workers is slower than one by more than 5 %. Medians of several runs, which take turns.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use dfo::minimize;
use std::time::{Duration, Instant};

const WORKERS: [usize; 3] = [1, 2, 4];

/// A cost that takes so long.
fn busy(x: &[f64], time: Duration) -> f64 {
    let start = Instant::now();
    let cost = x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum();
    while start.elapsed() < time {
        std::hint::spin_loop();
    }
    cost
}

/// Seconds of a run, rounds, and evaluations made ahead of need.
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

fn main() {
    println!(
        "time of an evaluation, workers: ms (times as fast as one), rounds, evaluations made ahead and not needed"
    );
    for (micros, evaluations) in [(1, 300), (10, 300), (100, 300), (1000, 300), (10_000, 150)] {
        let time = Duration::from_micros(micros);
        let mut seconds = vec![Vec::new(); WORKERS.len()];
        let mut counts = [(0, 0); WORKERS.len()];
        for _ in 0..if micros < 1000 { 51 } else { 7 } {
            for (k, workers) in WORKERS.into_iter().enumerate() {
                let (took, rounds, ahead) = run(time, workers, evaluations);
                seconds[k].push(took);
                counts[k] = (rounds, ahead);
            }
        }
        let median = |list: &mut Vec<f64>| {
            list.sort_by(f64::total_cmp);
            list[list.len() / 2]
        };
        let medians: Vec<f64> = seconds.iter_mut().map(median).collect();
        for (k, workers) in WORKERS.into_iter().enumerate() {
            let ((rounds, ahead), gain) = (counts[k], medians[0] / medians[k]);
            println!("{micros:6} us, {workers}: {:9.3} ({gain:.2}) {rounds:5} {ahead:5}", 1e3 * medians[k]);
        }
    }
}
