"""Measurements in the shapes people have them: CSV files, dictionaries, data frames, structured arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ._errors import BadCalibrationError

FloatArray = npt.NDArray[np.float64]

Path = str | os.PathLike[str]
Columns = list[tuple[str, list[float]]]


def read(data: Any, needed: list[str]) -> tuple[str | None, Columns]:
    """The path of a CSV file, or the columns of a table in memory: the time first, then those needed.

    Raises
    ------
    TypeError
        `data` is nothing that holds columns.
    BadCalibrationError
        There is no column of times, or one of those needed is missing or holds text.
    """
    if isinstance(data, (str, os.PathLike)):
        return os.fspath(data), []
    table = _columns(data)
    time = next((name for name in table if name.lower() == "time"), None)
    if time is None:
        raise BadCalibrationError(f"data: there is no column 'time'; there are: {_names(table)}")
    columns = [(time, _numbers(time, table[time]))]
    for name in dict.fromkeys(needed):
        if name == time:
            continue
        if name not in table:
            raise BadCalibrationError(f"data: there is no column '{name}'; there are: {_names(table)}")
        columns.append((name, _numbers(name, table[name])))
    return None, columns


def _columns(data: Any) -> dict[str, Any]:
    if isinstance(data, Mapping):
        return {str(name): values for name, values in data.items()}
    names = getattr(getattr(data, "dtype", None), "names", None)
    if names:
        return {name: data[name] for name in names}
    if hasattr(data, "columns") and hasattr(data, "__getitem__"):
        table = {str(name): data[name] for name in data.columns}
        index = getattr(data, "index", None)
        if str(getattr(index, "name", "")).lower() == "time":
            table.setdefault("time", index)
        return table
    raise TypeError(
        f"data must be the path of a CSV file, a dict of arrays, a DataFrame or a structured array, not {type(data).__name__}"
    )


def _names(table: dict[str, Any]) -> str:
    return ", ".join(f"'{name}'" for name in table)


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
        raise BadCalibrationError(f"data: column '{name}' holds dates; times are numbers, in s")
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
