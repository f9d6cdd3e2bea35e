//! Uncertainty of a fit: standard errors of its parameters, identifiable parameters, and checks of the
//! residuals.

use crate::cost::residual::sum_of_squares;
use crate::error::CalibrationError;
use crate::loaded::budget::Extra;
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::constraint::CriteriaNearby;
use crate::problem::parameter::{Parameter, Scale, Target, inner};
use crate::uncertainty::covariance::achievable_decrease::At;
use crate::uncertainty::covariance::joint::JointMatrices;
use crate::uncertainty::covariance::matrix::Factors;
use crate::uncertainty::covariance::noise::{Noise, groups};
use crate::uncertainty::diagnostics::lack_of_fit::LackOfFit;
use crate::uncertainty::diagnostics::prior_check::PriorConflict;
use crate::uncertainty::diagnostics::residual_check::ResidualCheck;
use crate::uncertainty::differences::{Center, Differences};
use crate::uncertainty::group::Group;
use crate::uncertainty::inactive_parameters::AT;
use crate::uncertainty::joint_errors::JointErrors;
use crate::uncertainty::result::{Estimator, Uncertainty, UncertaintyOptions, errors_and_correlation};
use crate::uncertainty::row_blocks::{along, go_on};
use crate::uncertainty::scores::{Criterion, Working};
use base::RunContext;
use dfo::{ParameterKind, RobustLoss};
use nalgebra::{DMatrix, DVector};

/// Step of the differences of criteria relative to the size of a parameter. The error of a central difference
/// is about the square of it, and that of simulations with the default tolerance 1e-6 divided by it.
const CRITERIA_STEP: f64 = 1e-3;

/// Data that are known at a point before its uncertainty is estimated.
#[derive(Default)]
pub(crate) struct EvaluatedPoint<'a> {
    /// Residuals before a loss is applied.
    pub(crate) residuals: Option<&'a [f64]>,
    /// Derivatives of the residuals in the user's units, m x n, as a first guess for the differences. The
    /// derivatives of a search come from arbitrary trial points, so they never replace differences.
    pub(crate) jacobian: Option<&'a [f64]>,
    /// Indices of parameters that are at a bound or held.
    pub(crate) held: Vec<usize>,
    /// Indices of parameters without a visible effect. They are not held, even at a bound.
    pub(crate) inert: &'a [usize],
    /// Relative differences of the cost that are negligible.
    pub(crate) f_tol: f64,
    /// Form of the cost as a function of the residuals.
    pub(crate) criterion: Criterion,
    /// True if the noise of all outputs is known, see [`UncertaintyOptions::is_noise_known`].
    pub(crate) is_noise_known: bool,
}

/// The residuals at a point.
struct CenterResiduals {
    residuals: Vec<f64>,
    /// Residuals of more accurate simulations; `None` if they failed or were skipped.
    accurate: Option<Vec<f64>>,
    /// Norm of the difference. If it is unknown, the relative tolerance times the norm of the measurements.
    simulation_error: f64,
}

impl CenterResiduals {
    /// Returns the noise of differences relative to the residuals; zero if simulations have no error.
    fn part_of(&self, noise: f64) -> f64 {
        let size = sum_of_squares(&self.residuals).sqrt();
        if self.simulation_error > 0.0 && size > 0.0 { noise / size } else { 0.0 }
    }

    /// Returns the steps of the free parameters to the minimum of more accurate simulations.
    fn steps_by_accuracy(
        &self,
        working: &Working,
        factors: &Factors,
        context: &RunContext<'_>,
    ) -> Result<Option<DVector<f64>>, CalibrationError> {
        let Some(accurate) = &self.accurate else { return Ok(None) };
        let mut change = DVector::from_fn(accurate.len(), |i, _| accurate[i] - self.residuals[i]);
        working.weigh(&mut change);
        Ok(Some(&factors.inverse * along(&factors.base, change.as_slice(), context)?))
    }
}

/// Directions that the constraints leave at a point.
#[derive(Default)]
struct ConstrainedDirections {
    /// As in [`Center`].
    basis: Option<DMatrix<f64>>,
    inactive: Vec<(DVector<f64>, (f64, f64))>,
    /// Texts of the active constraints.
    active: Vec<String>,
}

