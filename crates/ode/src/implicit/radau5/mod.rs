//! Radau IIA of order 5: three implicit stages, L-stable. For stiff systems and systems with a mass matrix.
//!
//! E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.8, and: Stiff differential
//! equations solved by Radau methods, Journal of Computational and Applied Mathematics 111 (1999) 93-111.
//!
//! The stages are written as increments `z_i = X_i - x` and transformed by `T` to the variables `w`. In
//! these, the Newton matrix separates into a real and a complex block of the size of the system.

use super::algebraic::Algebraic;
use super::kept_jacobian::{KeptJacobian, Matrix, Rules};
use super::newton::{Convergence, Newton};
use crate::error::Undetermined;
use crate::error_norm::scaled_norm;
use crate::stepper::{
    Attempt, Consistency, Equations, Point, PointMut, Properties, StepWithEvent, Stepper, Trial,
};
use crate::system::{CallError, CallResult, HybridSystem};
use num_complex::Complex;

mod coefficients;
mod dense;
mod stages;

use coefficients::{E, GAMMA};
use dense::{Collocation, Terms};
use stages::{StageEquations, Stages};

const U: f64 = f64::EPSILON / 2.0;
/// As in radau5 (its NIT).
const MAX_NEWTON: u32 = 7;
/// The decomposed matrix depends on the step size. The step size is therefore kept if a slightly larger one
/// does not justify a decomposition.
const RULES: Rules = Rules {
    change: 0.0,
    decomposition_steps: u32::MAX,
    jacobian_steps: u32::MAX,
    cheap: 4,
    only_after_events: false,
};
const SAFETY: f64 = 0.9;
/// Factor of the tolerance of the error estimate, with `rtol^(2/3)`. The estimate is of order 3 and the
/// solution of order 5. This factor makes the error roughly equal to the tolerance (radau5 uses 0.1).
const TRANSFORM: f64 = 0.08;

#[derive(Debug)]
pub(crate) struct Radau5 {
    freshness: KeptJacobian,
    convergence: Convergence,
    algebraic: Algebraic,
    stages: Stages,
    spectrum: Option<(f64, f64)>,
    f: Vec<f64>,
    f_new: Vec<f64>,
    /// Inverse weights of the norm.
    inverse: Vec<f64>,
    error: Vec<f64>,
    trial: Collocation,
    last: Collocation,
    terms: Terms,
    /// True if the last step ended at the current point and the solution continues without an event.
    can_extrapolate: bool,
    /// True if the next trial repeats the last good one with an earlier end.
    is_repetition: bool,
    error_norm: f64,
    /// Error and size of the last accepted step, for the predictive controller.
    last_error: f64,
    last_h: f64,
    after_rejection: bool,
    first: bool,
    /// True if the current point is a kink. `kink_h` is the step size proposed there by the last step.
    at_kink: bool,
    kink_h: f64,
}

impl Default for Radau5 {
    fn default() -> Self {
        Self {
            freshness: KeptJacobian::new(RULES),
            convergence: Convergence::new(MAX_NEWTON),
            algebraic: Algebraic::default(),
            stages: Stages::default(),
            spectrum: None,
            f: Vec::new(),
            f_new: Vec::new(),
            inverse: Vec::new(),
            error: Vec::new(),
            trial: Collocation::default(),
            last: Collocation::default(),
            terms: Terms::default(),
            can_extrapolate: false,
            is_repetition: false,
            error_norm: 0.0,
            last_error: 0.0,
            last_h: 0.0,
            after_rejection: false,
            first: false,
            at_kink: false,
            kink_h: 0.0,
        }
    }
}

impl Radau5 {
    /// Returns the spectral radius of the last Jacobian and the cosine between the last vector and its image.
    /// Vector iteration gives the radius as the mean growth over the last half of twenty products, so that
    /// complex pairs contribute their modulus. The cosine is -1 if the largest eigenvalue is real and
    /// negative. It is 0 if the growth alternates, as for two eigenvalues of opposite sign (a saddle, for
    /// example bodies that pass each other closely). Computed once per Jacobian.
    pub(crate) fn spectrum(&mut self) -> (f64, f64) {
        const HALF: i32 = 10;
        // Of 81 runs of the Pleiades at rtol 1e-2 to 1e-4, one fails (BDF spirals inward). With 2, two fail;
        // without this rule, four.
        const STEADY: f64 = 1.1;
        if let Some(spectrum) = self.spectrum {
            return spectrum;
        }
        let Self { freshness, inverse, stages: Stages { point: v, .. }, error: product, .. } = self;
        for (i, (v, inverse)) in v.iter_mut().zip(&*inverse).enumerate() {
            *v = (1.0 + 0.1 * i as f64) / inverse;
        }
        let (mut growth, mut cosine, mut last) = (1.0, 0.0, 0.0);
        for count in 0..2 * HALF {
            product.fill(0.0);
            freshness.jacobian().each(|i, k, j| product[i] += j * v[k]);
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
            let factor = after / before;
            if factor > STEADY * last || last > STEADY * factor {
                cosine = 0.0;
            }
            last = factor;
            v.iter_mut().zip(&*product).for_each(|(v, p)| *v = p / after);
        }
        *self.spectrum.insert((growth, cosine))
    }

