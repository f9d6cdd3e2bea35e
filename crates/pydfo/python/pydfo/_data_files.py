"""Recordings in the formats of other tools, each read by the library that Python people use for it; none is needed before."""

from __future__ import annotations

import csv
import importlib
import importlib.util
import io
import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from ._errors import BadCalibrationError

Array = npt.NDArray[Any]


def suffix(path: str) -> str:
    """The end of a file's name, in lower case."""
    return os.path.splitext(path)[1].lower()


def _library(path: str, names: list[str]) -> Any:
    """The first of these modules that is installed."""
    for name in names:
        try:
            return importlib.import_module(name)
        except ImportError:
            pass
    package = names[0].split(".", maxsplit=1)[0]
    raise ImportError(f"{path}: reading {suffix(path)} files needs {package}: pip install {package}")


def _read(path: str, what: str, reader: Callable[[], Any]) -> Any:
    """What a reader of a library returns; what it raises becomes an error that names the file."""
    with open(path, "rb"):
        pass
    try:
        return reader()
    except (OSError, MemoryError):
        if what.startswith("a MATLAB file of version 7.3"):
            raise BadCalibrationError(f"{path}: this is not {what}, or it is damaged") from None
        raise
    except Exception as e:
        raise BadCalibrationError(f"{path}: this is not {what}, or it is damaged: {e}") from e


def parquet(path: str) -> dict[str, Any]:
    """The columns of a Parquet file."""
    if importlib.util.find_spec("pyarrow") is None and importlib.util.find_spec("polars") is not None:
        frame = _read(path, "a Parquet file", lambda: importlib.import_module("polars").read_parquet(path))
        return {name: frame[name] for name in frame.columns}
    module = _library(path, ["pyarrow.parquet"])
    table = _read(path, "a Parquet file", lambda: module.read_table(path))
    return {name: table.column(name).to_numpy() for name in table.column_names}


def workbook(path: str) -> bytes:
    """The first sheet of an Excel workbook as the text of a CSV file."""
    module = _library(path, ["openpyxl"])
    book = _read(path, "an Excel workbook (.xlsx)", lambda: module.load_workbook(path, read_only=True, data_only=True))
    try:
        rows = [row for row in book.worksheets[0].iter_rows(values_only=True) if any(cell is not None for cell in row)]
    finally:
        book.close()
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([["" if cell is None else _cell(cell) for cell in row] for row in rows])
    return text.getvalue().encode()


def _cell(cell: Any) -> Any:
    # Line breaks within a cell would be rows of the table.
    return cell.isoformat() if hasattr(cell, "isoformat") else " ".join(cell.split()) if isinstance(cell, str) else cell


def mat(path: str) -> dict[str, Array]:
    """The numeric variables of a MATLAB file, those of structs as ``struct.field``."""
    with open(path, "rb") as file:
        head = file.read(128)
    if b"MATLAB 7.3" in head or head.startswith(b"\x89HDF"):
        module = _library(path, ["h5py"])

        def read() -> dict[str, Array]:
            with module.File(path, "r") as file:
                return dict(_datasets(module, file, ""))

        columns: dict[str, Array] = _read(path, "a MATLAB file of version 7.3", read)
        return columns
    module = _library(path, ["scipy.io"])
    variables = _read(
        path, "a MATLAB file", lambda: module.loadmat(path, squeeze_me=False, struct_as_record=True, chars_as_strings=True)
    )
    found: dict[str, Array] = {}
    for name, value in variables.items():
        if not name.startswith("__"):
            found.update(_numeric(name, value))
    return found


def _numeric(name: str, value: Any) -> Iterator[tuple[str, Array]]:
    """The numeric arrays in a variable that SciPy has read."""
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            yield from _numeric(f"{name}.{field}", value.reshape(-1)[0][field])
    elif value.dtype.kind in "fiub":
        yield name, value


def _datasets(h5py: Any, group: Any, prefix: str) -> Iterator[tuple[str, Array]]:
    """The numeric arrays of a file of version 7.3, where they stand column by column."""
    for name, value in group.items():
        if name.startswith("#"):
            continue
        if isinstance(value, h5py.Group):
            yield from _datasets(h5py, value, f"{prefix}{name}.")
        elif value.dtype.kind in "fiub" and value.attrs.get("MATLAB_class") != b"char" and "MATLAB_empty" not in value.attrs:
            yield prefix + name, np.asarray(value).T


def of_one_length(variables: dict[str, Array], time: str) -> tuple[dict[str, Array], list[str]]:
    """The columns of the variables that are as long as `time`: vectors under their names, the columns of a matrix `y` as
    ``y[1]``, ``y[2]`` and so on, as MATLAB and models count them. The names of the others with their sizes come second."""
    times = variables[time]
    if max(times.shape, default=0) != times.size:
        raise BadCalibrationError(f"data: the times '{time}' are a {_size(times)} matrix, not a vector")
    n = times.size
    columns: dict[str, Array] = {}
    others = []
    for name, value in variables.items():
        if value.size == n and max(value.shape, default=1) == n:
            columns[name] = value.reshape(-1)
        elif value.ndim == 2 and n in value.shape:
            matrix = value if value.shape[0] == n else value.T
            columns.update({f"{name}[{k + 1}]": matrix[:, k] for k in range(matrix.shape[1])})
        else:
            others.append(f"{name} ({_size(value)})")
    return columns, others


def _size(value: Array) -> str:
    return " x ".join(str(n) for n in value.shape)
