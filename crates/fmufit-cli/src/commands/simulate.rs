//! `fmufit simulate`: simulates a model and writes a table.

use super::variable_text::value_of;
use crate::arguments::Simulate;
use crate::console::Console;
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::output_paths::{check_written, is_stream};
use crate::problem::short_form;
use base::Number;
use calibration::{CalibrationError, CsvRequest, Data, ModelProcess, ParameterSet, RunContext, Severity};
use dfo::Value;
use fmi::worker::{WorkerLimits, check_sandbox};
use fmi::{FmiError, Fmu, Inputs, SimulateOptions, SimulationPlan, Trajectory};
use ode::Termination;
use std::path::{Path, PathBuf};

pub(crate) fn run(arguments: &Simulate, console: &Console) -> Result<Exit, Error> {
    let output = arguments.output.as_ref().filter(|path| !is_stream(path));
    let read: Vec<PathBuf> = arguments.input.iter().chain([&arguments.model]).cloned().collect();
    check_written(output.into_iter().chain(&arguments.plot), &read)?;
    if let Some(path) = arguments.plot.as_ref().filter(|path| !is_drawing(path)) {
        let path = path.display();
        return Err(Error::input(format!("--plot {path}: expected a name that ends in .svg")));
    }
    if arguments.sandbox {
        check_sandbox().map_err(Error::input)?;
    }
    let fmu = arguments.limits.open(&arguments.model)?;
    let units = short_form::assignments(&arguments.unit, "VARIABLE=UNIT, as in --unit u=V")?;
    let units = units.iter().map(|(variable, unit)| (&variable[..], &unit[..]));
    let fmu = fmu.with_units(units).map_err(Error::input)?;
    let options = options(arguments, &fmu, console)?;
    let kind = fmu.check_runnable_as(options.run.kind).map_err(Error::input)?;
    options.without_effect(kind).iter().for_each(|sentence| console.note(&format!("warning: {sentence}")));
    // Reports mistakes in the options before the model is loaded.
    SimulationPlan::new(&fmu, &options)
        .map_err(|error| Error::input(in_arguments(&calibration::visible_error(&error))))?;
    let place = match arguments.in_process {
        true => Place::ThisProcess,
        false => Place::Worker { sandbox: arguments.sandbox },
    };
    let trajectory = simulated(&fmu, &options, place, console).map_err(Error::of_work)?;
    let table = table(&trajectory)?;
    let write = |path: &Path, text: &str| {
        base::files::write_atomically(path, text.as_bytes()).map_err(Error::write(path))
    };
    match output {
        Some(path) => write(path, &table)?,
        None => console.data(&table),
    }
    if let Some(path) = &arguments.plot {
        let unit =
            |name: &String| fmu.description().variable(name).and_then(|variable| variable.unit.clone());
        let label =
            |name: &String| unit(name).map_or_else(|| name.clone(), |unit| format!("{name} in {unit}"));
        let columns = trajectory.names.iter().zip(&trajectory.columns);
        let plot =
            calibration::plot(&trajectory.time, columns.map(|(name, values)| (label(name), &values[..])));
        write(path, &plot.ok_or_else(|| Error::work("--plot: the result has no finite values to plot"))?)?;
    }
    if let Some(reported) = trajectory.not_finite() {
        console.note(&format!("warning: {reported}"));
    }
    if trajectory.termination == Termination::StoppedByModel {
        console.note(&format!(
            "warning: the model ended the simulation at {} {}",
            Number(trajectory.end_time),
            fmu.description().time_unit()
        ));
    }
    for path in output.into_iter().chain(&arguments.plot) {
        console.note(&format!("wrote {}", path.display()));
    }
    Ok(Exit::Success)
}

fn is_drawing(path: &Path) -> bool {
    path.extension().is_some_and(|suffix| suffix.eq_ignore_ascii_case("svg"))
}

/// Replaces the names of simulation options in a message with the names of the arguments.
fn in_arguments(message: &str) -> String {
    let names = [
        ("start_time", "--start-time"),
        ("final_time", "--final-time"),
        ("output_interval", "--interval"),
        ("relative_tolerance", "--tolerance"),
        ("step_size", "--step-size"),
    ];
    names.iter().fold(message.to_owned(), |message, (name, argument)| message.replace(name, argument))
}

/// Process in which a model is simulated.
pub(crate) enum Place {
    ThisProcess,
    /// A separate process if this program can start one, otherwise this process.
    Worker {
        /// True to confine the process; an error if that is not possible.
        sandbox: bool,
    },
}

/// Simulates a model. Ctrl-C ends the simulation.
pub(crate) fn simulated(
    fmu: &Fmu,
    options: &SimulateOptions,
    place: Place,
    console: &Console,
) -> Result<Trajectory, CalibrationError> {
    let interrupt = Interrupt::watch().map_err(|error| CalibrationError::Setup(error.to_string()))?;
    let flag = interrupt.flag();
    let context = RunContext::new().flagged(&flag);
    let process = match place {
        Place::ThisProcess => None,
        Place::Worker { sandbox } => {
            match ModelProcess::new(fmu, WorkerLimits { sandbox, ..WorkerLimits::default() }) {
                Err(FmiError::NoWorker { reason }) => {
                    console.note(&format!("warning: the model runs in this process: {reason}"));
                    None
                }
                process => Some(process?),
            }
        }
    };
    let options = SimulateOptions { cancel: Some(flag.clone()), ..options.clone() };
    let trajectory = match process {
        Some(process) => process.simulate(&options, &context)?,
        None => fmu.simulate(&options)?,
    };
    match trajectory.termination {
        Termination::StoppedByObserver => Err(CalibrationError::Cancelled),
        Termination::Finished | Termination::StoppedByModel => Ok(trajectory),
    }
}

