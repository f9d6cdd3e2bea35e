//! Search for the reasons of a failed run: values that are not finite, or a system of a higher index.

use super::run::{Exit, Run, Space, no_retreat};
use crate::error::{ErrorKind, Evaluated, NotFinite};
use crate::stepper::Equations;
use crate::system::CallError;

/// Number of points examined ahead of a refused step. Each is four times as far as the one before, like the
/// successive reductions of a refused step.
const POINTS_AHEAD: u32 = 14;

/// Maximum number of states for which the model's own Jacobian is examined, because it requires a dense
/// matrix.
const LARGEST_JACOBIAN: usize = 1000;

impl Run<'_> {
    /// Handles a refusal of the current point: finds a value there that is not finite, if any.
    pub(super) fn refused_here(&mut self, error: CallError) -> Exit {
        if matches!(error, CallError::Discard) {
            let space = &*self.space;
            self.not_finite = self
                .found(Evaluated::State, &space.x)
                .or_else(|| self.found(Evaluated::Derivative, self.stepper.derivative()))
                .or_else(|| self.found(Evaluated::EventIndicator, &space.domains.base));
            if self.not_finite.is_none() && self.stepper.properties().slopes_from_stepper_only {
                let Space { x, x_new, .. } = &mut *self.space;
                let _ = self.system.derivatives(self.t, x, x_new);
                self.not_finite = self.found(Evaluated::Derivative, &self.space.x_new);
            }
        }
        no_retreat(error)
    }

    fn found(&self, what: Evaluated, values: &[f64]) -> Option<NotFinite> {
        NotFinite::first(what, self.t, values)
    }

    /// Determines the reasons after the run has failed with this error.
    pub(super) fn look_for_reasons(&mut self, kind: &ErrorKind) {
        match kind {
            ErrorKind::StepTooSmall { discarded: true } => self.look_ahead(),
            ErrorKind::StepTooSmall { discarded: false }
            | ErrorKind::NoConvergence
            | ErrorKind::HigherIndex
            | ErrorKind::Inconsistent { .. } => {
                let Self { space, system, stats, stepper, .. } = self;
                let mut equations = Equations { system: &mut **system, weights: &space.weights, stats };
                self.undetermined = stepper.undetermined(&mut equations, self.t, &space.x);
            }
            _ => {}
        }
    }

    /// Searches for values that are not finite ahead along the tangent, at points that refused steps may have
    /// reached.
    fn look_ahead(&mut self) {
        let (n, mut s) = (self.space.x.len(), self.h_tried);
        let (mut dx, mut jacobian) = (vec![0.0; n], Vec::new());
        if self.stepper.properties().takes_jacobians && n <= LARGEST_JACOBIAN {
            jacobian.resize(n * n, 0.0);
            // The values that a model filled in before it refused are examined.
            let _ = self.system.jacobian(self.t, &self.space.x, &mut jacobian);
            self.not_finite = self.found(Evaluated::Jacobian, &jacobian);
        }
        for _ in 0..POINTS_AHEAD {
            let at = self.t + s;
            if self.not_finite.is_some() || at > self.end {
                return;
            }
            let Space { x, x_mid, domains, .. } = &mut *self.space;
            let slope = self.stepper.derivative();
            x_mid.iter_mut().zip(x.iter().zip(slope)).for_each(|(p, (x, d))| *p = x + s * d);
            let _ = self.system.derivatives(at, x_mid, &mut dx);
            self.not_finite = NotFinite::first(Evaluated::Derivative, at, &dx);
            if self.not_finite.is_none() && domains.len() > 0 {
                let _ = self.system.event_indicators(at, x_mid, &mut domains.end);
                self.not_finite = NotFinite::first(Evaluated::EventIndicator, at, &domains.end);
            }
            s *= 4.0;
        }
    }
}
