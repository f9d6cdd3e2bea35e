//! `fmufit report`: writes a saved fit as a page or as a file for other programs.

use crate::arguments::Report;
use crate::console::Console;
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::output_paths::check_written;
use calibration::{Calibration, Fit, RunContext, SavedFit, Table};
use fmi::Fmu;
use std::path::Path;

pub(crate) fn run(arguments: &Report, console: &Console) -> Result<Exit, Error> {
    check_suffix(&arguments.output)?;
    if arguments.experiment.is_some() && suffix(&arguments.output) != "ssv" {
        return Err(Error::input("--experiment: only .ssv files have the values of one experiment"));
    }
    check_written([&arguments.output], std::slice::from_ref(&arguments.fit))?;
    let saved = SavedFit::load(&arguments.fit).map_err(Error::of_input)?;
    let calibration = match &arguments.model {
        Some(path) => {
            let fmu = Fmu::open_with(path, &saved.open_options).map_err(Error::input)?;
            saved.calibration_with(fmu)
        }
        None => saved.calibration(),
    };
    let calibration = calibration.map_err(Error::of_input)?;
    let interrupt = Interrupt::watch()?;
    let line = console.live_line();
    let shown = || line.show_until(interrupt.is_requested(), "simulating");
    let (experiment, context) = (arguments.experiment.as_deref(), RunContext::new().polling(&shown));
    let written = write(&saved.fit, &calibration, &arguments.output, experiment, &context);
    drop(line);
    written?;
    console.result(&format!("wrote {}", arguments.output.display()));
    Ok(Exit::Success)
}

/// Returns the suffix of a file name, in lower case.
pub(super) fn suffix(path: &Path) -> String {
    path.extension().map(|suffix| suffix.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// Rejects file names whose suffix does not determine a format.
pub(super) fn check_suffix(path: &Path) -> Result<(), Error> {
    match ["html", "htm", "csv", "json", "ssv"].contains(&suffix(path).as_str()) {
        true => Ok(()),
        false => Err(Error::input(format!(
            "{}: unknown report format; expected a name that ends in .html, .csv, .json or .ssv",
            path.display()
        ))),
    }
}

/// Writes the file in the format that its suffix determines. `experiment` selects the values of an SSP file.
pub(super) fn write(
    fit: &Fit,
    calibration: &Calibration,
    path: &Path,
    experiment: Option<&str>,
    context: &RunContext<'_>,
) -> Result<(), Error> {
    check_suffix(path)?;
    let written = match suffix(path).as_str() {
        "csv" => fit.write_csv(calibration, path, Table::Parameters, context),
        "ssv" => fit.export_ssv(calibration, path, experiment),
        "json" => {
            let text = fit.to_json(calibration).map_err(Error::of_input)?;
            return base::files::write_atomically(path, text.as_bytes()).map_err(Error::write(path));
        }
        _ => calibration.report(fit, path, context),
    };
    written.map_err(Error::of_work)
}
