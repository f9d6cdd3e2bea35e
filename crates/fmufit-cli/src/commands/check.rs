//! `fmufit check`: mistakes in a problem, before a fit.

use crate::arguments::Check;
use crate::console::Console;
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::problem;
use calibration::{CheckOptions, PreflightOptions, RunContext, Severity};
use serde_json::json;

pub(crate) fn run(arguments: &Check, console: &Console) -> Result<Exit, Error> {
    let file = problem::asked(&arguments.problem)?;
    let interrupt = Interrupt::watch()?;
    let is_asked = || interrupt.is_asked();
    let calibration = file.calibration(&RunContext::new().asking(&is_asked))?;
    // Mistakes in the options of the fit are found, too.
    let n = calibration.parameters().len();
    file.options(n)?;
    file.stages(n)?;
    let line = console.live_line();
    let shown = || {
        line.show("checking", String::new);
        interrupt.is_asked()
    };
    let context = RunContext::new().asking(&shown);
    let options = CheckOptions { simulate: !arguments.no_run, ..CheckOptions::default() };
    let check = calibration.check_with(&options, &context).map_err(Error::of_work)?;
    let is_bad = check.findings.iter().any(|finding| finding.severity == Severity::Error);
    let preflight = match arguments.preflight && !is_bad {
        true => Some(calibration.preflight(&PreflightOptions::default(), &context).map_err(Error::of_work)?),
        false => None,
    };
    drop(line);
    if arguments.json {
        let document = json!({
            "is_ok": check.is_ok(),
            "findings": serde_json::to_value(&check.findings).unwrap_or_default(),
            "preflight": serde_json::to_value(&preflight).unwrap_or_default(),
        });
        console.json(&document)?;
    } else {
        console.result(&check.to_string());
        if let Some(preflight) = &preflight {
            console.result(&format!("\n{preflight}"));
        }
    }
    Ok(if is_bad { Exit::NoSuccess } else { Exit::Success })
}
