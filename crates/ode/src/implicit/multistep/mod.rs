//! Multistep methods with variable step size and order: Adams-Moulton formulae of order 1 to 12, and backward
//! differentiation formulae of order 1 to 5 in fixed-leading-coefficient form.
//!
//! Adams formulae begin without a matrix: the increment of the corrector is its residual. Once the iterations
//! beyond the first of each step have cost as much as a Jacobian, Newton's method replaces them. It needs one
//! iteration per step, and only stability limits the steps then, not the convergence of the iterations.
//!
//! G. D. Byrne, A. C. Hindmarsh, A polyalgorithm for the numerical solution of ordinary differential
//! equations, ACM Transactions on Mathematical Software 1 (1975) 71-96; K. R. Jackson, R. Sacks-Davis, An
//! alternative implementation of variable step-size multistep formulas for stiff ODEs, ACM Transactions on
//! Mathematical Software 6 (1980) 295-318; P. N. Brown, G. D. Byrne, A. C. Hindmarsh, VODE: a
//! variable-coefficient ODE solver, SIAM Journal on Scientific and Statistical Computing 10 (1989) 1038-1051.
//!
//! The history is stored as the Nordsieck array `z_j = h^j x^(j) / j!`: the polynomial of the formula,
//! expanded at the current point. A step extrapolates this polynomial as its prediction. The corrector adds
//! `l_j e` to each `z_j`, where `e` solves `G(e) = e + z_1 / l_1 - gamma f(t, z_0 + e) = 0` with `gamma = h /
//! l_1`. Systems `M x' = f(t, x)` and `F(t, x, x') = 0` are solved similarly, with `x' = (e + z_1 / l_1) /
//! gamma` (K. E. Brenan, S. L. Campbell, L. R. Petzold, Numerical Solution of Initial-Value Problems in
//! Differential-Algebraic Equations, 1996, chapter 5).

use super::kept_jacobian::{KeptJacobian, Matrix, Rules};
use super::newton::{Convergence, Newton};
use crate::error::Undetermined;
use crate::error_norm::scaled_norm;
use crate::jacobian::Jacobian;
use crate::lu::{self, Lu};
use crate::stats::Stats;
use crate::stepper::{Attempt, Consistency, Equations, Point, PointMut, Properties, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};

mod coefficients;
mod consistent;
mod corrector;
mod given_slopes;
mod left_side;
mod nordsieck;

pub(crate) use coefficients::Formula;
use coefficients::{Coefficients, MAX_ORDER};
use corrector::{Corrector, Iterate};
use left_side::LeftSide;
use nordsieck::add_multiple;

/// Three iterations, as in VODE.
const MAX_NEWTON: u32 = 4;
/// Tolerance of Newton's method as a fraction of the error test, as in VODE.
const NEWTON_SHARE: f64 = 0.1;
/// Tolerance of Newton's method in units of the tolerances of the states, for systems that may contain
/// equations without derivatives (IDA: 0.33). The error test of a later step of lower order counts the
/// remaining residual of these equations as an error, which no step size reduces.
const NEWTON_ERROR: f64 = 0.2;
const RULES: Rules =
    Rules { change: 0.3, decomposition_steps: 20, jacobian_steps: 50, cheap: 0, only_after_events: true };
/// Maximum order of the array kept at a kink of an input. The second derivative jumps there, so higher rows
/// of the array describe only the past and are dropped. Measured on an exhaust pipe driven by inputs with a
/// kink each second. Steps across the kinks need 17 % more right-hand sides, and their error is 50 times as
/// large at rtol 1e-8. The noise of a cost at rtol 1e-6 is then 2e-5 instead of 5e-9. With all rows kept, 5 %
/// fewer right-hand sides at rtol 1e-8, but a noise of 1e-7 instead of 6e-9. Order 1: 10 % more.
const KINK_ORDER: usize = 2;
/// Intervals of stability of the explicit Adams formulae of order 1 to 12 on the negative real axis: `2 /
/// sum(2^j gamma_j)`, with the coefficients `gamma_j` of Hairer, Norsett and Wanner I, III.1.
const EXPLICIT_LIMIT: [f64; MAX_ORDER] =
    [2.0, 1.0, 0.5455, 0.3, 0.1633, 0.08772, 0.04651, 0.02441, 0.0127, 0.006571, 0.003383, 0.001735];
