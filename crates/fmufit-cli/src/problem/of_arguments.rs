//! Problem from the arguments of a command: a file or the short form.

use super::problem_file::ProblemFile;
use super::short_form;
use crate::arguments::Problem;
use crate::console::Console;
use crate::error::Error;
use calibration::{CsvRequest, Data, SimulationSettings, find_column};
use dfo::{Record, Value};
use fmi::Fmu;
use fmi::description::Causality;
use fmi::worker::Isolation;
use std::path::Path;

/// Returns the problem that the arguments describe.
pub(crate) fn of_arguments(arguments: &Problem, console: &Console) -> Result<ProblemFile, Error> {
    let Problem {
        problem,
        data,
        output,
        input,
        hold,
        parameter,
        initial_state,
        time,
        start_time,
        unit,
        setting,
        sandbox,
    } = arguments;
    if problem.is_dir() && !problem.join("modelDescription.xml").is_file() {
        return Err(Error::input(format!(
            "{} is not a model, because the folder contains no modelDescription.xml. Specify a problem file, \
             or a model and a recording",
            problem.display()
        )));
    }
    // Systems of models are rejected, with an alternative, when they are opened.
    let is_model = problem.is_dir()
        || problem.extension().is_some_and(|suffix| {
            ["fmu", "ssp", "ssd"].iter().any(|extension| suffix.eq_ignore_ascii_case(extension))
        });
    let settings = short_form::options(setting)?.into_iter().map(|(name, value)| match (&name[..], value) {
        // Without this, "none" would mean the default instead of no isolation.
        ("isolation", Value::Nothing) => (name, Value::Text(Isolation::None.name().to_owned())),
        (_, value) => (name, value),
    });
    let settings: Record = settings.collect();
    let mut file = match data {
        Some(data) if is_model => {
            let input = match input.is_empty() {
                true => driven(problem, data, time.as_deref(), &settings, console)?,
                false => input.clone(),
            };
            ProblemFile::without_file(short_form::record(arguments, data, &input)?)?
        }
        Some(data) => {
            return Err(Error::input(format!(
                "{} is not a model, so {} is not expected. Specify either a problem file, or a model (.fmu) \
                 and a recording",
                problem.display(),
                data.display()
            )));
        }
        None if is_model => {
            return Err(Error::input(format!(
                "{} is a model, so a recording is also required. Specify a recording with --output and \
                 --parameter, or write a problem file: fmufit init {} recording.csv problem.toml",
                problem.display(),
                problem.display()
            )));
        }
        None => {
            let of_model = [
                ("--output", !output.is_empty()),
                ("--input", !input.is_empty()),
                ("--hold", !hold.is_empty()),
                ("--parameter", !parameter.is_empty()),
                ("--initial-state", !initial_state.is_empty()),
                ("--time", time.is_some()),
                ("--start-time", start_time.is_some()),
            ];
            if let Some((option, _)) = of_model.iter().find(|(_, is_given)| *is_given) {
                return Err(Error::input(format!(
                    "{option} cannot be used with a problem file. Edit {} instead",
                    problem.display()
                )));
            }
            ProblemFile::read(problem)?
        }
    };
    file.set(
        "settings",
        settings.into_iter().chain(sandbox.then(|| ("sandbox".to_owned(), Value::Flag(true)))),
    );
    if !unit.is_empty() {
        let units = short_form::assignments(unit, "VARIABLE=UNIT, as in --unit room.T=K")?;
        let units = units.into_iter().map(|(variable, unit)| (variable, Value::Text(unit)));
        file.extend("settings", "units", units);
    }
    Ok(file)
}

/// Returns the inputs with the names of columns of the recording.
fn driven(
    model: &Path,
    data: &Path,
    time: Option<&str>,
    settings: &Record,
    console: &Console,
) -> Result<Vec<String>, Error> {
    let settings = SimulationSettings::from_record(settings).map_err(Error::input)?;
    let fmu = Fmu::open_with(model, &settings.open_options()).map_err(Error::input)?;
    let inputs = fmu.description().variables.iter().filter(|v| v.causality == Causality::Input);
    let inputs: Vec<&String> = inputs.map(|variable| &variable.name).collect();
    if inputs.is_empty() {
        return Ok(Vec::new());
    }
    let data =
        Data::read_csv(data, CsvRequest { time, ..CsvRequest::default() }).map_err(Error::of_arguments)?;
    let (driven, others): (Vec<&String>, Vec<&String>) =
        inputs.into_iter().partition(|name| find_column(data.names(), name).is_ok());
    let listed = |names: &[&String]| names.iter().map(|name| name.as_str()).collect::<Vec<_>>().join(", ");
    if !driven.is_empty() {
        console.note(&format!("inputs driven by the columns of the same names: {}", listed(&driven)));
    }
    if !others.is_empty() {
        console.note(&format!(
            "warning: no column drives these inputs, which keep their start values: {}",
            listed(&others)
        ));
    }
    Ok(driven.into_iter().cloned().collect())
}
