"""Recordings in other formats. The library for each format is imported only when it is needed."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import json
import math
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _core
from .._args import text as _text
from .._errors import BadCalibrationError, CalibrationWarning
from . import matlab_reader
from .worker import interpreter

Array = npt.NDArray[Any]


def suffix(path: str) -> str:
    """Returns the suffix of a file name in lower case."""
    return os.path.splitext(path)[1].lower()


def _library(path: str, names: list[str]) -> Any:
    """Returns the first of these modules that is installed."""
    for name in names:
        try:
            return importlib.import_module(name)
        except ImportError:
            pass
    package = names[0].split(".", maxsplit=1)[0]
    raise ImportError(f"{path}: reading {suffix(path)} files requires {package}; install it with pip install {package}")


@dataclass(frozen=True)
class Columns:
    """Columns by name, which are read on request."""

    names: list[str]
    read: Callable[[list[str]], Mapping[str, Any]]
    #: Other contents of the file, with their sizes.
    others: list[str] = field(default_factory=list)


#: Maximum number of bytes of values to read, or eight times the size of the file if this is larger.
MOST_BYTES = 1 << 30

#: Maximum number of bytes of the strings of a workbook, which are kept while its rows are read.
_MOST_TEXT = 1 << 26

#: Maximum number of rows of a sheet in Excel.
_MOST_ROWS = 1 << 20

#: Number of values read at once. Ctrl-C is handled between two parts.
_PART = 1 << 20


def check_size(path: str, n_values: int) -> None:
    """Rejects columns with too many values, because compressed files may claim any number of values."""
    most = max(MOST_BYTES, 8 * os.path.getsize(path))
    if 8 * n_values > most:
        raise MemoryError(
            f"{path}: the required columns have {n_values} values, which require {8 * n_values} bytes, more than {most} (1 GiB, or 8 "
            "times the size of the file). Pass parts of the file as arrays"
        )


@contextmanager
def _reading(path: str, what: str) -> Iterator[None]:
    """Converts errors of a library's reader to errors that name the file."""
    try:
        yield
    except MemoryError:
        raise
    except OSError as e:
        if e.errno is not None and e.filename is not None:
            raise
        raise BadCalibrationError(f"{path}: the file is not {what}, or it is damaged") from None
    except BadCalibrationError:
        raise
    except Exception as e:
        raise BadCalibrationError(f"{path}: the file is not {what}, or it is damaged: {_text.beginning(str(e))}") from e


def parquet(path: str) -> Columns:
    """Returns the columns of a Parquet file."""
    _core.check_regular(path)
    if importlib.util.find_spec("pyarrow") is None and importlib.util.find_spec("polars") is not None:
        return _with_polars(path)
    module, arrow = _library(path, ["pyarrow.parquet"]), importlib.import_module("pyarrow")
    with _reading(path, "a Parquet file"):
        file = module.ParquetFile(path)
        names = list(file.schema_arrow.names)

    def read(wanted: list[str]) -> dict[str, Any]:
        with _reading(path, "a Parquet file"):
            check_size(path, file.metadata.num_rows * len(wanted))
            parts: dict[str, list[Any]] = {name: [] for name in wanted}
            n_rows = 0
            for batch in file.iter_batches(batch_size=_PART, columns=wanted):
                n_rows += batch.num_rows
                check_size(path, n_rows * len(wanted))
                for name in wanted:
                    column = batch.column(batch.schema.names.index(name))
                    parts[name].append(arrow.chunked_array([column]).to_numpy())
            return {name: np.concatenate(arrays) if arrays else np.empty(0) for name, arrays in parts.items()}

    return Columns(names, read)


def _with_polars(path: str) -> Columns:
    polars = importlib.import_module("polars")
    with _reading(path, "a Parquet file"):
        names = list(polars.read_parquet_schema(path))
        scan = polars.scan_parquet(path)

    def read(wanted: list[str]) -> dict[str, Any]:
        with _reading(path, "a Parquet file"):
            check_size(path, scan.select(polars.len()).collect().item() * len(wanted))
            frame = scan.select(wanted).collect()
            return {name: frame[name] for name in wanted}

    return Columns(names, read)