/// Maximum growth after the first step, and after any other step.
const FIRST_GROWTH: f64 = 1e4;
const GROWTH: f64 = 10.0;

#[derive(Debug)]
pub(crate) struct Multistep {
    formula: Formula,
    /// True if the corrector is Newton's method. Adams formulae begin without a matrix.
    is_newton: bool,
    /// Right-hand sides per Jacobian. Infinite if memory is insufficient for the matrices.
    jacobian_cost: f64,
    /// Iterations beyond the first of each step since the last Jacobian of an Adams formula.
    extra: f64,
    /// Last estimate of the Lipschitz constant from iterations without a matrix.
    lipschitz: f64,
    freshness: KeptJacobian,
    convergence: Convergence,
    lu: Lu<f64>,
    left: LeftSide,
    /// The array at the current point and at the end of the trial.
    z: [Vec<f64>; MAX_ORDER + 1],
    z_new: [Vec<f64>; MAX_ORDER + 1],
    order: usize,
    next_order: usize,
    /// Step size by which the array is scaled.
    h: f64,
    past: [f64; MAX_ORDER + 1],
    coefficients: Coefficients,
    /// Slopes at the current point.
    f: Vec<f64>,
    /// True if the slopes at the start of the run are known.
    has_started: bool,
    /// True if only the state in the array is valid.
    fresh: bool,
    /// Steps since the array was restarted.
    steps: u32,
    /// Steps until a change of order is considered.
    wait: u32,
    growth: f64,
    error_failures: u32,
    /// The corrector. From the previous step, its sum `e` and the constant of that step, for the next higher
    /// order.
    iterate: Iterate,
    correction_norm: f64,
    last_correction: Vec<f64>,
    last_scale: f64,
    /// Inverse weights of the norm of Newton's method, and of the norm of the error test.
    inverse: Vec<f64>,
    tested: Vec<f64>,
}

impl Multistep {
    /// Creates the method. `exclude`: states without a derivative in the equations are not in the error test.
    pub(crate) fn new(formula: Formula, exclude: bool) -> Self {
        Self {
            formula,
            is_newton: formula == Formula::Bdf,
            jacobian_cost: 0.0,
            extra: 0.0,
            lipschitz: 0.0,
            freshness: KeptJacobian::new(RULES),
            convergence: Convergence::new(MAX_NEWTON),
            lu: Lu::default(),
            left: LeftSide::new(exclude),
            z: Default::default(),
            z_new: Default::default(),
            order: 1,
            next_order: 1,
            h: 1.0,
            past: [0.0; MAX_ORDER + 1],
            coefficients: Coefficients::default(),
            f: Vec::new(),
            has_started: false,
            fresh: true,
            steps: 0,
            wait: 2,
            growth: FIRST_GROWTH,
            error_failures: 0,
            iterate: Iterate::default(),
            correction_norm: 0.0,
            last_correction: Vec::new(),
            last_scale: 0.0,
            inverse: Vec::new(),
            tested: Vec::new(),
        }
    }

    /// The Jacobian, to be transferred to another method.
    pub(crate) fn freshness_mut(&mut self) -> &mut KeptJacobian {
        &mut self.freshness
    }

    /// Continues a run of another method that knows the right-hand side at the current point.
    pub(crate) fn take_over(&mut self, x: &[f64], f: &[f64]) {
        self.forget();
        self.z[0].copy_from_slice(x);
        self.f.copy_from_slice(f);
    }

    /// Allocates the matrices of Newton's method.
    fn begin_matrices(&mut self, system: &dyn HybridSystem) -> CallResult<()> {
        self.freshness.begin(system)?;
        self.left.begin(system)?;
        // The mass matrix has entries outside the pattern.
        let pattern = self.freshness.jacobian().pattern().filter(|_| system.mass_matrix().is_none());
        self.lu.begin(system.n_states(), pattern)?;
        Ok(())
    }

    /// Changes to the selected order.
    fn change_order(&mut self) {
        let q = self.order;
        let (h, past) = (self.h, &self.past);
        match (self.formula, self.next_order > q) {
            (Formula::Adams, false) => nordsieck::lower_adams(&mut self.z[..=q], h, past),
            (Formula::Adams, true) => {
                let factor = 1.0 / self.coefficients.scale;
                nordsieck::raise_adams(&mut self.z[..=q + 1], h, past, factor, &self.last_correction);
            }
            (Formula::Bdf, false) => nordsieck::lower_bdf(&mut self.z[..=q], h, past),
            (Formula::Bdf, true) => {
                nordsieck::raise_bdf(&mut self.z[..=q + 1], h, past, &self.last_correction);
            }
        }
        self.order = self.next_order;
        self.wait = self.order as u32 + 1;
    }

