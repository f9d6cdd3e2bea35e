"""The model description of an FMU."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from .. import _core
from .._args import optional_libraries as _optional_libraries
from .._args import text as _text
from .._errors import UnknownVariableError
from .files import OpenOptions, PathLike, size_limit


@dataclass(frozen=True)
class DefaultExperiment:
    """Settings suggested by the model for a simulation; None if there is no suggestion.

    Attributes
    ----------
    start_time, stop_time, step_size : float or None
        Start time, stop time and step size, in the time unit of the model.
    tolerance : float or None
        Relative tolerance.
    """

    start_time: float | None
    stop_time: float | None
    tolerance: float | None
    step_size: float | None


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of an FMU, with the names of FMI 2.0 for all versions.

    Only FMI 3.0 has `has_event_mode`, `might_return_early_from_do_step`, `provides_intermediate_update`,
    `can_return_early_after_intermediate_update` and `fixed_internal_step_size` (in s, None if there is none)."""

    needs_execution_tool: bool
    completed_integrator_step_not_needed: bool
    can_be_instantiated_only_once_per_process: bool
    can_not_use_memory_management_functions: bool
    can_get_and_set_state: bool
    can_serialize_state: bool
    provides_directional_derivative: bool
    provides_adjoint_derivative: bool
    can_handle_variable_communication_step_size: bool
    can_interpolate_inputs: bool
    can_run_asynchronuously: bool
    max_output_derivative_order: int
    has_event_mode: bool
    might_return_early_from_do_step: bool
    provides_intermediate_update: bool
    can_return_early_after_intermediate_update: bool
    fixed_internal_step_size: float | None


@dataclass(frozen=True)
class Interface:
    """The model exchange or co-simulation interface of an FMU.

    Attributes
    ----------
    model_identifier : str
        Name of the library.
    source_files : list of str
        Files in ``sources/`` from which the library is built.
    capabilities : Capabilities
    """

    model_identifier: str
    source_files: list[str]
    capabilities: Capabilities


@dataclass(frozen=True)
class BaseUnit:
    """Exponents of the SI base units, with ``value in base units = factor * value + offset``."""

    kg: int
    m: int
    s: int
    a: int
    k: int
    mol: int
    cd: int
    rad: int
    factor: float
    offset: float


@dataclass(frozen=True)
class DisplayUnit:
    """A unit for display, with ``shown value = factor * value + offset`` (``factor / value`` if `inverse`)."""

    name: str
    factor: float
    offset: float
    inverse: bool


@dataclass(frozen=True)
class Unit:
    """A unit; `base` is None if the file does not define the unit in SI units."""

    name: str
    base: BaseUnit | None
    display_units: list[DisplayUnit]


@dataclass(frozen=True)
class EnumerationItem:
    """A value of an enumeration."""

    name: str
    value: int
    description: str | None


@dataclass(frozen=True)
class TypeDefinition:
    """A type to which variables refer as their `declared_type`; `items` are the items of an enumeration."""

    name: str
    description: str | None
    type: str
    quantity: str | None
    unit: str | None
    display_unit: str | None
    relative_quantity: bool
    unbounded: bool
    min: float | None
    max: float | None
    nominal: float | None
    items: list[EnumerationItem]


@dataclass(frozen=True)
class LogCategory:
    """A category of log messages."""

    name: str
    description: str | None


@dataclass(frozen=True)
class Quirk:
    """A violation of the standard in the description, and its interpretation.

    `line` is None if the violation concerns the whole file."""

    kind: str
    message: str
    line: int | None


@dataclass(frozen=True)
class Variable:
    """A variable of a model. It includes the attributes of its type definition.

    Attributes
    ----------
    name : str
    index : int
        Position in the file, from 0. Aliases have the position of their variable.
    value_reference : int
        Handle within the FMU, shared by aliases.
    description : str or None
    type : {"Real", "Integer", "Boolean", "String", "Enumeration"}
        FMI 3.0 adds "Float32", "Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64", "Binary", "Clock".
    causality : {"parameter", "structuralParameter", "calculatedParameter", "input", "output", "local", "independent"}
    variability : {"constant", "fixed", "tunable", "discrete", "continuous"}
    initial : {"exact", "approx", "calculated"} or None
        Origin of the initial value; None for inputs and time.
    declared_type : str or None
        Name of the type definition.
    quantity, unit, display_unit : str or None
    relative_quantity, unbounded : bool
    min, max, nominal : float or None
        Limits and nominal value in `unit`.
    start : float, int, bool, str, bytes, ndarray or None
        Start value in `unit`. The start value of an array has its shape.
    shape : tuple of int
        Shape of an array, with structural parameters at their start values; () for a single value.
    dimensions : tuple of int or str
        Extents of an array, as numbers or as names of structural parameters.
    aliases : tuple of str
        Other names of the variable (FMI 3.0). Each is an entry of `Variables`, with its own description and display
        unit.
    derivative : str or None
        Name of the variable whose time derivative this variable is.
    reinit : bool
        True for a state that events may reset.
    can_handle_multiple_set_per_time_instant : bool
    interval_variability : str or None
        For a clock (FMI 3.0), the source of its ticks: "constant", "fixed", "tunable", "changing", "countdown",
        "triggered".
    line : int
        Line in the file, from 1.
    """

    name: str
    index: int
    value_reference: int
    description: str | None
    type: str
    causality: str
    variability: str
    initial: str | None
    declared_type: str | None
    quantity: str | None
    unit: str | None
    display_unit: str | None
    relative_quantity: bool
    unbounded: bool
    min: float | None
    max: float | None
    nominal: float | None
    start: Any
    shape: tuple[int, ...]
    dimensions: tuple[int | str, ...]
    aliases: tuple[str, ...]
    derivative: str | None
    reinit: bool
    can_handle_multiple_set_per_time_instant: bool
    interval_variability: str | None
    line: int