/// Returns an orthonormal basis of the vectors that are orthogonal to all rows, n x q.
fn null_space(rows: &[DVector<f64>], n: usize) -> DMatrix<f64> {
    let mut range: Vec<DVector<f64>> = Vec::new();
    let mut basis: Vec<DVector<f64>> = Vec::new();
    // Gram and Schmidt, twice, first over the rows and then over the axes.
    for row in rows {
        range.extend(orthogonal(row.clone(), &range));
    }
    for k in 0..n {
        let axis = DVector::from_fn(n, |i, _| f64::from(u8::from(i == k)));
        let all: Vec<DVector<f64>> = range.iter().chain(&basis).cloned().collect();
        basis.extend(orthogonal(axis, &all));
    }
    if basis.is_empty() { DMatrix::zeros(n, 0) } else { DMatrix::from_columns(&basis) }
}

/// Returns the normalised part of a vector outside the others; `None` if it depends on them.
fn orthogonal(mut vector: DVector<f64>, others: &[DVector<f64>]) -> Option<DVector<f64>> {
    let length = vector.norm();
    for _ in 0..2 {
        others.iter().for_each(|other| vector.axpy(-other.dot(&vector), other, 1.0));
    }
    let rest = vector.norm();
    (rest > 1e-9 * length).then(|| vector / rest)
}

/// Inputs of the covariance estimate of the free parameters among `n`.
struct Estimate<'a> {
    n: usize,
    free: &'a [usize],
    /// Derivative of each free parameter with respect to its coordinate in the search.
    per_unit: &'a [f64],
    factors: &'a Factors,
    groups: &'a [Group],
    noise: &'a Noise,
    /// Experiment and state of each measured initial state.
    starts: &'a [(usize, String)],
    /// For each output, the variance of the plain residuals divided by the variance of the working residuals.
    plain: &'a [f64],
}

/// Covariances of all parameters, n x n, in the user's units.
struct Covariances {
    covariance: Vec<f64>,
    /// Covariance under the assumption of independent residuals; `None` if no autocorrelation was corrected.
    uncorrected: Option<Vec<f64>>,
    /// Diagonal of the inverse of half the cost's second derivatives.
    curvature: Vec<f64>,
    /// Degrees of freedom of each variance.
    degrees_of_freedom: Vec<f64>,
    /// Autocorrelation of each output.
    autocorrelations: Vec<f64>,
    /// Joint covariance with measured initial states, corrected and uncorrected.
    joint: JointErrors,
    uncorrected_joint: Option<JointErrors>,
}

