//! Cost of ask and tell per evaluation at ten parameters, without the objective. Requirement: 5 microseconds,
//! and for least squares with m residuals 20 microseconds plus 1 ns m n^2. Also measures the speed-up of two
//! workers for differential evolution with an objective of 5 ms; requirement: 1.9. `-- many`: the same
//! measurements with many parameters. `-- solved`: their cost until termination.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use dfo::{
    Answers, Barrier, Batch, Bounds, CmaEs, DifferentialEvolution, Genetic, LeastSquares, Lookahead, Method,
    MethodOptions, NelderMead, Outcome, PatternSearch, QuadraticModel, Setup, Space, Status, minimize,
};
use std::time::{Duration, Instant};

const N: usize = 10;

fn rosenbrock(x: &[f64]) -> f64 {
    x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
}

/// Rosenbrock's function alone, or `m` nonlinear residuals.
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

/// Microseconds per evaluation spent in ask and tell, averaged over `evaluations`, with `m` residuals or with
/// costs only.
fn overhead<M: MethodOptions>(options: &M, evaluations: usize, m: usize) -> f64 {
    overhead_of(options, evaluations, (N, m))
}

/// Microseconds per evaluation spent in ask and tell, at `n` parameters.
fn overhead_of<M: MethodOptions>(options: &M, evaluations: usize, (n, m): (usize, usize)) -> f64 {
    let mut residuals = Vec::new();
    let (mut spent, mut count) = (Duration::ZERO, 0);
    let mut seed = 0;
    let mut batch = Batch::new();
    let mut answers = Answers::default();
    while count < evaluations {
        let bounds = Bounds::new(&vec![-5.0; n], &vec![5.0; n]).unwrap();
        let mut setup = Setup::new(Space::new(&vec![-1.2; n], bounds, &[], &[]).unwrap());
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

/// Microseconds per evaluation of a whole run, including the objective.
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

/// Milliseconds of a loop over a matrix of n by n numbers.
fn plain_loop(n: usize) -> f64 {
    let (matrix, x) = (vec![0.5; n * n], vec![0.25; n]);
    let start = Instant::now();
    for _ in 0..20 {
        let rows = std::hint::black_box(&matrix).chunks_exact(n);
        std::hint::black_box(
            rows.map(|row| row.iter().zip(&x).map(|(a, b)| a * b).sum::<f64>()).sum::<f64>(),
        );
    }
    start.elapsed().as_secs_f64() * 1e3 / 20.0
}

/// Measures the cost with many parameters. Requirement: at most twice the time of a loop over a matrix, whose size
/// is the number of parameters or of interpolation conditions of a model.
fn many_parameters() {
    for n in [200, 500, 1000] {
        let evaluations = if n == 1000 { 3000 } else { 6000 };
        let spent = |ms: f64| format!("{:8.3} ms per evaluation, a loop {:8.3} ms", ms * 1e-3, plain_loop(n));
        println!("cma-es, n = {n:4} {}", spent(overhead_of(&CmaEs::default(), evaluations, (n, 0))));
        let shade = DifferentialEvolution::default();
        println!("de,     n = {n:4} {}", spent(overhead_of(&shade, 20_000, (n, 0))));
    }
    for n in [50, 100, 200] {
        let model = overhead_of(&QuadraticModel::default(), 7 * n, (n, 0)) * 1e-3;
        println!(
            "quadratic-model, n = {n:3} {model:8.3} ms per evaluation, a loop {:8.3} ms",
            plain_loop(3 * n + 2)
        );
    }
}

/// Large problems until termination: evaluations in units of n, cost, seconds.
fn solved() {
    let ellipsoid = |x: &[f64]| -> f64 {
        let n = x.len() as f64;
        x.iter().enumerate().map(|(k, x)| 1e3f64.powf(k as f64 / (n - 1.0)) * (x - 1.0).powi(2)).sum()
    };
    let quadratic = |x: &[f64]| -> f64 {
        // Convex, with coupled neighbours.
        x.iter().enumerate().map(|(k, x)| (1.0 + (k % 7) as f64) * (x - 1.0).powi(2)).sum::<f64>()
            + x.windows(2).map(|w| (w[0] - 2.0 * w[1] + 1.0).powi(2)).sum::<f64>()
    };
    // Toint's function, as in Powell's reports.
    let chrosen = |x: &[f64]| -> f64 {
        x.windows(2).map(|w| 4.0 * (w[0] - w[1] * w[1]).powi(2) + (1.0 - w[1]).powi(2)).sum()
    };
    let show = |what: &str, n: usize, report: &dfo::Report, start: Instant| {
        let units = report.n_evaluations as f64 / n as f64;
        let seconds = start.elapsed().as_secs_f64();
        println!(
            "{what:32} n = {n:4} {units:7.1} n evaluations, cost {:9.2e}, {seconds:6.1} s: {}",
            report.fun, report.termination
        );
    };
    for n in [50, 100, 200] {
        for (name, f) in
            [("quadratic", &quadratic as &(dyn Fn(&[f64]) -> f64 + Sync)), ("chained Rosenbrock", &chrosen)]
        {
            let start = Instant::now();
            let report = minimize(f).start(&vec![-1.0; n]).method(QuadraticModel::default()).target(1e-8);
            show(
                &format!("quadratic-model, {name}"),
                n,
                &report.max_evaluations(200 * n).run().unwrap(),
                start,
            );
        }
    }
    for n in [200, 1000] {
        for (name, f) in [
            (
                "sphere",
                &(|x: &[f64]| x.iter().map(|x| x * x).sum::<f64>()) as &(dyn Fn(&[f64]) -> f64 + Sync),
            ),
            ("ellipsoid 1e3", &ellipsoid),
        ] {
            let start = Instant::now();
            let report = minimize(f).start(&vec![3.0; n]).method(CmaEs::default()).seed(1).target(1e-8);
            show(&format!("cma-es, {name}"), n, &report.max_evaluations(400 * n).run().unwrap(), start);
        }
    }
}

fn main() {
    if std::env::args().any(|word| word == "solved") {
        return solved();
    }
    if std::env::args().any(|word| word == "many") {
        return many_parameters();
    }
    const COUNT: usize = 200_000;
    println!("microseconds per evaluation, n = {N}: ask + tell, whole driven run");
    let line = |name: &str, requested: f64, whole: f64| println!("{name:28} {requested:8.3} {whole:8.3}");
    for plan in [Lookahead::None, Lookahead::Points(2), Lookahead::Points(4), Lookahead::Points(20)] {
        let options = NelderMead::default().batch(plan);
        line(&format!("nelder-mead {}", plan.name()), overhead(&options, COUNT, 0), driven(options));
    }
    line("barrier", overhead(&Barrier::default(), COUNT, 0), driven(Barrier::default()));
    let (lshade, classic) = (DifferentialEvolution::default(), DifferentialEvolution::classic());
    line("de (L-SHADE)", overhead(&lshade, COUNT, 0), driven(lshade));
    line("de-classic", overhead(&classic, COUNT, 0), driven(classic));
    line("ga", overhead(&Genetic::default(), COUNT, 0), driven(Genetic::default()));
    for m in [20, 800] {
        let requested = overhead(&LeastSquares::default(), COUNT / 20, m);
        let bar = 20.0 + 1e-3 * (m * N * N) as f64;
        println!("{:28} {requested:8.3}          (at most {bar:.0})", format!("least-squares, m = {m}"));
    }
    for population in [10, 100, 1000, 10_000] {
        let options = CmaEs::default().population(population);
        line(&format!("cma-es, {population} individuals"), overhead(&options, COUNT, 0), driven(options));
    }
    let serial = PatternSearch::default().batch(Lookahead::None);
    line("pattern-search", overhead(&serial, COUNT, 0), driven(serial));
    for n in [2, 5, N, 20, 50] {
        let requested = overhead_of(&QuadraticModel::default(), 20_000 / n, (n, 0));
        println!("quadratic-model, n = {n:2}          {requested:8.1}");
    }
    let (one, two) = (seconds(1), seconds(2));
    println!(
        "de-classic, population 20, 5 ms: {one:.2} s alone, {two:.2} s with two workers: {:.2} times",
        one / two
    );
}
