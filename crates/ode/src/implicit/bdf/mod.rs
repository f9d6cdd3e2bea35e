//! Backward differentiation formulae of order 1 to 5 with variable step size and order, in
//! fixed-leading-coefficient form.
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
use crate::lu::Lu;
use crate::stats::Stats;
use crate::stepper::{Attempt, Consistency, Equations, Point, PointMut, Properties, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};

mod coefficients;
mod consistent;
mod corrector;
mod given_slopes;
mod left_side;
mod nordsieck;

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
/// The step size is changed only if it can grow by this factor.
const WORTH_IT: f64 = 1.5;
/// Maximum growth after the first step, and after any other step.
const FIRST_GROWTH: f64 = 1e4;
const GROWTH: f64 = 10.0;

#[derive(Debug)]
pub(crate) struct Bdf {
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

impl Bdf {
    /// Creates the method. `exclude`: states without a derivative in the equations are not in the error test.
    pub(crate) fn new(exclude: bool) -> Self {
        Self {
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

    /// Continues a run of another method that knows the right-hand side at `x` and has a Jacobian.
    pub(crate) fn take_over(&mut self, x: &[f64], f: &[f64]) {
        self.forget();
        self.z[0].copy_from_slice(x);
        self.f.copy_from_slice(f);
    }

    /// The Jacobian, to be taken over from another method.
    pub(crate) fn freshness_mut(&mut self) -> &mut KeptJacobian {
        &mut self.freshness
    }

    /// Changes to the selected order.
    fn change_order(&mut self) {
        let q = self.order;
        if self.next_order < q {
            nordsieck::lower(&mut self.z[..=q], self.h, &self.past);
        } else if self.next_order > q {
            nordsieck::raise(&mut self.z[..=q + 1], self.h, &self.past, &self.last_correction);
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
        self.coefficients = Coefficients::new(self.order, self.h, &self.past);
        let gamma = self.h / self.coefficients.l[1];
        loop {
            self.iterate.slopes.iter_mut().zip(&self.z_new[1]).for_each(|(s, z)| *s = z / self.h);
            let Self { freshness, lu, left, z_new, iterate: Iterate { slopes, rhs, .. }, .. } = self;
            let x = &z_new[0][..];
            left.defect(equations, Point { t: end, x, slopes }, rhs)?;
            let before = equations.stats.jacobians;
            let mut decompose = |left: &LeftSide, jacobian: &Jacobian, stats: &mut Stats| {
                stats.decompositions += 1;
                stats.linear_algebra += lu.operations().0;
                lu.decompose(|p, on_diagonal| left.entry(p, on_diagonal) - gamma * jacobian.values[p])
            };
            let mut system = left.at_slopes(equations.system, slopes);
            let mut inner =
                Equations { system: &mut system, weights: equations.weights, stats: &mut *equations.stats };
            let mut matrix = freshness.prepare(
                &mut inner,
                gamma,
                Point { t: end, x, slopes: rhs },
                |jacobian, stats| decompose(left, jacobian, stats),
            )?;
            if equations.stats.jacobians > before
                && left.renew(equations, Point { t: end, x, slopes }, rhs)?
                && !decompose(left, freshness.jacobian(), equations.stats)
            {
                matrix = Matrix::Singular;
            }
            match matrix {
                Matrix::Kept => {}
                Matrix::New => self.convergence.forget(),
                Matrix::Singular => return Ok(false),
            }
            self.iterate.correction.fill(0.0);
            // Corrects for the change of gamma since the decomposition (by about half of it). `change` is the
            // remaining error of stiff components.
            let ratio = gamma / self.freshness.coefficient();
            let (relaxation, change) = (2.0 / (1.0 + ratio), (1.0 - ratio).abs() / (1.0 + ratio));
            let mut iteration = Corrector {
                lu: &self.lu,
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
            let newton = self.convergence.iterate(equations, &mut iteration, tolerance, change)?;
            if newton == Newton::Converged {
                self.correction_norm = scaled_norm(&self.iterate.correction, &self.tested);
                return Ok(true);
            }
            if !self.freshness.renew_after_failure(gamma) {
                return Ok(false);
            }
        }
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
            if q < MAX_ORDER && self.last_scale != 0.0 {
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
            if largest >= WORTH_IT && largest != best {
                best = largest;
                if largest == below {
                    self.next_order = q - 1;
                } else {
                    self.next_order = q + 1;
                    self.last_correction.copy_from_slice(&self.iterate.correction);
                }
            }
        }
        if best < WORTH_IT { self.h } else { self.h * best.min(growth) }
    }
}

impl Stepper for Bdf {
    fn properties(&self) -> Properties {
        Properties {
            order: 1,
            takes_mass_matrix: true,
            takes_residual: true,
            only_own_slopes: !self.left.is_identity(),
            interior_samples: 1,
            wants_second_derivative: true,
            evaluates_ends: false,
            takes_jacobians: true,
            ..Properties::default()
        }
    }

    fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()> {
        let n = system.n_states();
        self.freshness.begin(system)?;
        self.left.begin(system)?;
        // The mass matrix has entries outside the pattern.
        let pattern = self.freshness.jacobian().pattern().filter(|_| system.mass_matrix().is_none());
        self.lu.begin(n, pattern)?;
        self.has_started = false;
        let Self { f, iterate, last_correction, inverse, tested, z, z_new, .. } = self;
        let single = [f, last_correction, inverse, tested];
        for v in single.into_iter().chain(iterate.vectors()).chain(z).chain(z_new) {
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
        equations.weights.inverse_at(x, 1.0, &mut self.inverse);
        self.tested.copy_from_slice(&self.inverse);
        self.left.choose_tested(&mut self.tested);
        self.prepare(equations, trial)?;
        if !self.correct(equations, end)? {
            self.growth = 1.0;
            self.freshness.want_jacobian();
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
            if self.wait == 1 && self.order < MAX_ORDER && self.next_order == self.order {
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
