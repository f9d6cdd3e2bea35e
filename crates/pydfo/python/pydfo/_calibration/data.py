"""Conversion of measurements: files, dictionaries, data frames, series, structured arrays."""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import text as _text
from .._errors import BadCalibrationError
from . import data_files as _data_files

FloatArray = npt.NDArray[np.float64]

Path = str | os.PathLike[str]

@dataclass(frozen=True)
class Table:
    """A recording, as the native code reads it."""

    #: Path of a CSV file, or None.
    path: str | None
    #: The times and the required columns in memory; None if they are in the file.
    table: _core.Table | None
    #: Name of the time column of the file; None: "time" in any case.
    time: str | None


def read(data: Any, needed: list[str], time: str | None, sheet: str | None = None) -> Table:
    """Returns the path of a CSV file, or the columns of another file or of a table in memory; `time` is the time
    column, `sheet` the sheet of a workbook or the table of an HDF5 file.

    Raises
    ------
    TypeError
        `data` does not contain columns.
    ImportError
        The library for files of this format is not installed. The message states how to install it.
    BadCalibrationError
        There is no time column, or a required column is missing or contains text.
    """
    suffix = _data_files.suffix(os.fspath(data)) if isinstance(data, (str, os.PathLike)) else None
    if sheet is not None and suffix not in (".xlsx", ".xlsm", *_HDF5):
        raise BadCalibrationError(f"sheet = {sheet!r} requires a workbook (.xlsx) or the tables of pandas in an HDF5 file (.h5)")
    if not isinstance(data, (str, os.PathLike)):
        columns = _columns(data)
        try:
            return _selected(_data_files.Columns(list(columns), lambda names: columns), needed, time)
        except BadCalibrationError as e:
            wanted = "time" if time is None else time
            if f"column '{wanted}' not found" not in str(e) or not _has_unnamed_index(data):
                raise
            raise BadCalibrationError(f"{e}. If the index contains the times, name it: frame.rename_axis({wanted!r})") from None
    path = os.fspath(data)
    match suffix:
        case ".parquet" | ".pq":
            return _selected(_data_files.parquet(path), needed, time)
        case ".mat":
            return _selected(_data_files.mat(path, needed, time), needed, time)
        case ".xlsx" | ".xlsm":
            text, others = _data_files.workbook(path, needed, time, sheet)
            return Table(None, _core.Table.from_csv(text, path, time, needed, others), None)
        case ".h5" | ".hdf" | ".hdf5":
            columns = _columns(_data_files.hdf5(path, sheet))
            return _selected(_data_files.Columns(list(columns), lambda names: columns), needed, time)
        case ".xls" | ".ods" | ".feather" | ".pkl" | ".json" | ".npy" | ".npz" as other:
            raise BadCalibrationError(
                f"data: {path}: {other} files are not supported; expected CSV, .mat, .parquet, .xlsx or .h5. Read the file with a library, and "
                "pass a dict of arrays or a DataFrame"
            )
    return Table(path, None, time)


#: Suffixes of HDF5 files with tables of pandas.
_HDF5 = (".h5", ".hdf", ".hdf5")


def all_columns(data: Any) -> list[str]:
    """Returns the names of all columns of data in memory; empty for a path."""
    return [] if isinstance(data, (str, os.PathLike)) else list(_columns(data))


def read_recording(data: Any, needed: list[str], time: str | None, sheet: str | None = None) -> Table:
    """Like `read`, for data compared with a model: also records the name of the file for the fit."""
    found = read(data, needed, time, sheet)
    if found.table is not None and isinstance(data, (str, os.PathLike)):
        return Table(None, found.table.of_file(os.fspath(data)), None)
    return found


def _find_time(names: list[str], time: str | None) -> tuple[int, tuple[float, float] | None]:
    try:
        return _core.find_time(names, time)
    except ValueError as e:
        raise BadCalibrationError(f"data: {e}") from None


