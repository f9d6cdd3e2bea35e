//! `fmufit init`: writes a problem file from a model and a recording.

mod matching;
mod proposal;
mod text;

use crate::arguments::Init;
use crate::console::Console;
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::output_paths::check_written;
use crate::problem::{ProblemFile, short_form};
use calibration::{CsvRequest, Data, PreflightOptions, RunContext};
use fmi::worker::check_sandbox;
use matching::{Columns, Pair};
use proposal::Proposed;
use std::path::Path;

pub(crate) fn run(arguments: &Init, console: &Console) -> Result<Exit, Error> {
    let Init { model, data, problem, .. } = arguments;
    if problem.exists() && !arguments.force {
        return Err(Error::input(format!("{} already exists; use --force to replace it", problem.display())));
    }
    check_written([problem], &[model.clone(), data.clone()])?;
    if arguments.sandbox {
        check_sandbox().map_err(Error::input)?;
    }
    let fmu = arguments.limits.open(model)?;
    let request = CsvRequest { time: arguments.time.as_deref(), ..CsvRequest::default() };
    let recording = Data::read_csv(data, request).map_err(Error::of_arguments)?;
    let columns = Columns::matched(&fmu, &recording, named(&arguments.output)?, named(&arguments.input)?)?;
    let mut proposed = Proposed::of(&fmu, &arguments.parameter)?;
    // Paths in the file are relative to its folder.
    let folder = base::files::folder_of(problem);
    let (model_path, data_path) = (relative(model, folder)?, relative(data, folder)?);
    let text = |proposed: &Proposed| {
        let (time, bytes) = (arguments.time.as_deref(), arguments.limits.max_description_bytes);
        let settings = (bytes, arguments.sandbox);
        text::text(&fmu, &model_path, &data_path, &columns, time, settings, proposed)
    };
    let mut why_not = None;
    if !columns.has_outputs() {
        why_not = Some(
            "no column matches an output, so no parameter was tested. Specify an output: --output \
                        VARIABLE=COLUMN"
                .to_owned(),
        );
    } else if arguments.parameter.is_empty() && proposed.has_active() && !arguments.no_run {
        let tried = tried(&text(&proposed), problem, console);
        match tried {
            Ok(preflight) => proposed.judge(&preflight),
            Err(error) if error.exit == Exit::Interrupted => return Err(error),
            Err(error) => why_not = Some(format!("the parameters could not be tested: {error}")),
        }
    }
    let text = text(&proposed);
    // Checks that the written text can be read.
    ProblemFile::parse(&text, problem)?;
    base::files::write_atomically(problem, text.as_bytes()).map_err(Error::write(problem))?;
    console.result(&format!("wrote {}: {}", problem.display(), columns.summary(&proposed)));
    why_not.iter().for_each(|reason| console.note(reason));
    let path = problem.display();
    console.note(&match columns.has_outputs() && proposed.has_active() {
        true => format!("next, review the file, then run: fmufit check {path}; fmufit fit {path}"),
        false => format!("next, fill in the missing fields, then run: fmufit check {path}"),
    });
    Ok(Exit::Success)
}

/// Returns the variables and columns of `variable=column` arguments.
fn named(given: &[String]) -> Result<Vec<Pair>, Error> {
    given.iter().map(|text| short_form::assignment(text, "VARIABLE=COLUMN")).collect()
}

/// Returns a path relative to a folder, or the full path if it is not inside the folder.
fn relative(path: &Path, folder: &Path) -> Result<String, Error> {
    let full = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let (path, folder) = (full(path), full(folder));
    short_form::text_of(path.strip_prefix(&folder).unwrap_or(&path))
}

/// Varies each of the parameters that the text proposes.
fn tried(text: &str, path: &Path, console: &Console) -> Result<calibration::Preflight, Error> {
    let interrupt = Interrupt::watch()?;
    let line = console.live_line();
    let shown = || line.show_until(interrupt.is_requested(), "testing the parameters");
    let context = RunContext::new().polling(&shown);
    let calibration = ProblemFile::parse(text, path)?.calibration(&context)?;
    calibration.preflight(&PreflightOptions::default(), &context).map_err(Error::of_work)
}
