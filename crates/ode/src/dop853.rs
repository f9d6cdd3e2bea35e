//! DOP853: an explicit Runge-Kutta method of order 8 for tight tolerances, whose dense output (three more evaluations) is
//! made only for steps that somebody looks into.

use crate::control::Controller;
use crate::stages::{combine, weighted_sum};
use crate::stepper::{Attempt, Equations, StepWithEvent, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};
use tableau::{A, C, DENSE, ERROR_3, ERROR_5, STAGES, Weights};

mod tableau;

/// The stage that is the right-hand side at the end of the step.
const END: usize = 12;
/// Terms of the continuous extension.
const TERMS: usize = 7;

#[derive(Debug)]
pub(crate) struct Dop853 {
    k: [Vec<f64>; STAGES],
    stage: Vec<f64>,
    error: Vec<f64>,
    error_norm: f64,
    /// `x + theta (d_0 + (1 - theta) (d_1 + theta (d_2 + ...)))`.
    dense: [Vec<f64>; TERMS],
    controller: Controller,
}

impl Default for Dop853 {
    fn default() -> Self {
        Self {
            k: Default::default(),
            stage: Vec::new(),
            error: Vec::new(),
            error_norm: 0.0,
            dense: Default::default(),
            controller: Controller::of_high_order(8),
        }
    }
}

/// The stages with weights other than zero.
fn terms(weights: Weights, k: &[Vec<f64>; STAGES]) -> impl Iterator<Item = (f64, &[f64])> + Clone {
    weights.iter().map(|(j, w)| (*w, &k[*j][..]))
}

/// `sum_j w_j k_j` of one component.
fn sum(weights: Weights, k: &[Vec<f64>; STAGES], i: usize) -> f64 {
    terms(weights, k).map(|(w, k)| w * k[i]).sum()
}

/// The terms of the continuous extension, of one component of a step of size `h`.
fn dense_terms(k: &[Vec<f64>; STAGES], h: f64, i: usize) -> [f64; TERMS] {
    let (start, end, change) = (h * k[0][i], h * k[END][i], h * sum(A[END], k, i));
    let [d3, d4, d5, d6] = DENSE.map(|weights| h * sum(weights, k, i));
    [change, start - change, 2.0 * change - (start + end), d3, d4, d5, d6]
}

/// The factor of each term at `theta`.
fn factors(theta: f64) -> [f64; TERMS] {
    let mut product = theta;
    std::array::from_fn(|term| {
        let now = product;
        product *= if term % 2 == 0 { 1.0 - theta } else { theta };
        now
    })
}

/// Weights of the stages in the continuous extension at `theta`.
#[cfg(test)]
pub(crate) fn dense_weights(theta: f64) -> [f64; STAGES] {
    std::array::from_fn(|stage| {
        let k = std::array::from_fn(|j| vec![f64::from(j == stage)]);
        dense_terms(&k, 1.0, 0).iter().zip(factors(theta)).map(|(d, f)| d * f).sum()
    })
}

impl Dop853 {
    /// As of [`ExplicitRk`](crate::explicit_rk::ExplicitRk): the last two stages lie at the end of the step both.
    pub(crate) fn response(&self, x: &[f64], x_new: &[f64], weights: &crate::control::Weights) -> f64 {
        weights.ratio(x, (&self.k[END], &self.k[END - 1]), (x_new, &self.stage))
    }

    /// Takes over in the middle of a run from a method that knows the right-hand side at the current point.
    pub(crate) fn take_over(&mut self, f: &[f64]) {
        self.k[0].copy_from_slice(f);
        self.forget();
    }

    fn stage<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        s: usize,
        Trial { t, end, h, x }: Trial<'_>,
    ) -> CallResult<()> {
        combine(&mut self.stage, x, h, terms(A[s], &self.k));
        let time = if C[s] == 1.0 { end } else { t + C[s] * h };
        equations.derivatives(time, &self.stage, &mut self.k[s])
    }
}

impl Stepper for Dop853 {
    fn order(&self) -> u32 {
        8
    }

    fn has_error_estimate(&self) -> bool {
        true
    }

    fn takes_long_steps(&self) -> bool {
        true
    }

    fn step_with_event(&self) -> StepWithEvent {
        StepWithEvent::RepeatedToBefore
    }

    fn begin<S: HybridSystem + ?Sized>(&mut self, system: &S) -> CallResult<()> {
        let n = system.n_states();
        let Self { k, stage, error, dense, .. } = self;
        for v in k.iter_mut().chain(dense).chain([stage, error]) {
            v.clear();
            v.resize(n, 0.0);
        }
        self.controller.restart();
        Ok(())
    }

    fn evaluate<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        t: f64,
        x: &[f64],
    ) -> CallResult<()> {
        equations.derivatives(t, x, &mut self.k[0])
    }

    fn forget(&mut self) {
        self.controller.restart();
    }

    fn derivative(&self) -> &[f64] {
        &self.k[0]
    }

    fn try_step<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        trial: Trial<'_>,
        x_new: &mut [f64],
    ) -> CallResult<Attempt> {
        let Trial { end, h, x, .. } = trial;
        if x.is_empty() {
            return Ok(Attempt::Good);
        }
        for s in 1..END {
            self.stage(equations, s, trial)?;
        }
        combine(x_new, x, h, terms(A[END], &self.k));
        weighted_sum(&mut self.error, h, terms(ERROR_3, &self.k));
        let third = equations.weights.error_norm(x, x_new, &self.error);
        weighted_sum(&mut self.error, h, terms(ERROR_5, &self.k));
        // Of order 8 at a smooth place: the estimate of order 5, made smaller where that of order 3 is larger still.
        let fifth = equations.weights.error_norm(x, x_new, &self.error);
        let both = fifth.hypot(0.1 * third);
        self.error_norm = if both == 0.0 { 0.0 } else { fifth * (fifth / both) };
        if self.error_norm.is_nan() {
            return Err(CallError::Discard);
        }
        if self.error_norm > 1.0 {
            return Ok(Attempt::TooInexact { h: h * self.controller.rejected(self.error_norm) });
        }
        equations.derivatives(end, x_new, &mut self.k[END])?;
        if !self.k[END].iter().sum::<f64>().is_finite() {
            return Err(CallError::Discard);
        }
        Ok(Attempt::Good)
    }

    fn error(&self) -> &[f64] {
        &self.error
    }

    fn refused(&mut self, h: f64) -> f64 {
        h * self.controller.discarded()
    }

    fn prepare_interpolation<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        trial: Trial<'_>,
        _: &[f64],
    ) -> CallResult<()> {
        if trial.x.is_empty() {
            return Ok(());
        }
        for s in END + 1..STAGES {
            self.stage(equations, s, trial)?;
        }
        for i in 0..trial.x.len() {
            let terms = dense_terms(&self.k, trial.h, i);
            self.dense.iter_mut().zip(terms).for_each(|(d, term)| d[i] = term);
        }
        Ok(())
    }

    fn interpolate(&self, trial: Trial<'_>, theta: f64, x: &mut [f64]) {
        let factors = factors(theta);
        for (i, (out, x)) in x.iter_mut().zip(trial.x).enumerate() {
            *out = x + self.dense.iter().zip(&factors).map(|(d, f)| d[i] * f).sum::<f64>();
        }
    }

    fn accept(&mut self, h: f64, theta: f64) -> f64 {
        if theta == 1.0 {
            self.k.swap(0, END);
        }
        h * self.controller.accepted(self.error_norm)
    }
}
