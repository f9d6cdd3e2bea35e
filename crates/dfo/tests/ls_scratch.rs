#![allow(clippy::unwrap_used, dead_code)]
mod problems;
use dfo::{Error, LeastSquares, minimize, residuals as of};
use problems::{instances, residuals};
#[test]
fn bench() {
    let inst = instances();
    for tau in [1e-1, 1e-3, 1e-5, 1e-7] {
        let mut units: Vec<f64> = Vec::new();
        for p in &inst {
            let f = |x: &[f64], out: &mut Vec<f64>| out.extend(residuals(p.number, p.m, x));
            let r = minimize(of(f))
                .start(&p.start())
                .method(LeastSquares::default())
                .x_tol(0.0)
                .f_tol(0.0)
                .max_evaluations(100 * (p.n + 1))
                .run();
            let r = match r {
                Ok(r) => r,
                Err(e) => {
                    println!("{p:?} {e}");
                    units.push(f64::INFINITY);
                    continue;
                }
            };
            let first = p.cost(&p.start());
            let goal = first - (1.0 - tau) * (first - p.best);
            let k = r.trace.iter().position(|e| e.outcome.value().is_some_and(|v| v <= goal));
            let u = k.map_or(f64::INFINITY, |k| (k + 1) as f64 / (p.n + 1) as f64);
            if tau == 1e-5 && !(u <= 25.0) {
                println!(
                    "{:?} n={} m={} units {u:.1} fun {:e} best {:e} start {:e} {} {}",
                    p.number, p.n, p.m, r.fun, p.best, first, r.termination, r.n_evaluations
                );
            }
            units.push(u);
        }
        let share = |c: f64| 100.0 * units.iter().filter(|u| **u <= c).count() as f64 / units.len() as f64;
        let s = (share(10.0), share(25.0), share(50.0), share(100.0));
        units.sort_by(f64::total_cmp);
        println!(
            "tau {tau:e}: {:.0}/{:.0}/{:.0}/{:.0} median {:.1}",
            s.0,
            s.1,
            s.2,
            s.3,
            units[units.len() / 2]
        );
    }
}

#[test]
fn cal() {
    let mut units = Vec::new();
    let mut own = Vec::new();
    let mut bad = 0;
    for fit in problems::calibration::fits() {
        for (k, start) in fit.starts().iter().enumerate() {
            for bounded in [false, true] {
                let f = |x: &[f64], out: &mut Vec<f64>| out.extend(fit.residuals(x));
                let n = start.len();
                let lo: Vec<f64> =
                    fit.truth.iter().map(|t| if *t > 0.0 { t * 0.2 } else { t * 3.0 }).collect();
                let hi: Vec<f64> =
                    fit.truth.iter().map(|t| if *t > 0.0 { t * 3.0 } else { t * 0.2 }).collect();
                let mut m = minimize(of(f))
                    .start(start)
                    .method(LeastSquares::default())
                    .max_evaluations(200 * (n + 1));
                if bounded {
                    m = m.bounds(&lo, &hi).unwrap();
                }
                let r = m.run();
                let r = match r {
                    Ok(r) => r,
                    Err(e) => {
                        println!("{} {k} {bounded} {e}", fit.name);
                        units.push(f64::INFINITY);
                        bad += 1;
                        continue;
                    }
                };
                let first = fit.cost(start);
                let goal = 1e-5 * first;
                let p = r.trace.iter().position(|e| e.outcome.value().is_some_and(|v| v <= goal));
                let u = p.map_or(f64::INFINITY, |p| (p + 1) as f64 / (n + 1) as f64);
                if !u.is_finite() || !r.is_success() {
                    println!(
                        "{} start {k} box {bounded} n={n}: units {u:.1} fun {:e} first {first:e} {} nfev {} {:?} truth {:?}",
                        fit.name, r.fun, r.termination, r.n_evaluations, r.x, fit.truth
                    );
                }
                units.push(u);
                own.push(r.n_evaluations as f64 / (n + 1) as f64);
            }
        }
    }
    let solved = units.iter().filter(|u| u.is_finite()).count();
    let len = units.len();
    units.sort_by(f64::total_cmp);
    own.sort_by(f64::total_cmp);
    println!(
        "fits solved {solved} of {len}, median {:.1}; to its own stop median {:.1} max {:.1}; errors {bad}",
        units[len / 2],
        own[own.len() / 2],
        own[own.len() - 1]
    );
}

