//! Problem file: model, experiments, parameters, settings and the options of a fit. The library reads each
//! part from a record.

use super::document::Document;
use super::error_location::{Lines, field, item, named_in};
use crate::error::Error;
use crate::output_paths::is_stream;
use calibration::{
    Calibration, CalibrationError, Combination, Experiment, ExperimentRecord, FitOptions, Goal, Parameter,
    Relation, RunContext, SimulationSettings, Stage, fit_schema, stages_schema,
};
use dfo::{Record, RecordError, Value, field_names};
use fmi::Fmu;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Serialize;
use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};

/// A problem file, which specifies the parameters of a model and the recordings to fit them to.
#[derive(Debug, Default, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "fmufit problem file")]
#[schemars(extend("anyOf" = [{ "required": ["experiments"] }, { "required": ["objective"] }]))]
pub(crate) struct ProblemRecord {
    /// Path of the FMU.
    #[schemars(with = "PathBuf")]
    model: Value,
    /// Recordings, and how the model should reproduce them.
    #[schemars(with = "Vec<ExperimentRecord>", length(min = 1))]
    #[serde(default)]
    experiments: Value,
    /// Scenarios of a design: inputs, start values and the span of a simulation each. They replace
    /// `experiments`.
    #[schemars(with = "Vec<ExperimentRecord>")]
    #[serde(default)]
    scenarios: Value,
    /// Objective of a design: a formula over criteria of the simulation, such as `ise(y, 1) + 0.1*max(u)`. It
    /// is minimised unless it begins with `maximize`. With a list of objectives, the search returns their
    /// Pareto front.
    #[schemars(schema_with = "objective_schema")]
    #[serde(default)]
    objective: Value,
    /// Combination of the objective over several scenarios.
    #[schemars(with = "Option<Combination>")]
    #[serde(default)]
    combine: Value,
    /// Parameters to fit.
    #[schemars(schema_with = "parameters_schema")]
    parameters: Value,
    /// Constraints between the parameters, such as `tau1 <= tau2`.
    #[schemars(with = "Vec<Relation>")]
    #[serde(default)]
    constraints: Value,
    /// Settings of the simulations.
    #[schemars(with = "Option<SimulationSettings>")]
    settings: Value,
    /// Options of the fit.
    #[schemars(schema_with = "fit_schema")]
    #[serde(default)]
    fit: Value,
    /// Successive fits, each of some of the parameters.
    #[schemars(schema_with = "stages_schema")]
    #[serde(default)]
    stages: Value,
}

/// Fields of an experiment that may be written before its table by mistake.
const OF_EXPERIMENTS: [&str; 8] =
    ["data", "time", "outputs", "inputs", "weights", "windows", "start_time", "start_values"];

/// Returns the schema of the parameters: at least one, each with a name, and with a start value unless it is
/// tied to another parameter or derived from others.
fn parameters_schema(generator: &mut SchemaGenerator) -> Schema {
    let has_value = json_schema!({
        "required": ["name"],
        "anyOf": [{ "required": ["start"] }, { "required": ["tied_to"] }, { "required": ["expr"] }],
    });
    let all = [generator.subschema_for::<Parameter>(), has_value];
    json_schema!({ "type": "array", "items": { "allOf": all }, "minItems": 1 })
}

/// Returns the schema of an objective or a list of objectives.
fn objective_schema(generator: &mut SchemaGenerator) -> Schema {
    let goal = generator.subschema_for::<Goal>();
    json_schema!({ "anyOf": [goal, { "type": "array", "items": goal, "minItems": 1 }] })
}

/// A problem as written.
pub(crate) struct ProblemFile {
    /// Path of the file; `None` for a problem from the command line.
    path: Option<PathBuf>,
    /// Folder for relative paths in the file.
    folder: PathBuf,
    record: Value,
    lines: Lines,
    /// Paths of options that arguments have set.
    set: Vec<String>,
}

impl ProblemFile {
    /// Reads a file.
    pub(crate) fn read(path: &Path) -> Result<Self, Error> {
        let failed = |error| Error::input(format!("cannot read {}: {error}", path.display()));
        if is_stream(path) {
            let text = io::read_to_string(io::stdin()).map_err(failed)?;
            return Self::parse(&text, Path::new("<stdin>"));
        }
        let bytes = base::files::read_regular(path).map_err(failed)?;
        let text = String::from_utf8(bytes).map_err(|_| {
            Error::input(format!("{}: not a problem file, because it is not UTF-8 text", path.display()))
        })?;
        Self::parse(&text, path)
    }

