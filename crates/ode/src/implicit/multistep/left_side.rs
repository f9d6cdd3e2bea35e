//! Left side of the equations: `x'`, `M x'`, or the whole of `F(t, x, x') = 0`.
//!
//! Near a point, all three are `M x' = f(t, x)` with `M = dF/dx'` and the Jacobian `-dF/dx` of the right-hand
//! side. The two matrices are stored separately, so that a change of the step size requires no evaluation.
//! `M` is evaluated again if one evaluation along a vector shows that it has changed.

use super::given_slopes::{AtSlopes, AtState, Kind};
use crate::error::Undetermined;
use crate::error_norm::ErrorWeights;
use crate::implicit::algebraic::Algebraic;
use crate::implicit::kept_jacobian::KeptJacobian;
use crate::jacobian::Jacobian;
use crate::lu::{Lu, resize_matrix};
use crate::options::Options;
use crate::stepper::{Equations, Point};
use crate::system::{CallError, CallResult, HybridSystem};

/// Entries of a finite-difference matrix below this fraction of its largest entries are zero.
pub(super) const NOISE: f64 = 1e-6;
/// A matrix of the slopes with a relative error below this is not evaluated again, because Newton's method
/// then needs no additional iteration.
const SAME: f64 = 1e-4;
/// Relative rounding error of residuals.
const ROUNDING: f64 = 1e-12;

/// The matrix of the slopes.
#[derive(Debug, Default)]
pub(super) struct LeftSide {
    pub(super) kind: Kind,
    /// The mass matrix, or `dF/dx'` if it is dense, by columns.
    pub(super) mass: Vec<f64>,
    /// `dF/dx'`.
    pub(super) slopes: Jacobian,
    pub(super) is_evaluated: bool,
    /// True if the residual is an affine function of the slopes; `None` if this is not known yet.
    pub(super) is_affine: Option<bool>,
    /// `is_split`: the algebraic part is valid for this run. `is_checked`: the index was found to be 0 or 1.
    pub(super) is_split: bool,
    pub(super) is_checked: bool,
    pub(super) algebraic: Algebraic,
    /// Factors of `M`, [completed](Algebraic::completion).
    pub(super) lu: Lu<f64>,
    pub(super) has_factors: bool,
    /// True if states that do not appear in `M x'` are excluded from the error test.
    exclude: bool,
    /// True for states that appear in `M x'`.
    pub(super) has_slope: Vec<bool>,
    weights: ErrorWeights,
    nominals: Vec<f64>,
    direction: Vec<f64>,
    pub(super) point: Vec<f64>,
    pub(super) value: Vec<f64>,
    last: Vec<f64>,
    /// States and slopes from which consistent ones are searched.
    pub(super) guess: (Vec<f64>, Vec<f64>),
}

impl LeftSide {
    /// Creates the left side. `exclude`: the error test excludes the states that do not appear in `M x'`.
    pub(super) fn new(exclude: bool) -> Self {
        Self { exclude, ..Self::default() }
    }

    /// True if the left side is `x'`, that is, the equations are ordinary differential equations.
    pub(super) fn is_identity(&self) -> bool {
        self.kind == Kind::Identity
    }

    /// Allocates the work space for the system.
    ///
    /// # Errors
    /// Returns an error if memory is insufficient for matrices of this size.
    pub(super) fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()> {
        let n = system.n_states();
        self.kind = match system.mass_matrix() {
            _ if system.has_residual() => Kind::Residual,
            Some(mass) => {
                self.mass.clear();
                self.mass.extend_from_slice(mass);
                Kind::Mass
            }
            None => Kind::Identity,
        };
        self.is_evaluated = self.kind == Kind::Mass;
        self.is_affine = system.has_jacobian().then_some(false);
        self.is_split = false;
        self.is_checked = false;
        if self.kind == Kind::Residual {
            self.slopes.begin(system)?;
            if !self.slopes.is_sparse() && self.mass.len() != n * n {
                resize_matrix(&mut self.mass, n, 0.0)?;
            }
            self.last.resize(self.slopes.values.len(), 0.0);
        }
        if self.kind != Kind::Identity {
            let Self { nominals, direction, point, value, .. } = self;
            [nominals, direction, point, value].into_iter().for_each(|v| v.resize(n, 0.0));
        }
        if self.kind == Kind::Mass {
            self.find_slopes();
        }
        Ok(())
    }

