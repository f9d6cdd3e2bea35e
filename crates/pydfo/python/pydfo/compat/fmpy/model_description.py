"""The model description as FMPy's objects, read by `pydfo.read_description`.

Literals are rewritten (``start="1"``, ``"true"``), so they may differ from the file. Variables include the attributes
of their type definition.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import IO, Any
from xml.parsers.expat import ExpatError

import numpy as np

from ..._model import description as _native
from .._refused import hand_out, refuse
from ._file import DescriptionFile, numbers, read_file, attribute_values

PathLike = str | os.PathLike[str]


@dataclass(eq=False)
class DefaultExperiment:
    """Settings for a simulation, as strings; times in s."""

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
    providesPerElementDependencies: bool = False
    canNotUseMemoryManagementFunctions: bool = False
    providesDirectionalDerivative: bool = False


@dataclass(eq=False)
class ModelExchange(InterfaceType):
    """Model exchange."""

    needsCompletedIntegratorStep: bool = False
    providesEvaluateDiscreteStates: bool = False
    completedIntegratorStepNotNeeded: bool = False


@dataclass(eq=False)
class CoSimulation(InterfaceType):
    """Co-simulation; the step in s."""

    canHandleVariableCommunicationStepSize: bool = False
    fixedInternalStepSize: float | None = None
    maxOutputDerivativeOrder: int = 0
    recommendedIntermediateInputSmoothness: int = 0
    canInterpolateInputs: bool = False
    providesIntermediateUpdate: bool = False
    mightReturnEarlyFromDoStep: bool = False
    canReturnEarlyAfterIntermediateUpdate: bool = False
    hasEventMode: bool = False
    providesEvaluateDiscreteStates: bool = False
    canRunAsynchronuously: bool = False


@dataclass(eq=False)
class Category:
    """A category of log messages."""

    name: str | None = None
    description: str | None = None


@dataclass(eq=False)
class Item:
    """A value of an enumeration."""

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
    """A unit for display."""

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
class Dimension:
    """An extent of an array: a number, or a structural parameter."""

    start: int | None
    valueReference: int | None
    variable: ModelVariable | None = field(default=None, repr=False)


@dataclass(eq=False)
class ModelVariable:
    """A variable; values in its unit, as strings. `clocks` is None if the file lists none (FMI 3.0)."""

    name: str
    valueReference: int
    type: str
    shape: tuple[int, ...] = ()
    description: str | None = None
    causality: str | None = None
    variability: str | None = None
    initial: str | None = None
    canHandleMultipleSetPerTimeInstant: bool = True
    intermediateUpdate: bool = False
    previous: int | None = None
    clocks: list[ModelVariable] | None = field(default_factory=list, repr=False)
    declaredType: SimpleType | None = None
    dimensions: list[Dimension] = field(default_factory=list)
    dimensionValueReferences: list[int] = field(default_factory=list)
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
    canBeDeactivated: bool = False
    priority: int | None = None
    intervalVariability: str | None = None
    intervalDecimal: float | None = None
    shiftDecimal: float | None = None
    supportsFraction: bool = False
    resolution: int | None = None
    intervalCounter: int | None = None
    shiftCounter: int = 0
    aliases: list[VariableAlias] = field(default_factory=list)
    alias: ModelVariable | None = field(default=None, repr=False)


ScalarVariable = ModelVariable


@dataclass(eq=False)
class Unknown:
    """A variable of the model structure, with the variables on which it depends (None: not declared).

    `index` is the index of FMI 2.0, from 1."""

    index: int = 0
    variable: ModelVariable | None = None
    dependencies: list[ModelVariable] | None = None
    dependenciesKind: list[str] | None = None
    sourceline: int = 0


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
    clockedStates: list[Unknown] = field(default_factory=list)
    eventIndicators: list[Unknown] = field(default_factory=list)
    initialUnknowns: list[Unknown] = field(default_factory=list)

    @property
    def guid(self) -> str:
        """The guid, or the instantiation token in FMI 3.0."""
        return self.instantiationToken

    @guid.setter
    def guid(self, value: str) -> None:
        self.instantiationToken = value

    @property
    def fmiMajorVersion(self) -> int:
        """Major version: 1, 2 or 3."""
        return int(self.fmiVersion.split(".")[0])

    @property
    def modelIdentifier(self) -> str:
        """Name of the library, if all interfaces have the same one."""
        names = {interface.modelIdentifier for interface in (self.modelExchange, self.coSimulation) if interface is not None}
        if len(names) != 1:
            raise ValueError(f"the interfaces have different libraries: {', '.join(sorted(map(str, names))) or 'none'}")
        return str(names.pop())


class ValidationError(Exception):
    """A description that violates the standard, with the list of its `problems`."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__(problems)
        self.problems = problems

    def __str__(self) -> str:
        return "Failed to validate modelDescription.xml:" + "".join(f"\n- {problem}" for problem in self.problems)


