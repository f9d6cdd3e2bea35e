//! Answers of an objective, the trace of a run, Pareto fronts, and the reasons for its end.

pub(crate) mod answer;
pub(crate) mod pareto_front;
pub(crate) mod termination;
pub(crate) mod trace;
