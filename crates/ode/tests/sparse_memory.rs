//! The memory for large sparse systems does not grow with the square of their size.

#![allow(clippy::unwrap_used)]

use ode::{Driver, *};
use std::ops::ControlFlow;

const N: usize = 10_000;

/// Source of the Jacobian.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Given {
    Nothing,
    Products,
    Entries,
}

/// Heat in a rod with cold ends. The start is its slowest mode.
struct Rod {
    pattern: JacobianPattern,
    given: Given,
}

impl Rod {
    fn new(given: Given) -> Self {
        let places = (0..N).flat_map(|k| (k.saturating_sub(1)..(k + 2).min(N)).map(move |i| (i, k)));
        Self { pattern: JacobianPattern::new(N, places).unwrap(), given }
    }
}

fn product(x: &[f64], dx: &mut [f64]) {
    for (i, dx) in dx.iter_mut().enumerate() {
        let at = |i: usize| x.get(i).copied().unwrap_or(0.0);
        *dx = 1e8 * (at(i.wrapping_sub(1)) + at(i + 1) - 2.0 * x[i]);
    }
}

fn mode(i: usize) -> f64 {
    (std::f64::consts::PI * (i + 1) as f64 / (N + 1) as f64).sin()
}

impl HybridSystem for Rod {
    fn n_states(&self) -> usize {
        N
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.iter_mut().enumerate().for_each(|(i, x)| *x = mode(i));
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, _: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        product(x, dx);
        Ok(())
    }
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        Some(&self.pattern)
    }
    fn jacobian_entries(&mut self, _: f64, _: &[f64], entries: &mut [f64]) -> CallResult<bool> {
        assert_eq!(entries.len(), 3 * N - 2);
        // The first column has the rows 0 and 1; the next ones have the rows above, on and below the
        // diagonal.
        for (p, entry) in entries.iter_mut().enumerate() {
            *entry = if p.is_multiple_of(3) { -2e8 } else { 1e8 };
        }
        Ok(self.given == Given::Entries)
    }
    fn directional_derivative(
        &mut self,
        _: f64,
        _: &[f64],
        seed: &[f64],
        derivative: &mut [f64],
    ) -> CallResult<bool> {
        product(seed, derivative);
        Ok(self.given == Given::Products)
    }
}

struct Last(Vec<f64>);

impl Observer for Last {
    fn sample(&mut self, s: &Sample<'_>) -> ControlFlow<()> {
        self.0.extend_from_slice(s.states);
        ControlFlow::Continue(())
    }
}

/// A matrix of `N * N` numbers would need 800 MB, and even a matrix of bits would need 12.5 MB.
#[test]
fn sparse_run_of_ten_thousand_states_uses_few_megabytes() {
    let rate = -4e8 * (0.5 * std::f64::consts::PI / (N + 1) as f64).sin().powi(2);
    for method in [Method::Radau5, Method::Bdf] {
        let mut ends = Vec::new();
        for given in [Given::Nothing, Given::Products, Given::Entries] {
            let (mut seen, mut stats) = (Last(Vec::with_capacity(N)), Stats::default());
            let counted = allocation_counter::measure(|| {
                let options = Options { method, relative_tolerance: 1e-6, ..Options::default() };
                let mut driver = Driver::new(options).unwrap();
                stats = driver.run(&mut Rod::new(given), 0.0, 0.1, &[0.1], &mut seen).unwrap().stats;
            });
            let what = format!("{given:?} {} {stats:?} {counted:?}", method.name());
            assert!(counted.bytes_max < 20_000_000, "{what}");
            let off = |(i, x): (usize, &f64)| (x - (0.1 * rate).exp() * mode(i)).abs();
            let off = seen.0.iter().enumerate().map(off).fold(0.0, f64::max);
            assert!(seen.0.len() == N && off < 1e-5, "{off:e}: {what}");
            // Three groups of columns.
            let products = if given == Given::Products { 3 * stats.jacobians } else { 0 };
            assert!(stats.jacobians > 0 && stats.directional_derivatives == products, "{what}");
            ends.push(stats.right_hand_sides);
        }
        assert!(ends[0] >= ends[2] + 3 && ends[1] == ends[2], "{ends:?}");
    }
}

/// Each column has one separate entry and one in the last row, so no two columns share a group.
#[test]
fn colouring_avoids_quadratic_memory() {
    let counted = allocation_counter::measure(|| {
        let arrow = (0..N).flat_map(|k| [(k, k), (N - 1, k)]);
        assert_eq!(JacobianPattern::new(N, arrow).unwrap().n_colours(), N);
    });
    assert!(counted.bytes_max < 10_000_000, "{counted:?}");
}