fn options(arguments: &Simulate, fmu: &Fmu, console: &Console) -> Result<SimulateOptions, Error> {
    let parsed = |name: &str, text: &Option<String>| {
        text.as_ref().map(|text| (name.to_owned(), Value::Text(text.clone())))
    };
    let mut options = SimulateOptions {
        start_time: arguments.start_time,
        final_time: arguments.final_time,
        output_interval: arguments.interval,
        ..SimulateOptions::default()
    };
    options.run.relative_tolerance = arguments.tolerance;
    options.run.step_size = arguments.step_size;
    if let Some((name, method)) = parsed("--solver", &arguments.solver) {
        options.run.method = method.parse(&name).map_err(Error::input)?;
    }
    if let Some((name, kind)) = parsed("--kind", &arguments.kind) {
        options.run.kind = kind.parse(&name).map_err(Error::input)?;
    }
    if let Some(seconds) = arguments.timeout {
        options.run.timeout = Value::Number(seconds).read_time("--timeout").map_err(Error::input)?;
    }
    if !arguments.outputs.is_empty() {
        options = options.outputs(arguments.outputs.clone());
    }
    let (files, values): (Vec<&String>, Vec<&String>) =
        arguments.values.iter().partition(|text| text.starts_with('@'));
    let values: Vec<String> = values.into_iter().cloned().collect();
    let values = short_form::assignments(&values, "NAME=VALUE, as in --set friction=0.01, or @FILE.ssv")?;
    for file in files {
        let set = ParameterSet::read(&file[1..]).and_then(|set| set.values(fmu.description()));
        // Individual values take precedence over values from files.
        let is_named = |name: &String| values.iter().any(|(given, _)| given == name);
        for (name, value) in set.map_err(Error::of_arguments)?.into_iter().filter(|(name, _)| !is_named(name))
        {
            options = options.start_value(name, value);
        }
    }
    for (name, value) in values {
        let value = value_of(fmu.description(), &name, &value)?;
        options = options.start_value(name, value);
    }
    for (name, value) in
        short_form::assignments(&arguments.initial_states, "NAME=NUMBER, as in --initial-state level=0.1")?
    {
        let number = value.parse().map_err(|_| {
            Error::input(format!("--initial-state {name}={value}: '{value}' is not a number"))
        })?;
        options = options.initial_state(name, number);
    }
    if let Some(path) = &arguments.input {
        let request = CsvRequest { time: arguments.time.as_deref(), ..CsvRequest::default() };
        let data = Data::read_csv(path, request).map_err(Error::of_arguments)?;
        let given: Vec<String> = options.start_values.iter().map(|(name, _)| name.clone()).collect();
        options = options.inputs(inputs(fmu, &data, &given, console)?);
        if options.final_time.is_none() && fmu.description().default_experiment.stop_time.is_none() {
            options.final_time = data.time().last().copied();
        }
    }
    Ok(options)
}

/// Returns the inputs for which the recording has columns, in the units of the model. The other inputs keep
/// their start values, unless they are `given`.
fn inputs(fmu: &Fmu, data: &Data, given: &[String], console: &Console) -> Result<Inputs, Error> {
    let description = fmu.description();
    let (converted, pairs, warnings) =
        calibration::recorded_inputs(data.clone(), description, given).map_err(Error::of_arguments)?;
    let (mut inputs, mut without_unit) = (Inputs::new(), Vec::new());
    for (name, column) in &pairs {
        let values = converted.column(column).map_err(Error::of_input)?;
        let stated = description.variable(name).and_then(|variable| variable.unit.as_deref());
        let stated = stated.filter(|unit| !matches!(*unit, "" | "1" | "-") && data.unit(column).is_none());
        without_unit.extend(stated.map(|unit| format!("'{name}' in {unit}")));
        // Rows with a missing value are left out, as in fits.
        let rows = data.time().iter().zip(values).filter(|(_, value)| !value.is_nan());
        let (times, values): (Vec<f64>, Vec<f64>) = rows.unzip();
        inputs = inputs.series(name, times, values);
    }
    for warning in warnings.iter().filter(|warning| warning.severity() == Severity::Warning) {
        console.note(&format!("warning: {warning}"));
    }
    if !without_unit.is_empty() {
        console.note(&format!(
            "{}: columns without a unit are assumed to be in the unit of the model: {}",
            data.source(),
            without_unit.join(", ")
        ));
    }
    Ok(inputs)
}

/// Returns the rows as comma-separated values. All numbers have enough digits to be read back exactly.
fn table(trajectory: &Trajectory) -> Result<String, Error> {
    let failed = |e: &dyn std::fmt::Display| Error::work(format!("cannot write the table: {e}"));
    // Exact integers are also among the numeric columns.
    let texts = trajectory.values.iter().filter(|column| !trajectory.names.contains(&column.name));
    let texts: Vec<_> = texts.collect();
    let mut writer = csv::Writer::from_writer(Vec::new());
    let names = trajectory.names.iter().chain(texts.iter().map(|column| &column.name));
    writer.write_record(std::iter::once("time").chain(names.map(String::as_str))).map_err(|e| failed(&e))?;
    for (k, time) in trajectory.time.iter().enumerate() {
        let numbers = std::iter::once(*time).chain(trajectory.columns.iter().map(|column| column[k]));
        let texts = texts.iter().map(|column| match &column[k] {
            fmi::Value::String(text) => text.clone(),
            other => other.to_string(),
        });
        let row = numbers.map(|number| Number(number).to_string()).chain(texts);
        writer.write_record(row).map_err(|e| failed(&e))?;
    }
    let bytes = writer.into_inner().map_err(|e| failed(&e))?;
    String::from_utf8(bytes).map_err(|e| failed(&e))
}
