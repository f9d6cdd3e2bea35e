"""The model description as FMPy's objects, read by `pydfo.read_description`.

Literals are written anew (``start="1"``, ``"true"``), so they may look other than in the file; of the model structure there are
the variables, not their dependencies.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..._model import description as _native
from .._refused import hand_out, refuse

PathLike = str | os.PathLike[str]


@dataclass(eq=False)
class DefaultExperiment:
    """Settings for a simulation, as texts; times in s."""

    startTime: str | None = None
    stopTime: str | None = None
    tolerance: str | None = None
    stepSize: str | None = None


@dataclass(eq=False)
class InterfaceType:
    """Model exchange or co-simulation."""

    modelIdentifier: str | None = None
    needsExecutionTool: bool = False
    canBeInstantiatedOnlyOncePerProcess: bool = False
    canGetAndSetFMUstate: bool = False
    canSerializeFMUstate: bool = False
    providesAdjointDerivatives: bool = False
    canNotUseMemoryManagementFunctions: bool = False
    providesDirectionalDerivative: bool = False


@dataclass(eq=False)
class ModelExchange(InterfaceType):
    """Model exchange."""

    needsCompletedIntegratorStep: bool = False
    completedIntegratorStepNotNeeded: bool = False


@dataclass(eq=False)
class CoSimulation(InterfaceType):
    """Co-simulation; the step in s."""

    canHandleVariableCommunicationStepSize: bool = False
    fixedInternalStepSize: float | None = None
    maxOutputDerivativeOrder: int = 0
    canInterpolateInputs: bool = False
    providesIntermediateUpdate: bool = False
    mightReturnEarlyFromDoStep: bool = False
    canReturnEarlyAfterIntermediateUpdate: bool = False
    hasEventMode: bool = False
    canRunAsynchronuously: bool = False


@dataclass(eq=False)
class Category:
    """A category of log messages."""

    name: str | None = None
    description: str | None = None


@dataclass(eq=False)
class Item:
    """One of the values of an enumeration."""

    name: str | None = None
    value: str | None = None
    description: str | None = None


@dataclass(eq=False)
class SimpleType:
    """A type definition."""

    name: str | None = None
    description: str | None = None
    type: str | None = None
    quantity: str | None = None
    unit: str | None = None
    displayUnit: str | None = None
    relativeQuantity: bool = False
    min: str | None = None
    max: str | None = None
    nominal: str | None = None
    unbounded: bool = False
    items: list[Item] = field(default_factory=list)


@dataclass(eq=False)
class DisplayUnit:
    """A unit to show values in."""

    name: str | None = None
    factor: float = 1.0
    offset: float = 0.0


@dataclass(eq=False)
class BaseUnit:
    """Exponents of the SI base units."""

    kg: int = 0
    m: int = 0
    s: int = 0
    A: int = 0
    K: int = 0
    mol: int = 0
    cd: int = 0
    rad: int = 0
    factor: float = 1.0
    offset: float = 0.0


@dataclass(eq=False)
class Unit:
    """A unit."""

    name: str | None = None
    baseUnit: BaseUnit | None = None
    displayUnits: list[DisplayUnit] = field(default_factory=list)


@dataclass(eq=False)
class VariableAlias:
    """Another name of a variable (FMI 3.0)."""

    name: str
    description: str | None = None
    displayUnit: str | None = None


@dataclass(eq=False)
class ModelVariable:
    """A variable; values in its unit, as texts."""

    name: str
    valueReference: int
    type: str
    shape: tuple[int, ...] | None = None
    description: str | None = None
    causality: str | None = None
    variability: str | None = None
    initial: str | None = None
    canHandleMultipleSetPerTimeInstant: bool = True
    declaredType: SimpleType | None = None
    dimensions: list[Any] = field(default_factory=list)
    quantity: str | None = None
    unit: str | None = None
    displayUnit: str | None = None
    relativeQuantity: bool = False
    min: str | None = None
    max: str | None = None
    nominal: str | None = None
    unbounded: bool = False
    start: str | None = None
    derivative: ModelVariable | None = field(default=None, repr=False)
    reinit: bool = False
    sourceline: int | None = None
    intervalVariability: str | None = None
    aliases: list[VariableAlias] = field(default_factory=list)
    alias: ModelVariable | None = field(default=None, repr=False)


ScalarVariable = ModelVariable


@dataclass(eq=False)
class Unknown:
    """A variable of the model structure; its dependencies are not told (None)."""

    variable: ModelVariable | None = None
    dependencies: list[ModelVariable] | None = None
    dependenciesKind: list[str] | None = None


@dataclass(eq=False)
class ModelDescription:
    """A model description."""

    fmiVersion: str
    modelName: str
    instantiationToken: str
    description: str | None = None
    author: str | None = None
    version: str | None = None
    copyright: str | None = None
    license: str | None = None
    generationTool: str | None = None
    generationDateAndTime: str | None = None
    variableNamingConvention: str = "flat"
    numberOfContinuousStates: int = 0
    numberOfEventIndicators: int = 0
    logCategories: list[Category] = field(default_factory=list)
    defaultExperiment: DefaultExperiment | None = None
    coSimulation: CoSimulation | None = None
    modelExchange: ModelExchange | None = None
    unitDefinitions: list[Unit] = field(default_factory=list)
    typeDefinitions: list[SimpleType] = field(default_factory=list)
    modelVariables: list[ModelVariable] = field(default_factory=list)
    outputs: list[Unknown] = field(default_factory=list)
    derivatives: list[Unknown] = field(default_factory=list)

    @property
    def guid(self) -> str:
        """The guid; the instantiation token in FMI 3.0."""
        return self.instantiationToken

    @property
    def fmiMajorVersion(self) -> int:
        """1, 2 or 3."""
        return int(self.fmiVersion.split(".")[0])

    @property
    def modelIdentifier(self) -> str:
        """The name of the library, where all interfaces have the same."""
        names = {interface.modelIdentifier for interface in (self.modelExchange, self.coSimulation) if interface is not None}
        if len(names) != 1:
            raise ValueError(f"the interfaces have other libraries each: {', '.join(sorted(map(str, names))) or 'none'}")
        return str(names.pop())


class ValidationError(Exception):
    """A description that departs from the standard, with the list of its `problems`."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__(problems)
        self.problems = problems

    def __str__(self) -> str:
        return "Failed to validate modelDescription.xml:" + "".join(f"\n- {problem}" for problem in self.problems)


