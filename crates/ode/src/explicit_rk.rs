//! Explicit Runge-Kutta methods: one implementation for every tableau, with or without an error estimate.

use crate::control::{Controller, Weights};
use crate::stages::{combine, weighted_sum};
use crate::stepper::{Attempt, Equations, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};
use crate::tableau::Tableau;

/// An explicit method and its stages `k_i = f(t + c_i h, ...)`.
#[derive(Debug)]
pub(crate) struct ExplicitRk<const S: usize> {
    tableau: &'static Tableau<S>,
    k: [Vec<f64>; S],
    stage: Vec<f64>,
    error: Vec<f64>,
    error_norm: f64,
    controller: Controller,
}

impl<const S: usize> ExplicitRk<S> {
    pub(crate) fn new(tableau: &'static Tableau<S>) -> Self {
        Self {
            tableau,
            k: std::array::from_fn(|_| Vec::new()),
            stage: Vec::new(),
            error: Vec::new(),
            error_norm: 0.0,
            controller: Controller::new(tableau.order),
        }
    }
}

impl<const S: usize> ExplicitRk<S> {
    /// How strongly the right-hand side answers to a change of the state, from the last two stages, which lie at the end
    /// of the step both: an estimate of the largest eigenvalue. For methods whose last but one abscissa is 1.
    pub(crate) fn response(&self, x: &[f64], x_new: &[f64], weights: &Weights) -> f64 {
        weights.ratio(x, (&self.k[S - 1], &self.k[S - 2]), (x_new, &self.stage))
    }

    /// Takes over in the middle of a run from a method that knows the right-hand side at the current point.
    pub(crate) fn take_over(&mut self, f: &[f64]) {
        self.k[0].copy_from_slice(f);
        self.forget();
    }
}

/// The first `weights.len()` stages with their weights.
fn terms<'a>(weights: &'a [f64], k: &'a [Vec<f64>]) -> impl Iterator<Item = (f64, &'a [f64])> + Clone {
    weights.iter().copied().zip(k.iter().map(Vec::as_slice))
}

impl<const S: usize> Stepper for ExplicitRk<S> {
    fn order(&self) -> u32 {
        self.tableau.order
    }

    fn has_error_estimate(&self) -> bool {
        self.tableau.error.is_some()
    }

    fn begin<M: HybridSystem + ?Sized>(&mut self, system: &M) -> CallResult<()> {
        let n = system.n_states();
        for k in &mut self.k {
            k.resize(n, 0.0);
        }
        self.stage.resize(n, 0.0);
        self.error.clear();
        self.error.resize(n, 0.0);
        self.controller.restart();
        Ok(())
    }

    fn evaluate<M: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, M>,
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

    fn try_step<M: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, M>,
        trial: Trial<'_>,
        x_new: &mut [f64],
    ) -> CallResult<Attempt> {
        let Trial { t, end, h, x } = trial;
        if x.is_empty() {
            return Ok(Attempt::Good);
        }
        for s in 1..S {
            let (known, rest) = self.k.split_at_mut(s);
            let last = s + 1 == S;
            let point = if last { &mut *x_new } else { &mut self.stage[..] };
            combine(point, x, h, terms(&self.tableau.a[s][..s], known));
            // The end of the step is met exactly: an input that jumps there must be asked at that very time.
            let c = self.tableau.c[s];
            let time = if c == 1.0 { end } else { t + c * h };
            equations.derivatives(time, point, &mut rest[0])?;
        }
        self.error_norm = match &self.tableau.error {
            Some(weights_of_error) => {
                weighted_sum(&mut self.error, h, terms(weights_of_error, &self.k));
                equations.weights.error_norm(x, x_new, &self.error)
            }
            // A sum is finite unless something in it is not; no need to look at each number.
            None if x_new.iter().sum::<f64>().is_finite() => 0.0,
            None => f64::NAN,
        };
        if self.error_norm.is_nan() {
            return Err(CallError::Discard);
        }
        if self.error_norm > 1.0 {
            return Ok(Attempt::TooInexact { h: h * self.controller.rejected(self.error_norm) });
        }
        Ok(Attempt::Good)
    }

    fn error(&self) -> &[f64] {
        &self.error
    }

    fn refused(&mut self, h: f64) -> f64 {
        h * self.controller.discarded()
    }

    fn interpolate(&self, trial: Trial<'_>, theta: f64, x: &mut [f64]) {
        combine(x, trial.x, trial.h, terms(&self.tableau.dense_weights(theta), &self.k));
    }

    fn accept(&mut self, h: f64, theta: f64) -> f64 {
        if theta == 1.0 {
            self.k.swap(0, S - 1);
        }
        h * self.controller.accepted(self.error_norm)
    }
}
