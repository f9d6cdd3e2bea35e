//! The problem of the arguments of a command: a file, or the short form.

use super::problem_file::ProblemFile;
use super::short_form;
use crate::arguments::Problem;
use crate::error::Error;

/// The problem that arguments describe.
pub(crate) fn asked(arguments: &Problem) -> Result<ProblemFile, Error> {
    let Problem { problem, data, output, input, parameter, setting } = arguments;
    let is_model =
        problem.is_dir() || problem.extension().is_some_and(|suffix| suffix.eq_ignore_ascii_case("fmu"));
    let mut file = match data {
        Some(data) if is_model => {
            ProblemFile::without_file(short_form::record(problem, data, parameter, output, input)?)?
        }
        Some(data) => {
            return Err(Error::input(format!(
                "{} is no model, and {} no part of a problem file: give a problem file alone, or a model (.fmu) and a recording",
                problem.display(),
                data.display()
            )));
        }
        None if is_model => {
            return Err(Error::input(format!(
                "{} is a model: give a recording, too, with --output and --parameter, or write a problem file: fmufit init {} \
                 recording.csv problem.toml",
                problem.display(),
                problem.display()
            )));
        }
        None => ProblemFile::read(problem)?,
    };
    file.set("settings", short_form::options(setting)?);
    Ok(file)
}
