//! Overhead of the stepper: time per right-hand side of a whole run, minus the time of the function alone.
//! Both are measured in this run. Run with `cargo bench -p fmufit-ode`.

#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use ode::{CallResult, Driver, EventOutcome, HybridSystem, Ignore, Options};
use std::hint::black_box;
use std::time::Instant;

/// `n / 2` Van der Pol oscillators.
struct Oscillators(usize);

#[inline(never)]
fn right_hand_side(x: &[f64], dx: &mut [f64]) {
    for (x, dx) in x.chunks_exact(2).zip(dx.chunks_exact_mut(2)) {
        dx[0] = x[1];
        dx[1] = (1.0 - x[0] * x[0]) * x[1] - x[0];
    }
}

impl HybridSystem for Oscillators {
    fn n_states(&self) -> usize {
        self.0
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        for x in x.chunks_exact_mut(2) {
            x.copy_from_slice(&[2.0, 0.0]);
        }
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        right_hand_side(x, dx);
        Ok(())
    }
}

/// Minimum of 30 repetitions, because other load on the machine only increases the time.
fn best(mut f: impl FnMut()) -> f64 {
    (0..30)
        .map(|_| {
            let start = Instant::now();
            f();
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}

fn main() {
    println!(
        "{:>6} {:>10} {:>12} {:>12} {:>12}",
        "states", "rhs/run", "ns per rhs", "plain ns", "overhead ns"
    );
    for n in [2, 10, 100] {
        let mut driver = Driver::new(Options::default()).unwrap();
        let mut system = Oscillators(n);
        let mut run = || driver.run(&mut system, 0.0, 20.0, &[], &mut Ignore).unwrap().stats.right_hand_sides;
        let calls = run();
        let stepped = best(|| {
            run();
        }) / calls as f64;
        let (x, mut dx) = (vec![1.5; n], vec![0.0; n]);
        let plain = best(|| {
            for _ in 0..calls {
                right_hand_side(black_box(&x), black_box(&mut dx));
            }
        }) / calls as f64;
        let (a, b) = (1e9 * stepped, 1e9 * plain);
        println!("{n:>6} {calls:>10} {a:>12.1} {b:>12.1} {:>12.1}", a - b);
    }
}