    /// Entry of `M` at a position of the matrix to be decomposed.
    pub(super) fn entry(&self, place: usize, is_on_diagonal: bool) -> f64 {
        match self.kind {
            Kind::Identity => f64::from(is_on_diagonal),
            Kind::Mass => self.mass[place],
            Kind::Residual => self.slopes.values[place],
        }
    }

    /// Returns the system with these slopes.
    pub(super) fn at_slopes<'a>(
        &'a self,
        system: &'a mut dyn HybridSystem,
        slopes: &'a [f64],
    ) -> AtSlopes<'a> {
        AtSlopes { system, kind: self.kind, mass: &self.mass, slopes }
    }

    /// Computes the residual of the equations at a point. If the left side is `x'`, this is the right-hand
    /// side.
    pub(super) fn defect(
        &self,
        equations: &mut Equations<'_>,
        Point { t, x, slopes }: Point<'_>,
        defect: &mut [f64],
    ) -> CallResult<()> {
        equations.stats.right_hand_sides += 1;
        self.at_slopes(equations.system, slopes).derivatives(t, x, defect)
    }

    /// Excludes states from the error test by setting their inverse weights to zero.
    pub(super) fn choose_tested(&self, inverse: &mut [f64]) {
        if self.exclude && self.kind != Kind::Identity {
            let untested = inverse.iter_mut().zip(&self.has_slope).filter(|(_, has_slope)| !**has_slope);
            untested.for_each(|(inverse, _)| *inverse = 0.0);
        }
    }

    /// Determines the states that appear in `M x'`, after `M` was computed.
    pub(super) fn find_slopes(&mut self) {
        let Self { kind, mass, slopes, has_slope, nominals, .. } = self;
        has_slope.clear();
        has_slope.resize(nominals.len(), false);
        match kind {
            Kind::Residual => slopes.each(|_, k, m| has_slope[k] |= m != 0.0),
            _ => mass.iter().enumerate().for_each(|(p, m)| has_slope[p / nominals.len()] |= *m != 0.0),
        }
    }

    /// Evaluates `dF/dx'` at a point unless it is unchanged, after the Jacobian was evaluated there. `defect`
    /// is the residual at the point. Returns `true` if `dF/dx'` has changed.
    pub(super) fn renew(
        &mut self,
        equations: &mut Equations<'_>,
        point: Point<'_>,
        defect: &[f64],
    ) -> CallResult<bool> {
        if self.kind != Kind::Residual {
            return Ok(false);
        }
        let Point { t, x, slopes } = point;
        for (i, nominal) in self.nominals.iter_mut().enumerate() {
            *nominal = slopes[i].abs().max(equations.weights.scale(i));
        }
        if self.is_affine.is_none() {
            self.is_affine = Some(self.look_for_curvature(equations, point, defect)?);
        }
        let is_affine = self.is_affine == Some(true);
        if self.is_evaluated && is_affine && self.is_as_before(equations, point, defect)? {
            return Ok(false);
        }
        // If the residual is affine, longer differences are more accurate.
        let longer = if is_affine { (f64::EPSILON / 2.0).sqrt().recip() } else { 1.0 };
        self.nominals.iter_mut().for_each(|nominal| *nominal *= longer);
        let options = Options { relative_tolerance: equations.weights.rtol(), ..Options::default() };
        self.weights.set(&options, &self.nominals, |_| false);
        self.last.copy_from_slice(&self.slopes.values);
        self.value.iter_mut().zip(defect).for_each(|(r, d)| *r = -d);
        let mut at_state = AtState { system: &mut *equations.system, x };
        let mut inner =
            Equations { system: &mut at_state, weights: &self.weights, stats: &mut *equations.stats };
        self.slopes.evaluate(&mut inner, Point { t, x: slopes, slopes: &self.value })?;
        equations.stats.jacobians -= 1;
        let has_changed = !self.is_evaluated || self.last != self.slopes.values;
        self.is_evaluated = true;
        if has_changed {
            self.find_slopes();
            if !self.slopes.is_sparse() {
                self.mass.copy_from_slice(&self.slopes.values);
            }
        }
        Ok(has_changed)
    }

    /// Evaluates the residual at slopes further along the direction.
    fn ahead(
        &mut self,
        equations: &mut Equations<'_>,
        Point { t, x, slopes }: Point<'_>,
        share: f64,
    ) -> CallResult<bool> {
        // Fractions without a common divisor.
        for (i, d) in self.direction.iter_mut().enumerate() {
            *d = share * self.nominals[i] * (1.0 + 0.5 * ((i + 2) as f64).sqrt().fract());
        }
        self.point.iter_mut().zip(slopes.iter().zip(&self.direction)).for_each(|(p, (s, d))| *p = s + d);
        equations.stats.right_hand_sides += 1;
        match equations.system.residual(t, x, &self.point, &mut self.value) {
            Ok(()) => Ok(self.value.iter().all(|v| v.is_finite())),
            Err(CallError::Discard) => Ok(false),
            Err(failed) => Err(failed),
        }
    }

    /// True if the residual is an affine function of the slopes, as far as three points on a line can show.
    fn look_for_curvature(
        &mut self,
        equations: &mut Equations<'_>,
        point: Point<'_>,
        defect: &[f64],
    ) -> CallResult<bool> {
        if !self.ahead(equations, point, 1.0)? {
            return Ok(false);
        }
        let mut near = std::mem::take(&mut self.last);
        near.clear();
        near.extend_from_slice(&self.value);
        let is_there = self.ahead(equations, point, 2.0);
        let affine = (0..near.len()).all(|i| {
            let (a, b, c) = (-defect[i], near[i], self.value[i]);
            (c - 2.0 * b + a).abs() <= 1e-8 * (b - a).abs() + ROUNDING * (a.abs() + b.abs() + c.abs())
        });
        near.resize(self.slopes.values.len(), 0.0);
        self.last = near;
        Ok(is_there? && affine)
    }

    /// True if one evaluation shows that `dF/dx'` is unchanged.
    fn is_as_before(
        &mut self,
        equations: &mut Equations<'_>,
        point: Point<'_>,
        defect: &[f64],
    ) -> CallResult<bool> {
        if !self.ahead(equations, point, 1.0)? {
            return Ok(false);
        }
        let Self { slopes, direction, value, point: allowed, .. } = self;
        for ((v, allowed), d) in value.iter_mut().zip(allowed.iter_mut()).zip(defect) {
            *allowed = ROUNDING * (v.abs() + d.abs());
            *v += d;
        }
        slopes.each(|i, k, m| {
            value[i] -= m * direction[k];
            allowed[i] += SAME * (m * direction[k]).abs();
        });
        Ok(value.iter().zip(allowed).all(|(v, allowed)| v.abs() <= *allowed))
    }

    /// Returns the states that equations without derivatives do not determine, after a failure.
    pub(super) fn undetermined(
        &mut self,
        equations: &mut Equations<'_>,
        Point { t, x, slopes }: Point<'_>,
        freshness: &mut KeptJacobian,
    ) -> Option<Undetermined> {
        if self.kind == Kind::Identity || !self.is_split {
            return None;
        }
        freshness.drop_jacobian();
        let Self { algebraic, mass, kind, .. } = self;
        let mut at_slopes = AtSlopes { system: &mut *equations.system, kind: *kind, mass, slopes };
        let mut inner =
            Equations { system: &mut at_slopes, weights: equations.weights, stats: &mut *equations.stats };
        algebraic.undetermined(&mut inner, freshness.jacobian_mut().0, t, x)
    }
}