#: Columns and maximum number of rows of a table of variables.
_COLUMNS = ("name", "type", "causality", "variability", "start", "unit", "description")
_MOST_SHOWN = 100


def _cell(value: object) -> str:
    return "" if value is None else value if isinstance(value, str) else _text.show(value)


class Variables(Mapping[str, Variable]):
    """The variables of a model by name, in the order of the file, each followed by its aliases (FMI 3.0).

    Variables are created on access. Printing shows a table, and `to_dataframe` returns a pandas table."""

    def __init__(self, fmu: _core.Fmu) -> None:
        self._fmu = fmu

    def __getitem__(self, name: str) -> Variable:
        found = self._fmu.variable(name) if isinstance(name, str) else None
        if found is None:
            nearest = self._fmu.nearest(name) if isinstance(name, str) else []
            hint = f"; did you mean {_text.names(nearest)}?" if nearest else ""
            raise UnknownVariableError(f'the model has no variable "{_text.line(str(name))}"{hint}')
        return Variable(**found)

    def __iter__(self) -> Iterator[str]:
        return iter(self._fmu.names())

    def __len__(self) -> int:
        return self._fmu.n_variables

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._fmu.has(name)

    def __repr__(self) -> str:
        return f"<Variables: {len(self)}>"

    def __str__(self) -> str:
        """Returns a table of the first hundred variables."""
        shown = list(itertools.islice(self.values(), _MOST_SHOWN))
        rows = [_COLUMNS, *(tuple(_text.line(_cell(getattr(variable, column))) for column in _COLUMNS) for variable in shown)]
        widths = [max(map(len, column)) for column in zip(*rows)]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]
        if len(self) > len(shown):
            lines.append(f"... and {len(self) - len(shown)} more; to_dataframe() returns all variables")
        return "\n".join(lines)

    def to_dataframe(self) -> Any:
        """Returns a pandas.DataFrame with a row per variable and the attributes of `Variable` as columns.

        The names are its index. Needs pandas."""
        rows = [vars(variable) for variable in self.values()]
        return _optional_libraries.pandas().DataFrame(rows, columns=list(Variable.__dataclass_fields__)).set_index("name")


@dataclass(frozen=True)
class Terminal:
    """A group of variables of the model to connect to a group of another model.

    Attributes
    ----------
    name : str
    matching_rule : str
        How the members of two terminals are paired: "plug", "bus", "sequence", or a name with a domain.
    kind, description : str or None
    members : dict
        Maps the name of each variable to its connection: "signal", "inflow", "outflow", or a name with a domain.
    streams : list of tuple of str
        Pairs of variables for quantities transported with a flow: into the model, and out of it.
    terminals : list of Terminal
        Nested terminals.
    icon : str or None
        Name of the image in the folder ``terminalsAndIcons``.
    """

    name: str
    matching_rule: str
    kind: str | None
    description: str | None
    members: dict[str, str]
    streams: list[tuple[str, str]]
    terminals: list[Terminal]
    icon: str | None


def _terminal(fields: dict[str, Any]) -> Terminal:
    return Terminal(**{**fields, "terminals": [_terminal(inner) for inner in fields["terminals"]]})


