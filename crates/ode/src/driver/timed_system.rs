//! A system that answers no more once the run was cancelled or its time is up, so that a long step ends as
//! well, and whose calls are timed.

use super::end_conditions::EndConditions;
use crate::sparsity::JacobianPattern;
use crate::stats::{Seconds, Stats};
use crate::stopwatch::Stopwatch;
use crate::system::{
    Argument, CallError, CallResult, Direction, EventOutcome, EventVisit, HybridSystem, InputStop,
    StepAction, hand_on,
};
use std::time::Instant;

/// The calls that run the model; each is a kind of its own for the stopwatch.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Call {
    Derivatives,
    Jacobian,
    DirectionalDerivative,
    EventIndicators,
    Outputs,
    StepCompleted,
    Nominals,
    Start,
    HandleEvent,
}

impl Call {
    const KINDS: usize = Self::HandleEvent as usize + 1;

    /// Of these a step makes many: they are refused when the run is to end.
    const fn is_evaluation(self) -> bool {
        matches!(
            self,
            Self::Derivatives | Self::Jacobian | Self::DirectionalDerivative | Self::EventIndicators
        )
    }

    /// These are seldom, and one may take much longer than another.
    const fn is_seldom(self) -> bool {
        matches!(self, Self::Nominals | Self::Start | Self::HandleEvent)
    }
}

/// A system under watch.
pub(crate) struct TimedSystem<'a, S: ?Sized> {
    system: &'a mut S,
    watch: EndConditions<'a>,
    began: Instant,
    stopwatch: &'a mut CallWatch,
}

/// The stopwatch for the calls of a system; outlives a run.
pub(crate) type CallWatch = Stopwatch<{ Call::KINDS }>;

impl<'a, S: ?Sized> TimedSystem<'a, S> {
    /// For a run that begins now.
    pub(crate) fn new(system: &'a mut S, watch: EndConditions<'a>, stopwatch: &'a mut CallWatch) -> Self {
        stopwatch.reset();
        Self { system, watch, began: Instant::now(), stopwatch }
    }

    /// Enters the times of the run, which ends now.
    pub(crate) fn enter_times(&self, stats: &mut Stats) {
        let seconds = self.began.elapsed().as_secs_f64();
        stats.seconds = Seconds::new(seconds);
        stats.seconds_in_model = Seconds::new(self.stopwatch.seconds().min(seconds));
    }
}

macro_rules! watched {
    ($self:ident, $call:ident, $answer:expr) => {{
        if const { Call::$call.is_evaluation() } {
            $self.watch.check().map_err(CallError::failed)?;
        }
        let kind = Call::$call as usize;
        if const { !Call::$call.is_seldom() } && $self.stopwatch.skips(kind) {
            return $answer;
        }
        let timing = $self.stopwatch.start_timed(kind);
        let answer = $answer;
        $self.stopwatch.stop(timing);
        answer
    }};
}

impl<S: HybridSystem + ?Sized> HybridSystem for TimedSystem<'_, S> {
    hand_on!(self, self.system, watched);
}
