//! The model description for Python: plain dictionaries, made when they are asked for; `_description.py` gives them
//! their classes.

use crate::{files, fmu_error, values};
use fmi::description::{
    BaseUnit, Capabilities, Dimension, DisplayUnit, EnumerationItem, Interface, Terminal, TypeDefinition,
    Unit,
};
use fmi::{
    DescriptionLimits, InterfaceKind, LoaderOptions, LogFilter, LogOptions, ModelDescription, OpenOptions,
    Reuse, Variable,
};
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyString};
use std::path::{Path, PathBuf};

/// `pydfo._model.OpenOptions`, field by field.
#[derive(FromPyObject)]
struct OpenFields {
    log_level: u8,
    logging: bool,
    log_categories: Vec<String>,
    show_log: bool,
    deepbind: bool,
    lazy: bool,
    tool_is_present: bool,
    max_description_bytes: Option<u64>,
    max_elements: Option<usize>,
}

impl From<OpenFields> for OpenOptions {
    fn from(fields: OpenFields) -> Self {
        // PyFMI's levels: nothing, fatal, error, warning, and four that let everything pass.
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
            tool_is_present: fields.tool_is_present,
            logging: LogOptions {
                asked: fields.logging,
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
        let fields = PyDict::new(py);
        fields.set_item("name", &terminal.name)?;
        fields.set_item("matching_rule", &terminal.matching_rule)?;
        fields.set_item("kind", &terminal.kind)?;
        fields.set_item("description", &terminal.description)?;
        let members = PyDict::new(py);
        for member in &terminal.members {
            members.set_item(&member.variable, &member.kind)?;
        }
        fields.set_item("members", members)?;
        let streams = terminal.stream_members.iter().map(|m| (&m.inflow_variable, &m.outflow_variable));
        fields.set_item("streams", streams.collect::<Vec<_>>())?;
        fields.set_item("terminals", list_of_terminals(py, &terminal.terminals)?)?;
        fields.set_item("icon", terminal.icon.as_ref().and_then(|icon| icon.file.as_ref()))?;
        list.append(fields)?;
    }
    Ok(list)
}

fn interface(kind: &str) -> InterfaceKind {
    if kind == "CS" { InterfaceKind::CoSimulation } else { InterfaceKind::ModelExchange }
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

    /// How instances are brought back to their beginning between simulations; None before it was tried.
    fn reuse(&self, kind: &str) -> Option<&'static str> {
        Some(match self.fmu.reuse_of(interface(kind))? {
            Reuse::Restore => "restore",
            Reuse::Reset => "reset",
            Reuse::Reinstantiate => "reinstantiate",
            Reuse::Reload => "reload",
            _ => "other",
        })
    }

    /// How simulations that run in parallel share the process; None before the library was first needed.
    fn sharing(&self, kind: &str) -> Option<&'static str> {
        self.fmu.sharing_of(interface(kind)).map(fmi::Sharing::name)
    }

    /// Raises what keeps the FMU from being simulated in this way, as far as its description tells; else "ME" or "CS".
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
        self.description().variables.len()
    }

    /// Everything but the lists.
    fn header(&self) -> Header<'_> {
        Header::new(self.description())
    }

    /// Names of all variables in the order of the file.
    fn names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        PyList::new(py, self.description().variables.iter().map(|v| PyString::new(py, &v.name)))
    }

    /// Names of the states in the order of the state vector; None where the file does not tell.
    fn state_names(&self) -> Vec<Option<&str>> {
        self.description().state_names()
    }

    /// The terminals, each with those inside of it.
    fn terminals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let terminals = py.detach(|| self.fmu.terminals()).map_err(|e| fmu_error::raise(py, &e))?;
        list_of_terminals(py, &terminals)
    }

    /// Names of the variables of a causality.
    fn names_of(&self, causality: &str) -> Vec<&str> {
        let variables = self.description().variables.iter();
        variables.filter(|v| v.causality.to_string() == causality).map(|v| v.name.as_str()).collect()
    }

    /// Position of a variable; None if there is none of this name.
    fn find(&self, name: &str) -> Option<usize> {
        self.description().variable_index(name)
    }

    /// Names that resemble `name`.
    fn nearest(&self, name: &str) -> Vec<&str> {
        self.description().nearest_names(name, 3)
    }

    /// The attributes of the variable at a position.
    fn variable<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Bound<'py, PyAny>> {
        let description = self.description();
        let variable = description.variables.get(index).ok_or_else(|| {
            PyIndexError::new_err(format!("{index} of {} variables", description.variables.len()))
        })?;
        let attributes = Attributes::new(py, description, variable, index)?;
        Ok(attributes.into_pyobject(py)?.into_any())
    }

    fn units(&self) -> Vec<UnitFields<'_>> {
        self.description().units.iter().map(UnitFields::new).collect()
    }

    fn type_definitions(&self) -> Vec<TypeFields<'_>> {
        self.description().type_definitions.iter().map(TypeFields::new).collect()
    }

    fn log_categories(&self) -> Vec<(&str, Option<&str>)> {
        self.description()
            .log_categories
            .iter()
            .map(|c| (c.name.as_str(), c.description.as_deref()))
            .collect()
    }

    /// Kind, message and line (None: the file as a whole) of each departure from the standard: those of the description,
    /// and those that have shown when the FMU was run.
    fn quirks(&self) -> Vec<(String, String, Option<u32>)> {
        let quirks = self.description().quirks.iter().cloned().chain(self.fmu.quirks_seen());
        quirks.map(|q| (q.kind.to_string(), q.message, Some(q.line).filter(|line| *line > 0))).collect()
    }
}

