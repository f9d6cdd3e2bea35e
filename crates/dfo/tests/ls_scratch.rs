#![allow(clippy::unwrap_used, dead_code)]
mod problems;
use dfo::{LeastSquares, minimize, residuals as of, Error};
use problems::{instances, residuals};
#[test]
fn bench() {
    let inst = instances();
    for tau in [1e-1, 1e-3, 1e-5, 1e-7] {
        let mut units: Vec<f64> = Vec::new();
        for p in &inst {
            let f = |x: &[f64], out: &mut Vec<f64>| out.extend(residuals(p.number, p.m, x));
            let r = minimize(of(f)).start(&p.start()).method(LeastSquares::default()).x_tol(0.0).f_tol(0.0).max_evaluations(100*(p.n+1)).run();
            let r = match r { Ok(r) => r, Err(e) => { println!("{p:?} {e}"); units.push(f64::INFINITY); continue } };
            let first = p.cost(&p.start());
            let goal = first - (1.0 - tau) * (first - p.best);
            let k = r.trace.iter().position(|e| e.outcome.value().is_some_and(|v| v <= goal));
            let u = k.map_or(f64::INFINITY, |k| (k+1) as f64/(p.n+1) as f64);
            if tau == 1e-5 && !(u <= 25.0) { println!("{:?} n={} m={} units {u:.1} fun {:e} best {:e} start {:e} {} {}", p.number, p.n, p.m, r.fun, p.best, first, r.termination, r.n_evaluations); }
            units.push(u);
        }
        let share = |c: f64| 100.0*units.iter().filter(|u| **u <= c).count() as f64/units.len() as f64;
        let s = (share(10.0), share(25.0), share(50.0), share(100.0));
        units.sort_by(f64::total_cmp);
        println!("tau {tau:e}: {:.0}/{:.0}/{:.0}/{:.0} median {:.1}", s.0, s.1, s.2, s.3, units[units.len()/2]);
    }
}
