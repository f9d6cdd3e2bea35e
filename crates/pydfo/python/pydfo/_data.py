"""Measurements in the shapes people have them: CSV files, dictionaries, data frames, structured arrays."""

from __future__ import annotations

import datetime
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _core, _options
from ._errors import BadCalibrationError

FloatArray = npt.NDArray[np.float64]

Path = str | os.PathLike[str]
Columns = list[tuple[str, list[float]]]


@dataclass(frozen=True)
class Table:
    """A recording, as the native code reads it."""

    #: A CSV file, or None.
    path: str | None
    #: The columns in memory: the times first, in the unit in their name, then those needed.
    columns: Columns
    #: Names of the other columns.
    left_out: list[str]


def read(data: Any, needed: list[str], time: str | None) -> Table:
    """The path of a CSV file, or the columns of a table in memory; `time` names the column of times.

    Raises
    ------
    TypeError
        `data` is nothing that holds columns.
    BadCalibrationError
        There is no column of times, or one of those needed is missing or holds text.
    """
    if isinstance(data, (str, os.PathLike)):
        return Table(os.fspath(data), [], [])
    table = _columns(data)
    names = list(table)
    try:
        index, (numerator, denominator) = _core.find_time(names, time)
    except ValueError as e:
        raise BadCalibrationError(f"data: {e}") from None
    at = names[index]
    durations = seconds(table[at])
    if durations is not None and numerator != denominator:
        raise BadCalibrationError(f"data: column '{at}' holds durations, which have a unit of their own; take the unit out of its name")
    columns = [(at, _numbers(at, table[at] if durations is None else durations))]
    for name in dict.fromkeys(needed):
        if name == at:
            continue
        if name not in table:
            raise BadCalibrationError(f"data: there is no column '{name}'; there are: {_options.listed(names)}")
        columns.append((name, _numbers(name, table[name])))
    return Table(None, columns, [name for name in names if name != at and name not in needed])


def _columns(data: Any) -> dict[str, Any]:
    if isinstance(data, Mapping):
        return {str(name): values for name, values in data.items()}
    names = getattr(getattr(data, "dtype", None), "names", None)
    if names:
        return {name: data[name] for name in names}
    if hasattr(data, "columns") and hasattr(data, "__getitem__"):
        table = {str(name): data[name] for name in data.columns}
        index = getattr(data, "index", None)
        name = getattr(index, "name", None)
        if isinstance(name, str):
            table.setdefault(name, index)
        return table
    raise TypeError(
        f"data must be the path of a CSV file, a dict of arrays, a DataFrame or a structured array, not {type(data).__name__}"
    )


def seconds(values: Any) -> FloatArray | None:
    """Durations (``timedelta64`` of NumPy and pandas, ``datetime.timedelta``) in s; None if `values` are something else."""
    array = np.asarray(values)
    if array.dtype.kind == "O" and array.size and all(isinstance(value, datetime.timedelta) for value in array.flat):
        array = array.astype("timedelta64[us]")
    if array.dtype.kind != "m":
        return None
    # A timedelta64 without a unit is a number of who knows what.
    if np.datetime_data(array.dtype)[0] == "generic":
        return None
    return np.asarray(array / np.timedelta64(1, "s"), dtype=np.float64)


def _numbers(name: str, values: Any) -> list[float]:
    """A column as floats; what is masked, None or NA is missing (NaN)."""
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    elif hasattr(values, "to_numpy"):
        # missing values of nullable pandas columns, which float() refuses
        mask = values.isna() if hasattr(values, "isna") else None
        values = values.to_numpy()
        if mask is not None and values.dtype == object:
            values = np.where(np.asarray(mask), np.nan, values)
    array = np.asarray(values)
    if array.dtype.kind in "mM":
        raise BadCalibrationError(
            f"data: column '{name}' holds dates; times are numbers, in s or in the unit in the name of their column, or durations: "
            "subtract the first date (t - t[0])"
        )
    if array.ndim != 1:
        raise BadCalibrationError(f"data: column '{name}' must be one-dimensional, not of shape {array.shape}")
    if array.dtype.kind in "fiub":
        return [float(v) for v in array.tolist()]
    return [_number(name, row, value) for row, value in enumerate(array.tolist())]


def _number(name: str, row: int, value: Any) -> float:
    if value is None:
        return float("nan")
    if not isinstance(value, (str, bytes)):
        try:
            return float(value)
        except (TypeError, ValueError):
            pass
    raise BadCalibrationError(f"data: {value!r} in column '{name}', row {row}, is not a number")
