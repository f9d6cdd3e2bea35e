//! Errors that replace a result: one typed error, with indices and values.

use crate::outcome::termination::Termination;
use crate::outcome::trace::Trace;
use crate::values::choices::ParameterKind;
use crate::values::record::RecordError;
use base::{Bytes, Number};
use std::fmt;

/// Reason why a minimisation could not start, or ended without a usable point.
///
/// Stopping early is not an error. If at least one used point has a finite cost, a run ends with a
/// [`Report`](crate::Report), whose [`Termination`] contains the reason.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No start point was given.
    #[error("the start point (x0) is missing")]
    NoStart,
    /// The start point has no parameters.
    #[error("the start point (x0) is empty; expected at least one parameter")]
    Empty,
    /// The length of a list differs from the number of parameters.
    #[error("{what}: expected {expected} values, one per parameter; got {got}")]
    Length {
        /// Name of the list.
        what: &'static str,
        /// Entries needed.
        expected: usize,
        /// Entries given.
        got: usize,
    },
    /// A bound is NaN, a lower bound is +inf or an upper bound is -inf.
    #[error("the {side} bound of x[{index}] must not be {value}", value = Number(*.value))]
    BadBound {
        /// `"lower"` or `"upper"`.
        side: &'static str,
        /// Parameter, counted from 0.
        index: usize,
        /// The bound.
        value: f64,
    },
    /// A lower bound is above the upper bound.
    #[error("x[{index}]: the lower bound {lower} is above the upper bound {upper}", lower = Number(*.lower), upper = Number(*.upper))]
    BoundsCrossed {
        /// Parameter, counted from 0.
        index: usize,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// A coordinate of the start point is NaN or infinite.
    #[error("x0[{index}] = {value} is not finite", value = Number(*.value))]
    StartNotFinite {
        /// Parameter, counted from 0.
        index: usize,
        /// Its start value.
        value: f64,
    },
    /// The start point is outside of the box.
    #[error("x0[{index}] = {value} is outside its bounds [{lower}, {upper}]", value = Number(*.value), lower = Number(*.lower), upper = Number(*.upper))]
    StartOutside {
        /// Parameter, counted from 0.
        index: usize,
        /// Its start value.
        value: f64,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// A parameter on a logarithmic scale has a start value or bound that has no logarithm.
    #[error("x[{index}] has a logarithmic scale, but its {what} is {value}; expected a positive number", value = Number(*.value))]
    LogScale {
        /// Parameter, counted from 0.
        index: usize,
        /// `"start value"`, `"lower bound"` or `"upper bound"`.
        what: &'static str,
        /// The value.
        value: f64,
    },
    /// An entry of a per-parameter option is out of range.
    #[error("{name} of x[{index}] = {value} must be {range}", value = Number(*.value))]
    ParameterOption {
        /// Name of the option.
        name: &'static str,
        /// Parameter, counted from 0.
        index: usize,
        /// The value given.
        value: f64,
        /// Condition that it must meet.
        range: &'static str,
    },
    /// A discrete parameter has no integer between its bounds.
    #[error(
        "x[{index}] is discrete, but there is no integer between its bounds {lower} and {upper}", lower = Number(*.lower), upper = Number(*.upper)
    )]
    NoWholeNumber {
        /// Parameter, counted from 0.
        index: usize,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// A number is outside its range.
    #[error("{name} = {value} must be {range}", value = Number(*.value))]
    Option {
        /// Name of the option.
        name: &'static str,
        /// The value given.
        value: f64,
        /// Condition that it must meet.
        range: &'static str,
    },
    /// A value does not fit its option, or the option does not exist.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The name or number of the method is unknown.
    #[error("unknown method '{name}'; expected one of: {available}{hint}")]
    UnknownMethod {
        /// The name or number given.
        name: String,
        /// Suggestion of a similar name.
        hint: String,
        /// Available names.
        available: String,
    },
    /// A least-squares method was used with an objective that returns only a cost.
    #[error(
        "{method} requires residuals, but the objective returns only a cost. Return the vector of residuals, \
         or use another method"
    )]
    NeedsResiduals {
        /// The method.
        method: &'static str,
    },
    /// A method needs a finite range for each parameter.
    #[error("{method} requires finite bounds, but x[{index}] has the bounds [{lower}, {upper}]", lower = Number(*.lower), upper = Number(*.upper))]
    NeedsBox {
        /// The method.
        method: &'static str,
        /// Parameter, counted from 0.
        index: usize,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// The limits of a constraint are NaN, contradict each other or exclude every number.
    #[error("{kind} constraint {index}: no number is between its limits {lower} and {upper}", lower = Number(*.lower), upper = Number(*.upper))]
    ConstraintLimits {
        /// `"linear"`, `"nonlinear"` or `"nonlinear equality"`.
        kind: &'static str,
        /// Constraint, counted from 0.
        index: usize,
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
    },
    /// A coefficient of a linear constraint is not finite.
    #[error("linear constraint {constraint}: the coefficient of x[{index}] is {value}; expected a finite number", value = Number(*.value))]
    ConstraintCoefficient {
        /// Constraint, counted from 0.
        constraint: usize,
        /// Parameter, counted from 0.
        index: usize,
        /// The coefficient.
        value: f64,
    },
    /// A linear constraint contains a discrete parameter.
    #[error(
        "linear constraint {constraint} contains x[{index}], which is {kind}. State it as a nonlinear \
         constraint, which differential evolution and the genetic algorithm support"
    )]
    DiscreteConstraint {
        /// Constraint, counted from 0.
        constraint: usize,
        /// Parameter, counted from 0.
        index: usize,
        /// Its kind.
        kind: ParameterKind,
    },
    /// No point satisfies the bounds and the linear constraints.
    #[error("no point satisfies {}", infeasible(.constraint))]
    Infeasible {
        /// A linear constraint that contradicts the bounds and the constraints before it, counted from 0;
        /// `None` if it is unknown.
        constraint: Option<usize>,
    },
    /// The linear inequalities leave no room between them.
    #[error(
        "the linear inequalities and bounds allow only points on a plane. Replace the inequalities that \
         imply an equality with this equality"
    )]
    NoInterior,
    /// A method does not support constraints of this kind.
    #[error("{method} does not support {kind} constraints; use {use_instead}")]
    NoConstraints {
        /// The method.
        method: &'static str,
        /// `"linear"` or `"nonlinear"`.
        kind: &'static str,
        /// Methods that support them.
        use_instead: &'static str,
    },
    /// Too few complete trajectories or rows of a sensitivity analysis are left.
    #[error(
        "{left} complete {rows} are left for the sensitivity analysis; at least 2 are required{}",
        reason.as_ref().map_or_else(String::new, |reason| format!(". Most frequent reason of missing values: {reason}"))
    )]
    TooFewValues {
        /// `"trajectories"` or `"rows"`.
        rows: &'static str,
        /// Number of complete ones.
        left: usize,
        /// Most frequent reason of missing values.
        reason: Option<String>,
    },
    /// The number of constraint values differs from the number of nonlinear constraints.
    #[error("the objective returned {got} constraint values at x = {x:?}; expected {expected}")]
    ConstraintCount {
        /// Number of nonlinear constraints.
        expected: usize,
        /// Number of values.
        got: usize,
        /// The point.
        x: Vec<f64>,
    },
    /// The barrier method needs a start point strictly inside the bounds.
    #[error(
        "x0[{index}] = {value} must be strictly between its bounds {lower} and {upper}", value = Number(*.value), lower = Number(*.lower), upper = Number(*.upper)
    )]
    StartNotInterior {
        /// Parameter, counted from 0.
        index: usize,
        /// Its start value.
        value: f64,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// The method requires at least one bound, and there is none.
    #[error("{method} requires at least one bound")]
    NoBounds {
        /// The method.
        method: &'static str,
    },
    /// A method cannot search over a discrete parameter.
    #[error("{method} does not support x[{index}], which is {kind}")]
    NotContinuous {
        /// The method.
        method: &'static str,
        /// Parameter, counted from 0.
        index: usize,
        /// Its kind.
        kind: ParameterKind,
    },
    /// The number of vertices of an initial simplex is not the number of free parameters plus one.
    #[error("the initial simplex has {got} vertices; expected {expected} (free parameters + 1)")]
    SimplexSize {
        /// Vertices needed.
        expected: usize,
        /// Vertices given.
        got: usize,
    },
    /// A vertex of an initial simplex has a coordinate that is not finite or is outside the box.
    #[error(
        "initial simplex: coordinate x[{index}] = {value} of vertex {vertex} is outside its bounds [{lower}, \
         {upper}]", value = Number(*.value), lower = Number(*.lower), upper = Number(*.upper)
    )]
    SimplexOutside {
        /// Vertex, counted from 0.
        vertex: usize,
        /// Parameter, counted from 0.
        index: usize,
        /// The coordinate.
        value: f64,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// The vertices of an initial simplex span a space of lower dimension.
    #[error("the initial simplex is flat: its vertices span only {rank} of {n} dimensions")]
    DegenerateSimplex {
        /// Dimensions spanned.
        rank: usize,
        /// Free parameters.
        n: usize,
    },
    /// A member of an initial population has a coordinate that is not finite or is outside the box.
    #[error(
        "initial population: coordinate x[{index}] = {value} of member {member} is outside its bounds \
         [{lower}, {upper}]", value = Number(*.value), lower = Number(*.lower), upper = Number(*.upper)
    )]
    MemberOutside {
        /// Member, counted from 0.
        member: usize,
        /// Parameter, counted from 0.
        index: usize,
        /// The coordinate.
        value: f64,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// All members of an initial population have the same value of a free parameter.
    #[error(
        "the initial population is flat: x[{index}] = {value} in all members, so the search cannot change \
         it", value = Number(*.value)
    )]
    FlatPopulation {
        /// Parameter, counted from 0.
        index: usize,
        /// Its value in all members.
        value: f64,
    },
    /// The checkpoint file cannot be read or written.
    #[error("checkpoint {path}: {message}")]
    CheckpointFile {
        /// The file.
        path: String,
        /// Kind of the error; `NotFound` if a checkpoint was required and does not exist.
        kind: std::io::ErrorKind,
        /// Message of the system.
        message: String,
    },
    /// The file is not a usable checkpoint.
    #[error("checkpoint {path}: {message}")]
    Checkpoint {
        /// The file.
        path: String,
        /// Reason why it cannot be used.
        message: String,
    },
    /// A checkpoint belongs to another run.
    #[error("checkpoint {path} belongs to another run ({what}: {stored} in the file, {given} in this run)")]
    CheckpointMismatch {
        /// The file, which is left unchanged.
        path: String,
        /// Name of the entry that differs.
        what: String,
        /// Value in the file.
        stored: String,
        /// Value in this run.
        given: String,
    },
    /// `tell` was called with an id that is not waiting for an answer.
    #[error("tell: point {id} is not waiting for an answer")]
    UnknownPoint {
        /// The id.
        id: u64,
    },
    /// The saved state of a method cannot be continued.
    #[error("cannot continue from the saved state of the method: {message}")]
    State {
        /// Reason why the state cannot be continued.
        message: String,
    },
    /// `tell` was called before a batch was requested.
    #[error("tell: no batch is waiting for an answer; call ask first")]
    TellWithoutAsk,
    /// `tell` was called with more outcomes than the batch has points.
    #[error("tell: got {received} outcomes for a batch of {requested} points")]
    TooManyOutcomes {
        /// Points in the batch.
        requested: usize,
        /// Outcomes given.
        received: usize,
    },
    /// The number of residuals differs between points.
    #[error("the objective returned {got} residuals at x = {x:?}, but {expected} at earlier points")]
    ResidualCount {
        /// Number of residuals at the earlier points.
        expected: usize,
        /// Number of residuals at this point.
        got: usize,
        /// The point.
        x: Vec<f64>,
    },
    /// State that a method must keep does not fit into memory.
    #[error("not enough memory for {what}, which requires {}", Bytes(*.bytes))]
    Memory {
        /// Description of the state.
        what: &'static str,
        /// Its size in bytes.
        bytes: f64,
    },
    /// The objective failed at every starting point.
    #[error("the objective failed at every starting point: {0}")]
    AllStartsFailed(Box<NothingFound>),
    /// The run ended before any point had a finite cost.
    #[error("the run ended ({termination}) before any point had a finite cost: {found}")]
    EndedWithoutPoint {
        /// Reason why the run ended.
        termination: Termination,
        /// Evaluations until the end.
        found: Box<NothingFound>,
    },
}

