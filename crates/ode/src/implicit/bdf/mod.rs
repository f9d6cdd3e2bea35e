//! Backward differentiation formulae of order 1 to 5, step size and order variable, in fixed-leading-coefficient form.
//!
//! G. D. Byrne, A. C. Hindmarsh, A polyalgorithm for the numerical solution of ordinary differential equations, ACM
//! Transactions on Mathematical Software 1 (1975) 71-96; K. R. Jackson, R. Sacks-Davis, An alternative implementation
//! of variable step-size multistep formulas for stiff ODEs, the same 6 (1980) 295-318; P. N. Brown, G. D. Byrne,
//! A. C. Hindmarsh, VODE: a variable-coefficient ODE solver, SIAM Journal on Scientific and Statistical Computing 10
//! (1989) 1038-1051.
//!
//! The past is kept as the Nordsieck array `z_j = h^j x^(j) / j!`: the polynomial behind the formula, expanded at the
//! current point. A step predicts by continuing it; the corrector adds `l_j e` to each `z_j`, where `e` solves
//! `G(e) = e + z_1 / l_1 - gamma f(t, z_0 + e) = 0`, `gamma = h / l_1`.

use super::radau5::Radau5;
use crate::control::scaled_norm;
use crate::jacobian::Jacobian;
use crate::lu::Lu;
use crate::stepper::{Attempt, Equations, Properties, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};

mod array;
mod coefficients;

use array::add_multiple;
use coefficients::Coefficients;

const MAX_ORDER: usize = 5;
const MAX_NEWTON: u32 = 3;
/// Newton's error, as a share of the error test.
const NEWTON_SHARE: f64 = 0.1;
/// A decomposition is kept while `gamma` changes less than this, and for so many steps.
const KEEP_GAMMA: f64 = 0.3;
const KEEP_DECOMPOSITION: u32 = 20;
const KEEP_JACOBIAN: u32 = 50;
/// Where an input changes its slope the second derivative jumps; the rows of the array above it are of the past only, and
/// are left out. Measured on an exhaust pipe driven by inputs with a kink each second: steps that go over the kinks take
/// 17 % more right-hand sides and are off by 50 times as much at rtol 1e-8, and the noise of a cost at rtol 1e-6 is 2e-5
/// instead of 5e-9. All rows kept: 5 % less at rtol 1e-8, but a noise of 1e-7 instead of 6e-9. Order 1: 10 % more.
const KINK_ORDER: usize = 2;
/// The step size is left alone unless it can grow by this factor.
const WORTH_IT: f64 = 1.5;
/// Growth allowed after the first step, and after each other one.
const FIRST_GROWTH: f64 = 1e4;
const GROWTH: f64 = 10.0;

#[derive(Debug)]
pub(crate) struct Bdf {
    jacobian: Jacobian,
    lu: Lu<f64>,
    /// The array at the current point, and at the end of the trial.
    z: [Vec<f64>; MAX_ORDER + 1],
    z_new: [Vec<f64>; MAX_ORDER + 1],
    order: usize,
    next_order: usize,
    /// The step size that the array is scaled by.
    h: f64,
    past: [f64; MAX_ORDER + 1],
    coefficients: Coefficients,
    f: Vec<f64>,
    /// The array holds nothing but the state.
    fresh: bool,
    /// Steps since the start of the array.
    steps: u32,
    /// Steps until a change of order is considered.
    wait: u32,
    growth: f64,
    error_failures: u32,
    /// The corrector's sum `e`, and that of the step before (with its constant) for the order above.
    correction: Vec<f64>,
    correction_norm: f64,
    last_correction: Vec<f64>,
    last_scale: f64,
    /// `gamma` of the decomposition; 0: none.
    decomposed_gamma: f64,
    decomposition_age: u32,
    has_jacobian: bool,
    jacobian_age: u32,
    /// The Jacobian is from before an event.
    jacobian_is_suspect: bool,
    wants_jacobian: bool,
    rate: f64,
    inverse: Vec<f64>,
    x: Vec<f64>,
    rhs: Vec<f64>,
    increment: Vec<f64>,
}

