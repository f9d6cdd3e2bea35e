//! `fmufit check`: checks a problem for mistakes before a fit.

use super::fit::check_fit;
use crate::arguments::Check;
use crate::console::Console;
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::problem;
use calibration::{CheckOptions, Finding, Preflight, PreflightOptions, RunContext, Severity};
use schemars::JsonSchema;
use serde::Serialize;

/// Result of a check as printed by `--json`.
#[derive(Serialize, JsonSchema)]
#[schemars(title = "Result of fmufit check")]
pub(super) struct Document<'c> {
    /// True if no finding prevents a fit.
    is_ok: bool,
    /// Findings, most severe first.
    findings: &'c [Finding],
    /// Result of varying each parameter, if requested.
    preflight: Option<&'c Preflight>,
}

pub(crate) fn run(arguments: &Check, console: &Console) -> Result<Exit, Error> {
    let file = problem::of_arguments(&arguments.problem, console)?;
    let interrupt = Interrupt::watch()?;
    let is_requested = || interrupt.is_requested();
    let calibration = file.calibration(&RunContext::new().polling(&is_requested))?;
    // Also finds mistakes in the options of the fit.
    let n = calibration.parameters().len();
    check_fit(&calibration, &file.options(n)?, &file.stages(n, None)?)?;
    let line = console.live_line();
    let shown = || line.show_until(interrupt.is_requested(), "checking");
    let context = RunContext::new().polling(&shown);
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
            // The findings are already printed above.
            preflight.findings.clear();
            console.result(&format!("\n{preflight}"));
        }
    }
    Ok(if is_bad { Exit::NoSuccess } else { Exit::Success })
}
