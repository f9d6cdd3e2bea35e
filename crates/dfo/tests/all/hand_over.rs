//! Method `auto` for costs: quadratic models if the cost is smooth, Nelder-Mead if it has kinks, CMA-ES if it
//! has strong noise or steps.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;
use crate::problems;

use common::{rosenbrock, timeless};
use dfo::{
    AnyMethod, Checkpoint, CmaEs, Minimize, NelderMead, Outcome, PatternSearch, QuadraticModel, Query,
    Report, Resume, Search, Termination, minimize, with_query,
};
use problems::{instances, residuals};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

fn auto() -> AnyMethod {
    AnyMethod::auto(Search::Local)
}

/// Two kinks that cross at the minimum.
fn kinked(x: &[f64]) -> f64 {
    (x[0] - 1.0).abs() + 10.0 * (x[1] - x[0]).abs()
}

#[test]
fn auto_follows_quadratic_model_on_smooth_costs() {
    let run = |method: AnyMethod| minimize(rosenbrock).start(&[-1.2, 1.0]).method(method).run().unwrap();
    let (auto_run, model) = (run(auto()), run(QuadraticModel::default().into()));
    assert_eq!(timeless(&auto_run.trace), timeless(&model.trace));
    assert!(auto_run.is_success() && auto_run.method == "quadratic-model", "{auto_run}");
    assert!(auto_run.method_reason.unwrap().contains("Nelder-Mead if it has kinks"));
    assert!(!auto_run.message.contains("switched to"), "{}", auto_run.message);
}

#[test]
fn auto_switches_to_nelder_mead_on_kinks() {
    let run = |method: AnyMethod| minimize(kinked).start(&[-1.0, 2.0]).method(method).run().unwrap();
    let auto_run = run(auto());
    assert!(auto_run.is_success() && auto_run.fun < 1e-5, "{auto_run}");
    assert!(auto_run.message.contains("; switched to nelder-mead after "), "{}", auto_run.message);
    assert!(auto_run.final_simplex.is_some());
    let model = run(QuadraticModel::default().into());
    assert!(model.fun < 1e-5 || !model.is_success() && model.message.contains("kinks"), "{model}");
}

/// If `auto` would switch to Nelder-Mead, the model alone does not claim convergence.
#[test]
fn quadratic_model_claims_success_only_at_minimum_on_kinks() {
    let sum = |x: &[f64]| x.iter().map(|x| (x - 0.3).abs()).sum::<f64>();
    let largest = |x: &[f64]| x.iter().fold(0.0, |m: f64, x| m.max((x - 0.3).abs()));
    let chain =
        |x: &[f64]| (x[0] - 0.7).abs() + x.windows(2).map(|w| 10.0 * (w[1] - w[0]).abs()).sum::<f64>();
    let costs: [fn(&[f64]) -> f64; 3] = [sum, largest, chain];
    for (n, cost) in (2..=6).flat_map(|n| costs.map(|cost| (n, cost))) {
        for x0 in [vec![1.5; n], vec![-1.0; n], vec![0.0; n]] {
            let run = minimize(cost).start(&x0).method(QuadraticModel::default());
            let report = run.run().unwrap();
            let is_near = report.fun < 1e-3 * cost(&x0);
            assert!(
                is_near || !report.is_success() && report.message.contains("kinks"),
                "{n} {x0:?}: {report}"
            );
        }
    }
}

/// Parameters that start at zero have unknown size. The method determines the size before the model searches.
#[test]
fn auto_finds_unknown_sizes() {
    for size in [1e-12, 1e-6, 1.0, 300.0] {
        let cost = |x: &[f64]| (x[0] / size - 1.0).powi(2) + 3.0 * (x[1] / size - 2.0).powi(2);
        for method in [auto(), QuadraticModel::default().into()] {
            let report = minimize(cost).start(&[0.0, 0.0]).method(method).run().unwrap();
            assert!(report.is_success() && report.fun < 1e-12, "{size:e}: {report}");
            assert!(report.n_evaluations < 100 && !report.message.contains("switched to"), "{report}");
        }
    }
}

/// On the problems of Moré and Wild with absolute residuals, `auto` solves at most two problems fewer than
/// Nelder-Mead, with at most 1.2 times its evaluations.
#[test]
#[cfg_attr(windows, ignore = "the counts depend on the last digits of mathematical functions")]
fn auto_matches_nelder_mead_on_kinks() {
    let histories = |method: &AnyMethod, p: &problems::Instance| {
        let cost = |x: &[f64]| residuals(p.number, p.m, x).iter().map(|r| r.abs()).sum::<f64>();
        let run = minimize(cost).start(&p.start()).method(method.clone()).x_tol(0.0).f_tol(0.0);
        let report = run.max_evaluations(100 * (p.n + 1)).run().unwrap();
        let costs: Vec<f64> = report.trace.iter().filter_map(|e| e.outcome.value()).collect();
        (report.fun, costs)
    };
    let mut units = [Vec::new(), Vec::new()];
    for p in instances() {
        let runs = [auto(), NelderMead::default().into()].map(|method| histories(&method, &p));
        let best = runs[0].0.min(runs[1].0);
        let goal = best + 1e-2 * (runs[0].1[0] - best);
        for (units, (_, costs)) in units.iter_mut().zip(runs) {
            let place = costs.iter().position(|cost| *cost <= goal);
            units.push(place.map_or(f64::INFINITY, |place| (place + 1) as f64 / (p.n + 1) as f64));
        }
    }
    let [(n_auto, median), (simplex, other)] = units.map(|mut units| {
        units.sort_by(f64::total_cmp);
        (units.iter().filter(|u| u.is_finite()).count(), units[units.len() / 2])
    });
    println!("auto {n_auto} of 53, median {median:.1} (n + 1); nelder-mead {simplex}, {other:.1}");
    assert!(n_auto + 2 >= simplex && median <= 1.2 * other, "{n_auto} {median} {simplex} {other}");
}