impl Estimate<'_> {
    fn covariances(&self, n_outputs: usize) -> Covariances {
        let Self { n, free, factors, groups, noise, .. } = *self;
        let independent = JointMatrices::new(factors, noise, &noise.independent);
        let degrees = |joint: &JointMatrices| (0..free.len()).map(|k| joint.degrees_of_freedom(k)).collect();
        let mut of_free: Vec<f64> = degrees(&independent);
        let (mut joint, mut autocorrelations) = (independent, vec![0.0; n_outputs]);
        let (mut uncorrected, mut uncorrected_joint) = (None, None);
        let mut variances = &noise.independent.variances;
        if let Some(model) = &noise.autocorrelated {
            let mut corrected = JointMatrices::new(factors, noise, model);
            corrected.raise_to(&joint);
            let uncorrected_degrees: Vec<f64> = degrees(&corrected);
            of_free
                .iter_mut()
                .zip(uncorrected_degrees)
                .for_each(|(degrees, uncorrected_degrees)| *degrees = degrees.min(uncorrected_degrees));
            uncorrected = Some(self.of_all(&joint.covariance));
            uncorrected_joint = Some(self.joint(&joint, variances, n_outputs));
            (joint, variances) = (corrected, &model.variances);
            for (group, rho) in groups.iter().zip(&model.autocorrelations) {
                group.outputs.iter().for_each(|k| autocorrelations[*k] = *rho);
            }
        }
        let mut degrees_of_freedom = vec![noise.degrees_of_freedom; n];
        let with_degrees = free.iter().zip(of_free).filter(|(_, degrees)| !degrees.is_nan());
        with_degrees.for_each(|(i, degrees)| degrees_of_freedom[*i] = degrees);
        let curvature = self.of_all(&(&factors.inverse * factors.inverse.transpose()));
        Covariances {
            covariance: self.of_all(&joint.covariance),
            uncorrected,
            curvature: curvature.into_iter().step_by(n + 1).collect(),
            degrees_of_freedom,
            autocorrelations,
            joint: self.joint(&joint, variances, n_outputs),
            uncorrected_joint,
        }
    }

    fn joint(&self, joint: &JointMatrices, variances: &[f64], n_outputs: usize) -> JointErrors {
        let Self { n, free, per_unit, factors, groups, starts, plain, .. } = *self;
        let mut outputs = vec![(0, 0.0); n_outputs];
        for (g, group) in groups.iter().enumerate() {
            group.outputs.iter().for_each(|k| outputs[*k] = (g, variances[g] * plain[*k]));
        }
        joint.of_all(n, (free, per_unit, &factors.is_undetermined), starts, outputs)
    }

    /// Converts a covariance of the free parameters in the coordinates of the search to all parameters in the
    /// user's units. An undetermined parameter has an infinite variance and NaN covariances.
    fn of_all(&self, of_free: &DMatrix<f64>) -> Vec<f64> {
        let Self { n, free, per_unit, factors, noise, .. } = *self;
        let is_open = |k: usize| factors.is_undetermined[k] || noise.degrees_of_freedom == 0.0;
        let mut matrix = vec![0.0; n * n];
        for (a, &i) in free.iter().enumerate() {
            for (b, &j) in free.iter().enumerate() {
                matrix[i * n + j] = match (is_open(a) || is_open(b), a == b) {
                    (false, _) => of_free[(a, b)] * per_unit[a] * per_unit[b],
                    (true, true) => f64::INFINITY,
                    (true, false) => f64::NAN,
                };
            }
        }
        matrix
    }
}

impl Calibration {
    /// Estimates the uncertainty of a point as if it were the result of a fit. The result contains the
    /// covariance and correlation of the parameters, undetermined parameters, and checks of the residuals. It
    /// also contains the cost with a tenth of the relative tolerance (half the step for a fixed-step method).
    ///
    /// The number of simulations is one for the accurate cost, plus two in each of two rounds for each
    /// parameter that is not held. The first round determines steps of about one standard error. Two more
    /// simulations are run for each combination of parameters whose change is below the simulation noise. The
    /// same applies if the residuals bend over the step. Simulations run in parallel. The context is checked
    /// on the calling thread.
    ///
    /// # Errors
    /// Returns an error if the number of values is wrong, or if simulations fail at the point or on both
    /// sides of it. Returns [`CalibrationError::Cancelled`] if the context has ended.
    pub fn uncertainty(
        &self,
        x: &[f64],
        options: &UncertaintyOptions,
        context: &RunContext<'_>,
    ) -> Result<Uncertainty, CalibrationError> {
        self.check_length(x)?;
        let workers = options.workers.unwrap_or_else(base::available_cores);
        let mut simulations = Simulations::new(self, RobustLoss::default(), workers, context)?;
        if let Some(index) = options.held.iter().find(|i| **i >= x.len()) {
            let n = x.len();
            return Err(CalibrationError::Setup(format!(
                "held: parameter index {index} is not below the number of parameters, {n}"
            )));
        }
        let (held, criterion) = (options.held.clone(), options.criterion());
        let is_noise_known = options.is_noise_known;
        let evaluated_point =
            EvaluatedPoint { f_tol: 1e-4, held, criterion, is_noise_known, ..EvaluatedPoint::default() };
        self.uncertainty_of(x, options.estimator, &evaluated_point, &mut simulations)
    }

    pub(crate) fn uncertainty_of(
        &self,
        x: &[f64],
        estimator: Estimator,
        evaluated_point: &EvaluatedPoint<'_>,
        simulations: &mut Simulations<'_>,
    ) -> Result<Uncertainty, CalibrationError> {
        self.uncertainty_and_curvature(x, estimator, evaluated_point, simulations)
            .map(|(uncertainty, _)| uncertainty)
    }