class Description:
    """The model description of an FMU. Reading it runs no code of the FMU.

    Attributes
    ----------
    fmi_version : str
        "1.0", "2.0", "3.0".
    model_name, guid : str
        In FMI 3.0, the guid is the instantiation token.
    description, author, version, copyright, license, generation_tool, generation_date_and_time : str or None
    variable_naming_convention : {"flat", "structured"} or None
    time_unit : str
        Unit in which the model counts its time, as it states for its independent variable; "s" by default. All times of
        simulations are in this unit.
    n_states, n_event_indicators : int
    default_experiment : DefaultExperiment
    model_exchange, co_simulation : Interface or None
        None if the FMU does not support the interface.
    path : Path
        Path of the FMU.
    """

    fmi_version: str
    model_name: str
    guid: str
    description: str | None
    author: str | None
    version: str | None
    copyright: str | None
    license: str | None
    generation_tool: str | None
    generation_date_and_time: str | None
    variable_naming_convention: str | None
    time_unit: str
    n_states: int
    n_event_indicators: int
    default_experiment: DefaultExperiment
    model_exchange: Interface | None
    co_simulation: Interface | None

    def __init__(self, fmu: _core.Fmu) -> None:
        self._fmu = fmu
        header = fmu.header()
        self.default_experiment = DefaultExperiment(**header.pop("default_experiment"))
        self.model_exchange = _interface(header.pop("model_exchange"))
        self.co_simulation = _interface(header.pop("co_simulation"))
        vars(self).update(header)
        self.path = fmu.path

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (os.fspath(self.path), self._fmu.description_file(), self._fmu.content_hash)

    @cached_property
    def variables(self) -> Variables:
        """The variables by name (a mapping of str to `Variable`)."""
        return Variables(self._fmu)

    @property
    def capabilities(self) -> Capabilities | None:
        """Capabilities of model exchange, or of co-simulation if only co-simulation is supported."""
        interface = self.model_exchange or self.co_simulation
        return interface.capabilities if interface else None

    @cached_property
    def states(self) -> list[str | None]:
        """Names of the continuous states in their order; None if the file does not name them."""
        return self._fmu.state_names()

    @cached_property
    def terminals(self) -> list[Terminal]:
        """Terminals of the model (``terminalsAndIcons.xml``); empty if there are none."""
        return [_terminal(fields) for fields in self._fmu.terminals()]

    @cached_property
    def inputs(self) -> list[str]:
        """Names of the inputs."""
        return self._fmu.names_of("input")

    @cached_property
    def outputs(self) -> list[str]:
        """Names of the outputs."""
        return self._fmu.names_of("output")

    @cached_property
    def parameters(self) -> list[str]:
        """Names of the parameters."""
        return self._fmu.names_of("parameter")

    @cached_property
    def units(self) -> dict[str, Unit]:
        """Units by name."""
        return {u["name"]: _unit(**u) for u in self._fmu.units()}

    @cached_property
    def type_definitions(self) -> dict[str, TypeDefinition]:
        """Type definitions by name."""
        return {t["name"]: _type_definition(**t) for t in self._fmu.type_definitions()}

    @cached_property
    def log_categories(self) -> list[LogCategory]:
        """Categories of log messages."""
        return [LogCategory(*category) for category in self._fmu.log_categories()]

    @property
    def quirks(self) -> list[Quirk]:
        """Violations of the standard in the file, and those detected when the model was run."""
        return [Quirk(*quirk) for quirk in self._fmu.quirks()]

    def __repr__(self) -> str:
        kinds = [k for k, i in (("ME", self.model_exchange), ("CS", self.co_simulation)) if i]
        return _text.line(
            f"<Description: {self.model_name}, FMI {self.fmi_version} {'+'.join(kinds)}, {len(self.variables)} variables, "
            f"{self.n_states} states, {self.n_event_indicators} event indicators>"
        )


def read_description(
    path: PathLike, *, max_description_bytes: int | None = None, max_elements: int | None = None
) -> Description:
    """Reads the model description of an FMU, even if the FMU cannot be simulated. Runs no code of the FMU.

    Parameters
    ----------
    path : path
        An ``.fmu`` file or an unpacked folder.
    max_description_bytes : int, optional
        Maximum size of ``modelDescription.xml``; default 64 MiB. Reading it requires at most eight times as much
        memory.
    max_elements : int, optional
        Maximum total number of elements of the array variables; default 2 million.

    Raises
    ------
    OSError
        The file cannot be read (FileNotFoundError if it does not exist).
    FmuError
        The archive or its ``modelDescription.xml`` is damaged or not safe to unpack.
    """
    options = OpenOptions(
        max_description_bytes=size_limit("max_description_bytes", max_description_bytes),
        max_elements=size_limit("max_elements", max_elements),
    )
    return Description(_core.Fmu(path, options))


def _interface(fields: dict[str, Any] | None) -> Interface | None:
    if fields is None:
        return None
    capabilities = Capabilities(**fields.pop("capabilities"))
    return Interface(**fields, capabilities=capabilities)


def _unit(name: str, base: dict[str, Any] | None, display_units: list[dict[str, Any]]) -> Unit:
    return Unit(name, BaseUnit(**base) if base else None, [DisplayUnit(**shown) for shown in display_units])


def _type_definition(items: list[dict[str, Any]], **fields: Any) -> TypeDefinition:
    return TypeDefinition(**fields, items=[EnumerationItem(**item) for item in items])


def _restored(path: str, description: bytes, content_hash: str) -> Description:
    """Restores a description from its pickle without the file."""
    return Description(_core.Fmu.described(path, description, content_hash))
