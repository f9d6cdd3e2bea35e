"""Conversion of all forms of inputs into tables and functions of time."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import text as _text
from .._calibration import data as _data

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Table:
    """Columns and their times, as the native code reads them."""

    times: FloatArray
    columns: list[tuple[str, FloatArray]]
    #: Strings, bytes, and integers that cannot be represented as doubles.
    values: list[tuple[str, list[Any]]]


@dataclass(frozen=True)
class Function:
    """A function of time that returns the values of some inputs, as the native code reads it."""

    names: list[str]
    function: Callable[[float], Any]


def normalize(
    given: Any, fmu: _core.Fmu, start_values: list[str], parameter_set: str | None
) -> tuple[list[Table], list[Function]]:
    """Returns tables and functions from the argument ``inputs`` of a simulation.

    `start_values` lists the names whose start values are set."""
    if given is None:
        return [], []
    if isinstance(given, (str, os.PathLike)):
        return _recording(os.fspath(given), fmu, start_values, parameter_set), []
    if isinstance(given, Mapping):
        return _mapping(given, fmu)
    if isinstance(given, np.ndarray) and given.dtype.names is not None:
        return [_table(given.dtype.names, lambda name: given[name].ravel(), "the structured array", fmu)], []
    if hasattr(given, "columns") and hasattr(given, "to_numpy"):
        return [_frame(given, fmu)], []
    if callable(given):
        inputs = fmu.names_of("input")
        if len(inputs) != 1:
            raise ValueError(
                f"a single function can drive only a model with one input; this model has {len(inputs)} "
                f"({_text.names(inputs[:10]) or 'none'}). Use (names, function) or a dict of functions"
            )
        return [], [Function(inputs, given)]
    if isinstance(given, (tuple, list)) and len(given) == 2 and isinstance(given[0], (str, Sequence, np.ndarray)):
        return _pair(given[0], given[1])
    raise TypeError(
        "inputs must be the path of a recording, a dict or a DataFrame with 'time', a structured array, a function, "
        f"(names, matrix) or (names, function), not {type(given).__name__}"
    )


def _recording(path: str, fmu: _core.Fmu, start_values: list[str], parameter_set: str | None) -> list[Table]:
    """Returns the columns of a file with the names of inputs or tunable parameters."""
    found = _data.read(path, [], None)
    if found.table is not None:
        # Elements of arrays and units follow the name. Case may differ.
        driven = fmu.names_of("input") + fmu.tunable_parameters()
        inputs, names = {name.split("[")[0].lower() for name in driven}, found.table.names()
        named = [name for name in names if re.split(r"[\[(]", name)[0].strip().lower() in inputs]
        found = _data.read(path, named, None)
    series = _core.recorded_inputs(fmu, found.path, found.table, start_values, parameter_set)
    return [Table(times, [(name, values)], []) for name, times, values in series]


def held_beyond(tables: list[Table], first: float, last: float) -> str:
    """Returns a warning about recorded inputs that end before a simulation or start after it by more than a row.

    Returns an empty string if there is none."""
    for table in tables:
        if len(table.times) < 2:
            # A constant input.
            continue
        start, end = float(np.min(table.times)), float(np.max(table.times))
        row = float(np.median(np.diff(np.sort(table.times)))) + 2.0 * _core.time_tolerance(first, last)
        if start - first > row or last - end > row:
            named = _text.names([name for name, _ in table.columns + table.values][:10])
            return (
                f"inputs {named} cover {start:g} s to {end:g} s, but the simulation runs from {first:g} s to {last:g} s. Outside this range "
                "they keep their first or last value"
            )
    return ""


def _mapping(given: Mapping[Any, Any], fmu: _core.Fmu) -> tuple[list[Table], list[Function]]:
    for name in given:
        if not isinstance(name, str):
            raise TypeError(f"names of inputs must be strings, not {_text.show(name)}")
    functions = [Function([name], value) for name, value in given.items() if callable(value)]
    constants = {name: [value] for name, value in given.items() if not callable(value) and np.ndim(value) == 0}
    names = [name for name, value in given.items() if not callable(value) and np.ndim(value) > 0]
    # A table with a single row is constant.
    tables = [_columns(np.zeros(1), constants)] if constants else []
    if names and names != ["time"]:
        tables.append(_table(names, lambda name: given[name], "the dict", fmu))
    return tables, functions


def _frame(given: Any, fmu: _core.Fmu) -> Table:
    columns: dict[str, Any] = {str(name): given[name] for name in given.columns}
    index = getattr(given, "index", None)
    name = getattr(index, "name", None)
    if isinstance(name, str):
        columns.setdefault(name, index)
    return _table(list(columns), lambda name: columns[name].to_numpy(), "the DataFrame", fmu)


def _table(names: Sequence[str], column: Callable[[str], Any], what: str, fmu: _core.Fmu) -> Table:
    """Returns the columns of a table. The times are the column "time", converted from the unit in its name to the time
    unit of the model."""
    try:
        at, unit = _core.find_time(list(names))
    except ValueError as e:
        if not any("time" in name.lower() for name in names):
            there = _text.names(names[:10])
            raise ValueError(
                f"{what} of inputs has no times, only {there}. Add them, inputs={{'time': [...], {names[0]!r}: [...]}}, or use a "
                "number for a constant input"
            ) from None
        raise ValueError(f"{what} of inputs: {e}") from None
    given = column(names[at])
    durations = _data.seconds(given)
    if durations is not None and unit is not None and unit[0] != unit[1]:
        raise ValueError(f"{what} of inputs: '{_text.line(names[at])}' contains durations, which include their unit; remove the unit from its name")
    times = _column(names[at], given if durations is None else durations)
    numerator, denominator = fmu.time_factor(unit if durations is None else (1.0, 1.0))
    if numerator != denominator:
        times = times * numerator / denominator
    return _columns(times, {name: column(name) for k, name in enumerate(names) if k != at})


def _columns(times: FloatArray, given: Mapping[str, Any]) -> Table:
    exact = {name: _exact(values) for name, values in given.items()}
    numbers = [(name, _column(name, values)) for name, values in given.items() if exact[name] is None]
    return Table(times, numbers, [(name, values) for name, values in exact.items() if values is not None])


#: Largest magnitude up to which a double represents every integer.
_EXACT_INTEGERS = 2**53


def _exact(values: Any) -> list[Any] | None:
    """Returns the values one by one if they are strings, bytes, or integers not representable as doubles, otherwise
    None."""
    if np.ndim(values) != 1 or len(values) == 0:
        return None
    if isinstance(values, np.ndarray) and values.dtype.kind in "iu":
        is_large = max(int(values.max()), -int(values.min())) > _EXACT_INTEGERS
        return [int(value) for value in values] if is_large else None
    if isinstance(values, np.ndarray) and values.dtype.kind not in "USO":
        return None
    items = list(values)
    if all(isinstance(item, (str, bytes)) for item in items):
        return items
    if all(isinstance(item, (int, np.integer)) for item in items) and max(map(abs, map(int, items))) > _EXACT_INTEGERS:
        return [int(item) for item in items]
    return None


def _pair(names: Any, data: Any) -> tuple[list[Table], list[Function]]:
    names = [names] if isinstance(names, str) else list(names)
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"names of inputs must be strings, not {name!r}")
    names = [str(name) for name in names]
    if callable(data):
        return [], [Function(names, data)]
    try:
        matrix = np.asarray(data, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"the matrix of inputs must be numbers, not {_text.show(data)}") from None
    if matrix.ndim != 2 or matrix.shape[1] != len(names) + 1:
        raise ValueError(
            f"the matrix of inputs has the shape {matrix.shape}; expected {len(names) + 1} columns for time and {len(names)} inputs"
        )
    columns = [np.ascontiguousarray(matrix[:, k]) for k in range(len(names) + 1)]
    return [Table(columns[0], list(zip(names, columns[1:])), [])], []


def _column(name: str, values: Any) -> FloatArray:
    name = _text.line(name)
    array = np.asarray(values)
    # NumPy would convert None to NaN.
    if array.dtype.kind not in "biufO" or (array.dtype.kind == "O" and any(v is None for v in array.flat)):
        raise TypeError(f"input {name} must be numbers, not of type {array.dtype}")
    try:
        array = np.ascontiguousarray(array, dtype=np.float64)
    except (TypeError, ValueError) as e:
        raise TypeError(f"input {name} must be numbers: {e}") from None
    if array.ndim == 2 and 1 in array.shape:
        array = array.ravel()
    if array.ndim != 1:
        elements = ", ".join(f"'{name}[{k + 1}]'" for k in range(min(array.shape[-1], 3))) if array.ndim == 2 else ""
        hint = f"; use a separate column for each element of an array ({elements})" if elements else ""
        raise ValueError(f"input {name} must be one-dimensional, not of shape {array.shape}{hint}")
    return array
