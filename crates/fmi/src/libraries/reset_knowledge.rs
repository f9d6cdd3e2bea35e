//! What is known about the instances of an FMU: how they are brought back to their start, and which promises
//! of the description they do not keep.

/// What is known about the instances of one interface.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ResetKnowledge {
    /// Co-simulation: instances are not made with the event mode that the description promises.
    pub(crate) no_event_mode: bool,
    /// Co-simulation: whether the model is told the stop time.
    pub(crate) stop_time: StopTime,
}

/// Whether a co-simulation is told its stop time. Some models add up their steps and refuse the last one,
/// which ends a rounding error after the stop time (seen in FMUs of 20-sim).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum StopTime {
    /// It is told: the last step was not refused yet.
    #[default]
    Told,
    /// The last step was refused: the next run is not told, to compare.
    OnTrial,
    /// It is not told: the last step was refused with a stop time, and made without one.
    Withheld,
    /// It is told: without a stop time the run failed, too.
    Kept,
}

impl StopTime {
    pub(crate) fn is_told(self) -> bool {
        matches!(self, Self::Told | Self::Kept)
    }

    /// What is known after the model failed in a run; `was_told`: in this run.
    pub(crate) fn after_failure(self, was_told: bool) -> Self {
        if self == Self::OnTrial && !was_told { Self::Kept } else { self }
    }

    /// What is known after a last step; `was_told`: in the run that it belongs to.
    pub(crate) fn after_last_step(self, was_told: bool, is_refused: bool) -> Self {
        match (self, was_told, is_refused) {
            (Self::Told, true, true) => Self::OnTrial,
            (Self::OnTrial, false, false) => Self::Withheld,
            (known, _, true) => known.after_failure(was_told),
            (known, ..) => known,
        }
    }
}

/// How a worker process returns a model to its start between two simulations. A new model begins with
/// `Reset`. The process that asks compares answers with those of a fresh process, and takes the next way if
/// they differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
#[non_exhaustive]
pub enum Reuse {
    /// By the FMU's reset function. Without one (FMI 1.0 model exchange) or if it fails, by a new instance.
    #[default]
    Reset,
    /// By a new instance for every simulation.
    Reinstantiate,
    /// By a new process for every simulation: the model keeps a state outside of its instances.
    NewProcess,
}

impl Reuse {
    /// All ways, in the order in which they are tried.
    pub(crate) const ALL: [Self; 3] = [Self::Reset, Self::Reinstantiate, Self::NewProcess];
}
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stop_time_is_withheld_if_only_its_absence_lets_the_last_step_pass() {
        let after = |steps: &[bool]| {
            steps
                .iter()
                .fold(StopTime::Told, |known, refused| known.after_last_step(known.is_told(), *refused))
        };
        assert_eq!(after(&[false, true]), StopTime::OnTrial);
        assert_eq!(after(&[true, false, true]), StopTime::Withheld);
        assert_eq!(after(&[true, true, true]), StopTime::Kept);
    }
}
