//! Consistent initial values of systems with a matrix of the slopes, `M`.
//!
//! P. N. Brown, A. C. Hindmarsh, L. R. Petzold, Consistent initial condition calculation for
//! differential-algebraic systems, SIAM Journal on Scientific Computing 19 (1998) 1495-1512. In that paper,
//! the user marks the algebraic variables. Here, they are the states, or sums of states, that do not appear
//! in `M x'`.

use super::given_slopes::{AtSlopes, Kind};
use super::left_side::{LeftSide, NOISE};
use crate::error_norm::ErrorWeights;
use crate::implicit::algebraic::{Algebraic, sizes};
use crate::implicit::kept_jacobian::KeptJacobian;
use crate::lu::resize_matrix;
use crate::stepper::{Consistency, Equations, Point, PointMut};
use crate::system::{CallError, CallResult};

/// Slopes are consistent if Newton's method would change them by less than this fraction.
const CONVERGED: f64 = 1e-6;
/// States are consistent if Newton's method would move them by less than this fraction of their tolerance.
const CONSISTENT: f64 = 1e-3;
const MAX_ROUNDS: u32 = 20;
/// Sparse matrices of up to this number of rows are treated as dense if nothing else determines their
/// algebraic part.
const MAX_DENSE: usize = 500;
/// Newton's method has not converged. Equation and residual are filled in later, for the guess.
const NO_SLOPES: Consistency = Consistency::NoSlopes { equation: 0, residual: 0.0, is_singular: false };

impl LeftSide {
    /// Ensures that the equations hold at `(t, x)` by changing the slopes and the states that do not appear
    /// in `M x'`. `defect` is the residual there. The first call in a run also checks the index.
    pub(super) fn make_consistent(
        &mut self,
        equations: &mut Equations<'_>,
        PointMut { t, x, slopes }: PointMut<'_>,
        defect: &mut [f64],
        freshness: &mut KeptJacobian,
    ) -> CallResult<Consistency> {
        if self.kind == Kind::Identity {
            return Ok(Consistency::Holds);
        }
        let guess = &mut self.guess;
        for (kept, given) in [(&mut guess.0, &*x), (&mut guess.1, &*slopes)] {
            kept.clear();
            kept.extend_from_slice(given);
        }
        let is_sparse = self.kind == Kind::Residual && self.slopes.is_sparse();
        let found = match is_sparse {
            true => self.make_sparse_consistent(equations, PointMut { t, x, slopes }, defect, freshness)?,
            false => None,
        };
        let found = match found {
            Some(found) => found,
            None if is_sparse && x.len() > MAX_DENSE => self.unmet(equations.weights, x, defect, freshness),
            None => self.make_dense_consistent(equations, PointMut { t, x, slopes }, defect, freshness)?,
        };
        let is_failure = !matches!(found, Consistency::Holds | Consistency::Corrected);
        let may_be_wrong = found == Consistency::Corrected && self.is_affine != Some(true);
        if self.kind != Kind::Residual || !(is_failure || may_be_wrong) {
            return Ok(found);
        }
        if is_failure {
            x.copy_from_slice(&self.guess.0);
            slopes.copy_from_slice(&self.guess.1);
        }
        let is_singular = self.is_singular_only_here(equations, Point { t, x, slopes }, is_failure)?;
        if is_singular || matches!(found, Consistency::NoSlopes { .. }) {
            x.copy_from_slice(&self.guess.0);
            slopes.copy_from_slice(&self.guess.1);
            self.defect(equations, Point { t, x, slopes }, defect)?;
            let worst = (0..x.len()).max_by(|i, k| defect[*i].abs().total_cmp(&defect[*k].abs()));
            let equation = worst.unwrap_or_default();
            return Ok(Consistency::NoSlopes { equation, residual: -defect[equation], is_singular });
        }
        Ok(match found {
            // The right-hand side is the negative residual.
            Consistency::Impossible { equation, residual } => {
                Consistency::Impossible { equation, residual: -residual }
            }
            other => other,
        })
    }

