//! Options for opening an FMU.

use crate::archive::ArchiveLimits;
use crate::cancel_request::CancelRequest;
use crate::description::DescriptionLimits;
use crate::log::LogFilter;
use crate::source::COMPILE_TIME;
use crate::sys::LoaderOptions;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Options of [`Fmu::open_with`](crate::Fmu::open_with); the default is what [`Fmu::open`](crate::Fmu::open)
/// does.
///
/// ```
/// use fmi::{LoaderOptions, OpenOptions};
/// let options = OpenOptions { loader: LoaderOptions { deepbind: true, ..Default::default() }, ..Default::default() };
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OpenOptions {
    /// Limits on the archive.
    pub limits: ArchiveLimits,
    /// Limits on the model description.
    pub description: DescriptionLimits,
    /// Options of the dynamic loader.
    pub loader: LoaderOptions,
    /// Log settings of the instances that simulations use.
    pub logging: LogOptions,
    /// Time limit of the compiler that builds the library of a source-code FMU (default: five minutes).
    pub compile_time: Duration,
    /// Ends the opening early. It is not looked at any more when the FMU is open.
    #[serde(skip)]
    pub cancel: CancelRequest,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            limits: ArchiveLimits::default(),
            description: DescriptionLimits::default(),
            loader: LoaderOptions::default(),
            logging: LogOptions::default(),
            compile_time: COMPILE_TIME,
            cancel: CancelRequest::default(),
        }
    }
}

/// Log settings of an FMU. Its lines are kept per instance, not for ever, and the last of them are part of
/// every error.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LogOptions {
    /// The FMU is asked to log. FMUs log what they think important without being asked, too.
    pub asked: bool,
    /// Of which categories, by their names; none: of all (see
    /// [`Instance::log_categories`](crate::Instance::log_categories)).
    pub categories: Vec<String>,
    /// Filter for the lines.
    pub filter: LogFilter,
    /// Lines go to the program's logger at the level `info`, after the run that they are of; else at `debug`.
    pub shown: bool,
}
