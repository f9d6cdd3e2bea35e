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
    """Settings that the model suggests for a simulation; None where it does not.

    Attributes
    ----------
    start_time, stop_time, step_size : float or None
        In s.
    tolerance : float or None
        Relative tolerance.
    """

    start_time: float | None
    stop_time: float | None
    tolerance: float | None
    step_size: float | None


@dataclass(frozen=True)
class Capabilities:
    """What an FMU can do, in the words of FMI 2.0; those of the other versions are given the same names. FMI 3.0 alone has
    `has_event_mode`, `might_return_early_from_do_step`, `provides_intermediate_update`, `can_return_early_after_intermediate_update`
    and `fixed_internal_step_size` (in s, None if there is none)."""

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
    """Model exchange or co-simulation, as an FMU offers it.

    Attributes
    ----------
    model_identifier : str
        Name of the library.
    source_files : list of str
        Files in ``sources/`` that it is built from.
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
    """A unit to show values in, with ``shown value = factor * value + offset`` (``factor / value`` if `inverse`)."""

    name: str
    factor: float
    offset: float
    inverse: bool


@dataclass(frozen=True)
class Unit:
    """A unit; `base` is None where the file does not define it in SI units."""

    name: str
    base: BaseUnit | None
    display_units: list[DisplayUnit]


@dataclass(frozen=True)
class EnumerationItem:
    """One of the values of an enumeration."""

    name: str
    value: int
    description: str | None


@dataclass(frozen=True)
class TypeDefinition:
    """A type that variables refer to as their `declared_type`; `items` are those of an enumeration."""

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
    """A place where the description departs from the standard, and what was made of it; `line` is None if it is about
    the file as a whole."""

    kind: str
    message: str
    line: int | None


@dataclass(frozen=True)
class Variable:
    """A variable of a model. Attributes of its type definition are filled in.

    Attributes
    ----------
    name : str
    index : int
        Position in the file, from 0; aliases have that of their variable.
    value_reference : int
        Handle within the FMU; aliases share it.
    description : str or None
    type : {"Real", "Integer", "Boolean", "String", "Enumeration"}
        Or one of FMI 3.0: "Float32", "Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64", "Binary", "Clock".
    causality : {"parameter", "structuralParameter", "calculatedParameter", "input", "output", "local", "independent"}
    variability : {"constant", "fixed", "tunable", "discrete", "continuous"}
    initial : {"exact", "approx", "calculated"} or None
        How the initial value comes about; None for inputs and time.
    declared_type : str or None
        Name of the type definition.
    quantity, unit, display_unit : str or None
    relative_quantity, unbounded : bool
    min, max, nominal : float or None
        In `unit`.
    start : float, int, bool, str, bytes, ndarray or None
        The start value, in `unit`; that of an array has its shape.
    shape : tuple of int
        Of an array, with structural parameters at their start values; () for a single value.
    dimensions : tuple of int or str
        The extents, or the names of the structural parameters that they are.
    aliases : tuple of str
        The other names of the variable (FMI 3.0): each is an entry of `Variables`, with its own description and display unit.
    derivative : str or None
        Name of the variable that this one is the time derivative of.
    reinit : bool
        A state that events may set anew.
    can_handle_multiple_set_per_time_instant : bool
    interval_variability : str or None
        Of a clock (FMI 3.0), who knows when it ticks: "constant", "fixed", "tunable", "changing", "countdown", "triggered".
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


#: What a table of variables shows of them, and of how many.
_COLUMNS = ("name", "type", "causality", "variability", "start", "unit", "description")
_MOST_SHOWN = 100


def _cell(value: object) -> str:
    return "" if value is None else value if isinstance(value, str) else _text.show(value)


class Variables(Mapping[str, Variable]):
    """The variables of a model by name, in the order of the file, each followed by its aliases (FMI 3.0); made when they are
    looked at. Printed they are a table; `to_dataframe` makes one of pandas."""

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
        """A table of the first hundred variables."""
        shown = list(itertools.islice(self.values(), _MOST_SHOWN))
        rows = [_COLUMNS, *(tuple(_text.line(_cell(getattr(variable, column))) for column in _COLUMNS) for variable in shown)]
        widths = [max(map(len, column)) for column in zip(*rows)]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]
        if len(self) > len(shown):
            lines.append(f"... and {len(self) - len(shown)} more: to_dataframe() has all")
        return "\n".join(lines)

    def to_dataframe(self) -> Any:
        """A pandas.DataFrame with a row per variable and the attributes of `Variable` as columns; the names are its index.
        Needs pandas."""
        rows = [vars(variable) for variable in self.values()]
        return _optional_libraries.pandas().DataFrame(rows, columns=list(Variable.__dataclass_fields__)).set_index("name")


@dataclass(frozen=True)
class Terminal:
    """Variables of the model that are connected to those of another one together.

    Attributes
    ----------
    name : str
    matching_rule : str
        How the members of two terminals are paired: "plug", "bus", "sequence", or a name with a domain.
    kind, description : str or None
    members : dict
        From the name of each variable to how it is connected: "signal", "inflow", "outflow", or a name with a domain.
    streams : list of tuple of str
        Pairs of variables for what is transported with a flow: into the model, and out of it.
    terminals : list of Terminal
        Those inside of it.
    icon : str or None
        Name of its image in the folder ``terminalsAndIcons``.
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
    """The model description of an FMU; reading it runs no code of the FMU.

    Attributes
    ----------
    fmi_version : str
        "1.0", "2.0", "3.0".
    model_name, guid : str
        The guid is the instantiation token in FMI 3.0.
    description, author, version, copyright, license, generation_tool, generation_date_and_time : str or None
    variable_naming_convention : {"flat", "structured"} or None
    n_states, n_event_indicators : int
    default_experiment : DefaultExperiment
    model_exchange, co_simulation : Interface or None
        None if it is not offered.
    path : Path
        The file.
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
        """Those of model exchange, or those of co-simulation where that alone is offered."""
        interface = self.model_exchange or self.co_simulation
        return interface.capabilities if interface else None

    @cached_property
    def states(self) -> list[str | None]:
        """Names of the continuous states in their order; None where the file does not name them."""
        return self._fmu.state_names()

    @cached_property
    def terminals(self) -> list[Terminal]:
        """The terminals of the model (``terminalsAndIcons.xml``); empty where it has none."""
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
        """The units by name."""
        return {u["name"]: _unit(**u) for u in self._fmu.units()}

    @cached_property
    def type_definitions(self) -> dict[str, TypeDefinition]:
        """The types by name."""
        return {t["name"]: _type_definition(**t) for t in self._fmu.type_definitions()}

    @cached_property
    def log_categories(self) -> list[LogCategory]:
        """The categories of log messages."""
        return [LogCategory(*category) for category in self._fmu.log_categories()]

    @property
    def quirks(self) -> list[Quirk]:
        """Where the file departs from the standard, and where the model was seen to when it was run."""
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
    """The model description of an FMU, which need not be one that can be simulated. Runs no code of the FMU.

    Parameters
    ----------
    path : path
        An ``.fmu`` file or an unpacked folder.
    max_description_bytes : int, optional
        How large ``modelDescription.xml`` may be; default 64 MiB. Reading it takes at most eight times as much memory.
    max_elements : int, optional
        How many elements its array variables may have together; default 2 million.

    Raises
    ------
    OSError
        The file cannot be read (FileNotFoundError if there is none).
    FmuError
        The archive or its ``modelDescription.xml`` is damaged, or not safe to unpack.
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
    """A description from its pickle, which needs no file."""
    return Description(_core.Fmu.described(path, description, content_hash))
