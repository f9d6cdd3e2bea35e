//! Fits of the other parameters with one parameter fixed.

use crate::error::CalibrationError;
use crate::loaded::calibration::Calibration;
use crate::problem::objective::reweighted_by_likelihood;
use crate::problem::parameter::{Parameter, Scale};
use crate::uncertainty::scores::Criterion;
use base::RunContext;
use dfo::{
    Answer, AnyMethod, ByRef, EvaluationKind, LeastSquares, Limits, Objective, ParameterKind, QuadraticModel,
    Query, RobustLoss, RunOptions, Termination, Tolerances,
};
use ode::Stats;
use std::sync::Mutex;

/// Initial radius and final tolerance of a refit, in standard errors. The statistic is quadratic in them, so
/// the tolerance leaves an error of 1e-4 in the statistic.
const RADIUS: f64 = 0.3;
const X_TOL: f64 = 0.01;

/// Accuracy of the cost, as a part of the threshold.
pub(super) const F_TOL: f64 = 1e-4;

/// Maximum number of evaluations of a refit per parameter. Least squares requires about 5.
const EVALUATIONS: usize = 60;

/// Refits of a calibration.
pub(super) struct Refits<'a> {
    pub(super) calibration: &'a Calibration,
    /// Cost as a function of the residuals. The likelihood is minimised as a sum of squares.
    pub(super) criterion: Criterion,
    /// Parameters that are always fixed.
    pub(super) held: &'a [usize],
    /// Typical steps in the coordinates of the search: standard errors, if they are known.
    pub(super) sizes: Vec<f64>,
    /// Relative differences of the cost below this value count as zero.
    pub(super) f_tol: f64,
    pub(super) stats: Mutex<Stats>,
}

/// Best values of a refit, and their sum of squares.
pub(super) struct Refitted {
    pub(super) x: Vec<f64>,
    pub(super) cost: f64,
}

/// Reason why a refit failed.
pub(super) enum NoFit {
    Cancelled,
    Failed(String),
}

impl Objective for Refits<'_> {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        let mut stats = Stats::default();
        self.calibration.evaluate_counted(x, query, self.residual_loss(), None, answer, &mut stats);
        let criteria = self.calibration.take_criteria(&mut answer.residuals);
        if self.criterion == Criterion::Likelihood && answer.outcome.value().is_some() {
            let layout = self.calibration.residual_layout();
            answer.residuals = reweighted_by_likelihood(layout, &answer.residuals);
            answer.outcome = RobustLoss::default().cost(&mut answer.residuals, f64::INFINITY);
        }
        *self.stats.lock().unwrap_or_else(|e| e.into_inner()) += stats;
        self.calibration.constraints().nonlinear(x, &criteria, &mut answer.constraints);
        if query.kind == EvaluationKind::Cost {
            answer.residuals.clear();
        }
    }

    fn has_residuals(&self) -> bool {
        true
    }

    fn residual_loss(&self) -> RobustLoss {
        match self.criterion {
            Criterion::Loss(loss) => loss,
            Criterion::Likelihood => RobustLoss::default(),
        }
    }
}

impl Refits<'_> {
    /// Returns the unconstrained minimum of the cost.
    ///
    /// # Errors
    /// Returns an error if no minimum is found or its cost is zero. Also returns
    /// [`CalibrationError::Cancelled`].
    pub(super) fn optimum(
        &self,
        start: &[f64],
        n_simulations: &mut usize,
        context: &RunContext<'_>,
    ) -> Result<Refitted, CalibrationError> {
        match self.refit(start, None, n_simulations, context) {
            Ok(optimum) if optimum.cost > 0.0 && optimum.cost.is_finite() => Ok(optimum),
            Ok(_) => Err(CalibrationError::Setup(
                "all residuals are zero, so there is no noise for a profile likelihood".to_owned(),
            )),
            Err(NoFit::Cancelled) => Err(CalibrationError::Cancelled),
            Err(NoFit::Failed(message)) => {
                Err(CalibrationError::Setup(format!("the optimum of the cost was not found: {message}")))
            }
        }
    }

    /// Returns the best values with one parameter fixed at its value in `start`.
    pub(super) fn refit(
        &self,
        start: &[f64],
        held: Option<usize>,
        n_simulations: &mut usize,
        context: &RunContext<'_>,
    ) -> Result<Refitted, NoFit> {
        let failed = |error: dfo::Error| match error {
            dfo::Error::EndedWithoutPoint { termination: Termination::Interrupted, .. } => NoFit::Cancelled,
            error => NoFit::Failed(CalibrationError::from(error).to_string()),
        };
        let parameters = self.calibration.parameters();
        let is_held = |i: usize| held == Some(i) || self.held.contains(&i);
        let bound = |side: fn(&Parameter) -> f64| -> Vec<f64> {
            let by_parameter = parameters.iter().enumerate();
            by_parameter.map(|(i, p)| if is_held(i) { start[i] } else { side(p) }).collect()
        };
        let transforms: Vec<Scale> = parameters.iter().map(Parameter::scale_kind).collect();
        let sizes: Vec<Option<f64>> = self.sizes.iter().map(|size| Some(*size)).collect();
        let tolerances = Tolerances { x_tol: X_TOL, f_tol: self.f_tol, ..Tolerances::default() };
        let n_free = (0..start.len()).filter(|i| !is_held(*i)).count();
        let limits = Limits { max_evaluations: Some(EVALUATIONS * (n_free + 1)), ..Limits::default() };
        let tolerance = dfo::Constraints::default().tolerance;
        let constraints = self.calibration.constraints().of_search(tolerance);
        let method: AnyMethod = if constraints.nonlinear.is_empty() {
            LeastSquares::default().radius(RADIUS).into()
        } else {
            QuadraticModel::default().radius(RADIUS).into()
        };
        let workers = Some(1);
        let options =
            RunOptions { method, tolerances, limits, workers, constraints, ..RunOptions::default() };
        let report = dfo::minimize(ByRef(self))
            .start(start)
            .bounds(&bound(Parameter::search_lower), &bound(Parameter::search_upper))
            .map_err(failed)?
            .transforms(&transforms)
            .kinds(&vec![ParameterKind::Continuous; start.len()])
            .optional_scales(&sizes)
            .options(options)
            .context(*context)
            .run()
            .map_err(failed)?;
        *n_simulations += report.n_evaluations;
        match report.termination {
            Termination::Interrupted => Err(NoFit::Cancelled),
            Termination::Aborted(message) => Err(NoFit::Failed(message)),
            _ if report.constr_violation > tolerance => {
                Err(NoFit::Failed("no values satisfy the constraints".to_owned()))
            }
            _ => Ok(Refitted { x: report.x, cost: report.fun }),
        }
    }
}