    /// Prepares the array for a step of size `h`.
    fn prepare(&mut self, equations: &mut Equations<'_>, Trial { t, h, x, .. }: Trial<'_>) -> CallResult<()> {
        if !self.fresh && self.error_failures >= 3 {
            // The derivatives in the array are wrong: restart at order 1, as in DASSL. If there are equations
            // without derivatives, reduce the order by one instead, which needs fewer steps
            // (`tests/all/dae.rs`, amplifier).
            let order = if self.left.is_identity() { 1 } else { self.order - 1 };
            if order > 1 {
                (self.next_order, self.error_failures) = (order, 0);
            } else {
                (self.order, self.next_order, self.wait, self.last_scale) = (1, 1, 2, 0.0);
                if self.left.is_identity() {
                    equations.derivatives(t, x, &mut self.f)?;
                } else if self.error_failures == 3 {
                    let Self { left, z, f, iterate: Iterate { rhs, .. }, freshness, .. } = self;
                    left.correct(equations, PointMut { t, x: &mut z[0], slopes: f }, rhs, freshness)?;
                }
                self.z[1].iter_mut().zip(&self.f).for_each(|(z, f)| *z = self.h * f);
            }
        }
        if self.fresh {
            self.fresh = false;
            self.h = h;
            self.z[0].copy_from_slice(x);
            self.z[1].iter_mut().zip(&self.f).for_each(|(z, f)| *z = h * f);
            if self.order == 2 {
                // `z_2` contains half the second derivative. The parabola passes through the previous point.
                self.z[2].iter_mut().for_each(|z| *z *= h * h);
                self.past[0] = h;
                self.wait = 3;
            }
        }
        if self.next_order != self.order {
            self.change_order();
        }
        if h != self.h {
            nordsieck::rescale(&mut self.z[..=self.order], h / self.h);
            self.h = h;
        }
        Ok(())
    }

    /// Predicts and corrects. Returns `false` if the equations could not be solved with a fresh Jacobian.
    fn correct(&mut self, equations: &mut Equations<'_>, end: f64) -> CallResult<bool> {
        for (new, old) in self.z_new.iter_mut().zip(&self.z).take(self.order + 1) {
            new.copy_from_slice(old);
        }
        nordsieck::advance(&mut self.z_new[..=self.order]);
        self.coefficients = Coefficients::new(self.formula, self.order, self.h, &self.past);
        let gamma = self.h / self.coefficients.l[1];
        loop {
            self.iterate.slopes.iter_mut().zip(&self.z_new[1]).for_each(|(s, z)| *s = z / self.h);
            let Self { left, z_new, iterate: Iterate { slopes, rhs, .. }, .. } = self;
            left.defect(equations, Point { t: end, x: &z_new[0], slopes }, rhs)?;
            self.iterate.correction.fill(0.0);
            let had_matrix = self.is_newton;
            let (mut relaxation, mut change) = (1.0, 0.0);
            if self.is_newton {
                let ratio = match self.prepare_matrix(equations, end, gamma) {
                    Ok(Some(ratio)) => ratio,
                    Ok(None) => return Ok(false),
                    Err(CallError::Discard) if self.formula == Formula::Adams => {
                        // The Jacobian cannot be evaluated here. It is not needed, either.
                        (self.is_newton, self.jacobian_cost) = (false, f64::INFINITY);
                        continue;
                    }
                    Err(error) => return Err(error),
                };
                // Relaxation would leave an error in the components that are not stiff, which Adams formulae
                // do not damp.
                if self.formula == Formula::Bdf {
                    (relaxation, change) = (2.0 / (1.0 + ratio), (1.0 - ratio).abs() / (1.0 + ratio));
                }
            }
            // With one iteration per step, the method is as unstable as the explicit one.
            let is_unstable = !self.is_newton && self.h * self.lipschitz > EXPLICIT_LIMIT[self.order - 1];
            let mut iteration = Corrector {
                lu: self.is_newton.then_some(&self.lu),
                left: &self.left,
                z: &self.z_new,
                end,
                gamma,
                share: 1.0 / self.coefficients.l[1],
                relaxation,
                inverse: &self.inverse,
                iterate: &mut self.iterate,
            };
            let most = if self.left.is_identity() { f64::INFINITY } else { NEWTON_ERROR };
            let tolerance = (NEWTON_SHARE / self.coefficients.here).min(most);
            let least = 1 + u32::from(is_unstable);
            let newton = self.convergence.iterate(equations, &mut iteration, tolerance, change, least)?;
            if self.formula == Formula::Adams {
                self.count_iterations(equations.system, gamma);
            }
            if newton == Newton::Converged {
                self.correction_norm = scaled_norm(&self.iterate.correction, &self.tested);
                return Ok(true);
            }
            let may_help =
                if had_matrix { self.freshness.renew_after_failure(gamma) } else { self.is_newton };
            if !may_help {
                return Ok(false);
            }
        }
    }

