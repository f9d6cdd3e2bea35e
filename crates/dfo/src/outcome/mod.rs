//! Answers of an objective, the trace of a run, and the reasons for its end.

pub(crate) mod answer;
pub(crate) mod termination;
pub(crate) mod trace;
