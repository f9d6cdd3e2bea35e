//! Differential evolution with a thousand workers for a population of a thousand; an evaluation waits for 20
//! ms. The run is compared with a plain pool of a thousand threads that evaluates the same points one
//! generation at a time. Prints the median ratio of the times. Requirement: 1.2.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use dfo::{DifferentialEvolution, minimize};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

const WORKERS: usize = 1000;
const GENERATIONS: usize = 20;
const PAIRS: usize = 9;

fn cost(x: &[f64]) -> f64 {
    std::thread::sleep(Duration::from_millis(20));
    x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
}

/// Sender of points to the threads, and receiver of their costs.
struct Pool(Sender<Vec<f64>>, Receiver<f64>);

impl Pool {
    fn new() -> Self {
        let (sender, waiting) = channel::<Vec<f64>>();
        let (done, receiver) = channel();
        let waiting = Arc::new(Mutex::new(waiting));
        for _ in 0..WORKERS {
            let (waiting, done) = (Arc::clone(&waiting), done.clone());
            std::thread::spawn(move || {
                loop {
                    let next = waiting.lock().unwrap().recv();
                    let Ok(x) = next else { return };
                    done.send(cost(&x)).unwrap();
                }
            });
        }
        Self(sender, receiver)
    }
}

fn plain() -> f64 {
    let start = Instant::now();
    let pool = Pool::new();
    for generation in 0..GENERATIONS {
        (0..WORKERS).for_each(|k| pool.0.send(vec![0.1; 5 + generation % 2 + k % 2]).unwrap());
        (0..WORKERS).for_each(|_| _ = pool.1.recv().unwrap());
    }
    start.elapsed().as_secs_f64()
}

fn evolution(method: DifferentialEvolution) -> f64 {
    let start = Instant::now();
    let run = minimize(cost).bounds(&[-5.0; 5], &[5.0; 5]).unwrap().method(method.population(WORKERS));
    run.workers(WORKERS).seed(1).max_evaluations(GENERATIONS * WORKERS).run().unwrap();
    start.elapsed().as_secs_f64()
}

fn main() {
    for (name, method) in [
        ("de-classic", DifferentialEvolution::classic()),
        ("de-classic, lag 1000", DifferentialEvolution::classic().lag(WORKERS)),
        // The population does not shrink while only such a small part of the budget is spent.
        ("de", DifferentialEvolution::default().budget(100 * GENERATIONS * WORKERS)),
    ] {
        let pairs: Vec<(f64, f64)> = (0..PAIRS).map(|_| (evolution(method.clone()), plain())).collect();
        let mut ratios: Vec<f64> = pairs.iter().map(|(measured, reference)| measured / reference).collect();
        ratios.sort_by(f64::total_cmp);
        let (measured, reference) = pairs[PAIRS / 2];
        println!(
            "{name}: {:.2} (from {:.2} to {:.2}); {measured:.2} s compared with {reference:.2} s",
            ratios[PAIRS / 2],
            ratios[0],
            ratios[PAIRS - 1]
        );
    }
}
