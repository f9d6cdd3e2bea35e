//! Rules for evaluating the Jacobian again and for decomposing the matrix of Newton's method again.

use super::newton::INITIAL_RATE;
use crate::jacobian::Jacobian;
use crate::stats::Stats;
use crate::stepper::{Equations, Point};
use crate::system::{CallResult, HybridSystem};

/// Convergence with more iterations than this is slow.
const ITERATIONS: u32 = 2;
/// After a failure, the Jacobian is assumed to be the cause if the coefficient has changed by less than this
/// fraction since the decomposition.
const SAME_MATRIX: f64 = 0.2;

/// Parameters of a method.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules {
    /// The decomposition is kept while its coefficient changes by at most this fraction, for at most
    /// `decomposition_steps` steps.
    pub(super) change: f64,
    pub(super) decomposition_steps: u32,
    /// Number of steps for which the Jacobian is kept.
    pub(super) jacobian_steps: u32,
    /// A Jacobian that requires at most this number of evaluations is cheap. It is evaluated again as soon as
    /// convergence slows down or a step fails. A more expensive one is evaluated only if slow convergence
    /// costs iterations.
    pub(super) cheap: usize,
    /// If true, slow convergence causes a new Jacobian only if the last one is from before an event.
    /// Otherwise, slow convergence is attributed to the different coefficient of the matrix.
    pub(super) only_after_events: bool,
}

/// State of the decomposed matrix after [`prepare`](KeptJacobian::prepare).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Matrix {
    Kept,
    New,
    /// The matrix is singular even with a fresh Jacobian.
    Singular,
}

/// The Jacobian, and the ages of the Jacobian and the decomposition.
#[derive(Debug)]
pub(crate) struct KeptJacobian {
    rules: Rules,
    jacobian: Jacobian,
    has_jacobian: bool,
    needs_jacobian: bool,
    /// Steps since the Jacobian was evaluated; 0 if it was evaluated at the current point.
    age: u32,
    /// True if the Jacobian is from before an event.
    is_before_event: bool,
    /// Coefficient of the decomposed matrix; 0 if there is none.
    coefficient: f64,
    decomposition_age: u32,
}

impl KeptJacobian {
    pub(super) fn new(rules: Rules) -> Self {
        Self {
            rules,
            jacobian: Jacobian::default(),
            has_jacobian: false,
            needs_jacobian: false,
            age: 0,
            is_before_event: false,
            coefficient: 0.0,
            decomposition_age: 0,
        }
    }

    /// Allocates the work space for the system.
    ///
    /// # Errors
    /// Returns an error if memory is insufficient for a dense matrix of this size.
    pub(super) fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()> {
        self.drop_jacobian();
        self.needs_jacobian = false;
        self.jacobian.begin(system)
    }

    pub(super) fn jacobian(&self) -> &Jacobian {
        &self.jacobian
    }

    /// True if there is a Jacobian of the current point.
    pub(super) fn is_here(&self) -> bool {
        self.has_jacobian && self.age == 0
    }

    /// The Jacobian to be changed, and whether it is valid.
    pub(super) fn jacobian_mut(&mut self) -> (&mut Jacobian, bool) {
        (&mut self.jacobian, self.has_jacobian)
    }

    /// Coefficient of the decomposed matrix.
    pub(super) fn coefficient(&self) -> f64 {
        self.coefficient
    }

    /// Discards the Jacobian.
    pub(super) fn drop_jacobian(&mut self) {
        self.has_jacobian = false;
        self.coefficient = 0.0;
    }

    /// Reports that other code has evaluated the Jacobian: at the current point, or elsewhere, so that it is
    /// invalid.
    pub(super) fn take_new(&mut self, is_here: bool) {
        self.has_jacobian = is_here;
        self.age = u32::from(!is_here);
        self.needs_jacobian = false;
        self.coefficient = 0.0;
    }

    /// Takes the Jacobian of another method, which loses it.
    pub(crate) fn take_over(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.jacobian, &mut other.jacobian);
        other.has_jacobian = false;
        self.take_new(true);
    }

    /// Reports an event, after which the right-hand side may differ.
    pub(super) fn event(&mut self) {
        self.coefficient = 0.0;
        self.is_before_event = true;
        self.needs_jacobian = false;
    }

    /// Reports that the current point has changed.
    pub(super) fn moved(&mut self) {
        self.age = self.age.max(1);
    }

    /// Ensures that there is a Jacobian and a decomposition for this coefficient, computed by `decompose`. A
    /// new Jacobian is evaluated at `point`, whose slopes must be the right-hand side.
    pub(super) fn prepare(
        &mut self,
        equations: &mut Equations<'_>,
        coefficient: f64,
        point: Point<'_>,
        mut decompose: impl FnMut(&Jacobian, &mut Stats) -> bool,
    ) -> CallResult<Matrix> {
        loop {
            let is_old = self.change(coefficient) > self.rules.change
                || self.decomposition_age >= self.rules.decomposition_steps;
            let is_overdue = is_old && self.age > self.rules.jacobian_steps;
            if !self.has_jacobian || self.needs_jacobian || is_overdue {
                self.jacobian.evaluate(equations, point)?;
                self.take_new(true);
                self.is_before_event = false;
            } else if !is_old {
                return Ok(Matrix::Kept);
            }
            if decompose(&self.jacobian, equations.stats) {
                self.coefficient = coefficient;
                self.decomposition_age = 0;
                return Ok(Matrix::New);
            }
            self.coefficient = 0.0;
            if self.age == 0 {
                return Ok(Matrix::Singular);
            }
            self.needs_jacobian = true;
        }
    }

    /// Relative change of the coefficient since the decomposition.
    fn change(&self, coefficient: f64) -> f64 {
        if self.coefficient == 0.0 { f64::INFINITY } else { (coefficient / self.coefficient - 1.0).abs() }
    }

    /// Reacts to a failure of Newton's method. Returns `true` if a new Jacobian or decomposition may help.
    pub(super) fn renew_after_failure(&mut self, coefficient: f64) -> bool {
        if self.age == 0 && self.coefficient == coefficient {
            return false;
        }
        self.needs_jacobian = self.change(coefficient) < SAME_MATRIX;
        self.coefficient = 0.0;
        true
    }

    /// Reacts to a rejected step.
    pub(super) fn rejected(&mut self) {
        self.needs_jacobian = self.needs_jacobian || (self.age > 0 && self.is_cheap());
        self.coefficient = 0.0;
    }

    /// Requests a Jacobian because the step failed without one at its end.
    pub(super) fn request_jacobian(&mut self) {
        self.needs_jacobian = true;
    }

    /// True if a new Jacobian is needed for the next step.
    pub(super) fn needs_jacobian(&self) -> bool {
        self.needs_jacobian
    }

    fn is_cheap(&self) -> bool {
        self.jacobian.cost() <= self.rules.cheap
    }

    /// Reacts to an accepted step in which Newton's method made this number of iterations at this rate.
    pub(super) fn accepted(&mut self, iterations: u32, rate: f64) {
        self.age += 1;
        self.decomposition_age += 1;
        let is_slow = rate > INITIAL_RATE && (iterations > ITERATIONS || self.is_cheap());
        self.needs_jacobian = is_slow && (self.is_before_event || !self.rules.only_after_events);
    }
}