    /// Estimates the uncertainty, and the diagonal of the inverse of half the cost's second derivatives, in
    /// the user's units. The diagonal is infinite for undetermined parameters.
    pub(crate) fn uncertainty_and_curvature(
        &self,
        x: &[f64],
        estimator: Estimator,
        evaluated_point: &EvaluatedPoint<'_>,
        simulations: &mut Simulations<'_>,
    ) -> Result<(Uncertainty, Vec<f64>), CalibrationError> {
        let (parameters, layout, before) = (self.parameters(), self.residual_layout(), simulations.n);
        let (mut held, mut free) = self.held_and_free(x, evaluated_point);
        let criteria = self.criteria_nearby(x, &free, simulations)?;
        let constrained = self.directions(x, &criteria, &mut held, &mut free);
        let at_center = self.residuals_at_center(x, evaluated_point, simulations)?;
        let (residuals, accurate) = (&at_center.residuals, &at_center.accurate);
        let sizes: Vec<f64> = free.iter().map(|&i| self.size_of(&parameters[i], x[i])).collect();
        let center = Center {
            parameters,
            x,
            free: &free,
            sizes: &sizes,
            residuals,
            measured: layout.size_of_measurements(),
            simulation_error: at_center.simulation_error,
            basis: constrained.basis,
            inactive: constrained.inactive,
        };
        let per_unit: Vec<f64> = free.iter().map(|&i| slope(&parameters[i], x[i])).collect();
        let context = &simulations.context.clone();
        let first = |jacobian: &[f64]| of_free(jacobian, x.len(), &free, &per_unit, context);
        let guess = evaluated_point
            .jacobian
            .filter(|_| evaluated_point.residuals.is_some())
            .map(first)
            .transpose()?;
        let differences = Differences::around(&center, guess, simulations)?
            .map_err(|message| self.failed_at(x, format!("around this point: {message}"), None))?;
        let jacobian = differences.jacobian(context)?;
        let (differences_noise, roughness) = (differences.noise, differences.roughness);
        let starts = self.measured_starts(x);
        let groups =
            groups(layout, residuals, estimator, evaluated_point.criterion, evaluated_point.is_noise_known);
        let working =
            Working::new(evaluated_point.criterion, layout, residuals, &groups, center.n_directions());
        let differences = differences.weighted(&working.roots);
        let factors = &Factors::new(&differences, context)?;
        let starts = self.find_changes_by_starts(starts, x, residuals, simulations)?;
        let noise = &Noise::estimate(layout, residuals, &working, &groups, &starts, &factors.base, context)?;
        let by_starts = noise.changes_by_starts();
        let estimate = Estimate {
            n: x.len(),
            free: &free,
            per_unit: &per_unit,
            factors,
            groups: &groups,
            noise,
            starts: &starts.iter().map(|start| (start.experiment, start.state.clone())).collect::<Vec<_>>(),
            plain: &working.plain_over_working(layout, residuals, &groups),
        };
        let covariances = estimate.covariances(layout.outputs.len());
        let is_exact = self.is_within_tolerance(sum_of_squares(residuals));
        let is_linear = evaluated_point.criterion.is_sum_of_squares();
        let undetermined = || (0..free.len()).filter(|k| factors.is_undetermined[*k]);
        let is_inert =
            |k: &usize| jacobian.column(*k).norm() * differences.steps.row(*k).amax() <= differences_noise;
        let prior_conflicts = PriorConflict::all(&center, layout, &per_unit, (&jacobian, &working), context)?;
        let cost = |residuals: &[f64]| evaluated_point.criterion.cost(layout, residuals);
        let at = At { parameters, x, free: &free, sizes: &sizes, factors, residuals: &working.residuals };
        let gain = if is_exact {
            Default::default()
        } else {
            at.achievable_decrease(&cost, cost(residuals), simulations)?
        };
        let (standard_errors, correlation) = errors_and_correlation(&covariances.covariance, x.len());
        let mut uncertainty = Uncertainty {
            correlation,
            uncorrected_covariance: covariances.uncorrected,
            autocorrelations: covariances.autocorrelations,
            effective_degrees_of_freedom: covariances.degrees_of_freedom,
            covariance: covariances.covariance,
            joint: covariances.joint,
            uncorrected_joint: covariances.uncorrected_joint,
            standard_errors,
            degrees_of_freedom: noise.degrees_of_freedom,
            undetermined: undetermined().map(|k| free[k]).collect(),
            without_effect: undetermined().filter(is_inert).map(|k| free[k]).collect(),
            held,
            cost: cost(residuals),
            is_exact,
            accurate_cost: accurate.as_deref().map(cost),
            achievable_decrease: gain.part,
            roughness,
            simulation_noise: at_center.part_of(differences_noise),
            is_at_failures: gain.is_at_failures,
            prior_conflicts,
            has_loss: !is_linear && evaluated_point.criterion != Criterion::Likelihood,
            jacobian: of_all(&jacobian, x.len(), &free, &per_unit, context)?,
            residual_checks: self.residual_checks(residuals, &by_starts, context)?,
            lack_of_fit: LackOfFit::new(layout, residuals, noise.degrees_of_freedom),
            residuals: at_center.residuals.clone(),
            ..self.without_estimates(x, estimator)
        };
        if let Some(steps) = at_center.steps_by_accuracy(&working, factors, context)? {
            uncertainty.note_shift(&free, &steps);
        }
        uncertainty.active_constraints = constrained.active;
        // The correlations along an active constraint do not come from the measurements.
        if center.basis.is_none() {
            uncertainty.find_combinations(&jacobian, &differences, noise, &free, &sizes, context)?;
        } else {
            let is_determined = |i: &usize| !uncertainty.undetermined.contains(i);
            uncertainty.identifiable = free.iter().copied().filter(is_determined).collect();
        }
        uncertainty.n_simulations = simulations.n - before;
        uncertainty.findings = uncertainty.all_findings(evaluated_point.f_tol);
        Ok((uncertainty, covariances.curvature))
    }

