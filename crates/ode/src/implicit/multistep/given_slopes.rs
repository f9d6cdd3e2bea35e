//! A system with given slopes or with a given state: the residual as a function of the other argument.

use crate::sparsity::JacobianPattern;
use crate::system::{Argument, CallError, CallResult, EventOutcome, HybridSystem};

/// Form of the equations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Kind {
    #[default]
    Identity,
    Mass,
    Residual,
}

/// The system `M x' = f(t, x)` or `F(t, x, x') = 0` with given slopes. Its right-hand side is the residual,
/// `f(t, x) - M x'` or `-F(t, x, x')`.
pub(super) struct AtSlopes<'a> {
    pub(super) system: &'a mut dyn HybridSystem,
    pub(super) kind: Kind,
    pub(super) mass: &'a [f64],
    pub(super) slopes: &'a [f64],
}

impl HybridSystem for AtSlopes<'_> {
    fn n_states(&self) -> usize {
        self.system.n_states()
    }
    fn start(&mut self, _: f64, _: &mut [f64]) -> CallResult<EventOutcome> {
        Err(CallError::Discard)
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        match self.kind {
            Kind::Identity => return self.system.derivatives(t, x, dx),
            Kind::Mass => {
                self.system.derivatives(t, x, dx)?;
                for (column, v) in self.mass.chunks_exact(x.len()).zip(self.slopes) {
                    dx.iter_mut().zip(column).for_each(|(d, m)| *d -= m * v);
                }
            }
            Kind::Residual => {
                self.system.residual(t, x, self.slopes, dx)?;
                dx.iter_mut().for_each(|d| *d = -*d);
            }
        }
        if dx.iter().all(|d| d.is_finite()) { Ok(()) } else { Err(CallError::Discard) }
    }
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        self.system.jacobian_pattern()
    }
    fn jacobian_entries(&mut self, t: f64, x: &[f64], entries: &mut [f64]) -> CallResult<bool> {
        Ok(self.kind != Kind::Residual && self.system.jacobian_entries(t, x, entries)?)
    }
    fn jacobian(&mut self, t: f64, x: &[f64], j: &mut [f64]) -> CallResult<bool> {
        if self.kind != Kind::Residual {
            return self.system.jacobian(t, x, j);
        }
        let is_available = self.system.residual_jacobian(t, x, self.slopes, Argument::States, j)?;
        j.iter_mut().for_each(|v| *v = -*v);
        Ok(is_available)
    }
    fn directional_derivative(
        &mut self,
        t: f64,
        x: &[f64],
        seed: &[f64],
        derivative: &mut [f64],
    ) -> CallResult<bool> {
        match self.kind {
            Kind::Residual => Ok(false),
            _ => self.system.directional_derivative(t, x, seed, derivative),
        }
    }
}

/// The residual as a function of the slopes at a given state.
pub(super) struct AtState<'a> {
    pub(super) system: &'a mut dyn HybridSystem,
    pub(super) x: &'a [f64],
}

impl HybridSystem for AtState<'_> {
    fn n_states(&self) -> usize {
        self.system.n_states()
    }
    fn start(&mut self, _: f64, _: &mut [f64]) -> CallResult<EventOutcome> {
        Err(CallError::Discard)
    }
    fn derivatives(&mut self, t: f64, slopes: &[f64], r: &mut [f64]) -> CallResult<()> {
        self.system.residual(t, self.x, slopes, r)
    }
    fn jacobian(&mut self, t: f64, slopes: &[f64], j: &mut [f64]) -> CallResult<bool> {
        self.system.residual_jacobian(t, self.x, slopes, Argument::Slopes, j)
    }
}