def _selected(source: _data_files.Columns, needed: list[str], time: str | None) -> Table:
    """Returns the times and the required columns."""
    names = source.names
    index, unit = _find_time(names, time)
    at = names[index]
    taken = [at]
    for name in needed:
        try:
            found = names[_core.find_column(names, name)]
        except ValueError as e:
            hint = f". Ignored, because their length differs from the times: {', '.join(source.others)}" if source.others else ""
            raise BadCalibrationError(f"data: {e}{hint}") from None
        if found not in taken:
            taken.append(found)
    table = source.read(taken)
    durations, change = _seconds(table[at], at)
    if durations is not None and unit is not None and unit[0] != unit[1]:
        raise BadCalibrationError(
            f"data: column '{at}' contains durations or dates, which include their unit; remove the unit from its name"
        )
    # Converted one by one, so that no temporary array outlives its copy.
    columns = ((name, _numbers(name, table[name]) if name != at or durations is None else durations) for name in taken)
    left_out = [name for name in names if name not in taken]
    return Table(None, _core.Table(columns, at, left_out, change, durations is not None), None)


def _columns(data: Any) -> dict[str, Any]:
    if isinstance(data, Mapping) and not hasattr(data, "data_vars"):
        return {str(name): values for name, values in data.items()}
    names = getattr(getattr(data, "dtype", None), "names", None)
    if names:
        return {name: data[name] for name in names}
    if hasattr(data, "coords") and hasattr(data, "dims"):
        return _labelled(data)
    if hasattr(data, "columns") and hasattr(data, "__getitem__"):
        return _framed(data)
    if hasattr(data, "index") and hasattr(data, "to_frame") and hasattr(data, "dtype"):
        return _framed(data.to_frame(data.name if isinstance(data.name, str) else "value"))
    hint = ""
    if isinstance(data, (np.ndarray, list, tuple)):
        hint = ", because its columns have no names; use a dict such as {'time': t, 'y': y}"
    raise TypeError(
        "data must be the path of a file (CSV, .mat, .parquet, .xlsx), a dict of arrays, a DataFrame or a structured array, not "
        f"{type(data).__name__}{hint}"
    )


def _framed(frame: Any) -> dict[str, Any]:
    """Returns the columns of a pandas or polars data frame.

    The index contains the times if its name is the name of the times, or if it contains dates or
    durations and no column has that name. If there are two lines of names, the second contains the units."""
    table = {}
    for label in frame.columns:
        name = _name(label)
        if name in table:
            raise BadCalibrationError(f"data: two columns have the name '{name}'")
        table[name] = frame[label]
    index: Any = getattr(frame, "index", None)
    if hasattr(index, "to_timestamp"):
        index = index.to_timestamp()
    named = getattr(index, "name", None)
    if isinstance(named, str):
        table.setdefault(named, index)
    elif index is not None and seconds(index) is not None or (len(table) == 1 and type(index).__name__ == "Index"):
        table.setdefault("time", index)
    return table


def _has_unnamed_index(data: Any) -> bool:
    """True for a pandas table whose index has no name and does not only count the rows."""
    index = getattr(data, "index", None)
    return hasattr(data, "rename_axis") and getattr(index, "name", "") is None and type(index).__name__ == "Index"


def _name(label: Any) -> str:
    if isinstance(label, tuple) and len(label) == 2:
        name, unit = (str(part).strip() for part in label)
        return name if not unit or unit.startswith("Unnamed:") else f"{name} [{unit.strip('[]()')}]"
    return str(label)


def _labelled(data: Any) -> dict[str, Any]:
    """Returns the vectors of an xarray Dataset or DataArray, with the units of their attributes."""
    variables = dict(data.variables) if hasattr(data, "data_vars") else {data.name or "value": data.variable}
    variables |= {name: coordinate.variable for name, coordinate in data.coords.items()}
    table = {}
    for name, variable in variables.items():
        unit = variable.attrs.get("units")
        has_unit = isinstance(unit, str) and unit.strip() and not str(name).endswith(("]", ")"))
        if variable.ndim == 1:
            table[f"{name} [{unit}]" if has_unit else str(name)] = variable.values
    return table


#: Local times before and after an hour that is missing or doubled, and a flag that is True if it is doubled.
ClockChange = tuple[str, str, bool]


def seconds(values: Any, column: str = "") -> FloatArray | None:
    """Converts durations and dates to seconds; None if `values` are neither.

    Durations (``timedelta64`` of NumPy and pandas, ``datetime.timedelta``) are converted to s. Dates (``datetime64``,
    ``datetime``, strings) are converted to s since the first one. The name of the column may define the meaning of
    `10:02`, as in ``time [mm:ss]``."""
    return _seconds(values, column)[0]