    /// Rate of convergence of Newton's method in the last step; 0 if one iteration was enough.
    pub(crate) fn contraction(&self) -> f64 {
        if self.convergence.count() > 1 { self.convergence.rate() } else { 0.0 }
    }

    /// The Jacobian, to be transferred to another method.
    pub(crate) fn freshness_mut(&mut self) -> &mut KeptJacobian {
        &mut self.freshness
    }

    /// Continues a run of another method that knows the right-hand side at the current point.
    pub(crate) fn take_over(&mut self, f: &[f64]) {
        self.f.copy_from_slice(f);
        self.freshness.drop_jacobian();
        self.forget();
    }

    /// Computes the weighted error of the embedded formula. If necessary, it is computed again from the point
    /// that the first estimate leads to.
    fn estimate_error(
        &mut self,
        equations: &mut Equations<'_>,
        Trial { t, h, x, .. }: Trial<'_>,
    ) -> CallResult<f64> {
        let n = x.len();
        let Stages { mass, real, z, f: stage_f, point, .. } = &mut self.stages;
        for i in 0..n {
            point[i] = (E[0] * z[0][i] + E[1] * z[1][i] + E[2] * z[2][i]) / h;
        }
        let slopes = &mut stage_f[0];
        match mass {
            None => slopes.copy_from_slice(point),
            Some(m) => {
                for (i, s) in slopes.iter_mut().enumerate() {
                    *s = (0..n).map(|k| m[i + n * k] * point[k]).sum();
                }
            }
        }
        for ((e, s), f) in self.error.iter_mut().zip(&*slopes).zip(&self.f) {
            *e = s + f;
        }
        equations.stats.linear_algebra += real.operations().1;
        real.solve(&mut self.error);
        for (d, e) in self.terms.defect.iter_mut().zip(&self.error) {
            *d = GAMMA * e;
        }
        let norm = scaled_norm(&self.error, &self.inverse);
        if norm < 1.0 || !(self.first || self.after_rejection) {
            return Ok(norm.max(1e-10));
        }
        for ((p, x), e) in point.iter_mut().zip(x).zip(&self.error) {
            *p = x + e;
        }
        match equations.derivatives(t, point, &mut stage_f[1]) {
            Ok(()) => {}
            // The first estimate is used.
            Err(CallError::Discard) => return Ok(norm),
            Err(failed) => return Err(failed),
        }
        let [defect, slope, _] = stage_f;
        for ((e, slope), defect) in self.error.iter_mut().zip(&*slope).zip(&*defect) {
            *e = slope + defect;
        }
        equations.stats.linear_algebra += real.operations().1;
        real.solve(&mut self.error);
        Ok(scaled_norm(&self.error, &self.inverse).max(1e-10))
    }

    /// Returns the step size required by the error alone.
    fn wanted(&self, h: f64) -> f64 {
        let newton = f64::from(1 + 2 * MAX_NEWTON) / f64::from(self.convergence.count() + 2 * MAX_NEWTON);
        h / (self.error_norm.powf(0.25) / (SAFETY * newton.min(1.0))).clamp(0.125, 5.0)
    }
}

impl Stepper for Radau5 {
    fn properties(&self) -> Properties {
        Properties {
            order: 3,
            takes_mass_matrix: true,
            step_with_event: StepWithEvent::RepeatedToIt,
            interior_samples: 3,
            takes_jacobians: true,
            ..Properties::default()
        }
    }

    fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()> {
        let n = system.n_states();
        self.freshness.begin(system)?;
        match (system.mass_matrix(), &mut self.stages.mass) {
            (None, mass) => *mass = None,
            (Some(m), Some(mass)) => {
                mass.clear();
                mass.extend_from_slice(m);
            }
            (Some(m), mass) => *mass = Some(m.to_vec()),
        }
        if let Some(mass) = &self.stages.mass {
            self.algebraic.begin(n, mass, 0.0)?;
        }
        let Self { f, f_new, inverse, error, stages, .. } = self;
        // The mass matrix has entries outside the pattern.
        let pattern = self.freshness.jacobian().pattern().filter(|_| stages.mass.is_none());
        stages.real.begin(n, pattern)?;
        stages.complex.begin(n, pattern)?;
        self.trial.begin(n);
        self.last.begin(n);
        self.terms.begin(n);
        let Stages { point, complex_rhs, z, w, f: stage_f, .. } = stages;
        let single = [f, f_new, point, inverse, error];
        let triple = [z, w, stage_f];
        for v in single.into_iter().chain(triple.into_iter().flatten()) {
            v.clear();
            v.resize(n, 0.0);
        }
        complex_rhs.resize(n, Complex::new(0.0, 0.0));
        self.forget();
        Ok(())
    }

