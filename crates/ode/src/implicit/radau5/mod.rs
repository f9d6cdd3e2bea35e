//! Radau IIA of order 5: three implicit stages, L-stable; for stiff systems and systems with a mass matrix.
//!
//! E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.8, and: Stiff differential equations
//! solved by Radau methods, Journal of Computational and Applied Mathematics 111 (1999) 93-111.
//!
//! The stages are written as increments `z_i = X_i - x`, transformed by `T` to the variables `w` in which the Newton
//! matrix falls apart into a real and a complex block of the size of the system.

use crate::control::scaled_norm;
use crate::jacobian::Jacobian;
use crate::lu::Lu;
use crate::stats::Stats;
use crate::stepper::{Attempt, Consistency, Equations, Properties, StepWithEvent, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};
use nalgebra::Complex;

mod algebraic;
mod coefficients;
mod dense;
mod newton;

use algebraic::Algebraic;
use coefficients::{ALPHA, BETA, E, GAMMA};
use dense::{Collocation, Terms};
use newton::{MAX_NEWTON, Newton};

const U: f64 = f64::EPSILON / 2.0;
/// Below this rate of convergence the Jacobian is good enough for the next step too.
const KEEP_JACOBIAN: f64 = 1e-3;
/// A Jacobian of so few evaluations is made anew as soon as convergence slows down or a step fails; a dearer one only
/// when the slow convergence costs iterations.
const CHEAP_JACOBIAN: usize = 4;
const SAFETY: f64 = 0.9;
/// The estimates at the end of a step are held against this times `rtol^(2/3)`: they are of order 3, the end itself of
/// order 5, and this makes the error about what was asked for (radau5 has 0.1 here).
const TRANSFORM: f64 = 0.08;

#[derive(Debug, Default)]
pub(crate) struct Radau5 {
    jacobian: Jacobian,
    mass: Option<Vec<f64>>,
    algebraic: Algebraic,
    real: Lu<f64>,
    complex: Lu<Complex<f64>>,
    /// Size of the step whose matrices are decomposed; 0: none.
    decomposed_h: f64,
    /// There is a Jacobian; it was made at the current point; the last one converged too slowly.
    has_jacobian: bool,
    spectrum: Option<(f64, f64)>,
    jacobian_is_fresh: bool,
    wants_jacobian: bool,
    f: Vec<f64>,
    f_new: Vec<f64>,
    z: [Vec<f64>; 3],
    w: [Vec<f64>; 3],
    stage_f: [Vec<f64>; 3],
    stage_x: Vec<f64>,
    complex_rhs: Vec<Complex<f64>>,
    /// Inverse weights of the norm.
    inverse: Vec<f64>,
    error: Vec<f64>,
    trial: Collocation,
    last: Collocation,
    terms: Terms,
    /// The last step led to the current point, and the solution goes on from there as if nothing had happened.
    can_extrapolate: bool,
    /// The next trial is the last good one made shorter.
    is_repetition: bool,
    theta: f64,
    fac_convergence: f64,
    newton_count: u32,
    error_norm: f64,
    /// Error and size of the last accepted step, for the predictive controller.
    last_error: f64,
    last_h: f64,
    after_rejection: bool,
    first: bool,
    /// The current point is a kink; the step size that the step after the last one would have had.
    at_kink: bool,
    kink_h: f64,
}

impl Radau5 {
    /// The spectral radius of the last Jacobian, by vector iteration (the mean growth over the last half of twenty products, so
    /// that complex pairs count with their modulus), and the cosine between the last vector and its image: -1 where the
    /// largest eigenvalue is real and negative. Found once for each Jacobian.
    pub(crate) fn spectrum(&mut self) -> (f64, f64) {
        const HALF: i32 = 10;
        if let Some(known) = self.spectrum {
            return known;
        }
        let Self { jacobian, inverse, stage_x: v, error: product, .. } = self;
        for (i, (v, inverse)) in v.iter_mut().zip(&*inverse).enumerate() {
            *v = (1.0 + 0.1 * i as f64) / inverse;
        }
        let (mut growth, mut cosine) = (1.0, 0.0);
        for count in 0..2 * HALF {
            product.fill(0.0);
            jacobian.each(|i, k, j| product[i] += j * v[k]);
            let (before, after) = (scaled_norm(v, inverse), scaled_norm(product, inverse));
            if after == 0.0 || !after.is_finite() {
                (growth, cosine) = (0.0, 0.0);
                break;
            }
            if count >= HALF {
                growth *= (after / before).powf(1.0 / f64::from(HALF));
            }
            let weighted = |((v, p), w): ((&f64, &f64), &f64)| v * w * (p * w);
            let dot: f64 = v.iter().zip(&*product).zip(&*inverse).map(weighted).sum();
            cosine = dot / (before * after * v.len() as f64);
            v.iter_mut().zip(&*product).for_each(|(v, p)| *v = p / after);
        }
        *self.spectrum.insert((growth, cosine))
    }

