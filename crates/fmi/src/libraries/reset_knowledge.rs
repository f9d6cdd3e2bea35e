//! State of knowledge about the reset of an FMU's instances.

/// State of knowledge about the reset of instances of one interface.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ResetKnowledge {
    /// Way in which instances are reset; `None` before it was tried. Only gets worse.
    pub(crate) reuse: Option<Reuse>,
    /// Saved states do not bring an instance back.
    pub(crate) no_restore: bool,
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

impl ResetKnowledge {
    /// Notes what was seen.
    pub(crate) fn note(&mut self, reuse: Reuse) {
        self.reuse = self.reuse.max(Some(reuse));
    }

    /// True if a new instance is made for every run, whatever a simulator has seen.
    pub(crate) fn is_final(&self) -> bool {
        self.reuse >= Some(Reuse::Reinstantiate)
    }
}

/// Way in which the instances of an FMU are reset between simulations: the first of these that was seen to be
/// right. Right means that runs have the same bits as on a new instance, also after a run with other values;
/// speed is not compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Reuse {
    /// By restoring the state saved when the instance was new (model exchange, FMUs that can save states): it
    /// was seen to restore everything, bit for bit. All values are set again afterwards, and read back.
    Restore,
    /// By the FMU's reset function: it was seen to restore everything, bit for bit.
    Reset,
    /// By a new instance for every simulation: nothing else is offered, or it fails, or it leaves traces.
    Reinstantiate,
    /// By a new process for every simulation: the model keeps a state outside of its instances. Where
    /// simulations are made in this process, each has a new instance, and results may depend on earlier ones.
    NewProcess,
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

    #[test]
    fn verdicts_only_get_worse() {
        let mut verdict = ResetKnowledge::default();
        verdict.note(Reuse::Reset);
        verdict.note(Reuse::Restore);
        assert_eq!((verdict.reuse, verdict.is_final()), (Some(Reuse::Reset), false));
        verdict.note(Reuse::Reinstantiate);
        assert!(verdict.is_final());
    }
}