    /// Computes `dF/dx'` at a point, by columns.
    fn matrix_at(&mut self, equations: &mut Equations<'_>, point: Point<'_>) -> CallResult<Vec<f64>> {
        let n = point.x.len();
        let mut defect = vec![0.0; n];
        self.defect(equations, point, &mut defect)?;
        self.is_evaluated = false;
        self.renew(equations, point, &defect)?;
        let mut matrix = vec![0.0; n * n];
        self.slopes.each(|i, k, m| matrix[i + n * k] = m);
        Ok(matrix)
    }

    /// True if `dF/dx'` has a larger rank near this point, at other slopes and, if `moves_states`, at other
    /// states. With other slopes alone, `dF/dx'` must also act there on the difference between the states and
    /// the guess.
    fn is_singular_only_here(
        &mut self,
        equations: &mut Equations<'_>,
        Point { t, x, slopes }: Point<'_>,
        moves_states: bool,
    ) -> CallResult<bool> {
        let n = x.len();
        if n > MAX_DENSE && self.slopes.is_sparse() {
            return Ok(false);
        }
        let mut here = self.matrix_at(equations, Point { t, x, slopes })?;
        let kept = self.slopes.values.clone();
        sizes(equations.weights, x, &mut self.point);
        // Fractions without a common divisor.
        let share = |i: usize| 1.0 + 0.5 * ((i + 2) as f64).sqrt().fract();
        let states = if moves_states { 0.1 } else { 0.0 };
        let near_x: Vec<f64> = (0..n).map(|i| x[i] + states * share(i) * self.point[i]).collect();
        let near_slopes: Vec<f64> =
            (0..n).map(|i| slopes[i] + share(i) * slopes[i].abs().max(x[i].abs()).max(1.0)).collect();
        let near = match self.matrix_at(equations, Point { t, x: &near_x, slopes: &near_slopes }) {
            Err(CallError::Discard) => return Ok(false),
            near => near?,
        };
        self.slopes.values.copy_from_slice(&kept);
        if !self.slopes.is_sparse() {
            self.mass.copy_from_slice(&kept);
        }
        self.find_slopes();
        here.iter_mut().zip(&near).filter(|(h, n)| h.abs() <= NOISE * n.abs()).for_each(|(h, _)| *h = 0.0);
        let acts = (0..n).any(|i| {
            let terms = (0..n).map(|k| near[i + n * k] * (x[k] - self.guess.0[k]));
            let (sum, size) = terms.fold((0.0, 0.0), |(sum, size), v: f64| (sum + v, size + v.abs()));
            sum.abs() > NOISE * size
        });
        let rank = |matrix: &[f64]| -> CallResult<usize> {
            let mut algebraic = Algebraic::default();
            algebraic.begin(n, matrix, NOISE)?;
            Ok(n - algebraic.count())
        };
        Ok((moves_states || acts) && rank(&near)? > rank(&here)?)
    }