    /// The rate of convergence of Newton's method in the last step; 0 where one iteration was enough.
    pub(crate) fn contraction(&self) -> f64 {
        if self.newton_count > 1 { self.theta } else { 0.0 }
    }

    /// Hands over the Jacobian.
    pub(crate) fn jacobian_mut(&mut self) -> &mut Jacobian {
        self.has_jacobian = false;
        &mut self.jacobian
    }

    /// Takes over in the middle of a run from a method that knows the right-hand side at the current point.
    pub(crate) fn take_over(&mut self, f: &[f64]) {
        self.f.copy_from_slice(f);
        self.has_jacobian = false;
        self.decomposed_h = 0.0;
        self.forget();
    }

    fn decompose(&mut self, h: f64, stats: &mut Stats) -> bool {
        let (j, mass) = (&self.jacobian.values, self.mass.as_deref());
        let m = |p: usize, on_diagonal: bool| match mass {
            Some(m) => m[p],
            None => f64::from(on_diagonal),
        };
        let (gamma, eigen) = (GAMMA / h, Complex::new(ALPHA / h, BETA / h));
        stats.decompositions += 2;
        stats.linear_algebra += self.real.operations().0 + self.complex.operations().0;
        let good = self.real.decompose(|p, d| gamma * m(p, d) - j[p])
            && self.complex.decompose(|p, d| eigen * m(p, d) - Complex::new(j[p], 0.0));
        self.decomposed_h = if good { h } else { 0.0 };
        good
    }

    /// The weighted error of the embedded formula; the second time from the point that the first estimate leads to.
    fn estimate_error<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        Trial { t, h, x, .. }: Trial<'_>,
    ) -> CallResult<f64> {
        let n = x.len();
        for i in 0..n {
            self.stage_x[i] = (E[0] * self.z[0][i] + E[1] * self.z[1][i] + E[2] * self.z[2][i]) / h;
        }
        let slopes = &mut self.stage_f[0];
        match &self.mass {
            None => slopes.copy_from_slice(&self.stage_x),
            Some(m) => {
                for (i, s) in slopes.iter_mut().enumerate() {
                    *s = (0..n).map(|k| m[i + n * k] * self.stage_x[k]).sum();
                }
            }
        }
        for ((e, s), f) in self.error.iter_mut().zip(&*slopes).zip(&self.f) {
            *e = s + f;
        }
        equations.stats.linear_algebra += self.real.operations().1;
        self.real.solve(&mut self.error);
        for (d, e) in self.terms.defect.iter_mut().zip(&self.error) {
            *d = GAMMA * e;
        }
        let norm = scaled_norm(&self.error, &self.inverse);
        if norm < 1.0 || !(self.first || self.after_rejection) {
            return Ok(norm.max(1e-10));
        }
        for ((p, x), e) in self.stage_x.iter_mut().zip(x).zip(&self.error) {
            *p = x + e;
        }
        match equations.derivatives(t, &self.stage_x, &mut self.stage_f[1]) {
            Ok(()) => {}
            // The first estimate stands.
            Err(CallError::Discard) => return Ok(norm),
            Err(failed) => return Err(failed),
        }
        for i in 0..n {
            self.error[i] = self.stage_f[1][i] + self.stage_f[0][i];
        }
        equations.stats.linear_algebra += self.real.operations().1;
        self.real.solve(&mut self.error);
        Ok(scaled_norm(&self.error, &self.inverse).max(1e-10))
    }

    /// The step size that the error alone asks for.
    fn wanted(&self, h: f64) -> f64 {
        let newton = f64::from(1 + 2 * MAX_NEWTON) / f64::from(self.newton_count + 2 * MAX_NEWTON);
        h / (self.error_norm.powf(0.25) / (SAFETY * newton.min(1.0))).clamp(0.125, 5.0)
    }
}

