//! Options for opening an FMU.

use crate::archive::ArchiveLimits;
use crate::cancel_request::CancelRequest;
use crate::description::DescriptionLimits;
use crate::log::LogFilter;
use crate::source::COMPILE_TIME;
use crate::sys::LoaderOptions;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Options of [`Fmu::open_with`](crate::Fmu::open_with). The defaults are the options of
/// [`Fmu::open`](crate::Fmu::open).
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
    /// Cancels the opening. Not used after the FMU is open.
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

/// Log settings of an FMU. The last lines are kept for each instance, and every error of a call includes the
/// latest of them.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LogOptions {
    /// Requests logging from the FMU. FMUs may also log important lines without a request.
    pub requested: bool,
    /// Requested categories; empty for all (see
    /// [`Instance::log_categories`](crate::Instance::log_categories)).
    pub categories: Vec<String>,
    /// Filter for the lines.
    pub filter: LogFilter,
    /// Sends the lines to the program's logger at level `info`, after the run that produced them. If false,
    /// the level is `debug`.
    pub shown: bool,
}