fn infeasible(constraint: &Option<usize>) -> String {
    let all = "the bounds and the linear constraints";
    match constraint {
        Some(constraint) => format!("{all}: constraint {constraint} contradicts them"),
        None => all.to_owned(),
    }
}

impl Error {
    /// Returns the index of the parameter that caused the error, counted from 0. `None` if the error does not
    /// concern a single parameter.
    pub fn parameter(&self) -> Option<usize> {
        match self {
            Self::BadBound { index, .. }
            | Self::BoundsCrossed { index, .. }
            | Self::StartNotFinite { index, .. }
            | Self::StartOutside { index, .. }
            | Self::LogScale { index, .. }
            | Self::ParameterOption { index, .. }
            | Self::NoWholeNumber { index, .. }
            | Self::NeedsBox { index, .. }
            | Self::StartNotInterior { index, .. }
            | Self::NotContinuous { index, .. }
            | Self::SimplexOutside { index, .. }
            | Self::MemberOutside { index, .. }
            | Self::FlatPopulation { index, .. } => Some(*index),
            _ => None,
        }
    }

    /// Returns the evaluations before the error, if any.
    pub fn trace(&self) -> Option<&Trace> {
        match self {
            Self::AllStartsFailed(found) | Self::EndedWithoutPoint { found, .. } => Some(&found.trace),
            _ => None,
        }
    }
}

