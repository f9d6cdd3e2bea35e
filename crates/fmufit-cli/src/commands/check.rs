//! `fmufit check`: mistakes in a problem, before a fit.

use super::fit::check_fit;
use crate::arguments::Check;
use crate::console::Console;
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::problem;
use calibration::{CheckOptions, Finding, Preflight, PreflightOptions, RunContext, Severity};
use schemars::JsonSchema;
use serde::Serialize;

/// A check as `--json` prints it.
#[derive(Serialize, JsonSchema)]
#[schemars(title = "Check of fmufit")]
pub(super) struct Document<'c> {
    /// Nothing speaks against a fit.
    is_ok: bool,
    /// The most severe first.
    findings: &'c [Finding],
    /// What came of moving each parameter, where that was asked for.
    preflight: Option<&'c Preflight>,
}

pub(crate) fn run(arguments: &Check, console: &Console) -> Result<Exit, Error> {
    let file = problem::of_arguments(&arguments.problem, console)?;
    let interrupt = Interrupt::watch()?;
    let is_asked = || interrupt.is_asked();
    let calibration = file.calibration(&RunContext::new().asking(&is_asked))?;
    // Mistakes in the options of the fit are found, too.
    let n = calibration.parameters().len();
    check_fit(&calibration, &file.options(n)?, &file.stages(n, None)?)?;
    let line = console.live_line();
    let shown = || line.show_until(interrupt.is_asked(), "checking");
    let context = RunContext::new().asking(&shown);
    let options = CheckOptions { simulate: !arguments.no_run, ..CheckOptions::default() };
    let check = calibration.check_with(&options, &context).map_err(Error::of_work)?;
    let is_bad = check.findings.iter().any(|finding| finding.severity == Severity::Error);
    let preflight = match arguments.preflight && !is_bad {
        true => Some(calibration.preflight(&PreflightOptions::default(), &context).map_err(Error::of_work)?),
        false => None,
    };
    drop(line);
    let check = match &preflight {
        Some(preflight) => check.with(&preflight.findings),
        None => check,
    };
    if arguments.json {
        let document =
            Document { is_ok: check.is_ok(), findings: &check.findings, preflight: preflight.as_ref() };
        console.json(&document)?;
    } else {
        console.result(&check.to_string());
        if let Some(mut preflight) = preflight {
            // They stand above.
            preflight.findings.clear();
            console.result(&format!("\n{preflight}"));
        }
    }
    Ok(if is_bad { Exit::NoSuccess } else { Exit::Success })
}
