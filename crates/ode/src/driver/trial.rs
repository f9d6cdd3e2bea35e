//! Outcomes of trial steps.

/// Outcome of one trial step.
pub(super) enum Tried {
    /// Good up to its own end, or up to the event found inside.
    Good,
    /// Not good for this reason; to be tried again with this size.
    Again { h: f64, why: Shrink },
}

/// Why a step is made smaller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Shrink {
    /// The error test wants it.
    TooInexact,
    /// The equations of an implicit method were not solved.
    NotSolved,
    /// The model refused a point of it.
    Refused,
    /// An event indicator left its domain and came back in it, which was not seen.
    Returned,
}

/// Event, or reason for a smaller step, inside of a step.
pub(super) enum Inside {
    Nothing,
    Crossing(Found),
    /// The step cannot stand; one of this size may.
    Again {
        h: f64,
        why: Shrink,
    },
}

/// Where a good step is cut.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    /// The point to go on from.
    pub(super) at: f64,
    /// End and size of the trial that the stepper holds now.
    pub(super) end: f64,
    pub(super) h: f64,
    /// A time before the first change of an indicator that is an event at the cut; `None`: there is none.
    pub(super) before: Option<f64>,
}

/// Excursion of an indicator next to zero at the start of a step: it leaves its domain and comes back within
/// the step.
pub(super) enum Return {
    Nothing,
    /// At this time it is in the other domain.
    Found(f64),
    /// It leads into the other domain at the start, and is in the domain where it began at the end, but no
    /// point of the step was found where it is in the other one. A step of this size may show it.
    Unseen {
        indicator: usize,
        shorter: Option<f64>,
    },
}
