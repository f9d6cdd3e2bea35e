//! `fmufit sensitivity`: effect of each parameter on the cost of a fit or the criteria of a design.

use crate::arguments::{self, SensitivityName};
use crate::console::Console;
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::output_paths::check_written;
use crate::problem;
use calibration::{RunContext, SensitivityOptions, SensitivityProgress, visible_line};
use dfo::{IntervalOptions, SensitivityMethod};
use std::sync::Arc;
use std::time::Duration;

pub(crate) fn run(arguments: &arguments::Sensitivity, console: &Console) -> Result<Exit, Error> {
    let options = options(arguments)?;
    let file = problem::of_arguments(&arguments.problem, console)?;
    check_written(&arguments.checkpoint, &file.files())?;
    let interrupt = Interrupt::watch()?;
    let is_requested = || interrupt.is_requested();
    let calibration = file.calibration(&RunContext::new().polling(&is_requested))?;
    // The analysis has its own options. This reports mistakes in those of the file.
    file.options(calibration.parameters().len())?;
    let line = console.live_line();
    let shown = || {
        let is_requested = interrupt.is_requested();
        match is_requested {
            true => line.end(),
            false => line.show("simulating", || progress_of(&options.progress)),
        }
        is_requested
    };
    let found = calibration.sensitivity(&options, &RunContext::new().polling(&shown));
    drop(line);
    let found = found.map_err(Error::of_work)?;
    match arguments.json {
        true => console.json(&found)?,
        false => console.result(&found.to_text(|name| visible_line(name).into_owned())),
    }
    Ok(if interrupt.is_requested() { Exit::Interrupted } else { Exit::Success })
}

fn progress_of(progress: &SensitivityProgress) -> String {
    match progress.n_points() {
        0 => String::new(),
        n => format!("{} of at most {n} points", progress.n_evaluated()),
    }
}

/// Returns the options of the analysis.
fn options(arguments: &arguments::Sensitivity) -> Result<SensitivityOptions, Error> {
    let refused = |name: &str, method: &str| {
        Err(Error::input(format!("--{name} is an option of --method {method} only")))
    };
    let mut method = match arguments.method {
        SensitivityName::Morris => SensitivityMethod::MORRIS,
        SensitivityName::Sobol => SensitivityMethod::SOBOL,
    };
    match &mut method {
        SensitivityMethod::Morris { .. } if arguments.second_order => {
            return refused("second-order", "sobol");
        }
        SensitivityMethod::Sobol { .. } if arguments.levels.is_some() => return refused("levels", "morris"),
        SensitivityMethod::Morris { n, levels } => {
            *n = arguments.n.unwrap_or(*n);
            *levels = arguments.levels.unwrap_or(*levels);
        }
        SensitivityMethod::Sobol { n, second_order } => {
            *n = arguments.n.unwrap_or(*n);
            *second_order = arguments.second_order;
        }
        _ => {}
    }
    let max_time = arguments.max_time.map(|seconds| {
        Duration::try_from_secs_f64(seconds).map_err(|_| {
            Error::input(format!("--max-time {seconds}: expected a number of seconds, at least 0"))
        })
    });
    Ok(SensitivityOptions {
        method,
        intervals: IntervalOptions { level: arguments.level, ..IntervalOptions::default() },
        seed: arguments.rng,
        workers: arguments.workers,
        max_time: max_time.transpose()?,
        checkpoint: arguments.checkpoint.clone(),
        progress: Arc::default(),
    })
}