    /// Returns the uncertainty at a point before anything is estimated.
    fn without_estimates(&self, x: &[f64], estimator: Estimator) -> Uncertainty {
        let parameters = self.parameters();
        Uncertainty {
            estimator,
            names: parameters.iter().map(|p| p.name().to_owned()).collect(),
            x: x.to_vec(),
            is_log: parameters.iter().map(|p| p.scale_kind() == Scale::Log).collect(),
            sizes: parameters.iter().zip(x).map(|(p, x)| self.size_of_either_sign(p, *x)).collect(),
            is_about_zero: parameters.iter().map(is_about_zero).collect(),
            is_step_halved: self.has_fixed_step(),
            step_size: self.step_in_use(),
            ..Uncertainty::default()
        }
    }

    /// Returns the checks of the residuals of all outputs. The `by_starts` are the changes of the residuals
    /// due to measured initial states.
    fn residual_checks(
        &self,
        residuals: &[f64],
        by_starts: &[DVector<f64>],
        context: &RunContext<'_>,
    ) -> Result<Vec<ResidualCheck>, CalibrationError> {
        let (layout, names) = (self.residual_layout(), self.problem().experiment_names());
        let mut checks = ResidualCheck::all(layout, &names, residuals, context)?;
        for (check, output) in checks.iter_mut().zip(&layout.outputs) {
            let mean = |change: &DVector<f64>| change.rows_range(output.range.clone()).mean();
            check.mean_by_starts = by_starts.iter().map(mean).fold(0.0, f64::hypot);
        }
        Ok(checks)
    }

    /// Returns the indices of the parameters treated as known, and of the others.
    fn held_and_free(&self, x: &[f64], evaluated_point: &EvaluatedPoint<'_>) -> (Vec<usize>, Vec<usize>) {
        let is_held = |i: &usize| {
            let p = &self.parameters()[*i];
            let is_at_bound = self.is_at_bound(p, x[*i]) && !evaluated_point.inert.contains(i);
            let is_fixed =
                p.is_fixed() || p.lower() == p.upper() || p.value_kind() != ParameterKind::Continuous;
            evaluated_point.held.contains(i) || is_fixed || is_at_bound
        };
        (0..x.len()).partition(is_held)
    }

