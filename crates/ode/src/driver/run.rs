//! State of a run between its start and its end, and the reasons to leave its loop.

use super::end_conditions::{EndConditions, Stopped};
use super::sliding::Sliding;
use crate::error::{ErrorKind, NotFinite, Termination, TooLargeForDense, Undetermined};
use crate::error_norm::ErrorWeights;
use crate::event::Domains;
use crate::observer::Observer;
use crate::options::Options;
use crate::sampling::Sampler;
use crate::stats::Stats;
use crate::stepper::Stepper;
use crate::system::{CallError, HybridSystem, InputStop};
use base::time_tolerance;

/// Unit round-off of double precision.
pub(super) const U: f64 = f64::EPSILON / 2.0;

/// Work space reused by later runs.
#[derive(Debug, Default)]
pub(super) struct Space {
    pub(super) x: Vec<f64>,
    pub(super) x_new: Vec<f64>,
    pub(super) x_mid: Vec<f64>,
    /// Change of the states by the last event.
    pub(super) jump: Vec<f64>,
    pub(super) slope: Vec<f64>,
    pub(super) nominals: Vec<f64>,
    pub(super) weights: ErrorWeights,
    pub(super) domains: Domains,
    pub(super) sampler: Sampler,
}

/// Reason to leave the loop.
pub(super) enum Exit {
    Normal(Termination),
    Error(ErrorKind),
}

impl From<ErrorKind> for Exit {
    fn from(kind: ErrorKind) -> Self {
        Self::Error(kind)
    }
}

impl From<Stopped> for Exit {
    fn from(stopped: Stopped) -> Self {
        match stopped {
            Stopped::Cancelled => Self::Error(ErrorKind::Cancelled),
            Stopped::TimedOut(limit) => Self::Error(ErrorKind::TimedOut(limit)),
            Stopped::ByObserver => Self::Normal(Termination::StoppedByObserver),
        }
    }
}

/// Converts the error of a failed call.
impl From<Box<dyn std::error::Error + Send + Sync>> for Exit {
    fn from(error: Box<dyn std::error::Error + Send + Sync>) -> Self {
        match error.downcast::<Stopped>().map_err(|error| error.downcast::<TooLargeForDense>()) {
            Ok(stopped) => (*stopped).into(),
            // Memory is insufficient for a matrix.
            Err(Ok(large)) => ErrorKind::from(*large).into(),
            Err(Err(error)) => ErrorKind::Model(error).into(),
        }
    }
}

pub(super) type Step<T> = Result<T, Exit>;

/// Request of a run: time span, sample times, observer and end conditions.
pub(super) struct Task<'a> {
    pub(super) start: f64,
    pub(super) end: f64,
    pub(super) times: &'a [f64],
    pub(super) observer: &'a mut dyn Observer,
    pub(super) watch: EndConditions<'a>,
}

/// State of one run between `start` and `end`.
pub(super) struct Run<'a> {
    pub(super) options: &'a Options,
    pub(super) stepper: &'a mut dyn Stepper,
    pub(super) space: &'a mut Space,
    pub(super) system: &'a mut dyn HybridSystem,
    pub(super) times: &'a [f64],
    pub(super) observer: &'a mut dyn Observer,
    pub(super) start: f64,
    pub(super) end: f64,
    /// Times closer than this are equal.
    pub(super) time_tolerance: f64,
    pub(super) t: f64,
    /// Step size proposed by the controller, before it is shortened to end at a target.
    pub(super) h: f64,
    pub(super) h_tried: f64,
    pub(super) fixed_step: Option<f64>,
    /// End of the first half of a fixed step that is split into two.
    pub(super) middle: Option<f64>,
    pub(super) next_time_event: Option<f64>,
    pub(super) input_stop: Option<InputStop>,
    pub(super) sliding: Sliding,
    pub(super) discards: u32,
    pub(super) not_finite: Option<NotFinite>,
    pub(super) undetermined: Option<Undetermined>,
    pub(super) worst_state: Option<usize>,
    pub(super) last_event: Option<f64>,
    pub(super) stats: Stats,
    pub(super) watch: EndConditions<'a>,
}

impl<'a> Run<'a> {
    pub(super) fn new(
        options: &'a Options,
        stepper: &'a mut dyn Stepper,
        space: &'a mut Space,
        system: &'a mut dyn HybridSystem,
        Task { start, end, times, observer, watch }: Task<'a>,
    ) -> Self {
        let span = end - start;
        let time_tolerance = time_tolerance(start, end);
        let fixed_step =
            (!stepper.properties().has_error_estimate).then(|| options.step_size.unwrap_or(span / 500.0));
        Self {
            options,
            stepper,
            space,
            system,
            times,
            observer,
            start,
            end,
            time_tolerance,
            t: start,
            h: 0.0,
            h_tried: 0.0,
            fixed_step,
            middle: None,
            next_time_event: None,
            input_stop: None,
            sliding: Sliding::new(span, time_tolerance),
            discards: 0,
            not_finite: None,
            undetermined: None,
            worst_state: None,
            last_event: None,
            stats: Stats { runs: 1, ..Stats::default() },
            watch,
        }
    }
}

pub(super) fn finish(termination: Termination) -> Step<()> {
    Err(Exit::Normal(termination))
}

/// Reads the event indicators. A value that is not finite counts as refused.
pub(super) fn read_indicators(
    system: &mut dyn HybridSystem,
    t: f64,
    x: &[f64],
    z: &mut [f64],
) -> Result<(), CallError> {
    system.event_indicators(t, x, z)?;
    // Zero times a value that is not finite is NaN.
    if z.iter().fold(0.0, |sum, z| sum + 0.0 * z) == 0.0 { Ok(()) } else { Err(CallError::Discard) }
}

/// Converts the error of a call that cannot be retried with a smaller step. Such calls are the start of the
/// model, its state after an event, and a sample.
pub(super) fn no_retreat(error: CallError) -> Exit {
    match error {
        CallError::Discard => ErrorKind::DiscardedAtRestart.into(),
        CallError::Failed(error) => error.into(),
    }
}
