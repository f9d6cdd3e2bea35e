//! Errors of data, parameters and fits: one typed error with names and numbers.

use std::io;
use std::path::PathBuf;

/// Reason why a calibration could not be set up, evaluated or fitted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// A data file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    DataFile {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A report cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    ReportFile {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A table of measurements cannot be used.
    #[error("{source_name}: {message}")]
    Data {
        /// The file, or the source of the table.
        source_name: String,
        /// Description of the fault and its location.
        message: String,
    },
    /// The numbers of a parameter are inconsistent.
    #[error("parameter '{name}': {message}")]
    Parameter {
        /// Name of the parameter.
        name: String,
        /// Description of the fault.
        message: String,
    },
    /// A value is not valid for its field.
    #[error(transparent)]
    Record(#[from] dfo::RecordError),
    /// Experiments, outputs or parameters are missing or contradict each other.
    #[error("{0}")]
    Setup(String),
    /// Error of one of several experiments.
    #[error("{name}: {source}")]
    Experiment {
        /// Name of the experiment.
        name: String,
        /// Error of this experiment.
        source: Box<CalibrationError>,
    },
    /// A file is not a saved fit, or was written by another version.
    #[error("{name}: {message}")]
    SavedFit {
        /// The file.
        name: String,
        /// Description of the fault.
        message: String,
    },
    /// Error of one of the stages of a fit.
    #[error("stage {number}: {source}")]
    Stage {
        /// Number of the stage, from 1.
        number: usize,
        /// Error of this stage.
        source: Box<CalibrationError>,
    },
    /// The model of a stored problem has changed.
    #[error("the FMU {} has changed since the problem was created; expected content {expected}, found {found}", path.display())]
    OtherModel {
        /// Path of the model.
        path: PathBuf,
        /// SHA-256 of the content that the problem was created with.
        expected: String,
        /// SHA-256 of the current content.
        found: String,
    },
    /// The model reported an error.
    #[error(transparent)]
    Model(#[from] fmi::FmiError),
    /// The wrong number of parameter values.
    #[error("{got} values given for {expected} parameters ({names})")]
    Length {
        /// Number of values given.
        got: usize,
        /// Number of parameters.
        expected: usize,
        /// Names of the parameters.
        names: String,
    },
    /// A requested simulation failed.
    #[error("the simulation at {at} failed: {message}")]
    Simulation {
        /// Parameter values by name.
        at: String,
        /// Full error message.
        message: String,
        /// Error of the model, if there is one.
        #[source]
        source: Option<Box<fmi::FmiError>>,
    },
    /// The evaluation was stopped because its cancel flag was set.
    #[error("the evaluation was cancelled")]
    Cancelled,
    /// The optimiser could not start, or found no point.
    #[error(transparent)]
    Optimiser(#[from] dfo::Error),
    /// The optimiser could not start because of a parameter, which it identifies by its index.
    #[error("{source} (x[{index}] is parameter '{name}')")]
    OptimiserParameter {
        /// Index of the parameter, from 0.
        index: usize,
        /// Name of the parameter.
        name: String,
        /// Error of the optimiser.
        source: Box<dfo::Error>,
    },
}

impl CalibrationError {
    /// True if the work was interrupted before it produced a result: by a cancel flag, or by the interrupt
    /// check of the context.
    pub fn is_interrupt(&self) -> bool {
        match self {
            Self::Cancelled | Self::Model(fmi::FmiError::Cancelled) => true,
            Self::Optimiser(dfo::Error::EndedWithoutPoint { termination, .. }) => {
                *termination == dfo::Termination::Interrupted
            }
            Self::Experiment { source, .. } | Self::Stage { source, .. } => source.is_interrupt(),
            _ => false,
        }
    }
}