    /// Parses the text of a file, which exists or will be written at `path`.
    pub(crate) fn parse(text: &str, path: &Path) -> Result<Self, Error> {
        let Document { record, lines } = Document::parse(text)
            .map_err(|(line, message)| Error::input(format!("{}, line {line}: {message}", path.display())))?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        let file = Self {
            path: Some(path.to_owned()),
            folder,
            record: Value::Record(record),
            lines,
            set: Vec::new(),
        };
        file.checked()
    }

    /// Creates a problem without a file. Relative paths start in the working folder.
    pub(crate) fn without_file(record: Record) -> Result<Self, Error> {
        let record = Value::Record(record);
        Self { path: None, folder: PathBuf::new(), record, lines: Lines::default(), set: Vec::new() }
            .checked()
    }

    fn checked(self) -> Result<Self, Error> {
        let fields = self.fields("")?;
        let available: Vec<String> =
            field_names::<ProblemRecord>().map_err(Error::input)?.into_iter().collect();
        let Some(name) = fields.keys().find(|name| !available.contains(name)) else { return Ok(self) };
        let of_settings = field_names::<SimulationSettings>().map_err(Error::input)?;
        let of_fit = FitOptions::option_names().map_err(Error::input)?;
        let is_of_experiment = OF_EXPERIMENTS.contains(&name.as_str());
        let tables = [
            ("[settings]", of_settings.contains(name)),
            ("[[experiments]]", is_of_experiment),
            ("[fit]", of_fit.contains(name)),
        ];
        let home = tables.iter().find(|(_, is_home)| *is_home);
        Err(match home {
            Some((table, _)) => {
                self.error(name, format!("'{name}' belongs to the table {table}; move it below that line"))
            }
            None => self.error(name, RecordError::unknown("problem field", name, &available)),
        })
    }

    /// Sets options of a table and replaces options of the file.
    pub(crate) fn set(&mut self, table: &str, options: impl IntoIterator<Item = (String, Value)>) {
        let Value::Record(record) = &mut self.record else { return };
        let options_of_table = record.entry(table.to_owned()).or_insert_with(|| Value::Record(Record::new()));
        if let Value::Record(fields) = options_of_table {
            for (name, value) in options {
                // `rng` and `seed` are the same option, and the command line takes precedence.
                let other = [("rng", "seed"), ("seed", "rng")].iter().find(|(alias, _)| *alias == name);
                other.iter().for_each(|(_, other)| drop(fields.remove(*other)));
                self.set.push(field(table, &name));
                fields.insert(name, value);
            }
        }
    }

    /// Adds entries to a record of a table, in addition to the entries of the file.
    pub(crate) fn extend(
        &mut self,
        table: &str,
        name: &str,
        entries: impl IntoIterator<Item = (String, Value)>,
    ) {
        let of_file = match &self.record {
            Value::Record(record) => match record.get(table) {
                Some(Value::Record(fields)) => fields.get(name).cloned(),
                _ => None,
            },
            _ => None,
        };
        let mut all = if let Some(Value::Record(all)) = of_file { all } else { Record::new() };
        all.extend(entries);
        self.set(table, [(name.to_owned(), Value::Record(all))]);
    }

    /// Creates an error at a path in the file.
    fn error(&self, path: &str, message: impl Display) -> Error {
        if let Some((table, name)) = path.split_once('.').filter(|_| self.set.iter().any(|set| set == path)) {
            let argument = if table == "settings" { "--setting" } else { "--option" };
            return Error::input(format!("{argument} {name}: {message}"));
        }
        match (&self.path, self.lines.of(path)) {
            (Some(file), Some(line)) => Error::input(format!("{}, line {line}: {message}", file.display())),
            (Some(file), None) => Error::input(format!("{}: {message}", file.display())),
            (None, _) => Error::input(message),
        }
    }