    /// Implements `make_consistent` for dense matrices, or for sparse ones treated as dense.
    fn make_dense_consistent(
        &mut self,
        equations: &mut Equations<'_>,
        PointMut { t, x, slopes }: PointMut<'_>,
        defect: &mut [f64],
        freshness: &mut KeptJacobian,
    ) -> CallResult<Consistency> {
        let n = x.len();
        let is_sparse = self.kind == Kind::Residual && self.slopes.is_sparse();
        // The decomposition may be a sparse one.
        self.is_checked &= !is_sparse;
        let mut fewest = n;
        let mut outcome = Consistency::Holds;
        for _ in 0..MAX_ROUNDS {
            let is_new = self.renew(equations, Point { t, x, slopes }, defect)?;
            if is_sparse {
                resize_matrix(&mut self.mass, n, 0.0)?;
                self.mass.fill(0.0);
                let Self { mass, slopes, .. } = self;
                slopes.each(|i, k, m| mass[i + n * k] = m);
            }
            let noise = if self.kind == Kind::Mass { 0.0 } else { NOISE };
            if self.algebraic.begin(n, &self.mass, noise)? || is_new || !self.is_checked {
                self.lu.begin(n, None)?;
                equations.stats.decompositions += 1;
                equations.stats.linear_algebra += self.lu.operations().0;
                let Self { algebraic, mass, lu, .. } = self;
                self.has_factors = lu.decompose(|p, _| mass[p] + algebraic.completion(p));
            }
            self.is_split = true;
            if self.algebraic.count() < fewest {
                // States that turn out to have a slope are reset to their given values.
                fewest = self.algebraic.count();
                if outcome == Consistency::Corrected {
                    self.algebraic.move_from(&self.guess.0, x);
                    self.defect(equations, Point { t, x, slopes }, defect)?;
                    freshness.moved();
                    self.is_checked = false;
                }
            }
            let before = equations.stats.jacobians;
            let Self { algebraic, mass, kind, is_checked, .. } = self;
            let mut at_slopes = AtSlopes { system: &mut *equations.system, kind: *kind, mass, slopes };
            let mut inner = Equations {
                system: &mut at_slopes,
                weights: equations.weights,
                stats: &mut *equations.stats,
            };
            let (jacobian, has_jacobian) = freshness.jacobian_mut();
            let point = PointMut { t, x, slopes: defect };
            let found = algebraic.make_consistent(&mut inner, point, jacobian, has_jacobian)?;
            if inner.stats.jacobians > before {
                freshness.take_new(found == Consistency::Holds);
            }
            match found {
                Consistency::Holds => {}
                Consistency::Corrected => outcome = Consistency::Corrected,
                other => return Ok(other),
            }
            if !std::mem::replace(is_checked, true) {
                if !freshness.is_here() {
                    freshness.jacobian_mut().0.evaluate(&mut inner, Point { t, x, slopes: defect })?;
                    freshness.take_new(true);
                }
                sizes(inner.weights, x, &mut self.point);
                if algebraic.deficit(freshness.jacobian(), &self.point).is_some() {
                    freshness.drop_jacobian();
                    if algebraic.undetermined(&mut inner, freshness.jacobian_mut().0, t, x).is_some() {
                        return Ok(Consistency::HigherIndex);
                    }
                }
            }
            if !self.has_factors {
                return Ok(outcome);
            }
            equations.stats.linear_algebra += self.lu.operations().1;
            self.point.copy_from_slice(defect);
            self.lu.solve(&mut self.point);
            let mut converged = true;
            for (i, (s, d)) in slopes.iter_mut().zip(&self.point).enumerate() {
                *s += d;
                converged &= d.abs() <= CONVERGED * (s.abs() + equations.weights.scale(i));
            }
            if self.kind == Kind::Mass || (converged && found == Consistency::Holds) {
                return Ok(outcome);
            }
            self.defect(equations, Point { t, x, slopes }, defect)?;
        }
        Ok(NO_SLOPES)
    }

