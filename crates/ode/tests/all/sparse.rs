//! Large systems with a known pattern: coloured differences and sparse decompositions, compared with closed
//! forms and with dense matrices.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use common::*;
use ode::*;

/// Heat on a square of `m * m` inner points with cold borders. The start is the slowest mode, which only
/// decays.
struct Heat {
    m: usize,
    pattern: Option<JacobianPattern>,
}

impl Heat {
    fn new(m: usize, sparse: bool) -> Self {
        let near = |p: usize, q: usize| {
            let ((a, b), (c, d)) = ((p / m, p % m), (q / m, q % m));
            a.abs_diff(c) + b.abs_diff(d) <= 1
        };
        let all = (0..m * m).flat_map(|p| (0..m * m).map(move |q| (p, q)));
        let pattern = sparse.then(|| JacobianPattern::new(m * m, all.filter(|(p, q)| near(*p, *q))).unwrap());
        Self { m, pattern }
    }

    fn mode(&self, p: usize) -> f64 {
        let s = |i: usize| (std::f64::consts::PI * (i + 1) as f64 / (self.m + 1) as f64).sin();
        s(p / self.m) * s(p % self.m)
    }

    fn rate(&self) -> f64 {
        let cells = (self.m + 1) as f64;
        -8.0 * cells * cells * (0.5 * std::f64::consts::PI / cells).sin().powi(2)
    }
}

impl HybridSystem for Heat {
    fn n_states(&self) -> usize {
        self.m * self.m
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.iter_mut().enumerate().for_each(|(p, x)| *x = self.mode(p));
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        let (m, scale) = (self.m, ((self.m + 1) * (self.m + 1)) as f64);
        for (p, dx) in dx.iter_mut().enumerate() {
            let (i, j) = (p / m, p % m);
            let at = |there: bool, q: usize| if there { x[q] } else { 0.0 };
            let sum = at(i > 0, p.wrapping_sub(m))
                + at(i + 1 < m, p + m)
                + at(j > 0, p.wrapping_sub(1))
                + at(j + 1 < m, p + 1);
            *dx = scale * (sum - 4.0 * x[p]);
        }
        Ok(())
    }
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        self.pattern.as_ref()
    }
}

fn solve(method: Method, heat: &mut Heat) -> (Vec<f64>, Stats) {
    let mut seen = Recorder::default();
    let options = Options { method, relative_tolerance: 1e-7, ..Options::default() };
    let report = Driver::new(options).unwrap().run(heat, 0.0, 0.1, &[0.1], &mut seen).unwrap();
    (seen.rows.remove(0).3, report.stats)
}

#[test]
fn heat_equation_matches_closed_form() {
    for method in [Method::Radau5, Method::Bdf, Method::Auto] {
        let mut heat = Heat::new(18, true);
        let (x, stats) = solve(method, &mut heat);
        let decay = (0.1 * heat.rate()).exp();
        for (p, x) in x.iter().enumerate() {
            let off = (x - decay * heat.mode(p)).abs();
            assert!(off < 2e-6, "{} at {p}: {off:e}", method.name());
        }
        // A Jacobian of 324 columns from a few differences. (For such a short time, the system is not stiff
        // for `auto`.)
        let implicit = stats.jacobians > 0 || method == Method::Auto;
        assert!(implicit && stats.right_hand_sides < 1500, "{}: {stats:?}", method.name());
    }
}

#[test]
fn sparse_and_dense_results_agree_and_are_reproducible() {
    for method in [Method::Radau5, Method::Bdf] {
        let (sparse, a) = solve(method, &mut Heat::new(12, true));
        let (dense, b) = solve(method, &mut Heat::new(12, false));
        for (s, d) in sparse.iter().zip(&dense) {
            assert!((s - d).abs() < 1e-9, "{}: {s} {d}", method.name());
        }
        assert_eq!(a.accepted_steps, b.accepted_steps, "{}", method.name());
        let elsewhere = std::thread::spawn(move || solve(method, &mut Heat::new(12, true)));
        assert_eq!(elsewhere.join().unwrap(), (sparse, a), "{}", method.name());
    }
}

/// A wave that runs along a chain: `x_i' = x_(i-1) - x_i`.
struct Chain {
    n: usize,
    pattern: JacobianPattern,
}

impl HybridSystem for Chain {
    fn n_states(&self) -> usize {
        self.n
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.fill(0.0);
        x[0] = 1.0;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx[0] = -x[0];
        x.windows(2).zip(&mut dx[1..]).for_each(|(x, dx)| *dx = x[0] - x[1]);
        Ok(())
    }
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        Some(&self.pattern)
    }
}

/// The system is not stiff, so the explicit method is as good as any other. A trial of Radau5 is cheap with
/// sparse matrices. With dense matrices, one trial costs as much as thousands of right-hand sides. x_k(t) =
/// exp(-t) t^k / k!.
#[test]
fn auto_avoids_dense_decompositions_when_pattern_is_sparse() {
    let n = 1000;
    let entries = (0..n).flat_map(|i: usize| [(i, i), (i, i.saturating_sub(1))]);
    let mut system = Chain { n, pattern: JacobianPattern::new(n, entries).unwrap() };
    let mut seen = Recorder::default();
    let report =
        Driver::new(Options::default()).unwrap().run(&mut system, 0.0, 40.0, &[40.0], &mut seen).unwrap();
    let exact = (1..=40).fold((-40f64).exp(), |x, k| x * 40.0 / f64::from(k));
    assert!((seen.rows[0].3[40] - exact).abs() < 1e-5, "{} for {exact}", seen.rows[0].3[40]);
    let stats = report.stats;
    assert!(cfg!(feature = "sparse") || (stats.decompositions, stats.jacobians) == (0, 0), "{stats:?}");
}