def hdf5(path: str, key: str | None) -> Any:
    """Returns a table that pandas has written to an HDF5 file."""
    _core.check_regular(path)
    pandas = _library(path, ["pandas"])
    try:
        importlib.import_module("tables")
    except ImportError:
        raise ImportError(f"{path}: reading {suffix(path)} files requires PyTables; install it with pip install tables") from None
    with _reading(path, "an HDF5 file with tables of pandas"), pandas.HDFStore(path, mode="r") as store:
        keys = [name.strip("/") for name in store]
        if key is None and len(keys) > 1:
            raise BadCalibrationError(f"{path}: the file contains several tables; specify one with sheet=, expected one of: {_text.listed(keys)}")
        if key is not None and key.strip("/") not in keys:
            raise BadCalibrationError(f"{path}: table {key!r} not found; expected one of: {_text.listed(keys)}")
        return store[keys[0] if key is None else key]


def sheets(path: str) -> list[str]:
    """Returns the names of the sheets of an Excel workbook that are not empty."""
    _core.check_regular(path)
    module = _library(path, ["openpyxl"])
    with _reading(path, "an Excel workbook (.xlsx)"):
        book = module.load_workbook(path, read_only=True, data_only=True)
        try:
            return _sheets(book)
        finally:
            book.close()


def _sheets(book: Any) -> list[str]:
    """Returns the names of the sheets with at least one value in their first rows."""
    names = []
    for sheet in book.worksheets:
        sheet.reset_dimensions()
        if any(cell is not None for row in sheet.iter_rows(max_row=100, values_only=True) for cell in row):
            names.append(sheet.title)
    return names


def workbook(path: str, needed: list[str], time: str | None, sheet_name: str | None = None) -> tuple[bytes, list[str]]:
    """Returns the required columns of a sheet of an Excel workbook as CSV text, and the names of the other columns.

    Without a name, the first sheet is read, with a warning if there are others."""
    _core.check_regular(path)
    import csv
    import zipfile

    module = _library(path, ["openpyxl"])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    chosen: list[int] | None = None
    names: list[str] = []
    with _reading(path, "an Excel workbook (.xlsx)"):
        with zipfile.ZipFile(path) as archive:
            kept = sum(entry.file_size for entry in archive.infolist() if "/worksheets/" not in entry.filename)
        if kept > max(_MOST_TEXT, 8 * os.path.getsize(path)):
            raise MemoryError(f"{path}: the strings and formats of this workbook require {kept} bytes, more than {_MOST_TEXT}")
        book = module.load_workbook(path, read_only=True, data_only=True)
        try:
            titles = [sheet.title for sheet in book.worksheets]
            if sheet_name is not None and sheet_name not in titles:
                raise BadCalibrationError(f"{path}: sheet {sheet_name!r} not found; expected one of: {_text.listed(titles)}")
            if sheet_name is None and len(filled := _sheets(book)) > 1:
                warnings.warn(
                    f"{path}: the workbook has several sheets: {_text.listed(filled)}. The first one is read; specify one with sheet=, or "
                    "read one recording per sheet with Experiment.of_sheets",
                    CalibrationWarning,
                    stacklevel=2,
                )
            sheet = book.worksheets[0 if sheet_name is None else titles.index(sheet_name)]
            # The size that a sheet declares is not reliable.
            sheet.reset_dimensions()
            for row in sheet.iter_rows(max_row=_MOST_ROWS, values_only=True):
                if all(cell is None for cell in row) or (isinstance(row[0], str) and row[0].lstrip().startswith("#")):
                    continue
                if chosen is None:
                    names = ["" if cell is None else str(_cell(cell)).strip() for cell in row]
                    chosen = _chosen(names, needed, time)
                cells = [_cell(row[k]) if k < len(row) and row[k] is not None else "" for k in chosen]
                # A row may have cells in other columns only.
                if any(cell != "" for cell in cells):
                    writer.writerow(cells)
        finally:
            book.close()
    return text.getvalue().encode(), [name for k, name in enumerate(names) if k not in (chosen or []) and name]


def _chosen(names: list[str], needed: list[str], time: str | None) -> list[int]:
    """Returns the indices of the times and of the required columns. A missing column is rejected when it is used."""
    try:
        chosen = {_core.find_time(names, time)[0]}
    except ValueError as e:
        raise BadCalibrationError(f"data: {e}") from None
    for name in needed:
        with contextlib.suppress(ValueError):
            chosen.add(_core.find_column(names, name))
    return sorted(chosen)


def _cell(cell: Any) -> Any:
    # Line breaks within a cell would become rows of the table.
    return cell.isoformat() if hasattr(cell, "isoformat") else " ".join(cell.split()) if isinstance(cell, str) else cell


