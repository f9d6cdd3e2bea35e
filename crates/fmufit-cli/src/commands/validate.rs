//! `fmufit validate`: reports violations of the FMI standard and runs the model in a separate process.

use super::simulate::{Place, simulated};
use crate::arguments::Validate;
use crate::console::Console;
use crate::error::{Error, Exit};
use base::Number;
use calibration::CalibrationError;
use calibration::visible_line;
use dfo::Value;
use fmi::worker::check_sandbox;
use fmi::{SimulateOptions, Trajectory};
use ode::Termination;
use schemars::JsonSchema;
use serde::Serialize;

/// Duration of the simulation in s, if the model does not declare a stop time.
const SHORT: f64 = 1.0;

/// A simulation with problems.
enum Run {
    /// It reached the end, but its results are unusable.
    Ended,
    Failed,
}

/// Result of a validation as printed by `--json`.
#[derive(Serialize, JsonSchema)]
#[schemars(title = "Result of fmufit validate")]
pub(super) struct Document<'v> {
    /// Path of the model.
    path: String,
    /// Name of the model.
    model_name: &'v str,
    /// FMI version, for example `2.0`.
    fmi_version: String,
    /// Violations of the FMI standard.
    quirks: &'v [String],
    /// True if the simulation succeeded and its results are finite.
    is_simulated: bool,
    /// Result of the simulation, in a sentence.
    simulation: &'v str,
}

pub(crate) fn run(arguments: &Validate, console: &Console) -> Result<Exit, Error> {
    if arguments.sandbox {
        check_sandbox().map_err(Error::input)?;
    }
    let fmu = arguments.limits.open(&arguments.model)?;
    let timeout = Value::Number(arguments.timeout).read_time("--timeout").map_err(Error::input)?;
    let experiment = &fmu.description().default_experiment;
    let mut options = SimulateOptions::default();
    options.run.timeout = timeout;
    if experiment.stop_time.is_none() {
        options = options.final_time(experiment.start_time.unwrap_or_default() + SHORT);
    }
    let outcome = match simulated(&fmu, &options, Place::Worker { sandbox: arguments.sandbox }, console) {
        Ok(trajectory) => match trajectory.not_finite() {
            None => Ok(result(&trajectory, fmu.description().time_unit())),
            Some(found) => {
                Err((Run::Ended, format!("{}; {found}", result(&trajectory, fmu.description().time_unit()))))
            }
        },
        Err(CalibrationError::Cancelled) => return Err(Error::interrupted()),
        Err(error) => Err((Run::Failed, error.to_string())),
    };
    let quirks: Vec<String> =
        fmu.description().quirks.iter().chain(&fmu.quirks_seen()).map(ToString::to_string).collect();
    if arguments.json {
        let (is_simulated, message) = match &outcome {
            Ok(message) => (true, message),
            Err((_, message)) => (false, message),
        };
        console.json(&Document {
            path: fmu.path().display().to_string(),
            model_name: &fmu.description().model_name,
            fmi_version: fmu.description().fmi_version.to_string(),
            quirks: &quirks,
            is_simulated,
            simulation: message,
        })?;
    } else {
        let departures = match quirks.len() {
            0 => "no violations of the FMI standard".to_owned(),
            1 => "1 violation of the FMI standard:".to_owned(),
            n => format!("{n} violations of the FMI standard:"),
        };
        console.result(&format!("{}: {departures}", fmu.path().display()));
        quirks.iter().for_each(|quirk| console.result(&format!("  {}", visible_line(quirk))));
        console.result(&match &outcome {
            Ok(message) => format!("simulated: {message}"),
            Err((Run::Ended, message)) => format!("simulated with problems: {message}"),
            Err((Run::Failed, message)) => format!("not simulated: {message}"),
        });
    }
    Ok(if outcome.is_ok() { Exit::Success } else { Exit::NoSuccess })
}

/// Returns the end time and the counts of a simulation.
fn result(trajectory: &Trajectory, unit: &str) -> String {
    let (end, stats, n_events) = (Number(trajectory.end_time), &trajectory.stats, trajectory.events.len());
    let by_model = match trajectory.termination {
        Termination::StoppedByModel => ", ended by the model",
        _ => "",
    };
    format!("to {end} {unit}{by_model}, {} steps, {n_events} events", stats.accepted_steps)
}
