//! Large sparse systems need no room that grows with the square of their size.

#![allow(clippy::unwrap_used)]

use ode::{Driver, *};

const N: usize = 10_000;

/// Where the Jacobian comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Given {
    Nothing,
    Products,
    Entries,
}

/// Heat in a rod with cold ends that starts with its slowest mode; an arrow on request: each cell also heats the first a
/// little, and is cooled by it.
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

#[test]
fn ten_thousand_states_in_a_row() {
    for given in [Given::Nothing, Given::Products] {
        for method in [Method::Radau5, Method::Bdf] {
            let mut seen = Vec::new();
            let counted = allocation_counter::measure(|| {
                let options = Options { method, relative_tolerance: 1e-6, ..Options::default() };
                let mut rod = Rod::new(given);
                let start = std::time::Instant::now();
                let r = Driver::new(options).unwrap().run(&mut rod, 0.0, 0.1, &[], &mut Ignore).unwrap();
                eprintln!("{given:?} {} {:?} {:?}", method.name(), start.elapsed(), r.stats);
                seen.push(r);
            });
            eprintln!("{counted:?}");
        }
    }
}
