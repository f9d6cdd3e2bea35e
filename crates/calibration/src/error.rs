//! Errors of data, parameters or a fit: one typed error with names and numbers.

use std::io;
use std::path::PathBuf;

/// Why a calibration could not be set up, evaluated or fitted.
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
    /// A table of measurements that cannot be used.
    #[error("{source_name}: {message}")]
    Data {
        /// File, or where the table comes from.
        source_name: String,
        /// Description of the fault and its place.
        message: String,
    },
    /// A parameter whose numbers do not fit together.
    #[error("parameter '{name}': {message}")]
    Parameter {
        /// Name of the parameter.
        name: String,
        /// Description of the fault.
        message: String,
    },
    /// A value that does not fit what it is given to.
    #[error(transparent)]
    Record(#[from] dfo::RecordError),
    /// Experiments, outputs or parameters are missing or contradict each other.
    #[error("{0}")]
    Setup(String),
    /// Error of one of several experiments.
    #[error("{name}: {source}")]
    Experiment {
        /// Its name.
        name: String,
        /// Error of this experiment.
        source: Box<CalibrationError>,
    },
    /// A file that should hold a fit, and does not, or not one of this version.
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
        /// Its number, from 1.
        number: usize,
        /// Error of this stage.
        source: Box<CalibrationError>,
    },
    /// The model of a stored problem is another one now.
    #[error("the FMU {} has changed: the problem was made with content {expected}, now it is {found}", path.display())]
    OtherModel {
        /// Where it is.
        path: PathBuf,
        /// SHA-256 of the content that the problem was made with.
        expected: String,
        /// That of the file.
        found: String,
    },
    /// The model refused something.
    #[error(transparent)]
    Model(#[from] fmi::FmiError),
    /// The wrong number of parameter values.
    #[error("{got} values given for {expected} parameters ({names})")]
    Length {
        /// Values given.
        got: usize,
        /// Parameters there are.
        expected: usize,
        /// Their names.
        names: String,
    },
    /// A simulation that was asked for failed.
    #[error("the simulation at {at} failed: {message}")]
    Simulation {
        /// Parameter values by name.
        at: String,
        /// Why, in full.
        message: String,
        /// The error of the model, where there was one.
        #[source]
        source: Option<Box<fmi::FmiError>>,
    },
    /// The evaluation was given up because its cancel flag was set.
    #[error("the evaluation was cancelled")]
    Cancelled,
    /// The optimiser could not start, or found nothing.
    #[error(transparent)]
    Optimiser(#[from] dfo::Error),
    /// The optimiser could not start because of one of the parameters, which it knows by number.
    #[error("{source} (x[{index}] is parameter '{name}')")]
    OptimiserParameter {
        /// Parameter, counted from 0.
        index: usize,
        /// Its name.
        name: String,
        /// Error of the optimiser.
        source: Box<dfo::Error>,
    },
}

impl CalibrationError {
    /// True if the work was ended from outside before it had a result: by a cancel flag, or by whoever the
    /// context asks.
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
