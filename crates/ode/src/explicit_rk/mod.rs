//! Explicit Runge-Kutta methods: one implementation for every tableau, with or without an error estimate.

use crate::error_norm::ErrorWeights;
use crate::stages::Stages;
use crate::step_size::StepController;
use crate::stepper::{Attempt, Equations, Properties, StepWithEvent, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};
use crate::tableau::{Dense, Estimate, Explicit, by_power, polynomial_weights, row};
use continuous::{TERMS, dense_terms, factors};
use std::marker::PhantomData;

mod continuous;
mod dop853;

pub(crate) use dop853::Dop853;

/// An explicit method and its stages `k_i = f(t + c_i h, ...)`.
#[derive(Debug)]
pub(crate) struct ExplicitRk<const S: usize, T> {
    tableau: PhantomData<T>,
    /// Coefficients of the continuous extension, if it is polynomial.
    polynomials: Option<[[f64; S]; 4]>,
    k: Stages<S>,
    stage: Vec<f64>,
    error: Vec<f64>,
    error_norm: f64,
    /// Terms of a continuous extension that has additional stages.
    dense: Stages<TERMS>,
    controller: StepController,
}

impl<const S: usize, T: Explicit<S>> ExplicitRk<S, T> {
    pub(crate) fn new() -> Self {
        Self {
            tableau: PhantomData,
            polynomials: match &T::TABLEAU.dense {
                Dense::Polynomials(polynomials) => Some(by_power(polynomials)),
                Dense::Terms(_) => None,
            },
            k: Stages::default(),
            stage: Vec::new(),
            error: Vec::new(),
            error_norm: 0.0,
            dense: Stages::default(),
            controller: StepController::new(T::TABLEAU.order),
        }
    }

    /// Estimates the largest eigenvalue: the change of the right-hand side per change of the state between
    /// the last two stages. Requires a method whose last but one abscissa is 1, so that both stages are at
    /// the end of the step.
    pub(crate) fn response(&self, x: &[f64], x_new: &[f64], weights: &ErrorWeights) -> f64 {
        let end = T::TABLEAU.end;
        weights.ratio(x, [self.k.get(end), self.k.get(end - 1)], [x_new, &self.stage])
    }

    /// Continues a run of another method that knows the right-hand side at the current point.
    pub(crate) fn take_over(&mut self, f: &[f64]) {
        self.k.get_mut(0).copy_from_slice(f);
        self.forget();
    }

    fn has_stages_behind_end(&self) -> bool {
        T::TABLEAU.end + 1 < S
    }

    /// Computes the state at which a stage is evaluated.
    #[inline]
    fn sum(k: &Stages<S>, s: usize, h: f64, x: &[f64], out: &mut [f64]) {
        macro_rules! of_stage {
            ($($row:literal)+) => {
                match s {
                    $($row => {
                        let weights = const { row::<S, T>($row) };
                        k.combine(out, x, weights.iter().copied(), |sum, x| x + h * sum);
                    })+
                    _ => {}
                }
            };
        }
        of_stage!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);
    }

    /// Evaluates a stage other than the solution.
    fn stage(
        &mut self,
        equations: &mut Equations<'_>,
        s: usize,
        Trial { t, end, h, x }: Trial<'_>,
    ) -> CallResult<()> {
        Self::sum(&self.k, s, h, x, &mut self.stage);
        // The end of the step is used exactly, because an input that jumps there must be evaluated at that
        // time.
        let c = T::TABLEAU.c[s];
        let time = if c == 1.0 { end } else { t + c * h };
        equations.derivatives(time, &self.stage, self.k.get_mut(s))
    }

    /// Computes the error with these weights and returns its norm.
    #[inline(always)]
    fn error_by(
        &mut self,
        weights: &ErrorWeights,
        Trial { h, x, .. }: Trial<'_>,
        x_new: &[f64],
        of_error: &[(usize, f64)],
    ) -> f64 {
        self.k.combine(&mut self.error, x, of_error.iter().copied(), |sum, _| h * sum);
        weights.error_norm(x, x_new, &self.error)
    }
}