def text_of(value: Any) -> str | None:
    """A value as it stands in an XML file."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, np.ndarray):
        return " ".join(str(text_of(item)) for item in value.ravel().tolist())
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return re.sub(r"e([+-])0+", r"e\1", f"{value:.16g}")
    return value.hex() if isinstance(value, bytes) else str(value)


def path_of(filename: PathLike | IO[bytes]) -> tuple[str, str | None]:
    """A path to open, and the folder to remove afterwards: a file-like object is written to one."""
    if isinstance(filename, (str, os.PathLike)):
        return os.fspath(filename), None
    folder = tempfile.mkdtemp()
    path = os.path.join(folder, "model.fmu")
    with open(path, "wb") as file:
        shutil.copyfileobj(filename, file)
    return path, folder


def _interface(found: _native.Interface | None, kind: type[Any]) -> Any:
    if found is None:
        return None
    can = found.capabilities
    fields: dict[str, Any] = {
        "modelIdentifier": found.model_identifier,
        "needsExecutionTool": can.needs_execution_tool,
        "canBeInstantiatedOnlyOncePerProcess": can.can_be_instantiated_only_once_per_process,
        "canGetAndSetFMUstate": can.can_get_and_set_state,
        "canSerializeFMUstate": can.can_serialize_state,
        "providesAdjointDerivatives": can.provides_adjoint_derivative,
        "canNotUseMemoryManagementFunctions": can.can_not_use_memory_management_functions,
        "providesDirectionalDerivative": can.provides_directional_derivative,
    }
    if kind is ModelExchange:
        fields["completedIntegratorStepNotNeeded"] = can.completed_integrator_step_not_needed
        fields["needsCompletedIntegratorStep"] = not can.completed_integrator_step_not_needed
    else:
        fields |= {
            "canHandleVariableCommunicationStepSize": can.can_handle_variable_communication_step_size,
            "fixedInternalStepSize": can.fixed_internal_step_size,
            "maxOutputDerivativeOrder": can.max_output_derivative_order,
            "canInterpolateInputs": can.can_interpolate_inputs,
            "providesIntermediateUpdate": can.provides_intermediate_update,
            "mightReturnEarlyFromDoStep": can.might_return_early_from_do_step,
            "canReturnEarlyAfterIntermediateUpdate": can.can_return_early_after_intermediate_update,
            "hasEventMode": can.has_event_mode,
            "canRunAsynchronuously": can.can_run_asynchronuously,
        }
    return kind(**fields)


def _unit(unit: _native.Unit) -> Unit:
    base = unit.base
    shown = [DisplayUnit(display.name, display.factor, display.offset) for display in unit.display_units]
    exponents = None if base is None else BaseUnit(base.kg, base.m, base.s, base.a, base.k, base.mol, base.cd, base.rad, base.factor, base.offset)
    return Unit(unit.name, exponents, shown)


#: FMPy's names of the types of FMI 3.0 that are called otherwise here.
_TYPES_3 = {"Real": "Float64", "Integer": "Int32"}


def _type_name(name: str, version: str) -> str:
    return _TYPES_3.get(name, name) if version.startswith("3") else name


def _type(found: _native.TypeDefinition, version: str) -> SimpleType:
    return SimpleType(
        name=found.name,
        description=found.description,
        type=_type_name(found.type, version),
        quantity=found.quantity,
        unit=found.unit,
        displayUnit=found.display_unit,
        relativeQuantity=found.relative_quantity,
        min=text_of(found.min),
        max=text_of(found.max),
        nominal=text_of(found.nominal),
        unbounded=found.unbounded,
        items=[Item(item.name, str(item.value), item.description) for item in found.items],
    )


def of_description(found: _native.Description) -> ModelDescription:
    """FMPy's object for a description."""
    version = found.fmi_version
    types = {name: _type(definition, version) for name, definition in found.type_definitions.items()}
    variables: dict[str, ModelVariable] = {}
    origins: dict[int, ModelVariable] = {}
    for name, v in found.variables.items():
        variables[name] = ModelVariable(
            name=name,
            valueReference=v.value_reference,
            type=_type_name(v.type, version),
            shape=v.shape or None,
            description=v.description,
            causality=v.causality,
            variability=v.variability,
            initial=v.initial,
            canHandleMultipleSetPerTimeInstant=v.can_handle_multiple_set_per_time_instant,
            declaredType=types.get(v.declared_type) if v.declared_type else None,
            dimensions=list(v.dimensions),
            quantity=v.quantity,
            unit=v.unit,
            displayUnit=v.display_unit,
            relativeQuantity=v.relative_quantity,
            min=text_of(v.min),
            max=text_of(v.max),
            nominal=text_of(v.nominal),
            unbounded=v.unbounded,
            start=text_of(v.start),
            reinit=v.reinit,
            sourceline=v.line,
            intervalVariability=v.interval_variability,
            alias=origins.get(v.index),
        )
        if (origin := origins.setdefault(v.index, variables[name])) is not variables[name]:
            origin.aliases.append(VariableAlias(name, v.description, v.display_unit))
    for name, v in found.variables.items():
        if v.derivative is not None:
            variables[name].derivative = variables[v.derivative]
    of_state = {v.derivative.name: v for v in variables.values() if v.derivative is not None}
    default = found.default_experiment
    texts = [text_of(value) for value in (default.start_time, default.stop_time, default.tolerance, default.step_size)]
    return ModelDescription(
        fmiVersion=version,
        modelName=found.model_name,
        instantiationToken=found.guid,
        description=found.description,
        author=found.author,
        version=found.version,
        copyright=found.copyright,
        license=found.license,
        generationTool=found.generation_tool,
        generationDateAndTime=found.generation_date_and_time,
        variableNamingConvention=found.variable_naming_convention or "flat",
        numberOfContinuousStates=found.n_states,
        numberOfEventIndicators=found.n_event_indicators,
        logCategories=[Category(category.name, category.description) for category in found.log_categories],
        defaultExperiment=DefaultExperiment(*texts) if any(text is not None for text in texts) else None,
        coSimulation=_interface(found.co_simulation, CoSimulation),
        modelExchange=_interface(found.model_exchange, ModelExchange),
        unitDefinitions=[_unit(unit) for unit in found.units.values()],
        typeDefinitions=list(types.values()),
        # FMPy has the aliases at the end.
        modelVariables=sorted(variables.values(), key=lambda variable: variable.alias is not None),
        # FMI 1.0 has no model structure.
        outputs=[Unknown(variables[name]) for name in found.outputs] if version != "1.0" else [],
        derivatives=[Unknown(of_state[name]) for name in found.states if name is not None and name in of_state],
    )