fn hash(x: &[f64], i: usize, seed: u64) -> f64 {
    // A standard normal from the bits: noise that is a function of the point and the seed.
    let mut h = 0xcbf29ce484222325u64 ^ seed.wrapping_mul(0x9E3779B97F4A7C15);
    for v in x {
        h = (h ^ v.to_bits()).wrapping_mul(0x100000001b3);
        h ^= h >> 29;
    }
    h = (h ^ i as u64).wrapping_mul(0x9E3779B97F4A7C15);
    let mut z = 0.0;
    for _ in 0..12 {
        h ^= h >> 30;
        h = h.wrapping_mul(0xBF58476D1CE4E5B9);
        h ^= h >> 27;
        h = h.wrapping_mul(0x94D049BB133111EB);
        h ^= h >> 31;
        h = h.wrapping_add(0x9E3779B97F4A7C15);
        z += (h >> 11) as f64 / (1u64 << 53) as f64;
    }
    z - 6.0
}
#[test]
fn noise() {
    let inst = instances();
    for (tau, tol) in [(1e-3, 0.0), (1e-5, 0.0), (1e-5, 1e-6)] {
        let mut units: Vec<f64> = Vec::new();
        for seed in 0..5 {
            for p in &inst {
                let f = |x: &[f64], out: &mut Vec<f64>| {
                    let r = residuals(p.number, p.m, x);
                    out.extend(r.iter().enumerate().map(|(i, r)| r * (1.0 + 1e-3 * hash(x, i, seed))));
                };
                let r = minimize(of(f))
                    .start(&p.start())
                    .method(LeastSquares::default())
                    .x_tol(tol)
                    .f_tol(tol)
                    .max_evaluations(100 * (p.n + 1))
                    .run();
                let r = match r {
                    Ok(r) => r,
                    Err(e) => {
                        println!("{p:?} {e}");
                        units.push(f64::INFINITY);
                        continue;
                    }
                };
                let first = p.cost(&p.start());
                let goal = first - (1.0 - tau) * (first - p.best);
                let k = r.trace.iter().position(|e| e.outcome.value().is_some() && p.cost(e.x) <= goal);
                let u = k.map_or(f64::INFINITY, |k| (k + 1) as f64 / (p.n + 1) as f64);
                if tau == 1e-5 && seed == 0 && tol == 0.0 && !(u <= 100.0) {
                    println!(
                        "{:?} n={} m={} units {u:.1} fun {:e} best {:e} start {:e} {} {}",
                        p.number, p.n, p.m, r.fun, p.best, first, r.termination, r.n_evaluations
                    );
                }
                units.push(u);
            }
        }
        let share = |c: f64| 100.0 * units.iter().filter(|u| **u <= c).count() as f64 / units.len() as f64;
        let s = (share(10.0), share(25.0), share(50.0), share(100.0));
        units.sort_by(f64::total_cmp);
        println!(
            "noise tau {tau:e} tol {tol:e}: {:.0}/{:.0}/{:.0}/{:.0} median {:.1}",
            s.0,
            s.1,
            s.2,
            s.3,
            units[units.len() / 2]
        );
    }
}

#[test]
fn rounds() {
    let inst = instances();
    for tau in [1e-1, 1e-3, 1e-5] {
        let mut units: Vec<f64> = Vec::new();
        let mut evals: Vec<f64> = Vec::new();
        for p in &inst {
            let f = |x: &[f64], out: &mut Vec<f64>| out.extend(residuals(p.number, p.m, x));
            let r = minimize(of(f))
                .start(&p.start())
                .method(LeastSquares::default().batch(p.n + 4))
                .x_tol(0.0)
                .f_tol(0.0)
                .max_evaluations(100 * (p.n + 1))
                .run();
            let Ok(r) = r else {
                println!("{p:?} {r:?}");
                units.push(f64::INFINITY);
                continue;
            };
            let first = p.cost(&p.start());
            let goal = first - (1.0 - tau) * (first - p.best);
            let e = r.trace.iter().enumerate().find(|(_, e)| e.outcome.value().is_some_and(|v| v <= goal));
            let u = e.map_or(f64::INFINITY, |(_, e)| (e.batch + 1) as f64);
            let v = e.map_or(f64::INFINITY, |(k, _)| (k + 1) as f64 / (p.n + 1) as f64);
            if tau == 1e-5 && !(u <= 25.0) {
                println!(
                    "{:?} n={} m={} rounds {u:.1} fun {:e} best {:e} start {:e} {} {}",
                    p.number, p.n, p.m, r.fun, p.best, first, r.termination, r.n_evaluations
                );
            }
            units.push(u);
            evals.push(v);
        }
        let share = |c: f64| 100.0 * units.iter().filter(|u| **u <= c).count() as f64 / units.len() as f64;
        let s = (share(10.0), share(25.0), share(50.0), share(1e9));
        units.sort_by(f64::total_cmp);
        evals.sort_by(f64::total_cmp);
        println!(
            "rounds tau {tau:e}: {:.0}/{:.0}/{:.0}/{:.0} median {:.1} evals {:.1}",
            s.0,
            s.1,
            s.2,
            s.3,
            units[units.len() / 2],
            evals[evals.len() / 2]
        );
    }
}
#[test]
fn one() {
    for p in instances().iter().filter(|p| [14, 19, 18].contains(&p.number)) {
        println!("### {} n={} best {:e}", p.number, p.n, p.best);
        let seed = 0;
        let f = |x: &[f64], out: &mut Vec<f64>| {
            let r = residuals(p.number, p.m, x);
            out.extend(r.iter().enumerate().map(|(i, r)| r * (1.0 + 1e-3 * hash(x, i, seed))));
        };
        let r = minimize(of(f))
            .start(&p.start())
            .method(LeastSquares::default())
            .x_tol(0.0)
            .f_tol(0.0)
            .max_evaluations(30 * (p.n + 1))
            .run()
            .unwrap();
        let first = p.cost(&p.start());
        for (k, e) in r.trace.iter().enumerate() {
            println!(
                "{k} {:e} rel excess {:.2e} x {:?}",
                e.outcome.value().unwrap_or(f64::NAN),
                (p.cost(e.x) - p.best) / (first - p.best),
                &e.x[..2]
            );
        }
    }
}
