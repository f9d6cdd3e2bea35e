//! Reasons of a failed run: values that are not finite, and a system of a higher index.

use super::run::{Exit, Run, Space, no_retreat};
use crate::error::{ErrorKind, Evaluated, NotFinite};
use crate::stepper::Equations;
use crate::system::CallError;

/// Points ahead of a refused step that are looked at, each four times as far as the one before: as many as
/// steps are quartered.
const POINTS_AHEAD: u32 = 14;

/// The model's own Jacobian is looked at up to so many states: it takes the square of their number of places.
const LARGEST_JACOBIAN: usize = 1000;

impl Run<'_> {
    /// The current point was refused: by a value there that is not finite, or by the model itself.
    pub(super) fn refused_here(&mut self, error: CallError) -> Exit {
        if matches!(error, CallError::Discard) {
            let space = &*self.space;
            self.not_finite = self
                .found(Evaluated::State, &space.x)
                .or_else(|| self.found(Evaluated::Derivative, self.stepper.derivative()))
                .or_else(|| self.found(Evaluated::EventIndicator, &space.domains.base));
            if self.not_finite.is_none() && self.stepper.properties().only_own_slopes {
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

    /// After the run has failed with this: what there is to know of the reason.
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

    /// Looks for values that are not finite at the points ahead that refused steps may have met, along the
    /// tangent.
    fn look_ahead(&mut self) {
        let (n, mut s) = (self.space.x.len(), self.h_tried);
        let (mut dx, mut jacobian) = (vec![0.0; n], Vec::new());
        if self.stepper.properties().takes_jacobians && n <= LARGEST_JACOBIAN {
            jacobian.resize(n * n, 0.0);
            // What a model has filled in before it refused is what there is to see.
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