    /// Counts the iterations of an Adams formula. Once those beyond the first have cost as much as a
    /// Jacobian, one is evaluated, because Newton's method then needs one iteration per step. At most twice
    /// the cost of the better choice is spent.
    fn count_iterations(&mut self, system: &dyn HybridSystem, gamma: f64) {
        let count = self.convergence.count();
        if count > 1 && !self.is_newton {
            self.lipschitz = self.convergence.rate() / gamma;
        }
        self.extra += f64::from(count) - 1.0;
        if self.extra >= self.jacobian_cost {
            self.extra = 0.0;
            if self.is_newton {
                self.freshness.request_jacobian();
            } else {
                self.is_newton = self.begin_matrices(system).is_ok();
                if !self.is_newton {
                    self.jacobian_cost = f64::INFINITY;
                }
            }
        }
    }

    /// Ensures that there is a matrix of Newton's method for `gamma`. Returns the ratio of `gamma` and the
    /// coefficient of the matrix, or `None` if the matrix is singular.
    fn prepare_matrix(
        &mut self,
        equations: &mut Equations<'_>,
        end: f64,
        gamma: f64,
    ) -> CallResult<Option<f64>> {
        let Self { freshness, lu, left, z_new, iterate: Iterate { slopes, rhs, .. }, .. } = self;
        let x = &z_new[0][..];
        let before = equations.stats.jacobians;
        let mut decompose = |left: &LeftSide, jacobian: &Jacobian, stats: &mut Stats| {
            stats.decompositions += 1;
            stats.linear_algebra += lu.operations().0;
            lu.decompose(|p, on_diagonal| left.entry(p, on_diagonal) - gamma * jacobian.values[p])
        };
        let mut system = left.at_slopes(equations.system, slopes);
        let mut inner =
            Equations { system: &mut system, weights: equations.weights, stats: &mut *equations.stats };
        let mut matrix =
            freshness.prepare(&mut inner, gamma, Point { t: end, x, slopes: rhs }, |jacobian, stats| {
                decompose(left, jacobian, stats)
            })?;
        if equations.stats.jacobians > before
            && left.renew(equations, Point { t: end, x, slopes }, rhs)?
            && !decompose(left, freshness.jacobian(), equations.stats)
        {
            matrix = Matrix::Singular;
        }
        if matrix == Matrix::Singular {
            return Ok(None);
        }
        if equations.stats.jacobians > before || (self.formula == Formula::Bdf && matrix == Matrix::New) {
            self.convergence.forget();
        }
        // Corrects for the change of gamma since the decomposition (by about half of it). `change` is the
        // remaining error of stiff components.
        Ok(Some(gamma / self.freshness.coefficient()))
    }