def text_of(value: Any) -> str | None:
    """Returns a value as in an XML file."""
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
    """Returns a path to open, and the folder to remove afterwards, in which a file-like object is stored."""
    if isinstance(filename, (str, os.PathLike)):
        return os.fspath(filename), None
    folder = tempfile.mkdtemp()
    path = os.path.join(folder, "model.fmu")
    try:
        with open(path, "wb") as file:
            shutil.copyfileobj(filename, file)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return path, folder


def _pydfo_name(theirs: str) -> str:
    """Returns the name in pydfo of an attribute of FMPy."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", theirs).lower()


def _copied(kind: type[Any], found: Any, **others: Any) -> Any:
    """Returns FMPy's object for an object of pydfo.

    It copies the attributes with equal names; `others` provides the other ones."""
    same = (field.name for field in fields(kind) if field.name not in others and hasattr(found, _pydfo_name(field.name)))
    return kind(**{name: getattr(found, _pydfo_name(name)) for name in same}, **others)


def _names(kind: type[Any]) -> set[str]:
    return {field.name for field in fields(kind)}


def _interface(found: _native.Interface | None, kind: type[Any], file: DescriptionFile) -> Any:
    if found is None:
        return None
    can = found.capabilities
    others: dict[str, Any] = {
        **attribute_values(file.interfaces.get(kind.__name__, {}), _names(kind)),
        "modelIdentifier": found.model_identifier,
        "canGetAndSetFMUstate": can.can_get_and_set_state,
        "canSerializeFMUstate": can.can_serialize_state,
        "providesAdjointDerivatives": can.provides_adjoint_derivative,
    }
    if kind is ModelExchange:
        others["needsCompletedIntegratorStep"] = not can.completed_integrator_step_not_needed
    return _copied(kind, can, **others)


def _unit(unit: _native.Unit) -> Unit:
    exponents = None if unit.base is None else _copied(BaseUnit, unit.base)
    return Unit(unit.name, exponents, [_copied(DisplayUnit, shown) for shown in unit.display_units])


#: FMPy's names of FMI 3.0 types with another name in pydfo.
_TYPES_3 = {"Real": "Float64", "Integer": "Int32"}


def _type_name(name: str, version: str) -> str:
    return _TYPES_3.get(name, name) if version.startswith("3") else name


def _texts(found: Any, *names: str) -> dict[str, str | None]:
    """Returns numbers as strings."""
    return {name: text_of(getattr(found, name)) for name in names}


def _type(found: _native.TypeDefinition, version: str) -> SimpleType:
    items = [Item(item.name, str(item.value), item.description) for item in found.items]
    limits = _texts(found, "min", "max", "nominal")
    made: SimpleType = _copied(SimpleType, found, type=_type_name(found.type, version), items=items, **limits)
    return made


def _dimensions(variable: ModelVariable, extents: Sequence[int | str], variables: Mapping[str, ModelVariable]) -> None:
    for extent in extents:
        if isinstance(extent, str):
            of = variables[extent]
            variable.dimensions.append(Dimension(None, of.valueReference, of))
            variable.dimensionValueReferences.append(of.valueReference)
        else:
            variable.dimensions.append(Dimension(extent, None))


def _unknowns(listed: list[tuple[int, dict[str, str]]], variables: Mapping[int, ModelVariable]) -> list[Unknown]:
    """Returns a list of the model structure without entries that refer to unknown variables."""
    made = []
    for line, attributes in listed:
        for reference in numbers(attributes.get("index", attributes.get("valueReference", ""))):
            if reference in variables:
                by, kinds = attributes.get("dependencies"), attributes.get("dependenciesKind")
                unknown = Unknown(reference if "index" in attributes else 0, variables[reference], sourceline=line)
                unknown.dependencies = None if by is None else [variables[one] for one in numbers(by) if one in variables]
                unknown.dependenciesKind = None if kinds is None else kinds.split()
                made.append(unknown)
    return made


def _file_of(found: _native.Description, is_strict: bool) -> DescriptionFile:
    # FMI 1.0 has no model structure.
    if found.fmi_version == "1.0":
        return DescriptionFile()
    try:
        return read_file(found._fmu.description_file())
    except ExpatError as e:
        if is_strict:
            raise ValidationError([str(e)]) from None
        return DescriptionFile()


def of_description(found: _native.Description, is_strict: bool = True) -> ModelDescription:
    """Returns FMPy's object for a description.

    If `is_strict` is False, it omits the model structure of a file that is not valid XML."""
    version, file = found.fmi_version, _file_of(found, is_strict)
    types = {name: _type(definition, version) for name, definition in found.type_definitions.items()}
    variables: dict[str, ModelVariable] = {}
    is_3, attribute_names = version.startswith("3"), _names(ModelVariable)
    origins: dict[int, ModelVariable] = {}
    for name, v in found.variables.items():
        variables[name] = _copied(
            ModelVariable,
            v,
            type=_type_name(v.type, version),
            shape=v.shape,
            # FMI 1.0 has no such attribute; inputs have exact initial values.
            initial=None if version == "1.0" else "exact" if v.causality == "input" else v.initial,
            clocks=None if is_3 else [],
            declaredType=types.get(v.declared_type) if v.declared_type else None,
            dimensions=[],
            derivative=None,
            sourceline=v.line,
            aliases=[],
            alias=origins.get(v.index),
            **_texts(v, "min", "max", "nominal", "start"),
            **(attribute_values(file.variables.get(v.value_reference, {}), attribute_names) if is_3 else {}),
        )
        if (origin := origins.setdefault(v.index, variables[name])) is not variables[name]:
            origin.aliases.append(VariableAlias(name, v.description, v.display_unit))
    for name, v in found.variables.items():
        if v.derivative is not None:
            variables[name].derivative = variables[v.derivative]
        _dimensions(variables[name], v.dimensions, variables)
    by_reference = {v.valueReference: v for v in origins.values()} if is_3 else {index + 1: v for index, v in origins.items()}
    for variable in variables.values() if is_3 else ():
        clocks = file.variables.get(variable.valueReference, {}).get("clocks")
        variable.clocks = None if clocks is None else [by_reference[clock] for clock in numbers(clocks) if clock in by_reference]
    default = found.default_experiment
    texts = [text_of(value) for value in (default.start_time, default.stop_time, default.tolerance, default.step_size)]
    made: ModelDescription = _copied(
        ModelDescription,
        found,
        instantiationToken=found.guid,
        variableNamingConvention=found.variable_naming_convention or "flat",
        numberOfContinuousStates=found.n_states,
        numberOfEventIndicators=found.n_event_indicators,
        logCategories=[Category(category.name, category.description) for category in found.log_categories],
        defaultExperiment=DefaultExperiment(*texts) if any(text is not None for text in texts) else None,
        coSimulation=_interface(found.co_simulation, CoSimulation, file),
        modelExchange=_interface(found.model_exchange, ModelExchange, file),
        unitDefinitions=[_unit(unit) for unit in found.units.values()],
        typeDefinitions=list(types.values()),
        # FMPy lists the aliases at the end.
        modelVariables=sorted(variables.values(), key=lambda variable: variable.alias is not None),
        **{name: _unknowns(listed, by_reference) for name, listed in file.unknowns.items()},
    )
    return made


def read_model_description(
    filename: PathLike | IO[bytes],
    validate: bool = True,
    validate_variable_names: bool = False,
    validate_model_structure: bool = False,
) -> ModelDescription:
    """Reads the model description of an FMU.

    Parameters
    ----------
    filename : path or file-like
        An ``.fmu`` file, an unpacked folder, or an open file.
    validate, validate_variable_names, validate_model_structure : bool
        The first flag has no effect, because an unreadable file always raises an error. The other flags raise
        `ValidationError` if the description violates the standard.

    Raises
    ------
    OSError, FmuError
        The file cannot be read.
    ValidationError
        The file violates the standard or XML.
    """
    path, folder = path_of(filename)
    try:
        if Path(path).suffix == ".xml":
            refuse("read_model_description() of an XML file", "use the .fmu file, or the folder that contains modelDescription.xml")
        found = _native.read_description(path)
        problems = [quirk.message for quirk in found.quirks]
        if problems and (validate_variable_names or validate_model_structure):
            raise ValidationError(problems)
        return of_description(found)
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


_BUILD = "sources are built automatically when an FMU is first simulated"
REFUSED = {
    "BuildConfiguration": _BUILD,
    "PreProcessorDefinition": _BUILD,
    "ScheduledExecution": "scheduled execution is not supported",
    "SourceFileSet": _BUILD,
    "is_float_literal": "use float()",
    "read_build_description": "sources are built automatically when an FMU is first simulated; use pydfo.build_fmu to pack a folder",
    "write_model_description": "pydfo does not write descriptions; use Fit.export_fmu to write an FMU with other start values",
}
__getattr__ = hand_out("pydfo.compat.fmpy.model_description", REFUSED)