impl<const S: usize, T: Explicit<S>> Stepper for ExplicitRk<S, T> {
    fn properties(&self) -> Properties {
        let has_extra_stages = self.has_stages_behind_end();
        Properties {
            order: T::TABLEAU.order,
            has_error_estimate: !matches!(T::TABLEAU.error, Estimate::None),
            interior_samples: if has_extra_stages { 3 } else { 1 },
            step_with_event: if has_extra_stages {
                StepWithEvent::RepeatedToBefore
            } else {
                StepWithEvent::Interpolated
            },
            ..Properties::default()
        }
    }

    fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()> {
        let n = system.n_states();
        let has_extra_stages = self.has_stages_behind_end();
        self.k.begin(n);
        self.dense.begin(if has_extra_stages { n } else { 0 });
        for v in [&mut self.stage, &mut self.error] {
            v.clear();
            v.resize(n, 0.0);
        }
        self.controller.restart();
        Ok(())
    }

    fn evaluate(&mut self, equations: &mut Equations<'_>, t: f64, x: &[f64]) -> CallResult<()> {
        equations.derivatives(t, x, self.k.get_mut(0))
    }

    fn forget(&mut self) {
        self.controller.restart();
    }

    fn derivative(&self) -> &[f64] {
        self.k.get(0)
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
        let last = T::TABLEAU.end;
        for s in 1..last {
            self.stage(equations, s, trial)?;
        }
        Self::sum(&self.k, last, h, x, x_new);
        // If the estimate does not use the stage at the end, a rejected step saves that evaluation.
        let spares_end = matches!(T::TABLEAU.error, Estimate::Two(..));
        if !spares_end {
            equations.derivatives(end, x_new, self.k.get_mut(last))?;
        }
        self.error_norm = match T::TABLEAU.error {
            Estimate::Embedded(error) => self.error_by(equations.weights, trial, x_new, error),
            Estimate::Two(fifth, third) => {
                let third = self.error_by(equations.weights, trial, x_new, third);
                let fifth = self.error_by(equations.weights, trial, x_new, fifth);
                let both = fifth.hypot(0.1 * third);
                if both == 0.0 { 0.0 } else { fifth * (fifth / both) }
            }
            // The sum is finite only if all values are, so they are not checked one by one.
            Estimate::None if x_new.iter().sum::<f64>().is_finite() => 0.0,
            Estimate::None => f64::NAN,
        };
        if self.error_norm.is_nan() {
            return Err(CallError::Discard);
        }
        if self.error_norm > 1.0 {
            return Ok(Attempt::TooInexact { h: h * self.controller.rejected(self.error_norm) });
        }
        if spares_end {
            let f = self.k.get_mut(last);
            equations.derivatives(end, x_new, f)?;
            if !f.iter().sum::<f64>().is_finite() {
                return Err(CallError::Discard);
            }
        }
        Ok(Attempt::Good)
    }

    fn error(&self) -> &[f64] {
        &self.error
    }

    fn refused(&mut self, h: f64) -> f64 {
        h * self.controller.discarded()
    }

    fn prepare_interpolation(
        &mut self,
        equations: &mut Equations<'_>,
        trial: Trial<'_>,
        _: &[f64],
    ) -> CallResult<()> {
        let Dense::Terms(highest) = &T::TABLEAU.dense else { return Ok(()) };
        if trial.x.is_empty() {
            return Ok(());
        }
        for s in T::TABLEAU.end + 1..S {
            self.stage(equations, s, trial)?;
        }
        dense_terms(&T::TABLEAU, highest, &self.k, trial.h, &mut self.dense);
        Ok(())
    }

    fn interpolate(&self, trial: Trial<'_>, theta: f64, x: &mut [f64]) {
        if let Some(polynomials) = &self.polynomials {
            let weights = polynomial_weights(polynomials, theta);
            let h = trial.h;
            return self.k.combine(x, trial.x, weights.iter().copied().enumerate(), |sum, x| x + h * sum);
        }
        let factors = factors(theta);
        self.dense.combine(x, trial.x, factors.iter().copied().enumerate(), |sum, x| x + sum);
    }

    fn accept(&mut self, h: f64, theta: f64) -> f64 {
        if theta == 1.0 {
            self.k.copy(T::TABLEAU.end, 0);
        }
        h * self.controller.accepted(self.error_norm)
    }
}