#[derive(IntoPyObject)]
struct Header<'a> {
    fmi_version: &'a str,
    model_name: &'a str,
    guid: &'a str,
    description: Option<&'a str>,
    author: Option<&'a str>,
    version: Option<&'a str>,
    copyright: Option<&'a str>,
    license: Option<&'a str>,
    generation_tool: Option<&'a str>,
    generation_date_and_time: Option<&'a str>,
    variable_naming_convention: Option<&'a str>,
    n_states: usize,
    n_event_indicators: usize,
    default_experiment: Experiment,
    model_exchange: Option<InterfaceFields<'a>>,
    co_simulation: Option<InterfaceFields<'a>>,
}

impl<'a> Header<'a> {
    fn new(d: &'a ModelDescription) -> Self {
        let e = &d.default_experiment;
        Self {
            fmi_version: &d.fmi_version.text,
            model_name: &d.model_name,
            guid: &d.guid,
            description: d.description.as_deref(),
            author: d.author.as_deref(),
            version: d.version.as_deref(),
            copyright: d.copyright.as_deref(),
            license: d.license.as_deref(),
            generation_tool: d.generation_tool.as_deref(),
            generation_date_and_time: d.generation_date_and_time.as_deref(),
            variable_naming_convention: d.variable_naming_convention.as_deref(),
            n_states: d.n_states(),
            n_event_indicators: d.n_event_indicators,
            default_experiment: Experiment {
                start_time: e.start_time,
                stop_time: e.stop_time,
                tolerance: e.tolerance,
                step_size: e.step_size,
            },
            model_exchange: d.model_exchange.as_ref().map(InterfaceFields::new),
            co_simulation: d.co_simulation.as_ref().map(InterfaceFields::new),
        }
    }
}

#[derive(IntoPyObject)]
struct Experiment {
    start_time: Option<f64>,
    stop_time: Option<f64>,
    tolerance: Option<f64>,
    step_size: Option<f64>,
}

#[derive(IntoPyObject)]
struct InterfaceFields<'a> {
    model_identifier: &'a str,
    source_files: Vec<&'a str>,
    capabilities: CapabilityFields,
}

impl<'a> InterfaceFields<'a> {
    fn new(interface: &'a Interface) -> Self {
        Self {
            model_identifier: &interface.model_identifier,
            source_files: interface.source_files.iter().map(String::as_str).collect(),
            capabilities: CapabilityFields::new(&interface.capabilities),
        }
    }
}

/// Declares a dictionary with some fields of a structure.
macro_rules! fields {
    ($name:ident of $source:ty: $($field:ident: $type:ty),+ $(,)?) => {
        #[derive(IntoPyObject)]
        struct $name {
            $($field: $type,)+
        }

        impl $name {
            fn new(source: &$source) -> Self {
                Self { $($field: source.$field,)+ }
            }
        }
    };
}

fields!(CapabilityFields of Capabilities:
    needs_execution_tool: bool,
    completed_integrator_step_not_needed: bool,
    can_be_instantiated_only_once_per_process: bool,
    can_not_use_memory_management_functions: bool,
    can_get_and_set_state: bool,
    can_serialize_state: bool,
    provides_directional_derivative: bool,
    provides_adjoint_derivative: bool,
    can_handle_variable_communication_step_size: bool,
    can_interpolate_inputs: bool,
    can_run_asynchronuously: bool,
    max_output_derivative_order: u32,
    has_event_mode: bool,
);

fields!(BaseFields of BaseUnit:
    kg: i32, m: i32, s: i32, a: i32, k: i32, mol: i32, cd: i32, rad: i32, factor: f64, offset: f64,
);

#[derive(IntoPyObject)]
struct UnitFields<'a> {
    name: &'a str,
    base: Option<BaseFields>,
    display_units: Vec<DisplayFields<'a>>,
}