impl Stepper for Radau5 {
    fn properties(&self) -> Properties {
        Properties {
            order: 3,
            takes_mass_matrix: true,
            step_with_event: StepWithEvent::RepeatedToIt,
            takes_long_steps: true,
            takes_jacobians: true,
            ..Properties::default()
        }
    }

    fn begin<S: HybridSystem + ?Sized>(&mut self, system: &S) -> CallResult<()> {
        let n = system.n_states();
        self.jacobian.begin(system)?;
        match (system.mass_matrix(), &mut self.mass) {
            (None, mass) => *mass = None,
            (Some(m), Some(mass)) => {
                mass.clear();
                mass.extend_from_slice(m);
            }
            (Some(m), mass) => *mass = Some(m.to_vec()),
        }
        if let Some(mass) = &self.mass {
            self.algebraic.begin(n, mass)?;
        }
        // A mass matrix has places of its own.
        let pattern = self.jacobian.pattern().filter(|_| self.mass.is_none());
        self.real.begin(n, pattern)?;
        self.complex.begin(n, pattern)?;
        self.trial.begin(n);
        self.last.begin(n);
        self.terms.begin(n);
        let Self { f, f_new, stage_x, inverse, error, z, w, stage_f, .. } = self;
        let single = [f, f_new, stage_x, inverse, error];
        let triple = [z, w, stage_f];
        for v in single.into_iter().chain(triple.into_iter().flatten()) {
            v.clear();
            v.resize(n, 0.0);
        }
        self.complex_rhs.resize(n, Complex::new(0.0, 0.0));
        self.decomposed_h = 0.0;
        self.has_jacobian = false;
        self.jacobian_is_fresh = false;
        self.wants_jacobian = false;
        self.forget();
        Ok(())
    }

