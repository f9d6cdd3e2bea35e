//! The step-size controller and the size of the first step.

use crate::error_norm::ErrorWeights;

/// The PI controllers of DOPRI5 and DOP853 (Hairer, Norsett, Wanner I, II.4 and II.5, and IV.2 of volume II).
#[derive(Debug)]
pub(crate) struct StepController {
    exponent: f64,
    beta: f64,
    growth: f64,
    reduction: f64,
    previous_error: f64,
    just_rejected: bool,
}

impl StepController {
    const SAFETY: f64 = 0.9;

    /// Creates the controller. For methods of order 5: `beta = 0.04`, factor between 0.2 and 10. For methods
    /// of order 8: no memory, factor between 1/3 and 6.
    pub(crate) fn new(order: u32) -> Self {
        let (beta, growth, reduction) = if order < 8 { (0.04, 10.0, 0.2) } else { (0.0, 6.0, 1.0 / 3.0) };
        Self {
            exponent: 1.0 / f64::from(order) - 0.75 * beta,
            beta,
            growth,
            reduction,
            previous_error: 1e-4,
            just_rejected: false,
        }
    }

    pub(crate) fn restart(&mut self) {
        self.previous_error = 1e-4;
        self.just_rejected = false;
    }

    /// Returns the factor for the step size after an accepted step with this error norm.
    pub(crate) fn accepted(&mut self, error: f64) -> f64 {
        let factor = error.powf(self.exponent) / self.previous_error.powf(self.beta) / Self::SAFETY;
        let growth = if self.just_rejected { 1.0 } else { self.growth };
        self.previous_error = error.max(1e-4);
        self.just_rejected = false;
        (1.0 / factor).clamp(self.reduction, growth)
    }

    /// Returns the factor for the step size after a rejected step with this error norm.
    pub(crate) fn rejected(&mut self, error: f64) -> f64 {
        self.just_rejected = true;
        (Self::SAFETY / error.powf(self.exponent)).clamp(self.reduction, 0.9)
    }

    /// Returns the factor for the step size after a point that the model refused.
    pub(crate) fn discarded(&mut self) -> f64 {
        self.just_rejected = true;
        0.25
    }
}

/// Returns a first estimate of the step size: HNW I, II.4, steps a) and b). An explicit Euler step of this
/// size changes the solution by a hundredth of its norm.
pub(crate) fn probe_step(weights: &ErrorWeights, x: &[f64], dx: &[f64], span: f64) -> f64 {
    let (d0, d1) = (weights.norm(x, x), weights.norm(x, dx));
    if d0 < 1e-5 || d1 < 1e-5 { 1e-6 * span } else { 0.01 * d0 / d1 }
}

/// Returns the step size from two right-hand sides `probe` apart: HNW I, II.4, steps d) to f).
pub(crate) fn first_step(
    weights: &ErrorWeights,
    order: u32,
    x: &[f64],
    dx: &[f64],
    dx_probe: &[f64],
    probe: f64,
) -> f64 {
    let d1 = weights.norm(x, dx);
    let d2 = weights.distance(x, dx_probe, dx) / probe;
    let largest = d1.max(d2);
    if largest <= 1e-15 {
        return 100.0 * probe;
    }
    (0.01 / largest).powf(1.0 / f64::from(order + 1)).min(100.0 * probe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_does_not_grow_right_after_rejection() {
        let mut c = StepController::new(5);
        assert!(c.rejected(100.0) < 0.5);
        assert!(c.accepted(1e-8) <= 1.0);
        assert!(c.accepted(1e-8) > 5.0);
    }
}