    /// Converts a library error about the value at a path. The location is the line of the item that the
    /// message names, if the file contains it.
    fn located(&self, path: &str, error: CalibrationError) -> Error {
        let of = if self.path.is_some() { Error::of_input } else { Error::of_arguments };
        let message = match of(error) {
            error if error.exit == crate::error::Exit::Interrupted => return error,
            error => error.to_string(),
        };
        let place = self.value(path).and_then(|value| named_in(&message, value, path));
        self.error(place.as_deref().unwrap_or(path), message)
    }

    /// Returns the value of a field of the file, or the whole file.
    fn value(&self, path: &str) -> Option<&Value> {
        let Value::Record(fields) = &self.record else { return None };
        if path.is_empty() {
            return Some(&self.record);
        }
        let (name, index) = path.split_once('[').unwrap_or((path, ""));
        match (fields.get(name)?, index.trim_end_matches(']').parse::<usize>()) {
            (Value::List(items), Ok(index)) => items.get(index),
            (value, _) => Some(value),
        }
    }

    /// Returns the fields of a table; empty if the table is missing.
    fn fields(&self, path: &str) -> Result<Record, Error> {
        match self.value(path) {
            None => Ok(Record::new()),
            Some(Value::Record(fields)) => Ok(fields.clone()),
            Some(other) => {
                let message = format!("{path}: expected a table of names and values, [{path}]; got {other}");
                Err(self.error(path, message))
            }
        }
    }

    /// Returns the tables of a list, with their paths.
    fn tables(&self, name: &str) -> Result<Vec<(String, Record)>, Error> {
        let n = match self.value(name) {
            None => 0,
            Some(Value::List(items)) => items.len(),
            Some(_) => {
                return Err(
                    self.error(name, format!("{name}: expected tables, each with the heading [[{name}]]"))
                );
            }
        };
        let paths = (0..n).map(|k| item(name, k));
        paths.map(|path| self.fields(&path).map(|fields| (path, fields))).collect()
    }

    /// Returns the constraints, with their paths.
    fn constraints(&self) -> Result<Vec<(String, Value)>, Error> {
        match self.value("constraints") {
            None => Ok(Vec::new()),
            Some(Value::List(items)) => Ok(items
                .iter()
                .enumerate()
                .map(|(k, value)| (item("constraints", k), value.clone()))
                .collect()),
            Some(_) => {
                let message = "constraints: expected a list, constraints = [\"a <= b\"], or tables with the heading [[constraints]]";
                Err(self.error("constraints", message))
            }
        }
    }

    /// Returns the objectives of a design, with their paths.
    fn objectives(&self) -> Vec<(String, &Value)> {
        match self.value("objective") {
            None => Vec::new(),
            Some(Value::List(items)) => {
                items.iter().enumerate().map(|(k, goal)| (item("objective", k), goal)).collect()
            }
            Some(goal) => vec![("objective".to_owned(), goal)],
        }
    }

    /// True if the problem has several objectives, and thus a Pareto front.
    pub(crate) fn has_front(&self) -> bool {
        self.objectives().len() > 1
    }

    /// True if the problem has an objective.
    pub(crate) fn is_design(&self) -> bool {
        self.value("objective").is_some()
    }

    /// Rejects names in a table that the library does not support.
    fn check_names(
        &self,
        path: &str,
        fields: &Record,
        available: impl IntoIterator<Item = String>,
    ) -> Result<(), Error> {
        let available: Vec<String> = available.into_iter().collect();
        match fields.keys().find(|name| !available.contains(name)) {
            Some(name) => {
                Err(self.error(&field(path, name), RecordError::unknown("fit option", name, &available)))
            }
            None => Ok(()),
        }
    }

    /// Returns the files that the problem is read from: itself, the model and the recordings.
    pub(crate) fn files(&self) -> Vec<PathBuf> {
        let mut experiments = self.tables("experiments").unwrap_or_default();
        experiments.extend(self.tables("scenarios").unwrap_or_default());
        let of_experiment =
            |fields: &'_ Record| ["data", "start_values"].map(|name| fields.get(name).cloned());
        let data: Vec<Value> =
            experiments.iter().flat_map(|(_, fields)| of_experiment(fields)).flatten().collect();
        let named = data.iter().chain(self.value("model")).filter_map(|value| match value {
            Value::Text(path) => Some(self.folder.join(path)),
            _ => None,
        });
        named.chain(self.path.clone()).collect()
    }