    fn evaluate<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        t: f64,
        x: &[f64],
    ) -> CallResult<()> {
        self.jacobian_is_fresh = false;
        self.f_new.copy_from_slice(&self.f);
        equations.derivatives(t, x, &mut self.f)?;
        // A change below the tolerance is one all the same: crossings are looked for inside of steps.
        self.can_extrapolate &= self.f == self.f_new;
        Ok(())
    }

    fn make_consistent<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        t: f64,
        x: &mut [f64],
    ) -> CallResult<Consistency> {
        if self.mass.is_none() {
            return Ok(Consistency::Holds);
        }
        let before = equations.stats.jacobians;
        let Self { algebraic, jacobian, f, has_jacobian, .. } = self;
        let found = algebraic.make_consistent(equations, (t, x, f), (jacobian, *has_jacobian))?;
        if equations.stats.jacobians > before {
            // Where nothing was changed it is of the current point.
            self.has_jacobian = found == Consistency::Holds;
            self.jacobian_is_fresh = self.has_jacobian;
            self.wants_jacobian = false;
            self.decomposed_h = 0.0;
        }
        Ok(found)
    }

    fn forget(&mut self) {
        self.is_repetition = false;
        self.can_extrapolate = false;
        self.fac_convergence = 1.0;
        self.first = true;
        self.after_rejection = false;
        self.last_h = 0.0;
        self.last_error = 1e-2;
        self.theta = KEEP_JACOBIAN;
        self.at_kink = false;
        self.kink_h = f64::INFINITY;
    }

    fn kink(&mut self, h: f64) -> f64 {
        self.can_extrapolate = false;
        self.at_kink = true;
        h.min(self.kink_h)
    }

    fn repeat(&mut self) {
        self.is_repetition = true;
    }

    fn undetermined<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        t: f64,
        x: &[f64],
    ) -> Option<usize> {
        self.mass.as_ref()?;
        self.has_jacobian = false;
        self.algebraic.undetermined(equations, &mut self.jacobian, t, x)
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
        // The error estimate is of order 3, the solution of order 5: a larger tolerance for the estimate, so that the
        // error of the solution is about what was asked for (radau5, "tolerance transform").
        let rtol = TRANSFORM * equations.weights.rtol().powf(2.0 / 3.0);
        equations.weights.inverse_at(x, equations.weights.rtol() / rtol, &mut self.inverse);
        let newton_tolerance = (10.0 * U / rtol).max(rtol.sqrt().min(0.03));
        loop {
            if !self.has_jacobian || self.wants_jacobian {
                self.jacobian.evaluate(equations, (t, x, &self.f))?;
                self.has_jacobian = true;
                self.spectrum = None;
                self.jacobian_is_fresh = true;
                self.wants_jacobian = false;
                self.decomposed_h = 0.0;
            }
            if self.decomposed_h != h && !self.decompose(h, equations.stats) {
                if self.jacobian_is_fresh {
                    self.after_rejection = true;
                    return Ok(Attempt::NotSolved { h: 0.5 * h });
                }
                self.wants_jacobian = true;
                continue;
            }
            match self.newton(equations, trial, newton_tolerance)? {
                Newton::Converged => break,
                Newton::Failed(_) if !self.jacobian_is_fresh => self.wants_jacobian = true,
                Newton::Failed(share) => {
                    self.after_rejection = true;
                    return Ok(Attempt::NotSolved { h: share * h });
                }
            }
        }
        let at_end = self.estimate_error(equations, trial)?;
        self.trial.set(h, &self.z);
        let last = self.can_extrapolate.then_some(&self.last);
        let inside = self.terms.bend(&self.trial, last, &self.inverse) * (rtol / equations.weights.rtol());
        self.error_norm = at_end.max(inside);
        if !self.error_norm.is_finite() {
            return Err(CallError::Discard);
        }
        for ((new, x), z) in x_new.iter_mut().zip(x).zip(&self.z[2]) {
            *new = x + z;
        }
        if self.error_norm >= 1.0 {
            let h_new = if self.first { 0.1 * h } else { self.wanted(h).min(0.9 * h) };
            self.after_rejection = true;
            self.wants_jacobian = !self.jacobian_is_fresh && self.jacobian.cost() <= CHEAP_JACOBIAN;
            return Ok(Attempt::TooInexact { h: h_new });
        }
        equations.derivatives(end, x_new, &mut self.f_new)?;
        if !self.f_new.iter().sum::<f64>().is_finite() {
            return Err(CallError::Discard);
        }
        Ok(Attempt::Good)
    }

    fn error(&self) -> &[f64] {
        &self.error
    }

    fn refused(&mut self, h: f64) -> f64 {
        self.after_rejection = true;
        0.25 * h
    }

    fn interpolate(&self, trial: Trial<'_>, theta: f64, x: &mut [f64]) {
        let value = self.terms.value(&self.trial, theta);
        for (i, out) in x.iter_mut().enumerate() {
            *out = trial.x[i] + self.z[2][i] + value(i);
        }
    }

    fn accept(&mut self, h: f64, theta: f64) -> f64 {
        let mut proposed = self.wanted(h);
        if std::mem::take(&mut self.at_kink) {
            self.kink_h = proposed;
        }
        if self.last_h > 0.0 {
            // K. Gustafsson's predictive controller: Hairer and Wanner, (IV.8.27).
            let ratio = self.error_norm * self.error_norm / self.last_error;
            let quotient = self.last_h / h * ratio.powf(0.25) / SAFETY;
            proposed = proposed.min(h / quotient.clamp(0.125, 5.0));
        }
        if self.after_rejection {
            proposed = proposed.min(h);
        }
        self.last_h = h;
        self.last_error = self.error_norm.max(1e-2);
        self.first = false;
        self.after_rejection = false;
        self.jacobian_is_fresh = false;
        let slow = self.newton_count > 2 || self.jacobian.cost() <= CHEAP_JACOBIAN;
        self.wants_jacobian = slow && self.theta > KEEP_JACOBIAN;
        self.can_extrapolate = theta == 1.0;
        if self.can_extrapolate {
            std::mem::swap(&mut self.f, &mut self.f_new);
            std::mem::swap(&mut self.trial, &mut self.last);
        }
        // A little more is not worth a decomposition.
        if !self.wants_jacobian && (1.0..=1.2).contains(&(proposed / h)) { h } else { proposed }
    }
}