def mat(path: str, needed: list[str], time: str | None) -> Columns:
    """Returns the numeric variables of a MATLAB file as long as the times; fields of structs are ``struct.field``."""
    _core.check_regular(path)
    with open(path, "rb") as file:
        head = file.read(128)
    is_hdf5 = b"MATLAB 7.3" in head or head.startswith(b"\x89HDF")
    _find_library(path, "h5py" if is_hdf5 else "scipy.io")

    most = max(MOST_BYTES, 8 * os.path.getsize(path)) // 8
    listed = json.loads(_ask_reader(path, {"is_hdf5": is_hdf5, "wanted": [*needed, time or "time"], "most": most}))
    shapes = {name: tuple(shape) for name, shape in listed["variables"].items()}
    try:
        at = _core.find_time(list(shapes), time)[0]
    except ValueError as e:
        raise BadCalibrationError(f"data: {e}") from None

    def load(names: list[str]) -> dict[str, Array]:
        arrays = io.BytesIO(_ask_reader(path, {"is_hdf5": is_hdf5, "names": names}))
        return {name: np.load(arrays, allow_pickle=False) for name in names}

    return _of_one_length(path, shapes, list(shapes)[at], listed["others"], load)


def _find_library(path: str, name: str) -> None:
    """Raises an error if a module is not installed. Imports only the package that contains the module."""
    try:
        is_found = importlib.util.find_spec(name) is not None
    except ImportError:
        is_found = False
    if not is_found:
        package = name.partition(".")[0]
        raise ImportError(f"{path}: reading {suffix(path)} files requires {package}; install it with pip install {package}")


#: Runs a file as a program with the import path of this process.
_RUN = "import json, runpy, sys; sys.path[:] = json.loads(sys.argv.pop(1)); sys.argv.pop(0); runpy.run_path(sys.argv[0], run_name='__main__')"


def _ask_reader(path: str, request: dict[str, Any]) -> bytes:
    """Returns the answer of `matlab_reader`, which runs in a separate process, because a damaged file can crash its
    reader."""
    if (program := interpreter()) is None:
        raise BadCalibrationError(f"{path}: MATLAB files are read by another Python process, but no interpreter was found (sys.executable)")
    command = [program, "-c", _RUN, json.dumps(sys.path), os.path.join(os.path.dirname(__file__), "matlab_reader.py"), os.path.abspath(path)]
    done = subprocess.run(command, input=json.dumps(request).encode(), capture_output=True, check=False)
    if done.returncode == 0:
        return done.stdout
    message = f"{path}: the file is not a MATLAB file, or it is damaged"
    if done.returncode == matlab_reader.REFUSED:
        raise BadCalibrationError(f"{message}: {_text.beginning(done.stderr.decode(errors='replace').strip())}")
    raise BadCalibrationError(f"{message}: the reader process ended with code {done.returncode}")


def _of_one_length(
    path: str, shapes: dict[str, tuple[int, ...]], time: str, others: list[str], load: Callable[[list[str]], dict[str, Array]]
) -> Columns:
    """Returns the columns of the variables as long as `time`.

    Vectors keep their names. The columns of a matrix `y` are ``y[1]``, ``y[2]`` and so on, counted from 1 as in
    MATLAB and in models. The other variables are listed with their sizes."""
    n = math.prod(shapes[time])
    if max(shapes[time], default=0) != n:
        raise BadCalibrationError(f"data: the times '{time}' must be a vector, not a {_size(shapes[time])} matrix")
    sources: dict[str, tuple[str, int | None]] = {}
    others = list(others)
    for name, shape in shapes.items():
        if math.prod(shape) == n and max(shape, default=1) == n:
            sources[name] = (name, None)
        elif len(shape) == 2 and n in shape and math.prod(shape) <= n * _MOST_COLUMNS:
            sources.update({f"{name}[{k + 1}]": (name, k) for k in range(math.prod(shape) // max(n, 1))})
        else:
            others.append(f"{name} ({_size(shape)})")

    def read(wanted: list[str]) -> dict[str, Array]:
        whole = list(dict.fromkeys(sources[name][0] for name in wanted))
        check_size(path, sum(math.prod(shapes[name]) for name in whole))
        values = load(whole)
        columns = {}
        for name in wanted:
            variable, k = sources[name]
            value = values[variable]
            columns[name] = value.reshape(-1) if k is None else (value if value.shape[0] == n else value.T)[:, k]
        return columns

    return Columns(list(sources), read, others)


#: Maximum number of columns of a matrix.
_MOST_COLUMNS = 1 << 16


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(n) for n in shape)