impl<'a> UnitFields<'a> {
    fn new(unit: &'a Unit) -> Self {
        Self {
            name: &unit.name,
            base: unit.base.as_ref().map(BaseFields::new),
            display_units: unit.display_units.iter().map(DisplayFields::new).collect(),
        }
    }
}

#[derive(IntoPyObject)]
struct DisplayFields<'a> {
    name: &'a str,
    factor: f64,
    offset: f64,
    inverse: bool,
}

impl<'a> DisplayFields<'a> {
    fn new(unit: &'a DisplayUnit) -> Self {
        Self { name: &unit.name, factor: unit.factor, offset: unit.offset, inverse: unit.inverse }
    }
}

#[derive(IntoPyObject)]
struct TypeFields<'a> {
    name: &'a str,
    description: Option<&'a str>,
    r#type: &'static str,
    quantity: Option<&'a str>,
    unit: Option<&'a str>,
    display_unit: Option<&'a str>,
    relative_quantity: bool,
    unbounded: bool,
    min: Option<f64>,
    max: Option<f64>,
    nominal: Option<f64>,
    items: Vec<ItemFields<'a>>,
}

impl<'a> TypeFields<'a> {
    fn new(t: &'a TypeDefinition) -> Self {
        Self {
            name: &t.name,
            description: t.description.as_deref(),
            r#type: t.kind.name(),
            quantity: t.quantity.as_deref(),
            unit: t.unit.as_deref(),
            display_unit: t.display_unit.as_deref(),
            relative_quantity: t.relative_quantity,
            unbounded: t.unbounded,
            min: t.min,
            max: t.max,
            nominal: t.nominal,
            items: t.items.iter().map(ItemFields::new).collect(),
        }
    }
}

#[derive(IntoPyObject)]
struct ItemFields<'a> {
    name: &'a str,
    value: i64,
    description: Option<&'a str>,
}

impl<'a> ItemFields<'a> {
    fn new(item: &'a EnumerationItem) -> Self {
        Self { name: &item.name, value: item.value, description: item.description.as_deref() }
    }
}

#[derive(IntoPyObject)]
struct Attributes<'a, 'py> {
    name: &'a str,
    index: usize,
    value_reference: u32,
    description: Option<&'a str>,
    r#type: &'static str,
    causality: String,
    variability: String,
    initial: Option<String>,
    declared_type: Option<&'a str>,
    quantity: Option<&'a str>,
    unit: Option<&'a str>,
    display_unit: Option<&'a str>,
    relative_quantity: bool,
    unbounded: bool,
    min: Option<f64>,
    max: Option<f64>,
    nominal: Option<f64>,
    start: Option<Bound<'py, PyAny>>,
    shape: Vec<usize>,
    dimensions: Vec<Bound<'py, PyAny>>,
    aliases: Vec<&'a str>,
    derivative: Option<&'a str>,
    reinit: bool,
    can_handle_multiple_set_per_time_instant: bool,
    extents: Vec<usize>,
    interval_variability: Option<&'static str>,
    line: u32,
}

impl<'a, 'py> Attributes<'a, 'py> {
    fn new(
        py: Python<'py>,
        description: &'a ModelDescription,
        v: &'a Variable,
        index: usize,
    ) -> PyResult<Self> {
        Ok(Self {
            name: &v.name,
            index,
            value_reference: v.value_reference,
            description: v.description.as_deref(),
            r#type: v.kind.name(),
            causality: v.causality.to_string(),
            variability: v.variability.to_string(),
            initial: v.initial.map(|initial| initial.to_string()),
            declared_type: v.declared_type.as_deref(),
            quantity: v.quantity.as_deref(),
            unit: v.unit.as_deref(),
            display_unit: v.display_unit.as_deref(),
            relative_quantity: v.relative_quantity,
            unbounded: v.unbounded,
            min: v.min,
            max: v.max,
            nominal: v.nominal,
            start: v
                .start
                .clone()
                .map(|value| values::to_python(py, value, v.kind, &description.extents(v)))
                .transpose()?,
            shape: description.extents(v),
            dimensions: v
                .dimensions
                .iter()
                .map(|dimension| match dimension {
                    Dimension::Fixed(extent) => extent.into_bound_py_any(py),
                    Dimension::Parameter(index) => {
                        description.variables[*index].name.as_str().into_bound_py_any(py)
                    }
                })
                .collect::<PyResult<_>>()?,
            aliases: v.aliases.iter().map(|alias| alias.name.as_str()).collect(),
            derivative: v.derivative.map(|state| description.variables[state].name.as_str()),
            reinit: v.reinit,
            can_handle_multiple_set_per_time_instant: v.can_handle_multiple_set_per_time_instant,
            extents: description.extents(v),
            interval_variability: v.clock.as_ref().map(|timing| timing.kind.name()),
            line: v.line,
        })
    }
}
