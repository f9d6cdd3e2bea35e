//! Knowledge about the instances of an FMU: how they are reset, and which declarations of the description
//! they do not follow.

/// Knowledge about the instances of one interface.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ResetKnowledge {
    /// Co-simulation: instances are created without the event mode that the description declares.
    pub(crate) no_event_mode: bool,
    /// Co-simulation: state of the decision to pass the stop time to the model.
    pub(crate) stop_time: StopTime,
}

/// Decision to pass the stop time to a co-simulation. Some models add up their steps and reject the last one,
/// which ends a rounding error after the stop time (seen in FMUs of 20-sim).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum StopTime {
    /// Passed: no last step has been rejected so far.
    #[default]
    Passed,
    /// The last step was rejected. The next run omits the stop time, for comparison.
    OnTrial,
    /// Omitted: the last step was rejected with a stop time and succeeded without one.
    Withheld,
    /// Passed: the run also failed without a stop time.
    Kept,
}

impl StopTime {
    pub(crate) fn is_passed(self) -> bool {
        matches!(self, Self::Passed | Self::Kept)
    }

    /// Returns the state after the model failed in a run. `was_passed` is true if this run passed the stop
    /// time.
    pub(crate) fn after_failure(self, was_passed: bool) -> Self {
        if self == Self::OnTrial && !was_passed { Self::Kept } else { self }
    }

    /// Returns the state after a last step. `was_passed` is true if its run passed the stop time.
    pub(crate) fn after_last_step(self, was_passed: bool, is_refused: bool) -> Self {
        match (self, was_passed, is_refused) {
            (Self::Passed, true, true) => Self::OnTrial,
            (Self::OnTrial, false, false) => Self::Withheld,
            (stop_time, _, true) => stop_time.after_failure(was_passed),
            (stop_time, ..) => stop_time,
        }
    }
}

/// Method by which a worker process resets a model between two simulations. A new model begins with `Reset`.
/// The parent process compares answers with the answers of a fresh process. If they differ, the parent uses
/// the next method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
#[non_exhaustive]
pub enum Reuse {
    /// The reset function of the FMU. A new instance is created if there is no such function (FMI 1.0 model
    /// exchange) or if it fails.
    #[default]
    Reset,
    /// A new instance for every simulation.
    Reinstantiate,
    /// A new process for every simulation, because the model keeps state outside its instances.
    NewProcess,
}

impl Reuse {
    /// All methods, in the order in which they are tried.
    pub(crate) const ALL: [Self; 3] = [Self::Reset, Self::Reinstantiate, Self::NewProcess];
}
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stop_time_is_withheld_when_last_step_succeeds_without_it() {
        let after = |steps: &[bool]| {
            steps.iter().fold(StopTime::Passed, |stop_time, refused| {
                stop_time.after_last_step(stop_time.is_passed(), *refused)
            })
        };
        assert_eq!(after(&[false, true]), StopTime::OnTrial);
        assert_eq!(after(&[true, false, true]), StopTime::Withheld);
        assert_eq!(after(&[true, true, true]), StopTime::Kept);
    }
}