    /// Returns the next step size. Sometimes considers the neighbouring orders.
    fn choose(&mut self) -> f64 {
        let q = self.order;
        let order = q as f64;
        let growth = std::mem::replace(&mut self.growth, GROWTH);
        self.next_order = q;
        if growth == 1.0 {
            // After a failure, the order and step size are kept for some steps.
            self.wait = self.wait.max(2);
            return self.h;
        }
        let error = self.correction_norm * self.coefficients.here;
        let mut best = 1.0 / ((6.0 * error).powf(1.0 / (order + 1.0)) + 1e-6);
        if self.wait == 0 {
            self.wait = 2;
            let mut below = 0.0;
            if q > 1 {
                let error = scaled_norm(&self.z[q], &self.tested) * self.coefficients.below;
                below = 1.0 / ((6.0 * error).powf(1.0 / order) + 1e-6);
            }
            let mut above = 0.0;
            if q < self.formula.max_order() && self.last_scale != 0.0 {
                let quotient =
                    self.coefficients.scale / self.last_scale * (self.h / self.past[1]).powf(order + 1.0);
                for (d, (e, last)) in self
                    .iterate
                    .increment
                    .iter_mut()
                    .zip(self.iterate.correction.iter().zip(&self.last_correction))
                {
                    *d = e - quotient * last;
                }
                let error = scaled_norm(&self.iterate.increment, &self.tested) * self.coefficients.above;
                above = 1.0 / ((10.0 * error).powf(1.0 / (order + 2.0)) + 1e-6);
            }
            let largest = best.max(below).max(above);
            if largest >= self.formula.worth_it() && largest != best {
                best = largest;
                if largest == below {
                    self.next_order = q - 1;
                } else {
                    self.next_order = q + 1;
                    self.last_correction.copy_from_slice(&self.iterate.correction);
                }
            }
        }
        if best < self.formula.worth_it() { self.h } else { self.h * best.min(growth) }
    }
}

impl Stepper for Multistep {
    fn properties(&self) -> Properties {
        Properties {
            order: 1,
            takes_mass_matrix: self.formula == Formula::Bdf,
            takes_residual: self.formula == Formula::Bdf,
            slopes_from_stepper_only: !self.left.is_identity(),
            interior_samples: 1,
            needs_second_derivative: true,
            evaluates_ends: false,
            takes_jacobians: self.formula == Formula::Bdf,
            ..Properties::default()
        }
    }

    fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()> {
        let n = system.n_states();
        self.is_newton = self.formula == Formula::Bdf;
        if self.is_newton {
            self.begin_matrices(system)?;
        }
        let pattern = system.jacobian_pattern().filter(|p| p.n_states() == n);
        self.jacobian_cost = pattern.map_or(n as f64, |p| p.widest_column() as f64 + lu::needless_work(p));
        (self.extra, self.lipschitz) = (0.0, 0.0);
        self.has_started = false;
        let rows = self.formula.max_order() + 1;
        let Self { f, iterate, last_correction, inverse, tested, z, z_new, .. } = self;
        let single = [f, last_correction, inverse, tested];
        for v in single.into_iter().chain(iterate.vectors()).chain(&mut z[..rows]).chain(&mut z_new[..rows]) {
            v.clear();
            v.resize(n, 0.0);
        }
        self.forget();
        Ok(())
    }