    /// Opens the model.
    pub(crate) fn model(&self) -> Result<Fmu, Error> {
        let model = self.value("model").ok_or_else(|| {
            self.error("", "model is missing; specify the path of an FMU, model = \"plant.fmu\"")
        })?;
        let path: PathBuf = model.read("model").map_err(|error| self.located("model", error.into()))?;
        let options = self.settings()?.open_options();
        Fmu::open_with(self.folder.join(path), &options).map_err(|error| self.located("model", error.into()))
    }

    /// Returns the settings of the simulations.
    fn settings(&self) -> Result<SimulationSettings, Error> {
        let settings = SimulationSettings::from_record(&self.fields("settings")?);
        settings.map_err(|error| self.located("settings", error.into()))
    }

    /// Creates the calibration and reads the recordings, unless the context has ended.
    pub(crate) fn calibration(&self, context: &RunContext<'_>) -> Result<Calibration, Error> {
        let mut builder = Calibration::builder(self.model()?).settings(self.settings()?);
        for (path, fields) in self.tables("parameters")? {
            let parameter = Parameter::from_record(&fields).map_err(|error| self.located(&path, error))?;
            builder = builder.parameter(parameter);
        }
        for (path, constraint) in self.constraints()? {
            let relation = constraint.read::<Relation>("constraint");
            builder = builder.constraint(relation.map_err(|error| self.located(&path, error.into()))?);
        }
        if self.is_design() && self.objectives().is_empty() {
            let message = "objective: the list is empty. Give at least one formula, such as \"ise(y, 1)\"";
            return Err(self.error("objective", message));
        }
        for (path, goal) in self.objectives() {
            let goal = goal.read::<Goal>("objective").map_err(|error| self.located(&path, error.into()))?;
            builder = builder.goal(goal);
        }
        if let Some(combine) = self.value("combine") {
            let combination =
                combine.read("combine").map_err(|error| self.located("combine", error.into()))?;
            builder = builder.combination(combination);
        }
        let mut experiments = self.tables("experiments")?;
        if self.is_design() {
            if let Some((path, _)) = experiments.first() {
                let message = "experiments belong to a fit, and objective to a design. Use [[scenarios]], or remove the objective";
                return Err(self.error(path, message));
            }
            experiments = self.tables("scenarios")?;
            if experiments.is_empty() {
                builder = builder.experiment(Experiment::default());
            }
        } else if let Some((path, _)) = self.tables("scenarios")?.first() {
            return Err(self.error(
                path,
                "scenarios belong to a design. Add objective = \"...\", or use [[experiments]]",
            ));
        }
        for (path, fields) in experiments {
            let experiment = Experiment::from_record(&fields, &self.folder, context);
            builder = builder.experiment(experiment.map_err(|error| self.located(&path, error))?);
        }
        builder.build().map_err(|error| self.located("", error))
    }

    /// Returns the options of a fit of `n_parameters` parameters.
    pub(crate) fn options(&self, n_parameters: usize) -> Result<FitOptions<'static>, Error> {
        let at = |error: dfo::Error| self.located("fit", error.into());
        let fields = self.fields("fit")?;
        self.check_names("fit", &fields, FitOptions::option_names().map_err(at)?)?;
        let mut options = match self.has_front() {
            true if fields.contains_key("method") => {
                let message = "method: a Pareto front of several objectives is searched by NSGA-II. Remove the method, or give one objective";
                return Err(self.error("fit.method", message));
            }
            true => FitOptions::of_front(fields, n_parameters),
            false => FitOptions::from_record(fields, n_parameters),
        }
        .map_err(at)?;
        if let Some(checkpoint) = &mut options.run.checkpoint {
            checkpoint.path = self.folder.join(&checkpoint.path);
        }
        Ok(options)
    }

    /// Returns the stages of the fit; empty for a fit in one stage.
    pub(crate) fn stages(&self, n_parameters: usize, workers: Option<usize>) -> Result<Vec<Stage>, Error> {
        let stage = |(path, fields): (String, Record)| {
            let at = |error: dfo::Error| self.located(&path, error.into());
            self.check_names(&path, &fields, Stage::option_names().map_err(at)?)?;
            Stage::from_record(fields, n_parameters, workers).map_err(at)
        };
        self.tables("stages")?.into_iter().map(stage).collect()
    }
}