    /// Implements `make_consistent` for sparse matrices, if the states can be divided into states with slopes
    /// and states without. Newton's method determines the slopes of the former and the values of the latter.
    /// `None` if the system has a different form or a higher index; states and slopes are then unchanged.
    fn make_sparse_consistent(
        &mut self,
        equations: &mut Equations<'_>,
        PointMut { t, x, slopes }: PointMut<'_>,
        defect: &mut [f64],
        freshness: &mut KeptJacobian,
    ) -> CallResult<Option<Consistency>> {
        let (mut outcome, mut is_singular) = (Consistency::Holds, false);
        for _ in 0..MAX_ROUNDS {
            self.renew(equations, Point { t, x, slopes }, defect)?;
            let given = x.iter_mut().zip(&self.guess.0).zip(&self.has_slope);
            let mut is_other = false;
            for ((x, guess), _) in given.filter(|((x, guess), has_slope)| **has_slope && x != guess) {
                (*x, is_other) = (*guess, true);
            }
            if is_other {
                self.defect(equations, Point { t, x, slopes }, defect)?;
            }
            let mut at_slopes = self.at_slopes(&mut *equations.system, slopes);
            let mut inner = Equations {
                system: &mut at_slopes,
                weights: equations.weights,
                stats: &mut *equations.stats,
            };
            freshness.jacobian_mut().0.evaluate(&mut inner, Point { t, x, slopes: defect })?;
            freshness.take_new(true);
            let jacobian = freshness.jacobian();
            let Some(pattern) = jacobian.pattern() else { return Ok(None) };
            let columns: Vec<usize> = pattern.with_diagonal().entries().map(|(_, k)| k).collect();
            self.lu.begin(x.len(), Some(pattern))?;
            equations.stats.decompositions += 1;
            let Self { lu, has_slope, slopes: of_slopes, .. } = self;
            let is_regular =
                lu.decompose(
                    |p, _| {
                        if has_slope[columns[p]] { of_slopes.values[p] } else { -jacobian.values[p] }
                    },
                );
            self.point.copy_from_slice(defect);
            self.lu.solve(&mut self.point);
            is_singular = !is_regular || !self.point.iter().all(|v| v.is_finite());
            if is_singular {
                break;
            }
            let mut converged = true;
            equations.weights.inverse_at(x, 1.0, &mut self.value);
            for (i, d) in self.point.iter().enumerate() {
                if self.has_slope[i] {
                    slopes[i] += d;
                    converged &= d.abs() <= CONVERGED * (slopes[i].abs() + equations.weights.scale(i));
                } else if (d * self.value[i]).abs() > CONSISTENT {
                    x[i] += d;
                    converged = false;
                    outcome = Consistency::Corrected;
                }
            }
            if converged {
                return Ok(Some(outcome));
            }
            self.defect(equations, Point { t, x, slopes }, defect)?;
        }
        // A numerically singular matrix may have been decomposed without an error.
        x.copy_from_slice(&self.guess.0);
        slopes.copy_from_slice(&self.guess.1);
        self.defect(equations, Point { t, x, slopes }, defect)?;
        Ok((!is_singular && x.len() > MAX_DENSE).then_some(NO_SLOPES))
    }

    /// Checks large sparse systems without a regular matrix. Returns an equation without a slope that does
    /// not hold within the tolerances of the states.
    fn unmet(
        &mut self,
        weights: &ErrorWeights,
        x: &[f64],
        defect: &[f64],
        freshness: &mut KeptJacobian,
    ) -> Consistency {
        let Self { point: allowed, value: inverse, slopes, .. } = self;
        weights.inverse_at(x, 1.0, inverse);
        allowed.fill(0.0);
        freshness.jacobian().each(|i, k, j| allowed[i] += j.abs() / inverse[k]);
        slopes.each(|i, _, m| allowed[i] += if m == 0.0 { 0.0 } else { f64::INFINITY });
        match (0..x.len()).find(|i| defect[*i].abs() > allowed[*i]) {
            Some(equation) => Consistency::Impossible { equation, residual: defect[equation] },
            None => Consistency::Holds,
        }
    }

    /// Corrects the residuals that Newton's method has left in the equations without derivatives, before a
    /// restart during a run. They would otherwise appear as an error of the following steps, however short.
    pub(super) fn correct(
        &mut self,
        equations: &mut Equations<'_>,
        PointMut { t, x, slopes }: PointMut<'_>,
        defect: &mut [f64],
        freshness: &mut KeptJacobian,
    ) -> CallResult<()> {
        self.defect(equations, Point { t, x, slopes }, defect)?;
        self.make_consistent(equations, PointMut { t, x, slopes }, defect, freshness)?;
        Ok(())
    }
}
