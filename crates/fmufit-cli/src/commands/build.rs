//! `fmufit build`: compiles a source-code FMU.

use crate::arguments::Build;
use crate::console::Console;
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use fmi::{CancelRequest, FmiError};

pub(crate) fn run(arguments: &Build, console: &Console) -> Result<Exit, Error> {
    let Build { model, output, platform } = arguments;
    let output = match output {
        Some(output) => output.clone(),
        None if model.is_dir() => {
            // A folder may be given with a trailing slash, or as `.`.
            let folder =
                model.canonicalize().map_err(|e| Error::input(format!("{}: {e}", model.display())))?;
            folder.with_extension("fmu")
        }
        None => {
            let name = model.display();
            return Err(Error::input(format!(
                "{name} is not a folder. Specify the file to write: fmufit build {name} built.fmu"
            )));
        }
    };
    if model.is_dir() && !["sources", "binaries"].iter().any(|folder| model.join(folder).is_dir()) {
        let name = model.display();
        return Err(Error::input(format!(
            "{name} has neither the folder \"sources\" nor the folder \"binaries\". Put the C files into \"sources\""
        )));
    }
    let interrupt = Interrupt::watch()?;
    let built = fmi::pack_for(model, &output, *platform, &CancelRequest::when(interrupt.flag()));
    match built {
        Ok(()) => {
            console.result(&format!("wrote {}", output.display()));
            Ok(Exit::Success)
        }
        Err(FmiError::Cancelled) => Err(Error::interrupted()),
        Err(error @ FmiError::Io { .. }) => Err(Error::input(error)),
        Err(error) => Err(Error::work(error)),
    }
}
