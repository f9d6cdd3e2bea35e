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

use crate::control::{Weights, scaled_norm};
use crate::jacobian::Jacobian;
use crate::lu::Lu;
use crate::stats::Stats;
use crate::stepper::{Attempt, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};

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

/// Coefficients of one step: they follow from its size, its order and the sizes of the steps before.
#[derive(Debug, Default, Clone, Copy)]
struct Coefficients {
    /// What the corrector adds to each row of the array.
    l: [f64; MAX_ORDER + 1],
    /// Error constants: of the order below (times `z_q`), of this order (times `e`), of the order above.
    below: f64,
    here: f64,
    above: f64,
    /// The constant that makes differences of `e` over steps of several sizes comparable.
    scale: f64,
}

impl Coefficients {
    /// For order `q` and step `h` after steps `past[0]` (the last one), `past[1]`, ...
    fn new(q: usize, h: f64, past: &[f64; MAX_ORDER + 1]) -> Self {
        let order = q as f64;
        let mut l = [0.0; MAX_ORDER + 1];
        (l[0], l[1]) = (1.0, 1.0);
        // The polynomial l(s) has the roots -1/xi_j of the past points, but for one that is moved so that the leading
        // coefficient is that of equal steps.
        let (mut alpha, mut alpha_hat) = (-1.0, -1.0);
        let (mut xi, mut xi_fixed) = (1.0, 1.0);
        let mut sum = h;
        if q > 1 {
            for j in 2..q {
                sum += past[j - 2];
                xi = h / sum;
                alpha -= 1.0 / j as f64;
                for i in (1..=j).rev() {
                    l[i] += l[i - 1] * xi;
                }
            }
            alpha -= 1.0 / order;
            xi_fixed = -l[1] - alpha;
            sum += past[q - 2];
            xi = h / sum;
            alpha_hat = -l[1] - xi;
            for i in (1..=q).rev() {
                l[i] += l[i - 1] * xi_fixed;
            }
        }
        let a1 = 1.0 - alpha_hat + alpha;
        let a2 = 1.0 + order * a1;
        let here = (a1 / (alpha * a2)).abs();
        let scale = (a2 * xi_fixed / (l[q] * xi)).abs();
        let below = if q > 1 {
            let c = xi_fixed / l[q];
            let (a3, a4) = (alpha + 1.0 / order, alpha_hat + xi);
            (c * (1.0 - a4 + a3) / a3).abs()
        } else {
            1.0
        };
        sum += past[q - 1];
        let xi = h / sum;
        let (a5, a6) = (alpha - 1.0 / (order + 1.0), alpha_hat - xi);
        let above = ((1.0 - a6 + a5) / a2 / (xi * (order + 2.0) * a5)).abs();
        Self { l, below, here, above, scale }
    }
}

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
    fn rescale(&mut self, h: f64) {
        let ratio = h / self.h;
        let mut factor = 1.0;
        for z in &mut self.z[1..=self.order] {
            factor *= ratio;
            z.iter_mut().for_each(|z| *z *= factor);
        }
        self.h = h;
    }

    /// Continues the array to the end of the step: multiplies it with Pascal's triangle.
    fn predict(&mut self) {
        for (new, old) in self.z_new.iter_mut().zip(&self.z).take(self.order + 1) {
            new.copy_from_slice(old);
        }
        add_pascal(&mut self.z_new[..=self.order]);
    }

    /// Takes the decided order. The polynomial loses or gains the term that belongs to a past point more or less.
    fn change_order(&mut self) {
        let q = self.order;
        if self.next_order < q {
            // The product of s and the distances to the points that stay, as a polynomial in s.
            let mut l = [0.0; MAX_ORDER + 1];
            l[2] = 1.0;
            let mut sum = 0.0;
            for j in 1..q - 1 {
                sum += self.past[j - 1];
                let xi = sum / self.h;
                for i in (2..=j + 2).rev() {
                    l[i] = l[i] * xi + l[i - 1];
                }
            }
            let (low, high) = self.z.split_at_mut(q);
            for (z, l) in low.iter_mut().zip(l).skip(2) {
                add_multiple(z, -l, &high[0]);
            }
        } else if self.next_order > q {
            let mut l = [0.0; MAX_ORDER + 1];
            l[2] = 1.0;
            let (mut alpha_0, mut alpha_1, mut product, mut xi_old) = (-1.0, 1.0, 1.0, 1.0);
            let mut sum = self.h;
            for j in 1..q {
                sum += self.past[j];
                let xi = sum / self.h;
                product *= xi;
                alpha_0 -= 1.0 / (j as f64 + 1.0);
                alpha_1 += 1.0 / xi;
                for i in (2..=j + 2).rev() {
                    l[i] = l[i] * xi_old + l[i - 1];
                }
                xi_old = xi;
            }
            let factor = (-alpha_0 - alpha_1) / product;
            let (low, high) = self.z.split_at_mut(q + 1);
            for (z, e) in high[0].iter_mut().zip(&self.last_correction) {
                *z = factor * e;
            }
            for (z, l) in low.iter_mut().zip(l).skip(2) {
                add_multiple(z, l, &high[0]);
            }
        }
        self.order = self.next_order;
        self.wait = self.order as u32 + 1;
    }

    /// Makes the array ready for a step of size `h`.
    fn prepare<S: HybridSystem + ?Sized>(
        &mut self,
        system: &mut S,
        (t, x, h): (f64, &[f64], f64),
        stats: &mut Stats,
    ) -> CallResult<()> {
        if !self.fresh && self.error_failures >= 3 {
            // The derivatives in the array have lost their meaning.
            self.error_failures = 0;
            if self.order > 1 {
                self.next_order = self.order - 1;
            } else {
                stats.right_hand_sides += 1;
                system.derivatives(t, x, &mut self.f)?;
                self.z[1].iter_mut().zip(&self.f).for_each(|(z, f)| *z = self.h * f);
                self.wait = 10;
            }
        }
        if self.fresh {
            self.fresh = false;
            self.h = h;
            self.z[1].iter_mut().zip(&self.f).for_each(|(z, f)| *z = h * f);
        }
        if self.next_order != self.order {
            self.change_order();
        }
        if h != self.h {
            self.rescale(h);
        }
        Ok(())
    }

    /// A new decomposition for this `gamma`, with a new Jacobian where the old one cannot be kept.
    fn set_up<S: HybridSystem + ?Sized>(
        &mut self,
        system: &mut S,
        end: f64,
        gamma: f64,
        weights: &Weights,
        stats: &mut Stats,
    ) -> CallResult<bool> {
        if !self.has_jacobian || self.wants_jacobian || self.jacobian_age > KEEP_JACOBIAN {
            let point = (end, &self.z_new[0][..], &self.rhs[..]);
            self.jacobian.evaluate(system, point, weights, stats)?;
            self.has_jacobian = true;
            self.wants_jacobian = false;
            self.jacobian_is_suspect = false;
            self.jacobian_age = 0;
        }
        let n = self.rhs.len();
        let j = &self.jacobian.values;
        stats.decompositions += 1;
        stats.linear_algebra += self.lu.operations().0;
        let good = self.lu.decompose(|p| f64::from(p.is_multiple_of(n + 1)) - gamma * j[p]);
        self.decomposed_gamma = if good { gamma } else { 0.0 };
        self.decomposition_age = 0;
        self.rate = 1.0;
        Ok(good)
    }

    /// Newton's iterations from the prediction, whose right-hand side is in `rhs`. `false`: no convergence.
    fn newton<S: HybridSystem + ?Sized>(
        &mut self,
        system: &mut S,
        end: f64,
        gamma: f64,
        stats: &mut Stats,
    ) -> CallResult<bool> {
        let tolerance = NEWTON_SHARE / self.coefficients.here;
        let share = 1.0 / self.coefficients.l[1];
        // Half a correction for the change of gamma since the decomposition.
        let ratio = gamma / self.decomposed_gamma;
        let relaxation = 2.0 / (1.0 + ratio);
        self.correction.fill(0.0);
        let mut last = 0.0;
        for count in 1..=MAX_NEWTON {
            stats.newton_iterations += 1;
            stats.linear_algebra += self.lu.operations().1;
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
            stats.right_hand_sides += 1;
            system.derivatives(end, &self.x, &mut self.rhs)?;
        }
        Ok(false)
    }

    /// Predicts and corrects. `false`: the equations could not be solved with a fresh Jacobian.
    fn correct<S: HybridSystem + ?Sized>(
        &mut self,
        system: &mut S,
        end: f64,
        weights: &Weights,
        stats: &mut Stats,
    ) -> CallResult<bool> {
        self.predict();
        self.coefficients = Coefficients::new(self.order, self.h, &self.past);
        let gamma = self.h / self.coefficients.l[1];
        let mut must_set_up = self.wants_jacobian || self.error_failures > 0;
        loop {
            stats.right_hand_sides += 1;
            system.derivatives(end, &self.z_new[0], &mut self.rhs)?;
            let change = if self.decomposed_gamma == 0.0 {
                f64::INFINITY
            } else {
                (gamma / self.decomposed_gamma - 1.0).abs()
            };
            let old = must_set_up || change > KEEP_GAMMA || self.decomposition_age >= KEEP_DECOMPOSITION;
            if old && !self.set_up(system, end, gamma, weights, stats)? {
                if self.jacobian_age == 0 {
                    return Ok(false);
                }
                self.wants_jacobian = true;
                continue;
            }
            if self.newton(system, end, gamma, stats)? {
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

    /// Expands the array at an earlier point of the last step, `theta` of it from its start.
    fn cut(&mut self, theta: f64) {
        let s = theta - 1.0;
        let mut power = 1.0;
        for z in &mut self.z[..=self.order] {
            z.iter_mut().for_each(|z| *z *= power);
            power *= s;
        }
        // Now in units of the distance to that point; back to units of the (shorter) step.
        add_pascal(&mut self.z[..=self.order]);
        let (unit, mut power) = (theta / s, 1.0);
        for z in &mut self.z[..=self.order] {
            z.iter_mut().for_each(|z| *z *= power);
            power *= unit;
        }
        self.h *= theta;
        self.past[0] = self.h;
    }
}

/// `y += factor x`.
fn add_multiple(y: &mut [f64], factor: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * x;
    }
}

/// Moves the point of expansion by one unit.
fn add_pascal(z: &mut [Vec<f64>]) {
    for k in 1..z.len() {
        for j in (k..z.len()).rev() {
            let (low, high) = z.split_at_mut(j);
            add_multiple(&mut low[j - 1], 1.0, &high[0]);
        }
    }
}

impl Stepper for Bdf {
    fn order(&self) -> u32 {
        1
    }

    fn has_error_estimate(&self) -> bool {
        true
    }

    fn takes_long_steps(&self) -> bool {
        true
    }

    fn begin<S: HybridSystem + ?Sized>(&mut self, system: &S) {
        let n = system.n_states();
        self.jacobian.begin(system);
        self.lu.begin(n, self.jacobian.pattern());
        let Self { f, correction, last_correction, inverse, x, rhs, increment, z, z_new, .. } = self;
        let single = [f, correction, last_correction, inverse, x, rhs, increment];
        for v in single.into_iter().chain(z).chain(z_new) {
            v.clear();
            v.resize(n, 0.0);
        }
        self.has_jacobian = false;
        self.forget();
    }

    fn evaluate<S: HybridSystem + ?Sized>(
        &mut self,
        system: &mut S,
        t: f64,
        x: &[f64],
        stats: &mut Stats,
    ) -> CallResult<()> {
        self.z[0].copy_from_slice(x);
        stats.right_hand_sides += 1;
        system.derivatives(t, x, &mut self.f)
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
        system: &mut S,
        trial: Trial<'_>,
        weights: &Weights,
        x_new: &mut [f64],
        stats: &mut Stats,
    ) -> CallResult<Attempt> {
        let Trial { t, end, h, x } = trial;
        if x.is_empty() {
            return Ok(Attempt::Good);
        }
        weights.inverse_at(x, 1.0, &mut self.inverse);
        self.prepare(system, (t, x, h), stats)?;
        if !self.correct(system, end, weights, stats)? {
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
        let s = theta - 1.0;
        x.copy_from_slice(&self.z_new[self.order]);
        for z in self.z_new[..self.order].iter().rev() {
            for (x, z) in x.iter_mut().zip(z) {
                *x = *x * s + z;
            }
        }
    }

    fn interpolate_slope(&self, _: Trial<'_>, theta: f64, dx: &mut [f64]) {
        let s = theta - 1.0;
        dx.fill(0.0);
        for (j, z) in self.z_new[..=self.order].iter().enumerate().skip(1).rev() {
            for (dx, z) in dx.iter_mut().zip(z) {
                *dx = *dx * s + j as f64 * z / self.h;
            }
        }
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
            self.cut(theta);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Equal steps give the classical formulae: `l_1` is the harmonic number; the error is
    /// `e / ((q + 1) l_1)`.
    #[test]
    fn equal_steps_give_the_classical_formulae() {
        for q in 1..=MAX_ORDER {
            let c = Coefficients::new(q, 0.1, &[0.1; MAX_ORDER + 1]);
            let harmonic: f64 = (1..=q).map(|j| 1.0 / j as f64).sum();
            assert!((c.l[1] - harmonic).abs() < 1e-14, "order {q}: {:?}", c.l);
            assert!((c.here * (q as f64 + 1.0) * harmonic - 1.0).abs() < 1e-14, "order {q}: {}", c.here);
            // l(s) vanishes at the past points but the present one: sum l_j (-1)^j = 0.
            let at_last: f64 = (0..=q).map(|j| c.l[j] * (-1f64).powi(j as i32)).sum();
            assert!(at_last.abs() < 1e-14, "order {q}: {at_last}");
        }
    }

    /// A polynomial of the degree of the order is continued exactly, whatever the step sizes and changes of order.
    #[test]
    fn the_array_is_a_polynomial() {
        let mut bdf = Bdf::default();
        // 1 + 2 t + 3 t^2 + 4 t^3 at t = 1, h = 0.5
        let at = |t: f64| 1.0 + t * (2.0 + t * (3.0 + 4.0 * t));
        let (h, t) = (0.5, 1.0);
        bdf.order = 3;
        bdf.next_order = 3;
        bdf.h = h;
        bdf.z[0] = vec![at(t)];
        bdf.z[1] = vec![h * (2.0 + 6.0 * t + 12.0 * t * t)];
        bdf.z[2] = vec![h * h * (3.0 + 12.0 * t)];
        bdf.z[3] = vec![h * h * h * 4.0];
        bdf.z_new.iter_mut().for_each(|z| *z = vec![0.0]);
        bdf.predict();
        assert!((bdf.z_new[0][0] - at(1.5)).abs() < 1e-12);
        bdf.rescale(0.2);
        bdf.predict();
        assert!((bdf.z_new[0][0] - at(1.2)).abs() < 1e-12);
        let mut x = [0.0];
        let trial = Trial { t: 1.0, end: 1.2, h: 0.2, x: &[0.0] };
        bdf.interpolate(trial, 0.25, &mut x);
        assert!((x[0] - at(1.05)).abs() < 1e-12);
        bdf.interpolate_slope(trial, 0.25, &mut x);
        assert!((x[0] - (2.0 + 6.0 * 1.05 + 12.0 * 1.05 * 1.05)).abs() < 1e-12);
        std::mem::swap(&mut bdf.z, &mut bdf.z_new);
        bdf.cut(0.25);
        assert!((bdf.z[0][0] - at(1.05)).abs() < 1e-12);
        assert!((bdf.z[1][0] / bdf.h - (2.0 + 6.0 * 1.05 + 12.0 * 1.05 * 1.05)).abs() < 1e-12);
        assert!((bdf.z[3][0] / bdf.h.powi(3) - 4.0).abs() < 1e-9);
    }
}