    /// Returns the criteria of the simulations at a point and their derivatives, if a constraint contains
    /// any. The derivatives are central differences, or one-sided ones at a bound, from two simulations per
    /// free parameter.
    fn criteria_nearby(
        &self,
        x: &[f64],
        free: &[usize],
        simulations: &mut Simulations<'_>,
    ) -> Result<CriteriaNearby, CalibrationError> {
        if self.constraints().first_of_simulation().is_none() {
            return Ok(CriteriaNearby::default());
        }
        let parameters = self.parameters();
        let moved = |i: usize, sign: f64| {
            let mut moved = x.to_vec();
            let step = CRITERIA_STEP * self.size_of(&parameters[i], x[i]) * slope(&parameters[i], x[i]);
            moved[i] = (x[i] + sign * step).clamp(parameters[i].lower(), parameters[i].upper());
            moved
        };
        let points = std::iter::once(x.to_vec())
            .chain(free.iter().flat_map(|i| [moved(*i, -1.0), moved(*i, 1.0)]))
            .map(|x| Point { x, is_accurate: false });
        let points: Vec<Point> = points.collect();
        let found = simulations.values(&points)?;
        let n = self.n_residuals();
        let criteria = |k: usize| found[k].as_ref().ok().map(|values| &values[n..]);
        let Some(values) = criteria(0) else { return Ok(CriteriaNearby::default()) };
        let mut slopes = vec![vec![0.0; values.len()]; x.len()];
        for (k, &i) in free.iter().enumerate() {
            let width = points[2 * k + 2].x[i] - points[2 * k + 1].x[i];
            slopes[i] = match (criteria(2 * k + 1), criteria(2 * k + 2)) {
                (Some(below), Some(above)) => {
                    below.iter().zip(above).map(|(below, above)| (above - below) / width).collect()
                }
                _ => vec![f64::NAN; values.len()],
            };
        }
        Ok(CriteriaNearby { values: values.to_vec(), slopes })
    }

    /// Returns the directions that the active constraints leave at a point. Free parameters that the
    /// constraints fix become held.
    fn directions(
        &self,
        x: &[f64],
        criteria: &CriteriaNearby,
        held: &mut Vec<usize>,
        free: &mut Vec<usize>,
    ) -> ConstrainedDirections {
        let parameters = self.parameters();
        let sizes: Vec<f64> = parameters.iter().zip(x).map(|(p, x)| self.size_of(p, *x)).collect();
        let in_units: Vec<f64> = (0..x.len()).map(|i| sizes[i] * slope(&parameters[i], x[i])).collect();
        let nearby = self.constraints().around(x, &in_units, criteria);
        let mut found = ConstrainedDirections::default();
        let over = |free: &[usize], gradient: &[f64]| {
            DVector::from_iterator(
                free.len(),
                free.iter().map(|i| gradient[*i] * slope(&parameters[*i], x[*i])),
            )
        };
        let active: Vec<_> = nearby.iter().filter(|constraint| constraint.is_active).collect();
        found.active = active.iter().map(|constraint| constraint.text.clone()).collect();
        while !active.is_empty() && !free.is_empty() {
            let scale = |gradient: DVector<f64>| {
                let scaled = gradient
                    .component_mul(&DVector::from_iterator(free.len(), free.iter().map(|i| sizes[*i])));
                let norm = scaled.norm();
                if norm > 0.0 { scaled / norm } else { scaled }
            };
            let rows: Vec<_> = active.iter().map(|active| scale(over(free, &active.gradient))).collect();
            let mut basis = null_space(&rows, free.len());
            let fixed = (0..free.len()).find(|k| basis.row(*k).amax() <= 1e-9);
            if let Some(k) = fixed {
                held.push(free.remove(k));
                held.sort_unstable();
                continue;
            }
            basis.row_iter_mut().zip(free.iter()).for_each(|(mut row, i)| row *= sizes[*i]);
            found.basis = (basis.ncols() < free.len()).then_some(basis);
            break;
        }
        let inactive = nearby.iter().filter(|constraint| !constraint.is_active);
        found.inactive =
            inactive.map(|constraint| (over(free, &constraint.gradient), constraint.room)).collect();
        found
    }

