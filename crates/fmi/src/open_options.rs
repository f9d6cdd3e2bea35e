//! What opening an FMU may be told.

use crate::archive::ArchiveLimits;
use crate::cancel::Cancel;
use crate::sys::LogFilter;

/// Options of [`Fmu::open_with`](crate::Fmu::open_with); the default is what [`Fmu::open`](crate::Fmu::open) does.
///
/// ```
/// use fmi::{LoaderOptions, OpenOptions};
/// let options = OpenOptions { loader: LoaderOptions { deepbind: true, ..Default::default() }, ..Default::default() };
/// ```
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct OpenOptions {
    /// What an archive may contain.
    pub limits: ArchiveLimits,
    /// How the library is loaded.
    pub loader: LoaderOptions,
    /// Run the FMU although it says that it needs the tool that made it (`needsExecutionTool`): the tool is there, or the
    /// FMU exaggerates.
    pub tool_is_present: bool,
    /// What is done with the logs of the instances that simulations use.
    pub logging: LogOptions,
    /// Ends the opening early. It is not looked at any more when the FMU is open.
    pub cancel: Cancel,
}

/// What is done with the log of an FMU. Its lines are kept per instance, not for ever, and the last of them are part of
/// every error.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct LogOptions {
    /// The FMU is asked to log. FMUs log what they think important without being asked, too.
    pub asked: bool,
    /// Which lines are kept.
    pub filter: LogFilter,
    /// Lines go to the program's logger at the level `info`, after the run that they are of; else at `debug`.
    pub shown: bool,
}

/// How the dynamic loader is asked for a library. By default all its symbols are looked up when it is loaded, so that a
/// missing one is an error then and not the end of the process later (`RTLD_NOW`), and none of them are offered to other
/// libraries (`RTLD_LOCAL`). A library that is loaded already stays as it is; that holds for the libraries it depends on too,
/// which the loader knows by their names: of two with one name in a process it takes the first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct LoaderOptions {
    /// Symbols of the library and what it depends on come before those of the process (`RTLD_DEEPBIND` of glibc): for
    /// libraries that call a function of their own and get one of the same name of the host program instead. An error
    /// where the system has no such flag. Not together with the address sanitizer, which refuses it.
    pub deepbind: bool,
    /// Functions are looked up when they are first called (`RTLD_LAZY`): for libraries that lack some which are never
    /// called. If one is called, the process ends.
    pub lazy: bool,
}
