//! Outcomes of trial steps.

/// Outcome of one trial step.
pub(super) enum Tried {
    /// The trial is good up to its end, or up to the event found inside.
    Good,
    /// The trial failed for this reason and must be repeated with step size `h`.
    Again { h: f64, why: Shrink },
}

/// Reason for a smaller step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Shrink {
    /// The error test requires a smaller step.
    TooInexact,
    /// The equations of an implicit method were not solved.
    NotSolved,
    /// The model refused a point of the trial.
    Refused,
    /// An event indicator left its domain and returned within the step without being seen outside.
    Returned,
}

/// Event inside a step, or reason for a smaller step.
pub(super) enum Inside {
    Nothing,
    Crossing(Found),
    /// The step cannot be accepted; a step of size `h` may be.
    Again {
        h: f64,
        why: Shrink,
    },
}

/// Point at which a good step is cut.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    /// Point from which to continue.
    pub(super) at: f64,
    /// End and size of the trial that the stepper currently stores.
    pub(super) end: f64,
    pub(super) h: f64,
    /// Time before the first change of an indicator that is an event at the cut; `None` if there is none.
    pub(super) before: Option<f64>,
}

/// Excursion of an indicator that is near zero at the start of a step: it leaves its domain and returns
/// within the step.
pub(super) enum Return {
    Nothing,
    /// At this time, the indicator is in the other domain.
    Found(f64),
    /// The indicator leads into the other domain at the start and ends the step in its initial domain. No
    /// evaluated point of the step was in the other domain. A step of size `shorter` may show it.
    Unseen {
        indicator: usize,
        shorter: Option<f64>,
    },
}