def _seconds(values: Any, column: str) -> tuple[FloatArray | None, ClockChange | None]:
    """Returns times in s, and the missing or repeated hour of a clock change in dates without a time zone."""
    array = np.asarray(values)
    if array.ndim != 1 or not array.size:
        return None, None
    if array.dtype.kind == "U" or (array.dtype.kind in "OT" and all(isinstance(value, str) for value in array)):
        with _refused():
            return _core.date_seconds([str(value) for value in array], column)
    if array.dtype.kind == "O":
        for kind in (datetime.datetime, datetime.date, datetime.timedelta):
            if all(isinstance(value, kind) for value in array):
                if kind is datetime.timedelta:
                    return np.array([value.total_seconds() for value in array]), None
                dates, is_naive = _in_utc(array) if kind is datetime.datetime else (array, False)
                since = np.array([(value - dates[0]).total_seconds() for value in dates])
                return since, _clock_change(np.datetime64(dates[0], "us"), since) if is_naive else None
    if array.dtype.kind not in "mM" or np.datetime_data(array.dtype)[0] == "generic":
        # The unit of a timedelta64 without a unit is unknown.
        return None, None
    if array.dtype.kind == "m":
        return np.asarray(array / np.timedelta64(1, "s"), dtype=np.float64), None
    since = np.asarray((array - array[0]) / np.timedelta64(1, "s"), dtype=np.float64)
    return since, _clock_change(array[0], since)


def _in_utc(dates: Any) -> tuple[Any, bool]:
    """Returns dates, in UTC if they have a time zone, and a flag that is True if they have none.

    Python subtracts dates of one time zone by the wall clock."""
    with_zone = [value.tzinfo is not None for value in dates]
    if not any(with_zone):
        return dates, True
    if not all(with_zone):
        naive, other = with_zone.index(False), with_zone.index(True)
        raise BadCalibrationError(
            f"data: the date in row {naive}, {dates[naive]}, has no time zone, but the date in row {other}, {dates[other]}, has one. Specify "
            "a time zone for all dates, or for none"
        )
    return [value.astimezone(datetime.timezone.utc) for value in dates], False


def _clock_change(first: np.datetime64, since: FloatArray) -> ClockChange | None:
    """Returns a missing or doubled hour in the times since the first one, which is a local time."""
    start = (first - np.datetime64(0, "s")) / np.timedelta64(1, "s")
    with _refused():
        return _core.clock_change(float(start), since)


@contextmanager
def _refused() -> Iterator[None]:
    """Converts errors of the native code to errors in the data."""
    try:
        yield
    except ValueError as e:
        raise BadCalibrationError(f"data: {e}") from None


def mask(given: Any) -> tuple[list[bool] | None, str | None]:
    """Returns a mask as one truth value per row, or as the name of a column."""
    if given is None or isinstance(given, str):
        return None, given
    array = np.asarray(given)
    if array.ndim != 1 or array.dtype.kind != "b":
        raise TypeError(f"mask must be one True or False per row, or the name of a column, not {_text.show(given)}")
    return array.tolist(), None


def _numbers(name: str, values: Any) -> FloatArray:
    """Returns a column as floats; masked entries, None and NA are missing (NaN)."""
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    elif hasattr(values, "to_numpy"):
        # float() rejects missing values of nullable pandas columns
        mask = values.isna() if hasattr(values, "isna") else None
        values = values.to_numpy()
        if mask is not None and values.dtype == object:
            values = np.where(np.asarray(mask), np.nan, values)
    array = np.asarray(values)
    if array.dtype.kind in "mM":
        raise BadCalibrationError(
            f"data: column '{name}' contains dates or durations, not measurements; if it is the time column, set time='{name}'"
        )
    if array.ndim != 1:
        raise BadCalibrationError(f"data: column '{name}' must be one-dimensional, not of shape {array.shape}")
    if array.dtype.kind in "fiub":
        return np.ascontiguousarray(array, dtype=np.float64)
    return np.fromiter((_number(name, row, value) for row, value in enumerate(array)), np.float64, array.size)


def _number(name: str, row: int, value: Any) -> float:
    if value is None:
        return float("nan")
    if isinstance(value, np.generic):
        value = value.item()
    if not isinstance(value, (str, bytes)):
        try:
            return float(value)
        except OverflowError:
            raise BadCalibrationError(
                f"data: a number in column '{name}', row {row}, exceeds the largest number 1.8e308"
            ) from None
        except (TypeError, ValueError):
            pass
    raise BadCalibrationError(f"data: {_text.show(value)} in column '{name}', row {row}, is not a number")
