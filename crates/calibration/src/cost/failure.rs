//! Reasons why a point has no cost.

use crate::error::CalibrationError;
use dfo::FailureKind;
use fmi::FmiError;
use fmi::error::{EndKind, ReportedError};
use fmi::platform::without_private_folders;
use ode::{ErrorKind, NotFinite};
use serde::{Deserialize, Serialize};

/// Reason why a point has no cost.
pub(crate) enum CostFailure {
    /// The cost is strictly above the cutoff.
    Above,
    /// The run was interrupted.
    Cancelled,
    /// No further simulation is possible, at this or any other point.
    Over(Box<FmiError>),
    /// The simulation failed. `reason` is equal for all failures of this kind, and `message` contains all
    /// details. `source` is the error of the model, if it is one.
    Failed { kind: FailureKind, reason: String, message: String, source: Option<Box<FmiError>> },
}

impl CostFailure {
    /// Creates a failure that is not an error of the model.
    pub(crate) fn failed(kind: FailureKind, reason: String) -> Self {
        Self::Failed { kind, message: reason.clone(), reason, source: None }
    }

    /// Adds the name of the experiment to the failure.
    pub(crate) fn in_experiment(mut self, name: &str) -> Self {
        if let Self::Failed { reason, message, .. } = &mut self {
            *reason = format!("{name}: {reason}");
            *message = format!("{name}: {message}");
        }
        self
    }

    /// Returns the reason and all details of a failure at this point.
    ///
    /// # Errors
    /// Returns the error that ends the work at all points. (No cost is above an infinite cutoff.)
    pub(crate) fn of_point(self) -> Result<PointFailure, CalibrationError> {
        match self {
            Self::Failed { message, source, .. } => Ok(PointFailure { message, source }),
            Self::Over(error) => Err(CalibrationError::Model(*error)),
            Self::Cancelled | Self::Above => Err(CalibrationError::Cancelled),
        }
    }

    /// Returns the failure of a worker process that did not answer. Errors end the work, unless the process
    /// ended during a simulation.
    pub(crate) fn of_worker(error: FmiError) -> Self {
        match error {
            FmiError::WorkerEnded(_) | FmiError::Cancelled => error.into(),
            error => Self::Over(Box::new(error)),
        }
    }
}

/// Reason why a simulation failed.
pub(crate) struct PointFailure {
    pub(crate) message: String,
    pub(crate) source: Option<Box<FmiError>>,
}

/// Serializable [`CostFailure`] from a worker process.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum ReportedCostFailure {
    Above,
    Cancelled,
    Over(ReportedError),
    Failed { kind: FailureKind, reason: String, message: String, source: Option<ReportedError> },
}

impl ReportedCostFailure {
    /// True if the failure concerns the process or its files rather than the point.
    pub(crate) fn is_of_process(&self) -> bool {
        match self {
            Self::Over(reported) => reported.is_of_process(),
            Self::Failed { source, .. } => source.as_ref().is_some_and(ReportedError::is_of_process),
            Self::Above | Self::Cancelled => false,
        }
    }
}

impl From<CostFailure> for ReportedCostFailure {
    fn from(no_cost: CostFailure) -> Self {
        match no_cost {
            CostFailure::Above => Self::Above,
            CostFailure::Cancelled => Self::Cancelled,
            CostFailure::Over(error) => Self::Over(error.reported()),
            CostFailure::Failed { kind, reason, message, source } => {
                Self::Failed { kind, reason, message, source: source.map(|source| source.reported()) }
            }
        }
    }
}

impl From<ReportedCostFailure> for CostFailure {
    fn from(reported: ReportedCostFailure) -> Self {
        let error = |reported: ReportedError| Box::new(FmiError::ReportedError(Box::new(reported)));
        match reported {
            ReportedCostFailure::Above => Self::Above,
            ReportedCostFailure::Cancelled => Self::Cancelled,
            ReportedCostFailure::Over(reported) => Self::Over(error(reported)),
            ReportedCostFailure::Failed { kind, reason, message, source } => {
                Self::Failed { kind, reason, message, source: source.map(error) }
            }
        }
    }
}

