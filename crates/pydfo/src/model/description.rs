//! The model description for Python: plain dictionaries, created on request. `_model/description.py` converts
//! them to classes.

use crate::convert::dict::dict;
use crate::convert::fmu_error;
use crate::convert::object;
use crate::convert::values;
use crate::model::files;
use calibration::TimeColumn;
use fmi::description::{Dimension, Terminal, TypeDefinition};
use fmi::{
    DescriptionLimits, InterfaceKind, LoaderOptions, LogFilter, LogOptions, ModelDescription, OpenOptions,
};
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList, PyString, PyTuple};
use std::path::{Path, PathBuf};

/// `pydfo._model.model.OpenOptions`, field by field.
#[derive(FromPyObject)]
struct OpenFields {
    log_level: u8,
    logging: bool,
    log_categories: Vec<String>,
    show_log: bool,
    deepbind: bool,
    lazy: bool,
    max_description_bytes: Option<u64>,
    max_elements: Option<usize>,
}

impl From<OpenFields> for OpenOptions {
    fn from(fields: OpenFields) -> Self {
        // PyFMI's levels: nothing, fatal, error, warning, and four levels that pass everything.
        let filter = match fields.log_level {
            0 => LogFilter::Nothing,
            1 | 2 => LogFilter::Errors,
            3 => LogFilter::Warnings,
            _ => LogFilter::All,
        };
        let limits = DescriptionLimits::default();
        OpenOptions {
            description: DescriptionLimits {
                bytes: fields.max_description_bytes.unwrap_or(limits.bytes),
                elements: fields.max_elements.unwrap_or(limits.elements),
            },
            loader: LoaderOptions { deepbind: fields.deepbind, lazy: fields.lazy },
            logging: LogOptions {
                requested: fields.logging,
                categories: fields.log_categories,
                filter,
                shown: fields.show_log,
            },
            ..OpenOptions::default()
        }
    }
}

fn list_of_terminals<'py>(py: Python<'py>, terminals: &[Terminal]) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for terminal in terminals {
        let members = PyDict::new(py);
        for member in &terminal.members {
            members.set_item(&member.variable, &member.kind)?;
        }
        let streams = terminal.stream_members.iter().map(|m| (&m.inflow_variable, &m.outflow_variable));
        list.append(dict!(py; terminal => name, matching_rule, kind, description;
            "members": members,
            "streams": streams.collect::<Vec<_>>(),
            "terminals": list_of_terminals(py, &terminal.terminals)?,
            "icon": terminal.icon.as_ref().and_then(|icon| icon.file.as_ref()),
        ))?;
    }
    Ok(list)
}

/// An opened FMU.
#[pyclass(frozen, module = "pydfo._core")]
pub(crate) struct Fmu {
    pub(crate) fmu: fmi::Fmu,
}

impl Fmu {
    fn description(&self) -> &ModelDescription {
        self.fmu.description()
    }
}

#[pymethods]
impl Fmu {
    #[new]
    #[pyo3(signature = (path, options=None))]
    fn new(py: Python<'_>, path: PathBuf, options: Option<OpenFields>) -> PyResult<Self> {
        let options = options.map(OpenOptions::from).unwrap_or_default();
        Ok(Self { fmu: files::open(py, path, &options)? })
    }

    /// Returns the FMU with units of variables for which its description declares none.
    fn with_units(&self, py: Python<'_>, units: Vec<(String, String)>) -> PyResult<Self> {
        let units = units.iter().map(|(variable, unit)| (&variable[..], &unit[..]));
        Ok(Self { fmu: self.fmu.with_units(units).map_err(|e| fmu_error::raise(py, &e))? })
    }