/// Evaluations of a run that found no finite cost.
#[derive(Debug, Clone, PartialEq)]
pub struct NothingFound {
    /// Evaluations made.
    pub n_evaluations: usize,
    /// Number of points whose cost was not evaluated, because a constraint is violated.
    pub n_infeasible: usize,
    /// Reasons of the failures with their counts, most frequent first.
    pub failures: Vec<(String, usize)>,
    /// The first point that failed, if any.
    pub x: Option<Vec<f64>>,
    /// Every evaluation.
    pub trace: Trace,
}

impl fmt::Display for NothingFound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} evaluations, ", self.n_evaluations)?;
        if self.n_infeasible > 0 {
            let n = self.n_infeasible;
            write!(f, "{n} without a cost because they violate a constraint with keep_feasible, ")?;
        }
        if self.failures.is_empty() {
            return f.write_str("none failed");
        }
        const SHOWN: usize = 5;
        let failed: usize = self.failures.iter().map(|(_, count)| count).sum();
        write!(f, "{failed} failed: ")?;
        for (k, (reason, count)) in self.failures.iter().take(SHOWN).enumerate() {
            write!(f, "{}{count} x {reason}", if k > 0 { ", " } else { "" })?;
        }
        if self.failures.len() > SHOWN {
            write!(f, ", and {} more reasons", self.failures.len() - SHOWN)?;
        }
        match &self.x {
            Some(x) => write!(f, "; first at x = {x:?}"),
            None => Ok(()),
        }
    }
}