impl Default for Bdf {
    fn default() -> Self {
        Self {
            jacobian: Jacobian::default(),
            lu: Lu::default(),
            z: Default::default(),
            z_new: Default::default(),
            order: 1,
            next_order: 1,
            h: 1.0,
            past: [0.0; MAX_ORDER + 1],
            coefficients: Coefficients::default(),
            f: Vec::new(),
            fresh: true,
            steps: 0,
            wait: 2,
            growth: FIRST_GROWTH,
            error_failures: 0,
            correction: Vec::new(),
            correction_norm: 0.0,
            last_correction: Vec::new(),
            last_scale: 0.0,
            decomposed_gamma: 0.0,
            decomposition_age: 0,
            has_jacobian: false,
            jacobian_age: 0,
            jacobian_is_suspect: false,
            wants_jacobian: false,
            rate: 1.0,
            inverse: Vec::new(),
            x: Vec::new(),
            rhs: Vec::new(),
            increment: Vec::new(),
        }
    }
}

impl Bdf {
    /// Takes over from Radau5 at `x`, with its Jacobian.
    pub(crate) fn take_over(&mut self, x: &[f64], from: &mut Radau5) {
        self.forget();
        self.z[0].copy_from_slice(x);
        self.f.copy_from_slice(from.derivative());
        std::mem::swap(&mut self.jacobian, from.jacobian_mut());
        self.has_jacobian = true;
        self.jacobian_age = 0;
    }

    /// Takes the decided order.
    fn change_order(&mut self) {
        let q = self.order;
        if self.next_order < q {
            array::lower(&mut self.z[..=q], self.h, &self.past);
        } else if self.next_order > q {
            array::raise(&mut self.z[..=q + 1], self.h, &self.past, &self.last_correction);
        }
        self.order = self.next_order;
        self.wait = self.order as u32 + 1;
    }