    /// Returns the bytes of the model description.
    fn description_file<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = py.detach(|| self.fmu.description_file()).map_err(|e| fmu_error::raise(py, &e))?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Returns an FMU with this content, originally at `path`, of which only the model description is
    /// available.
    #[staticmethod]
    fn described(
        py: Python<'_>,
        path: PathBuf,
        description: Vec<u8>,
        content_hash: String,
    ) -> PyResult<Self> {
        let reason = "a pickled Description contains only the description; open the file".to_owned();
        let options = OpenOptions::default();
        let fmu = py.detach(|| fmi::Fmu::absent(path, description, content_hash, reason, &options));
        Ok(Self { fmu: fmu.map_err(|e| fmu_error::raise(py, &e))? })
    }

    /// Returns the factor that converts times in a unit (its length in s as a fraction, or None if none is
    /// stated) to the time unit of the model, as a fraction.
    #[pyo3(signature = (unit))]
    fn time_factor(&self, unit: Option<(f64, f64)>) -> PyResult<(f64, f64)> {
        let factor = TimeColumn { index: 0, unit }.factor_for(self.description());
        factor.ok_or_else(|| {
            let own = self.description().time_unit();
            PyValueError::new_err(format!(
                "the model counts its independent variable in '{own}', which is not a unit of time. Remove the unit from the times"
            ))
        })
    }

    /// Returns the way in which the model is reset between simulations, as far as comparisons with new
    /// processes have shown.
    fn reuse(&self) -> &'static str {
        match self.fmu.reuse() {
            fmi::Reuse::Reset => "reset",
            fmi::Reuse::Reinstantiate => "reinstantiate",
            _ => "process",
        }
    }

    /// Raises the reason why the FMU cannot be simulated as this kind, as far as its description shows.
    /// Otherwise returns "ME" or "CS".
    fn check_runnable(&self, py: Python<'_>, kind: &str) -> PyResult<&'static str> {
        let chosen = kind.parse().and_then(|kind| self.fmu.check_runnable_as(kind));
        match chosen.map_err(|e| fmu_error::raise(py, &e))? {
            InterfaceKind::ModelExchange => Ok("ME"),
            InterfaceKind::CoSimulation => Ok("CS"),
        }
    }

    #[getter]
    fn path(&self) -> &Path {
        self.fmu.path()
    }

    #[getter]
    fn content_hash(&self, py: Python<'_>) -> PyResult<&str> {
        py.detach(|| self.fmu.content_hash()).map_err(|e| fmu_error::raise(py, &e))
    }

    #[getter]
    fn n_variables(&self) -> usize {
        self.description().names().count()
    }

    /// Returns everything but the lists.
    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let d = self.description();
        Ok(dict!(py;
            d => model_name, guid, description, author, version, copyright, license, generation_tool,
            generation_date_and_time, variable_naming_convention, n_event_indicators;
            "fmi_version": &d.fmi_version.text,
            "time_unit": d.time_unit(),
            "n_states": d.n_states(),
            "default_experiment": object::to_python(py, &d.default_experiment)?,
            "model_exchange": object::to_python(py, &d.model_exchange)?,
            "co_simulation": object::to_python(py, &d.co_simulation)?,
        ))
    }

    /// Names of all variables in the order of the file, each followed by its aliases.
    fn names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let names: Vec<_> = self.description().names().map(|(name, _)| PyString::new(py, name)).collect();
        PyList::new(py, names)
    }

    /// Names of the states in the order of the state vector; None if the file does not declare it.
    fn state_names(&self) -> Vec<Option<&str>> {
        self.description().state_names()
    }

    /// Returns the terminals, each with its nested terminals.
    fn terminals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let terminals = py.detach(|| self.fmu.terminals()).map_err(|e| fmu_error::raise(py, &e))?;
        list_of_terminals(py, &terminals)
    }

    /// Names of the parameters that may change during a simulation.
    fn tunable_parameters(&self) -> Vec<&str> {
        let variables = self.description().variables.iter();
        variables.filter(|v| v.is_tunable_parameter()).map(|v| v.name.as_str()).collect()
    }

    /// Names of the variables with this causality.
    fn names_of(&self, causality: &str) -> Vec<&str> {
        let variables = self.description().variables.iter();
        variables.filter(|v| v.causality.to_string() == causality).map(|v| v.name.as_str()).collect()
    }

    /// True if there is a variable of this name.
    fn has(&self, name: &str) -> bool {
        self.description().variable_index(name).is_some()
    }

    /// Returns names that resemble `name`.
    fn nearest(&self, name: &str) -> Vec<&str> {
        self.description().nearest_names(name, 3)
    }

    /// Returns the attributes of the variable with this name; None if there is no such variable.
    fn variable<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Option<Bound<'py, PyDict>>> {
        let description = self.description();
        description.variable_index(name).map(|index| attributes(py, description, index, name)).transpose()
    }

    fn units<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        object::to_python(py, &self.description().units)
    }

    fn type_definitions<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        self.description().type_definitions.iter().map(|t| type_fields(py, t)).collect()
    }

    fn log_categories(&self) -> Vec<(&str, Option<&str>)> {
        self.description()
            .log_categories
            .iter()
            .map(|c| (c.name.as_str(), c.description.as_deref()))
            .collect()
    }

    /// Returns kind, message and line (`None` for the whole file) of each violation of the standard, in the
    /// description or observed while the FMU was run.
    fn quirks(&self) -> Vec<(String, String, Option<u32>)> {
        let quirks = self.description().quirks.iter().cloned().chain(self.fmu.quirks_seen());
        quirks.map(|q| (q.kind.to_string(), q.message, Some(q.line).filter(|line| *line > 0))).collect()
    }
}