/// Classifies a failed simulation by kind and by a reason that is equal for all failures of this kind.
impl From<FmiError> for CostFailure {
    fn from(error: FmiError) -> Self {
        match error {
            FmiError::Cancelled => return CostFailure::Cancelled,
            _ if error.is_of_machine() => return CostFailure::Over(Box::new(error)),
            _ => {}
        }
        let mut kind = FailureKind::Error;
        let reason = match &error {
            FmiError::WorkerEnded(end) => {
                if end.kind == EndKind::Hung {
                    kind = FailureKind::TimedOut;
                }
                end.reason()
            }
            FmiError::Simulation(e) => match &e.kind {
                ErrorKind::Cancelled => return CostFailure::Cancelled,
                ErrorKind::Model(inner) => {
                    let inner_error = inner.downcast_ref();
                    if matches!(inner_error, Some(FmiError::StateNotFinite { .. })) {
                        kind = FailureKind::NotFinite;
                    }
                    inner_error.map_or_else(|| inner.to_string(), call_reason)
                }
                ErrorKind::DiscardedAtRestart | ErrorKind::StepTooSmall { discarded: true }
                    if e.not_finite.is_some() =>
                {
                    kind = FailureKind::NotFinite;
                    e.not_finite.as_ref().map(NotFinite::summary).unwrap_or_default()
                }
                other => {
                    if matches!(other, ErrorKind::TimedOut(_)) {
                        kind = FailureKind::TimedOut;
                    }
                    other.summary()
                }
            },
            other => call_reason(other),
        };
        let reason = without_private_folders(&reason);
        CostFailure::Failed { kind, reason, message: error.to_string(), source: Some(Box::new(error)) }
    }
}

/// Returns the reason of a failed call without its time, with the first line that the FMU logged about it.
fn call_reason(error: &FmiError) -> String {
    match error {
        FmiError::Call(failure) => {
            let line = failure.log.first().map(|line| format!(": {line}")).unwrap_or_default();
            let hints: String = failure.hints.iter().map(|hint| format!("; {hint}")).collect();
            format!("{} returned {}{line}{hints}", failure.call, failure.status)
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ode::{Evaluated, SimulationError, Stats};

    #[test]
    fn machine_failures_are_not_point_failures() {
        let source = std::io::Error::from_raw_os_error(27);
        let io = FmiError::Io { action: "write", path: "model.so".into(), source };
        let no_worker = FmiError::NoWorker { reason: "no memory".to_owned() };
        let memory = FmiError::Memory { what: "a trajectory".to_owned(), bytes: 1 << 40 };
        for error in [io, no_worker, memory] {
            assert!(matches!(CostFailure::from(error), CostFailure::Over(_)));
        }
        let model = FmiError::EventIteration { time: 1.0, limit: 10 };
        assert!(matches!(CostFailure::from(model), CostFailure::Failed { .. }));
    }

    #[test]
    fn failure_reports_the_quantity_that_is_not_finite() {
        let (what, name) = (Evaluated::Derivative, Some("T".to_owned()));
        let error = SimulationError {
            kind: ErrorKind::DiscardedAtRestart,
            time: 0.5,
            step: 0.0,
            worst_state: None,
            last_event: None,
            not_finite: Some(NotFinite { what, index: 2, value: f64::NAN, time: 0.5, name }),
            undetermined: None,
            refusal: None,
            stats: Stats::default(),
        };
        let CostFailure::Failed { kind, reason, message, .. } =
            CostFailure::from(FmiError::Simulation(Box::new(error)))
        else {
            panic!("a failure")
        };
        assert_eq!(kind, FailureKind::NotFinite);
        assert_eq!(reason, "the derivative of state 2 (T) is NaN");
        assert!(message.contains("is NaN at t = 0.5"), "{message}");
    }
}