/// A number in (-1, 1) that depends on all bits of the point (Steele, Lea and Flood, OOPSLA 2014: SplitMix64).
fn noise(x: &[f64]) -> f64 {
    let mixed = |mut z: u64| {
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    let bits = x.iter().fold(1, |h, v| mixed(h ^ v.to_bits()).wrapping_add(0x9e37_79b9_7f4a_7c15));
    (mixed(bits) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// The problems of Moré and Wild with noise of 10 % of the range of the cost, or rounded to steps of 1 % of
/// it. A problem is solved if the cost without noise at the result is within a tenth of the range, or two
/// steps, of the minimum.
#[test]
fn auto_solves_nearly_as_many_problems_as_cma_es_with_strong_noise_or_steps() {
    for (level, is_noise, tau) in [(0.1, true, 0.1), (0.01, false, 0.02)] {
        let solved = |method: AnyMethod| {
            let is_solved = |p: &problems::Instance| {
                let range = p.cost(&p.start()) - p.best;
                let seen = |x: &[f64]| match is_noise {
                    true => p.cost(x) + 3f64.sqrt() * level * range * noise(x),
                    false => (p.cost(x) / (level * range)).round() * level * range,
                };
                let run = minimize(seen).start(&p.start()).method(method.clone()).seed(1);
                let report = run.x_tol(0.0).f_tol(0.0).max_evaluations(100 * (p.n + 1)).run().unwrap();
                p.cost(&report.x) <= p.best + tau * range
            };
            instances().iter().filter(|p| is_solved(p)).count()
        };
        let own = solved(auto());
        let [simplex, polls, population] =
            [NelderMead::default().into(), PatternSearch::default().into(), CmaEs::default().into()]
                .map(solved);
        println!(
            "level {level}: auto {own}, nelder-mead {simplex}, pattern-search {polls}, cma-es {population}"
        );
        assert!(
            own >= simplex.max(polls) + 5 && own + 5 >= population,
            "{own} {simplex} {polls} {population}"
        );
    }
}

fn noisy(x: &[f64]) -> f64 {
    x.iter().map(|x| (x - 1.0).powi(2)).sum::<f64>() + noise(x)
}

/// A run that is aborted after `limit` evaluations.
fn set_up(cost: fn(&[f64]) -> f64, limit: usize) -> Minimize<'static, AnyMethod> {
    let calls = AtomicUsize::new(0);
    let cost = move |x: &[f64], _: &Query<'_>| match calls.fetch_add(1, Ordering::Relaxed) {
        k if k >= limit => Outcome::Abort("stopped".to_owned()),
        _ => Outcome::Value(cost(x)),
    };
    minimize(with_query(cost)).start(&[-1.0, 2.0]).method(auto()).seed(5).max_evaluations(150)
}

fn same(a: &Report, b: &Report) {
    assert!(timeless(&a.trace) == timeless(&b.trace));
    assert_eq!((&a.x, a.fun.to_bits(), &a.message), (&b.x, b.fun.to_bits(), &b.message));
}

#[test]
fn result_is_independent_of_workers_and_interruptions() {
    for (cost, second) in [(kinked as fn(&[f64]) -> f64, "nelder-mead"), (noisy, "cma-es")] {
        let whole = set_up(cost, usize::MAX).run().unwrap();
        assert!(whole.message.contains(&format!("switched to {second} after ")), "{}", whole.message);
        for workers in [2, 5] {
            same(&set_up(cost, usize::MAX).workers(workers).run().unwrap(), &whole);
        }
        let folder = tempfile::tempdir().unwrap();
        for limit in (1..150).step_by(7) {
            let file = folder.path().join(format!("{limit}"));
            let checkpoint = || Checkpoint::new(&file).interval(Duration::ZERO);
            let stopped = set_up(cost, limit).checkpoint(checkpoint()).run().unwrap();
            assert_eq!(stopped.termination, Termination::Aborted("stopped".to_owned()));
            let run =
                set_up(cost, usize::MAX).checkpoint(checkpoint().resume(Resume::Require)).run().unwrap();
            same(&run, &whole);
        }
    }
}
