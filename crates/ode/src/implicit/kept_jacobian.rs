//! When the Jacobian is evaluated anew, and when the matrix of Newton's method is decomposed anew.

use super::newton::INITIAL_RATE;
use crate::jacobian::Jacobian;
use crate::stats::Stats;
use crate::stepper::{Equations, Point};
use crate::system::{CallResult, HybridSystem};

/// More iterations than this are slow.
const ITERATIONS: u32 = 2;
/// After a failure the Jacobian is taken as the cause where the coefficient has changed by less than this
/// since the decomposition.
const SAME_MATRIX: f64 = 0.2;

/// The numbers of a method.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules {
    /// The decomposition is kept while the coefficient of its matrix changes by no more than this share of
    /// it, and for so many steps.
    pub(super) change: f64,
    pub(super) decomposition_steps: u32,
    /// The Jacobian is kept for so many steps.
    pub(super) jacobian_steps: u32,
    /// A Jacobian of so few evaluations is made anew as soon as convergence slows down or a step fails; a
    /// dearer one only when the slow convergence costs iterations.
    pub(super) cheap: usize,
    /// Slow convergence is a reason for a new Jacobian only where the last one is from before an event:
    /// elsewhere it comes from the matrix, of another coefficient.
    pub(super) only_after_events: bool,
}

/// State of the decomposed matrix after [`prepare`](KeptJacobian::prepare).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Matrix {
    Kept,
    New,
    /// With a fresh Jacobian too.
    Singular,
}

/// The Jacobian, and how old it and the decomposition are.
#[derive(Debug)]
pub(crate) struct KeptJacobian {
    rules: Rules,
    jacobian: Jacobian,
    has_jacobian: bool,
    wants_jacobian: bool,
    /// Steps since the Jacobian was made; 0: at the current point.
    age: u32,
    /// The Jacobian is from before an event.
    is_before_event: bool,
    /// Coefficient of the decomposed matrix; 0: none.
    coefficient: f64,
    decomposition_age: u32,
}

impl KeptJacobian {
    pub(super) fn new(rules: Rules) -> Self {
        Self {
            rules,
            jacobian: Jacobian::default(),
            has_jacobian: false,
            wants_jacobian: false,
            age: 0,
            is_before_event: false,
            coefficient: 0.0,
            decomposition_age: 0,
        }
    }

    /// Makes room for the system.
    ///
    /// # Errors
    /// There is none for a dense matrix of this size.
    pub(super) fn begin(&mut self, system: &dyn HybridSystem) -> CallResult<()> {
        self.drop_jacobian();
        self.wants_jacobian = false;
        self.jacobian.begin(system)
    }

    pub(super) fn jacobian(&self) -> &Jacobian {
        &self.jacobian
    }

    /// True if there is a Jacobian of the current point.
    pub(super) fn is_here(&self) -> bool {
        self.has_jacobian && self.age == 0
    }

    /// The Jacobian, for a change of it, and whether there is one.
    pub(super) fn jacobian_mut(&mut self) -> (&mut Jacobian, bool) {
        (&mut self.jacobian, self.has_jacobian)
    }

    /// Coefficient of the decomposed matrix.
    pub(super) fn coefficient(&self) -> f64 {
        self.coefficient
    }

    /// There is no Jacobian any more.
    pub(super) fn drop_jacobian(&mut self) {
        self.has_jacobian = false;
        self.coefficient = 0.0;
    }

    /// The Jacobian was evaluated by another part: at the current point, or elsewhere, where it is of no use.
    pub(super) fn take_new(&mut self, is_here: bool) {
        self.has_jacobian = is_here;
        self.age = u32::from(!is_here);
        self.wants_jacobian = false;
        self.coefficient = 0.0;
    }

    /// Takes the Jacobian of another method, which loses it.
    pub(crate) fn take_over(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.jacobian, &mut other.jacobian);
        other.has_jacobian = false;
        self.take_new(true);
    }

    /// The right-hand side may be another one from here on.
    pub(super) fn event(&mut self) {
        self.coefficient = 0.0;
        self.is_before_event = true;
        self.wants_jacobian = false;
    }

    /// The current point is another one.
    pub(super) fn moved(&mut self) {
        self.age = self.age.max(1);
    }

    /// Sees to it that there is a Jacobian, evaluated at a point whose slopes are the right-hand side
    /// where it must be a new one, and a decomposition for this coefficient, which `decompose` makes.
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
            if !self.has_jacobian || self.wants_jacobian || is_overdue {
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
            self.wants_jacobian = true;
        }
    }

    /// By which share the coefficient has changed since the decomposition.
    fn change(&self, coefficient: f64) -> f64 {
        if self.coefficient == 0.0 { f64::INFINITY } else { (coefficient / self.coefficient - 1.0).abs() }
    }

    /// Newton's method has failed. `true`: with what is made anew now it may not.
    pub(super) fn renew_after_failure(&mut self, coefficient: f64) -> bool {
        if self.age == 0 && self.coefficient == coefficient {
            return false;
        }
        self.wants_jacobian = self.change(coefficient) < SAME_MATRIX;
        self.coefficient = 0.0;
        true
    }

    /// A step was not good.
    pub(super) fn rejected(&mut self) {
        self.wants_jacobian = self.wants_jacobian || (self.age > 0 && self.is_cheap());
        self.coefficient = 0.0;
    }

    /// The step failed for want of a Jacobian at its end.
    pub(super) fn want_jacobian(&mut self) {
        self.wants_jacobian = true;
    }

    /// True if a new Jacobian is needed for the next step.
    pub(super) fn wants_jacobian(&self) -> bool {
        self.wants_jacobian
    }

    fn is_cheap(&self) -> bool {
        self.jacobian.cost() <= self.rules.cheap
    }

    /// A step was accepted, in which Newton's method took so many iterations at this rate.
    pub(super) fn accepted(&mut self, iterations: u32, rate: f64) {
        self.age += 1;
        self.decomposition_age += 1;
        let is_slow = rate > INITIAL_RATE && (iterations > ITERATIONS || self.is_cheap());
        self.wants_jacobian = is_slow && (self.is_before_event || !self.rules.only_after_events);
    }
}
