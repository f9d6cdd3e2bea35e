//! `fmufit optimize`: search for the best design of a model, or for the Pareto front of several objectives.

use super::fit::{check_fit, searched, show_report, watch};
use super::report;
use crate::arguments;
use crate::console::Console;
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::output_paths::check_written;
use crate::problem::{ProblemFile, short_form};
use calibration::{Design, DesignFront, RunContext};
use dfo::{Checkpoint, Termination};
use std::path::Path;
use std::sync::Arc;

pub(crate) fn run(arguments: &arguments::Optimize, console: &Console) -> Result<Exit, Error> {
    let mut file = ProblemFile::read(&arguments.problem)?;
    file.set("fit", short_form::options(&arguments.option)?);
    file.set("settings", short_form::options(&arguments.setting)?);
    check_written(arguments.checkpoint.iter().chain(&arguments.report), &file.files())?;
    match file.has_front() {
        true => check_front(arguments)?,
        false => arguments.report.iter().try_for_each(|path| report::check_suffix(path))?,
    }
    let interrupt = Interrupt::watch()?;
    let is_requested = || interrupt.is_requested();
    if !file.is_design() {
        return Err(Error::input(format!(
            "{}: objective is missing. Add, for example, objective = \"ise(y, 1)\"; to fit parameters to recordings, use fmufit fit",
            arguments.problem.display()
        )));
    }
    let calibration = Arc::new(file.calibration(&RunContext::new().polling(&is_requested))?);
    let design = Design::of(Arc::clone(&calibration)).map_err(Error::of_input)?;
    let mut options = file.options(calibration.parameters().len())?;
    if let Some(path) = &arguments.checkpoint {
        options.run.checkpoint = Some(Checkpoint::new(path));
    }
    check_fit(&calibration, &options, &[])?;
    let watch = arguments.watch.then(|| watch(&calibration, console)).transpose()?;
    let fit = searched(&calibration, options, &[], (&is_requested, watch.as_ref()), console)
        .inspect_err(|error| watch.iter().for_each(|watch| watch.show_error(&error.to_string())))?;
    let is_interrupted = fit.report.termination == Termination::Interrupted || interrupt.is_requested();
    if file.has_front() {
        let front = design.front(fit);
        if !arguments.json {
            console.result(&front.to_string());
        }
        if let Some(path) = &arguments.report {
            write_front(&front, path)?;
            console.note(&match front.is_success() {
                true => format!("wrote {}", path.display()),
                false => {
                    format!("{} was not written, because no design satisfies the constraints", path.display())
                }
            });
        }
        // Printed last, because an error is a JSON document, too.
        if arguments.json {
            console.data(&(front.to_json().map_err(Error::of_work)? + "\n"));
        }
        return Ok(exit(front.is_success(), is_interrupted));
    }
    let result = design.result(fit, &RunContext::new().polling(&is_requested));
    match arguments.json {
        true => console.data(&(result.to_json().map_err(Error::of_work)? + "\n")),
        false => console.result(&result.to_string()),
    }
    if let Some(path) = arguments.report.as_ref().filter(|_| !interrupt.is_requested()) {
        report::write(&result.fit, &calibration, path, None, &RunContext::new().polling(&is_requested))?;
        console.note(&format!("wrote {}", path.display()));
    }
    if let Some(watch) = &watch {
        show_report(watch, &result.fit, &calibration, &interrupt, console);
    }
    Ok(exit(result.is_success(), is_interrupted))
}

fn exit(is_success: bool, is_interrupted: bool) -> Exit {
    match is_success {
        _ if is_interrupted => Exit::Interrupted,
        true => Exit::Success,
        false => Exit::NoSuccess,
    }
}

/// Rejects options that a Pareto front does not have.
fn check_front(arguments: &arguments::Optimize) -> Result<(), Error> {
    if arguments.watch {
        return Err(Error::input(
            "--watch: the page shows a search for one objective, but the problem has several",
        ));
    }
    match arguments.report.as_ref().filter(|path| !["csv", "json", "svg"].contains(&&*report::suffix(path))) {
        Some(path) => Err(Error::input(format!(
            "{}: unknown format of a Pareto front; expected a name that ends in .csv, .json or .svg",
            path.display()
        ))),
        None => Ok(()),
    }
}

/// Writes a Pareto front in the format that the suffix determines, unless it is empty.
fn write_front(front: &DesignFront, path: &Path) -> Result<(), Error> {
    if !front.is_success() {
        return Ok(());
    }
    let text = match &*report::suffix(path) {
        "csv" => front.to_csv().map_err(Error::of_work)?,
        "json" => front.to_json().map_err(Error::of_work)?,
        _ => front.plot().ok_or_else(|| Error::work("--report: the front has no finite values to plot"))?,
    };
    base::files::write_atomically(path, text.as_bytes()).map_err(Error::write(path))
}