fn type_fields<'py>(py: Python<'py>, t: &TypeDefinition) -> PyResult<Bound<'py, PyDict>> {
    Ok(dict!(py;
        t => name, description, quantity, unit, display_unit, relative_quantity, unbounded, min, max, nominal;
        "type": t.kind.name(),
        "items": object::to_python(py, &t.items)?,
    ))
}

fn attributes<'py>(
    py: Python<'py>,
    description: &ModelDescription,
    index: usize,
    name: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let v = &description.variables[index];
    let alias = v.aliases.iter().find(|alias| alias.name == name && v.name != name);
    let display_unit = alias.and_then(|alias| alias.display_unit.as_ref()).or(v.display_unit.as_ref());
    let names = std::iter::once(&v.name).chain(v.aliases.iter().map(|alias| &alias.name));
    let shape = description.extents(v);
    let start = v.start.clone().map(|value| values::to_python(py, value, v.kind, &shape)).transpose()?;
    let name_of = |variable: usize| description.variables[variable].name.as_str();
    let dimension = |dimension: &Dimension| match dimension {
        Dimension::Fixed(extent) => extent.into_bound_py_any(py),
        Dimension::Parameter(index) => name_of(*index).into_bound_py_any(py),
    };
    Ok(dict!(py;
        v => value_reference, declared_type, quantity, unit, relative_quantity, unbounded, min, max, nominal, reinit,
        can_handle_multiple_set_per_time_instant, line;
        "name": name,
        "index": index,
        "description": alias.map_or(&v.description, |alias| &alias.description),
        "display_unit": display_unit,
        "type": v.kind.name(),
        "causality": v.causality.to_string(),
        "variability": v.variability.to_string(),
        "initial": v.initial.map(|initial| initial.to_string()),
        "start": start,
        "shape": PyTuple::new(py, shape)?,
        "dimensions": PyTuple::new(py, v.dimensions.iter().map(dimension).collect::<PyResult<Vec<_>>>()?)?,
        "aliases": PyTuple::new(py, names.filter(|other| *other != name).collect::<Vec<_>>())?,
        "derivative": v.derivative.map(name_of),
        "interval_variability": v.clock.as_ref().map(|timing| timing.kind.name()),
    ))
}
