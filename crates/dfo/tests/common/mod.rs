//! Test problems and small helpers.
#![allow(dead_code, unreachable_pub, clippy::unwrap_used)]

use dfo::{
    AnyMethod, Error, Lookahead, MethodOptions, Minimize, NelderMead, Outcome, Progress, Report, Simplex,
    Trace, WithQuery, minimize, with_query,
};
use std::ops::ControlFlow;

/// Returns all methods for objectives without residuals, with default options.
pub fn methods_for_costs() -> Vec<AnyMethod> {
    let all = AnyMethod::NAMES.iter().map(|name| name.parse::<AnyMethod>().unwrap());
    all.filter(|method| !method.needs_residuals()).collect()
}

pub fn rosenbrock(x: &[f64]) -> f64 {
    x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
}

/// Powell's singular function (More, Garbow, Hillstrom 1981, problem 13); minimum 0 at 0, start (3, -1, 0, 1).
pub fn powell_singular(x: &[f64]) -> f64 {
    (x[0] + 10.0 * x[1]).powi(2)
        + 5.0 * (x[2] - x[3]).powi(2)
        + (x[1] - 2.0 * x[2]).powi(4)
        + 10.0 * (x[0] - x[3]).powi(4)
}

/// Helical valley (problem 7); minimum 0 at (1, 0, 0), start (-1, 0, 0).
pub fn helical_valley(x: &[f64]) -> f64 {
    let theta = x[1].atan2(x[0]) / std::f64::consts::TAU;
    let theta = if theta < -0.25 { theta + 1.0 } else { theta };
    100.0 * ((x[2] - 10.0 * theta).powi(2) + (x[0].hypot(x[1]) - 1.0).powi(2)) + x[2] * x[2]
}

/// Rosenbrock's function with three failing regions near the path; start (-0.5, 1), box [-2, 2]^2.
pub fn probe_fails(x: &[f64]) -> bool {
    x[0] + x[1] < -0.2 || (x[0] > 0.2 && x[1] < 0.02) || x[1] > 1.6
}

pub fn probe(x: &[f64]) -> f64 {
    if probe_fails(x) { f64::NAN } else { rosenbrock(x) }
}

pub struct Problem {
    pub name: &'static str,
    pub f: fn(&[f64]) -> f64,
    pub x0: Vec<f64>,
    pub bounds: Option<(Vec<f64>, Vec<f64>)>,
}

impl Problem {
    pub fn minimize(&self) -> Minimize<'static, NelderMead> {
        self.set_up(minimize(self.f))
    }

    pub fn set_up<'a>(&self, m: Minimize<'a, NelderMead>) -> Minimize<'a, NelderMead> {
        let m = m.start(&self.x0);
        match &self.bounds {
            Some((lower, upper)) => m.bounds(lower, upper).unwrap(),
            None => m,
        }
    }
}

/// Costs with features that could break plans and cutoffs: failures, ties, plateaus and bounds.
pub fn problems() -> Vec<Problem> {
    let p = |name, f, x0: &[f64]| Problem { name, f, x0: x0.to_vec(), bounds: None };
    let b = |name, f, x0: &[f64], lo: &[f64], hi: &[f64]| Problem {
        name,
        f,
        x0: x0.to_vec(),
        bounds: Some((lo.to_vec(), hi.to_vec())),
    };
    vec![
        p("rosenbrock", rosenbrock, &[-1.2, 1.0]),
        p("rosenbrock 6", rosenbrock, &[-1.2, 1.0, -1.2, 1.0, -1.2, 1.0]),
        p("powell singular", powell_singular, &[3.0, -1.0, 0.0, 1.0]),
        p("helical valley", helical_valley, &[-1.0, 0.0, 0.0]),
        p("one parameter", |x| (x[0] - 3.0).powi(2).abs().sqrt() + 1.0, &[100.0]),
        b("active bound", rosenbrock, &[-1.2, 1.0], &[-2.0, -2.0], &[0.5, 2.0]),
        b("failing regions", probe, &[-0.5, 1.0], &[-2.0, -2.0], &[2.0, 2.0]),
        p("steps", |x| (10.0 * x[0]).floor().abs() + (10.0 * x[1]).floor().abs(), &[3.3, -2.2]),
        p(
            "checkerboard",
            |x| if (7.0 * x[0] + 5.0 * x[1]).sin() > 0.7 { f64::NAN } else { rosenbrock(x) },
            &[-1.2, 1.0],
        ),
        b("constant", |_| 4.0, &[0.0, 0.5, 1.0], &[0.0; 3], &[1.0; 3]),
        b("sharp", |x| x.iter().map(|x| (x - 0.2).abs()).sum(), &[0.9; 4], &[0.0; 4], &[1.0; 4]),
    ]
}

/// Objective that uses its cutoff as much as possible: it never returns a value above it.
pub fn cutting(f: fn(&[f64]) -> f64) -> WithQuery<impl Fn(&[f64], &dfo::Query<'_>) -> Outcome + Sync> {
    with_query(move |x: &[f64], e: &dfo::Query<'_>| {
        let v = f(x);
        if v > e.cutoff { Outcome::Above(e.cutoff) } else { Outcome::Value(v) }
    })
}

/// Runs a minimisation and records the simplex of every iteration.
pub fn run_with_path(m: Minimize<'_, NelderMead>) -> Result<(Report, Vec<Simplex>), Error> {
    let path = std::cell::RefCell::new(Vec::new());
    let report = m
        .observer(|p: &Progress<'_>| {
            path.borrow_mut().push(p.simplex.unwrap().to_owned());
            ControlFlow::Continue(())
        })
        .run()?;
    Ok((report, path.into_inner()))
}

/// Returns the part of a trace that must be the same for any number of workers: everything except times.
pub fn timeless(trace: &Trace) -> Vec<(Vec<u64>, Outcome, u64, u64, u64, bool)> {
    trace
        .iter()
        .map(|e| {
            let x = e.x.iter().map(|v| v.to_bits()).collect();
            (x, e.outcome.clone(), e.id, e.batch, e.cutoff.to_bits(), e.used)
        })
        .collect()
}

pub fn plan(plan: Lookahead) -> NelderMead {
    NelderMead::default().batch(plan)
}

pub const PLANS: [Lookahead; 4] =
    [Lookahead::None, Lookahead::Points(2), Lookahead::Points(4), Lookahead::Points(20)];

/// Hides intentional panics (their message begins with "on purpose") from the output.
pub fn quiet_panics_on_purpose() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    fn text(payload: &(dyn std::any::Any + Send)) -> &str {
        let string = payload.downcast_ref::<String>().map(String::as_str);
        string.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or_default()
    }
    ONCE.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if !text(info.payload()).starts_with("on purpose") {
                usual(info);
            }
        }));
    });
}