    /// Makes the array ready for a step of size `h`.
    fn prepare<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        (t, x, h): (f64, &[f64], f64),
    ) -> CallResult<()> {
        if !self.fresh && self.error_failures >= 3 {
            // The derivatives in the array have lost their meaning.
            self.error_failures = 0;
            if self.order > 1 {
                self.next_order = self.order - 1;
            } else {
                equations.derivatives(t, x, &mut self.f)?;
                self.z[1].iter_mut().zip(&self.f).for_each(|(z, f)| *z = self.h * f);
                self.wait = 10;
            }
        }
        if self.fresh {
            self.fresh = false;
            self.h = h;
            self.z[1].iter_mut().zip(&self.f).for_each(|(z, f)| *z = h * f);
            if self.order == 2 {
                // In `z_2` is half the second derivative; the point before is the one that the parabola passes.
                self.z[2].iter_mut().for_each(|z| *z *= h * h);
                self.past[0] = h;
                self.wait = 3;
            }
        }
        if self.next_order != self.order {
            self.change_order();
        }
        if h != self.h {
            array::rescale(&mut self.z[..=self.order], h / self.h);
            self.h = h;
        }
        Ok(())
    }

    /// A new decomposition for this `gamma`, with a new Jacobian where the old one cannot be kept.
    fn set_up<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        end: f64,
        gamma: f64,
    ) -> CallResult<bool> {
        if !self.has_jacobian || self.wants_jacobian || self.jacobian_age > KEEP_JACOBIAN {
            let point = (end, &self.z_new[0][..], &self.rhs[..]);
            self.jacobian.evaluate(equations, point)?;
            self.has_jacobian = true;
            self.wants_jacobian = false;
            self.jacobian_is_suspect = false;
            self.jacobian_age = 0;
        }
        let j = &self.jacobian.values;
        equations.stats.decompositions += 1;
        equations.stats.linear_algebra += self.lu.operations().0;
        let good = self.lu.decompose(|p, on_diagonal| f64::from(on_diagonal) - gamma * j[p]);
        self.decomposed_gamma = if good { gamma } else { 0.0 };
        self.decomposition_age = 0;
        self.rate = 1.0;
        Ok(good)
    }

    /// Newton's iterations from the prediction, whose right-hand side is in `rhs`. `false`: no convergence.
    fn newton<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        end: f64,
        gamma: f64,
    ) -> CallResult<bool> {
        let tolerance = NEWTON_SHARE / self.coefficients.here;
        let share = 1.0 / self.coefficients.l[1];
        // Half a correction for the change of gamma since the decomposition.
        let ratio = gamma / self.decomposed_gamma;
        let relaxation = 2.0 / (1.0 + ratio);
        self.correction.fill(0.0);
        let mut last = 0.0;
        for count in 1..=MAX_NEWTON {
            equations.stats.newton_iterations += 1;
            equations.stats.linear_algebra += self.lu.operations().1;
            for (i, b) in self.increment.iter_mut().enumerate() {
                *b = gamma * self.rhs[i] - share * self.z_new[1][i] - self.correction[i];
            }
            self.lu.solve(&mut self.increment);
            if ratio != 1.0 {
                self.increment.iter_mut().for_each(|v| *v *= relaxation);
            }
            for (e, d) in self.correction.iter_mut().zip(&self.increment) {
                *e += d;
            }
            let norm = scaled_norm(&self.increment, &self.inverse);
            if !norm.is_finite() {
                return Err(CallError::Discard);
            }
            if count > 1 {
                self.rate = (0.3 * self.rate).max(norm / last);
            }
            if norm * self.rate.min(1.0) <= tolerance {
                self.correction_norm =
                    if count == 1 { norm } else { scaled_norm(&self.correction, &self.inverse) };
                // Slow, with a Jacobian from before the last event.
                self.wants_jacobian |= self.jacobian_is_suspect && count == MAX_NEWTON;
                return Ok(true);
            }
            if count == MAX_NEWTON || (count > 1 && norm > 2.0 * last) {
                break;
            }
            last = norm;
            for (i, x) in self.x.iter_mut().enumerate() {
                *x = self.z_new[0][i] + self.correction[i];
            }
            equations.derivatives(end, &self.x, &mut self.rhs)?;
        }
        Ok(false)
    }

    /// Predicts and corrects. `false`: the equations could not be solved with a fresh Jacobian.
    fn correct<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        end: f64,
    ) -> CallResult<bool> {
        for (new, old) in self.z_new.iter_mut().zip(&self.z).take(self.order + 1) {
            new.copy_from_slice(old);
        }
        array::advance(&mut self.z_new[..=self.order]);
        self.coefficients = Coefficients::new(self.order, self.h, &self.past);
        let gamma = self.h / self.coefficients.l[1];
        let mut must_set_up = self.wants_jacobian || self.error_failures > 0;
        loop {
            equations.derivatives(end, &self.z_new[0], &mut self.rhs)?;
            let change = if self.decomposed_gamma == 0.0 {
                f64::INFINITY
            } else {
                (gamma / self.decomposed_gamma - 1.0).abs()
            };
            let old = must_set_up || change > KEEP_GAMMA || self.decomposition_age >= KEEP_DECOMPOSITION;
            if old && !self.set_up(equations, end, gamma)? {
                if self.jacobian_age == 0 {
                    return Ok(false);
                }
                self.wants_jacobian = true;
                continue;
            }
            if self.newton(equations, end, gamma)? {
                return Ok(true);
            }
            if self.jacobian_age == 0 && self.decomposed_gamma == gamma {
                return Ok(false);
            }
            // If gamma has moved far the decomposition is to blame, else the Jacobian.
            self.wants_jacobian = change < 0.2 || self.decomposed_gamma == gamma;
            must_set_up = true;
        }
    }

    /// The step size to go on with: considers the orders next to this one once in a while.
    fn choose(&mut self) -> f64 {
        let q = self.order;
        let order = q as f64;
        let growth = std::mem::replace(&mut self.growth, GROWTH);
        self.next_order = q;
        if growth == 1.0 {
            // After a failure: stay a while.
            self.wait = self.wait.max(2);
            return self.h;
        }
        let error = self.correction_norm * self.coefficients.here;
        let mut best = 1.0 / ((6.0 * error).powf(1.0 / (order + 1.0)) + 1e-6);
        if self.wait == 0 {
            self.wait = 2;
            let mut below = 0.0;
            if q > 1 {
                let error = scaled_norm(&self.z[q], &self.inverse) * self.coefficients.below;
                below = 1.0 / ((6.0 * error).powf(1.0 / order) + 1e-6);
            }
            let mut above = 0.0;
            if q < MAX_ORDER && self.last_scale != 0.0 {
                let quotient =
                    self.coefficients.scale / self.last_scale * (self.h / self.past[1]).powf(order + 1.0);
                for (d, (e, last)) in
                    self.increment.iter_mut().zip(self.correction.iter().zip(&self.last_correction))
                {
                    *d = e - quotient * last;
                }
                let error = scaled_norm(&self.increment, &self.inverse) * self.coefficients.above;
                above = 1.0 / ((10.0 * error).powf(1.0 / (order + 2.0)) + 1e-6);
            }
            let largest = best.max(below).max(above);
            if largest >= WORTH_IT && largest != best {
                best = largest;
                if largest == below {
                    self.next_order = q - 1;
                } else {
                    self.next_order = q + 1;
                    self.last_correction.copy_from_slice(&self.correction);
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
            takes_long_steps: true,
            wants_second_derivative: true,
            evaluates_ends: false,
            takes_jacobians: true,
            ..Properties::default()
        }
    }

    fn begin<S: HybridSystem + ?Sized>(&mut self, system: &S) -> CallResult<()> {
        let n = system.n_states();
        self.jacobian.begin(system)?;
        self.lu.begin(n, self.jacobian.pattern())?;
        let Self { f, correction, last_correction, inverse, x, rhs, increment, z, z_new, .. } = self;
        let single = [f, correction, last_correction, inverse, x, rhs, increment];
        for v in single.into_iter().chain(z).chain(z_new) {
            v.clear();
            v.resize(n, 0.0);
        }
        self.has_jacobian = false;
        self.forget();
        Ok(())
    }

    fn evaluate<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        t: f64,
        x: &[f64],
    ) -> CallResult<()> {
        self.z[0].copy_from_slice(x);
        equations.derivatives(t, x, &mut self.f)
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
        self.decomposed_gamma = 0.0;
        self.rate = 1.0;
        self.jacobian_is_suspect = true;
        self.wants_jacobian = false;
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

    fn try_step<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        trial: Trial<'_>,
        x_new: &mut [f64],
    ) -> CallResult<Attempt> {
        let Trial { t, end, h, x } = trial;
        if x.is_empty() {
            return Ok(Attempt::Good);
        }
        equations.weights.inverse_at(x, 1.0, &mut self.inverse);
        self.prepare(equations, (t, x, h))?;
        if !self.correct(equations, end)? {
            self.growth = 1.0;
            self.wants_jacobian = true;
            return Ok(Attempt::NotSolved { h: 0.25 * h });
        }
        for (z, l) in self.z_new.iter_mut().zip(self.coefficients.l).take(self.order + 1) {
            add_multiple(z, l, &self.correction);
        }
        x_new.copy_from_slice(&self.z_new[0]);
        let error = self.correction_norm * self.coefficients.here;
        if !error.is_finite() {
            return Err(CallError::Discard);
        }
        if error > 1.0 {
            self.growth = 1.0;
            self.error_failures += 1;
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
        &self.correction
    }

    fn refused(&mut self, h: f64) -> f64 {
        self.growth = 1.0;
        0.25 * h
    }

    fn interpolate(&self, _: Trial<'_>, theta: f64, x: &mut [f64]) {
        array::value(&self.z_new[..=self.order], theta - 1.0, x);
    }

    fn accept(&mut self, _: f64, theta: f64) -> f64 {
        self.steps += 1;
        self.decomposition_age += 1;
        self.jacobian_age += 1;
        self.error_failures = 0;
        self.past.rotate_right(1);
        self.past[0] = self.h;
        if self.steps == 1 {
            self.past[1] = self.h;
        }
        std::mem::swap(&mut self.z, &mut self.z_new);
        let h = self.h;
        let proposed = if theta < 1.0 {
            array::retreat(&mut self.z[..=self.order], theta);
            self.h *= theta;
            self.past[0] = self.h;
            self.wait = self.wait.max(2);
            self.next_order = self.order;
            h
        } else {
            self.wait = self.wait.saturating_sub(1);
            let proposed = self.choose();
            if self.wait == 1 && self.order < MAX_ORDER && self.next_order == self.order {
                self.last_correction.copy_from_slice(&self.correction);
                self.last_scale = self.coefficients.scale;
            }
            proposed
        };
        let h = self.h;
        self.f.iter_mut().zip(&self.z[1]).for_each(|(f, z)| *f = z / h);
        proposed
    }
}