    fn evaluate(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> CallResult<()> {
        self.freshness.moved();
        self.f_new.copy_from_slice(&self.f);
        equations.derivatives(t, x, &mut self.f)?;
        // A change below the tolerance also counts, because crossings are located inside steps.
        self.can_extrapolate &= self.f == self.f_new;
        Ok(())
    }

    fn make_consistent(
        &mut self,
        equations: &mut Equations<'_>,
        t: f64,
        x: &mut [f64],
    ) -> CallResult<Consistency> {
        if self.stages.mass.is_none() {
            return Ok(Consistency::Holds);
        }
        let before = equations.stats.jacobians;
        let Self { algebraic, freshness, f, .. } = self;
        let (jacobian, has_jacobian) = freshness.jacobian_mut();
        let point = PointMut { t, x, slopes: f };
        let found = algebraic.make_consistent(equations, point, jacobian, has_jacobian)?;
        if equations.stats.jacobians > before {
            // If nothing was changed, the Jacobian is valid for the current point.
            freshness.take_new(found == Consistency::Holds);
        }
        Ok(found)
    }

    fn forget(&mut self) {
        self.is_repetition = false;
        self.can_extrapolate = false;
        self.convergence.forget();
        self.first = true;
        self.after_rejection = false;
        self.last_h = 0.0;
        self.last_error = 1e-2;
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

    fn undetermined(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> Option<Undetermined> {
        self.stages.mass.as_ref()?;
        self.freshness.drop_jacobian();
        self.algebraic.undetermined(equations, self.freshness.jacobian_mut().0, t, x)
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
        let Trial { t, end, h, x } = trial;
        if x.is_empty() {
            return Ok(Attempt::Good);
        }
        // The error estimate is of order 3, the solution of order 5. The tolerance of the estimate is
        // enlarged so that the error of the solution roughly equals the requested tolerance (radau5,
        // "tolerance transform").
        let rtol = TRANSFORM * equations.weights.rtol().powf(2.0 / 3.0);
        equations.weights.inverse_at(x, equations.weights.rtol() / rtol, &mut self.inverse);
        let newton_tolerance = (10.0 * U / rtol).max(rtol.sqrt().min(0.03));
        loop {
            let before = equations.stats.jacobians;
            let Self { freshness, stages, .. } = self;
            let point = Point { t, x, slopes: &self.f };
            let decompose = |jacobian: &_, stats: &mut _| stages.decompose(jacobian, h, stats);
            let matrix = freshness.prepare(equations, h, point, decompose)?;
            if equations.stats.jacobians > before {
                self.spectrum = None;
            }
            if matrix == Matrix::Singular {
                self.after_rejection = true;
                return Ok(Attempt::NotSolved { h: 0.5 * h });
            }
            let longer = std::mem::take(&mut self.is_repetition).then_some(&self.trial);
            self.stages.guess(h, self.can_extrapolate.then_some(&self.last), longer);
            let mut iteration = StageEquations { stages: &mut self.stages, trial, inverse: &self.inverse };
            match self.convergence.iterate(equations, &mut iteration, newton_tolerance, 0.0, 1)? {
                Newton::Converged => break,
                Newton::Failed(_) if self.freshness.renew_after_failure(h) => {}
                Newton::Failed(share) => {
                    self.after_rejection = true;
                    return Ok(Attempt::NotSolved { h: share * h });
                }
            }
        }
        let at_end = self.estimate_error(equations, trial)?;
        self.trial.set(h, &self.stages.z);
        let last = self.can_extrapolate.then_some(&self.last);
        let inside = self.terms.bend(&self.trial, last, &self.inverse) * (rtol / equations.weights.rtol());
        self.error_norm = at_end.max(inside);
        if !self.error_norm.is_finite() {
            return Err(CallError::Discard);
        }
        for ((new, x), z) in x_new.iter_mut().zip(x).zip(&self.stages.z[2]) {
            *new = x + z;
        }
        if self.error_norm >= 1.0 {
            let h_new = if self.first { 0.1 * h } else { self.wanted(h).min(0.9 * h) };
            self.after_rejection = true;
            self.freshness.rejected();
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
            *out = trial.x[i] + self.stages.z[2][i] + value(i);
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
        self.freshness.accepted(self.convergence.count(), self.convergence.rate());
        self.can_extrapolate = theta == 1.0;
        if self.can_extrapolate {
            std::mem::swap(&mut self.f, &mut self.f_new);
            std::mem::swap(&mut self.trial, &mut self.last);
        }
        // A slightly larger step does not justify a decomposition.
        if !self.freshness.needs_jacobian() && (1.0..=1.2).contains(&(proposed / h)) { h } else { proposed }
    }
}