def read_model_description(
    filename: PathLike | IO[bytes],
    validate: bool = True,
    validate_variable_names: bool = False,
    validate_model_structure: bool = False,
) -> ModelDescription:
    """The model description of an FMU.

    Parameters
    ----------
    filename : path or file-like
        An ``.fmu`` file, an unpacked folder, or an open file.
    validate, validate_variable_names, validate_model_structure : bool
        The first has no effect: what cannot be read is an error in any case. The others raise `ValidationError` where the
        description departs from the standard.

    Raises
    ------
    OSError, FmuError
        The file cannot be read.
    ValidationError
        Departures from the standard.
    """
    path, folder = path_of(filename)
    try:
        if Path(path).suffix == ".xml":
            refuse("read_model_description() of an XML file", "give the .fmu, or the folder that holds modelDescription.xml")
        found = _native.read_description(path)
        problems = [quirk.message for quirk in found.quirks]
        if problems and (validate_variable_names or validate_model_structure):
            raise ValidationError(problems)
        return of_description(found)
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


_BUILD = "sources are built by themselves when an FMU is first simulated"
REFUSED = {
    "BuildConfiguration": _BUILD,
    "Dimension": "ModelVariable.shape has the extents, .dimensions the names of the structural parameters that they are",
    "PreProcessorDefinition": _BUILD,
    "ScheduledExecution": "scheduled execution is not simulated",
    "SourceFileSet": _BUILD,
    "is_float_literal": "float() says so",
    "read_build_description": "sources are built by themselves when an FMU is first simulated; pydfo.build_fmu packs a folder",
    "write_model_description": "pydfo does not write descriptions; Fit.export_fmu writes an FMU with other start values",
}
__getattr__ = hand_out("pydfo.compat.fmpy.model_description", REFUSED)
