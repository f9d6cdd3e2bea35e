//! What ask and tell cost per evaluation at ten parameters, the objective left out: the bar is 5 microseconds; for least squares on
//! m residuals 20 microseconds and 1 ns m n^2. And
//! what two workers gain for differential evolution with an objective of 5 ms: the bar is 1.9 times.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use dfo::{
    Answers, Barrier, Batch, BatchPlan, Bounds, DifferentialEvolution, Genetic, LeastSquares, Method,
    MethodOptions, NelderMead, Outcome, Setup, Space, Status, minimize,
};
use std::time::{Duration, Instant};

const N: usize = 10;

fn rosenbrock(x: &[f64]) -> f64 {
    x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
}

/// Rosenbrock's function alone, or `m` residuals that are not linear.
fn answer(x: &[f64], m: usize, residuals: &mut Vec<f64>) -> Outcome {
    residuals.clear();
    if m == 0 {
        return Outcome::Value(rosenbrock(x));
    }
    let terms =
        |i: usize| x.iter().enumerate().map(move |(j, x)| ((i * N + j) as f64 * 0.7).sin() * (x + x * x));
    residuals.extend((0..m).map(|i| terms(i).sum::<f64>() - 1.0));
    Outcome::Value(residuals.iter().map(|r| r * r).sum())
}

/// Microseconds per evaluation spent in ask and tell, over so many evaluations, on `m` residuals or on costs alone.
fn overhead<M: MethodOptions>(options: &M, evaluations: usize, m: usize) -> f64 {
    let mut residuals = Vec::new();
    let (mut spent, mut count) = (Duration::ZERO, 0);
    let mut seed = 0;
    let mut batch = Batch::new();
    let mut answers = Answers::default();
    while count < evaluations {
        let bounds = Bounds::new(&[-5.0; N], &[5.0; N]).unwrap();
        let mut setup = Setup::new(Space::new(&[-1.2; N], bounds, &[], &[]).unwrap());
        setup.seed = Some(seed);
        setup.max_evaluations = Some(20_000);
        seed += 1;
        let mut method = options.begin(&setup).unwrap();
        let begun = count;
        loop {
            let start = Instant::now();
            method.ask(&mut batch);
            spent += start.elapsed();
            if (batch.is_empty() && method.status() != Status::Running) || count - begun >= 20_000 {
                break;
            }
            answers.clear();
            for x in batch.points() {
                let outcome = answer(x, m, &mut residuals);
                answers.push(outcome, &residuals);
            }
            count += batch.len();
            let start = Instant::now();
            method.tell(&answers).unwrap();
            spent += start.elapsed();
        }
    }
    spent.as_secs_f64() * 1e6 / count as f64
}

/// Microseconds per evaluation of a whole driven run, the objective included.
fn driven<M: MethodOptions>(options: M) -> f64 {
    let start = Instant::now();
    let report = minimize(rosenbrock)
        .start(&[-1.2; N])
        .bounds(&[-5.0; N], &[5.0; N])
        .unwrap()
        .method(options)
        .seed(1)
        .max_evaluations(20_000)
        .run()
        .unwrap();
    start.elapsed().as_secs_f64() * 1e6 / report.n_evaluations as f64
}

fn seconds(workers: usize) -> f64 {
    let slow = |x: &[f64]| {
        std::thread::sleep(Duration::from_millis(5));
        rosenbrock(x)
    };
    let start = Instant::now();
    minimize(slow)
        .bounds(&[-2.0; 2], &[2.0; 2])
        .unwrap()
        .method(DifferentialEvolution::classic().population(20))
        .seed(1)
        .workers(workers)
        .max_evaluations(200)
        .run()
        .unwrap();
    start.elapsed().as_secs_f64()
}

fn main() {
    const COUNT: usize = 200_000;
    println!("microseconds per evaluation, n = {N}: ask + tell, whole driven run");
    let line = |name: &str, asked: f64, whole: f64| println!("{name:28} {asked:8.3} {whole:8.3}");
    for plan in
        [BatchPlan::Serial, BatchPlan::Two, BatchPlan::Four, BatchPlan::TwoAhead, BatchPlan::LeeWiswall]
    {
        let options = NelderMead::default().batch(plan);
        line(&format!("nelder-mead {}", plan.name()), overhead(&options, COUNT, 0), driven(options));
    }
    line("barrier", overhead(&Barrier::default(), COUNT, 0), driven(Barrier::default()));
    let (lshade, classic) = (DifferentialEvolution::default(), DifferentialEvolution::classic());
    line("de (L-SHADE)", overhead(&lshade, COUNT, 0), driven(lshade));
    line("de-classic", overhead(&classic, COUNT, 0), driven(classic));
    line("ga", overhead(&Genetic::default(), COUNT, 0), driven(Genetic::default()));
    for m in [20, 800] {
        let asked = overhead(&LeastSquares::default(), COUNT / 20, m);
        let bar = 20.0 + 1e-3 * (m * N * N) as f64;
        println!("{:28} {asked:8.3}          (at most {bar:.0})", format!("least-squares, m = {m}"));
    }
    let (one, two) = (seconds(1), seconds(2));
    println!(
        "de-classic, population 20, 5 ms: {one:.2} s alone, {two:.2} s with two workers: {:.2} times",
        one / two
    );
}