    /// Returns the residuals at a point, simulated if unknown, and the residuals of more accurate
    /// simulations.
    fn residuals_at_center(
        &self,
        x: &[f64],
        evaluated_point: &EvaluatedPoint<'_>,
        simulations: &mut Simulations<'_>,
    ) -> Result<CenterResiduals, CalibrationError> {
        let residuals = match evaluated_point.residuals {
            Some(plain) => plain.to_vec(),
            None => {
                let found = simulations.residuals(&[Point::new(x.to_vec())])?.swap_remove(0);
                found.map_err(|message| self.failed_at(x, message, None))?
            }
        };
        let points = [Point { x: x.to_vec(), is_accurate: true }];
        let found = simulations.extra(Extra::Accuracy, &points)?;
        let is_simulated = found.is_some();
        let accurate = found.and_then(|mut found| found.swap_remove(0).ok());
        let simulation_error = match &accurate {
            // The error of a fixed step is the same on both sides of the point.
            _ if self.has_fixed_step() => 0.0,
            Some(accurate) => {
                accurate.iter().zip(&residuals).map(|(a, r)| (a - r) * (a - r)).sum::<f64>().sqrt()
            }
            None if is_simulated => 0.0,
            // The method controls its error to this tolerance.
            None => self.relative_tolerance() * self.residual_layout().size_of_measurements(),
        };
        Ok(CenterResiduals { residuals, accurate, simulation_error })
    }

    /// Returns the absolute value of a parameter. If zero is between the bounds, the result is at least the
    /// size of the parameter.
    fn size_of_either_sign(&self, p: &Parameter, x: f64) -> f64 {
        let is_of_either = p.lower() < 0.0 && p.upper() > 0.0 && p.scale_kind() == Scale::Linear;
        if is_of_either { self.size_of(p, x).max(x.abs()) } else { x.abs() }
    }

    /// True if a parameter is at one of its bounds.
    fn is_at_bound(&self, p: &Parameter, x: f64) -> bool {
        let (lower, upper, at) = (inner(p, p.lower()), inner(p, p.upper()), inner(p, x));
        !p.is_periodic() && (at - lower).min(upper - at) <= AT * self.size_of(p, x)
    }
}

/// True if zero is a usual value of a parameter, so that a relative error is meaningless. The bounds must
/// allow both signs, and the parameter must be a delay or an offset, or start at zero.
fn is_about_zero(p: &Parameter) -> bool {
    let is_added = matches!(p.target(), Target::Delay(_) | Target::Offset(_));
    let is_of_either = p.lower() < 0.0 && p.upper() > 0.0 && p.scale_kind() == Scale::Linear;
    is_of_either && (is_added || p.start() == 0.0)
}

/// Converts derivatives with respect to all n parameters, row by row, to derivatives with respect to the
/// coordinates of the free parameters, m x p.
fn of_free(
    by_all: &[f64],
    n: usize,
    free: &[usize],
    per_unit: &[f64],
    context: &RunContext<'_>,
) -> Result<DMatrix<f64>, CalibrationError> {
    let mut jacobian = DMatrix::zeros(by_all.len() / n, free.len());
    for (k, mut column) in jacobian.column_iter_mut().enumerate() {
        go_on(context)?;
        let rows = by_all.iter().skip(free[k]).step_by(n);
        column.iter_mut().zip(rows).for_each(|(to, from)| *to = from * per_unit[k]);
    }
    Ok(jacobian)
}

/// Converts derivatives with respect to the free coordinates to derivatives with respect to all parameters.
/// The derivatives for the other parameters are zero.
fn of_all(
    jacobian: &DMatrix<f64>,
    n: usize,
    free: &[usize],
    per_unit: &[f64],
    context: &RunContext<'_>,
) -> Result<Vec<f64>, CalibrationError> {
    let mut by_all = vec![0.0; jacobian.nrows() * n];
    for (k, &i) in free.iter().enumerate() {
        go_on(context)?;
        let rows = by_all.iter_mut().skip(i).step_by(n);
        rows.zip(&jacobian.column(k)).for_each(|(to, from)| *to = from / per_unit[k]);
    }
    Ok(by_all)
}

/// Returns the derivative of a parameter with respect to its coordinate in the search.
fn slope(p: &Parameter, x: f64) -> f64 {
    match p.scale_kind() {
        Scale::Linear => 1.0,
        Scale::Log => x,
    }
}