    fn evaluate(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> CallResult<()> {
        self.z[0].copy_from_slice(x);
        if self.left.is_identity() {
            return equations.derivatives(t, x, &mut self.f);
        }
        if !std::mem::replace(&mut self.has_started, true) {
            equations.system.slopes_at_start(&mut self.f);
        }
        self.left.defect(equations, Point { t, x, slopes: &self.f }, &mut self.iterate.rhs)
    }

    fn make_consistent(
        &mut self,
        equations: &mut Equations<'_>,
        t: f64,
        x: &mut [f64],
    ) -> CallResult<Consistency> {
        let Self { left, f, iterate: Iterate { rhs, .. }, freshness, .. } = self;
        let found = left.make_consistent(equations, PointMut { t, x, slopes: f }, rhs, freshness)?;
        self.z[0].copy_from_slice(x);
        Ok(found)
    }

    fn undetermined(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> Option<Undetermined> {
        self.left.undetermined(equations, Point { t, x, slopes: &self.f }, &mut self.freshness)
    }

    fn forget(&mut self) {
        self.fresh = true;
        self.order = 1;
        self.next_order = 1;
        self.steps = 0;
        self.wait = 2;
        self.growth = FIRST_GROWTH;
        self.error_failures = 0;
        self.last_scale = 0.0;
        self.past = [0.0; MAX_ORDER + 1];
        self.convergence.forget();
        self.freshness.event();
    }

    fn begin_with(&mut self, s: f64, dx: &[f64]) {
        for (z, (f, ahead)) in self.z[2].iter_mut().zip(self.f.iter().zip(dx)) {
            *z = 0.5 * (ahead - f) / s;
        }
        if self.z[2].iter().all(|z| z.is_finite()) {
            (self.order, self.next_order) = (2, 2);
        }
    }

    fn kink(&mut self, h: f64) -> f64 {
        self.order = self.order.min(KINK_ORDER);
        self.next_order = self.order;
        self.wait = self.order as u32 + 1;
        self.last_scale = 0.0;
        h
    }

    fn derivative(&self) -> &[f64] {
        &self.f
    }

    fn try_step(
        &mut self,
        equations: &mut Equations<'_>,
        trial: Trial<'_>,
        x_new: &mut [f64],
    ) -> CallResult<Attempt> {
        let Trial { end, h, x, .. } = trial;
        if x.is_empty() {
            return Ok(Attempt::Good);
        }
        // Steps that approach rounding lead to a discontinuity, which only the tolerance of the run can pass.
        equations.weights.inverse_at(x, 1.0, &mut self.inverse);
        self.tested.copy_from_slice(&self.inverse);
        self.left.choose_tested(&mut self.tested);
        self.prepare(equations, trial)?;
        if !self.correct(equations, end)? {
            self.growth = 1.0;
            self.freshness.request_jacobian();
            return Ok(Attempt::NotSolved { h: 0.25 * h });
        }
        for (z, l) in self.z_new.iter_mut().zip(self.coefficients.l).take(self.order + 1) {
            add_multiple(z, l, &self.iterate.correction);
        }
        x_new.copy_from_slice(&self.z_new[0]);
        let error = self.correction_norm * self.coefficients.here;
        if !error.is_finite() {
            return Err(CallError::Discard);
        }
        if error > 1.0 {
            self.growth = 1.0;
            self.error_failures += 1;
            self.freshness.rejected();
            let wanted = 1.0 / ((6.0 * error).powf(1.0 / (self.order as f64 + 1.0)) + 1e-6);
            let share = match self.error_failures {
                1 => wanted.clamp(0.1, 0.9),
                2 => wanted.clamp(0.1, 0.2),
                _ => 0.1,
            };
            return Ok(Attempt::TooInexact { h: share * h });
        }
        Ok(Attempt::Good)
    }

    fn error(&self) -> &[f64] {
        &self.iterate.correction
    }

    fn refused(&mut self, h: f64) -> f64 {
        self.growth = 1.0;
        0.25 * h
    }

    fn interpolate(&self, _: Trial<'_>, theta: f64, x: &mut [f64]) {
        nordsieck::value(&self.z_new[..=self.order], theta - 1.0, x);
    }

    fn accept(&mut self, _: f64, theta: f64) -> f64 {
        self.steps += 1;
        self.freshness.accepted(self.convergence.count(), self.convergence.rate());
        self.error_failures = 0;
        self.past.rotate_right(1);
        self.past[0] = self.h;
        if self.steps == 1 {
            self.past[1] = self.h;
        }
        std::mem::swap(&mut self.z, &mut self.z_new);
        let h = self.h;
        let proposed = if theta < 1.0 {
            nordsieck::retreat(&mut self.z[..=self.order], theta);
            self.h *= theta;
            self.past[0] = self.h;
            self.wait = self.wait.max(2);
            self.next_order = self.order;
            h
        } else {
            self.wait = self.wait.saturating_sub(1);
            let proposed = self.choose();
            if self.wait == 1 && self.order < self.formula.max_order() && self.next_order == self.order {
                self.last_correction.copy_from_slice(&self.iterate.correction);
                self.last_scale = self.coefficients.scale;
            }
            proposed
        };
        let h = self.h;
        self.f.iter_mut().zip(&self.z[1]).for_each(|(f, z)| *f = z / h);
        proposed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums of the coefficients `gamma_j` of Hairer, Norsett and Wanner I, III.1, times `2^j`.
    fn sums(first: impl Fn(usize) -> f64) -> [f64; MAX_ORDER] {
        let mut gamma = [0.0; MAX_ORDER];
        let mut sum = 0.0;
        std::array::from_fn(|j| {
            gamma[j] = first(j) - (1..=j).map(|i| gamma[j - i] / (i as f64 + 1.0)).sum::<f64>();
            sum += gamma[j] * 2f64.powi(j as i32);
            sum
        })
    }

    #[test]
    fn limits_of_stability_follow_from_coefficients() {
        for (limit, sum) in EXPLICIT_LIMIT.iter().zip(sums(|_| 1.0)) {
            assert!((limit * sum / 2.0 - 1.0).abs() < 1e-3, "{limit} {sum}");
        }
    }
}
